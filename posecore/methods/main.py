"""The command line: `python -m posecore evaluate | train | estimate | clouds`."""

from __future__ import annotations

import argparse
import importlib
import sys
import warnings
from collections.abc import Sequence

from data_tools.storage import MakingError
from posecore.command_line import carry_out, refuse_empty
from posecore.methods import METHODS
from posecore.methods.evaluating import add_evaluate
from posecore.methods.notes import note

__all__ = ["main", "parse", "run"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Returns:
        The exit status: 0; 2 for input that cannot be used; 130 after Ctrl-C; 141 if nobody reads
        the output to its end, as with `| head`.
    """
    return run(parse(arguments))


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The options of the command line; ends the process with 2 for what is no command."""
    arguments = sys.argv[1:] if arguments is None else arguments
    return _parser(arguments).parse_args(arguments)


def run(options: argparse.Namespace) -> int:
    """Run a command of the command line; returns the exit status, as `main` does."""

    def command() -> None:
        refuse_empty(options, "estimates", "ground_truth")
        options.command(options)

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, *_: note(
            str(message).replace("rotations='as_read'", "--rotations as_read")
        )
        return carry_out(command, refusals=(ValueError, OSError, MakingError), failed=2)


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
        ("clouds", "write point clouds that were estimated from images"),
    ):
        command = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
        methods = command.add_subparsers(required=True, metavar="METHOD")
        if name in arguments:  # imported by name here, so that `evaluate` waits for no method
            for method in METHODS:
                module = importlib.import_module(f"posecore.methods.{method}.command")
                if add := getattr(module, f"add_{name}", None):  # a method need not do all of it
                    add(methods)
    return parser
