"""What is known of all views of a dataset, as tensors, and their images as bytes."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from torch import Tensor
from tqdm.auto import tqdm

from data_tools.batches.files import CHUNK_SIZE, ImageChunks
from data_tools.batches.indices import to_integers
from posecore.arrays import fail, require_choice, require_number

__all__ = ["Table"]

LABELS = {"instance", "surface"}  # images that are known if all objects have masks, coordinates


class Table:
    """V views of H x W pixels with N objects in all, which `Stack` cuts its batches from.

    What is not known of every view, or of every object, is None.

    Args:
        chunks: of the dataset.
        count: V.
        depth_step: metres.
        progress: whether to show a bar while chunks are made.

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
        most_objects: in a view.
        object_id: (N,) int64.
        category: (N,) int64 index into `categories`.
        R, t: (N, 3, 3) and (N, 3) float64 poses, metres.
        box: (N, 4) float64 x, y, width, height of what is seen in pixels; 0 for nothing or unknown.
        object_size: (N, 3) float64 extent along the object's axes in metres.
        visible_fraction, full_pixels: (N,) float64, the latter of the whole silhouette.

    Raises:
        ValueError: naming the first view of a chunk whose images differ from those of view 0.
    """

    def __init__(self, chunks: ImageChunks, count: int, depth_step: float, progress: bool) -> None:
        self._chunks, self._count, self.depth_step = chunks, count, depth_step
        numbers = range(-(-count // CHUNK_SIZE))
        quiet = not progress or all(chunks.exists(number) for number in numbers)
        bar = tqdm(numbers, desc="stack", unit="chunk", disable=quiet)
        tables = [chunks.table(number) for number in bar]
        shapes = [chunks.kinds(number) for number in numbers]
        for number, shape in enumerate(shapes):
            differ = {name for name, _ in shape.items() ^ shapes[0].items()}
            if not differ <= LABELS or differ & shape.keys() & shapes[0].keys():
                fail(f"view {number * CHUNK_SIZE}", f"images as in view 0, {shapes[0]}", shape)
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
        self.most_objects = int(counts.max())
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
        for number in (views // CHUNK_SIZE).unique().tolist():
            self._chunks.images(number)

    def image(self, kind: str, view: int) -> np.ndarray:
        """One image as it is kept, which is not to be changed: see `data_tools.batches.files`."""
        number, row = divmod(int(view), CHUNK_SIZE)
        return self._chunks.images(number)[kind][row]
