"""What runs while a chapter measures: each measurement is run at `tiny` once for all its tests."""

import pickle
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import coverage
import pytest
import torch

from book.tools.contents import Page
from book.tools.measuring import declared, import_experiments
from data_tools.storage.locks import file_lock
from data_tools.worlds.redrawn import Redrawn
from data_tools.worlds.world import WorldDataset
from posecore.fingerprint import HOME, PACKAGES

OURS = tuple(f"{HOME / package}/" for package in PACKAGES)


class Watched(NamedTuple):
    """What a measurement with seed 0, or a training, gave; the lines that ran; what it opened."""

    result: Any
    ran: dict[Path, set[int]]
    opened: set[str]


def watched_run(page: Page, name: str, shared_cache: Path) -> Watched:
    """Of whoever asks first, in whichever process of this run.

    The worlds are those of all tests, the trainings are its own. One that an earlier measurement
    has run is found again: what a training runs is watched where it runs first.
    """
    cache, worlds = shared_cache / "watched", shared_cache / "worlds"
    cache.mkdir(exist_ok=True)
    kept = cache / f"{page.name}-{name}.pickle"
    with file_lock(cache / "run"):
        if not kept.exists():
            if not (cache / "worlds").exists():
                worlds.mkdir(exist_ok=True)
                (cache / "worlds").symlink_to(worlds, target_is_directory=True)
            kept.write_bytes(pickle.dumps(_run(page, name, cache)))
        return pickle.loads(kept.read_bytes())


def _run(page: Page, name: str, cache: Path) -> Watched:
    forget()
    with pytest.MonkeyPatch.context() as patch, torch.random.fork_rng(), afresh(page):
        patch.setenv("POSECORE_CACHE", str(cache))
        _, measurements, trainings = declared(import_experiments(page))
        with opening(patch) as opened, watched() as ran:
            if name in measurements:
                result = measurements[name].function(0)
            else:
                result = trainings[name].function()
    forget()
    return Watched(result if name in measurements else None, ran, opened)


@contextmanager
def afresh(page: Page) -> Iterator[None]:
    """A chapter's modules are imported again, with nothing in their caches."""

    def loaded() -> dict[str, ModuleType]:
        package = f"book.{page.package}"
        return {n: m for n, m in sys.modules.items() if f"{n}.".startswith(f"{package}.")}

    before, parent = loaded(), sys.modules["book"]
    package = getattr(parent, page.package, None)
    for name in before:
        del sys.modules[name]
    try:
        yield
    finally:
        for name in loaded():
            del sys.modules[name]
        sys.modules.update(before)
        if package is not None:
            setattr(parent, page.package, package)


@contextmanager
def opening(patch: pytest.MonkeyPatch) -> Iterator[set[str]]:
    """The datasets that are opened, or some of whose instants are drawn in other light."""
    found: set[str] = set()
    init, redraw = WorldDataset.__init__, Redrawn.__init__

    def noting(self: WorldDataset, world: object, split: str, *more: object, **options: object):
        init(self, world, split, *more, **options)
        found.add(f"{self.world.name}/{split}")

    def drawing(self: Redrawn, indices: object, **conditions: object):
        redraw(self, indices, **conditions)
        found.add(f"headset/{conditions['split']}")

    patch.setattr(WorldDataset, "__init__", noting)
    patch.setattr(Redrawn, "__init__", drawing)
    yield found


@contextmanager
def watched() -> Iterator[dict[Path, set[int]]]:
    """The lines of this project that run inside, in any thread, by file."""
    ran: dict[Path, set[int]] = {}
    watch = coverage.Coverage(data_file=None, config_file=False, include=[f"{o}*" for o in OURS])
    watch.start()
    try:
        yield ran
    finally:
        watch.stop()
        data = watch.get_data()
        ran |= {Path(file): set(data.lines(file) or ()) for file in data.measured_files()}


def forget() -> None:
    """Let nothing of before be found in what modules keep in memory."""
    for name, module in list(sys.modules.items()):
        if name.startswith("book.ch") or name.startswith("data_tools."):
            for thing in vars(module).values():
                if hasattr(thing, "cache_clear"):
                    thing.cache_clear()
