"""Meshes from PLY files, whole or not at all, from millimetres to metres.

trimesh reads the format, but takes a text file that lacks its last rows for a smaller mesh, and
merges or splits vertices by texture if not told otherwise. Errors of a pose are averages over the
vertices of the file, so here they stay as they are, in number and order.
"""

from __future__ import annotations

import codecs
import io
import re
import warnings
from pathlib import Path

import numpy as np
import trimesh
from trimesh.exchange.ply import load_ply
from trimesh.geometry import triangulate_quads

from data_tools.bop.files import read_bytes
from data_tools.bop.polygons import Elements, mixed_polygons

__all__ = ["FARTHEST", "MeshWarning", "read_ply"]

FARTHEST = 1e15  # millimetres: beyond the planets; squares and sums of such numbers are finite


class MeshWarning(UserWarning):
    """A file's last line has no end, so that nobody knows whether its last number was cut."""


def read_ply(path: str | Path) -> trimesh.Trimesh:
    """Read a mesh in millimetres.

    Args:
        path: a text or binary PLY file.

    Returns:
        The mesh in metres: vertices in the file's order, faces, and normals and colours of the
        vertices where the file has them. Polygons become triangles. Textures are not read.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: naming the file, if it is damaged or cut off, has no vertices, has some that are
            not finite or beyond reason, or faces of vertices that do not exist.

    Warns:
        MeshWarning: if the last line of a text file has no end.
    """
    path = Path(path)
    data = read_bytes(path).removeprefix(codecs.BOM_UTF8)
    if b"\n" not in data and b"format ascii" in data:
        data = data.replace(b"\r", b"\n")  # lines end as on any system
    encoding, elements = _read_header(path, data)
    if elements.get("vertex", (0, []))[0] == 0:
        raise ValueError(f"{path}: a PLY file without vertices")
    try:
        polygons = None
        if encoding != "ascii":
            body = data[data.index(b"\n", data.index(b"\nend_header") + 1) + 1 :]
            polygons, vertex_rows = mixed_polygons(body, encoding, elements)
        if polygons is not None:  # to trimesh all have as many corners as the first
            data = vertex_rows
        with np.errstate(over="ignore"):  # what is too large for its kind becomes infinite
            parts = load_ply(io.BytesIO(_plain(data)), fix_texture=False, skip_materials=True)
        vertices = np.asarray(parts["vertices"], np.float64)
        faces = parts.get("faces") if polygons is None else triangulate_quads(polygons)
        faces = np.zeros((0, 3), np.int64) if faces is None else np.asarray(faces, np.int64)
    except Exception as error:  # whatever trips over damaged input, it is the file's fault
        raise ValueError(f"{path}: damaged PLY: {error!r}") from error
    # A binary file that ends with its vertices is a point cloud to trimesh.
    if len(faces) < (announced := elements.get("face", (0, []))[0]):
        raise ValueError(f"{path}: damaged PLY: {announced} faces announced, got {len(faces)}")
    if not np.isfinite(vertices).all():
        row = int(np.argwhere(~np.isfinite(vertices))[0, 0])
        raise ValueError(f"{path}: vertex {row} is not finite: {vertices[row].tolist()}")
    if np.abs(vertices).max() > FARTHEST:
        row = int(np.argwhere(np.abs(vertices) > FARTHEST)[0, 0])
        raise ValueError(f"{path}: vertex {row} is beyond reason: {vertices[row].tolist()}")
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


def _read_header(path: Path, data: bytes) -> tuple[str, Elements]:
    """The encoding and the elements of a file; of text it is seen that all rows are there."""
    head, end, body = data.partition(b"\nend_header")
    lines = head.decode("ascii", "replace").split("\n")
    if lines[0].strip() != "ply" or not end or b"\n" not in body:
        raise ValueError(f"{path}: no PLY file, or cut off in its header")
    elements: Elements = {}
    encoding = ""
    for line in lines[1:]:
        match line.split():
            case ["format", word, _]:
                encoding = word
            case ["element", name, count] if count.isdigit() and len(count) < 19:
                elements[name] = (int(count), [])
            case ["property", *words] if elements and words:
                elements[name][1].append(words)
            case ["comment" | "obj_info", *_] | []:
                pass
            case _:
                raise ValueError(f"{path}: damaged PLY header: {line.strip()!r}")
    if encoding not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise ValueError(f"{path}: damaged PLY header: unknown format {encoding!r}")
    if encoding == "ascii":
        _check_rows(path, body.split(b"\n")[1:], elements)
    return encoding, elements


def _check_rows(path: Path, rows: list[bytes], elements: Elements) -> None:
    """Refuse text that has not exactly the rows and the numbers in them that were announced.

    Some programs end the last line, some do not. A last number may have been cut without an end;
    if the other lines end in a blank, this one must as well.
    """
    announced = sum(count for count, _ in elements.values())
    unended = len(rows) == announced and bool(rows[-1].strip())
    if not unended and (len(rows) - 1 < announced or b"".join(rows[announced:]).strip()):
        raise ValueError(f"{path}: damaged PLY: {announced} rows announced, got {len(rows) - 1}")
    cut = f"{path}: damaged PLY: no line end after the last row, it may be cut"
    position = 0
    for name, (count, properties) in elements.items():
        lists = [words[0] == "list" for words in properties]
        for number, row in enumerate(rows[position : position + count]):
            if not _is_complete(row.split(), lists):
                last = unended and position + number == announced - 1
                raise ValueError(
                    cut if last else f"{path}: damaged PLY: {name} {number} is {row[:80]!r}"
                )
        position += count
    if unended:
        if len(rows) > 1 and rows[-2].rstrip(b"\r").endswith(b" ") and not rows[-1].endswith(b" "):
            raise ValueError(cut)
        text = f"{path}: no line end after the last row, which is taken as it is"
        warnings.warn(text, MeshWarning, stacklevel=4)


def _is_complete(words: list[bytes], lists: list[bool]) -> bool:
    if not any(lists):
        return len(words) == len(lists)
    length = 0
    for is_list in lists:
        if is_list and not (length < len(words) and re.fullmatch(rb"[0-9]{1,9}", words[length])):
            return False
        length += 1 + int(words[length]) if is_list else 1
    return length == len(words)


def _plain(data: bytes) -> bytes:
    """The same file with a header that trimesh can decode: comments may be in any encoding."""
    head, end, body = data.partition(b"\nend_header")
    try:
        head.decode("utf-8")
    except UnicodeDecodeError:
        return head.decode("ascii", "replace").encode("ascii", "replace") + end + body
    return data
