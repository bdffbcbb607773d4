"""Chamfer distance and normals: against loops, SciPy, scikit-learn and known surfaces."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from sklearn.decomposition import PCA

from posecore import clouds

seeds = st.integers(0, 2**32 - 1)


def even_sphere(n):
    """Points spread evenly over the unit sphere, on a spiral of golden angles."""
    z = 1 - (2 * np.arange(n) + 1) / n
    angle = np.arange(n) * np.pi * (3 - 5**0.5)
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


# Chamfer distance


@given(seeds, st.integers(1, 20), st.integers(1, 20), st.booleans())
def test_chamfer_is_the_sum_of_both_mean_nearest_distances(seed, n, m, squared):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(n, 3)), rng.normal(size=(m, 3))
    distances = np.linalg.norm(a[:, None] - b, axis=-1) ** (2 if squared else 1)
    expected = distances.min(1).mean() + distances.min(0).mean()
    assert clouds.chamfer_distance(a, b, squared=squared) == pytest.approx(expected, rel=1e-12)


def test_chamfer_of_three_points_by_hand():
    a, b = np.zeros((1, 3)), np.array([[0.0, 0, 0], [3, 4, 0]])
    assert clouds.chamfer_distance(a, b) == 2.5
    assert clouds.chamfer_distance(b, a, squared=True) == 12.5


def test_chamfer_of_batches_that_broadcast(rng):
    a, b = rng.normal(size=(4, 1, 300, 3)), rng.normal(size=(3, 200, 3))
    result = clouds.chamfer_distance(a, b)
    assert result.shape == (4, 3)
    for i, j in np.ndindex(4, 3):
        there, back = cKDTree(b[j]).query(a[i, 0])[0], cKDTree(a[i, 0]).query(b[j])[0]
        assert result[i, j] == pytest.approx(there.mean() + back.mean(), rel=1e-12)


@given(seeds)
def test_chamfer_is_symmetric_and_moves_with_both_clouds(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(9, 3)), rng.normal(size=(7, 3))
    R, t = Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3)
    value = clouds.chamfer_distance(a, b)
    assert clouds.chamfer_distance(b, a) == pytest.approx(value, rel=1e-12)
    assert clouds.chamfer_distance(a @ R.T + t, b @ R.T + t) == pytest.approx(value, rel=1e-10)
    assert clouds.chamfer_distance(a, rng.permutation(a)) == 0


@pytest.mark.slow
@pytest.mark.parametrize("squared", [False, True])
def test_chamfer_passes_exact_gradients_to_both(rng, squared):
    a = torch.from_numpy(rng.normal(size=(2, 6, 3))).requires_grad_()
    b = torch.from_numpy(rng.normal(size=(2, 5, 3))).requires_grad_()
    assert torch.autograd.gradcheck(lambda a, b: clouds.chamfer_distance(a, b, squared), (a, b))


@pytest.mark.parametrize("squared", [False, True])
def test_chamfer_of_equal_clouds_has_gradient_zero(squared):
    a = torch.rand(6, 3, requires_grad=True)
    value = clouds.chamfer_distance(a, a.detach().flip(0), squared)
    value.backward()
    assert value == 0 and (a.grad == 0).all()


@pytest.mark.parametrize("shift", [0.0, 1e6])
def test_chamfer_of_copies_of_one_point(shift):
    a = torch.full((5, 3), shift, dtype=torch.float64, requires_grad=True)
    b = torch.full((1, 3), shift, dtype=torch.float64) + torch.tensor([0, 3.0, 4.0])
    value = clouds.chamfer_distance(a, b)
    value.backward()
    assert value == 10
    assert torch.isfinite(a.grad).all() and (a.grad[:, 1:] < 0).any()


# Normals


@pytest.mark.slow
@given(seeds)
def test_normals_are_the_last_principal_component(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(30, 3))
    normals = clouds.estimate_normals(points, 8)
    nearest = cKDTree(points).query(points, 8)[1]
    for normal, indices in zip(normals, nearest, strict=True):
        expected = PCA(3).fit(points[indices]).components_[2]
        assert abs(normal @ expected) == pytest.approx(1, abs=1e-9)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-12)
    assert ((normals * (points - points.mean(0))).sum(1) >= 0).all()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_normals_of_a_sphere_point_outward_or_to_the_viewer(rng, dtype):
    centre = np.array([0.1, -0.2, 1.5])
    directions = rng.permutation(even_sphere(2000))
    points = (centre + 0.05 * directions).astype(dtype)
    outward = clouds.estimate_normals(points)
    assert outward.dtype == dtype
    # The plane is that of the patch's middle, and the point is less than one spacing from it.
    assert (outward * directions).sum(1).min() > np.cos(np.sqrt(4 * np.pi / 2000))
    seen = clouds.estimate_normals(points, orient_to=np.zeros(3))
    assert ((seen * -points).sum(1) >= 0).all()
    np.testing.assert_allclose(np.abs((seen * outward).sum(1)), 1, rtol=1e-6)
    assert (np.sign((seen * directions).sum(1)) == -1).any()


@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_normals_of_a_plane_are_exact(rng, offset):
    R = Rotation.random(random_state=3).as_matrix()
    points = np.c_[rng.uniform(-1, 1, (50, 2)), np.zeros(50)] @ R.T + offset
    side = points.mean(0) + 2 * R[:, 2]
    normals = clouds.estimate_normals(points, 6, side)
    # The coordinates are rounded to 1e-16 of their size.
    atol = 1e-12 if offset == 0 else 1e-7
    np.testing.assert_allclose(normals, np.tile(R[:, 2], (50, 1)), atol=atol)


@given(seeds)
def test_normals_turn_with_the_cloud_whatever_its_order(seed):
    rng = np.random.default_rng(seed)
    points, R = rng.normal(size=(25, 3)), Rotation.random(random_state=seed).as_matrix()
    normals = clouds.estimate_normals(points, 6, np.full(3, 100.0))
    order = rng.permutation(25)
    np.testing.assert_array_equal(
        clouds.estimate_normals(points[order], 6, np.full(3, 100.0)), normals[order]
    )
    turned = clouds.estimate_normals(points @ R.T, 6, R @ np.full(3, 100.0))
    agreement = np.abs((turned * (normals @ R.T)).sum(1))
    np.testing.assert_allclose(agreement, 1, rtol=1e-8)


@pytest.mark.parametrize("shift", [0.0, 1e6])
def test_points_on_a_line_have_unit_normals_perpendicular_to_it(rng, shift):
    direction = np.array([1.0, 2, -2]) / 3
    points = np.linspace(0, 1, 12)[:, None] * direction + shift
    normals = clouds.estimate_normals(points, 5)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-12)
    np.testing.assert_allclose(normals @ direction, 0, atol=1e-12 if shift == 0 else 1e-8)


@pytest.mark.parametrize("place", [0.0, 0.1, 1e6])
def test_copies_of_one_point_have_some_unit_normal(place):
    normals = clouds.estimate_normals(np.full((2, 6, 3), place), 6)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1, rtol=1e-12)


def test_normals_of_batches_with_their_own_viewers(rng):
    points, viewers = rng.normal(size=(2, 3, 20, 3)), rng.normal(size=(3, 3)) * 10
    normals = clouds.estimate_normals(points, 5, viewers)
    for i, j in np.ndindex(2, 3):
        single = clouds.estimate_normals(points[i, j], 5, viewers[j])
        np.testing.assert_allclose(normals[i, j], single, rtol=1e-12)
    tensor = torch.from_numpy(points).requires_grad_()
    assert not clouds.estimate_normals(tensor, 5).requires_grad


POINTS = np.arange(15.0).reshape(5, 3) ** 2
BAD_CALLS = [
    (lambda: clouds.estimate_normals(POINTS, 6), "k"),
    (lambda: clouds.estimate_normals(POINTS, 2), "k"),
    (lambda: clouds.estimate_normals(POINTS), "k"),
    (lambda: clouds.estimate_normals(POINTS, 3.0), "k"),
]


@pytest.mark.parametrize(("call", "argument"), BAD_CALLS)
def test_bad_input_is_refused_by_name(call, argument):
    with pytest.raises(ValueError, match=rf"^{argument}: expected .*got"):
        call()
