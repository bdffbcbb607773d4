"""All views of a dataset at hand, and batches that are cut out of them."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from data_tools.batches.augmentation import Augmentation
from data_tools.batches.decoding import make_chunk
from data_tools.batches.files import CHUNK_SIZE, ImageChunks
from data_tools.batches.identity import identify
from data_tools.batches.indices import to_indices
from data_tools.batches.memory import require_bytes, require_room
from data_tools.batches.sampling import make_batch
from data_tools.batches.table import Table
from data_tools.batches.warps import require_size, widened
from data_tools.storage.store import WORLDS
from data_tools.views import Dataset
from posecore.arrays import fail, require_number, to_numbers
from posecore.scale import cache_folder

__all__ = ["Stack", "load"]

Batch = dict[str, Tensor]
OBJECT_KEYS = {"row", "object_id", "category", "R", "t", "size", "box", "visible_fraction"}


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
        ValueError: naming the argument, or the view that does not fit the others; if images that
            are not cached do not fit into memory.
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
    recipe = {
        "source": recipe,
        "depth_step": depth_step,
        "piece": CHUNK_SIZE,
        "count": len(dataset),
    }
    chunks = ImageChunks(place, recipe, partial(make_chunk, dataset, depth_step))
    if place is None:  # all of it stays in memory: as much for each chunk as for the first one
        first = sum(images.nbytes for images in chunks.images(0).values())
        needed = first * len(dataset) / min(CHUNK_SIZE, len(dataset))
        require_bytes("dataset", "images that fit into", f"{len(dataset)} images", needed)
    return Stack(chunks, len(dataset), depth_step, progress)


class Stack(Table):
    """A table of views and objects, and batches of their images. Made by `load`; can be pickled.

    `frames` cuts batches of whole images, `crops` of single objects. What the table holds is said
    of `Table`; what is not known of every view, or of every object, is None.
    """

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
            Of B images, h x w pixels:

            - "rgb" (B, 3, h, w), "ir" (B, 1, h, w) float32, 0 to 1, in channels_last memory;
            - "depth" (B, h, w) float32 metres, 0 for none;
            - "coordinates" (B, h, w, 3) float32 metres in the frame of the object that is seen;
            - "instance" (B, h, w) int64, which of the M objects below is seen, or -1;
            - "K" (B, 3, 3) and "T_world_cam" (B, 4, 4) float32; "view" and "group" (B,) int64.

            Of the objects in each of them, as many as the fullest view of the data has; all is -1
            where there are fewer:

            - "object_id", "category", "row" (B, M) int64, the last in the table of the Stack;
            - "R" (B, M, 3, 3), "t" (B, M, 3), "size" (B, M, 3) float32;
            - "box" (B, M, 4) float32 x, y, width, height of what is seen, 0 for nothing;
            - "visible_fraction" (B, M) float32 share of the silhouette that is seen; what lies
              outside the image counts as unseen.

            What the data do not have is not there.

        Raises:
            ValueError: naming the argument that does not fit this description, or a batch that does
                not fit into memory.
        """
        views = to_indices("views", views, len(self))
        flat = views.reshape(-1)
        size = self.size if size is None else require_size("size", size)
        require_room("views" if len(flat) > 1 else "size", len(flat), size)
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
        batch = self._by_image(batch, len(flat))
        if views.ndim > 1:
            batch = {name: values.unflatten(0, views.shape) for name, values in batch.items()}
        return batch

    def _by_image(self, batch: Batch, count: int) -> Batch:
        """One table of all objects, (N, ...), as one for each image, (B, M, ...)."""
        image = batch.pop("image")
        slot = self.slot[batch["row"]]
        for name in OBJECT_KEYS & batch.keys():
            values = batch[name]
            dense = values.new_full((count, self.most_objects, *values.shape[1:]), -1)
            dense[image, slot] = values
            batch[name] = dense
        if "instance" in batch:
            # Row -1 of a table that has a last row more is what is no object.
            batch["instance"] = torch.cat([slot, slot.new_tensor([-1])])[batch["instance"]]
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
            As `frames`, but of one object in each image, (B, ...) without M; in place of "instance"
            there is "mask" (B, h, w) bool, the pixels in which it is seen.

        Raises:
            ValueError: naming the argument that does not fit this description, or a batch that does
                not fit into memory; an object that is not seen has no box of its own.
        """
        rows = to_indices("rows", rows, len(self.view))
        if rows.ndim != 1:
            fail("rows", "shape (B,)", f"shape {tuple(rows.shape)}")
        size = require_size("size", size)
        require_room("rows" if len(rows) > 1 else "size", len(rows), size)
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
