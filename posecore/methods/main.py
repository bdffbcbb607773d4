"""The command line: `python -m posecore evaluate | train | estimate`."""

from __future__ import annotations

import argparse
import importlib
import sys
import warnings
from collections.abc import Sequence

from data_tools.storage import MakingError
from posecore.methods import METHODS
from posecore.methods.evaluating import add_evaluate
from posecore.methods.notes import note

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status: 0, or 2 for input that cannot be used."""
    arguments = sys.argv[1:] if arguments is None else arguments
    options = _parser(arguments).parse_args(arguments)
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, *_: note(
            str(message).replace("rotations='as_read'", "--rotations as_read")
        )
        try:
            options.command(options)
        except (ValueError, OSError, MakingError) as error:
            print(f"error: {error}", file=sys.stderr)
            return 2
    return 0


def _parser(arguments: Sequence[str]) -> argparse.ArgumentParser:
    """The parser of these arguments: only a command that is among them knows its methods."""
    parser = argparse.ArgumentParser(
        prog="python -m posecore", description="6-DoF object pose estimation."
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    add_evaluate(commands)
    for name, text in (
        ("train", "train a method"),
        ("estimate", "estimate poses with what was trained"),
    ):
        command = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
        methods = command.add_subparsers(required=True, metavar="METHOD")
        if name in arguments:  # imported by name here, so that `evaluate` waits for no method
            for method in METHODS:
                module = importlib.import_module(f"posecore.methods.{method}.command")
                getattr(module, f"add_{name}")(methods)
    return parser
