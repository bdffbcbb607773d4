"""The command line: `python -m posecore evaluate | train | estimate`."""

from __future__ import annotations

import argparse
import importlib
import sys
import warnings
from collections.abc import Sequence

from data_tools.storage import MakingError
from posecore.command_line import INTERRUPTED, Interrupts, refuse_empty
from posecore.methods import METHODS
from posecore.methods.evaluating import add_evaluate
from posecore.methods.notes import OUTPUT, lacks_memory, leave_output, note, warn

__all__ = ["main", "parse", "run"]

PIPE_CLOSED = 141  # 128 and the number of the signal, as a shell has it


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
    with Interrupts() as interrupts, warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, *_: note(
            str(message).replace("rotations='as_read'", "--rotations as_read")
        )
        try:
            refuse_empty(options, "estimates", "ground_truth")
            options.command(options)
        except KeyboardInterrupt:
            return _interrupted()
        except (ValueError, OSError, MakingError, MemoryError) as error:
            if interrupts.came:
                return _interrupted()
            if getattr(error, "filename", None) == OUTPUT:
                leave_output()
                if isinstance(error, BrokenPipeError):
                    return PIPE_CLOSED
            what = str(error) or "not enough memory"
            warn(f"error: {' '.join(what.splitlines())}")
            return 2
        except Exception as error:
            if interrupts.came:
                return _interrupted()
            if not lacks_memory(error):
                raise
            warn(f"error: not enough memory: {' '.join(str(error).split()):.200}")
            return 2
    return 0


def _interrupted() -> int:
    leave_output()
    warn("\ninterrupted" if sys.stderr is not None and sys.stderr.isatty() else "interrupted")
    return INTERRUPTED


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
