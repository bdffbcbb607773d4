import asyncio
import os
import sys
from queue import Empty
from types import SimpleNamespace

import pytest
from jupyter_client.channels import AsyncZMQSocketChannel
from nbformat.v4 import new_code_cell, new_notebook, new_output

from book.tools import execution
from book.tools.contents import Page
from book.tools.execution import clean_outputs, environment, execute
from book.tools.inputs import inputs, stale_inputs
from book.tools.notebooks import (
    HEADER,
    code_digest,
    notebook_bytes,
    outputs_digest,
    read_notebook,
    read_source,
    write_notebook,
)
from book.tools.pairs import pair

pytestmark = pytest.mark.slow  # kernels

CONTENTS = '[[page]]\nname = "01_a"\n'
PAGE = """
# %% [markdown]
# # A page

# %%
import os, sys, time
from tqdm import tqdm
from tqdm.auto import tqdm as widget_bar
for _ in tqdm(range(2), desc="a"):
    time.sleep(0.02)
for _ in widget_bar(range(2)):
    pass
print("10%\\r20%\\rdone", end="")
print("\\x1b[31m.\\x1b[0m")

# %%
from IPython.display import display
from ipywidgets import interact
from posecore.figures import Picture

@interact(width=(1, 4))
def draw(width=2):
    return Picture(figsize=(width, 1))

# %%
import matplotlib, posecore.scale
try:
    assert False
except AssertionError:
    print("assertions on")
print("startup" in globals(), os.path.basename(os.getcwd()), posecore.scale.scale())
print(sys.executable == os.environ["EXPECTED"], matplotlib.get_backend().split(".")[-1])
print(matplotlib.rcParams["lines.linewidth"])
print({"POSECORE_DATA", "POSECORE_RETRAIN", "PYTHONWARNINGS"} & set(os.environ))
"""


def write(folder, text, name="01_a.py"):
    (folder / "site").mkdir(exist_ok=True)
    (folder / "site" / "contents.toml").write_text(CONTENTS)
    path = folder / name
    path.write_text(HEADER + text, encoding="utf-8")
    return path


def inputs_now(source):
    return inputs(read_source(source), Page("01_a"), source.parent)


@pytest.fixture(scope="module")
def executed(hostile, tmp_path_factory):
    source = write(tmp_path_factory.mktemp("pages"), PAGE)
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {**hostile, "EXPECTED": sys.executable}.items():
            patch.setenv(name, value)
        before = dict(os.environ)
        nb = execute(source, "tiny")
        assert dict(os.environ) == before
        yield source, nb


def test_an_executed_page_says_what_it_belongs_to(executed):
    source, nb = executed
    stored = read_notebook(source.with_suffix(".ipynb"))
    assert notebook_bytes(stored) == notebook_bytes(nb) == stored_bytes(source)
    assert stored.metadata.posecore == {
        "code": code_digest(nb),
        "inputs": inputs_now(source),
        "outputs": outputs_digest(stored),
        "scale": "tiny",
    }
    assert [cell.execution_count for cell in stored.cells[1:]] == [1, 2, 3]
    assert source.stat().st_mtime >= source.with_suffix(".ipynb").stat().st_mtime


def stored_bytes(source):
    return source.with_suffix(".ipynb").read_bytes()


def test_progress_bars_and_overwritten_text_are_not_stored(executed):
    (output,) = executed[1].cells[1].outputs
    assert (output.name, output.text) == ("stdout", "done.\n")


def test_a_slider_is_stored_as_the_picture_that_it_shows_at_its_start(executed):
    (output,) = executed[1].cells[2].outputs
    assert set(output.data) == {"text/html", "text/plain"}
    assert output.data["text/html"].startswith('<img alt="')
    assert b"widget-" not in stored_bytes(executed[0])


def test_settings_of_users_and_machines_do_not_count(executed):
    lines = executed[1].cells[3].outputs[0].text.splitlines()
    folder = executed[0].parent.name
    assert lines == [
        "assertions on",
        f"False {folder} tiny",
        "True backend_inline",
        "1.5",
        "set()",
    ]


def test_a_second_run_gives_the_same_bytes(executed):
    before = stored_bytes(executed[0])
    execute(executed[0], "tiny")
    assert stored_bytes(executed[0]) == before


@pytest.mark.parametrize(
    "code, message",
    [
        ("x = 1\n\n# %%\nassert x == 2, 'x is 1'", r"^01_a\.py, cell 2: AssertionError: x is 1$"),
        ("import os\nos._exit(1)", r"^01_a\.py, cell 1: the kernel died$"),
        ("import time\ntime.sleep(60)", r"^01_a\.py, cell 1 takes longer than 2 s$"),
    ],
    ids=["error", "death", "timeout"],
)
def test_a_run_that_fails_is_told_of_and_leaves_the_old_notebook(
    code, message, tmp_path, monkeypatch
):
    monkeypatch.setattr(execution, "CELL_TIMEOUT", 2)
    source = write(tmp_path, "\n# %%\nprint('old')\n")
    pair(source)
    before = stored_bytes(source)
    write(tmp_path, f"\n# %%\n{code}\n")
    with pytest.raises(ValueError, match=message):
        execute(source)
    assert stored_bytes(source) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["01_a.ipynb", "01_a.py", "site"]


@pytest.mark.parametrize("old, new, kept", [("title", "words", True), ("x = 1", "x = 2", False)])
def test_a_source_may_change_while_it_runs_in_its_text_alone(old, new, kept, tmp_path):
    code = (
        "from pathlib import Path\n"
        "page = Path('01_a.py')\n"
        f"page.write_text(page.read_text().replace({old[:2]!r} + {old[2:]!r}, {new!r}))"
    )
    source = write(tmp_path, f"\n# %% [markdown]\n# # A title\n\n# %%\nx = 1\n\n# %%\n{code}\n")
    if kept:
        execute(source, "tiny")
        nb = read_notebook(source.with_suffix(".ipynb"))
        assert nb.cells[0].source == "# A words" and nb.cells[1].execution_count == 1
    else:
        with pytest.raises(ValueError, match=r"01_a\.py was changed while it ran"):
            execute(source, "tiny")
        assert not source.with_suffix(".ipynb").exists()


WHILE_IT_RUNS = """
import os
from pathlib import Path

Path("ch01_a/drawing.py").write_text("def colour():\\n    return 'blue'")
page = Path("01_a.ipynb")
page.write_text(page.read_text().replace("# A title", "# Hours of work"))
os.utime(page, (1e9 + TIME, 1e9 + TIME))
"""


def test_what_changes_beside_a_page_while_it_runs(tmp_path, capsys, monkeypatch):
    """It keeps the drawings of its start, and is stale then."""
    book = tmp_path / "folio"
    (book / "ch01_a").mkdir(parents=True)
    (book / "__init__.py").write_text("")
    drawing = book / "ch01_a" / "drawing.py"
    drawing.write_text("def colour():\n    return 'red'")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    text = "\n# %% [markdown]\n# # A title\n\n# %%\nfrom folio.ch01_a.drawing import colour\n"
    text += WHILE_IT_RUNS + "assert colour() == 'red'\n"
    source = write(book, text.replace("TIME", "1"))
    before = inputs_now(source)
    assert before["definitions"].startswith("colour:")
    pair(source)
    os.utime(source, (1e9, 1e9))
    with pytest.raises(ValueError, match=r"01_a\.ipynb was saved after 01_a\.py and differs"):
        execute(source, "tiny")
    assert read_notebook(source.with_suffix(".ipynb")).cells[0].source == "# Hours of work"
    write(book, text.replace("TIME", "-1"))  # and now where times say nothing of it
    os.utime(source.with_suffix(".ipynb"), (1, 1))
    drawing.write_text("def colour():\n    return 'red'")
    nb = execute(source, "tiny")
    assert nb.metadata.posecore.inputs == before != inputs_now(source)
    assert stale_inputs(nb, Page("01_a"), book) == ("drawing.colour",)
    (kept,) = (book / "_build" / "replaced").iterdir()
    assert read_notebook(kept).cells[0].source == "# Hours of work"
    assert "what it said before is kept" in capsys.readouterr().out


def test_a_kernel_that_does_not_start_is_told_of(tmp_path, monkeypatch):
    def never(*arguments, **more):
        raise RuntimeError("Kernel didn't respond in 120 seconds")

    monkeypatch.setattr(execution.NotebookClient, "execute", never)
    source = write(tmp_path, "\n# %%\nx = 1\n")
    with pytest.raises(ValueError, match=r"^01_a\.py: the kernel did not start: Kernel didn't"):
        execute(source, "tiny")
    assert not source.with_suffix(".ipynb").exists()


def test_edits_of_the_notebook_are_not_run_over(tmp_path):
    source = write(tmp_path, "\n# %%\nx = 1\n")
    pair(source)
    target = source.with_suffix(".ipynb")
    nb = read_notebook(target)
    nb.cells[0].source = "x = 2"
    write_notebook(nb, target)
    os.utime(source, (1e9, 1e9))
    with pytest.raises(ValueError, match="was saved after"):
        execute(source, "tiny")


def test_bad_input(tmp_path):
    with pytest.raises(ValueError, match="scale"):
        execute(tmp_path / "a.py", "huge")
    with pytest.raises(ValueError, match=r"a\.py"):
        execute(tmp_path / "a.py")


def test_the_environment_is_put_back_also_after_an_error(tmp_path, monkeypatch):
    monkeypatch.setenv("POSECORE_SCALE", "paper")
    monkeypatch.delenv("POSECORE_DATA", raising=False)
    before = dict(os.environ)
    with pytest.raises(KeyError), environment("tiny", tmp_path):
        assert os.environ["POSECORE_SCALE"] == "tiny"
        raise KeyError
    assert dict(os.environ) == before


def stream(text, name="stdout"):
    return new_output("stream", name=name, text=text)


def test_streams_are_joined_and_bars_taken_out():
    bar = "\rtrain:  50%|#####     | 1/2 [00:00<00:00, 37.9it/s, loss=2.1]"
    unknown = "\r5it [00:02, 2.31it/s]"
    picture = new_output("display_data", {"text/plain": "x"})
    outputs = [
        *(stream("a"), stream("b\n"), stream("warning\n", "stderr"), stream(bar, "stderr")),
        *(picture, stream(unknown, "stderr"), stream("\n", "stderr"), stream("50% done\n")),
    ]
    nb = new_notebook(cells=[new_code_cell("x", outputs=outputs)])
    clean_outputs(nb)
    shown = [(o.get("name"), o.get("text")) for o in nb.cells[0].outputs]
    assert shown == [
        ("stdout", "ab\n"),
        ("stderr", "warning\n"),
        (None, None),
        ("stdout", "50% done\n"),
    ]


@pytest.mark.parametrize("timeout", [None, 30.0])
def test_a_reply_whose_news_got_lost_is_found_within_a_second(monkeypatch, timeout):
    """With many widgets a page took its timeout more than once (nbclient's issue 312)."""
    waits = []

    async def deaf_at_first(self, timeout=None):
        waits.append(timeout)
        if len(waits) < 3:
            raise Empty
        return {"reply": 1}

    monkeypatch.setattr(AsyncZMQSocketChannel, "get_msg", deaf_at_first)
    channel = execution._Channel.__new__(execution._Channel)
    assert asyncio.run(channel.get_msg(timeout)) == {"reply": 1}
    assert waits == [1.0, 1.0, 1.0]


def test_a_reply_that_does_not_come_is_missed_in_time(monkeypatch):
    waits = []

    async def never(self, timeout=None):
        waits.append(timeout)
        raise Empty

    clock = SimpleNamespace(monotonic=lambda: sum(waits))  # only waiting takes time
    monkeypatch.setattr(execution, "time", clock)
    monkeypatch.setattr(AsyncZMQSocketChannel, "get_msg", never)
    channel = execution._Channel.__new__(execution._Channel)
    with pytest.raises(Empty):
        asyncio.run(channel.get_msg(1.3))
    assert waits == pytest.approx([1, 0.3])


def test_the_kernel_of_a_page_is_listened_to_in_that_way():
    assert execution._Kernel().client_factory.shell_channel_class.klass is execution._Channel
