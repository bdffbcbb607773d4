"""Whether the edges in the pictures lie where the outlines of the objects are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from data_tools.checking.drawing import draw
from data_tools.checking.report import Finding, Report
from data_tools.checking.sample import Instance, Sample
from data_tools.views import View

__all__ = ["EdgeFit", "check", "edge_fit"]

MOST_BORDER = 600  # pixels of outlines that are looked at in an image
WINDOW = (6, 24)  # pixels: outlines are moved so far, at least and at most
WINDOW_SHARE = 0.06  # of the image's width
LEAST_VIEWS = 5
LEAST_SHIFT = 2  # pixels
SURE = 4.0  # standard errors
CLEAR = 1.5  # of the spread of edges around: how much stronger they must be on the outlines


@dataclass(frozen=True)
class EdgeFit:
    """Where the outlines of objects find the strongest edges.

    Attributes:
        strength: of the edges on the outlines as they are, in spreads of those around.
        shift: (x, y) pixels by which they have to be moved to lie on the strongest.
        shifted: the strength there.
        sure: by how many standard errors that is more.
        neighbours: the strength of the same outlines in the next and the previous image of the
            scene, each with by how many standard errors it is more; None where there is none.
        views: in how many images.
    """

    strength: float
    shift: tuple[int, int]
    shifted: float
    sure: float
    neighbours: tuple[tuple[float, float] | None, tuple[float, float] | None]
    views: int

    @property
    def off(self) -> bool:
        """Whether the outlines lie clearly beside the edges."""
        far = max(map(abs, self.shift)) >= LEAST_SHIFT
        return far and self.sure > SURE and self.shifted > CLEAR

    @property
    def neighbour(self) -> int | None:
        """1 or -1 if the outlines are clearly those of the next or previous image."""
        for offset, found in zip((1, -1), self.neighbours, strict=True):
            if found is not None and found[1] > SURE and found[0] > CLEAR:
                return offset
        return None


def check(report: Report) -> None:
    """Whether the pictures show the objects where masks have them, or where models are drawn."""

    def outlined(instance: Instance) -> np.ndarray | None:
        if instance.visible is not None:
            return instance.visible
        place = report.corrections[instance.number].place(instance)
        return None if place is None else draw(instance.shape, place, instance.size)[0]

    fit = edge_fit(report.sample, report.sample.instances, outlined)
    if fit is None:
        report.notes.append("colours: too few images to look for edges on the outlines")
        return
    (x, y), what = fit.shift, "masks" if report.kind == "masks" else "drawn models"
    report.facts.append(
        f"colours: edges of pictures are strongest ({x:+d}, {y:+d}) pixels from the outlines of "
        f"the {what}: {fit.shifted:.1f} standard deviations above what is around, "
        f"{fit.strength:.1f} on the outlines"
    )
    if (offset := fit.neighbour) is not None:
        name = "next" if offset > 0 else "previous"
        there = fit.neighbours[0 if offset > 0 else 1][0]
        words = f"the pictures belong to other images: the outlines of the {what} are in the {name}"
        evidence = f"edges on the outlines {fit.strength:.1f} in the same image, {there:.1f} there"
        report.findings.append(Finding("pictures shifted by one image", words, (evidence,)))
    elif fit.off:
        words = f"the pictures are shifted by ({x:+d}, {y:+d}) pixels against the {what}"
        evidence = f"edges on the outlines {fit.strength:.1f} as given, {fit.shifted:.1f} there"
        report.findings.append(Finding("shifted pictures", words, (evidence,)))


def edge_fit(
    sample: Sample,
    instances: Sequence[Instance],
    outlined: Callable[[Instance], np.ndarray | None],
) -> EdgeFit | None:
    """Look for the edges of pictures on outlines, and around them.

    Of each image the strength of the edges under the outlines is taken for all shifts in a window,
    less its mean over the window, in units of its spread there, so that each image counts alike.

    Args:
        sample: that the instances are of.
        instances: whose outlines are taken.
        outlined: (H, W) bool, the mask of which it is the border.

    Returns:
        None for fewer than five images.
    """
    borders: dict[int, list[np.ndarray]] = {}
    for instance in instances:
        mask = outlined(instance)
        if mask is not None:
            borders.setdefault(instance.view, []).append(_border(mask))
    own, neighbours = [], ([], [])
    for index, parts in borders.items():
        view = sample.views[index]
        pixels = np.concatenate(parts)
        pixels = pixels[:: max(1, -(-len(pixels) // MOST_BORDER))]
        found = _standardised(view, pixels)
        if found is None or (own and found.shape != own[0].shape):
            continue
        own.append(found)
        for place, offset in enumerate((1, -1)):
            other = sample.neighbour_view(index, offset)
            there = None if other is None else _standardised(other, pixels)
            if there is not None:
                middle = tuple(n // 2 for n in there.shape)
                neighbours[place].append((there[middle], found[middle]))
    if len(own) < LEAST_VIEWS:
        return None
    maps = np.array(own)
    mean, half = maps.mean(0), maps.shape[1] // 2
    y, x = np.unravel_index(mean.argmax(), mean.shape)
    return EdgeFit(
        strength=float(mean[half, half]),
        shift=(int(x) - half, int(y) - half),
        shifted=float(mean[y, x]),
        sure=_sure(maps[:, y, x] - maps[:, half, half]),
        neighbours=tuple(_of_neighbour(pairs) for pairs in neighbours),
        views=len(own),
    )


def _of_neighbour(pairs: list[tuple[float, float]]) -> tuple[float, float] | None:
    if len(pairs) < LEAST_VIEWS:
        return None
    there, here = np.array(pairs).T
    return float(there.mean()), _sure(there - here)


def _sure(differences: np.ndarray) -> float:
    """The mean in standard errors."""
    error = differences.std(ddof=1) / np.sqrt(len(differences))
    return float(differences.mean() / max(error, 1e-9))


def _border(mask: np.ndarray) -> np.ndarray:
    """(N, 2) rows and columns of the pixels on both sides of a mask's border."""
    filled, cross = mask.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    border = cv2.dilate(filled, cross) != cv2.erode(filled, cross)
    border[[0, -1]] = border[:, [0, -1]] = False  # where the image ends there is no edge
    return np.argwhere(border)


def _standardised(view: View, pixels: np.ndarray) -> np.ndarray | None:
    """(2 W + 1, 2 W + 1) strength of edges under moved pixels; None without a picture."""
    image = view.rgb if view.rgb is not None else view.ir
    if image is None or not len(pixels):
        return None
    grey = image.astype(np.float32)
    if grey.ndim == 3:
        grey = cv2.cvtColor(grey, cv2.COLOR_RGB2GRAY)
    x, y = (cv2.Sobel(grey, cv2.CV_32F, *axis) for axis in ((1, 0), (0, 1)))
    edges = np.sqrt(np.hypot(x, y))  # the root, so that a few strong ones do not decide
    width = int(np.clip(round(WINDOW_SHARE * grey.shape[1]), *WINDOW))
    padded = np.pad(edges, width, constant_values=edges.mean())
    moves = np.arange(2 * width + 1)
    rows = pixels[:, 0, None] + moves
    columns = pixels[:, 1, None] + moves
    means = np.array([padded[rows[:, k, None], columns].mean(0) for k in moves])
    spread = means.std()
    return None if spread == 0 else (means - means.mean()) / spread
