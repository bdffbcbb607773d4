#!/usr/bin/env python
"""The one tool of the book.

A page is a pair: NN_name.py, the source, and NN_name.ipynb, what it shows when run. Edit either,
in an editor or in JupyterLab. Then, for every page NN that you touched:

  python book/make.py pair NN       bring notebook, solutions and exercises in step
  python book/make.py execute NN    run the page and store what it shows (minutes)
  python book/make.py check         say what is not fit to be committed, and how long pages are
  pytest book tests/book -k NN      run page, solutions and exercises, at a small scale

Solutions are written in solutions/solutions_NN_name.py; exercises are generated from them, never
edited.
`make.py new NN name` begins a chapter. What belongs to it beside source and solutions is a package:

  chNN_name/drawing/        its figures
  chNN_name/checks.py       checks of its exercises                    (tools/checks.py says how)
  chNN_name/experiments.py  what `claims` measures and `train` trains  (tools/measuring.py does)
  chNN_name/claims.json     what was measured; chNN_name/weights/ what was trained
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

# Not the folder of this script, whose `site` and `checks` others could mistake for their own.
sys.path[0] = str(Path(__file__).resolve().parents[1])

from posecore import command_line  # noqa: E402

if __name__ == "__main__":
    # Before anything else is imported, all of which Ctrl-C may interrupt.
    command_line.start("book.make")

from book.tools.contents import BOOK, Page, find_page, pages  # noqa: E402
from posecore.scale import SCALES  # noqa: E402


def read(chosen: Sequence[Page], arguments: argparse.Namespace) -> None:
    """Open a page in JupyterLab, the index if none is named; nothing is saved unasked."""
    import subprocess

    from book.tools.reading import command

    words = command(chosen[0] if arguments.pages else None)
    print("pages that you run are not saved, unless you do it; to stop: Control-C", flush=True)
    if status := subprocess.run(words, cwd=BOOK.parent).returncode:
        raise ValueError(f"JupyterLab ended with status {status}")


def new(chosen: Sequence[Page], arguments: argparse.Namespace) -> None:
    """Write the skeleton of a chapter and its method: all that the checks ask for, in small."""
    from book.tools.new import new as write

    number = arguments.number.zfill(2)
    files = write(number, arguments.name, arguments.method, BOOK.parent)
    for path in files:
        print(path.relative_to(BOOK.parent).as_posix())
    print(
        f"{len(files)} files. Now:\n"
        f"  python book/make.py claims {number}    measure its claim, over three seeds\n"
        f"  python book/make.py execute {number}   run the page and store what it shows\n"
        f"  python book/make.py check {number}     is it fit to be committed?\n"
        f"  python book/make.py pair {number}      after each edit of page or solutions\n"
        "and link the page in the table of book/index.py."
    )


def pair(chosen: Sequence[Page], arguments: argparse.Namespace) -> None:
    """Bring both sides of pages and solutions in step; generate the exercises."""
    from book.tools import exercises, pairs

    for page in chosen:
        pairs.pair(BOOK / f"{page.name}.py")
        if page.exercises:
            pairs.pair(BOOK / f"{page.part('solutions')}.py")
            exercises.generate(page, BOOK)
        print(f"{page.name}: in step")


def execute(chosen: Sequence[Page], arguments: argparse.Namespace) -> None:
    """Run pages from their sources and store what they show."""
    from book.tools import execution

    for page in chosen:
        start = time.monotonic()
        execution.execute(BOOK / f"{page.name}.py", arguments.scale)
        size = (BOOK / f"{page.name}.ipynb").stat().st_size / 1e6
        print(f"{page.name}: executed in {time.monotonic() - start:.0f} s, {size:.2f} MB")


def strip(chosen: Sequence[Page], arguments: argparse.Namespace) -> None:
    """Remove all outputs of pages."""
    from book.tools import notebooks, pairs

    for page in chosen:
        path = BOOK / f"{page.name}.ipynb"
        # Its source is touched: that must not make it the newer one of two that differ.
        pairs.refuse_lost_edits(path.with_suffix(".py"), path)
        notebooks.write_notebook(notebooks.strip(notebooks.read_notebook(path)), path)
        path.with_suffix(".py").touch()  # JupyterLab expects it to be no older
        print(f"{page.name}: no outputs")


def start(chosen: Sequence[Page], arguments: argparse.Namespace) -> None:
    """Copy exercises to book/my_work, to be worked on; a file that is there already stays."""
    from book.tools import exercises

    for page in chosen:
        try:
            if arguments.pages or page.exercises:
                print(f"{page.name}: open {exercises.start(page)}")
        except FileExistsError as error:
            if arguments.pages:
                raise
            print(error)  # and on to the next


def train(chosen: Sequence[Page], arguments: argparse.Namespace) -> None:
    """Train the networks that pages ship, into book/chNN_name/weights."""
    from book.tools import measuring

    for page in chosen:
        measuring.train(page.name, BOOK, scale=arguments.scale)


def claims(chosen: Sequence[Page], arguments: argparse.Namespace) -> None:
    """Measure what papers claim, into book/chNN_name/claims.json; goes on where it was stopped."""
    from book.tools import confirming, measuring

    if arguments.same_numbers and not arguments.confirm:
        raise ValueError("--same-numbers: expected --confirm to go with it, got none")
    for option in ("status", "confirm"):
        if getattr(arguments, option) and arguments.scale is not None:
            got = arguments.scale
            raise ValueError(f"--scale: expected none, as --{option} has its own, got {got!r}")
    for page in chosen:
        if arguments.status:
            print("\n".join(measuring.status(page, BOOK)))
        elif arguments.confirm:
            lines = confirming.confirm(page.name, BOOK, same_numbers=arguments.same_numbers)
            print("\n".join(lines), flush=True)
        else:
            measuring.claims(page.name, BOOK, scale=arguments.scale)
            if arguments.scale in (None, "book"):
                print("and `make.py claims --confirm` keeps what this code gives at tiny")


def site(chosen: Sequence[Page], arguments: argparse.Namespace) -> None:
    """Build the site of the whole book, into book/_build/html."""
    from book.tools import site

    print(f"open {site.build() / 'index.html'}")


def check(chosen: Sequence[Page], arguments: argparse.Namespace) -> None:
    """Say how long pages are, what makes the book unfit to be committed, and what is stale."""
    from book.tools import budget, checking

    # A long page is told of, and is no reason to fail.
    lengths = [line for line in (budget.budget(page, BOOK) for page in chosen) if line]
    print("\n".join(lengths), end="\n" if lengths else "")
    only = chosen if arguments.pages else None
    found, old = checking.problems(BOOK, only), checking.stale(BOOK, only)
    print("\n".join([*found, *old] or ["fit to be committed, and nothing is stale"]))
    if found or (old and arguments.strict):
        raise ValueError(
            ", ".join(
                f"{len(part)} {word}"
                for part, word in ((found, f"problem{'s' * (len(found) > 1)}"), (old, "stale"))
                if part
            )
        )


COMMANDS: tuple[Callable[[Sequence[Page], argparse.Namespace], None], ...] = (
    *(read, new, pair, execute, strip, start, train, claims, site, check),
)


def main(words: Sequence[str] | None = None) -> int:
    """Run one command; the exit status is 1 if it did not succeed, and 130 after Ctrl-C."""
    return run(parse(words))


def parse(words: Sequence[str] | None = None) -> argparse.Namespace:
    """The options of the command line; ends the process with 2 for what is no command."""
    return _parser().parse_args(words)


def run(arguments: argparse.Namespace) -> int:
    """Run one command; returns the exit status, as `main` does."""

    def command() -> None:
        command_line.refuse_empty(arguments, "pages", "number", "name")
        named = getattr(arguments, "pages", [])
        chosen = tuple(find_page(name, BOOK) for name in named) or pages(BOOK)
        try:
            arguments.command(chosen, arguments)
        except ModuleNotFoundError as error:
            raise ValueError(f"{error}; pip install -r environment.txt") from error

    name = f"make.py {arguments.command.__name__}"
    return command_line.carry_out(command, name=name, stopped=f"{name}: stopped")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="make.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for function in COMMANDS:
        # Python without docstrings (PYTHONOPTIMIZE=2) has a shorter help.
        words = (function.__doc__ or function.__name__).rstrip(".")
        command = commands.add_parser(function.__name__, help=words, description=words)
        command.set_defaults(command=function)
        if function is new:
            command.add_argument("number", metavar="NN", help="of the chapter")
            command.add_argument("name", help="small letters, digits and _")
            command.add_argument("--method", help="name in posecore/methods; default: the same")
        elif function is not site:
            command.add_argument(
                "pages", nargs="*", metavar="PAGE", help="number or name; without any, all pages"
            )
        if function is execute:
            command.add_argument("--scale", choices=SCALES, default="book", help="default: book")
        if function is check:
            command.add_argument(
                "--strict", action="store_true", help="fail for what is stale, too"
            )
        if function is claims:
            which = command.add_mutually_exclusive_group()
            words = "what is stale, and how long it takes to measure it again; nothing is run"
            which.add_argument("--status", action="store_true", help=words)
            words = "run what is stale at tiny: where all is as before it counts as measured today"
            which.add_argument("--confirm", action="store_true", help=words)
            words = "with --confirm: numbers of the own scale were only moved, as runs have shown"
            command.add_argument("--same-numbers", action="store_true", help=words)
        if function in (train, claims):
            words = "to try it: at tiny and paper the results go to book/_build/SCALE"
            command.add_argument("--scale", choices=SCALES, help=words)
    return parser
