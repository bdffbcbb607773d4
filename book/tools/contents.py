"""The table of contents, and where the parts of a page lie."""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path

from posecore.arrays import fail

__all__ = ["BOOK", "PARTS", "ROOT", "Page", "find_page", "notebooks", "notebooks_of", "pages"]

BOOK = Path(__file__).resolve().parents[1]
ROOT = BOOK.parent
PARTS = ("solutions", "exercises")
"""The folders of what belongs to the exercises of a page."""
NAME = re.compile(r"index|\d\d_[a-z0-9_]+")


@dataclass(frozen=True)
class Page:
    """A page of the book: `index` or a chapter, `NN_name`."""

    name: str
    exercises: bool = False

    @property
    def package(self) -> str:
        """The folder, and the package, of what belongs to it: `chNN_name`."""
        return "ch00_index" if self.name == "index" else f"ch{self.name}"

    def part(self, folder: str) -> str:
        """The file of one of `PARTS`, without its ending: `exercises/exercises_NN_name`.

        JupyterLab's tabs show the beginning of a file's name and no folder, so the names of one
        chapter's files begin differently.
        """
        return f"{folder}/{folder}_{self.name}"


def pages(book: Path = BOOK) -> tuple[Page, ...]:
    """The pages in their order.

    Args:
        book: the folder of a book; tests give one of their own.

    Raises:
        ValueError: if `site/contents.toml` is no such table.
    """
    path = book / "site" / "contents.toml"
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        found = tuple(Page(**entry) for entry in table["page"])
        names = [page.name for page in found]
        if wrong := [name for name in names if not NAME.fullmatch(name) or names.count(name) > 1]:
            fail("name", "index or NN_name in small letters, each once", repr(wrong[0]))
    except (KeyError, OSError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: no table of contents: {error!r}") from error
    return found


def find_page(name: str, book: Path = BOOK) -> Page:
    """The page of this name or number: `01_poses_and_cameras`, `01` or `1`.

    Raises:
        ValueError: if there is none; the message lists all.
    """
    wanted = name.zfill(2) if name.isdigit() else name
    for page in pages(book):
        if wanted in (page.name, page.name.partition("_")[0]):
            return page
    names = ", ".join(page.name for page in pages(book))
    fail("page", f"one of {names} (site/contents.toml)", repr(name))


def notebooks(book: Path = BOOK) -> tuple[Path, ...]:
    """Every notebook: pages, solutions and what students get."""
    return tuple(path for page in pages(book) for path in notebooks_of(page, book))


def notebooks_of(page: Page, book: Path = BOOK) -> tuple[Path, ...]:
    """The notebooks of one page: its own, and those of its solutions and exercises.

    All have a source (`.py`) beside them but the exercises, which are generated.
    """
    names = [page.name, *(page.part(folder) for folder in PARTS if page.exercises)]
    return tuple(book / f"{name}.ipynb" for name in names)
