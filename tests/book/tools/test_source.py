"""Source on the page: the right lines of the right file, and what is left out."""

import ast
import importlib.util
import inspect
import json
import linecache
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from book.tools.source import Source, show_source
from posecore import arrays, cameras, poses
from posecore.rotations import is_rotation

TEXT = '''"""A module."""
import functools


def through(function):
    @functools.wraps(function)
    def inner(*a):
        return function(*a)

    return inner


@through
def decorated(x):
    """Doc."""

    return x  # kept


class Net:
    """A net.

    With ``` and ```` in it.
    """

    size = 3

    def __init__(self, size):
        """Make one."""
        # why
        self.size = size
        self.text = """
left
"""

    @property
    def double(self):
        return 2 * self.size

    def only(self):
        """Nothing but words."""

    def café(self): "é"; return 1

    def forward(self, x,
                y=None):  # shape
        """Both."""
        def nested():
            """Deep."""
            return x
        return nested()

    async def later(self): return 2
'''


@pytest.fixture(scope="module")
def net(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ModuleType]:
    path = tmp_path_factory.mktemp("m") / "shown_module.py"
    path.write_text(TEXT, encoding="utf-8")
    spec = importlib.util.spec_from_file_location("shown_module", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["shown_module"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["shown_module"]


def test_a_function_is_shown_as_it_stands_in_its_file() -> None:
    shown = show_source(poses.compose)
    lines = Path(poses.__file__).read_text(encoding="utf-8").splitlines()
    assert shown.file == "posecore/poses.py"
    code = shown.code.splitlines()
    assert lines[shown.line - 1 : shown.line - 1 + len(code)] == code
    assert code[0].startswith("@array_function(") and code[1].startswith("def compose(")
    assert code[-1] == "    return R_ac, t_ac"


def test_what_the_page_gets() -> None:
    shown = Source("a/b.py", 7, "x = 1")
    assert repr(shown) == "a/b.py, line 7\n\nx = 1"
    assert shown._repr_markdown_() == "`a/b.py`, line 7\n\n```python\nx = 1\n```\n"


def test_the_fence_is_longer_than_any_in_the_code(net: ModuleType) -> None:
    page = show_source(net.Net)._repr_markdown_()
    assert "\n`````python\nclass Net:" in page and page.endswith("\n`````\n")


def test_ipython_shows_markdown_and_text() -> None:
    formatter = pytest.importorskip("IPython.core.formatters").DisplayFormatter()
    shown = show_source(poses.apply)
    data, _ = formatter.format(shown)
    assert data == {"text/plain": repr(shown), "text/markdown": shown._repr_markdown_()}


def test_a_whole_class_is_its_text(net: ModuleType) -> None:
    shown = show_source(net.Net)
    assert shown.file == "shown_module.py"
    assert shown.code + "\n" == TEXT[TEXT.index("class Net") :]
    assert TEXT.splitlines()[shown.line - 1] == "class Net:"


def test_a_decorated_function_and_a_method(net: ModuleType) -> None:
    shown = show_source(net.decorated, docstrings=False)
    assert shown.code == "@through\ndef decorated(x):\n    return x  # kept"
    for method in (net.Net.only, net.Net(1).only):
        shown = show_source(method)
        assert shown.code == 'def only(self):\n    """Nothing but words."""'
        assert TEXT.splitlines()[shown.line - 1] == "    def only(self):"
    # A string that reaches to the left margin does not disturb the rest.
    init = show_source(net.Net.__init__).code
    assert init.splitlines()[3:] == ["    self.size = size", '    self.text = """', "left", '"""']


def test_without_docstrings(net: ModuleType) -> None:
    expected = '''
    class Net:
        size = 3

        def __init__(self, size):
            # why
            self.size = size
            self.text = """
    left
    """

        @property
        def double(self):
            return 2 * self.size

        def only(self):
            ...

        def café(self): return 1

        def forward(self, x,
                    y=None):  # shape
            def nested():
                return x
            return nested()

        async def later(self): return 2
    '''
    shown = show_source(net.Net, docstrings=False)
    assert shown.code == textwrap.dedent(expected).strip()


def test_hidden_methods(net: ModuleType) -> None:
    code = show_source(net.Net, hide=["__init__", "café", "forward", "later", "double"]).code
    assert "    def __init__(self, size):\n        ...\n\n    @property\n" in code
    assert "    @property\n    def double(self):\n        ...\n\n    def only" in code
    assert "\n    def café(self): ...\n\n    def forward(self, x,\n" in code
    assert "                y=None):  # shape\n        ...\n" in code
    assert code.endswith("\n    async def later(self): ...")
    assert "A net." in code and "Nothing but words." in code
    assert not any(word in code for word in ("Make one", "why", "nested"))


@pytest.mark.usefixtures("net")
@given(
    st.sets(st.sampled_from(["__init__", "double", "only", "café", "forward", "later"])),
    st.booleans(),
)
def test_what_is_shown_is_python_with_the_same_methods(hide: set[str], docs: bool) -> None:
    thing = sys.modules["shown_module"].Net
    tree = ast.parse(show_source(thing, docstrings=docs, hide=sorted(hide)).code)
    whole = ast.parse(show_source(thing).code)
    functions = (ast.FunctionDef, ast.AsyncFunctionDef)
    shown = {n.name: n for n in tree.body[0].body if isinstance(n, functions)}
    assert set(shown) == {n.name for n in whole.body[0].body if isinstance(n, functions)}
    for name, node in shown.items():
        assert not (name in hide and ast.unparse(node.body) != "...")
    documented = [n for n in ast.walk(tree) if isinstance(n, (ast.ClassDef, *functions))]
    assert docs or not any(ast.get_docstring(n) for n in documented)


@pytest.mark.parametrize("module", [arrays, cameras, poses])
def test_every_public_function_of_the_library_can_be_shown(module: ModuleType) -> None:
    for name in module.__all__:
        thing = getattr(module, name)
        if inspect.isroutine(thing) or (
            inspect.isclass(thing) and thing.__module__[:8] == "posecore"
        ):
            for docstrings in (True, False):
                ast.parse(show_source(thing, docstrings=docstrings).code)


def typed_in_a_notebook() -> Callable[[], int]:
    space: dict = {"__name__": "__main__"}
    exec(compile("def typed(): return 1", "<ipython-input-1>", "exec"), space)
    return space["typed"]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: show_source(3), "thing: expected a class or a function, got an instance of int"),
        (
            lambda: show_source(poses),
            "thing: expected a class or a function, got an instance of module",
        ),
        (
            lambda: show_source(None),
            "thing: expected a class or a function, got an instance of NoneType",
        ),
        (lambda: show_source(len), "thing: expected something with Python source, got len"),
        (lambda: show_source(int), "thing: expected something with Python source, got int"),
        (
            lambda: show_source(np.add),
            "thing: expected a class or a function, got an instance of ufunc",
        ),
        (
            lambda: show_source(typed_in_a_notebook()),
            "thing: expected something with Python source, got typed",
        ),
        (
            lambda: show_source(Source, hide=["forward", "a"]),
            "hide: expected names of methods, got 'a', 'forward'",
        ),
        (
            lambda: show_source(Source, hide="forward"),
            "hide: expected a sequence of names of methods, got 'forward'",
        ),
        (
            lambda: show_source(poses.apply, hide=["apply"]),
            "hide: expected names of methods, got 'apply'",
        ),
    ],
)
def test_what_cannot_be_shown(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError) as caught:
        call()
    assert str(caught.value) == message


def test_a_cell_has_text_but_no_file(monkeypatch: pytest.MonkeyPatch) -> None:
    text = "def typed(): return 1\n"
    monkeypatch.setitem(
        linecache.cache, "<ipython-input-1>", (len(text), None, [text], "<ipython-input-1>")
    )
    with pytest.raises(ValueError) as caught:
        show_source(typed_in_a_notebook())
    assert str(caught.value) == (
        "thing: expected something from a file, got typed, typed in a notebook or a shell"
    )


def test_a_package_is_named_by_its_folder() -> None:
    assert show_source(textwrap.dedent).file == "textwrap.py"
    assert show_source(st.text).file.startswith("hypothesis/")
    assert show_source(is_rotation).file.startswith("posecore/rotations/")
    assert show_source(json.dumps).file == "json/__init__.py"
