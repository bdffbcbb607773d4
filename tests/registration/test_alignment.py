"""Umeyama's alignment against roma, brute force, finite differences; clouds that decide nothing."""

import numpy as np
import pytest
import roma
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posecore.registration import umeyama

SEEDS = st.integers(0, 2**32 - 1)


def rotation(rng):
    return Rotation.random(random_state=rng).as_matrix()


def move(points, R, t, scale=1.0):
    return scale * points @ R.T + t


def cost(R, t, scale, source, target, weights):
    return (weights * np.square(target - move(source, R, t, scale)).sum(-1)).sum()


@given(
    seed=SEEDS,
    count=st.integers(3, 20),
    flat=st.booleans(),
    offset=st.sampled_from([0.0, 1.0, 1e3]),
    with_scale=st.booleans(),
)
def test_exact_matches_are_recovered(seed, count, flat, offset, with_scale):
    rng = np.random.default_rng(seed)
    source = rng.normal(size=(count, 3))
    source[:, 2] *= not flat  # three points are flat in any case
    source = source @ rotation(rng) + offset
    R, t, scale = rotation(rng), rng.normal(size=3), rng.uniform(0.1, 10) if with_scale else 1.0
    weights = rng.uniform(0.1, 1, count)

    found = umeyama(source, move(source, R, t, scale), weights, with_scale=with_scale)

    # Rounding of the coordinates turns the cloud by as much as it is wide; some are narrow.
    width = np.linalg.svd(source - source.mean(0), compute_uv=False)[1]
    due = 1e-14 * (1 + offset) * count / min(width, 1) ** 2
    np.testing.assert_allclose(found.R, R, atol=due)
    np.testing.assert_allclose(found.scale, scale, rtol=due)
    np.testing.assert_allclose(found.t, t, atol=due * scale * (1 + offset))


@given(seed=SEEDS, with_scale=st.booleans(), weighted=st.booleans(), mirrored=st.booleans())
def test_noisy_matches_agree_with_roma(seed, with_scale, weighted, mirrored):
    rng = np.random.default_rng(seed)
    source = torch.from_numpy(rng.normal(size=(2, 4, 7, 3)))
    target = torch.from_numpy(rng.normal(size=(2, 4, 7, 3)))  # half of these fits would reflect
    target = target * torch.tensor([1.0, 1.0, -1.0]) if mirrored else target
    weights = torch.from_numpy(rng.uniform(0, 1, (2, 4, 7))) if weighted else None

    found = umeyama(source, target, weights, with_scale)

    R, t, scale = roma.rigid_points_registration(source, target, weights, compute_scaling=True)
    if not with_scale:
        R, t = roma.rigid_points_registration(source, target, weights)
        scale = torch.ones_like(scale)
    torch.testing.assert_close(found.R, R, atol=1e-6, rtol=0)  # the two fits may nearly tie
    torch.testing.assert_close(found.t, t, atol=1e-6, rtol=0)
    torch.testing.assert_close(found.scale, scale, atol=1e-6, rtol=0)
    torch.testing.assert_close(torch.linalg.det(found.R), torch.ones(2, 4).double())


@given(seed=SEEDS)
def test_no_other_transform_costs_less(seed):
    rng = np.random.default_rng(seed)
    source, target = rng.normal(size=(2, 5, 3))
    weights = rng.uniform(0, 1, 5)
    scale, R, t = umeyama(source, target, weights, with_scale=True)
    least = cost(R, t, scale, source, target, weights)
    for size in (1e-3, 0.1, 3.0):
        turned = R @ Rotation.from_rotvec(size * rng.normal(size=3)).as_matrix()
        other = turned, t + size * rng.normal(size=3), scale * np.exp(size * rng.normal())
        for changed in ((turned, t, scale), (R, other[1], scale), (R, t, other[2]), other):
            assert cost(*changed, source, target, weights) >= least * (1 - 1e-12)


@given(seed=SEEDS)
def test_moving_either_cloud_moves_the_answer(seed):
    rng = np.random.default_rng(seed)
    source, target = rng.normal(size=(2, 6, 3))
    A, a, B, b = rotation(rng), rng.normal(size=3), rotation(rng), rng.normal(size=3)
    _, R, t = umeyama(source, target)
    _, R_moved, t_moved = umeyama(move(source, A, a), move(target, B, b))
    np.testing.assert_allclose(R_moved, B @ R @ A.T, atol=1e-6)
    np.testing.assert_allclose(t_moved, B @ t + b - R_moved @ a, atol=1e-6)


def test_a_weight_is_a_number_of_copies_and_zero_is_none(rng):
    source, target = rng.normal(size=(2, 5, 3))
    copies = np.array([1, 0, 3, 2, 1])
    weighted = umeyama(source, target, copies * 0.37, with_scale=True)
    repeated = umeyama(source.repeat(copies, 0), target.repeat(copies, 0), with_scale=True)
    for one, other in zip(weighted, repeated, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-13)


@pytest.mark.parametrize("outlier", [1.0, -1e6, 1e100])
def test_outliers_of_weight_zero_change_no_bit(rng, outlier):
    source, target = rng.normal(size=(2, 8, 3))
    weights = np.array([1, 0, 0.5, 1, 0, 2, 1, 1.0])
    clean = umeyama(source, target, weights, with_scale=True)
    source[1], target[4] = outlier, -outlier
    for one, other in zip(umeyama(source, target, weights, True), clean, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_mirrored_cloud_is_turned_and_never_reflected(rng):
    source = rng.normal(size=(30, 3)) * [3.0, 2.0, 1.0]
    _, R, _ = umeyama(source, -source)
    # Best is the half turn that leaves the thinnest axis wrong.
    axes = np.linalg.svd(source - source.mean(0))[2]
    np.testing.assert_allclose(R, axes.T @ np.diag([-1, -1, 1]) @ axes, atol=1e-12)


def test_batches_broadcast_and_equal_a_loop(rng):
    source = rng.normal(size=(6, 3))
    target = rng.normal(size=(4, 2, 6, 3))
    weights = rng.uniform(size=(2, 6))
    scale, R, t = umeyama(source, target, weights, with_scale=True)
    assert (scale.shape, R.shape, t.shape) == ((4, 2), (4, 2, 3, 3), (4, 2, 3))
    assert umeyama(source, target).scale.shape == (4, 2)
    for i in np.ndindex(4, 2):
        alone = umeyama(source, target[i], weights[i[1]], with_scale=True)
        np.testing.assert_allclose(scale[i], alone.scale, atol=1e-12)
        np.testing.assert_allclose(R[i], alone.R, atol=1e-12)
        np.testing.assert_allclose(t[i], alone.t, atol=1e-12)


def test_precision_and_kind_of_the_input_come_back(rng):
    source = rng.normal(size=(9, 3)).astype(np.float32)
    target = move(source, rotation(rng), np.ones(3)).astype(np.float32)
    for found in (umeyama(source, target, with_scale=True), umeyama(source, target)):
        assert all(isinstance(value, np.ndarray | np.float32) for value in found)
        assert all(value.dtype == np.float32 for value in found)
    found = umeyama(torch.from_numpy(source), torch.from_numpy(target))
    exact = umeyama(source.astype(float), target.astype(float))
    assert found.R.dtype == torch.float32
    np.testing.assert_allclose(found.R.numpy(), exact.R, atol=2e-6)


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("with_scale", [False, True])
def test_gradients_match_finite_differences(flat, with_scale):
    generator = torch.Generator().manual_seed(0)
    source, target = torch.randn(2, 2, 5, 3, generator=generator, dtype=torch.float64)
    if flat:
        source[..., 2] = 0
    weights = torch.rand(2, 5, generator=generator, dtype=torch.float64) + 0.1
    inputs = [x.requires_grad_() for x in (source, target, weights)]
    assert torch.autograd.gradcheck(lambda *x: umeyama(*x, with_scale=with_scale), inputs)


def test_gradients_are_finite_for_weights_of_zero_and_exact_matches():
    source = torch.eye(3, dtype=torch.float64).repeat(2, 1).requires_grad_()
    weights = torch.tensor([1.0, 1, 1, 0, 0, 0], dtype=torch.float64, requires_grad=True)
    scale, R, t = umeyama(source, source.detach() * 2, weights, with_scale=True)
    (scale + R[0, 1] + t.sum()).backward()
    assert torch.isfinite(source.grad).all() and torch.isfinite(weights.grad).all()


LINE = np.arange(1.0, 6.0)[:, None] * [0.3, 0.2, -0.1] + [0.7, 0.1, 0.3]
OCTAHEDRON = np.concatenate([np.eye(3), -np.eye(3)])


@given(seed=SEEDS, offset=st.sampled_from([0.0, 1.0, 30.0]), single=st.booleans())
def test_clouds_on_a_line_or_in_a_spot_are_refused(seed, offset, single):
    rng = np.random.default_rng(seed)
    kind = np.float32 if single else np.float64
    cloud = rng.normal(size=(7, 3)).astype(kind)
    line = (rng.normal(size=(7, 1)) * rng.normal(size=3) + offset * rng.normal(size=3)).astype(kind)
    spot = np.repeat(rng.normal(size=(1, 3)) + offset, 7, axis=0).astype(kind)
    turned = (line @ rotation(rng)).astype(kind)
    for pair in ((line, cloud), (cloud, line), (line, turned), (spot, cloud), (cloud, spot)):
        with pytest.raises(ValueError, match="source and target: expected points that determine"):
            umeyama(*pair)


def test_a_needle_still_decides():
    needle = LINE.copy()
    needle[2, 1] += 1e-4
    R = Rotation.from_euler("xyz", [0.4, -1.0, 2.0]).as_matrix()
    # 1e-4 of width against roundings of 1e-16, squared in the covariance.
    np.testing.assert_allclose(umeyama(needle, needle @ R.T).R, R, atol=1e-7)


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda c: umeyama(c[:2], c[:2]), "source: expected at least 3 points, got 2"),
        (lambda c: umeyama(c, c, [1, 1, 1, -1e-9, 1, 1]), "weights: expected none negative"),
        (lambda c: umeyama(c, c, np.zeros(6)), "weights: expected at least 3 positive"),
        (lambda c: umeyama(c, c, [1, 0, 0, 1, 0, 0]), "weights: expected at least 3 positive"),
        (lambda c: umeyama(c, c, [np.ones(6), [1, 0, 0, 0, 0, 0]]), "weights:"),
        (lambda c: umeyama(LINE, c[:5]), "source and target:"),
        (lambda c: umeyama(c[:5], LINE, with_scale=True), "source and target:"),
        (lambda c: umeyama(c, np.zeros((6, 3))), "source and target:"),
        (lambda c: umeyama(np.full((6, 3), 0.1), c), "source and target:"),
        (lambda c: umeyama([c, np.ones((6, 3))], [c, c]), "source and target:"),
        (lambda c: umeyama(OCTAHEDRON, -OCTAHEDRON), "source and target:"),
    ],
)
def test_bad_input_is_named(rng, call, named):
    cloud = rng.normal(size=(6, 3))
    with pytest.raises(ValueError, match=f"^{named}"):
        call(cloud)
