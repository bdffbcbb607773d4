"""Lenses that bend straight lines: radial and tangential distortion, as OpenCV has it.

The ray of a point (X, Y, Z) is (x, y) = (X, Y) / Z, and r^2 = x^2 + y^2. The lens bends it to

    x' = x f + 2 p1 x y + p2 (r^2 + 2 x^2),  y' = y f + p1 (r^2 + 2 y^2) + 2 p2 x y,
    f = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6),

and it is seen at the pixel K (x', y', 1) (Brown 1966, "Decentering Distortion of Lenses"; the
numerator and p1, p2 are Conrady's and Brown's, the denominator is OpenCV's rational model). The
coefficients stand in OpenCV's order, k1 k2 p1 p2 [k3 [k4 k5 k6]], in all functions here.

Such polynomials are fitted to what the picture shows. Farther out they turn round, so that rays far
outside would be drawn into the picture, on top of others. A lens does no such thing: those are
*beyond* it here, and are refused, or infinite, as points behind the camera are.

All other functions of this library are of pinhole cameras. What was seen through a lens goes
through `undistort_points` first; a whole picture through `cv2.undistort`, and has no distortion
then.
"""

from __future__ import annotations

import torch
from torch import Tensor

from posecore.arrays import Array, array_function, fail, require_choice, somewhere, values_known
from posecore.cameras import require_intrinsics

__all__ = ["distort_points", "project_distorted", "undistort_points"]

LENGTHS = (4, 5, 8)  # of the coefficients
MOST = 100  # steps of Newton's method; 4 are usual, near the rim half steps are taken
CLOSE = 1e-12  # relative; rays so near to the one that was asked for are that one


@array_function(points="... N 2", K="... 3 3", distortion="... D")
def distort_points(points: Array, K: Array, distortion: Array, beyond: str = "refuse") -> Array:
    """Where the lens shows what a pinhole camera would see at some pixels.

    Args:
        points: (..., N, 2) pixels of the pinhole camera. With the identity for `K`, rays (x, y).
        K: (..., 3, 3) camera matrix.
        distortion: (..., D) with D of 4, 5 or 8: k1, k2, p1, p2, then k3, then k4, k5, k6.
        beyond: what to do with points that the lens cannot see: "refuse", or "inf": both their
            coordinates become +inf and they pass no gradient.

    Returns:
        (..., N, 2) pixels.

    Raises:
        ValueError: if `K` is no camera matrix, there are not 4, 5 or 8 coefficients, or `beyond` is
            "refuse" and a point is beyond the lens.
    """
    require_intrinsics("K", K)
    _require_distortion(distortion)
    require_choice("beyond", beyond, ("refuse", "inf"))
    bent, unseen = _seen(_rays(points, K), distortion)
    if beyond == "refuse":
        _refuse(unseen)
    return _pixels(bent, K).masked_fill(unseen, torch.inf)


@array_function(points="... N 2", K="... 3 3", distortion="... D")
def undistort_points(points: Array, K: Array, distortion: Array, beyond: str = "refuse") -> Array:
    """Where a pinhole camera would see what the lens shows at some pixels: `distort_points` undone.

    There is no formula for it. Newton's method in float64, with steps that stay where the lens is
    one to one; what it finds is distorted again, and counts only if that is the pixel asked for.
    (`cv2.undistortPoints` iterates a few times and returns what it has.)

    Args:
        points: (..., N, 2) pixels of the picture as it was taken. With the identity for `K`, rays.
        K: (..., 3, 3) camera matrix.
        distortion: (..., D) with D of 4, 5 or 8: k1, k2, p1, p2, then k3, then k4, k5, k6.
        beyond: what to do with pixels to which the lens leads no ray: "refuse", or "inf": both
            their coordinates become +inf and they pass no gradient.

    Returns:
        (..., N, 2) pixels. Gradients flow to all three arguments.

    Raises:
        ValueError: if `K` is no camera matrix, there are not 4, 5 or 8 coefficients, or `beyond` is
            "refuse" and for a pixel no ray is found.
    """
    require_intrinsics("K", K)
    _require_distortion(distortion)
    require_choice("beyond", beyond, ("refuse", "inf"))
    wanted, exact = _rays(points.double(), K.double()), distortion.double()
    with torch.no_grad():
        rays, unseen = _solve(wanted, exact)
    if beyond == "refuse" and somewhere(unseen):
        got = f"{int(unseen.sum())} of {unseen.numel()} for which none is found"
        fail("points", "pixels to which a ray leads through the lens", got)
    # A last step of Newton's method, through which gradients find what the answer depends on.
    bent, jacobian = _bend(rays, exact)
    rays = rays - _divide(jacobian.detach(), bent - wanted)
    return _pixels(rays, K.double()).to(points.dtype).masked_fill(unseen, torch.inf)


@array_function(K="... 3 3", points="... N 3", distortion="... D")
def project_distorted(K: Array, points: Array, distortion: Array, behind: str = "refuse") -> Array:
    """Where points of the camera frame appear in the picture of a lens: `cameras.project` with it.

    Args:
        K: (..., 3, 3) camera matrix.
        points: (..., N, 3) points in the camera frame.
        distortion: (..., D) with D of 4, 5 or 8: k1, k2, p1, p2, then k3, then k4, k5, k6.
        behind: what to do with points that are not in front of the camera (z <= 0), or beyond the
            lens: "refuse", or "inf": both their coordinates become +inf and they pass no gradient.

    Returns:
        (..., N, 2) pixel coordinates (x, y).

    Raises:
        ValueError: if `K` is no camera matrix, there are not 4, 5 or 8 coefficients, or `behind` is
            "refuse" and a point has z <= 0 or is beyond the lens.
    """
    require_intrinsics("K", K)
    _require_distortion(distortion)
    require_choice("behind", behind, ("refuse", "inf"))
    z = points[..., 2:]
    hidden = z <= 0
    if behind == "refuse" and somewhere(hidden):
        fail("points", "z > 0 everywhere", f"{int(hidden.sum())} of {hidden.numel()} with z <= 0")
    bent, unseen = _seen(points[..., :2] / torch.where(hidden, 1, z), distortion)
    if behind == "refuse":
        _refuse(unseen)
    return _pixels(bent, K).masked_fill(hidden | unseen, torch.inf)


def _require_distortion(distortion: Tensor) -> None:
    if distortion.shape[-1] not in LENGTHS:
        expected = "4, 5 or 8 coefficients: k1 k2 p1 p2 [k3 [k4 k5 k6]]"
        fail("distortion", expected, f"shape {tuple(distortion.shape)}")


def _refuse(unseen: Tensor) -> None:
    if somewhere(unseen):
        got = f"{int(unseen.sum())} of {unseen.numel()} beyond it, where its formula turns round"
        fail("points", "points that the lens can see", got)


def _rays(pixels: Tensor, K: Tensor) -> Tensor:
    """(..., N, 2) of pixels (..., N, 2)."""
    y = (pixels[..., 1] - K[..., 1, 2, None]) / K[..., 1, 1, None]
    x = pixels[..., 0] - K[..., 0, 2, None] - K[..., 0, 1, None] * y
    return torch.stack([x / K[..., 0, 0, None], y], -1)


def _pixels(rays: Tensor, K: Tensor) -> Tensor:
    return rays @ K[..., :2, :2].mT + K[..., None, :2, 2]


def _coefficients(distortion: Tensor) -> tuple[Tensor, Tensor, tuple[Tensor, Tensor]]:
    """1, k1, k2, k3; 1, k4, k5, k6, both (..., 4); and p1 and p2."""
    padded = torch.nn.functional.pad(distortion, (0, 8 - distortion.shape[-1]))
    one = torch.ones_like(padded[..., :1])
    above = torch.cat([one, padded[..., [0, 1, 4]]], -1)
    return above, torch.cat([one, padded[..., 5:]], -1), (padded[..., 2], padded[..., 3])


def _bend(rays: Tensor, distortion: Tensor) -> tuple[Tensor, Tensor]:
    """The rays behind the lens, (..., N, 2), and their derivative, symmetric: (..., N, 3).

    The three are dx'/dx, dx'/dy = dy'/dx and dy'/dy.
    """
    above, below, (p_1, p_2) = _coefficients(distortion[..., None, :])
    x, y = rays.unbind(-1)
    s = x * x + y * y
    f, slope = _quotient(above, below, s)
    x_bent = x * f + 2 * p_1 * x * y + p_2 * (s + 2 * x * x)
    y_bent = y * f + p_1 * (s + 2 * y * y) + 2 * p_2 * x * y
    both = 2 * (p_1 * x + p_2 * y)
    jacobian = [
        f + 2 * x * x * slope + 2 * p_1 * y + 6 * p_2 * x,
        2 * x * y * slope + both,
        f + 2 * y * y * slope + 6 * p_1 * y + 2 * p_2 * x,
    ]
    return torch.stack([x_bent, y_bent], -1), torch.stack(jacobian, -1)


def _quotient(above: Tensor, below: Tensor, s: Tensor) -> tuple[Tensor, Tensor]:
    """A quotient of two polynomials of s, (..., 4) coefficients each, and its derivative."""
    values = []
    for a in (above, below):
        value = a[..., 0] + s * (a[..., 1] + s * (a[..., 2] + s * a[..., 3]))
        values += [value, a[..., 1] + s * (2 * a[..., 2] + s * 3 * a[..., 3])]
    n, n_slope, d, d_slope = values
    return n / d, (n_slope - n / d * d_slope) / d


def _seen(rays: Tensor, distortion: Tensor) -> tuple[Tensor, Tensor]:
    """The rays behind the lens, and which are beyond it, (..., N, 1)."""
    with torch.no_grad():
        bent, jacobian = _bend(rays, distortion)
        unseen = ~_within(rays, bent, jacobian, _limit(distortion)[..., None])[..., None]
    # What overflows there must not meet a gradient either.
    return _bend(rays.masked_fill(unseen, 0), distortion)[0], unseen


def _within(rays: Tensor, bent: Tensor, jacobian: Tensor, limit: Tensor) -> Tensor:
    """Whether the lens is one to one up to here; False for what is no number."""
    a, b, d = jacobian.unbind(-1)
    return (rays.square().sum(-1) < limit) & (a * d > b * b) & torch.isfinite(bent).all(-1)


def _limit(distortion: Tensor) -> Tensor:
    """The squared radius (...) at which the radial part turns round or has a pole; may be infinite.

    With numerator n and denominator d, polynomials of s = r^2, the derivative of r n / d has the
    sign of n d + 2 s (n' d - n d'), of degree 6 and 1 at s = 0. The first positive zero is the
    largest one of the polynomial of 1 / s: a positive eigenvalue of its companion matrix.
    """
    above, below, _ = _coefficients(distortion.detach().double())
    turns = [
        sum(
            above[..., i] * below[..., m - i] * (2 * i + 1 - 2 * (m - i))
            for i in range(max(0, m - 3), min(3, m) + 1)
        )
        for m in range(1, 7)
    ]
    none = torch.zeros_like(turns[0])
    poles = [*below[..., 1:].unbind(-1), none, none, none]
    first = -torch.stack([torch.stack(turns, -1), torch.stack(poles, -1)], -2)[..., None, :]
    rest = torch.eye(6).to(none)[:5].expand(*first.shape[:-2], 5, 6)
    companion = torch.cat([first, rest], -2)
    roots = torch.linalg.eigvals(companion).flatten(-2)
    real = roots.imag.abs() <= 1e-9 * roots.real.abs()
    return 1 / torch.where(real, roots.real, 0).amax(-1).clamp(min=0)


def _solve(wanted: Tensor, distortion: Tensor) -> tuple[Tensor, Tensor]:
    """The rays that the lens bends to those wanted, and for which there are none, (..., N, 1)."""
    shape = torch.broadcast_shapes(wanted.shape, (*distortion.shape[:-1], 1, 1))
    wanted, limit = wanted.expand(shape), _limit(distortion)[..., None]
    rays = torch.zeros_like(wanted)  # along the optical axis, where every lens is one to one
    bent, jacobian = _bend(rays, distortion)
    error = (bent - wanted).norm(dim=-1)
    share = torch.ones_like(error)
    enough = CLOSE * (1 + wanted.norm(dim=-1))
    for _ in range(MOST):
        if values_known() and bool((error <= enough).all()):
            break
        step = _divide(jacobian, bent - wanted)
        tried = rays - share[..., None] * step
        tried_bent, tried_jacobian = _bend(tried, distortion)
        tried_error = (tried_bent - wanted).norm(dim=-1)
        better = _within(tried, tried_bent, tried_jacobian, limit) & (tried_error < error)
        rays, bent, jacobian = (
            torch.where(better[..., None], new, old)
            for new, old in ((tried, rays), (tried_bent, bent), (tried_jacobian, jacobian))
        )
        error = torch.where(better, tried_error, error)
        share = torch.where(better, (2 * share).clamp(max=1), share / 4)
    return rays, ~(error <= enough)[..., None]


def _divide(jacobian: Tensor, difference: Tensor) -> Tensor:
    """The inverse of symmetric matrices, by their three entries, times vectors (..., 2)."""
    a, b, d = jacobian.unbind(-1)
    x, y = difference.unbind(-1)
    return torch.stack([d * x - b * y, a * y - b * x], -1) / (a * d - b * b)[..., None]
