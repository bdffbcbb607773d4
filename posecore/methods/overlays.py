"""What `estimate` writes beside its poses: images with the poses drawn in, and names of pictures.

BOP's results name an image by two numbers. Of a folder of pictures these are the scene 0 and a
number from the picture's name or its place (`data_tools.pictures`); which one it is says the file
`FILE_images.csv`, with the columns `scene_id,im_id,file`.
"""

from __future__ import annotations

import argparse
import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm.auto import tqdm

from data_tools.pictures import PictureFolder
from data_tools.views import Dataset, View
from posecore.arrays import fail
from posecore.files import write_bytes
from posecore.methods.outputs import check_outputs
from posecore.metrics.pose_table import PoseTable
from posecore.models import ObjectModel

__all__ = ["Beside", "beside", "draw_poses", "name_table"]

MOST = 100  # images that are drawn, spread over all
WIDTH = 9.0  # inches, of 100 dots


@dataclass(frozen=True)
class Beside:
    """What is to be written beside the poses.

    Attributes:
        folder: of drawn images; None for none.
        names: the file that says which picture is which; None for none.
    """

    folder: Path | None
    names: Path | None

    def write(
        self, dataset: Dataset, table: PoseTable, models: Sequence[ObjectModel]
    ) -> Iterator[str]:
        """Write it; yields lines that say so.

        Args:
            dataset: whose images were looked at.
            table: the poses in them.
            models: of the objects, for the boxes around them; those without get axes only.

        Raises:
            OSError: if it cannot be written.
        """
        if self.names is not None and isinstance(dataset, PictureFolder):
            write_bytes(self.names, name_table(dataset).encode())
            yield f"{self.names}: which picture has which scene_id and im_id"
        if self.folder is None:
            return
        self.folder.mkdir(exist_ok=True)
        sizes = {model.object_id: model for model in models}
        chosen = np.unique(np.linspace(0, len(dataset) - 1, MOST).round().astype(int)).tolist()
        for index in tqdm(chosen, desc="pictures", disable=None):
            view = dataset[index]
            write_bytes(self.folder / f"poses_{_name(dataset, index, view)}.png",
                        draw_poses(view, table, sizes))  # fmt: skip
        yield f"{self.folder}: {len(chosen)} of {len(dataset)} images with their poses"


def beside(options: argparse.Namespace) -> Beside:
    """What a command is to write besides `--output`.

    Raises:
        ValueError: naming the option that cannot be.
    """
    output, (kind, _, data) = Path(options.output), options.data.partition(":")
    folder = Path(options.pictures) if options.pictures else None
    names = None
    if kind == "pictures" and (output.is_file() or not output.exists()):  # no stream
        folder = folder or output.with_name(f"{output.stem}_pictures")
        names = output.with_name(f"{output.stem}_images.csv")
        check_outputs({"--output": str(names)}, [data])
    if folder is not None:
        if (folder.exists() and not folder.is_dir()) or not folder.resolve().parent.is_dir():
            fail("--pictures", "a folder, new or in one that exists", str(folder))
        if data and folder.resolve() == Path(data).resolve():
            fail("--pictures", "a folder that the command does not read", str(folder))
    return Beside(folder, names)


def name_table(dataset: PictureFolder) -> str:
    """Which picture is which, as CSV: `scene_id,im_id,file`."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("scene_id", "im_id", "file"))
    writer.writerows((0, *pair) for pair in zip(dataset.image_ids, dataset.files, strict=True))
    return text.getvalue()


def draw_poses(view: View, table: PoseTable, models: dict[int, ObjectModel]) -> bytes:
    """An image with the poses in it, as a PNG file: axes, object and score, and boxes.

    Poses with a score of 0 are guesses, and left out.

    Args:
        view: with an image.
        table: poses of all images; those of the view are drawn.
        models: by object id, for the boxes; if one is missing there are none.
    """
    from posecore import figures  # whoever draws nothing does without matplotlib

    image = next(i for i in (view.rgb, view.ir, view.depth) if i is not None)
    rows = (table.scene_id == view.scene_id) & (table.image_id == view.image_id)
    guesses = rows & (table.score <= 0)
    rows &= ~guesses
    ids = table.object_id[rows].tolist()
    title = "object: score" if ids else "no object was found"
    if guesses.any():
        title += f"; {guesses.sum()} more with a score of 0 are not drawn"
    if not ids:
        return figures.picture(image, title=title, width=WIDTH).png()
    labels = [f"{i}: {score:.2f}" for i, score in zip(ids, table.score[rows], strict=True)]
    box = {}
    if all(i in models for i in ids):
        box = {"size": [models[i].size for i in ids], "centre": [models[i].centre for i in ids]}
    poses = view.K, table.R[rows], table.t[rows]
    return figures.pose_picture(image, *poses, **box, labels=labels, title=title, width=WIDTH).png()


def _name(dataset: Dataset, index: int, view: View) -> str:
    """Of a drawn image: that of the picture, or the numbers of the view."""
    if not isinstance(dataset, PictureFolder):
        return f"{view.scene_id:06d}_{view.image_id:06d}"
    stems = [Path(file).stem for file in dataset.files]
    return stems[index] if stems.count(stems[index]) == 1 else dataset.files[index]
