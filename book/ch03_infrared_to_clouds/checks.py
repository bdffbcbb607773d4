"""The checks of chapter 3's exercises: what they are tried on, their hints, and what is right."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from torch import Tensor

from book.tools.checks import Exercise
from book.tools.gradients import gradient_at_leaf
from book.tools.values import difference
from posecore import rotations
from posecore.methods.infrared import masks

SECONDS = 10.0

Inputs = Iterator[tuple]


# 1. One step of Li's iteration --------------------------------------------------------------------


def li_update(values: np.ndarray, threshold: float) -> float:
    """The threshold that follows on another one, from the means on its two sides."""
    dark, bright = values[values <= threshold], values[values > threshold]
    if not dark.size or not bright.size:
        return float(threshold)
    below, above = dark.mean(dtype=float), bright.mean(dtype=float)
    below = max(below, 1e-12 * above)
    return float((above - below) / (np.log(above) - np.log(below)))


def _brightness(rng: np.random.Generator) -> Inputs:
    few = np.array([1.0, 3, 9, 11])
    yield "four values, two on each side", few, 5.0
    yield "the same values, another threshold", few, 10.5
    yield "a value that is the threshold", np.array([1.0, 3, 5, 9, 11]), 5.0
    picture = rng.integers(1, 255, size=(6, 8)).astype(np.uint8)
    yield "a picture of bytes", picture, 100.0
    yield "a picture of bytes, a threshold between two of them", picture, 63.5
    yield "pictures of 12 bits", rng.integers(0, 4096, size=(2, 5, 7)).astype(np.uint16), 1500.25
    for _ in range(2):
        yield "brightness from 0 to 1", rng.uniform(0, 1, size=(4, 9)), float(rng.uniform(0.2, 0.8))
    yield "brightness of float32", rng.uniform(0, 1, size=40).astype(np.float32), 0.4
    yield "hardly any light", 1e-3 * rng.uniform(0, 1, size=(5, 5)), 4e-4
    yield "many dark values, one bright one", np.array([1.0] * 30 + [200]), 60.0
    yield "only 0 below", np.array([0, 0, 40, 60], np.uint8), 20.0
    yield "nothing above the threshold", few, 11.0
    yield "nothing below the threshold", few, 0.5
    yield "values that are all 0", np.zeros((3, 3), np.uint8), 0.0
    yield "no values at all", np.zeros(0), 3.0


check_li_update = Exercise(
    li_update,
    _brightness,
    hints=(
        {
            "the threshold": "What is on both sides? Read the list again: one of the two sides "
            "holds what is equal to the threshold, and one may hold nothing.",
            "only 0": "A mean of 0 has no logarithm. What should stand in its place?",
            "byte": "Bytes end at 255. What becomes of a sum of them?",
            "bits": "Do all pictures have the same range of values, and two dimensions?",
            "0 to 1": "Neither values nor thresholds need be whole numbers.",
            "": "Sort the values into two groups by a mask; each has a mean.",
        },
        "dark = values[values <= threshold] and bright = values[values > threshold] have any shape "
        "of values. If either is empty, return the threshold. Else take both means, replace that "
        "of the dark by max(m0, 1e-12 * m1), and use np.log.",
    ),
    tolerance=1e-5,  # means of float32
    seconds=SECONDS,
)


# 2. The cuboid's silhouette -----------------------------------------------------------------------


def cuboid_silhouette(
    K: np.ndarray,
    R: np.ndarray,
    t: np.ndarray,
    sides: np.ndarray,
    centre: np.ndarray,
    size: tuple[int, int],
) -> np.ndarray:
    """(H, W) bool: the pixels whose centres a cuboid covers."""
    return masks.cuboid_mask(K, R, t, size, sides=tuple(sides), centre=tuple(centre))


def _cuboids(rng: np.random.Generator) -> Inputs:
    K = np.array([[40.0, 0, 9.5], [0, 40, 7.5], [0, 0, 1]])
    size = 20, 16
    straight, ahead, origin = np.eye(3), np.array([0, 0, 1.0]), np.zeros(3)
    box, beside = np.array([0.2, 0.3, 0.1]), np.array([0.06, -0.05, 0.1])
    yield "a cuboid straight ahead", K, straight, ahead, box, origin, size
    yield "a deep cuboid, wider in front", K, straight, ahead, np.array([0.2, 0.1, 1]), origin, size
    apart = np.array([[50.0, 0, 9.5], [0, 30, 7.5], [0, 0, 1]])
    yield "a camera with fx and fy apart", apart, straight, ahead, box, origin, size
    yield "a centre beside the origin", K, straight, ahead, box, beside, size
    for _ in range(2):
        R = rotations.random_rotations(generator=rng)
        yield "a turned cuboid", K, R, ahead, np.array([0.1, 0.4, 0.2]), origin, size
    yield "a turned cuboid, its centre beside the origin", K, R, ahead, box, 2 * beside, size
    off_axis = np.array([[45.0, 0, 4], [0, 35, 11], [0, 0, 1]])
    yield "a principal point that is not in the middle", off_axis, R, ahead, box, beside, size
    skewed = np.array([[40.0, 15, 9.5], [0, 40, 7.5], [0, 0, 1]])
    yield "a camera with skew", skewed, R, np.array([0.05, 0.15, 1]), box, beside, size
    yield "an image that is higher than wide", K, R, ahead, box, beside, (12, 20)
    yield "a cuboid half outside the image", K, R, np.array([-0.21, 0.13, 0.9]), box, origin, size
    yield "a cuboid outside the image", K, R, np.array([1.0, 0, 1]), box, origin, size
    yield "a cuboid that fills the image", K, R, ahead, np.array([1.0, 1, 1]), origin, size
    yield "a cuboid between four pixels", K, R, ahead, np.array([0.005] * 3), origin, size
    lying = rotations.axis_angle_to_matrix(np.array([0.6, -0.5, 0.1]))
    behind = "a cuboid with one corner behind the camera"
    yield behind, K, lying, np.array([0, 0, 0.25]), np.array([0.4, 0.4, 0.4]), origin, size
    yield "a cuboid around the camera", K, lying, np.array([0, 0, 0.02]), box, origin, size
    yield "a cuboid behind the camera", K, lying, -ahead, box, origin, size


check_cuboid_silhouette = Exercise(
    cuboid_silhouette,
    _cuboids,
    hints=(
        {
            "shape": "The size is (width, height); a picture has its rows first.",
            "beside the origin": "Where is the centre: in the frame of the object, or of the "
            "camera? So what is turned by R?",
            "turned": "Of a turned cuboid one sees up to three faces, and the outline has up to "
            "six corners.",
            "behind the camera": "Look at the depth of every corner, not of their mean.",
            "": "Eight corners, each with its own depth, have eight pixels. What lies between "
            "them, in a picture?",
        },
        "The corners are centre + signs * sides / 2, with all eight signs. Project them. "
        "scipy.spatial.ConvexHull(pixels).equations has a row (a, b, c) for each edge of the "
        "outline, and a x + b y + c <= 0 inside: a pixel is covered if that holds for all rows.",
    ),
    seconds=SECONDS,
)


# 3. One point in a volume -------------------------------------------------------------------------


def splat_point(point: Tensor, size: tuple[int, int, int]) -> Tensor:
    """(D, H, W): the shares of one point (3,) in the voxels around it."""
    x, y, z = (
        (1 - (torch.arange(count) - value).abs()).clamp(min=0)
        for value, count in zip(point, size, strict=True)
    )
    return z[:, None, None] * y[:, None] * x


def _points(rng: np.random.Generator) -> Inputs:
    def at(*values: float) -> Tensor:
        return torch.tensor(values, dtype=torch.float64, requires_grad=True)

    yield "a point at the centre of a voxel", at(2, 1, 0), (5, 4, 3)
    yield "a point between two voxels, along x", at(2.25, 1, 0), (5, 4, 3)
    yield "a point between two voxels, along y", at(2, 1.25, 0), (5, 4, 3)
    yield "a point between two voxels, along z", at(2, 1, 0.25), (5, 4, 3)
    yield "a point among eight voxels", at(1.3, 2.6, 0.8), (5, 4, 3)
    for size in ((4, 4, 4), (2, 6, 5), (7, 3, 2)):
        yield "a random point", at(*rng.uniform(0, np.array(size) - 1)), size
    yield "a point on the last voxel", at(4, 3, 2), (5, 4, 3)
    yield "a point a little outside, before the first voxels", at(-0.3, 1.4, -0.2), (5, 4, 3)
    yield "a point a little outside, after the last voxels", at(4.6, 3.2, 1.5), (5, 4, 3)
    yield "a point more than a voxel outside", at(1, -1.5, 1), (5, 4, 3)
    yield "a point as far outside as the grid is large", at(-5, -4, -3), (5, 4, 3)
    yield "a point that is nowhere", at(-1e4, -1e4, -1e4), (5, 4, 3)
    yield "a grid of one voxel", at(0.2, -0.4, 0.5), (1, 1, 1)


def _is_the_splat(answer: Tensor, point: Tensor, size: tuple[int, int, int]) -> str:
    expected = splat_point(point, size)
    if words := difference(answer.detach(), expected.detach(), 1e-6):
        return words
    off_centre = (point - point.round()).abs().min() > 1e-6  # at a centre each side has its own
    if not off_centre or not expected.detach().any():
        return ""
    probe = torch.rand(expected.shape, generator=torch.Generator().manual_seed(0)).to(expected)
    gradient = gradient_at_leaf((answer.to(probe) * probe).sum())
    if gradient is None:
        return "the volume is right, but no gradient can go back through it to the point"
    wanted = torch.autograd.grad((expected * probe).sum(), point)[0]
    if words := difference(gradient.to(wanted), wanted, 1e-4):
        return f"the volume is right, but not the gradient that comes back to the point: {words}"
    return ""


check_splat_point = Exercise(
    splat_point,
    _points,
    hints=(
        {
            "shape": "The size is (W, H, D), as x, y and z are; the volume is (D, H, W).",
            "gradient": "A gradient goes through arithmetic, and not through whole numbers, "
            ".item(), float(...) or torch.tensor(...).",
            "outside": "Which of the eight voxels are in the grid? And what is volume[-1]?",
            "on the last voxel": "Its neighbour to the right gets a share of 0. Is there one?",
            "": "Along each axis a point lies between two voxels, and gives the nearer one more.",
        },
        "Do one axis at a time, for all voxels of it: w_x = (1 - (torch.arange(W) - point[0])"
        ".abs()).clamp(min=0) has at most two entries that are not 0, and is 0 outside by itself. "
        "Then multiply: w_z[:, None, None] * w_y[:, None] * w_x.",
    ),
    judge=_is_the_splat,
    seconds=SECONDS,
)


# 4. The ray that stops ----------------------------------------------------------------------------


def terminate(occupancy: Tensor, intensity: Tensor) -> tuple[Tensor, Tensor]:
    """Silhouette and picture (H, W) of volumes (D, H, W), whose first slice is the nearest."""
    passed = torch.cumprod(1 - occupancy, 0)
    arriving = torch.cat([torch.ones_like(passed[:1]), passed[:-1]])[: len(passed)]
    return 1 - torch.prod(1 - occupancy, 0), (intensity * occupancy * arriving).sum(0)


def _volumes(rng: np.random.Generator) -> Inputs:
    def ray(*values: float) -> Tensor:
        return torch.tensor(values, dtype=torch.float64)[:, None, None]

    def some(*shape: int) -> Tensor:
        return torch.from_numpy(rng.uniform(0, 1, size=shape))

    yield "one slice", ray(0.25), ray(0.8)
    yield "two slices, the nearer one bright", ray(0.5, 0.5), ray(1, 0.1)
    yield "two slices, the farther one bright", ray(0.5, 0.5), ray(0.1, 1)
    yield "three slices", ray(0.2, 0.5, 0.25), ray(0.9, 0.4, 0.6)
    for shape in ((4, 2, 3), (3, 3, 3), (2, 5, 4)):
        yield "random volumes", some(*shape), some(*shape)
    yield "an opaque slice in front", ray(1, 0.5), ray(0.3, 0.9)
    yield "an opaque slice in the middle", ray(0.5, 1, 0.5), ray(0.3, 0.9, 0.4)
    yield "opaque slices only", ray(1, 1, 1), ray(0.3, 0.9, 0.4)
    yield "empty slices, which send no light", ray(0, 0.5, 0), ray(1, 0.4, 1)
    solid = torch.from_numpy(rng.integers(0, 2, size=(5, 4, 3)).astype(float))
    yield "volumes of 0 and 1", solid, some(5, 4, 3)
    yield "intensities above 1", some(3, 2, 2), 50 * some(3, 2, 2)
    yield "a hundred thin slices", 0.02 * some(100, 1, 2), some(100, 1, 2)
    yield "no slices at all", some(0, 2, 3), some(0, 2, 3)


check_terminate = Exercise(
    terminate,
    _volumes,
    hints=(
        {
            "opaque": "What does your formula do with an occupancy of 1? Are there log(0), 0 / 0?",
            "no slices": "Behind no slice at all, nothing has been stopped.",
            "two slices": "What is behind is seen through what is in front. How much of the light "
            "gets through?",
            "": "Walk along one ray, from the first slice on. Keep in a number how much light is "
            "left, 1 at first.",
        },
        "A loop over the slices will do: picture += left * occupancy[i] * intensity[i], and only "
        "then left = left * (1 - occupancy[i]). What is left at the end is 1 - silhouette.",
    ),
    tolerance=1e-4,  # an occupancy that is capped below 1, as in the library, is right
    seconds=SECONDS,
)


# 5. What silhouettes cannot tell ------------------------------------------------------------------


def same_silhouettes(solid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The largest volume (D, H, W) with the three silhouettes of a solid, and one of the least."""
    front, top, side = (solid.any(axis, keepdims=True) for axis in range(3))
    most = front & top & side
    least = most.copy()
    counts = [least.sum(axis) for axis in range(3)]
    # In the order of the array, a sheet would be left; at random, it is dust.
    for voxel in np.random.default_rng(0).permutation(np.argwhere(most)):
        rays = [tuple(np.delete(voxel, axis)) for axis in range(3)]
        if all(count[ray] > 1 for count, ray in zip(counts, rays, strict=True)):
            least[tuple(voxel)] = False
            for count, ray in zip(counts, rays, strict=True):
                count[ray] -= 1
    return most, least


def _solids(rng: np.random.Generator) -> Inputs:
    place = np.stack(np.meshgrid(*[np.arange(7) - 3] * 3, indexing="ij"))
    ball = (place**2).sum(0) < 10
    yield "a cube", np.ones((3, 3, 3), bool)
    yield "one voxel", np.arange(24).reshape(2, 3, 4) == 17
    yield "a ball", ball
    yield "a bowl", ball & ((place - [[[[0]]], [[[-3]]], [[[0]]]]) ** 2).sum(0) > 8
    yield "a box with a hollow in it", (np.abs(place) < 3).all(0) & (np.abs(place) > 1).any(0)
    yield "two voxels in opposite corners", np.arange(8).reshape(2, 2, 2) % 7 == 0
    yield (
        "a plate with a hole",
        np.pad(np.ones((1, 4, 5), bool), ((0, 1), (0, 0), (1, 0)))
        & (np.arange(48).reshape(2, 4, 6) != 9),
    )
    for shape, share in (((4, 5, 6), 0.05), ((6, 4, 5), 0.15), ((5, 5, 5), 0.3)):
        yield "random voxels", rng.random(shape) < share
    yield "nothing", np.zeros((3, 4, 2), bool)


def _have_the_silhouettes(answer: tuple[np.ndarray, np.ndarray], solid: np.ndarray) -> str:
    for name, volume in zip(("most", "least"), answer, strict=True):
        for axis in range(3):
            want, have = solid.any(axis), volume.any(axis)
            if (want != have).any():
                place = np.argwhere(want != have)[0].tolist()
                missing = "is missing" if want[tuple(place)] else "should not be there"
                return f"the silhouette of {name} along axis {axis} differs: {place} {missing}"
    most, least = answer
    if (lacking := same_silhouettes(solid)[0] & ~most).any():
        voxel = np.argwhere(lacking)[0].tolist()
        return f"most is not the largest: it lacks {voxel}, which no silhouette forbids"
    counts = [least.sum(axis, keepdims=True) for axis in range(3)]
    spare = least & (np.minimum(np.minimum(*counts[:2]), counts[2]) > 1)
    if spare.any():
        voxel = np.argwhere(spare)[0].tolist()
        return f"least has more than it needs: without {voxel} its silhouettes are the same"
    return ""


check_same_silhouettes = Exercise(
    same_silhouettes,
    _solids,
    hints=(
        {
            "most is not": "A voxel is forbidden if one of the silhouettes is empty where it "
            "would be seen. Which are not forbidden?",
            "of least": "Every voxel that goes makes others indispensable. Look again after each.",
            "least has": "A voxel is needed if it is alone on at least one of its three rays.",
            "": "A silhouette is volume.any(axis). Solve the two volumes one after the other.",
        },
        "most: solid.any(axis, keepdims=True) for the three axes, joined by &. least: begin with "
        "most and look at one voxel at a time, in any order. If there are others on all three of "
        "its rays, take it out at once.",
    ),
    judge=_have_the_silhouettes,
    seconds=SECONDS,
)
