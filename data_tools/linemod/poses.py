"""Cameras and poses of the images of one object, from .npy or YAML files.

The YAML files are read by PyYAML, which jupytext brings along: they are plain enough for a few
lines of our own, but no such lines would tell a damaged file from a whole one as well.
"""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from data_tools.bop.files import has_file, read_bytes, read_integer, read_number, read_numbers
from data_tools.bop.rotations import check_rotations
from data_tools.linemod.folders import Numbered, ObjectFolder, decode_text, require_file

__all__ = ["CAMERA", "Frame", "read_frames", "read_text", "read_yaml"]

# LINEMOD's camera, in images of 640 x 480 pixels.
CAMERA = np.array([[572.4114, 0, 325.2611], [0, 573.57043, 242.04899], [0, 0, 1]])
DEEPEST = 100  # lists in lists of a YAML file; LINEMOD's has three levels
MOST_VALUES = 5_000_000  # of a YAML file, aliases written out; LINEMOD's largest has 250 000
FARTHEST = 1e12  # metres or pixels: what is beyond has no squares and sums in float32


@dataclass(frozen=True, eq=False)
class Frame:
    """What is known of an image.

    Attributes:
        K: (3, 3) camera matrix.
        R, t: (3, 3) and (3,) pose of the object in metres.
        box: (4,) x, y, width and height in pixels of what is seen of the object, None if not known.
        depth_scale: millimetres per unit of the depth image.
    """

    K: np.ndarray
    R: np.ndarray
    t: np.ndarray
    box: np.ndarray | None = None
    depth_scale: float = 1.0


def read_frames(folder: ObjectFolder, images: list[int], rotations: str) -> dict[int, Frame]:
    """What is known of each of the images of an object.

    Args:
        folder: of the object.
        images: their numbers.
        rotations: "project" or "as_read", see `data_tools.bop.rotations.check_rotations`.

    Raises:
        ValueError: naming the file that is not there or damaged.
    """
    read = _read_yaml_frames if folder.layout == "densefusion" else _read_npy_frames
    frames = read(folder, images, rotations)
    for image, frame in frames.items():
        for name, values in (("K", frame.K), ("t", frame.t), ("box", frame.box)):
            if values is not None and np.abs(values).max() > FARTHEST:
                got = values.tolist()
                raise ValueError(
                    f"{folder.path}: image {image}: {name}: expected numbers of at most "
                    f"{FARTHEST:.0e} in size, got {got}"
                )
    return frames


def _read_npy_frames(folder: ObjectFolder, images: list[int], rotations: str) -> dict[int, Frame]:
    K = CAMERA
    if folder.layout == "own":
        K = read_text(folder.path / "camera.txt", (3, 3))
    files = Numbered(folder.path / "pose", (".npy",))
    poses = np.reshape([_read_pose(files[image]) for image in images], (-1, 3, 4))
    R = check_rotations(
        files.folder, poses[..., :3], rotations, lambda row: files[images[row]].name
    )
    rows = zip(images, R, poses[..., 3], strict=True)
    return {image: Frame(K, R, t) for image, R, t in rows}


def _read_yaml_frames(folder: ObjectFolder, images: list[int], rotations: str) -> dict[int, Frame]:
    path, info_path = folder.path / "gt.yml", folder.path / "info.yml"
    poses = read_yaml(path, list)
    infos = read_yaml(info_path, dict) if has_file(info_path) else None
    R, t, box, K, scale = [], [], [], [], []
    for image in images:
        where = f"{path}: image {image}"
        pose = _pick(where, poses.get(image, []), folder.object_id)
        R.append(read_numbers(where, pose, "cam_R_m2c", 9).reshape(3, 3))
        t.append(read_numbers(where, pose, "cam_t_m2c", 3) / 1000)
        box.append(read_numbers(where, pose, "obj_bb", 4))
        where = f"{info_path}: image {image}"
        info = {"cam_K": CAMERA.ravel().tolist()} if infos is None else infos.get(image, {})
        K.append(read_numbers(where, info, "cam_K", 9).reshape(3, 3))
        scale.append(read_number(where, {"depth_scale": 1.0, **info}, "depth_scale"))
        if scale[-1] <= 0:
            raise ValueError(f"{where}: depth_scale: expected above 0, got {scale[-1]}")
    checked = check_rotations(path, np.array(R), rotations, lambda row: f"image {images[row]}")
    rows = zip(images, K, checked, t, box, scale, strict=True)
    return {image: Frame(*row) for image, *row in rows}


def _pick(where: str, poses: list, object_id: int) -> dict:
    """The pose of an object: the images of object 2 list those of whatever else stands in them."""
    if not all(isinstance(pose, dict) for pose in poses):
        raise ValueError(f"{where}: expected entries for each pose, got {poses!r:.80}")
    found = [pose for pose in poses if read_integer(where, pose, "obj_id") == object_id]
    if len(found) != 1:
        raise ValueError(f"{where}: expected one pose of object {object_id}, got {len(found)}")
    return found[0]


def _read_pose(path: Path) -> np.ndarray:
    """A (3, 4) pose in metres from an .npy file."""
    data = read_bytes(path)
    try:
        pose = np.load(io.BytesIO(data), allow_pickle=False)
    except Exception as error:  # whatever trips over damaged input, it is the file's fault
        raise ValueError(f"{path}: damaged .npy file: {error}") from error
    if not isinstance(pose, np.ndarray) or pose.dtype.kind not in "fiu" or pose.shape != (3, 4):
        got = f"{pose.dtype} {pose.shape}" if isinstance(pose, np.ndarray) else "an archive"
        raise ValueError(f"{path}: expected numbers of shape (3, 4), got {got}")
    if not np.isfinite(pose).all():
        raise ValueError(f"{path}: expected finite numbers, got {pose.tolist()}")
    return pose.astype(np.float64)


def read_text(path: Path, shape: tuple[int, ...]) -> np.ndarray:
    """An array of finite numbers from a text file, its rows on lines; -1 stands for any length.

    Raises:
        ValueError: naming the file, if it is not there or holds something else.
    """
    data = read_bytes(require_file(path))
    try:
        rows = [[_float(word) for word in line.split()] for line in decode_text(data).splitlines()]
        values = np.array([row for row in rows if row]).reshape(shape)
    except ValueError as error:
        raise ValueError(f"{path}: expected numbers of shape {shape}: {error}") from error
    if not values.size or not np.isfinite(values).all():
        raise ValueError(f"{path}: expected finite numbers, got {values.tolist()}")
    return values


def _float(word: str) -> float:
    if not word.isascii() or "_" in word:  # Python takes other digits and 1_000 for numbers
        raise ValueError(f"could not convert {word!r}")
    return float(word)


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
    """As YAML has it, but a key that is there twice is an error, and 1e-5 a number."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        mapping = super().construct_mapping(node, deep)
        if len(mapping) < len(node.value):
            raise yaml.MarkedYAMLError(problem="a key is there twice", problem_mark=node.start_mark)
        return mapping

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int | float:
        """An integer that fits into 64 bits; larger ones as a float, which no reader takes."""
        number = super().construct_yaml_int(node)
        try:
            return number if abs(number) < 2**63 else float(number)
        except OverflowError:
            raise yaml.MarkedYAMLError(
                problem="a number of hundreds of digits", problem_mark=node.start_mark
            ) from None


_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_yaml_int)
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"),
    [*"-+0123456789"],
)


def read_yaml(path: Path, kind: type) -> dict[int, Any]:
    """A YAML mapping from image or object ids to values of one kind.

    Raises:
        ValueError: naming the file, if it is not there, damaged or something else.
    """
    data = read_bytes(require_file(path))
    try:
        text = decode_text(data)
        _check_depth(text.encode())
        loader = _Loader(text)
        node = loader.get_single_node()
        if "*" in text and node is not None:
            _check_aliases(node, {}, frozenset())
        content = None if node is None else loader.construct_document(node)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        words = " ".join(str(error).split())
        raise ValueError(f"{path}: damaged YAML: {words}") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path}: expected ids and what they stand for, got {content!r:.80}")
    for key, value in content.items():
        if type(key) is not int or key < 0:
            raise ValueError(f"{path}: expected ids as keys, got {key!r}")
        if not isinstance(value, kind):
            raise ValueError(f"{path}: {key}: expected a {kind.__name__}, got {value!r:.80}")
    return content


def _check_depth(data: bytes) -> None:
    """Refuse what is nested so deeply that the parser in C would end the whole process.

    A level costs a bracket, a mark in one line with others, or at least half a blank of the line's
    indentation, as a list may stand right under the key that it belongs to.
    """
    marks = np.frombuffer(data, np.uint8)
    opened, closed = (np.isin(marks, list(pair)).cumsum() for pair in (b"[{", b"]}"))
    in_lines = re.search(rb"(?:[-?] +){%d}|(?:^|\r) {%d}" % (DEEPEST, DEEPEST), data, re.MULTILINE)
    if np.max(opened - closed) > DEEPEST or in_lines:
        raise ValueError(f"nested more than {DEEPEST} deep")


def _check_aliases(
    node: yaml.Node, known: dict[int, tuple[int, int]], above: frozenset[int]
) -> tuple[int, int]:
    """How many values a node stands for and how deep they lie, once its aliases are written out.

    Raises:
        ValueError: if there are too many or they lie too deep, or it stands within itself.
    """
    if isinstance(node, yaml.ScalarNode):
        return 1, 0
    if id(node) in above:
        raise ValueError("an alias stands within what it names")
    if id(node) not in known:
        children = node.value
        if isinstance(node, yaml.MappingNode):
            children = [child for pair in node.value for child in pair]
        sizes = [_check_aliases(child, known, above | {id(node)}) for child in children]
        size = 1 + sum(count for count, _ in sizes)
        depth = 1 + max((depth for _, depth in sizes), default=0)
        if size > MOST_VALUES:
            raise ValueError(f"aliases that stand for more than {MOST_VALUES} values")
        if depth > DEEPEST:
            raise ValueError(f"nested more than {DEEPEST} deep")
        known[id(node)] = size, depth
    return known[id(node)]
