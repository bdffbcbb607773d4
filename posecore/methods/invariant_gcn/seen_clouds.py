"""What a depth camera sees of things of known categories, as clouds with poses and sizes.

Source: Chen et al., the rotation-invariant paper, Section 3.4 (512 points from the masked depth
image) and the data of NOCS (Wang et al., CVPR 2019), whose rules for symmetric things these are: a
bottle, a bowl and a can have no front, and a mug none whose handle is not seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from torch import Tensor

from data_tools.batches import Stack
from posecore.arrays import fail, require_integer, require_number
from posecore.cameras import back_project
from posecore.clouds import farthest_point_sampling, gather_points
from posecore.methods.points_to_pose.pose_clouds import visible_points
from posecore.symmetry import turned_to_camera

__all__ = ["SYMMETRIC", "SeenClouds", "masked_points", "seen_clouds", "spread_points"]

SYMMETRIC = ("bottle", "bowl", "can")
"""Categories whose things are solids of revolution about y."""

SPARE = 1.25  # times as many points are drawn, to choose those that are spread from
HANDLE_SHARE = 0.003  # of a mug's pixels: below it nobody sees the handle
HANDLE_MARGIN = 0.004  # metres beyond the body
AT_ONCE = 64  # clouds


@dataclass(frozen=True, eq=False)
class SeenClouds:
    """V clouds of N points, each of one thing.

    Points come farthest first: a prefix is a coarser cloud, and copies come last.

    Attributes:
        points: (V, N, 3) float32 metres in the frame of the camera.
        canonical: (V, N, 3) float32 metres, where they are on the thing.
        R: (V, 3, 3), t: (V, 3), size: (V, 3) float32, pose and edges of the box, metres. Things of
            symmetric categories are turned so that the camera is on the side of z.
        category: (V,) int64 index into `categories`.
        symmetric: (V,) bool, whether the x axis means nothing: of those categories, and of mugs
            whose handle is not seen.
        revolution: (V,) bool, of those categories alone.
        object_id, view, row: (V,) int64, in the dataset.
        visible: (V,) float32 share of the silhouette that is seen.
        categories: their names.
    """

    points: Tensor
    canonical: Tensor
    R: Tensor
    t: Tensor
    size: Tensor
    category: Tensor
    symmetric: Tensor
    revolution: Tensor
    object_id: Tensor
    view: Tensor
    row: Tensor
    visible: Tensor
    categories: tuple[str, ...]

    def __len__(self) -> int:
        """How many clouds."""
        return len(self.points)

    def only(self, chosen: Tensor) -> SeenClouds:
        """Some of the clouds: those where (V,) booleans are True, or by their numbers.

        Raises:
            ValueError: if there are none.
        """
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        names = values.pop("categories")
        part = {name: value[chosen] for name, value in values.items()}
        if not len(part["points"]):
            fail("chosen", "one cloud or more", "none")
        return SeenClouds(**part, categories=names)

    def thinned(self, count: int) -> SeenClouds:
        """The same clouds of their first `count` points, which are spread over all of each.

        Raises:
            ValueError: if they have not so many.
        """
        require_integer("count", count, 1, self.points.shape[1])
        return replace(self, points=self.points[:, :count], canonical=self.canonical[:, :count])

    def mean_size(self) -> Tensor:
        """(C, 3) metres, of each category; where it has no cloud, of all.

        Those of a category are means over clouds, not over things.
        """
        found = []
        for number in range(len(self.categories)):
            own = self.size[self.category == number]
            found.append((own if len(own) else self.size).mean(0))
        return torch.stack(found)


def masked_points(
    depth: np.ndarray, mask: np.ndarray, K: np.ndarray, count: int, rng: np.random.Generator,
    *, reach: float = 0.25, least: int = 16,
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]] | None:  # fmt: skip
    """Points of one thing in a depth image, back-projected.

    Args:
        depth: (H, W) float32 metres, 0 for none.
        mask: (H, W) bool, where it is seen.
        K: (3, 3) in pixels.
        count: N, drawn at random; where fewer are seen some are drawn again.
        rng: of what is drawn.
        reach: metres from the median depth, beyond which points are of something else: a sensor
            mixes the depths of both sides of an edge.
        least: pixels that have to be left.

    Returns:
        (N, 3) metres in the camera's frame, and the rows and columns of their pixels, (N,) each;
        None if too little is seen.

    Raises:
        ValueError: for a mask of another shape, or a number that cannot be.
    """
    require_number("reach", reach, above=0)
    require_integer("least", least, 1)
    if mask.shape != depth.shape:
        fail("mask", f"shape {depth.shape}, that of depth", f"shape {mask.shape}")
    seen = mask & (depth > 0)
    if not seen.any():
        return None
    near = seen & (np.abs(depth - np.median(depth[seen])) < reach)
    if near.sum() < least:
        return None
    return visible_points(depth, near, K, count, rng)


def spread_points(points: Tensor, count: int) -> Tensor:
    """(B, M, 3) to (B, count) int64: the farthest first, the nearest to the mean before all.

    Raises:
        ValueError: if there are not so many.
    """
    found = []
    for part in points.split(AT_ONCE):
        # Begin with the point in the middle, whatever was drawn first.
        middle = (part - part.mean(1, keepdim=True)).square().sum(-1).argmin(1)
        order = torch.arange(part.shape[1]).repeat(len(part), 1)
        order[:, 0], order[torch.arange(len(part)), middle] = middle, 0
        chosen = farthest_point_sampling(gather_points(part, order), count)
        found.append(order.gather(1, chosen))
    return torch.cat(found)


def seen_clouds(
    data: Stack, count: int, *, rows: Tensor | None = None, seed: int = 0, reach: float = 0.25,
    least: int = 16, symmetric: Sequence[str] = SYMMETRIC,
) -> SeenClouds:  # fmt: skip
    """What the depth camera sees of each thing, by the data's masks.

    Canonical points are those of the exact surface where the data know it, else of what the camera
    measured.

    Args:
        data: with depth, masks, categories and sizes.
        count: N.
        rows: (M,) of the table of objects; None for all that are seen.
        seed, reach, least: as of `masked_points`, for one after the other. Of what is seen less
            there is no cloud.
        symmetric: categories of solids of revolution about y.

    Raises:
        ValueError: if the data lack something, or nothing is seen at all.
    """
    for kind in ("depth", "instance"):
        if kind not in data.kinds:
            fail("data", f"images of {kind}", ", ".join(data.kinds) or "none")
    if data.categories is None or data.object_size is None:
        fail("data", "objects with category and size", "others")
    count = require_integer("count", count, 3)
    rng = np.random.default_rng(require_integer("seed", seed, 0))
    rows = data.rows() if rows is None else rows
    chosen, points, exact = [], [], []
    for row in rows.tolist():
        view = int(data.view[row])
        depth = data.image("depth", view).astype(np.float32) * np.float32(data.depth_step)
        mask = data.image("instance", view) == int(data.slot[row])
        K = data.K[view].numpy()
        drawn = int(np.ceil(SPARE * count))
        found = masked_points(depth, mask, K, drawn, rng, reach=reach, least=least)
        if found is None:
            continue
        chosen.append(row)
        points.append(found[0])
        exact.append(_on_surface(data, view, found, K))
    if not chosen:
        fail("data", "an object of which something is seen", "none")
    where = torch.tensor(chosen)
    seen = torch.from_numpy(np.stack(points)).double()
    surface = torch.from_numpy(np.stack(exact)).double()
    order = spread_points(seen, count)
    return _posed(data, where, gather_points(seen, order), gather_points(surface, order), symmetric)


def _on_surface(data: Stack, view: int, found: tuple, K: np.ndarray) -> np.ndarray:
    """(N, 3) metres in the camera's frame, exact where the data know it."""
    points, pixels = found
    if "surface" not in data.kinds:
        return points
    z = data.image("surface", view)[pixels].astype(np.float64) * data.depth_step
    # The ray through a pixel is that of its measured point.
    return np.where(z > 0, z, points[:, 2])[:, None] / points[:, 2:] * points


def _posed(
    data: Stack, rows: Tensor, points: Tensor, surface: Tensor, symmetric: Sequence[str]
) -> SeenClouds:
    R, t, size = data.R[rows], data.t[rows], data.object_size[rows]
    numbers = [data.categories.index(name) for name in symmetric if name in data.categories]
    category = data.category[rows]
    revolution = torch.isin(category, torch.tensor(numbers, dtype=torch.int64))
    up, front = torch.eye(3).double()[[1, 2]]
    R = torch.where(revolution[:, None, None], turned_to_camera(R, t, up, front), R)
    canonical = (surface - t[:, None]) @ R
    known = data.visible_fraction
    visible = torch.full((len(rows),), 1.0) if known is None else known[rows].float()
    handle = _shows_handle(data, rows)
    return SeenClouds(
        points=points.float(), canonical=canonical.float(), R=R.float(), t=t.float(),
        size=size.float(), category=category, symmetric=revolution | ~handle,
        revolution=revolution, object_id=data.object_id[rows], view=data.view[rows], row=rows,
        visible=visible, categories=tuple(data.categories),
    )  # fmt: skip


def _shows_handle(data: Stack, rows: Tensor) -> Tensor:
    """(V,) bool: False for mugs of whose handle, along x, nobody sees anything."""
    found = torch.ones(len(rows), dtype=torch.bool)
    if "mug" not in data.categories or "surface" not in data.kinds:
        return found
    for i in (data.category[rows] == data.categories.index("mug")).nonzero()[:, 0].tolist():
        row = int(rows[i])
        view = int(data.view[row])
        mask = data.image("instance", view) == int(data.slot[row])
        depth = data.image("surface", view).astype(np.float64) * data.depth_step
        points = back_project(np.where(mask, depth, 0), data.K[view].numpy())[mask]
        x = ((points - data.t[row].numpy()) @ data.R[row].numpy())[:, 0]
        size = data.object_size[row].numpy()
        beyond = -size[0] / 2 + size[2] + HANDLE_MARGIN  # the body is as wide as it is deep
        found[i] = bool((x > beyond).mean() > HANDLE_SHARE)
    return found
