# ---
# jupyter:
#   jupytext:
#     cell_metadata_filter: tags,-all
#     formats: ipynb,py:percent
#     notebook_metadata_filter: jupytext,-jupytext.text_representation,-kernelspec
# ---

# %% [markdown]
# # Poses and cameras
#
# ## The question in one picture

# %%
import numpy as np

from book.ch01_poses_and_cameras.drawing import scenes as draw
from posecore import cameras, figures, metrics, poses, registration, rotations

photo = draw.photograph()
draw.question(photo)

# %% [markdown]
# Where is the mug, and how is it turned? The answer on the right is six numbers: three say where
# the mug is, three say how it is turned. Together they are its **pose**, and finding them from a
# picture is **6-DoF pose estimation** (six degrees of freedom).
#
# A robot needs the pose to grasp the handle. A headset needs it to draw steam over the rim. And
# whoever compares two methods needs one more thing: a number that says how wrong an estimate is.
# Such numbers are easy to compute and easy to misread. Half of this page is about them.

# %% [markdown]
# ## What you will build, and what you need
#
# | | you build | the library has it as |
# |---|---|---|
# | 1 | a pose: rotation matrix, axis and angle, quaternion | `poses`, `rotations` |
# | 2 | a pinhole camera | `cameras.project` |
# | 3 | a pose from eight pixels, some of them wrong | `registration.pnp` |
# | 4 | a pose from a depth image | `registration.umeyama`, `registration.icp` |
# | 5 | every error measure of the book's five papers, and what each is blind to | `metrics` |
# | 6 | misprints and traps, found by computing | |
#
# You need some linear algebra, a little calculus, and NumPy. Nothing is trained here: the page runs
# in under a minute and takes an hour to read. Each piece is first built in its plainest form, then
# an `assert` shows that the library's version gives the same. Change numbers as you read. Where an
# `assert` then fails, a sentence beside it holds no longer, and you have found its limit.
#
# The picture is drawn by the book itself, so its pose, mask and depth are known exactly. The field
# has photographs with poses that were measured; LINEMOD is a much-used set of them. If you have
# this real data, set `POSECORE_DATA` to its folder before starting Jupyter. Sections 1 to 3 then
# show a cat of LINEMOD, and section 4 a watering can of Occlusion-LINEMOD, where things hide each
# other. Read "mug" as "cat" or "can" there.

# %%
print(f"the picture shows a {photo.name}: {photo.source}")

# %% [markdown]
# ## The idea
#
# Two steps lead from a point of the mug to a pixel. The pose moves the point in front of the
# camera, and the camera projects it:
#
# $$X_\text{obj} \;\xrightarrow{\;R,\, t\;}\; X_\text{cam} \;\xrightarrow{\;K\;}\; (u, v).$$
#
# Sections 1 and 2 build these steps. Sections 3 and 4 go back: from pixels, or from depth, to
# $(R, t)$. Section 5 asks how far apart two poses are, and finds that it depends on who asks.

# %% [markdown]
# ## 1. What a pose is
#
# Two frames meet in every pose. The **object's frame** is glued to the mug: its z axis is the mug's
# axis, and x points out of the handle. The **camera's frame** is glued to the camera: x right, y
# down, z forward. Drag the figure to look from elsewhere.

# %%
draw.frames(photo)

# %% [markdown]
# A point has coordinates in either frame. The pose $(R, t)$ translates from the object's to the
# camera's:
#
# $$X_\text{cam} = R\, X_\text{obj} + t .$$
#
# $R$ is a 3 x 3 rotation matrix and $t$ a vector in metres. Take one point of the mug, and apply
# the formula.

# %%
R, t = photo.R, photo.t
X_obj = photo.keypoints[0]
X_cam = R @ X_obj + t

assert np.allclose(X_cam, poses.apply(R, t, X_obj[None])[0])
print("in the object's frame:", X_obj.round(3), "m")
print("in the camera's frame:", X_cam.round(3), "m, so", X_cam[2].round(3), "m in front of it")

# %% [markdown]
# There is no mystery in the nine numbers of $R$. Put in the object's x axis, $(1, 0, 0)$, and out
# comes the first column. So **the columns of $R$ are the object's axes, as the camera sees them**.
# And $t$ is where the object's origin is.
#
# The third column, for instance, is the z axis. That of the drawn mug points up, against the
# camera's y, and leans a little towards the camera, against its z:

# %%
origin, x_axis, y_axis, z_axis = np.zeros(3), *np.eye(3)

assert np.allclose(R @ x_axis, R[:, 0])
assert np.allclose(R @ z_axis, R[:, 2])
assert np.allclose(R @ origin + t, t)
print("the object's z axis in the camera's frame:", R[:, 2].round(2))

# %% [markdown]
# The axes have length one and are at right angles. That is six equations for nine numbers,
# $R^\top R = I$, and leaves three: a rotation has three degrees of freedom. One more condition
# rules out mirror images, $\det R = +1$.

# %%
assert np.allclose(R.T @ R, np.eye(3), atol=1e-5)
assert np.isclose(np.linalg.det(R), 1, atol=1e-5)

# %% [markdown]
# **Invert** a pose to ask the question the other way round: where is the camera, seen from the mug?
# Solve $X_\text{cam} = R X_\text{obj} + t$ for $X_\text{obj}$; as $R^{-1} = R^\top$, it costs
# nothing.

# %%
R_inverse, t_inverse = R.T, -R.T @ t

assert np.allclose(R_inverse @ X_cam + t_inverse, X_obj, atol=1e-6)
assert np.allclose(t_inverse, poses.invert(R, t)[1])
print("the camera, in the object's frame:", t_inverse.round(2), "m")

# %% [markdown]
# **Compose** two poses to do one after the other. Write $(R_{ab}, t_{ab})$ for the pose that takes
# points from frame b to frame a. From c over b to a, then:
#
# $$R_{ac} = R_{ab} R_{bc}, \qquad t_{ac} = R_{ab}\, t_{bc} + t_{ab} .$$
#
# The order matters. Take a turn $S$ by 10 degrees about a y axis. Written on the right, it happens
# first, in the mug's own frame: the mug turns on the spot. Written on the left, it happens last, in
# the camera's frame: everything turns about the camera. Blue is the pose as it was, orange the
# turned one.

# %%
S = rotations.axis_angle_to_matrix(np.radians([0, 10, 0]))
no_shift = np.zeros(3)
own = poses.compose(R, t, S, no_shift)
cameras_own = poses.compose(S, no_shift, R, t)

assert np.allclose(own[1], t) and not np.allclose(cameras_own[1], t)
draw.order_matters(photo, {"R S: about its own y": own, "S R: about the camera's y": cameras_own})

# %% [markdown]
# ### Three numbers for a turn
#
# Every rotation is one turn by an angle about one axis. Scale the axis by the angle and you have
# three numbers, the **axis-angle vector** $\omega$. Rodrigues' formula makes the matrix of it: with
# $\theta = |\omega|$, and $[k]_\times$ the matrix that takes the cross product with the unit axis
# $k$,
#
# $$R = I + \sin\theta\, [k]_\times + (1 - \cos\theta)\, [k]_\times^2 .$$
#
# Only $\theta = 0$ has no axis. The library takes care of it; this plainest form does not.


# %%
def rodrigues(omega):
    theta = np.linalg.norm(omega)
    kx, ky, kz = omega / theta
    k_cross = np.array([[0, -kz, ky], [kz, 0, -kx], [-ky, kx, 0]])
    return np.eye(3) + np.sin(theta) * k_cross + (1 - np.cos(theta)) * k_cross @ k_cross


omega = rotations.matrix_to_axis_angle(R)
assert np.allclose(rodrigues(omega), R, atol=1e-5)
assert np.allclose(rodrigues(omega), rotations.axis_angle_to_matrix(omega))
print(f"R is a turn by {np.degrees(np.linalg.norm(omega)):.1f} degrees")

# %% [markdown]
# A **quaternion** spends a fourth number. In return, its products and sums make the matrix, without
# a sine. It has length one:
#
# $$q = (w, x, y, z) = \left(\cos\tfrac\theta2,\; \sin\tfrac\theta2\, k\right).$$
#
# It has a catch. The quaternions $q$ and $-q$ are the same rotation, yet as far apart as two unit
# vectors can be. A network that is punished for the distance between quaternions must know that
# (chapters 4 and 5).

# %%
theta = np.linalg.norm(omega)
q = np.array([np.cos(theta / 2), *np.sin(theta / 2) * omega / theta])

assert np.allclose(rotations.quaternion_to_matrix(q), rotations.quaternion_to_matrix(-q))
assert np.allclose(rotations.quaternion_to_matrix(q), R, atol=1e-5)
print(f"same rotation, distance {np.linalg.norm(q - (-q)):.3f}")

# %% [markdown]
# You will also meet **Euler angles**: yaw, pitch and roll, three turns one after the other. They
# are good for reading and bad for computing, and two papers rarely mean the same order. Chapter 5
# compares all of these, and what a network makes of them.

# %% [markdown]
# ## 2. What a camera does
#
# A pinhole camera divides by the depth. Seen from above, a point lies $X$ beside the optical axis,
# at depth $Z$. Its ray meets the image, which stands at distance $f$, at $f X / Z$: the two
# triangles have the same shape.

# %%
draw.pinhole(photo)

# %% [markdown]
# Measure $f$ in pixels, which need not be square, so in their widths and in their heights. And add
# the pixel $(c_x, c_y)$ where the optical axis meets the image:
#
# $$u = f_x \frac XZ + c_x, \qquad v = f_y \frac YZ + c_y .$$
#
# The four numbers are kept in the camera matrix $K$, which says the same in one product:
#
# $$K = \begin{pmatrix} f_x & 0 & c_x \\ 0 & f_y & c_y \\ 0 & 0 & 1 \end{pmatrix}, $$
#
# $$K \begin{pmatrix} X \\ Y \\ Z \end{pmatrix} = Z \begin{pmatrix} u \\ v \\ 1 \end{pmatrix} .$$

# %%
K = photo.K
fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]


def project_by_hand(X_cam):
    X, Y, Z = X_cam
    return np.array([fx * X / Z + cx, fy * Y / Z + cy])


model = poses.apply(R, t, photo.points)  # (N, 3) in the camera's frame
pixels = np.array([project_by_hand(X) for X in model])
with_ones = np.column_stack([pixels, np.ones(len(pixels))])
assert np.allclose(model @ K.T, model[:, 2:] * with_ones)
assert np.allclose(pixels, cameras.project(K, model))

# %% [markdown]
# Which number has the first pixel? In this book, in OpenCV and in BOP its **centre** is $(0, 0)$,
# so the picture begins at $-0.5$.

# %%
draw.pixel_grid()

# %% [markdown]
# Forget that half pixel and every resized picture is shifted. The border stays in place when a
# picture is halved, so it is $c_x + 0.5$ that is halved, not $c_x$.

# %%
height, width = photo.rgb.shape[:2]
half = cameras.resize_intrinsics(K, (width, height), (width // 2, height // 2))

assert np.isclose(half[0, 2], (cx + 0.5) / 2 - 0.5)
print("cx:", cx, "in the whole picture,", half[0, 2], "in the half one")

# %% [markdown]
# Now see whether pose and camera are right: the projected points of the model must cover the mug
# and nothing else. That is the first test to make with any data set, ground truth included.
#
# The right picture shows eight **keypoints**: points of the model, chosen far from each other. Some
# are out of sight. Number 0 of the drawn mug is in the middle of its bottom.

# %%
from scipy.ndimage import binary_dilation

keypoints = photo.keypoints[:8]
keypoint_pixels = cameras.project(K, poses.apply(R, t, keypoints))

columns, rows = np.rint(pixels).astype(int).T
with_border = binary_dilation(photo.mask, iterations=2)  # rounding may step over the edge
assert with_border[rows, columns].all()
draw.model_on_photograph(photo, pixels, keypoint_pixels)

# %% [markdown]
# ## 3. From eight pixels to a pose
#
# Turn the question round. Someone has found the eight numbered keypoints in the picture; in chapter
# 8 a network does. Their places on the model are known. Which pose puts them there? This is the
# **Perspective-n-Point** problem, PnP.
#
# The found pixels are never exact. Here they are rounded to whole pixels.

# %%
found = np.rint(keypoint_pixels)  # (8, 2)


def residuals(pose):
    """How far the pose, axis-angle vector and translation, misses the pixels: (16,)."""
    R, t = rotations.axis_angle_to_matrix(pose[:3]), pose[3:]
    return (cameras.project(K, poses.apply(R, t, keypoints)) - found).ravel()


# %% [markdown]
# Six unknowns, sixteen equations, none of them linear. **Gauss-Newton** pretends that they are. At
# the present pose $p$ it replaces the residuals by their tangent,
# $r(p + \delta) \approx r(p) + J \delta$, takes the step $\delta$ for which the sum of squares of
# that is least, and repeats. The Jacobian $J$ (16 x 6) comes from central differences.


# %%
def jacobian(function, p, step=1e-6):
    nudges = step * np.eye(len(p))
    return np.stack([(function(p + n) - function(p - n)) / (2 * step) for n in nudges], axis=1)


tilt = np.radians([25, -15, 20])  # a start that is far off
R_start = R @ rotations.axis_angle_to_matrix(tilt)
p = np.concatenate([rotations.matrix_to_axis_angle(R_start), [0, 0, 1.3 * t[2]]])
path = [p]
for _ in range(10):
    J = jacobian(residuals, p)
    p = p - np.linalg.lstsq(J, residuals(p))[0]
    path.append(p)
pixel_errors = [np.sqrt(np.square(residuals(p)).sum() / 8) for p in path]
print(f"start: tilted by {np.degrees(np.linalg.norm(tilt)):.0f} degrees, {pixel_errors[0]:.1f} px")

# %% [markdown]
# The start is tilted by 35 degrees, lies on the optical axis, and is 30 % too far away. Blue is the
# truth, orange the estimate, here and wherever a pose is drawn into the picture. The titles give
# the root mean square distance from the eight pixels. A few steps suffice.
#
# Not from everywhere: with 150 degrees in place of 25 a step leaps behind the camera, and the
# library says so.

# %%
steps = [(rotations.axis_angle_to_matrix(p[:3]), p[3:]) for p in path]
draw.fitting_steps(photo, steps, pixel_errors)

# %% [markdown]
# The library finds its own start, and ends at the same pose. The error that is left comes from
# rounding the pixels.

# %%
solved = registration.pnp(keypoints, found, K)
R_found, t_found = steps[-1]

assert np.allclose(solved.R, R_found, atol=1e-5) and np.allclose(solved.t, t_found, atol=1e-5)
assert pixel_errors[-1] < 1 < pixel_errors[0]
degrees = np.degrees(metrics.rotation_error(R_found, R))
print(f"off by {degrees:.2f} degrees and {1000 * np.linalg.norm(t_found - t):.1f} mm")

# %% [markdown]
# ### Wrong keypoints
#
# Least squares believes every keypoint, and believes a far-off one most, as its error counts
# squared. **RANSAC** asks for a vote instead. Take four keypoints, solve, and count how many of the
# others agree, here to 4 pixels. Wrong keypoints rarely agree with each other, right ones always
# do. With eight keypoints we can try all seventy choices of four; the library draws some at random.

# %%
from itertools import combinations


def most_agreeable(pixels, threshold=4.0):
    best = np.zeros(8, dtype=bool)
    for four in map(list, combinations(range(8), 4)):
        try:  # SQPnP needs no start; its pose is good enough for a vote
            R, t, *_ = registration.pnp(keypoints[four], pixels[four], K, "sqpnp")
        except ValueError:  # no pose explains these four
            continue
        there = cameras.project(K, poses.apply(R, t, keypoints), behind="inf")
        agree = np.linalg.norm(there - pixels, axis=1) <= threshold
        best = max(best, agree, key=np.sum)
    return best


# %% [markdown]
# Displace one, two, then three of the eight: the crosses. Least squares takes all eight; RANSAC
# takes those that agree, and solves once more with these.

# %%
pushed = np.array([[45, 10], [-20, 38], [30, -35]]) * photo.rgb.shape[1] / 480
given, results = {}, {}
for wrong in (1, 2, 3):
    given[wrong] = found.copy()
    given[wrong][:wrong] += pushed[:wrong]
    results["least squares", wrong] = registration.pnp(keypoints, given[wrong], K)
    results["RANSAC", wrong] = registration.pnp(keypoints, given[wrong], K, "ransac")

    agree = most_agreeable(given[wrong])
    assert not agree[:wrong].any() and agree[wrong:].all()
    assert np.array_equal(agree, results["RANSAC", wrong].inliers)
    off = [metrics.rotation_error(results[m, wrong].R, R) for m in ("RANSAC", "least squares")]
    assert np.degrees(off[0]) < 3 and off[0] < off[1]

# %%
draw.wrong_keypoints(photo, given, results)

# %% [markdown]
# One displaced keypoint is enough to tilt the box visibly. That is why PVNet (chapter 8) lets the
# pixels vote for every keypoint, and says how sure it is of each.
#
# **Play with it.** The sliders drag one keypoint, the cross; the other seven are exact here. Up to
# where does RANSAC still believe it? (Where no kernel runs, on the site or on GitHub, you see the
# figure's still form.)

# %%
from ipywidgets import fixed, interact

pixels_away = (-80, 80)
_ = interact(
    draw.dragged_keypoint,
    photo=fixed(photo),
    right=pixels_away,
    down=pixels_away,
    keypoint=(0, 7),
)

# %% [markdown]
# ## 4. From depth to a pose
#
# A depth camera measures, for every pixel, the $Z$ of what it sees. Undo the projection and each
# pixel becomes a point: $X = Z (u - c_x) / f_x$, and the same for $Y$.

# %%
shot = draw.scan()
measured = cameras.depth_to_points(shot.depth, shot.K, shot.mask)  # (M, 3), row by row

v, u = np.argwhere(shot.mask & (shot.depth > 0))[0]  # the first pixel of the mask, by hand
Z = shot.depth[v, u]
by_hand = [Z * (u - shot.K[0, 2]) / shot.K[0, 0], Z * (v - shot.K[1, 2]) / shot.K[1, 1], Z]
assert np.allclose(measured[0], by_hand)
print(len(measured), "points measured on the", shot.name)
draw.depth_picture(shot)

# %% [markdown]
# ### If we knew which point is which
#
# Suppose each measured point $q_i$ came with its place $p_i$ on the model. (A network
# says exactly this in chapter 7.) Then the pose with the least
# $\sum_i |R\, p_i + t - q_i|^2$ needs no iteration. Umeyama's recipe: take both means $\bar p$ and
# $\bar q$ away; collect $H = \sum_i (q_i - \bar q)(p_i - \bar p)^\top$; and with its singular value
# decomposition $H = U \Sigma V^\top$,
#
# $$R = U \operatorname{diag}(1, 1, \det U \det V)\, V^\top, $$
#
# $$t = \bar q - R\, \bar p .$$
#
# Why? Multiply the square out: of all its terms only $-2 \operatorname{tr}(R^\top H)$ depends on
# $R$. Write $R = U S V^\top$. Then the trace is $\sum_k \Sigma_{kk} S_{kk}$. No entry of an
# orthogonal $S$ exceeds 1, so $S = I$ is best, and where that gives a mirror image, the last and
# smallest singular value pays.


# %%
def umeyama_by_hand(p, q):
    p_mean, q_mean = p.mean(0), q.mean(0)
    H = (q - q_mean).T @ (p - p_mean)
    U, _, Vt = np.linalg.svd(H)
    d = np.linalg.det(U) * np.linalg.det(Vt)  # +1, or -1 if U V^T is a mirror image
    R = U @ np.diag([1, 1, d]) @ Vt
    return R, q_mean - R @ p_mean


# %%
rng = np.random.default_rng(0)
p = shot.points
q = poses.apply(shot.R, shot.t, p) + rng.normal(0, 0.005, p.shape)  # with 5 mm of noise
R_hand, t_hand = umeyama_by_hand(p, q)
_, R_library, t_library = registration.umeyama(p, q)  # the first is a scale, here 1

assert np.allclose(R_hand, R_library) and np.allclose(t_hand, t_library)
degrees = np.degrees(metrics.rotation_error(R_hand, shot.R))
assert degrees < 0.5
print(f"{len(p)} pairs with 5 mm of noise: off by {degrees:.2f} degrees")

# %% [markdown]
# What is the middle matrix for? Without it, the answer may be a mirror image, which no turn can
# bring about. With random matrices in place of $H$ that happens half of the time. The paper of
# chapter 7 prints the formula without it.

# %%
U, _, Vt = np.linalg.svd(rng.normal(size=(10_000, 3, 3)))
mirrored = (np.linalg.det(U @ Vt) < 0).mean()

assert 0.45 < mirrored < 0.55
print(f"{100 * mirrored:.1f} % of the matrices U V^T are mirror images")

# %% [markdown]
# ### If we do not
#
# Guess! **Iterative closest point** (ICP) pairs every measured point with the nearest point of the
# model as it is placed now, solves for the pose as if the pairs were right, and repeats.
#
# Only those points of the model are asked whose surface faces the camera, as no others can have
# been measured. It matters here: the mug's inner wall is a few millimetres behind its outer one,
# and would attract what was measured on the outer one.

# %%
from scipy.spatial import cKDTree


def icp_by_hand(measured, R, t, steps=40):
    path, distances = [(R, t)], []
    for _ in range(steps):
        towards_camera = ((shot.points @ R.T + t) * (shot.normals @ R.T)).sum(1) < 0
        model = shot.points[towards_camera]
        distance, nearest = cKDTree(model).query((measured - t) @ R)  # in the object's frame
        distances.append(np.sqrt(np.square(distance).mean()))
        R, t = umeyama_by_hand(model[nearest], measured)
        path.append((R, t))
    return path, distances


# %% [markdown]
# Start with a pose that is tilted by 25 degrees and 27 mm off. The picture looks along the object's
# own axis. There the model stands still, and the measured points move.

# %%
tilt = rotations.axis_angle_to_matrix(np.radians([12, -8, 20]))
start = shot.R @ tilt, shot.t + [0.015, -0.010, 0.020]
some = measured[:: len(measured) // 500]
path, distances = icp_by_hand(some, *start)

for name, (R_now, t_now) in {"start": start, "end": path[-1]}.items():
    degrees = np.degrees(metrics.rotation_error(R_now, shot.R))
    millimetres = 1000 * metrics.translation_error(t_now, shot.t)
    print(f"{name}: {degrees:.1f} degrees and {millimetres:.1f} mm from the truth")
assert degrees < 5 and millimetres < 8
draw.before_and_after(shot, some, path, distances)

# %% [markdown]
# One step of the library's `icp`, from the same pairs, gives the same pose. (It moves the measured
# points to the model, so its pose is the inverse of ours.) `refine_on_depth` is the one to use: it
# measures distances to tangent planes, along which points may slide, and drops the worst pairs.

# %%
R_0, t_0 = start
facing = ((shot.points @ R_0.T + t_0) * (shot.normals @ R_0.T)).sum(1) < 0
model, (R_back, t_back) = shot.points[facing], poses.invert(R_0, t_0)
one_step = registration.icp(some, model, R_back, t_back, max_iterations=1)
R_1, t_1 = poses.invert(one_step.R, one_step.t)
assert np.allclose(R_1, path[1][0]) and np.allclose(t_1, path[1][1])

fine = registration.refine_on_depth(shot.depth, shot.K, shot.points, shot.normals, R_0, t_0)
degrees = np.degrees(metrics.rotation_error(fine.R, shot.R))
millimetres = 1000 * metrics.translation_error(fine.t, shot.t)
assert degrees < 5 and millimetres < 8
print(f"refine_on_depth: {degrees:.2f} degrees, {millimetres:.2f} mm, {fine.iterations} steps")

# %% [markdown]
# ### When it fails
#
# ICP walks downhill from where it starts. Give it starts that are turned about the object's own
# axis, all the way round, and see where each ends. One that ends within 10 degrees of the truth has
# arrived.

# %%
turns = np.arange(-180, 180, 20)
ends, last = [], []
for turn in np.radians(turns):
    R_start = shot.R @ rotations.axis_angle_to_matrix(np.array([0, 0, turn]))
    path, distances = icp_by_hand(some, R_start, shot.t, steps=25)
    ends.append(path[-1])
    last.append(distances[-1])

last = np.array(last)
errors = np.degrees([metrics.rotation_error(R, shot.R) for R, _ in ends])
assert errors[np.abs(turns) <= 20].max() < 10 < errors.max()
assert last[errors > 20].min() > last[errors < 10].max()

# %%
draw.icp_starts(shot, some, turns, ends, last, shown=turns.tolist().index(100))

# %% [markdown]
# Outside a narrow valley around the truth the mug stays as wrong as it was. Its body fits itself at
# every turn, so nothing pulls but the handle, and the measured handle finds its nearest partners on
# the body, straight behind it (right). Without the handle no turn would be better than another.
#
# The distance at the end betrays a wrong end, but only if you know what to expect: it too is a
# matter of millimetres. So ICP refines a pose; something else must find it.

# %% [markdown]
# ## 5. How wrong is an estimate?
#
# Every measure below is used in one of the book's papers. Each is built in its plainest form, then
# shown on a case where it does not say what one thinks. From here on the drawn mug and the tin can
# beside it serve, whatever data you have: with exact poses, every surprise is the measure's own.

# %%
from book.ch01_poses_and_cameras.drawing import measuring as chart

mug, can = chart.mug(), chart.can()
K, R_gt, t_gt, points = mug.K, mug.R, mug.t, mug.points  # gt: ground truth


def turned(degrees, axis):
    """The mug's true pose after a turn about one of its own axes."""
    angle = np.radians(degrees) * np.eye(3)["xyz".index(axis)]
    return R_gt @ rotations.axis_angle_to_matrix(angle), t_gt


# %% [markdown]
# ### Two errors: rotation and translation
#
# The relative rotation $R_\text{est} R_\text{gt}^\top$ is one turn by one angle, which its trace
# gives away: $\operatorname{tr} = 1 + 2 \cos\theta$. The translation error is a distance. (For very
# small angles this formula is a trap; exercise 2 shows it.)

# %%
R_est, t_est = turned(15, "x")[0], t_gt + [0.003, 0, 0.004]
cosine = (np.trace(R_est @ R_gt.T) - 1) / 2
angle = np.arccos(np.clip(cosine, -1, 1))  # rounding may leave the cosine just above 1

assert np.isclose(angle, metrics.rotation_error(R_est, R_gt))
assert np.isclose(np.linalg.norm(t_est - t_gt), metrics.translation_error(t_est, t_gt))
print(f"{np.degrees(angle):.1f} degrees, {1000 * np.linalg.norm(t_est - t_gt):.1f} mm")

# %% [markdown]
# **What it does not say.** Two numbers do not rank two estimates. And the angle does not know the
# object: turn the can about its axis, and nobody can tell, but the angle can. For such objects the
# **axis error** counts: the angle between the axis as estimated and as it is.

# %%
spin = rotations.axis_angle_to_matrix(np.radians([0, 0, 90]))
can_turned = can.R @ spin, can.t

assert np.isclose(np.degrees(metrics.rotation_error(can_turned[0], can.R)), 90)
assert np.isclose(metrics.axis_error(can_turned[0], can.R, [0, 0, 1]), 0)
alt = "The outlines of the can before and after a turn by 90 degrees about its axis coincide."
chart.on_the_photograph(can, {"rotation error: 90°, axis error: 0°": can_turned}, alt=alt)

# %% [markdown]
# ### ADD: how far do the points move?
#
# One number for both errors, in metres: place the model twice, and average the distances of its
# points. The object's diameter $d$ is the largest distance between two of its points. An estimate
# counts as correct if ADD is below a tenth of it, `0.1 d`.
#
# $$\text{ADD} = \frac1N \sum_i \left| (R_\text{est} x_i + t_\text{est}) -
# (R_\text{gt} x_i + t_\text{gt}) \right|$$


# %%
def add_by_hand(R_est, t_est, R_gt, t_gt, points):
    gaps = (points @ R_est.T + t_est) - (points @ R_gt.T + t_gt)
    return np.linalg.norm(gaps, axis=1).mean()


on_mug = metrics.add(R_est, t_est, R_gt, t_gt, points)
on_can = metrics.add(*can_turned, can.R, can.t, can.points)
assert np.isclose(add_by_hand(R_est, t_est, R_gt, t_gt, points), on_mug)
assert on_mug < 0.1 * mug.diameter and on_can > 0.1 * can.diameter
print(f"mug, 15 degrees and 5 mm off: {1000 * on_mug:.1f} mm, 0.1 d = {100 * mug.diameter:.1f} mm")
print(f"can, turned by 90 degrees:    {1000 * on_can:.1f} mm, 0.1 d = {100 * can.diameter:.1f} mm")

# %% [markdown]
# **What it does not say.** That turn of the can, which nobody sees, is wrong by 42 mm. ADD is not
# for symmetric objects.

# %% [markdown]
# ### ADD-S: for symmetric objects
#
# Compare each point with the **nearest** one instead of its own. The can is right again. What is
# left is not quite 0, because the points are a sample of its surface.


# %%
def add_s_by_hand(R_est, t_est, R_gt, t_gt, points):
    estimated, true = points @ R_est.T + t_est, points @ R_gt.T + t_gt
    distances = np.linalg.norm(true[:, None] - estimated[None], axis=-1)  # (N, N)
    return distances.min(axis=1).mean()  # for every true point, the nearest estimated one


few = points[:500]
backwards = turned(180, "z")
assert np.isclose(
    add_s_by_hand(*backwards, R_gt, t_gt, few), metrics.add_s(*backwards, R_gt, t_gt, few)
)
on_can = metrics.add_s(*can_turned, can.R, can.t, can.points)
assert on_can < 0.1 * can.diameter
print(f"can, turned by 90 degrees: {1000 * on_can:.1f} mm")

# %% [markdown]
# **What it does not say.** It is too kind. Turn the mug by 180 degrees: the handle is on the wrong
# side, and a robot would grasp the air. But the body covers itself, so nearly every point has a
# near neighbour. By ADD-S below 0.1 d, this estimate is correct.

# %%
add, add_s = (f(*backwards, R_gt, t_gt, points) for f in (metrics.add, metrics.add_s))

assert add_s < 0.1 * mug.diameter < add
title = f"ADD {1000 * add:.0f} mm, ADD-S {1000 * add_s:.1f} mm, 0.1 d = {100 * mug.diameter:.1f} mm"
alt = "The mug's true outline has its handle on the right, the estimate's outline on the left."
chart.on_the_photograph(mug, {title: backwards}, alt=alt)

# %% [markdown]
# Some tables therefore print "ADD(-S)": ADD-S for the objects on a list of symmetric ones, ADD for
# the others. Who is on the list belongs to the result. The BOP challenge avoids the question by
# asking for each object's set of symmetries (`metrics.mssd`).

# %% [markdown]
# ### 2D projection: what the camera sees
#
# Project both placed models, and average the distances in pixels. Below 5 pixels counts as correct.
# Push the mug away by 3 cm, along the ray on which it lies.

# %%
away = R_gt, t_gt + 0.03 * t_gt / np.linalg.norm(t_gt)
true_pixels = cameras.project(K, poses.apply(R_gt, t_gt, points))
gaps = cameras.project(K, poses.apply(*away, points)) - true_pixels
projection = metrics.projection_2d(K, *away, R_gt, t_gt, points)

assert np.isclose(np.linalg.norm(gaps, axis=1).mean(), projection)
add = metrics.add(*away, R_gt, t_gt, points)
assert projection < 5 and add > 0.2 * mug.diameter
print(f"2D projection {projection:.1f} px, ADD {1000 * add:.0f} mm")
chart.seen_from_above(mug, *away)

# %% [markdown]
# **What it does not say.** It cannot see along the optical axis. For a headset that draws into the
# picture that is fine. For a robot it is not: the gripper closes 3 cm too far away.

# %% [markdown]
# ### 0.1 d: whose diameter?
#
# Four hundred noisy estimates of the mug. How many are correct? That depends on `d`. For the same
# objects of LINEMOD, the diameters in the code of PVNet (chapter 8) differ from those of the BOP
# benchmark by -6 to +16 %. Move the threshold by that much:

# %%
turns = rotations.axis_angle_to_matrix(rng.normal(0, np.radians(6), (400, 3)))
shifts = rng.normal(0, [0.004, 0.004, 0.012], (400, 3))  # depth is the hardest
R_many, t_many = R_gt @ turns, t_gt + shifts
errors = metrics.add(R_many, t_many, R_gt, t_gt, points)

limits = {f"0.1 x {f:.2f} d": 0.1 * f * mug.diameter for f in (0.94, 1.00, 1.16)}
shares = [metrics.accuracy(errors, limit) for limit in limits.values()]
assert np.isclose(shares[1], (errors < 0.1 * mug.diameter).mean())
assert shares[0] < shares[1] < shares[2]
chart.thresholds(errors, limits)

# %% [markdown]
# The same estimates, and a gap that many papers would call progress. ADD-0.1d columns of different
# papers can be compared only if their diameters can.

# %% [markdown]
# ### AUC: no threshold at all?
#
# Take all thresholds up to 10 cm: the area under the accuracy curve. The curve is a staircase, so
# the area is exact: the mean of $\max(0, 1 - e / 0.1)$ over all errors $e$, in metres. Here are two
# methods with the same area.

# %%
gambler = np.repeat([0.001, 0.300], [240, 60])  # four times in five 1 mm off, else lost
steady = rng.uniform(-0.005, 0.005, 300)  # about 2 cm off, always
steady += 0.1 * (1 - metrics.auc(gambler, 0.1)) - steady.mean()

by_hand = np.maximum(0, 1 - steady / 0.1).mean()
assert np.isclose(by_hand, metrics.auc(steady, 0.1))
assert np.isclose(by_hand, metrics.auc(gambler, 0.1))
figures.accuracy_curves({"about 2 cm off": steady, "1 mm off, or lost": gambler}, 0.1)

# %% [markdown]
# **What it does not say.** Which of them you want. A gripper that needs 1 cm never works with the
# first, and four times in five with the second. Look at the curve, not at its area. And 10 cm is
# nearly the size of the mug: with ADD-S inside, an area of 90 % is easy to get.

# %% [markdown]
# ### n degrees, m centimetres
#
# Correct means: rotation error below n degrees **and** translation error below m cm.

# %%
rotation = metrics.rotation_error(R_many, R_gt)
translation = metrics.translation_error(t_many, t_gt)
correct = (np.degrees(rotation) < 5) & (100 * translation < 5)

assert np.array_equal(correct, metrics.within(rotation, translation, 5, 5))
ten = metrics.within(rotation, translation, 10, 5).mean()
print(f"5 degrees 5 cm: {100 * correct.mean():.0f} %, 10 degrees 5 cm: {100 * ten:.0f} %")
named = {"4.9°: correct": (4.9, 3.0), "5.1°: wrong": (5.1, 0.2)}
chart.cliff(rotation, translation, named)

# %% [markdown]
# **What it does not say.** It is a cliff. Of the two named estimates the worse one counts and the
# better one does not. And a can has no yaw: for bottles, bowls and cans the angle must be that of
# the axis, or be taken over all symmetric poses. Whether a mug whose handle is hidden is such an
# object is a choice, which moves tables.

# %% [markdown]
# ### MAE, RMSE, BMAE: angles of a head
#
# Head pose is given in yaw, pitch and roll, and their errors are averaged: the mean of the absolute
# errors (MAE), or the root of the mean of the squares (RMSE). People mostly look ahead. So here is
# a method that never looks at the picture, and always says "frontal".

# %%
frontal = rng.normal(0, np.radians(4), 2000)
sideways = rng.uniform(-np.radians(70), np.radians(70), 100)
true_yaw = np.concatenate([frontal, sideways])
lazy = 0 - true_yaw  # its error, as it always says 0
honest = rng.normal(0, np.radians(6), true_yaw.shape)  # looks, and is as wrong everywhere

mae = metrics.mean_absolute_error
assert np.isclose(np.abs(lazy).mean(), mae(lazy)) and mae(lazy) < mae(honest) * 1.1
print(f"MAE: lazy {np.degrees(mae(lazy)):.1f}, honest {np.degrees(mae(honest)):.1f} degrees")

# %% [markdown]
# The balanced error, BMAE, sorts the pictures into bins of the true angle, here 5 degrees wide,
# averages in each bin, and then over the bins. A rare angle now counts as much as a frequent one.

# %%
bins = np.floor(np.abs(true_yaw) / np.radians(5)).astype(int)
by_hand = np.mean([np.abs(lazy[bins == b]).mean() for b in np.unique(bins)])

bmae = metrics.balanced_mean_angular_error
assert np.isclose(by_hand, bmae(lazy, true_yaw))
assert bmae(lazy, true_yaw) > 3 * bmae(honest, true_yaw)
balanced = [np.degrees(bmae(errors, true_yaw)) for errors in (lazy, honest)]
print(f"BMAE: lazy {balanced[0]:.1f}, honest {balanced[1]:.1f} degrees")
chart.bins_of_angles(true_yaw, {"honest": honest, "lazy": lazy}, np.radians(5))

# %% [markdown]
# **What it does not say.** A bin with three pictures weighs as much as one with a thousand, so BMAE
# is noisy exactly where it looks. Print the number of pictures beside it.

# %% [markdown]
# ### 3D IoU: boxes instead of points
#
# Some methods say a box: a pose and a size. Two boxes are compared by the volume they share, over
# the volume they fill together. For boxes with parallel edges that takes two lines; the library
# clips boxes in any pose.


# %%
def iou_by_hand(centre_1, centre_2, size):
    shared = np.prod(np.maximum(0, size - np.abs(centre_1 - centre_2)))
    return shared / (2 * np.prod(size) - shared)


cube, upright = np.full(3, 0.1), np.eye(3)
one, two = np.array([0, 0, 0.8]), np.array([0.02, 0.05, 0.81])
iou = metrics.oriented_iou_3d(upright, one, cube, upright, two, cube)
assert np.isclose(iou_by_hand(one, two, cube), iou)
print(f"IoU {iou:.3f}")

# %% [markdown]
# **What it does not say.** A box has no front. Turn the mug by 180 degrees about the middle of its
# box, and the overlap is perfect.

# %%
R_est, _ = backwards
middle = R_gt @ mug.centre + t_gt
t_est = middle - R_est @ mug.centre  # so that the middle of the box stays where it is
iou = metrics.oriented_iou_3d(R_est, R_est @ mug.centre + t_est, mug.size, R_gt, middle, mug.size)

assert np.isclose(iou, 1)
title = f"3D IoU {iou:.2f}, ADD {1000 * metrics.add(R_est, t_est, R_gt, t_gt, points):.0f} mm"
alt = "The estimate's handle is on the left, its body where the true handle is, on the right."
chart.on_the_photograph(mug, {title: (R_est, t_est)}, alt=alt)

# %% [markdown]
# ### AP: which of many, and how sure?
#
# A detector says several boxes with a score each. Go through them from the surest to the least
# sure. After each, **precision** is the share of correct ones so far, **recall** the share of all
# objects found. The staircase gives, for every recall, the best precision there or beyond, and
# **average precision** is the area under it. Here: five objects, seven estimates, correct if the
# IoU is above 0.5 and no surer estimate found the same object.

# %%
scores = np.array([0.95, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4])
overlaps = np.zeros((7, 5))
overlaps[[0, 1, 3, 5], [0, 1, 2, 3]] = [0.8, 0.7, 0.6, 0.55]
overlaps[4, 0] = 0.9  # object 0 once more
hit = metrics.match_by_overlap(overlaps, scores, 0.5)
precision, recall = np.cumsum(hit) / np.arange(1, 8), np.cumsum(hit) / 5

best_beyond = np.maximum.accumulate(precision[::-1])[::-1]
by_hand = (np.diff(recall, prepend=0) * best_beyond).sum()
assert np.isclose(by_hand, metrics.average_precision(scores, hit, 5))
chart.precision_recall(recall, precision, by_hand)

# %% [markdown]
# **What it does not say.** How good a correct pose is. AP at IoU 0.5 is a statement about finding;
# an estimate just above the threshold counts in full. Scores matter too: the same poses with
# shuffled scores have another AP.

# %% [markdown]
# ### All at once
#
# Five estimates of the mug. Which measure calls which of them correct? Each of the five is right by
# at least one measure and wrong by another.

# %%
cases = {
    "5 mm to the right": (R_gt, t_gt + [0.005, 0, 0]),
    "3 cm further away": away,
    "leans by 15°": turned(15, "x"),
    "turned by 30°": turned(30, "z"),
    "handle on the wrong side": turned(180, "z"),
}


# %%
def judge(R_est, t_est):
    """Whether each measure calls an estimate correct."""
    pose, gt = (R_est, t_est), (R_gt, t_gt)
    angle, shift = metrics.rotation_error(R_est, R_gt), metrics.translation_error(t_est, t_gt)
    box, true_box = ((R, R @ mug.centre + t, mug.size) for R, t in (pose, gt))
    return {
        "ADD < 0.1 d": metrics.add(*pose, *gt, points) < 0.1 * mug.diameter,
        "ADD-S < 0.1 d": metrics.add_s(*pose, *gt, points) < 0.1 * mug.diameter,
        "2D < 5 px": metrics.projection_2d(K, *pose, *gt, points) < 5,
        "5° 5 cm": metrics.within([angle], [shift], 5, 5)[0],
        "3D IoU > 0.5": metrics.oriented_iou_3d(*box, *true_box) > 0.5,
    }


# %%
verdicts = {name: judge(*pose) for name, pose in cases.items()}

assert all(any(row.values()) and not all(row.values()) for row in verdicts.values())
chart.scoreboard(verdicts)

# %% [markdown]
# | measure | what it sees | what it is blind to | use it when |
# |---|---|---|---|
# | rotation, translation error | each part by itself | the object's size and symmetry | always |
# | ADD | how far the surface moves | symmetry | the object has none |
# | ADD-S | how far off the surface is | handles and labels | the object is symmetric |
# | < 0.1 d | one share per object | all but one threshold; whose d | diameters are stated |
# | AUC to 0.1 m | all thresholds at once | the curve; the object's size | the curve is shown |
# | 2D projection | what an overlay shows | depth | it is drawn into the picture |
# | n° m cm | both parts at once | just how wrong; symmetry | a task has such tolerances |
# | MAE, RMSE | the average picture | rare angles | angles are evenly spread |
# | BMAE | rare angles too | how few pictures those are | angles are not |
# | 3D IoU | place and size together | front and back | sizes are unknown |
# | AP | missed and false finds | accuracy beyond the threshold | objects must be found first |

# %% [markdown]
# ## 6. Reading the papers closely
#
# Results are only as good as the measure behind them. Five traps from the papers of this book, each
# found by computing. Each begins with what was printed or published, in our words. The papers go by
# the short names of [the index](index.ipynb#The-papers).

# %% [markdown]
# ### ADD-S has a direction
#
# > CIPE, Eq 12, looks for the nearest *true* point of every *estimated* one. The code that the
# > benchmarks use goes the other way: for every true point, the nearest estimated one.
#
# On evenly spread points that hardly matters. But a model's vertices are dense where it is
# detailed. Take a bar of few points with a knob of many, and an estimate that is turned by 90
# degrees and has its knob on the middle of the true bar.

# %%
bar = np.linspace([-0.05, 0, 0], [0.05, 0, 0], 12)
knob = rng.normal([0.05, 0, 0], [0.005, 0.008, 0], (60, 3))
tool = np.concatenate([bar, knob])
estimate = rotations.axis_angle_to_matrix(np.radians([0, 0, 90])), np.array([0, -0.05, 0])
truth = upright, np.zeros(3)

official = metrics.add_s(*estimate, *truth, tool)
as_printed = metrics.add_s(*estimate, *truth, tool, "est_to_gt")
assert official > 2 * as_printed
print(f"official {1000 * official:.1f} mm, as printed {1000 * as_printed:.1f} mm")
chart.directions(tool, *estimate)

# %% [markdown]
# The book takes the official direction, ground truth to estimate, and offers the other.

# %% [markdown]
# ### The "3D IoU" of many tables is none
#
# > Where only an object's kind is known, its size is estimated too, and tables have columns of IoU:
# > those of CIPE and of the rotation-invariant paper, too. The evaluation code that was published
# > with NOCS, the data behind such tables, takes the smallest and the largest coordinate of each
# > *corner*, where it should take them over the corners.
#
# So every corner yields one interval, over x, y and z together, and the product of eight such
# lengths passes for a volume. That is short enough to be rebuilt here.


# %%
def legacy_by_hand(corners_1, corners_2):
    low = np.maximum(corners_1.min(axis=1), corners_2.min(axis=1))  # axis 0 was meant
    high = np.minimum(corners_1.max(axis=1), corners_2.max(axis=1))
    shared = 0.0 if (high < low).any() else np.prod(high - low)
    volumes = [np.prod(np.ptp(corners, axis=1)) for corners in (corners_1, corners_2)]
    return shared / (sum(volumes) - shared)


def cubes_apart(shift):
    """The two cubes' corners, and the library's legacy score, for a shift (3,)."""
    corners = metrics.box_corners(upright, one, cube)
    score = metrics.nocs_legacy_iou(upright, one, cube, upright, one + shift, cube)
    assert np.isclose(score, legacy_by_hand(corners, corners + shift))
    return score


# %% [markdown]
# Two cubes of 10 cm, 80 cm in front of the camera, pulled apart to the side and in depth:

# %%
shifts = np.linspace(0, 0.2, 41)
sideways = np.array([cubes_apart([shift, 0, 0]) for shift in shifts])
in_depth = np.array([cubes_apart([0, 0, shift]) for shift in shifts])
true = np.array([iou_by_hand(one, one + [shift, 0, 0], cube) for shift in shifts])

assert np.isclose(true[10], 1 / 3) and np.isclose(sideways[10], 0.885, atol=5e-4)  # 5 cm apart
assert true[-1] == 0 and np.isclose(in_depth[-1], 0.174, atol=5e-4)  # disjoint
assert np.allclose([cubes_apart([shift, 0, 0]) for shift in (0.1, 0.4, 0.7)], 0.778, atol=5e-4)
chart.boxes_apart(0.1, shifts, true, {"to the side": sideways, "in depth": in_depth}, [10, 30])

# %% [markdown]
# Half a cube to the side scores 0.885 instead of 0.333. Cubes that do not touch score 0.778, be
# they shifted by 10 or by 70 cm to the side, and still 0.174 at 20 cm in depth. Such tables cannot
# be compared with true overlaps. The library has both: `oriented_iou_3d`, and `nocs_legacy_iou` for
# old tables.

# %% [markdown]
# ### BMAE: 36 bins, 37 terms
#
# > The infrared paper, Eq 5, sums $\phi_{i,i+d}$ over $i \in d\mathbb N \cap [0, k]$ and divides by
# > $k / d$, with $d = 5$ and $k = 180$ degrees.
#
# Count: $i = 0, 5, \dots, 180$ are 37 values, divided by 36. A method that is wrong by 1 degree
# everywhere would get more than 1 degree. And what an empty bin adds is not said.

# %%
starts = np.arange(0, 180 + 1, 5)
as_printed = 5 / 180 * np.sum(np.ones(len(starts)))  # every bin's mean error is 1 degree

assert len(starts) == 37 and as_printed > 1.02
everywhere = np.radians(np.linspace(0, 179.9, 1000))
assert np.isclose(bmae(np.radians(np.ones(1000)), everywhere), np.radians(1))
print(f"as printed: {as_printed:.4f} degrees")

# %% [markdown]
# The book's reading: bins are half-open, empty ones are skipped, and the sum is divided by the
# number of bins in use. In the paper's Table 3 the average BMAE lies above the average MAE in every
# row. That fits: with all 36 bins in the divisor and most of them empty, it would lie far below.

# %% [markdown]
# ### Whose average?
#
# > The colour-refinement paper, Table 2, AUC of ADD-S on the 21 objects of YCB-Video. Its last row
# > says 91.8, 93.0, 93.1 and 93.2.

# %%
table_2 = """
 93.9 95.8 96.4 96.4  92.9 91.8 95.5 95.8  95.4 98.2 97.5 97.6  93.3 94.5 94.6 94.5
 95.4 98.4 97.2 97.4  94.9 97.1 96.6 97.1  94.0 97.9 96.5 96.0  97.6 98.8 98.1 98.0
 90.6 92.8 91.3 90.7  91.7 96.9 96.6 96.1  93.1 97.8 97.1 97.5  93.4 96.8 95.8 95.9
 92.9 78.3 88.2 89.5  96.1 95.1 97.1 96.7  93.3 98.0 96.0 96.1  87.6 90.5 89.7 92.8
 95.7 92.2 95.2 92.1  95.6 97.2 97.5 97.6  75.4 75.4 72.9 72.5  73.0 65.3 69.8 70.0
 94.2 97.1 92.5 92.0"""
means = np.array(table_2.split(), dtype=float).reshape(21, 4).mean(axis=0)
printed = {"Tien": 91.8, "PoseCNN+ICP": 93.0, "DenseFusion": 93.1, "the paper": 93.2}
for (method, last_row), mean in zip(printed.items(), means, strict=True):
    print(f"{method:12} printed {last_row}, mean of the rows {mean:.3f}")
assert 0 < means[3] - means[2] < 0.02

# %% [markdown]
# The mean of the rows differs from the printed one by up to 0.34, too much for rounding. Most
# likely the printed row averages over all *instances*, as the usual evaluation code does: an object
# that is in more pictures weighs more. Both means are sensible, and they answer different
# questions. But the gain of 0.1 over DenseFusion that the last row suggests is 0.01 if every object
# counts the same.
#
# > CIPE, Table II, gives PVNet a mean of 40.8 on Occlusion-LINEMOD.

# %%
in_cipe = np.array([15.8, 63.3, 16.7, 65.7, 46.9, 54.2, 75.8, 36.1])
elsewhere = np.array([15.81, 63.6, 16.68, 65.65, 25.24, 50.17, 49.62, 39.67])  # of PVNet, too
objects = ["ape", "can", "cat", "driller", "duck", "eggbox", "glue", "holepuncher"]

wrong = [o for o, a, b in zip(objects, in_cipe, elsewhere, strict=True) if abs(a - b) > 1]
assert np.isclose(in_cipe.mean(), 46.81, atol=0.005)
assert np.isclose(elsewhere.mean(), 40.805)
print(f"mean of the rows in CIPE: {in_cipe.mean():.1f}")
print(f"mean of the rows in the projection-loss paper: {elsewhere.mean():.1f}")
print("they differ by more than 1 for:", ", ".join(wrong))

# %% [markdown]
# The mean fits the rows that the other paper prints. So the mean is right and four of its rows were
# miscopied. Recomputing a mean costs one line.

# %% [markdown]
# ### Ground truth that is not quite a rotation
#
# > The published ground truth of Occlusion-LINEMOD, as it comes with the BOP toolkit's tests, has
# > rotation matrices with $|R R^\top - I|$ up to 0.0096 and determinants up to 1.014.
#
# A per cent, who cares? Take one and the same set of estimates, three or four degrees off, and
# three ways to the angle that agree for rotations. The trace is that of
#
# - $R_\text{est} R_\text{gt}^{-1}$,
# - $R_\text{est} R_\text{gt}^\top$,
# - the second, after projecting $R_\text{gt}$ to the nearest rotation.


# %%
def angle_of(M):
    return np.arccos(np.clip((np.trace(M, axis1=-2, axis2=-1) - 1) / 2, -1, 1))


def three_angles(R_est, R_gt):
    """Median angle by each of the formulas, radians."""
    nearest = rotations.special_procrustes(R_gt)
    return {
        "trace with the inverse": np.median(angle_of(R_est @ np.linalg.inv(R_gt))),
        "trace with the transpose": np.median(angle_of(R_est @ R_gt.mT)),  # .mT: of each matrix
        "projected first": np.median(metrics.rotation_error(R_est, nearest)),
    }


# %% [markdown]
# Scale the ground truth by up to half a per cent, and leave the estimates alone.

# %%
true_R = rotations.random_rotations(500, generator=rng)
estimates = true_R @ rotations.axis_angle_to_matrix(rng.normal(0, np.radians(2.2), (500, 3)))
scales = np.linspace(0.995, 1.005, 21)
curves = [three_angles(estimates, scale * true_R) for scale in scales]
angles = {formula: np.array([curve[formula] for curve in curves]) for formula in curves[0]}

agreed = np.array([*curves[10].values()])  # at scale 1
assert np.ptp(agreed) < 1e-6
assert np.ptp(angles["projected first"]) < 1e-6 < np.ptp(angles["trace with the inverse"])
chart.not_quite_rotations(scales - 1, angles, agreed[0])

# %% [markdown]
# Near zero a small angle hides in the trace as $3 - \theta^2$, so a change of the trace by 0.01 is
# an angle of 6 degrees. Half a per cent of scale is worth more than the whole error. On the real
# data the three medians are **6.36**, **2.64** and **3.53** degrees: MegaPose's estimates for the
# can of Occlusion-LINEMOD against that ground truth, both as published with the BOP toolkit's
# tests. Only the last is a rotation error. Where the real data is at hand, this cell computes them.

# %%
real = draw.real_results()
if real is None:
    print("no real data: POSECORE_DATA is not set")
else:
    medians = {formula: np.degrees(angle) for formula, angle in three_angles(*real).items()}
    assert np.allclose(list(medians.values()), [6.36, 2.64, 3.53], atol=0.005)
    print({formula: round(float(angle), 2) for formula, angle in medians.items()})

# %% [markdown]
# The library refuses to give an angle for what is not a rotation, and its readers project and say
# so.

# %%
from textwrap import fill

try:
    metrics.rotation_error(estimates, 1.005 * true_R)
    raise AssertionError("this must be refused")
except ValueError as error:
    print(fill(str(error), 88))

# %% [markdown]
# ## Exercises
#
# Six functions to write yourself, each with a check that answers in one line, and hints:
# [the exercises](exercises/exercises_01_poses_and_cameras.ipynb). Get your own copy, which no update touches,
# with
#
# ```
# python book/make.py start 01
# ```
#
# Solutions with explanations: [solutions](solutions/solutions_01_poses_and_cameras.ipynb).
#
# ## Summary
#
# - A pose takes points from the object's frame to the camera's:
#   $X_\text{cam} = R X_\text{obj} + t$. The columns of $R$ are the object's axes as the camera sees
#   them.
# - A camera divides by depth. Check every data set by projecting its models.
# - Eight pixels give a pose. Least squares believes wrong ones, RANSAC outvotes them.
# - Matched points give a pose in closed form; unmatched ones need ICP, and ICP needs a good start.
# - Every measure has a blind spot. Choose the one that sees what your task needs, print a second
#   one beside it, and recompute the means of tables.
#
# ## Further reading
#
# - Hartley and Zisserman, *Multiple View Geometry in Computer Vision*, 2004: cameras and PnP.
# - Umeyama, *Least-Squares Estimation of Transformation Parameters Between Two Point Patterns*,
#   1991: five pages, the determinant among them.
# - Besl and McKay, *A Method for Registration of 3-D Shapes*, 1992: ICP.
# - Fischler and Bolles, *Random Sample Consensus*, 1981: written for PnP.
# - Hinterstoisser et al., *Model Based Training, Detection and Pose Estimation of Texture-Less 3D
#   Objects in Heavily Cluttered Scenes*, 2012: ADD, ADD-S and LINEMOD.
# - Hodaň, Matas and Obdržálek, *On Evaluation of 6D Object Pose Estimation*, 2016: what is wrong
#   with them.
#
# Next, in [chapter 2](02_small_worlds.ipynb): how such a picture is drawn in the first place.
