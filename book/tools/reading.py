"""JupyterLab for a reader: nothing is saved unasked, so that no update meets a change of his.

Lab saves an open notebook every two minutes by itself; a page that was merely run would then differ
from the committed one. `site/lab/overrides.json` has the setting, for this command alone: neither
the user's own settings nor other projects are touched, and what the user has set himself rules.
"""

from __future__ import annotations

import sys
from pathlib import Path

from book.tools.contents import BOOK, Page

__all__ = ["command"]

SETTINGS = BOOK / "site" / "lab"


def command(page: Page | None = None, book: Path = BOOK) -> list[str]:
    """The words that start JupyterLab at a page, the first one if none is named.

    Raises:
        ValueError: if the page has no notebook.
    """
    path = book / f"{'index' if page is None else page.name}.ipynb"
    if not path.is_file():
        raise ValueError(f"page: expected one with a notebook, got {path}, which is not there")
    settings = f"--LabApp.app_settings_dir={SETTINGS}"
    return [sys.executable, "-m", "jupyterlab", str(path), settings]
