"""Edits that change what is computed without an edit of the function's own text."""

# ruff: noqa: E501 - tables of code, a line each

from pathlib import Path

import pytest

from posecore.fingerprint import changes, closure

# name: (files, what is edited: file, before, after); house.main:f is what is measured.
SEEN = {
    "two definitions of one name change places": (
        {"main.py": "from house import a, b\ndef f(): return a.STEEL - b.STEEL\n", "a.py": "STEEL = 1\n", "b.py": "STEEL = 2\n"},
        [("a.py", "1", "3"), ("b.py", "2", "1"), ("a.py", "3", "2")],
    ),
    "the condition of an error that a caller answers": (
        {"main.py": "from house.a import g\ndef f():\n    try:\n        return g(1)\n    except ValueError:\n        return 0\n",
         "a.py": "def g(x):\n    if x < 0: raise ValueError('no')\n    return x\n"},
        [("a.py", "x < 0", "x < 9")],
    ),
    "the same below a function in between": (
        {"main.py": "import contextlib\nfrom house.a import g\ndef f():\n    with contextlib.suppress(ValueError):\n        return g(1)\n",
         "a.py": "def g(x): return h(x)\ndef h(x):\n    if x < 0: fail('x', 'more', x)\n    return x\n"},
        [("a.py", "x < 0", "x < 9")],
    ),
    "a name given a value in a condition": (
        {"main.py": "def f(x):\n    if (y := x + 1) < 0: raise ValueError\n    return y\n"},
        [("main.py", "x + 1", "x + 2")],
    ),
    "an error by which an iteration ends": (
        {"main.py": "class A:\n    def __getitem__(self, i):\n        if i > 3: raise IndexError\n        return i\ndef f(): return list(A())\n"},
        [("main.py", "i > 3", "i > 5")],
    ),
    "what a package does when it is imported": (
        {"__init__.py": "import torch\ntorch.set_default_dtype(torch.float32)\n", "main.py": "from house.a import g\ndef f(): return g()\n", "a.py": "def g(): return 1\n"},
        [("__init__.py", "float32", "float64")],
    ),
    "what a module does that is imported for it": (
        {"main.py": "import house.plugins\nfrom house.a import TABLE\ndef f(): return TABLE['k']\n", "a.py": "TABLE = {}\n", "plugins.py": "from house.a import TABLE\nTABLE['k'] = 1\n"},
        [("plugins.py", "= 1", "= 2")],
    ),
    "a part of what is imported gets a value": (
        {"main.py": "from house.a import TABLE\nTABLE['k'] = 7\ndef f(): return TABLE['m']\n", "a.py": "TABLE = {'m': 1}\n"},
        [("a.py", "'m': 1", "'m': 2")],
    ),
    "a name of a comprehension that is the module's outside": (
        {"main.py": "SALT = 1\ndef f():\n    [SALT for SALT in (1, 2)]\n    return SALT\n"},
        [("main.py", "SALT = 1", "SALT = 2")],
    ),
    "an import that is tried first": (
        {"main.py": "try:\n    from house.a import g\nexcept ImportError:\n    from house.b import g\ndef f(): return g()\n", "a.py": "def g(): return 1\n", "b.py": "def g(): return 2\n"},
        [("a.py", "return 1", "return 3")],
    ),
    "the other branch of TYPE_CHECKING": (
        {"main.py": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    X = 0\nelse:\n    X = 1\ndef f(): return X\n"},
        [("main.py", "X = 1", "X = 2")],
    ),
    "draws of one generator change places": (
        {"main.py": "import random\nR = random.Random(0)\nA = R.random()\nB = R.random()\ndef f(): return A\n"},
        [("main.py", "A = R.random()\nB = R.random()", "B = R.random()\nA = R.random()")],
    ),
    "what a module's own dict holds": (
        {"main.py": "from house import a\ndef f(): return a.__dict__['X']\n", "a.py": "X = 1\n"},
        [("a.py", "X = 1", "X = 2")],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SEEN)
def test_it_is_seen(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files, edits = SEEN[name]
    house = tmp_path / "house"
    house.mkdir()
    for file, text in {"__init__.py": "", **files}.items():
        (house / file).write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    before = closure("house.main:f", packages=("house",))
    for file, old, new in edits:
        text = (house / file).read_text()
        assert old in text
        (house / file).write_text(text.replace(old, new, 1))
    after = closure("house.main:f", packages=("house",))
    assert changes(before.text, after) and before.text != after.text


def test_words_of_an_error_that_a_caller_answers_do_not_count(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files, _ = SEEN["the condition of an error that a caller answers"]
    (tmp_path / "house").mkdir()
    for file, text in {"__init__.py": "", **files}.items():
        (tmp_path / "house" / file).write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    before = closure("house.main:f", packages=("house",))
    path = tmp_path / "house" / "a.py"
    path.write_text(path.read_text().replace("'no'", "f'{x} is too small'"))
    assert changes(before.text, closure("house.main:f", packages=("house",))) == []
