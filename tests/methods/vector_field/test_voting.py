"""Voting: exact fields, outliers, and every way in which pixels can fail to agree."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from posecore.methods.vector_field import lines, voting
from posecore.methods.vector_field.lines import FLOOR
from posecore.methods.vector_field.voting import (
    FITS,
    UNKNOWN_STD,
    VoteOptions,
    count_inliers,
    hypothesis_covariance,
    intersect_lines,
    vote,
    vote_pixels,
)

SEEDS = st.integers(0, 2**32 - 1)


def disc(height, width, centre, radius):
    rows, columns = np.mgrid[:height, :width]
    return np.hypot(columns - centre[0], rows - centre[1]) < radius


def field(keypoints, height, width):
    """Vectors in pixels from every pixel to each keypoint, (O, K, 2, H, W)."""
    rows, columns = np.mgrid[:height, :width]
    return keypoints[..., None, None] - np.stack([columns, rows])


def turned(vectors, angles):
    x, y = vectors[..., 0, :, :], vectors[..., 1, :, :]
    c, s = np.cos(angles), np.sin(angles)
    return np.stack([c * x - s * y, s * x + c * y], -3)


def scene(seed, objects=1, count=9, height=60, width=80):
    """Discs, keypoints in and around them, their fields in pixels, and a generator."""
    rng = np.random.default_rng(seed)
    centres = rng.uniform([20, 20], [width - 20, height - 20], (objects, 2))
    mask = np.stack([disc(height, width, centre, 18) for centre in centres])
    keypoints = centres[:, None] + rng.uniform(-16, 16, (objects, count, 2))
    return mask, field(keypoints, height, width), keypoints, rng


def assert_sound(votes):
    """What holds for every result, however little the pixels agree."""
    for name, values in votes._asdict().items():
        assert np.isfinite(np.asarray(values)).all(), name
    assert (np.linalg.eigvalsh(np.asarray(votes.covariances, np.float64)) >= 0.9 * FLOOR**2).all()
    assert (np.asarray(votes.inliers) >= 0).all() and (np.asarray(votes.inliers) <= 1).all()
    np.testing.assert_allclose(votes.inliers, np.asarray(votes.weights).max(-1))


# --- voting


@pytest.mark.parametrize("fit", FITS)
@given(seed=SEEDS, objects=st.integers(1, 3), pixels=st.booleans())
@settings(max_examples=12)
def test_clean_fields_give_the_keypoints(seed, objects, pixels, fit):
    mask, vectors, keypoints, _ = scene(seed, objects)
    if not pixels:
        vectors = vectors / np.maximum(np.linalg.norm(vectors, axis=2, keepdims=True), 1e-9)
    votes = vote(mask, vectors.astype(np.float32), VoteOptions(fit=fit))
    np.testing.assert_allclose(votes.points, keypoints, atol=1e-3)
    assert votes.points.dtype == np.float32 and votes.found.all()
    np.testing.assert_array_equal(votes.pixels, mask.sum((1, 2)))
    assert (votes.inliers > 0.99).all()
    np.testing.assert_allclose(
        votes.covariances, np.broadcast_to(FLOOR**2 * np.eye(2), (objects, 9, 2, 2)), atol=1e-4
    )
    assert_sound(votes)
    exact = vote(mask, vectors, VoteOptions(fit=fit))  # float64
    np.testing.assert_allclose(exact.points, keypoints, atol=1e-9)


@pytest.mark.parametrize("fit", FITS)
@given(seed=SEEDS)
@settings(max_examples=12)
def test_keypoints_on_a_pixel_and_far_outside_of_the_image(seed, fit):
    mask, _, keypoints, rng = scene(seed)
    rows, columns = mask[0].nonzero()
    chosen = rng.integers(len(rows))
    keypoints[0, 0] = columns[chosen], rows[chosen]
    angle = rng.uniform(-np.pi, np.pi)
    keypoints[0, 1] = 30 + 500 * np.cos(angle), 30 + 500 * np.sin(angle)
    keypoints[0, 2] = -1, -1
    votes = vote(mask, field(keypoints, 60, 80), VoteOptions(fit=fit))
    np.testing.assert_allclose(votes.points, keypoints, atol=1e-6)
    assert votes.inliers[0, 0] == pytest.approx(
        1 - 1 / mask.sum()
    )  # the pixel itself points nowhere


@pytest.mark.parametrize("fit", FITS)
@given(seed=SEEDS, kind=st.sampled_from(["any", "reversed", "zero", "another point"]))
@settings(max_examples=12)
def test_40_percent_outliers(seed, kind, fit):
    mask, vectors, keypoints, rng = scene(seed, height=120, width=160)
    mask = disc(120, 160, keypoints[0].mean(0), 30)[None]
    wrong = rng.uniform(size=(1, 9, 120, 160)) < 0.4
    replaced = {
        "any": turned(vectors, rng.uniform(-np.pi, np.pi, wrong.shape)),
        "reversed": -vectors,
        "zero": 0 * vectors,
        "another point": field(keypoints + [40, 25], 120, 160),
    }[kind]
    vectors = np.where(wrong[:, :, None], replaced, vectors)
    votes = vote(mask, vectors, VoteOptions(fit=fit))
    # Of outliers that point somewhere a few point almost right, and are believed.
    few = kind in ("any", "another point")
    np.testing.assert_allclose(votes.points, keypoints, atol=0.4 if few else 1e-6)
    assert (votes.inliers > 0.5).all() and (votes.inliers < 0.75).all()
    assert_sound(votes)


@pytest.mark.parametrize("fit", FITS)
def test_40_percent_outliers_leave_a_tenth_of_a_pixel_on_a_large_mask(fit):
    errors = []
    for seed in range(4):
        _, _, keypoints, rng = scene(seed, height=240, width=320)
        mask = disc(240, 320, keypoints[0].mean(0), 50)[None]
        angles = rng.uniform(-np.pi, np.pi, (1, 9, 240, 320))
        wrong = rng.uniform(size=angles.shape) < 0.4
        votes = vote(mask, turned(field(keypoints, 240, 320), wrong * angles), VoteOptions(fit=fit))
        errors.append(np.linalg.norm(votes.points - keypoints, axis=-1))
    assert np.max(errors) < 0.1


@pytest.mark.parametrize("fit", FITS)
def test_noise_is_averaged_and_told(fit):
    """The keypoint is far better than one hypothesis; noisier ones are told to be less sure."""
    errors, deviations = [], []
    for seed in range(8):
        mask, vectors, keypoints, rng = scene(seed, height=120, width=160)
        angles = rng.normal(size=(1, 9, 120, 160)) * np.geomspace(0.005, 0.2, 9)[:, None, None]
        votes = vote(mask, turned(vectors, angles), VoteOptions(seed=seed, fit=fit))
        errors.append(np.linalg.norm(votes.points - keypoints, axis=-1)[0])
        deviations.append(np.sqrt(np.linalg.eigvalsh(votes.covariances)[0, :, 1]))
    errors, deviations = np.mean(errors, 0), np.mean(deviations, 0)
    assert errors.max() < 1
    assert (errors < deviations).all()
    assert deviations[-1] > 2 * deviations[0]
    assert np.corrcoef(errors, deviations)[0, 1] > 0.8


def test_ellipses_are_long_where_rays_nearly_agree():
    mask = disc(60, 80, (20, 30), 8)[None]
    keypoints = np.array([[[75.0, 30.0]]])  # far to the right: rays run along x
    angles = 0.03 * np.random.default_rng(0).normal(size=(1, 1, 60, 80))
    covariance = vote(mask, turned(field(keypoints, 60, 80), angles)).covariances[0, 0]
    assert covariance[0, 0] > 10 * covariance[1, 1]


@given(seed=SEEDS)
@settings(max_examples=12)
def test_the_result_is_what_its_own_parts_say(seed):
    """Weights by counting, the covariance from them, the keypoint from the lines of the inliers."""
    mask, vectors, _, rng = scene(seed, count=3)
    vectors = turned(vectors, 0.05 * rng.normal(size=(1, 3, 60, 80)))
    votes = vote(mask, vectors, VoteOptions(hypotheses=40))
    rows, columns = mask[0].nonzero()
    pixels = np.stack([columns, rows], -1).astype(float)
    gathered = np.moveaxis(vectors[0][:, :, rows, columns], -1, 0)
    shares = count_inliers(pixels, gathered, votes.hypotheses[0]) / len(pixels)
    best = shares.max(1, keepdims=True)
    # Coordinates are rounded from the middle of the mask; a pixel on the edge may flip.
    expected = np.where(votes.weights[0] > 0, shares, 0)
    np.testing.assert_allclose(votes.weights[0], expected, atol=2.01 / len(pixels))
    assert ((votes.weights[0] > 0) == (shares >= best - 0.1)).mean() > 0.95
    winners = votes.hypotheses[0, np.arange(3), votes.weights[0].argmax(1)]
    cosines = np.einsum("pki,pki->kp", gathered, winners - pixels[:, None])
    cosines /= np.linalg.norm(gathered, axis=-1).T
    cosines /= np.linalg.norm(winners[:, None] - pixels, axis=-1)
    points = intersect_lines(pixels[None], gathered.swapaxes(0, 1), (cosines > 0.99).astype(float))
    np.testing.assert_allclose(votes.points[0], points, atol=0.05)  # one pixel more or less
    covariances = hypothesis_covariance(votes.hypotheses[0], votes.weights[0], votes.points[0])
    np.testing.assert_allclose(votes.covariances[0], covariances, rtol=1e-9)


@pytest.mark.parametrize("fit", FITS)
def test_pixels_in_a_list_are_the_same_as_in_a_mask(fit):
    mask, vectors, _, rng = scene(5)
    vectors = turned(vectors, 0.1 * rng.normal(size=(1, 9, 60, 80)))
    rows, columns = mask[0].nonzero()
    listed = np.moveaxis(vectors[0][:, :, rows, columns], -1, 0)
    one, other = (
        vote(mask, vectors, VoteOptions(fit=fit)),
        vote_pixels(np.stack([columns, rows], -1), listed, VoteOptions(fit=fit)),
    )
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a[0], b)
    assert isinstance(other.found, np.bool_) and other.pixels == mask.sum()


@pytest.mark.parametrize("fit", FITS)
def test_objects_do_not_know_of_each_other(fit):
    mask, vectors, _, rng = scene(1, objects=3)
    vectors = turned(vectors, 0.1 * rng.normal(size=(3, 9, 60, 80)))
    together = vote(mask, vectors, VoteOptions(fit=fit))
    mask[1] = False
    without = vote(mask, vectors, VoteOptions(fit=fit))
    for o in (0, 2):
        alone = vote(mask[o : o + 1], vectors[o : o + 1], VoteOptions(fit=fit))
        for a, b, c in zip(together, without, alone, strict=True):
            np.testing.assert_array_equal(a[o], b[o])
            np.testing.assert_array_equal(a[o], c[0])


@pytest.mark.parametrize("fit", FITS)
def test_a_seed_decides_everything(fit):
    mask, vectors, _, rng = scene(2)
    vectors = turned(vectors, 0.2 * rng.normal(size=(1, 9, 60, 80)))
    for options in ({}, {"sample": 50}):
        one, again, other = (
            vote(mask, vectors, VoteOptions(seed=s, **options, fit=fit)) for s in (3, 3, 4)
        )
        for a, b in zip(one, again, strict=True):
            np.testing.assert_array_equal(a, b)
        assert (one.hypotheses != other.hypotheses).any()


def test_a_sample_of_the_pixels_does_on_easy_fields():
    mask, vectors, keypoints, _ = scene(3)
    votes = vote(mask, vectors, VoteOptions(sample=30))
    np.testing.assert_allclose(votes.points, keypoints, atol=1e-6)
    assert votes.pixels == mask.sum()
    assert np.allclose(votes.inliers * 30, np.round(votes.inliers * 30))
    everything = vote(mask, vectors, VoteOptions(sample=10**9))
    np.testing.assert_array_equal(everything.points, vote(mask, vectors).points)


def test_more_rounds_find_what_one_misses():
    """One pixel in twenty is right: a pair is of two inliers once in 400 draws."""
    found = {1: 0, 20: 0}
    for seed in range(10):
        mask, vectors, keypoints, rng = scene(seed, count=2)
        wrong = rng.uniform(size=(1, 2, 60, 80)) < 0.95
        vectors = turned(vectors, wrong * rng.uniform(-np.pi, np.pi, wrong.shape))
        for rounds in found:
            votes = vote(
                mask,
                vectors,
                VoteOptions(hypotheses=32, rounds=rounds, threshold=0.9999, seed=seed),
            )
            found[rounds] += (np.linalg.norm(votes.points - keypoints, axis=-1) < 1).sum()
    assert found[20] >= 16 and found[1] <= found[20] // 2


def test_rounds_stop_when_all_are_sure():
    mask, vectors, _, rng = scene(4)
    vectors = turned(vectors, 0.1 * rng.normal(size=(1, 9, 60, 80)))
    one, twenty = (
        vote(mask, vectors, VoteOptions(rounds=1)),
        vote(mask, vectors, VoteOptions(rounds=20)),
    )
    np.testing.assert_array_equal(one.hypotheses, twenty.hypotheses)


# --- the last step: distances to lines, or angles


def test_the_door_has_the_names_of_its_rooms():
    for name in ("count_inliers", "hypothesis_covariance", "intersect_lines"):
        assert getattr(voting, name) is getattr(lines, name)


def towards(seed, noise, fit, outside=1.5):
    """Errors (9,) of keypoints around a disc along the way from its middle, by noisy fields."""
    rng = np.random.default_rng(seed)
    mask, bearing = disc(80, 100, (50, 40), 20)[None], rng.uniform(0, 2 * np.pi, 9)
    outwards = np.stack([np.cos(bearing), np.sin(bearing)], -1)
    keypoints = np.array([50, 40]) + 20 * outside * outwards
    angles = np.radians(noise) * rng.normal(size=(1, 9, 80, 100))
    votes = vote(
        mask, turned(field(keypoints[None], 80, 100), angles), VoteOptions(seed=seed, fit=fit)
    )
    return ((votes.points[0] - keypoints) * outwards).sum(-1), votes


@pytest.mark.parametrize("noise", [2.0, 5.0])
def test_lines_are_pulled_towards_the_pixels_and_angles_are_not(noise):
    errors = {fit: np.concatenate([towards(s, noise, fit)[0] for s in range(12)]) for fit in FITS}
    means = {fit: values.mean() for fit, values in errors.items()}
    deviation = errors["angles"].std() / np.sqrt(len(errors["angles"]))
    assert means["lines"] < -10 * deviation
    assert abs(means["angles"]) < 3 * deviation
    assert abs(means["angles"]) < 0.1 * abs(means["lines"])
    assert errors["angles"].std() < np.abs(means["lines"])


def test_fits_differ_in_the_keypoint_and_where_the_covariance_is_measured_from():
    _, of_lines = towards(0, 5.0, "lines")
    _, of_angles = towards(0, 5.0, "angles")
    for name in ("inliers", "hypotheses", "weights", "found", "pixels"):
        np.testing.assert_array_equal(getattr(of_lines, name), getattr(of_angles, name))
    assert (of_lines.points != of_angles.points).all()
    expected = hypothesis_covariance(of_angles.hypotheses, of_angles.weights, of_angles.points)
    np.testing.assert_allclose(of_angles.covariances, expected, rtol=1e-9)


def test_keypoints_of_an_object_do_not_know_of_each_other():
    """However many steps one needs, the others' stay the same to the last digit."""
    rng = np.random.default_rng(0)
    mask = disc(80, 100, (50, 40), 20)[None]
    keypoints = np.array([[[50.0, 40], [90, 40], [400, 300], [50, 70]]])
    vectors = turned(field(keypoints, 80, 100), 0.08 * rng.normal(size=(1, 4, 80, 100)))
    together = vote(mask, vectors, VoteOptions(hypotheses=16, rounds=1, fit="angles"))
    assert (
        (together.points != vote(mask, vectors, VoteOptions(hypotheses=16, rounds=1)).points)
        .any(-1)
        .all()
    )
    other = vectors.copy()
    other[0, 2] = 0
    without = vote(mask, other, VoteOptions(hypotheses=16, rounds=1, fit="angles"))
    np.testing.assert_array_equal(together.points[0, [0, 1, 3]], without.points[0, [0, 1, 3]])


# --- where there is nothing to agree on


@pytest.mark.parametrize("fit", FITS)
def test_an_empty_mask(fit):
    mask, vectors, keypoints, _ = scene(0, objects=3)
    mask[1] = False
    votes = vote(mask, vectors, VoteOptions(fit=fit))
    assert votes.found.tolist() == [True, False, True]
    assert votes.pixels[1] == 0
    for values in (votes.points, votes.inliers, votes.hypotheses, votes.weights):
        assert (values[1] == 0).all()
    np.testing.assert_array_equal(
        votes.covariances[1], np.tile(UNKNOWN_STD**2 * np.eye(2), (9, 1, 1))
    )
    np.testing.assert_allclose(votes.points[[0, 2]], keypoints[[0, 2]], atol=1e-6)
    assert_sound(votes)
    nothing = vote_pixels(np.zeros((0, 2)), np.zeros((0, 9, 2)), VoteOptions(fit=fit))
    np.testing.assert_array_equal(nothing.points, votes.points[1])
    assert not nothing.found and nothing.hypotheses.shape == (9, 128, 2)


@pytest.mark.parametrize("fit", FITS)
def test_one_pixel(fit):
    votes = vote_pixels([[7.0, 5.0]], [[[1.0, 0.0], [0.0, 0.0]]], VoteOptions(fit=fit))
    assert not votes.found and votes.pixels == 1 and (votes.inliers == 0).all()
    np.testing.assert_array_equal(votes.points, [[7, 5], [7, 5]])
    np.testing.assert_array_equal(votes.covariances, np.tile(UNKNOWN_STD**2 * np.eye(2), (2, 1, 1)))
    assert_sound(votes)


@pytest.mark.parametrize("fit", FITS)
def test_two_pixels(fit):
    """They cross before both, behind one, nowhere (parallel, against each other, no vector)."""
    pixels = [[0.0, 0.0], [10.0, 0.0]]
    first = [[1, 1], [1, 1], [1, 1], [1, 0], [1, 1], [0, 0]]
    second = [[-1, 1], [1, -1], [1, 1], [-1, 0], [0, 0], [0, 0]]
    votes = vote_pixels(
        pixels, np.stack([first, second]).astype(float), VoteOptions(hypotheses=8, fit=fit)
    )
    np.testing.assert_allclose(votes.points[0], [5, 5], atol=1e-6)
    np.testing.assert_allclose(votes.covariances[0], FLOOR**2 * np.eye(2), atol=1e-6)
    assert votes.inliers.tolist() == [1, 0.5, 0, 0, 0, 0]
    np.testing.assert_array_equal(votes.points[2:], np.tile([5.0, 0.0], (4, 1)))
    np.testing.assert_array_equal(votes.hypotheses[2:], np.tile([5.0, 0.0], (4, 8, 1)))
    np.testing.assert_array_equal(
        votes.covariances[2:], np.tile(UNKNOWN_STD**2 * np.eye(2), (4, 1, 1))
    )
    assert votes.found
    assert_sound(votes)


@pytest.mark.parametrize("fit", FITS)
@given(seed=SEEDS, angle=st.floats(-math.pi, math.pi))
@settings(max_examples=12)
def test_parallel_rays(seed, angle, fit):
    mask, vectors, _, _ = scene(seed, count=2)
    vectors[:] = np.array([np.cos(angle), np.sin(angle)])[:, None, None]
    votes = vote(mask, vectors.astype(np.float32), VoteOptions(fit=fit))
    assert not votes.found[0] and (votes.inliers == 0).all() and (votes.weights == 0).all()
    rows, columns = mask[0].nonzero()
    np.testing.assert_allclose(votes.points[0, 0], [columns.mean(), rows.mean()], rtol=1e-6)
    np.testing.assert_array_equal(votes.covariances[0, 0], UNKNOWN_STD**2 * np.eye(2))
    assert_sound(votes)


@pytest.mark.parametrize("fit", FITS)
@given(seed=SEEDS, height=st.integers(1, 12), width=st.integers(1, 12), objects=st.integers(1, 3))
@settings(max_examples=12)
def test_fields_of_outliers_only_give_numbers(seed, height, width, objects, fit):
    rng = np.random.default_rng(seed)
    mask = rng.uniform(size=(objects, height, width)) < rng.uniform(0, 1.1)
    vectors = rng.integers(-1, 2, (objects, 3, 2, height, width)).astype(
        np.float32
    )  # many parallel
    votes = vote(mask, vectors, VoteOptions(rounds=3, hypotheses=16, seed=seed, fit=fit))
    assert_sound(votes)
    assert (votes.found == (votes.inliers > 0).any(1)).all()
    unknown = votes.inliers == 0
    assert (votes.covariances[unknown] == (UNKNOWN_STD**2 * np.eye(2))).all()


@pytest.mark.parametrize("fit", FITS)
def test_an_all_outlier_field_is_found_but_unsure(fit):
    mask, vectors, _, rng = scene(0)
    vectors = turned(vectors, rng.uniform(-np.pi, np.pi, (1, 9, 60, 80)))
    votes = vote(mask, vectors, VoteOptions(fit=fit))
    assert votes.found[0] and (votes.inliers < 0.2).all()
    assert (np.linalg.eigvalsh(votes.covariances)[..., 1] > 5**2).all()
    assert_sound(votes)


@pytest.mark.parametrize("fit", FITS)
def test_a_keypoint_without_vectors_does_not_touch_the_others(fit):
    mask, vectors, keypoints, _ = scene(0)
    vectors[0, 4] = 0
    votes = vote(mask, vectors, VoteOptions(fit=fit))
    others = np.arange(9) != 4
    np.testing.assert_allclose(votes.points[0, others], keypoints[0, others], atol=1e-6)
    assert votes.inliers[0, 4] == 0 and votes.found[0]
    np.testing.assert_array_equal(votes.covariances[0, 4], UNKNOWN_STD**2 * np.eye(2))


@pytest.mark.parametrize("fit", FITS)
def test_rays_that_almost_agree_stay_finite(fit):
    mask = disc(60, 80, (40, 30), 10)[None]
    for distance in (1e4, 1e6, 1e8):
        vectors = field(np.array([[[distance, 30.0]]]), 60, 80)
        assert_sound(vote(mask, vectors.astype(np.float32), VoteOptions(fit=fit)))


# --- kinds of input


def test_kind_precision_and_layout():
    mask, vectors, keypoints, _ = scene(0, objects=2)
    plain = vote(mask, vectors.astype(np.float32))
    tensors = torch.from_numpy(mask), torch.from_numpy(vectors).float()
    last = tensors[1].permute(0, 3, 4, 1, 2).contiguous().permute(0, 3, 4, 1, 2)
    for fields in (tensors[1], last, tensors[1].clone().requires_grad_()):
        votes = vote(tensors[0], fields)
        assert votes.points.dtype == votes.covariances.dtype == torch.float32
        assert votes.found.dtype == torch.bool and votes.pixels.dtype == torch.int64
        for a, b in zip(votes, plain, strict=True):
            np.testing.assert_array_equal(a.numpy(), b)
    half = vote(tensors[0], tensors[1].bfloat16())
    assert half.points.dtype == torch.bfloat16
    np.testing.assert_allclose(half.points.float().numpy(), keypoints, atol=1)
    frozen = vectors.astype(np.float32)
    frozen.setflags(write=False)
    np.testing.assert_array_equal(vote(mask, frozen).points, plain.points)
    mirrored = np.ascontiguousarray(frozen[..., ::-1])[..., ::-1]
    np.testing.assert_array_equal(vote(mask, mirrored).points, plain.points)
    swapped = frozen.astype(frozen.dtype.newbyteorder())
    np.testing.assert_array_equal(vote(mask, swapped).points, plain.points)
    whole = vote_pixels([[0, 0], [10, 0]], [[[1, 1]], [[-1, 1]]])
    assert whole.points.dtype == np.float64 and np.allclose(whole.points, 5)


def test_what_is_outside_of_the_mask_is_not_looked_at():
    mask, vectors, _, _ = scene(0)
    spoiled = np.where(mask[:, None, None], vectors, np.nan)
    np.testing.assert_array_equal(vote(mask, spoiled).points, vote(mask, vectors).points)


@pytest.mark.parametrize("fit", FITS)
@given(seed=SEEDS, length=st.sampled_from([1e-30, 1e-6, 1e30]))
@settings(max_examples=12)
def test_the_length_of_vectors_does_not_matter(seed, length, fit):
    mask, vectors, keypoints, rng = scene(seed, count=2)
    lengths = length * rng.uniform(0.5, 2, (1, 2, 1, 60, 80))
    unit = vectors / np.maximum(np.linalg.norm(vectors, axis=2, keepdims=True), 1e-9)
    votes = vote(mask, (lengths * unit).astype(np.float32), VoteOptions(fit=fit))
    np.testing.assert_allclose(votes.points, keypoints, atol=1e-3)


MASK, VECTORS, _, _ = scene(0)
SPOILED = VECTORS.copy()
SPOILED[0, 3, 1][MASK[0]] = np.nan
PIXELS = np.zeros((4, 2))


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: vote(MASK, SPOILED), "vectors: expected finite"),
        (lambda: vote(MASK, SPOILED * 0 + np.inf), "vectors: expected finite"),
        (lambda: vote(MASK, VECTORS[0]), "vectors: expected shape"),
        (lambda: vote(MASK, VECTORS[:, :, :1]), "vectors: expected shape"),
        (lambda: vote(MASK, VECTORS[:, :0]), "vectors: expected shape"),
        (lambda: vote(MASK[:, :-1], VECTORS), "mask: expected shape"),
        (lambda: vote(MASK[0], VECTORS), "mask: expected shape"),
        (lambda: vote(MASK.astype(float), VECTORS), "mask: expected bool"),
        (lambda: vote(torch.zeros(1, 60, 80, dtype=torch.uint8), VECTORS), "mask: expected bool"),
        (lambda: vote("mask", VECTORS), "mask: expected an array"),
        (lambda: vote(MASK, [[1.0], [1.0, 2.0]]), "vectors: expected an array"),
        (lambda: vote(MASK, VECTORS + 1j), "vectors: expected"),
        (lambda: vote(MASK, VECTORS, VoteOptions(hypotheses=0)), "hypotheses:"),
        (lambda: vote(MASK, VECTORS, VoteOptions(hypotheses=1.5)), "hypotheses:"),
        (lambda: vote(MASK, VECTORS, VoteOptions(sample=1)), "sample:"),
        (lambda: vote(MASK, VECTORS, VoteOptions(threshold=1)), "threshold:"),
        (lambda: vote(MASK, VECTORS, VoteOptions(threshold=0)), "threshold:"),
        (lambda: vote(MASK, VECTORS, VoteOptions(threshold=np.nan)), "threshold:"),
        (lambda: vote(MASK, VECTORS, VoteOptions(rounds=0)), "rounds:"),
        (lambda: vote(MASK, VECTORS, VoteOptions(seed=-1)), "seed:"),
        (lambda: vote(MASK, VECTORS, VoteOptions(seed=None)), "seed:"),
        (
            lambda: vote(MASK, VECTORS, VoteOptions(fit="angle")),
            "fit: expected one of 'lines', 'angles'",
        ),
        (lambda: vote(MASK, VECTORS, VoteOptions(fit=None)), "fit:"),
        (lambda: vote_pixels(PIXELS, np.zeros((4, 9, 2)), VoteOptions(fit="rays")), "fit:"),
        (lambda: vote_pixels(PIXELS, np.zeros((3, 9, 2))), "vectors: expected shape"),
        (lambda: vote_pixels(PIXELS, np.zeros((4, 9, 3))), "vectors: expected shape"),
        (lambda: vote_pixels(PIXELS, np.zeros((4, 0, 2))), "vectors: expected shape"),
        (lambda: vote_pixels(PIXELS[0], np.zeros((4, 9, 2))), "pixels: expected shape"),
        (lambda: vote_pixels(PIXELS + np.nan, np.zeros((4, 9, 2))), "pixels: expected finite"),
        (lambda: vote_pixels(PIXELS, np.full((4, 9, 2), np.nan)), "vectors: expected finite"),
        (lambda: vote_pixels(PIXELS, np.zeros((4, 9, 2)), VoteOptions(threshold=2)), "threshold:"),
    ],
)
def test_bad_input_is_named(call, named):
    with pytest.raises(ValueError, match=f"^{named}"):
        call()
