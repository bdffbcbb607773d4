"""The three losses of the cloud estimator.

Source: Firintepe et al., "From IR images to point clouds to pose", 2021, Section 3.1.2 and Eq 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from posecore.arrays import fail, require_number
from posecore.methods.infrared.network import CloudNet
from posecore.methods.infrared.projection import Projector
from posecore.splat import Pictures

__all__ = ["CloudLoss", "between", "blur_masks"]


def between(ends: tuple[float, float], done: float) -> float:
    """What goes in a straight line from the first of `ends` to the second in a training."""
    return ends[0] + (ends[1] - ends[0]) * done


def blur_masks(masks: Tensor, variance: float) -> Tensor:
    """Masks blurred with a Gaussian of 3 x 3 pixels (the paper's K = 3).

    Args:
        masks: (..., H, W); outside they are as at their edge.
        variance: in square pixels; 0 for no blur.

    Returns:
        (..., H, W).

    Raises:
        ValueError: if the variance is negative or no number.
    """
    if require_number("variance", variance, 0) == 0:
        return masks
    side = torch.exp(torch.tensor(-0.5 / variance)).item()
    middle = 1 / (1 + 2 * side)
    for axis in (-1, -2):
        first, last = masks.narrow(axis, 0, 1), masks.narrow(axis, -1, 1)
        padded = torch.cat([first, masks, last], axis)
        length = masks.shape[axis]
        around = padded.narrow(axis, 0, length) + padded.narrow(axis, 2, length)
        masks = middle * (masks + side * around)
    return masks


@dataclass(frozen=True)
class CloudLoss:
    """L = a L_t + b L_mp + c L_cmp, of a batch as `Triples.draw` makes them.

    - L_t: squared distance of predicted and true translation, in units of the object box.
    - L_mp: squared difference of silhouette and blurred mask.
    - L_cmp: the same of the picture of intensities and the image within its mask.

    Clouds are projected from their *true* translation, so that shape and place are learned apart.

    Attributes:
        projector: into the views.
        weights: a, b, c. The text calls L_cmp the one that assists, but these are its numbers.
        box_units: whether L_t is in units of the object box, else in metres.
        by_resolution: whether the sums over pixels are divided by their number.
        mask_blur: variance of the masks' blur in square pixels at the beginning and at the end.
        blur: sigma of the projected volume's blur in voxels, at the beginning and at the end,
            between them in equal ratios, as of the renderer that the paper adapts.
        keep: the share of points that is projected, at the beginning and at the end (which is
            reached at four fifths of the training).
        use_scale: whether the predicted occupancy scale is used, else 1.
        relative: whether points are relative to the translation, else to the middle of the box.

    Raises:
        ValueError: for a number that is out of range.
    """

    projector: Projector
    weights: tuple[float, float, float] = (0.2, 0.2, 0.6)
    box_units: bool = True
    by_resolution: bool = True
    mask_blur: tuple[float, float] = (0.2, 1.0)
    blur: tuple[float, float] = (3.0, 0.2)
    keep: tuple[float, float] = (0.07, 1.0)
    use_scale: bool = True
    relative: bool = True

    def __post_init__(self) -> None:
        for name, count, above in (
            ("weights", 3, False), ("mask_blur", 2, False), ("blur", 2, True), ("keep", 2, True),
        ):  # fmt: skip
            values = getattr(self, name)
            if not isinstance(values, tuple | list) or len(values) != count:
                fail(name, f"{count} numbers", repr(values))
            for value in values:
                require_number(name, value, None if above else 0, above=0 if above else None)
        for value in self.keep:
            require_number("keep", value, 0, 1)

    def __call__(self, net: CloudNet, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """The losses of a batch; "loss" is their weighted sum."""
        done = float(batch["done"])
        cloud = net(batch["images"])
        points, intensities = self._kept(cloud.points, cloud.intensities, done)
        pictures = self.projector(
            points,
            batch["t"] if self.relative else net.middle.expand_as(batch["t"]),
            batch["own"],
            batch["K"],
            batch["T_world_cam"],
            intensities=intensities if self.weights[2] else None,
            scale=cloud.scale if self.use_scale else 1.0,
            sigma=self.sigma(done),
        )
        off = cloud.t - batch["t"]
        if self.box_units:
            off = off / (net.high - net.low).clamp(min=1e-3)  # of a single place it is none
        parts = {"translation": off.square().sum(-1).mean(), **self._of_pictures(pictures, batch)}
        weighted = zip(self.weights, parts.values(), strict=False)
        return {"loss": sum(weight * part for weight, part in weighted), **parts}

    def sigma(self, done: float) -> float:
        """The blur of the volume in voxels, at a part of the training."""
        first, last = self.blur
        return first * (last / first) ** done

    def _of_pictures(self, pictures: Pictures, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        variance = between(self.mask_blur, float(batch["done"]))
        pairs = {"mask": (pictures.silhouette, batch["masks"])}
        if pictures.intensity is not None:
            pairs["intensity"] = pictures.intensity, batch["shades"]
        losses = {}
        for name, (seen, wanted) in pairs.items():
            if wanted.shape != seen.shape:
                fail(
                    {"mask": "masks", "intensity": "shades"}[name],
                    f"shape {tuple(seen.shape)}",
                    f"shape {tuple(wanted.shape)}",
                )
            squares = (seen - blur_masks(wanted, variance)).square().sum((-1, -2)).mean()
            pixels = wanted.shape[-1] * wanted.shape[-2] if self.by_resolution else 1
            losses[name] = squares / pixels
        return losses

    def _kept(self, points: Tensor, intensities: Tensor, done: float) -> tuple[Tensor, Tensor]:
        """Some of the points, drawn anew for every batch, the same of all of its clouds."""
        share = between(self.keep, min(1.0, done / 0.8))
        count = max(1, round(share * points.shape[1]))
        if count == points.shape[1]:
            return points, intensities
        chosen = torch.randperm(points.shape[1], device=points.device)[:count]
        return points[:, chosen], intensities[:, chosen]
