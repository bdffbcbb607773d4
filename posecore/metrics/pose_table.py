"""Many poses of many objects in many images, as arrays: what results files hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from torch import Tensor

from posecore.arrays import Array, fail, to_numbers

__all__ = ["CategoryPoseTable", "PoseTable"]


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


@dataclass(frozen=True, eq=False)
class CategoryPoseTable(PoseTable):
    """Poses of objects of which only the category is known: each has a size of its own.

    `object_id` may say which instance it is; nothing that measures categories looks at it. A pose
    leads from the middle of the object's bounding box, whose sides are the object's axes.
    `CategoryPoseTable.from_arrays` needs no more than what is known.

    Attributes:
        category: (N,) names.
        size: (N, 3) lengths of the bounding box along the object's axes, metres.
        axis: (N, 3) of the ground truth, the axis in the object's frame about which every turn
            leaves this instance as it is, of any length, such as (0, 1, 0); zeros if there is none.
            One mug may have it, for its handle is hidden, and the next one not.

    Raises:
        ValueError: as `PoseTable`; if a name is empty, or a size is not positive.
    """

    category: np.ndarray
    size: np.ndarray
    axis: np.ndarray

    def __post_init__(self) -> None:
        poses = PoseTable(*(getattr(self, column.name) for column in fields(PoseTable)))
        for column in fields(PoseTable):
            object.__setattr__(self, column.name, getattr(poses, column.name))
        names = np.asarray(self.category)
        if names.shape != (len(poses),):
            fail("category", f"shape ({len(poses)},), one row for every object_id", names.shape)
        if not all(isinstance(name, str) and name.strip() for name in names.tolist()):
            fail("category", "names", f"{names.dtype} {names.tolist()[:3]}")
        object.__setattr__(self, "category", names.astype(str))
        for name in ("size", "axis"):
            array = to_numbers(name, getattr(self, name))
            if array.shape != (len(poses), 3):
                fail(name, f"shape ({len(poses)}, 3), one row for every object_id", array.shape)
            if not np.isfinite(array).all():
                row = int(np.argwhere(~np.isfinite(array))[0][0])
                fail(name, "finite values", f"one that is not in row {row}")
            object.__setattr__(self, name, array)
        if (self.size <= 0).any():
            row = int(np.argwhere(self.size <= 0)[0][0])
            fail("size", "lengths above 0", f"{self.size[row].tolist()} in row {row}")

    @classmethod
    def from_arrays(
        cls,
        category: Sequence[str] | str,
        R: Array,
        t: Array,
        size: Array,
        *,
        axis: Array | None = None,
        score: Array | float = 1.0,
        image_id: Array | int = 0,
        scene_id: Array | int = 0,
        object_id: Array | int = 0,
        time: Array | float = -1.0,
    ) -> CategoryPoseTable:
        """The table of arrays or tensors; what is one number holds for all N rows.

        Args:
            category: N names, or the one of all.
            R: (N, 3, 3) rotations from object to camera.
            t: (N, 3) where the middle of the bounding box is, metres.
            size: (N, 3) metres.
            axis: (N, 3) or (3,), of the ground truth; None for objects without symmetry.
            score, time: numbers or (N,), as in `PoseTable`.
            image_id, scene_id, object_id: integers or (N,).

        Raises:
            ValueError: as the class.
        """
        count = len(R)

        def column(values: Array | float, *row: int) -> np.ndarray:
            """One number for all rows, or as many as there are."""
            array = values.numpy(force=True) if isinstance(values, Tensor) else np.asarray(values)
            return np.broadcast_to(array, (count, *row)) if array.ndim == len(row) else array

        def rows(name: str, values: Array, *row: int) -> np.ndarray:
            array = to_numbers(name, values)
            return array if array.size else array.reshape(0, *row)  # of lists without a shape

        return cls(
            scene_id=column(scene_id),
            image_id=column(image_id),
            object_id=column(object_id),
            R=rows("R", R, 3, 3),
            t=rows("t", t, 3),
            score=column(score),
            time=column(time),
            category=column(category),
            size=rows("size", size, 3),
            axis=column(np.zeros(3) if axis is None else axis, 3),
        )

    @property
    def scale(self) -> np.ndarray:
        """(N,) length of the bounding box's diagonal, metres.

        It is the factor from normalised object coordinates to metres (Wang et al., Normalized
        Object Coordinate Space, CVPR 2019, section 3): there the diagonal is 1.
        """
        return np.linalg.norm(self.size, axis=-1)

    def __getitem__(self, rows: int | np.ndarray | slice) -> CategoryPoseTable:
        """The table of the chosen rows: a slice, a mask, an array of indices, or one index."""
        if isinstance(rows, int | np.integer):
            rows = np.arange(len(self))[[rows]]
        return CategoryPoseTable(*(getattr(self, column.name)[rows] for column in fields(self)))
