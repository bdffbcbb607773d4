# ---
# jupyter:
#   jupytext:
#     cell_metadata_filter: tags,-all
#     formats: ipynb,py:percent
#     notebook_metadata_filter: jupytext,-jupytext.text_representation,-kernelspec
# ---

# %% [markdown]
# # Infrared to clouds
#
# ## The question in one picture

# %%
import numpy as np
import torch

import data_tools
from book.ch03_infrared_to_clouds import cloud_training as training
from book.ch03_infrared_to_clouds import experiments, looking
from book.ch03_infrared_to_clouds.drawing import splats, views
from book.tools.checkpoints import load_or_train
from data_tools.worlds import headset
from posecore import cameras, figures
from posecore.methods.infrared import masks
from posecore.methods.infrared.evaluation import overlap
from posecore.methods.infrared.losses import CloudLoss
from posecore.scale import choose, scale
from posecore.splat import render, to_voxels

# %%
torch.set_num_threads(choose(tiny=1, book=2, paper=2))  # a test at tiny has one core
recipe = training.recipe()
net = load_or_train(experiments, "clouds", looking.blank_net(recipe))
few = data_tools.open("headset", split="test", whole=False)  # makes only what is looked at


def instant(number):
    """Three photographs taken at once: left, centre, right."""
    return [few[3 * number + camera] for camera in range(3)]


driver = instant(5)
cloud, surface = looking.cloud_of(net, driver[1]), looking.surface_of(driver[1])
figures.Viewer({"predicted cloud": cloud, "true surface": surface}, up="-y", unit="cm")

# %% [markdown]
# Turn it. One infrared photograph of a driver went into a network, and this cloud of points came
# out (the other points are the true surface, as far as the camera sees it). The network has never
# seen this driver. That a network can say depth from one image is known. The odd thing is how it
# was taught: **nobody ever showed it the shape of a head.** No depth camera, no scan, no 3D model.
# It was told where the glasses are, one point. All else are flat pictures: which pixels of a
# photograph are head, and how bright these are, seen from other sides.
#
# How can flat shapes teach depth? That is this chapter. Its method is the first half of Firintepe
# et al., *From IR Images to Point Clouds to Pose* (2021); chapter 4 makes poses out of such clouds.
#
# ## What you will build, and what you need
#
# | | you build | the library has it as |
# |---|---|---|
# | 1 | a shape from three silhouettes | |
# | 2 | masks that nobody painted | `methods.infrared.masks` |
# | 3 | a point spread over voxels | `splat.to_voxels`, `splat.render` |
# | 4 | a ray that stops at what it meets | `splat.render` |
# | 5 | the pull of a mask on a point | its derivative |
# | 6 | (looked at) the network | `methods.infrared.network` |
# | 7 | three losses, and a training, live | `losses`, `recipe`, `training.fit` |
# | 8 | what is right, wrong and guessed | `methods.infrared.evaluation` |
# | 9 | the paper's claims, measured | the book's ledger |
#
# You need chapter 1's cameras; chapter 2's `headset` world is where the photographs come from.
#
# - **Time:** an hour to read, some minutes to run.
# - **Short path:** sections 1, 4, 5 and 8.
#
# Symbols of this page:
#
# | symbol | in code | is |
# |---|---|---|
# | $p$ | `points` | a point of the cloud, metres, relative to $t$, along the camera's axes |
# | $t$ | `t` | the translation: where the glasses are, in the camera's frame, metres |
# | $K$, $T$ | `K`, `T_world_cam` | a camera's matrix, and its pose in the car |
# | $N$; $W, H, D$ | `points`, `grid` | how many points; columns, rows and slices of the grid |
# | $o_i$ | `occupancy` | how much of a ray's light voxel $i$ stops, 0 to 1 |
# | $q_i$ | `stopped` | the share of a ray's light that is stopped in voxel $i$ |
# | $c_i$ | `intensities` | how bright what is in voxel $i$ is, 0 to 1 |
# | $s$ | `scale` | the occupancy scale, one number for a cloud, 0 to 4 |
# | $\sigma$ | `sigma` | width of a blur, voxels |
# | $\theta$ | `threshold` | brightness above which a pixel counts as foreground |

# %%
print("This page runs at scale:", scale())

# %% [markdown]
# ## 1. What three silhouettes know
#
# A **silhouette** is the shape of a thing in an image: a mask, black and white, without anything
# inside. In one view it says little. A ball and a disc have the same one. But a mask does say
# something of space: whatever is inside the thing must lie *behind its mask's pixels*. A point of
# space that some camera sees outside the mask cannot belong to the thing.
#
# So take many points, throw away what any camera sees outside its mask, and look at what is left.
# It is called the **visual hull**. First of a cube of 15 cm, before this world's three cameras:


# %%
def carve(points, masks, cameras_):
    """Which of (N, 3) points in the car lie within the masks of all cameras."""
    inside = np.ones(len(points), bool)
    for mask, (K, T) in zip(masks, cameras_, strict=True):
        seen = (points - T[:3, 3]) @ T[:3, :3]  # in the camera's frame: T's inverse, for rows
        x, y = np.round(cameras.project(K, seen)).astype(int).T
        height, width = mask.shape
        here = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        inside &= here
        inside[here] &= mask[y[here], x[here]]
    return inside


# %%
size = few[0].shape[::-1]
three = headset.cameras(*size)
sides, middle = (0.15, 0.15, 0.15), np.array([0.0, 0.0, 0.05])
shapes = [
    masks.cuboid_mask(
        K, T[:3, :3].T, T[:3, :3].T @ (middle - T[:3, 3]), size, sides=sides, centre=(0, 0, 0)
    )
    for K, T in three
]
# %%
step = choose(tiny=0.02, book=0.01, paper=0.01)
line = np.arange(-0.35, 0.35, step)
space = np.stack(np.meshgrid(line, line, line, indexing="ij"), -1).reshape(-1, 3) + middle
kept = carve(space, shapes, three)
in_cube = (np.abs(space - middle) <= 0.075).all(-1)

assert (in_cube & ~kept).sum() <= 0.1 * in_cube.sum()  # a few are lost, as pixels are coarse
print(f"{in_cube.sum()} points in the cube, {kept.sum()} in its visual hull")
figures.point_clouds(
    {"hull": space[kept & ~in_cube], "cube": space[kept & in_cube]},
    up="-y",
    unit="cm",
    views=("oblique", "top"),
)

# %% [markdown]
# It is a solid thing at the right place, as wide and as high as the cube, and all that went in are
# three flat shapes. But it is much deeper: it has roofs at the front and at the back, where no
# camera looks from the side. Now the same with a head.

# %%
truths = [headset.foreground(view) for view in driver]
head_at = driver[1].T_world_cam[:3, :3] @ driver[1].objects[0].t + driver[1].T_world_cam[:3, 3]
around = space - middle + head_at + [0, 0, 0.1]
hull = around[carve(around, truths, [(view.K, view.T_world_cam) for view in driver])]
T = driver[1].T_world_cam
hull_seen = (hull - T[:3, 3]) @ T[:3, :3]

assert len(hull)
figures.point_clouds(
    {"hull of three masks": hull_seen, "true surface": surface},
    up="-y",
    unit="cm",
    views=("oblique", "side"),
)

# %% [markdown]
# <details><summary>Could a fourth camera cut the roofs off?</summary>
#
# Each camera takes away what *it* sees beside the thing. A little above the centre one it would see
# the roofs before and behind the head itself, as the others do, and leave them. Above the driver's
# head, or at a side window, it would cut them off.
#
# </details>
#
# <details><summary>Can any number of cameras find the hollow of an eye?</summary>
#
# No. Whatever lies in a hollow is behind the mask from every side, since some part of the rim is
# always before or behind it. What silhouettes cannot know is the open exercise of this chapter.
#
# </details>
#
# This needs all three masks. The network will get *one photograph*. But while it learns, the other
# masks can tell it how wrong its cloud is: that is the whole trick.
#
# ## 2. Masks that nobody painted
#
# Where do masks come from? The paper has a million triples of photographs and paints nothing. It
# knows the poses of the glasses, and it knows that the head is *bright*: each camera has an
# infrared lamp beside it, whose light falls with the square of the distance. Two steps:
#
# 1. A box of 17.8 x 26.4 x 25.7 cm is put where the head must be and projected. What is outside
#    its silhouette is painted black.
# 2. A threshold $\theta$ separates bright from dark.
#
# (Where the box sits relative to the glasses is not in the paper: here a head's depth behind them.
# It calls the box an "upper body"; it is the size of a head.)

# %%
view = driver[1]
item = view.objects[0]
region = masks.cuboid_mask(view.K, item.R, item.t, size)
cut = np.where(region, view.ir, 0)

assert region.shape == view.ir.shape
views.masks(view.ir, {"the cuboid": region, "what is in it": cut, "what we hope for": truths[1]})

# %% [markdown]
# Which threshold? Li and Tam (1998) paint every pixel of brightness $g$ with the mean of its side,
# $m_0$ of the dark one or $m_1$ of the bright one, and take the threshold with which that says most
# of the image: the smallest **cross-entropy** $\sum g \log (g / m)$. Set its derivative to zero, and
# out comes a rule that is repeated until it stays:
#
# $$ \theta \;\leftarrow\; \frac{m_1 - m_0}{\log m_1 - \log m_0}. $$
#
# That is the *logarithmic mean* of the two. It lies below their ordinary mean, which is what a dark
# image with a bright spot needs.


# %%
def li(values):
    """The thresholds of Li's iteration, one after the other; the darkest value is 0."""
    steps = [values.mean()]
    while len(steps) < 2 or abs(steps[-1] - steps[-2]) > 0.5:
        dark, bright = values[values <= steps[-1]], values[values > steps[-1]]
        m0, m1 = max(dark.mean(), 1e-12 * bright.mean()), bright.mean()
        steps.append((m1 - m0) / (np.log(m1) - np.log(m0)))
    return steps


steps = li(cut.astype(float))
assert abs(steps[-1] - masks.li_threshold(cut)) < 0.5
views.li_steps(cut[region], steps)

# %%
mask = masks.object_mask(view.ir, view.K, item.R, item.t)
assert (mask == (region & (view.ir > masks.li_threshold(cut)))).all()
shared = (mask & truths[1]).sum() / (mask | truths[1]).sum()
print(f"overlap with what is truly head and glasses: {shared:.2f}")
views.masks(view.ir, {"within the cuboid, above θ": mask, "head and glasses": truths[1]}, columns=3)

# %% [markdown]
# The **overlap** (intersection over union, IoU) is what both masks share, divided by what either
# has. It is far from 1, and one sees why: neck, collar and some of the seat are in. (Other drivers
# lose dark hair as well.) One detail decides much: whether the pixels outside the box, painted
# black, take part in the threshold. The same for the four drivers of the test split:

# %%
for number in (4, 5, 6, 7):
    one = instant(number)[1]
    box = masks.cuboid_mask(one.K, one.objects[0].R, one.objects[0].t, size)
    shares = []
    for level in (masks.li_threshold(np.where(box, one.ir, 0)), masks.li_threshold(one.ir[box])):
        found, true = box & (one.ir > level), headset.foreground(one)
        shares.append((found & true).sum() / (found | true).sum())
    print(
        f"driver {one.scene_id}: overlap {shares[0]:.2f}; of the box's own pixels {shares[1]:.2f}"
    )

# %% [markdown]
# With the box's own pixels alone, a threshold between bright and dark *skin* is found for most.
#
# A network that learns from such masks learns the clouds of faces with necks. To see what clouds
# can do, this page's network was taught with exact masks, as a painter would have made them;
# section 9 compares both.
#
# <details><summary>By day, light comes in through the windows. What does that do to the mask?</summary>
#
# What is seen through a window within the box can be as bright as skin, and is taken for head. It
# is another shape in every image, so a network cannot learn it; it learns the average.
#
# </details>
#
# ## 3. A point in a box of voxels
#
# Now the other direction: from a cloud of points to a silhouette, so that it can be compared with a
# mask. One could paint a pixel for each point. But painting has no derivative: move a point by a
# hundredth of a pixel and nothing changes, then it jumps. What is to learn by gradients needs a
# picture that changes *smoothly* when a point moves.
#
# So fill a box of **voxels** (pixels with depth) instead. Its columns and rows are those of the
# image, in coarser pixels; its slices are depths, here over 64 cm, the glasses amid them. A point at
# $(x, y, z)$, in voxels, is shared out among the eight voxel centres around it, to each the more
# the nearer it is: **trilinear** weights, a product of three shares.


# %%
def splat(point, size):
    """(D, H, W): one point at x, y, z in voxels, shared out among eight voxels."""
    volume = np.zeros(size[::-1])
    first = np.floor(point).astype(int)
    for corner in np.ndindex(2, 2, 2):
        place = first + corner
        shares = 1 - np.abs(point - place)  # along x, y and z
        if (place >= 0).all() and (place < size).all():
            volume[tuple(place[::-1])] += shares.prod()
    return volume


point = [1.3, 1.6, 0.25]
volume = splat(point, (4, 3, 3))
assert np.isclose(volume.sum(), 1)
splats.eight_corners(volume, point)

# %% [markdown]
# Move the point a little to the right, and the right voxels gain exactly what the left ones lose.
# That has a derivative. Before it there is the camera, which chapter 1 built: from metres to
# pixels, and here to voxels.

# %%
W, H, D = recipe.grid
K, T = torch.from_numpy(view.K).float(), torch.from_numpy(view.T_world_cam).float()
somewhere = torch.tensor([[0.02, -0.03, float(item.t[2]) + 0.05]])  # metres, in the camera's frame
x, y = cameras.project(view.K, somewhere.double().numpy())[0]
# Points, camera, size of its images, size of the grid, depth at its middle, and its extent in metres.
voxel = to_voxels(somewhere, K, size, recipe.grid, float(item.t[2]), recipe.extent)[0]

by_hand = [(x + 0.5) * W / size[0] - 0.5, (y + 0.5) * H / size[1] - 0.5]
by_hand.append(0.05 * D / recipe.extent + (D - 1) / 2)
assert np.allclose(voxel, by_hand, atol=1e-3)
print("voxel", [round(float(v), 2) for v in voxel], "of", recipe.grid)

# %% [markdown]
# <details><summary>Why are halves added and taken away in that formula?</summary>
#
# The centre of the first pixel is at 0, so the image begins at -0.5. When it is made coarser its
# border stays where it is, not its first centre (chapter 1, half pixels).
#
# </details>
#
# ## 4. The ray that stops
#
# A silhouette asks of each pixel: does a ray from the camera meet anything? Let voxel $i$ stop a
# share $o_i$ of the light that arrives there, its **occupancy**. What arrives is what all voxels
# before it let through, so what is stopped *here* is
#
# $$ q_i = o_i \prod_{j<i} (1 - o_j), \qquad \text{silhouette} = \sum_i q_i = 1 - \prod_i (1 - o_i). $$

# %%
occupancy = np.array([0, 0.02, 0.3, 0.7, 0.3, 0.02, 0, 0, 0.1, 0.6, 0.6, 0.1, 0])
left = np.concatenate([[1], np.cumprod(1 - occupancy)[:-1]])
stopped = occupancy * left

assert np.isclose(stopped.sum(), 1 - np.prod(1 - occupancy))
splats.ray(occupancy, left, stopped)

# %% [markdown]
# Most of it stops at the first surface; the second one, as full as the first, gets what is left. So
# the same $q_i$ also say what is *seen*: give every voxel a brightness $c_i$, the mean of its points'
# weighted by their shares, and the pixel's is $\sum_i c_i q_i$. What is hidden adds nothing. All of it in code, for one point and one pixel
# after the other; the library has it in one function, and both agree.


# %%
def picture_of(points, brightness, size):
    """Silhouette and picture (H, W) of points in voxels: the loops."""
    volume = sum(splat(point, size) for point in points)
    light = sum(c * splat(point, size) for c, point in zip(brightness, points, strict=True))
    shades = np.divide(light, volume, out=np.zeros_like(volume), where=volume > 0)
    occupancy = volume.clip(max=1) * (
        1 - 1e-5
    )  # never quite 1, as in the library, which adds logarithms
    left = np.cumprod(np.concatenate([np.ones((1, *volume.shape[1:])), 1 - occupancy]), 0)
    stopped = occupancy * left[:-1]
    return stopped.sum(0), (shades * stopped).sum(0)


# %%
rng = np.random.default_rng(0)
points = rng.uniform(0, 5, (40, 3))
brightness = rng.uniform(0, 1, 40)
mine = picture_of(points, brightness, (6, 6, 6))
library = render(torch.from_numpy(points), (6, 6, 6), intensities=torch.from_numpy(brightness))

assert np.allclose(mine[0], library.silhouette, atol=1e-6)
assert np.allclose(mine[1], library.intensity, atol=1e-6)

# %% [markdown]
# <details><summary>Two points in one voxel: does it become twice as full?</summary>
#
# The volume is cut at 1: a voxel is full when it is full. A point more in it changes nothing, and
# gets no gradient from there.
#
# </details>
#
# ## 5. The pull of a mask
#
# Compare the silhouette with a mask, pixel by pixel, and square the differences: a **loss**. Its
# gradient by the points says in which direction each should move. But how far does a mask's pull
# reach? A point that is one voxel from the mask shares a voxel with it; one that is five away does
# not feel it at all. Unless the volume is *blurred*: then every point is a cloud of its own, as
# wide as the blur. Here is the pull of a disc of radius 8 on a point beside it, each as a share of
# its largest. (A wide blur pulls far, and weakly.)

# %%
far = torch.linspace(0, 12, 61)
target = torch.zeros(48, 48)
rows, columns = torch.meshgrid(torch.arange(48.0), torch.arange(48.0), indexing="ij")
target[(rows - 24) ** 2 + (columns - 14) ** 2 <= 8**2] = 1
pulls = {}
for sigma in (0.0, 1.0, 3.0):
    points = torch.stack([22 + far, torch.full_like(far, 24), torch.full_like(far, 5)], -1)
    points = points[:, None].requires_grad_()  # 61 clouds of one point
    seen = render(points, (48, 48, 11), sigma=sigma).silhouette
    # Of (seen - target)² what depends on both; a point's own seen² hardly changes when it moves.
    (-2 * seen * target).sum().backward()
    towards = points.grad[:, 0, 0]  # along x, away from the disc where positive
    pulls[f"blur σ = {sigma:g}"] = (far.numpy(), towards.abs().numpy() / towards.abs().max().item())
splats.reach(pulls)

# %% [markdown]
# Without a blur the pull ends after a voxel. So a training **begins with a wide blur and ends with
# a narrow one**: first the heap finds its place, then its shape. The paper prints that the *masks*
# are blurred, a little and then more; the renderer that it adapts blurs the *volume*, much and then
# less. The library has both (`mask_blur`, `blur`).
#
# Try it without any network. A heap of points, the three masks of our driver, and gradient descent
# on the points themselves. Twice, as one thing is open: how much light does a point stop? Say, as
# much as its voxels are full, times a **scale**, which is 1 or 4:

# %%
count = choose(tiny=100, book=400, paper=400)
poses = torch.stack([torch.from_numpy(one.T_world_cam).float() for one in driver])
Ks = torch.stack([torch.from_numpy(one.K).float() for one in driver])
t = torch.from_numpy(item.t).float()[None]
project = recipe.projector(size)
wanted = torch.nn.functional.interpolate(
    torch.from_numpy(np.stack(truths))[None].float(), size=(H, W), mode="area"
)


# %%
def in_the_grid(heap):
    """The heap in the centre camera's grid."""
    voxels = project.to_voxels(heap.detach(), t, poses[1][None], Ks[None], poses[None])
    return voxels[0, 1, :, :2]  # (clouds, cameras, points, x y z)


# %%
def pull(scale, rounds):
    """A heap after gradient descent, its silhouettes, how it was on the way, and its loss."""
    start = 0.05 * torch.randn(1, count, 3, generator=torch.Generator().manual_seed(1))
    heap, stages = start.requires_grad_(), {}
    descent = torch.optim.Adam([heap], lr=3e-3)
    for number in range(rounds):
        sigma = 3.0 * (0.6 / 3.0) ** (number / rounds)  # from 3 to 0.6 in equal ratios
        seen = project(heap, t, poses[1][None], Ks[None], poses[None], sigma=sigma, scale=scale)
        loss = (seen.silhouette - wanted).square().mean()
        descent.zero_grad()
        loss.backward()
        descent.step()
        if number in (0, rounds // 6, rounds // 2, rounds - 1):
            stages[f"step {number + 1}"] = in_the_grid(heap).numpy()
    return heap.detach()[0], seen.silhouette.detach()[0], stages, loss.item()


# %%
rounds = choose(tiny=20, book=120, paper=120)
_, grey, _, grey_loss = pull(1.0, rounds)
heap, white, stages, white_loss = pull(4.0, rounds)

assert white_loss < grey_loss
splats.pulled(stages, wanted[0, 1].numpy())

# %% [markdown]
# This is the heap of scale 4. At 1 a point fills one voxel at the most, and the blur spreads it over
# several. Our head covers about 400 pixels of the grid, and so 400 points are about one for each,
# front and back together: they cannot stop all light, wherever they go. At 4 they can. (What would
# be more than full is cut.)

# %%
every = torch.from_numpy(np.stack(truths))
for words, found in (("scale 1", grey), ("scale 4", white)):
    print(f"{words}: overlap with the masks {overlap(found, every).mean():.2f}")
views.silhouettes(
    {"mask": wanted[0].numpy(), "scale 1": grey.numpy(), "scale 4": white.numpy()},
    alt="Three masks of a head; the silhouettes of the heap with scale 1, grey inside; those with "
    "scale 4, as white as the masks.",
)

# %%
moved = heap.numpy() + item.t
figures.point_clouds(
    {"the heap, pulled": moved, "true surface": surface},
    up="-y",
    unit="cm",
    views=("front", "side"),
)

# %% [markdown]
# (A few points began too far away and are lost: no pixel of a mask is within their blur, which ends
# at three sigma.) Look at the cloud from the side. Nobody told the points a depth, and yet they have one: the left and the
# right mask pulled them there. The points fill the *hull*, inside too, where no camera looks.
#
# <details><summary>Points inside the heap have no gradient. Why does that do no harm?</summary>
#
# The rays that pass them are stopped anyway, so the silhouettes are right without them. For the loss
# it does not matter where they are; and it cannot say, either.
#
# </details>
#
# ## 6. One image in, a cloud out
#
# That was one driver, with three masks at hand. A **network** that is given one image and says the
# points can be trained on thousands of instants: for each it is told by all three masks how wrong
# it was. At test there is one image, and no mask. What it has to learn is what shape usually
# belongs to such a picture.
#
# The encoder's blocks are a convolution of 3 x 3 that halves the image and one of 1 x 1, and each
# has twice as many channels as the one before (ours up to 96, as the file is to stay small):

# %%
image = torch.from_numpy(view.ir).float()[None, None] / 255
x = torch.nn.functional.interpolate(image, size=recipe.image[::-1], mode="area")
print("image", tuple(x.shape))
for layer in net.encoder:
    x = layer(x)
    if isinstance(layer, torch.nn.Conv2d) and layer.kernel_size == (3, 3):
        print("3 x 3, stride 2 ", tuple(x.shape))
features = x.flatten(1)
code = net.decoder(features)
print("flattened", tuple(features.shape), "decoder", tuple(code.shape))
print("points", tuple(net.points(code).shape), "place", tuple(net.place(code).shape),
      "scale", tuple(net.scale(code).shape), "intensity", tuple(net.intensity(features).shape))  # fmt: skip

found = net(torch.nn.functional.interpolate(image, size=recipe.image[::-1], mode="area"))
assert found.points.shape == (1, recipe.points, 3) and found.points.abs().max() <= net.cube / 2

# %% [markdown]
# Four **output layers** read it off:
#
# - **points** $p$, $N$ x 3 numbers, through a tanh, so that they stay within a cube of 40 cm;
# - a **place**: the translation $t$, in units of the *object box*, the box of all translations of
#   the training, which is some decimetres wide. Points are relative to $t$: shape and place are
#   learned apart;
# - a **scale** $s$, one number, that multiplies all occupancies: from 0 to 1 in the paper, to 4 here,
#   as our points are few (section 5);
# - **intensities** $c$, one for each point, straight from the features, as brightness is in the
#   image already.
#
# <details><summary>Why are the points not predicted in the car's frame?</summary>
#
# The network sees one image and is not told of which camera. What it can know is how things lie
# *before that camera*; the calibration, which is known, does the rest.
#
# </details>
#
# ## 7. Three losses
#
# - $L_t$: the squared distance of predicted and true translation, in units of the box. (The
#   poses of the glasses are known, so this one is supervised in the plain way.)
# - $L_{mp}$: silhouettes in the three views against the masks.
# - $L_{cmp}$: pictures of the intensities against the image *within its mask*.
#
# $$ L = 0.2\, L_t + 0.2\, L_{mp} + 0.6\, L_{cmp} $$
#
# For the last two, the cloud is put at the **true** translation while it learns, and only at test
# at the predicted one: else a wrong place would bend the shape. By hand, for our driver's centre
# image, and the same by the library:

# %%
inside = np.stack(
    [np.where(true, one.ir, 0) / 255 for true, one in zip(truths, driver, strict=True)]
)
shades = torch.nn.functional.interpolate(
    torch.from_numpy(inside)[None].float(), size=(H, W), mode="area"
)
batch = {
    "images": torch.nn.functional.interpolate(image, size=recipe.image[::-1], mode="area"),
    "t": t, "own": poses[1][None], "K": Ks[None], "T_world_cam": poses[None],
    "masks": wanted, "shades": shades, "done": torch.tensor(1.0),
}  # fmt: skip

# %%
cloud = net(batch["images"])
pictures = project(
    cloud.points, t, poses[1][None], Ks[None], poses[None],
    intensities=cloud.intensities, scale=cloud.scale, sigma=0.8,
)  # fmt: skip
by_hand = {
    "translation": ((cloud.t - t) / (net.high - net.low)).square().sum(),
    "mask": (pictures.silhouette - wanted).square().mean(),
    "intensity": (pictures.intensity - shades).square().mean(),
}

# %%
plain = CloudLoss(project, blur=(0.8, 0.8), mask_blur=(0.0, 0.0))
parts = plain(net, batch)
for name, value in by_hand.items():
    print(f"{name:12}{value.item():.6f}")
    assert torch.isclose(value, parts[name], rtol=1e-4)

# %% [markdown]
# In each step of a training one of the three views is drawn to be the input; one view, drawn as
# well, is looked at: that costs a third of looking in all, and its gradient is right on average.
# Let us train a small network for a moment, on a few instants, and watch the cloud of our driver
# meanwhile. Each panel looks at it from a little further to the side; near is yellow.

# %%
small = training.compared(steps=choose(tiny=4, book=400, paper=400))
little, curves = looking.train_watched(small, view, splats.turning)

# %%
figures.training_curves(curves.losses)

# %% [markdown]
# Half a minute of that is not enough for a good cloud. The network that this page loaded was trained
# for half an hour, with larger images and a finer grid, on 3000 instants of the **crowd**: 750
# drivers of this world who are there to learn from. Two things of its recipe are not the paper's:
# the weights are 0.4, 0.5 and 0.1, with more for the masks, and only the *other* two views are
# looked at, as the own one says nothing of depth.
#
# Try `training.compared(masks="threshold")`, `training.compared(points=64)`, or
# `training.compared(blur=(0.4, 0.4))` in the training above.
#
# What does it see? Its silhouettes and pictures, beside masks and images (shown twice as bright).
# The input was the centre image; the other two it has never seen. The cloud is where the network
# says.

# %%
seen = looking.pictures_of(net, recipe, driver, 1)
beside = looking.targets_of(recipe, driver)
views.silhouettes(
    {"true mask": beside[0], "silhouette of the cloud": seen.silhouette,
     "image in its mask": 2 * beside[1], "picture of the cloud": 2 * seen.intensity},
    alt="Masks of head and glasses in three views, the cloud's silhouettes, the images within the "
    "masks, and the pictures that the cloud's intensities give: blurred, but bright where the face "
    "is.",
)  # fmt: skip

# %% [markdown]
# ## 8. What is right, wrong and guessed
#
# Four drivers are in the test split, and none of them is in the crowd. For every view of theirs the
# cloud is made from that view alone, put at the *predicted* place, and compared with the true masks
# of the **other two** views.

# %%
measured = training.evaluate(net, recipe, most=choose(tiny=4, book=None, paper=None))
unseen = measured.unseen()
rows = {
    "overlap in views not shown, mean": f"{unseen.mean():.3f}",
    "the same, median": f"{unseen.median():.3f}",
    "overlap at the true place, mean": f"{measured.unseen(measured.at_truth).mean():.3f}",
    "translation, median": f"{1000 * measured.off.median():.0f} mm",
    "from the surface seen to the cloud": f"{1000 * measured.to_cloud.nanmean():.1f} mm",
    "from the cloud's front to the surface": f"{1000 * measured.to_surface.nanmean():.1f} mm",
}
for words, value in rows.items():
    print(f"{words:40}{value}")
for axis, error in zip("xyz", looking.off_by_axis(net, recipe), strict=True):
    print(f"{'translation along ' + axis + ', median':40}{1000 * error:.0f} mm")
assert 0 <= unseen.min() and unseen.max() <= 1

# %% [markdown]
# Are these good numbers? Two floors, which need no network: one head from the training, looking
# straight ahead, put at the true place; and the same head, turned as the driver's truly is. Both
# are to be compared with what clouds reach at the true place. And one ceiling: the visual hull of
# the three true masks, in the views that it was cut out by. It says how exact the measuring is.

# %%
for words, overlaps in training.floors(0).items():
    print(f"{words:40}{overlaps.mean():.3f}")
print(f"{'hull of three true masks':40}{looking.ceiling(choose(tiny=2, book=20, paper=20)):.3f}")
constant = looking.constant_translation()
print(f"{'translation: always the mean, median':40}{1000 * constant:.0f} mm")

# %% [markdown]
# The best, the median and the worst cloud, by the overlap in views not shown. Green is the true
# outline, orange that of the cloud.

# %%
order = unseen.flatten().argsort(descending=True)
ranks = {"best": 0, "median": len(order) // 2, "worst": len(order) - 1}
cases = {}
for name, rank in ranks.items():
    g, j = divmod(int(order[rank]), 3)
    cases[name] = looking.case(net, recipe, measured.views[g], j)
views.gallery(
    cases,
    alt="For the best, the median and the worst cloud: the input, the outlines of truth and cloud in "
    "the left, centre and right view, and the cloud from the side with the surface that the camera "
    "sees. In the best both outlines agree nearly everywhere; in the worst the cloud is smaller or "
    "shifted, and its depth is off by centimetres.",
)

# %% [markdown]
# So the network knows more than where a head is and how it is turned: it knows something of *this*
# head. Which part of a cloud does the photograph show, and which is **guessed**? A point is hidden if
# another one stands before it, nearer by three voxels and less than 1.5 aside. The back of the head
# is in no picture. Where the network puts it, it has learned from the masks of other heads that were
# turned; how well is not measured here.

# %%
parts = looking.seen_and_guessed(net, recipe, driver[1])
figures.Viewer(parts, up="-y", unit="cm")

# %% [markdown]
# <details><summary>Depth is the worst of the three coordinates of the place. Why?</summary>
#
# A small head nearby and a large one further off give the same image. What tells them apart is the
# size of the glasses, of which there are only four kinds, and how bright the lamp makes the skin.
#
# </details>
#
# What such clouds are for: chapter 4 reads poses off them, and measures rotations in degrees. To have
# an idea of one: the true pose of the glasses, and one that is 10 degrees off.

# %%
views.poses_apart(view, 10)

# %% [markdown]
# ## 9. What the paper claims and what we measured
#
# The networks that are compared are smaller, so that several of each can be trained: images of 80 x
# 47, a grid of 40 x 24 x 40, 512 points, 1500 steps of 16 instants of the crowd, about a minute
# each, three of each kind. They look in all three views, with the paper's weights. They differ in one
# thing, and are all tested on the four new drivers. Masks are exact unless a row says otherwise.

# %%
from book.tools.claims import ledger_table
from book.tools.ledger import all_rows

ledger_table(all_rows().get("03_infrared_to_clouds", []))

# %% [markdown]
# Some rows need a word:
#
# - **Li's threshold.** A lamp's light falls with the square of the distance, and a camera may be
#   exposed longer or shorter: its *gain*, a factor on all brightness. A fixed threshold is chosen
#   once, on training images as they are, and knows of neither; Li's is found anew in each image.
#   "Overlap lost" is what the masks lose from the nearest third of the views to the farthest, and
#   from gain 1 to another gain.
# - **Infrared and visible light.** 600 instants of the crowd are drawn twice: as the infrared
#   cameras see them, by their lamps, and in grey, as colour cameras in the same places would see
#   them without these lamps. One network learns from each. Both are tested at four daylights, from
#   night to noon; "overlap spread" is the largest of the four overlaps less the smallest. This is
#   hard on visible light: its exposure is the same by day and by night, where a real camera would
#   expose longer, and see noise.
#
# - **Views.** Corrected in its own view only, a network learns an outline and no depth: seen from
#   elsewhere its clouds are worse than any head that looks straight ahead. One other view is enough.
#   A third brings nothing that three seeds could tell apart.
# - **Intensity and scale** are "crucial" in the paper. Here, clouds taught without intensities lie a
#   little *nearer* to the surface: masks put points well, and pictures pull some of them away. Without
#   a predicted scale they are further off. That it may go up to 4 is no gain on this coarse grid,
#   where 512 points are dense enough. Section 5's is twice as fine.
# - **Points relative to a place** have the smaller overlap, as a wrong place moves the whole cloud.
#   But absolute ones are scattered: what a ray meets first is 17 cm from the surface. Silhouettes
#   hardly see a few lost points; a method that reads poses off them would.
# - **Weights and blurs** as printed, or not: overlaps within a percent of each other.
# - **Masks** cost most. What Li's threshold makes of necks and hair is what the network learns.
# - **Drivers.** As many images of only twelve people teach to know these twelve: place and seat come
#   from who it is. With a new driver that fails.
#
# What is not measured is how good clouds get at the paper's sizes: images of 320 x 188, a grid of
# 160 x 94 x 160, 2000 points. Only what they cost is: how long one step of a training takes, of 4
# instants, in all three views, beside ours, which looks in one (the tiny scale compares smaller
# sizes).

# %%
of_paper, of_ours = looking.seconds_of_a_step()
print(f"a step: {of_paper:.2f} s at the paper's sizes, {of_ours:.3f} s at those compared,")
print(f"{of_paper / of_ours:.0f} times as long")

# %% [markdown]
# ## What you can do now
#
# - Say what silhouettes know of a shape, and what they never can.
# - Make masks from a pose and a threshold, and say where they are wrong.
# - Project a cloud differentiably, with rays that stop, and choose its blur.
# - Train a network on depth that nobody measured, and test it in views it was not shown.
#
# ## Exercises
#
# [The exercises](exercises/exercises_03_infrared_to_clouds.ipynb); get your own copy with
# `python book/make.py start 03`. [Solutions](solutions/solutions_03_infrared_to_clouds.ipynb).
#
# ## Summary
#
# - Masks in several views bound a shape: the visual hull.
# - A cloud becomes a picture through voxels and rays that stop; that picture has a derivative, and
#   a blur decides how far a mask can pull.
# - A network that is shown one view, and corrected by masks in others, learns depth.
# - It learns the place of a new driver only from many drivers, not from many images.
#
# Further reading: Insafutdinov and Dosovitskiy, *Unsupervised Learning of Shape and Pose with
# Differentiable Point Clouds* (2018), whose renderer the paper adapts.
#
# ## Appendix: reading the paper closely
#
# | where | is printed | the book reads it as |
# |---|---|---|
# | Eq 1 | $C^{-1}(p_h + t)$, inverse intrinsics on metres | $X = p + t$ in the camera's frame, metres |
# | Eq 2 | $T^{-1} p^c$ | camera to world, $T\,[X; 1]$, and from there into each view |
# | $s$ | scale, superscript and variance of a blur | occupancy scale; no superscript; `mask_blur` |
# | "s controls the points' size" | | one sigmoid a cloud, which multiplies occupancies |
# | mask blur | variance 0.2 to 1, K = 3, growing | the same; and the volume's blur, shrinking (`blur`) |
# | Eq 3 | "translation and mask losses have more weight", with 0.2, 0.2 and 0.6 | the numbers, by default |
# | cuboid | "upper body"; where it sits is not said | a head; centre 10 cm behind the glasses |
#
# What is not printed, and what the library takes by default: the input's own view is among the
# losses (`own_view`); $L_t$ is in units of the box (`box_units`); sums over pixels are divided by
# their number (`by_resolution`); a share of the points is projected at first, growing to all
# (`keep`: 0.07 to 1); images are normalised by the training's mean and deviation (`normalised`).
#
# What this book's recipes have besides: half of the instants are mirrored (`mirror`); a step looks
# in one view (`looks`); the scale goes up to 4 (`max_scale`); a fifth of the points is projected at
# first; exact masks; and another optimiser than Adam, Muon, which is faster here.
