"""Meshes from PLY files, whole or not at all, from millimetres to metres.

trimesh reads the format, but takes a text file that lacks its last rows for a smaller mesh, and
merges or splits vertices by texture if not told otherwise. Errors of a pose are averages over the
vertices of the file, so here they stay as they are, in number and order.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import trimesh
from trimesh.exchange.ply import load_ply

from data_tools.bop.files import read_bytes

__all__ = ["read_ply"]


def read_ply(path: str | Path) -> trimesh.Trimesh:
    """Read a mesh in millimetres.

    Args:
        path: a text or binary PLY file.

    Returns:
        The mesh in metres: vertices in the file's order, faces, and normals and colours of the
        vertices where the file has them. Textures are not read.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: naming the file, if it is damaged or cut off, has no vertices, has some that are
            not finite, or faces of vertices that do not exist.
    """
    path = Path(path)
    data = read_bytes(path)
    elements = _read_header(path, data)
    if elements.get("vertex", (0, []))[0] == 0:
        raise ValueError(f"{path}: a PLY file without vertices")
    try:
        parts = load_ply(io.BytesIO(data), fix_texture=False, skip_materials=True)
        vertices = np.asarray(parts["vertices"], np.float64)
        faces = parts.get("faces")
        faces = np.zeros((0, 3), np.int64) if faces is None else np.asarray(faces, np.int64)
    except Exception as error:  # whatever trips over damaged input, it is the file's fault
        raise ValueError(f"{path}: damaged PLY: {error!r}") from error
    # A binary file that ends with its vertices is a point cloud to trimesh.
    if len(faces) < (announced := elements.get("face", (0, []))[0]):
        raise ValueError(f"{path}: damaged PLY: {announced} faces announced, got {len(faces)}")
    if not np.isfinite(vertices).all():
        row = int(np.argwhere(~np.isfinite(vertices))[0, 0])
        raise ValueError(f"{path}: vertex {row} is not finite: {vertices[row].tolist()}")
    if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
        row = int(np.argwhere((faces < 0) | (faces >= len(vertices)))[0, 0])
        raise ValueError(
            f"{path}: face {row} has a vertex that does not exist: {faces[row].tolist()}"
        )
    return trimesh.Trimesh(
        vertices=vertices / 1000,
        faces=faces,
        vertex_normals=parts.get("vertex_normals"),
        vertex_colors=parts.get("vertex_colors"),
        process=False,
    )


def _read_header(path: Path, data: bytes) -> dict[str, tuple[int, list[bool]]]:
    """The count of every element and which of its properties are lists."""
    head, end, body = data.partition(b"\nend_header")
    lines = head.decode("ascii", "replace").split("\n")
    if lines[0].strip() != "ply" or not end or b"\n" not in body:
        raise ValueError(f"{path}: no PLY file, or cut off in its header")
    elements: dict[str, tuple[int, list[bool]]] = {}
    encoding = ""
    for line in lines[1:]:
        match line.split():
            case ["format", word, _]:
                encoding = word
            case ["element", name, count] if count.isdigit():
                elements[name] = (int(count), [])
            case ["property", kind, *_] if elements:
                elements[name][1].append(kind == "list")
            case ["comment" | "obj_info", *_] | []:
                pass
            case _:
                raise ValueError(f"{path}: damaged PLY header: {line.strip()!r}")
    if encoding not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise ValueError(f"{path}: damaged PLY header: unknown format {encoding!r}")
    if encoding == "ascii":
        _check_rows(path, body.split(b"\n")[1:], elements)
    return elements


def _check_rows(path: Path, rows: list[bytes], elements: dict[str, tuple[int, list[bool]]]) -> None:
    """Refuse text that has not exactly the rows and the numbers in them that were announced.

    What follows the last line end is no row: without it, the last number may have been cut.
    """
    announced = sum(count for count, _ in elements.values())
    if len(rows) == announced and rows[-1].strip():
        raise ValueError(f"{path}: damaged PLY: no line end after the last row, it may be cut")
    if len(rows) - 1 < announced or b"".join(rows[announced:]).strip():
        raise ValueError(f"{path}: damaged PLY: {announced} rows announced, got {len(rows) - 1}")
    position = 0
    for name, (count, lists) in elements.items():
        for number, row in enumerate(rows[position : position + count]):
            if not _is_complete(row.split(), lists):
                raise ValueError(f"{path}: damaged PLY: {name} {number} is {row[:80]!r}")
        position += count


def _is_complete(words: list[bytes], lists: list[bool]) -> bool:
    if not any(lists):
        return len(words) == len(lists)
    length = 0
    for is_list in lists:
        if is_list and not (length < len(words) and words[length].isdigit()):
            return False
        length += 1 + int(words[length]) if is_list else 1
    return length == len(words)
