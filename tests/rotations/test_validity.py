"""What is a rotation, and what the refusal of others says."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from posecore.rotations import (
    geodesic_distance,
    is_rotation,
    random_rotations,
    require_rotation,
    rotation_defect,
    special_procrustes,
)

RANDOM = Rotation.random(20, random_state=0).as_matrix()
matrices = hnp.arrays(float, (3, 3), elements=st.floats(-2, 2))


@given(matrices)
def test_defect_is_the_largest_entry(R: np.ndarray) -> None:
    loop = max(abs(R[i] @ R[j] - (i == j)) for i in range(3) for j in range(3))
    assert abs(rotation_defect(R) - loop) < 1e-14


@pytest.mark.parametrize(
    ("R", "defect"),
    [
        (np.eye(3), 0),
        (-np.eye(3), 0),
        (2 * np.eye(3), 3),
        (np.zeros((3, 3)), 1),
        (np.diag([1, 1, 1.1]), 0.21),
        (np.array([[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]), 0.5),
    ],
)
def test_defect_of_known_matrices(R: np.ndarray, defect: float) -> None:
    assert rotation_defect(R) == pytest.approx(defect)
    assert rotation_defect(torch.from_numpy(R)).item() == pytest.approx(defect)


@given(st.integers(0, 10**6), st.floats(0, 0.1))
def test_is_rotation_up_to_the_tolerance(seed: int, off: float) -> None:
    R = Rotation.random(random_state=seed).as_matrix() * np.sqrt(1 + off)
    assert is_rotation(R, tolerance=off + 1e-12)
    assert not is_rotation(-R, tolerance=off + 1e-12)
    if off > 1e-11:
        assert not is_rotation(R, tolerance=off - 1e-12)
    assert is_rotation(R) == (off <= 1e-3)


def test_is_rotation_of_a_batch() -> None:
    R = RANDOM.reshape(4, 5, 3, 3).copy()
    R[1, 2] *= 1.01
    R[3, 4] *= -1
    expected = np.ones((4, 5), bool)
    expected[1, 2] = expected[3, 4] = False
    assert np.array_equal(is_rotation(R), expected)
    assert torch.equal(is_rotation(torch.from_numpy(R)), torch.from_numpy(expected))
    assert is_rotation(np.zeros((0, 3, 3))).shape == (0,)


@given(matrices)
def test_require_agrees_with_is_rotation(M: np.ndarray) -> None:
    for R in (M, special_procrustes(M)):
        if is_rotation(R):
            require_rotation("R", R)
        else:
            with pytest.raises(ValueError, match=r"^R: "):
                require_rotation("R", R)


@given(st.integers(0, 10**6), st.floats(-8, 0), st.sampled_from([1e-12, 1e-7, 1e-3, 0.3, 2, 1e9]))
def test_require_of_many_agrees_with_is_rotation(seed: int, size: float, tolerance: float) -> None:
    # Many matrices are looked at in another way first.
    rng = np.random.default_rng(seed)
    R = np.tile(Rotation.random(600, rng=rng).as_matrix(), (2, 1, 1))
    R[700] += 10**size * rng.normal(size=(3, 3))
    R[800] *= rng.choice([-1, 1])
    for some in (R, R.astype(np.float32)):
        kept = some[is_rotation(some, tolerance)]
        require_rotation("R", torch.from_numpy(kept), tolerance)
        if len(kept) < len(some):
            with pytest.raises(ValueError, match=rf"^R: .* {len(some) - len(kept)} of 1200"):
                require_rotation("R", torch.from_numpy(some), tolerance)


@pytest.mark.parametrize(
    "R",
    [
        RANDOM,
        RANDOM.astype(np.float32),
        RANDOM[::-1],
        RANDOM.astype(">f8"),
        np.broadcast_to(np.eye(3), (4, 3, 3)),  # not writable
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        np.zeros((0, 3, 3)),
        torch.from_numpy(RANDOM).requires_grad_(),
        torch.eye(3, dtype=torch.float16),
    ],
    ids=lambda R: type(R).__name__,
)
def test_rotations_of_any_kind_pass(R: object) -> None:
    require_rotation("R", R)


def test_autocast_does_not_make_rotations_worse() -> None:
    with torch.autocast("cpu", dtype=torch.bfloat16):
        require_rotation("R", torch.from_numpy(RANDOM).float())


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_is_not_refused_for_its_digits(dtype: torch.dtype) -> None:
    R = random_rotations(2000, generator=0)
    half, doubtful = R.to(dtype), 1.02 * R
    limit = torch.finfo(dtype).eps
    assert is_rotation(half).all() and not is_rotation(doubtful.to(dtype)).any()
    assert rotation_defect(half).max() < limit
    assert geodesic_distance(half, R).max() < limit
    with pytest.raises(ValueError, match="^R_2: expected rotation matrices to 0.00"):
        geodesic_distance(half, doubtful.to(dtype))
    if dtype == torch.bfloat16:  # as numbers of single precision they are no rotations
        with pytest.raises(ValueError, match="^R_1: expected rotation matrices to 0.001"):
            geodesic_distance(half.float(), R)


def test_the_refusal_says_what_where_and_what_to_do() -> None:
    R = RANDOM.reshape(4, 5, 3, 3).copy()
    R[1, 2] *= 1.1
    R[3, 4] = 0
    with pytest.raises(ValueError) as error:
        require_rotation("R_est", R)
    assert str(error.value) == (
        "R_est: expected rotation matrices to 0.001 (rotations.special_procrustes gives the "
        "nearest), got 2 of 20 that are not, the first with R R^T off by 0.21 and determinant 1.33 "
        "at index (1, 2)"
    )


BAD = [
    (lambda: require_rotation("pose", 2 * np.eye(3)), "pose: .*determinant 8"),
    (lambda: require_rotation("pose", -np.eye(3)), "pose: .*determinant -1"),
    (lambda: require_rotation("pose", np.full((3, 3), np.nan)), "pose: .*nan"),
    (lambda: require_rotation("pose", torch.full((3, 3), np.inf)), "pose: "),
    (lambda: require_rotation("pose", np.eye(4)), "pose: .*shape"),
    (lambda: require_rotation("pose", [1, 2, 3]), "pose: .*shape"),
    (lambda: require_rotation("pose", [[1, 0, 0], [0, 1], [0]]), "pose: .*list"),
    (lambda: require_rotation("pose", "identity"), "pose: .*str"),
    (lambda: require_rotation("pose", None), "pose: "),
    (lambda: require_rotation("pose", 1.001 * np.eye(3), 1e-3), "pose: "),
    (lambda: require_rotation("pose", np.eye(3), -1), "tolerance: "),
    (lambda: is_rotation(np.eye(3), tolerance=-1e-3), "tolerance: "),
    (lambda: is_rotation(np.eye(3), tolerance=np.nan), "tolerance: "),
]


@pytest.mark.parametrize(("call", "complaint"), BAD)
def test_bad_input(call: Callable, complaint: str) -> None:
    with pytest.raises(ValueError, match="^" + complaint):
        call()
