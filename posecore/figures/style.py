"""One look for all figures: colours, lines and markers that differ in grey too, and alt text."""

from __future__ import annotations

import base64
import io
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from torch import Tensor

from posecore.arrays import fail

__all__ = [
    "AXIS_COLOURS",
    "CLOUD_COLOURS",
    "COLOURS",
    "HALO",
    "INK",
    "MARKERS",
    "STYLES",
    "Picture",
    "new_picture",
    "to_floats",
]

# Okabe and Ito's colours, told apart by the colour-blind; line styles tell them apart in grey.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
# Points have no line style: neighbours in this order differ in brightness.
CLOUD_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9")
STYLES = ("-", "--", "-.", ":")
MARKERS = ("o", "s", "D", "^")
# Red, green and blue as everybody draws x, y and z, in the shades of the same palette.
AXIS_COLOURS = {"x": "#D55E00", "y": "#009E73", "z": "#0072B2"}
INK = "#000000"
# A light rim keeps a line visible on dark and on light pictures.
HALO = (withStroke(linewidth=3.6, foreground="white"),)


class Picture(Figure):
    """A matplotlib figure that belongs to no window and says in words what it shows.

    A notebook shows it with or without pyplot, and keeps `alt` with the stored picture.
    """

    alt: str = ""

    def png(self, dpi: float = 100) -> bytes:
        """The figure as a PNG file, the same bytes whenever the figure is the same."""
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
        return buffer.getvalue()

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> tuple[dict, dict]:
        encoded = base64.b64encode(self.png()).decode()
        return {"image/png": encoded, "text/plain": self.alt}, {"image/png": {"alt": self.alt}}


def new_picture(width: float, height: float, alt: str | None, default: str) -> Picture:
    """An empty figure of `width` x `height` inches.

    Args:
        width, height: inches.
        alt: what the figure shows, in words, from the caller.
        default: what it shows if the caller did not say.

    Raises:
        ValueError: if `alt` is an empty text or none at all.
    """
    if alt is not None and (not isinstance(alt, str) or not alt.strip()):
        fail("alt", "a text that says what the figure shows", repr(alt))
    figure = Picture(figsize=(width, height), layout="constrained")
    figure.alt = default if alt is None else alt
    return figure


def to_floats(name: str, value: object, *shape: int | str) -> np.ndarray:
    """`value` as a finite float64 array.

    Args:
        name: what the caller's argument is called; the error begins with it.
        value: array, tensor or nested list.
        shape: a number is that size; a name is any size of at least one; a leading "..." is any
            number of dimensions.

    Raises:
        ValueError: if the value is not numeric, not finite, or has another shape.
    """
    if isinstance(value, Tensor):
        value = value.detach().cpu().double().numpy()
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "fiub":
            raise TypeError
    except (TypeError, ValueError):
        fail(name, "an array of numbers", repr(value)[:80])
    array = array.astype(np.float64)
    core = shape[1:] if shape[:1] == ("...",) else shape
    shown = array.shape[array.ndim - len(core) :] if core is not shape else array.shape
    fits = len(shown) == len(core) and all(
        size == wanted if isinstance(wanted, int) else size > 0
        for size, wanted in zip(shown, core, strict=True)
    )
    if not fits or array.size == 0:
        fail(name, f"shape ({', '.join(map(str, shape))})", f"shape {array.shape}")
    if not np.isfinite(array).all():
        fail(name, "finite values", f"{int((~np.isfinite(array)).sum())} that are not")
    return array
