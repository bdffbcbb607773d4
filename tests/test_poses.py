"""Poses against products and inverses of 4 x 4 matrices."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posecore import poses

seeds = st.integers(0, 10**6)


def random_poses(seed: int, *batch: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    R = Rotation.random(int(np.prod(batch)), rng=rng).as_matrix().reshape(*batch, 3, 3)
    return R, rng.uniform(-2, 2, size=(*batch, 3))


def matrix(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """The 4 x 4 matrix of one pose, entry by entry."""
    T = np.eye(4)
    for i in range(3):
        for j in range(3):
            T[i, j] = R[i, j]
        T[i, 3] = t[i]
    return T


def close(a: tuple, b: np.ndarray) -> bool:
    """A pose or a matrix like this 4 x 4 matrix, to rounding."""
    return np.abs(matrix(*a) - b).max() < 1e-14


@given(seeds)
def test_to_matrix_and_back(seed: int) -> None:
    R, t = random_poses(seed, 2, 3)
    T = poses.to_matrix(R, t)
    assert np.array_equal(T[1, 2], matrix(R[1, 2], t[1, 2]))
    R_back, t_back = poses.from_matrix(T)
    assert np.array_equal(R_back, R)
    assert np.array_equal(t_back, t)


@given(seeds)
def test_apply_with_a_scale_is_a_similarity(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, t = rng.normal(size=(4, 3)), rng.normal(size=(5, 3))
    R, scale = Rotation.random(5, rng=rng).as_matrix(), rng.uniform(0.1, 3, 5)
    moved = poses.apply(R, t, points, scale)
    expected = [[s * r @ x + v for x in points] for s, r, v in zip(scale, R, t, strict=True)]
    assert np.abs(moved - np.array(expected)).max() < 1e-13
    assert poses.apply(R[0].astype("f4"), t[0].astype("f4"), points.astype("f4"), 2.0).dtype == "f4"


@given(seeds)
def test_apply_is_the_product_with_homogeneous_points(seed: int) -> None:
    R, t = random_poses(seed, 2)
    points = np.random.default_rng(seed).normal(size=(2, 5, 3))
    moved = poses.apply(R, t, points)
    for b in range(2):
        for n in range(5):
            expected = matrix(R[b], t[b]) @ [*points[b, n], 1]
            assert np.abs(moved[b, n] - expected[:3]).max() < 1e-14


@given(seeds)
def test_compose_is_the_product(seed: int) -> None:
    R, t = random_poses(seed, 2)
    composed = poses.compose(R[0], t[0], R[1], t[1])
    assert close(composed, matrix(R[0], t[0]) @ matrix(R[1], t[1]))


@given(seeds)
def test_invert_is_the_inverse(seed: int) -> None:
    R, t = random_poses(seed)
    assert close(poses.invert(R, t), np.linalg.inv(matrix(R, t)))


@given(seeds)
def test_relative_is_the_inverse_of_the_first_times_the_second(seed: int) -> None:
    R, t = random_poses(seed, 2)
    step = poses.relative(R[0], t[0], R[1], t[1])
    assert close(step, np.linalg.inv(matrix(R[0], t[0])) @ matrix(R[1], t[1]))
    assert close(poses.compose(R[0], t[0], *step), matrix(R[1], t[1]))


@given(seeds)
def test_laws_of_the_group(seed: int) -> None:
    (a, b, c) = zip(*random_poses(seed, 3), strict=True)
    identity = (np.eye(3), np.zeros(3))
    left = poses.compose(*poses.compose(*a, *b), *c)
    assert close(left, matrix(*poses.compose(*a, *poses.compose(*b, *c))))
    assert close(poses.compose(*a, *poses.invert(*a)), np.eye(4))
    assert close(poses.compose(*identity, *a), matrix(*a))
    assert close(poses.invert(*poses.invert(*a)), matrix(*a))
    assert close(poses.relative(*identity, *a), matrix(*a))


@given(seeds)
def test_one_after_the_other_is_the_composition(seed: int) -> None:
    (a, b) = zip(*random_poses(seed, 2), strict=True)
    points = np.random.default_rng(seed).normal(size=(4, 3))
    one_by_one = poses.apply(*a, poses.apply(*b, points))
    assert np.abs(one_by_one - poses.apply(*poses.compose(*a, *b), points)).max() < 1e-13
    assert np.abs(poses.apply(*poses.invert(*a), poses.apply(*a, points)) - points).max() < 1e-13
    lengths = np.linalg.norm(points[1:] - points[0], axis=1)
    moved = poses.apply(*a, points)
    assert np.abs(np.linalg.norm(moved[1:] - moved[0], axis=1) - lengths).max() < 1e-13


def test_a_known_pose() -> None:
    # A quarter turn about z, then 1 m along x.
    R, t = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [1, 0, 0]
    assert poses.apply(R, t, [[1, 0, 0], [0, 2, 0]]).tolist() == [[1, 1, 0], [-1, 0, 0]]
    R_inv, t_inv = poses.invert(R, t)
    assert R_inv.tolist() == [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    assert t_inv.tolist() == [0, 1, 0]


def test_any_matrix_may_move_points() -> None:
    # Published ground truth may be off; a pose is applied as it is.
    R = 1.01 * np.eye(3)
    assert poses.apply(R, np.zeros(3), np.ones((1, 3))).tolist() == [[1.01, 1.01, 1.01]]
    assert poses.compose(R, np.zeros(3), R, np.ones(3))[1].tolist() == [1.01, 1.01, 1.01]


FUNCTIONS = [
    lambda R, t: poses.apply(R, t, t[..., None, :]),
    lambda R, t: poses.compose(R, t, R, t),
    poses.invert,
    lambda R, t: poses.relative(R, t, R, t),
    poses.to_matrix,
    lambda R, t: poses.from_matrix(poses.to_matrix(R, t)),
]


def flat(result: object) -> list:
    return list(result) if isinstance(result, tuple) else [result]


@pytest.mark.parametrize("function", FUNCTIONS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_arrays_and_tensors_give_the_same(function: Callable, dtype: type) -> None:
    R, t = (part.astype(dtype) for part in random_poses(0, 4))
    arrays = flat(function(R, t))
    tensors = flat(function(torch.from_numpy(R), torch.from_numpy(t)))
    for array, tensor in zip(arrays, tensors, strict=True):
        assert isinstance(array, np.ndarray)
        assert isinstance(tensor, torch.Tensor)
        assert array.dtype == dtype
        assert np.array_equal(array, tensor.numpy())


@pytest.mark.parametrize("function", FUNCTIONS)
def test_lists_are_float64_arrays(function: Callable) -> None:
    R, t = random_poses(1)

    class Listed(list):
        """A list that can still be indexed as the functions above need."""

        def __getitem__(self, index: object) -> object:
            return np.asarray(self)[index]

    for array in flat(function(Listed(R.tolist()), Listed(t.tolist()))):
        assert isinstance(array, np.ndarray)
        assert array.dtype == np.float64


def test_precision_is_that_of_the_widest_argument() -> None:
    R, t = random_poses(2)
    points = np.ones((2, 3), np.float32)
    assert poses.apply(R, t, points).dtype == np.float64
    assert poses.apply(R.astype(np.float32), t.astype(np.float32), points).dtype == np.float32
    mixed = poses.apply(torch.from_numpy(R).float(), t, points)
    assert isinstance(mixed, torch.Tensor)
    assert mixed.dtype == torch.float64


def test_batches_broadcast() -> None:
    R, t = random_poses(3, 4)
    points = np.random.default_rng(3).normal(size=(6, 3))
    moved = poses.apply(R, t, points)
    assert moved.shape == (4, 6, 3)
    # Not to the bit: how products are added up depends on the machine and on the number of rows.
    assert np.allclose(moved[2], poses.apply(R[2], t[2], points), rtol=0, atol=1e-14)
    R_ac, t_ac = poses.compose(R[:, None], t[:, None], R, t)
    assert R_ac.shape == (4, 4, 3, 3)
    assert np.allclose(t_ac[1, 2], R[1] @ t[2] + t[1], rtol=0, atol=1e-15)
    assert poses.to_matrix(R, t[0]).shape == (4, 4, 4)
    assert poses.to_matrix(R[0], t).shape == (4, 4, 4)
    assert poses.apply(R[:0], t[:0], points).shape == (0, 6, 3)


@pytest.mark.parametrize("function", FUNCTIONS)
def test_gradients_are_those_of_finite_differences(function: Callable) -> None:
    R, t = (torch.from_numpy(part).requires_grad_() for part in random_poses(4, 2))
    assert torch.autograd.gradcheck(function, (R, t))


def test_the_arguments_are_left_as_they_were() -> None:
    R, t = random_poses(5, 3)
    before = R.copy(), t.copy()
    for function in FUNCTIONS:
        function(R, t)
    assert np.array_equal(R, before[0])
    assert np.array_equal(t, before[1])


R0, T0 = np.eye(3), np.zeros(3)
LAST_ROW = np.eye(4)
LAST_ROW[3, 3] = 2
BAD = [
    (lambda: poses.invert(1.01 * R0, T0), "R: .*special_procrustes"),
    (lambda: poses.invert(-R0, T0), "R: .*determinant -1"),
    (lambda: poses.invert(np.zeros((3, 3)), T0), "R: .*determinant 0"),
    (lambda: poses.relative(1.01 * R0, T0, R0, T0), "R_1: .*rotation"),
    (lambda: poses.from_matrix(LAST_ROW), r"T: .*\[0.0, 0.0, 0.0, 2.0\]"),
    (lambda: poses.from_matrix(np.stack([np.eye(4), np.ones((4, 4))])), "T: .*last row"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "complaint"), BAD)
def test_bad_input(call: Callable, complaint: str) -> None:
    with pytest.raises(ValueError, match="^" + complaint):
        call()
