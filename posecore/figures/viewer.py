"""A 3D figure that the reader can turn, in one piece of HTML that loads nothing.

Where scripts do not run (GitHub, an untrusted notebook, a printed page) the still picture of
`point_clouds` stands in its place. WebGL, the browsers' interface for 3D, draws points and lines.
"""

from __future__ import annotations

import base64
import collections
import hashlib
import html
import io
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from PIL import Image

from posecore.arrays import Array
from posecore.figures.clouds3d import AZIMUTH, ELEVATION, draw_scene
from posecore.figures.scene import UNITS, Part, build_scene
from posecore.figures.style import MARKERS, show_in_notebook
from posecore.figures.viewer_script import SCRIPT

__all__ = ["Viewer"]

STEPS = 65535  # positions are stored in 16 bits
_shown: collections.Counter[str] = collections.Counter()


class Viewer:
    """Point clouds, axes and boxes to turn and zoom on a page; arguments as in `point_clouds`.

    The last line of a cell shows it, and so does `show()` anywhere in a cell. Drag turns, pinch or
    the wheel with Ctrl or Command zooms, a double click goes back; where the figure has the focus,
    arrow keys, + and -, and 0 do the same. A click on a name hides or shows its points. The wheel
    alone, and a finger that moves up or down, scroll the page.

    Args:
        clouds, colours, axes, axis_length, boxes, lines, up, unit: as in `point_clouds`.
        alt: what the figure shows, in words; by default the labels and numbers of points.

    Attributes:
        alt: the text for those who do not see the figure.
        still: the figure that stands in where scripts do not run.
        resolution: metres between two neighbouring stored positions; what is drawn lies within
            half of it, on each axis, of what was given.

    Raises:
        ValueError: if there is nothing to draw, or an argument is not as in `point_clouds`.
    """

    def __init__(
        self,
        clouds: Mapping[str, Array],
        *,
        colours: Mapping[str, str | Array] | None = None,
        axes: Sequence[Array] | None = None,
        axis_length: float | None = None,
        boxes: Sequence[Array] | None = None,
        lines: Mapping[str, Array] | None = None,
        up: str = "z",
        unit: str = "mm",
        alt: str | None = None,
    ) -> None:
        self._scene = build_scene(clouds, colours, axes, axis_length, boxes, lines, up)
        self.still = draw_scene(self._scene, ("oblique",), unit, alt)
        self.alt = self.still.alt
        low, high = self._scene.corners()
        self._span = float((high - low).max()) or 1.0
        self._low = (low + high - self._span) / 2
        everything = np.concatenate([part.positions.reshape(-1, 3) for part in self._scene.parts])
        distances = np.linalg.norm(everything - (low + high) / 2, axis=1)
        self._radius = 2 * float(distances.max()) / self._span or 1.0
        self._extent = f"{self._span * UNITS[unit]:.3g} {unit}"
        self.resolution = self._span / STEPS

    def payload(self) -> dict[str, Any]:
        """What the script in the page is given.

        A stored position q, 16 bits little-endian in base64, is the point `low + q * resolution`,
        in metres. Colours are bytes; null is the colour of the page's text.
        """
        count = sum(len(part.positions) for part in self._scene.parts if not part.is_lines)
        return {
            "parts": [self._encode(number, part) for number, part in enumerate(self._scene.parts)],
            "low": self._low.tolist(),
            "resolution": self.resolution,
            "up": self._scene.up,
            "azimuth": AZIMUTH,
            "elevation": ELEVATION,
            "radius": self._radius,
            "size": 0.05 if count < 500 else 0.03,
            "hint": f"{self._extent} along its longest side · drag to turn · Ctrl + wheel or pinch "
            "to zoom · double click to go back",
        }

    def png(self) -> bytes:
        """The still picture as a small PNG file."""
        with Image.open(io.BytesIO(self.still.png())) as picture:
            reduced = picture.convert("RGB").quantize(64, dither=Image.Dither.NONE)
        buffer = io.BytesIO()
        reduced.save(buffer, format="PNG", optimize=True)
        return buffer.getvalue()

    def show(self) -> None:
        """Show the figure here, in the middle of a cell or of a loop."""
        show_in_notebook(self)

    def html(self) -> str:
        """The figure as HTML, complete in itself; every call gives it an id of its own."""
        return self._page(self.png())

    def _page(self, png: bytes) -> str:
        # A page may hold it in <script>, so no text may end that; ASCII needs no encoding.
        data = json.dumps(self.payload(), separators=(",", ":")).replace("<", "\\u003c")
        digest = hashlib.sha256(data.encode()).hexdigest()[:12]
        name = f"viewer-{digest}-{_shown[digest]}"
        _shown[digest] += 1
        return (
            f'<figure id="{name}" style="margin:0 auto;max-width:760px;text-align:center">'
            f'<img alt="{html.escape(self.alt)}" style="max-width:100%" '
            f'src="data:image/png;base64,{base64.b64encode(png).decode()}"></figure>'
            f'<script>{SCRIPT}("{name}",{data})</script>'
        )

    def _repr_html_(self) -> str:
        return self.html()

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> tuple[dict, dict]:
        png = self.png()
        data = {
            "text/html": self._page(png),
            "image/png": base64.b64encode(png).decode(),
            "text/plain": self.alt,
        }
        return data, {"image/png": {"alt": self.alt}}

    def _encode(self, number: int, part: Part) -> dict[str, Any]:
        steps = (part.positions.reshape(-1, 3) - self._low) / self.resolution
        encoded = {
            "label": part.label,
            "lines": part.is_lines,
            "marker": number % len(MARKERS),
            "positions": _base64(np.clip(np.rint(steps), 0, STEPS).astype("<u2")),
            "onTop": part.on_top,
            "colour": None,
        }
        if part.colours is not None:
            colours = np.rint(part.colours * 255).astype(np.uint8)
            solid = colours if colours.ndim == 1 else np.rint(colours.mean(0))
            encoded["colour"] = [int(value) for value in solid]
            if colours.ndim == 2:
                encoded["colours"] = _base64(colours)
        return encoded


def _base64(array: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()
