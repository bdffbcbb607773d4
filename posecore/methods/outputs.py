"""Files that a command is to write: refused before all the work if they cannot be."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from posecore.arrays import fail
from posecore.command_line import warn
from posecore.files import own_stream
from posecore.methods.notes import say

__all__ = ["check_outputs", "say_beside"]

# What datasets, models and runs hold.
READ = re.compile(
    r"scene_\w+\.json|models_info\.(json|yml)|camera\w*\.(json|txt)|test_targets\w*\.json|run\.json"
    r"|gt\.yml|info\.yml|dataset_info\.\w+|.*\.(ply|obj|stl|npy|safetensors)"
    r"|[0-9]+(_\w+)?\.(png|jpe?g|tiff?|bmp)",
    re.IGNORECASE,
)


def check_outputs(outputs: Mapping[str, str | None], inputs: Sequence[str | None]) -> None:
    """Refuse outputs without a folder, over each other, or over what the command reads.

    Args:
        outputs: option -> file to be written, None if it was not asked for.
        inputs: files and folders that are read, None for those that are not; of a folder, what has
            one of the names that datasets, models and runs have.

    Raises:
        ValueError: naming the option.
    """
    wanted = {option: Path(file) for option, file in outputs.items() if file}
    sources = [Path(source) for source in inputs if source]
    for number, (option, path) in enumerate(wanted.items()):
        if not path.resolve().parent.is_dir():
            fail(option, "a file in a folder that exists", path)
        if path.is_dir():
            fail(option, "a file", f"the folder {path}")
        for other, before in list(wanted.items())[:number]:
            if _same(path, before) and not _is_stream(path):
                fail(option, f"another file than {other}", path)
        for source in sources:
            if _same(path, source) or _holds(source, path):
                fail(option, "a file that the command does not read", path)


def say_beside(text: str, outputs: Sequence[str | None]) -> None:
    """Print results; on the error stream if one of the outputs went to where they would be.

    Raises:
        OSError: if they cannot be printed.
    """
    if any(file and own_stream(Path(file)) == 1 for file in outputs):
        warn(text)
    else:
        say(text)


def _same(one: Path, other: Path) -> bool:
    with contextlib.suppress(OSError):
        return os.path.samefile(one, other)
    return one.resolve() == other.resolve()


def _is_stream(path: Path) -> bool:
    return path.exists() and not path.is_file()


def _holds(folder: Path, path: Path) -> bool:
    """Whether a file is there and belongs to what is read in a folder."""
    if not folder.is_dir() or not path.is_file():
        return False
    return folder.resolve() in path.resolve().parents and READ.fullmatch(path.name) is not None
