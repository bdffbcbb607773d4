"""The first and last figures of chapter 2: what the worlds are for, a BOP dataset, films."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from torch import Tensor

import data_tools
from data_tools.views import View
from data_tools.worlds.categories import nocs_map
from posecore.figures import Picture, draw_axes, draw_box, picture, picture_grid
from posecore.figures.photographs import show_crop, without_grain
from posecore.figures.style import BOX_COLOURS, COLOURS, STYLES, house_style, new_picture

__all__ = ["augmented", "bop_picture", "films", "question"]


@house_style
def question() -> Picture:
    """One picture of each world, as a method gets it and with what is known of it."""
    headset = data_tools.open("headset", split="test", whole=False)[13]
    tabletop = data_tools.open("tabletop", split="occluded", whole=False)[4]
    categories = data_tools.open("categories", split="synthetic", whole=False)
    crops = [categories[i] for i in (6, 1, 2, 11)]

    height, width = tabletop.shape
    grey = np.repeat(headset.ir[..., None], 3, 2)
    across = round(headset.shape[0] * width / height)
    first = (headset.shape[1] - across) // 2
    given = [
        without_grain(cv2.resize(grey[:, first : first + across], (width, height))),
        without_grain(tabletop.rgb),
        without_grain(cv2.resize(_square([crop.rgb for crop in crops]), (width, height))),
    ]
    maps = _square([nocs_map(crop) for crop in crops])
    known = np.where(maps.any(-1, keepdims=True), 8 * (maps * 31.9 // 1), 225).astype(np.uint8)
    figure = picture_grid(
        [
            *given,
            given[0],
            _pale(tabletop.rgb),
            cv2.resize(known, (width, height), interpolation=cv2.INTER_NEAREST),
        ],
        ["headset: infrared", "tabletop: colour and depth", "categories: kinds, not things"]
        + ["pose of the glasses", "pose of each object", "place of each pixel on its object"],
        columns=3,
        width=8.0,
        alt="Above, three pictures: a driver with AR glasses in infrared light, a heap of things "
        "on a table, four crops of a bottle, a bowl and the like. Below, the same with axes on "
        "the glasses and on each thing, and colours for where on it each pixel lies.",
    )
    axes = figure.axes
    zoom = height / headset.shape[0]
    to_shown = np.diag([zoom, zoom, 1]) @ [[1, 0, 0.5 - first], [0, 1, 0.5], [0, 0, 1]]
    K = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]]) @ to_shown @ headset.K
    glasses = headset.objects[0]
    draw_axes(axes[3], K, glasses.R, glasses.t, 0.09)
    for item in tabletop.objects:
        if item.visible_fraction > 0.3:
            draw_axes(axes[4], tabletop.K, item.R, item.t, 0.045)
    return figure


def augmented(batches: Sequence[Mapping[str, Tensor]]) -> Picture:
    """Crops of an object with the axes of its pose; that of the first batch is as it was."""
    rows = [
        {key: batch[key][i].numpy().astype(np.float64) for key in ("rgb", "K", "R", "t", "size")}
        for batch in batches
        for i in range(len(batch["K"]))
    ]
    crops = [np.round(255 * row["rgb"].transpose(1, 2, 0)).astype(np.uint8) for row in rows]
    titles = ["as it was", *(["varied"] * (len(rows) - 1))]
    figure = picture_grid(
        [without_grain(crop) for crop in crops],
        titles,
        columns=4,
        width=7.6,
        alt="A teapot as it was, and three times turned, moved, recoloured and hidden in part; the "
        "axes drawn on it turn with it.",
    )
    for axes, row in zip(figure.axes, rows, strict=True):
        draw_axes(axes, row["K"], row["R"], row["t"], 0.32 * row["size"].max())
    return figure


def bop_picture(view: View) -> Picture:
    """A view as it was read back, with the boxes of its objects."""
    figure = picture(
        _pale(view.rgb), width=4.8, alt="Things on a table, with a box around each that fits."
    )
    for item in view.objects:
        if item.visible_fraction > 0.3:
            colour = BOX_COLOURS[item.object_id % len(BOX_COLOURS)]
            draw_box(figure.axes[0], view.K, item.R, item.t, item.size, colour=colour)
    return figure


@house_style
def films(
    pictures: np.ndarray, who: np.ndarray, errors: Mapping[str, np.ndarray], every: int
) -> Picture:
    """A strip of each driver's film, and how wrong the memory of pictures is by each split.

    Args:
        pictures: (N, H, W) of all films, one after the other.
        who: (N,) whose film.
        errors: degrees, of all test pictures, by the name of the split.
        every: how many pictures apart those of the strip are.
    """
    figure = new_picture(
        8.0,
        3.4,
        "Left, strips of films in which a head looks about, a row for each driver. Right, the "
        "share of test pictures below each error: shuffled frames are far better.",
    )
    strips, curve = figure.subplots(1, 2, width_ratios=(1.15, 1))
    rows = [np.hstack(pictures[who == driver][::every][:5, :, 10:70]) for driver in np.unique(who)]
    show_crop(strips, np.minimum(1, np.vstack(rows) / 150))
    strips.set_title(f"films, every {every}th picture")
    for (name, values), colour, style in zip(errors.items(), COLOURS, STYLES, strict=False):
        share = np.arange(1, len(values) + 1) / len(values)
        curve.plot(np.sort(values), 100 * share, style, color=colour, label=name)
    curve.set(xlabel="error of the head's rotation, degrees", ylabel="test pictures below, %")
    curve.set(xlim=(0, None), ylim=(0, 101))
    curve.legend(loc="lower right")
    return figure


def _square(images: list[np.ndarray]) -> np.ndarray:
    return np.vstack([np.hstack(images[:2]), np.hstack(images[2:])])


def _pale(rgb: np.ndarray) -> np.ndarray:
    """The picture without its noise and pale, so that lines stand out."""
    return np.round(110 + 0.56 * without_grain(rgb)).astype(np.uint8)
