"""What the three worlds have in common: their scales, their place on disk, and how they are opened.

A world is described by a `World`: how large it is at each scale, a function that makes one record,
and one that turns a record into views. `WORLD.open(split="train")` gives a dataset; what is not on
disk yet is made when the first view is asked for, and never again.

    def record(recipe, index):
        rng = generator(recipe, index)  # the same scene at every scale, whatever the count
        width, height = recipe["width"], recipe["height"]
        ...
        return {"rgb": rgb, "ids": [3, 1]}

    def views(recipe, index, record):
        return [View(...)]

    WORLD = World("tabletop", sizes=SIZES, record=record, views=views)
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from data_tools.bop.models import ModelInfo
from data_tools.shapes.mesh import Mesh
from data_tools.storage import Store, code_version
from data_tools.views import Dataset, View
from posecore.arrays import fail, require_choice
from posecore.scale import SCALES, scale

__all__ = ["Recipe", "Size", "World", "WorldDataset", "WorldModels", "generator"]

Recipe = dict[str, Any]
"""What a record depends on besides its index and the code: "world", "split", "scale", "width",
"height" and "seed"."""

Record = dict[str, Any]


@dataclass(frozen=True)
class Size:
    """How large a world is at one scale.

    Attributes:
        width, height: of the images, pixels.
        counts: how many records each split has.
    """

    width: int
    height: int
    counts: Mapping[str, int]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class World:
    """A world: everything that is needed to make and to open it.

    Attributes:
        name: by which `data_tools.open` knows it.
        sizes: by the name of the scale; all have the same splits.
        record: `record(recipe, index)` makes a record as `Store` keeps it; a function of a module,
            so that other processes can call it, and the same record whenever it is called.
        views: `views(recipe, index, record)` turns what was kept into `views_per_record` views.
        views_per_record: more than 1 where several cameras see the same instant.
        object_ids: the objects that occur.
        models: the objects; None where no two instances are alike.
        seed: of the whole world.
        shard_size: records in a file.
    """

    name: str
    sizes: Mapping[str, Size]
    record: Callable[[Recipe, int], Record]
    views: Callable[[Recipe, int, Record], Sequence[View]]
    object_ids: tuple[int, ...]
    views_per_record: int = 1
    models: WorldModels | None = None
    seed: int = 0
    shard_size: int = 16

    def __repr__(self) -> str:
        return f"World({self.name!r}, splits {', '.join(self.splits)})"

    @property
    def splits(self) -> tuple[str, ...]:
        """The names of the splits."""
        return tuple(next(iter(self.sizes.values())).counts)

    def recipe(self, split: str, scale_name: str | None = None) -> Recipe:
        """Everything that the records of a split depend on, besides the code.

        Args:
            split: one of `splits`.
            scale_name: "tiny", "book" or "paper"; None for the one in force.

        Raises:
            ValueError: if there is no such split or scale.
        """
        size = self._size(split, scale_name)
        return {
            "world": self.name,
            "split": split,
            "scale": scale() if scale_name is None else scale_name,
            "width": size.width,
            "height": size.height,
            "seed": self.seed,
        }

    def store(self, split: str, scale_name: str | None = None) -> Store:
        """Where the records of a split lie; arguments and errors as for `recipe`."""
        return Store(
            self.name,
            self.recipe(split, scale_name),
            self._size(split, scale_name).counts[split],
            self.record,
            version=code_version(*self.code),
            shard_size=self.shard_size,
        )

    def open(
        self,
        path: None = None,
        *,
        split: str | None = None,
        scale: str | None = None,
        processes: int | None = None,
        progress: bool = True,
        whole: bool = True,
    ) -> WorldDataset:
        """Open a split; what is missing is made when the first view is asked for.

        Args:
            path: nothing; what other kinds of source have after the colon.
            split: one of `splits`.
            scale: "tiny", "book" or "paper"; None for the one in force.
            processes: how many make what is missing; None for one on each core.
            progress: whether to show a bar meanwhile.
            whole: whether to make the whole split then; otherwise each file when it is read, which
                is quicker for those who only want to see a few views.

        Raises:
            ValueError: naming the argument that does not fit this description.
        """
        if path is not None:
            fail("source", f"just {self.name!r}", repr(f"{self.name}:{path}"))
        return WorldDataset(self, split, scale, processes=processes, progress=progress, whole=whole)

    @property
    def code(self) -> tuple[Callable[..., Any], ...]:
        """The functions that decide what is seen: of records, views and meshes."""
        return self.record, self.views, *(self.models.makers.values() if self.models else ())

    def _size(self, split: str, scale_name: str | None) -> Size:
        name = scale() if scale_name is None else scale_name
        require_choice("scale", name, SCALES)
        require_choice("split", split, self.splits)
        return self.sizes[name]


class WorldDataset(Dataset):
    """One split of a world as views. It can be pickled, for the workers of a `DataLoader`.

    Args:
        world: the world.
        split, scale, processes, progress, whole: as for `World.open`.

    Attributes:
        world, split: as above.
        store: the records on disk.

    Raises:
        ValueError: naming the argument that does not fit this description.
    """

    def __init__(
        self,
        world: World,
        split: str | None,
        scale: str | None = None,
        *,
        processes: int | None = None,
        progress: bool = True,
        whole: bool = True,
    ) -> None:
        self.world = world
        self.store = world.store(split, scale)
        self.split: str = split
        self._making = {"processes": processes, "progress": progress}
        self._is_made = not whole
        self._last: tuple[int, Sequence[View]] = (-1, ())

    def __len__(self) -> int:
        return len(self.store) * self.world.views_per_record

    def __getitem__(self, index: int) -> View:
        """A view.

        Raises:
            IndexError: if there is no such view.
            MakingError: if it was not there and cannot be made.
        """
        index = operator.index(index)
        if not -len(self) <= index < len(self):
            raise IndexError(f"{self.world.name}: no view {index} among {len(self)}")
        self.make()
        row, which = divmod(index % len(self), self.world.views_per_record)
        if self._last[0] != row:  # the next view is often of the same instant
            views = self.world.views(self.store.recipe, row, self.store[row])
            self._last = (row, views)
        return self._last[1][which]

    def __repr__(self) -> str:
        return f"WorldDataset({self.world.name!r}, {self.split!r}: {len(self)} views)"

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_last": (-1, ())}

    def make(self) -> None:
        """Make what is missing, if that has not been looked for yet."""
        if not self._is_made:
            if self.store.missing():
                self.store.make(**self._making)
            self._is_made = True

    @property
    def object_ids(self) -> tuple[int, ...]:
        """The ids of the objects, in ascending order."""
        return tuple(sorted(self.world.object_ids))

    def models(self) -> WorldModels:
        """The objects' meshes and what is known of their shape.

        Raises:
            ValueError: if the world has no fixed objects.
        """
        if self.world.models is None:
            fail("dataset", "one of fixed objects", f"{self.world.name}: no two are alike")
        return self.world.models


class WorldModels:
    """The fixed objects of a world, each made when it is first asked for.

    Args:
        meshes: by object id, what makes its mesh.

    Attributes:
        makers: the same, in ascending order.
    """

    def __init__(self, meshes: Mapping[int, Callable[[], Mesh]]) -> None:
        self.makers = dict(sorted(meshes.items()))
        self._meshes: dict[int, Mesh] = {}
        self._infos: dict[int, ModelInfo] = {}

    def __repr__(self) -> str:
        return f"WorldModels(objects {list(self.ids)})"

    @property
    def ids(self) -> tuple[int, ...]:
        """The objects' ids in ascending order."""
        return tuple(self.makers)

    def info(self, object_id: int) -> ModelInfo:
        """Diameter, box and symmetries of an object.

        Raises:
            ValueError: if there is no such object.
        """
        if object_id not in self._infos:
            self._infos[object_id] = _info(self.mesh(object_id))
        return self._infos[object_id]

    def mesh(self, object_id: int) -> Mesh:
        """The mesh of an object.

        Raises:
            ValueError: if there is no such object.
        """
        require_choice("object_id", object_id, self.ids)
        if object_id not in self._meshes:
            self._meshes[object_id] = self.makers[object_id]()
        return self._meshes[object_id]


def generator(recipe: Recipe, index: int) -> np.random.Generator:
    """The random numbers of one record: its own, whatever the scale and the other records."""
    names = (int.from_bytes(recipe[key].encode(), "big") for key in ("world", "split"))
    return np.random.default_rng([*names, recipe["seed"], index])


def _info(mesh: Mesh) -> ModelInfo:
    turns = () if mesh.axis is None else ((mesh.axis, np.zeros(3)),)
    # The symmetries of a solid of revolution are its turns, which the axis stands for.
    discrete = mesh.symmetries[1:] if mesh.axis is None else np.zeros((0, 4, 4))
    return ModelInfo(mesh.diameter, mesh.bounds[0], mesh.size, discrete, turns)
