"""Meshes from PLY, OBJ and STL files, whole or not at all, from millimetres to metres.

Errors of a pose are averages over the vertices of the file, so those of PLY and OBJ stay as they
are, in number and order. STL has no vertices but corners of triangles: equal ones are one here.
"""

from __future__ import annotations

import codecs
import io
import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh
from trimesh.exchange.stl import load_stl

from data_tools.bop.files import read_bytes
from data_tools.bop.ply import FARTHEST, read_ply

__all__ = ["MESH_SUFFIXES", "read_mesh"]

MESH_SUFFIXES = (".ply", ".obj", ".stl")  # in the order in which they are looked for
TRIANGLE = 50  # bytes of one in a binary STL file, behind a head of 84


def read_mesh(path: str | Path) -> trimesh.Trimesh:
    """Read a mesh in millimetres.

    Args:
        path: a file whose name ends in one of MESH_SUFFIXES.

    Returns:
        The mesh in metres. Polygons become triangles. What PLY files give besides, see
        `data_tools.bop.ply.read_ply`; of the others nothing but vertices and faces is read.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: naming the file and, where there are any, the line that is damaged.
    """
    path = Path(path)
    read = {".obj": _read_obj, ".stl": _read_stl}.get(path.suffix.lower())
    if read is None:
        return read_ply(path)
    vertices, faces = read(path, read_bytes(path))
    if not len(vertices):
        raise ValueError(f"{path}: a mesh without vertices")
    if not np.abs(vertices).max() < FARTHEST:
        row = int(np.argwhere(~(np.abs(vertices) < FARTHEST))[0, 0])
        raise ValueError(
            f"{path}: vertex {row} is not finite, or beyond reason: {vertices[row].tolist()}"
        )
    return trimesh.Trimesh(vertices / 1000, faces, process=False)


def _read_obj(path: Path, data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a Wavefront OBJ file.

    Read here, since trimesh splits vertices by texture and normal, and lets "v 1 2" pass.
    """
    text = data.removeprefix(codecs.BOM_UTF8).decode("ascii", "replace")
    text = text.replace("\r\n", "\n").replace("\r", "\n")  # lines end as on any system
    lines = text.replace("\\\n", " ").split("\n")
    vertices, triangles = [], []
    for number, line in enumerate(lines, 1):
        words = line.split()
        try:
            if words[:1] == ["v"]:
                vertices.append([_number(word) for word in words[1:4]])
                if len(words) < 4:
                    raise ValueError
            elif words[:1] == ["f"]:
                # A corner is v, v/vt, v//vn or v/vt/vn; counted from 1, or from the last one back.
                corners = [int(_word(word.split("/")[0])) for word in words[1:]]
                corners = [i - 1 if i > 0 else len(vertices) + i for i in corners]
                if len(corners) < 3 or "0" in words or min(corners) < 0:
                    raise ValueError
                triangles += [(corners[0], *pair) for pair in pairwise(corners[1:])]
                if number == len(lines) and max(corners) >= len(vertices):
                    raise ValueError
        except ValueError:
            raise ValueError(f"{path}: damaged OBJ: line {number}: {line.strip()[:80]!r}") from None
    faces = np.reshape(np.array(triangles, np.int64), (-1, 3))
    if faces.size and faces.max() >= len(vertices):
        row = int(np.argwhere(faces >= len(vertices))[0, 0])
        raise ValueError(
            f"{path}: face {row} has a vertex that does not exist: {faces[row].tolist()}"
        )
    return np.reshape(np.array(vertices, np.float64), (-1, 3)), faces


def _read_stl(path: Path, data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of an STL file, binary or text; equal corners become one vertex."""
    announced = int.from_bytes(data[80:84], "little")
    binary = len(data) == 84 + TRIANGLE * announced
    text = b"" if binary else data.lower()
    words = text.split()
    if not binary:
        if words[:1] != [b"solid"] or b"\0" in data:
            raise ValueError(
                f"{path}: damaged STL: {len(data)} bytes, expected {84 + TRIANGLE * announced}"
            )
        announced = words.count(b"facet")
        ends = [words.count(word) for word in (b"endfacet", b"vertex", b"endsolid")]
        solids = len(re.findall(rb"^[ \t]*solid\b", text, re.MULTILINE))
        if ends != [announced, 3 * announced, solids]:
            raise ValueError(f"{path}: damaged STL: no end of the solid, it may be cut")
    if announced == 0:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    try:
        read = load_stl(io.BytesIO(data))
        parts = list(read["geometry"].values()) if "geometry" in read else [read]  # of many solids
        corners = np.concatenate([np.reshape(part["vertices"], (-1, 3)) for part in parts])
        if len(corners) != 3 * announced:
            raise ValueError(f"{announced} triangles announced, got {len(corners) / 3:g}")
    except Exception as error:  # whatever trips over damaged input, it is the file's fault
        raise ValueError(f"{path}: damaged STL: {error!r}") from error
    vertices, faces = np.unique(corners, axis=0, return_inverse=True)
    return vertices, faces.reshape(-1, 3)


def _number(word: str) -> float:
    return float(_word(word))


def _word(word: str) -> str:
    """A word that may be a number; Python takes 1_000 for one too."""
    if "_" in word or len(word) > 60:
        raise ValueError
    return word
