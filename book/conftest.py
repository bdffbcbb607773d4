"""Every page of the book is a test: nbval runs it at `tiny`, in the same world for everybody.

Exercises and solutions are run by tests/book/tools/test_rehearsal.py, which reads their answers.
The options of nbval stand in pyproject.toml. A cell fails if it raises, so correctness lies in the
assertions on the page; what nbval passes over, `book.tools.checking` refuses.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from book.tools.execution import environment

collect_ignore = ["exercises", "solutions", "my_work", "_build"]

PROFILE = pytest.StashKey[Path]()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Every notebook is slow, and comes first: one process would run the last of them alone.

    A hook of this kind is given the tests of all folders.
    """
    for item in items:
        if item.path.suffix == ".ipynb":
            item.add_marker(pytest.mark.slow)
    items.sort(key=lambda item: item.path.suffix != ".ipynb")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Iterator[None]:
    """The first cell of a notebook starts its kernel."""
    with environment("tiny", _profile(item.config)):
        return (yield)


def _profile(config: pytest.Config) -> Path:
    """An empty folder that the kernels of this run share."""
    if PROFILE not in config.stash:
        folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        config.add_cleanup(folder.cleanup)
        config.stash[PROFILE] = Path(folder.name)
    return config.stash[PROFILE]
