"""Some views of a dataset, and each object in them with what is given of it to compare with."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np

from data_tools.checking.drawing import Placement, Shape
from data_tools.views import Dataset, ObjectView, View

__all__ = ["Instance", "Sample", "chosen_views", "read_sample", "spread_out"]

BLOCK = 3  # views that follow each other are taken together: images may be off by one
LEAST_PIXELS = 25  # of a mask: smaller ones are all border
LEAST_VISIBLE = 0.6  # share of an object, where only the mask of what is seen is known
WIDEST = 320  # pixels: candidates are compared in images of at most this width


@dataclass(frozen=True, eq=False, kw_only=True)
class Instance:
    """One object in one image.

    Attributes:
        number: its place in the sample.
        view: the place of its view in the sample.
        row: its place among the objects of the view.
        item: what the dataset says of it.
        shape: its model.
        K: (3, 3) the camera's matrix.
        size: (width, height) of the image.
        mask: (H, W) bool, the whole silhouette where that is given, else what is seen of it; None
            where there is neither.
        visible: (H, W) bool, what is seen of it, or None.
        others: (H, W) bool, where other objects are seen and this may be hidden; None for nowhere.
        small, small_others: `mask` and `others`, of every `step`-th pixel.
        depth: (H, W) metres, 0 for none; None where there is no depth image.
        whole: whether the mask is that of a whole object, not cut by the image's border.
    """

    number: int
    view: int
    row: int
    item: ObjectView
    shape: Shape
    K: np.ndarray
    size: tuple[int, int]
    mask: np.ndarray | None = None
    visible: np.ndarray | None = None
    others: np.ndarray | None = None
    small: np.ndarray | None = None
    small_others: np.ndarray | None = None
    step: int = 1
    depth: np.ndarray | None = None
    whole: bool = False

    @property
    def object_id(self) -> int:
        """Which object."""
        return self.item.object_id

    @property
    def place(self) -> Placement:
        """Where the dataset says that it is."""
        return Placement(self.K, self.item.R, self.item.t)

    @cached_property
    def moments(self) -> dict[str, float]:
        """Moments, as OpenCV has them, of the convex hull of the mask's largest part."""
        contours, _ = cv2.findContours(
            self.mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
        )
        hull = cv2.convexHull(max(contours, key=len))
        filled = np.zeros(self.mask.shape, np.uint8)
        return cv2.moments(cv2.fillConvexPoly(filled, hull, 1), binaryImage=True)


@dataclass(eq=False)
class Sample:
    """What is looked at of a dataset.

    Attributes:
        views: by their index in the dataset.
        instances: the objects large enough to be compared, in the order of the views.
        total: objects in the views, whatever their size.
        unreadable: what was said of views that cannot be read.
        without_model: ids of objects without a mesh.
    """

    views: dict[int, View]
    instances: list[Instance] = field(default_factory=list)
    total: int = 0
    unreadable: list[str] = field(default_factory=list)
    without_model: set[int] = field(default_factory=set)

    def neighbour(self, instance: Instance, offset: int) -> ObjectView | None:
        """The same object in the image that many places later in its scene; None if it is not.

        Of several instances of an object the one in the same place among them is taken.
        """
        view = self.neighbour_view(instance.view, offset)
        if view is None:
            return None
        own = self.views[instance.view].objects
        rank = [i for i, o in enumerate(own) if o.object_id == instance.object_id].index(
            instance.row
        )
        same = [item for item in view.objects if item.object_id == instance.object_id]
        return same[rank] if rank < len(same) else None

    def neighbour_view(self, index: int, offset: int) -> View | None:
        """The view that many places later in the dataset, if it is of the same scene and size."""
        view = self.views.get(index + offset)
        mine = self.views[index]
        if view is None or view.scene_id != mine.scene_id or view.shape != mine.shape:
            return None
        return view


def chosen_views(length: int, count: int) -> list[int]:
    """Indices of about `count` of `length` views, spread over them in blocks of `BLOCK`."""
    if length <= count:
        return list(range(length))
    blocks = max(1, count // BLOCK)
    starts = np.linspace(0, length - BLOCK, blocks).round().astype(int) if length > BLOCK else [0]
    return sorted({int(s) + i for s in starts for i in range(BLOCK) if s + i < length})


def spread_out(length: int, most: int) -> list[int]:
    """At most `most` indices below `length`, evenly spread."""
    if length <= most:
        return list(range(length))
    return np.linspace(0, length - 1, most).round().astype(int).tolist()


def read_sample(dataset: Dataset, indices: Sequence[int], shapes: dict[int, Shape]) -> Sample:
    """Read views, and what can be compared in them.

    Args:
        dataset: of views.
        indices: which views.
        shapes: the models by object id.

    Returns:
        The sample. A view that cannot be read is left out, and `unreadable` says why.
    """
    sample = Sample({})
    for index in indices:
        try:
            sample.views[index] = dataset[index]
        except (ValueError, OSError) as error:
            sample.unreadable.append(" ".join(str(error).split()))
    for index, view in sample.views.items():
        for row, item in enumerate(view.objects):
            sample.total += 1
            if item.object_id not in shapes:
                sample.without_model.add(item.object_id)
            elif view.shape is not None:
                sample.instances += _instances(sample, index, view, row, shapes[item.object_id])
    return sample


def _instances(
    sample: Sample, index: int, view: View, row: int, shape: Shape
) -> Iterator[Instance]:
    """The instance, if it is large enough."""
    item, (height, width) = view.objects[row], view.shape
    mask = item.mask if item.full_mask is None else item.full_mask
    known = {}
    if mask is not None:
        if np.count_nonzero(mask) < LEAST_PIXELS:
            return
        seen = item.visible_fraction
        if item.full_mask is None and seen is not None and seen < LEAST_VISIBLE:
            return
        step = -(-width // WIDEST)
        others = None
        if item.full_mask is None:
            rest = [o.mask for i, o in enumerate(view.objects) if i != row and o.mask is not None]
            others = np.logical_or.reduce(rest) & ~mask if rest else None
        border = mask[0].any() or mask[-1].any() or mask[:, 0].any() or mask[:, -1].any()
        known = {
            "mask": mask,
            "visible": item.mask,
            "others": others,
            "small": np.ascontiguousarray(mask[::step, ::step]),
            "small_others": None if others is None else others[::step, ::step],
            "step": step,
            "whole": not border and (others is None or not _touches(mask, others)),
        }
    yield Instance(
        number=len(sample.instances),
        view=index,
        row=row,
        item=item,
        shape=shape,
        K=view.K,
        size=(width, height),
        depth=view.depth,
        **known,
    )


def _touches(mask: np.ndarray, others: np.ndarray) -> bool:
    grown = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8))
    return bool((grown.astype(bool) & others).any())
