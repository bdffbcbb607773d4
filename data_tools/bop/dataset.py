"""One split of a dataset in the layout of the BOP benchmark, as views.

    PATH/models[_eval]/obj_000001.ply, models_info.json
    PATH/SPLIT/000002/{rgb,gray,depth,mask,mask_visib}/000003.png
    PATH/SPLIT/000002/scene_camera.json, scene_gt.json, scene_gt_info.json

With several sensors, names end in that of one: see `data_tools.bop.layout`. Layout: BOP
toolkit, docs/bop_datasets_format.md. Cameras are read when the dataset is opened, poses when the
first image of their scene is asked for, images when they are asked for.
"""

from __future__ import annotations

import operator
from collections import Counter
from functools import cached_property
from pathlib import Path

import numpy as np

from data_tools.bop.files import (
    IMAGE_SUFFIXES,
    find_image,
    has_file,
    has_folder,
    read_depth,
    read_grey,
    read_mask,
    read_rgb,
    refuse_broken_link,
)
from data_tools.bop.layout import SceneFiles, choose_sensor, find_scenes, number_of
from data_tools.bop.models import Models
from data_tools.bop.scenes import Annotations, Camera, read_annotations, read_cameras
from data_tools.bop.targets import read_targets
from data_tools.views import Dataset, ObjectView, View
from posecore.arrays import fail, require_choice
from posecore.metrics.pose_table import PoseTable

__all__ = ["BopDataset"]

MODEL_FOLDERS = ("models", "models_eval", "models_cad", "models_reconst")


class BopDataset(Dataset):
    """The images of one split, in the order of scene and image id.

    The images are those that `scene_camera.json` lists, with the objects that `scene_gt.json` lists
    for them. Only test splits may lack that file, as some of BOP's keep the poses secret: their
    views have no objects.

    A view has what the scene's folder has: `rgb` becomes `rgb`, `gray` becomes `ir`, `depth` is
    depth, `mask_visib` the masks and `mask` the full masks; a folder that is there must have its
    file for every image that is asked for. Boxes and visible fractions come from
    `scene_gt_info.json`, sizes and symmetries from the models; without those files they are None.

    Args:
        path: the dataset's folder.
        split: name of the split's folder, such as "test" or "train_pbr"; None if there is only one.
            "val:cam1" is `sensor` "cam1" of "val".
        targets: a file such as "test_targets_bop19.json", by its path or its name in the dataset's
            folder: only the images and the objects that it lists; of several instances of an
            object the `inst_count` most visible ones, if visible fractions are known. One that
            lists images, such as "test_targets_bop24.json": these with all of their objects.
        sensor: of several, such as "cam1"; None for the only one, or for files without a sensor in
            their names. Scenes in which it was not there are left out.
        rotations: "project" turns rotations that are slightly off into the nearest ones and warns
            once per file if they are noticeably off; "as_read" leaves them, to reproduce the
            figures of others.

    Raises:
        ValueError: naming the argument, or the file and what is wrong in it.
    """

    def __init__(
        self,
        path: str | Path,
        split: str | None = None,
        *,
        targets: str | Path | None = None,
        sensor: str | None = None,
        rotations: str = "project",
    ) -> None:
        require_choice("rotations", rotations, ("project", "as_read"))
        if not isinstance(path, str | Path) or not Path(path).is_dir():
            fail("path", "the folder of a BOP dataset", repr(path))
        self.path = Path(path)
        splits = sorted(p.name for p in self.path.iterdir() if p.is_dir() and find_scenes(p))
        if not splits:
            for place in sorted(self.path.iterdir()):
                refuse_broken_link(place)
            fail("path", "a folder with splits and scenes, such as test/000001", repr(str(path)))
        if isinstance(split, str) and sensor is None:
            split, _, name = split.partition(":")
            sensor = name or None
        if split is None and len(splits) == 1:
            split = splits[0]
        if split not in splits:
            if isinstance(split, str):
                refuse_broken_link(self.path / split)
            fail("split", f"one of {', '.join(splits)} in {path}", repr(split))
        self.split: str = split
        self.rotations = rotations
        self._scenes = choose_sensor(find_scenes(self.path / split), sensor)
        self.sensor: str = next(iter(self._scenes.values())).sensor
        self._cameras = {i: _read_scene_cameras(p, rotations) for i, p in self._scenes.items()}
        self._annotations: dict[int, Annotations] = {}
        self._shapes: dict[int, tuple[np.ndarray | None, np.ndarray | None]] = {}
        self._targets = None
        if targets is not None:
            file = self.path / targets
            known = {(i, image) for i, cameras in self._cameras.items() for image in cameras}
            self._targets = read_targets(file if has_file(file) else Path(targets), known, split)
        index = [(scene, image) for scene, cameras in self._cameras.items() for image in cameras]
        self._index = [key for key in index if self._targets is None or key in self._targets]

    def __len__(self) -> int:
        return len(self._index)

    def __getitem__(self, index: int) -> View:
        scene_id, image_id = self._index[operator.index(index)]
        camera = self._cameras[scene_id][image_id]
        files, stem = self._scenes[scene_id], f"{image_id:06d}"
        images = {
            name: read(find_image(folder, stem))
            for name, kind, read in (("rgb", "rgb", read_rgb), ("ir", "gray", read_grey))
            if (folder := files.images(kind)) is not None
        }
        if files.images("depth") is not None:
            images["depth"] = _read_scene_depth(files, stem, camera)
        annotations = self._annotations_of(scene_id)
        first = annotations.rows.get(image_id, range(0)).start
        objects = tuple(
            self._object(annotations, row, files, f"{stem}_{row - first:06d}")
            for row in self._rows(scene_id, image_id)
        )
        try:
            return View(
                K=camera.K,
                scene_id=scene_id,
                image_id=image_id,
                T_world_cam=camera.T_world_cam,
                objects=objects,
                **images,
            )
        except ValueError as error:
            raise ValueError(f"{files.folder}: image {image_id}: {error}") from error

    def __repr__(self) -> str:
        part = self.split + (f":{self.sensor}" if self.sensor else "")
        return f"BopDataset({str(self.path)!r}, {part!r}: {len(self)} images)"

    @cached_property
    def object_ids(self) -> tuple[int, ...]:
        """The objects that occur in the images, in ascending order; reads all scenes' poses."""
        return tuple(np.unique(self.ground_truth().object_id).tolist())

    @property
    def images(self) -> list[tuple[int, int]]:
        """(scene id, image id) of every view."""
        return list(self._index)

    def ground_truth(self, targets_only: bool = True) -> PoseTable:
        """All poses of the split, in the order of the views; no image is read for it.

        Args:
            targets_only: of images with targets only these, as the views have it; else whatever
                is known to be in the images that have some.
        """
        keys = [(*key, row) for key in self._index for row in self._rows(*key, targets_only)]
        rows = [(self._annotations_of(scene), row) for scene, _, row in keys]
        return PoseTable(
            scene_id=np.array([scene for scene, _, _ in keys], np.int64),
            image_id=np.array([image for _, image, _ in keys], np.int64),
            object_id=np.array([a.object_id[row] for a, row in rows], np.int64),
            R=np.reshape([a.R[row] for a, row in rows], (-1, 3, 3)),
            t=np.reshape([a.t[row] for a, row in rows], (-1, 3)),
            score=np.ones(len(rows)),
            time=np.full(len(rows), -1.0),
        )

    def camera(self, scene_id: int, image_id: int) -> Camera:
        """The camera of one image.

        Raises:
            ValueError: if the split holds no such image.
        """
        if image_id not in self._cameras.get(scene_id, {}):
            fail("image_id", f"an image of scene {scene_id} in {self.split}", image_id)
        return self._cameras[scene_id][image_id]

    def models(self, folder: str | None = None) -> Models:
        """The objects' models.

        Args:
            folder: name of the folder, such as "models_eval"; None for the first that is there of
                "models", "models_eval", "models_cad" and "models_reconst".

        Raises:
            ValueError: if there is no such folder, or it is damaged.
        """
        if folder is not None:
            return Models(self.path / folder)
        if self._models is None:
            raise ValueError(f"{self.path}: no models: none of the folders {MODEL_FOLDERS}")
        return self._models

    @cached_property
    def _models(self) -> Models | None:
        folder = next((f for f in MODEL_FOLDERS if has_folder(self.path / f)), None)
        return None if folder is None else Models(self.path / folder)

    def _object(
        self, annotations: Annotations, row: int, files: SceneFiles, stem: str
    ) -> ObjectView:
        object_id = int(annotations.object_id[row])
        box, fraction = annotations.box, annotations.visible_fraction
        size, symmetries = self._shape_of(object_id)
        return ObjectView(
            object_id=object_id,
            R=annotations.R[row],
            t=annotations.t[row],
            box=None if box is None or np.isnan(box[row, 0]) else box[row],
            mask=_read_scene_mask(files.images("mask_visib"), stem),
            full_mask=_read_scene_mask(files.images("mask"), stem),
            visible_fraction=None if fraction is None else float(fraction[row]),
            size=size,
            symmetries=symmetries,
        )

    def _shape_of(self, object_id: int) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Size and symmetries of an object, None where there is no model of it."""
        if object_id not in self._shapes:
            known = self._models is not None and object_id in self._models.ids
            info = self._models.info(object_id) if known else None
            self._shapes[object_id] = (info.size, info.symmetries()) if info else (None, None)
        return self._shapes[object_id]

    def _rows(self, scene_id: int, image_id: int, targets_only: bool = True) -> list[int]:
        """The rows of the objects in an image, those that are targets if there are targets."""
        annotations = self._annotations_of(scene_id)
        rows = annotations.rows.get(image_id, range(0))
        if annotations.known is not None:
            rows = [row for row in rows if annotations.known[row]]
        if self._targets is None or not targets_only:
            return list(rows)
        wanted = self._targets[scene_id, image_id]
        if wanted is None:
            return list(rows)
        chosen: list[int] = []
        for object_id, count in wanted.items():
            instances = [row for row in rows if annotations.object_id[row] == object_id]
            if annotations.visible_fraction is not None:
                instances.sort(key=lambda row: -annotations.visible_fraction[row])
                instances = instances[:count]
            chosen += instances
        return sorted(chosen)

    def _annotations_of(self, scene_id: int) -> Annotations:
        if scene_id not in self._annotations:
            self._annotations[scene_id] = self._read_annotations(scene_id)
        return self._annotations[scene_id]

    def _read_annotations(self, scene_id: int) -> Annotations:
        files = self._scenes[scene_id]
        path, info_path = files.json("scene_gt"), files.json("scene_gt_info")
        if not has_file(path) and not has_file(info_path) and self.split.startswith("test"):
            return Annotations({}, np.zeros(0, np.int64), np.zeros((0, 3, 3)), np.zeros((0, 3)))
        info = info_path if has_file(info_path) else None
        annotations = read_annotations(path, info, self.rotations)
        for image_id in annotations.rows:
            if image_id not in self._cameras[scene_id]:
                raise ValueError(f"{path}: image {image_id} has poses, but no camera")
        for (scene, image_id), wanted in (self._targets or {}).items():
            rows = annotations.rows.get(image_id, range(0))
            there = Counter(annotations.object_id[rows].tolist())
            lost = [object_id for object_id, n in (wanted or {}).items() if there[object_id] < n]
            if scene == scene_id and lost:
                raise ValueError(
                    f"{path}: image {image_id} has too few of the target objects {sorted(lost)}"
                )
        return annotations


def _read_scene_cameras(files: SceneFiles, rotations: str) -> dict[int, Camera]:
    """The cameras of a scene, and that no image is without one."""
    path = files.json("scene_camera")
    cameras = read_cameras(path, rotations)
    for kind in ("rgb", "gray", "depth"):
        folder = files.images(kind)
        for file in sorted(folder.iterdir()) if folder is not None else ():
            image = number_of(file.stem) if file.suffix.lower() in IMAGE_SUFFIXES else None
            if image is not None and image not in cameras:
                raise ValueError(f"{path}: no camera for {folder.name}/{file.name}")
    return cameras


def _read_scene_depth(files: SceneFiles, stem: str, camera: Camera) -> np.ndarray:
    path = find_image(files.images("depth"), stem)
    if camera.depth_scale is None:
        where = f"{files.json('scene_camera')}: image {stem}"
        raise ValueError(f"{where}: depth_scale is missing")
    return read_depth(path, camera.depth_scale)


def _read_scene_mask(folder: Path | None, stem: str) -> np.ndarray | None:
    return None if folder is None else read_mask(find_image(folder, stem))
