# ---
# jupyter:
#   jupytext:
#     cell_metadata_filter: tags,-all
#     formats: ipynb,py:percent
#     notebook_metadata_filter: jupytext,-jupytext.text_representation,-kernelspec
# ---

# %% [markdown]
# # Exercises: small worlds
#
# Seven functions for you to write, from a warm-up to an open question.
# They need NumPy, and what [chapter 2](../02_small_worlds.ipynb) explains.

# %% [markdown] tags=["solution"]
# **This is the teacher's edition, with the solutions.**
# The students' one is made from it: `python book/make.py start 02` puts it into `book/my_work/`.

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
from dataclasses import replace

import cv2
import numpy as np

from book.ch02_small_worlds import checks
from book.tools.checks import use
from book.tools.syntax import forgive_syntax
from data_tools import renderer, sensors, shapes
from posecore import cameras, figures, poses, rotations
from posecore.figures.style import COLOURS

forgive_syntax()  # a cell that is no Python says so, and the page goes on
rng = np.random.default_rng(0)

# %% [markdown]
# **The scene.** A duck, a can and a car stand on a table. The picture has 160 x 120 pixels. Depth
# is z in the camera's frame, in metres, and 0 where there is nothing.

# %%
size = width, height = 160, 120
K = np.array([[190.0, 0, 79.5], [0, 190, 59.5], [0, 0, 1]])
table = rotations.axis_angle_to_matrix(np.deg2rad([115.0, 0, 0])), np.array([0, 0.03, 0.42])
objects, placed = [], []
for number, x, y, turn in ((1, -0.05, 0.0, 230), (2, 0.02, 0.07, 0), (6, 0.06, -0.03, 35)):
    mesh = shapes.make_object(number)
    objects.append(renderer.prepare(mesh))
    upright = rotations.axis_angle_to_matrix(np.deg2rad([0.0, 0, turn]))
    placed.append(poses.compose(*table, upright, np.array([x, y, -mesh.bounds[0, 2]])))
names = [item.mesh.name for item in objects]
lamp = renderer.Light(position=[-0.4, -0.6, 0.0], power=0.5)
linear = renderer.render_colour(objects, placed, K, size, [lamp], background=0.3)
photo = np.round(255 * sensors.linear_to_srgb(linear)).astype(np.uint8)
labels = renderer.render_labels(objects, placed, K, size)
alt = "A yellow duck, a can behind it and a toy car before it on the right, on plain grey"
figures.picture(photo, width=4, alt=alt)

# %% [markdown]
# ## 1. Warm-up: the edge function
#
# Walk from $a$ to $b$. Is the point $p$ to your left? The sign of the edge function tells:
#
# $$E_{ab}(p) = (b_y - a_y)(p_x - a_x) - (b_x - a_x)(p_y - a_y)$$
#
# Its size is twice the area of the triangle $a, b, p$.
#
# | in | shape | |
# |---|---|---|
# | `a`, `b` | (2,), (2,) | ends of the edge, (x, y) in pixels |
# | `points` | (N, 2) | (x, y) in pixels; N may be 0 |
# | **out** | (N,) | positive to the left, 0 on the line, negative to the right; px² |
#
# Left is meant as you see it on the screen. There y runs *down*, and that is why a formula from
# a textbook may give you the other sign.
#
# Two ends may be the same point: then the edge has no sides, and every point gets 0.
#
# The picture shows what is expected: for each pixel a number, which changes evenly and is 0 on the
# line.

# %%
a, b = np.array([3.0, 15]), np.array([27.0, 5])
grid = np.stack(np.meshgrid(np.arange(32), np.arange(20)), axis=-1).astype(float)
E = checks.edge_function(a, b, grid.reshape(-1, 2)).reshape(20, 32)
alt = "An edge from lower left to upper right; values are positive above it and negative below"
figure = figures.picture(E, colour_bar="E, px²", width=5.2, alt=alt)
figure.set_size_inches(6.2, 3.8)
axes = figure.axes[0]
axes.axline(a, b, color="white", linestyle="--")
axes.annotate("", b, a, arrowprops={"width": 2, "color": "white"})
for text, place in (("a", a + [0, 1.6]), ("b", b + [0, 1.6]), ("+", (10, 4)), ("−", (22, 15))):
    box = {"facecolor": "white", "edgecolor": "none", "boxstyle": "round"}
    axes.text(*place, text, ha="center", va="center", bbox=box)
axes.set_axis_on()
axes.set(xlabel="x, px", ylabel="y, px")
figure


# %%
def edge_function(a, b, points):
    """Twice the signed area (N,) of the triangles a, b, p; positive left of the way to b.

    >>> edge_function(np.array([0, 0]), np.array([4, 0]), np.array([[1, -2], [2, 0], [9, 1]]))
    array([ 8,  0, -4])
    """
    ### BEGIN SOLUTION
    along, there = b - a, points - a
    return along[1] * there[:, 0] - along[0] * there[:, 1]
    ### END SOLUTION


# %%
answer = checks.check_edge_function(edge_function)
edge_function_here = use(answer, checks.edge_function)
answer

# %% [markdown]
# Three edges make a triangle. Divided by the whole triangle's value, they are the weights of the
# three corners: the barycentric coordinates. A pixel is inside where none of them is negative.


# %%
def barycentric(corners, points):
    """Weights (N, 3) of the corners (3, 2) at the points (N, 2)."""
    a, b, c = corners
    opposite = ((b, c), (c, a), (a, b))
    values = [edge_function_here(start, end, points) for start, end in opposite]
    return np.stack(values, axis=-1) / edge_function_here(a, b, c[None])


corners = np.array([[3.0, 16], [28, 13], [12, 2]])
weights = barycentric(corners, grid.reshape(-1, 2))
inside = (weights >= 0).all(1).reshape(20, 32)
assert np.allclose(weights @ corners, grid.reshape(-1, 2))
assert np.allclose(weights.sum(1), 1)
area = edge_function_here(*corners[:2], corners[2:])[0] / 2
print(f"{inside.sum()} pixels inside, area {area:.1f} px²")

# %% [markdown] tags=["solution"]
# **Discussion.** Nothing is divided, so a triangle without an area does no harm here: all its edge
# functions are 0 on the line that it is. A renderer has to leave it out by itself, for the rule
# "none is negative" would draw that whole line, and the weights would be 0 / 0.

# %% [markdown]
# ## 2. What lies between the corners
#
# The corners of a triangle have values: colours, normals, coordinates in a texture. What is the
# value at a pixel inside? In space it changes evenly along the triangle. But a camera makes the
# far part of the triangle smaller. So the weights in the image, the barycentric coordinates
# $\beta_i$, must first be divided by the depths. For a value $s$:
#
# $$s = \frac{\sum_i \beta_i \, s_i / z_i}{\sum_i \beta_i / z_i}$$
#
# | in | shape | |
# |---|---|---|
# | `weights` | (N, 3) | $\beta$ of N pixels, so weights *in the image*; each row sums to 1 |
# | `depths` | (3,) | z of the corners, above 0; metres |
# | `values` | (3, C) | C numbers at each corner, of any sign |
# | **out** | (N, C) | C numbers at each pixel |
#
# The picture shows a floor of 6 x 6 tiles, made of two triangles. On the left the values were
# interpolated with the weights alone, on the right as is expected of you.

# %%
floor = np.array([[-1.0, 0.6, 1.2], [1, 0.6, 1.2], [1, 0.6, 5], [-1, 0.6, 5]])
texture = np.array([[0.0, 0], [6, 0], [6, 6], [0, 6]])  # in tiles
every_pixel = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).reshape(-1, 2)


def tiles(interpolate):
    """The floor (H, W), its tiles light and dark."""
    image = np.full(height * width, 255, np.uint8)
    for corners in ([0, 1, 2], [0, 2, 3]):
        weights = barycentric(cameras.project(K, floor[corners]), every_pixel.astype(float))
        inside = (weights >= 0).all(1)
        u, v = interpolate(weights[inside], floor[corners, 2], texture[corners]).T
        image[inside] = np.where((np.floor(u) + np.floor(v)) % 2 == 0, 90, 190)
    return image.reshape(height, width)[75:]


flat = tiles(lambda weights, depths, values: weights @ values)
alt = "Left a chequered floor with a kink along its diagonal, right one that looks like a floor"
titles = ["weights alone", "expected"]
figures.picture_grid([flat, tiles(checks.interpolate)], titles, width=6.4, alt=alt)


# %%
def interpolate(weights, depths, values):
    """The values (N, C) on the triangle in space, at pixels with these weights (N, 3).

    >>> halfway = np.array([[0.5, 0.5, 0.0]])
    >>> interpolate(halfway, np.array([1.0, 3.0, 3.0]), np.array([[0.0], [1.0], [1.0]]))
    array([[0.25]])
    """
    ### BEGIN SOLUTION
    shares = weights / depths
    shares = shares / shares.sum(1, keepdims=True)
    return shares @ values
    ### END SOLUTION


# %%
answer = checks.check_interpolate(interpolate)
interpolate_here = use(answer, checks.interpolate)
answer

# %% [markdown]
# Take the corners' points in space as values. Then every pixel gets its own point, and projecting
# that point must lead back to the pixel. With the weights alone it would land elsewhere:

# %%
X = floor[:3]
pixels = rng.dirichlet(np.ones(3), size=1000) @ cameras.project(K, X)
weights = barycentric(cameras.project(K, X), pixels)
points = interpolate_here(weights, X[:, 2], X)
off = np.abs(cameras.project(K, points) - pixels).max()
alone = np.abs(cameras.project(K, weights @ X) - pixels).max()
print(f"farthest off: {off:.0e} px, with the weights alone {alone:.0f} px")
assert off < 1e-9 < 1 < alone

# %% [markdown] tags=["solution"]
# **Discussion.** On a plane, 1/z is an affine function of the pixel (linear, up to a constant), and
# so is s/z for all s that are affine on the plane. That is why both may be interpolated in the
# image. The depth itself is the case s = z: the formula then says z = 1 / Σ(β/z), the harmonic
# mean. Some game consoles of the 1990s used the weights alone, and their floors bent.

# %% [markdown]
# ## 3. The z-buffer
#
# Draw each object alone into a depth image, a layer. (Nothing is 0 here, as in files, and not
# infinite as in the chapter.) What does the camera see of all of them? At
# each pixel the nearest.
#
# | in | shape | |
# |---|---|---|
# | `layers` | (N, H, W) | depth of each object; metres, 0 where it is not |
# | **out** | (H, W) | `depth` of what is seen, 0 where there is nothing |
# | | (H, W) | `instance`: whole numbers, which layer is seen, -1 where there is nothing |
#
# - Of two layers equally far, the first is seen.
# - There may be no layers at all: N = 0. Then there is nothing anywhere.
# - Leave `layers` as they are; the caller needs them.
#
# The picture shows three layers and, last, what is expected.

# %%
alone = [
    renderer.render_labels([item], [pose], K, size).depth
    for item, pose in zip(objects, placed, strict=True)
]
layers = np.stack(alone).astype(float)
depth, instance = checks.merge_layers(layers)
shown = np.where([*layers, depth], [*layers, depth], np.nan)
alt = "Depth of a duck, a can and a car alone; merged, the duck hides a part of the can"
figure = figures.picture_grid(shown, [*names, "expected"], columns=2, colour_bar="z, m", alt=alt)
for number in range(3):
    figures.draw_outline(figure.axes[3], instance == number)
figure


# %%
def merge_layers(layers):
    """What is seen of N layers (N, H, W): its depth (H, W), and which layer it is (H, W).

    >>> merge_layers(np.array([[[2.0, 2.0, 0.0]], [[1.0, 2.0, 0.0]]]))
    (array([[1., 2., 0.]]), array([[ 1,  0, -1]]))
    """
    ### BEGIN SOLUTION
    depth = np.zeros(layers.shape[1:])
    instance = np.full(layers.shape[1:], -1)
    for number, layer in enumerate(layers):
        nearer = (layer > 0) & ((instance < 0) | (layer < depth))
        depth[nearer] = layer[nearer]
        instance[nearer] = number
    return depth, instance
    ### END SOLUTION


# %%
answer = checks.check_merge_layers(merge_layers)
merge_layers_here = use(answer, checks.merge_layers)
answer

# %% [markdown]
# The library draws all objects together. It must see the same:

# %%
depth, instance = merge_layers_here(layers)
assert np.array_equal(instance, labels.instance)
assert np.allclose(depth, labels.depth)
print({name: int((instance == number).sum()) for number, name in enumerate(names)}, "pixels seen")

# %% [markdown] tags=["solution"]
# **Discussion.** "Nothing" is as far away as can be, but 0 is the smallest number; that is the
# trap of every depth image. The library keeps 1/z instead, where nothing is 0 and the nearest is
# the largest: one `np.maximum`, without a special case.

# %% [markdown]
# ## 4. Cut at the near plane
#
# A wall beside the camera reaches behind it. A corner behind the camera has no pixel (chapter 1),
# so the triangle must be cut before it is projected: keep the part at $z \ge n$, the near plane.
#
# Where an edge from $P$ to $Q$ crosses the plane, there is a new corner:
#
# $$P + s\,(Q - P) \qquad s = \frac{n - P_z}{Q_z - P_z}$$
#
# | in | shape | |
# |---|---|---|
# | `triangle` | (3, 3) | corners, one a row, in the camera's frame; metres |
# | `near` | a number | $n$, the depth of the plane; metres |
# | **out** | (M, 3) | corners of what is left, in order; M is 0, 3 or 4 |
#
# - Keep the order in which the triangle runs; begin with any corner. The order says which side is
#   the outer one.
# - A corner on the plane stays where it is, and no corner comes twice.
# - If only a corner or an edge touches the plane from behind, nothing is left: shape (0, 3).
# - A triangle that lies in the plane stays whole.
#
# The picture shows what is expected in four cases, from the side. The black arrow is the camera.

# %%
cases = {
    "one corner in front": [[0.0, 0, -0.6], [0, -1, 1.6], [0, 1, -0.2]],
    "two corners in front": [[0.0, 0, -0.8], [0, -1, 1.6], [0, 1, 1.0]],
    "one on the plane": [[0.0, 0.9, 0.4], [0, -0.9, 1.7], [0, -0.6, -0.8]],
    "touches from behind": [[0.0, -0.2, 0.4], [0, -1, -0.8], [0, 1, -0.5]],
}
figure = figures.Picture(figsize=(8, 2.9), layout="constrained")
figure.alt = "Four triangles cut by an upright plane: of them 3, 4, 3 and 0 corners are left"
for axes, (title, triangle) in zip(figure.subplots(1, 4, sharey=True), cases.items(), strict=True):
    left = checks.clip_near(np.array(triangle), 0.4)
    axes.fill(*np.array(triangle)[:, [2, 1]].T, fill=False, linestyle=":")
    axes.fill(*left[:, [2, 1]].T, facecolor=COLOURS[5], edgecolor="black", linewidth=2)
    for number, (_, y, z) in enumerate(left):
        axes.text(z, y, f" {number}", fontsize=11, fontweight="bold")
    axes.axvline(0.4, color=COLOURS[1], linestyle="--")
    axes.plot(0, 0, "k>", markersize=9)
    axes.set(title=f"{title}: {len(left)}", xlabel="z, m", xlim=(-1, 2), ylim=(1.3, -1.3))
    axes.title.set_fontsize(9)
figure.axes[0].set_ylabel("y, m")
figure


# %%
def clip_near(triangle, near):
    """The corners (M, 3), in order, of the part of a triangle (3, 3) that is at z >= near.

    >>> clip_near(np.array([[0.0, 0.0, 2.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]]), 1.0)
    array([[0., 0., 2.],
           [2., 0., 1.],
           [0., 2., 1.]])
    """
    ### BEGIN SOLUTION
    z = triangle[:, 2]
    if (z <= near).all() and (z < near).any():
        return np.zeros((0, 3))
    corners = []
    for P, Q in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
        if P[2] >= near:
            corners.append(P)
        if min(P[2], Q[2]) < near < max(P[2], Q[2]):  # it really crosses
            s = (near - P[2]) / (Q[2] - P[2])
            corners.append(P + s * (Q - P))
    return np.array(corners)
    ### END SOLUTION


# %%
answer = checks.check_clip_near(clip_near)
clip_near_here = use(answer, checks.clip_near)
answer

# %% [markdown]
# The floor of exercise 2, made larger so that the camera stands on it. Each tile is two triangles.
# Projected without cutting, those behind the camera appear in the sky, upside down; those that
# cross its plane go everywhere.

# %%
places = [(x, z) for x in range(-4, 4) for z in range(-2, 8)]
square = np.array([[0.0, 0.6, 0], [1, 0.6, 0], [1, 0.6, 1], [0, 0.6, 1]])
figure = figures.picture_grid(np.full((2, height, width), 255, np.uint8), ["not cut", "cut"])
figure.alt = "Left a chequered floor with tiles in the sky; right a floor that ends at the horizon"
for x, z in places:
    for corners in (square[[0, 1, 2]], square[[0, 2, 3]]):
        whole = corners + [x - 0.5, 0, z - 0.5]
        for axes, part in zip(figure.axes, (whole, clip_near_here(whole, 0.01)), strict=True):
            if len(part):
                u, v = (part[:, :2] / part[:, 2:] * 190 + [79.5, 59.5]).T
                axes.fill(u, v, color="0.35" if (x + z) % 2 else "0.75", linewidth=0.5)
figure

# %%
cut = [clip_near_here(square[[0, 1, 2]] + [x - 0.5, 0, z - 0.5], 0.01) for x, z in places]
assert {len(part) for part in cut} <= {0, 3, 4}
assert min(part[:, 2].min() for part in cut if len(part)) >= 0.01 - 1e-12

# %% [markdown] tags=["solution"]
# **Discussion.** A renderer draws triangles, so four corners become two of them: 0, 1, 2 and 0,
# 2, 3. The cut is made in space, before the division by z. Cut points of an edge that two
# triangles share should be the same to the last bit, or the seam shows; so the library computes
# them the same way from both sides, beginning at the corner in front. Ours begins where the walk
# comes from.

# %% [markdown]
# ## 5. How much of it is seen?
#
# A method that finds a duck of which 5 % is seen has done more than one that finds a whole duck. So
# datasets state for each object the *visible fraction*: how many pixels of its whole
# silhouette the camera sees.
#
# The whole silhouette includes what lies outside the image. So each object is drawn alone on a
# canvas that is `margin` pixels larger on all four sides.
#
# | in | shape | |
# |---|---|---|
# | `layers` | (N, h, w) | depth of each object alone on the canvas; metres, 0 where it is not |
# | `margin` | an integer | of the canvas around the image, pixels; may be 0 |
# | **out** | (N,) | share of each silhouette that the camera sees, 0 to 1 |
#
# - Nearer objects hide farther ones; of two equally far the first is seen. Exercise 3's
#   `merge_layers_here` settles that.
# - What lies outside the image is not seen, though nothing hides it.
# - An object of no pixel, perhaps too far away, has the fraction 0.
#
# The picture shows what is expected. The frame is the image: dark is what the camera sees, pale
# what it does not.

# %%
margin = 60
moved = [(R, t + [0.07, -0.05, -0.02]) for R, t in placed]
canvas_K = cameras.crop_intrinsics(K, -margin, -margin)
canvas_size = width + 2 * margin, height + 2 * margin
canvas = np.stack(
    [
        renderer.render_labels([item], [pose], canvas_K, canvas_size).depth
        for item, pose in zip(objects, moved, strict=True)
    ]
)
fractions = checks.visible_fraction(canvas, margin)

# %%
inner = np.zeros(canvas.shape[1:], bool)
inner[margin:-margin, margin:-margin] = True
nearest = checks.merge_layers(canvas)[1]
images = [
    np.select([(nearest == k) & inner, canvas[k] > 0, inner], [20, 190, 255], 235).astype(np.uint8)
    for k in range(3)
]
titles = [f"{name}: {share:.0%}" for name, share in zip(names, fractions, strict=True)]
alt = "Silhouettes, dark where seen: most of the duck, half of the can, the left part of the car"
figure = figures.picture_grid(images, titles, alt=alt)
for axes in figure.axes:
    left, right, low = margin - 0.5, margin + width - 0.5, margin + height - 0.5
    axes.plot([left, right, right, left, left], [left, left, low, low, left], "k-", linewidth=1)
figure


# %%
def visible_fraction(layers, margin):
    """The share (N,) that the camera sees of each object's whole silhouette.

    >>> visible_fraction(np.array([[[2.0, 2.0, 2.0, 2.0]], [[0.0, 0.0, 1.0, 0.0]]]), 0)
    array([0.75, 1.  ])
    """
    ### BEGIN SOLUTION
    height, width = layers.shape[1:]
    image = layers[:, margin : height - margin, margin : width - margin]
    _, instance = merge_layers_here(image)
    seen = np.array([(instance == number).sum() for number in range(len(layers))])
    whole = (layers > 0).sum((1, 2))
    return seen / np.maximum(whole, 1)
    ### END SOLUTION


# %%
answer = checks.check_visible_fraction(visible_fraction)
visible_fraction_here = use(answer, checks.visible_fraction)
answer

# %% [markdown]
# The library says the same. If one counted only what is inside the image, the car would seem
# hardly hidden:

# %%
labels_moved = renderer.render_labels(objects, moved, K, size)
fractions = visible_fraction_here(canvas, margin)
inside_only = visible_fraction_here(canvas[:, margin:-margin, margin:-margin], 0)
for name, share, other in zip(names, fractions, inside_only, strict=True):
    print(f"{name:5s} {share:6.1%} visible, {other:6.1%} of what is in the image")
assert np.allclose(fractions, labels_moved.visible_fraction, atol=0.002)

# %% [markdown] tags=["solution"]
# **Discussion.** `layers[:, margin:-margin]` is empty for a margin of 0, since -0 is 0. The BOP
# benchmark (Hodaň et al., 2018) defines its `visib_fract` in the same way. But real scenes have no
# layers: who is seen is decided with the measured depth image, and some millimetres of tolerance.

# %% [markdown]
# ## 6. Turn the picture, keep the pose right
#
# Training images are few. So one turns, cuts and scales those that one has. The labels
# must follow *exactly*, or the network learns the error.
#
# Turn everything before the camera by `angle` about the optical axis, from +x towards +y. (Or the
# camera, the other way. It is the same.) On the screen everything then turns clockwise about the
# principal point. `K` stays as it is. Find the new pose of the object, and the map $A$ that takes
# every old pixel $(x, y, 1)$ to its new place:
#
# $$K\,(R_{new}\,X + t_{new}) \sim A\,K\,(R\,X + t) \quad \text{for all } X$$
#
# Here $\sim$ means: the same up to a factor, the depth.
#
# | in | shape | |
# |---|---|---|
# | `R`, `t` | (3, 3), (3,) | pose of the object; metres |
# | `K` | (3, 3) | camera matrix; fx and fy may differ |
# | `angle` | a number | radians |
# | **out** | (3, 3), (3,) | pose of the object in the turned picture |
# | | (3, 3) | $A$, with a last row of 0 0 1 |
#
# The picture shows what is expected for 25 degrees.

# %%
pose, grey = placed[2], photo[0, 0].tolist()


def before_and_after(turn_picture):
    """The photograph and the turned one, with the axes of the car's pose."""
    R_new, t_new, A = turn_picture(*pose, K, np.deg2rad(25))
    turned = cv2.warpAffine(photo, A[:2], size, borderValue=grey)
    alt = "The scene and the same turned clockwise by 25 degrees; the car's axes turn with it"
    figure = figures.picture_grid([photo, turned], ["before", "after 25 degrees"], alt=alt)
    figures.draw_axes(figure.axes[0], K, *pose, length=0.07)
    figures.draw_axes(figure.axes[1], K, R_new, t_new, length=0.07)
    return figure


before_and_after(checks.turn_picture)


# %%
def turn_picture(R, t, K, angle):
    """The pose (R, t) in the turned picture, and the map (3, 3) from old pixels to new ones.

    >>> R_new, t_new, A = turn_picture(np.eye(3), np.array([0.1, 0, 1]), K, np.pi / 2)
    >>> t_new.round(3), (A @ [79.5 + 19, 59.5, 1]).round(3)
    (array([0. , 0.1, 1. ]), array([79.5, 78.5,  1. ]))
    """
    ### BEGIN SOLUTION
    cosine, sine = np.cos(angle), np.sin(angle)
    Z = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    return Z @ R, Z @ t, K @ Z @ np.linalg.inv(K)
    ### END SOLUTION


# %%
answer = checks.check_turn_picture(turn_picture)
turn_picture_here = use(answer, checks.turn_picture)
answer

# %% [markdown]
# Cutting and scaling work the other way: the pose stays, and the camera matrix changes. Both
# together: turn, cut a box out, and enlarge it to 256 x 256. Every point of the car still lands
# on its pixel.
# As the centre of the first pixel is at (0, 0) and not its corner, a zoom $k$ takes $x$ to
# $k\,(x + \frac12) - \frac12$.

# %%
R_new, t_new, A = turn_picture_here(*pose, K, np.deg2rad(25))
car = objects[2].mesh.vertices
box = np.array([70, 35, 64, 64])  # first column and row, width, height
crop_K = cameras.crop_and_resize_intrinsics(K, box, (256, 256))
old = cameras.project(K, poses.apply(*pose, car))
turned = old @ A[:2, :2].T + A[:2, 2]
new = (turned - box[:2] + 0.5) * 256 / 64 - 0.5
off = np.abs(cameras.project(crop_K, poses.apply(R_new, t_new, car)) - new).max()
print(f"farthest off: {off:.0e} px")
assert off < 1e-9

# %%
scale_and_cut = crop_K @ np.linalg.inv(K) @ A
crop = cv2.warpAffine(photo, scale_and_cut[:2], (256, 256), borderValue=grey)
alt = "The car, cut out of the turned picture and enlarged, with its axes"
figure = figures.picture(crop, width=3.6, alt=alt)
figures.draw_axes(figure.axes[0], crop_K, R_new, t_new, length=0.07)
figure

# %% [markdown] tags=["solution"]
# **Discussion.** A turn about the *middle of the image* is another thing if the principal point is
# elsewhere: to the exact labels of that picture belongs another K. With fx and fy different, A is
# no turn of the pixels at all, but a turn between two stretches. A move of the picture, finally,
# may go into K, as here, but not into t: an object that moves sideways shows another side.

# %% [markdown]
# ## 7. Open: undo the lamp
#
# An infrared camera has a lamp, here at its own centre. A matt surface of albedo $\rho$ that is at
# the point $X$ and has the unit normal $n$ then has the brightness
#
# $$L = \rho\,\frac{\Phi}{r^2}\,\max(0,\; n \cdot l) \qquad r = |X| \qquad l = -X / r$$
#
# So near things are bright and far ones dark, whatever they are made of. With a depth image one
# can undo that and recover the albedo. But not everywhere: which pixels do not tell it?
#
# | in | shape | |
# |---|---|---|
# | `brightness` | (H, W) | $L$ as the camera measured it, 0 to 1; what is brighter is 1 too |
# | `depth` | (H, W) | z, not the distance; metres, 0 where it is not known |
# | `normals` | (H, W, 3) | unit normals in the camera's frame, 0 where the depth is |
# | `K` | (3, 3) | camera matrix |
# | `power` | a number | $\Phi$, the brightness of white that faces the lamp at 1 m |
# | `noise` | a number | standard deviation of the noise in `brightness` |
# | **out** | (H, W) | albedo, or `nan` where it cannot be recovered |
#
# Decide for yourself where to say `nan`. The check refuses numbers that nobody can know, or that
# noise could change by 0.3 and more, and it refuses a `nan` where noise is below 0.03. Between
# the two, the choice is yours.
#
# The picture shows the same scene by the lamp, what is expected (pale: not recovered), and the
# truth.

# %%
power, noise = 0.09, 0.006
wall = renderer.prepare(shapes.make_floor(0, 8.0))
room = [*objects, wall, wall]
stands = [*placed, table, (np.diag([1.0, -1, -1]), np.array([0, 0, 0.8]))]
light = renderer.Light(position=np.zeros(3), power=power, shadows=False)
by_lamp = renderer.render_infrared(room, stands, K, size, [light], ambient=0)
sensor = {"shot_noise": 0, "read_noise": noise, "column_noise": 0, "blur": 0}
brightness = sensors.infrared_sensor(by_lamp, rng, **sensor) / 255

# %%
# In light of brightness 1 from all around, matt things are as bright as their albedo.
matt = []
for item in room:
    materials = tuple(replace(material, specular=0.0) for material in item.mesh.materials)
    matt.append(renderer.prepare(replace(item.mesh, materials=materials)))
truth = renderer.render_infrared(matt, stands, K, size, [], ambient=1, samples=1)
room_labels = renderer.render_labels(room, stands, K, size)
depth = sensors.depth_sensor(room_labels.depth, K, rng, disparity_noise=0.02, disparity_step=0)
normals = room_labels.normals * (depth > 0)[..., None]
scene = brightness, depth.astype(float), normals.astype(float), K, power, noise

# %%
shown = [brightness, checks.recover_albedo(*scene), truth]
titles = ["brightness", "albedo, expected", "true albedo"]
alt = "A scene that is bright in front and dark behind; its albedo, with gaps; the true albedo"
figures.picture_grid(shown, titles, limits=(0, 1), alt=alt)


# %%
def recover_albedo(brightness, depth, normals, K, power, noise):
    """The albedo (H, W) of what a camera with a lamp at its centre sees, NaN where unknown.

    >>> facing = np.array([[[0.0, 0.0, -1.0]]])
    >>> recover_albedo(np.array([[0.4]]), np.array([[0.5]]), facing, np.eye(3), 0.25, 0.01)
    array([[0.4]])
    """
    ### BEGIN SOLUTION
    X = cameras.back_project(depth, K)
    r = np.linalg.norm(X, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = -(normals * X).sum(-1) / r
        factor = r**2 / (power * cosine)
    known = (depth > 0) & (cosine > 0) & (brightness < 1) & (noise * factor < 0.1)
    return np.where(known, brightness * factor, np.nan)
    ### END SOLUTION


# %%
answer = checks.check_recover_albedo(recover_albedo)
recover_albedo_here = use(answer, checks.recover_albedo)
answer

# %% [markdown]
# How far is it off? The formula knows nothing of highlights, which shiny things have:

# %%
albedo = recover_albedo_here(*scene)
error = np.abs(albedo - truth)
for number, name in enumerate([*names, "table", "wall"]):
    seen = room_labels.instance == number
    known = seen & ~np.isnan(albedo)
    print(f"{name:5s} {known.sum() / seen.sum():4.0%} recovered", end="")
    print(f", median error {np.median(error[known]):.3f}" if known.any() else "")
assert np.nanmedian(error) < 0.05

# %%
alt = "Error of the albedo: small on matt surfaces, large in highlights and far away"
figures.picture(error, colour_bar="error of the albedo", limits=(0, 0.3), width=5, alt=alt)

# %% [markdown] tags=["solution"]
# **Discussion.** Unknown are white pixels (any larger albedo would look the same), holes of the
# depth, surfaces that look away, and those from which too little light comes: far, or grazing.
# The noise is multiplied by the same factor $r^2 / (\Phi\,n \cdot l)$ as the brightness, so this
# factor says how much an answer is worth. A lamp at the camera's centre throws no shadow that the
# camera could see. A lamp beside it does, and in a shadow nothing is known either. Highlights are
# the worst: they give a number, and a wrong one. At rims a pixel mixes two surfaces.
