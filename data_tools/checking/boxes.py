"""Whether boxes are those of the masks, and in the format that is expected."""

from __future__ import annotations

import numpy as np

from data_tools.checking.agreement import box_iou
from data_tools.checking.drawing import draw
from data_tools.checking.report import Finding, Report

__all__ = ["check"]

FITS = 0.7  # median IoU
CLEAR = 0.2  # better, for another format to be named


def check(report: Report) -> None:
    """Compare boxes with those around the masks of what is seen.

    Where more is off, boxes only tell what they go with: masks, or poses as given.
    """
    pairs = [
        (i.item.box, _around(i.visible), i)
        for i in report.sample.instances
        if i.item.box is not None and i.visible is not None and i.visible.any()
    ]
    if not pairs:
        return
    given, true = (np.array([pair[k] for pair in pairs], float) for k in range(2))
    as_given = float(np.median(_iou(given, true)))
    fact = f"boxes: overlap by {as_given:.2f} with those around the masks"
    if report.findings:
        drawn = np.median([box_iou(i, draw(i.shape, i.place, i.size)[0]) for *_, i in pairs])
        fact += f", by {drawn:.2f} with those around the models drawn as given"
    report.facts.append(fact)
    # A pixel all around is nothing, however small the object.
    smaller = np.median(((true[:, 2:] - 2).clip(1) / true[:, 2:]).prod(1))
    if as_given >= min(FITS, smaller) or report.findings:
        return
    corners = np.concatenate([given[:, :2], given[:, 2:] - given[:, :2]], 1)
    centres = np.concatenate([given[:, :2] - given[:, 2:] / 2, given[:, 2:]], 1)
    width, height = report.sample.instances[0].size
    shares = given * [width, height, width, height]
    formats = {
        "are left, top, right, bottom": corners,
        "have x and y of their centres": centres,
        "are in shares of the image's size": shares,
        "have rows before columns": given[:, [1, 0, 3, 2]],
    }
    tried = {words: float(np.median(_iou(boxes, true))) for words, boxes in formats.items()}
    best = max(tried, key=tried.__getitem__)
    words = "the boxes are not those of the masks"
    evidence = [f"they overlap by {as_given:.2f} (median IoU)"]
    if tried[best] >= max(FITS, as_given + CLEAR):
        words = f"the boxes {best}, where left, top, width, height are expected"
        evidence = [f"they overlap by {as_given:.2f} with those of the masks as given; read so "
                    f"{tried[best]:.2f}"]  # fmt: skip
    report.findings.append(Finding("boxes", words, tuple(evidence)))


def _around(mask: np.ndarray) -> list[int]:
    y, x = (np.flatnonzero(mask.any(axis)) for axis in (1, 0))
    return [x[0], y[0], x[-1] + 1 - x[0], y[-1] + 1 - y[0]]


def _iou(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(N,) of boxes (N, 4) x, y, width, height."""
    low = np.maximum(one[:, :2], other[:, :2])
    high = np.minimum(one[:, :2] + one[:, 2:], other[:, :2] + other[:, 2:])
    inner = (high - low).clip(0).prod(1)
    areas = one[:, 2:].clip(0).prod(1) + other[:, 2:].prod(1)
    return inner / np.maximum(areas - inner, 1e-9)
