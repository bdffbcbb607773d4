# ---
# jupyter:
#   jupytext:
#     cell_metadata_filter: tags,-all
#     formats: ipynb,py:percent
#     notebook_metadata_filter: jupytext,-jupytext.text_representation,-kernelspec
# ---

# %% [markdown]
# # Exercises: from an infrared picture to a point cloud
#
# Five functions for you to write, from a warm-up to an open question.
# They need NumPy and PyTorch, and what [chapter 3](../03_infrared_to_clouds.ipynb) explains.
#
# | | exercise | level | minutes |
# |---|---|---|---|
# | 1 | one step of Li's iteration | warm-up | 10 |
# | 2 | the silhouette of a cuboid | medium | 35 |
# | 3 | one point in a volume | medium | 20 |
# | 4 | the ray that stops | medium | 20 |
# | 5 | what silhouettes cannot tell | hard, open | 40 |

# %% [markdown] tags=["solution"]
# **This is the teacher's edition, with the solutions.**
# The students' one is made from it: `python book/make.py start 03` puts it into `book/my_work/`.

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
# Exercises 1, 2 and 5 use NumPy arrays, 3 and 4 torch tensors of `float64`.

# %%
import numpy as np
import torch
from scipy.spatial import ConvexHull

from book.ch03_infrared_to_clouds import checks
from book.ch03_infrared_to_clouds.drawing import exercises as draw
from book.tools.checks import use
from book.tools.syntax import forgive_syntax
from data_tools.shapes.faces import Proportions, head_shape
from data_tools.worlds import headset
from posecore import cameras, clouds, figures
from posecore.methods.infrared import masks
from posecore.splat import projector

forgive_syntax()  # a cell that is no Python says so, and the page goes on
torch.set_default_dtype(torch.float64)

# %% [markdown]
# **The scene.** A driver with AR glasses, seen by three infrared cameras at once. The pictures have
# 160 x 94 pixels. Pixels are (x, y), x to the right and y down; the centre of the first one is at
# (0, 0).

# %%
views = headset.draw(5, split="test", scale="book")
photos = {name: view.ir for name, view in zip(headset.CAMERAS, views, strict=True)}
left, centre, right = views
glasses = centre.objects[0]  # of its pose
width, height = size = centre.ir.shape[::-1]
alt = "A bald driver with glasses from the left, the centre and the right, bright before black"
figures.picture_grid(photos.values(), list(photos), alt=alt)

# %% [markdown]
# ## 1. Warm-up: one step of Li's iteration
#
# *Warm-up, 10 minutes.* What is near the lamp is bright, and the rest is dark. So a threshold tells
# the driver from the car. Li's method improves a threshold $\tau$ step by step. Let $m_0$ be the
# mean of all values at or below $\tau$, and $m_1$ the mean of those above. The next threshold is
#
# $$\tau' = \frac{m_1 - m_0}{\log m_1 - \log m_0}$$
#
# | in | shape | |
# |---|---|---|
# | `values` | any | brightness, at least 0; of any dtype, bytes too |
# | `threshold` | a number | $\tau$ |
# | **out** | a number | $\tau'$, a float |
#
# - What is equal to the threshold is on the dark side.
# - If one of the sides is empty, the threshold stays what it is.
# - If $m_0 = 0$, it has no logarithm. Take $10^{-12}\,m_1$ for every $m_0$ that is below this.
#
# The picture shows what is expected for the centre camera, at the first threshold: the mean of all.

# %%
mean = float(centre.ir.mean())
draw.brightness(centre.ir, mean, checks.li_update(centre.ir, mean))


# %%
def li_update(values, threshold):
    """The threshold that follows on another one.

    >>> round(li_update(np.array([[1, 3], [9, 11]]), 5.0), 3)
    4.971
    """
    ### BEGIN SOLUTION
    dark, bright = values[values <= threshold], values[values > threshold]
    if dark.size == 0 or bright.size == 0:
        return float(threshold)
    m0, m1 = dark.mean(dtype=float), bright.mean(dtype=float)
    m0 = max(m0, 1e-12 * m1)
    return float((m1 - m0) / (np.log(m1) - np.log(m0)))
    ### END SOLUTION


# %%
answer = checks.check_li_update(li_update)
li_update_here = use(answer, checks.li_update)
answer

# %% [markdown]
# Repeat it until it stays. (The library moves the darkest value to 0 first, so we do, too.)


# %%
def iterate(values, threshold):
    """All thresholds, from the first to the one that stays."""
    steps = [threshold]
    while len(steps) < 2 or abs(steps[-1] - steps[-2]) > 0.5:
        steps.append(li_update_here(values, steps[-1]))
    return steps


above_dark = centre.ir - float(centre.ir.min())
for start in (float(above_dark.mean()), 5.0, 200.0):
    print(*(f"{step:.1f}" for step in iterate(above_dark, start)), sep=" → ")
steps = iterate(above_dark, float(above_dark.mean()))
assert np.isclose(steps[-1] + centre.ir.min(), masks.li_threshold(centre.ir), atol=1e-6)

# %% [markdown]
# Another camera gives twice the signal (a *gain* of 2). Or sunlight adds 20 to every pixel. What
# becomes of the mask, if nothing is moved to 0 first?

# %%
half = centre.ir / 2.0
changed = {"as it is": half, "gain of 2": 2 * half, "20 brighter": half + 20}
for name, values in changed.items():
    threshold = iterate(values, float(values.mean()))[-1]
    print(f"{name:12s} threshold {threshold:5.1f}, mask of {(values > threshold).mean():.1%}")

# %% [markdown] tags=["solution"]
# **Discussion.** The threshold comes from cross-entropy: replace every dark pixel $g$ by $m_0$ and
# every bright one by $m_1$, and ask how much information that costs, $\sum g \log(g / m)$. Where
# the derivative by $\tau$ is 0, the next threshold and the last are the same.
#
# $\tau'$ is the *logarithmic mean* of $m_0$ and $m_1$. It lies below their midpoint, the more so the
# more the means differ. That suits a lamp: what is lit is spread over many values, what is
# not is spread over few.
#
# A gain multiplies both means and so the threshold: the mask stays. An offset does not: then
# the means are more alike, the logarithm is nearly straight, and the threshold goes up towards the
# midpoint. That is why the library (and scikit-image) moves the darkest value to 0. It helps only
# against light that is the same everywhere.
#
# All three starts end within half a level here. It need not be so: each end is a *local* minimum.

# %% [markdown]
# ## 2. The silhouette of a cuboid
#
# *Medium, 35 minutes.* The threshold alone takes the shirt for a head. So the paper looks only
# where a cuboid is seen that moves with the pose of the glasses. Which pixels are these?
#
# | in | shape | |
# |---|---|---|
# | `K` | (3, 3) | camera matrix; fx and fy may differ, and there may be skew |
# | `R`, `t` | (3, 3), (3,) | pose of the object, $X_{cam} = R\,X_{obj} + t$; metres |
# | `sides` | (3,) | lengths along the object's x, y and z; metres |
# | `centre` | (3,) | of the cuboid, in the object's frame; metres |
# | `size` | two integers | (width, height) of the image, pixels |
# | **out** | (height, width) | bool: where the cuboid covers the *centre* of the pixel |
#
# - Much of the cuboid may be outside the image, or all of it.
# - If one of its corners is not in front of the camera ($z \le 0$), raise a `ValueError`.
#
# The picture shows what is expected for the paper's cuboid in the three views.

# %%
sides, middle = np.array(masks.CUBOID), np.array(masks.CUBOID_CENTRE)
cuboids = {
    name: checks.cuboid_silhouette(v.K, v.objects[0].R, v.objects[0].t, sides, middle, size)
    for name, v in zip(photos, views, strict=True)
}
draw.outlines(list(photos.values()), cuboids)


# %%
def cuboid_silhouette(K, R, t, sides, centre, size):
    """(H, W) bool: the pixels whose centres a cuboid covers.

    >>> K = np.array([[10.0, 0, 2], [0, 10, 1], [0, 0, 1]])
    >>> sides = np.array([0.3, 0.1, 0.1])
    >>> cuboid_silhouette(K, np.eye(3), np.array([0, 0, 1.0]), sides, np.zeros(3), (5, 3)).astype(int)
    array([[0, 0, 0, 0, 0],
           [0, 1, 1, 1, 0],
           [0, 0, 0, 0, 0]])
    """
    ### BEGIN SOLUTION
    signs = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    X = (centre + signs * sides / 2) @ R.T + t
    if (X[:, 2] <= 0).any():
        raise ValueError("t: expected a cuboid in front of the camera")
    hull = ConvexHull((X @ K.T)[:, :2] / X[:, 2:])
    x, y = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    pixels = np.stack([x, y], -1)  # (H, W, 2)
    sides_of_edges = pixels @ hull.equations[:, :2].T + hull.equations[:, 2]
    return (sides_of_edges <= 0).all(-1)
    ### END SOLUTION


# %%
answer = checks.check_cuboid_silhouette(cuboid_silhouette)
cuboid_silhouette_here = use(answer, checks.cuboid_silhouette)
answer

# %% [markdown]
# Now the paper's masks can be made. How much of the true mask of head and glasses do they get? The
# overlap is intersection over union.


# %%
def overlap(one, other):
    """Intersection over union of two masks."""
    return (one & other).sum() / (one | other).sum()


found = {}
for name, view in zip(photos, views, strict=True):
    item, truth = view.objects[0], headset.foreground(view)
    box = cuboid_silhouette_here(view.K, item.R, item.t, sides, middle, size)
    everywhere = view.ir > masks.li_threshold(view.ir)
    found[name] = box & (view.ir > masks.li_threshold(np.where(box, view.ir, 0)))
    given = everywhere, box, found[name]
    print(f"{name:7s}", *(f"{overlap(mask, truth):.2f}" for mask in given))
    assert overlap(found[name], truth) > max(overlap(mask, truth) for mask in given[:2])
print("        threshold alone, cuboid alone, both")
draw.outlines(list(photos.values()), found)

# %% [markdown] tags=["solution"]
# **Discussion.** A camera sees a convex body as a convex region, and its outline is the hull of the
# projected corners: four to six of the eight. Faces need not be looked at.
#
# There is another way, without projecting anything. A pixel's ray is $s\,d$ with
# $d = K^{-1}(x, y, 1)$. Turn it into the cuboid's own frame. There, each pair of opposite faces
# leaves an interval of $s$, and the ray hits the cuboid if the three intervals have a part in
# common. This also works for a cuboid that reaches behind the camera. Renderers call it the *slab
# method*.
#
# A function that fills polygons (`cv2.fillConvexPoly`) will not do: it rounds the corners to whole
# pixels, and it paints all pixels that an edge touches.
#
# The masks miss what is dark, as the frame of the glasses, and take in what is bright and near:
# neck and collar. Note also what the paper uses here: the *true pose*. These masks cost no drawing
# by hand, but a label all the same.

# %% [markdown]
# ## 3. One point in a volume
#
# *Medium, 20 minutes.* Rays go through a volume of voxels, and the network says points. So each
# point is *splatted*: it is shared among the voxels around it. Along one axis, a point at $x$ gives
# to the voxel $i$ the share
#
# $$w_i(x) = \max(0,\; 1 - |x - i|)$$
#
# and a voxel of the volume gets the product of its shares along x, y and z. This is trilinear
# interpolation, the other way round.
#
# | in | shape | |
# |---|---|---|
# | `point` | (3,) | x, y, z in voxels; the centre of the first voxel is at (0, 0, 0) |
# | `size` | three integers | (W, H, D) of the volume |
# | **out** | (D, H, W) | the shares; all others are 0 |
#
# - What would go to voxels outside the volume is lost: a point at $x = -0.3$ gives 0.7 along x. A
#   point a whole voxel or more outside gives nothing.
# - A gradient must find its way from the volume back to `point`: that is what it is for. The check
#   looks at it.
#
# The picture shows what is expected for three points.

# %%
cases = {
    "(1.3, 0.6, 0.25)": [1.3, 0.6, 0.25],
    "(2, 1, 1)": [2.0, 1, 1],
    "(-0.4, 1, 0.5)": [-0.4, 1, 0.5],
}
draw.shares(
    {name: checks.splat_point(torch.tensor(p), (4, 3, 2)).numpy() for name, p in cases.items()}
)


# %%
def splat_point(point, size):
    """(D, H, W): the shares of one point (3,) in the voxels around it.

    >>> splat_point(torch.tensor([0.75, 0.0, 0.5]), (3, 1, 2))
    tensor([[[0.1250, 0.3750, 0.0000]],
    <BLANKLINE>
            [[0.1250, 0.3750, 0.0000]]])
    """
    ### BEGIN SOLUTION
    x, y, z = (
        (1 - (torch.arange(count) - value).abs()).clamp(min=0)
        for value, count in zip(point, size, strict=True)
    )
    return z[:, None, None] * y[:, None] * x
    ### END SOLUTION


# %%
answer = checks.check_splat_point(splat_point)
splat_point_here = use(answer, checks.splat_point)
answer

# %% [markdown]
# How far does a point feel? Let the voxel at $x = 10$ be wanted full: the loss is
# $(1 - \text{its share})^2$. Move a point along x and look at the gradient.

# %%
places = torch.linspace(7.025, 12.975, 120)
pulls = []
for place in places:
    point = torch.stack([place, torch.tensor(1.0), torch.tensor(1.0)]).requires_grad_()
    loss = (1 - splat_point_here(point, (20, 3, 3))[1, 1, 10]) ** 2
    pulls.append(float(torch.autograd.grad(loss, point)[0][0]))
pulls = np.array(pulls)
felt = np.abs(places.numpy()[np.abs(pulls) > 0] - 10).max()
print(f"felt from at most {felt:.2f} voxels away")
assert 0.9 < felt < 1
figures.chart(
    {"gradient": pulls},
    x=places.numpy(),
    upright={"_wanted": 10.0},
    xlabel="x of the point, voxels",
    ylabel="gradient of the loss by x",
    alt="The gradient is 0 up to x = 9, jumps to -2, rises straight to +2 at x = 11, and is 0 again",
)

# %% [markdown] tags=["solution"]
# **Discussion.** A loop over the eight corners is as good, if it takes care of three things: a
# corner outside is left out (`volume[-1]` is no error in Python, but the other end of the volume),
# no gradient is lost in `int(...)` or `.item()`, and a point exactly on the last voxel has no
# neighbour to the right.
#
# The gradient reaches one voxel and no further. A point that is two voxels away from a mask does
# not know that there is one. So the volume is *blurred* after the splat: with a wide blur at first,
# so that every point feels something, and a narrow one at the end, for sharp outlines.
#
# At the centre of a voxel the share has a kink, and the gradient jumps from one sign to the other.

# %% [markdown]
# ## 4. The ray that stops
#
# *Medium, 20 minutes.* Now look along the rays. Here each column of voxels `[:, y, x]` is a ray, and
# slice 0 is the nearest. The occupancy $o_i$ is the share of the light that voxel $i$ stops, from 0
# (empty) to 1 (opaque), and $c_i$ is its intensity. Then
#
# $$\text{silhouette} = 1 - \prod_i (1 - o_i) \qquad
# \text{picture} = \sum_i c_i\,o_i \prod_{j < i} (1 - o_j)$$
#
# | in | shape | |
# |---|---|---|
# | `occupancy` | (D, H, W) | $o_i$, 0 to 1; D may be 0 |
# | `intensity` | (D, H, W) | $c_i$ |
# | **out** | (H, W), (H, W) | silhouette and picture |
#
# - An occupancy of exactly 1 is no special case, and `nan` never comes out.
# - A voxel's own occupancy does not dim the voxel itself: $j < i$.
#
# The picture shows what is expected: a frame that is half transparent, before a bright plate.

# %%
occupancy, intensity = torch.zeros(2, 2, 24, 32)
occupancy[0, 4:20, 4:24], occupancy[0, 8:16, 8:20], intensity[0] = 0.5, 0.0, 0.2
occupancy[1, 10:22, 14:30], intensity[1] = 1.0, torch.linspace(0.4, 1, 32)
seen = checks.terminate(occupancy, intensity)
draw.slices(occupancy.numpy(), intensity.numpy(), *(image.numpy() for image in seen))


# %%
def terminate(occupancy, intensity):
    """Silhouette (H, W) and picture (H, W) of volumes (D, H, W), the nearest slice first.

    >>> occupancy, intensity = torch.tensor([[0.5], [1.0]]), torch.tensor([[0.2], [0.8]])
    >>> terminate(occupancy[:, None], intensity[:, None])
    (tensor([[1.]]), tensor([[0.5000]]))
    """
    ### BEGIN SOLUTION
    left = torch.ones(occupancy.shape[1:])
    picture = torch.zeros(occupancy.shape[1:])
    for o, c in zip(occupancy, intensity, strict=True):
        picture = picture + left * o * c
        left = left * (1 - o)
    return 1 - left, picture
    ### END SOLUTION


# %%
answer = checks.check_terminate(terminate)
terminate_here = use(answer, checks.terminate)
answer

# %% [markdown]
# Exercises 3 and 4 together are the projector. Take points on the true surface, with the brightness
# of their pixels, into a grid of 40 x 24 x 40 voxels:

# %%
truth = headset.foreground(centre)
surface = cameras.back_project(torch.from_numpy(centre.depth).double(), torch.from_numpy(centre.K))
some = torch.from_numpy(truth & (centre.depth > 0))
points, shades = surface[some], torch.from_numpy(centre.ir / 255.0)[some]
chosen = clouds.farthest_point_sampling(points, 350)
points, shades = points[chosen], shades[chosen]
grid = 40, 24, 40
K = torch.from_numpy(centre.K)
voxels = projector.to_voxels(points, K, size, grid, float(glasses.t[2]) + 0.1, 0.4)

# %%
held, light = torch.zeros(2, *grid[::-1])
for place, shade in zip(voxels, shades, strict=True):
    share = splat_point_here(place, grid)
    held, light = held + share, light + shade * share
occupancy = held.clamp(max=1)  # where points crowd, a voxel is full
intensity = light / held.clamp(min=1e-12)
silhouette, picture = terminate_here(occupancy, intensity)
theirs = projector.render(voxels, grid, intensities=shades)
off = max(float((a - b).abs().max()) for a, b in zip((silhouette, picture), theirs, strict=True))
print(f"the library differs by at most {off:.0e}")
assert off < 1e-4
draw.clouds(centre.ir, silhouette.numpy(), picture.numpy())

# %% [markdown] tags=["solution"]
# **Discussion.** The library caps occupancies at $1 - 10^{-5}$, hence the difference: it adds up
# $\log(1 - o)$ instead of multiplying, which is one `cumsum` for all rays, and the one of
# an opaque voxel would be infinite.
#
# The order matters for the picture only: the silhouette is the same from both ends of the ray.
# (Exercise 5 makes much of this.) Behind an opaque voxel nothing is seen, and no gradient comes: a
# point behind the face never learns from that view. It must be in front in another one.

# %% [markdown]
# ## 5. Open: what silhouettes cannot tell
#
# *Hard and open, 40 minutes.* The network learns its clouds from silhouettes. So it can learn what
# silhouettes tell, and no more. How much is that? Take a solid of voxels, with its silhouettes along
# the three axes:
#
# `solid.any(0)`, `solid.any(1)`, `solid.any(2)`
#
# Find two other volumes that have exactly the same three.
#
# | in | shape | |
# |---|---|---|
# | `solid` | (D, H, W) | bool; perhaps empty |
# | **out** | (D, H, W) | bool: *most*, the largest of all volumes with these silhouettes |
# | | (D, H, W) | bool: *least*, one from which no voxel can be taken without changing a silhouette |
#
# - There is one *most*, and mostly there are many *least*: any will do. It need not be a part of
#   the solid.
# - If there is no choice, both are the solid itself.
#
# The picture shows what is expected, for a head made of voxels of 6 mm.

# %%
STEP = 0.006
shape = head_shape(Proportions(*[1.0] * 7))  # a function: negative inside; y up, z towards us
axes = [np.arange(low, high, STEP) for low, high in ((-0.04, 0.25), (-0.13, 0.14), (-0.1, 0.1))]
z, y, x = np.meshgrid(*axes, indexing="ij")  # x right, y down, z away from us
head = shape(np.stack([x, -y, -z], -1)) < 0
eyes = int(np.abs(axes[1]).argmin())
expected = checks.same_silhouettes(head)
draw.sections(
    dict(zip(("solid", "most", "least"), (head, *expected), strict=True)), eyes, 1000 * STEP
)


# %%
def same_silhouettes(solid):
    """The largest volume with the silhouettes of a solid, and one of the least.

    >>> most, least = same_silhouettes(np.ones((1, 2, 2), bool))
    >>> most.sum(), least.sum()  # from above, all four are needed
    (np.int64(4), np.int64(4))
    >>> same_silhouettes(np.ones((2, 2, 2), bool))[1].sum()  # of eight, four are enough
    np.int64(4)
    """
    ### BEGIN SOLUTION
    most = solid.any(0)[None] & solid.any(1)[:, None] & solid.any(2)[:, :, None]
    least = most.copy()
    for k, j, i in np.random.default_rng(0).permutation(np.argwhere(most)):
        if min(least[:, j, i].sum(), least[k, :, i].sum(), least[k, j, :].sum()) > 1:
            least[k, j, i] = False
    return most, least
    ### END SOLUTION


# %%
answer = checks.check_same_silhouettes(same_silhouettes)
same_silhouettes_here = use(answer, checks.same_silhouettes)
answer

# %%
most, least = same_silhouettes_here(head)
for name, volume in {"solid": head, "most": most, "least": least}.items():
    same = all((volume.any(axis) == head.any(axis)).all() for axis in range(3))
    print(f"{name:6s} {volume.sum():6d} voxels, the same silhouettes: {same}")
    assert same
assert (head <= most).all() and least.sum() < 0.3 * head.sum()

# %% [markdown]
# So the masks do not tell a head from a cloud of dust. Can intensity? Paint the head with
# spots, and look at it from the front, from above and from the left. Then let each volume choose
# the brightness of its voxels as well as it can: a voxel that is seen in several pixels takes their
# mean. By how much are its pictures wrong?


# %%
def first_hits(volume, axis):
    """The index of the voxel that each ray along an axis meets first; rays that meet one."""
    number = np.arange(volume.size).reshape(volume.shape)
    rays = np.moveaxis(volume, axis, 0), np.moveaxis(number, axis, 0)
    return np.take_along_axis(rays[1], rays[0].argmax(0)[None], 0)[0][volume.any(axis)]


spots = 0.5 + 0.5 * np.sin(200 * x + 5) * np.sin(180 * y + 1) * np.sin(190 * z)
wanted = [spots.ravel()[first_hits(head, axis)] for axis in range(3)]
errors = {}
for name, volume in {"solid": head, "most": most, "least": least}.items():
    hits = np.concatenate([first_hits(volume, axis) for axis in range(3)])
    pixels = np.concatenate(wanted)
    seen_by = np.bincount(hits, minlength=volume.size)
    best = np.bincount(hits, pixels, volume.size) / np.maximum(seen_by, 1)
    errors[name] = np.sqrt(np.mean((best[hits] - pixels) ** 2))
    print(f"{name:6s} pictures wrong by {errors[name]:.3f} (root mean square)")
print(f"       one grey for all {pixels.std():.3f}")
assert errors["solid"] < 1e-9 < min(errors["most"], errors["least"])

# %% [markdown] tags=["solution"]
# **Discussion.** *Most* is called the **visual hull** (Laurentini, 1994). A voxel belongs to it if
# no silhouette forbids it, so there is exactly one. It has no eye sockets: whatever lies within the
# outline in *every* view is filled. More views make it smaller, but the bottom of a bowl stays
# filled: every ray that passes there also meets the bowl. Here the three views are at right
# angles. The cameras of the car are at most 54 degrees apart, so their hull is much longer
# along the line of sight.
#
# *Least* is dust, if one looks at the voxels in a random order. (In the order of the array it is a
# bent sheet at the back.) Each of its voxels is alone on at least one ray, so there are never more
# of them than pixels in the three silhouettes together. To find the smallest is hard in general.
# For a full cube of $n^3$ voxels it is a Latin square: voxel $(i, j, k)$ with
# $k = (i + j) \bmod n$, so $n^2$ are enough. A network with 2000 points can make such dust, too:
# the mask loss is 0 for it.
#
# Why do clouds still look like heads? Three things help. *Intensity:* the point that a ray meets
# first must have the right brightness in all views at once, and dust cannot do that. (It is called
# photo-consistency. But here each camera has its own lamp, so that the same skin is not
# equally bright in all pictures: a weak constraint. On skin without marks it says nothing at all.)
# *Other views:* the network does not know from where it will be judged, so dust would have to fit
# any view. *The network itself:* it is smooth, and has seen many heads. It says what heads look
# like on average. This is a guess that no loss on this picture has checked: an eye socket in the
# cloud is memory at best, and never measured.
#
# What would measure it? Shading, if one knows the lamp; texture and stereo; a depth camera.
