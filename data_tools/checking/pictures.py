"""Pictures of what was compared: masks and models drawn as outlines over the images."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from data_tools.checking.corrections import AS_GIVEN
from data_tools.checking.drawing import Placement, draw
from data_tools.checking.report import Report
from data_tools.checking.sample import Instance
from data_tools.views import View
from posecore.files import write_bytes

__all__ = ["write_pictures"]

WIDTH = 9.0  # inches, of 100 dots


def write_pictures(report: Report, folder: str | Path, count: int = 6) -> list[Path]:
    """Write some of the views as PNG files, those that fit worst first.

    Solid: the given masks. Dashed: the models as given. Dash-dotted: the models once corrected.

    Args:
        report: of a dataset.
        folder: where to; it is made. Files there that are called alike are written over.
        count: how many views, at most.

    Returns:
        The files, `check_SCENE_IMAGE.png`.

    Raises:
        OSError: if they cannot be written.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    by_view: dict[int, list[Instance]] = {}
    for instance in report.sample.instances:
        by_view.setdefault(instance.view, []).append(instance)
    fit = {v: np.mean([report.scores[i.number] for i in items]) for v, items in by_view.items()}
    files = []
    for index in sorted(sorted(by_view, key=lambda v: (fit[v], v))[:count]):
        view = report.sample.views[index]
        path = folder / f"check_{view.scene_id:06d}_{view.image_id:06d}.png"
        write_bytes(path, _picture(report, view, by_view[index]))
        files.append(path)
    return files


def _picture(report: Report, view: View, instances: list[Instance]) -> bytes:
    from posecore import figures  # whoever wants no pictures does without matplotlib
    from posecore.figures.style import COLOURS

    image = next((i for i in (view.rgb, view.ir, view.depth) if i is not None), None)
    if image is None:
        image = np.zeros(view.shape, np.uint8)
    title = f"scene {view.scene_id}, image {view.image_id}"
    sheet = figures.picture(image, title=title, width=WIDTH)
    axes, named = sheet.axes[0], set()

    def outline(mask: np.ndarray, name: str, number: int, style: str) -> None:
        label = None if name in named else name
        named.add(name)
        figures.draw_outline(axes, mask, label=label, colour=COLOURS[number], style=style)

    for instance in instances:
        correction = report.corrections[instance.number]
        if instance.mask is not None:
            outline(instance.mask, "given mask", 0, "-")
        outline(_silhouette(instance, instance.place), "model, as given", 1, "--")
        if correction is not AS_GIVEN and correction.targets is None:
            silhouette = _silhouette(instance, correction.place(instance))
            outline(silhouette, "model, corrected", 2, "-.")
    axes.legend(loc="upper right", fontsize=9)
    return sheet.png()


def _silhouette(instance: Instance, place: Placement | None) -> np.ndarray:
    width, height = instance.size
    if place is None:
        return np.zeros((height, width), bool)
    return draw(instance.shape, place, instance.size)[0]
