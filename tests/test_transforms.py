"""Cameras, poses, metrics and look-ups under `vmap`, `jacrev` and `torch.compile`.

Rotations have theirs in `rotations/test_transforms.py`. What searches for values, the nearest point
or the best symmetry over all points, is not among them.
"""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from posecore import cameras, clouds, metrics, poses, rotations

# PyTorch's compiler does what PyTorch's autograd warns of.
pytestmark = [
    pytest.mark.filterwarnings("ignore:.*should not be instantiated:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:There is a performance drop:UserWarning"),  # embedding_bag
]

GENERATOR = torch.Generator().manual_seed(0)


def numbers(*shape: int) -> Tensor:
    return torch.randn(*shape, generator=GENERATOR, dtype=torch.float64)


AWAY = torch.tensor([0.0, 0.0, 9.0], dtype=torch.float64)
R_1, R_2 = rotations.random_rotations(2, 3, generator=0, dtype=torch.float64)
POSES = (R_1, numbers(3, 3) + AWAY, R_2, numbers(3, 3) + AWAY)
K = torch.tensor([[100.0, 2, 30], [0, 90, 20], [0, 0, 1]], dtype=torch.float64).repeat(3, 1, 1)
POINTS, MODEL, SIZE = numbers(3, 7, 3), numbers(7, 3), numbers(3, 3).abs() + 0.5
SYMMETRIES = torch.diag_embed(torch.tensor([[1.0, 1, 1, 1], [-1, -1, 1, 1]]).double())
INDICES = torch.tensor([[0, 6, 6, 2], [1, 1, 0, 3], [5, 4, 3, 2]])

SAME: dict[str, tuple[Callable, tuple[Tensor, ...]]] = {
    "project": (cameras.project, (K, POINTS + AWAY)),
    "back_project": (cameras.back_project, (numbers(3, 4, 6).abs(), K)),
    "crop_intrinsics": (cameras.crop_intrinsics, (K, numbers(3), numbers(3))),
    "resize_intrinsics": (lambda K: cameras.resize_intrinsics(K, (64, 48), (32, 30)), (K,)),
    "crop_and_resize_intrinsics": (
        lambda K, box: cameras.crop_and_resize_intrinsics(K, box, (32, 30)),
        (K, numbers(3, 4).abs() + 1),
    ),
    "apply": (poses.apply, (R_1, numbers(3, 3), POINTS, numbers(3))),
    "compose": (poses.compose, POSES),
    "invert": (poses.invert, POSES[:2]),
    "relative": (poses.relative, POSES),
    "to_matrix": (poses.to_matrix, POSES[:2]),
    "from_matrix": (poses.from_matrix, (poses.to_matrix(*POSES[:2]),)),
    "add": (metrics.add, (*POSES, POINTS)),
    "mssd": (lambda *pair: metrics.mssd(*pair, MODEL), POSES),
    "mspd": (lambda *pair: metrics.mspd(*pair, MODEL), (K, *POSES)),
    "projection_2d": (metrics.projection_2d, (K, *POSES, POINTS)),
    "rotation_error": (lambda *pair: metrics.rotation_error(*pair, SYMMETRIES), (R_1, R_2)),
    "axis_error": (lambda *pair: metrics.axis_error(*pair, MODEL[0]), (R_1, R_2)),
    "translation_error": (metrics.translation_error, POSES[1::2]),
    "closest_symmetry": (
        lambda *pair: metrics.closest_symmetry(*pair, SYMMETRIES),
        (R_1, R_2, POSES[3]),
    ),
    "box_corners": (metrics.box_corners, (*POSES[:2], SIZE)),
    "nocs_legacy_iou": (metrics.nocs_legacy_iou, (*POSES[:2], SIZE, R_2, POSES[1] + 0.01, SIZE)),
    "angle_difference": (metrics.angle_difference, (numbers(3), numbers(3))),
    "gather_points": (clouds.gather_points, (POINTS, INDICES)),
    "interpolate": (
        clouds.interpolate,
        (numbers(3, 7, 2), INDICES[..., None], numbers(3, 4, 1)),
    ),
}
each = pytest.mark.parametrize(("function", "args"), SAME.values(), ids=SAME)


def parts(result: object) -> tuple[Tensor, ...]:
    return tuple(result) if isinstance(result, tuple) else (result,)


@each
def test_vmap_gives_the_batched_values(function: Callable, args: tuple[Tensor, ...]) -> None:
    found = torch.func.vmap(function)(*args)
    for one, other in zip(parts(found), parts(function(*args)), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
@each
def test_one_graph_gives_the_same(function: Callable, args: tuple[Tensor, ...]) -> None:
    compiled = torch.compile(function, fullgraph=True, backend="aot_eager")
    for one, other in zip(parts(compiled(*args)), parts(function(*args)), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-12, atol=1e-12)


@each
def test_jacobians_are_those_of_each_row(function: Callable, args: tuple[Tensor, ...]) -> None:
    free = tuple(i for i, arg in enumerate(args) if arg.is_floating_point())

    def flat(*row: Tensor) -> Tensor:
        return torch.cat([part.flatten() for part in parts(function(*row))])

    found = torch.func.vmap(torch.func.jacrev(flat, argnums=free))(*args)
    for i, row in enumerate(zip(*args, strict=True)):

        def of_free(*values: Tensor, row: tuple[Tensor, ...] = row) -> Tensor:
            mixed = list(row)
            for place, value in zip(free, values, strict=True):
                mixed[place] = value
            return flat(*mixed)

        expected = torch.autograd.functional.jacobian(of_free, tuple(row[j] for j in free))
        for one, other in zip(found, expected, strict=True):
            torch.testing.assert_close(one[i], other, rtol=1e-10, atol=1e-10)


def test_what_is_wrong_is_refused_where_values_are_known() -> None:
    for call, name in [
        (lambda: cameras.project(K, POINTS - AWAY), "points"),
        (lambda: poses.from_matrix(2 * poses.to_matrix(*POSES[:2])), "T"),
        (lambda: clouds.gather_points(POINTS, INDICES + 1), "indices"),
        (lambda: metrics.axis_error(R_1, R_2, 0 * MODEL[0]), "axis"),
    ]:
        with pytest.raises(ValueError, match=f"^{name}: "):
            call()
    # Nothing to look at: what is behind the camera has a mirrored pixel, as without the check.
    mirrored = torch.func.vmap(cameras.project)(K, POINTS - AWAY)
    assert mirrored.shape == (3, 7, 2)
