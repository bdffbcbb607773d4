"""Chapter 8's last exercises: covariances, overlaps and symmetric objects."""

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from book.ch08_vector_fields import checks
from posecore import cameras, rotations
from tests.book.exercises import Solutions

SOLUTIONS = Solutions()
right, wrong = SOLUTIONS.right, SOLUTIONS.wrong


# 4. The mean and the covariance -------------------------------------------------------------------


@right("mean_and_covariance")
def covariance_one_by_one(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    pairs = [(w.item(), h) for w, h in zip(weights, points, strict=True) if w > 0]
    if not pairs:
        raise ValueError("no weights")
    total = sum(w for w, _ in pairs)
    mean = sum(w * h for w, h in pairs) / total
    return mean, sum(w * torch.outer(h - mean, h - mean) for w, h in pairs) / total


@right("mean_and_covariance")
def covariance_by_numpy(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    some = weights > 0
    if not some.any():
        raise ValueError("no weights")
    mean = np.average(points[some], axis=0, weights=weights[some])
    C = np.cov(points[some].double().T, aweights=weights[some], ddof=0)
    return torch.from_numpy(mean).to(points), torch.from_numpy(C).to(points)


def _covariance(
    points: Any, weights: Any, w_mean: Any = None, divide: Any = lambda w: w.sum()
) -> tuple[Tensor, Tensor]:
    points, weights = points[weights > 0], weights[weights > 0].to(points)
    if not len(weights):
        raise ValueError("no weights")
    w_mean = weights if w_mean is None else w_mean(weights)
    mean = w_mean @ points / w_mean.sum()
    off = points - mean
    return mean, (weights[:, None] * off).T @ off / divide(weights)


@wrong(
    "mean_and_covariance",
    "four corners of a square, equal weights",
    "got array (2, 2) [[1.3333, 0.], [0., 1.3333",
)
def covariance_of_samples(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    return _covariance(points, weights, divide=lambda w: w.sum() - 1)


@wrong(
    "mean_and_covariance", "weights that sum to 1", "got array (2, 2) [[0.24, -0.02], [-0.02, 0.2"
)
def covariance_by_count(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    return _covariance(points, weights, divide=len)


@wrong("mean_and_covariance", "weights that sum to 1", "got array (2,) [1., 1.]")
def covariance_about_the_plain_mean(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    return _covariance(points, weights, w_mean=torch.ones_like)


@wrong("mean_and_covariance", "weights that sum to 1", "got array (2,) [1., 1.]")
def covariance_without_weights(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    return _covariance(points, torch.ones_like(weights))


@wrong("mean_and_covariance", "rays that did not meet, of weight 0", "got array (2,) [nan, nan]")
def covariance_with_nan(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    if not (weights > 0).any():
        raise ValueError("no weights")
    w = (weights / weights.sum()).to(points)
    mean = w @ points
    return mean, (w[:, None] * (points - mean)).T @ (points - mean)


@wrong("mean_and_covariance", "float32, all to 0.1 px", "got array (2, 2) [[0., 0.], [0., 0.]]")
def covariance_by_squares(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    points, weights = points[weights > 0], weights[weights > 0]
    if not len(weights):
        raise ValueError("no weights")
    w = (weights / weights.sum()).to(points)
    mean = w @ points
    return mean, (w[:, None] * points).T @ points - torch.outer(mean, mean)


@wrong("mean_and_covariance", "weights that are all 0", "expected a ValueError")
def covariance_of_nothing_is_nan(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    points, weights = points[weights > 0], weights[weights > 0].to(points)
    mean = weights @ points / weights.sum()
    return mean, (weights[:, None] * (points - mean)).T @ (points - mean) / weights.sum()


@wrong(
    "mean_and_covariance", "weights that are whole numbers, as counts are", "it raised RuntimeError"
)
def covariance_of_whole_weights_fails(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    some = weights > 0
    if not some.any():
        raise ValueError("no weights")
    mean = weights[some] @ points[some] / weights.sum()
    off = points[some] - mean
    return mean, (weights[some, None] * off).T @ off / weights.sum()


@wrong("mean_and_covariance", "weights that sum to 1", "got array (2, 2) [[0.96, 0.], [0., 0.84]]")
def covariance_on_the_diagonal(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    mean, C = checks.mean_and_covariance(points, weights)
    return mean, torch.diag(C.diagonal())


@wrong(
    "mean_and_covariance", "weights that sum to 1", "got array (2, 2) [[0.9798, 0.2828], [0.2828, "
)
def covariance_as_deviations(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    mean, C = checks.mean_and_covariance(points, weights)
    return mean, C.abs().sqrt()


@wrong("mean_and_covariance", "one hypothesis", "ValueError: too few")
def covariance_refuses_one(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    if (weights > 0).sum() < 2:
        raise ValueError("too few")
    return checks.mean_and_covariance(points, weights)


@wrong("mean_and_covariance", "four corners of a square, equal weights", "expected shape")
def covariance_first(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    return checks.mean_and_covariance(points, weights)[::-1]


# 5. The activation rule ---------------------------------------------------------------------------


@right("overlap")
def overlap_one_by_one(points: Any, R: Any, t: Any, K: Any, mask: Any) -> float:
    hits = 0
    for point in points:
        x, y, z = (R @ point + t).tolist()
        if z > 0:
            column = round(float(K[0, 0]) * x / z + float(K[0, 2]))
            row = round(float(K[1, 1]) * y / z + float(K[1, 2]))
            if 0 <= row < mask.shape[0] and 0 <= column < mask.shape[1]:
                hits += int(mask[row, column])
    return hits / len(points)


@right("overlap")
def overlap_by_padding(points: Any, R: Any, t: Any, K: Any, mask: Any) -> Tensor:
    """A rim of False around the mask, to which all points outside are moved."""
    X = points @ R.T + t
    ahead = X[:, 2] > 0
    pixels = cameras.project(K, X[ahead]) if ahead.any() else X[ahead, :2]
    padded = torch.nn.functional.pad(mask, (1, 1, 1, 1))
    x, y = (pixels + 1.5).floor().T
    x, y = x.clamp(0, mask.shape[1] + 1).long(), y.clamp(0, mask.shape[0] + 1).long()
    return padded[y, x].sum() / len(points)


def _overlap(
    points: Any,
    R: Any,
    t: Any,
    K: Any,
    mask: Any,
    whole: Any = torch.round,
    ahead: Any = lambda z: z > 0,
    low: float = 0,
    of: Any = len,
) -> Tensor:
    X = points @ R.T + t
    X = X[ahead(X[:, 2])]
    x, y = whole((X @ K.T)[:, :2] / X[:, 2:]).T
    height, width = mask.shape
    seen = (x >= low) & (x < width) & (y >= low) & (y < height)
    hits = mask[y[seen].long(), x[seen].long()].sum()
    return hits / max(of(points) if of is len else of(seen), 1)


@wrong("overlap", "a point left of the image", "got 1")
def overlap_that_wraps(points: Any, R: Any, t: Any, K: Any, mask: Any) -> Tensor:
    return _overlap(points, R, t, K, mask, low=-30)


@wrong("overlap", "points at x = 18.7 and 19.7, a mask up to 19", "got 1")
def overlap_cut_short(points: Any, R: Any, t: Any, K: Any, mask: Any) -> Tensor:
    return _overlap(points, R, t, K, mask, whole=torch.floor)


@wrong("overlap", "points at x = 18.7 and 19.7, a mask up to 19", "got 1")
def overlap_cut_towards_0(points: Any, R: Any, t: Any, K: Any, mask: Any) -> Tensor:
    return _overlap(points, R, t, K, mask, whole=torch.trunc)


@wrong("overlap", "a point behind the camera", "got 1")
def overlap_of_all_depths(points: Any, R: Any, t: Any, K: Any, mask: Any) -> Tensor:
    return _overlap(points, R, t, K, mask, ahead=lambda z: z != 0)


@wrong("overlap", "a point left of the image", "got 1")
def overlap_of_what_is_seen(points: Any, R: Any, t: Any, K: Any, mask: Any) -> Tensor:
    return _overlap(points, R, t, K, mask, of=lambda seen: int(seen.sum()))


@wrong("overlap", "a point left of the image", "got 1")
def overlap_clamped(points: Any, R: Any, t: Any, K: Any, mask: Any) -> Tensor:
    X = points @ R.T + t
    X = torch.where(X[:, 2:] > 0, X, torch.tensor([0.0, 0, 1]).to(X))
    x, y = cameras.project(K, X).round().long().T
    x, y = x.clamp(0, mask.shape[1] - 1), y.clamp(0, mask.shape[0] - 1)
    return mask[y, x].double().mean()


@wrong("overlap", "points in an image that is all mask", "got 0.5")
def overlap_transposed(points: Any, R: Any, t: Any, K: Any, mask: Any) -> Tensor:
    return _overlap(points, R, t, K, mask.T)


@wrong("overlap", "points in an image that is all mask", "got 0.00166667")
def overlap_of_the_mask(points: Any, R: Any, t: Any, K: Any, mask: Any) -> Tensor:
    hit = torch.zeros_like(mask)
    pixels = cameras.project(K, points @ R.T + t, behind="inf").round()
    seen = ((pixels >= 0) & (pixels < torch.tensor(mask.shape[::-1]))).all(1)
    x, y = pixels[seen].long().T
    hit[y, x] = True
    return (hit & mask).sum() / mask.sum()


@wrong("overlap", "a random pose", "got 0.285")
def overlap_turned_back(points: Any, R: Any, t: Any, K: Any, mask: Any) -> Tensor:
    return _overlap(points, R.T, t, K, mask)


@wrong("overlap", "one point of four in the left half", "got 0")
def overlap_as_a_decision(points: Any, R: Any, t: Any, K: Any, mask: Any) -> float:
    return float(checks.overlap(points, R, t, K, mask) > 0.8)


@wrong("overlap", "a point behind the camera", "got 0")
def overlap_that_gives_up(points: Any, R: Any, t: Any, K: Any, mask: Any) -> float:
    if ((points @ R.T + t)[:, 2] <= 0).any():
        return 0.0
    return checks.overlap(points, R, t, K, mask)


# 6. Symmetric objects -----------------------------------------------------------------------------


@right("canonical_rotation")
def canonical_by_crosses(R: Any, t: Any) -> Tensor:
    """The y axis at a right angle to the line of sight."""
    z = R[:, :, 2]
    y = torch.linalg.cross(t, z)
    y = torch.where(y.norm(dim=1, keepdim=True) < 1e-6, R[:, :, 1], y)
    y = normalize(y, dim=1)
    return torch.stack([torch.linalg.cross(y, z), y, z], 2)


@right("canonical_rotation")
def canonical_by_an_angle(R: Any, t: Any) -> Tensor:
    """Turned about z by what the camera's azimuth in the object's frame says."""
    camera = -(R.mT @ t[..., None])[..., 0]
    return R @ checks.about_z(torch.atan2(camera[:, 1], camera[:, 0]))


@right("canonical_rotation")
def canonical_least_turn(R: Any, t: Any) -> Tensor:
    """The least rotation that brings the camera's z axis to the object's: no twist."""
    z = R[:, :, 2]
    start = torch.tensor([0.0, 0, 1]).to(z).expand_as(z)
    axis = torch.linalg.cross(start, z)
    sine = axis.norm(dim=1, keepdim=True)
    flat = torch.tensor([1.0, 0, 0]).to(z).expand_as(z)
    axis = torch.where(sine > 1e-9, axis, flat)
    angle = torch.atan2(sine[:, 0], z[:, 2])[:, None]
    return rotations.axis_angle_to_matrix(normalize(axis, dim=1) * angle)


@right("canonical_rotation")
def canonical_by_the_optical_axis(R: Any, t: Any) -> Tensor:
    return checks.canonical_rotation(R, torch.tensor([0.0, 0, 1]).to(t).expand_as(t))


@wrong("canonical_rotation", "one pose, turned four times", "look alike")
def canonical_none(R: Any, t: Any) -> Tensor:
    return R


@wrong("canonical_rotation", "one pose, turned four times", "tilted")
def canonical_by_nothing(R: Any, t: Any) -> Tensor:
    return torch.eye(3).to(R).expand_as(R)


@wrong("canonical_rotation", "one pose, turned four times", "tilted")
def canonical_turned_in_the_camera(R: Any, t: Any) -> Tensor:
    angle = torch.atan2(R[:, 1, 0], R[:, 0, 0])
    return checks.about_z(-angle) @ R


@wrong("canonical_rotation", "an upright object that leans left and right", "expected a rotation")
def canonical_against_a_camera_axis(R: Any, t: Any, axis: int = 1) -> Tensor:
    z = R[:, :, 2]
    other = torch.eye(3).to(z)[axis].expand_as(z)
    y = normalize(torch.linalg.cross(other, z), dim=1)
    return torch.stack([torch.linalg.cross(y, z), y, z], 2)


@wrong("canonical_rotation", "an object that lies on its side and rolls", "expected a rotation")
def canonical_against_x(R: Any, t: Any) -> Tensor:
    return canonical_against_a_camera_axis(R, t, axis=0)


@wrong("canonical_rotation", "an upright object that leans left and right", "look alike")
def canonical_from_the_farthest_axis(R: Any, t: Any) -> Tensor:
    return checks.upright(R[:, :, 2])


@wrong("canonical_rotation", "one pose, turned four times", "look alike")
def canonical_in_steps(R: Any, t: Any) -> Tensor:
    camera = -(R.mT @ t[..., None])[..., 0]
    step = torch.pi / 18
    return R @ checks.about_z((torch.atan2(camera[:, 1], camera[:, 0]) / step).round() * step)


@wrong("canonical_rotation", "one pose, turned four times", "look alike")
def canonical_half(R: Any, t: Any) -> Tensor:
    camera = -(R.mT @ t[..., None])[..., 0]
    return R @ checks.about_z(torch.atan(camera[:, 1] / camera[:, 0]))


@wrong("canonical_rotation", "an object that lies, and points away", "look alike")
def canonical_on_the_right(R: Any, t: Any) -> Tensor:
    """Towards the camera or away from it, whichever points right."""
    right = checks.canonical_rotation(R, t)
    flip = torch.where(right[:, :1, :1] < 0, -1.0, 1.0)
    return torch.cat([right[:, :, :2] * flip, right[:, :, 2:]], 2)


@wrong("canonical_rotation", "one pose, turned four times", "expected a rotation")
def canonical_mean(R: Any, t: Any) -> Tensor:
    """The mean of all matrices that look alike."""
    every = checks.about_z(torch.linspace(0, 2 * torch.pi, 37).double()[:-1])
    return (R[:, None] @ every).mean(1)


@wrong("canonical_rotation", "an axis along the line of sight", "expected a rotation")
def canonical_without_the_pole(R: Any, t: Any) -> Tensor:
    z = R[:, :, 2]
    x = -t + (t * z).sum(1, keepdim=True) * z
    x = normalize(x, dim=1)
    return torch.stack([x, torch.linalg.cross(z, x), z], 2)


@wrong("canonical_rotation", "one pose, turned four times", "expected a rotation")
def canonical_mirrored(R: Any, t: Any) -> Tensor:
    return checks.canonical_rotation(R, t) * torch.tensor([1, -1, 1])


@wrong("canonical_rotation", "one pose, turned four times", "tilted")
def canonical_with_the_axis_as_x(R: Any, t: Any) -> Tensor:
    return checks.canonical_rotation(R, t)[:, :, [2, 0, 1]]


@wrong("canonical_rotation", "an upright object that leans left and right", "look alike")
def canonical_by_euler(R: Any, t: Any) -> Tensor:
    """The last of three angles, y x z, set to 0."""
    angles = rotations.matrix_to_euler(R, "YXZ")
    return rotations.euler_to_matrix(angles * torch.tensor([1, 1, 0]), "YXZ")
