"""What a measurement runs lies in the closure of its definitions, or in that of a declared world.

The closure is found by reading; a function that is reached by a name put together while running
would be missed, and its edits would go unnoticed. So every measurement, training and world is run
at `tiny` here and watched.
"""

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import CodeType, FrameType

import pytest
import torch

from book.tools.contents import Page, pages
from book.tools.dependencies import KEEPING, code_of, open_world
from book.tools.measuring import declared, import_experiments
from data_tools.worlds.world import WorldDataset
from posecore.fingerprint import HOME, PACKAGES, Closure, closure

pytestmark = pytest.mark.slow

OURS = tuple(f"{HOME / package}/" for package in PACKAGES)
NOT_COUNTED = tuple(str(HOME / name.replace(".", "/")) for name in KEEPING)
WORLDS = ("headset", "tabletop", "categories")


def _experiments() -> list[tuple[Page, str]]:
    found = []
    for page in pages():
        if (HOME / "book" / page.package / "experiments.py").is_file():
            _, measurements, trainings = declared(import_experiments(page))
            found += [(page, name) for name in (*measurements, *trainings)]
    return found


@contextmanager
def watched() -> Iterator[set[CodeType]]:
    """The code of this project that runs inside, without what only an import runs."""
    ran: set[CodeType] = set()

    def look(frame: FrameType, event: str, argument: object) -> None:
        code = frame.f_code
        if code in ran or not code.co_filename.startswith(OURS) or code.co_name == "<module>":
            return
        above = frame.f_back
        while above is not None:
            if above.f_code.co_name == "<module>" and above.f_code.co_filename.startswith(OURS):
                return
            above = above.f_back
        ran.add(code)

    before = sys.gettrace()
    threading.settrace(look)
    sys.settrace(look)
    try:
        yield ran
    finally:
        sys.settrace(before)
        threading.settrace(None)  # type: ignore[arg-type]


def strangers(ran: set[CodeType], *known: Closure) -> list[str]:
    """What ran and lies in none of the closures."""
    lines: dict[str, set[int]] = {}
    for one in known:
        for path, first, last in one.lines:
            lines.setdefault(str(path), set()).update(range(first, last + 1))
    found = {
        f"{Path(code.co_filename).relative_to(HOME)}:{code.co_firstlineno} {code.co_qualname}"
        for code in ran
        if code.co_firstlineno not in lines.get(code.co_filename, set())
        and not code.co_filename.startswith(NOT_COUNTED)
    }
    return sorted(found)


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """The datasets that are opened."""
    found: set[str] = set()
    init = WorldDataset.__init__

    def noting(self: WorldDataset, world: object, split: str, *more: object, **options: object):
        init(self, world, split, *more, **options)
        found.add(f"{self.world.name}/{split}")

    monkeypatch.setattr(WorldDataset, "__init__", noting)
    return found


@pytest.fixture
def fresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Nothing of earlier runs: no cache on disk, and none in the modules of a chapter."""
    monkeypatch.setenv("POSECORE_CACHE", str(tmp_path))
    forget()
    yield
    forget()


def forget() -> None:
    for name, module in list(sys.modules.items()):
        if name.startswith("book.ch") or name.startswith("data_tools."):
            for thing in vars(module).values():
                if hasattr(thing, "cache_clear"):
                    thing.cache_clear()


@pytest.mark.usefixtures("fresh")
@pytest.mark.parametrize(
    ("page", "name"), _experiments(), ids=lambda value: getattr(value, "name", value)
)
def test_what_a_measurement_runs_and_opens_is_known(page: Page, name: str, opened: set[str]):
    _, measurements, trainings = declared(import_experiments(page))
    one = measurements.get(name) or trainings[name]
    run: Callable[[], object] = (
        (lambda: one.function(0)) if name in measurements else (lambda: one.function())
    )
    with torch.random.fork_rng(), watched() as ran:
        run()
    worlds = {open_world(source, "tiny").world for source in one.data}
    known = [closure(*world.code, refusals=True) for world in worlds]
    assert strangers(ran, code_of(one.function, one.data, refusals=True), *known) == []
    assert len(ran) > 10
    assert opened == set(one.data)


@pytest.mark.parametrize("name", WORLDS)
def test_what_a_world_runs_is_known(name: str):
    world = open_world(f"{name}/train", "tiny").world
    known = closure(*world.code, refusals=True)
    forget()
    with watched() as ran:
        for split in world.splits:
            recipe = world.recipe(split, "tiny")
            for index in range(5 if split == "train" else 2):
                world.views(recipe, index, world.record(recipe, index))
        for object_id in world.models.ids[:3]:
            world.models.makers[object_id]()
    assert strangers(ran, known) == []
    assert any(code.co_filename.endswith("renderer/shading.py") for code in ran)


def test_the_watch_sees_what_is_missing():
    """By names put together while running."""
    world = open_world("tabletop/train", "tiny").world
    recipe = world.recipe("train", "tiny")
    forget()
    with watched() as ran:
        world.record(recipe, 0)
    known = closure("data_tools.worlds.tabletop:intrinsics", refusals=True)
    found = strangers(ran, known)
    assert any("record" in line for line in found)
    assert not any(line.endswith(" intrinsics") for line in found)
