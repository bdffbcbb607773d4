"""The one record that every world and every reader yields, and the one door to all of them.

A `View` is one image of one camera with everything that is known about it; `open` turns a name such
as `"bop:PATH"` into a dataset of views. Metres, pixels and `X_cam = R @ X_obj + t` throughout.
"""

from __future__ import annotations

import importlib
import operator
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from posecore.arrays import fail, require_integer, require_number

__all__ = ["Dataset", "ModelSet", "ObjectView", "View", "open"]

FARTHEST = 1e12  # metres or pixels: what is beyond has no squares and sums in float32


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class ObjectView:
    """One object as one camera sees it. What is not known is None.

    Attributes:
        object_id: which object, an integer of at least 0.
        R: (3, 3) float64 rotation from object to camera, as the dataset gives it.
        t: (3,) float64 translation in metres.
        category: name of the object's category, for datasets that have categories.
        box: (4,) x, y, width and height in pixels of the visible part.
        mask: (H, W) bool, the pixels in which the object is seen.
        full_mask: (H, W) bool, the pixels it would cover if nothing stood before it.
        visible_fraction: share of the full silhouette that is seen, 0 to 1.
        size: (3,) extent of the object along its axes in metres.
        symmetries: (S, 4, 4) motions in metres that leave the object as it is, identity first.
        coordinates: (H, W, 3) float32 metres in the object's frame, where each pixel lies on the
            object, 0 outside the mask.

    Raises:
        ValueError: naming the field that does not fit this description.
    """

    object_id: int
    R: np.ndarray
    t: np.ndarray
    category: str | None = None
    box: np.ndarray | None = None
    mask: np.ndarray | None = None
    full_mask: np.ndarray | None = None
    visible_fraction: float | None = None
    size: np.ndarray | None = None
    symmetries: np.ndarray | None = None
    coordinates: np.ndarray | None = None

    def __post_init__(self) -> None:
        _set(self, "object_id", require_integer("object_id", self.object_id, 0))
        _set(self, "R", _numbers("R", self.R, (3, 3)))
        _set(self, "t", _numbers("t", self.t, (3,)))
        if not isinstance(self.category, str | None):
            fail("category", "a name or None", repr(self.category))
        for name in ("mask", "full_mask"):
            _set(self, name, _image(name, getattr(self, name), (bool,)))
        if self.visible_fraction is not None:
            share = require_number("visible_fraction", self.visible_fraction, 0, 1)
            _set(self, "visible_fraction", share)
        if self.box is not None:
            _set(self, "box", _numbers("box", self.box, (4,)))
            if (self.box[2:] < 0).any():
                fail("box", "a width and a height of at least 0", self.box.tolist())
        if self.size is not None:
            _set(self, "size", _numbers("size", self.size, (3,)))
            if (self.size < 0).any():
                fail("size", "three lengths of at least 0", self.size.tolist())
        if self.symmetries is not None:
            count = max(1, len(np.atleast_1d(self.symmetries)))
            _set(self, "symmetries", _numbers("symmetries", self.symmetries, (count, 4, 4)))
            if not np.array_equal(self.symmetries[0], np.eye(4)):
                fail("symmetries", "the identity first", self.symmetries[0].tolist())
        _set(self, "coordinates", _image("coordinates", self.coordinates, (np.float32,), 3))
        if self.coordinates is not None:
            self._check_coordinates()

    def _check_coordinates(self) -> None:
        if not np.isfinite(self.coordinates).all():
            fail("coordinates", "finite metres", "others")
        if self.mask is None:
            return
        if self.coordinates.shape[:2] != self.mask.shape:
            fail("coordinates", f"height and width {self.mask.shape} as in the mask", "others")
        if self.coordinates[~self.mask].any():
            fail("coordinates", "0 outside the mask", "others")

    def __repr__(self) -> str:
        seen = "" if self.visible_fraction is None else f", {self.visible_fraction:.0%} visible"
        name = "" if self.category is None else f" {self.category}"
        return f"ObjectView({self.object_id}{name} at {np.round(self.t, 3).tolist()} m{seen})"


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class View:
    """One image of one camera. What is not known is None.

    Attributes:
        K: (3, 3) float64 camera matrix in pixels, the first pixel's centre at (0, 0).
        scene_id, image_id: integers that name the image within its dataset.
        rgb: (H, W, 3) uint8 colour image.
        ir: (H, W) uint8 or uint16 image of one channel: infrared, or grey.
        depth: (H, W) float32 distance along the optical axis in metres, 0 where there is none.
        T_world_cam: (4, 4) float64 pose of the camera in the world: `X_world = T_world_cam X_cam`.
        group: what the views of one instant share, by default `(scene_id, image_id)`.
        objects: the objects in the image.

    Raises:
        ValueError: naming the field that does not fit this description.
    """

    K: np.ndarray
    scene_id: int
    image_id: int
    rgb: np.ndarray | None = None
    ir: np.ndarray | None = None
    depth: np.ndarray | None = None
    T_world_cam: np.ndarray | None = None
    group: str | tuple | None = None
    objects: tuple[ObjectView, ...] = ()

    def __post_init__(self) -> None:
        for name in ("scene_id", "image_id"):
            _set(self, name, require_integer(name, getattr(self, name), 0))
        _set(self, "K", _numbers("K", self.K, (3, 3)))
        if self.K[2].tolist() != [0, 0, 1] or self.K[1, 0] != 0 or (np.diag(self.K) <= 0).any():
            fail("K", "fx s cx / 0 fy cy / 0 0 1 with fx, fy above 0", self.K.tolist())
        _set(self, "rgb", _image("rgb", self.rgb, (np.uint8,), channels=3))
        _set(self, "ir", _image("ir", self.ir, (np.uint8, np.uint16)))
        _set(self, "depth", _image("depth", self.depth, (np.float32,)))
        if self.depth is not None and not (np.isfinite(self.depth) & (self.depth >= 0)).all():
            fail("depth", "finite metres of at least 0", "others")
        if self.T_world_cam is not None:
            _set(self, "T_world_cam", _numbers("T_world_cam", self.T_world_cam, (4, 4)))
            if self.T_world_cam[3].tolist() != [0, 0, 0, 1]:
                fail("T_world_cam", "a last row 0 0 0 1", self.T_world_cam[3].tolist())
        if self.group is None:
            _set(self, "group", (self.scene_id, self.image_id))
        if not isinstance(self.group, str | tuple):
            fail("group", "a name or a tuple", repr(self.group))
        if not all(isinstance(item, ObjectView) for item in self.objects):
            fail("objects", "ObjectViews", [type(item).__name__ for item in self.objects])
        _set(self, "objects", tuple(self.objects))
        for name, image in self._images():
            if image.shape[:2] != self.shape:
                fail(name, f"height and width {self.shape} as in the view", image.shape[:2])

    @property
    def shape(self) -> tuple[int, int] | None:
        """Height and width in pixels, None if the view has no image and no mask."""
        return next((image.shape[:2] for _, image in self._images()), None)

    def __repr__(self) -> str:
        kinds = [name for name in ("rgb", "ir", "depth") if getattr(self, name) is not None]
        size = f"{self.shape[1]} x {self.shape[0]} " if self.shape else ""
        ids = [item.object_id for item in self.objects]
        images = "+".join(kinds) or "no image"
        return f"View(scene {self.scene_id}, image {self.image_id}: {size}{images}, objects {ids})"

    def _images(self) -> Iterator[tuple[str, np.ndarray]]:
        for name in ("rgb", "ir", "depth"):
            if getattr(self, name) is not None:
                yield name, getattr(self, name)
        for i, item in enumerate(self.objects):
            for name in ("mask", "full_mask", "coordinates"):
                if getattr(item, name) is not None:
                    yield f"objects[{i}].{name}", getattr(item, name)


class ModelSet(Protocol):
    """The objects of a dataset: what `info(id)` knows of their shape, and the `mesh(id)`."""

    @property
    def ids(self) -> tuple[int, ...]: ...  # noqa: D102

    def info(self, object_id: int) -> Any: ...  # noqa: D102

    def mesh(self, object_id: int) -> Any: ...  # noqa: D102


class Dataset(ABC):
    """A sequence of views that are read when they are asked for: `dataset[i]`, `len`, `for`."""

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def __getitem__(self, index: int) -> View: ...

    @property
    @abstractmethod
    def object_ids(self) -> tuple[int, ...]:
        """The objects that occur in the views, in ascending order."""

    @abstractmethod
    def models(self) -> ModelSet:
        """The objects' meshes and what is known of their shape.

        Raises:
            ValueError: if the dataset comes without models.
        """

    def __iter__(self) -> Iterator[View]:
        return (self[i] for i in range(len(self)))


def open(source: str, *, split: str | None = None, **options: Any) -> Dataset:
    """Open a dataset by its name.

    Args:
        source: `"headset"`, `"tabletop"` or `"categories"`, a world, made on first use; or
            `"bop:PATH"` and the like, the folder of a dataset: see `data_tools.readers`.
        split: which part of it, for example "train" or "test"; None takes the only one.
        options: what the reader of this kind of source takes besides: of a world `scale`, by
            default the one in force (`data_tools.worlds.world.World.open`); or of the layout's reader.

    Raises:
        ValueError: if the source is of no known kind, or its reader refuses it.
    """
    if not isinstance(source, str):
        fail("source", "a string such as 'bop:PATH'", repr(source))
    kind, colon, path = source.partition(":")
    if colon and not path:
        fail("path", "a folder after the colon", repr(source))
    # Its name is put together here, as a new reader is no reason to measure the old ones again.
    readers = importlib.import_module(f"{__package__}.readers").READERS
    if kind not in readers:
        fail("source", f"KIND or KIND:PATH with KIND one of {', '.join(readers)}", repr(source))
    module, name = readers[kind].split(":")
    reader = operator.attrgetter(name)(importlib.import_module(module))
    return reader(path or None, split=split, **options)


def _set(record: object, name: str, value: object) -> None:
    object.__setattr__(record, name, value)


def _numbers(name: str, value: object, shape: tuple[int, ...]) -> np.ndarray:
    try:
        array = np.asarray(value)
    except ValueError:  # a ragged list
        fail(name, f"shape {shape}", "rows of different lengths")
    if array.dtype.kind not in "fiu":
        fail(name, "numbers", f"dtype {array.dtype}")
    if array.shape != shape:
        fail(name, f"shape {shape}", f"shape {array.shape}")
    if not np.isfinite(array).all():
        fail(name, "finite values", array.tolist())
    if np.abs(array).max(initial=0) > FARTHEST:
        fail(name, f"values of at most {FARTHEST:.0e} in size", array.tolist())
    return array.astype(np.float64)


def _image(
    name: str, value: object, dtypes: tuple[type, ...], channels: int | None = None
) -> np.ndarray | None:
    if value is None:
        return None
    array = np.asarray(value)
    if array.dtype not in dtypes:
        fail(name, " or ".join(np.dtype(t).name for t in dtypes), array.dtype)
    tail = () if channels is None else (channels,)
    if array.ndim != 2 + len(tail) or array.shape[2:] != tail or 0 in array.shape:
        fail(name, "shape (H, W" + "".join(f", {n}" for n in tail) + ")", array.shape)
    return array
