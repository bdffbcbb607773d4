"""Clouds of points with the pose that they are to give: in the world's frame, which is the car's.

A cloud is either what a camera truly sees of head and glasses, from labels of depth, or what the
cloud estimator makes of its infrared image. Both have the same poses beside them, so that what is
lost in the cloud and what in the pose can be told apart.

Source: Firintepe et al., "From IR images to point clouds to pose", 2021, Sections 3.2 and 4.1.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from torch import Tensor

from data_tools.batches import Stack
from data_tools.batches.decoding import NONE
from posecore.arrays import fail, require_integer
from posecore.cameras import depth_to_points
from posecore.methods.infrared.clouds import CloudSet
from posecore.methods.infrared.triples import first_rows

__all__ = ["PoseClouds", "predicted_clouds", "visible_clouds", "visible_points"]


@dataclass(frozen=True, eq=False)
class PoseClouds:
    """V clouds of N points.

    Attributes:
        points: (V, N, 3) float32 metres in the world.
        worn: (V, N) bool, which points are of the glasses; None where nobody knows.
        R: (V, 3, 3) and t: (V, 3) float32, the pose of the glasses in the world.
        object_id: (V,) int64, which glasses.
        scene_id: (V,) int64, in `headset` the driver.
        view: (V,) int64, in the dataset.

    Raises:
        ValueError: if there are none, or naming what has another shape or dtype, or is not finite.
    """

    points: Tensor
    worn: Tensor | None
    R: Tensor
    t: Tensor
    object_id: Tensor
    scene_id: Tensor
    view: Tensor

    def __post_init__(self) -> None:
        for name, values in self._tensors().items():
            if not isinstance(values, Tensor):
                fail(name, "a tensor", type(values).__name__)
        if self.points.ndim != 3 or self.points.shape[-1] != 3 or not self.points.numel():
            fail(
                "points", "shape (V, N, 3), V and N at least 1", f"shape {tuple(self.points.shape)}"
            )
        for name, values in self._tensors().items():
            rest = {"points": self.points.shape[1:], "worn": self.points.shape[1:2]}
            rest |= {"R": (3, 3), "t": (3,)}
            shape = (len(self.points), *rest.get(name, ()))
            if values.shape != shape:
                fail(name, f"shape {shape}", f"shape {tuple(values.shape)}")
            dtypes = {"worn": torch.bool, **dict.fromkeys(("points", "R", "t"), torch.float32)}
            if values.dtype != (dtype := dtypes.get(name, torch.int64)):
                fail(name, dtype, values.dtype)
            if not values.isfinite().all():
                fail(name, "finite numbers", "others")

    def __len__(self) -> int:
        """How many clouds."""
        return len(self.points)

    def only(self, chosen: Tensor) -> PoseClouds:
        """Some of the clouds: those where (V,) booleans are True, or by their numbers.

        Raises:
            ValueError: if there are none.
        """
        return replace(self, **{name: values[chosen] for name, values in self._tensors().items()})

    def thinned(self, count: int, seed: int = 0) -> PoseClouds:
        """The same clouds of `count` of their points, drawn at random for each.

        Raises:
            ValueError: if they have not so many.
        """
        most = self.points.shape[1]
        require_integer("count", count, 1, most)
        generator = torch.Generator().manual_seed(require_integer("seed", seed, 0))
        order = torch.rand(len(self), most, generator=generator).argsort(1)[:, :count]
        points = self.points.gather(1, order[..., None].expand(-1, -1, 3))
        worn = None if self.worn is None else self.worn.gather(1, order)
        return replace(self, points=points, worn=worn)

    def _tensors(self) -> dict[str, Tensor]:
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: value for name, value in values.items() if value is not None}


def visible_clouds(data: Stack, count: int, seed: int = 0) -> PoseClouds:
    """Points of head and glasses that each camera sees, by the data's own depth.

    Args:
        data: with depth and masks; the first object of each view is the one whose pose is asked.
        count: N, drawn at random from what is seen; where less is seen some are drawn again. Views
            without any have no cloud.
        seed: of what is drawn.

    Raises:
        ValueError: if the data lack depth, masks or calibrated cameras, or nothing is seen at all.
    """
    for kind in ("depth", "instance"):
        if kind not in data.kinds:
            fail("data", f"images of {kind}", ", ".join(data.kinds) or "none")
    count = require_integer("count", count, 1)
    rng = np.random.default_rng(require_integer("seed", seed, 0))
    views, points, worn = [], [], []
    for view in range(len(data)):
        instance = data.image("instance", view)
        depth = data.image("depth", view).astype(np.float32) * np.float32(data.depth_step)
        found = visible_points(depth, instance != NONE, data.K[view].numpy(), count, rng)
        if found is not None:
            views.append(view)
            points.append(found[0])
            worn.append(instance[found[1]] == 0)
    if not views:
        fail("data", "a view in which something is seen", "none")
    which = torch.tensor(views)
    seen_by = torch.from_numpy(np.stack(points)).double()
    return _posed(data, which, seen_by, torch.from_numpy(np.stack(worn)))


def visible_points(
    depth: np.ndarray, mask: np.ndarray, K: np.ndarray, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]] | None:
    """Points of what a camera sees, drawn at random.

    Args:
        depth: (H, W) float32 metres, 0 for none.
        mask: (H, W) bool, of what they are to lie on.
        K: (3, 3) in pixels.
        count: N; where less is seen some are drawn again.
        rng: of what is drawn.

    Returns:
        (N, 3) metres in the camera's frame, and the rows and columns of their pixels, (N,) each;
        None, and nothing drawn, if nothing is seen.

    Raises:
        ValueError: for a mask of another shape, or a number that cannot be.
    """
    if mask.shape != depth.shape:
        fail("mask", f"shape {depth.shape}, that of depth", f"shape {mask.shape}")
    require_integer("count", count, 1)
    depth = np.where(mask, depth, np.float32(0))
    seen = np.nonzero(depth > 0)
    if not len(seen[0]):
        return None
    # In the order of the pixels, as `depth_to_points` has them.
    chosen = rng.choice(len(seen[0]), count, replace=len(seen[0]) < count)
    return depth_to_points(depth, K)[chosen], (seen[0][chosen], seen[1][chosen])


def predicted_clouds(data: Stack, clouds: CloudSet) -> PoseClouds:
    """What the cloud estimator made of the infrared images of the same data.

    Raises:
        ValueError: if the clouds are of other views or cameras, or cameras are not calibrated.
    """
    same = len(clouds) == len(data) and all(
        torch.equal(getattr(clouds, name), getattr(data, name)) for name in ("scene_id", "image_id")
    )
    if not same:
        fail("clouds", f"those of the {len(data)} views of the data", f"{len(clouds)} others")
    if data.T_world_cam is not None and not torch.equal(clouds.T_world_cam, data.T_world_cam):
        fail("clouds", "those of the cameras of the data", "some of other poses (T_world_cam)")
    seen = clouds.points.double() + clouds.t[:, None].double()
    return _posed(data, torch.arange(len(data)), seen, None)


def _posed(data: Stack, views: Tensor, seen: Tensor, worn: Tensor | None) -> PoseClouds:
    """Clouds (V, N, 3) in the frames of their cameras, in the world, with the poses there."""
    if data.T_world_cam is None:
        fail("data", "calibrated cameras (T_world_cam)", "none")
    rows, T = first_rows(data)[views], data.T_world_cam[views]
    R, t = T[:, :3, :3], T[:, :3, 3]
    return PoseClouds(
        points=(seen @ R.mT + t[:, None]).float(),
        worn=worn,
        R=(R @ data.R[rows]).float(),
        t=((R @ data.t[rows][..., None])[..., 0] + t).float(),
        object_id=data.object_id[rows],
        scene_id=data.scene_id[views],
        view=views,
    )
