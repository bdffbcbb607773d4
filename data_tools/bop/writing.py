"""Views written as a dataset in the layout of the BOP benchmark, as its toolkit reads it.

    PATH/camera.json, test_targets_bop19.json, test_targets_bop24.json, dataset_info.md
    PATH/models, models_eval: obj_000001.ply, models_info.json
    PATH/SPLIT/000002/{rgb,gray,depth,mask,mask_visib}/000003.png
    PATH/SPLIT/000002/scene_camera.json, scene_gt.json, scene_gt_info.json

Layout and fields: BOP toolkit, docs/bop_datasets_format.md and scripts/calc_gt_info.py. What
differs is said in dataset_info.md. There is no scene_gt_coco.json, which only detection needs: the
toolkit's scripts/calc_gt_coco.py makes it from the masks.
"""

from __future__ import annotations

import json
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from data_tools.bop.model_writing import Model, write_models
from data_tools.bop.models import ModelInfo
from data_tools.storage.folders import new_folder
from data_tools.views import ObjectView, View
from posecore.arrays import fail, require_choice, require_number
from posecore.files import write_bytes
from posecore.rotations import require_rotation

__all__ = ["Silhouettes", "write_dataset"]

Silhouettes = Callable[[View], tuple[np.ndarray, np.ndarray]]
"""Of a view, for each of its N objects, the whole silhouette with what is outside the image: (N,)
pixels, and (N, 4) x, y, width and height."""

LARGEST = np.iinfo(np.uint16).max
VISIBLE = 0.1  # share of an object that must be seen for it to be a target: BOP Challenge 2019
TARGETS = "test_targets_bop19.json"
IMAGES = "test_targets_bop24.json"  # only images: in detection nobody says what is in them
ABOUT = """# {}

Images with exact poses, in the layout of the BOP benchmark.

- Lengths are millimetres. The centre of an image's first pixel is at (0, 0).
- PLY files are binary. Images are PNG files in all splits, train_pbr too.
- Width and height of boxes count pixels: one more than scripts/calc_gt_info.py of the toolkit has.
- What is visible (mask_visib, visib_fract, ...) is as the images' makers know it, not estimated
  from the depth images.

| split | scenes | images |
|---|---|---|
"""


def write_dataset(
    splits: Mapping[str, Iterable[View]],
    path: str | Path,
    models: Mapping[int, Model],
    *,
    models_eval: Mapping[int, Model] | None = None,
    infos: Mapping[int, ModelInfo] | None = None,
    silhouettes: Silhouettes | None = None,
    depth_scale: float = 0.1,
    targets: str | None = None,
) -> None:
    """Write views, and the models of the objects in them, as a BOP dataset.

    The folder appears when everything is in it. Until then its name ends in `.unfinished`; after an
    error nothing is left of it, and what a kill left is taken away by the next call.

    Args:
        splits: the views of each split, such as {"train_pbr": ..., "test": ...}; gone through once,
            in any order. All views of a split have the same kinds of images, all of the dataset the
            same size. Every object has `mask` and `full_mask`.
        path: the folder, new or empty; the folder around it exists.
        models: for every object id its mesh in metres, a `data_tools.shapes.Mesh` or a
            `trimesh.Trimesh`. Normals and colours of its vertices are written too.
        models_eval: the models with which errors are measured; None for the same.
        infos: diameters, boxes and symmetries of the objects; an object that is not in it gets them
            from its mesh (a `Trimesh` knows of no symmetries).
        silhouettes: what is not in a view: how large the silhouettes are, and their boxes, with the
            parts outside the image. None: the size follows from the visible fraction, if the view
            has it, and the box is that of the part inside the image.
        depth_scale: millimetres per unit of the depth images.
        targets: the split of which `test_targets_bop19.json` lists the objects that are at least
            10 % visible, and `test_targets_bop24.json` the images; None for the first whose name
            begins with "test", if there is one.

    Raises:
        ValueError: naming the argument, or the view and what does not fit; nothing is left then.
        OSError: if a file cannot be written; nothing is left then.
    """
    if not isinstance(splits, Mapping) or not splits:
        fail("splits", "views by the name of their split", repr(splits))
    for name in splits:
        if not isinstance(name, str) or not re.fullmatch(
            r"(train|val|test)(_[A-Za-z0-9_]+)?", name
        ):
            fail("splits", "names such as train_pbr, val and test", repr(name))
    tests = [name for name in splits if name.startswith("test")]
    if targets is None and tests:
        targets = tests[0]
    require_choice("targets", targets, (*splits, *([] if tests else [None])))
    depth_scale = require_number("depth_scale", depth_scale, above=0)
    with new_folder(path) as unfinished:
        write_models(unfinished / "models", models, infos or {})
        write_models(unfinished / "models_eval", models_eval or models, infos or {})
        writer = _Writer(unfinished, set(models), depth_scale, silhouettes)
        about = ABOUT.format(Path(os.path.realpath(path)).name)
        for name, views in splits.items():
            images, objects = writer.write_split(name, views)
            scenes = {image["scene_id"] for image in images}
            about += f"| {name} | {len(scenes)} | {len(images)} |\n"
            if name == targets:
                _write_json(unfinished / TARGETS, objects)
                _write_json(unfinished / IMAGES, images)
        write_bytes(unfinished / "dataset_info.md", about.encode())


class _Writer:
    """Writes one split after the other, and what they have in common."""

    def __init__(
        self,
        path: Path,
        object_ids: set[int],
        depth_scale: float,
        silhouettes: Silhouettes | None,
    ) -> None:
        self.path = path
        self.object_ids = object_ids
        self.depth_scale = depth_scale
        self.silhouettes = silhouettes
        self.shape: tuple[int, int] | None = None

    def write_split(
        self, split: str, views: Iterable[View]
    ) -> tuple[list[dict[str, int]], list[dict[str, int]]]:
        """Write the images and the JSON files of a split; returns its targets: images, objects."""
        scenes: dict[int, dict[str, dict[int, Any]]] = {}
        targets = []
        kinds = None
        for number, view in enumerate(views):
            where = f"splits[{split!r}], view {number}"
            if not isinstance(view, View):
                fail(where, "a View", type(view).__name__)
            where += f" (scene {view.scene_id}, image {view.image_id})"
            images = self._check(where, view)
            if (kinds := kinds or set(images)) != set(images):
                fail(where, f"the images {sorted(kinds)}, as of the first view", sorted(images))
            content = scenes.setdefault(
                view.scene_id, {"scene_camera": {}, "scene_gt": {}, "scene_gt_info": {}}
            )
            if view.image_id in content["scene_camera"]:
                fail(where, "each image once", "it a second time")
            infos = self._infos(where, view, images.get("depth"))
            content["scene_camera"][view.image_id] = _camera(where, view, self.depth_scale)
            content["scene_gt"][view.image_id] = [_pose(where, item) for item in view.objects]
            content["scene_gt_info"][view.image_id] = infos
            targets += _targets(view, infos)
            folder = self.path / split / f"{view.scene_id:06d}"
            for kind, image in images.items():
                _write_png(folder / kind / f"{view.image_id:06d}.png", image)
            for row, item in enumerate(view.objects):
                for kind, mask in (("mask", item.full_mask), ("mask_visib", item.mask)):
                    name = f"{view.image_id:06d}_{row:06d}.png"
                    _write_png(folder / kind / name, mask.astype(np.uint8) * 255)
        if not scenes:
            fail(f"splits[{split!r}]", "at least one view", "none")
        for scene_id, content in scenes.items():
            for name, entries in content.items():
                _write_json(self.path / split / f"{scene_id:06d}" / f"{name}.json", entries)
        images = [
            {"im_id": image_id, "scene_id": scene_id}
            for scene_id in sorted(scenes)
            for image_id in sorted(scenes[scene_id]["scene_camera"])
        ]
        order = ("scene_id", "im_id", "obj_id")
        return images, sorted(targets, key=lambda target: [target[key] for key in order])

    def _check(self, where: str, view: View) -> dict[str, np.ndarray]:
        """The images of a view as they are written, by the names of their folders."""
        images: dict[str, np.ndarray] = {}
        if view.rgb is not None:
            images["rgb"] = cv2.cvtColor(view.rgb, cv2.COLOR_RGB2BGR)
        if view.ir is not None:
            images["gray"] = view.ir
        if view.depth is not None:
            units = np.round(view.depth.astype(np.float64) * 1000 / self.depth_scale)
            if units.max() > LARGEST:
                most = LARGEST * self.depth_scale / 1000
                fail(f"{where}: depth", f"at most {most:.3f} m (depth_scale)", view.depth.max())
            images["depth"] = units.astype(np.uint16)
        if not images:
            fail(where, "a view with an image", "none")
        if self.shape is None:
            self.shape = view.shape
            _write_json(self.path / "camera.json", _sensor(view, self.depth_scale))
        if view.shape != self.shape:
            fail(where, f"height and width {self.shape}, as of the first view", view.shape)
        for item in view.objects:
            if item.object_id not in self.object_ids:
                fail(f"{where}: objects", "objects that are in models", item.object_id)
            for name in ("mask", "full_mask"):
                if getattr(item, name) is None:
                    fail(f"{where}: {name} of object {item.object_id}", "a mask", None)
        return images

    def _infos(self, where: str, view: View, depth: np.ndarray | None) -> list[dict[str, Any]]:
        """The entries of scene_gt_info.json for a view."""
        whole = None
        if self.silhouettes is not None:
            pixels, boxes = map(np.asarray, self.silhouettes(view))
            count = len(view.objects)
            if pixels.shape != (count,) or boxes.shape != (count, 4):
                fail(f"{where}: silhouettes", f"({count},) and ({count}, 4)",
                     f"{pixels.shape} and {boxes.shape}")  # fmt: skip
            whole = list(zip(pixels.tolist(), boxes.tolist(), strict=True))
        return [
            _info(item, depth, whole[row] if whole else None)
            for row, item in enumerate(view.objects)
        ]


def _sensor(view: View, depth_scale: float) -> dict[str, Any]:
    height, width = view.shape
    (fx, _, cx), (_, fy, cy), _ = view.K.tolist()
    return {
        "cx": cx, "cy": cy, "depth_scale": depth_scale, "fx": fx, "fy": fy,
        "height": height, "width": width,
    }  # fmt: skip


def _camera(where: str, view: View, depth_scale: float) -> dict[str, Any]:
    entry = {"cam_K": view.K.ravel().tolist(), "depth_scale": depth_scale}
    if view.T_world_cam is not None:
        R, t = view.T_world_cam[:3, :3], view.T_world_cam[:3, 3]
        require_rotation(f"{where}: T_world_cam", R)
        entry["cam_R_w2c"] = R.T.ravel().tolist()
        entry["cam_t_w2c"] = (-R.T @ t * 1000).tolist()
    return entry


def _pose(where: str, item: ObjectView) -> dict[str, Any]:
    require_rotation(f"{where}: R of object {item.object_id}", item.R)
    R, t = item.R.ravel().tolist(), (item.t * 1000).tolist()
    return {"cam_R_m2c": R, "cam_t_m2c": t, "obj_id": item.object_id}


def _info(
    item: ObjectView, depth: np.ndarray | None, whole: tuple[int, list] | None
) -> dict[str, Any]:
    visible, inside = int(item.mask.sum()), int(item.full_mask.sum())
    fraction = item.visible_fraction
    if whole is not None:
        pixels, box = whole
    else:
        # The fraction counts what is outside the image, the full mask does not.
        pixels = round(visible / fraction) if fraction else inside
        box = _box(item.full_mask)
    visible_box = _box(item.mask) if item.box is None else item.box.tolist()
    return {
        "bbox_obj": [_number(x) for x in box] if visible else [-1] * 4,
        "bbox_visib": [_number(x) for x in visible_box] if visible else [-1] * 4,
        "px_count_all": int(pixels),
        "px_count_valid": 0 if depth is None else int((depth[item.full_mask] > 0).sum()),
        "px_count_visib": visible,
        "visib_fract": visible / max(pixels, 1) if fraction is None else fraction,
    }


def _box(mask: np.ndarray) -> list[int]:
    y, x = (np.flatnonzero(mask.any(axis)) for axis in (1, 0))
    return [x[0], y[0], x[-1] + 1 - x[0], y[-1] + 1 - y[0]] if x.size else [-1] * 4


def _number(x: float) -> int | float:
    return int(x) if int(x) == x else float(x)


def _targets(view: View, infos: list[dict[str, Any]]) -> list[dict[str, int]]:
    counts = Counter(
        item.object_id
        for item, info in zip(view.objects, infos, strict=True)
        if info["visib_fract"] >= VISIBLE
    )
    image = {"im_id": view.image_id, "scene_id": view.scene_id}
    return [{"inst_count": n, "obj_id": i, **image} for i, n in counts.items()]


def _write_png(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, cv2.imencode(".png", image)[1].tobytes())


def _write_json(path: Path, content: Any) -> None:
    """JSON of one line for each image, in the order of their ids, or for each target."""
    if isinstance(content, list):
        brackets, lines = "[]", [json.dumps(entry, sort_keys=True) for entry in content]
    else:
        brackets = "{}"
        items = sorted(content.items())
        lines = [f'"{key}": {json.dumps(entry, sort_keys=True)}' for key, entry in items]
    text = brackets[0] + "\n  " + ",\n  ".join(lines) + "\n" + brackets[1] + "\n"
    write_bytes(path, text.encode("ascii"))
