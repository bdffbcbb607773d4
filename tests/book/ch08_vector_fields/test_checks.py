"""Chapter 8's exercises: plausible wrong solutions are caught, other right ones are accepted."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.nn.functional import cosine_similarity, huber_loss, normalize, smooth_l1_loss

from book.ch08_vector_fields import checks
from book.tools.checks import DONE, NOT_DONE
from posecore import cameras, rotations
from posecore.methods.vector_field import keypoints, voting

seeds = st.integers(0, 2**31 - 1)


def doubles(*shape: int, seed: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def cross(a: Tensor, b: Tensor) -> Tensor:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


# 1. Where two rays meet ---------------------------------------------------------------------------


def rays_one_by_one(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    result = torch.full_like(p, torch.nan)
    for i in range(len(p)):
        A = torch.stack([normalize(u[i], dim=0), -normalize(v[i], dim=0)], 1)
        if torch.linalg.det(A).abs() > 1e-6:
            s, r = torch.linalg.solve(A, q[i] - p[i])
            if s >= 0 and r >= 0:
                result[i] = p[i] + s * A[:, 0]
    return result


def rays_by_lines(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    """Lines as homogeneous vectors; the rays meet where both look forward."""
    u, v = normalize(u, dim=1), normalize(v, dim=1)
    one, zero = torch.ones(len(p), 1).to(p), torch.zeros(len(p), 1).to(p)

    def line(start: Tensor, way: Tensor) -> Tensor:
        return torch.linalg.cross(torch.cat([start, one], 1), torch.cat([way, zero], 1), dim=1)

    x = torch.linalg.cross(line(p, u), line(q, v), dim=1)
    x = x[:, :2] / x[:, 2:]
    meet = (((x - p) * u).sum(1) >= 0) & (((x - q) * v).sum(1) >= 0) & (cross(u, v).abs() > 1e-6)
    x[~meet] = torch.nan
    return x


def rays_as_lines(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    s = cross(q - p, v) / cross(u, v)
    return torch.where(cross(u, v)[:, None].abs() < 1e-6, torch.nan, p + s[:, None] * u)


def rays_by_solving(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    s = torch.linalg.solve(torch.stack([u, -v], -1), q - p)
    meet = (s >= 0).all(1)
    return torch.where(meet[:, None], p + s[:, :1] * u, torch.nan)


def _rays(
    p: Any,
    u: Any,
    q: Any,
    v: Any,
    parallel: Any = lambda u, v: cross(normalize(u), normalize(v)).abs() < 1e-6,
    meet: Any = lambda s, r: (s >= 0) & (r >= 0),
    fill: float = torch.nan,
) -> Tensor:
    s, r = cross(q - p, v) / cross(u, v), cross(q - p, u) / cross(u, v)
    return torch.where((meet(s, r) & ~parallel(u, v))[:, None], p + s[:, None] * u, fill)


def rays_by_exact_zero(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    return _rays(p, u, q, v, parallel=lambda u, v: cross(u, v) == 0)


def rays_without_lengths(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    return _rays(p, u, q, v, parallel=lambda u, v: cross(u, v).abs() < 1e-6)


def rays_forward_of_one(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    return _rays(p, u, q, v, meet=lambda s, r: s >= 0)


def rays_on_the_same_side(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    return _rays(p, u, q, v, meet=lambda s, r: s * r >= 0)


def rays_without_their_start(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    return _rays(p, u, q, v, meet=lambda s, r: (s > 0) & (r > 0))


def rays_that_do_not_meet_at_0(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    return _rays(p, u, q, v, fill=0.0)


def rays_of_another_sign(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    return _rays(p, -u, q, v)


def rays_with_a_wide_threshold(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    return _rays(p, u, q, v, parallel=lambda u, v: cross(normalize(u), normalize(v)).abs() < 0.01)


def rays_that_change_the_input(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    u /= u.norm(dim=1, keepdim=True)
    return checks.intersect_rays(p, u, q, v)


# 2. Votes -----------------------------------------------------------------------------------------


def count_one_by_one(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    counts = torch.zeros(len(points), dtype=torch.long)
    for h, point in enumerate(points):
        for pixel, vector in zip(pixels, vectors, strict=True):
            way = point - pixel
            both = way.norm() * vector.norm()
            counts[h] += bool(both > 0) and bool(way @ vector / both > threshold)
    return counts


def count_by_a_product(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    """(h - p) . v > threshold |h - p| |v|, with the products of all pairs as one of matrices."""
    aligned = points @ vectors.T - (pixels * vectors).sum(1)
    return (aligned > threshold * torch.cdist(points, pixels) * vectors.norm(dim=1)).sum(1)


def count_by_the_library(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    cosines = cosine_similarity(points[:, None] - pixels, vectors[None], dim=-1)
    return (cosines > threshold).sum(1)


def count_both_ways(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    to = normalize(points[:, None] - pixels, dim=-1)
    return ((to * normalize(vectors, dim=-1)).sum(-1).abs() > threshold).sum(1)


def count_with_raw_vectors(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    to = normalize(points[:, None] - pixels, dim=-1)
    return ((to * vectors).sum(-1) > threshold).sum(1)


def count_from_the_points(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    return checks.count_inliers(pixels, -vectors, points, threshold)


def count_pixels_on_points(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    aligned = ((points[:, None] - pixels) * vectors).sum(-1)
    far = torch.cdist(points, pixels) * vectors.norm(dim=1)
    return (aligned >= threshold * far).sum(1)


def count_at_the_pixels(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    to = normalize(points[:, None] - pixels, dim=-1)
    return ((to * normalize(vectors, dim=-1)).sum(-1) > threshold).sum(0)


def share_of_inliers(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    return checks.count_inliers(pixels, vectors, points, threshold).double() / max(len(pixels), 1)


def count_squared(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    aligned = ((points[:, None] - pixels) * vectors).sum(-1)
    far = torch.cdist(points, pixels) * vectors.norm(dim=1)
    return (aligned**2 > (threshold * far) ** 2).sum(1)


def count_at_a_fixed_threshold(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    return checks.count_inliers(pixels, vectors, points, 0.99)


def count_by_distance(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    off = cross(points[:, None] - pixels, normalize(vectors, dim=-1)).abs()
    return (off < 1).sum(1)


# 3. The projection loss and its blind spot --------------------------------------------------------


def loss_by_cross_product(predicted: Any, target: Any) -> Tensor:
    length = predicted.square().sum(1).clamp_min(1e-12).sqrt()
    d = cross(target, predicted) / length
    losses = torch.where(d.abs() < 1, d**2 / 2, d.abs() - 0.5)
    return losses.sum() / max(len(losses), 1)


def loss_by_huber(predicted: Any, target: Any) -> Tensor:
    """The target in the frame of the vector: its second coordinate."""
    x, y = normalize(predicted, dim=1).T
    d = torch.einsum("nij,nj->ni", torch.stack([x, y, -y, x], 1).reshape(-1, 2, 2), target)[:, 1]
    return huber_loss(d, torch.zeros_like(d), reduction="sum") / max(len(d), 1)


def _loss(d: Tensor) -> Tensor:
    return smooth_l1_loss(d, torch.zeros_like(d), reduction="sum") / max(len(d), 1)


def loss_undivided(predicted: Any, target: Any) -> Tensor:
    return _loss(cross(target, predicted))


def loss_of_unit_targets(predicted: Any, target: Any) -> Tensor:
    return _loss(cross(normalize(target), normalize(predicted)))


def loss_along_the_vector(predicted: Any, target: Any) -> Tensor:
    return _loss((target * normalize(predicted)).sum(1))


def loss_of_the_difference(predicted: Any, target: Any) -> Tensor:
    off = predicted - normalize(target)
    return smooth_l1_loss(off, torch.zeros_like(off), reduction="sum") / max(off.numel(), 1)


def loss_squared(predicted: Any, target: Any) -> Tensor:
    return cross(target, normalize(predicted)).square().sum() / max(len(target), 1) / 2


def loss_absolute(predicted: Any, target: Any) -> Tensor:
    return cross(target, normalize(predicted)).abs().sum() / max(len(target), 1)


def loss_summed(predicted: Any, target: Any) -> Tensor:
    return _loss(cross(target, normalize(predicted))) * len(target)


def loss_nan_at_0(predicted: Any, target: Any) -> Tensor:
    return _loss(cross(target, predicted) / predicted.norm(dim=1))


def loss_nan_in_the_gradient(predicted: Any, target: Any) -> Tensor:
    length = predicted.norm(dim=1)
    return _loss(torch.where(length > 0, cross(target, predicted) / length, 0.0))


def loss_nan_of_nothing(predicted: Any, target: Any) -> Tensor:
    d = cross(target, normalize(predicted))
    return smooth_l1_loss(d, torch.zeros_like(d))


def loss_with_a_constant_length(predicted: Any, target: Any) -> Tensor:
    length = predicted.norm(dim=1).clamp_min(1e-9).detach()
    return _loss(cross(target, predicted) / length)


def loss_cut_off(predicted: Any, target: Any) -> Tensor:
    return checks.projection_loss(predicted.detach(), target)


def loss_with_a_large_eps(predicted: Any, target: Any) -> Tensor:
    return _loss(cross(target, predicted) / (predicted.norm(dim=1) + 0.1))


def blind_by_angle(target: Any) -> Tensor:
    angle = torch.atan2(target[:, 1], target[:, 0]) + torch.pi
    return torch.stack([angle.cos(), angle.sin()], 1)


def blind_right(target: Any) -> Tensor:
    return normalize(target, dim=1)


def blind_across(target: Any) -> Tensor:
    return torch.stack([target[:, 1], -target[:, 0]], 1) / target.norm(dim=1, keepdim=True)


def blind_nothing(target: Any) -> Tensor:
    return torch.zeros_like(target)


def blind_unscaled(target: Any) -> Tensor:
    return -target


def blind_mirrored(target: Any) -> Tensor:
    return normalize(target * torch.tensor([-1, 1]), dim=1)


def blind_in_every_other(target: Any) -> Tensor:
    signs = torch.ones(len(target), 1).to(target)
    signs[::2] = -1
    return signs * normalize(target, dim=1)


def blind_nearly(target: Any) -> Tensor:
    angle = torch.atan2(target[:, 1], target[:, 0]) + torch.pi + 0.01
    return torch.stack([angle.cos(), angle.sin()], 1)


# 4. The mean and the covariance -------------------------------------------------------------------


def covariance_one_by_one(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    pairs = [(w.item(), h) for w, h in zip(weights, points, strict=True) if w > 0]
    if not pairs:
        raise ValueError("no weights")
    total = sum(w for w, _ in pairs)
    mean = sum(w * h for w, h in pairs) / total
    return mean, sum(w * torch.outer(h - mean, h - mean) for w, h in pairs) / total


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


def covariance_of_samples(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    return _covariance(points, weights, divide=lambda w: w.sum() - 1)


def covariance_by_count(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    return _covariance(points, weights, divide=len)


def covariance_about_the_plain_mean(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    return _covariance(points, weights, w_mean=torch.ones_like)


def covariance_without_weights(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    return _covariance(points, torch.ones_like(weights))


def covariance_with_nan(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    if not (weights > 0).any():
        raise ValueError("no weights")
    w = (weights / weights.sum()).to(points)
    mean = w @ points
    return mean, (w[:, None] * (points - mean)).T @ (points - mean)


def covariance_by_squares(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    points, weights = points[weights > 0], weights[weights > 0]
    if not len(weights):
        raise ValueError("no weights")
    w = (weights / weights.sum()).to(points)
    mean = w @ points
    return mean, (w[:, None] * points).T @ points - torch.outer(mean, mean)


def covariance_of_nothing_is_nan(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    points, weights = points[weights > 0], weights[weights > 0].to(points)
    mean = weights @ points / weights.sum()
    return mean, (weights[:, None] * (points - mean)).T @ (points - mean) / weights.sum()


def covariance_of_whole_weights_fails(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    some = weights > 0
    if not some.any():
        raise ValueError("no weights")
    mean = weights[some] @ points[some] / weights.sum()
    off = points[some] - mean
    return mean, (weights[some, None] * off).T @ off / weights.sum()


def covariance_on_the_diagonal(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    mean, C = checks.mean_and_covariance(points, weights)
    return mean, torch.diag(C.diagonal())


def covariance_as_deviations(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    mean, C = checks.mean_and_covariance(points, weights)
    return mean, C.abs().sqrt()


def covariance_refuses_one(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    if (weights > 0).sum() < 2:
        raise ValueError("too few")
    return checks.mean_and_covariance(points, weights)


def covariance_first(points: Any, weights: Any) -> tuple[Tensor, Tensor]:
    return checks.mean_and_covariance(points, weights)[::-1]


# 5. The activation rule ---------------------------------------------------------------------------


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


def overlap_that_wraps(points: Any, R: Any, t: Any, K: Any, mask: Any) -> Tensor:
    return _overlap(points, R, t, K, mask, low=-30)


def overlap_cut_short(points: Any, R: Any, t: Any, K: Any, mask: Any) -> Tensor:
    return _overlap(points, R, t, K, mask, whole=torch.floor)


def overlap_cut_towards_0(points: Any, R: Any, t: Any, K: Any, mask: Any) -> Tensor:
    return _overlap(points, R, t, K, mask, whole=torch.trunc)


def overlap_of_all_depths(points: Any, R: Any, t: Any, K: Any, mask: Any) -> Tensor:
    return _overlap(points, R, t, K, mask, ahead=lambda z: z != 0)


def overlap_of_what_is_seen(points: Any, R: Any, t: Any, K: Any, mask: Any) -> Tensor:
    return _overlap(points, R, t, K, mask, of=lambda seen: int(seen.sum()))


def overlap_clamped(points: Any, R: Any, t: Any, K: Any, mask: Any) -> Tensor:
    X = points @ R.T + t
    X = torch.where(X[:, 2:] > 0, X, torch.tensor([0.0, 0, 1]).to(X))
    x, y = cameras.project(K, X).round().long().T
    x, y = x.clamp(0, mask.shape[1] - 1), y.clamp(0, mask.shape[0] - 1)
    return mask[y, x].double().mean()


def overlap_transposed(points: Any, R: Any, t: Any, K: Any, mask: Any) -> Tensor:
    return _overlap(points, R, t, K, mask.T)


def overlap_of_the_mask(points: Any, R: Any, t: Any, K: Any, mask: Any) -> Tensor:
    hit = torch.zeros_like(mask)
    pixels = cameras.project(K, points @ R.T + t, behind="inf").round()
    seen = ((pixels >= 0) & (pixels < torch.tensor(mask.shape[::-1]))).all(1)
    x, y = pixels[seen].long().T
    hit[y, x] = True
    return (hit & mask).sum() / mask.sum()


def overlap_turned_back(points: Any, R: Any, t: Any, K: Any, mask: Any) -> Tensor:
    return _overlap(points, R.T, t, K, mask)


def overlap_as_a_decision(points: Any, R: Any, t: Any, K: Any, mask: Any) -> float:
    return float(checks.overlap(points, R, t, K, mask) > 0.8)


def overlap_that_gives_up(points: Any, R: Any, t: Any, K: Any, mask: Any) -> float:
    if ((points @ R.T + t)[:, 2] <= 0).any():
        return 0.0
    return checks.overlap(points, R, t, K, mask)


# 6. Symmetric objects -----------------------------------------------------------------------------


def canonical_by_crosses(R: Any, t: Any) -> Tensor:
    """The y axis at a right angle to the line of sight."""
    z = R[:, :, 2]
    y = torch.linalg.cross(t, z)
    y = torch.where(y.norm(dim=1, keepdim=True) < 1e-6, R[:, :, 1], y)
    y = normalize(y, dim=1)
    return torch.stack([torch.linalg.cross(y, z), y, z], 2)


def canonical_by_an_angle(R: Any, t: Any) -> Tensor:
    """Turned about z by what the camera's azimuth in the object's frame says."""
    camera = -(R.mT @ t[..., None])[..., 0]
    return R @ checks.about_z(torch.atan2(camera[:, 1], camera[:, 0]))


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


def canonical_by_the_optical_axis(R: Any, t: Any) -> Tensor:
    return checks.canonical_rotation(R, torch.tensor([0.0, 0, 1]).to(t).expand_as(t))


def canonical_none(R: Any, t: Any) -> Tensor:
    return R


def canonical_by_nothing(R: Any, t: Any) -> Tensor:
    return torch.eye(3).to(R).expand_as(R)


def canonical_turned_in_the_camera(R: Any, t: Any) -> Tensor:
    angle = torch.atan2(R[:, 1, 0], R[:, 0, 0])
    return checks.about_z(-angle) @ R


def canonical_against_a_camera_axis(R: Any, t: Any, axis: int = 1) -> Tensor:
    z = R[:, :, 2]
    other = torch.eye(3).to(z)[axis].expand_as(z)
    y = normalize(torch.linalg.cross(other, z), dim=1)
    return torch.stack([torch.linalg.cross(y, z), y, z], 2)


def canonical_against_x(R: Any, t: Any) -> Tensor:
    return canonical_against_a_camera_axis(R, t, axis=0)


def canonical_from_the_farthest_axis(R: Any, t: Any) -> Tensor:
    return checks.upright(R[:, :, 2])


def canonical_in_steps(R: Any, t: Any) -> Tensor:
    camera = -(R.mT @ t[..., None])[..., 0]
    step = torch.pi / 18
    return R @ checks.about_z((torch.atan2(camera[:, 1], camera[:, 0]) / step).round() * step)


def canonical_half(R: Any, t: Any) -> Tensor:
    camera = -(R.mT @ t[..., None])[..., 0]
    return R @ checks.about_z(torch.atan(camera[:, 1] / camera[:, 0]))


def canonical_on_the_right(R: Any, t: Any) -> Tensor:
    """Towards the camera or away from it, whichever points right."""
    right = checks.canonical_rotation(R, t)
    flip = torch.where(right[:, :1, :1] < 0, -1.0, 1.0)
    return torch.cat([right[:, :, :2] * flip, right[:, :, 2:]], 2)


def canonical_mean(R: Any, t: Any) -> Tensor:
    """The mean of all matrices that look alike."""
    every = checks.about_z(torch.linspace(0, 2 * torch.pi, 37).double()[:-1])
    return (R[:, None] @ every).mean(1)


def canonical_without_the_pole(R: Any, t: Any) -> Tensor:
    z = R[:, :, 2]
    x = -t + (t * z).sum(1, keepdim=True) * z
    x = normalize(x, dim=1)
    return torch.stack([x, torch.linalg.cross(z, x), z], 2)


def canonical_mirrored(R: Any, t: Any) -> Tensor:
    return checks.canonical_rotation(R, t) * torch.tensor([1, -1, 1])


def canonical_with_the_axis_as_x(R: Any, t: Any) -> Tensor:
    return checks.canonical_rotation(R, t)[:, :, [2, 0, 1]]


def canonical_by_euler(R: Any, t: Any) -> Tensor:
    """The last of three angles, y x z, set to 0."""
    angles = rotations.matrix_to_euler(R, "YXZ")
    return rotations.euler_to_matrix(angles * torch.tensor([1, 1, 0]), "YXZ")


RIGHT = [
    ("intersect_rays", rays_one_by_one),
    ("intersect_rays", rays_by_lines),
    ("count_inliers", count_one_by_one),
    ("count_inliers", count_by_a_product),
    ("count_inliers", count_by_the_library),
    ("projection_loss", loss_by_cross_product),
    ("projection_loss", loss_by_huber),
    ("blind_prediction", blind_by_angle),
    ("mean_and_covariance", covariance_one_by_one),
    ("mean_and_covariance", covariance_by_numpy),
    ("overlap", overlap_one_by_one),
    ("overlap", overlap_by_padding),
    ("canonical_rotation", canonical_by_crosses),
    ("canonical_rotation", canonical_by_an_angle),
    ("canonical_rotation", canonical_least_turn),
    ("canonical_rotation", canonical_by_the_optical_axis),
]


@pytest.mark.parametrize(("exercise", "student"), RIGHT)
def test_another_way_to_be_right(exercise: str, student: Callable[..., Any]) -> None:
    answer = getattr(checks, f"check_{exercise}")(student)
    assert answer.status == DONE, answer.line


# The exercise, the wrong solution, the input that gives it away, and what the line says of it.
WRONG = [
    (
        "intersect_rays",
        rays_as_lines,
        "a crossing behind the first pixel",
        "got array (1, 2) [[5., 2.]]",
    ),
    ("intersect_rays", rays_by_solving, "parallel rays side by side", "it raised _LinAlgError"),
    (
        "intersect_rays",
        rays_by_exact_zero,
        "directions as long as 1e4",
        "got array (1, 2) [[2.e+10, 4.e+10]]",
    ),
    (
        "intersect_rays",
        rays_without_lengths,
        "directions as short as 1e-4",
        "got array (1, 2) [[nan, nan]]",
    ),
    (
        "intersect_rays",
        rays_forward_of_one,
        "a crossing behind the second pixel",
        "got array (1, 2) [[5., 2.]]",
    ),
    (
        "intersect_rays",
        rays_on_the_same_side,
        "a crossing behind both pixels",
        "got array (1, 2) [[5., 2.]]",
    ),
    (
        "intersect_rays",
        rays_without_their_start,
        "the first pixel on the second ray",
        "got array (1, 2) [[nan, nan]]",
    ),
    (
        "intersect_rays",
        rays_that_do_not_meet_at_0,
        "parallel rays side by side",
        "got array (1, 2) [[0., 0.]]",
    ),
    (
        "intersect_rays",
        rays_of_another_sign,
        "two rays at a right angle",
        "got array (1, 2) [[nan, nan]]",
    ),
    (
        "intersect_rays",
        rays_with_a_wide_threshold,
        "rays at 0.06 degrees",
        "got array (1, 2) [[nan, nan]]",
    ),
    (
        "intersect_rays",
        rays_that_change_the_input,
        "a slanted ray and a level one",
        "it changes its u",
    ),
    ("count_inliers", count_both_ways, "a point behind the pixel", "got array (1,) [1]"),
    (
        "count_inliers",
        count_with_raw_vectors,
        "a vector of length 7",
        "got array (4,) [1, 1, 1, 0]",
    ),
    (
        "count_inliers",
        count_from_the_points,
        "points ahead, and 6, 11 and 90 degrees off",
        "got array (4,) [0, 0, 0, 0]",
    ),
    ("count_inliers", count_pixels_on_points, "a pixel on the point itself", "got array (1,) [2]"),
    (
        "count_inliers",
        count_at_the_pixels,
        "points ahead, and 6, 11 and 90 degrees off",
        "expected shape",
    ),
    (
        "count_inliers",
        share_of_inliers,
        "points ahead, and 6, 11 and 90 degrees off",
        "whole numbers",
    ),
    ("count_inliers", count_squared, "a point behind the pixel", "got array (1,) [1]"),
    (
        "count_inliers",
        count_at_a_fixed_threshold,
        "a narrow threshold",
        "got array (4,) [1, 1, 0, 0]",
    ),
    ("count_inliers", count_by_distance, "a point behind the pixel", "got array (1,) [1]"),
    ("projection_loss", loss_undivided, "a vector 0.5 px beside a keypoint", "the loss is right"),
    (
        "projection_loss",
        loss_of_unit_targets,
        "a vector 0.5 px beside a keypoint",
        "got 0.000312305",
    ),
    ("projection_loss", loss_along_the_vector, "a vector 0.5 px beside a keypoint", "got 19.5"),
    (
        "projection_loss",
        loss_of_the_difference,
        "a vector 0.5 px beside a keypoint",
        "got 0.000156177",
    ),
    ("projection_loss", loss_squared, "a vector 3 px beside a keypoint", "got 4.5"),
    ("projection_loss", loss_absolute, "a vector 0.5 px beside a keypoint", "got 0.5"),
    ("projection_loss", loss_summed, "two vectors, of which one is right", "got 1.5"),
    ("projection_loss", loss_nan_at_0, "a predicted vector of 0", "got nan"),
    ("projection_loss", loss_nan_in_the_gradient, "a predicted vector of 0", "the loss is right"),
    ("projection_loss", loss_nan_of_nothing, "no vectors at all", "got nan"),
    (
        "projection_loss",
        loss_with_a_constant_length,
        "a vector 0.5 px beside a keypoint",
        "the loss is right",
    ),
    ("projection_loss", loss_cut_off, "a vector 0.5 px beside a keypoint", "no gradient can"),
    ("projection_loss", loss_with_a_large_eps, "a vector 0.5 px beside a keypoint", "got 0.103306"),
    ("blind_prediction", blind_right, "one target to the right", "more than 90 degrees"),
    ("blind_prediction", blind_across, "one target to the right", "more than 90 degrees"),
    ("blind_prediction", blind_nothing, "one target to the right", "got length"),
    ("blind_prediction", blind_unscaled, "one target to the right", "got length"),
    ("blind_prediction", blind_mirrored, "one slanted target", "more than 90 degrees"),
    ("blind_prediction", blind_in_every_other, "random targets", "more than 90 degrees"),
    ("blind_prediction", blind_nearly, "one target to the right", "a projection loss of 0"),
    (
        "mean_and_covariance",
        covariance_of_samples,
        "four corners of a square, equal weights",
        "got array (2, 2) [[1.3333, 0. ], [0. , 1.3333",
    ),
    (
        "mean_and_covariance",
        covariance_by_count,
        "weights that sum to 1",
        "got array (2, 2) [[ 0.24, -0.02], [-0.02, 0.2",
    ),
    (
        "mean_and_covariance",
        covariance_about_the_plain_mean,
        "weights that sum to 1",
        "got array (2,) [1., 1.]",
    ),
    (
        "mean_and_covariance",
        covariance_without_weights,
        "weights that sum to 1",
        "got array (2,) [1., 1.]",
    ),
    (
        "mean_and_covariance",
        covariance_with_nan,
        "rays that did not meet, of weight 0",
        "got array (2,) [nan, nan]",
    ),
    (
        "mean_and_covariance",
        covariance_by_squares,
        "float32, all to 0.1 px",
        "got array (2, 2) [[0., 0.], [0., 0.]]",
    ),
    (
        "mean_and_covariance",
        covariance_of_nothing_is_nan,
        "weights that are all 0",
        "expected a ValueError",
    ),
    (
        "mean_and_covariance",
        covariance_of_whole_weights_fails,
        "weights that are whole numbers, as counts are",
        "it raised RuntimeError",
    ),
    (
        "mean_and_covariance",
        covariance_on_the_diagonal,
        "weights that sum to 1",
        "got array (2, 2) [[0.96, 0. ], [0. , 0.84]]",
    ),
    (
        "mean_and_covariance",
        covariance_as_deviations,
        "weights that sum to 1",
        "got array (2, 2) [[0.9798, 0.2828], [0.2828, ",
    ),
    ("mean_and_covariance", covariance_refuses_one, "one hypothesis", "ValueError: too few"),
    (
        "mean_and_covariance",
        covariance_first,
        "four corners of a square, equal weights",
        "expected shape",
    ),
    ("overlap", overlap_that_wraps, "a point left of the image", "got 1"),
    ("overlap", overlap_cut_short, "points at x = 18.7 and 19.7, a mask up to 19", "got 1"),
    ("overlap", overlap_cut_towards_0, "points at x = 18.7 and 19.7, a mask up to 19", "got 1"),
    ("overlap", overlap_of_all_depths, "a point behind the camera", "got 1"),
    ("overlap", overlap_of_what_is_seen, "a point left of the image", "got 1"),
    ("overlap", overlap_clamped, "a point left of the image", "got 1"),
    ("overlap", overlap_transposed, "points in an image that is all mask", "got 0.5"),
    ("overlap", overlap_of_the_mask, "points in an image that is all mask", "got 0.00166667"),
    ("overlap", overlap_turned_back, "a random pose", "got 0.285"),
    ("overlap", overlap_as_a_decision, "one point of four in the left half", "got 0"),
    ("overlap", overlap_that_gives_up, "a point behind the camera", "got 0"),
    ("canonical_rotation", canonical_none, "one pose, turned four times", "look alike"),
    ("canonical_rotation", canonical_by_nothing, "one pose, turned four times", "tilted"),
    ("canonical_rotation", canonical_turned_in_the_camera, "one pose, turned four times", "tilted"),
    (
        "canonical_rotation",
        canonical_against_a_camera_axis,
        "an upright object that leans left and right",
        "expected a rotation",
    ),
    (
        "canonical_rotation",
        canonical_against_x,
        "an object that lies on its side and rolls",
        "expected a rotation",
    ),
    (
        "canonical_rotation",
        canonical_from_the_farthest_axis,
        "an upright object that leans left and right",
        "look alike",
    ),
    ("canonical_rotation", canonical_in_steps, "one pose, turned four times", "look alike"),
    ("canonical_rotation", canonical_half, "one pose, turned four times", "look alike"),
    (
        "canonical_rotation",
        canonical_on_the_right,
        "an object that lies, and points away",
        "look alike",
    ),
    ("canonical_rotation", canonical_mean, "one pose, turned four times", "expected a rotation"),
    (
        "canonical_rotation",
        canonical_without_the_pole,
        "an axis along the line of sight",
        "expected a rotation",
    ),
    (
        "canonical_rotation",
        canonical_mirrored,
        "one pose, turned four times",
        "expected a rotation",
    ),
    ("canonical_rotation", canonical_with_the_axis_as_x, "one pose, turned four times", "tilted"),
    (
        "canonical_rotation",
        canonical_by_euler,
        "an upright object that leans left and right",
        "look alike",
    ),
]


@pytest.mark.parametrize(("exercise", "student", "words", "result"), WRONG)
def test_a_wrong_solution_is_caught(
    refused: Callable[..., str], exercise: str, student: Callable[..., Any], words: str, result: str
) -> None:
    line = refused(getattr(checks, f"check_{exercise}"), exercise, student, words)
    assert result in line, line


def test_every_exercise_has_wrong_solutions_and_two_hints() -> None:
    found = [name for name in vars(checks) if name.startswith("check_")]
    assert len(found) == 7  # the third exercise has two parts
    for name in found:
        assert len(getattr(checks, name).hints) == 2
        assert sum(f"check_{exercise}" == name for exercise, *_ in WRONG) >= 6
        assert sum(f"check_{exercise}" == name for exercise, _ in RIGHT) >= 1


@pytest.mark.parametrize("name", [name for name in vars(checks) if name.startswith("check_")])
def test_a_stub_is_not_done(name: str) -> None:
    assert getattr(checks, name)(lambda *arguments: ...).status == NOT_DONE


@given(seeds)
def test_the_rays_meet_at_the_point_they_came_from(seed: int) -> None:
    p, q, point = 100 * doubles(3, 8, 2, seed=seed)
    lengths = doubles(2, 8, 1, seed=seed + 1).abs() + 0.1
    met = checks.intersect_rays(p, lengths[0] * (point - p), q, lengths[1] * (point - q))
    sharp = cross(normalize(point - p), normalize(point - q)).abs() < 1e-3
    assert torch.allclose(met[~sharp], point[~sharp], rtol=0, atol=1e-8)
    assert checks.intersect_rays(p, p - point, q, point - q).isnan().all()
    assert checks.intersect_rays(p, point - p, q, point - p).isnan().all()


@given(seeds)
def test_the_lines_of_rays_that_meet_cross_there_for_the_library(seed: int) -> None:
    p, u, q, v = doubles(4, 8, 2, seed=seed)
    met = checks.intersect_rays(p, u, q, v)
    meet = ~met.isnan().any(1) & (cross(normalize(u), normalize(v)).abs() > 0.01)
    lines = voting.intersect_lines(torch.stack([p, q], 1), torch.stack([u, v], 1))
    assert torch.allclose(lines[meet], met[meet], rtol=0, atol=1e-6)


@given(seeds, st.floats(0.3, 0.999))
@settings(max_examples=30)
def test_votes_are_those_of_a_loop(seed: int, threshold: float) -> None:
    pixels, vectors = 30 * doubles(2, 12, 2, seed=seed)
    points = torch.cat([pixels[:2], 30 * doubles(4, 2, seed=seed + 1)])
    counts = checks.count_inliers(pixels, vectors, points, threshold)
    assert torch.equal(counts, count_one_by_one(pixels, vectors, points, threshold))
    assert torch.equal(counts, checks.count_inliers(pixels, 3 * vectors, points, threshold))
    away = points[2:]  # on a pixel, float32 decides by chance
    theirs = voting.count_inliers(pixels, vectors[:, None], away[None], threshold)
    assert torch.equal(counts[2:], theirs[0])
    behind = checks.count_inliers(pixels, -vectors, points, threshold)
    assert (counts + behind <= 12).all()


@given(seeds)
def test_the_projection_loss_is_blind_to_reversed_vectors(seed: int) -> None:
    predicted, target = doubles(2, 9, 2, seed=seed)
    loss = checks.projection_loss(predicted, 50 * target)
    assert torch.isclose(loss, checks.projection_loss(-7 * predicted, 50 * target))
    blind = checks.blind_prediction(50 * target)
    assert checks.projection_loss(blind, 50 * target) < 1e-12
    assert (cosine_similarity(blind, target) < -1 + 1e-9).all()


@given(seeds)
def test_the_covariance_is_that_of_numpy(seed: int) -> None:
    points = 300 + 20 * doubles(9, 2, seed=seed)
    weights = torch.randint(0, 5, (9,), generator=torch.Generator().manual_seed(seed))
    weights[0] = 1
    mean, C = checks.mean_and_covariance(points, weights)
    assert np.allclose(mean, np.average(points, axis=0, weights=weights))
    assert np.allclose(C, np.cov(points.T, aweights=weights, ddof=0), atol=1e-9)
    assert (torch.linalg.eigvalsh(C) >= -1e-9).all()


@given(seeds, st.floats(-0.3, 1))
@settings(max_examples=30)
def test_the_overlap_is_that_of_a_loop(seed: int, depth: float) -> None:
    points, R = doubles(60, 3, seed=seed) / 10, rotations.random_rotations(generator=seed)
    given = points, torch.as_tensor(R).double(), torch.tensor([0.02, 0.03, depth]).double()
    K = torch.tensor([[100, 0, 19.5], [0, 100, 14.5], [0, 0, 1]]).double()
    mask = doubles(30, 40, seed=seed + 1) > 0
    share = checks.overlap(*given, K, mask)
    assert np.isclose(share, overlap_one_by_one(*given, K, mask))
    assert np.isclose(
        share + checks.overlap(*given, K, ~mask), checks.overlap(*given, K, mask | True)
    )


@given(seeds)
@settings(max_examples=30)
def test_the_canonical_pose_looks_the_same_and_is_one(seed: int) -> None:
    R = rotations.random_rotations(generator=seed, dtype=torch.float64)
    t = torch.tensor([0, 0, 1.0]).double() + doubles(3, seed=seed) / 10
    angles = doubles(5, seed=seed + 1)
    alike = R @ checks.about_z(angles)
    found = checks.canonical_rotation(alike, t.expand(5, 3))
    assert rotations.is_rotation(found).all()
    assert torch.allclose(found[:, :, 2], alike[:, :, 2])
    assert torch.allclose(found, found[:1].expand_as(found), atol=1e-6)
    # The x axis points at the camera, as far as it can: no part of the line of sight along y.
    assert torch.allclose((found.mT @ t)[:, 1], torch.zeros(5).double(), atol=1e-9)
    assert ((found.mT @ t)[:, 0] <= 0).all()


@given(seeds)
@settings(max_examples=10)
def test_the_library_has_the_same_rule_in_steps(seed: int) -> None:
    """Its favoured direction is another one, so all its answers are turned by one fixed angle."""
    R = rotations.random_rotations(6, generator=seed, dtype=torch.float64)
    t = torch.tensor([0, 0, 1.0]).double() + doubles(6, 3, seed=seed) / 10
    steps = 90
    symmetries = torch.eye(4).double().repeat(steps, 1, 1)
    symmetries[:, :3, :3] = checks.about_z(2 * torch.pi * torch.arange(steps).double() / steps)
    theirs, _ = keypoints.canonical_rotation(R, t, symmetries)
    turn = checks.canonical_rotation(R, t).mT @ theirs
    assert torch.allclose(turn, turn[:1].expand_as(turn), atol=2 * torch.pi / steps)
