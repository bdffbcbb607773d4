"""The faces of binary PLY files in which triangles stand beside quads and larger polygons."""

from __future__ import annotations

import numpy as np

__all__ = ["Elements", "mixed_polygons"]

KINDS = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip
CORNERS = ("vertex_index", "vertex_indices")
Elements = dict[str, tuple[int, list[list[str]]]]
"""Of every element in a header its count, and the words of each of its properties."""


def mixed_polygons(
    body: bytes, encoding: str, elements: Elements
) -> tuple[list[np.ndarray] | None, bytes]:
    """The corners of each face of a binary file, if they are not equally many everywhere.

    Args:
        body: what follows the header.
        encoding: "binary_little_endian" or "binary_big_endian".
        elements: of the header.

    Returns:
        For each face its corners, and a file of the vertices alone; None and nothing if all faces
        have equally many, or the file is of another order than vertices and then faces.

    Raises:
        KeyError: if a property is of no known kind.
        ValueError: if the file ends within its faces or goes on behind them.
    """
    order = "<" if encoding == "binary_little_endian" else ">"
    with_lists = [n for n, (_, p) in elements.items() if any(words[0] == "list" for words in p)]
    names = list(elements)
    if with_lists != ["face"] or "vertex" not in names[: names.index("face")]:
        return None, b""

    def size(name: str) -> int:
        count, properties = elements[name]
        return count * sum(np.dtype(KINDS[words[0]]).itemsize for words in properties)

    start = sum(size(name) for name in names[: names.index("face")])
    end = len(body) - sum(size(name) for name in names[names.index("face") + 1 :])
    count, properties = elements["face"]
    fields = [  # of each property its name, the kind of its count if it is a list, and its kind
        (words[-1], order + KINDS[words[1]] if len(words) > 2 else None, order + KINDS[words[-2]])
        for words in properties
    ]
    if count == 0 or _all_alike(body[start:end], count, fields):
        return None, b""
    corners, position = _walk(body, start, count, fields)
    if position != end:
        raise ValueError(f"{end - position} bytes behind the last face")
    head = ["ply", f"format {encoding} 1.0", f"element vertex {elements['vertex'][0]}"]
    head += ["property " + " ".join(words) for words in elements["vertex"][1]] + ["end_header\n"]
    first = sum(size(name) for name in names[: names.index("vertex")])
    return corners, "\n".join(head).encode() + body[first : first + size("vertex")]


def _all_alike(data: bytes, count: int, fields: list[tuple]) -> bool:
    """Whether the lists of all faces are as long as those of the first one."""
    parts, position, lengths = [], 0, {}
    for number, (_, counted, kind) in enumerate(fields):
        if counted is not None:
            lengths[f"n{number}"] = int(np.frombuffer(data, counted, 1, position)[0])
            parts.append((f"n{number}", counted))
        length = lengths.get(f"n{number}", 1)
        parts.append((f"x{number}", kind, (length,)))
        position = np.dtype(parts).itemsize
    if position * count != len(data):
        return False
    rows = np.frombuffer(data, np.dtype(parts))
    return all((rows[name] == length).all() for name, length in lengths.items())


def _walk(body: bytes, start: int, count: int, fields: list[tuple]) -> tuple[list[np.ndarray], int]:
    """The corners of each face, one after the other, and where the last one ends."""
    steps = [
        (name in CORNERS, None if counted is None else np.dtype(counted), np.dtype(kind))
        for name, counted, kind in fields
    ]
    corners, position = [], start
    for number in range(count):
        for wanted, counted, kind in steps:
            length = 1
            if counted is not None:
                length = int(np.frombuffer(body, counted, 1, position)[0])
                position += counted.itemsize
            if wanted:
                if length < 3:
                    raise ValueError(f"face {number} has {length} corners")
                corners.append(np.frombuffer(body, kind, length, position).astype(np.int64))
            position += length * kind.itemsize
    return corners, position
