"""What stands in a 3D figure: sets of points and of lines, the same for stills and the viewer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from matplotlib.colors import to_rgb
from torch import Tensor

from posecore import poses
from posecore.arrays import Array, fail, require_choice, require_number
from posecore.figures.overlays import BOX_EDGES
from posecore.figures.style import AXIS_COLOURS, CLOUD_COLOURS, to_floats
from posecore.metrics import box_corners

__all__ = ["UNITS", "Part", "Scene", "build_scene", "directions"]

UNITS = {"m": 1.0, "cm": 100.0, "mm": 1000.0}


@dataclass(frozen=True)
class Part:
    """A set of points (N, 3), or of line segments (S, 2, 3), in one colour or one for each point.

    `colours` is (3,) or (N, 3) in [0, 1]; None is the ink of the page, black on white. What is
    `on_top` is not hidden by what stands before it.
    """

    label: str
    positions: np.ndarray
    colours: np.ndarray | None
    on_top: bool = False

    @property
    def is_lines(self) -> bool:
        """Whether these are line segments."""
        return self.positions.ndim == 3


@dataclass(frozen=True)
class Scene:
    """All parts of a figure, and which way is up: "z", or "-y" as in the frame of a camera."""

    parts: tuple[Part, ...]
    up: str

    def corners(self) -> tuple[np.ndarray, np.ndarray]:
        """The smallest and the largest coordinates (3,)."""
        everything = np.concatenate([part.positions.reshape(-1, 3) for part in self.parts])
        return everything.min(0), everything.max(0)

    def describe(self) -> str:
        """The parts in words."""
        names = [
            part.label if part.is_lines else f"{part.label} ({len(part.positions)} points)"
            for part in self.parts
            if not part.on_top
        ]
        return ", ".join(names + ["axes"] * any(part.on_top for part in self.parts))


def build_scene(
    clouds: Mapping[str, Array],
    colours: Mapping[str, str | Array] | None,
    axes: Sequence[Array] | None,
    axis_length: float | None,
    boxes: Sequence[Array] | None,
    lines: Mapping[str, Array] | None,
    up: str,
) -> Scene:
    """Check and gather what a 3D figure shows; for the arguments see `point_clouds`.

    Raises:
        ValueError: naming the argument that is not as there, or if there is nothing to show.
    """
    require_choice("up", up, ("z", "-y"))
    lines = {} if lines is None else lines
    colours = {} if colours is None else colours
    for name, value in (("clouds", clouds), ("lines", lines), ("colours", colours)):
        if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
            fail(name, "label -> array", repr(value)[:80])
    strangers = set(colours) - set(clouds) - set(lines)
    if strangers:
        fail("colours", "labels of clouds or lines", sorted(strangers))
    parts = []
    for number, (label, points) in enumerate(clouds.items()):
        positions = to_floats(f"clouds[{label!r}]", points, "N", 3)
        chosen = colours.get(label, CLOUD_COLOURS[number % len(CLOUD_COLOURS)])
        parts.append(Part(label, positions, _colours(label, chosen, len(positions))))
    for label, segments in lines.items():
        positions = to_floats(f"lines[{label!r}]", segments, "S", 2, 3)
        chosen = colours.get(label)
        parts.append(Part(label, positions, None if chosen is None else _colours(label, chosen, 0)))
    if boxes is not None:
        R, t, size = _batch("boxes", boxes, "(R, t, size)")
        corners = box_corners(R, t, size)
        parts.append(Part("boxes", corners[:, BOX_EDGES].reshape(-1, 2, 3), None))
    if axes is not None:
        R, t = _batch("axes", axes, "(R, t)")
        if axis_length is None:
            known = [part.positions.reshape(-1, 3) for part in parts] + [t]
            axis_length = 0.3 * float(np.ptp(np.concatenate(known), axis=0).max()) or 0.1
        length = require_number("axis_length", axis_length, above=0)
        for axis, (letter, colour) in enumerate(AXIS_COLOURS.items()):
            ends = poses.apply(R, t, [np.zeros(3), np.eye(3)[axis] * length])
            parts.append(Part(letter, ends, np.array(to_rgb(colour)), on_top=True))
    if not parts:
        fail("clouds", "at least one set of points or lines", "none")
    return Scene(tuple(parts), up)


def directions(azimuth: float, elevation: float, up: str) -> np.ndarray:
    """Rows: right, up and towards the viewer (3, 3), in the frame of the points.

    Args:
        azimuth, elevation: where the viewer stands, radians; azimuth -pi/2, elevation 0 is before
            the x axis that runs to the right, azimuth 0 at the far end of it.
        up: "z" or "-y".
    """
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    rows = np.array([[-sa, ca, 0], [-ca * se, -sa * se, ce], [ca * ce, sa * ce, se]])
    # In a camera's frame the three directions right, forward, up are x, z, -y.
    return rows if up == "z" else rows[:, [0, 2, 1]] * [1, -1, 1]


def _colours(label: str, value: str | Array, count: int) -> np.ndarray:
    if isinstance(value, str):
        try:
            return np.array(to_rgb(value))
        except ValueError:
            fail(f"colours[{label!r}]", "a colour that matplotlib knows", repr(value))
    name = f"colours[{label!r}]"
    array = to_floats(name, value, "...", 3)
    if array.shape not in ((3,), (count, 3)):
        fail(name, f"a colour or shape ({count}, 3)", f"shape {array.shape}")
    kind = (value if isinstance(value, Tensor) else np.asarray(value)).dtype
    if kind not in (torch.uint8, np.uint8) and _whole(kind) and array.max() == 1:
        fail(name, "numbers in [0, 1] or bytes", "integers up to 1, which may be meant as either")
    array = array / (255.0 if _whole(kind) else 1.0)
    if not ((array >= 0) & (array <= 1)).all():
        fail(name, "numbers in [0, 1] or bytes", f"{array.min()}..{array.max()}")
    return array


def _whole(kind: Any) -> bool:
    return not (kind.is_floating_point if isinstance(kind, torch.dtype) else kind.kind == "f")


def _batch(name: str, value: Sequence[Array], expected: str) -> list[np.ndarray]:
    count = expected.count(",") + 1
    if not isinstance(value, tuple | list) or len(value) != count:
        fail(name, expected, repr(value)[:80])
    R = to_floats(f"{name}: R", value[0], "...", 3, 3).reshape(-1, 3, 3)
    rest = []
    for part, array in zip(expected[1:-1].split(", ")[1:], value[1:], strict=True):
        rows = to_floats(f"{name}: {part}", array, "...", 3).reshape(-1, 3)
        if len(rows) not in (1, len(R)):
            fail(f"{name}: {part}", f"one or {len(R)} rows of 3", f"shape {rows.shape}")
        rest.append(np.broadcast_to(rows, (len(R), 3)))
    return [R, *rest]
