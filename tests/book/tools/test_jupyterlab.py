"""Pairs opened and saved in JupyterLab, through jupytext's contents manager and a real server."""

import json
import os
import subprocess
import sys
import time
import urllib.request

import nbformat
import pytest
from jupytext import TextFileContentsManager
from nbformat.v4 import new_code_cell, new_output
from tornado.web import HTTPError

from book.tools import reading
from book.tools.contents import BOOK, Page
from book.tools.exercises import generate
from book.tools.notebooks import (
    HEADER,
    cells_differ,
    code_digest,
    notebook_bytes,
    outputs_digest,
    read_notebook,
    read_source,
    write_notebook,
)
from book.tools.pairs import pair

pytestmark = pytest.mark.slow  # a server

SOURCE = (
    HEADER
    + """
# %% [markdown]
# # A page
#
# Its text. Where a function follows, formatters set two blank lines and jupytext one.


# %% tags=["solution"]
def area(r):
    \"\"\"Of a circle.\"\"\"
    return 3.14 * r**2


# %%
area(1)
"""
)


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A project with an executed pair in its book, and a user with settings of jupytext."""
    settings = tmp_path / "settings"
    settings.mkdir()
    (settings / "jupytext.toml").write_text(
        'formats = "ipynb,md"\nnotebook_metadata_filter = "all"\ncell_metadata_filter = "all"\n'
    )
    monkeypatch.setenv("XDG_CONFIG_HOME", str(settings))
    book = tmp_path / "project" / "book"
    (book / "solutions").mkdir(parents=True)
    (book / "jupytext.toml").write_bytes((BOOK / "jupytext.toml").read_bytes())
    for folder in (book, book / "solutions"):
        source = folder / "01_a.py"
        source.write_text(SOURCE, encoding="utf-8")
        pair(source)
    target = book / "01_a.ipynb"
    nb = read_notebook(target)
    for count, cell in enumerate(nb.cells[1:], 1):
        cell.execution_count = count
    result = new_output("execute_result", {"text/plain": "3.14"}, execution_count=2)
    nb.cells[2].outputs = [result]
    nb.metadata["posecore"] = {"code": code_digest(nb), "outputs": outputs_digest(nb)}
    write_notebook(nb, target)
    return book.parent


def age(book, newer, seconds=100):
    """Set the times of the pair: which side is the newer one."""
    for suffix in (".py", ".ipynb"):
        when = 1e9 + (seconds if newer == suffix else 0)
        os.utime(book / f"01_a{suffix}", (when, when))


def open_page(root, path):
    manager = TextFileContentsManager(root_dir=str(root))
    return manager, manager.get(path, content=True, type="notebook")


def as_the_browser_does(content):
    """What JupyterLab adds to a notebook before it saves it."""
    content["metadata"]["kernelspec"]["display_name"] = "Python 3.11 (mine)"
    content["metadata"]["language_info"] = {"name": "python", "version": "3.11.4"}
    for cell in content["cells"]:
        cell["metadata"].update(editable=True, trusted=True, slideshow={"slide_type": ""})
    return dict(type="notebook", content=content)


ROOTS = [("", "book/"), ("book", ""), ("book/solutions", "")]
SIDES = [".py", ".ipynb"]


@pytest.mark.parametrize("root, folder", ROOTS[:2])
@pytest.mark.parametrize("newer", [*SIDES, "neither"])
@pytest.mark.parametrize("side", SIDES)
def test_a_fresh_clone_opens_from_either_side_and_saves_in_step(root, folder, newer, side, project):
    book = project / "book"
    age(book, newer)
    before = (book / "01_a.ipynb").read_bytes()
    manager, model = open_page(project / root, f"{folder}01_a{side}")
    assert model["content"].cells[2].outputs[0].data["text/plain"] == "3.14"
    manager.save(as_the_browser_does(model["content"]), f"{folder}01_a{side}")
    assert (book / "01_a.py").read_text(encoding="utf-8") == SOURCE
    nb = read_notebook(book / "01_a.ipynb")
    assert cells_differ(read_source(book / "01_a.py"), nb) == ""
    assert notebook_bytes(nb) == before
    assert nb.metadata.posecore == {"code": code_digest(nb), "outputs": outputs_digest(nb)}
    pair(book / "01_a.py")
    assert (book / "01_a.ipynb").read_bytes() == before
    assert {path.name for path in book.iterdir() if path.is_file()} == {
        "01_a.py", "01_a.ipynb", "jupytext.toml",
    }  # fmt: skip


@pytest.mark.parametrize("root, folder", ROOTS)
@pytest.mark.parametrize("side", SIDES)
def test_edits_made_there_reach_both_sides(root, folder, side, project):
    place = project / root / folder
    manager, model = open_page(project / root, f"{folder}01_a{side}")
    cells = model["content"].cells
    cells[0].source = "# Another title"
    cells.insert(1, new_code_cell("new = 1", metadata={"tags": ["solution"]}))
    manager.save(as_the_browser_does(model["content"]), f"{folder}01_a{side}")
    source, nb = read_source(place / "01_a.py"), read_notebook(place / "01_a.ipynb")
    assert cells_differ(source, nb) == ""
    assert [cell.source for cell in source.cells[:2]] == ["# Another title", "new = 1"]
    assert source.cells[1].metadata.tags == ["solution"]
    if root != "book/solutions":  # there the user's settings rule but what the header says
        assert (place / "01_a.py").read_text(encoding="utf-8").startswith(HEADER)
    if nb.metadata.get("posecore"):
        assert nb.metadata.posecore.code != code_digest(nb)
    pair(place / "01_a.py")
    assert (place / "01_a.py").read_text(encoding="utf-8").startswith(HEADER)
    assert not read_notebook(place / "01_a.ipynb").cells[-1].outputs


@pytest.mark.parametrize("side", SIDES)
def test_a_source_edited_in_an_editor_wins_where_it_is_newer(side, project):
    book = project / "book"
    (book / "01_a.py").write_text(SOURCE.replace("Its text.", "Its new text."), encoding="utf-8")
    age(book, ".py")
    _, model = open_page(book, f"01_a{side}")
    assert model["content"].cells[0].source.split("\n")[-1].startswith("Its new text.")
    assert model["content"].cells[2].outputs


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("seconds", [0.01, 100])
def test_a_notebook_edited_elsewhere_is_not_lost_but_explained(seconds, side, project):
    book = project / "book"
    nb = read_notebook(book / "01_a.ipynb")
    nb.cells[0].source = "# Edited where jupytext was not there"
    write_notebook(nb, book / "01_a.ipynb")
    age(book, ".ipynb", seconds)
    with pytest.raises(HTTPError, match="is more recent than") as caught:
        open_page(book, f"01_a{side}")
    assert "Edited where jupytext was not there" in str(caught.value)


@pytest.fixture
def server(project, tmp_path):
    """`jupyter lab book/01_a.ipynb`, started in the project."""
    runtime = tmp_path / "runtime"
    words = ["--no-browser", "--ServerApp.port=0", "--allow-root"]
    process = subprocess.Popen(
        [sys.executable, "-m", "jupyterlab", "book/01_a.ipynb", *words],
        cwd=project,
        env={**os.environ, "JUPYTER_RUNTIME_DIR": str(runtime), "HOME": str(tmp_path)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield _answering(process, runtime)
    finally:
        process.terminate()
        process.wait(timeout=60)


def _answering(process, runtime):
    """Address and token, once there is an answer."""
    end = time.monotonic() + 90
    while time.monotonic() < end and process.poll() is None:
        for path in runtime.glob("jpserver-*.json"):
            try:
                server = json.loads(path.read_text())
                request(server, "")
            except (OSError, ValueError):
                continue
            return server
        time.sleep(0.1)
    pytest.fail("JupyterLab did not start")


def request(server, path, model=None):
    address = f"http://127.0.0.1:{server['port']}/api/contents/{path}"
    call = urllib.request.Request(
        address,
        data=None if model is None else json.dumps(model).encode(),
        method="GET" if model is None else "PUT",
        headers={"Authorization": f"token {server['token']}"},
    )
    with urllib.request.urlopen(call, timeout=60) as answer:
        return json.loads(answer.read())


def test_a_real_server_keeps_a_pair_in_step_from_both_sides(server, project):
    book = project / "book"
    assert os.path.samefile(server["root_dir"], book)  # not the folder it was started in
    before = (book / "01_a.ipynb").read_bytes()
    for number, side in enumerate(SIDES):
        age(book, SIDES[1 - number])
        content = request(server, f"01_a{side}?type=notebook")["content"]
        assert content["cells"][2]["outputs"]
        request(server, f"01_a{side}", as_the_browser_does(content))
        assert (book / "01_a.py").read_text(encoding="utf-8") == SOURCE
        assert notebook_bytes(read_notebook(book / "01_a.ipynb")) == before
        content["cells"][0]["source"] = f"# Saved from {side}"
        request(server, f"01_a{side}", as_the_browser_does(content))
        source, nb = read_source(book / "01_a.py"), read_notebook(book / "01_a.ipynb")
        assert source.cells[0].source == nb.cells[0].source == f"# Saved from {side}"
        (book / "01_a.py").write_text(SOURCE, encoding="utf-8")
        pair(book / "01_a.py")


EXERCISE = """
# %%
def double(x):
    ### BEGIN SOLUTION
    return 2 * x
    ### END SOLUTION
"""


def test_exercises_solved_in_jupyterlab_stay_one_notebook(server, project):
    """Whatever the folder's settings pair."""
    book = project / "book"
    (book / "exercises").mkdir()
    (book / "solutions" / "solutions_02_b.py").write_text(HEADER + EXERCISE)
    generate(Page("02_b", exercises=True), book)
    path = book / "exercises" / "exercises_02_b.ipynb"
    before = path.read_bytes()
    content = request(server, "exercises/exercises_02_b.ipynb?type=notebook")["content"]
    assert [file.name for file in path.parent.iterdir()] == [path.name]
    request(server, "exercises/exercises_02_b.ipynb", as_the_browser_does(content))
    content["cells"][0]["source"] = "def double(x):\n    return x + x"
    request(server, "exercises/exercises_02_b.ipynb", as_the_browser_does(content))
    assert [f.name for f in path.parent.iterdir() if f.is_file()] == [path.name]
    nb = read_notebook(path)
    assert nb.cells[0].source.endswith("return x + x")
    assert nbformat.read(path, as_version=4).metadata.jupytext.formats == "ipynb"
    generate(Page("02_b", exercises=True), book)
    assert path.read_bytes() == before


# Reading ------------------------------------------------------------------------------------------


def test_the_readers_lab_saves_nothing_unasked(project, tmp_path):
    """`make.py read`: Lab's own default is to save every two minutes what is open."""
    runtime = tmp_path / "runtime"
    words = reading.command(Page("01_a", exercises=False), project / "book")
    process = subprocess.Popen(
        [*words, "--no-browser", "--ServerApp.port=0", "--allow-root"],
        cwd=project,
        env={**os.environ, "JUPYTER_RUNTIME_DIR": str(runtime), "HOME": str(tmp_path)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        server = _answering(process, runtime)
        name = "@jupyterlab/docmanager-extension:plugin"
        address = f"http://127.0.0.1:{server['port']}/lab/api/settings/{name}"
        call = urllib.request.Request(
            address, headers={"Authorization": f"token {server['token']}"}
        )
        with urllib.request.urlopen(call, timeout=60) as answer:
            found = json.loads(answer.read())
        assert found["schema"]["properties"]["autosave"]["default"] is False
        assert found["settings"] == {}, "the user's own are not touched"
    finally:
        process.terminate()
        process.wait(timeout=60)


def test_a_page_that_is_not_there_is_not_read(project):
    assert reading.command(None, BOOK)[3].endswith("index.ipynb")
    with pytest.raises(ValueError, match=r"^page: expected one with a notebook, .*02_b\.ipynb"):
        reading.command(Page("02_b", exercises=False), project / "book")


def test_the_readme_reads_by_this_command_and_says_so():
    text = (BOOK.parent / "README.md").read_text(encoding="utf-8")
    assert "python book/make.py read\n" in text and "turns off that it saves by itself" in text
    assert "jupyter lab book" not in text
