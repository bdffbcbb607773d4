"""One look for all figures: colours, lines and markers that differ in grey too, and alt text."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import matplotlib.style
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from PIL import Image
from torch import Tensor

from posecore.arrays import fail
from posecore.figures.encoding import holds_photograph, smallest, to_png

__all__ = [
    "AXIS_COLOURS",
    "BOX_COLOURS",
    "CLOUD_COLOURS",
    "COLOURS",
    "HALO",
    "INK",
    "MARKERS",
    "STYLES",
    "Picture",
    "house_style",
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
# Boxes, which have axes in them: none of the three, mostly dark, as their rim is light.
BOX_COLOURS = ("#882255", "#000000", "#997700", "#56B4E9")
INK = "#000000"
# A light rim keeps a line visible on dark and on light pictures.
HALO = (withStroke(linewidth=3.6, foreground="white"),)

P, T = ParamSpec("P"), TypeVar("T")


def house_style(function: Callable[P, T]) -> Callable[P, T]:
    """Let a function draw as it would in a fresh process, whatever style its caller has set."""

    @wraps(function)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> T:
        with matplotlib.style.context("default"):
            return function(*args, **kwargs)

    return drawn


class Picture(Figure):
    """A matplotlib figure that belongs to no window and says in words what it shows.

    The last line of a cell shows it, with or without pyplot, and so does `show()` anywhere in a
    cell; the notebook keeps it as an <img> whose alt text is `alt`.
    """

    alt: str = ""

    def png(self, dpi: float = 100) -> bytes:
        """The figure as a PNG file, the same bytes whenever the figure is the same.

        What holds a photograph keeps all its colours; a drawing has at most 256.
        """
        return to_png(self._drawn(dpi), lossless=holds_photograph(self))

    def stored(self, dpi: float = 100) -> tuple[str, bytes]:
        """The figure as a notebook keeps it, small: its MIME type and its file.

        "image/jpeg" for what holds a photograph, unless PNG is smaller; "image/png" for a drawing.
        The same figure is the same bytes.
        """
        return smallest(self._drawn(dpi), holds_photograph(self))

    @house_style
    def _drawn(self, dpi: float) -> Image.Image:
        # Drawing moves the axes a little, and the next drawing would start from there.
        places = [(axes, axes.get_position(original=True)) for axes in self.axes]
        buffer = io.BytesIO()
        try:
            self.savefig(buffer, format="png", dpi=dpi)
        finally:
            for axes, place in places:
                axes._set_position(place)
        with Image.open(buffer) as picture:
            return picture.convert("RGB")

    def show(self, warn: bool = True) -> None:
        """Show the figure here, in the middle of a cell or of a loop.

        Args:
            warn: taken as matplotlib's figures take it, without effect.
        """
        show_in_notebook(self)

    def _ipython_display_(self) -> None:
        # Said outright, since IPython would draw any Figure anew, without `stored`, once pyplot has
        # opened one.
        from IPython.display import display

        data, metadata = self._repr_mimebundle_()
        display(data, metadata=metadata, raw=True)

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> tuple[dict, dict]:
        # JupyterLab 4.6 draws image/png and image/jpeg by `renderImage` (rendermime), which takes
        # no alt from the metadata (jupyter/enhancement-proposals, issue 120): there the <img> has
        # none. It draws this HTML with its alt text, as large as the picture alone, also where the
        # notebook is not trusted: its sanitizer lets data: in <img> pass. Both forms in one file
        # would double its size. Readers that know no HTML have the words.
        kind, data = self.stored()
        source = f"data:{kind};base64,{base64.b64encode(data).decode()}"
        words = html.escape(self.alt)
        return {"text/html": f'<img alt="{words}" src="{source}">', "text/plain": self.alt}, {}


def show_in_notebook(figure: Any) -> None:
    """Show a figure under the running cell; outside a notebook its words are printed."""
    try:
        from IPython import get_ipython  # the library does without it
        from IPython.display import display
    except ImportError:
        get_ipython = lambda: None  # noqa: E731
    if get_ipython() is None:
        print(figure.alt)
    else:
        display(figure)


@house_style
def new_picture(width: float, height: float, alt: str | None, default: str = "") -> Picture:
    """An empty figure of `width` x `height` inches.

    Args:
        width, height: inches.
        alt: what the figure shows, in words, from the caller.
        default: what it shows if the caller did not say; without it `alt` must.

    Raises:
        ValueError: if `alt` is an empty text or none at all.
    """
    said = alt if alt is not None or not default else default
    if not isinstance(said, str) or not said.strip():
        fail("alt", "a text that says what the figure shows", repr(alt))
    figure = Picture(figsize=(width, height), layout="constrained")
    figure.alt = said
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
