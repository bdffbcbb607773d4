"""The images, and the objects in them, that a method is measured on: test_targets_bop19.json."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from data_tools.bop.files import read_integer, read_json

__all__ = ["Targets", "read_targets"]

Targets = dict[tuple[int, int], dict[int, int] | None]
"""By scene and image, the wanted objects and how many of each; None for whatever is there."""


def read_targets(path: Path, images: Collection[tuple[int, int]], split: str) -> Targets:
    """The content of a targets file.

    Args:
        path: of the file: a list of scene_id, im_id, obj_id and inst_count, or of scene_id and
            im_id alone, as in test_targets_bop24.json.
        images: scenes and images that are there.
        split: in which, for messages.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: naming the file, and the target that is damaged or not there.
    """
    entries = read_json(path)
    if not isinstance(entries, list):
        raise ValueError(f"{path}: expected a list of targets, got a {type(entries).__name__}")
    images_only = not any(isinstance(entry, dict) and "obj_id" in entry for entry in entries)
    wanted: Targets = {}
    for number, entry in enumerate(entries):
        where = f"{path}: target {number}"
        scene_id, image_id = (read_integer(where, entry, key) for key in ("scene_id", "im_id"))
        if (scene_id, image_id) not in images:
            raise ValueError(f"{where}: scene {scene_id}, image {image_id} is not in {split}")
        if images_only:
            wanted[scene_id, image_id] = None
            continue
        object_id = read_integer(where, entry, "obj_id")
        count = read_integer(where, entry, "inst_count") if "inst_count" in entry else 1
        if count < 1:
            raise ValueError(f"{where}: inst_count: expected at least 1, got {count}")
        wanted.setdefault((scene_id, image_id), {})[object_id] = count
    return wanted
