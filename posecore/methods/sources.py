"""The data that a command is given: a world, or the folder of a dataset."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import data_tools
from data_tools import units
from data_tools.readers import READERS
from data_tools.views import Dataset
from posecore.arrays import fail
from posecore.methods.notes import note

__all__ = ["new_parser", "open_source"]

SOURCE = "headset, tabletop, categories, bop:PATH, linemod:PATH or hmdpose:PATH"
"""What `--data` may be, for its help."""


def new_parser(
    methods: argparse._SubParsersAction[argparse.ArgumentParser],
    name: str,
    command: Callable[[argparse.Namespace], None],
    *,
    summary: str,
    description: str,
    source: str = SOURCE,
) -> argparse.ArgumentParser:
    """Add a method to a command, with the options of all commands that read a dataset.

    Args:
        methods: the parser's methods.
        name: of the method.
        command: what runs it.
        summary: a few words.
        description: a few sentences.
        source: what `--data` may be.

    Returns:
        Its parser, which knows `--data` and `--device`.
    """
    parser = methods.add_parser(name, help=summary, description=description)
    parser.set_defaults(command=command)
    parser.add_argument("--data", metavar="SOURCE", required=True, help=source)
    parser.add_argument("--device", default="auto", help="default: a GPU where there is one")
    return parser


def open_source(
    source: str,
    split: str | None,
    scale_name: str | None,
    show: bool = True,
    **options: Any,
) -> Dataset:
    """Open a dataset as `data_tools.open` does; of worlds at a scale, with a bar if `show`.

    Units that cannot be right are said in a note, if `show`.

    Args:
        source: as for `data_tools.open`.
        split: which part, or None for the only one.
        scale_name: of worlds; None for the one in force.
        show: a bar in a terminal while a world is made, and notes.
        options: what the reader takes besides, such as `targets` of a BOP dataset.

    Raises:
        ValueError: if there is no such source, or its reader refuses it.
    """
    if source not in READERS and Path(source).is_dir():
        expected = f"bop:{source} for a dataset, or pictures:{source} for a folder of pictures"
        fail("--data", expected, source)
    if ":" not in source:  # a world, which has scales, and is made on first use
        options |= {"scale": scale_name, "progress": show and sys.stderr.isatty()}
    try:
        dataset = data_tools.open(source, split=split, **options)
    except ValueError as error:
        argument, colon, words = str(error).partition(": ")
        if not colon or argument not in ("path", "source", "split", "camera"):
            raise
        name = f"--{argument}" if argument in ("split", "camera") else "--data"
        raise ValueError(f"{name}: {words}") from error
    if ":" in source and show and isinstance(dataset, Dataset):
        for text in units.of_dataset(dataset):
            note(f"{source}: {text}")
    return dataset
