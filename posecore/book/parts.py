"""The parts of the book that a page uses and does not show: its figures and its checks.

They are files of the checkout, `book/drawing/NAME.py` and `book/checks/NAME.py`, and are found from
where posecore lies, so that a page runs in any working directory: in `book/`, in
`book/my_work/`, in the site's build.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

from posecore.arrays import fail, require_choice

__all__ = ["checks", "drawing"]

ROOT = Path(__file__).resolve().parents[2]


def drawing(name: str) -> ModuleType:
    """The module `book/drawing/NAME.py` with a chapter's own figures.

    It is imported once, as `book.drawing.NAME`; `importlib.reload` reads it again after an edit.

    Args:
        name: of a file there, without its ending: "01_poses_and_cameras".

    Raises:
        ValueError: if there is no such file. What the file itself raises comes through as it is.
    """
    return _part("drawing", name)


def checks(name: str) -> ModuleType:
    """The module `book/checks/NAME.py` with the checks of a chapter's exercises.

    It is imported once, as `book.checks.NAME`, so that its checks remember which hints they gave.

    Args:
        name: of a file there, without its ending: "01_poses_and_cameras".

    Raises:
        ValueError: if there is no such file. What the file itself raises comes through as it is.
    """
    return _part("checks", name)


def _part(kind: str, name: str) -> ModuleType:
    folder = ROOT / "book" / kind
    if not folder.is_dir():
        fail("posecore", "to lie beside the book, in its checkout", f"no folder {folder}")
    require_choice("name", name, sorted(path.stem for path in folder.glob("*.py")))
    if str(ROOT) not in sys.path:
        # At the end, where it hides nothing. Worker processes inherit it and find the module too.
        sys.path.append(str(ROOT))
    module = importlib.import_module(f"book.{kind}.{name}")
    if not Path(module.__file__ or "").resolve().is_relative_to(folder):
        fail("name", f"a module of {folder}", f"{module.__file__}, another package called book")
    return module
