"""What a measurement runs lies in the closure of its definitions, or in that of a declared world.

The closure is found by reading; a function that is reached by a name put together while running
would be missed, and its edits would go unnoticed. So every measurement, training and world is run
at `tiny` here and watched.
"""

import ast
import functools
from pathlib import Path

import numpy as np
import pytest

from book.tools.contents import Page, pages
from book.tools.dependencies import KEEPING, open_world, roots_of
from book.tools.measuring import declared, import_experiments
from posecore.fingerprint import HOME, Closure, closure
from tests.book.watching import forget, watched, watched_run

pytestmark = pytest.mark.slow

NOT_COUNTED = tuple(str(HOME / name.replace(".", "/")) for name in KEEPING)
WORLDS = ("headset", "tabletop", "categories")


def _experiments() -> list[tuple[Page, str]]:
    found = []
    for page in pages():
        if (HOME / "book" / page.package / "experiments.py").is_file():
            _, measurements, trainings = declared(import_experiments(page))
            found += [(page, name) for name in (*measurements, *trainings)]
    return found


def strangers(ran: dict[Path, set[int]], *known: Closure) -> list[str]:
    """The functions that ran and lie in none of the closures."""
    ours: dict[Path, set[int]] = {}
    for one in known:
        for path, first, last in one.lines:
            ours.setdefault(path, set()).update(range(first, last + 1))
    found = set()
    for path, lines in ran.items():
        if str(path).startswith(NOT_COUNTED):
            continue
        for line in lines - ours.get(path, set()):
            for first, last, name in functions(path):
                if first <= line <= last:
                    found.add(f"{path.relative_to(HOME)}: {name}")
    return sorted(found)


@functools.cache
def functions(path: Path) -> list[tuple[int, int, str]]:
    """First and last line of the body of every function; what stands outside only imports run."""
    tree = ast.parse(path.read_bytes())
    kinds = ast.FunctionDef | ast.AsyncFunctionDef
    return [
        (node.body[0].lineno, node.end_lineno or 0, node.name)
        for node in ast.walk(tree)
        if isinstance(node, kinds)
    ]


@pytest.mark.parametrize(
    ("page", "name"), _experiments(), ids=lambda value: getattr(value, "name", value)
)
def test_what_a_measurement_runs_and_opens_is_known(page: Page, name: str, shared_cache: Path):
    _, measurements, trainings = declared(import_experiments(page))
    one = measurements.get(name) or trainings[name]
    result, ran, opened = watched_run(page, name, shared_cache)
    worlds = {open_world(source, "tiny").world for source in one.data}
    known = [closure(*world.code, refusals=True) for world in worlds]
    assert (
        strangers(
            ran, closure(*roots_of(one.function, one.data), without=KEEPING, refusals=True), *known
        )
        == []
    )
    assert len(ran) > 5
    assert opened == set(one.data)
    if name in measurements:
        claims = [c for c in import_experiments(page).CLAIMS if c.measurement == name]
        assert claims and {side for c in claims for side in (c.favoured, c.other)} <= set(result)
        assert all(np.isfinite(value) for value in result.values())


@pytest.mark.parametrize("name", WORLDS)
def test_what_a_world_runs_is_known(name: str):
    world = open_world(f"{name}/train", "tiny").world
    known = closure(*world.code, refusals=True)
    recipes = {split: world.recipe(split, "tiny") for split in world.splits}
    makers = [world.models.makers[object_id] for object_id in world.models.ids[:3]]
    forget()
    with watched() as ran:
        for split, recipe in recipes.items():
            for index in range(5 if split == "train" else 2):
                world.views(recipe, index, world.record(recipe, index))
        for make in makers:
            make()
    assert strangers(ran, known) == []
    assert HOME / "data_tools" / "renderer" / "shading.py" in ran


def test_the_watch_sees_what_is_missing():
    """By names put together while running."""
    world = open_world("tabletop/train", "tiny").world
    recipe = world.recipe("train", "tiny")
    forget()
    with watched() as ran:
        world.record(recipe, 0)
    known = closure("data_tools.worlds.tabletop:intrinsics", refusals=True)
    found = strangers(ran, known)
    assert "data_tools/worlds/tabletop.py: record" in found
    assert "data_tools/worlds/tabletop.py: intrinsics" not in found
