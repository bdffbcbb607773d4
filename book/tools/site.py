"""The site: the executed notebooks as pages for a browser, which load nothing from elsewhere.

Nothing is run. The notebooks are copied to a temporary folder and made ready for Sphinx there, so
that the notebooks themselves stay as a reader of JupyterLab wants them:

- the table of contents becomes the order of the pages;
- a link to a work that `site/references.bib` has gets a footnote with the full reference;
- stored pictures become files with their alt text, widgets without a picture are left out;
- exercises and solutions say at their top what they are;
- a header cell of a table that heads nothing is a plain one.

A build that is killed leaves its folder, `.site-*`, which the next one takes away.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import html
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import unquote

import nbformat
from nbformat import NotebookNode
from pybtex.database import parse_file

from book.tools.contents import BOOK, ROOT, Page, pages
from book.tools.execution import WIDGET_VIEW
from book.tools.notebooks import read_notebook
from data_tools.storage.locks import byte_lock
from posecore.arrays import fail

__all__ = ["build"]

CONFIGURATION = BOOK / "site"
PARTS = ("exercises", "solutions")
SUFFIXES = {"image/png": ".png", "image/jpeg": ".jpeg", "image/svg+xml": ".svg"}
# Code comes first: what looks like a link inside it is none.
LINK = re.compile(r"(`+).+?\1|\[[^\]]*\]\((?P<to>[^)\s]+)\)", re.S)
# A figure of `posecore.figures`, as notebooks keep it.
FIGURE = re.compile(
    r'<img alt="(?P<alt>[^"]*)" src="data:(?P<kind>image/(?:png|jpeg));base64,(?P<data>[^"]*)">'
)
EMPTY_HEADER = re.compile(r"<th\b([^>]*)>\s*(?:<p>\s*</p>)?\s*</th>")
UNFINISHED = ".site-"
ALIVE = "alive"  # a file that a build has locked until it ends
FORGOTTEN = 3600  # seconds after which a folder without that file is nobody's
# What MathJax loads on the site: itself, its fonts, and the commands that it has in extra files.
MATHJAX = ("tex-mml-chtml.js", "output/chtml/fonts/woff-v2/*", "input/tex/extensions/*")

CITED = """\
## References

```{footbibliography}
```"""
REFERENCES = """\
# References

```{bibliography}
:all:
:list: bullet
```
"""
WORDS = {
    "exercises": """\
```{{admonition}} To be filled in
:class: tip
`python book/make.py start {number}` copies this page to `book/my_work/`.
Open the copy in JupyterLab and fill it in: every exercise has a check that answers at once.
```""",
    "solutions": """\
```{{admonition}} Spoilers
:class: warning
This page gives the answers away. [Here are the exercises](../{exercises}.ipynb) without them.
```""",
}


def build(output: Path = BOOK / "_build" / "html", book: Path = BOOK) -> Path:
    """Build the site of a book; the first page is `index.html`.

    The old site stays until the new one is whole.

    Args:
        output: the folder of the site; replaced if a site is there.
        book: the folder of the book.

    Returns:
        `output`.

    Raises:
        ValueError: if `output` holds something else than a site, a notebook is missing or damaged,
            a picture has no alt text, a cited work is not in the bibliography, or Sphinx warns of
            anything (its message is shown).
    """
    output = Path(output).absolute()
    if output.exists() and any(output.iterdir()) and not (output / "searchindex.js").is_file():
        fail("output", "a new or empty folder, or an earlier site", output)
    output.parent.mkdir(parents=True, exist_ok=True)
    _forget_killed(output.parent)
    with _working_folder(output.parent) as folder:
        built = Path(folder, "html")
        stage = _Stage(Path(book).resolve(), Path(folder, "project"))
        stage.fill()
        _run_sphinx(stage.source, built)
        _copy_mathjax(built / "_static" / "mathjax")
        _drop_what_no_page_loads(built / "_static")
        for page in built.rglob("*.html"):
            page.write_bytes(EMPTY_HEADER.sub(r"<td\1></td>", page.read_text("utf-8")).encode())
        # The theme's download button offers what Sphinx read; readers want the notebook itself.
        for name in stage.names():
            shutil.copyfile(stage.book / name, built / "_sources" / name)
        _replace(built, output, Path(folder, "old"))
    return output


@contextlib.contextmanager
def _working_folder(parent: Path) -> Iterator[str]:
    """A folder of this build; whoever finds it can tell whether the build goes on."""
    with tempfile.TemporaryDirectory(prefix=UNFINISHED, dir=parent) as folder:
        alive = Path(folder, ALIVE)
        alive.touch()
        with byte_lock(alive):
            yield folder


def _forget_killed(parent: Path) -> None:
    """Take away the folders of builds that were killed."""
    for folder in parent.glob(f"{UNFINISHED}*"):
        with contextlib.suppress(OSError):  # another build was quicker
            age = time.time() - folder.stat().st_mtime
            with byte_lock(folder / ALIVE) as free:
                # One that has just begun may not have locked its file yet.
                dead = free and age > (60 if (folder / ALIVE).exists() else FORGOTTEN)
            if dead:
                shutil.rmtree(folder, ignore_errors=True)


def _run_sphinx(source: Path, built: Path) -> None:
    command = [
        *(sys.executable, "-m", "sphinx", "--builder", "html", "--nitpicky", "--fail-on-warning"),
        *("--quiet", "--no-color", "--conf-dir", CONFIGURATION),
        *("--doctree-dir", built.with_name("doctrees"), source, built),
    ]
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [str(word) for word in command],
        env={**os.environ, "PYTHONPATH": path.rstrip(os.pathsep), "PYTHONWARNINGS": "ignore"},
        capture_output=True,
        text=True,
        encoding="utf-8",
        errors="replace",
    )
    if done.returncode:
        message = (done.stderr or done.stdout).strip().replace(f"{source}{os.sep}", "")
        message = re.sub(r"\.ipynb:(\d+)\d{4}:", r".ipynb, cell \1:", message)
        raise ValueError(f"Sphinx did not build the site:\n{message}")


def _replace(built: Path, output: Path, old: Path) -> None:
    if output.exists():
        os.replace(output, old)
    try:
        os.replace(built, output)
    except OSError:
        if old.exists():
            os.replace(old, output)
        raise


class _Stage:
    """A copy of the book in which Sphinx finds what it reads; it lies as in the project."""

    def __init__(self, book: Path, project: Path) -> None:
        self.book, self.source = book, project / book.name
        self.pages, self.works = pages(book), _works()

    def names(self) -> list[str]:
        """All notebooks, relative to the book."""
        return [f"{p.name}.ipynb" for p in self.pages] + [
            f"{p.part(part)}.ipynb" for part in PARTS for p in self.pages if p.exercises
        ]

    def fill(self) -> None:
        self.source.mkdir(parents=True)
        shutil.copyfile(CONFIGURATION / "references.bib", self.source / "references.bib")
        (self.source / "references.md").write_text(REFERENCES, encoding="utf-8")
        (self.source / "pictures").mkdir()
        for name in self.names():
            notebook = read_notebook(self.book / name)
            try:
                notebook = self._ready(notebook, name)
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from error
            (self.source / name).parent.mkdir(exist_ok=True)
            nbformat.write(notebook, self.source / name)

    def _ready(self, notebook: NotebookNode, name: str) -> NotebookNode:
        cited: set[str] = set()
        for number, cell in enumerate(notebook.cells, 1):
            if cell.cell_type == "markdown":
                cell.source = LINK.sub(lambda m: self._link(m, name, cited), cell.source)
            elif cell.cell_type == "code":
                try:
                    cell.outputs = list(self._outputs(cell.outputs))
                except ValueError as error:
                    raise ValueError(f"cell {number}: {error}") from error
        for page, part in ((p, part) for p in self.pages for part in PARTS):
            if name == f"{page.part(part)}.ipynb":
                _introduce(notebook, part, page)
        kept = {k: v for k, v in notebook.metadata.items() if k in ("kernelspec", "language_info")}
        if not (words := _description(notebook)):
            raise ValueError("expected a paragraph of text, by which search engines describe it")
        about = {"html_meta": {"description": words}}
        notebook.metadata = nbformat.from_dict({**kept, "myst": about})
        for text in [*([CITED] if cited else []), *self._order(name)]:
            notebook.cells.append(nbformat.v4.new_markdown_cell(text))
        return notebook

    def _order(self, name: str) -> Iterator[str]:
        """Which pages follow this one: exercises their chapter, solutions the whole book."""
        exercises = {p.name: p for p in self.pages if p.exercises}
        if name == "index.ipynb":
            yield _toctree("Chapters", [p.name for p in self.pages if p.name != "index"])
            solutions = [p.part("solutions") for p in exercises.values()]
            yield _toctree("At the back", [*solutions, "references"])
        elif (page := name.removesuffix(".ipynb")) in exercises:
            yield _toctree("", [exercises[page].part("exercises")])

    def _link(self, match: re.Match[str], name: str, cited: set[str]) -> str:
        """A link as it stands on the site."""
        link = match["to"]
        if link is None:  # code
            return match[0]
        if key := self.works.get(_address(link)):
            cited.add(key)
            return f"{match[0]}{{footcite}}`{key}`"
        if re.match(r"https?://(dx\.)?(doi|arxiv)\.org/", link):
            raise ValueError(f"cites {link}, but site/references.bib has no such work")
        if not re.match(r"[a-z]+:|#", link, re.I) and not link.partition("#")[0].endswith(".ipynb"):
            self._bring((self.book / name).parent / unquote(link.partition("#")[0]))
        return match[0]

    def _bring(self, file: Path) -> None:
        """A file of the project that a page links to, or shows, comes along."""
        file = file.resolve()
        if file.is_file() and file.is_relative_to(self.book.parent):
            target = self.source.parent / file.relative_to(self.book.parent)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, target)

    def _outputs(self, outputs: list[NotebookNode]) -> Iterator[NotebookNode]:
        """What cells put out, pictures in files."""
        for output in outputs:
            data = output.get("data", {})
            if data.pop(WIDGET_VIEW, None) and not set(data) - {"text/plain"}:
                continue  # a slider or a progress bar, which nothing on the site would move
            if found := _stored_picture(output):
                kind, content, alt = found
                if not alt.strip():
                    raise ValueError("a picture without alt text")
                picture = self._picture(content, kind)
                output = nbformat.v4.new_output(
                    "display_data", {"text/markdown": f"![{_escape(alt)}]({picture})"}
                )
            yield output

    def _picture(self, text: str, kind: str) -> str:
        encoded = text.encode() if kind == "image/svg+xml" else base64.b64decode(text)
        name = f"pictures/{hashlib.sha256(encoded).hexdigest()[:16]}{SUFFIXES[kind]}"
        (self.source / name).write_bytes(encoded)
        return f"/{name}"


def _stored_picture(output: NotebookNode) -> tuple[str, str, str] | None:
    """What an output is a picture of: its MIME type, its content and its alt text."""
    data = output.get("data", {})
    if figure := FIGURE.fullmatch("".join(data.get("text/html", ""))):
        return figure["kind"], figure["data"], html.unescape(figure["alt"])
    kind = next((kind for kind in SUFFIXES if kind in data), None)
    if kind is None or "text/html" in data:
        return None
    alt = output.get("metadata", {}).get(kind, {}).get("alt", "")
    return kind, "".join(data[kind]), alt


def _copy_mathjax(target: Path) -> None:
    package = find_spec("sphinx-mathjax-offline")
    if package is None or package.origin is None:
        raise ValueError("the package sphinx-mathjax-offline is not installed (environment.txt)")
    home = Path(package.origin).parent / "static" / "mathjax"
    for pattern in MATHJAX:
        for file in home.glob(pattern):
            if file.name != "all-packages.js":  # all of them once more, which nothing loads
                (target / file.relative_to(home)).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(file, target / file.relative_to(home))


def _drop_what_no_page_loads(static: Path) -> None:
    """The theme's translations and templates, which Sphinx has read, and its developers' maps."""
    shutil.rmtree(static / "locales", ignore_errors=True)
    for pattern in ("*.map", "*macros.html"):
        for file in static.rglob(pattern):
            file.unlink()


def _works() -> dict[str, str]:
    """Address -> key of every work in the bibliography."""
    works = {}
    for key, entry in parse_file(str(CONFIGURATION / "references.bib")).entries.items():
        if "doi" in entry.fields:
            works[_address("https://doi.org/" + entry.fields["doi"])] = key
        if "url" in entry.fields:
            works[_address(entry.fields["url"])] = key
    return works


def _address(link: str) -> str:
    """An address as it is compared: letter case, a trailing slash and http say nothing."""
    return link.lower().rstrip("/").replace("http://", "https://")


def _toctree(caption: str, names: list[str]) -> str:
    options = [":hidden:", *([f":caption: {caption}"] if caption else [])]
    return "\n".join(["```{toctree}", *options, *names, "```"])


def _introduce(notebook: NotebookNode, part: str, page: Page) -> None:
    """Exercises and solutions are told apart by title, and say what they are."""
    number, first = page.name.partition("_")[0], notebook.cells[0]
    title = re.search(r"^# (.+)$", first.source, re.M)
    if first.cell_type != "markdown" or title is None:
        raise ValueError("expected a first cell with a title, as in '# Exercises'")
    name = re.sub(r"^(exercises|solutions):? *", "", title[1], flags=re.I) or number
    words = WORDS[part].format(exercises=page.part("exercises"), number=number)
    top = f"# {part.capitalize()}: {name}\n\n{words}"
    first.source = first.source.replace(title[0], top, 1)


def _description(notebook: NotebookNode) -> str:
    """The first paragraph of a page, as search engines show it."""
    for cell in notebook.cells:
        for paragraph in cell.source.split("\n\n") if cell.cell_type == "markdown" else ():
            if re.match(r"[\w*_\[]", paragraph):
                plain = re.sub(r"\{footcite\}`[^`]*`|\]\([^)]*\)|[\[\]*`$]", "", paragraph)
                return " ".join(plain.split())[:200]
    return ""


def _escape(text: str) -> str:
    """Text that Markdown takes as it is."""
    return re.sub(r"([!-/:-@\[-`{-~])", r"\\\1", " ".join(text.split()))
