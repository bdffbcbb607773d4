"""One split of LINEMOD, of all its objects or of some, as views.

    PATH/cat/JPEGImages/000012.jpg, mask/0012.png, pose/pose12.npy     PVNet (Peng et al., CVPR
    PATH/cat/cat.ply, farthest.txt, train.txt, test.txt                2019); metres

    PATH/rgb/12.jpg, mask/12.png, pose/pose12.npy or 12.npy            an own object, as PVNet's
    PATH/model.ply, camera.txt, diameter.txt                           public code has it; metres

    PATH/data/06/{rgb,depth,mask}/0012.png, gt.yml, info.yml           DenseFusion (Wang et al.,
    PATH/data/06/train.txt, test.txt                                   CVPR 2019); millimetres
    PATH/models/obj_06.ply, models_info.yml
    PATH/segnet_results/06_label/0012_label.png

Pictures may be PNG, JPEG, TIFF or BMP; a mask is whatever is not black. Models may be OBJ or STL.
Lists are read when the dataset is opened, the poses of an object when its first image is asked for,
images when they are asked for.
"""

from __future__ import annotations

import operator
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from data_tools.bop.files import has_folder, read_depth, read_mask, read_rgb
from data_tools.linemod.folders import (
    Numbered,
    ObjectFolder,
    find_objects,
    lists_of,
    read_numbers_of,
)
from data_tools.linemod.models import LinemodModels
from data_tools.linemod.poses import Frame, read_frames
from data_tools.views import Dataset, ObjectView, View
from posecore.arrays import fail, require_choice
from posecore.metrics.pose_table import PoseTable

__all__ = ["LinemodDataset"]


class LinemodDataset(Dataset):
    """The images of one split, in the order of object ids and of the lists.

    Of the objects in an image one is known, that of its folder; its id is also the `scene_id`, as
    in BOP. A view has what the folders hold: without a folder of depth or masks there are none, but
    a folder that is there must have its file for every image that is asked for. Boxes come from
    `gt.yml`, sizes and symmetries from the models. LINEMOD's camera is taken where the files name
    none.

    Args:
        path: the folder of one object, or of the dataset; which layout it has is seen.
        split: "train" or "test", what `train.txt` or `test.txt` lists; None if there is only one of
            them, or for all images if there is none.
        object_id: one of the objects, or several; 1 is an own object's. None for all.
        cls: the same by their names, such as "cat"; an own object's is that of its folder.
        masks: "given", or "segnet" for those that DenseFusion's segmentation found.
        rotations: "project" turns rotations that are slightly off into the nearest ones and warns
            once per object if they are noticeably off; "as_read" leaves them.

    Raises:
        ValueError: naming the argument, or the file and what is wrong in it.
    """

    def __init__(
        self,
        path: str | Path,
        split: str | None = None,
        *,
        object_id: int | Iterable[int] | None = None,
        cls: str | Iterable[str] | None = None,
        masks: str = "given",
        rotations: str = "project",
    ) -> None:
        require_choice("masks", masks, ("given", "segnet"))
        require_choice("rotations", rotations, ("project", "as_read"))
        if not isinstance(path, str | Path) or not Path(path).is_dir():
            fail("path", "the folder of LINEMOD or of one of its objects", repr(path))
        self.path = Path(path).absolute()
        self.masks, self.rotations = masks, rotations
        self._folders = find_objects(self.path)
        if object_id is not None and cls is not None:
            fail("cls", "None, as object_id is given", repr(cls))
        if object_id is not None:
            self._choose("object_id", object_id, {i: i for i in self._folders})
        if cls is not None:
            self._choose("cls", cls, {f.name: i for i, f in self._folders.items()})
        folders = list(self._folders.values())
        if masks == "segnet" and any(folder.layout != "densefusion" for folder in folders):
            fail("masks", "'given', as only DenseFusion's layout has others", repr(masks))
        self.split = self._find_split(split)
        self._frames: dict[int, dict[int, Frame]] = {}
        self._files: dict[int, dict[str, Numbered]] = {}
        self._index = [(f.object_id, image) for f in folders for image in self._list(f)]

    def __len__(self) -> int:
        return len(self._index)

    def __getitem__(self, index: int) -> View:
        object_id, image = self._index[operator.index(index)]
        frame = self._frames_of(object_id)[image]
        files = {kind: numbered[image] for kind, numbered in self._files_of(object_id).items()}
        rgb = read_rgb(files["rgb"])
        depth = read_depth(files["depth"], frame.depth_scale) if "depth" in files else None
        mask = _read_mask(files["mask"]) if "mask" in files else None
        info = self._models.info(object_id) if object_id in self._models.ids else None
        try:
            item = ObjectView(
                object_id=object_id,
                R=frame.R,
                t=frame.t,
                box=frame.box,
                mask=mask,
                size=None if info is None else info.size,
                symmetries=None if info is None else info.symmetries(),
            )
            return View(
                K=frame.K, scene_id=object_id, image_id=image, rgb=rgb, depth=depth, objects=(item,)
            )
        except ValueError as error:
            raise ValueError(f"{self._folders[object_id].path}: image {image}: {error}") from error

    def __repr__(self) -> str:
        names = ", ".join(folder.name for folder in self._folders.values())
        split = "all images" if self.split is None else repr(self.split)
        return f"LinemodDataset({str(self.path)!r}, {split} of {names}: {len(self)} images)"

    @property
    def object_ids(self) -> tuple[int, ...]:
        """The objects that occur in the images, in ascending order."""
        return tuple(self._folders)

    @property
    def images(self) -> list[tuple[int, int]]:
        """(object id, image number) of every view."""
        return list(self._index)

    def ground_truth(self) -> PoseTable:
        """All poses of the split, in the order of the views; no image is read for it."""
        frames = [self._frames_of(object_id)[image] for object_id, image in self._index]
        scene_id, image_id = np.array(self._index, np.int64).T
        return PoseTable(
            scene_id=scene_id,
            image_id=image_id,
            object_id=scene_id,
            R=np.array([frame.R for frame in frames]),
            t=np.array([frame.t for frame in frames]),
            score=np.ones(len(frames)),
            time=np.full(len(frames), -1.0),
        )

    def camera(self, scene_id: int, image_id: int) -> Frame:
        """The camera of one image, `K` (3, 3), with what else is known of the image.

        Raises:
            ValueError: if the split holds no such image.
        """
        frames = self._frames_of(scene_id) if scene_id in self._folders else {}
        if image_id not in frames:
            fail("image_id", f"an image of object {scene_id} in {self.path}", image_id)
        return frames[image_id]

    def models(self) -> LinemodModels:
        """The objects' models.

        Raises:
            ValueError: if there are none.
        """
        if not self._models.ids:
            raise ValueError(f"{self.path}: no models of the objects {list(self._folders)}")
        return self._models

    @cached_property
    def _models(self) -> LinemodModels:
        return LinemodModels(self._folders)

    def _choose(self, name: str, wanted: Any, known: dict[Any, int]) -> None:
        """Keep the folders of the objects that an argument names."""
        single = isinstance(wanted, str) or not isinstance(wanted, Iterable)
        items = [wanted] if single else list(wanted)
        for item in items or [items]:
            if isinstance(item, bool) or item not in list(known):
                known_ones = ", ".join(map(str, known))
                fail(name, f"one or several of {known_ones} in {self.path}", repr(item))
        ids = sorted(known[item] for item in set(items))
        self._folders = {i: self._folders[i] for i in ids}

    def _find_split(self, split: Any) -> str | None:
        lists = lists_of(self._folders.values())
        if split is None and len(lists) < 2:
            return lists[0] if lists else None
        if split not in lists:
            known = f"one of {', '.join(lists)}" if lists else "None, as there are no lists"
            fail("split", f"{known} in {self.path}", repr(split))
        return split

    def _list(self, folder: ObjectFolder) -> list[int]:
        """The images of an object that belong to the split."""
        if self.split is not None:
            return read_numbers_of(folder.path / f"{self.split}.txt")
        images = self._files_of(folder.object_id)["rgb"]
        if not images.numbers:
            raise ValueError(f"{images.folder}: no images")
        return images.numbers

    def _frames_of(self, object_id: int) -> dict[int, Frame]:
        if object_id not in self._frames:
            images = [image for i, image in self._index if i == object_id]
            folder = self._folders[object_id]
            self._frames[object_id] = read_frames(folder, images, self.rotations)
        return self._frames[object_id]

    def _files_of(self, object_id: int) -> dict[str, Numbered]:
        """The images of an object, by kind."""
        if object_id not in self._files:
            folder = self._folders[object_id]
            path, layout = folder.path, folder.layout
            kinds = {"rgb": path / ("JPEGImages" if layout == "pvnet" else "rgb")}
            if layout == "densefusion" and has_folder(path / "depth"):
                kinds["depth"] = path / "depth"
            if self.masks == "segnet":
                kinds["mask"] = path.parents[1] / "segnet_results" / f"{object_id:02d}_label"
            elif has_folder(path / "mask"):
                kinds["mask"] = path / "mask"
            self._files[object_id] = {kind: Numbered(place) for kind, place in kinds.items()}
        return self._files[object_id]


def _read_mask(path: Path) -> np.ndarray:
    """A mask (H, W), bool: true where the image is not black, whatever its colour."""
    return read_mask(path)
