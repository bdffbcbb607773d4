"""Models written as BOP has them: PLY files in millimetres and `models_info.json`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from data_tools.bop.models import ModelInfo, Models
from data_tools.sensors import linear_to_srgb
from data_tools.shapes.mesh import Mesh
from data_tools.textures import albedo
from posecore.arrays import fail, require_integer
from posecore.files import write_bytes

__all__ = ["Model", "to_models_info", "to_ply", "write_models"]

Model = Mesh | trimesh.Trimesh
"""A mesh in metres."""

VERTEX = np.dtype([("position", "<f4", 3), ("normal", "<f4", 3), ("colour", "u1", 3)])
FACE = np.dtype([("count", "u1"), ("vertices", "<i4", 3)])
# The names and types that the toolkit's reader knows.
HEADER = """ply
format binary_little_endian 1.0
element vertex {}
property float x
property float y
property float z
property float nx
property float ny
property float nz
property uchar red
property uchar green
property uchar blue
element face {}
property list uchar int vertex_indices
end_header
"""


def write_models(folder: Path, models: Mapping[int, Model], infos: Mapping[int, ModelInfo]) -> None:
    """Write a folder of models.

    Args:
        folder: where to; new, in a folder that exists, or empty.
        models: for every object id its mesh in metres.
        infos: what is known of the objects; the others get it from their meshes.

    Raises:
        ValueError: naming the argument, if there is no model, an id is no integer of at least 0,
            something is no mesh, an info is of no model, or there are files in the folder.
    """
    if not isinstance(models, Mapping) or not models:
        fail("models", "meshes by object id", repr(models))
    ids = sorted(require_integer("models", object_id, 0) for object_id in models)
    for object_id, info in infos.items():
        if object_id not in models or not isinstance(info, ModelInfo):
            fail("infos", "a ModelInfo for ids of models", f"{object_id}: {info!r}")
    folder.mkdir(exist_ok=True)
    if any(folder.iterdir()):
        fail("folder", "a new or an empty folder", str(folder))
    for object_id in ids:
        data = to_ply(f"models[{object_id}]", models[object_id])
        write_bytes(folder / f"obj_{object_id:06d}.ply", data)
    written = Models(folder)  # diameters and boxes of what is really there
    known = {
        object_id: infos.get(object_id)
        or _with_symmetries(written.measured(object_id), models[object_id])
        for object_id in ids
    }
    write_bytes(folder / "models_info.json", to_models_info(known))


def to_models_info(infos: Mapping[int, ModelInfo]) -> bytes:
    """The content of `models_info.json`, in millimetres, an object a line.

    Args:
        infos: what is known of each object, by its id.
    """
    lines = (f'  "{i}": {json.dumps(_to_entry(infos[i]), sort_keys=True)}' for i in sorted(infos))
    return ("{\n" + ",\n".join(lines) + "\n}\n").encode("ascii")


def to_ply(name: str, model: Model) -> bytes:
    """A binary PLY file in millimetres, the vertices in their order, with normals and colours.

    Raises:
        ValueError: naming the argument, if it is no mesh or has no vertices.
    """
    if not isinstance(model, Model):
        fail(name, "a Mesh or a trimesh.Trimesh", type(model).__name__)
    if len(model.vertices) == 0:
        fail(name, "a mesh with vertices", "none")
    surface = _of_mesh(model) if isinstance(model, Mesh) else _of_trimesh(model)
    vertices = np.zeros(len(model.vertices), VERTEX)
    vertices["position"] = np.asarray(model.vertices) * 1000
    vertices["normal"], vertices["colour"] = surface
    faces = np.zeros(len(model.faces), FACE)
    faces["count"], faces["vertices"] = 3, model.faces
    header = HEADER.format(len(vertices), len(faces))
    return header.encode("ascii") + vertices.tobytes() + faces.tobytes()


def _of_mesh(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Normals and colours of the vertices: means over the corners that meet in them."""
    corners = mesh.faces.ravel()
    points, normals = mesh.vertices[corners], mesh.corner_normals.reshape(-1, 3)
    a, b, c = points.reshape(-1, 3, 3).swapaxes(0, 1)
    area = np.repeat(np.linalg.norm(np.cross(b - a, c - a), axis=1), 3)[:, None]
    colours = albedo(mesh.materials, np.repeat(mesh.material, 3), points, normals)
    sums = np.zeros((3, len(mesh.vertices), 3))
    for total, values in zip(sums, (normals * area, colours, np.ones((1, 3))), strict=True):
        np.add.at(total, corners, values)
    normals, colours, counts = sums
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(lengths > 0, normals / np.where(lengths > 0, lengths, 1), [0.0, 0.0, 1.0])
    encoded = linear_to_srgb(colours / np.maximum(counts, 1))
    return normals, np.round(encoded * 255).astype(np.uint8)


def _of_trimesh(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    visual = mesh.visual
    colours = visual.vertex_colors if visual.kind != "texture" else visual.material.main_color
    if visual.kind == "texture" and visual.to_color().kind == "vertex":  # there is an image
        colours = visual.to_color().vertex_colors
    return mesh.vertex_normals, np.atleast_2d(colours)[:, :3]


def _with_symmetries(info: ModelInfo, model: Model) -> ModelInfo:
    if not isinstance(model, Mesh):
        return info
    discrete, axes = model.symmetries[1:], ()
    if model.axis is not None:
        axis = model.axis / np.linalg.norm(model.axis)
        axes = ((axis, np.zeros(3)),)
        kept = [np.eye(4)]
        for T in model.symmetries:
            # Two motions differ by a turn if one, and then the other undone, leave the axis alone.
            away = [np.abs((np.linalg.inv(K) @ T)[:3, :3] @ axis - axis).max() for K in kept]
            if min(away) > 1e-6:
                kept.append(T)
        discrete = np.reshape(kept[1:], (-1, 4, 4))
    return ModelInfo(info.diameter, info.minimum, info.size, discrete, axes)


def _to_entry(info: ModelInfo) -> dict[str, Any]:
    """An entry of models_info.json, in millimetres."""
    entry: dict[str, Any] = {"diameter": info.diameter * 1000}
    for i, axis in enumerate("xyz"):
        entry[f"min_{axis}"] = float(info.minimum[i]) * 1000
        entry[f"size_{axis}"] = float(info.size[i]) * 1000
    if len(info.symmetries_discrete):
        motions = info.symmetries_discrete.copy()
        motions[:, :3, 3] *= 1000
        entry["symmetries_discrete"] = motions.reshape(-1, 16).tolist()
    if info.symmetries_continuous:
        entry["symmetries_continuous"] = [
            {"axis": axis.tolist(), "offset": (offset * 1000).tolist()}
            for axis, offset in info.symmetries_continuous
        ]
    return entry
