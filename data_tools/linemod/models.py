"""The objects' models: meshes, sizes, symmetries and keypoints, in metres."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import trimesh

from data_tools.bop.files import has_file, read_number
from data_tools.bop.meshes import MESH_SUFFIXES, read_mesh
from data_tools.bop.models import ModelInfo, ModelInfoWarning, _diameter
from data_tools.linemod.folders import NAMES, ObjectFolder
from data_tools.linemod.poses import read_text, read_yaml
from posecore.arrays import fail

__all__ = ["LinemodModels"]

# The eggbox and the glue look the same from two sides. The motions that BOP gives for them differ
# from a half turn about z by up to 1.6 degrees and 0.8 mm.
HALF_TURNS = (10, 11)


class LinemodModels:
    """The models of a dataset's objects; those without a file are not among its `ids`.

    The two layouts have other object frames: DenseFusion's begins in the middle of the object's
    box, PVNet's of the cat 13 mm from it. So poses go with the models of the same layout only.

    Args:
        folders: of the objects, by their ids.
    """

    def __init__(self, folders: dict[int, ObjectFolder]) -> None:
        self._folders = folders
        self._meshes: dict[int, trimesh.Trimesh] = {}
        self._infos: dict[int, ModelInfo] = {}
        self._files = {i: _mesh_file(folder) for i, folder in folders.items()}
        self.ids: tuple[int, ...] = tuple(i for i, file in self._files.items() if has_file(file))

    def __repr__(self) -> str:
        return f"LinemodModels(objects {list(self.ids)})"

    def mesh(self, object_id: int) -> trimesh.Trimesh:
        """The mesh of an object in metres; it is read once, so copy it before changing it.

        Raises:
            ValueError: if there is no such object, or its file is damaged.
        """
        self._require_id(object_id)
        if object_id not in self._meshes:
            mesh = read_mesh(self._files[object_id])
            if self._folders[object_id].layout != "densefusion":
                mesh.apply_scale(1000)  # it was in metres before `read_mesh`
            self._meshes[object_id] = mesh
        return self._meshes[object_id]

    def info(self, object_id: int) -> ModelInfo:
        """Diameter, box and symmetries of an object.

        They come from `models_info.yml` or, of an own object, the diameter from `diameter.txt`; and
        from the mesh where there is no such file; of DenseFusion's layout, which has such a list, a
        `ModelInfoWarning` says so once per object. Only the eggbox and the glue have a symmetry,
        the half turn about z through the middle of their box.

        Raises:
            ValueError: if there is no such object, or a file is damaged.
        """
        self._require_id(object_id)
        if object_id not in self._infos:
            self._infos[object_id] = self._read_info(object_id)
        return self._infos[object_id]

    def keypoints(self, object_id: int) -> np.ndarray:
        """(K, 3) the keypoints that PVNet's `farthest.txt` gives, `fps.txt` of an own object.

        Raises:
            ValueError: if there is no such object or file, or it is damaged.
        """
        self._require_id(object_id)
        folder = self._folders[object_id]
        name = "fps.txt" if folder.layout == "own" else "farthest.txt"
        return read_text(folder.path / name, (-1, 3))

    def _read_info(self, object_id: int) -> ModelInfo:
        folder, file = self._folders[object_id], self._files[object_id]
        where, entry = str(file), None
        if folder.layout == "densefusion":
            places = (file.with_name("models_info.yml"), file.parents[1] / "models_info.yml")
            if (path := next((p for p in places if has_file(p)), None)) is not None:
                where, entry = f"{path}: object {object_id}", read_yaml(path, dict).get(object_id)
        if entry is not None:
            minimum, size = (
                np.array([read_number(where, entry, f"{key}_{axis}") for axis in "xyz"]) / 1000
                for key in ("min", "size")
            )
            diameter = read_number(where, entry, "diameter") / 1000
        else:
            points = self.mesh(object_id).vertices
            minimum, size = points.min(0), np.ptp(points, axis=0)
            diameter = _diameter(points)
            if folder.layout == "densefusion":  # the others never have a list
                # Those of LINEMOD's own objects are not in its list either.
                unknown = "" if object_id in NAMES else ", no symmetries are known"
                warnings.warn(
                    f"{file.parent}: no entry for object {object_id} in models_info.yml: its "
                    f"diameter is measured{unknown}",
                    ModelInfoWarning,
                    stacklevel=3,
                )
        if folder.layout == "own" and has_file(path := folder.path / "diameter.txt"):
            given = float(read_text(path, (1,))[0])
            if not 0.5 * diameter < given < 2 * diameter:
                raise ValueError(
                    f"{path}: expected {diameter:.4g} m as in {file.name}, got {given}"
                )
            diameter = given
        turns = np.zeros((0, 4, 4))
        if object_id in HALF_TURNS:
            turns = np.diag([-1.0, -1, 1, 1])[None]
            turns[0, :2, 3] = (2 * minimum + size)[:2]
        try:
            return ModelInfo(diameter, minimum, size, turns)
        except ValueError as error:
            raise ValueError(f"{where}: {error}") from error

    def _require_id(self, object_id: int) -> None:
        if object_id not in self.ids:
            fail("object_id", f"one of {', '.join(map(str, self.ids))}", repr(object_id))


def _mesh_file(folder: ObjectFolder) -> Path:
    """The file with the model: PLY, or OBJ or STL where there is no PLY file."""
    place = folder.path / ("model.ply" if folder.layout == "own" else f"{folder.name}.ply")
    if folder.layout == "densefusion":
        place = folder.path.parents[1] / "models" / f"obj_{folder.object_id:02d}.ply"
    files = [place.with_suffix(suffix) for suffix in MESH_SUFFIXES]
    return next((file for file in files if has_file(file)), place)
