"""Point clouds as a still picture, seen from several sides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.markers import MarkerStyle
from matplotlib.ticker import MaxNLocator

from posecore.arrays import Array, fail, require_choice
from posecore.figures.scene import UNITS, Scene, build_scene, directions
from posecore.figures.style import (
    AXIS_COLOURS,
    HALO,
    INK,
    MARKERS,
    Picture,
    house_style,
    new_picture,
)

__all__ = ["AZIMUTH", "ELEVATION", "VIEWS", "draw_scene", "point_clouds"]

AZIMUTH, ELEVATION = np.radians(-60.0), np.radians(25.0)
VIEWS = {
    "oblique": (AZIMUTH, ELEVATION),
    "front": (-np.pi / 2, 0.0),
    "side": (0.0, 0.0),
    "top": (-np.pi / 2, np.pi / 2),
}
PANEL = 3.0  # inches
LETTER = {"ha": "center", "va": "center", "fontsize": 9, "fontweight": "bold"}


def point_clouds(
    clouds: Mapping[str, Array],
    *,
    colours: Mapping[str, str | Array] | None = None,
    axes: Sequence[Array] | None = None,
    axis_length: float | None = None,
    boxes: Sequence[Array] | None = None,
    lines: Mapping[str, Array] | None = None,
    views: Sequence[str] = ("oblique", "front", "side", "top"),
    up: str = "z",
    unit: str = "mm",
    alt: str | None = None,
) -> Picture:
    """Draw point clouds from several sides, all panels to the same scale, without perspective.

    Args:
        clouds: label -> (N, 3) points, metres.
        colours: label -> a colour, or (N, 3) colours of the points (bytes, or numbers in [0, 1]),
            for clouds or lines; others take theirs from the palette.
        axes: (R, t) with shapes (..., 3, 3) and (..., 3): poses whose axes are drawn.
        axis_length: of those axes, metres; by default 0.3 of the scene.
        boxes: (R, t, size) with shapes (..., 3, 3), (..., 3), (..., 3): boxes to draw.
        lines: label -> (S, 2, 3) segments, metres.
        views: of "oblique", "front", "side" (from +x) and "top", in the order of the panels.
        up: "z"; or "-y" for points in the frame of a camera, where "front" is the camera's view.
        unit: of the drawn axes: "m", "cm" or "mm".
        alt: what the figure shows, in words; by default the labels and numbers of points.

    Returns:
        A figure that belongs to no window, a panel for each view.

    Raises:
        ValueError: if there is nothing to draw, or an argument is not as above.
    """
    scene = build_scene(clouds, colours, axes, axis_length, boxes, lines, up)
    return draw_scene(scene, views, unit, alt)


@house_style
def draw_scene(scene: Scene, views: Sequence[str], unit: str, alt: str | None) -> Picture:
    """The figure of a scene; for the arguments see `point_clouds`.

    Raises:
        ValueError: if `unit` or a view is none that there is, or there are no views.
    """
    require_choice("unit", unit, tuple(UNITS))
    if isinstance(views, str) or not views:
        fail("views", "a sequence of " + ", ".join(map(repr, VIEWS)), repr(views))
    for view in views:
        require_choice("views", view, tuple(VIEWS))
    default = f"{scene.describe()}; seen from: {', '.join(views)}; in {unit}"
    rows, columns = -(-len(views) // 2), min(len(views), 2)
    scale = 1.6 if len(views) == 1 else 1.1
    figure = new_picture(columns * PANEL * scale, rows * PANEL * scale + 0.3, alt, default)
    low, high = scene.corners()
    centre = (low + high) / 2
    reach = _reach(scene, views, centre)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel, view in zip(panels, views, strict=False):
        _draw_view(panel, scene, view, unit, centre, reach, len(views) > 1)
    for panel in panels[len(views) :]:
        panel.remove()
    look = {"frameon": False, "fontsize": 9, "columnspacing": 1.2, "handlelength": 1.4}
    if handles := _legend(scene):
        longest = max(len(handle.get_label()) for handle in handles)
        fitting = max(1, int(12 * figure.get_figwidth() / (longest + 4)))  # 12 letters an inch
        place = {"loc": "outside lower center", "ncols": fitting}
        figure.legend(handles=handles, **place, **look)
    return figure


def _reach(scene: Scene, views: Sequence[str], centre: np.ndarray) -> float:
    """How far anything is from the middle, right or up, in any of the views."""
    reach = 0.0
    for part in scene.parts:
        for view in views:
            right_up = directions(*VIEWS[view], scene.up)[:2]
            reach = max(reach, np.abs((part.positions - centre) @ right_up.T).max())
    return 1.08 * reach or 0.5


def _draw_view(
    panel: Axes,
    scene: Scene,
    view: str,
    unit: str,
    centre: np.ndarray,
    reach: float,
    titled: bool,
) -> None:
    frame = directions(*VIEWS[view], scene.up)
    names = [_name(row) for row in frame[:2]]
    # A direction that is an axis turned round is drawn as that axis with its numbers descending.
    turned = np.array([-1.0 if name.startswith("-") else 1.0 for name in names])
    factor = UNITS[unit]
    _draw_points(panel, scene, frame, turned * factor)
    for part in scene.parts:
        if part.is_lines:
            ends = part.positions @ frame[:2].T * turned * factor
            colour = INK if part.colours is None else part.colours
            look = {"linewidths": 1.3}
            if part.on_top:
                look = {"linewidths": 2.2, "path_effects": HALO, "zorder": 3}
                for start, tip in ends:  # letters tell the axes apart where there is no colour
                    place = tip + 0.12 * (tip - start)
                    text = panel.text(*place, part.label, color=colour, clip_on=True, **LETTER)
                    text.set(path_effects=HALO, zorder=4)
            panel.add_collection(LineCollection(ends, colors=[colour], **look))
    middle = frame[:2] @ centre * turned * factor
    edges = np.array([-reach, reach]) * factor
    panel.set(
        xlim=middle[0] + edges * turned[0],
        ylim=middle[1] + edges * turned[1],
        title=view if titled else "",
    )
    panel.set_aspect("equal", adjustable="box")
    if view == "oblique":
        panel.set(xticks=[], yticks=[])
        panel.spines[:].set_visible(False)
        if not any(part.on_top for part in scene.parts):
            _draw_compass(panel, frame)
        _draw_length(panel, reach * factor, unit)
    else:
        panel.set(
            xlabel=f"{names[0].lstrip('-')}, {unit}", ylabel=f"{names[1].lstrip('-')}, {unit}"
        )
        panel.xaxis.set_major_locator(MaxNLocator(5))
        panel.yaxis.set_major_locator(MaxNLocator(5))
        panel.grid(alpha=0.25)
        panel.set_axisbelow(True)


def _draw_points(panel: Axes, scene: Scene, frame: np.ndarray, factor: np.ndarray) -> None:
    """All points of all sets in one collection, the nearest last, so that they hide the others."""
    clouds = [part for part in scene.parts if not part.is_lines]
    if not clouds:
        return
    positions = np.concatenate([part.positions for part in clouds])
    colours = np.concatenate(
        [np.broadcast_to(part.colours, part.positions.shape) for part in clouds]
    )
    kinds = np.repeat(np.arange(len(clouds)), [len(part.positions) for part in clouds])
    order = np.argsort(positions @ frame[2], kind="stable")
    x, y = (positions[order] @ frame[:2].T * factor).T
    size = float(np.clip(20000 / len(positions), 3, 30))
    drawn = panel.scatter(x, y, s=size, c=colours[order], linewidths=0)
    markers = [MarkerStyle(MARKERS[kind % len(MARKERS)]) for kind in range(len(clouds))]
    paths = [marker.get_path().transformed(marker.get_transform()) for marker in markers]
    drawn.set_paths([paths[kind] for kind in kinds[order]])


def _draw_compass(panel: Axes, frame: np.ndarray) -> None:
    """In the corner: which way the axes point."""
    for axis, (letter, colour) in enumerate(AXIS_COLOURS.items()):
        start, tip = np.array([0.09, 0.12]), frame[:2, axis] * 0.08
        panel.plot(
            *np.stack([start, start + tip], 1), color=colour, transform=panel.transAxes, lw=1.6
        )
        look = {"ha": "center", "va": "center", "fontsize": 9, "color": colour}
        panel.text(*(start + 1.45 * tip), letter, transform=panel.transAxes, **look)


def _draw_length(panel: Axes, reach: float, unit: str) -> None:
    """In the other corner: how long a round number of units is."""
    length = 10.0 ** np.floor(np.log10(reach))
    length *= max(n for n in (0.2, 0.5, 1, 2, 5) if n * length <= 0.6 * reach)
    share = length / (2 * reach)
    panel.plot([0.97 - share, 0.97], [0.04] * 2, color=INK, lw=2, transform=panel.transAxes)
    text = {"ha": "center", "va": "bottom", "fontsize": 9, "transform": panel.transAxes}
    panel.text(0.97 - share / 2, 0.05, f"{length:g} {unit}", **text)


def _name(direction: np.ndarray) -> str:
    axis = int(np.abs(direction).argmax())
    return ("-" if direction[axis] < 0 else "") + "xyz"[axis]


def _legend(scene: Scene) -> list[Line2D]:
    """What is what; axes carry their letters in the picture."""
    handles = []
    for part in scene.parts:
        if part.on_top:
            continue
        many = part.colours is not None and part.colours.ndim == 2
        colour = INK if part.colours is None else part.colours.mean(0) if many else part.colours
        shape = {} if part.is_lines else {"linestyle": "", "marker": MARKERS[len(handles) % 4]}
        handles.append(Line2D([], [], color=colour, label=part.label, markersize=6, **shape))
    return handles
