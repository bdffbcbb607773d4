"""The floor of every table: one pose for all, whatever comes in."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from posecore.arrays import fail, require_finite, require_integer
from posecore.rotations import mean_rotation

__all__ = ["ConstantPose"]


@dataclass(frozen=True, eq=False)
class ConstantPose:
    """The mean pose of a training set.

    Attributes:
        R: (3, 3) the chordal mean of its rotations.
        t: (3,) metres, the mean of its translations.
    """

    R: Tensor
    t: Tensor

    @classmethod
    def fit(cls, R: Tensor, t: Tensor) -> ConstantPose:
        """Of rotations (N, 3, 3) and translations (N, 3), metres.

        Raises:
            ValueError: if shapes do not fit, or the rotations have no one mean.
        """
        if t.ndim != 2 or t.shape != (len(R), 3) or not len(R):
            fail("t", f"shape ({len(R)}, 3), at least one", f"shape {tuple(t.shape)}")
        require_finite("t", t)
        return cls(mean_rotation(R), t.mean(0))

    def __call__(self, count: int) -> tuple[Tensor, Tensor]:
        """R (count, 3, 3) and t (count, 3), the same for all."""
        require_integer("count", count, 0)
        return self.R.expand(count, 3, 3), self.t.expand(count, 3)
