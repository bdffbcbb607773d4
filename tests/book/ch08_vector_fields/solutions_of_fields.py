"""Chapter 8's first exercises, solved as students would: rays, votes and the loss."""

from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import cosine_similarity, huber_loss, normalize, smooth_l1_loss

from book.ch08_vector_fields import checks
from tests.book.exercises import Solutions

SOLUTIONS = Solutions()
right, wrong = SOLUTIONS.right, SOLUTIONS.wrong


def cross(a: Tensor, b: Tensor) -> Tensor:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


# 1. Where two rays meet ---------------------------------------------------------------------------


@right("intersect_rays")
def rays_one_by_one(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    result = torch.full_like(p, torch.nan)
    for i in range(len(p)):
        A = torch.stack([normalize(u[i], dim=0), -normalize(v[i], dim=0)], 1)
        if torch.linalg.det(A).abs() > 1e-6:
            s, r = torch.linalg.solve(A, q[i] - p[i])
            if s >= 0 and r >= 0:
                result[i] = p[i] + s * A[:, 0]
    return result


@right("intersect_rays")
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


@wrong("intersect_rays", "a crossing behind the first pixel", "got array (1, 2) [[5., 2.]]")
def rays_as_lines(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    s = cross(q - p, v) / cross(u, v)
    return torch.where(cross(u, v)[:, None].abs() < 1e-6, torch.nan, p + s[:, None] * u)


@wrong("intersect_rays", "parallel rays side by side", "it raised _LinAlgError")
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


@wrong("intersect_rays", "directions as long as 1e4", "got array (1, 2) [[2e+10, 4e+10]]")
def rays_by_exact_zero(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    return _rays(p, u, q, v, parallel=lambda u, v: cross(u, v) == 0)


@wrong("intersect_rays", "directions as short as 1e-4", "got array (1, 2) [[nan, nan]]")
def rays_without_lengths(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    return _rays(p, u, q, v, parallel=lambda u, v: cross(u, v).abs() < 1e-6)


@wrong("intersect_rays", "a crossing behind the second pixel", "got array (1, 2) [[5., 2.]]")
def rays_forward_of_one(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    return _rays(p, u, q, v, meet=lambda s, r: s >= 0)


@wrong("intersect_rays", "a crossing behind both pixels", "got array (1, 2) [[5., 2.]]")
def rays_on_the_same_side(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    return _rays(p, u, q, v, meet=lambda s, r: s * r >= 0)


@wrong("intersect_rays", "the first pixel on the second ray", "got array (1, 2) [[nan, nan]]")
def rays_without_their_start(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    return _rays(p, u, q, v, meet=lambda s, r: (s > 0) & (r > 0))


@wrong("intersect_rays", "parallel rays side by side", "got array (1, 2) [[0., 0.]]")
def rays_that_do_not_meet_at_0(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    return _rays(p, u, q, v, fill=0.0)


@wrong("intersect_rays", "two rays at a right angle", "got array (1, 2) [[nan, nan]]")
def rays_of_another_sign(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    return _rays(p, -u, q, v)


@wrong("intersect_rays", "rays at 0.06 degrees", "got array (1, 2) [[nan, nan]]")
def rays_with_a_wide_threshold(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    return _rays(p, u, q, v, parallel=lambda u, v: cross(normalize(u), normalize(v)).abs() < 0.01)


@wrong("intersect_rays", "a slanted ray and a level one", "it changes its u")
def rays_that_change_the_input(p: Any, u: Any, q: Any, v: Any) -> Tensor:
    u /= u.norm(dim=1, keepdim=True)
    return checks.intersect_rays(p, u, q, v)


# 2. Votes -----------------------------------------------------------------------------------------


@right("count_inliers")
def count_one_by_one(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    counts = torch.zeros(len(points), dtype=torch.long)
    for h, point in enumerate(points):
        for pixel, vector in zip(pixels, vectors, strict=True):
            way = point - pixel
            both = way.norm() * vector.norm()
            counts[h] += bool(both > 0) and bool(way @ vector / both > threshold)
    return counts


@right("count_inliers")
def count_by_a_product(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    """(h - p) . v > threshold |h - p| |v|, with the products of all pairs as one of matrices."""
    aligned = points @ vectors.T - (pixels * vectors).sum(1)
    return (aligned > threshold * torch.cdist(points, pixels) * vectors.norm(dim=1)).sum(1)


@right("count_inliers")
def count_by_the_library(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    cosines = cosine_similarity(points[:, None] - pixels, vectors[None], dim=-1)
    return (cosines > threshold).sum(1)


@wrong("count_inliers", "a point behind the pixel", "got array (1,) [1]")
def count_both_ways(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    to = normalize(points[:, None] - pixels, dim=-1)
    return ((to * normalize(vectors, dim=-1)).sum(-1).abs() > threshold).sum(1)


@wrong("count_inliers", "a vector of length 7", "got array (4,) [1, 1, 1, 0]")
def count_with_raw_vectors(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    to = normalize(points[:, None] - pixels, dim=-1)
    return ((to * vectors).sum(-1) > threshold).sum(1)


@wrong("count_inliers", "points ahead, and 6, 11 and 90 degrees off", "got array (4,) [0, 0, 0, 0]")
def count_from_the_points(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    return checks.count_inliers(pixels, -vectors, points, threshold)


@wrong("count_inliers", "a pixel on the point itself", "got array (1,) [2]")
def count_pixels_on_points(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    aligned = ((points[:, None] - pixels) * vectors).sum(-1)
    far = torch.cdist(points, pixels) * vectors.norm(dim=1)
    return (aligned >= threshold * far).sum(1)


@wrong("count_inliers", "points ahead, and 6, 11 and 90 degrees off", "expected shape")
def count_at_the_pixels(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    to = normalize(points[:, None] - pixels, dim=-1)
    return ((to * normalize(vectors, dim=-1)).sum(-1) > threshold).sum(0)


@wrong("count_inliers", "points ahead, and 6, 11 and 90 degrees off", "whole numbers")
def share_of_inliers(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    return checks.count_inliers(pixels, vectors, points, threshold).double() / max(len(pixels), 1)


@wrong("count_inliers", "a point behind the pixel", "got array (1,) [1]")
def count_squared(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    aligned = ((points[:, None] - pixels) * vectors).sum(-1)
    far = torch.cdist(points, pixels) * vectors.norm(dim=1)
    return (aligned**2 > (threshold * far) ** 2).sum(1)


@wrong("count_inliers", "a narrow threshold", "got array (4,) [1, 1, 0, 0]")
def count_at_a_fixed_threshold(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    return checks.count_inliers(pixels, vectors, points, 0.99)


@wrong("count_inliers", "a point behind the pixel", "got array (1,) [1]")
def count_by_distance(pixels: Any, vectors: Any, points: Any, threshold: float) -> Tensor:
    off = cross(points[:, None] - pixels, normalize(vectors, dim=-1)).abs()
    return (off < 1).sum(1)


# 3. The projection loss and its blind spot --------------------------------------------------------


@right("projection_loss")
def loss_by_cross_product(predicted: Any, target: Any) -> Tensor:
    length = predicted.square().sum(1).clamp_min(1e-12).sqrt()
    d = cross(target, predicted) / length
    losses = torch.where(d.abs() < 1, d**2 / 2, d.abs() - 0.5)
    return losses.sum() / max(len(losses), 1)


@right("projection_loss")
def loss_by_huber(predicted: Any, target: Any) -> Tensor:
    """The target in the frame of the vector: its second coordinate."""
    x, y = normalize(predicted, dim=1).T
    d = torch.einsum("nij,nj->ni", torch.stack([x, y, -y, x], 1).reshape(-1, 2, 2), target)[:, 1]
    return huber_loss(d, torch.zeros_like(d), reduction="sum") / max(len(d), 1)


def _loss(d: Tensor) -> Tensor:
    return smooth_l1_loss(d, torch.zeros_like(d), reduction="sum") / max(len(d), 1)


@wrong("projection_loss", "a vector 0.5 px beside a keypoint", "the loss is right")
def loss_undivided(predicted: Any, target: Any) -> Tensor:
    return _loss(cross(target, predicted))


@wrong("projection_loss", "a vector 0.5 px beside a keypoint", "got 0.000312305")
def loss_of_unit_targets(predicted: Any, target: Any) -> Tensor:
    return _loss(cross(normalize(target), normalize(predicted)))


@wrong("projection_loss", "a vector 0.5 px beside a keypoint", "got 19.5")
def loss_along_the_vector(predicted: Any, target: Any) -> Tensor:
    return _loss((target * normalize(predicted)).sum(1))


@wrong("projection_loss", "a vector 0.5 px beside a keypoint", "got 0.000156177")
def loss_of_the_difference(predicted: Any, target: Any) -> Tensor:
    off = predicted - normalize(target)
    return smooth_l1_loss(off, torch.zeros_like(off), reduction="sum") / max(off.numel(), 1)


@wrong("projection_loss", "a vector 3 px beside a keypoint", "got 4.5")
def loss_squared(predicted: Any, target: Any) -> Tensor:
    return cross(target, normalize(predicted)).square().sum() / max(len(target), 1) / 2


@wrong("projection_loss", "a vector 0.5 px beside a keypoint", "got 0.5")
def loss_absolute(predicted: Any, target: Any) -> Tensor:
    return cross(target, normalize(predicted)).abs().sum() / max(len(target), 1)


@wrong("projection_loss", "two vectors, of which one is right", "got 1.5")
def loss_summed(predicted: Any, target: Any) -> Tensor:
    return _loss(cross(target, normalize(predicted))) * len(target)


@wrong("projection_loss", "a predicted vector of 0", "got nan")
def loss_nan_at_0(predicted: Any, target: Any) -> Tensor:
    return _loss(cross(target, predicted) / predicted.norm(dim=1))


@wrong("projection_loss", "a predicted vector of 0", "the loss is right")
def loss_nan_in_the_gradient(predicted: Any, target: Any) -> Tensor:
    length = predicted.norm(dim=1)
    return _loss(torch.where(length > 0, cross(target, predicted) / length, 0.0))


@wrong("projection_loss", "no vectors at all", "got nan")
def loss_nan_of_nothing(predicted: Any, target: Any) -> Tensor:
    d = cross(target, normalize(predicted))
    return smooth_l1_loss(d, torch.zeros_like(d))


@wrong("projection_loss", "a vector 0.5 px beside a keypoint", "the loss is right")
def loss_with_a_constant_length(predicted: Any, target: Any) -> Tensor:
    length = predicted.norm(dim=1).clamp_min(1e-9).detach()
    return _loss(cross(target, predicted) / length)


@wrong("projection_loss", "a vector 0.5 px beside a keypoint", "no gradient can")
def loss_cut_off(predicted: Any, target: Any) -> Tensor:
    return checks.projection_loss(predicted.detach(), target)


@wrong("projection_loss", "a vector 0.5 px beside a keypoint", "got 0.103306")
def loss_with_a_large_eps(predicted: Any, target: Any) -> Tensor:
    return _loss(cross(target, predicted) / (predicted.norm(dim=1) + 0.1))


@right("blind_prediction")
def blind_by_angle(target: Any) -> Tensor:
    angle = torch.atan2(target[:, 1], target[:, 0]) + torch.pi
    return torch.stack([angle.cos(), angle.sin()], 1)


@wrong("blind_prediction", "one target to the right", "more than 90 degrees")
def blind_right(target: Any) -> Tensor:
    return normalize(target, dim=1)


@wrong("blind_prediction", "one target to the right", "more than 90 degrees")
def blind_across(target: Any) -> Tensor:
    return torch.stack([target[:, 1], -target[:, 0]], 1) / target.norm(dim=1, keepdim=True)


@wrong("blind_prediction", "one target to the right", "got length")
def blind_nothing(target: Any) -> Tensor:
    return torch.zeros_like(target)


@wrong("blind_prediction", "one target to the right", "got length")
def blind_unscaled(target: Any) -> Tensor:
    return -target


@wrong("blind_prediction", "one slanted target", "more than 90 degrees")
def blind_mirrored(target: Any) -> Tensor:
    return normalize(target * torch.tensor([-1, 1]), dim=1)


@wrong("blind_prediction", "random targets", "more than 90 degrees")
def blind_in_every_other(target: Any) -> Tensor:
    signs = torch.ones(len(target), 1).to(target)
    signs[::2] = -1
    return signs * normalize(target, dim=1)


@wrong("blind_prediction", "one target to the right", "a projection loss of 0")
def blind_nearly(target: Any) -> Tensor:
    angle = torch.atan2(target[:, 1], target[:, 0]) + torch.pi + 0.01
    return torch.stack([angle.cos(), angle.sin()], 1)
