"""All views of a dataset at hand: what is known of them as tensors, their images as bytes."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from tqdm.auto import tqdm

from data_tools.batches.augmentation import Augmentation
from data_tools.batches.decoding import make_piece
from data_tools.batches.files import PIECE, Pieces
from data_tools.batches.identity import identify
from data_tools.batches.indices import to_indices, to_integers
from data_tools.batches.sampling import make_batch
from data_tools.batches.warps import require_size, widened
from data_tools.storage.store import WORLDS
from data_tools.views import Dataset
from posecore.arrays import fail, require_choice, require_number, to_numbers
from posecore.scale import cache_folder

__all__ = ["Stack", "load"]

Batch = dict[str, Tensor]
LABELS = {"instance", "surface"}  # images that are known if all objects have masks, coordinates
OF_OBJECTS = {"image", "row", "object_id", "category", "R", "t", "size", "box", "visible_fraction"}


def load(
    dataset: Dataset,
    *,
    depth_step: float = 1e-4,
    folder: str | Path | None = None,
    progress: bool = True,
) -> Stack:
    """All views of a dataset, decoded once and found again in the cache.

    Worlds and BOP datasets are cached; the images of others, which nothing identifies, stay in
    memory. A world is found by what it was made from; a BOP split by its targets, the contents of
    its JSON files, and names and lengths of its images.

    Args:
        dataset: all of its views have the same kinds of images, of the same size. Masks and
            coordinates are kept if all objects have them; of 16-bit infrared the upper 8 bits.
        depth_step: metres; depth is kept in whole steps, and beyond 65535 of them there is none.
        folder: where the worlds lie, as for `Store`; None for `worlds` in `cache_folder()`.
        progress: whether to show a bar the first time.

    Raises:
        ValueError: naming the argument, or the view that does not fit the others.
        MakingError: if there is no room for the files.
    """
    if not isinstance(dataset, Dataset) or not len(dataset):
        fail("dataset", "what data_tools.open returns, with one view at least", repr(dataset))
    if not isinstance(folder, str | Path | None):
        fail("folder", "a path or None", repr(folder))
    root = cache_folder() / WORLDS if folder is None else Path(folder)
    depth_step = require_number("depth_step", depth_step, above=0)
    name, recipe = identify(dataset)
    place = None if name is None else root / f"{name}-stack"
    recipe = {"source": recipe, "depth_step": depth_step, "piece": PIECE, "count": len(dataset)}
    pieces = Pieces(place, recipe, partial(make_piece, dataset, depth_step))
    return Stack(pieces, len(dataset), depth_step, progress)


class Stack:
    """V views of H x W pixels with N objects in all. Made by `load`; can be pickled.

    `frames` cuts batches of whole images, `crops` of single objects. What is not known of every
    view, or of every object, is None.

    Attributes:
        size: (width, height) of the images in pixels.
        kinds: of images: "rgb", "ir", "depth"; "instance" and "surface" from masks and coordinates.
        depth_step: metres.
        K: (V, 3, 3) float64 camera matrices.
        T_world_cam: (V, 4, 4) float64 poses of the cameras in the world.
        scene_id, image_id: (V,) int64.
        group: (V,) int64; views of one instant have the same number, from 0 on.
        categories: names; None where objects have no category.
        view, slot: (N,) int64 the view in which an object is, ascending, and its place in it.
        object_id: (N,) int64.
        category: (N,) int64 index into `categories`.
        R, t: (N, 3, 3) and (N, 3) float64 poses, metres.
        box: (N, 4) float64 x, y, width, height of what is seen in pixels; 0 for nothing or unknown.
        object_size: (N, 3) float64 extent along the object's axes in metres.
        visible_fraction, full_pixels: (N,) float64, the latter of the whole silhouette.
    """

    def __init__(self, pieces: Pieces, count: int, depth_step: float, progress: bool) -> None:
        self._pieces, self._count, self.depth_step = pieces, count, depth_step
        numbers = range(-(-count // PIECE))
        quiet = not progress or all(pieces.exists(number) for number in numbers)
        bar = tqdm(numbers, desc="stack", unit="piece", disable=quiet)
        tables = [pieces.table(number) for number in bar]
        shapes = [pieces.kinds(number) for number in numbers]
        for number, shape in enumerate(shapes):
            differ = {name for name, _ in shape.items() ^ shapes[0].items()}
            if not differ <= LABELS or differ & shape.keys() & shapes[0].keys():
                fail(f"view {number * PIECE}", f"images as in view 0, {shapes[0]}", shape)
        self.kinds: tuple[str, ...] = tuple(k for k in shapes[0] if all(k in s for s in shapes))
        self.size: tuple[int, int] = next(iter(shapes[0].values()))[1::-1]

        def stack(name: str) -> Tensor | None:
            if not all(name in table for table in tables):
                return None
            return torch.from_numpy(np.concatenate([table[name] for table in tables]))

        self.K, self.T_world_cam = stack("K"), stack("T_world_cam")
        self.scene_id, self.image_id = stack("scene_id"), stack("image_id")
        groups = [group for table in tables for group in table["groups"]]
        number_of = {group: number for number, group in enumerate(dict.fromkeys(groups))}
        self.group = torch.tensor([number_of[group] for group in groups])
        counts = stack("counts")
        self.view = torch.repeat_interleave(torch.arange(count), counts)
        self.slot = torch.arange(len(self.view)) - (counts.cumsum(0) - counts)[self.view]
        self.object_id, self.R, self.t = stack("object_id"), stack("R"), stack("t")
        self.box, self.object_size = stack("box"), stack("size")
        self.visible_fraction, self.full_pixels = stack("visible_fraction"), stack("full_pixels")
        names = [name for table in tables for name in table["categories"]]
        self.categories = self.category = None
        if None not in names:
            self.categories = tuple(sorted(set(names)))
            numbers = [self.categories.index(name) for name in names]
            self.category = torch.tensor(numbers, dtype=torch.int64)

    def __len__(self) -> int:
        """How many views."""
        return self._count

    def __repr__(self) -> str:
        (width, height), kinds = self.size, "+".join(self.kinds)
        return f"Stack({len(self)} views of {width} x {height} {kinds}, {len(self.view)} objects)"

    @property
    def kind(self) -> Tensor:
        """(N,) int64 the category, or the object where there are none."""
        return self.object_id if self.category is None else self.category

    @property
    def groups(self) -> Tensor:
        """(G, n) int64 views of each instant, for `frames`.

        Raises:
            ValueError: if not all instants have the same number of views.
        """
        counts = torch.bincount(self.group)
        if (counts != counts[0]).any():
            fail("groups", "the same number of views in each", counts.unique().tolist())
        return torch.argsort(self.group, stable=True).reshape(len(counts), -1)

    def rows(
        self,
        *,
        object_id: int | Iterable[int] | None = None,
        category: str | None = None,
        visible: float = 0.0,
    ) -> Tensor:
        """The objects that one wants, for `crops`.

        Args:
            object_id: one or several; None for all.
            category: one of `categories`; None for all.
            visible: the least visible fraction. What has no box is left out in any case.

        Returns:
            (M,) int64 rows of the table of objects.

        Raises:
            ValueError: if there is no such category, or visible fractions are not known.
        """
        wanted = (self.box[:, 2:] > 0).all(1)
        if object_id is not None:
            ids = torch.from_numpy(np.atleast_1d(to_integers("object_id", object_id)))
            wanted &= torch.isin(self.object_id, ids)
        if category is not None:
            require_choice("category", category, self.categories or (None,))
            wanted &= self.category == self.categories.index(category)
        if require_number("visible", visible, 0, 1) > 0:
            if self.visible_fraction is None:
                fail("visible", "0, as visible fractions are not known", visible)
            wanted &= self.visible_fraction >= visible
        return wanted.nonzero()[:, 0]

    def check(self, views: Tensor) -> None:
        """Make sure of the images of views, before several threads look at them at once."""
        for number in (views // PIECE).unique().tolist():
            self._pieces.images(number)

    def image(self, kind: str, view: int) -> np.ndarray:
        """One image as it is kept, which is not to be changed: see `data_tools.batches.files`."""
        number, row = divmod(int(view), PIECE)
        return self._pieces.images(number)[kind][row]

    def frames(
        self,
        views: Tensor,
        size: int | tuple[int, int] | None = None,
        *,
        boxes: Tensor | None = None,
        augment: Augmentation | None = None,
        generator: torch.Generator | None = None,
    ) -> Batch:
        """A batch of whole images, or of windows of them.

        Args:
            views: (B,), or (B, n) from `groups`: then what there is for each image has two
                dimensions in place of the first.
            size: (width, height) of the images, or one number for both; None for the data's.
            boxes: (B, 4) x, y, width, height of the part of each view that is shown, made larger
                where its sides have another ratio than `size`; None for the whole.
            augment: what is varied; None for nothing.
            generator: of the variations.

        Returns:
            For each of B images, h x w pixels:

            - "rgb" (B, 3, h, w), "ir" (B, 1, h, w) float32, 0 to 1, in channels_last memory;
            - "depth" (B, h, w) float32 metres, 0 for none;
            - "coordinates" (B, h, w, 3) float32 metres in the frame of the object that is seen;
            - "instance" (B, h, w) int64, the row below of the object that is seen, or -1;
            - "K" (B, 3, 3) and "T_world_cam" (B, 4, 4) float32; "view" and "group" (B,) int64.

            For each of the M objects in them:

            - "image" (M,) int64 in which image it is, counted without the dimension of groups;
            - "R" (M, 3, 3), "t" (M, 3), "size" (M, 3) float32, as in the Stack; "row" in it;
            - "object_id", "category" (M,) int64;
            - "box" (M, 4) float32 x, y, width, height of what is seen, 0 for nothing;
            - "visible_fraction" (M,) float32 share of the silhouette that is seen; what lies
              outside the image counts as unseen.

            What the data do not have is not there.

        Raises:
            ValueError: naming the argument that does not fit this description.
        """
        views = to_indices("views", views, len(self))
        flat = views.reshape(-1)
        size = self.size if size is None else require_size("size", size)
        if boxes is None:
            windows = np.tile([0.0, 0.0, *self.size], (len(flat), 1))
        else:
            windows = widened(to_numbers("boxes", boxes), size, 1.0)
        if len(windows) != len(flat):
            fail("boxes", f"{len(flat)} of them, one a view", len(windows))
        first = torch.searchsorted(self.view, flat)
        last = torch.searchsorted(self.view, flat, right=True)
        image = torch.repeat_interleave(torch.arange(len(flat)), last - first)
        rows = torch.cat([torch.arange(a, b) for a, b in zip(first, last, strict=True)])
        batch = make_batch(self, flat, windows, size, rows, image, False, augment, generator)
        if views.ndim > 1:
            for name in batch.keys() - OF_OBJECTS:
                batch[name] = batch[name].unflatten(0, views.shape)
        return batch

    def crops(
        self,
        rows: Tensor,
        size: int | tuple[int, int] = 128,
        *,
        margin: float = 1.25,
        boxes: Tensor | None = None,
        augment: Augmentation | None = None,
        generator: torch.Generator | None = None,
    ) -> Batch:
        """A batch of objects, cut out each by itself.

        Args:
            rows: (B,) rows of the table of objects.
            size: (width, height) of the crops, or one number for both.
            margin: factor on the smallest box with the sides' ratio of `size` that holds the
                object's, about the same middle.
            boxes: (B, 4) x, y, width, height from a detector, in place of the objects' own.
            augment, generator: as for `frames`.

        Returns:
            As `frames`, with one object for each image, M = B; in place of "instance" and "image"
            there is "mask" (B, h, w) bool, the pixels in which the object is seen.

        Raises:
            ValueError: naming the argument that does not fit this description; an object that is
                not seen has no box of its own.
        """
        rows = to_indices("rows", rows, len(self.view))
        if rows.ndim != 1:
            fail("rows", "shape (B,)", f"shape {tuple(rows.shape)}")
        size = require_size("size", size)
        margin = require_number("margin", margin, above=0)
        if boxes is None:
            boxes = self.box[rows]
            unseen = rows[(boxes[:, 2:] <= 0).any(1)]
            if len(unseen):
                fail("rows", "objects that are seen", f"row {int(unseen[0])}")
        boxes, views = widened(to_numbers("boxes", boxes), size, margin), self.view[rows]
        if len(boxes) != len(rows):
            fail("boxes", f"{len(rows)} of them, one a row", len(boxes))
        image = torch.arange(len(rows))
        batch = make_batch(self, views, boxes, size, rows, image, True, augment, generator)
        if "instance" in batch:
            batch["mask"] = batch.pop("instance") >= 0
        del batch["image"]
        return batch
