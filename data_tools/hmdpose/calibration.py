"""The three cameras: `calibration.json`, read and written."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from data_tools.bop.files import read_integer, read_json, read_number, read_numbers
from data_tools.bop.rotations import check_rotations
from posecore.cameras import require_intrinsics, resize_intrinsics

__all__ = ["CAMERAS", "Calibration", "Camera", "read_calibration", "to_json"]

CAMERAS = ("left", "centre", "right")  # as they lie in the image of the centre camera
ENTRIES = ("K", "T_world_cam", "width", "height")
MOST_PIXELS = 100_000  # along a side of an image


@dataclass(frozen=True, eq=False)
class Camera:
    """One of the three cameras.

    Attributes:
        K: (3, 3) camera matrix in pixels.
        T_world_cam: (4, 4) its pose in the car, metres.
        width, height: of its images in pixels.
    """

    K: np.ndarray
    T_world_cam: np.ndarray
    width: int
    height: int

    def resized(self, width: int) -> Camera:
        """The camera of images that were reduced to a width; the height is rounded."""
        if width == self.width:
            return self
        height = max(1, round(self.height * width / self.width))
        K = resize_intrinsics(self.K, (self.width, self.height), (width, height))
        return replace(self, K=K, width=width, height=height)


@dataclass(frozen=True, eq=False)
class Calibration:
    """What `calibration.json` holds.

    Attributes:
        cameras: by name, in the order of `CAMERAS`.
        depth_step: metres of a unit of the depth images; None if the file does not say.
    """

    cameras: Mapping[str, Camera]
    depth_step: float | None = None


def read_calibration(path: Path) -> Calibration:
    """Read a `calibration.json`.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: naming the file, the camera and the entry that is missing or cannot be.
    """
    content = read_json(path)
    if not isinstance(content, dict) or not isinstance(content.get("cameras"), dict):
        raise ValueError(
            f'{path}: expected {{"cameras": {{"left": ..., ...}}}}, got something else'
        )
    _refuse_others(str(path), content, ("cameras", "depth_step"))
    found = content["cameras"]
    missing = [name for name in CAMERAS if name not in found]
    if missing:
        got = ", ".join(found) or "none"
        raise ValueError(f"{path}: cameras: expected {', '.join(CAMERAS)}, got {got:.80}")
    _refuse_others(f"{path}: cameras", found, CAMERAS)
    step = None
    if "depth_step" in content:
        step = read_number(str(path), content, "depth_step")
        if not 0 < step <= 1:
            raise ValueError(f"{path}: depth_step: expected metres above 0, got {step}")
    cameras = {name: _read_camera(path, f"{path}: camera {name}", found[name]) for name in CAMERAS}
    return Calibration(cameras, step)


def to_json(calibration: Calibration) -> bytes:
    """The content of a `calibration.json`; reading it gives the same numbers bit by bit."""
    lines = []
    for name, camera in calibration.cameras.items():
        entry = {
            "K": camera.K.ravel().tolist(),
            "T_world_cam": camera.T_world_cam.ravel().tolist(),
            "width": camera.width,
            "height": camera.height,
        }
        lines.append(f'    "{name}": {json.dumps(entry)}')
    step = calibration.depth_step
    head = "" if step is None else f'  "depth_step": {json.dumps(step)},\n'
    return ("{\n" + head + '  "cameras": {\n' + ",\n".join(lines) + "\n  }\n}\n").encode("ascii")


def _read_camera(path: Path, where: str, entry: object) -> Camera:
    K = read_numbers(where, entry, "K", 9).reshape(3, 3)
    try:
        require_intrinsics("K", K)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    T = read_numbers(where, entry, "T_world_cam", 16).reshape(4, 4)
    if T[3].tolist() != [0, 0, 0, 1]:
        raise ValueError(f"{where}: T_world_cam: expected a last row 0 0 0 1, got {T[3].tolist()}")
    name = where.removeprefix(f"{path}: ") + ", T_world_cam"
    T[:3, :3] = check_rotations(path, T[None, :3, :3], "project", lambda _: name)[0]
    sizes = {name: read_integer(where, entry, name) for name in ("width", "height")}
    for name, pixels in sizes.items():
        if not 1 <= pixels <= MOST_PIXELS:
            raise ValueError(f"{where}: {name}: expected 1 to {MOST_PIXELS} pixels, got {pixels}")
    _refuse_others(where, entry, ENTRIES)
    return Camera(K, T, **sizes)


def _refuse_others(where: str, entry: dict, known: tuple[str, ...]) -> None:
    """Refuse what nobody would heed, such as a distortion, or a misspelt name."""
    for name in entry:
        if name not in known:
            raise ValueError(f"{where}: expected nothing but {', '.join(known)}, got {name!r:.80}")
