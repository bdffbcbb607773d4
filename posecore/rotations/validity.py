"""What counts as a rotation: R R^T = I and det R = +1, to a tolerance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from posecore.arrays import (
    Array,
    array_function,
    fail,
    input_precision,
    require_number,
    values_known,
)

__all__ = ["is_rotation", "require_rotation", "rotation_defect"]

FEW = 512  # matrices up to which fewer calls count for more than fewer passes over memory
BLOCK = 2**15  # of more matrices so many at once: few enough to stay in a processor's cache


@array_function(R="... 3 3")
def rotation_defect(R: Array) -> Array:
    """How far a matrix is from orthonormal: the largest entry of `|R R^T - I|`.

    A reflection has none; `is_rotation` looks at the determinant as well.

    Args:
        R: (..., 3, 3) any matrix.

    Returns:
        (...) at least 0.
    """
    return _defect(R)


@array_function(R="... 3 3")
def is_rotation(R: Array, tolerance: float = 1e-3) -> Array:
    """Which matrices are rotations: `rotation_defect` within `tolerance`, determinant positive.

    Args:
        R: (..., 3, 3) any matrix.
        tolerance: on the entries of `R R^T`; for tensors of half precision at least what their
            digits allow (0.008 for bfloat16).

    Returns:
        (...) booleans.
    """
    tolerance = _tolerance(tolerance)
    return (_defect(R) <= tolerance) & (_determinant(R) > 0)


def require_rotation(name: str, R: Array, tolerance: float = 1e-3) -> None:
    """Refuse matrices that are not rotations, by the rule of `is_rotation`.

    Args:
        name: what the caller's argument is called; the error begins with it.
        R: (..., 3, 3) matrices.
        tolerance: on the entries of `R R^T`.

    Raises:
        ValueError: says how far off the first such matrix is, and where it stands.
    """
    tolerance = _tolerance(tolerance)
    matrices = _to_matrices(name, R)
    if not values_known():
        return
    with torch.autocast(matrices.device.type, enabled=False):
        if many(matrices):
            off = [departure(entries(block)) for block in blocks(matrices)]
            if surely_rotations(off, tolerance):
                return
        defect, determinant = _defect(matrices), _determinant(matrices)
    bad = ~((defect <= tolerance) & (determinant > 0))  # true for NaN as well
    if not bool(bad.any()):
        return
    first = tuple(bad.nonzero()[0].tolist())
    fail(
        name,
        f"rotation matrices to {tolerance:g} (rotations.special_procrustes gives the nearest)",
        f"{int(bad.sum())} of {bad.numel()} that are not, the first with R R^T off by "
        f"{defect[first].item():.3g} and determinant {determinant[first].item():.3g}"
        + (f" at index {first}" if first else ""),
    )


def _tolerance(tolerance: float) -> float:
    # What rounding does to the entries of R R^T: of a million rotations, at most 0.85 of this.
    return max(require_number("tolerance", tolerance, 0), input_precision())


def _to_matrices(name: str, R: Array) -> Tensor:
    if not isinstance(R, Tensor):
        try:
            R = torch.from_numpy(np.array(R, dtype=np.float64))
        except (TypeError, ValueError):
            fail(name, "rotation matrices, shape (..., 3, 3)", type(R).__name__)
    if R.shape[-2:] != (3, 3):
        fail(name, "rotation matrices, shape (..., 3, 3)", f"shape {tuple(R.shape)}")
    return R.detach()


def many(R: Tensor) -> bool:
    """Whether there are so many matrices that they are best taken apart into `entries`."""
    return R.numel() > 9 * FEW and R.is_floating_point()


def blocks(R: Tensor) -> tuple[Tensor, ...]:
    """Matrices (..., 3, 3) one after the other, (n, 3, 3) at a time."""
    return R.reshape(-1, 3, 3).split(BLOCK)


def entries(R: Tensor) -> list[tuple[Tensor, ...]]:
    """The entries of matrices (..., 3, 3), row by row, as nine tensors (...).

    Each lies together in memory. Passes over them are several times as fast as products and sums
    over dimensions of three.
    """
    apart = R.movedim((-2, -1), (0, 1)).contiguous()
    return [row.unbind(0) for row in apart.unbind(0)]


def departure(rows: list[tuple[Tensor, ...]]) -> Tensor:
    """How far matrices, given by their `entries`, are off what defines a rotation by its rows.

    Two are unit vectors at right angles, the third is their cross product. This takes half as many
    passes over memory as `R R^T` and the determinant.

    Returns:
        The largest difference from 1 of a squared length, from 0 of the product of the two rows,
        and of an entry of the third row from that of the cross product.
    """
    first, second, third = rows
    ones = [*dot(first, first).aminmax(), *dot(second, second).aminmax()]
    zeros = [*dot(first, second).aminmax()]
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        rest = torch.addcmul(third[i], first[k], second[j])
        zeros += rest.addcmul_(first[j], second[k], value=-1).aminmax()
    return torch.maximum((torch.stack(ones) - 1).abs().amax(), torch.stack(zeros).abs().amax())


def surely_rotations(departures: list[Tensor], tolerance: float) -> bool:
    """Whether matrices are rotations to a tolerance beyond doubt; if not, they may be all the same.

    With a `departure` of at most e <= 0.1, the entries of `R R^T` are off by at most 6 e + 8 e^2,
    which is less than 8 e, and the determinant is positive.
    """
    # The roundings of a departure come to less than four of those of a number near 1.
    limit = min(tolerance / 8, 0.1) - 4 * torch.finfo(departures[0].dtype).eps
    return bool((torch.stack(departures) <= limit).all())  # False for NaN as well


def dot(u: Sequence[Tensor], v: Sequence[Tensor]) -> Tensor:
    """The products of vectors whose components are given one by one."""
    return (u[0] * v[0]).addcmul_(u[1], v[1]).addcmul_(u[2], v[2])


def _defect(R: Tensor) -> Tensor:
    return (R @ R.mT - torch.eye(3).to(R)).abs().flatten(-2).amax(-1)


def _determinant(R: Tensor) -> Tensor:
    return (torch.linalg.cross(R[..., 0, :], R[..., 1, :]) * R[..., 2, :]).sum(-1)
