"""Instants that several cameras see, as the cloud estimator learns from them."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable

import cv2
import numpy as np
import torch
from torch import Tensor

from data_tools.batches import Stack
from data_tools.batches.decoding import NONE
from data_tools.batches.memory import require_bytes
from posecore.arrays import fail, require_choice, require_integer
from posecore.cameras import resize_intrinsics
from posecore.methods.infrared.masks import object_mask
from posecore.rotations import axis_angle_to_matrix

__all__ = ["MASKS", "Triples"]

MASKS = ("threshold", "exact")
"""What a mask is: what is above Li's threshold within the cuboid, or what the data say it is."""


class Triples:
    """Images, masks and poses of the views of each instant, made once and kept in memory.

    Args:
        data: of infrared views in groups of equal size, each with the objects' pose; for exact
            masks with those.
        image: (width, height) to which images are reduced.
        grid: (width, height) to which masks are.
        masks: one of `MASKS`.
        mask_of: `mask_of(image, K, R, t)` gives the mask of an image (H, W) in place of `masks`.

    Attributes:
        images: (G, J, 1, h, w) uint8.
        masks: (G, J, H, W) uint8, 255 where a pixel is all object.
        shades: (G, J, H, W) uint8, the image within its mask.
        K: (G, J, 3, 3) float32, of the images as the data have them.
        T_world_cam: (G, J, 4, 4) float32.
        R: (G, J, 3, 3) and t: (G, J, 3) float32, the pose of the glasses in each camera's frame.
        views: (G, J) int64 views in the data.
        size: (width, height) of the images as the data have them.

    Raises:
        ValueError: if the data lack what is needed, or it does not fit into memory.
    """

    def __init__(
        self,
        data: Stack,
        *,
        image: tuple[int, int],
        grid: tuple[int, int],
        masks: str = "threshold",
        mask_of: Callable[..., np.ndarray] | None = None,
    ) -> None:
        require_choice("masks", masks, MASKS)
        if "ir" not in data.kinds:
            fail("data", "infrared images", ", ".join(data.kinds) or "none")
        if data.T_world_cam is None:
            fail("data", "calibrated cameras (T_world_cam)", "none")
        exact = mask_of is None and masks == "exact"
        if exact and "instance" not in data.kinds:
            fail("data", "masks, or masks='threshold'", ", ".join(data.kinds))
        self.views, self.size = data.groups, data.size
        groups, count = self.views.shape
        total = groups * count * (image[0] * image[1] + 2 * grid[0] * grid[1])
        require_bytes("data", "images that fit into", f"{len(data)} images", total)
        self.images = torch.empty(groups, count, 1, image[1], image[0], dtype=torch.uint8)
        self.masks = torch.empty(groups, count, grid[1], grid[0], dtype=torch.uint8)
        self.shades = torch.empty_like(self.masks)
        rows = first_rows(data)[self.views]
        self.K, self.T_world_cam = data.K[self.views].float(), data.T_world_cam[self.views].float()
        self.R, self.t = data.R[rows].float(), data.t[rows].float()
        data.check(self.views.flatten())
        for g, views in enumerate(self.views.tolist()):
            for j, view in enumerate(views):
                picture = data.image("ir", view)
                if exact:
                    mask = data.image("instance", view) != NONE
                else:
                    row = rows[g, j]
                    pose = data.K[view].numpy(), data.R[row].numpy(), data.t[row].numpy()
                    mask = (mask_of or object_mask)(picture, *pose)
                inside = np.where(mask, picture, 0).astype(np.float32)
                self.images[g, j, 0] = reduced(picture.astype(np.float32), image)
                self.masks[g, j] = reduced(mask.astype(np.float32) * 255, grid)
                self.shades[g, j] = reduced(inside, grid)

    def __len__(self) -> int:
        """How many instants."""
        return len(self.views)

    def only(self, chosen: Tensor) -> Triples:
        """Some of the instants: those where (G,) booleans are True, or by their numbers.

        Raises:
            ValueError: if there are none.
        """
        part = copy.copy(self)
        for name in ("images", "masks", "shades", "K", "T_world_cam", "R", "t", "views"):
            setattr(part, name, getattr(self, name)[chosen])
        if not len(part):
            fail("chosen", "one instant or more", "none")
        return part

    def brightness(self) -> tuple[float, float]:
        """Mean and standard deviation of the images, of 0 to 1."""
        return brightness(self.images)

    def draw(
        self,
        *,
        generator: torch.Generator,
        count: int,
        views: int | None = None,
        own: bool = True,
        looks: int | None = None,
        turn: float = 0.0,
        mirror: bool = False,
    ) -> dict[str, Tensor]:
        """A batch of `count` instants, one view of each drawn to be the network's input.

        Args:
            generator: of random numbers.
            count: B.
            views: V, how many views teach of an input: its own, the next camera's, and so on in
                turns; None for all.
            own: whether the input's own view is one of these.
            looks: S, at how many of these, drawn anew, the losses look in a step; None for all, in
                their order. Few are an unbiased estimate of all, and cost less.
            turn: degrees by which the input's camera is turned at most, about each of its axes: its
                image is warped, and pose and translation follow exactly.
            mirror: whether half of the instants are mirrored, cameras and all.

        Returns:
            - "images" (B, 1, h, w) float32, 0 to 1;
            - "t" (B, 3) metres, and "own" (B, 4, 4), the pose of the input's camera;
            - "masks", "shades" (B, S, H, W) float32, 0 to 1;
            - "K" (B, S, 3, 3), "T_world_cam" (B, S, 4, 4).

        Raises:
            ValueError: if there are not so many views.
        """
        cameras, first = self.views.shape[1], 0 if own else 1
        views = cameras if views is None else require_integer("views", views, 1 + first, cameras)
        teach = views - first
        looks = teach if looks is None else require_integer("looks", looks, 1, teach)
        instant = torch.randint(len(self), (count,), generator=generator)
        view = torch.randint(cameras, (count,), generator=generator)
        looked = (view[:, None] + torch.arange(first, views)) % cameras
        if looks < teach:
            order = torch.rand(count, teach, generator=generator).argsort(1)
            looked = looked.gather(1, order[:, :looks])
        angles = (2 * torch.rand(count, 3, generator=generator) - 1) * math.radians(turn)
        flip = torch.rand(count, generator=generator) < (0.5 if mirror else 0.0)
        at = instant[:, None], looked
        batch = {
            "images": self.images[instant, view],
            "t": self.t[instant, view],
            "own": self.T_world_cam[instant, view],
            "masks": self.masks[at].float() / 255,
            "shades": self.shades[at].float() / 255,
            "K": self.K[at],
            "T_world_cam": self.T_world_cam[at],
        }
        if turn:
            K = resize_intrinsics(self.K[instant, view], self.size, self.images.shape[:2:-1])
            _turn(batch, K, axis_angle_to_matrix(angles))
        batch["images"] = batch["images"].float() / 255
        if mirror:
            _mirror(batch, flip, self.size[0])
        return batch


def _turn(batch: dict[str, Tensor], K: Tensor, R: Tensor) -> None:
    """Turn each input's camera so that what was at X in its frame is at R X."""
    maps = (K @ R @ torch.linalg.inv(K)).double().numpy()
    images = batch["images"].numpy()
    size = images.shape[:1:-1]
    turned = [
        cv2.warpPerspective(image[0], M, size, borderMode=cv2.BORDER_REPLICATE)
        for image, M in zip(images, maps, strict=True)
    ]
    batch["images"] = torch.from_numpy(np.stack(turned))[:, None]
    batch["t"] = (R @ batch["t"][..., None])[..., 0]
    own = batch["own"].clone()
    own[:, :3, :3] = own[:, :3, :3] @ R.mT
    batch["own"] = own


def _mirror(batch: dict[str, Tensor], flip: Tensor, width: int) -> None:
    """Mirror the world about x = 0, and with it images and cameras, where `flip` is True."""
    for name in ("images", "masks", "shades"):
        picture = batch[name]
        batch[name] = torch.where(flip[:, None, None, None], picture.flip(-1), picture)
    signs = torch.tensor([-1.0, 1, 1, 1])
    batch["t"] = torch.where(flip[:, None], batch["t"] * signs[:3], batch["t"])
    for name in ("own", "T_world_cam"):
        pose = batch[name]
        where = flip.reshape(-1, *[1] * (pose.ndim - 1))
        batch[name] = torch.where(where, signs[:, None] * pose * signs, pose)
    K = batch["K"].clone()
    K[flip, :, 0, 2] = width - 1 - K[flip, :, 0, 2]
    K[flip, :, 0, 1] *= -1
    batch["K"] = K


def brightness(images: Tensor) -> tuple[float, float]:
    """Mean and standard deviation, of 0 to 1, of images (V, ...) uint8, or of some of many."""
    some = images[:: max(1, len(images) // 512)].float() / 255
    return float(some.mean()), float(some.std().clamp(min=1e-3))


def first_rows(data: Stack) -> Tensor:
    """(V,) the row of the first object of each view, in the headset world the glasses.

    Raises:
        ValueError: if a view has no object.
    """
    if not len(data.view):
        fail("data", "objects with their poses", "none")
    rows = torch.searchsorted(data.view, torch.arange(len(data)))
    found = data.view[rows.clamp(max=len(data.view) - 1)] == torch.arange(len(data))
    if not bool(found.all()):
        fail("data", "an object with its pose in every view", f"view {int((~found).nonzero()[0])}")
    return rows


def reduced(image: np.ndarray, size: tuple[int, int]) -> Tensor:
    """(h, w) uint8, each pixel the mean of what it covers; larger images are interpolated."""
    if image.shape[::-1] != size:
        shrinks = image.shape[1] >= size[0] and image.shape[0] >= size[1]
        image = cv2.resize(
            image, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
        )
    return torch.from_numpy(np.clip(np.round(image), 0, 255).astype(np.uint8))
