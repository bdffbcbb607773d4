"""Views of AR glasses written in the layout of `data_tools.hmdpose`, to be read back the same."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import cv2
import numpy as np

from data_tools.bop.model_writing import Model, write_models
from data_tools.bop.models import ModelInfo
from data_tools.hmdpose.calibration import CAMERAS, Calibration, Camera, to_json
from data_tools.hmdpose.dataset import CALIBRATION, HEAD, LABELS, POSES
from data_tools.hmdpose.tables import GLASSES, MOST_FRAMES, OBJECTS, to_csv
from data_tools.storage.folders import new_folder
from data_tools.views import ObjectView, View
from posecore.arrays import fail, require_number
from posecore.files import write_bytes
from posecore.poses import compose, from_matrix
from posecore.rotations import matrix_to_quaternion, require_rotation

__all__ = ["write_hmdpose"]

LARGEST = np.iinfo(np.uint16).max
AGREEMENT = 1e-6  # by which the poses in the car may differ that the three views have
KINDS = {"mask": "masks", "full_mask": "full_masks"}


def write_hmdpose(
    splits: Mapping[str, Iterable[View]],
    path: str | Path,
    models: Mapping[int, Model] | None = None,
    *,
    infos: Mapping[int, ModelInfo] | None = None,
    depth_step: float = 1e-4,
) -> None:
    """Write views of AR glasses for `HmdposeDataset`, which reads the same views.

    Images, masks, cameras, boxes, shares and sizes come back bit by bit, poses to 1e-15, depth that
    is in whole steps too. The folder appears when everything is in it; after an error nothing is
    left.

    Args:
        splits: the views of each split; gone through once. Left, centre and right follow one
            another, with `image_id` 3 * frame, 3 * frame + 1 and 3 * frame + 2, the subject as
            `scene_id`, `ir`, `T_world_cam` and the glasses (1 to 4) among the objects; the head (5)
            is in all views of a split or in none. Cameras and kinds of images stay the same.
        path: the folder, new or empty; the folder around it exists.
        models: of the glasses by their id, meshes in metres; None for no models.
        infos: diameters, boxes and symmetries of the models; the others get them from the meshes.
        depth_step: metres of a unit of the depth images.

    Raises:
        ValueError: naming the argument, or the view and what does not fit.
        OSError: if a file cannot be written.
    """
    if not isinstance(splits, Mapping) or not splits:
        fail("splits", "views by the name of their split", repr(splits))
    for name in splits:
        if not isinstance(name, str) or not re.fullmatch(r"(?!models$)[A-Za-z0-9_]+", name):
            fail("splits", "names such as train and test", repr(name))
    depth_step = require_number("depth_step", depth_step, None, 1, above=0)
    with new_folder(path) as folder:
        if models is not None:
            write_models(folder / "models", models, infos or {})
        cameras: dict[str, Camera] = {}
        depth = [
            _write_split(folder / name, f"splits[{name!r}]", views, cameras, depth_step)
            for name, views in splits.items()
        ]
        calibration = Calibration(cameras, depth_step if any(depth) else None)
        write_bytes(folder / CALIBRATION, to_json(calibration))


def _write_split(
    folder: Path, where: str, views: Iterable[View], cameras: dict[str, Camera], step: float
) -> bool:
    """Write images and tables of a split; returns whether it has depth."""
    folder.mkdir()
    poses: dict[int, list] = {}
    labels: list[list] = []
    kinds: set | None = None
    for number, triple in enumerate(_triples(where, views)):
        frame = _frame_of(f"{where}, views {3 * number} to {3 * number + 2}", triple)
        place = f"{where}, frame {frame}"
        if frame in poses:
            fail(place, "each frame once", "it a second time")
        glasses = []
        for name, view in zip(CAMERAS, triple, strict=True):
            here = f"{place}, {name}"
            _check_camera(here, cameras, name, view)
            objects = _objects(here, view)
            images = _images(here, view, objects, step)
            found = set(images) | set(objects)
            if (kinds := found if kinds is None else kinds) != found:
                fail(here, f"{_words(kinds)}, as of the first view", _words(found))
            for kind, image in images.items():
                _write_png(folder / kind / name / f"{frame:06d}.png", image)
            labels += [[frame, name, *_label(key, item)] for key, item in objects.items()]
            glasses.append(objects["glasses"])
        poses[frame] = [frame, triple[0].scene_id, *_in_car(place, triple, glasses)]
    if not poses:
        fail(where, "at least three views", "none")
    write_bytes(folder / POSES, to_csv(poses.values(), "poses"))
    # Without any label the head is not known of, so that its rows say that it is there.
    if any(row[2] == "head" or set(row[3:]) != {None} for row in labels):
        write_bytes(folder / LABELS, to_csv(labels, "labels"))
    return "depth" in kinds


def _in_car(where: str, triple: tuple[View, ...], glasses: list[ObjectView]) -> list:
    """Which glasses, and position and quaternion in the car, as the three views agree on them."""
    ids = [item.object_id for item in glasses]
    if len(set(ids)) > 1:
        fail(where, "the same glasses in the three views", ids)
    pairs = zip(triple, glasses, strict=True)
    poses = [compose(*from_matrix(view.T_world_cam), item.R, item.t) for view, item in pairs]
    R, t = poses[CAMERAS.index("centre")]
    away = max(float(np.abs(a - R).max() + np.abs(b - t).max()) for a, b in poses)
    if away > AGREEMENT:
        fail(where, "one pose of the glasses in the car", f"poses up to {away:.3g} apart")
    return [ids[0], *t.tolist(), *matrix_to_quaternion(R).tolist()]


def _triples(where: str, views: Iterable[View]) -> Iterator[tuple[View, ...]]:
    views = iter(views)
    while triple := tuple(itertools.islice(views, len(CAMERAS))):
        for view in triple:
            if not isinstance(view, View):
                fail(where, "Views", type(view).__name__)
        if len(triple) < len(CAMERAS):
            fail(where, "three views of each instant", f"{len(triple)} of the last one")
        yield triple


def _frame_of(where: str, triple: tuple[View, ...]) -> int:
    """The frame of three views that belong together."""
    frame = triple[0].image_id // len(CAMERAS)
    ids = [view.image_id for view in triple]
    if ids != [len(CAMERAS) * frame + number for number in range(len(CAMERAS))]:
        fail(f"{where}: image_id", "3 n, 3 n + 1 and 3 n + 2 for left, centre and right", ids)
    if frame > MOST_FRAMES:
        fail(f"{where}: image_id", f"frames up to {MOST_FRAMES}", frame)
    first = triple[0]
    for view in triple:
        if view.scene_id != first.scene_id or view.group != (first.scene_id, frame):
            expected = f"one subject and the group {(first.scene_id, frame)}"
            fail(where, expected, f"{view.scene_id} and {view.group}")
    return frame


def _check_camera(where: str, cameras: dict[str, Camera], name: str, view: View) -> None:
    """Keep the camera of a view, or refuse another one than was kept."""
    if view.T_world_cam is None:
        fail(where, "T_world_cam", "none")
    if view.ir is None:
        fail(where, "an infrared image", view)
    require_rotation(f"{where}: T_world_cam", view.T_world_cam[:3, :3])
    height, width = view.ir.shape
    found = Camera(view.K, view.T_world_cam, width, height)
    kept = cameras.setdefault(name, found)
    for field in ("K", "T_world_cam", "width", "height"):
        if not np.array_equal(getattr(kept, field), getattr(found, field)):
            fail(f"{where}: {field}", f"that of all views of this camera, {getattr(kept, field)}",
                 getattr(found, field))  # fmt: skip


def _objects(where: str, view: View) -> dict[str, ObjectView]:
    """The glasses of a view and, if it is there, the head."""
    ids = [item.object_id for item in view.objects]
    glasses = [item for item in view.objects if item.object_id in GLASSES]
    heads = [item for item in view.objects if item.object_id == HEAD]
    if len(glasses) != 1 or len(heads) > 1 or len(ids) > len(glasses) + len(heads):
        fail(f"{where}: objects", f"one of {GLASSES} and at most one head ({HEAD})", ids)
    for item in heads:
        off = max(np.abs(item.R - glasses[0].R).max(), np.abs(item.t - glasses[0].t).max())
        if off > AGREEMENT:
            fail(f"{where}: pose of the head", "that of the glasses", f"one that is {off:.3g} off")
    require_rotation(f"{where}: R", glasses[0].R)
    return dict(zip(OBJECTS, [*glasses, *heads], strict=False))


def _images(
    where: str, view: View, objects: Mapping[str, ObjectView], step: float
) -> dict[str, np.ndarray]:
    """The images of a view by the folder that they are for."""
    images: dict[str, np.ndarray] = {"": view.ir}
    if view.depth is not None:
        units = np.round(view.depth.astype(np.float64) / step)
        if units.max() > LARGEST:
            most = LARGEST * step
            fail(f"{where}: depth", f"at most {most:.3f} m (depth_step)", view.depth.max())
        images["depth"] = units.astype(np.uint16)
    for key, item in objects.items():
        for field, kind in KINDS.items():
            if (mask := getattr(item, field)) is not None:
                images[f"{kind}/{key}"] = mask.astype(np.uint8) * 255
    return images


def _label(key: str, item: ObjectView) -> list:
    box = [None] * 4 if item.box is None else item.box.tolist()
    size = [None] * 3 if item.size is None else item.size.tolist()
    return [key, *box, item.visible_fraction, *size]


def _words(kinds: set[str]) -> str:
    return ", ".join(sorted(kind or "ir" for kind in kinds))


def _write_png(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, cv2.imencode(".png", image)[1].tobytes())
