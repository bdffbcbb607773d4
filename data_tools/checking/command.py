"""`python -m data_tools check PATH`: an own dataset, looked at split by split."""

from __future__ import annotations

import sys
from pathlib import Path

from data_tools import units, views
from data_tools.bop.layout import find_scenes
from data_tools.checking.diagnosis import check_dataset
from data_tools.checking.pictures import write_pictures

__all__ = ["check_source", "source_of"]


def source_of(name: str) -> str:
    """The dataset that a name on the command line means: a folder alone is one in BOP's layout."""
    return name if ":" in name or not Path(name).is_dir() else f"bop:{name}"


def check_source(source: str, split: str | None, count: int, pictures: str | None) -> bool:
    """Look at a dataset, and print what is found.

    Args:
        source: as `data_tools.open` takes it.
        split: which part of it; None for all of a BOP dataset, of others the only one.
        count: how many views of each part are looked at.
        pictures: a folder for pictures of what was compared; None for none.

    Returns:
        Whether something is off.

    Raises:
        ValueError: if a part cannot be read, or there is nothing in it to compare; of several
            parts, if that is so of all.
        OSError: if the pictures cannot be written.
    """
    parts = [split] if split is not None else _splits(source)
    refused: list[str] = []
    off = False
    for part in parts:
        try:
            off |= _check_part(source, part, count, pictures, len(parts) > 1)
        except ValueError as error:
            if len(parts) == 1:
                raise
            refused.append(" ".join(str(error).split()))
            print(f"{_name(source, part)}: {refused[-1]}", file=sys.stderr)
    if len(refused) == len(parts):
        raise ValueError(f"{source}: none of the {len(parts)} splits can be checked")
    return off or bool(refused)


def _check_part(
    source: str, split: str | None, count: int, pictures: str | None, several: bool
) -> bool:
    dataset = views.open(source, split=split)
    report = check_dataset(dataset, count)
    print(_name(source, split))
    for line in report.lines():
        print(f"  {line}")
    if report.fine:
        for text in units.of_dataset(dataset):
            print(f"  note: {text}")
    if pictures is not None:
        folder = Path(pictures) / str(split) if several else Path(pictures)
        for path in write_pictures(report, folder):
            print(f"  {path}")
    elif not report.fine:
        print("  --pictures FOLDER draws masks and models over the images")
    return not report.fine


def _name(source: str, split: str | None) -> str:
    return source if split is None else f"{source}, {split}"


def _splits(source: str) -> list[str | None]:
    """The splits of a BOP dataset; None, whatever its reader takes, for the others."""
    kind, _, path = source.partition(":")
    if kind != "bop" or not Path(path).is_dir():
        return [None]
    found = sorted(p.name for p in Path(path).iterdir() if p.is_dir() and find_scenes(p))
    return found or [None]
