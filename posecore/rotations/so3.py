"""The group of rotations: distance, mean, uniform samples, and its skew-symmetric matrices."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from posecore.arrays import Array, array_function, fail, require_integer, values_known
from posecore.rotations.conversions import quaternion_to_matrix
from posecore.rotations.procrustes import special_procrustes
from posecore.rotations.validity import (
    blocks,
    departure,
    dot,
    entries,
    many,
    require_rotation,
    surely_rotations,
)

__all__ = ["geodesic_distance", "hat", "mean_rotation", "random_rotations", "vee"]


@array_function(v="... 3")
def hat(v: Array) -> Array:
    """The skew-symmetric matrix of the cross product: `hat(v) @ x = v × x`.

    Args:
        v: (..., 3) any vector.

    Returns:
        (..., 3, 3), with `hat(v).mT = -hat(v)`.
    """
    x, y, z = v.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))


@array_function(S="... 3 3")
def vee(S: Array) -> Array:
    """The vector of a skew-symmetric matrix: `vee(hat(v)) = v`.

    Args:
        S: (..., 3, 3) any matrix; what is symmetric in it is left out.

    Returns:
        (..., 3) the vector of `(S - S^T) / 2`.
    """
    difference = [S[..., i, j] - S[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0))]
    return torch.stack(difference, -1) / 2


@array_function(R_1="... 3 3", R_2="... 3 3")
def geodesic_distance(R_1: Array, R_2: Array) -> Array:
    """The angle of the rotation between two rotations, `R_1^T R_2`.

    For an angle a about a unit axis, `vee(R)` is sin(a) times the axis and the trace 1 + 2 cos(a).
    Both together give the angle to rounding everywhere. The arc cosine of the trace alone does not
    near 0 and pi, where its derivative is infinite. Here the gradient is zero at 0 and pi.

    Args:
        R_1, R_2: (..., 3, 3) rotations.

    Returns:
        (...) radians, from 0 to pi.

    Raises:
        ValueError: if one is not a rotation to 1e-3; its angle would depend on the formula.
    """
    taped = torch.is_grad_enabled() and (R_1.requires_grad or R_2.requires_grad)
    if values_known() and not taped and R_1.shape == R_2.shape and many(R_1):
        angles, sure = _angles_of_many(R_1, R_2)
        if sure:
            return angles
    require_rotation("R_1", R_1)
    require_rotation("R_2", R_2)
    return relative_angle(R_1, R_2)


def relative_angle(R_1: Tensor, R_2: Tensor) -> Tensor:
    """`geodesic_distance` of matrices that have been checked."""
    R_1, R_2 = torch.broadcast_tensors(R_1, R_2)
    # Both in terms of rows, which is several times as fast as the product of many small matrices,
    # and both doubled.
    first, second, third = torch.linalg.cross(R_1, R_2).unbind(-2)
    sine = torch.linalg.vector_norm(first + second + third, dim=-1)
    return torch.atan2(sine, (R_1 * R_2).sum((-2, -1)) - 1)


def _angles_of_many(R_1: Tensor, R_2: Tensor) -> tuple[Tensor, bool]:
    """What `relative_angle` gives, and whether all of them are surely angles of rotations.

    Entry by entry, which is faster forwards, but would be a long way back for gradients.
    """
    angles, departures = [], []
    for pair in zip(blocks(R_1), blocks(R_2), strict=True):
        one, two = (entries(R) for R in pair)
        departures += [departure(one), departure(two)]
        vector = []
        for j, k in ((1, 2), (2, 0), (0, 1)):
            # Products and sums as `torch.linalg.cross` rounds them.
            first, second, third = (
                (b[j] * a[k]).addcmul_(b[k], a[j], value=-1) for a, b in zip(one, two, strict=True)
            )
            vector.append(first.add_(second).add_(third))
        if R_1.dtype == torch.float32:  # rounded once, as by `vector_norm`, but much faster
            sine = dot(vector, vector).double().sqrt_().float()
        else:
            sine = torch.linalg.vector_norm(torch.stack(vector, -1), dim=-1)
        angles.append(torch.atan2(sine, (pair[0] * pair[1]).sum((-2, -1)) - 1))
    return torch.cat(angles).reshape(R_1.shape[:-2]), surely_rotations(departures, 1e-3)


@array_function(R="... N 3 3", weights="... N")
def mean_rotation(R: Array, weights: Array | None = None) -> Array:
    """The rotation with the least weighted sum of squared Frobenius distances to N rotations.

    It is the rotation nearest to their arithmetic mean (the chordal mean).

    Args:
        R: (..., N, 3, 3) rotations.
        weights: (..., N) at least 0, of any sum above 0; equal if not given.

    Returns:
        (..., 3, 3) rotation.

    Raises:
        ValueError: if `R` has matrices that are not rotations to 1e-3, if a weight is negative or
            all are zero, or if the mean is not unique to rounding, as of two rotations half a turn
            apart.

    Source:
        Hartley, Trumpf, Dai, Li 2013, "Rotation Averaging".
    """
    require_rotation("R", R)
    if weights is None:
        M = R.mean(-3)
    else:
        largest = weights.amax(-1, keepdim=True)
        if values_known() and bool(((weights < 0) | (largest == 0)).any()):
            fail("weights", "at least 0 and not all 0", f"the smallest {weights.min().item():g}")
        weights = weights / largest
        M = (weights[..., None, None] * R).sum(-3) / weights.sum(-1)[..., None, None]
    mean = special_procrustes(M)
    if values_known():
        _require_one_mean(M)
    return mean


def _require_one_mean(M: Tensor) -> None:
    # The best and the second-best rotation differ in tr(R^T M) by twice the last two singular
    # values, with the sign of the determinant: see procrustes.
    M = M.detach().to(torch.promote_types(M.dtype, torch.float32))
    s = torch.linalg.svdvals(M)
    gap = s[..., 1] + s[..., 2] * torch.linalg.det(M).sign()
    several = gap < 64 * torch.finfo(s.dtype).eps
    if bool(several.any()):
        fail("R", "rotations with one mean", f"{int(several.sum())} means of several rotations")


def random_rotations(
    *batch: int,
    generator: torch.Generator | np.random.Generator | int,
    dtype: torch.dtype | None = None,
) -> Array:
    """Rotations drawn uniformly: any fixed rotation applied to them leaves their distribution.

    The direction of four normal numbers is a uniform unit quaternion.

    Args:
        batch: the sizes of the batch; none gives a single matrix.
        generator: a torch generator or a seed gives a tensor, on the generator's device; a NumPy
            generator gives an array.
        dtype: of the result; else PyTorch's default for a tensor, float64 for an array.

    Returns:
        (*batch, 3, 3).

    Raises:
        ValueError: if a size or `generator` is no integer of at least 0, or a seed has more than 64
            bits, or `dtype` is one of integers.
    """
    sizes = [require_integer("batch", size, 0) for size in batch]
    if dtype is not None and not (isinstance(dtype, torch.dtype) and dtype.is_floating_point):
        fail("dtype", "a dtype of PyTorch with a decimal point, or None", dtype)
    if isinstance(generator, np.random.Generator):
        q = torch.from_numpy(np.asarray(generator.standard_normal((*sizes, 4))))
        return quaternion_to_matrix(q.to(dtype)).numpy()
    if not isinstance(generator, torch.Generator):
        seed = require_integer("generator", generator, 0, 2**64 - 1)  # what PyTorch takes
        generator = torch.Generator().manual_seed(seed)
    q = torch.randn(*sizes, 4, generator=generator, dtype=dtype, device=generator.device)
    return quaternion_to_matrix(q)
