import functools
import importlib
import pickle
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import data_tools
from data_tools import Dataset, View
from data_tools.shapes import make_object
from data_tools.worlds import tabletop
from data_tools.worlds.world import Size, World, WorldModels, generator

K = np.array([[50.0, 0, 3], [0, 50, 2], [0, 0, 1]])
CALLS = []


def record(recipe, index):
    CALLS.append(index)
    shape = recipe["height"], recipe["width"], 3
    start = generator(recipe, index).integers(1000)
    return {"start": int(start), "rgb": np.full(shape, index, np.uint8)}


def views(recipe, index, record):
    return [
        View(K=K, scene_id=0, image_id=2 * index + i, rgb=record["rgb"], group=(index,))
        for i in range(2)
    ]


SIZES = {
    "tiny": Size(4, 3, {"train": 5, "test": 3}),
    "book": Size(8, 6, {"train": 9, "test": 3}),
    "paper": Size(8, 6, {"train": 90, "test": 3}),
}
PAIRS = World(
    name="pairs",
    sizes=SIZES,
    record=record,
    views=views,
    object_ids=(3, 1),
    views_per_record=2,
    shard_size=2,
)


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("POSECORE_CACHE", str(tmp_path))
    monkeypatch.setenv("POSECORE_SCALE", "tiny")
    CALLS.clear()
    return tmp_path


def open_pairs(**options):
    return PAIRS.open(**{"split": "train", "processes": 1, "progress": False} | options)


def test_a_dataset_makes_itself_once():
    dataset = open_pairs()
    assert isinstance(dataset, Dataset)
    assert len(dataset) == 10
    assert dataset.object_ids == (1, 3)
    assert repr(dataset) == "WorldDataset('pairs', 'train': 10 views)"
    assert not CALLS, "nothing is made before it is asked for"
    assert [view.image_id for view in dataset] == list(range(10))
    assert sorted(CALLS) == list(range(5))
    assert [view.group for view in dataset] == [(i // 2,) for i in range(10)]
    assert dataset[-1].image_id == 9
    assert dataset[np.int64(3)].shape == (3, 4)
    again = open_pairs()
    assert again[7].rgb.flat[0] == 3
    assert sorted(CALLS) == list(range(5)), "the cache is used"


def test_a_few_views_need_not_the_whole_split():
    assert open_pairs(whole=False)[6].image_id == 6
    assert sorted(CALLS) == [2, 3], "the file in which record 3 is"


def test_a_damaged_file_is_made_again():
    dataset = open_pairs()
    _ = dataset[0]
    path = dataset.store.path(1)
    path.write_bytes(path.read_bytes()[:-3])
    with pytest.warns(UserWarning, match="made again"):
        assert open_pairs()[5].image_id == 5


def test_views_of_one_record_are_read_once():
    dataset = open_pairs()
    assert dataset[4].rgb is dataset[5].rgb
    assert dataset[4].rgb is not dataset[6].rgb


def test_no_such_view():
    dataset = open_pairs()
    for index in (10, -11):
        with pytest.raises(IndexError, match="no view"):
            dataset[index]
    with pytest.raises(TypeError):
        dataset[1.0]
    assert not CALLS


def test_datasets_can_be_pickled():
    dataset = open_pairs()
    first = dataset[2]
    other = pickle.loads(pickle.dumps(dataset))
    assert other[2].image_id == first.image_id
    assert len(other) == len(dataset)


def test_scales_and_recipes(monkeypatch):
    assert PAIRS.splits == ("train", "test")
    assert PAIRS.recipe("test") == PAIRS.recipe("test", "tiny")
    assert PAIRS.recipe("train", "book") == {
        "world": "pairs",
        "split": "train",
        "scale": "book",
        "width": 8,
        "height": 6,
        "seed": 0,
    }
    monkeypatch.setenv("POSECORE_SCALE", "book")
    assert len(open_pairs()) == 18
    assert len(open_pairs(scale="paper", split="test")) == 6
    stores = {
        PAIRS.store(split, scale).folder
        for split in PAIRS.splits
        for scale in ("tiny", "book", "paper")
    }
    assert len(stores) == 6


@given(
    index=st.integers(0, 10**9),
    other=st.integers(0, 10**9),
    split=st.sampled_from(("train", "test")),
)
def test_random_numbers_belong_to_the_record(index, other, split):
    def draw(world, split, scale, index):
        return generator(world.recipe(split, scale), index).random(3).tolist()

    here = draw(PAIRS, split, "tiny", index)
    assert here == draw(PAIRS, split, "book", index), "the same at every scale"
    rest = "test" if split == "train" else "train"
    assert here != draw(PAIRS, rest, "tiny", index)
    assert here != draw(replace(PAIRS, name="others"), split, "tiny", index)
    assert here != draw(replace(PAIRS, seed=1), split, "tiny", index)
    assert (here == draw(PAIRS, split, "tiny", other)) == (index == other)


MADE_UP = """
import functools

from data_tools.shapes import make_object
from data_tools.worlds.world import Size, World, WorldModels

FAINTEST = 7
TALLEST = 3


def record(recipe, index):
    return {"shade": FAINTEST + index}


def views(recipe, index, record):
    return [index]


def mesh(number):
    return make_object(number + TALLEST)


def nobody():
    return 1


MODELS = WorldModels({1: functools.partial(mesh, 1)})
SIZES = {scale: Size(4, 3, {"train": 5}) for scale in ("tiny", "book", "paper")}
WORLD = World(
    name="made-up", sizes=SIZES, record=record, views=views, object_ids=(1,), models=MODELS
)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "old, new, counts",
    [
        ("FAINTEST = 7", "FAINTEST = 8", True),
        ("return [index]", "return [index, index]", True),
        ("TALLEST = 3", "TALLEST = 4", True),
        ("return 1", "return 2", False),
        ("FAINTEST = 7", "FAINTEST = 7  # of 255", False),
        ("def mesh(number):", 'def mesh(number: int):\n    """The only one."""', False),
        ("(4, 3,", "(4, 6,", True),  # by its recipe
        ("5}", "6}", True),
    ],
)
def test_a_world_lies_where_its_own_code_and_recipe_say(old, new, counts, tmp_path, monkeypatch):
    """Of records, views and meshes: what is edited elsewhere makes no world anew."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    folders = []
    for text in (MADE_UP, MADE_UP.replace(old, new)):
        (tmp_path / "made_up_world.py").write_text(text)
        sys.modules.pop("made_up_world", None)
        importlib.invalidate_caches()
        world = importlib.import_module("made_up_world").WORLD
        assert [code.__name__ for code in world.code[:2]] == ["record", "views"]
        folders.append(world.store("train", "book").folder)
    del sys.modules["made_up_world"]
    assert MADE_UP != text and (folders[0] != folders[1]) == counts


def test_models():
    meshes = {5: make_object(4), 2: make_object(3)}
    asked = []

    def make(object_id):
        asked.append(object_id)
        return meshes[object_id]

    models = WorldModels({number: functools.partial(make, number) for number in meshes})
    assert models.ids == (2, 5)
    assert repr(models) == "WorldModels(objects [2, 5])"
    assert not asked
    for object_id, mesh in meshes.items():
        info = models.info(object_id)
        assert models.mesh(object_id) is mesh
        assert info.diameter == mesh.diameter
        assert np.array_equal(info.size, np.ptp(mesh.vertices, axis=0))
    assert np.array_equal(models.info(5).symmetries(), meshes[5].symmetries)
    assert sorted(asked) == [2, 5]  # each once
    vase = models.info(2)
    assert not len(vase.symmetries_discrete)
    assert np.array_equal(vase.symmetries_continuous[0][0], [0, 0, 1])
    turn = vase.symmetries()[1, :3, :3]
    assert 0 < np.arccos((np.trace(turn) - 1) / 2) <= 0.0201


def test_the_door():
    dataset = data_tools.open("tabletop", split="easy")
    assert dataset.world is tabletop.WORLD
    assert dataset.store.recipe["scale"] == "tiny"
    assert len(dataset) == 10
    assert len(data_tools.open("tabletop", split="train", scale="paper")) == 20_000


@pytest.mark.slow
def test_one_process_or_two(cache):
    small = {"tiny": Size(32, 24, {"easy": 4})}
    world = replace(tabletop.WORLD, name="small", sizes=small, shard_size=2)
    files = []
    for processes in (1, 2):
        store = world.store("easy")
        assert store.make(processes, progress=False) == 2
        files.append({p.name: p.read_bytes() for p in sorted(store.folder.iterdir())})
        for path in store.folder.iterdir():
            path.unlink()
    assert files[0] == files[1]
    assert len(files[0]) == 3


SCRIPT = """
import sys
from dataclasses import replace
from data_tools.worlds import tabletop
from data_tools.worlds.world import Size
print("begun")
world = replace(
    tabletop.WORLD, name="small", sizes={"tiny": Size(16, 12, {"easy": 4})}, shard_size=1
)
dataset = world.open(split="easy", processes=2, progress=False)
print([view.image_id for view in dataset])
print(__file__ == sys.argv[0], __spec__)
"""


@pytest.mark.slow
def test_a_script_needs_no_main_guard(tmp_path):
    """Other processes do not run it again, and it gets back what is hidden from them."""
    path = tmp_path / "script.py"
    path.write_text(SCRIPT)
    done = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, timeout=100)
    assert done.stderr == ""
    assert done.stdout.splitlines() == ["begun", "[0, 1, 2, 3]", "True None"]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: open_pairs(split="easy"), "split: expected one of 'train', 'test', got 'easy'"),
        (lambda: open_pairs(split=None), "split"),
        (lambda: open_pairs(split=5), "split"),
        (lambda: open_pairs(scale="huge"), "scale"),
        (lambda: open_pairs(processes=0)[0], "processes"),
        (lambda: PAIRS.open("somewhere", split="train"), "source: expected just 'pairs'"),
        (lambda: PAIRS.recipe("easy"), "split"),
        (lambda: PAIRS.store("train", "huge"), "scale"),
        (lambda: open_pairs().models(), "dataset: expected one of fixed objects"),
        (lambda: tabletop.WORLD.models.info(9), "object_id"),
        (lambda: tabletop.WORLD.models.mesh("duck"), "object_id"),
        (lambda: data_tools.open("tabletop"), "split"),
        (lambda: data_tools.open("tabletop:x", split="train"), "source"),
        (lambda: data_tools.open("tabletop", split="test"), "split"),
        (lambda: data_tools.open("tabletop", split="easy", scale="small"), "scale"),
    ],
)
def test_bad_input_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_a_bad_scale_in_the_environment(monkeypatch):
    monkeypatch.setenv("POSECORE_SCALE", "small")
    with pytest.raises(ValueError, match="POSECORE_SCALE"):
        open_pairs()
