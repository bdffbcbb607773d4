"""The checks of chapter 4's exercises: what they are tried on, their hints, and what is right."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from book.tools.checks import Exercise
from book.tools.gradients import gradient_at_leaf
from book.tools.values import difference
from posecore import clouds, metrics, rotations
from posecore.arrays import fail
from posecore.methods.points_to_pose.losses import PoseLoss
from posecore.methods.points_to_pose.network import Prediction
from posecore.methods.points_to_pose.voting import keypoint_pose, robust_mean

SECONDS = 10.0

EXTREME = float(np.deg2rad(40))  # a yaw of more than this, to either side
FEWEST, MOST = 0.3, 0.7  # of the draws of a training, that are to be extreme

Inputs = Iterator[tuple]


def _tensor(values: object) -> Tensor:
    return torch.as_tensor(np.asarray(values), dtype=torch.float64)


# 1. A ball query ----------------------------------------------------------------------------------


def ball_query(points: Tensor, centres: Tensor, radius: float, count: int) -> Tensor:
    """(M, count): the first points by index that are nearer to each centre than the radius."""
    return clouds.ball_query(points, centres, radius, count)


def _balls(rng: np.random.Generator) -> Inputs:
    line = _tensor([[x, 0, 0] for x in (0, 2, 4, 1, 3, 8)])
    first, three = line[:1], line[[0, 3, 2]]
    yield "a ball with as many points as asked for", line, first, 2.5, 3
    yield "a ball with more points than asked for", line, first, 4.5, 3
    yield "a ball with fewer points than asked for", line[[3, 1, 0, 5]], first, 3.0, 5
    yield "three centres", line, three, 1.5, 4
    yield "another radius and count", line, three, 2.5, 2
    sides = _tensor([[0.7, 0.7, 0], [0.5, 0, 0.5], [0, 0.9, 0.9], [0.5, -0.5, 0.5], [0, -0.7, 0]])
    yield "points in all directions", sides, _tensor([[0, 0, 0]]), 0.95, 4
    yield "a small radius", 0.01 * sides, _tensor([[0, 0, 0]]), 0.0095, 4
    for n, m, radius, count in ((12, 4, 0.8, 4), (20, 6, 1.5, 8), (24, 3, 0.6, 5)):
        points = _tensor(rng.normal(size=(n, 3)))
        yield "a random cloud", points, points[:m].clone(), radius, count
    yield "a point exactly on the radius", line, first, 2.0, 3
    twice = torch.cat([line[1:3], line[1:3]])
    yield "two points in one place", twice, line[1:2], 1.5, 4
    yield "a count larger than the cloud", line[:3], line[:2], 5.0, 6
    yield "a cloud of one point", first, first, 1.0, 3
    away = _tensor([[5.75, 0, 0], [0, 0, 0]])
    yield "an empty ball beside one that is not", line, away, 1.25, 3
    yield "an empty ball far from the cloud", line, _tensor([[-3e4, 9, 1]]), 1.0, 2
    level = _tensor([[9, 0, 0], [0, 2, 0], [0, -2, 0]])
    yield "an empty ball with two points equally near", level, _tensor([[0, 0, 0]]), 1.0, 2


check_ball_query = Exercise(
    ball_query,
    _balls,
    hints=(
        {
            "empty ball": "Which point does an empty ball hold? Read the list again.",
            "exactly on": "In the ball is what is nearer than the radius. Is this point nearer?",
            "fewer points": "What fills the places that are left over?",
            "larger than the cloud": "There may be more places than points in the whole cloud.",
            "more points": "Which ones stay, if there are too many? It is not the nearest.",
            "all directions": "A ball is round. How far away is a point with three coordinates?",
            "": "Take one centre, and write down by hand the indices of the points in its ball.",
        },
        "For each centre: d = torch.linalg.vector_norm(points - centre, dim=-1), then "
        "inside = (d < radius).nonzero()[:, 0][:count], which is in the order of indices. If it "
        "is empty, inside = d.argmin()[None]. Then put inside[0] into all places that are left.",
    ),
    seconds=SECONDS,
)


# 2. Pooling that knows no order -------------------------------------------------------------------


def pool_balls(features: Tensor, balls: Tensor) -> tuple[Tensor, Tensor]:
    """Maximum and mean (M, C) of the features (N, C) of those who are in each ball (M, K)."""
    maxima, means = features.new_zeros(2, len(balls), features.shape[1]).unbind()
    for i, ball in enumerate(balls):
        members = features[ball[ball >= 0].unique()]
        if len(members):
            maxima[i], means[i] = members.amax(0), members.mean(0)
    return maxima, means


def _filled_balls(rng: np.random.Generator) -> Inputs:
    features = _tensor([[1, -2], [5, 4], [3, -9], [-7, 8], [2, 6]])

    def balls(*rows: list[int]) -> Tensor:
        return torch.tensor(rows)

    yield "one ball of three different points", features, balls([0, 2, 4])
    yield "two balls", features, balls([0, 2, 4], [1, 3, 4])
    yield "a ball that is filled up with its first point", features, balls([1, 2, 1, 1])
    yield "a ball with a repeat that is not the first", features, balls([0, 1, 3, 1])
    yield "the same ball in another order", features, balls([1, 3, 0, 1])
    yield "a ball with places for nobody (-1)", features, balls([0, 1, -1, -1])
    yield "places for nobody (-1) in front", features, balls([-1, 3, 2, -1])
    yield "negative features, and places for nobody (-1)", -features.abs(), balls([0, -1, 2, -1])
    alike = features[[0, 0, 1, 3]]
    yield "two points with the same features", alike, balls([0, 1, 2, 2])
    for n, c, m, k in ((6, 4, 5, 8), (9, 1, 3, 4), (5, 3, 7, 5)):
        drawn = torch.from_numpy(rng.integers(-1, n, size=(m, k)))
        drawn[:, 0] = drawn[:, 0].abs()
        yield "random balls", _tensor(rng.normal(size=(n, c))), drawn
    yield "a ball of one point", features, balls([3, 3, 3])
    yield "a ball with nobody in it", features, balls([-1, -1], [4, 3])


check_pool_balls = Exercise(
    pool_balls,
    _filled_balls,
    hints=(
        {
            "with nobody": "What are the maximum and the mean of nobody, by the list?",
            "for nobody": "-1 is an index, too: features[-1] is a point. Leave these out before "
            "you look at any features.",
            "filled up": "Does a point that is there twice count twice?",
            "repeat": "A repeat can stand anywhere in the ball, and not only for its first point.",
            "same features": "Two points are the same if their indices are, not their features.",
            "": "What is asked of each ball, and what of each feature? Two results, each (M, C).",
        },
        "For one ball: members = ball[ball >= 0].unique() are its points, each once. Then "
        "features[members].amax(0) and features[members].mean(0); zeros if there is no member.",
    ),
    seconds=SECONDS,
)


# 3. A loss that does not see the sign -------------------------------------------------------------


def quaternion_loss(outputs: Tensor, q: Tensor) -> Tensor:
    """The mean distance of normalised outputs (B, 4) to the nearer of q (B, 4) and -q."""
    said = Prediction(rotation=outputs)
    return PoseLoss()(said, rotations.quaternion_to_matrix(q))["rotation"]


def _quaternions(rng: np.random.Generator) -> Inputs:
    def unit(*rows: list[float]) -> Tensor:
        return F.normalize(_tensor(rows), dim=-1)

    def said(values: Tensor) -> Tensor:
        return values.detach().clone().requires_grad_()

    def some(count: int) -> Tensor:
        return F.normalize(_tensor(rng.normal(size=(count, 4))), dim=-1)

    true = unit([4, 1, -2, 2])
    near = unit([4, 1, -1, 2])
    yield "one output near q", said(near), true
    yield "one output near -q", said(-near), true
    yield "an output of length 3", said(3 * near), true
    yield "an output of length 0.2", said(-0.2 * near), true
    small = unit([0.05, 3, -2, 1])
    yield "rotations near a half turn, w of another sign", said(small - unit([0.4, 0, 0, 0])), small
    both = torch.cat([near, -near])
    yield "two outputs, one near q and one near -q", said(both), torch.cat([true, true])
    yield "two outputs of different lengths", said(both * _tensor([[0.5], [4]])), some(2)
    for count in (3, 5, 8):
        yield "random outputs", said(_tensor(rng.normal(size=(count, 4)))), some(count)
    yield "true quaternions of both signs", said(some(4)), torch.cat([some(2), -some(2)])
    yield "an output that is exactly right", said(_tensor([[2, 0, 0, 0]])), unit([1, 0, 0, 0])
    yield "an output of four zeros", said(torch.zeros(1, 4, dtype=torch.float64)), true
    yield "zeros among others", said(_tensor([[0, 0, 0, 0], [1, 2, 3, 4]])), some(2)


def _is_the_loss(answer: Tensor, outputs: Tensor, q: Tensor) -> str:
    expected = quaternion_loss(outputs, q)
    if words := difference(answer.detach(), expected.detach(), 1e-5):
        return words
    gradient = gradient_at_leaf(answer)
    if gradient is None:
        return "the number is right, but no gradient can go back through it to the outputs"
    wanted = torch.autograd.grad(expected, outputs)[0]
    if not gradient.isfinite().all():
        return "the number is right, but the gradient that comes back to the outputs is nan"
    # Where an output is 0 the direction of the gradient is anybody's.
    known = torch.linalg.vector_norm(outputs.detach(), dim=-1) >= 1e-6
    if words := difference(gradient.to(wanted)[known], wanted[known], 1e-5):
        return f"the number is right, but not the gradient that comes back to the outputs: {words}"
    return ""


check_quaternion_loss = Exercise(
    quaternion_loss,
    _quaternions,
    hints=(
        {
            "exactly right": "The root has no derivative at 0. torch.linalg.vector_norm knows what "
            "to do there, a root of your own does not.",
            "no gradient": "A gradient goes through arithmetic, and not through .item(), float() "
            "or torch.tensor(...).",
            "not the gradient": "Outputs may have any length. To bring them to length 1 is a step "
            "through which the gradient goes, too.",
            "zeros": "What is 0 / 0? Is there a function that normalises and looks out for it?",
            "half turn": "Near a half turn, w is nearly 0, and its sign tells nothing. Look at all "
            "four numbers.",
            "different lengths": "Each output is brought to length 1 by a length of its own.",
            "two outputs": "Each rotation of the batch has a nearer sign of its own. And the loss "
            "is a mean.",
            "-q": "q and -q are one rotation. How far is your output from each of the two?",
            "": "It is a distance in four dimensions, of one quaternion to another; then a mean.",
        },
        "p = torch.nn.functional.normalize(outputs, dim=-1). Take the lengths of p - q and p + q "
        "with torch.linalg.vector_norm(..., dim=-1), the smaller of both for each row with "
        "torch.minimum, and at the end the mean.",
    ),
    judge=_is_the_loss,
    seconds=SECONDS,
)


# 4. From votes to a pose --------------------------------------------------------------------------


def pose_of_votes(votes: Tensor, model: Tensor) -> tuple[Tensor, Tensor]:
    """The pose R (3, 3), t (3,) that the votes (S, K, 3) for the keypoints (K, 3) come to."""
    R, t = keypoint_pose(robust_mean(votes[None]), model)
    return R[0], t[0]


def _votes(rng: np.random.Generator) -> Inputs:
    corners = _tensor([[0, 0, 0], [0.1, 0, 0], [0, 0.16, 0], [0, 0, 0.2], [0.1, 0.16, 0.05]])

    def posed(model: Tensor) -> Tensor:
        R = torch.from_numpy(rotations.random_rotations(generator=rng))
        return model @ R.mT + _tensor(rng.normal(scale=0.3, size=3))

    def around(places: Tensor, count: int, noise: float) -> Tensor:
        return places + _tensor(rng.normal(scale=noise, size=(count, *places.shape)))

    yield "one exact vote for each keypoint", posed(corners)[None], corners
    moved = (corners + _tensor([0.3, -0.1, 0.6]))[None]
    yield "a model that was moved and not turned", moved, corners
    yield "votes with a little noise", around(posed(corners), 9, 0.004), corners
    yield "an even number of votes", around(posed(corners), 6, 0.02), corners
    for seeds, keypoints in ((15, 9), (8, 4), (21, 6)):
        model = _tensor(rng.normal(scale=0.08, size=(keypoints, 3)))
        yield "a random model", around(posed(model), seeds, 0.01), model
    wild = around(posed(corners), 11, 0.003)
    wild[[1, 4, 6]] += _tensor(rng.normal(scale=0.5, size=(3, len(corners), 3)))
    yield "three wild votes of eleven", wild, corners
    one = around(posed(corners), 9, 0.002)
    one[:, 2] += _tensor(rng.normal(scale=0.05, size=(9, 3)))
    yield "one keypoint that is uncertain", one, corners
    flat = corners[[0, 1, 2]]
    for _ in range(3):
        yield "three keypoints, which lie in a plane", around(posed(flat), 7, 0.004), flat
    sure = posed(corners).repeat(7, 1, 1)
    sure[5:] += 0.2
    yield "votes that agree to the last digit, and two that do not", sure, corners


check_pose_of_votes = Exercise(
    pose_of_votes,
    _votes,
    hints=(
        {
            "nan": "What is 0 / 0? Where all votes agree, m is 0. So is d.",
            "not turned": "Which of the two clouds is to be moved, and onto which?",
            "[1]": "R is right. Where does it bring the middle of the model, and where should it?",
            "one exact vote": "One vote alone is the place of its keypoint. So look at the second "
            "step: which cloud is to be moved, and onto which?",
            "even number": "Which of two numbers in the middle is the median, by the list?",
            "in a plane": "The determinant of a rotation is 1. What is that of yours?",
            "": "Do it in two steps, and look at the first by itself: one place (3,) for each "
            "keypoint, from S votes.",
        },
        "centre = votes.median(0).values; d = torch.linalg.vector_norm(votes - centre, dim=-1), "
        "(S, K); m = d.median(0).values; w = 1 / (1 + (d / m.clamp(min=1e-30)) ** 2). The places "
        "are the sums of w[..., None] * votes, divided by those of w; umeyama(model, places) has R "
        "and t.",
    ),
    seconds=SECONDS,
)


# 5. The bins of BMAE ------------------------------------------------------------------------------


def error_bins(
    estimated: np.ndarray, true: np.ndarray, bin_width: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """How many poses each bin holds (B,), their mean errors (B,), and BMAE; all in radians."""
    errors = np.abs(metrics.angle_difference(estimated, true))
    bmae = metrics.balanced_mean_angular_error(errors, true, bin_width)
    size = int(np.ceil(np.pi / bin_width - 1e-9))
    bins = np.minimum(np.floor(np.abs(true) / bin_width + 1e-9).astype(int), size - 1)
    counts = np.bincount(bins, minlength=size)
    sums = np.bincount(bins, errors, minlength=size)
    means = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
    return counts, means, bmae


def _angles(rng: np.random.Generator) -> Inputs:
    def case(true: list[float], off: list[float]) -> tuple[np.ndarray, np.ndarray]:
        return np.array(true) + np.array(off), np.array(true)

    wide = np.pi / 4
    yield "one pose", *case([0.1], [0.02]), wide
    yield "two poses in one bin", *case([0.1, 0.6], [0.02, 0.04]), wide
    yield "a full bin and one of a single pose", *case([0.1, 0.2, 1], [0.01, 0.01, 0.07]), wide
    yield "errors of both signs", *case([0.1, 0.3], [0.03, -0.03]), wide
    yield "true angles of both signs", *case([0.1, -0.2, -0.9], [0.01, 0.03, 0.05]), wide
    yield "estimates in another bin than the truth", *case([0.7, 0.8], [0.2, -0.3]), wide
    yield "an angle on the edge of two bins", *case([np.pi / 4, 0.1], [0.02, 0.04]), wide
    yield "bins of 5 degrees", *case([0.1, 0.2, 0.5], [0.01, 0.02, 0.06]), np.pi / 36
    yield "an angle on an edge that is rounded", *case([0.3, 0.21], [0.02, 0.04]), 0.1
    for width in (np.pi / 36, 0.1, 0.25):
        true = rng.normal(scale=0.6, size=30).clip(-3, 3)
        yield "many frontal poses, few extreme ones", true + rng.normal(size=30) / 10, true, width
    yield "true angles of pi and -pi", *case([np.pi, -np.pi, 3], [-0.1, 0.2, 0.1]), np.pi / 36
    yield "an angle just below an edge", *case([0.2 - 1e-7, 0.25], [0.02, 0.04]), 0.1
    yield "61 bins, the last one in use", *case([np.pi, 0.1], [-0.02, 0.04]), np.pi / 61
    yield "a width that does not divide pi", *case([3.1, 2.9, 0.1], [-0.1, 0.2, 0.1]), 0.25
    yield "estimates on the other side of pi", np.array([-3.1, 3.0]), np.array([3.1, -3.1]), wide


check_error_bins = Exercise(
    error_bins,
    _angles,
    hints=(
        {
            "other side of pi": "How far is it from 179 to -179 degrees?",
            "pi and -pi": "The last bin includes its end. There is no bin after it.",
            "expected shape": "How many bins of this width does it take to reach pi?",
            "is rounded": "Print 0.3 / 0.1.",
            "not divide pi": "The last bin may be narrower than the others, and still be one.",
            "of both signs": "Left and right count alike, and so do too much and too little.",
            "another bin": "By what is a pose sorted into its bin: by the truth, or by what was "
            "estimated?",
            "in result [1]": "An error is the difference of estimate and truth. And a bin that "
            "holds nobody has no mean: it is nan.",
            "in result [2]": "First a mean inside each bin, then one over the bins, but only over "
            "those that hold a pose.",
            "": "To which bin a pose belongs is a matter of the true angle. There are as many as "
            "are needed to reach pi.",
        },
        "bins = np.floor(np.abs(true) / bin_width + 1e-9).astype(int), at most "
        "ceil(pi / bin_width - 1e-9) - 1. Errors: np.abs((estimated - true + pi) % (2 pi) - pi). "
        "np.bincount(bins, minlength=...) counts; np.bincount(bins, errors, minlength=...) adds "
        "the errors up. BMAE is np.nanmean of the means.",
    ),
    seconds=SECONDS,
)


# 6. More extreme poses ----------------------------------------------------------------------------


def training_weights(yaw: np.ndarray) -> np.ndarray:
    """How likely each cloud (N,) is to be drawn in a training that is to know extreme poses."""
    known, extreme = np.isfinite(yaw), np.abs(yaw) > EXTREME
    if not known.any():
        fail("yaw", "one that is known, or more", "none")
    share = max(extreme.sum() / known.sum(), 0.4) if extreme.any() else 0.0
    counts = max(extreme.sum(), 1), max((known & ~extreme).sum(), 1)
    return np.where(extreme, share / counts[0], (1 - share) / counts[1]) * known


def _yaws(rng: np.random.Generator) -> Inputs:
    def degrees(*values: float) -> np.ndarray:
        return np.deg2rad(np.array(values, dtype=float))

    few = degrees(0, 5, -3, 12, -20, 8, 1, -2, 55, -48)
    yield "two extreme poses of ten", few
    yield "extreme poses to the left only", degrees(0, 5, -3, 12, -20, 8, 1, -2, -62, -48)
    yield "every yaw twice", np.tile(few, 2)
    for size in (40, 300):
        yaw = np.where(rng.random(size) < 0.85, rng.normal(0, 8, size), rng.uniform(-75, 75, size))
        yield "a drive", np.deg2rad(np.append(yaw, [-70, 44]))
    left = np.append(rng.normal(0, 8, 60), [-50, -60, -44, -71, -58, -66, 47])
    yield "a drive that turns left mostly", np.deg2rad(left)
    yield "one extreme pose of two hundred", np.deg2rad(np.append(rng.normal(0, 8, 199), 51))
    yield "a yaw that nobody knows (nan)", np.append(few, np.nan)
    yield "many that nobody knows (nan)", np.insert(few, [0, 3, 3, 9], np.nan)
    yield "extreme poses mostly", degrees(50, -60, 70, 45, -52, 3, -61, 48, 66, -44)
    yield "no extreme pose", degrees(0, 5, -3, 12)
    yield "extreme poses only", degrees(50, -45, 62)
    yield "one cloud", degrees(3)
    yield "no yaw that is known (nan)", np.array([np.nan, np.nan])


def _teach_extremes(answer: np.ndarray, yaw: np.ndarray) -> str:
    known, extreme = np.isfinite(yaw), np.abs(yaw) > EXTREME
    if not np.isfinite(answer).all() or (answer < 0).any():
        worst = int(np.argmax(~(np.isfinite(answer) & (answer >= 0))))
        return f"expected weights of at least 0, got {answer[worst]:.3g} at [{worst}]"
    if (answer[~known] > 0).any():
        return f"the cloud at [{int(np.argmax(~known & (answer > 0)))}] has no yaw, but a weight"
    if (answer[known] < (least := 1e-3 / max(known.sum(), 1))).any():
        place = int(np.argmax(known & (answer < least)))
        return f"the cloud at [{place}] is hardly ever drawn, though its yaw is known"
    if abs(answer.sum() - 1) > 1e-6:
        return f"expected a sum of 1, got {answer.sum():.6g}"
    if words := _of_shares(answer, known, extreme):
        return words
    for side, name in ((yaw > EXTREME, "right"), (yaw < -EXTREME, "left")):
        before, after = side.sum() / known.sum(), answer[side].sum()
        if after < before - 1e-9:
            return f"extreme poses to the {name} are rarer than before: {after:.3g} < {before:.3g}"
    for i, one in enumerate(yaw):
        other = int(np.argmax(yaw == one)) if known[i] else i
        if abs(answer[i] - answer[other]) > 1e-6 * answer[i]:
            return f"the clouds at [{other}] and [{i}] have the same yaw, but not the same weight"
    return ""


def _of_shares(answer: np.ndarray, known: np.ndarray, extreme: np.ndarray) -> str:
    before, after = extreme.sum() / known.sum(), answer[extreme].sum()
    if not 0 < before < 1:
        return ""
    if after < max(before, FEWEST) - 1e-9:
        low = max(before, FEWEST)
        return f"expected an extreme pose in {low:.3g} of the draws at least, got {after:.3g}"
    if after > max(before, MOST) + 1e-9:
        high = max(before, MOST)
        return f"expected an extreme pose in {high:.3g} of the draws at most, got {after:.3g}"
    return ""


check_training_weights = Exercise(
    training_weights,
    _yaws,
    hints=(
        {
            "no extreme pose": "A group may be empty. What is 0 / 0?",
            "no yaw that": "There is nothing to draw from. What is to be done then, by the list?",
            "nan": "Any comparison with nan is False, and any sum with it is nan. Who has a yaw?",
            "at least, got": "Add up the weights of the extreme poses: are these the draws you "
            "wanted?",
            "of at least 0": "A probability is never below 0.",
            "same weight": "Only yaw may count, and not where in the list a cloud stands.",
            "at most": "A network that never sees a face from the front will not know it.",
            "to the": "Is a driver who looks left the same as one who looks right?",
            "sum of 1": "Divide by the sum, at the end.",
            "hardly ever drawn": "Whoever is known may be drawn, if seldom.",
            "": "Two groups, extreme and not. Which share of the draws should each of them have?",
        },
        "Give all extreme clouds together a share of 0.4, or what they have already if that is "
        "more, and the others the rest; inside a group all alike. Where one group is empty, "
        "the other has all. np.isfinite(yaw) tells who is known.",
    ),
    judge=_teach_extremes,
    seconds=SECONDS,
)
