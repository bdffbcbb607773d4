# ---
# jupyter:
#   jupytext:
#     cell_metadata_filter: tags,-all
#     formats: ipynb,py:percent
#     notebook_metadata_filter: jupytext,-jupytext.text_representation,-kernelspec
# ---

# %% [markdown]
# # Exercises: vector fields
#
# Seven functions for you to write, in six exercises from a warm-up to an open question.
# They need PyTorch, and what [chapter 8](../08_vector_fields.ipynb) explains.

# %% [markdown] tags=["solution"]
# **This is the teacher's edition, with the solutions.**
# The students' one is made from it: `python book/make.py start 08` puts it into `book/my_work/`.

# %% [markdown]
# **How it works**
#
# - Replace the line `...  # your code here`, run the cell, then run the check below it.
# - A check says *done*, *not done yet* or *not right yet*. If it is not right, the check shows the
#   first input where your answer differs, and a hint. The next try brings the second hint.
# - The page always goes on: after a check, the name that ends in `_here` is your function if it is
#   done, and the library's if not. So try the exercises in any order.
# - Keep the functions' names. To look at what yours does, add a cell of your own (`Esc`, then `B`)
#   and call it as the example in its docstring does.
# - `answer.inputs` are the arguments of that first input, `answer.expected` and `answer.got` the two
#   results: call your function with them, `f(*answer.inputs)`, to see what it does there.
#
# All numbers are torch tensors, and the inputs of the checks are `float64` unless a check says
# otherwise. Pixels are (x, y), x to the right and y down.

# %%
import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from book.ch08_vector_fields import checks
from book.ch08_vector_fields.drawing import exercises as draw
from book.tools.checks import use
from book.tools.syntax import forgive_syntax
from data_tools import renderer, sensors, shapes
from posecore import cameras, clouds, figures, metrics, poses, registration, rotations
from posecore.methods.vector_field import voting
from posecore.models import model_keypoints
from posecore.scale import choose, scale

forgive_syntax()  # a cell that is no Python says so, and the page goes on
generator = torch.Generator().manual_seed(0)
torch.set_default_dtype(torch.float64)

# %% [markdown]
# **The scene.** A teapot alone, in a picture of 160 x 120 pixels. Its keypoint is the tip of the
# spout. No network is needed here: we make the field ourselves, from the truth, and spoil it.

# %%
size = width, height = 160, 120
K = torch.tensor([[190.0, 0, 79.5], [0, 190, 59.5], [0, 0, 1]])
lamp = renderer.Light(position=[-0.4, -0.6, 0.0], power=0.5)


def shoot(number, R, t):
    """A photograph (H, W, 3) of a tabletop object alone, and its mask (H, W)."""
    scene = [renderer.prepare(shapes.make_object(number))], [(R.numpy(), t.numpy())]
    linear = renderer.render_colour(*scene, K.numpy(), size, [lamp], background=0.3)
    mask = renderer.render_labels(*scene, K.numpy(), size).instance == 0
    srgb = np.round(255 * sensors.linear_to_srgb(linear))
    return srgb.astype(np.uint8), torch.from_numpy(mask)


# %%
R = rotations.axis_angle_to_matrix(torch.deg2rad(torch.tensor([115.0, 0, 0])))
R = R @ rotations.axis_angle_to_matrix(torch.deg2rad(torch.tensor([0, 0, 20.0])))
t = torch.tensor([0.0, 0, 0.36])
photo, mask = shoot(5, R, t)
teapot = torch.from_numpy(np.array(shapes.make_object(5).vertices, float))
tip = teapot[teapot[:, 0].argmax()]
keypoint = cameras.project(K, poses.apply(R, t, tip[None]))[0]
pixels = mask.nonzero().flip(1).double()  # (P, 2), (x, y)
print(f"{len(pixels)} pixels, keypoint at {keypoint.numpy().round(1)}")


# %% [markdown]
# Every pixel's vector points at the tip. Then 3 degrees of noise are added, a network gives vectors
# of any length, and four pixels in ten say nonsense:

# %%
to_tip = keypoint - pixels
angle = torch.atan2(to_tip[:, 1], to_tip[:, 0])
angle = angle + torch.deg2rad(3 * torch.randn(len(pixels), generator=generator))
nonsense = torch.rand(len(pixels), generator=generator) < 0.4
angle = torch.where(nonsense, 7 * torch.rand(len(pixels), generator=generator), angle)
lengths = 0.5 + torch.rand(len(pixels), 1, generator=generator)
vectors = lengths * torch.stack([angle.cos(), angle.sin()], -1)  # (P, 2)

# %%
alt = "A white and blue teapot before grey; its keypoint is the tip of the spout, on the right"
figure = figures.picture(photo, width=4, alt=alt)
figures.draw_keypoints(figure.axes[0], keypoint[None])
figure

# %% [markdown]
# ## 1. Warm-up: where two rays meet
#
# A pixel $p$ says that the keypoint lies in the direction $u$, a pixel $q$ says in the direction
# $v$. Where do the two rays meet? Where $p + s\,u = q + r\,v$.
#
# | in | shape | |
# |---|---|---|
# | `p`, `q` | (N, 2) | the pixels where the rays start; N may be 0 |
# | `u`, `v` | (N, 2) | their directions, of any length but never 0 |
# | **out** | (N, 2) | the points where they meet; a row of `nan` where they do not |
#
# - A ray begins at its pixel. If the lines cross behind one of the pixels, the rays do not meet. If
#   they cross at the pixel itself, they do.
# - Call rays parallel if the sine of the angle between them is below $10^{-6}$, whatever the sign.
#   Parallel rays never meet, not even on the same line.
#
# The picture shows what is expected.

# %%
cases = {
    "they meet": [[0.0, 7], [2, -1], [1, 1], [1, 0.5]],
    "behind one": [[0.0, 7], [-2, 1], [1, 1], [1, 0.5]],
    "behind both": [[3.0, 5.5], [-2, 1], [3, 2], [-1, -0.5]],
    "parallel": [[0.0, 7], [2, -1], [1, 3], [2, -1]],
    "one line": [[0.0, 7], [2, -1], [8, 3], [-2, 1]],
}
p, u, q, v = torch.tensor(list(cases.values())).unbind(1)
shown = {title: np.array(rays) for title, rays in cases.items()}
draw.rays(shown, checks.intersect_rays(p, u, q, v).numpy())


# %%
def intersect_rays(p, u, q, v):
    """Where the rays from p (N, 2) along u and from q along v meet (N, 2); nan if they do not.

    >>> p, u = torch.tensor([[0.0, 0]]), torch.tensor([[1.0, 1]])
    >>> q, v = torch.tensor([[9.0, 4]]), torch.tensor([[-1.0, 0]])
    >>> intersect_rays(p, u, q, v)
    tensor([[4., 4.]])
    >>> intersect_rays(p, u, q, -v)
    tensor([[nan, nan]])
    """

    ### BEGIN SOLUTION
    def cross(a, b):
        return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]

    u, v = F.normalize(u, dim=-1), F.normalize(v, dim=-1)
    sine = cross(u, v)
    s, r = cross(q - p, v) / sine, cross(q - p, u) / sine
    meet = (sine.abs() >= 1e-6) & (s >= 0) & (r >= 0)
    return torch.where(meet[:, None], p + s[:, None] * u, torch.nan)
    ### END SOLUTION


# %%
answer = checks.check_intersect_rays(intersect_rays)
intersect_rays_here = use(answer, checks.intersect_rays)
answer

# %% [markdown]
# Draw 3000 pairs of pixels from the teapot. How good are their crossings?

# %%
pairs = torch.randint(len(pixels), (2, 3000), generator=generator)
(p, q), (u, v) = pixels[pairs], vectors[pairs]
crossings = intersect_rays_here(p, u, q, v)
meet = ~crossings.isnan().any(1)
off = (crossings - keypoint).norm(dim=1)
cosine = F.cosine_similarity(u, v).abs().clamp(max=1)  # of the lines: at most 90 degrees apart
degrees = torch.rad2deg(cosine.acos())
print(
    f"{meet.double().mean():.0%} of the pairs meet, of these {(off[meet] < 5).double().mean():.0%}"
)
print(f"within 5 px of the truth; the farthest is {off[meet].max():.0f} px off")
assert off[meet].max() > 300

# %% [markdown]
# Of two pixels that say no nonsense, it is the angle between the rays that counts:

# %%
honest = meet & ~nonsense[pairs].any(0)
wide = degrees > 30
assert off[honest & wide].median() < off[honest & ~wide].median() / 2
draw.crossings(degrees[honest].numpy(), off[honest].numpy())

# %% [markdown] tags=["solution"]
# **Discussion.** `torch.where` takes what is right from a quotient that may be infinite or `nan`;
# as no gradient is needed here, that does no harm. Comparing the sine with 0 exactly would not do:
# of two parallel vectors of different length, rounding leaves $10^{-17}$ and a point far away.
#
# The library's `voting.intersect_lines` crosses *lines*, and many at once: it needs no special case
# for a crossing behind a pixel, since the vote that follows gives such a point no votes.

# %% [markdown] tags=["solution"]
# A check of that: where rays meet, so do their lines.

# %% tags=["solution"]
lines = voting.intersect_lines(torch.stack([p, q], 1), torch.stack([u, v], 1))
assert torch.allclose(lines[meet], crossings[meet], rtol=1e-6)

# %% [markdown]
# ## 2. Counting the votes
#
# A crossing is only a hypothesis. Every pixel of the object may vote: does its vector point there?
# Pixel $i$ at $p_i$ with the vector $v_i$ is an *inlier* of the hypothesis $h$ if
#
# $$\cos\angle(h - p_i,\; v_i) > \theta$$
#
# | in | shape | |
# |---|---|---|
# | `pixels` | (P, 2) | where the pixels are; P may be 0 |
# | `vectors` | (P, 2) | what they say: of any length, also 0 |
# | `points` | (H, 2) | the hypotheses; H may be 0 |
# | `threshold` | a number | $\theta$, above 0 and below 1 |
# | **out** | (H,) | whole numbers: how many inliers each hypothesis has |
#
# - A pixel that points away from $h$ is no inlier.
# - If $h$ is on the pixel itself, there is no direction, and the pixel is no inlier. A vector of
#   length 0 votes for nothing.
#
# The picture shows what is expected: 200 crossings, and where most of the votes are.

# %%
points = crossings[meet]
points = points[((points > 0) & (points < torch.tensor(size))).all(1)][:200]
counts = checks.count_inliers(pixels, vectors, points, 0.99)
draw.votes(photo, points.numpy(), counts.numpy(), points[counts.argmax()].numpy())


# %%
def count_inliers(pixels, vectors, points, threshold):
    """For each of the points (H, 2), how many pixels (P, 2) point to it with their vectors (H,).

    >>> pixels, vectors = torch.zeros(2, 2), torch.tensor([[1.0, 0], [0, 5]])
    >>> count_inliers(pixels, vectors, torch.tensor([[4.0, 0.1], [-4, 0], [0, 0]]), 0.99)
    tensor([1, 0, 0])
    """
    ### BEGIN SOLUTION
    to_points = F.normalize(points[:, None] - pixels, dim=-1)  # (H, P, 2)
    cosines = (to_points * F.normalize(vectors, dim=-1)).sum(-1)  # (H, P)
    return (cosines > threshold).sum(1)
    ### END SOLUTION


# %%
answer = checks.check_count_inliers(count_inliers)
count_inliers_here = use(answer, checks.count_inliers)
answer

# %% [markdown]
# Now there is a RANSAC: draw pairs, cross them, count, and keep the best. How strict should the
# count be?

# %%
for threshold in (0.8, 0.99, 0.9999):
    counts = count_inliers_here(pixels, vectors, points, threshold)
    best = points[counts.argmax()]
    allowed = np.rad2deg(np.arccos(threshold))
    print(
        f"threshold {threshold}: {allowed:4.1f} degrees, the winner has {counts.max():4d} votes",
        end="",
    )
    print(f" and is {(best - keypoint).norm():.1f} px off")
counts = count_inliers_here(pixels, vectors, points, 0.99)
best = points[counts.argmax()]
assert (best - keypoint).norm() < 8

# %% [markdown]
# The winner is one crossing of two noisy rays: its error is a matter of luck. The library goes on
# as PVNet does. It takes all who voted for the winner, and the point of least squares of their
# lines. Is that better? Draw the pairs anew, eight times:

# %%
middle = pixels.mean(0)
draws = [
    voting.vote_pixels(pixels, vectors[:, None], voting.VoteOptions(seed=seed)) for seed in range(8)
]
winners = torch.stack([votes.hypotheses[0][votes.weights[0].argmax()] for votes in draws])
refined = torch.stack([votes.points[0] for votes in draws])
for name, points_found in (("winner", winners), ("least squares", refined)):
    off_by = (points_found - keypoint).norm(dim=1)
    print(f"{name:13s} {off_by.min():.1f} to {off_by.max():.1f} px off", end="")
    pull = F.cosine_similarity(points_found - keypoint, middle - keypoint)
    print(f", {int((pull > 0.9).sum())} of 8 times towards the teapot's middle")
assert refined.std(0).norm() < winners.std(0).norm() / 2

# %% [markdown] tags=["solution"]
# **Discussion.** $\theta = 0.99$ allows 8 degrees. That is 1 px for a pixel 7 px away, and 14 px
# for one at 100 px: a count in angles trusts the near pixels, and a hypothesis is only as good as
# its two rays. So the winner says *who is to be believed*. The least squares of their lines no
# longer depend on the draw.
#
# But they are off, always to the same side. Every line is turned a little, and lines that are
# turned pass nearer to their own pixels than to the keypoint. So the point that is nearest to all
# of them lies too near to the object. Statistics calls it errors in variables. It grows faster
# than the noise. To minimise *angles* in the place of distances removes it:

# %% tags=["solution"]
x = refined[0]
for _ in range(5):  # Gauss-Newton
    way = x - pixels
    sides = (way * vectors).sum(1), vectors[:, 0] * way[:, 1] - vectors[:, 1] * way[:, 0]
    off_by = torch.atan2(sides[1], sides[0])  # the angle from the vector to the way
    J = torch.stack([-way[:, 1], way[:, 0]], 1) / way.square().sum(1, keepdim=True)
    voters = off_by.abs() < np.arccos(0.99)
    x = x - torch.linalg.lstsq(J[voters], off_by[voters, None]).solution[:, 0]
print(f"least squares of angles: {(x - keypoint).norm():.2f} px off")
assert (x - keypoint).norm() < 0.3

# %% [markdown] tags=["solution"]
# `F.normalize` divides by `max(length, 1e-12)`, so a zero stays a zero and its cosine is 0. In C
# the same is done without a division: $(h - p) \cdot v > \theta\,\lVert h - p\rVert$ for unit $v$.
# There 0 > 0 is false. Beware of squaring both sides: it forgets the sign.

# %% [markdown]
# ## 3. The projection loss, and where it is blind
#
# The paper's Eq. 1. Let $g$ lead from a pixel to its keypoint, in pixels, and let $p$ be the
# vector that the network says there. The line along $p$ passes the keypoint at the distance
#
# $$d = \frac{g \cdot n}{\lVert n \rVert} \qquad n = (p_y, -p_x)$$
#
# The loss is smooth-L1 of $d$, and the mean over all vectors.
#
# | in | shape | |
# |---|---|---|
# | `predicted` | (N, 2) | $p$, what a network says: of any length, also 0; N may be 0 |
# | `target` | (N, 2) | $g$, in pixels; 0 where the pixel is the keypoint itself |
# | **out** | a tensor, no shape | the mean of smooth-L1; for N = 0 it is 0 |
#
# - The check compares the gradient with respect to `predicted`, too.
# - A vector of length 0 has the loss 0 and the gradient 0. That it is finite matters: one `nan`
#   spoils all weights of a network.
#
# The picture shows what is expected, for a keypoint at three distances.

# %%
degrees = torch.linspace(-12, 12, 121)
turned = torch.deg2rad(degrees)
turned = torch.stack([turned.cos(), turned.sin()], -1)  # (121, 2)


def loss_curves(loss, predicted):
    """The loss of each of the vectors (N, 2) for keypoints to the right, at three distances."""
    aims = {f"keypoint at {d} px": torch.tensor([[d, 0.0]]) for d in (5, 20, 50)}
    return {
        name: np.array([float(loss(one[None], aim)) for one in predicted])
        for name, aim in aims.items()
    }


alt = "Three valleys around 0 degrees, the steeper the farther the keypoint, with straight sides"
draw.losses(degrees.numpy(), loss_curves(checks.projection_loss, turned), alt)


# %%
def projection_loss(predicted, target):
    """How far keypoints are from the lines along predicted vectors (N, 2); mean smooth-L1.

    >>> projection_loss(torch.tensor([[1.0, 0], [0, 2]]), torch.tensor([[20.0, 3], [0, 20]]))
    tensor(1.2500)
    """
    ### BEGIN SOLUTION
    n = torch.stack([predicted[:, 1], -predicted[:, 0]], -1)
    d = (target * F.normalize(n, dim=-1)).sum(-1)
    return F.smooth_l1_loss(d, torch.zeros_like(d), reduction="sum") / max(len(d), 1)
    ### END SOLUTION


# %%
answer = checks.check_projection_loss(projection_loss)
projection_loss_here = use(answer, checks.projection_loss)
answer

# %% [markdown]
# Chapter 8 says that this loss pulls hard where the vector loss has nearly given up. See for
# yourself: one degree off, at several distances.

# %%
for distance in (1, 10, 50):
    target = torch.tensor([[distance, 0.0]])
    one_degree = torch.deg2rad(torch.tensor(1.0))
    predicted = torch.stack([one_degree.cos(), one_degree.sin()])[None].requires_grad_()
    off = predicted - F.normalize(target, dim=-1)
    vector = F.smooth_l1_loss(off, torch.zeros_like(off), reduction="sum")
    gradients = [
        torch.autograd.grad(loss, predicted)[0].norm()
        for loss in (vector, projection_loss_here(predicted, target))
    ]
    print(f"keypoint at {distance:2d} px: gradient {gradients[0]:.4f} of the vector loss", end="")
    print(f", {gradients[1]:7.4f} of the projection loss")
assert gradients[1] > 100 * gradients[0]

# %% [markdown]
# Why not use it alone, then? **Find a prediction that is wrong everywhere and costs nothing.**
#
# | in | shape | |
# |---|---|---|
# | `target` | (N, 2) | from each pixel to its keypoint, never 0; N may be 0 |
# | **out** | (N, 2) | vectors of length 1, all more than 90 degrees off, with a loss of 0 |


# %%
def blind_prediction(target):
    """Vectors (N, 2) of length 1, all of them wrong, on which the projection loss is 0.

    >>> target = torch.tensor([[3.0, 4]])
    >>> F.cosine_similarity(blind_prediction(target), target) < 0
    tensor([True])
    """
    ### BEGIN SOLUTION
    return -F.normalize(target, dim=-1)
    ### END SOLUTION


# %%
answer = checks.check_blind_prediction(blind_prediction)
blind_prediction_here = use(answer, lambda target: F.normalize(target, dim=-1))
answer

# %% [markdown]
# What does such a field do to a vote? (Until your prediction is done, the right one is used here.)

# %%
blind = blind_prediction_here(to_tip)
far = to_tip.norm(dim=1) > 0.5
point = voting.intersect_lines(pixels, blind)
counts = count_inliers_here(pixels[far], blind[far], keypoint[None], 0.99)
print(f"projection loss {projection_loss_here(blind, to_tip):.1e}")
print(
    f"lines cross {(point - keypoint).norm():.1e} px from the keypoint, which has {counts[0]} votes"
)
print(f"of {far.sum()} pixels")
assert projection_loss_here(blind, to_tip) < 1e-12 and (point - keypoint).norm() < 1e-6

# %% tags=["solution"]
degrees = torch.linspace(-180, 180, 361)
all_round = torch.deg2rad(degrees)
all_round = torch.stack([all_round.cos(), all_round.sin()], -1)
curves = loss_curves(projection_loss_here, all_round)
assert curves["keypoint at 50 px"][[0, 180, 360]].max() < 1e-12
alt = "The loss all the way round: it is 0 at 0 degrees, and also at 180 degrees to either side"
draw.losses(degrees.numpy(), curves, alt)

# %% [markdown] tags=["solution"]
# **Discussion.** A line has no direction. Half of all predictions that could be made roll down into
# the wrong valley. That is why the vector loss must stay. It pulls little at the end, but it knows
# which way is forward. Least squares of lines does not notice the difference, and the count finds
# nobody.
#
# Zero vectors cost nothing, either: the loss is blind to the length. And two ways to mask a
# division by 0 differ: `torch.where(length > 0, d / length, 0)` gives the right loss, and `nan` as
# its gradient, since the gradient of the branch that was not taken is 0 times infinity.

# %% [markdown]
# ## 4. How sure is the vote?
#
# The hypotheses of a keypoint lie in a cloud. Each has a weight $w_i$, the number of its inliers.
# The mean of the cloud and its covariance are
#
# $$\mu = \frac{\sum_i w_i\, h_i}{\sum_i w_i} \qquad
# \Sigma = \frac{\sum_i w_i\, (h_i - \mu)(h_i - \mu)^T}{\sum_i w_i}$$
#
# | in | shape | |
# |---|---|---|
# | `points` | (H, 2) | $h_i$, hypotheses in pixels |
# | `weights` | (H,) | $w_i$, at least 0; may be whole numbers |
# | **out** | (2,) | $\mu$ |
# | | (2, 2) | $\Sigma$, in px² |
#
# - A hypothesis of weight 0 does not count, wherever it is. It may even be `nan`: two rays that did
#   not meet.
# - A single hypothesis has the covariance 0. (The library adds a little to all; you need
#   not. And the page measures from the keypoint; here, as in PVNet's paper, from the mean.)
# - If all weights are 0, or there are no hypotheses, raise a `ValueError`.
# - Some points come as float32, 600 px from the corner of the image, and within 0.1 px of each
#   other.
#
# The picture shows what is expected for three keypoints: the cloud, $\mu$, and an ellipse of two
# standard deviations.


# %%
def cloud(point, count=300):
    """Crossings (count, 2) of rays with 2 degrees of noise that point to a point; their votes."""
    to_point = point - pixels
    angle = torch.atan2(to_point[:, 1], to_point[:, 0])
    angle = angle + torch.deg2rad(2 * torch.randn(len(pixels), generator=generator))
    field = torch.stack([angle.cos(), angle.sin()], -1)
    pairs = torch.randint(len(pixels), (2, count), generator=generator)
    (p, q), (u, v) = pixels[pairs], field[pairs]
    crossed = intersect_rays_here(p, u, q, v)
    votes = count_inliers_here(pixels, field, crossed.nan_to_num(-1e6), 0.99)
    votes[votes < votes.max() - 0.1 * len(pixels)] = 0  # those far below the best are left out
    return crossed, votes


# %%
ends = torch.stack([teapot[:, 0].argmin(), teapot[:, 0].argmax(), teapot[:, 2].argmax()])
three = cameras.project(K, poses.apply(R, t, teapot[ends]))
found = [cloud(point) for point in three]
expected = [checks.mean_and_covariance(*one) for one in found]
draw.hypotheses(
    photo,
    [points[votes > 0].numpy() for points, votes in found],
    [(mean.numpy(), covariance.numpy()) for mean, covariance in expected],
)


# %%
def mean_and_covariance(points, weights):
    """The weighted mean (2,) of points (H, 2), and their covariance (2, 2).

    >>> mean_and_covariance(torch.tensor([[0.0, 0], [4, 0]]), torch.tensor([3, 1]))
    (tensor([1., 0.]), tensor([[3., 0.],
            [0., 0.]]))
    """
    ### BEGIN SOLUTION
    points, weights = points[weights > 0], weights[weights > 0]
    if len(weights) == 0:
        raise ValueError("weights: expected at least one above 0, got none")
    w = (weights / weights.sum()).to(points.dtype)
    mean = w @ points
    off = points - mean
    return mean, (w[:, None] * off).T @ off
    ### END SOLUTION


# %%
answer = checks.check_mean_and_covariance(mean_and_covariance)
mean_and_covariance_here = use(answer, checks.mean_and_covariance)
answer

# %% [markdown]
# An ellipse knows more than a radius. In which direction is a keypoint least sure?

# %%
for name, (points, votes) in zip(("handle", "spout", "knob"), found, strict=True):
    mean, covariance = mean_and_covariance_here(points, votes)
    variances, directions = torch.linalg.eigh(covariance)
    short, long = variances.sqrt()
    cosine = F.cosine_similarity(directions[:, 1], middle - mean, dim=0).abs()
    print(
        f"{name:6s} {long:.2f} px along, {short:.2f} px across; long axis and the way to the",
        end="",
    )
    print(f" teapot's middle: {torch.rad2deg(cosine.acos()):.0f} degrees apart")
    assert long > 1.5 * short and cosine > np.cos(np.deg2rad(30))

# %% [markdown] tags=["solution"]
# **Discussion.** Rays to a far point are nearly parallel. They agree across, and not along. That is
# what PnP can use: the reprojection error counts less in the direction in which nobody knows.
#
# $\sum w\,h\,h^T - \mu\mu^T$ is the same number on paper. In float32, 600² has a last digit of
# 0.03 px², and the variance is 0.005 px²: what is left may even be negative. Take the mean away
# first.
#
# 0 times `nan` is `nan`, so what does not count must be left out and not be multiplied by 0.

# %% [markdown]
# ## 5. When to refine
#
# The paper's third system refines a pose only if it is good enough already (section III-D).
# Project the model's points with the estimated pose. What share of them lands inside the mask that
# the network found?
#
# | in | shape | |
# |---|---|---|
# | `points` | (N, 3) | points of the model, metres |
# | `R`, `t` | (3, 3), (3,) | the estimated pose, metres |
# | `K` | (3, 3) | camera matrix, without skew |
# | `mask` | (H, W) | true where the object is seen |
# | **out** | a number | share of *all* N points that land on a true pixel, 0 to 1 |
#
# - A point lands on the pixel that is nearest. The centre of the first pixel is at (0, 0), so it
#   reaches from −0.5 to 0.5.
# - A point outside of the image does not overlap, and a point that is not in front of the camera
#   ($z \le 0$) does not either. There is no error: an estimate may be as bad as that.
#
# The picture shows what is expected. Something stands before the left part of the teapot; what is
# left of the mask has a white rim. Full dots overlap, hollow ones do not.

# %%
model = teapot[clouds.farthest_point_sampling(teapot, 250)]
seen = mask.clone()
seen[:, :52] = False
turn = checks.about_z(torch.tensor(torch.pi))
estimates = {
    "true pose": (R, t),
    "3 cm to the left": (R, t - torch.tensor([0.03, 0, 0])),
    "turned by half": (R @ turn, t),
    "twice as far": (R, 2 * t),
}
where = {
    name: cameras.project(K, poses.apply(*pose, model)).numpy() for name, pose in estimates.items()
}
shares = [checks.overlap(model, *pose, K, seen) for pose in estimates.values()]
draw.overlaps(photo, seen.numpy(), where, shares)


# %%
def overlap(points, R, t, K, mask):
    """The share of the points (N, 3) that a pose puts inside of a mask (H, W).

    >>> points = torch.tensor([[0.0, 0, 0], [1, 0, 0], [9, 0, 0], [0, 0, -3]])
    >>> mask = torch.tensor([[True, True, False]])
    >>> overlap(points, torch.eye(3), torch.tensor([0.0, 0, 1]), torch.eye(3), mask)
    0.5
    """
    ### BEGIN SOLUTION
    X = points @ R.T + t
    X = X[X[:, 2] > 0]
    x, y = ((X @ K.T)[:, :2] / X[:, 2:]).round().T
    height, width = mask.shape
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    hits = mask[y[inside].long(), x[inside].long()].sum()
    return float(hits) / len(points)
    ### END SOLUTION


# %%
answer = checks.check_overlap(overlap)
overlap_here = use(answer, checks.overlap)
answer

# %% [markdown]
# The rule says: refine above 0.8. Let something hide more and more of the teapot, from the left:

# %%
columns = torch.arange(0, width, 2)
order = torch.arange(width)
hidden, curves = [], {name: [] for name in ("true pose", "turned by half", "twice as far")}
for column in columns:
    left = mask & (order >= column)
    hidden.append(1 - float(left.sum() / mask.sum()))
    for name, values in curves.items():
        values.append(overlap_here(model, *estimates[name], K, left))
curves = {name: np.array(values) for name, values in curves.items()}
assert curves["true pose"][0] > 0.9 and curves["twice as far"][0] > 0.9
assert (np.diff(curves["true pose"]) <= 0).all() and curves["true pose"][-1] == 0
draw.spreads(np.array(hidden), curves, 0.8)

# %% [markdown] tags=["solution"]
# **Discussion.** The rule asks two things at once. The overlap of the *true* pose says how much of
# the object is seen, since the points of its back land in the same outline. With nothing hidden
# it is a little less than 1: on the outline, the nearest pixel may belong to the background. So a
# threshold of 0.8 says: do not refine what is hidden by a sixth or more, however good the estimate.
#
# The rule is also one-sided. A pose that is too far away makes a small teapot, which fits into the
# mask with nearly all of its points. The share of the *mask* that is covered would notice;
# intersection over union asks both.
#
# An index of −4 is no error in Python, but the fourth from the other end. In a picture that is a
# point on the opposite side.

# %% [markdown]
# ## 6. Open: the label of something that looks the same
#
# The vase of tabletop is a solid of revolution. Turned about its own z axis by any angle, it looks
# the same. But its keypoints turn with it. So which vectors should a network learn?

# %%
lying = rotations.axis_angle_to_matrix(torch.deg2rad(torch.tensor([115.0, 0, 0])))
t_vase = torch.tensor([0.0, 0.0, 0.36])
vase = torch.from_numpy(shapes.make_object(3).vertices)
vase_keypoints = model_keypoints(vase)  # (9, 3), the last is the centre
turns = torch.deg2rad(torch.arange(0, 360, 10.0))
every_label = lying @ checks.about_z(turns)  # (36, 3, 3), one look


def project_keypoints(R, t):
    """The pixels (..., 9, 2) of the vase's keypoints."""
    return cameras.project(K, poses.apply(R, t, vase_keypoints))


# %%
shots = [shoot(3, every_label[number], t_vase)[0] for number in (0, 7)]
difference = np.abs(np.subtract(*shots, dtype=float)).mean()
labels = project_keypoints(every_label, t_vase.expand(36, 3))
apart = (labels[0] - labels[7]).norm(dim=1).max()
print(f"pictures differ by {difference:.2f} of 255 levels, keypoints by up to {apart:.0f} px")
assert difference < 0.5 and apart > 10
draw.same_look(shots, labels[[0, 7]].numpy(), labels.mean(0).numpy())

# %% [markdown]
# A network that gets all these labels for one look has the least squared error if it says their
# mean. And the mean is no vase. All keypoints are on the axis, where no surface is, and any turn
# about it fits as well or as badly.
#
# Here is a network that learns so. To save the time for pictures it is told what a picture can
# show: where the vase is, and where its axis points. Nothing about the turn.


# %%
def some_poses(count, generator):
    """Poses of a vase on a table, seen from above, turned anyhow about its axis."""
    x = torch.rand(count, 6, generator=generator)
    down = torch.zeros(count, 3)
    down[:, 0] = torch.deg2rad(100 + 60 * x[:, 0])
    R = checks.about_z(torch.deg2rad(60 * x[:, 1] - 30)) @ rotations.axis_angle_to_matrix(down)
    R = R @ checks.about_z(2 * torch.pi * x[:, 2])
    return R, x[:, 3:] * torch.tensor([0.2, 0.14, 0.2]) + torch.tensor([-0.1, -0.07, 0.45])


def look(R, t):
    """What a picture shows of the vase's pose: the axis and the place (N, 7)."""
    return torch.cat([R[:, :, 2], t / t[:, 2:], 0.5 / t[:, 2:]], 1).float()


# %%
def train(label):
    """A network from looks to keypoints (N, 9, 2), in units of 50 px from the centre."""
    torch.manual_seed(0)
    steps = choose(tiny=40, book=600, paper=4000)
    layers = [nn.Linear(7, 128), nn.LeakyReLU(), nn.Linear(128, 128), nn.LeakyReLU()]
    network = nn.Sequential(*layers, nn.Linear(128, 18), nn.Unflatten(1, (9, 2))).float()
    optimiser = torch.optim.Adam(network.parameters(), lr=3e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for _ in range(steps):
        R, t = some_poses(256, generator)
        target = project_keypoints(label(R, t), t)
        optimiser.zero_grad()
        F.smooth_l1_loss(network(look(R, t)), ((target - target[:, -1:]) / 50).float()).backward()
        optimiser.step()
        schedule.step()
    return network.requires_grad_(False)


# %%
surface = vase[clouds.farthest_point_sampling(vase, 200)]
test_R, test_t = some_poses(choose(tiny=15, book=100, paper=400), torch.Generator().manual_seed(9))


def add_s_of(network):
    """ADD-S of the test poses, in diameters: keypoints from the network, then PnP."""
    said = 50 * network(look(test_R, test_t)).double() + project_keypoints(test_R, test_t)[:, -1:]
    found = []
    for R, t, points in zip(test_R, test_t, said, strict=True):
        try:
            pose = registration.pnp(vase_keypoints, points, K)
        except ValueError:  # no pose fits
            found.append(np.inf)
        else:
            found.append(float(metrics.add_s(pose.R, pose.t, R, t, surface)))
    return np.array(found) / shapes.make_object(3).diameter


# %% [markdown]
# The picture shows what comes of labels as they are, and what is expected of yours: the curve
# should pass through the grey. ADD-S, which counts every turn as right, is the judge.


# %%
def any_label(R, t):
    """Labels as they come."""
    return R


as_they_come = add_s_of(train(any_label))
print(f"{(as_they_come < 0.1).mean():.0%} of the poses are right, to a tenth of the diameter")
assert (as_they_come < 0.1).mean() < 0.3
draw.errors({"labels as they come": as_they_come})

# %% [markdown]
# So choose. Of all poses that look the same, which one is the network to be asked for? Write a
# function that says it.
#
# | in | shape | |
# |---|---|---|
# | `R`, `t` | (N, 3, 3), (N, 3) | poses of an object that looks the same, however turned about z |
# | **out** | (N, 3, 3) | the rotations to learn instead; `t` stays |
#
# There are many good choices. The check wants three things of yours:
#
# - **The same look.** The answer is a rotation, and differs from `R` by a turn about the object's
#   own z axis only.
# - **One look, one answer.** Poses that look alike have one answer, to 1e-5.
# - **No jumps.** Poses that look *nearly* alike have answers that are nearly one: a small step may
#   turn the answer 15 times as far, but not more. This need not hold where the camera looks along
#   the axis, to 30 degrees. (Somewhere it must break. Can you see why?) But the answer must be a
#   rotation there, too.
#
# `checks.about_z(angles)` gives turns (N, 3, 3) about z.


# %%
def canonical_rotation(R, t):
    """Of all rotations (N, 3, 3) that look like R, the one that a network is to learn.

    >>> R = rotations.random_rotations(generator=0) @ checks.about_z(torch.tensor([0.0, 1.0]))
    >>> one, other = canonical_rotation(R, torch.tensor([[0.0, 0, 1], [0, 0, 1]]))
    >>> torch.allclose(one, other)
    True
    """
    ### BEGIN SOLUTION
    z = R[:, :, 2]
    to_camera = -F.normalize(t, dim=-1)
    x = to_camera - (to_camera * z).sum(-1, keepdim=True) * z  # the part across the axis
    along = x.norm(dim=-1, keepdim=True) < 1e-6
    x = F.normalize(torch.where(along, R[:, :, 0], x), dim=-1)
    return torch.stack([x, torch.linalg.cross(z, x), z], -1)
    ### END SOLUTION


# %%
answer = checks.check_canonical_rotation(canonical_rotation)
canonical_rotation_here = use(answer, any_label)
answer

# %% [markdown]
# The same network, the same looks, other labels. (Until your choice is done, the labels are as they
# come, so that nothing is given away.)

# %%
chosen = add_s_of(train(canonical_rotation_here))
print(f"{(as_they_come < 0.1).mean():.0%} of the poses are right with labels as they come,", end="")
print(f" {(chosen < 0.1).mean():.0%} with those here")
draw.errors({"labels as they come": as_they_come, "labels here": chosen})

# %% tags=["solution"]
if scale() == "book":
    assert (chosen < 0.1).mean() > 0.9

# %% [markdown]
# And where does it break? The vase leans towards the camera, 2 degrees at a time, until one looks
# into its mouth and beyond. By how much does the label turn in one step?

# %%
lean = torch.arange(-70, 71, 2.0)
sway = torch.deg2rad(torch.tensor(1.5))  # the axis passes the line of sight, but misses it narrowly
axis = torch.stack(
    [0 * lean + sway.sin(), torch.deg2rad(lean).sin(), -torch.deg2rad(lean).cos()], -1
)
walk = canonical_rotation_here(checks.upright(axis), torch.tensor([0, 0, 0.5]).expand(len(lean), 3))
steps = torch.rad2deg(rotations.geodesic_distance(walk[1:], walk[:-1]))
draw.angles(lean[1:].numpy() - 1, {"label here": steps.numpy()})

# %% [markdown] tags=["solution"]
# **Discussion.** The solution shows the camera always the same side. The library's
# `symmetry.canonical_rotation` does so, too, with another side, and takes the nearest of the 36
# turns that a model file lists: between two of them it jumps by 10 degrees, which a network
# smooths over. Other good choices: the least turn that brings the camera's z axis to the object's;
# or the optical axis in the place of the line of sight.
#
# Why must it break? A choice for every look is a direction x at a right angle to every axis z: a
# combing of the sphere, and the hairy ball theorem says that there is a bald spot. One can only
# choose where it is. Best is where the camera is seldom: exactly above or below. Choices that use
# a fixed axis of the camera, as "x stays level", have it where vases usually stand.
#
# An egg box, the same after half a turn, is worse. Walk half round it, and it looks as at the
# start. A label that never jumped would have turned by 180 degrees on the way, and would be
# another one for the same look. So each choice has a whole *surface* of jumps, and near it a
# network says the mean of two poses. Then it helps to let the network off: compare with all
# labels, and count the nearest, as ADD-S does.
