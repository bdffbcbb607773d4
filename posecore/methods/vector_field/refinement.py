"""The refinement of poses: model points in the current pose, and the field sampled there.

Section III-C of the paper gives the refiner the model's points, moved by the pose (3D information),
and "the selected vector of the object" (2D information), and says no more. Here:

- Every point is projected with the present pose, and the field's vectors are taken at that pixel.
  Outside of the mask they are zeros, and so is a flag that is one inside.
- Of each unit vector the direction is subtracted that the present pose lets expect, from the pixel
  to the projected keypoint (`residual`). What is left is zero where pose and field agree.
- Points are relative to the object's centre, along the camera's axes, in diameters.
- The answer turns the object about its centre, shifts it in diameters across the view, and
  multiplies its distance. In these units a small object and a large one, a near and a far one whose
  pictures differ in the same way need the same correction. (DeepIM, Li et al., ECCV 2018, has the
  same units with pixels for diameters.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor, nn

from posecore import cameras, poses
from posecore.arrays import Array, array_function, fail, require_finite, require_integer
from posecore.clouds import farthest_point_sampling
from posecore.methods.vector_field.fields import keypoint_vectors, unit
from posecore.models import ObjectModel, require_models
from posecore.nets.pose_refiner import PoseRefiner
from posecore.nets.rotation_heads.decoders import decode_quaternion
from posecore.refinement import correct_pose

__all__ = ["FieldRefiner", "overlap", "refiner_features"]

RESIDUAL_SCALE = 0.1
"""The size of a usual residual: the network is told how many of these, which are near one."""

FieldSampler = Callable[[Tensor], tuple[Tensor, Tensor]]
"""From pixels (B, N, 2) to vectors (B, N, K, 2) and whether in the mask (B, N)."""


@array_function(points="... N 3", R="... 3 3", t="... 3", camera="... 3 3", mask="... H W")
def overlap(points: Array, R: Array, t: Array, camera: Array, mask: Array) -> Array:
    """The share of a model's points whose projection lies in a mask (Section III-D).

    Points outside of the image or behind the camera do not.

    Args:
        points: (..., N, 3) of the model.
        R, t: (..., 3, 3) and (..., 3) the pose.
        camera: (..., 3, 3) camera matrix.
        mask: (..., H, W) true, or not 0, where the object is seen.

    Returns:
        (...) 0 to 1. Where another thing is in front, even of the true pose less than 1.

    Raises:
        ValueError: if the pose moves the points out of the range of numbers.
    """
    height, width = mask.shape[-2:]
    pixels = _pixels(points, R, t, camera).round()
    known = pixels.masked_fill(torch.isinf(pixels), 0)  # behind the camera
    require_finite("R, t and points", known, "a pose that keeps points finite")
    x, y = pixels.unbind(-1)
    seen = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    batch = np.broadcast_shapes(seen.shape[:-1], mask.shape[:-2])
    x, y, seen = (value.expand(*batch, -1) for value in (x, y, seen))
    flat = mask.expand(*batch, height, width).flatten(-2)  # (..., H W)
    place = torch.where(seen, y * width + x, 0).long()
    inside = seen & (flat.gather(-1, place) != 0)
    return inside.to(points.dtype).mean(-1)


@array_function(
    pixels="... N 2", vectors="... N K 2", inside="... N", keypoints="... K 3",
    R="... 3 3", t="... 3", camera="... 3 3",
)  # fmt: skip
def refiner_features(
    pixels: Array,
    vectors: Array,
    inside: Array,
    keypoints: Array,
    R: Array,
    t: Array,
    camera: Array,
    residual: bool = True,
) -> Array:
    """The refiner's input features of each point, besides its coordinates.

    Args:
        pixels: (..., N, 2) at which the field was sampled.
        vectors: (..., N, K, 2) the field there, of any length.
        inside: (..., N) true, or not 0, in the mask.
        keypoints: (..., K, 3) of the model.
        R, t: (..., 3, 3) and (..., 3) the present pose.
        camera: (..., 3, 3) camera matrix.
        residual: whether to subtract the directions to the keypoints as the pose projects them.

    Returns:
        (..., N, 2 K + 1) unit vectors, less those of the pose, and the flag; zeros outside.
    """
    said = unit(vectors)
    if residual:
        ends = _pixels(keypoints, R, t, camera)
        behind = torch.isinf(ends)  # of a keypoint behind the camera no direction is expected
        expected = unit(keypoint_vectors(pixels, ends.masked_fill(behind, 0)))
        said = (said - expected).masked_fill(behind[..., None, :, :], 0)
    inside = (inside != 0).to(said.dtype)[..., None]
    said = said.flatten(-2) * inside
    return torch.cat([said, inside.expand(*said.shape[:-1], 1)], -1)


class FieldRefiner(nn.Module):
    """The pose refiner, with the points, keypoints and diameters of its objects.

    One network serves all objects, with outputs of its own for each, as the network of the field
    does. The paper trains one for each object: that is a `FieldRefiner` of one model each.

    Attributes:
        models: as given.
        iterations: as given; may be changed.

    Args:
        models: of the objects, in the order of the field's network.
        width: of `PoseRefiner`; 64 in the reference.
        points: how many of each model's points are used, chosen by farthest point sampling.
        iterations: how often a pose is corrected, each time with the field sampled at the last one.
        residual: see `refiner_features`.

    Raises:
        ValueError: naming an argument that cannot be.
    """

    def __init__(
        self,
        models: Sequence[ObjectModel],
        width: int = 16,
        points: int = 200,
        iterations: int = 3,
        residual: bool = True,
    ) -> None:
        super().__init__()
        self.models = require_models(models)
        self.iterations = require_integer("iterations", iterations, 1)
        self.residual = bool(residual)
        points = require_integer("points", points, 1)
        fewest = min(len(model.points) for model in self.models)
        if points > fewest:
            fail("points", f"at most {fewest}, which a model has", points)

        def buffer(name: str, values: object) -> None:
            self.register_buffer(name, _tensor(values), persistent=False)

        chosen = [
            model.points[farthest_point_sampling(model.points, points, "farthest_from_centre")]
            for model in self.models
        ]
        buffer("points", chosen)  # (O, N, 3)
        buffer("keypoints", [model.keypoints for model in self.models])  # (O, K, 3)
        buffer("diameter", [model.diameter for model in self.models])  # (O,)
        buffer("symmetric", [model.symmetric for model in self.models])
        self.net = PoseRefiner(2 * self.keypoints.shape[1] + 1, len(self.models), width)

    def forward(
        self, index: Tensor, R: Tensor, t: Tensor, camera: Tensor, sample: FieldSampler
    ) -> list[tuple[Tensor, Tensor]]:
        """The poses after each iteration.

        As in DenseFusion, no gradient goes from an iteration to the one before.

        Args:
            index: (B,) int64, which of the models.
            R, t: (B, 3, 3) and (B, 3) the poses to begin with, whose precision is kept.
            camera: (B, 3, 3) camera matrices.
            sample: the field at pixels, as `MaskedFields.at` gives it for its entries.

        Returns:
            `iterations` pairs `(R, t)`.
        """
        found = []
        points, keypoints = self.points[index], self.keypoints[index]
        centre, diameter = keypoints[:, -1], self.diameter[index]
        for _ in range(self.iterations):
            R, t = R.detach(), t.detach()
            pixels = _pixels(points, R, t, camera).round()
            known = refiner_features(
                torch.nan_to_num(pixels, posinf=0), *sample(pixels), keypoints, R, t, camera,
                residual=self.residual,
            )  # fmt: skip
            if self.residual:
                known = torch.cat([known[..., :-1] / RESIDUAL_SCALE, known[..., -1:]], -1)
            there = (points - centre[:, None]) @ R.mT.to(points) / diameter[:, None, None]
            said = self.net(there, known.to(points), index)
            # Half as far or twice is more than any refinement needs, and never overflows.
            shift = torch.cat([said.shift[:, :2], said.shift[:, 2:].clamp(-0.7, 0.7)], -1)
            R, t = correct_pose(R, t, centre, diameter, decode_quaternion(said.quaternion), shift)
            found.append((R, t))
        return found


def _pixels(points: Tensor, R: Tensor, t: Tensor, camera: Tensor) -> Tensor:
    """Where points of the object are seen, (..., N, 2); infinite behind the camera."""
    return cameras.project(camera, poses.apply(R, t, points), behind="inf")


def _tensor(values: object) -> Tensor:
    return torch.from_numpy(np.array(values)).float()
