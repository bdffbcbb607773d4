"""What changes the plain form of code, and what does not; the same on every version of Python."""

# ruff: noqa: E501 - tables of code, a line each

import ast
import os
import shutil
import subprocess
import sys
import textwrap

import pytest

from posecore.fingerprint.plain import Found, plain_form


def form(text: str, refusals: bool = False) -> str:
    nodes = ast.parse(textwrap.dedent(text)).body
    return plain_form(nodes, "house", lambda chain, local: None, refusals).text


SAME = {
    "a comment": ("x = 1", "x = 1  # one"),
    "blank lines and brackets": ("x = f(1, 2)", "x = (\n\n    f(\n1,\n2,\n))"),
    "a docstring": ("def f():\n  return 1", "def f():\n  'One.'\n  return 1"),
    "a docstring of a class": ("class A:\n  x = 1", "class A:\n  'One.'\n  x = 1"),
    "a text under a constant": ("x = 1", "x = 1\n'''Of metres.'''"),
    "annotations": ("def f(a, *b, c=1): return a", "def f(a: int, *b: str, c: float=1) -> int: return a"),
    "the annotation of a variable": ("def f():\n  x = 1", "def f():\n  x: int = 1"),
    "a variable that is only announced": ("def f():\n  x = 1", "def f():\n  x: int\n  x = 1"),
    "quotes": ("x = 'a'", 'x = "a"'),
    "pieces of a text": ("x = 'ab'", "x = 'a' 'b'"),
    "pieces of an f-string": ("x = f'a{b}c d'", "x = f'a{b}' f'c ' 'd'"),
    "an import inside": ("def f(): return 1", "def f():\n  import numpy\n  return 1"),
    "a line that refuses": ("def f(a): return a", "def f(a):\n  if a < 0: raise ValueError(a)\n  return a"),
    "another message": (
        "def f(a):\n  if a: fail('a', 'none', a)\n  return a",
        "def f(a):\n  if a: fail('a', 'nothing at all', repr(a))\n  return a",
    ),
    "a check by name": ("def f(a): return a", "def f(a):\n  require_choice('a', a, (1, 2))\n  return a"),
    "a check of another module": ("def f(a): return a", "def f(a):\n  arrays._require_json('a', a)\n  return a"),
    "a loop of checks": ("def f(a): return a", "def f(a):\n  for x in a:\n    if x: fail('a', '', x)\n  return a"),
    "an error said in other words": (
        "def f(a):\n  return g(a)",
        "def f(a):\n  try:\n    return g(a)\n  except KeyError as error:\n    raise ValueError('a') from error",
    ),
    "an assertion": ("def f(a): return a", "def f(a):\n  assert a\n  return a"),
}  # fmt: skip
OTHER = {
    "a number": ("x = 1", "x = 2"),
    "its kind": ("x = 1", "x = 1.0"),
    "a sign of truth": ("x = 1", "x = True"),
    "an operator": ("x = a + b", "x = a - b"),
    "a default": ("def f(a=1): return a", "def f(a=2): return a"),
    "a keyword's name": ("f(a=1)", "f(b=1)"),
    "the kind of an argument": ("def f(a, b): return a", "def f(a, *, b): return a"),
    "a decorator": ("def f(): return 1", "@g\ndef f(): return 1"),
    "a decorator's argument": ("@g(1)\ndef f(): return 1", "@g(2)\ndef f(): return 1"),
    "a base": ("class A: x = 1", "class A(B): x = 1"),
    "the annotation of a field": ("class A:\n  x: int = 1", "class A:\n  x: float = 1"),
    "a field": ("class A:\n  x: int", "class A:\n  x: int\n  y: int"),
    "another value in place of an error": (
        "def f(a):\n  try: return g(a)\n  except KeyError: raise ValueError(a)",
        "def f(a):\n  try: return g(a)\n  except KeyError: return None",
    ),
    "what a check gives back": (
        "def f(a):\n  a = require_number('a', a, low=0)\n  return a",
        "def f(a):\n  a = require_number('a', a, low=1)\n  return a",
    ),
    "something besides refusing": (
        "def f(a):\n  if a: fail('a', '', a)\n  return a",
        "def f(a):\n  if a: a = 1\n  return a",
    ),
    "the other branch": (
        "def f(a):\n  if a: fail('a', '', a)\n  else: a = 1\n  return a",
        "def f(a):\n  if a: fail('a', '', a)\n  else: a = 2\n  return a",
    ),
    "a lambda": ("f = lambda a: a", "f = lambda a: -a"),
    "an f-string's format": ("x = f'{a:.1f}'", "x = f'{a:.2f}'"),
    "the order of statements": ("a()\nb()", "b()\na()"),
    "bytes": ("x = 'a'", "x = b'a'"),
}  # fmt: skip


@pytest.mark.parametrize("name", SAME)
def test_what_changes_nothing(name: str) -> None:
    a, b = SAME[name]
    assert form(a) == form(b)


@pytest.mark.parametrize("name", OTHER)
def test_what_changes_something(name: str) -> None:
    a, b = OTHER[name]
    assert form(a) != form(b)


def test_lines_that_refuse_count_where_they_are_asked_for() -> None:
    a, b = SAME["another message"]
    assert form(a, refusals=True) != form(b, refusals=True)


def test_names_are_written_as_what_they_stand_for() -> None:
    def resolve(chain: list[str], local: dict) -> Found | None:
        known = {"np": "numpy", "short": "house.long_name", "tool": "house.tools"}
        if chain[0] in known:
            return Found(known[chain[0]], (("house", chain[0]),), 1)
        return None

    def of(text: str) -> tuple[str, set]:
        found = plain_form(ast.parse(text).body, "house", resolve, False)
        return found.text, found.origins

    text, origins = of("def f(a): return np.dot(short(a), tool.x)")
    assert "numpy.dot" in text and "house.long_name" in text and "house.tools.x" in text
    assert origins == {("house", "np"), ("house", "short"), ("house", "tool")}
    # Names of a function's own are none of the module's.
    for shadowing in (
        "def f(np): return np.dot(1)",
        "def f():\n  np = 1\n  return np.dot(1)",
        "def f():\n  def g(): return np.dot(1)\n  np = 2\n  return g",
        "x = [np.dot(1) for np in y]",
        "x = lambda np: np.dot(1)",
        "def f():\n  for np, _ in y: np.dot(1)",
        "def f():\n  with y as np: np.dot(1)",
        "def f():\n  try: y()\n  except E as np: np.dot(1)",
    ):
        assert of(shadowing)[1] == set(), shadowing
    assert of("def f():\n  global np\n  np = 1\n  np.dot(1)")[1] == {("house", "np")}
    assert of("def f():\n  [np for np in y]\n  return np.dot(1)")[1] in (set(), {("house", "np")})


def test_numbers_chosen_by_scale_are_noted() -> None:
    def scaled(text: str) -> dict:
        return plain_form(ast.parse(text).body, "", lambda c, i: None, False).scaled

    call = scaled("x = choose(tiny=1, book=2 * y, paper=3)")
    assert {scale: len(values) for scale, values in call.items()} == dict.fromkeys(
        ("tiny", "book", "paper"), 1
    )
    assert scaled("x = {'tiny': 1, 'book': 2 * y}")["book"] == call["book"]
    assert scaled("x = choose(tiny=1, book=3 * y, paper=3)")["book"] != call["book"]
    assert scaled("x = choose(tiny=5, book=2 * y, paper=3)")["book"] == call["book"]
    assert scaled("x = dict(tiny=1)") == scaled("x = {'book': 1}") == {}


PROGRAM = """
import ast, sys
sys.path.insert(0, sys.argv[1])
import types
for name in ("posecore", "posecore.fingerprint"):  # without what they import
    module = types.ModuleType(name)
    module.__path__ = [sys.argv[1] + "/" + name.replace(".", "/")]
    sys.modules[name] = module
from posecore.fingerprint.plain import plain_form
import hashlib, pathlib
total = hashlib.sha256()
for path in sorted(pathlib.Path(sys.argv[1], "posecore").rglob("*.py")):
    tree = ast.parse(path.read_bytes())
    for refusals in (False, True):
        text = plain_form(tree.body, "p", lambda chain, local: None, refusals).text
        total.update(text.encode())
print(total.hexdigest())
"""


@pytest.mark.slow
def test_every_version_of_python_writes_the_same() -> None:
    from posecore.fingerprint import HOME

    others = [python for v in (12, 13) if (python := shutil.which(f"python3.{v}"))]
    answers = {}
    for python in (sys.executable, *others):
        done = subprocess.run(
            [python, "-c", PROGRAM, str(HOME)],
            capture_output=True,
            text=True,
            env={k: v for k, v in os.environ.items() if not k.startswith("PYTHON")},
        )
        if python == sys.executable or done.returncode == 0:  # a shim without its Python
            answers[python] = done.stdout
            assert done.returncode == 0, done.stderr
    assert len(set(answers.values())) == 1, answers
    if len(answers) == 1:
        pytest.skip("no other version of Python is installed here")
