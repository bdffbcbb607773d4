"""Chapter 3's exercises, solved as students would: rightly and wrongly."""

from typing import Any

import cv2
import numpy as np
import torch
from scipy import ndimage
from scipy.spatial import ConvexHull
from torch import Tensor

from book.ch03_infrared_to_clouds import checks
from tests.book.exercises import Solutions

SOLUTIONS = Solutions()
right, wrong = SOLUTIONS.right, SOLUTIONS.wrong


# 1. One step of Li's iteration --------------------------------------------------------------------


def li(values: Any, threshold: float, is_dark: Any = None, mean: Any = None) -> float:
    is_dark = values <= threshold if is_dark is None else is_dark
    dark, bright = values[is_dark], values[~is_dark]
    if not dark.size or not bright.size:
        return float(threshold)
    m0, m1 = (np.mean if mean is None else mean)(dark), (np.mean if mean is None else mean)(bright)
    m0 = max(float(m0), 1e-12 * float(m1))
    return float((m1 - m0) / (np.log(float(m1)) - np.log(m0)))


@right("li_update")
def li_one_by_one(values: Any, threshold: float) -> float:
    sides = [], []
    for value in values.ravel().tolist():
        sides[value > threshold].append(value)
    if not sides[0] or not sides[1]:
        return threshold
    m0, m1 = (sum(side) / len(side) for side in sides)
    return (m1 - m0) / np.log(m1 / max(m0, 1e-12 * m1)) if m0 else m1 / np.log(1e12)


@wrong("li_update", "a value that is the threshold", "got")
def li_with_the_threshold_above(values: Any, threshold: float) -> float:
    return li(values, threshold, values < threshold)


@wrong("li_update", "four values, two on each side", "got 6")
def li_as_midpoint(values: Any, threshold: float) -> float:
    return float(values[values <= threshold].mean() + values[values > threshold].mean()) / 2


@wrong("li_update", "four values, two on each side", "got")
def li_with_another_logarithm(values: Any, threshold: float) -> float:
    return li(values, threshold) * np.log(10)


@wrong("li_update", "the same values, another threshold", "got")
def li_to_the_end(values: Any, threshold: float) -> float:
    for _ in range(100):
        threshold = li(values, threshold)
    return threshold


@wrong("li_update", "four values, two on each side", "got")
def li_moved_to_begin_at_0(values: Any, threshold: float) -> float:
    low = values.min()
    return li(values - low, threshold - low) + float(low)


@wrong("li_update", "a picture of bytes", "got")
def li_with_sums_of_bytes(values: Any, threshold: float) -> float:
    def mean(side: Any) -> float:
        total = side.dtype.type(0)
        with np.errstate(over="ignore"):
            for value in side:
                total = total + value
        return float(total) / len(side)

    return li(values, threshold, mean=mean)


@wrong("li_update", "brightness from 0 to 1", "got 0")
def li_with_a_whole_threshold(values: Any, threshold: float) -> float:
    return li(values, int(threshold))


@wrong("li_update", "pictures of 12 bits", "got")
def li_of_a_histogram_of_bytes(values: Any, threshold: float) -> float:
    if values.dtype == np.uint8 or (values % 1 == 0).all():
        counts = np.bincount(values.ravel().astype(int).clip(0, 255), minlength=256)
        return li(np.repeat(np.arange(256), counts), threshold)
    return li(values, threshold)


@wrong("li_update", "only 0 below", "got 0")
def li_with_the_limit(values: Any, threshold: float) -> float:
    if (values <= threshold).any() and not values[values <= threshold].any():
        return 0.0
    return li(values, threshold)


@wrong("li_update", "nothing above the threshold", "got nan")
def li_with_an_empty_side(values: Any, threshold: float) -> float:
    m1 = values[values > threshold].astype(float).mean()
    m0 = max(values[values <= threshold].astype(float).mean(), 1e-12 * m1)
    return float((m1 - m0) / np.log(m1 / m0))


# 2. The cuboid's silhouette -----------------------------------------------------------------------


def corners(R: Any, t: Any, sides: Any, centre: Any) -> np.ndarray:
    signs = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    X = (centre + signs * sides / 2) @ R.T + t
    if (X[:, 2] <= 0).any():
        raise ValueError("behind the camera")
    return X


def covered(pixels: np.ndarray, size: Any, shift: float = 0) -> np.ndarray:
    equations = ConvexHull(pixels).equations
    x, y = np.meshgrid(np.arange(size[0]) + shift, np.arange(size[1]) + shift)
    return (np.stack([x, y], -1) @ equations[:, :2].T + equations[:, 2] <= 0).all(-1)


def project(K: Any, X: Any) -> np.ndarray:
    return (X @ K.T)[:, :2] / X[:, 2:]


@right("cuboid_silhouette")
def cuboid_by_slabs(K: Any, R: Any, t: Any, sides: Any, centre: Any, size: Any) -> np.ndarray:
    corners(R, t, sides, centre)
    x, y = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(K).T @ R
    camera = -R.T @ t - centre
    with np.errstate(divide="ignore"):
        ends = np.stack([(sign * sides / 2 - camera) / rays for sign in (-1, 1)])
    return ends.min(0).max(-1) <= ends.max(0).min(-1)


@right("cuboid_silhouette")
def cuboid_by_turns(K: Any, R: Any, t: Any, sides: Any, centre: Any, size: Any) -> np.ndarray:
    pixels = project(K, corners(R, t, sides, centre))
    outline = pixels[ConvexHull(pixels).vertices]
    mask = np.zeros((size[1], size[0]), bool)
    for v, u in np.ndindex(mask.shape):
        a, b = outline - [u, v], np.roll(outline, -1, axis=0) - [u, v]
        mask[v, u] = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] >= 0).all()
    return mask


def cuboid(K: Any, R: Any, t: Any, sides: Any, centre: Any, size: Any) -> np.ndarray:
    return covered(project(K, corners(R, t, sides, centre)), size)


@wrong("cuboid_silhouette", "a turned cuboid", "got")
def cuboid_as_a_rectangle(K: Any, R: Any, t: Any, sides: Any, centre: Any, size: Any) -> Any:
    pixels = project(K, corners(R, t, sides, centre))
    x, y = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    (left, top), (right, low) = pixels.min(0), pixels.max(0)
    return (x >= left) & (x <= right) & (y >= top) & (y <= low)


@wrong("cuboid_silhouette", "a cuboid straight ahead", "got")
def cuboid_of_twice_the_size(K: Any, R: Any, t: Any, sides: Any, centre: Any, size: Any) -> Any:
    return cuboid(K, R, t, 2 * sides, centre, size)


@wrong("cuboid_silhouette", "a cuboid straight ahead", "shape")
def cuboid_in_columns(K: Any, R: Any, t: Any, sides: Any, centre: Any, size: Any) -> Any:
    return cuboid(K, R, t, sides, centre, size).T


@wrong("cuboid_silhouette", "a deep cuboid", "got")
def cuboid_at_one_depth(K: Any, R: Any, t: Any, sides: Any, centre: Any, size: Any) -> Any:
    X = corners(R, t, sides, centre)
    return covered((X @ K.T)[:, :2] / X[:, 2].mean(), size)


@wrong("cuboid_silhouette", "a camera with fx and fy apart", "got")
def cuboid_with_fx_alone(K: Any, R: Any, t: Any, sides: Any, centre: Any, size: Any) -> Any:
    X = corners(R, t, sides, centre)
    return covered(K[0, 0] * X[:, :2] / X[:, 2:] + K[:2, 2], size)


@wrong("cuboid_silhouette", "a centre beside the origin", "got")
def cuboid_around_the_origin(K: Any, R: Any, t: Any, sides: Any, centre: Any, size: Any) -> Any:
    return cuboid(K, R, t, sides, 0 * centre, size)


@wrong("cuboid_silhouette", "a turned cuboid, its centre beside the origin", "got")
def cuboid_centred_in_the_camera(K: Any, R: Any, t: Any, sides: Any, centre: Any, size: Any) -> Any:
    return cuboid(K, R, t + centre, sides, 0 * centre, size)


@wrong("cuboid_silhouette", "a turned cuboid", "got")
def cuboid_turned_back(K: Any, R: Any, t: Any, sides: Any, centre: Any, size: Any) -> Any:
    return cuboid(K, R.T, t, sides, centre, size)


@wrong("cuboid_silhouette", "a turned cuboid", "got")
def cuboid_of_its_front_face(K: Any, R: Any, t: Any, sides: Any, centre: Any, size: Any) -> Any:
    X = corners(R, t, sides, centre)
    return covered(project(K, X[X[:, 2].argsort()[:4]]), size)


@wrong("cuboid_silhouette", "a principal point that is not in the middle", "got")
def cuboid_in_the_middle(K: Any, R: Any, t: Any, sides: Any, centre: Any, size: Any) -> Any:
    K = np.array(
        [[K[0, 0], K[0, 1], size[0] / 2 - 0.5], [0, K[1, 1], size[1] / 2 - 0.5], [0, 0, 1]]
    )
    return cuboid(K, R, t, sides, centre, size)


@wrong("cuboid_silhouette", "a camera with skew", "got")
def cuboid_without_skew(K: Any, R: Any, t: Any, sides: Any, centre: Any, size: Any) -> Any:
    return cuboid(K * [[1, 0, 1], [1, 1, 1], [1, 1, 1]], R, t, sides, centre, size)


@wrong("cuboid_silhouette", "a cuboid straight ahead", "got")
def cuboid_from_corners_of_pixels(
    K: Any, R: Any, t: Any, sides: Any, centre: Any, size: Any
) -> np.ndarray:
    return covered(project(K, corners(R, t, sides, centre)), size, 0.5)


@wrong("cuboid_silhouette", "a cuboid straight ahead", "got")
def cuboid_filled_by_opencv(K: Any, R: Any, t: Any, sides: Any, centre: Any, size: Any) -> Any:
    pixels = project(K, corners(R, t, sides, centre)).round().astype(np.int32)
    mask = np.zeros((size[1], size[0]), np.uint8)
    return cv2.fillConvexPoly(mask, cv2.convexHull(pixels), 1) > 0


@wrong("cuboid_silhouette", "an image that is higher than wide", "shape")
def cuboid_of_a_fixed_image(K: Any, R: Any, t: Any, sides: Any, centre: Any, size: Any) -> Any:
    return cuboid(K, R, t, sides, centre, (20, 16))


@wrong("cuboid_silhouette", "a cuboid with one corner behind the camera", "expected a ValueError")
def cuboid_judged_by_its_mean(K: Any, R: Any, t: Any, sides: Any, centre: Any, size: Any) -> Any:
    if (R @ centre + t)[2] <= 0:
        raise ValueError("behind the camera")
    X = corners(R, t + [0, 0, 9], sides, centre) - [0, 0, 9]
    return covered(project(K, X), size)


# 3. One point in a volume -------------------------------------------------------------------------


def splat(point: Any, size: Any, inside: Any = None, weight: Any = None) -> Tensor:
    """By a loop over the eight corners."""
    W, H, D = size
    volume = torch.zeros(D, H, W)
    low = point.floor()
    for step in np.ndindex(2, 2, 2):
        corner = low + torch.tensor(step)
        share = (1 - (point - corner).abs()).prod() if weight is None else weight(point, corner)
        i, j, k = (int(c) for c in corner)
        if (inside or is_inside)((i, j, k), size):
            volume[k, j, i] = volume[k, j, i] + share
    return volume


def is_inside(corner: Any, size: Any) -> bool:
    return all(0 <= c < n for c, n in zip(corner, size, strict=True))


@right("splat_point")
def splat_by_corners(point: Any, size: Any) -> Tensor:
    return splat(point, size)


@right("splat_point")
def splat_at_all_voxels(point: Any, size: Any) -> Tensor:
    grid = torch.meshgrid(*(torch.arange(n) for n in size), indexing="ij")
    away = (point[:, None, None, None] - torch.stack(grid)).abs()
    return torch.where(away < 1, 1 - away, 0).prod(0).permute(2, 1, 0)


@wrong("splat_point", "a point at the centre of a voxel", "shape")
def splat_of_another_order(point: Any, size: Any) -> Tensor:
    return checks.splat_point(point, size).permute(2, 1, 0)


@wrong("splat_point", "a point at the centre of a voxel", "shape")
def splat_of_a_size_of_rows(point: Any, size: Any) -> Tensor:
    return splat(point.flip(0), size[::-1])


@wrong("splat_point", "a point at the centre of a voxel", "got")
def splat_around_corners_of_voxels(point: Any, size: Any) -> Tensor:
    return splat(point - 0.5, size)


@wrong("splat_point", "a point between two voxels, along x", "got")
def splat_into_the_nearest(point: Any, size: Any) -> Tensor:
    return splat(point.round(), size)


@wrong("splat_point", "a point at the centre of a voxel", "got")
def splat_the_other_way_round(point: Any, size: Any) -> Tensor:
    return splat(point, size, weight=lambda p, c: (p - c).abs().prod())


@wrong("splat_point", "a point among eight voxels", "got")
def splat_by_distance(point: Any, size: Any) -> Tensor:
    return splat(point, size, weight=lambda p, c: (1 - (p - c).norm()).clamp(min=0))


@wrong("splat_point", "a point among eight voxels", "no gradient")
def splat_of_numbers(point: Any, size: Any) -> Tensor:
    return checks.splat_point(point.detach(), size)


@wrong("splat_point", "a point among eight voxels", "not the gradient")
def splat_with_half_a_gradient(point: Any, size: Any) -> Tensor:
    x, y, z = point
    return checks.splat_point(torch.stack([x, y.detach(), z]), size)


@wrong("splat_point", "a point on the last voxel", "it raised IndexError")
def splat_beyond_the_last_voxel(point: Any, size: Any) -> Tensor:
    return splat(point, size, lambda corner, size: min(corner) >= 0)


@wrong("splat_point", "a point a little outside, before the first voxels", "got")
def splat_around_the_border(point: Any, size: Any) -> Tensor:
    return splat(
        point, size, lambda corner, size: all(c < n for c, n in zip(corner, size, strict=True))
    )


@wrong("splat_point", "a point a little outside, before the first voxels", "got")
def splat_moved_to_the_border(point: Any, size: Any) -> Tensor:
    last = torch.tensor(size) - 1.0
    return splat(torch.minimum(point.clamp(min=0), last), size)


@wrong("splat_point", "a point a little outside, before the first voxels", "got")
def splat_of_what_is_inside(point: Any, size: Any) -> Tensor:
    inside = bool(((point >= 0) & (point <= torch.tensor(size) - 1)).all())
    return checks.splat_point(point, size) if inside else torch.zeros(size[::-1])


# 4. The ray that stops ----------------------------------------------------------------------------


@right("terminate")
def terminate_by_logs(occupancy: Any, intensity: Any) -> Any:
    logs = torch.log1p(-occupancy)
    before = torch.cat([torch.zeros_like(logs[:1]), logs])[:-1].cumsum(0)
    if not len(logs):
        before = logs
    return 1 - logs.sum(0).exp(), (intensity * occupancy * before.exp()).sum(0)


@right("terminate")
def terminate_from_behind(occupancy: Any, intensity: Any) -> Any:
    silhouette = picture = torch.zeros(occupancy.shape[1:])
    for o, c in zip(occupancy.flip(0), intensity.flip(0), strict=True):
        silhouette, picture = o + (1 - o) * silhouette, o * c + (1 - o) * picture
    return silhouette, picture


def seen(occupancy: Any, intensity: Any, arriving: Any) -> Any:
    return 1 - (1 - occupancy).prod(0), (intensity * occupancy * arriving).sum(0)


def arriving(occupancy: Any) -> Tensor:
    return torch.cat([torch.ones_like(occupancy[:1]), 1 - occupancy])[:-1].cumprod(0)


@wrong("terminate", "one slice", "in result [1]")
def terminate_dimming_itself(occupancy: Any, intensity: Any) -> Any:
    return seen(occupancy, intensity, (1 - occupancy).cumprod(0))


@wrong("terminate", "one slice", "in result [1]")
def terminate_without_occupancy(occupancy: Any, intensity: Any) -> Any:
    return seen(occupancy, intensity, arriving(occupancy) / occupancy)


@wrong("terminate", "two slices, the nearer one bright", "in result [1]")
def terminate_from_the_wrong_end(occupancy: Any, intensity: Any) -> Any:
    return terminate_from_behind(occupancy.flip(0), intensity.flip(0))


@wrong("terminate", "two slices, the nearer one bright", "in result [1]")
def terminate_without_order(occupancy: Any, intensity: Any) -> Any:
    return seen(occupancy, intensity, torch.ones_like(occupancy))


@wrong("terminate", "one slice", "in result [1]")
def terminate_as_a_mean(occupancy: Any, intensity: Any) -> Any:
    silhouette, picture = terminate_from_behind(occupancy, intensity)
    return silhouette, picture / silhouette


@wrong("terminate", "two slices, the nearer one bright", "in result [0]")
def terminate_as_a_maximum(occupancy: Any, intensity: Any) -> Any:
    return occupancy.amax(0), seen(occupancy, intensity, arriving(occupancy))[1]


@wrong("terminate", "two slices, the nearer one bright", "in result [0]")
def terminate_as_a_sum(occupancy: Any, intensity: Any) -> Any:
    return occupancy.sum(0).clamp(max=1), seen(occupancy, intensity, arriving(occupancy))[1]


@wrong("terminate", "two slices, the nearer one bright", "in result [1]")
def terminate_seeing_the_brightest(occupancy: Any, intensity: Any) -> Any:
    silhouette = terminate_from_behind(occupancy, intensity)[0]
    return silhouette, (occupancy * intensity * arriving(occupancy)).amax(0)


@wrong("terminate", "three slices", "in result [1]")
def terminate_seeing_one_slice_before(occupancy: Any, intensity: Any) -> Any:
    before = torch.cat([torch.ones_like(occupancy[:1]), 1 - occupancy])[:-1]
    return seen(occupancy, intensity, before)


@wrong("terminate", "two slices, the nearer one bright", "shape")
def terminate_along_the_rows(occupancy: Any, intensity: Any) -> Any:
    return terminate_from_behind(occupancy.movedim(-1, 0), intensity.movedim(-1, 0))


@wrong("terminate", "an opaque slice in front", "nan")
def terminate_by_division(occupancy: Any, intensity: Any) -> Any:
    return seen(occupancy, intensity, (1 - occupancy).cumprod(0) / (1 - occupancy))


@wrong("terminate", "an opaque slice in front", "nan")
def terminate_by_differences_of_logs(occupancy: Any, intensity: Any) -> Any:
    logs = (1 - occupancy).log()
    return seen(occupancy, intensity, (logs.cumsum(0) - logs).exp())


@wrong("terminate", "no slices at all", "it raised IndexError")
def terminate_beginning_at_the_first(occupancy: Any, intensity: Any) -> Any:
    left, picture = 1 - occupancy[0], occupancy[0] * intensity[0]
    for o, c in zip(occupancy[1:], intensity[1:], strict=True):
        left, picture = left * (1 - o), picture + left * o * c
    return 1 - left, picture


# 5. What silhouettes cannot tell ------------------------------------------------------------------


def hull(solid: Any) -> np.ndarray:
    return solid.any(0)[None] & solid.any(1)[:, None] & solid.any(2)[:, :, None]


def thinned(volume: Any, left: int = 1) -> np.ndarray:
    least = volume.copy()
    for k, j, i in np.argwhere(volume):
        if min(least[:, j, i].sum(), least[k, :, i].sum(), least[k, j].sum()) > left:
            least[k, j, i] = False
    return least


@right("same_silhouettes")
def silhouettes_in_order(solid: Any) -> Any:
    return hull(solid), thinned(hull(solid))


@right("same_silhouettes")
def silhouettes_of_the_solid_itself(solid: Any) -> Any:
    """By voxels that are asked one by one, and with a part of the solid that is left."""
    most, least = np.zeros_like(solid), solid.copy()
    for k, j, i in np.ndindex(solid.shape):
        most[k, j, i] = solid[:, j, i].any() and solid[k, :, i].any() and solid[k, j].any()
    for voxel in np.argwhere(solid)[::-1]:
        without = least.copy()
        without[tuple(voxel)] = False
        if all((without.any(axis) == solid.any(axis)).all() for axis in range(3)):
            least = without
    return most, least


@wrong("same_silhouettes", "a ball", "most is not the largest")
def silhouettes_of_a_solid_that_stays(solid: Any) -> Any:
    return solid.copy(), thinned(solid)


@wrong("same_silhouettes", "a ball", "the silhouette of most along axis 0 differs")
def silhouettes_of_a_box(solid: Any) -> Any:
    most = np.zeros_like(solid)
    if solid.any():
        low, high = np.argwhere(solid).min(0), np.argwhere(solid).max(0) + 1
        most[tuple(slice(a, b) for a, b in zip(low, high, strict=True))] = True
    return most, thinned(solid)


@wrong("same_silhouettes", "a ball", "the silhouette of most along axis 1 differs")
def silhouettes_of_two_views(solid: Any) -> Any:
    return solid.any(0)[None] & solid.any(2)[:, :, None], thinned(solid)


@wrong("same_silhouettes", "a ball", "most is not the largest")
def silhouettes_with_holes_filled(solid: Any) -> Any:
    return ndimage.binary_fill_holes(solid), thinned(solid)


@wrong("same_silhouettes", "a cube", "least has more than it needs")
def silhouettes_of_a_shell(solid: Any) -> Any:
    inner = ndimage.binary_erosion(solid)
    return hull(solid), solid & ~inner


@wrong("same_silhouettes", "a cube", "the silhouette of least along axis 0 differs")
def silhouettes_thinned_at_once(solid: Any) -> Any:
    most = hull(solid)
    counts = [most.sum(axis, keepdims=True) for axis in range(3)]
    return most, most & (np.minimum(np.minimum(*counts[:2]), counts[2]) == 1)


@wrong("same_silhouettes", "a cube", "the silhouette of least along axis 0 differs")
def silhouettes_of_the_diagonal(solid: Any) -> Any:
    least = np.zeros_like(solid)
    for n in range(min(solid.shape)):
        least[n, n, n] = True
    return hull(solid), least & hull(solid)


@wrong("same_silhouettes", "a cube", "least has more than it needs")
def silhouettes_of_two_voxels_a_ray(solid: Any) -> Any:
    return hull(solid), thinned(solid, 2)


@wrong("same_silhouettes", "a cube", "it changes its solid")
def silhouettes_in_place(solid: Any) -> Any:
    most = hull(solid)
    solid[:] = thinned(solid)
    return most, solid


@wrong("same_silhouettes", "a cube", "whole numbers")
def silhouettes_of_numbers(solid: Any) -> Any:
    return hull(solid).astype(int), thinned(solid).astype(int)
