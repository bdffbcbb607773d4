"""The table of contents, and where the parts of a page lie."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

from posecore.arrays import fail

__all__ = ["BOOK", "ROOT", "Page", "find_page", "notebooks", "pages"]

BOOK = Path(__file__).resolve().parents[1]
ROOT = BOOK.parent


@dataclass(frozen=True)
class Page:
    """A page of the book: `index` or a chapter, `NN_name`."""

    name: str
    exercises: bool = False


def pages(book: Path = BOOK) -> tuple[Page, ...]:
    """The pages in their order.

    Args:
        book: the folder of a book; tests give one of their own.
    """
    table = tomllib.loads((book / "site" / "contents.toml").read_text(encoding="utf-8"))
    return tuple(Page(**entry) for entry in table["page"])


def find_page(name: str, book: Path = BOOK) -> Page:
    """The page of this name or number: `01_poses_and_cameras`, `01` or `1`.

    Raises:
        ValueError: if there is none; the message lists all.
    """
    wanted = name.zfill(2) if name.isdigit() else name
    for page in pages(book):
        if wanted in (page.name, page.name.partition("_")[0]):
            return page
    fail("page", f"one of {', '.join(page.name for page in pages(book))}", repr(name))


def notebooks(book: Path = BOOK) -> tuple[Path, ...]:
    """The source (`.py`) of every notebook: pages, solutions and what students get."""
    found = []
    for page in pages(book):
        found.append(book / f"{page.name}.py")
        if page.exercises:
            found += [book / part / f"{page.name}.py" for part in ("solutions", "exercises")]
    return tuple(found)
