"""The figures of chapter 2 on the world of categories."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from matplotlib.patches import Rectangle

from data_tools.views import View
from posecore.figures import Picture, draw_axes, picture_grid
from posecore.figures.photographs import thin_lines, without_grain
from posecore.figures.style import INK, new_picture

__all__ = ["coordinates", "coordinates_in_space", "mugs", "strip"]


def strip(rows: Mapping[str, Sequence[View]]) -> Picture:
    """Rows of instances, each row by its name; in the same order of categories."""
    views = [view for row in rows.values() for view in row]
    names = [view.objects[0].category for view in views[: len(views) // len(rows)]]
    titles = [f"{row}\n{name}" for row in rows for name in names]
    alt = f"Crops around a {', a '.join(names)}, in {len(rows)} rows of unlike instances: "
    alt += ", ".join(rows) + ". The shifted ones are in harsher light, and grainier."
    # Small copies: a page holds many pictures.
    images = [cv2.resize(view.rgb, None, fx=0.6, fy=0.6, interpolation=3) for view in views]
    images = [without_grain(image) for image in images]
    return picture_grid(images, titles, columns=len(names), width=6.2, alt=alt)


def coordinates(pairs: Sequence[tuple[View, np.ndarray]]) -> Picture:
    """Views and, below each, the map of normalised coordinates (H, W, 3) of its first object."""
    titles = [view.objects[0].category for view, _ in pairs]
    maps = []
    for view, nocs in pairs:
        maps.append(np.uint8(255 * np.where(view.objects[0].mask[..., None], nocs, 0.96)))
    images = [without_grain(view.rgb) for view, _ in pairs] + maps
    alt = (
        f"Above: {', '.join(titles)}, in colour. Below, each pixel of the object has the colour of "
        "its place on it: red grows along x, green upwards, blue to the front."
    )
    return picture_grid(images, titles + ["x red, y green, z blue"] * len(pairs),
                        columns=len(pairs), width=2.0 * len(pairs), alt=alt)  # fmt: skip


def coordinates_in_space(view: View, points: np.ndarray, colours: np.ndarray) -> Picture:
    """The seen pixels of an object in its own frame, and the box of its size.

    Args:
        view: its first object is drawn.
        points: (N, 3) metres, in the object's frame.
        colours: (N, 3) from 0 to 1.
    """
    item = view.objects[0]
    figure = new_picture(
        6.4,
        3.2,
        f"The pixels of a {item.category} as points of its own frame, each in the colour of its "
        "coordinates, inside the box of its size: from the front and from above. Only the side "
        "that the camera sees is there.",
    )
    steps = np.round(colours.clip(0, 1) * 6) / 6
    for axes, (down, name) in zip(figure.subplots(1, 2), ((1, "y"), (2, "z")), strict=True):
        axes.scatter(*100 * points[:, [0, down]].T, s=9, c=steps, lw=0, antialiased=False)
        width, height = 100 * item.size[[0, down]]
        axes.add_patch(Rectangle((-width / 2, -height / 2), width, height, fc="none", ec=INK))
        axes.set(xlabel="x, cm", ylabel=f"{name}, cm", aspect="equal")
        axes.set_title("from the front" if name == "y" else "from above", fontsize=10)
        if name == "z":
            axes.invert_yaxis()  # the front is where one stands who looks at x to the right
    return figure


def mugs(views: Sequence[View], shares: Sequence[float]) -> Picture:
    """Mugs with the share of their visible pixels that lies on the handle."""
    titles = [f"handle: {100 * share:.0f} % of the pixels" for share in shares]
    figure = picture_grid(
        [without_grain(view.rgb) for view in views],
        titles,
        width=2.0 * len(views),
        alt="Mugs, from one whose handle is in full view to some whose handle is hidden and which "
        "look like a beaker: " + "; ".join(titles),
    )
    for axes, view in zip(figure.axes, views, strict=True):
        item = view.objects[0]
        draw_axes(axes, view.K, item.R, item.t, 0.5 * item.size.max())
        thin_lines(axes, 2)
    return figure
