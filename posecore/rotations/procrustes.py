"""The rotation nearest to a matrix (the special orthogonal Procrustes problem) and its derivative.

Write M = U diag(s_1, s_2, s_3) V^T with rotations U and V and s_1 >= s_2 >= |s_3|: a singular value
decomposition whose last value carries the sign of det M. The nearest rotation is then R = U V^T.

The derivative needs no derivative of U or V, which do not have one where singular values are equal.
P = R^T M is symmetric. Differentiating that, with dR = R hat(omega), gives three linear equations,

    (tr(P) I - P) omega = the axial vector of R^T dM - dM^T R,

whose matrix has the eigenvectors V and the eigenvalues s_2 + s_3, s_1 + s_3, s_1 + s_2.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from posecore.arrays import Array, array_function

__all__ = ["special_procrustes"]

_SMALL_BATCH = 400  # up to here LAPACK, one matrix after the other, is the faster road
_CHUNK = 65536  # matrices at a time, so that their columns stay in the processor's cache
_SWEEPS = {torch.float32: 5, torch.float64: 6}  # one more than any matrix of the tests has needed


@array_function(M="... 3 3")
def special_procrustes(M: Array) -> Array:
    """The rotation nearest to `M` in the Frobenius norm, `U diag(1, 1, det(U V^T)) V^T`.

    The result is a rotation for every finite `M`. Where several are nearest (s_2 + s_3 = 0, as for
    reflections and rank one), it is one of them; the zero matrix gives the identity.

    The gradient is finite everywhere, and can be differentiated again. Its component along
    rotations that are equally near, to eight roundings, is zero. It is inverse to the size of `M`,
    down to the size 1e-24 in float32 and 1e-276 in float64: smaller ones would soon overflow.

    Args:
        M: (..., 3, 3) any matrix, for example nine outputs of a network.

    Returns:
        (..., 3, 3) rotation. Half precision comes back as float32, as it cannot hold a rotation.

    Source:
        Umeyama 1991, Eq. 40, for the sign. Levinson et al. 2020, "An Analysis of SVD for Deep
        Rotation Estimation", for its use as the last layer of a network.
    """
    if M.dtype not in _SWEEPS:
        M = M.float()
    return _Procrustes.apply(M.reshape(-1, 3, 3))[0].reshape(M.shape)


def _full_precision(method: Callable[..., Any]) -> Callable[..., Any]:
    """Switch autocast off: its matrix products have three digits, and a rotation needs all."""

    @functools.wraps(method)
    def wrapper(*args: Any) -> Any:
        device = next(arg.device.type for arg in args if isinstance(arg, Tensor))
        with torch.autocast(device, enabled=False):
            return method(*args)

    return wrapper


def _as_one_batch(function: type[torch.autograd.Function], info: Any, dims: Any, *args: Any) -> Any:
    """What `vmap` makes of a function of batches (n, ...): one longer batch, the same numbers."""
    size = info.batch_size
    whole = [
        arg.expand(size, *arg.shape) if dim is None else arg.movedim(dim, 0)
        for arg, dim in zip(args, dims, strict=True)
    ]
    n = whole[0].shape[1]
    found = function.apply(*[arg.reshape(-1, *arg.shape[2:]) for arg in whole])
    if isinstance(found, Tensor):
        return found.unflatten(0, (size, n)), 0
    return tuple(part.unflatten(0, (size, n)) for part in found), (0,) * len(found)


class _Procrustes(torch.autograd.Function):
    """R of M, and V and the inverse of the pair sums, which its derivative needs."""

    @staticmethod
    @_full_precision
    def forward(M: Tensor) -> tuple[Tensor, Tensor, Tensor]:  # (n, 3, 3)
        number = torch.finfo(M.dtype)
        size = M.abs().amax((1, 2))
        # Jacobi looks at its values for lost columns, and there are none while compiling.
        small = torch.compiler.is_compiling() or len(M) <= _SMALL_BATCH
        solve = _by_lapack if small else _by_jacobi
        R, s, V = solve(M / (size + (size == 0))[:, None, None])
        pair_sums = torch.stack([s[:, 1] + s[:, 2], s[:, 0] + s[:, 2], s[:, 0] + s[:, 1]], 1)
        unique = pair_sums > 8 * number.eps * pair_sums[:, 2:]
        inverse = torch.where(unique, 1 / pair_sums, 0)
        inverse /= size.clamp_min(number.tiny / number.eps**2)[:, None]
        return R, V, inverse

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor], output: tuple[Tensor, ...]) -> None:
        ctx.mark_non_differentiable(*output[1:])
        ctx.save_for_backward(*inputs, *output)

    @staticmethod
    @_full_precision
    def backward(ctx: Any, grad_R: Tensor, *_: Tensor) -> Tensor:
        M, R, V, inverse = ctx.saved_tensors
        X = R.mT @ grad_R
        axial = torch.stack([X[:, i, j] - X[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], 1)
        omega = _Solve.apply(axial, M, R, V, inverse)
        return torch.linalg.cross(R, omega[:, None, :].expand_as(R))  # R hat(omega)

    @staticmethod
    def vmap(info: Any, dims: Any, M: Tensor) -> Any:
        return _as_one_batch(_Procrustes, info, dims, M)


class _Solve(torch.autograd.Function):
    """Solve (tr(P) I - P) omega = axial, P = R^T M; a function, to be differentiated once more."""

    @staticmethod
    @_full_precision
    def forward(axial: Tensor, M: Tensor, R: Tensor, V: Tensor, inverse: Tensor) -> Tensor:
        return (V @ (inverse[..., None] * (V.mT @ axial[..., None])))[..., 0]

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor, ...], output: Tensor) -> None:
        ctx.save_for_backward(*inputs[1:], output)

    @staticmethod
    @_full_precision
    def backward(ctx: Any, grad_omega: Tensor) -> tuple[Tensor, Tensor, Tensor, None, None]:
        M, R, V, inverse, omega = ctx.saved_tensors
        grad_axial = _Solve.apply(grad_omega, M, R, V, inverse)
        inner = (grad_axial * omega).sum(-1)[:, None, None]
        grad_P = grad_axial[:, :, None] * omega[:, None, :] - inner * torch.eye(3).to(M)
        return grad_axial, R @ grad_P, M @ grad_P.mT, None, None

    @staticmethod
    def vmap(info: Any, dims: Any, *args: Tensor) -> Any:
        return _as_one_batch(_Solve, info, dims, *args)


def _by_lapack(M: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """R (n, 3, 3), s (n, 3) and V (n, 3, 3), as the head of the module names them.

    Except that V may be a reflection: its columns count, not their signs.
    """
    U, s, Vh = torch.linalg.svd(M)
    sign = torch.ones_like(s)
    sign[:, 2] = torch.linalg.det(U @ Vh).sign()
    return (U * sign[:, None, :]) @ Vh, s * sign, Vh.mT


def _by_jacobi(M: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The same for many matrices at once, by one-sided Jacobi rotations (Hestenes 1958)."""
    R, s, V = torch.empty_like(M), M.new_empty(len(M), 3), torch.empty_like(M)
    for start in range(0, len(M), _CHUNK):
        part = slice(start, start + _CHUNK)
        R[part], s[part], V[part] = _jacobi_chunk(M[part])
    # Rank one leaves the second column to rounding.
    lost = (s[:, 1] <= torch.finfo(M.dtype).eps * s[:, 0]).nonzero()[:, 0]
    if len(lost):
        R[lost], s[lost], V[lost] = _by_lapack(M[lost])
    return R, s, V


def _jacobi_chunk(M: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    # A column of M over a column of V, which starts as I. The batch lies along the last dimension,
    # so that every operation runs over contiguous numbers.
    work = M.new_zeros(3, 6, len(M))
    work[:, :3] = M.permute(2, 1, 0)
    work[:, 3:] = torch.eye(3).to(M)[:, :, None]
    x, y, z = work
    for _ in range(_SWEEPS[M.dtype]):
        x, y = _make_orthogonal(x, y)
        x, z = _make_orthogonal(x, z)
        y, z = _make_orthogonal(y, z)
    s_1, s_2 = _dot(x, x).sqrt(), _dot(y, y).sqrt()
    u_1, u_2 = x[:3] / s_1, y[:3] / s_2
    u_3 = torch.linalg.cross(u_1, u_2, dim=0)  # never a reflection, whatever the sign of det M
    s_3 = _dot(u_3, z)
    R = u_1[:, None] * x[3:] + u_2[:, None] * y[3:] + u_3[:, None] * z[3:]
    V = torch.stack([x[3:], y[3:], z[3:]])
    return R.permute(2, 0, 1), torch.stack([s_1, s_2, s_3], 1), V.permute(2, 1, 0)


def _make_orthogonal(p: Tensor, q: Tensor) -> tuple[Tensor, Tensor]:
    """Turn two columns (6, n) in their plane until orthogonal, the longer one first."""
    angle = torch.atan2(2 * _dot(p, q), _dot(p, p) - _dot(q, q)).mul_(0.5)
    c, s = angle.cos(), angle.sin()
    return (p * c).addcmul_(q, s), (q * c).addcmul_(p, s, value=-1)


def _dot(p: Tensor, q: Tensor) -> Tensor:
    """The inner product of the first three rows."""
    return (p[0] * q[0]).addcmul_(p[1], q[1]).addcmul_(p[2], q[2])
