# ---
# jupyter:
#   jupytext:
#     cell_metadata_filter: tags,-all
#     formats: ipynb,py:percent
#     notebook_metadata_filter: jupytext,-jupytext.text_representation,-kernelspec
# ---

# %% [markdown]
# # Exercises: poses and cameras
#
# Six functions for you to write, from a warm-up to an open question.
# They need NumPy, and what [chapter 1](../01_poses_and_cameras.ipynb) explains.

# %% [markdown] tags=["solution"]
# **This is the teacher's edition, with the solutions.**
# The students' one is made from it: `python book/make.py start 01` puts it into `book/my_work/`.

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

# %%
import numpy as np
from scipy.stats import binned_statistic

from book.ch01_poses_and_cameras import checks
from book.tools.checks import use
from book.tools.syntax import forgive_syntax
from posecore import figures, metrics, poses, rotations

forgive_syntax()  # a cell that is no Python says so, and the page goes on
rng = np.random.default_rng(0)

# %% [markdown]
# **The object.** A cup is a cloud of points in a frame of its own, in metres.
# The z axis runs up through its middle, 10 cm high; the handle is on the side of +x.

# %%
turn, height = np.meshgrid(np.arange(36) * np.pi / 18, np.linspace(-0.05, 0.05, 10))
wall = np.stack([0.04 * np.cos(turn), 0.04 * np.sin(turn), height], -1)
bend, around = np.meshgrid(np.linspace(-np.pi / 2, np.pi / 2, 15), np.arange(8) * np.pi / 4)
ring = 0.027 + 0.005 * np.cos(around)
x, y, z = 0.04 + ring * np.cos(bend), 0.005 * np.sin(around), ring * np.sin(bend)
handle = np.stack([x, y, z], -1)
cup = np.concatenate([wall.reshape(-1, 3), handle.reshape(-1, 3)])
diameter = np.linalg.norm(cup[:, None] - cup, axis=-1).max()
print(f"{len(cup)} points, diameter d = {1000 * diameter:.0f} mm")

# %% [markdown]
# **The camera and the pose.** The picture has 640 x 480 pixels.
# The pose `(R, t)` takes points from the cup's frame to the camera's: `X_cam = R @ X_obj + t`.

# %%
K = np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])
stand_up = rotations.axis_angle_to_matrix(np.deg2rad([115.0, 0, 0]))
R = stand_up @ rotations.axis_angle_to_matrix(np.deg2rad([0, 0, -30.0]))
t = np.array([0.02, 0.01, 0.25])

# %% [markdown]
# ## 1. Warm-up: from points to pixels
#
# Every method in this book compares a pose with an image. For that, the object's points must be
# brought into the image.
#
# $$X = R\,x + t \qquad \begin{pmatrix} u z \\ v z \\ z \end{pmatrix} = K X$$
#
# | in | shape | |
# |---|---|---|
# | `R`, `t` | (3, 3), (3,) | pose of the object; metres |
# | `K` | (3, 3) | camera matrix |
# | `points` | (N, 3) | points in the object's frame; metres |
# | **out** | (N, 2) | pixels (u, v): column and row |
#
# A point behind the camera has no pixel, though the formula gives one without a complaint.
# Raise a `ValueError` if any point has z of 0 or less in the camera's frame.
#
# The picture shows what is expected for the cup.

# %%
blank = np.full((480, 640), 255, np.uint8)
figure = figures.picture(blank, alt="The cup's points in the image, the near ones dark")
axes = figure.axes[0]
depth = 1000 * poses.apply(R, t, cup)[:, 2]
u, v = checks.project_points(R, t, K, cup).T
dots = axes.scatter(u, v, s=9, c=depth, cmap="viridis")
figure.colorbar(dots, label="depth z, mm", shrink=0.8)
figures.draw_axes(axes, K, R, t, length=0.06)
axes.set_axis_on()
axes.set(xlabel="u, px", ylabel="v, px")
figure


# %%
def project_points(R, t, K, points):
    """Pixels (N, 2) of the object's points (N, 3).

    >>> project_points(np.eye(3), np.array([0, 0, 1]), K, np.array([[0.1, 0, 0]]))
    array([[380., 240.]])
    """
    ### BEGIN SOLUTION
    X = points @ R.T + t  # one point a row, so R stands on the right, transposed
    if (X[:, 2] <= 0).any():
        raise ValueError("points: expected all in front of the camera, got some behind it")
    scaled = X @ K.T
    return scaled[:, :2] / scaled[:, 2:]
    ### END SOLUTION


# %%
answer = checks.check_project_points(project_points)
project_points_here = use(answer, checks.project_points)
answer

# %% [markdown]
# With it, one can see that an object twice as far away looks half as large:

# %%
for distance in (0.5, 1.0, 2.0):
    width = np.ptp(project_points_here(R, np.array([0, 0, distance]), K, cup)[:, 0])
    print(f"at {distance} m the cup is {width:.0f} px wide")
assert 30 < width < 40

# %% [markdown] tags=["solution"]
# **Discussion.** The division by z makes the two signs cancel: without the check, a point behind
# the camera appears at the pixel of its mirror image before the camera. An estimate with `-t` in
# place of `t` would put the cup's centre on the right pixel.

# %% [markdown]
# ## 2. The angle between two rotations
#
# "Right to 5 degrees" is said of an angle: that of the one turn that takes `R_1` to `R_2`,
# $D = R_1^T R_2$. Every book has the formula
#
# $$\cos a = \frac{\operatorname{tr} D - 1}{2}$$
#
# and it is a trap: near 0 the cosine is flat, so that half of the digits are lost.
#
# | in | shape | |
# |---|---|---|
# | `R_1`, `R_2` | (3, 3), (3, 3) | rotations |
# | **out** | a number | radians, from 0 to pi |
#
# Write one that is right to 1e-9 rad everywhere: at 0, at 1e-7 rad, and at 180 degrees.
# The picture shows how far off the formula is, and what is expected of you: to stay in the grey.
# Left of 1e-8 rad the formula says 0, so that the error is the angle itself.

# %%
angles = np.geomspace(1e-10, 1e-2, 200)
turns = rotations.axis_angle_to_matrix(angles[:, None] * np.array([0.48, 0.6, 0.64]))
traces = np.trace(R @ turns @ R.T, axis1=1, axis2=2)
off = np.abs(np.arccos(np.clip((traces - 1) / 2, -1, 1)) - angles)
figure = figures.Picture(figsize=(6.4, 3.4), layout="constrained")
figure.alt = "Error of the arc cosine over the angle: up to 1e-8 rad for angles below 1e-6 rad"
axes = figure.subplots()
axes.loglog(angles, off.clip(1e-17), ".", color="black", label="arc cosine of the trace")
axes.axhspan(1e-17, 1e-9, color="0.85", label="expected")
axes.set(xlabel="true angle, rad", ylabel="error, rad", ylim=(1e-17, 1e-6))
axes.legend(loc="lower right")
figure


# %%
def rotation_angle(R_1, R_2):
    """The angle between two rotations (3, 3), radians in [0, pi].

    >>> rotation_angle(np.eye(3), np.diag([1.0, -1.0, -1.0]))
    3.141592653589793
    """
    ### BEGIN SOLUTION
    D = R_1.T @ R_2
    turned = [D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]]
    sine = np.linalg.norm(turned) / 2
    cosine = (np.trace(D) - 1) / 2
    return float(np.arctan2(sine, cosine))
    ### END SOLUTION


# %%
answer = checks.check_rotation_angle(rotation_angle)
rotation_angle_here = use(answer, checks.rotation_angle)
answer

# %% [markdown]
# Two turns about the same axis are as far apart as their angles, to the last digits:

# %%
for apart in (1e-7, 0.5, np.pi):
    turn = rotations.axis_angle_to_matrix(np.array([0, apart, 0]))
    print(f"{apart:.9g} rad: {rotation_angle_here(R, R @ turn):.9g}")

# %% [markdown] tags=["solution"]
# **Discussion.** Near 0 and pi the cosine is flat and the sine is steep; in the middle it is the
# other way round. The arc tangent of both always leans on the steep one. The chord,
# $2 \arcsin(\lVert R_1 - R_2 \rVert / \sqrt 8)$, is right near 0 but not near pi, where the arc
# sine is as steep as the arc cosine is at 0.

# %% [markdown]
# ## 3. The rotation between two clouds
#
# A depth camera sees points of an object, and we know which point of the model each of them is.
# Which rotation takes the model to what was seen? After both means $\bar p$, $\bar q$ are taken
# away, it is the one that minimises
#
# $$\sum_i \lVert R (p_i - \bar p) - (q_i - \bar q) \rVert^2$$
#
# Kabsch's answer: take the singular value decomposition $H = U \Sigma V^T$ of
# $H = \sum_i (q_i - \bar q)(p_i - \bar p)^T$, and $R = U V^T$ is the best *orthogonal* matrix.
# It may be a reflection. Mend that.
#
# | in | shape | |
# |---|---|---|
# | `source` | (N, 3) | points p of the model; metres |
# | `target` | (N, 3) | points q, where they were seen; metres. Row i belongs to row i |
# | **out** | (3, 3) | the best rotation, with determinant +1 |
#
# No camera can turn a left hand into a right one. But noise, a flat object or a wrong matching
# often makes the reflection fit better, and the check tries all three.
#
# The picture shows what is expected: turned and moved, the model lies on what was seen.

# %%
seen = poses.apply(R, np.array([0.15, 0, 0]), cup) + rng.normal(scale=0.001, size=cup.shape)
turned = cup @ checks.best_rotation(cup, seen).T
moved = turned - turned.mean(0) + seen.mean(0)
clouds = {"model": cup, "seen": seen, "model, moved": moved}
figures.point_clouds(clouds, views=("front", "top"))


# %%
def best_rotation(source, target):
    """The rotation (3, 3) that best takes one cloud (N, 3) to the other, after their means.

    >>> best_rotation(np.eye(3), np.eye(3)[[1, 2, 0]]).round(3) + 0.0
    array([[0., 0., 1.],
           [1., 0., 0.],
           [0., 1., 0.]])
    """
    ### BEGIN SOLUTION
    p, q = source - source.mean(0), target - target.mean(0)
    U, _, Vt = np.linalg.svd(q.T @ p)
    d = np.sign(np.linalg.det(U @ Vt))  # -1 where U Vt is a reflection
    return U @ np.diag([1, 1, d]) @ Vt
    ### END SOLUTION


# %%
answer = checks.check_best_rotation(best_rotation)
best_rotation_here = use(answer, checks.best_rotation)
answer

# %% [markdown]
# How many matched points does it take? Three may lie nearly on a line. From then on the error falls
# with the square root of their number:

# %%
for count in (3, 30, 300):
    tries = []
    for _ in range(50):
        some = rng.choice(len(cup), size=count, replace=False)
        tries.append(metrics.rotation_error(best_rotation_here(cup[some], seen[some]), R))
    print(f"{count:3d} points with 1 mm of noise: {np.rad2deg(np.median(tries)):.2f} degrees")

# %% [markdown] tags=["solution"]
# **Discussion.** NumPy sorts the singular values, so the last column belongs to the smallest one.
# Flipping it costs least: the sum of squares grows by four times that value, and by nothing at all
# for a flat cloud. Flipping another column also gives a rotation, but not the best one.

# %% [markdown]
# ## 4. ADD for a symmetric object
#
# ADD is the mean distance between the model's points in the estimated and in the true pose. A
# square tile looks the same after a quarter turn. An estimate that is a quarter turn off is not
# wrong, but ADD says so.
#
# The honest way is to list the symmetries $S$ of the object, and to take the best of them:
#
# $$\min_S \; \frac1N \sum_i \lVert (R_{est} x_i + t_{est}) - (R_{gt} S(x_i) + t_{gt}) \rVert$$
#
# | in | shape | |
# |---|---|---|
# | `R_est`, `t_est` | (3, 3), (3,) | estimated pose; metres |
# | `R_gt`, `t_gt` | (3, 3), (3,) | true pose; metres |
# | `points` | (N, 3) | points of the model; metres |
# | `symmetries` | (M, 4, 4) | homogeneous matrices in the object's frame, the identity among them |
# | **out** | a number | metres |
#
# The much-used ADD-S asks for no list: it compares every point with the *nearest* one. The picture
# shows why this is too kind: the orange tile is an eighth of a turn off, which anybody sees.
# ADD-S is below 0.1 d, so the pose counts as right.

# %%
grid = np.linspace(-0.05, 0.05, 21)
tile = np.stack(np.meshgrid(grid, grid, [0.0]), -1).reshape(-1, 3)
tile_diameter = 0.1 * np.sqrt(2)
quarters = rotations.axis_angle_to_matrix(np.arange(4)[:, None] * np.array([0, 0, np.pi / 2]))
symmetries = poses.to_matrix(quarters, np.zeros(3))
eighth = rotations.axis_angle_to_matrix(np.array([0, 0, np.pi / 4]))
truth = np.eye(3), np.zeros(3)
estimate = eighth, np.zeros(3)
print(f"0.1 d              {100 * tile_diameter:5.1f} mm")
print(f"ADD-S              {1000 * metrics.add_s(*estimate, *truth, tile):5.1f} mm")
best = checks.add_symmetric(*estimate, *truth, tile, symmetries)
print(f"ADD, best symmetry {1000 * best:5.1f} mm, expected of your function")
figures.point_clouds({"truth": tile, "estimate": tile @ eighth.T}, views=("top",))


# %%
def add_symmetric(R_est, t_est, R_gt, t_gt, points, symmetries):
    """ADD against the best of all poses that look like the true one, metres.

    >>> add_symmetric(np.eye(3), np.array([0, 0, 0.02]), *truth, tile, symmetries)
    0.02
    """
    ### BEGIN SOLUTION
    estimated = points @ R_est.T + t_est
    errors = []
    for S in symmetries:
        turned = points @ S[:3, :3].T + S[:3, 3]  # S acts first, in the object's own frame
        true = turned @ R_gt.T + t_gt
        errors.append(np.linalg.norm(estimated - true, axis=1).mean())
    return float(min(errors))
    ### END SOLUTION


# %%
answer = checks.check_add_symmetric(add_symmetric)
add_symmetric_here = use(answer, checks.add_symmetric)
answer

# %% [markdown]
# The three errors over a quarter turn of the tile. Only the middle one sees what the eye sees:

# %%
degrees = np.arange(91)
turns = rotations.axis_angle_to_matrix(np.deg2rad(degrees)[:, None] * np.array([0, 0, 1]))
still = np.zeros(3)
curve = [add_symmetric_here(turn, still, *truth, tile, symmetries) for turn in turns]
figures.chart(
    {
        "ADD": 1000 * metrics.add(turns, still, *truth, tile),
        "ADD, best symmetry": 1000 * np.array(curve),
        "ADD-S": 1000 * metrics.add_s(turns, still, *truth, tile),
    },
    x=degrees,
    level={"0.1 d": 100 * tile_diameter},
    xlabel="turn about the tile's axis, degrees",
    ylabel="error, mm",
    xticks=degrees[::15],
    alt="ADD rises to 57 mm; with symmetries to 31 mm and falls again; ADD-S stays at 3 mm",
)

# %% [markdown] tags=["solution"]
# **Discussion.** The order of the two steps matters. The minimum over symmetries *inside* the mean
# would let every point choose its own symmetry, and be almost as kind as ADD-S. A symmetry need
# not be a turn about the origin: where the model's origin is off its axis, $S$ has a translation.

# %% [markdown]
# ## 5. BMAE: rare poses count
#
# A driver looks ahead most of the time. A method that is good for frontal heads only has a small
# mean error, and fails when the driver looks aside. The balanced mean angular error (Eq 5 of the
# paper behind chapters 3 and 4) averages in two steps: inside bins of the *true* angle, then over the bins.
#
# | in | shape | |
# |---|---|---|
# | `errors` | (N,) | estimated minus true angle, of either sign; radians |
# | `true_angles` | (N,) | the true angle of the same axis, from -pi to pi; radians |
# | `bin_width` | a number | radians |
# | **out** | a number | radians |
#
# The equation leaves some things open. We read it so:
#
# - A pose belongs to a bin by the *size* of its true angle, and its error counts by its size.
# - Bins are half-open: $[0, w), [w, 2w), \dots$ An angle on an edge belongs to the bin that begins
#   there. Only the last bin, which holds pi, includes its end.
# - An empty bin is left out: divide by the number of bins that hold something.
# - Without any errors, raise a `ValueError`.
#
# The picture shows what is expected: one step for each bin that is not empty, and their mean.

# %%
true_angles = rng.normal(scale=0.35, size=400).clip(-1.5, 1.5)
errors = rng.normal(scale=0.02 + 0.15 * true_angles**2)
angle, error = np.rad2deg(np.abs([true_angles, errors]))
edges = np.arange(0, 95, 5)
steps = binned_statistic(angle, error, bins=edges).statistic  # NaN where a bin is empty
bmae = np.rad2deg(checks.balanced_error(errors, true_angles, np.deg2rad(5)))

# %%
figure = figures.Picture(figsize=(6.4, 3.8), layout="constrained")
figure.alt = "Errors over the true angle: many small ones near 0, few large ones at extreme angles"
axes = figure.subplots()
axes.plot(angle, error, ".", color="0.6", label=f"{len(error)} poses")
axes.hlines(steps, edges[:-1], edges[1:], color="black", linewidth=3, label="means of the bins")
axes.axhline(bmae, linestyle="--", label=f"BMAE {bmae:.1f}°")
axes.axhline(error.mean(), linestyle=":", color="#D55E00", label=f"MAE {error.mean():.1f}°")
axes.set(xlabel="size of the true angle, degrees", ylabel="size of the error, degrees")
axes.legend()
figure


# %%
def balanced_error(errors, true_angles, bin_width):
    """BMAE, radians: the mean absolute error inside bins of the true angle, then over the bins.

    >>> balanced_error(np.array([1.0, -3.0, 6.0]), np.array([0.1, 0.2, -0.9]), 0.25)
    4.0
    """
    ### BEGIN SOLUTION
    if len(errors) == 0:
        raise ValueError("errors: expected at least one, got none")
    last = int(np.ceil(np.pi / bin_width)) - 1
    bins = np.minimum(np.floor(np.abs(true_angles) / bin_width), last)
    means = [np.abs(errors[bins == b]).mean() for b in np.unique(bins)]
    return float(np.mean(means))
    ### END SOLUTION


# %%
answer = checks.check_balanced_error(balanced_error)
balanced_error_here = use(answer, checks.balanced_error)
answer

# %% [markdown]
# One bin for all gives the plain mean. Otherwise the number depends on the width of the bins, so a
# table of results must say which it was:

# %%
for width in (180, 20, 5, 1):
    value = balanced_error_here(errors, true_angles, np.deg2rad(width))
    print(f"bins of {width:3d} degrees: {np.rad2deg(value):.2f} degrees")
assert np.isclose(balanced_error_here(errors, true_angles, np.pi), np.abs(errors).mean())

# %% [markdown] tags=["solution"]
# **Discussion.** As printed, the sum runs over 37 terms and is divided by 36, and empty bins count
# as bins without error. Then BMAE would nearly always be *smaller* than MAE; the paper's tables
# have it larger. With few poses in the extreme bins, BMAE is also a noisy number: say how many
# poses they hold.

# %% [markdown]
# ## 6. Open: the worst pose that a metric forgives
#
# A pose is often called correct if its 2D projection error, the mean distance of the projected
# points, is below 5 px. How wrong can such a pose be? Find one whose ADD is above 0.1 d, which
# everybody calls wrong.
#
# | in | shape | |
# |---|---|---|
# | `R`, `t` | (3, 3), (3,) | true pose, at least five diameters away; metres |
# | `K` | (3, 3) | camera matrix |
# | `points` | (N, 3) | points of the model; metres |
# | `diameter` | a number | d, the largest distance of two points; metres |
# | **out** | (3, 3), (3,) | a pose `(R_wrong, t_wrong)` |
#
# There are many answers, and the check takes any. To be proud of: the largest ADD that you can get.
#
# The picture shows what is expected. Grey: 2000 random poses near the truth. Yours should lie in
# the green box, where hardly any of them is.

# %%
far = np.array([0.02, 0.01, 0.8])
axis_angles = rng.normal(size=(2000, 3)) * rng.uniform(0, 0.5, size=(2000, 1))
moves = rng.normal(size=(2000, 3)) * rng.uniform(0, 0.05, size=(2000, 1))
random_poses = R @ rotations.axis_angle_to_matrix(axis_angles), far + moves
pixels = metrics.projection_2d(K, *random_poses, R, far, cup)
shares = metrics.add(*random_poses, R, far, cup) / diameter


# %%
def error_plane():
    """2D projection error over ADD, with the random poses and the box that is asked for."""
    figure = figures.Picture(figsize=(6.4, 3.8), layout="constrained")
    figure.alt = "2D projection error over ADD; the box of forgiven poses is nearly empty"
    axes = figure.subplots()
    axes.plot(shares, pixels, ".", color="0.6", markersize=3, label="random poses")
    axes.fill_between([0.1, 1.5], 5, color="#009E73", alpha=0.3, label="forgiven, yet wrong")
    axes.set(xlim=(0, 1.5), ylim=(0, 60), xlabel="ADD, diameters", ylabel="2D projection error, px")
    return figure


figure = error_plane()
figure.axes[0].legend(loc="upper left")
figure


# %%
def forgiven_pose(R, t, K, points, diameter):
    """A wrong pose (R, t) that the 2D projection error calls correct.

    >>> R_wrong, t_wrong = forgiven_pose(R, far, K, cup, diameter)
    >>> R_wrong.shape, t_wrong.shape
    ((3, 3), (3,))
    """
    ### BEGIN SOLUTION
    # Along its viewing ray the object keeps its pixel and only changes its size in the image.
    for shift in np.geomspace(10, 0.01, 100):  # the first that is forgiven is the farthest
        if metrics.projection_2d(K, R, t * (1 + shift), R, t, points) < 5:
            return R, t * (1 + shift)
    ### END SOLUTION


# %%
answer = checks.check_forgiven_pose(forgiven_pose)
forgiven_pose_here = use(answer, lambda R, t, K, points, diameter: (R, t))
answer

# %% [markdown]
# This is where it lies, and how it looks to the camera and from the side. Until yours is done you
# see the true pose, at 0 px and 0 d, so that nothing is given away.

# %%
R_wrong, t_wrong = forgiven_pose_here(R, far, K, cup, diameter)
pixel_error = metrics.projection_2d(K, R_wrong, t_wrong, R, far, cup)
share = metrics.add(R_wrong, t_wrong, R, far, cup) / diameter
figure = error_plane()
figure.axes[0].plot(share, pixel_error, "*", color="#D55E00", markersize=14, label="the pose here")
figure.axes[0].legend(loc="upper left")
print(f"2D projection error {pixel_error:.3f} px, ADD {share:.2f} d")
figure

# %%
clouds = {"true": poses.apply(R, far, cup), "forgiven": poses.apply(R_wrong, t_wrong, cup)}
figures.point_clouds(clouds, views=("front", "side"), up="-y")

# %% [markdown] tags=["solution"]
# **Discussion.** One camera measures directions well and distances badly: along the viewing ray
# the pixels hardly change. The farther the object, the more is forgiven: at distance z a slide of
# s z costs about s times the object's radius in pixels, while ADD grows with s z. Going away is
# forgiven further than coming nearer, as the image of an object shrinks more slowly than it grows.
