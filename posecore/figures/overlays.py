"""What is drawn into a picture: the axes of a pose, boxes, keypoints and outlines of masks.

All functions draw into the axes of a picture (`figures.picture(image).axes[0]`) in pixels, with the
centre of the first pixel at (0, 0). What lies behind the camera is left out; lines that pass
through its plane are cut just before it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse

from posecore import cameras, poses
from posecore.arrays import Array, fail, require_number
from posecore.figures.style import AXIS_COLOURS, BOX_COLOURS, COLOURS, HALO, house_style, to_floats
from posecore.metrics import box_corners

__all__ = [
    "BOX_EDGES",
    "box_edges",
    "draw_axes",
    "draw_box",
    "draw_ellipse",
    "draw_keypoints",
    "draw_outline",
]

# Pairs of corners of `box_corners` that differ in one sign.
BOX_EDGES = np.array([(a, b) for a, b in itertools.combinations(range(8), 2) if a ^ b in (1, 2, 4)])
SIGNS = np.array(list(itertools.product((-1, 1), repeat=3)))


@house_style
def draw_axes(axes: Axes, K: Array, R: Array, t: Array, length: float) -> None:
    """Draw the x, y and z axis of an object, each with its letter.

    Args:
        axes: of a picture.
        K: (3, 3) camera matrix.
        R, t: (3, 3) and (3,), the pose of the object, metres.
        length: of the axes, metres.

    Raises:
        ValueError: if an argument has another shape or `K` is no camera matrix.
    """
    K, R, t = _camera(K), to_floats("R", R, 3, 3), to_floats("t", t, 3)
    size = require_number("length", length, above=0)
    for axis, (letter, colour) in enumerate(AXIS_COLOURS.items()):
        ends = _to_pixels(K, poses.apply(R, t, [np.zeros(3), np.eye(3)[axis] * size]))
        if ends is None:
            continue
        axes.plot(*ends.T, color=colour, linewidth=2, path_effects=HALO, gid=f"axis {letter}")
        _write(axes, letter, ends[1] + _outwards(ends), colour)


@house_style
def draw_box(
    axes: Axes,
    K: Array,
    R: Array,
    t: Array,
    size: Array,
    *,
    centre: Array = (0.0, 0.0, 0.0),
    colour: str = BOX_COLOURS[0],
) -> None:
    """Draw a 3D box; edges that its own faces hide are dashed.

    Args:
        axes: of a picture.
        K: (3, 3) camera matrix.
        R, t: (3, 3) and (3,), the pose of the object, metres.
        size: (3,) edge lengths along the object's axes, metres.
        centre: (3,) centre of the box in the object's frame, metres.
        colour: any colour that matplotlib knows.

    Raises:
        ValueError: if an argument has another shape, a size is negative, `K` is no camera matrix,
            or `R` cannot be inverted.
    """
    K, corners, hidden = _camera(K), *box_edges(R, t, size, centre)
    for edge, dashed in zip(BOX_EDGES, hidden, strict=True):
        ends = _to_pixels(K, corners[edge])
        if ends is not None:
            look = {"linestyle": (0, (3, 2.5)), "linewidth": 1.2} if dashed else {"linewidth": 1.8}
            gid = "hidden edge" if dashed else "edge"
            axes.plot(*ends.T, color=colour, path_effects=HALO, gid=gid, zorder=1.9, **look)


def box_edges(R: Array, t: Array, size: Array, centre: Array) -> tuple[np.ndarray, np.ndarray]:
    """Corners (8, 3) of a box in the camera's frame and which of `BOX_EDGES` its faces hide (12,).

    Args:
        R, t: (3, 3) and (3,), the pose of the object.
        size, centre: (3,) and (3,), edge lengths and centre of the box in the object's frame.

    Raises:
        ValueError: on shapes that do not fit, what is not finite, or an `R` without an inverse.
    """
    R, t, size = to_floats("R", R, 3, 3), to_floats("t", t, 3), to_floats("size", size, 3)
    middle = R @ to_floats("centre", centre, 3) + t
    if abs(np.linalg.det(R)) < 1e-9:
        fail("R", "a matrix that can be inverted", R.tolist())
    # A face is seen if the camera is on its outer side; an edge, if one of its two faces is.
    camera = np.linalg.solve(R, -middle)
    seen = SIGNS * camera > size / 2  # (8, 3): corner, the face through it across that axis
    one, two = BOX_EDGES.T
    shared = SIGNS[one] == SIGNS[two]
    return box_corners(R, middle, size), ~(seen[one] & shared).any(1)


@house_style
def draw_keypoints(
    axes: Axes,
    pixels: Array,
    *,
    label: str | None = None,
    colour: str = COLOURS[4],
    marker: str = "o",
    numbers: bool = False,
) -> None:
    """Mark points of a picture.

    Args:
        axes: of a picture.
        pixels: (N, 2) columns and rows; where N is 0 nothing is drawn.
        label: name for the legend; the caller asks for it with `axes.legend()`.
        colour, marker: as matplotlib has them.
        numbers: whether to write each point's index beside it.

    Raises:
        ValueError: if `pixels` has another shape.
    """
    if np.shape(pixels) == (0, 2):
        return  # none were found
    points = to_floats("pixels", pixels, "N", 2)
    look = {"s": 42, "color": colour, "edgecolors": "black", "linewidths": 0.9}
    if marker in ("x", "+"):  # have no inside that an edge could surround
        look = {"s": 48, "color": colour, "linewidths": 2, "path_effects": HALO}
    axes.scatter(*points.T, marker=marker, label=label, zorder=3, **look)
    for number, point in enumerate(points if numbers else ()):
        offset = {"xytext": (5, 4), "textcoords": "offset points", "annotation_clip": True}
        text = axes.annotate(str(number), point, fontsize=9, zorder=4, **offset)
        text.set_path_effects(HALO)


@house_style
def draw_outline(
    axes: Axes,
    mask: Array,
    *,
    label: str | None = None,
    colour: str = COLOURS[1],
    style: str = "-",
) -> None:
    """Draw the border of a mask, along the edges of its pixels.

    Args:
        axes: of a picture.
        mask: (H, W) true (or not 0) inside. An empty mask has no border and draws nothing.
        label: name for the legend; the caller asks for it with `axes.legend()`.
        colour, style: as matplotlib has them.

    Raises:
        ValueError: if `mask` has another shape.
    """
    rounds = _rounds(to_floats("mask", mask, "H", "W") != 0)
    # One line with gaps: its rim is drawn before all of it, and dashes run through.
    gap = np.full((1, 2), np.nan)
    points = np.concatenate([part for one in rounds for part in (one, gap)] or [gap])
    look = {"linewidth": 1.8, "solid_joinstyle": "miter", "path_effects": HALO}
    axes.plot(*points.T, color=colour, linestyle=style, label=label, gid="outline", **look)


@house_style
def draw_ellipse(
    axes: Axes, mean: Array, covariance: Array, *, colour: str = COLOURS[1], rim: bool = False
) -> None:
    """Draw the ellipse of two standard deviations around a mean.

    86 % of a normal distribution are inside.

    Args:
        axes: of a picture.
        mean: (2,) pixels.
        covariance: (2, 2) square pixels, symmetric; without spread in a direction, a line.
        colour: as matplotlib has it.
        rim: whether the line has a light rim.

    Raises:
        ValueError: if an argument has another shape.
    """
    mean = to_floats("mean", mean, 2)
    variances, directions = np.linalg.eigh(to_floats("covariance", covariance, 2, 2))
    long, short = 4 * np.sqrt(variances[::-1].clip(0))
    angle = np.degrees(np.arctan2(*directions[::-1, 1]))
    ring = Ellipse(mean, long, short, angle=angle, fill=False, ec=colour, lw=1.8, zorder=2)
    ring.set_path_effects(HALO if rim else [])
    axes.add_patch(ring)


def _rounds(inside: np.ndarray) -> list[np.ndarray]:
    """The border of a mask as closed lines (N, 2) from corner to corner, first and last the same.

    The inside lies on the right of one who walks along them, with y pointing down.
    """
    filled = np.pad(inside, 1)
    below, above = filled[1:, 1:-1], filled[:-1, 1:-1]
    right, left = filled[1:-1, 1:].T, filled[1:-1, :-1].T
    steps = np.concatenate(
        [
            _runs(below & ~above),
            _runs(above & ~below)[:, ::-1],
            _runs(left & ~right)[..., ::-1],
            _runs(right & ~left)[:, ::-1, ::-1],
        ]
    )
    onwards: dict[tuple[float, ...], list[tuple[float, ...]]] = {}
    for start, end in steps.tolist():
        onwards.setdefault(tuple(start), []).append(tuple(end))
    rounds = []
    while onwards:
        walk = [next(iter(onwards))]
        while ends := onwards.get(walk[-1]):
            place = walk[-1]
            walk.append(ends.pop())
            if not ends:
                del onwards[place]
        rounds.append(np.array(walk))
    return rounds


def _runs(border: np.ndarray) -> np.ndarray:
    """Straight pieces (S, 2, 2) of a border; `border[y, x]` lies above the pixel (x, y)."""
    steps = np.diff(np.pad(border, ((0, 0), (1, 1))).astype(int), axis=1)
    rows, first = np.nonzero(steps == 1)
    last = np.nonzero(steps == -1)[1]
    return np.stack([np.stack([first, rows], 1), np.stack([last, rows], 1)], axis=1) - 0.5


def _camera(K: Array) -> np.ndarray:
    K = to_floats("K", K, 3, 3)
    cameras.require_intrinsics("K", K)
    return K


def _to_pixels(K: np.ndarray, ends: np.ndarray) -> np.ndarray | None:
    """The two pixels of a segment's part before the camera; None if all of it is behind."""
    z = ends[:, 2]
    near = max(1e-3 * np.abs(ends).max(), 1e-9)
    if (z < near).all():
        return None
    if (z < near).any():
        front, back = ends[np.argmax(z)], ends[np.argmin(z)]
        cut = front + (back - front) * (front[2] - near) / (front[2] - back[2])
        ends = np.where((z < near)[:, None], [*cut[:2], near], ends)
    return cameras.project(K, ends)


def _outwards(ends: np.ndarray) -> np.ndarray:
    direction = ends[1] - ends[0]
    return 7 * direction / max(float(np.linalg.norm(direction)), 1e-9)


def _write(axes: Axes, text: str, place: Sequence[float], colour: str) -> None:
    look = {"ha": "center", "va": "center", "fontsize": 9, "fontweight": "bold", "clip_on": True}
    axes.text(*place, text, color=colour, path_effects=HALO, **look)
