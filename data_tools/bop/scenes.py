"""The JSON files of one BOP scene: cameras, ground-truth poses, and what is known about them."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from data_tools.bop.files import _short, read_integer, read_json, read_number, read_numbers
from data_tools.bop.rotations import check_rotations

__all__ = [
    "Annotations",
    "Camera",
    "PlaceholderWarning",
    "UnitWarning",
    "known_poses",
    "read_annotations",
    "read_by_id",
    "read_cameras",
]

SCALES = (0.003, 100)  # mm of a unit of depth: beyond, images end at 20 cm or have steps of 10 cm


@dataclass(frozen=True, eq=False)
class Camera:
    """One image's camera: `K` (3, 3), millimetres per unit of depth, (4, 4) pose in the world."""

    K: np.ndarray
    depth_scale: float | None
    T_world_cam: np.ndarray | None


@dataclass(frozen=True, eq=False)
class Annotations:
    """The objects in the images of a scene, one row for every object.

    Attributes:
        rows: for every image id its rows, in the order of the file.
        object_id: (N,) object ids.
        R, t: (N, 3, 3) and (N, 3) poses from object to camera in metres.
        box: (N, 4) x, y, width, height of what is seen; NaN where nothing is; None if not known.
        visible_fraction: (N,) share of the silhouette that is seen, None if not known.
        known: (N,) whether there is a pose, or nothing but a placeholder; None if all are known.
    """

    rows: dict[int, range]
    object_id: np.ndarray
    R: np.ndarray
    t: np.ndarray
    box: np.ndarray | None = None
    visible_fraction: np.ndarray | None = None
    known: np.ndarray | None = None


class UnitWarning(UserWarning):
    """Numbers of a file are in another unit, by the look of them."""


class PlaceholderWarning(UserWarning):
    """Poses of a file are placeholders: the objects are there, but nobody knows how they lie."""


def read_by_id(path: Path) -> dict[int, Any]:
    """A JSON object whose keys are image or object ids, in ascending order of the ids.

    Raises:
        ValueError: if it is something else.
    """
    content = read_json(path)
    if not isinstance(content, dict):
        raise ValueError(f"{path}: expected a JSON object, got a {type(content).__name__}")
    for key in content:
        if not (key.isascii() and key.isdigit() and len(key) < 19 and key == str(int(key))):
            raise ValueError(f"{path}: expected ids as keys, got {_short(key)}")
    return {int(key): content[key] for key in sorted(content, key=int)}


def read_cameras(path: Path, rotations: str) -> dict[int, Camera]:
    """The cameras of `scene_camera.json` by image id.

    `cam_R_w2c` and `cam_t_w2c` move from world to camera; `T_world_cam` is their inverse.

    Raises:
        ValueError: naming file, image and entry that are damaged.
    """
    entries = read_by_id(path)
    K, scale, R, t, odd = {}, {}, {}, {}, None
    for image_id, entry in entries.items():
        where = f"{path}: image {image_id}"
        K[image_id] = read_numbers(where, entry, "cam_K", 9).reshape(3, 3)
        if "depth_scale" in entry:
            scale[image_id] = read_number(where, entry, "depth_scale")
            if scale[image_id] <= 0:
                raise ValueError(f"{where}: depth_scale: expected above 0, got {scale[image_id]}")
            odd = odd if SCALES[0] < scale[image_id] < SCALES[1] else scale[image_id]
        if "cam_R_w2c" in entry or "cam_t_w2c" in entry:
            numbers = read_numbers(where, entry, "cam_R_w2c", 9)
            if (numbers == -1).all():  # a placeholder
                continue
            R[image_id] = numbers
            t[image_id] = read_numbers(where, entry, "cam_t_w2c", 3) / 1000
    if odd is not None:
        warnings.warn(
            f"{path}: depth_scale {odd:g} is meant in millimetres: depth images of 16 bits then "
            f"reach to {65.535 * odd:.3g} m, in steps of {odd:g} mm",
            UnitWarning,
            stacklevel=2,
        )
    matrices = np.reshape(list(R.values()), (-1, 3, 3))
    checked = check_rotations(path, matrices, rotations, lambda i: f"image {list(R)[i]}")
    poses = {i: _inverse(M, t[i]) for i, M in zip(R, checked, strict=True)}
    return {i: Camera(K[i], scale.get(i), poses.get(i)) for i in entries}


def read_annotations(path: Path, info_path: Path | None, rotations: str) -> Annotations:
    """The poses of `scene_gt.json`, with `scene_gt_info.json` where there is one.

    Args:
        path: the file with the poses.
        info_path: the file with boxes and visible fractions, None if there is none.
        rotations: "project" or "as_read", see `check_rotations`.

    Raises:
        ValueError: naming file, image, number and entry that are damaged; or if both files do not
            describe the same objects.
    """
    rows, places, object_id, R, t = {}, [], [], [], []
    for image_id, poses in read_by_id(path).items():
        _require_list(f"{path}: image {image_id}", poses)
        rows[image_id] = range(len(places), len(places) + len(poses))
        for number, pose in enumerate(poses):
            places.append(f"image {image_id}, pose {number}")
            where = f"{path}: {places[-1]}"
            object_id.append(read_integer(where, pose, "obj_id"))
            R.append(read_numbers(where, pose, "cam_R_m2c", 9))
            t.append(read_numbers(where, pose, "cam_t_m2c", 3) / 1000)
    R, t = np.reshape(R, (-1, 3, 3)), np.reshape(t, (-1, 3))
    known = known_poses(path, R)
    R[~known] = np.eye(3)  # nobody is given these
    return Annotations(
        rows,
        np.array(object_id, np.int64),
        check_rotations(path, R, rotations, places.__getitem__),
        t,
        *((None, None) if info_path is None else _read_infos(info_path, rows, known)),
        known=None if known.all() else known,
    )


def known_poses(path: Path, R: np.ndarray) -> np.ndarray:
    """Which of the poses (N, 3, 3) are some: BOP writes nothing but -1 for one that it lacks."""
    placeholder = (R == -1).all((1, 2))
    if placeholder.any():
        warnings.warn(
            f"{path}: {int(placeholder.sum())} of {len(R)} poses are placeholders, all -1: these "
            "objects are left out",
            PlaceholderWarning,
            stacklevel=3,
        )
    return ~placeholder


def _read_infos(
    path: Path, rows: dict[int, range], known: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Boxes and visible fractions of the objects that `rows` counts; no box without a pose."""
    entries = read_by_id(path)
    if set(entries) != set(rows):
        odd = min(set(entries) ^ set(rows))
        raise ValueError(f"{path}: image {odd} is not in both this file and scene_gt.json")
    boxes, fractions = [], []
    for image_id, infos in entries.items():
        _require_list(f"{path}: image {image_id}", infos, len(rows[image_id]))
        for number, info in enumerate(infos):
            where = f"{path}: image {image_id}, pose {number}"
            if not known[rows[image_id][number]]:  # placeholders here as well
                fractions.append(0.0)
                boxes.append(np.full(4, np.nan))
                continue
            fractions.append(read_number(where, info, "visib_fract"))
            if not 0 <= fractions[-1] <= 1:
                raise ValueError(f"{where}: visib_fract: expected 0 to 1, got {fractions[-1]}")
            box = read_numbers(where, info, "bbox_visib", 4)
            if (box == -1).all():  # what BOP writes where nothing of the object is seen
                box = np.full(4, np.nan)
            elif (box[2:] < 0).any():
                raise ValueError(f"{where}: bbox_visib: expected x, y, w, h, got {box.tolist()}")
            boxes.append(box)
    return np.reshape(boxes, (-1, 4)), np.array(fractions, np.float64)


def _require_list(where: str, value: Any, length: int | None = None) -> None:
    if not isinstance(value, list):
        raise ValueError(f"{where}: expected a list, got a {type(value).__name__}")
    if length is not None and len(value) != length:
        raise ValueError(f"{where}: expected {length} entries as in scene_gt, got {len(value)}")


def _inverse(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """The inverse as a (4, 4) matrix; a real inverse, for R is no rotation if taken as read."""
    T = np.eye(4)
    T[:3, :3] = np.linalg.inv(R)
    T[:3, 3] = -T[:3, :3] @ t
    return T
