"""What counts as a rotation: R R^T = I and det R = +1, to a tolerance."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from posecore.arrays import Array, array_function, fail, require_number, values_known

__all__ = ["is_rotation", "require_rotation", "rotation_defect"]


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
        tolerance: on the entries of `R R^T`.

    Returns:
        (...) booleans.
    """
    require_number("tolerance", tolerance, 0)
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
    require_number("tolerance", tolerance, 0)
    matrices = _to_matrices(name, R)
    if not values_known():
        return
    with torch.autocast(matrices.device.type, enabled=False):
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


def _to_matrices(name: str, R: Array) -> Tensor:
    if not isinstance(R, Tensor):
        try:
            R = torch.from_numpy(np.array(R, dtype=np.float64))
        except (TypeError, ValueError):
            fail(name, "rotation matrices, shape (..., 3, 3)", type(R).__name__)
    if R.shape[-2:] != (3, 3):
        fail(name, "rotation matrices, shape (..., 3, 3)", f"shape {tuple(R.shape)}")
    return R.detach()


def _defect(R: Tensor) -> Tensor:
    return (R @ R.mT - torch.eye(3).to(R)).abs().flatten(-2).amax(-1)


def _determinant(R: Tensor) -> Tensor:
    return (torch.linalg.cross(R[..., 0, :], R[..., 1, :]) * R[..., 2, :]).sum(-1)
