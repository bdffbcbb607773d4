"""Errors of head poses as in the infrared paper's tables: per axis, glasses and bin of angle.

Source: Firintepe et al., "From IR images to point clouds to pose", 2021, Section 4.1, Eq. 5, Tables
3 and 4.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from torch import Tensor

from posecore.arrays import fail, require_finite, require_number
from posecore.metrics.pose_errors import rotation_error
from posecore.metrics.summaries import (
    angle_difference,
    balanced_mean_angular_error,
    mean_absolute_error,
    root_mean_squared_error,
)
from posecore.rotations import matrix_to_euler

__all__ = ["ANGLES", "AXES", "METRICS", "AngleBin", "PoseErrors", "pose_errors"]

ANGLES = ("yaw", "pitch", "roll")
"""The head's angles, in the order of `PoseErrors.angles`."""
AXES = ("x", "y", "z")
"""Those of the car, in the order of `PoseErrors.offset`."""
METRICS = ("MAE", "RMSE", "BMAE")
"""Those of Table 3."""


class AngleBin(NamedTuple):
    """What is known of poses whose true angle lies in a bin."""

    low: float  # degrees, of its lower edge; the angle's size counts
    count: int
    error: float  # degrees, mean absolute


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Errors of V poses, in the car's frame.

    Attributes:
        angles: (V, 3) radians, estimated less true, of yaw, pitch and roll, the short way round.
        true: (V, 3) radians, the true angles.
        rotation: (V,) radians, the angle between the rotations.
        offset: (V, 3) metres, estimated less true translation along the car's axes.
    """

    angles: np.ndarray
    true: np.ndarray
    rotation: np.ndarray
    offset: np.ndarray

    def __len__(self) -> int:
        """How many."""
        return len(self.rotation)

    def only(self, chosen: np.ndarray | Tensor) -> PoseErrors:
        """Those where (V,) booleans are True, or by their numbers.

        Raises:
            ValueError: if there are none.
        """
        chosen = np.asarray(chosen)
        if chosen.ndim != 1 or chosen.dtype.kind not in "bi" or not chosen.size:
            fail("chosen", "booleans (V,) or numbers", f"{chosen.dtype} {chosen.shape}")
        if chosen.dtype.kind == "b" and len(chosen) != len(self):
            fail("chosen", f"{len(self)} booleans", len(chosen))
        part = PoseErrors(**{f.name: getattr(self, f.name)[chosen] for f in fields(self)})
        if not len(part):
            fail("chosen", "one pose or more", "none")
        return part

    def orientation(self) -> Mapping[str, dict[str, float]]:
        """A row of Table 3: degrees by metric, then by angle; "average" is that of the three."""
        table = {}
        for name, metric in (
            ("MAE", lambda error, _: mean_absolute_error(error)),
            ("RMSE", lambda error, _: root_mean_squared_error(error)),
            ("BMAE", balanced_mean_angular_error),
        ):
            found = [
                float(np.rad2deg(metric(self.angles[:, k], self.true[:, k]))) for k in range(3)
            ]
            table[name] = dict(zip((*ANGLES, "average"), (*found, np.mean(found)), strict=True))
        return table

    def position(self) -> dict[str, float]:
        """A row of Table 4: mean absolute error along each axis, and mean distance "L2", in mm."""
        each = 1000 * np.abs(self.offset).mean(0)
        distance = 1000 * np.linalg.norm(self.offset, axis=1).mean()
        return dict(zip((*AXES, "L2"), map(float, (*each, distance)), strict=True))

    def bins(self, angle: str = "yaw", width: float = 5.0) -> list[AngleBin]:
        """What BMAE is the mean of: the bins that are in use, from small angles to large ones.

        Args:
            angle: one of `ANGLES`.
            width: degrees, of a bin.

        Raises:
            ValueError: for another angle or width.
        """
        if angle not in ANGLES:
            fail("angle", f"one of {', '.join(ANGLES)}", repr(angle))
        width = require_number("width", width, 1e-3, 180)
        k = ANGLES.index(angle)
        errors, true = np.rad2deg(np.abs(self.angles[:, k])), np.rad2deg(np.abs(self.true[:, k]))
        last = int(np.ceil(180 / width - 1e-9)) - 1  # which includes its end, as in the metric
        number = np.minimum(np.floor(true / width + 1e-9).astype(int), last)
        return [
            AngleBin(float(b * width), int((number == b).sum()), float(errors[number == b].mean()))
            for b in np.unique(number)
        ]


def pose_errors(R_est: Tensor, t_est: Tensor, R_gt: Tensor, t_gt: Tensor) -> PoseErrors:
    """Errors of estimated poses.

    Args:
        R_est, R_gt: (V, 3, 3) rotations from the glasses to the car.
        t_est, t_gt: (V, 3) metres.

    Raises:
        ValueError: if shapes differ, there are no poses, or something is no rotation or not finite.
    """
    given = {"R_est": R_est, "t_est": t_est, "R_gt": R_gt, "t_gt": t_gt}
    for name, value in given.items():
        if not isinstance(value, Tensor):
            fail(name, "a tensor", type(value).__name__)
        shape = (len(R_est), 3, 3) if name.startswith("R") else (len(R_est), 3)
        if value.shape != shape or not len(R_est):
            fail(name, f"shape {shape}, at least one", f"shape {tuple(value.shape)}")
        require_finite(name, value)
    R_est, t_est, R_gt, t_gt = (value.detach().double() for value in given.values())
    true = matrix_to_euler(R_gt)
    return PoseErrors(
        angles=angle_difference(matrix_to_euler(R_est), true).numpy(),
        true=true.numpy(),
        rotation=rotation_error(R_est, R_gt).numpy(),
        offset=(t_est - t_gt).numpy(),
    )
