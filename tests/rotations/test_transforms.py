"""Rotations under `torch.compile`, `vmap` and `jacrev`: the values of the batched call."""

from collections.abc import Callable

import pytest
import roma
import torch
from torch import Tensor

from posecore import rotations
from posecore.registration import umeyama

# PyTorch's compiler does what PyTorch's autograd warns of.
pytestmark = pytest.mark.filterwarnings("ignore:.*should not be instantiated:DeprecationWarning")

GENERATOR = torch.Generator().manual_seed(0)


def numbers(*shape: int) -> Tensor:
    return torch.randn(*shape, generator=GENERATOR, dtype=torch.float64)


R_1, R_2 = rotations.random_rotations(2, 5, generator=0, dtype=torch.float64)
SAME: dict[str, tuple[Callable, tuple[Tensor, ...]]] = {
    "quaternion_to_matrix": (rotations.quaternion_to_matrix, (numbers(5, 4),)),
    "matrix_to_quaternion": (rotations.matrix_to_quaternion, (R_1,)),
    "quaternion_multiply": (rotations.quaternion_multiply, (numbers(5, 4), numbers(5, 4))),
    "axis_angle_to_quaternion": (rotations.axis_angle_to_quaternion, (numbers(5, 3),)),
    "quaternion_to_axis_angle": (rotations.quaternion_to_axis_angle, (numbers(5, 4),)),
    "axis_angle_to_matrix": (rotations.axis_angle_to_matrix, (numbers(5, 3),)),
    "matrix_to_axis_angle": (rotations.matrix_to_axis_angle, (R_1,)),
    "rotation_6d_to_matrix": (rotations.rotation_6d_to_matrix, (numbers(5, 6),)),
    "matrix_to_rotation_6d": (rotations.matrix_to_rotation_6d, (R_1,)),
    "euler_to_matrix": (rotations.euler_to_matrix, (numbers(5, 3),)),
    "matrix_to_euler": (rotations.matrix_to_euler, (R_1,)),
    "special_procrustes": (rotations.special_procrustes, (numbers(5, 3, 3),)),
    "geodesic_distance": (rotations.geodesic_distance, (R_1, R_2)),
    "mean_rotation": (rotations.mean_rotation, (torch.stack([R_1, R_2], 1),)),
    "hat": (rotations.hat, (numbers(5, 3),)),
    "vee": (rotations.vee, (numbers(5, 3, 3),)),
    "is_rotation": (rotations.is_rotation, (R_1,)),
    "rotation_defect": (rotations.rotation_defect, (numbers(5, 3, 3),)),
    "quaternion_inverse": (rotations.quaternion_inverse, (numbers(5, 4),)),
    "quaternion_apply": (rotations.quaternion_apply, (numbers(5, 4), numbers(5, 7, 3))),
    "quaternion_slerp": (
        rotations.quaternion_slerp,
        (numbers(5, 4), numbers(5, 4), torch.linspace(0.1, 0.9, 5, dtype=torch.float64)),
    ),
    "slerp": (rotations.slerp, (R_1, R_2, torch.linspace(0.1, 0.9, 5, dtype=torch.float64))),
    "wxyz_to_xyzw": (rotations.wxyz_to_xyzw, (numbers(5, 4),)),
    "xyzw_to_wxyz": (rotations.xyzw_to_wxyz, (numbers(5, 4),)),
    "umeyama": (lambda a, b: umeyama(a, b, with_scale=True), (numbers(5, 9, 3), numbers(5, 9, 3))),
}
each = pytest.mark.parametrize(("function", "args"), SAME.values(), ids=SAME)


def parts(result: object) -> tuple[Tensor, ...]:
    return tuple(result) if isinstance(result, tuple) else (result,)


def test_none_is_left_out() -> None:
    assert {"random_rotations", "require_rotation", *rotations.__all__} - set(SAME) == {
        "random_rotations",  # draws
        "require_rotation",  # gives nothing
    }


@each
def test_vmap_gives_the_batched_values(function: Callable, args: tuple[Tensor, ...]) -> None:
    for one, other in zip(
        parts(torch.func.vmap(function)(*args)), parts(function(*args)), strict=True
    ):
        torch.testing.assert_close(one, other, rtol=1e-14, atol=1e-14)


@pytest.mark.slow
@each
def test_one_graph_gives_the_same(function: Callable, args: tuple[Tensor, ...]) -> None:
    compiled = torch.compile(function, fullgraph=True, backend="aot_eager")
    for one, other in zip(parts(compiled(*args)), parts(function(*args)), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-12, atol=1e-12)


@each
def test_jacobians_are_those_of_each_row(function: Callable, args: tuple[Tensor, ...]) -> None:
    if not all(part.is_floating_point() for part in parts(function(*args))):
        return

    def flat(*row: Tensor) -> Tensor:
        return torch.cat([part.flatten() for part in parts(function(*row))])

    found = torch.func.vmap(torch.func.jacrev(flat))(*args)
    for i, row in enumerate(zip(*args, strict=True)):
        expected = torch.autograd.functional.jacobian(flat, row)[0]
        torch.testing.assert_close(found[i], expected, rtol=1e-10, atol=1e-10)


def test_procrustes_agrees_with_roma_under_transforms() -> None:
    M = numbers(6, 3, 3)
    ours, theirs = rotations.special_procrustes, roma.special_procrustes
    vmap, jacrev = torch.func.vmap, torch.func.jacrev
    torch.testing.assert_close(vmap(ours)(M), theirs(M))
    jacobian = vmap(jacrev(ours))(M)
    expected = torch.stack([torch.autograd.functional.jacobian(theirs, one) for one in M])
    torch.testing.assert_close(jacobian, expected)
    # Twice: once more by differences of the first.
    second, step = vmap(jacrev(jacrev(ours)))(M), torch.zeros_like(M)
    step[:, 1, 2] = 1e-6
    slope = (vmap(jacrev(ours))(M + step) - vmap(jacrev(ours))(M - step)) / 2e-6
    torch.testing.assert_close(second[..., 1, 2], slope, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
def test_many_matrices_go_the_same_road_under_vmap() -> None:
    M = numbers(1000, 3, 3)
    expected = rotations.special_procrustes(M)
    assert torch.equal(torch.func.vmap(rotations.special_procrustes)(M), expected)
    assert torch.equal(
        torch.func.vmap(rotations.special_procrustes)(M.unflatten(0, (10, 100))).flatten(0, 1),
        expected,
    )
    leaf = M.clone().requires_grad_()
    compiled = torch.compile(rotations.special_procrustes, fullgraph=True, backend="aot_eager")
    weights = numbers(1000, 3, 3)
    (gradient,) = torch.autograd.grad((compiled(leaf) * weights).sum(), leaf)
    (same,) = torch.autograd.grad((rotations.special_procrustes(leaf) * weights).sum(), leaf)
    torch.testing.assert_close(compiled(leaf), expected)
    torch.testing.assert_close(gradient, same, rtol=1e-8, atol=1e-8)


def test_a_batch_in_another_place_and_what_is_not_batched() -> None:
    M, weights = numbers(5, 3, 3), numbers(3, 3)

    def loss(M: Tensor, weights: Tensor) -> Tensor:
        return (rotations.special_procrustes(M) * weights).sum()

    expected = [torch.func.grad(loss)(one, weights) for one in M]
    found = torch.func.vmap(torch.func.grad(loss), (2, None), 1)(M.permute(1, 2, 0), weights)
    torch.testing.assert_close(found, torch.stack(expected, 1))
    many = torch.func.vmap(torch.func.grad(loss), (None, 0))(M[0], numbers(4, 3, 3))
    assert many.shape == (4, 3, 3)
