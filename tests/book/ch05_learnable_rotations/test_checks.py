"""Chapter 5's exercises: plausible wrong solutions are caught, other right ones are accepted."""

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import approx_fprime
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.nn.functional import normalize

from book.ch05_learnable_rotations import checks
from book.tools.checks import DONE
from posecore import rotations
from posecore.nets.rotation_heads import RotationHead
from tests.book.ch05_learnable_rotations.solutions import (
    SOLUTIONS,
    nearest_one_by_one,
    six_by_two_crosses,
    six_one_by_one,
)
from tests.book.exercises import ExerciseTests

seeds = st.integers(0, 2**31 - 1)


def doubles(*shape: int, seed: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def angle(a: Tensor, b: Tensor) -> float:
    """Between two directions of either sign, degrees."""
    return float(
        torch.rad2deg((normalize(a, dim=0) @ normalize(b, dim=0)).abs().clamp(max=1).acos())
    )


@pytest.mark.slow
class TestExercises(ExerciseTests):
    checks = checks
    solutions = SOLUTIONS


@given(seeds)
def test_no_rotation_is_nearer(seed: int) -> None:
    M = doubles(5, 3, 3, seed=seed)
    R = checks.nearest_rotation(M)
    assert rotations.is_rotation(R).all()
    others = rotations.random_rotations(200, 1, generator=seed, dtype=torch.float64)
    slightly = rotations.axis_angle_to_matrix(doubles(200, 5, 3, seed=seed + 1) / 100)
    best = torch.linalg.matrix_norm(M - R)
    assert (best <= torch.linalg.matrix_norm(M - others) + 1e-12).all()
    assert (best <= torch.linalg.matrix_norm(M - R @ slightly) + 1e-12).all()


@given(seeds, st.floats(0.1, 3), st.floats(-0.9, 1))
@settings(max_examples=30)
def test_the_gradient_is_that_of_finite_differences(seed: int, s_2: float, share: float) -> None:
    U, V = rotations.random_rotations(2, generator=seed, dtype=torch.float64)
    M = U @ torch.diag(torch.tensor([3.0, s_2, share * s_2]).double()) @ V.T
    G = doubles(3, 3, seed=seed)

    def loss(entries: np.ndarray) -> float:
        matrix = torch.from_numpy(entries).reshape(1, 3, 3)
        return float((nearest_one_by_one(matrix)[0] * G).sum())

    expected = approx_fprime(M.flatten().numpy(), loss, 1e-7).reshape(3, 3)
    tolerance = 1e-5 / (s_2 * (1 + share)) ** 2  # of the second derivative times the step
    found = checks.procrustes_gradient(M, G).numpy()
    assert np.allclose(found, expected, rtol=0, atol=max(tolerance, 1e-5))


@given(seeds)
def test_six_numbers_are_a_qr_decomposition(seed: int) -> None:
    x = doubles(1, 6, seed=seed)
    Q, triangle = np.linalg.qr(x.reshape(2, 3).T.numpy())
    columns = Q * np.sign(triangle.diagonal())
    expected = np.c_[columns, np.cross(*columns.T)]
    assert np.allclose(checks.six_to_rotation(x)[0].numpy(), expected, atol=1e-9)


def test_a_gradient_is_asked_of_the_copy_that_the_student_got() -> None:
    x = doubles(2, 6, seed=0).requires_grad_()
    assert checks._leaf(six_by_two_crosses(x)) is x
    assert checks._leaf(six_one_by_one(x)) is x


@given(seeds)
def test_five_numbers_say_a_rotation(seed: int) -> None:
    R = rotations.random_rotations(20, generator=seed, dtype=torch.float64)
    a = rotations.random_rotations(generator=seed + 1, dtype=torch.float64)[0]
    numbers = checks.to_five(R, a)
    assert numbers.shape == (20, 5)
    assert torch.allclose(checks.from_five(numbers, a), R, atol=1e-9)
    # A turn of the object about its z axis adds to the angle.
    turned = R @ rotations.axis_angle_to_matrix(torch.tensor([0, 0, 0.3]).double())
    angles = [torch.atan2(n[:, 4], n[:, 3]) for n in (numbers, checks.to_five(turned, a))]
    assert torch.allclose((angles[1] - angles[0]) % (2 * torch.pi), torch.tensor(0.3).double())


@given(seeds)
@settings(max_examples=5)
def test_the_hole_is_where_the_representation_has_it(seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    a = torch.nn.functional.normalize(doubles(3, seed=seed), dim=0)
    R = rotations.random_rotations(4000, generator=generator, dtype=torch.float64)
    errors = checks.blurred_errors(R, a, generator)
    errors[:10] = torch.pi
    assert angle(checks.hole_axis(R, errors), a) < 6


@given(seeds, st.sampled_from(checks.REPRESENTATIONS))
@settings(max_examples=30)
def test_the_mean_is_that_of_scipy(seed: int, representation: str) -> None:
    generator = torch.Generator().manual_seed(seed)
    centre = rotations.random_rotations(generator=generator, dtype=torch.float64)
    numbers = checks.predictions(centre, 7, 0.5, representation, generator)
    R = RotationHead(representation).decode(numbers)
    mean = checks.mean_prediction(numbers, representation)
    assert np.allclose(mean.numpy(), Rotation.from_matrix(R.numpy()).mean().as_matrix())
    assert torch.allclose(checks.mean_prediction(numbers.flip(0), representation), mean)


@pytest.mark.slow
@given(seeds, st.floats(0, 1.2))
@settings(max_examples=30)
def test_no_rotation_has_less_spread(seed: int, wide: float) -> None:
    R = rotations.axis_angle_to_matrix(wide * doubles(6, 3, seed=seed) / 3**0.5)
    least = checks.least_spread(R)
    for turn in doubles(10, 3, seed=seed + 1) / 10:
        other = rotations.mean_rotation(R) @ rotations.axis_angle_to_matrix(turn)
        assert least <= checks.spread(other, R) + 1e-9
    assert checks.spread(rotations.mean_rotation(R), R) <= 1.05 * least + 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("turn", [0, 0.03, 0.08, 0.3])
def test_the_open_exercise_is_judged_by_its_property(turn: float) -> None:
    """Whatever has hardly more spread than any other on all inputs is done."""

    def student(numbers: Any, representation: str) -> Tensor:
        mean = checks.mean_prediction(numbers, representation)
        # A single prediction has no spread of which there could be more.
        v = torch.tensor([turn if len(numbers) > 3 else 0, 0, 0], dtype=mean.dtype)
        return mean @ rotations.axis_angle_to_matrix(v)

    good = []
    rng = np.random.default_rng(checks.check_mean_prediction.seed)
    for _, numbers, name in checks.check_mean_prediction.inputs(rng):
        R = RotationHead(name).decode(numbers)
        got = checks.spread(student(numbers, name), R)
        good.append(got <= 1.05 * checks.least_spread(R) + 1e-5)
    assert (checks.check_mean_prediction(student).status == DONE) == all(good)
