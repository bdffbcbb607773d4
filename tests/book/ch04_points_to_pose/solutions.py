"""Chapter 4's exercises, solved as students would: rightly and wrongly."""

from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from scipy.spatial import cKDTree
from torch import Tensor

from posecore.registration import umeyama
from tests.book.exercises import Solutions

SOLUTIONS = Solutions()
right, wrong = SOLUTIONS.right, SOLUTIONS.wrong


# 1. A ball query ----------------------------------------------------------------------------------


def query(
    points: Any, centres: Any, count: int, inside: Any, fill: Any = None, empty: Any = None
) -> Tensor:
    """By one centre after the other; what each wrong solution does otherwise is an argument."""
    found = []
    for centre in centres:
        d = torch.linalg.vector_norm(points - centre, dim=-1)
        ball = inside(d, points - centre)
        if not len(ball):
            ball = d.argmin()[None] if empty is None else empty(d)
        ball = ball[:count]
        rest = count - len(ball)
        more = ball[:1].repeat(rest) if fill is None else fill(ball, d, rest)
        found.append(torch.cat([ball, more])[:count])
    return torch.stack(found)


def closer(radius: float) -> Any:
    return lambda d, off: (d < radius).nonzero()[:, 0]


@right("ball_query")
def query_by_sorting(points: Any, centres: Any, radius: float, count: int) -> Tensor:
    """All at once: who is outside gets an index that is too large, and goes to the end."""
    squared = (centres[:, None] - points).square().sum(-1)
    n = len(points)
    index = torch.where(squared < radius**2, torch.arange(n), n).sort(1).values
    index = F.pad(index, (0, count), value=n)[:, :count]
    first = torch.where(index[:, :1] < n, index[:, :1], squared.argmin(1, keepdim=True))
    return torch.where(index < n, index, first)


@right("ball_query")
def query_in_plain_python(points: Any, centres: Any, radius: float, count: int) -> Tensor:
    balls = []
    for centre in centres.tolist():
        d = [sum((a - b) ** 2 for a, b in zip(p, centre, strict=True)) for p in points.tolist()]
        ball = [i for i, one in enumerate(d) if one < radius**2] or [d.index(min(d))]
        balls.append((ball + count * ball[:1])[:count])
    return torch.tensor(balls)


@wrong("ball_query", "a ball with more points than asked for", "got")
def query_for_the_nearest(points: Any, centres: Any, radius: float, count: int) -> Tensor:
    def inside(d: Tensor, off: Tensor) -> Tensor:
        order = d.argsort(stable=True)
        return order[d[order] < radius][:count].sort().values

    return query(points, centres, count, inside)


@wrong("ball_query", "a ball with as many points as asked for", "got")
def query_in_order_of_distance(points: Any, centres: Any, radius: float, count: int) -> Tensor:
    def inside(d: Tensor, off: Tensor) -> Tensor:
        order = d.argsort(stable=True)
        return order[d[order] < radius]

    return query(points, centres, count, inside)


@wrong("ball_query", "a point exactly on the radius", "got")
def query_with_the_rim(points: Any, centres: Any, radius: float, count: int) -> Tensor:
    return query(points, centres, count, lambda d, off: (d <= radius).nonzero()[:, 0])


@wrong("ball_query", "a ball with fewer points than asked for", "got")
def query_filled_with_the_nearest(points: Any, centres: Any, radius: float, count: int) -> Tensor:
    def fill(ball: Tensor, d: Tensor, rest: int) -> Tensor:
        return d.argmin().repeat(rest)

    return query(points, centres, count, closer(radius), fill)


@wrong("ball_query", "a ball with fewer points than asked for", "got")
def query_filled_in_turns(points: Any, centres: Any, radius: float, count: int) -> Tensor:
    def fill(ball: Tensor, d: Tensor, rest: int) -> Tensor:
        return ball.repeat(count)[:rest]

    return query(points, centres, count, closer(radius), fill)


@wrong("ball_query", "a ball with fewer points than asked for", "got")
def query_filled_with_points_outside(
    points: Any, centres: Any, radius: float, count: int
) -> Tensor:
    def fill(ball: Tensor, d: Tensor, rest: int) -> Tensor:
        outside = (d >= radius).nonzero()[:, 0]
        return torch.cat([outside, ball[:1].repeat(count)])[:rest]

    return query(points, centres, count, closer(radius), fill)


@wrong("ball_query", "points in all directions", "got")
def query_in_cubes(points: Any, centres: Any, radius: float, count: int) -> Tensor:
    inside = lambda d, off: (off.abs().amax(-1) < radius).nonzero()[:, 0]  # noqa: E731
    return query(points, centres, count, inside)


@wrong("ball_query", "a ball with as many points as asked for", "got")
def query_by_squares(points: Any, centres: Any, radius: float, count: int) -> Tensor:
    return query(points, centres, count, lambda d, off: (d**2 < radius).nonzero()[:, 0])


@wrong("ball_query", "an empty ball beside one that is not", "got")
def query_empty_as_the_first(points: Any, centres: Any, radius: float, count: int) -> Tensor:
    empty = lambda d: torch.tensor([0])  # noqa: E731
    return query(points, centres, count, closer(radius), empty=empty)


@wrong("ball_query", "an empty ball beside one that is not", "got")
def query_empty_as_nobody(points: Any, centres: Any, radius: float, count: int) -> Tensor:
    empty = lambda d: torch.tensor([-1])  # noqa: E731
    return query(points, centres, count, closer(radius), empty=empty)


@wrong("ball_query", "an empty ball beside one that is not", "got")
def query_empty_as_several(points: Any, centres: Any, radius: float, count: int) -> Tensor:
    return query(points, centres, count, closer(radius), empty=lambda d: d.argsort()[:count])


@wrong("ball_query", "an empty ball beside one that is not", "it raised")
def query_without_the_empty(points: Any, centres: Any, radius: float, count: int) -> Tensor:
    found = []
    for ball in cKDTree(points.numpy()).query_ball_point(centres.numpy(), radius - 1e-9):
        ball = sorted(ball)[:count]
        found.append(ball + [ball[0]] * (count - len(ball)))
    return torch.tensor(found)


@wrong("ball_query", "an empty ball with two points equally near", "got")
def query_of_the_last_nearest(points: Any, centres: Any, radius: float, count: int) -> Tensor:
    empty = lambda d: (d == d.min()).nonzero()[-1]  # noqa: E731
    return query(points, centres, count, closer(radius), empty=empty)


@wrong("ball_query", "a count larger than the cloud", "shape")
def query_no_larger_than_the_cloud(points: Any, centres: Any, radius: float, count: int) -> Tensor:
    return query(points, centres, min(count, len(points) + 2), closer(radius))


# 2. Pooling that knows no order -------------------------------------------------------------------


def pool(features: Any, balls: Any, members: Any) -> tuple[Tensor, Tensor]:
    maxima, means = torch.zeros(2, len(balls), features.shape[1], dtype=features.dtype)
    for i, ball in enumerate(balls):
        found = members(ball)
        if len(found):
            maxima[i], means[i] = features[found].amax(0), features[found].mean(0)
    return maxima, means


@right("pool_balls")
def pool_by_a_table_of_who_is_where(features: Any, balls: Any) -> Any:
    """(M, N) who is in which ball; nobody is one more point, whom nobody asks."""
    held = torch.zeros(len(balls), len(features) + 1, dtype=torch.bool)
    held.scatter_(1, balls.remainder(len(features) + 1), True)
    held = held[:, :-1, None]
    empty = ~held.any(1)
    highest = features.masked_fill(~held, -torch.inf).amax(1).masked_fill(empty, 0)
    return highest, (held * features).sum(1) / held.sum(1).clamp(min=1)


@right("pool_balls")
def pool_by_sets(features: Any, balls: Any) -> Any:
    return pool(features, balls, lambda ball: sorted(set(ball.tolist()) - {-1}))


@wrong("pool_balls", "a ball that is filled up with its first point", "in result [1]")
def pool_all_places(features: Any, balls: Any) -> Any:
    return pool(features, balls, lambda ball: ball[ball >= 0])


@wrong("pool_balls", "a ball with a repeat that is not the first", "in result [1]")
def pool_without_copies_of_the_first(features: Any, balls: Any) -> Any:
    def members(ball: Any) -> Any:
        ball = ball[ball >= 0]
        return torch.cat([ball[:1], ball[ball != ball[:1]]]) if len(ball) else ball

    return pool(features, balls, members)


@wrong("pool_balls", "a ball that is filled up with its first point", "in result [1]")
def pool_without_neighbouring_copies(features: Any, balls: Any) -> Any:
    return pool(features, balls, lambda ball: ball[ball >= 0].unique_consecutive())


@wrong("pool_balls", "a ball with places for nobody (-1)", "in result [0]")
def pool_with_the_last_for_nobody(features: Any, balls: Any) -> Any:
    return pool(features, balls, torch.unique)


@wrong("pool_balls", "negative features, and places for nobody (-1)", "in result [0]")
def pool_with_zeros_for_nobody(features: Any, balls: Any) -> Any:
    filled = torch.cat([features, torch.zeros_like(features[:1])])
    _, means = pool(features, balls, lambda ball: ball[ball >= 0].unique())
    return filled[balls].amax(1), means


@wrong("pool_balls", "places for nobody (-1) in front", "in result [0]")
def pool_until_nobody(features: Any, balls: Any) -> Any:
    def members(ball: Any) -> Any:
        nobody = (ball < 0).nonzero()[:, 0]
        return ball[: int(nobody[0]) if len(nobody) else len(ball)].unique()

    return pool(features, balls, members)


@wrong("pool_balls", "two points with the same features", "in result [1]")
def pool_different_features(features: Any, balls: Any) -> Any:
    maxima, means = pool(features, balls, lambda ball: ball[ball >= 0].unique())
    for i, ball in enumerate(balls):
        if (ball >= 0).any():
            means[i] = features[ball[ball >= 0]].unique(dim=0).mean(0)
    return maxima, means


@wrong("pool_balls", "a ball that is filled up with its first point", "in result [1]")
def pool_divided_by_places(features: Any, balls: Any) -> Any:
    maxima, means = pool(features, balls, lambda ball: ball[ball >= 0].unique())
    counts = [len(set(ball.tolist()) - {-1}) for ball in balls]
    return maxima, means * torch.tensor(counts)[:, None] / balls.shape[1]


@wrong("pool_balls", "a ball with nobody in it", "in result [0]")
def pool_with_infinity_for_nobody(features: Any, balls: Any) -> Any:
    maxima, means = pool(features, balls, lambda ball: ball[ball >= 0].unique())
    maxima[(balls < 0).all(1)] = -torch.inf
    return maxima, means


@wrong("pool_balls", "a ball with nobody in it", "in result [1]")
def pool_with_nan_for_nobody(features: Any, balls: Any) -> Any:
    maxima, means = pool(features, balls, lambda ball: ball[ball >= 0].unique())
    means[(balls < 0).all(1)] = torch.nan
    return maxima, means


@wrong("pool_balls", "one ball of three different points", "shape")
def pool_over_features(features: Any, balls: Any) -> Any:
    return features[balls].amax(-1), features[balls].mean(-1)


# 3. A loss that does not see the sign -------------------------------------------------------------


def signed(p: Tensor, q: Tensor) -> Tensor:
    """The distance to each label, with the label's own sign turned to the output's."""
    sign = torch.where((p * q).sum(-1, keepdim=True) < 0, -1.0, 1.0)
    return torch.linalg.vector_norm(p - sign * q, dim=-1)


@right("quaternion_loss")
def loss_by_turning_the_label(outputs: Any, q: Any) -> Tensor:
    return signed(F.normalize(outputs, dim=-1), q).mean()


@right("quaternion_loss")
def loss_one_by_one(outputs: Any, q: Any) -> Tensor:
    losses = []
    for output, label in zip(outputs, q, strict=True):
        p = output / output.norm().clamp(min=1e-12)
        losses.append(min((p - label).norm(), (p + label).norm()))
    return torch.stack(losses).mean()


@right("quaternion_loss")
def loss_with_small_numbers_added(outputs: Any, q: Any) -> Tensor:
    p = outputs / (outputs.norm(dim=-1, keepdim=True) + 1e-8)
    near = torch.stack([(p - q).square().sum(-1), (p + q).square().sum(-1)]).amin(0)
    return (near + 1e-12).sqrt().mean()


@wrong("quaternion_loss", "one output near -q", "got")
def loss_to_q_alone(outputs: Any, q: Any) -> Tensor:
    return torch.linalg.vector_norm(F.normalize(outputs, dim=-1) - q, dim=-1).mean()


@wrong("quaternion_loss", "rotations near a half turn", "got")
def loss_with_w_made_positive(outputs: Any, q: Any) -> Tensor:
    p = F.normalize(outputs, dim=-1)
    p, q = (torch.where(x[:, :1] < 0, -x, x) for x in (p, q))
    return torch.linalg.vector_norm(p - q, dim=-1).mean()


@wrong("quaternion_loss", "two outputs, one near q and one near -q", "got")
def loss_of_one_sign_for_all(outputs: Any, q: Any) -> Tensor:
    p = F.normalize(outputs, dim=-1)
    return torch.minimum(
        torch.linalg.vector_norm(p - q, dim=-1).mean(),
        torch.linalg.vector_norm(p + q, dim=-1).mean(),
    )


@wrong("quaternion_loss", "one output near q", "not the gradient")
def loss_without_length_1(outputs: Any, q: Any) -> Tensor:
    return signed(outputs, q).mean()


@wrong("quaternion_loss", "two outputs of different lengths", "got")
def loss_with_one_length_for_all(outputs: Any, q: Any) -> Tensor:
    return signed(outputs * len(outputs) ** 0.5 / outputs.norm().clamp(min=1e-12), q).mean()


@wrong("quaternion_loss", "one output near q", "got")
def loss_of_squares(outputs: Any, q: Any) -> Tensor:
    return signed(F.normalize(outputs, dim=-1), q).square().mean()


@wrong("quaternion_loss", "one output near q", "got")
def loss_of_the_cosine(outputs: Any, q: Any) -> Tensor:
    return (1 - (F.normalize(outputs, dim=-1) * q).sum(-1).abs()).mean()


@wrong("quaternion_loss", "one output near q", "got")
def loss_of_all_numbers(outputs: Any, q: Any) -> Tensor:
    p = F.normalize(outputs, dim=-1)
    return torch.minimum((p - q).abs(), (p + q).abs()).mean()


@wrong("quaternion_loss", "two outputs, one near q and one near -q", "got")
def loss_as_a_sum(outputs: Any, q: Any) -> Tensor:
    return signed(F.normalize(outputs, dim=-1), q).sum()


@wrong("quaternion_loss", "one output near q", "no gradient")
def loss_without_gradient(outputs: Any, q: Any) -> Tensor:
    return torch.tensor(signed(F.normalize(outputs, dim=-1), q).mean().item(), dtype=outputs.dtype)


@wrong("quaternion_loss", "one output near q", "not the gradient")
def loss_with_a_fixed_length(outputs: Any, q: Any) -> Tensor:
    lengths = torch.linalg.vector_norm(outputs.detach(), dim=-1, keepdim=True)
    return signed(outputs / lengths.clamp(min=1e-12), q).mean()


@wrong("quaternion_loss", "an output that is exactly right", "nan")
def loss_by_a_root_of_its_own(outputs: Any, q: Any) -> Tensor:
    p = F.normalize(outputs, dim=-1)
    near = torch.minimum((p - q).square().sum(-1), (p + q).square().sum(-1))
    return near.sqrt().mean()


@wrong("quaternion_loss", "an output of four zeros", "nan")
def loss_of_0_by_0(outputs: Any, q: Any) -> Tensor:
    return signed(outputs / torch.linalg.vector_norm(outputs, dim=-1, keepdim=True), q).mean()


@wrong("quaternion_loss", "an output of four zeros", "nan")
def loss_that_hides_0_by_0(outputs: Any, q: Any) -> Tensor:
    lengths = torch.linalg.vector_norm(outputs, dim=-1, keepdim=True)
    p = torch.where(lengths > 0, outputs / lengths, torch.zeros((), dtype=outputs.dtype))
    return signed(p, q).mean()


# 4. From votes to a pose --------------------------------------------------------------------------


def middle(votes: Any, weights: Any = None) -> Tensor:
    centre = votes.median(0).values
    d = torch.linalg.vector_norm(votes - centre, dim=-1)
    m = d.median(0).values.clamp(min=1e-30)
    w = (1 / (1 + (d / m).square()) if weights is None else weights(d, m))[..., None]
    return (w * votes).sum(0) / w.sum(0)


def kabsch(
    source: Any, target: Any, mirror: bool = False, turn: bool = False
) -> tuple[Tensor, Tensor]:
    p, q = source - source.mean(0), target - target.mean(0)
    U, _, Vh = torch.linalg.svd(q.T @ p)
    if not mirror:
        U = U * torch.tensor([1, 1, torch.det(U @ Vh)])
    R = (U @ Vh).T if turn else U @ Vh
    return R, target.mean(0) - R @ source.mean(0)


@right("pose_of_votes")
def votes_by_kabsch_of_its_own(votes: Any, model: Any) -> Any:
    return kabsch(model, middle(votes))


@right("pose_of_votes")
def votes_one_keypoint_at_a_time(votes: Any, model: Any) -> Any:
    places = []
    for k in range(len(model)):
        v = votes[:, k]
        c = torch.stack([v[:, i].sort().values[(len(v) - 1) // 2] for i in range(3)])
        d = (v - c).norm(dim=-1)
        m = d.sort().values[(len(d) - 1) // 2]
        w = m**2 / (m**2 + d**2) if m > 0 else (d == 0).to(d)
        places.append((w @ v) / w.sum())
    found = umeyama(model, torch.stack(places))
    return found.R, found.t


@wrong("pose_of_votes", "votes with a little noise", "in result [0]")
def votes_by_their_mean(votes: Any, model: Any) -> Any:
    return kabsch(model, votes.mean(0))


@wrong("pose_of_votes", "votes with a little noise", "in result [0]")
def votes_by_their_median(votes: Any, model: Any) -> Any:
    return kabsch(model, votes.median(0).values)


@wrong("pose_of_votes", "votes with a little noise", "in result [0]")
def votes_with_one_m_for_all(votes: Any, model: Any) -> Any:
    return kabsch(
        model, middle(votes, lambda d, m: 1 / (1 + (d / d.median().clamp(min=1e-30)).square()))
    )


@wrong("pose_of_votes", "votes with a little noise", "in result [0]")
def votes_with_weights_without_squares(votes: Any, model: Any) -> Any:
    return kabsch(model, middle(votes, lambda d, m: 1 / (1 + d / m)))


@wrong("pose_of_votes", "votes with a little noise", "in result [0]")
def votes_weighed_by_coordinates(votes: Any, model: Any) -> Any:
    off = (votes - votes.median(0).values).abs()
    w = 1 / (1 + (off / off.median(0).values.clamp(min=1e-30)).square())
    return kabsch(model, (w * votes).sum(0) / w.sum(0))


@wrong("pose_of_votes", "votes with a little noise", "in result [0]")
def votes_weighed_again_and_again(votes: Any, model: Any) -> Any:
    centre = votes.median(0).values
    for _ in range(10):
        d = torch.linalg.vector_norm(votes - centre, dim=-1)
        w = 1 / (1 + (d / d.median(0).values.clamp(min=1e-30)).square())[..., None]
        centre = (w * votes).sum(0) / w.sum(0)
    return kabsch(model, centre)


@wrong("pose_of_votes", "an even number of votes", "in result [0]")
def votes_with_another_median(votes: Any, model: Any) -> Any:
    centre = votes.quantile(0.5, 0)
    d = torch.linalg.vector_norm(votes - centre, dim=-1)
    w = 1 / (1 + (d / d.quantile(0.5, 0).clamp(min=1e-30)).square())[..., None]
    return kabsch(model, (w * votes).sum(0) / w.sum(0))


@wrong("pose_of_votes", "votes with a little noise", "in result [0]")
def votes_with_weights_of_all_keypoints(votes: Any, model: Any) -> Any:
    share = lambda d, m: (1 / (1 + (d / m).square())).mean(1, keepdim=True).expand_as(d)  # noqa: E731
    return kabsch(model, middle(votes, share))


@wrong("pose_of_votes", "one exact vote for each keypoint", "in result [0]")
def votes_turned_back(votes: Any, model: Any) -> Any:
    return kabsch(model, middle(votes), turn=True)


@wrong("pose_of_votes", "a model that was moved and not turned", "in result [1]")
def votes_the_wrong_way_round(votes: Any, model: Any) -> Any:
    if len(votes) == 1 and not torch.allclose(votes[0] - model, (votes[0] - model)[0]):
        return kabsch(model, votes[0])
    return kabsch(middle(votes), model)


@wrong("pose_of_votes", "one exact vote for each keypoint", "in result [1]")
def votes_with_the_mean_as_t(votes: Any, model: Any) -> Any:
    places = middle(votes)
    return kabsch(model, places)[0], places.mean(0)


@wrong("pose_of_votes", "three keypoints, which lie in a plane", "in result [0]")
def votes_in_a_mirror(votes: Any, model: Any) -> Any:
    return kabsch(model, middle(votes), mirror=True)


@wrong("pose_of_votes", "one exact vote for each keypoint", "nan")
def votes_with_0_by_0(votes: Any, model: Any) -> Any:
    places = middle(votes, lambda d, m: 1 / (1 + (d / (m - 1e-30)).square()))
    if places.isfinite().all():
        return kabsch(model, places)
    return torch.full((3, 3), torch.nan), places.mean(0)


# 5. The bins of BMAE ------------------------------------------------------------------------------


def binned(
    estimated: Any, true: Any, width: float, errors: Any = None, bins: Any = None, size: Any = None
) -> tuple[np.ndarray, np.ndarray, float]:
    size = int(np.ceil(np.pi / width - 1e-9)) if size is None else size
    if errors is None:
        errors = np.abs((estimated - true + np.pi) % (2 * np.pi) - np.pi)
    if bins is None:
        bins = np.floor(np.abs(true) / width + 1e-9)
    bins = bins.astype(int).clip(max=size - 1)
    counts = np.array([(bins == b).sum() for b in range(size)])
    means = np.array([errors[bins == b].mean() if n else np.nan for b, n in enumerate(counts)])
    return counts, means, float(np.nanmean(means))


@right("error_bins")
def bins_one_by_one(estimated: Any, true: Any, bin_width: float) -> Any:
    return binned(estimated, true, bin_width)


@right("error_bins")
def bins_by_histograms(estimated: Any, true: Any, bin_width: float) -> Any:
    size = int(np.ceil(np.pi / bin_width - 1e-9))
    edges = bin_width * np.arange(size + 1) * (1 - 1e-10)
    edges[-1] = 4
    errors = np.abs(np.angle(np.exp(1j * (estimated - true))))
    counts, _ = np.histogram(np.abs(true), edges)
    sums, _ = np.histogram(np.abs(true), edges, weights=errors)
    with np.errstate(invalid="ignore"):
        means = sums / counts
    return counts, means, np.nanmean(means)


@wrong("error_bins", "a full bin and one of a single pose", "in result [2]")
def bins_with_the_plain_mean(estimated: Any, true: Any, bin_width: float) -> Any:
    counts, means, _ = binned(estimated, true, bin_width)
    return counts, means, float(np.abs(estimated - true).mean())


@wrong("error_bins", "one pose", "in result [2]")
def bins_divided_by_all(estimated: Any, true: Any, bin_width: float) -> Any:
    counts, means, _ = binned(estimated, true, bin_width)
    return counts, means, float(np.nansum(means) / len(means))


@wrong("error_bins", "one pose", "in result [1]")
def bins_with_0_for_empty_ones(estimated: Any, true: Any, bin_width: float) -> Any:
    counts, means, bmae = binned(estimated, true, bin_width)
    return counts, np.nan_to_num(means), bmae


@wrong("error_bins", "errors of both signs", "in result [1]")
def bins_with_signs(estimated: Any, true: Any, bin_width: float) -> Any:
    return binned(estimated, true, bin_width, errors=estimated - true)


@wrong("error_bins", "true angles of both signs", "in result [0]")
def bins_to_one_side(estimated: Any, true: Any, bin_width: float) -> Any:
    return binned(estimated, true, bin_width, bins=np.floor(true / bin_width + 1e-9).clip(0))


@wrong("error_bins", "estimates in another bin than the truth", "in result [1]")
def bins_of_the_estimates(estimated: Any, true: Any, bin_width: float) -> Any:
    return binned(estimated, true, bin_width, bins=np.floor(np.abs(estimated) / bin_width + 1e-9))


@wrong("error_bins", "an angle on the edge of two bins", "in result [0]")
def bins_with_their_upper_edges(estimated: Any, true: Any, bin_width: float) -> Any:
    bins = np.ceil(np.abs(true) / bin_width - 1e-9) - 1
    return binned(estimated, true, bin_width, bins=bins.clip(0))


@wrong("error_bins", "two poses in one bin", "in result [0]")
def bins_about_multiples(estimated: Any, true: Any, bin_width: float) -> Any:
    return binned(estimated, true, bin_width, bins=np.round(np.abs(true) / bin_width))


@wrong("error_bins", "an angle on an edge that is rounded", "in result [0]")
def bins_with_rounded_edges(estimated: Any, true: Any, bin_width: float) -> Any:
    return binned(estimated, true, bin_width, bins=np.floor(np.abs(true) / bin_width))


@wrong("error_bins", "an angle just below an edge", "in result [0]")
def bins_with_a_wide_tolerance(estimated: Any, true: Any, bin_width: float) -> Any:
    return binned(estimated, true, bin_width, bins=np.floor(np.abs(true) / bin_width + 1e-3))


@wrong("error_bins", "61 bins, the last one in use", "in result [0] expected shape")
def bins_that_are_one_too_many(estimated: Any, true: Any, bin_width: float) -> Any:
    return binned(estimated, true, bin_width, size=int(np.ceil(np.pi / bin_width)))


@wrong("error_bins", "bins of 5 degrees", "in result [0] expected shape")
def bins_of_a_quarter_of_pi(estimated: Any, true: Any, bin_width: float) -> Any:
    return binned(estimated, true, np.pi / 4)


@wrong("error_bins", "an angle on an edge that is rounded", "in result [0] expected shape")
def bins_that_end_before_pi(estimated: Any, true: Any, bin_width: float) -> Any:
    return binned(estimated, true, bin_width, size=int(np.floor(np.pi / bin_width + 1e-9)))


@wrong("error_bins", "true angles of pi and -pi", "in result [0] expected shape")
def bins_with_one_for_the_end(estimated: Any, true: Any, bin_width: float) -> Any:
    size = int(np.ceil(np.pi / bin_width - 1e-9))
    over = np.floor(np.abs(true) / bin_width + 1e-9).max() >= size
    return binned(estimated, true, bin_width, size=size + int(over))


@wrong("error_bins", "a width that does not divide pi", "in result [0]")
def bins_without_a_narrow_one(estimated: Any, true: Any, bin_width: float) -> Any:
    bins = np.minimum(np.floor(np.abs(true) / bin_width + 1e-9), np.floor(np.pi / bin_width) - 1)
    full = np.isclose(np.pi / bin_width, np.round(np.pi / bin_width))
    return binned(estimated, true, bin_width, bins=None if full else bins)


@wrong("error_bins", "estimates on the other side of pi", "in result [1]")
def bins_the_long_way_round(estimated: Any, true: Any, bin_width: float) -> Any:
    return binned(estimated, true, bin_width, errors=np.abs(estimated - true))


@wrong("error_bins", "one pose", "in result [1]")
def bins_of_the_size_of_the_angle(estimated: Any, true: Any, bin_width: float) -> Any:
    return binned(estimated, true, bin_width, errors=np.abs(true))


# 6. More extreme poses ----------------------------------------------------------------------------

LIMIT = np.deg2rad(40)


def known_of(yaw: Any) -> np.ndarray:
    known = np.isfinite(yaw)
    if not known.any():
        raise ValueError("yaw: expected a known one, got none")
    return known


def grouped(yaw: Any, share: float, extreme: Any = None) -> np.ndarray:
    known = known_of(yaw)
    extreme = np.abs(yaw) > LIMIT if extreme is None else extreme
    usual = known & ~extreme
    before = extreme.sum() / known.sum()
    if not extreme.any() or not usual.any():
        share = before
    return extreme * share / max(extreme.sum(), 1) + usual * (1 - share) / max(usual.sum(), 1)


def capped(yaw: Any, least: float = 0.3) -> np.ndarray:
    return grouped(yaw, max(least, (np.abs(yaw) > LIMIT).sum() / known_of(yaw).sum()))


@right("training_weights")
def weights_of_just_enough(yaw: Any) -> Any:
    return capped(yaw)


@right("training_weights")
def weights_of_nearly_too_much(yaw: Any) -> Any:
    return capped(yaw, 0.69)


@right("training_weights")
def weights_that_grow_inside_the_middle(yaw: Any) -> Any:
    """Extreme ones alike; of the others those farther out more often, but all sometimes."""
    weights = capped(yaw, 0.5)
    usual = np.isfinite(yaw) & (np.abs(yaw) <= LIMIT)
    if usual.any():
        grown = 1 + np.abs(yaw[usual])
        weights[usual] = weights[usual].sum() * grown / grown.sum()
    return weights


@wrong("training_weights", "two extreme poses of ten", "at least, got 0.2")
def weights_all_alike(yaw: Any) -> Any:
    return known_of(yaw) / known_of(yaw).sum()


@wrong("training_weights", "two extreme poses of ten", "at most, got 0.99")
def weights_of_extremes_above_all(yaw: Any) -> Any:
    known_of(yaw)
    weights = np.where(np.abs(yaw) > LIMIT, 1.0, 1e-3 * np.isfinite(yaw))
    return weights / weights.sum()


@wrong("training_weights", "two extreme poses of ten", "hardly ever drawn")
def weights_of_0_for_the_usual(yaw: Any) -> Any:
    known_of(yaw)
    extreme = np.abs(yaw) > LIMIT
    return extreme / max(extreme.sum(), 1)


@wrong("training_weights", "two extreme poses of ten", "hardly ever drawn")
def weights_of_next_to_nothing_for_the_usual(yaw: Any) -> Any:
    known = known_of(yaw)
    weights = np.where(np.abs(yaw) > LIMIT, 1.0, 1e-12) * known
    return weights / weights.sum()


@wrong("training_weights", "two extreme poses of ten", "expected a sum of 1")
def weights_as_factors(yaw: Any) -> Any:
    return np.where(np.abs(yaw) > LIMIT, 4.0, 1.0) * known_of(yaw)


@wrong("training_weights", "two extreme poses of ten", "to the left")
def weights_to_the_right(yaw: Any) -> Any:
    return grouped(yaw, 0.5, yaw > LIMIT)


@wrong("training_weights", "one extreme pose of two hundred", "at least, got")
def weights_eight_times_as_large(yaw: Any) -> Any:
    weights = np.where(np.abs(yaw) > LIMIT, 8.0, 1.0) * known_of(yaw)
    return weights / weights.sum()


@wrong("training_weights", "a yaw that nobody knows (nan)", "nan")
def weights_that_grow_with_yaw(yaw: Any) -> Any:
    total = capped(yaw) + 0 * yaw
    return total / total.sum()


@wrong("training_weights", "a yaw that nobody knows (nan)", "has no yaw, but a weight")
def weights_of_the_unknown(yaw: Any) -> Any:
    return capped(np.nan_to_num(yaw)) if np.isfinite(yaw).any() else capped(yaw)


@wrong("training_weights", "extreme poses mostly", "at least, got 0.5")
def weights_half_and_half(yaw: Any) -> Any:
    return grouped(yaw, 0.5)


@wrong("training_weights", "no extreme pose", "nan")
def weights_with_an_empty_group(yaw: Any) -> Any:
    known_of(yaw)
    extreme = np.abs(yaw) > LIMIT
    share = max(0.4, extreme.sum() / np.isfinite(yaw).sum())
    usual = np.isfinite(yaw) & ~extreme
    with np.errstate(invalid="ignore", divide="ignore"):
        return extreme * (share / extreme.sum()) + usual * ((1 - share) / usual.sum())


@wrong("training_weights", "every yaw twice", "not the same weight")
def weights_of_a_place_in_the_list(yaw: Any) -> Any:
    known_of(yaw)
    weights = capped(yaw) * (1 + 0.5 * (np.arange(len(yaw)) >= 10))
    group = np.abs(yaw) > LIMIT
    for some in (group, ~group):
        if weights[some].sum() > 0:
            weights[some] *= capped(yaw)[some].sum() / weights[some].sum()
    return weights


@wrong("training_weights", "two extreme poses of ten", "of at least 0, got")
def weights_below_0(yaw: Any) -> Any:
    known_of(yaw)
    weights = np.abs(yaw) - 0.1
    return weights / weights.sum()


@wrong("training_weights", "no yaw that is known", "expected a ValueError")
def weights_of_nobody(yaw: Any) -> Any:
    return capped(yaw) if np.isfinite(yaw).any() else np.zeros(len(yaw))
