"""Many poses of many objects in many images, as arrays: what results files hold."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from posecore.arrays import fail

__all__ = ["PoseTable"]


@dataclass(frozen=True, eq=False)
class PoseTable:
    """One row for every estimated (or annotated) pose; all arrays share their first dimension N.

    Attributes:
        scene_id, image_id, object_id: (N,) integers, where the pose was estimated and of what.
        R: (N, 3, 3) rotations from object to camera, as read: nothing here makes them exact.
        t: (N, 3) translations in metres.
        score: (N,) confidence of the estimator, larger is surer; 1 for ground truth.
        time: (N,) seconds that the whole image took, -1 where unknown.

    Raises:
        ValueError: if an array has the wrong shape or type, or holds values that are not finite.
    """

    scene_id: np.ndarray
    image_id: np.ndarray
    object_id: np.ndarray
    R: np.ndarray
    t: np.ndarray
    score: np.ndarray
    time: np.ndarray

    def __post_init__(self) -> None:
        rows = len(np.atleast_1d(self.object_id))
        tails = {"R": (3, 3), "t": (3,)}
        for field in fields(self):
            is_id = field.name.endswith("_id")
            array = np.asarray(getattr(self, field.name))
            if array.shape != (rows, *tails.get(field.name, ())):
                shape = (rows, *tails.get(field.name, ()))
                fail(field.name, f"shape {shape}, one row for every object_id", array.shape)
            if is_id and array.dtype.kind not in "iu" and rows:
                fail(field.name, "integers", array.dtype)
            if not is_id and array.dtype.kind not in "fiu":
                fail(field.name, "numbers", array.dtype)
            array = array.astype(np.int64 if is_id else np.float64)
            if not np.isfinite(array).all():
                row = int(np.argwhere(~np.isfinite(array))[0][0])
                fail(field.name, "finite values", f"one that is not in row {row}")
            object.__setattr__(self, field.name, array)

    @property
    def images(self) -> list[tuple[int, int]]:
        """(scene id, image id) of every row."""
        return list(zip(self.scene_id.tolist(), self.image_id.tolist(), strict=True))

    def __len__(self) -> int:
        return len(self.object_id)

    def __getitem__(self, rows: int | np.ndarray | slice) -> PoseTable:
        """The table of the chosen rows: a slice, a mask, an array of indices, or one index."""
        if isinstance(rows, int | np.integer):
            rows = np.arange(len(self))[[rows]]
        return PoseTable(*(getattr(self, field.name)[rows] for field in fields(self)))
