"""Lines and cones: crossings, counts and spreads, against linear algebra and the definition."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from posecore.methods.vector_field import lines
from posecore.methods.vector_field.lines import (
    FLOOR,
    count_inliers,
    fit_angles,
    fit_lines,
    hypothesis_covariance,
    intersect_lines,
)

SEEDS = st.integers(0, 2**32 - 1)


# --- crossings of lines


@given(seed=SEEDS, scale=st.sampled_from([1e-3, 1.0, 1e4]), far=st.sampled_from([0.0, 1e3]))
def test_two_lines_cross_where_linear_algebra_says(seed, scale, far):
    rng = np.random.default_rng(seed)
    points = scale * (rng.normal(size=(2, 2)) + far)
    angle = rng.uniform(0, 2 * np.pi)
    angles = np.array([angle, angle + rng.choice([-1, 1]) * rng.uniform(0.05, np.pi - 0.05)])
    directions = np.stack([np.cos(angles), np.sin(angles)], -1)
    along = np.linalg.solve(np.stack([directions[0], -directions[1]], -1), points[1] - points[0])
    lengths = rng.uniform(0.1, 10, (2, 1)) * rng.choice([-1, 1], (2, 1))
    found = intersect_lines(points, directions * lengths)
    crossing = points[0] + along[0] * directions[0]
    np.testing.assert_allclose(found, crossing, rtol=1e-9, atol=1e-9 * scale * (1 + far))


@given(seed=SEEDS, count=st.integers(2, 40), weighted=st.booleans())
def test_many_lines_meet_where_least_squares_says(seed, count, weighted):
    rng = np.random.default_rng(seed)
    points, directions = rng.normal(size=(2, 3, count, 2))
    weights = rng.uniform(0, 2, (3, count)) if weighted else None
    found = intersect_lines(points, directions, weights)
    for i in range(3):
        units = directions[i] / np.linalg.norm(directions[i], axis=-1, keepdims=True)
        normals = np.stack([-units[:, 1], units[:, 0]], -1)
        roots = np.sqrt(weights[i]) if weighted else np.ones(count)
        offsets = (normals * points[i]).sum(-1)
        best, _, _, singular = np.linalg.lstsq(roots[:, None] * normals, roots * offsets)
        if singular[1] > 1e-2 * singular[0]:
            np.testing.assert_allclose(found[i], best, rtol=1e-8, atol=1e-8)


@given(seed=SEEDS, count=st.integers(1, 10))
def test_parallel_lines_meet_nearest_to_the_middle_of_their_points(seed, count):
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=2)
    points, weights = rng.normal(size=(count, 2)), rng.uniform(0.1, 2, count)
    lengths = rng.uniform(0.1, 3, (count, 1)) * rng.choice([-1, 1], (count, 1))
    found = intersect_lines(points, direction * lengths, weights)
    # The mean has the mean offset across the lines, and nothing says how far to go along them.
    np.testing.assert_allclose(found, weights @ points / weights.sum(), atol=1e-9)


def test_lines_that_count_for_nothing():
    points = np.array([[0.0, 0], [10, 0], [3, 7]])
    directions = np.array([[1.0, 1], [-1, 1], [0, 0]])
    np.testing.assert_allclose(intersect_lines(points, directions), [5, 5])
    np.testing.assert_allclose(intersect_lines(points, directions, [1, 0, 1]), [0, 0])
    for no_line in (
        intersect_lines(points, 0 * directions),
        intersect_lines(points, directions, [0, 0, 0]),
    ):
        np.testing.assert_allclose(no_line, points.mean(0))
    tiny = intersect_lines(points, 1e-300 * directions, [1e-300, 1e-300, 0])
    np.testing.assert_allclose(tiny, [5, 5])
    np.testing.assert_allclose(intersect_lines(points, 1e300 * directions), [5, 5])


def test_lines_are_not_rays():
    behind = intersect_lines([[0.0, 0], [10, 0]], [[-1.0, -1], [1, -1]])
    np.testing.assert_allclose(behind, [5, 5])


def test_crossings_have_gradients_and_keep_kind_and_precision():
    generator = torch.Generator().manual_seed(0)
    points, directions = torch.randn(2, 3, 4, 2, generator=generator, dtype=torch.float64)
    weights = torch.rand(3, 4, generator=generator, dtype=torch.float64) + 0.1
    inputs = [x.requires_grad_() for x in (points.clone(), directions.clone(), weights)]
    assert torch.autograd.gradcheck(intersect_lines, inputs)
    degenerate = torch.tensor([[[0.0, 0], [1, 0]], [[1, 2], [1, 2]]], requires_grad=True)
    intersect_lines(torch.zeros(2, 2), degenerate).sum().backward()
    assert torch.isfinite(degenerate.grad).all()
    assert intersect_lines(points.float(), directions.float()).dtype == torch.float32
    assert intersect_lines([[0, 0], [2, 0]], [[1, 1], [-1, 1]]).tolist() == [1, 1]


# --- counting


def count_plainly(pixels, vectors, hypotheses, threshold):
    """By the definition, pixel by pixel; and how many decisions float32 may take either way."""
    away = hypotheses[:, :, None] - pixels  # (K, S, P, 2)
    v = vectors.swapaxes(0, 1)[:, None]
    lengths = np.linalg.norm(away, axis=-1) * np.linalg.norm(v, axis=-1)
    with np.errstate(invalid="ignore"):
        cosines = np.nan_to_num((away * v).sum(-1) / lengths)
    # To the edges of the cone, in pixels: what a few roundings of coordinates amount to.
    sines = np.sqrt(np.clip(1 - cosines**2, 0, 1))
    aside = np.abs(cosines * np.sqrt(1 - threshold**2) - sines * threshold)
    aside = aside * np.linalg.norm(away, axis=-1)
    middle = pixels.mean(0)
    size = np.linalg.norm(pixels - middle, axis=-1)
    size = size + np.linalg.norm(hypotheses - middle, axis=-1)[..., None]
    return (cosines > threshold).sum(-1), (aside < 2e-6 * size).sum(-1)


@given(
    seed=SEEDS,
    count=st.integers(1, 600),
    threshold=st.sampled_from([0.05, 0.5, 0.9, 0.99, 0.9999]),
    scale=st.sampled_from([1e-20, 1.0, 1e20]),
)
def test_counts_are_those_of_the_definition(seed, count, threshold, scale):
    rng = np.random.default_rng(seed)
    pixels = rng.integers(0, 640, (count, 2)).astype(float)
    hypotheses = rng.uniform(-300, 900, (3, 17, 2))
    target = rng.uniform(0, 640, (3, 2))
    vectors = target - pixels[:, None] + rng.normal(size=(count, 3, 2)) * 10
    hypotheses[:, 0] = target
    vectors[rng.uniform(size=count) < 0.1] = 0
    found = count_inliers(pixels, scale * vectors, hypotheses, threshold)
    expected, doubtful = count_plainly(pixels, vectors, hypotheses, threshold)
    assert (np.abs(found - expected) <= doubtful).all()
    assert found.dtype == np.int64 and found.max() <= count


def test_a_pixel_looks_forward_only():
    pixels, vectors = [[10.0, 10.0]], [[[3.0, 0.0]]]
    ahead, behind, beside = [20.0, 10.0], [0.0, 10.0], [20.0, 12.0]
    assert count_inliers(pixels, vectors, [[ahead, behind, beside]]).tolist() == [[1, 0, 0]]
    assert count_inliers(pixels, vectors, [[ahead, behind, beside]], 0.9).tolist() == [[1, 0, 1]]
    assert count_inliers(pixels, [[[0.0, 0.0]]], [[ahead, pixels[0]]]).tolist() == [[0, 0]]


PLACES = st.floats(-1e4, 1e4)


@pytest.mark.slow
@given(
    pixels=st.lists(st.tuples(PLACES, PLACES), min_size=1, max_size=20),
    seed=SEEDS,
    threshold=st.sampled_from([1e-3, 0.05, 0.5, 0.9, 0.99, 0.9999, 1 - 1e-9]),
    single=st.booleans(),
)
@settings(max_examples=300)
def test_no_pixel_points_at_itself(pixels, seed, threshold, single):
    """Also not by rounding: of every pixel's own place, only the others may be counted."""
    pixels = np.array(pixels, np.float32 if single else np.float64)
    count = len(pixels)
    vectors = np.random.default_rng(seed).normal(size=(count, 2))
    own = np.eye(count)[..., None] * vectors  # (P, K, 2), keypoint k seen by pixel k alone
    assert (count_inliers(pixels, own, pixels[:, None].astype(float), threshold) == 0).all()


def test_no_pixel_of_an_image_points_at_itself():
    """Cones without room for rounding count themselves here, about one in twenty."""
    for seed in range(40):
        rng = np.random.default_rng(seed)
        pixels = rng.uniform(0, 640, (36, 2)) if seed % 2 else rng.integers(0, 640, (36, 2)) + 0.0
        own = np.eye(36)[..., None] * rng.normal(size=(36, 2))
        found = count_inliers(pixels, own, pixels[:, None], [0.05, 0.5, 0.9, 0.99][seed % 4])
        assert (found == 0).all()


def test_a_pixel_points_at_what_is_near():
    """Room for rounding costs less than a hundredth of a pixel."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        pixels, angles = rng.uniform(0, 640, (36, 2)), rng.uniform(-np.pi, np.pi, 36)
        vectors = np.stack([np.cos(angles), np.sin(angles)], -1)
        own = np.eye(36)[..., None] * vectors
        assert (count_inliers(pixels, own, (pixels + 0.01 * vectors)[:, None]) == 1).all()


# --- fits


def noisy_rays(seed, noise, distance=40.0, count=600):
    """Pixels of a disc around 0, rays (K, 2, P) towards five points, and the points."""
    rng = np.random.default_rng(seed)
    angles, radii = rng.uniform(0, 2 * np.pi, count), 25 * np.sqrt(rng.uniform(size=count))
    pixels = np.stack([radii * np.cos(angles), radii * np.sin(angles)], -1)
    bearing = rng.uniform(0, 2 * np.pi, 5)
    points = distance * np.stack([np.cos(bearing), np.sin(bearing)], -1)
    way = points[:, None] - pixels
    angles = np.arctan2(way[..., 1], way[..., 0]) + noise * rng.normal(size=way.shape[:2])
    return pixels, np.stack([np.cos(angles), np.sin(angles)], 1), points


def sum_of_squares(pixels, units, inside, points):
    """Of the sines by which the pixels inside miss the points."""
    way = points[:, None] - pixels
    sines = units[:, 0] * way[..., 1] - units[:, 1] * way[..., 0]
    return (inside * (sines / np.maximum(np.linalg.norm(way, axis=-1), 1)) ** 2).sum(1)


@given(seed=SEEDS, moved=st.floats(0, 20))
@settings(max_examples=20)
def test_lines_are_fitted_from_anywhere(seed, moved):
    pixels, units, points = noisy_rays(seed, 0.05)
    inside = np.random.default_rng(seed).uniform(size=(5, len(pixels))) < 0.7
    found = fit_lines(pixels, units, inside, points + moved)
    expected = intersect_lines(pixels[None], units.swapaxes(1, 2), inside.astype(float))
    np.testing.assert_allclose(found, expected, atol=1e-9)


@given(seed=SEEDS, noise=st.floats(0.005, 0.1), distance=st.sampled_from([0.0, 12.0, 40.0, 90.0]))
@settings(max_examples=20)
def test_angles_are_least_where_they_are_fitted(seed, noise, distance):
    pixels, units, points = noisy_rays(seed, noise, distance)
    inside = np.random.default_rng(seed).uniform(size=(5, len(pixels))) < 0.7
    start = fit_lines(pixels, units, inside, points)
    found = fit_angles(pixels, units, inside, start)
    least = sum_of_squares(pixels, units, inside, found)
    assert (least <= sum_of_squares(pixels, units, inside, start)).all()
    if distance in (40.0, 90.0):  # no pixel is so near that its angle counts for less
        for k in range(5):
            best = minimize(
                lambda x: sum_of_squares(pixels, units[k : k + 1], inside[k], x[None])[0],  # noqa: B023
                points[k],
                method="Nelder-Mead",
                options={"xatol": 1e-6, "fatol": 1e-12},
            )
            # Angles are their sines to a sixth of their cube.
            assert np.abs(best.x - found[k]).max() < 0.02 * distance * noise


@given(
    seed=SEEDS,
    count=st.integers(1, 6),
    spread=st.sampled_from([1e-8, 1e-6, 1e-4, 0.01, 0.3, 3.0]),
    far=st.sampled_from([0.0, 1.0, 100.0, 1e5, 1e8]),
)
@settings(max_examples=200)
def test_few_rays_that_nearly_agree_are_never_fitted_worse(seed, count, spread, far):
    """Looking away counts as missing: a point behind all pixels is on all their lines."""
    rng = np.random.default_rng(seed)
    pixels = rng.integers(-20, 21, (count, 2)).astype(float)
    angles = rng.uniform(-np.pi, np.pi) + spread * rng.normal(size=(4, count))
    units = np.stack([np.cos(angles), np.sin(angles)], 1)
    start = np.concatenate([pixels[:1], pixels[:1] + far * rng.normal(size=(3, 2))])
    inside = rng.uniform(size=(4, count)) < 0.8
    found = fit_angles(pixels, units, inside, start)
    assert np.isfinite(found).all()

    def misses(points):
        way = points[:, None] - pixels
        lengths = np.maximum(np.linalg.norm(way, axis=-1), 1)
        sines = (units[:, 0] * way[..., 1] - units[:, 1] * way[..., 0]) / lengths
        away = np.minimum((units[:, 0] * way[..., 0] + units[:, 1] * way[..., 1]) / lengths, 0)
        return (inside * (sines**2 + away**2)).sum(1)

    assert (misses(found) <= misses(start) + 1e-6).all()


def test_angles_that_cannot_be_fitted_leave_the_start(monkeypatch):
    pixels, units, points = noisy_rays(0, 0.05)
    inside, start = np.ones((5, len(pixels)), bool), points + 3.0
    nobody = np.zeros_like(inside)
    np.testing.assert_array_equal(fit_angles(pixels, units, nobody, start), start)
    np.testing.assert_array_equal(fit_angles(pixels, 0 * units, inside, start), start)
    assert (fit_angles(pixels, units, inside, start) != start).all()
    monkeypatch.setattr(lines, "_STEPS", 1)  # too few to arrive
    np.testing.assert_array_equal(fit_angles(pixels, units, inside, start), start)


# --- covariance


@given(seed=SEEDS, floor=st.sampled_from([0.01, 0.1, 2.0]), centred=st.booleans())
def test_covariance_is_the_weighted_sum_of_outer_products(seed, floor, centred):
    rng = np.random.default_rng(seed)
    hypotheses, weights = rng.normal(size=(4, 12, 2)) * 5 + 100, rng.uniform(0, 1, (4, 12))
    centre = rng.normal(size=(4, 2)) + 100 if centred else None
    found = hypothesis_covariance(hypotheses, weights, centre, floor)
    for i in range(4):
        middle = centre[i] if centred else np.average(hypotheses[i], axis=0, weights=weights[i])
        away = hypotheses[i] - middle
        plain = sum(w * np.outer(d, d) for w, d in zip(weights[i], away, strict=True))
        plain = plain / weights[i].sum()
        np.testing.assert_allclose(
            found[i], plain + (floor**2 + 1e-6 * np.trace(plain)) * np.eye(2), rtol=1e-9, atol=1e-9
        )
        if not centred:
            by_numpy = np.cov(hypotheses[i].T, aweights=weights[i], ddof=0)
            np.testing.assert_allclose(plain, by_numpy, rtol=1e-8, atol=1e-9)


def test_a_covariance_can_always_be_inverted():
    same = hypothesis_covariance(np.full((5, 2), 7.0), np.ones(5))
    np.testing.assert_allclose(same, FLOOR**2 * np.eye(2), atol=1e-15)
    one = hypothesis_covariance(np.random.default_rng(0).normal(size=(5, 2)), [0, 0, 1, 0, 0])
    np.testing.assert_allclose(one, FLOOR**2 * np.eye(2), atol=1e-15)
    along = np.linspace(-1e5, 1e5, 11, dtype=np.float32)[:, None] * np.float32([0.6, 0.8])
    line = hypothesis_covariance(along, np.ones(11, np.float32))
    assert line.dtype == np.float32
    np.linalg.cholesky(line)
    np.linalg.cholesky(line.astype(np.float64))


PIXELS = np.zeros((4, 2))


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: intersect_lines(PIXELS, PIXELS, [1, 1, 1, -1]), "weights: expected at least 0"),
        (lambda: count_inliers(PIXELS, np.zeros((4, 3, 2)), np.zeros((3, 5, 2)), 1), "threshold:"),
        (lambda: hypothesis_covariance(PIXELS, [0, 0, 0, 0]), "weights:"),
        (lambda: hypothesis_covariance(PIXELS, [1, 1, 1, -1]), "weights:"),
        (lambda: hypothesis_covariance(PIXELS, [1, 1, 1, 1], floor=0), "floor:"),
    ],
)
def test_bad_input_is_named(call, named):
    with pytest.raises(ValueError, match=f"^{named}"):
        call()
