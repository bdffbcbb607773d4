"""Object models of a BOP dataset: meshes, diameters and symmetries, from millimetres to metres."""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from data_tools.bop.files import has_file, has_folder, read_number, read_numbers
from data_tools.bop.meshes import MESH_SUFFIXES, read_mesh
from data_tools.bop.rotations import check_rotations
from data_tools.bop.scenes import read_by_id
from posecore.arrays import fail, require_number

__all__ = ["MOST_SYMMETRIES", "ModelInfo", "ModelInfoWarning", "Models"]

MOST_SYMMETRIES = 10_000  # motions of one object; an axis and a flip make 630
FARTHEST = 1e12  # metres: what is beyond has no squares and sums in float32


@dataclass(frozen=True, eq=False)
class ModelInfo:
    """What is known of an object's shape, in metres and in the object's own frame.

    Attributes:
        diameter: the largest distance between two points of the object.
        minimum: (3,) the corner of its box with the smallest coordinates.
        size: (3,) extent of its box.
        symmetries_discrete: (D, 4, 4) motions that leave it as it is, without the identity.
        symmetries_continuous: pairs of an axis (3,) of length 1 and a point (3,) on that axis,
            about which any rotation leaves it as it is.

    Raises:
        ValueError: naming the field that does not fit this description.
    """

    diameter: float
    minimum: np.ndarray
    size: np.ndarray
    symmetries_discrete: np.ndarray
    symmetries_continuous: tuple[tuple[np.ndarray, np.ndarray], ...] = ()

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "diameter", require_number("diameter", self.diameter, above=0))
        for name in ("minimum", "size"):
            set_field(self, name, np.asarray(getattr(self, name), np.float64))
            if getattr(self, name).shape != (3,) or not np.isfinite(getattr(self, name)).all():
                fail(name, "three finite numbers", getattr(self, name).tolist())
        if (self.size < 0).any():
            fail("size", "lengths of at least 0", self.size.tolist())
        discrete = np.asarray(self.symmetries_discrete, np.float64)
        if discrete.ndim != 3 or discrete.shape[1:] != (4, 4) or not np.isfinite(discrete).all():
            fail("symmetries_discrete", "finite matrices (D, 4, 4)", discrete.shape)
        if (discrete[:, 3] != [0, 0, 0, 1]).any():
            fail("symmetries_discrete", "last rows 0 0 0 1", discrete[:, 3].tolist())
        set_field(self, "symmetries_discrete", discrete)
        pairs = []
        for axis, offset in self.symmetries_continuous:
            axis, offset = np.asarray(axis, np.float64), np.asarray(offset, np.float64)
            length = np.linalg.norm(axis)
            if axis.shape != (3,) or not np.isfinite(length) or length == 0:
                fail("symmetries_continuous", "an axis of three numbers, not all 0", axis.tolist())
            if offset.shape != (3,) or not np.isfinite(offset).all():
                fail("symmetries_continuous", "an offset of three numbers", offset.tolist())
            pairs.append((axis / length, offset))
        set_field(self, "symmetries_continuous", tuple(pairs))
        if len(pairs) + len(discrete) > MOST_SYMMETRIES:
            fail("symmetries", f"at most {MOST_SYMMETRIES}", len(pairs) + len(discrete))
        if not all(
            np.abs(length).max(initial=0) < FARTHEST
            for length in (
                np.array([self.diameter]),
                self.minimum,
                self.size,
                discrete[:, :3, 3],
                *(offset for _, offset in pairs),
            )
        ):
            fail("diameter, minimum, size, symmetries", f"lengths below {FARTHEST:.0e} m", "others")

    def symmetries(self, max_step: float = 0.01) -> np.ndarray:
        """All motions that leave the object as it is, rotations about an axis in small steps.

        From one step to the next no point of the object travels farther than `max_step` of its
        diameter (Hodan et al., BOP Challenge 2020, section 2, with 1 %). A point is at most half a
        diameter from the axis, as the circle on which it moves belongs to the object: pi / max_step
        steps suffice. Each is combined with every discrete symmetry.

        Args:
            max_step: largest step as a fraction of the diameter, above 0 and at most 1.

        Returns:
            (S, 4, 4) motions in metres, the identity first; S is at most MOST_SYMMETRIES.

        Raises:
            ValueError: if `max_step` is out of range, or there would be more.
        """
        max_step = require_number("max_step", max_step, None, 1, above=0)
        count = math.ceil(math.pi / max_step)
        if (1 + len(self.symmetries_continuous) * (count - 1)) * (
            1 + len(self.symmetries_discrete)
        ) > MOST_SYMMETRIES:
            fail("symmetries", f"at most {MOST_SYMMETRIES} motions", f"more in steps of {max_step}")
        angles = 2 * math.pi / count * np.arange(1, count)
        turns = [np.eye(4)[None]]
        for axis, offset in self.symmetries_continuous:
            T = np.tile(np.eye(4), (len(angles), 1, 1))
            T[:, :3, :3] = Rotation.from_rotvec(angles[:, None] * axis).as_matrix()
            T[:, :3, 3] = offset - T[:, :3, :3] @ offset  # the points of the axis stay
            turns.append(T)
        flips = np.concatenate([np.eye(4)[None], self.symmetries_discrete])
        return (np.concatenate(turns) @ flips[:, None]).reshape(-1, 4, 4)


class ModelInfoWarning(UserWarning):
    """A list of models does not say what is known of an object, so that it is measured."""


class Models:
    """The objects in a folder of models: `obj_000001.ply`, ... and `models_info.json`.

    Where there is no PLY file of an object, one that ends in .obj or .stl is read.

    Args:
        path: the folder, usually `models` or `models_eval` of a dataset.

    Raises:
        ValueError: if the folder is missing or empty, or its `models_info.json` is damaged.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if not has_folder(self.path):
            fail("path", "a folder of models", repr(str(path)))
        self._files = _find_meshes(self.path)
        info_file = self.path / "models_info.json"
        entries = read_by_id(info_file) if has_file(info_file) else {}
        self._infos = {i: _read_info(info_file, i, entry) for i, entry in entries.items()}
        self._meshes: dict[int, trimesh.Trimesh] = {}
        if not self.ids:
            fail("path", "a folder with obj_*.ply or models_info.json", repr(str(path)))

    def __repr__(self) -> str:
        return f"Models({str(self.path)!r}: objects {list(self.ids)})"

    @cached_property
    def ids(self) -> tuple[int, ...]:
        """The objects' ids in ascending order."""
        return tuple(sorted(self._files.keys() | self._infos.keys()))

    def info(self, object_id: int) -> ModelInfo:
        """Diameter, box and symmetries of an object.

        They come from `models_info.json`. An object that it does not list gets them from its mesh,
        without symmetries, which a `ModelInfoWarning` says once: of an object that has symmetries,
        errors that allow for them are then those of another object.

        Raises:
            ValueError: if there is no such object, or its file is damaged.
        """
        self._require_id(object_id)
        if object_id not in self._infos:
            self._infos[object_id] = self.measured(object_id)
            warnings.warn(
                f"{self.path}: no entry for object {object_id} in models_info.json: its diameter "
                "is measured, no symmetries are known",
                ModelInfoWarning,
                stacklevel=2,
            )
        return self._infos[object_id]

    def measured(self, object_id: int) -> ModelInfo:
        """Diameter and box of an object's mesh, whatever `models_info.json` says; no symmetries.

        Raises:
            ValueError: if there is no such object, or its file is damaged.
        """
        vertices = self.mesh(object_id).vertices
        return ModelInfo(
            _diameter(vertices), vertices.min(0), np.ptp(vertices, 0), np.zeros((0, 4, 4))
        )

    def mesh(self, object_id: int) -> trimesh.Trimesh:
        """The mesh of an object in metres; it is read once, so copy it before changing it.

        Raises:
            FileNotFoundError: if `models_info.json` lists the object but there is no such mesh.
            ValueError: if there is no such object, or its file is damaged.
        """
        self._require_id(object_id)
        if object_id not in self._meshes:
            file = self._files.get(object_id, self.path / f"obj_{object_id:06d}.ply")
            self._meshes[object_id] = read_mesh(file)
        return self._meshes[object_id]

    def _require_id(self, object_id: int) -> None:
        if object_id not in self.ids:
            fail("object_id", f"one of {', '.join(map(str, self.ids))}", repr(object_id))


def _find_meshes(folder: Path) -> dict[int, Path]:
    """The file of each object."""
    found: dict[int, Path] = {}
    for suffix in MESH_SUFFIXES:
        for file in sorted(folder.iterdir()):
            match = re.fullmatch("obj_(0{0,80}[0-9]{1,18})", file.stem)
            if match is None or file.suffix.lower() != suffix:
                continue
            other = found.setdefault(int(match[1]), file)
            if other != file and other.suffix == file.suffix:
                names = f"{other.name} and {file.name}"
                raise ValueError(f"{folder}: two files of object {int(match[1])}, {names}")
    return found


def _read_info(path: Path, object_id: int, entry: Any) -> ModelInfo:
    """One entry of models_info.json, from millimetres to metres."""
    where = f"{path}: object {object_id}"
    minimum = [read_number(where, entry, f"min_{axis}") / 1000 for axis in "xyz"]
    size = [read_number(where, entry, f"size_{axis}") / 1000 for axis in "xyz"]
    diameter = read_number(where, entry, "diameter") / 1000
    discrete = entry.get("symmetries_discrete", [])
    continuous = entry.get("symmetries_continuous", [])
    if not isinstance(discrete, list) or not isinstance(continuous, list):
        raise ValueError(f"{where}: expected lists of symmetries")
    if len(discrete) + len(continuous) > MOST_SYMMETRIES:
        got = len(discrete) + len(continuous)
        raise ValueError(f"{where}: expected at most {MOST_SYMMETRIES} symmetries, got {got}")
    keyed = {f"symmetries_discrete {i}": matrix for i, matrix in enumerate(discrete)}
    T = np.reshape([read_numbers(where, keyed, key, 16) for key in keyed], (-1, 4, 4))
    T[:, :3, :3] = check_rotations(
        path, T[:, :3, :3], "project", lambda i: f"object {object_id}, symmetries_discrete {i}"
    )
    T[:, :3, 3] /= 1000
    axes = [
        (read_numbers(where, entry, "axis", 3), read_numbers(where, entry, "offset", 3) / 1000)
        for entry in continuous
    ]
    try:
        info = ModelInfo(diameter, minimum, size, T, tuple(axes))
        if axes:  # that they are not too many together
            info.symmetries()
        return info
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error


def _diameter(points: np.ndarray) -> float:
    """The largest distance between two points, exact: both are corners of the convex hull."""
    try:
        points = points[ConvexHull(points).vertices]
    except (QhullError, ValueError):  # flat, or too few: then all points are compared
        points = np.unique(points, axis=0)
    return max(float(cdist(points[i : i + 512], points).max()) for i in range(0, len(points), 512))
