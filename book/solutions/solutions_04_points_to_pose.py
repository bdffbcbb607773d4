# ---
# jupyter:
#   jupytext:
#     cell_metadata_filter: tags,-all
#     formats: ipynb,py:percent
#     notebook_metadata_filter: jupytext,-jupytext.text_representation,-kernelspec
# ---

# %% [markdown]
# # Exercises: from a point cloud to a pose
#
# Six functions for you to write, from a warm-up to an open question.
# They need NumPy and PyTorch, and what [chapter 4](../04_points_to_pose.ipynb) explains.
#
# | | exercise | level | minutes |
# |---|---|---|---|
# | 1 | a ball query | warm-up | 15 |
# | 2 | pooling that knows no order | medium | 20 |
# | 3 | a loss that does not see the sign | medium | 20 |
# | 4 | from votes to a pose | medium | 30 |
# | 5 | the bins of BMAE | medium | 25 |
# | 6 | more extreme poses | hard, open | 40 |

# %% [markdown] tags=["solution"]
# **This is the teacher's edition, with the solutions.**
# The students' one is made from it: `python book/make.py start 04` puts it into `book/my_work/`.

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
# Exercises 1 to 4 use torch tensors of `float64`, 5 and 6 NumPy arrays.

# %%
import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from book.ch04_points_to_pose import checks
from book.ch04_points_to_pose.drawing import exercises as draw
from book.tools.checks import use
from book.tools.syntax import forgive_syntax
from data_tools.worlds.headset_scenes import draw_angles
from posecore import rotations
from posecore.methods.points_to_pose.voting import fused_keypoints
from posecore.registration import umeyama
from posecore.scale import choose

forgive_syntax()  # a cell that is no Python says so, and the page goes on
torch.set_default_dtype(torch.float64)

# %% [markdown]
# **The scene.** A head that wears glasses, as points on its surface. In its frame x is to the
# right, y down and z away from us. A camera in front sees the points whose surface is turned
# towards it. (A nose hides nothing here: that is kept simple.) What it sees is shifted so that its
# mean is 0.

# %%
from trimesh import Trimesh
from trimesh.sample import sample_surface

from data_tools.shapes import make_glasses, make_subject

meshes = [
    Trimesh(mesh.vertices, mesh.faces, process=False)
    for mesh in (make_subject(0).head, make_glasses("classic"))
]
sampled = [sample_surface(mesh, n, seed=0) for mesh, n in zip(meshes, (1200, 200), strict=True)]
surface = np.concatenate([points for points, _ in sampled])
normals = np.concatenate([m.face_normals[f] for m, (_, f) in zip(meshes, sampled, strict=True)])


# %%
def seen(R, count, rng):
    """(V, count, 3): a cloud of what is seen of the head in each of the rotations (V, 3, 3)."""
    hidden = R[:, 2] @ normals.T > -0.1  # (V, all points)
    chosen = (rng.random(hidden.shape) + hidden).argsort(1)[:, :count]
    noise = rng.normal(scale=0.002, size=(len(R), count, 3))
    points = surface[chosen] @ R.swapaxes(1, 2) + noise
    return torch.from_numpy(points - points.mean(1, keepdims=True))


# %% [markdown]
# ## 1. Warm-up: a ball query
#
# *Warm-up, 15 minutes.* PointNet++ looks at small parts of a cloud. A part is a ball about a
# centre, and a ball query says which points are in it. Every ball gets the same number of places,
# or they would not fit into one tensor.
#
# | in | shape | |
# |---|---|---|
# | `points` | (N, 3) | the cloud; metres |
# | `centres` | (M, 3) | of the balls; metres |
# | `radius` | a number | metres |
# | `count` | a number | places in each ball; may be more than N |
# | **out** | (M, count) | indices into the N points, int64 |
#
# - In the ball is what is *nearer* than the radius.
# - Of too many points the first stay: the first by index, and not the nearest.
# - Too few points are filled up with copies of the first one.
# - A ball may be empty, if its centre is no point of the cloud. Then the nearest point has all
#   places; of several equally near ones, the first.
#
# The picture shows what is expected: a full ball, one with few points, and an empty one.

# %%
cloud = seen(np.eye(3)[None], 400, np.random.default_rng(0))[0]
corner = cloud.amin(0) + torch.tensor([0.01, 0.015, 0.0])
centres = torch.stack([cloud[7], cloud[int(cloud[:, 1].argmax())], corner])
found = checks.ball_query(cloud, centres, 0.025, 16)
draw.balls(cloud.numpy(), centres.numpy(), 0.025, found.numpy())


# %%
def ball_query(points, centres, radius, count):
    """(M, count): the first points by index that are nearer to each centre than the radius.

    >>> points = torch.tensor([[0.0, 0, 0], [3, 0, 0], [1, 0, 0]])
    >>> ball_query(points, torch.tensor([[1.0, 0, 0], [9, 0, 0]]), 1.5, 3)
    tensor([[0, 2, 0],
            [1, 1, 1]])
    """
    ### BEGIN SOLUTION
    found = []
    for centre in centres:
        d = torch.linalg.vector_norm(points - centre, dim=-1)
        inside = (d < radius).nonzero()[:, 0][:count]
        if not len(inside):
            inside = d.argmin()[None]
        found.append(torch.cat([inside, inside[:1].repeat(count - len(inside))]))
    return torch.stack(found)
    ### END SOLUTION


# %%
answer = checks.check_ball_query(ball_query)
ball_query_here = use(answer, checks.ball_query)
answer

# %% [markdown]
# Shuffle the cloud, and ask again. Are these the same balls?

# %%
order = torch.randperm(len(cloud), generator=torch.Generator().manual_seed(0))
for count in (4, 16, 64):
    before = ball_query_here(cloud, cloud[:50], 0.025, count)
    after = order[ball_query_here(cloud[order], cloud[:50], 0.025, count)]
    same = [set(a.tolist()) == set(b.tolist()) for a, b in zip(before, after, strict=True)]
    print(f"{count:2d} places: {sum(same)} of {len(same)} balls hold the same points")
assert all(same)  # there was room for all

# %% [markdown] tags=["solution"]
# **Discussion.** Why the first by index, when the nearest would be as good? Because it is fast: the
# search stops as soon as the places are full, and nothing is sorted. The price is what you have
# just seen: where there are more points than places, the answer depends on the order of the cloud.
# If points are in a random order, as here, "the first" are drawn at random from the ball, and no
# part of it is preferred. In the order of an image's rows they would all be at its top.
#
# In PointNet++ centres are chosen from the cloud itself, so no ball is empty: the centre is in it.
# A ball about a place that was *voted* for may be.

# %% [markdown]
# ## 2. Pooling that knows no order
#
# *Medium, 20 minutes.* Each point of a ball has features, and the ball needs one vector of them
# all. Points have no order, so the vector must not depend on it: that is *pooling*. Nor may it
# depend on how often a point fills a place that was left over.
#
# | in | shape | |
# |---|---|---|
# | `features` | (N, C) | of the points |
# | `balls` | (M, K) | indices of points, int64; -1 in a place for nobody |
# | **out** | (M, C), (M, C) | for each ball the maximum and the mean of each feature |
#
# - Every point of a ball counts once, wherever and however often it stands there.
# - Points are told apart by their index. Two points may have the same features.
# - If there is nobody in a ball, its maximum and its mean are 0.
#
# The picture shows what is expected. Crossed-out places do not count.

# %%
features = torch.tensor([[1, -2], [5, 4], [3, -9], [-7, 8], [2, 6.0]])
some = torch.tensor([[0, 2, 4, 1], [1, 3, 1, 1], [2, -1, 0, -1], [3, 3, 3, 3], [-1, -1, -1, -1]])
expected = checks.pool_balls(features, some)
draw.pooled(features.numpy(), some.numpy(), *(one.numpy() for one in expected))


# %%
def pool_balls(features, balls):
    """Maximum and mean (M, C) of the features (N, C) of those who are in each ball (M, K).

    >>> pool_balls(torch.tensor([[1.0], [4], [9]]), torch.tensor([[0, 1, 0], [2, -1, -1]]))
    (tensor([[4.],
            [9.]]), tensor([[2.5000],
            [9.0000]]))
    """
    ### BEGIN SOLUTION
    maxima, means = torch.zeros(2, len(balls), features.shape[1])
    for i, ball in enumerate(balls):
        members = features[ball[ball >= 0].unique()]
        if len(members):
            maxima[i], means[i] = members.amax(0), members.mean(0)
    return maxima, means
    ### END SOLUTION


# %%
answer = checks.check_pool_balls(pool_balls)
pool_balls_here = use(answer, checks.pool_balls)
answer

# %% [markdown]
# On the head, take as features of a point where it is. The mean of a ball is then its centre of
# mass. What does the usual mean over all places make of it, if a ball is filled up?

# %%
balls = ball_query_here(cloud, cloud, 0.02, 16)
held = torch.tensor([len(ball.unique()) for ball in balls])
away = torch.linalg.vector_norm(cloud[balls].mean(1) - pool_balls_here(cloud, balls)[1], dim=-1)
worst = torch.equal(cloud[balls].amax(1), pool_balls_here(cloud, balls)[0])
for low, high in ((1, 4), (5, 8), (9, 15), (16, 16)):
    these = (held >= low) & (held <= high)
    if these.any():
        off = 1000 * away[these].mean()
        print(
            f"{low:2d} to {high:2d} points in the ball: {int(these.sum()):3d} balls, {off:.1f} mm"
        )
print("the maximum is the same with the copies:", worst)
assert worst and away[held == 16].max() < 1e-12

# %% [markdown] tags=["solution"]
# **Discussion.** The maximum of a set does not change if a member is there twice. So PointNet++
# fills its balls with copies and need not know how many there are: with a maximum, that is free. A
# mean would have to count, as yours does.
#
# It is not the only function of this kind. Any sum over members, of whatever is computed from each
# by itself, knows no order, and then any function of that sum. A famous theorem says that all
# continuous functions of a set can be written so, if there are enough numbers for each member
# (Zaheer et al., *Deep Sets*, 2017). The maximum sees the *outline* of a ball in feature space, the
# mean its middle: a point inside the outline can be left out without a trace.
#
# One more place where order comes in again: the network P2R lays the seeds in a row and puts a
# dense layer on top. That layer knows seed number 3 from seed number 4.

# %% [markdown]
# ## 3. A loss that does not see the sign
#
# *Medium, 20 minutes.* $q$ and $-q$ are the same rotation. A loss that measures the distance to one
# of them punishes the other, which is just as right. Let $p_i$ be the outputs of a network, each
# brought to length 1:
#
# $$L = \frac{1}{B} \sum_i \min(\lVert p_i - q_i \rVert,\; \lVert p_i + q_i \rVert)$$
#
# | in | shape | |
# |---|---|---|
# | `outputs` | (B, 4) | of a network, (w, x, y, z), of any length |
# | `q` | (B, 4) | the labels: true quaternions of length 1, of either sign |
# | **out** | () | the loss, a tensor |
#
# - An output of four zeros stays zero; its distance is then 1. `nan` never comes out.
# - A gradient must find its way from the loss back to `outputs`: the check looks at it. Where an
#   output is exactly right it is 0, and not `nan`.
#
# The picture shows what is expected, for a rotation that is turned too far by up to two full turns.


# %%
def turned(angles):
    """(N, 4) quaternions of turns about y."""
    half = torch.as_tensor(angles) / 2
    return torch.stack([half.cos(), 0 * half, half.sin(), 0 * half], -1)


angles = np.linspace(0, 4 * np.pi, 241)
label = turned([0.0])
ways = {
    "to q alone": torch.linalg.vector_norm(turned(angles) - label, dim=-1),
    "to the nearer of q and -q": torch.stack(
        [checks.quaternion_loss(one[None], label) for one in turned(angles)]
    ),
}
draw.distances(angles, {name: loss.numpy() for name, loss in ways.items()}, "loss")


# %%
def quaternion_loss(outputs, q):
    """The mean distance of normalised outputs (B, 4) to the nearer of q (B, 4) and -q.

    >>> quaternion_loss(torch.tensor([[-2.0, 0, 0, 0], [0, 0, 3, 0]]), torch.eye(4)[:2])
    tensor(0.7071)
    """
    ### BEGIN SOLUTION
    p = F.normalize(outputs, dim=-1)
    one = torch.linalg.vector_norm(p - q, dim=-1)
    other = torch.linalg.vector_norm(p + q, dim=-1)
    return torch.minimum(one, other).mean()
    ### END SOLUTION


# %%
answer = checks.check_quaternion_loss(quaternion_loss)
quaternion_loss_here = use(answer, checks.quaternion_loss)
answer

# %% [markdown]
# Let an output begin near $-q$, only 20 degrees off, and follow the gradient of each loss. How far
# does the rotation have to turn?


# %%
def plain_loss(outputs, q):
    """The distance to q alone."""
    return torch.linalg.vector_norm(F.normalize(outputs, dim=-1) - q, dim=-1).mean()


for name, loss in {"to q alone": plain_loss, "to the nearer": quaternion_loss_here}.items():
    p = (-turned([np.radians(20.0)])).requires_grad_()
    errors = []
    for _ in range(150):
        half = p.detach()[0] / p.detach().norm()
        errors.append(np.degrees(2 * np.arccos(min(float(half[0].abs()), 1))))
        step = torch.autograd.grad(loss(p, label), p)[0]
        p = (p - 0.05 * step).detach().requires_grad_()
    print(
        f"{name:14s} error at first {errors[0]:.0f}°, at most {max(errors):.0f}°, at the end",
        end=" ",
    )
    print(f"{errors[-1]:.0f}°")

# %% [markdown] tags=["solution"]
# **Discussion.** The plain loss drags the rotation through the farthest one there is, a half turn,
# to bring it back to where it has been already. That is the *double cover*: the quaternions go
# twice around the rotations.
#
# With labels that all have $w \ge 0$ this is rare for a head, which seldom turns by more than
# 90 degrees: then $w$ is never near 0, and a network learns the sign of the labels. For objects
# of any rotation it is a wall: near a half turn, two rotations that are alike have labels that
# are 2 apart.
#
# Another sign-free loss is $1 - |p \cdot q|$, or the angle itself. Near the truth the first is flat
# and grows with the square, and the distance grows with the angle: $2 \sin(\alpha / 4)$.

# %% [markdown]
# ## 4. From votes to a pose
#
# *Medium, 30 minutes.* Every seed votes for where every keypoint is. Some seeds know little, and
# their votes are far off. So do not take the mean, but one that listens less to what is far away.
# For one keypoint, with votes $v_s$:
#
# 1. Begin with the median $c$ of the votes, coordinate by coordinate.
# 2. $d_s = \lVert v_s - c \rVert$ is how far a vote is off, and $m$ is the median of all $d_s$.
# 3. The place of the keypoint is the mean of the votes with the weights
#    $w_s = 1 / (1 + (d_s / m)^2)$.
#
# From all keypoints' places comes the pose that brings the model's keypoints nearest to them
# (Kabsch; chapter 1). You may use `umeyama(source, target)`, whose answer has `.R` and `.t`.
#
# | in | shape | |
# |---|---|---|
# | `votes` | (S, K, 3) | of S seeds for K keypoints; metres |
# | `model` | (K, 3) | the keypoints in the object's frame; metres |
# | **out** | (3, 3), (3,) | `R` and `t` of the pose, from object to camera |
#
# - A median is that of `torch.median`: of an even number of votes, the lower of the middle two.
# - If most votes agree to the last digit, $m$ is 0. Then those votes are the answer.
#
# The picture shows what is expected of the places: 40 votes for each keypoint, every fourth wild.

# %%
model = fused_keypoints(8).double()
R_true = torch.from_numpy(rotations.euler_to_matrix(np.radians([25.0, -10, 5]), "YXZ"))
t_true = torch.tensor([0.02, -0.01, 0.7])
true = model @ R_true.T + t_true
generator = torch.Generator().manual_seed(0)
votes = true + 0.006 * torch.randn(40, len(model), 3, generator=generator)
votes[::4] += torch.tensor([0.08, 0.03, 0]) + 0.03 * torch.randn(
    10, len(model), 3, generator=generator
)
R, t = checks.pose_of_votes(votes, model)
answers = {"mean of the votes": votes.mean(0), "pose that is expected": model @ R.T + t}
places = {name: one.numpy() for name, one in answers.items()}
draw.votes(votes.numpy(), true.numpy(), places, 0.05)


# %%
def pose_of_votes(votes, model):
    """The pose R (3, 3), t (3,) that the votes (S, K, 3) for the keypoints (K, 3) come to.

    >>> R, t = pose_of_votes(torch.eye(3).expand(5, 3, 3) + 0.5, torch.eye(3))
    >>> torch.allclose(R, torch.eye(3)), torch.allclose(t, torch.full((3,), 0.5))
    (True, True)
    """
    ### BEGIN SOLUTION
    centre = votes.median(0).values  # (K, 3)
    d = torch.linalg.vector_norm(votes - centre, dim=-1)  # (S, K)
    m = d.median(0).values.clamp(min=1e-30)
    w = (1 / (1 + (d / m) ** 2))[..., None]
    places = (w * votes).sum(0) / w.sum(0)
    found = umeyama(model, places)
    return found.R, found.t
    ### END SOLUTION


# %%
answer = checks.check_pose_of_votes(pose_of_votes)
pose_of_votes_here = use(answer, checks.pose_of_votes)
answer

# %% [markdown]
# Let more and more votes be wild. When does the robust mean give way?

# %%
wild = 0.08 * torch.tensor([1, 0.4, 0]) + 0.03 * torch.randn(votes.shape, generator=generator)
fine = true + 0.006 * torch.randn(votes.shape, generator=generator)
shares, curves = np.arange(0, 41, 2), {"robust mean": [], "mean": []}
for count in shares:
    mixed = torch.cat([wild[:count] + true, fine[count:]])
    for name, given in {"robust mean": mixed, "mean": mixed.mean(0, keepdim=True)}.items():
        t = pose_of_votes_here(given, model)[1]
        curves[name].append(1000 * float((t - t_true).norm()))
for count in (0, 10, 18, 24, 40):
    off = [curves[name][count // 2] for name in curves]
    print(f"{count:2d} of 40 votes wild: robust {off[0]:5.1f} mm, mean {off[1]:5.1f} mm")
assert curves["robust mean"][5] < 0.5 * curves["mean"][5]

# %% [markdown] tags=["solution"]
# **Discussion.** These are Cauchy's weights, once. A vote that is $m$ away counts half, one that
# is ten times as far about a hundredth. No threshold has to be chosen: $m$ comes from the votes.
# And a median moves little as long as fewer than half of them are wild; beyond, the wild ones
# *are* the votes.
#
# The wild votes here are off to the same side, all of them, as those of a network are that takes
# one side of the glasses for the other. If they were off in all directions, even the mean would do:
# with many votes they cancel.
#
# Then the pose repairs what is left: an error that is not common to all keypoints mostly fits no motion,
# so Kabsch averages it away. One that *is* common to all goes right through into $t$.

# %% [markdown]
# ## 5. The bins of BMAE
#
# *Medium, 25 minutes.* Drivers mostly look ahead. So a mean error says how good a method is for
# faces from the front. The *balanced mean angular error* averages inside bins of the true
# angle, and then over the bins. In chapter 1 you wrote the number. Here you lay open what
# stands behind it.
#
# | in | shape | |
# |---|---|---|
# | `estimated`, `true` | (N,) | estimates and labels of one angle; radians, $-\pi$ to $\pi$ |
# | `bin_width` | a number | $w$, radians |
# | **out** | (B,) | how many poses each bin holds, whole numbers |
# | | (B,) | the mean error of each bin, radians; `nan` if it holds none |
# | | a number | BMAE: the mean over all bins that hold a pose, radians |
#
# - A pose belongs to a bin by the *size* of its true angle. An error counts by its size.
# - An error is measured the short way round: from 179 to -179 degrees it is 2.
# - Bins are half-open: $[0, w), [w, 2w), \dots$ As many as reach $\pi$, where the last one ends. It
#   includes its end, and may be narrower than the others.
# - Edges are rounded: `0.3 / 0.1` is 2.9999999999999996. An angle that lies within $10^{-9}\,w$ below
#   an edge is on it, so it belongs to the bin that begins there.
#
# The picture shows what is expected for 400 poses, in bins of 5 degrees.

# %%
rng = np.random.default_rng(0)
yaw = np.array([draw_angles(rng)[0] for _ in range(400)])
guess = yaw + rng.normal(scale=0.02 + 0.15 * yaw**2)
width = np.deg2rad(5)
draw.bins(guess, yaw, width, *checks.error_bins(guess, yaw, width))


# %%
def error_bins(estimated, true, bin_width):
    """How many poses each bin holds (B,), their mean errors (B,), and BMAE; all in radians.

    >>> true = np.array([0.1, -0.1, 2.9])
    >>> counts, means, bmae = error_bins(np.array([0.3, -0.5, 3.0]), true, 1.0)
    >>> counts, means.round(3), round(bmae, 3)
    (array([2, 0, 1, 0]), array([0.3, nan, 0.1, nan]), 0.2)
    """
    ### BEGIN SOLUTION
    errors = np.abs((estimated - true + np.pi) % (2 * np.pi) - np.pi)
    size = int(np.ceil(np.pi / bin_width - 1e-9))
    bins = np.floor(np.abs(true) / bin_width + 1e-9).astype(int).clip(max=size - 1)
    counts = np.bincount(bins, minlength=size)
    sums = np.bincount(bins, errors, minlength=size)
    means = np.full(size, np.nan)
    means[counts > 0] = sums[counts > 0] / counts[counts > 0]
    return counts, means, float(np.nanmean(means))
    ### END SOLUTION


# %%
answer = checks.check_error_bins(error_bins)
error_bins_here = use(answer, checks.error_bins)
answer

# %% [markdown]
# How sure is such a number? Draw the same 400 poses again and again, with other errors.

# %%
drawn = {"MAE": [], "BMAE": []}
for _ in range(200):
    guess = yaw + rng.normal(scale=0.02 + 0.15 * yaw**2)
    counts, _, bmae = error_bins_here(guess, yaw, width)
    drawn["MAE"].append(np.degrees(np.abs(guess - yaw).mean()))
    drawn["BMAE"].append(np.degrees(bmae))
for name, values in drawn.items():
    print(f"{name:4s} {np.mean(values):.2f} ± {np.std(values):.2f} degrees")
few = (counts > 0) & (counts < 5)
print(f"{few.sum()} of {(counts > 0).sum()} bins in use hold fewer than five poses")
assert np.mean(drawn["BMAE"]) > np.mean(drawn["MAE"])

# %% [markdown] tags=["solution"]
# **Discussion.** BMAE gives a bin of two poses the same say as one of a hundred. So it speaks about
# what is rare, and pays for it with noise: its spread is larger than that of the plain mean. A
# table should say how many poses the bins hold, and a difference that is smaller than the spread
# tells nothing about two methods.
#
# Empty bins are left out. Counted as bins without error they would *reward* a test set that has no
# extreme poses. And the bins are of the true angle: by the estimated one, a method could choose
# where its errors count.

# %% [markdown]
# ## 6. Open: more extreme poses
#
# *Hard and open, 40 minutes.* A network learns what it is shown. With only a few clouds beyond 40
# degrees of yaw, it sees hardly any of them in a training. You may not draw new clouds, but you may
# choose *how often* each one is drawn. Write a function that gives every cloud its weight.
#
# | in | shape | |
# |---|---|---|
# | `yaw` | (N,) | true yaw of each training cloud, radians; `nan` if nobody knows it |
# | **out** | (N,) | the probability that a draw takes this cloud |
#
# There are many answers. A check asks for what must hold:
#
# - Weights are at least 0, and their sum is 1. Where yaw is `nan`, the weight is 0; all others are
#   drawn at least sometimes: a thousandth as often as if all were alike, or more.
# - *Extreme* is a yaw of more than 40 degrees to either side (`checks.EXTREME`, radians). Together,
#   extreme clouds make at least 30 % of the draws, and never less than they did. Neither left nor
#   right becomes rarer.
# - They make at most 70 %, if they have not been more before: faces from the front are not forgotten.
# - If there are no extreme clouds, or no others, the shares are what they are.
# - Clouds of the same yaw have the same weight.
# - If nobody knows any yaw, raise a `ValueError` that names `yaw`.
#
# The picture shows what is expected of one answer, for 600 clouds.

# %%
rng = np.random.default_rng(1)
train_angles = np.array([draw_angles(rng) for _ in range(600)])
yaw = train_angles[:, 0]
edges = np.arange(-80, 81, 10)


def shares(weights):
    """(B,) of the draws, in bins of 10 degrees of yaw."""
    return np.histogram(np.degrees(yaw), edges, weights=weights)[0]


uniform = np.full(len(yaw), 1 / len(yaw))
draw.errors_and_draws(
    edges, {"all alike": shares(uniform), "one answer": shares(checks.training_weights(yaw))}
)


# %%
def training_weights(yaw):
    """How likely each cloud (N,) is to be drawn in a training that is to know extreme poses.

    >>> training_weights(np.radians([0.0, 10, -5, 60])).sum()
    np.float64(1.0)
    """
    ### BEGIN SOLUTION
    known, extreme = np.isfinite(yaw), np.abs(yaw) > checks.EXTREME
    if not known.any():
        raise ValueError("yaw: expected one that is known, got none")
    usual = known & ~extreme
    share = extreme.sum() / known.sum()
    if extreme.any() and usual.any():
        share = max(share, 0.4)
    weights = extreme * share / max(extreme.sum(), 1)
    return weights + usual * (1 - share) / max(usual.sum(), 1)
    ### END SOLUTION


# %%
answer = checks.check_training_weights(training_weights)
training_weights_here = use(answer, checks.training_weights)
answer

# %% [markdown]
# Now train two tiny networks, which differ in nothing but the weights: each point goes through two
# layers, the maximum makes one vector of them all (exercise 2), and two more layers make a
# quaternion of it, with the loss of exercise 3. They are tested on all yaws alike.


# %%
class TinyNet(nn.Module):
    def __init__(self):
        super().__init__()
        self.of_points = nn.Sequential(nn.Linear(3, 64), nn.ReLU(), nn.Linear(64, 64), nn.ReLU())
        self.of_cloud = nn.Sequential(nn.Linear(64, 64), nn.ReLU(), nn.Linear(64, 4))

    def forward(self, points):
        return self.of_cloud(self.of_points(points / 0.1).amax(1))


test_angles = np.array([draw_angles(rng) for _ in range(choose(tiny=160, book=640, paper=640))])
test_angles[:, 0] = np.radians(rng.uniform(-75, 75, len(test_angles)))
R_train, R_test = (rotations.euler_to_matrix(a, "YXZ") for a in (train_angles, test_angles))
train_clouds, test_clouds = (seen(R, 64, rng).float() for R in (R_train, R_test))
labels = torch.from_numpy(rotations.matrix_to_quaternion(R_train)).float()


# %%
def train(weights, steps):
    """A network, and its loss at every step."""
    torch.manual_seed(0)
    net, weights, losses = TinyNet().float(), torch.from_numpy(weights), []
    optimiser = torch.optim.Adam(net.parameters(), 5e-3)
    slower = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for _ in range(steps):
        rows = torch.multinomial(weights, 32, replacement=True)
        loss = quaternion_loss_here(net(train_clouds[rows]), labels[rows])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        slower.step()
        losses.append(loss.item())
    return net, losses


# %%
steps = choose(tiny=120, book=1200, paper=1200)
draws, errors, inside = {}, {}, np.abs(test_angles[:, 0]) <= checks.EXTREME
which = np.digitize(np.degrees(test_angles[:, 0]), edges) - 1
for name, weights in {"all alike": uniform, "your weights": training_weights_here(yaw)}.items():
    net, losses = train(weights, steps)
    with torch.no_grad():
        R = rotations.quaternion_to_matrix(net(test_clouds).double()).numpy()
    off = np.degrees(rotations.geodesic_distance(R, R_test))
    draws[name] = shares(weights)
    errors[name] = np.array([off[which == b].mean() for b in range(len(edges) - 1)])
    print(
        f"{name:12s} up to 40° of yaw {off[inside].mean():4.1f}°, beyond {off[~inside].mean():4.1f}°"
    )
    assert np.mean(losses[-5:]) < np.mean(losses[:5])
draw.errors_and_draws(edges, draws, errors)

# %% [markdown] tags=["solution"]
# **Discussion.** Drawing a cloud more often tells the network that its error matters more; it
# does not tell it anything new. (The same could be done by a factor on its loss; then the
# gradients of a batch vary more.) Two dozen extreme clouds stay two dozen, and a network that
# sees each of them hundreds of times may *overfit*: it knows them by heart. So look at clouds
# that it has not seen, as here.
#
# And what is taken from one is given to the other: faces from the front now come less often, which
# costs something in the middle. Which of the two is better depends on the question, that is on the
# measure: MAE of a usual drive would say no, BMAE yes.
#
# If you may draw new clouds, do that first. To *turn* a cloud and its label by some angle makes new
# yaws, but it also makes clouds that no camera sees: a face that looks to the side, with the points
# that are seen from the front.
