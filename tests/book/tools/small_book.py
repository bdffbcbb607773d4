"""A small book named folio, that stands beside the real one: what tests of its tools share."""

import importlib
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from book.tools.claims import Claim
from book.tools.keys import Key
from book.tools.ledger import Measurement

NAMES = ("index", "01_poses", "02_worlds", "03_more")
CONTENTS = "".join(f'[[page]]\nname = "{name}"\n' for name in NAMES)
A, B = Key("a"), Key("b")
CLAIM = Claim(
    id="c",
    statement="a is lower",
    source="Table 1",
    measurement="m",
    favoured=A,
    other=B,
    better="lower",
    unit="mm",
    paper=(1.0, None),
)
HELPER = '''"""A helper."""

OFFSET = 0.125


def shift():
    """What is added."""
    return OFFSET


def unrelated():
    return 3
'''
MEASURED = '''"""What is measured."""

import os
import time

import data_tools
from book.tools.keys import Key
from folio.ch01_poses.helper import shift
from posecore.scale import choose

SIZE = choose(tiny=1, book=2, paper=3)
LOG = os.environ.get("MEASURED_LOG")
calls = []


def note(text):
    if LOG:
        with open(LOG, "a") as file:
            file.write(text + "\\n")
        time.sleep(0.05)


def table(seed):
    calls.append(seed)
    note(f"start {seed}")
    note(f"end {seed}")
    return {Key("a"): seed / 3 + shift() + SIZE, Key("b"): 2 * seed / 3 + 3.5}


def other(seed):
    return {Key("a"): 1.0, Key("b"): 2.0 + seed, Key("c"): 0.0}


def seen(seed):
    calls.append(seed)
    views = data_tools.open("specks", split="train")
    total = sum(int(view.rgb.max()) for view in views)
    return {Key("a"): total + seed, Key("b"): 2 * total + seed * 7.0}


nested = lambda seed: table(seed)
'''
SPECKS = '''"""A world of a few specks."""

import numpy as np

from data_tools.views import View
from data_tools.worlds.world import Size, World, generator

SIZES = {
    "tiny": Size(4, 3, {"train": 3, "test": 2}),
    "book": Size(4, 3, {"train": 4, "test": 2}),
    "paper": Size(4, 3, {"train": 9, "test": 2}),
}
FAINTEST = 7


def record(recipe, index):
    """One speck."""
    shade = int(generator(recipe, index).integers(200)) + FAINTEST
    return {"rgb": np.full((recipe["height"], recipe["width"], 3), shade, np.uint8)}


def views(recipe, index, record):
    K = np.array([[50.0, 0, 2], [0, 50, 1], [0, 0, 1]])
    return [View(K=K, scene_id=0, image_id=index, rgb=record["rgb"])]


WORLD = World(name="specks", sizes=SIZES, record=record, views=views, object_ids=(1,))
'''
EXPERIMENTS = '''"""What the chapter measures and trains."""

import torch

from book.tools.checkpoints import Training
from book.tools.claims import Claim
from book.tools.keys import Key
from book.tools.ledger import Measurement
from folio.ch01_poses.measured import other, table
from posecore.scale import choose

SIDES = {"favoured": Key("a"), "other": Key("b")}
CLAIMS = [
    Claim(id="one", statement="a is lower", source="Table 1", measurement="other", **SIDES,
          better="lower", unit="mm", paper=(1.0, None)),
    Claim(id="two", statement="a is higher", source="Table 2", measurement="table", **SIDES,
          better="higher", paper=(1.0, 2.0)),
]
MEASUREMENTS = {
    "table": Measurement(table, range(5)),
    "other": Measurement(other, [0, 1, 2]),
}


def net():
    layer = torch.nn.Linear(3, 2)
    state = dict(layer.state_dict())
    return {**state, "tied": state["weight"], "turned": state["weight"].T}


def bigger():
    return {"w": torch.zeros(choose(tiny=10, book=100, paper=1000))}


CHECKPOINTS = {"net": Training(net), "bigger": Training(bigger)}
'''
SCRIPTS = {
    "__init__": "",
    "ch01_poses/__init__": "",
    "ch01_poses/helper": HELPER,
    "ch01_poses/measured": MEASURED,
    "ch01_poses/specks": SPECKS,
    "ch01_poses/experiments": EXPERIMENTS,
}


def write_folio(folder: Path) -> Path:
    """The folder of the book, made in a folder that must be on the path for imports."""
    book = folder / "folio"
    (book / "site").mkdir(parents=True)
    (book / "site" / "contents.toml").write_text(CONTENTS)
    for name, text in SCRIPTS.items():
        path = book / f"{name}.py"
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    return book


def forget() -> None:
    """Let what was edited be imported anew, as in another process."""
    for name in [name for name in sys.modules if name.partition(".")[0] == "folio"]:
        del sys.modules[name]
    importlib.invalidate_caches()


def edit(path: Path, *changes: tuple[str, str]) -> None:
    """Replace texts in a file; each must be there."""
    text = path.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")


def copied(book: Path, to: Path) -> Path:
    """The book elsewhere, with nothing measured."""
    return shutil.copytree(book, to, ignore=shutil.ignore_patterns("claims.json", "__pycache__"))


def due(seed: int) -> dict[Key, float]:
    """What `table` gives at book scale."""
    return {A: seed / 3 + 2.125, B: 2 * seed / 3 + 3.5}


def texts(numbers: dict[Key, float]) -> dict[str, float]:
    """Numbers as JSON holds them."""
    return {str(key): number for key, number in numbers.items()}


def of(function: Callable[..., Any], seeds: object = range(3), **more: Any) -> Measurement:
    """A measurement over three seeds."""
    return Measurement(function, seeds, **more)
