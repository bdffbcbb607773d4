"""Figures as files: small PNG files of drawings, JPEG files of what holds a photograph.

A drawing has few colours: PNG keeps it sharp, and a palette of 256 makes it small. A photograph or
a rendering in 256 colours shows bands where it was smooth, and in all of its colours it is several
times the size of a JPEG file, in which nobody sees the difference.
"""

from __future__ import annotations

import io

import numpy as np
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from PIL import Image

__all__ = [
    "MANY_COLOURS",
    "QUALITY",
    "holds_photograph",
    "is_photograph",
    "smallest",
    "to_jpeg",
    "to_png",
]

MANY_COLOURS = 64  # a table of shades or a mask has fewer, a photograph more
QUALITY = 80  # of JPEG: with colour at every pixel, lines over a photograph keep their edges


def holds_photograph(figure: Figure) -> bool:
    """Whether a figure shows a photograph or a rendering.

    Told by what is drawn, so that no caller has to say it: a visible image in colours of its own,
    or in greys, that has more than `MANY_COLOURS` of them. Numbers in the colours of a scale, such
    as a depth map, are a drawing.
    """
    return any(image.get_visible() and is_photograph(image) for image in figure.findobj(AxesImage))


def is_photograph(image: AxesImage) -> bool:
    """Whether one image artist shows a photograph or a rendering."""
    values = image.get_array()
    if values is None:
        return False
    if values.ndim == 2:  # numbers; what stands for "no value" in the scale may be no grey
        scale = image.get_cmap()(np.arange(image.get_cmap().N))[:, :3]
        if np.ptp(scale, axis=1).any():
            return False
    colours = np.ascontiguousarray(image.to_rgba(values, bytes=True)).view(np.uint32)
    return len(np.unique(colours)) > MANY_COLOURS


def smallest(picture: Image.Image, photograph: bool) -> tuple[str, bytes]:
    """The smallest file in which an RGB picture looks as it is: its MIME type and its bytes.

    Args:
        picture: in RGB.
        photograph: whether it holds one. Then JPEG is tried too, and a palette must come so near
            to all colours that no bands are seen: where a photograph is enlarged and its pixels
            are squares, that is the sharpest and smallest.
    """
    files = [("image/png", to_png(picture, lossless=photograph))]
    if photograph:
        files.append(("image/jpeg", to_jpeg(picture)))
        few = picture.quantize(256, kmeans=1, dither=Image.Dither.NONE)
        off = _off(picture, few)
        if off.mean() <= 2.6 and np.percentile(off, 99) <= 15 and off.max() <= 80:
            files.append(("image/png", _png_file(few)))
    return min(files, key=lambda file: len(file[1]))


def to_png(picture: Image.Image, lossless: bool) -> bytes:
    """A PNG file of an RGB picture, the same bytes whenever the picture is the same.

    Args:
        picture: in RGB.
        lossless: whether to keep every colour. If not, the file has a palette of 256 colours where
            that changes nothing but the edges of lines.
    """
    if not lossless and picture.getcolors(4096) is not None:
        few = picture.quantize(256, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
        off = _off(picture, few)
        if off.max() <= 128 and (off > 32).mean() <= 0.002:
            picture = few
    return _png_file(picture)


def _off(picture: Image.Image, few: Image.Image) -> np.ndarray:
    """By how much each pixel changes, in the channel that changes most, of 255."""
    off = np.asarray(picture).astype(np.int16) - np.asarray(few.convert("RGB"))
    return np.abs(off).max(-1)


def _png_file(picture: Image.Image) -> bytes:
    buffer = io.BytesIO()
    picture.save(buffer, format="PNG", optimize=True)
    return buffer.getvalue()


def to_jpeg(picture: Image.Image, quality: int = QUALITY) -> bytes:
    """A JPEG file of an RGB picture, the same bytes whenever the picture is the same.

    Colour is kept at every pixel (4:4:4): at half the resolution, as JPEG files often have it, a
    thin red or blue line and small letters would be blurred.
    """
    buffer = io.BytesIO()
    look = {"quality": quality, "subsampling": 0, "optimize": True, "progressive": True}
    picture.save(buffer, format="JPEG", **look)
    return buffer.getvalue()
