"""The losses of the rotation-invariant paper, Eq. 4 to 18, each by itself.

What the paper leaves open is said here, and is an argument of `TotalLoss`:

- Sums over points and faces (Eq. 8, 10, 13 to 15) are means, and so is everything over a batch:
  512 points and 6 faces beside weights of 1 and 8 would leave nothing of the others.
- An L1 norm is the sum over the three coordinates.
- Of symmetric things, where a turn about y means nothing, the x axis is not asked.

B clouds of N points; R, t and sizes in the frame and relative to the means in which clouds come.

Source: Chen et al., the rotation-invariant paper, Section 3.3; Di et al., "GPV-Pose", CVPR 2022.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from posecore.arrays import require_choice, require_number
from posecore.methods.invariant_gcn.faces import face_distances, outward_normals
from posecore.registration import Plane

__all__ = [
    "REDUCTIONS",
    "axis_loss",
    "canonical_loss",
    "centre_plane_loss",
    "confidence_loss",
    "consistency_loss",
    "face_confidence_loss",
    "face_loss",
    "plane_normal_loss",
    "reconstruction_loss",
    "reduced",
    "size_loss",
    "size_plane_loss",
    "translation_loss",
]

REDUCTIONS = ("mean", "sum")
"""Over points and faces."""


def reduced(values: Tensor, reduction: str) -> Tensor:
    """(B, ...) to one number: the mean over B of the mean or the sum of the rest.

    Raises:
        ValueError: for another reduction.
    """
    require_choice("reduction", reduction, REDUCTIONS)
    rest = values.flatten(1)
    return (rest.mean(1) if reduction == "mean" else rest.sum(1)).mean()


def axis_loss(x: Tensor, y: Tensor, R: Tensor, symmetric: Tensor) -> Tensor:
    """Eq. 4: |r_x^gt - r_x|_1 + |r_y^gt - r_y|_1, mean over the batch.

    Args:
        x, y: (B, 3) the axes that were said.
        R: (B, 3, 3) the true rotations.
        symmetric: (B,) bool, of which the first term is 0.
    """
    first = (x - R[:, :, 0]).abs().sum(-1) * ~symmetric
    return (first + (y - R[:, :, 1]).abs().sum(-1)).mean()


def translation_loss(t: Tensor, true: Tensor) -> Tensor:
    """Eq. 5: |t^gt - t|_1, mean over the batch; (B, 3) metres both."""
    return (t - true).abs().sum(-1).mean()


def size_loss(size: Tensor, true: Tensor) -> Tensor:
    """Eq. 6: |s^gt - s|_1, mean over the batch; (B, 3) metres both."""
    return (size - true).abs().sum(-1).mean()


def consistency_loss(
    points: Tensor, R: Tensor, t: Tensor, canonical: Tensor, reduction: str = "mean"
) -> Tensor:
    """Eq. 8, of the points that were seen: sum over p of |R^T (p - t) - p^c|_1.

    The paper calls p the predicted points. Then it would ask nothing of R and t that the network
    could not make up for in p; with the points that were seen it binds rotation and translation.

    Args:
        points: (B, N, 3) metres, seen.
        R: (B, 3, 3), t: (B, 3) metres, the pose that was said.
        canonical: (B, N, 3) metres, where the points are on the object.
        reduction: one of `REDUCTIONS`.
    """
    return reduced(((points - t[:, None]) @ R - canonical).abs().sum(-1), reduction)


def reconstruction_loss(
    said: Tensor, canonical: Tensor, size: Tensor, reduction: str = "mean"
) -> Tensor:
    """Eq. 8, of the branch that says points: sum over p of |p - p^c|_1, over the box's diagonal.

    Args:
        said: (B, N, 3) over the diagonal.
        canonical: (B, N, 3) metres.
        size: (B, 3) metres, true.
        reduction: one of `REDUCTIONS`.
    """
    return reduced((said - _over_diagonal(canonical, size)).abs().sum(-1), reduction)


def canonical_loss(
    said: Tensor, confidence: Tensor, canonical: Tensor, size: Tensor, width: float = 0.06
) -> Tensor:
    """Whether points know how good their canonical coordinate is; not in the paper.

    Cross-entropy of the confidence and exp(-(error / width)^2), mean over points and batch.

    Args:
        said: (B, N, 3) over the diagonal; no gradient flows there.
        confidence: (B, N) before a sigmoid.
        canonical: (B, N, 3) metres.
        size: (B, 3) metres, true.
        width: of the error, over the diagonal.

    Raises:
        ValueError: if `width` is not above 0.
    """
    require_number("width", width, above=0)
    error = (said.detach() - _over_diagonal(canonical, size)).norm(dim=-1)
    return F.binary_cross_entropy_with_logits(confidence, torch.exp(-(error / width).square()))


def face_confidence_loss(
    normals: Tensor, distances: Tensor, confidences: Tensor, points: Tensor, R: Tensor, t: Tensor,
    size: Tensor, *, a: float = 1 / 303.5, squared: bool = True, detach: bool = True,
    reduction: str = "mean",
) -> Tensor:  # fmt: skip
    """Eq. 10: sum over points and faces of |c - exp(-|d n - f r^gt|^2 / a)|.

    Printed without the square, which stands in GPV-Pose: a is in square metres then, and 1 / a of
    303.5 makes 5 cm a confidence of 0.47.

    Args:
        normals: (B, N, 6, 3), distances: (B, N, 6) metres, confidences: (B, N, 6), that were said.
        points: (B, N, 3) metres, seen.
        R: (B, 3, 3), t: (B, 3), size: (B, 3), true.
        a: in square metres, or in metres without the square.
        squared: False for the equation as it is printed.
        detach: whether the confidence alone learns; else an error may grow to fit a confidence.
        reduction: one of `REDUCTIONS`.

    Raises:
        ValueError: if `a` is not above 0, or for another reduction.
    """
    require_number("a", a, above=0)
    off = _face_offsets(normals, distances, points, R, t, size)
    off = off.detach() if detach else off
    error = off.square().sum(-1) if squared else torch.linalg.vector_norm(off, dim=-1)
    return reduced((confidences - torch.exp(-error / a)).abs(), reduction)


def face_loss(
    normals: Tensor, distances: Tensor, points: Tensor, R: Tensor, t: Tensor, size: Tensor,
    unit: float = 1.0, reduction: str = "mean",
) -> Tensor:  # fmt: skip
    """The L1 loss on n and d that the paper announces beside Eq. 10, and leaves out of Eq. 17.

    Sum over points and faces of |n - r^gt|_1 + |d - f|; arguments as of `face_confidence_loss`.

    Args:
        normals, distances, points, R, t, size: as said.
        unit: metres that count as one.
        reduction: one of `REDUCTIONS`.
    """
    wrong = (normals - outward_normals(R)[:, None]).abs().sum(-1)
    far = (distances - face_distances(points, R, t, size)).abs() / unit
    return reduced(wrong + far, reduction)


def plane_normal_loss(
    planes: Plane, R: Tensor, symmetric: Tensor, reduction: str = "mean"
) -> Tensor:
    """Eq. 13: sum over faces of |r'_i - N_i|_1, r' = +-r_x, +-r_y, +-r_z of the pose that was said.

    Args:
        planes: N (B, 6, 3), outward, and D.
        R: (B, 3, 3) said.
        symmetric: (B,) bool, of which only the faces along y count.
        reduction: one of `REDUCTIONS`.
    """
    wrong = (outward_normals(R) - planes.normal).abs().sum(-1)  # (B, 6)
    along_y = torch.tensor([False, True, False] * 2, device=wrong.device)
    return reduced(wrong * (along_y | ~symmetric[:, None]), reduction)


def centre_plane_loss(planes: Plane, t: Tensor, reduction: str = "mean") -> Tensor:
    """Eq. 14: sum over x, y, z of ||N+^T t - D+| - |N-^T t - D-||: t is in the middle.

    Args:
        planes: N (B, 6, 3) and D (B, 6), metres.
        t: (B, 3) metres, said.
        reduction: one of `REDUCTIONS`.
    """
    plus, minus = _plane_distances(planes, t).split(3, -1)
    return reduced((plus - minus).abs(), reduction)


def size_plane_loss(planes: Plane, t: Tensor, size: Tensor, reduction: str = "mean") -> Tensor:
    """Eq. 15: sum over faces of |s_i / 2 - |N_i^T t - D_i||.

    Args:
        planes: N (B, 6, 3) and D (B, 6), metres.
        t: (B, 3), size: (B, 3) metres, said.
        reduction: one of `REDUCTIONS`.
    """
    half = torch.cat([size, size], -1) / 2
    return reduced((half - _plane_distances(planes, t)).abs(), reduction)


def confidence_loss(
    x: Tensor, y: Tensor, x_confidence: Tensor, y_confidence: Tensor, R: Tensor,
    symmetric: Tensor, *, b: float = 13.7, detach: bool = True,
) -> Tensor:  # fmt: skip
    """Eq. 16: sum over x, y of |c_i - exp(-b |r_i - r_i^gt|^2)|, mean over the batch.

    Args:
        x, y: (B, 3), x_confidence, y_confidence: (B,), that were said.
        R: (B, 3, 3) true.
        symmetric: (B,) bool, of which the term of x is 0.
        b: above 0.
        detach: whether the confidences alone learn.

    Raises:
        ValueError: if `b` is not above 0.
    """
    require_number("b", b, above=0)
    terms = []
    for i, (axis, confidence) in enumerate(((x, x_confidence), (y, y_confidence))):
        error = (axis - R[:, :, i]).square().sum(-1)
        terms.append((confidence - torch.exp(-b * (error.detach() if detach else error))).abs())
    return (terms[0] * ~symmetric + terms[1]).mean()


def _face_offsets(
    normals: Tensor, distances: Tensor, points: Tensor, R: Tensor, t: Tensor, size: Tensor
) -> Tensor:
    """(B, N, 6, 3) d n - f r^gt."""
    true = face_distances(points, R, t, size)[..., None] * outward_normals(R)[:, None]
    return distances[..., None] * normals - true


def _plane_distances(planes: Plane, t: Tensor) -> Tensor:
    """(B, 6) |N^T t - D|."""
    return ((planes.normal * t[:, None]).sum(-1) - planes.offset).abs()


def _over_diagonal(canonical: Tensor, size: Tensor) -> Tensor:
    return canonical / torch.linalg.vector_norm(size, dim=-1)[:, None, None]
