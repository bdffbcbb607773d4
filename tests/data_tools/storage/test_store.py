"""A world on disk: what is read is what was made, and every damage is found, named and mended."""

import errno
import json
import os
import pickle
import re
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_tools.storage import DamagedShard, DamageWarning, MakingError, Store, records
from data_tools.storage import store as module
from tests.data_tools.storage.small_worlds import COUNT, RECIPE, SHARD_SIZE, files, make, world

SHARDS = 8  # 23 records, 3 in each


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """The world, made without disturbance; not to be changed."""
    store = world(tmp_path_factory.mktemp("whole"))
    assert store.make(1, progress=False) == SHARDS
    return store


@pytest.fixture
def store(whole, tmp_path):
    """A copy of it."""
    store = world(tmp_path)
    shutil.copytree(whole.folder, store.folder)
    return store


def assert_same(record, expected):
    assert record.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_array_equal(record[name], value)
        assert getattr(record[name], "dtype", None) == getattr(value, "dtype", None)


def test_records_come_back(whole):
    assert len(whole) == COUNT
    for i in np.random.default_rng(0).permutation(COUNT):
        assert_same(whole[i], make(RECIPE, int(i)))
    assert [record["index"] for record in whole] == list(range(COUNT))
    assert whole[-1]["index"] == COUNT - 1
    assert whole[np.int64(4)]["index"] == 4
    for index in (COUNT, -COUNT - 1):
        with pytest.raises(IndexError, match=f"no record {index} among {COUNT}"):
            whole[index]
    for index in (slice(3), 1.0, "1"):
        with pytest.raises(TypeError):
            whole[index]


def test_a_record_is_the_callers_own(whole):
    whole[3]["depth"][:] = -1
    assert_same(whole[3], make(RECIPE, 3))


@settings(max_examples=15)
@given(
    count=st.integers(0, 12),
    shard_size=st.integers(1, 14),
    index=st.integers(0, 11),
    parts=st.integers(1, 5),
)
def test_any_division(tmp_path_factory, count, shard_size, index, parts):
    folder = tmp_path_factory.mktemp("world")
    store = Store(
        "any", {}, count, lambda _, i: {"i": i}, version="1", shard_size=shard_size, folder=folder
    )
    assert store.shards == len(store.missing()) == -(-count // shard_size)
    made = [store.make(1, part=(i, parts), progress=False) for i in range(1, parts + 1)]
    assert sum(made) == store.shards
    assert max(made) - min(made) <= 1
    assert store.missing() == store.check() == []
    assert [record["i"] for record in store] == list(range(count))
    if index < count:
        assert store[index] == {"i": index}


def test_what_is_there_is_not_made_again(store):
    before = {p: p.stat().st_mtime_ns for p in store.folder.iterdir()}
    assert store.make(1) == 0
    assert {p: p.stat().st_mtime_ns for p in store.folder.iterdir()} == before


def test_only_what_is_missing_is_made(store, tmp_path):
    for number in (2, 7):
        store.path(number).unlink()
    calls = []

    def counted(recipe, index):
        calls.append(index)
        return make(recipe, index)

    again = world(tmp_path, counted)
    assert again.missing() == [2, 7]
    assert again.make(progress=False) == 2  # a function of this test: made here
    assert sorted(calls) == [6, 7, 8, 21, 22]


def test_a_missing_shard_is_made_when_a_record_is_asked_for(whole, tmp_path):
    store = world(tmp_path)
    assert_same(store[10], make(RECIPE, 10))
    assert sorted(p.name for p in store.folder.iterdir()) == ["000003.shard", "recipe.json"]
    assert_same(store[11], make(RECIPE, 11))
    shutil.rmtree(store.folder)  # somebody cleans the cache meanwhile
    assert_same(store[11], make(RECIPE, 11))
    assert store.path(3).read_bytes() == whole.path(3).read_bytes()


def test_recipes_are_told_apart(whole, tmp_path):
    def key(name="small", recipe=RECIPE, count=COUNT, version="1", shard_size=SHARD_SIZE):
        return Store(name, recipe, count, version=version, shard_size=shard_size).key

    assert key() == whole.key
    assert key(recipe=dict(reversed(RECIPE.items()))) == whole.key
    assert key(recipe=RECIPE | {"size": (6, 4)}) == whole.key
    others = [
        key(name="large"),
        key(recipe=RECIPE | {"seed": 6}),
        key(recipe=RECIPE | {"more": None}),
        key(recipe=RECIPE | {"size": [4, 6]}),
        key(count=22),
        key(version="2"),
        key(shard_size=4),
    ]
    assert len({whole.key, *others}) == 1 + len(others)


def test_the_function_gets_the_same_recipe_every_time(tmp_path):
    seen = []

    def careless(recipe, index):
        seen.append(json.dumps(recipe))
        recipe["a"].append(index)
        return {}

    Store("x", {"b": {"d": 1, "c": 2}, "a": (1,)}, 5, careless, version="1", folder=tmp_path).make()
    assert seen == ['{"a": [1], "b": {"c": 2, "d": 1}}'] * 5


def test_the_folder_says_what_is_in_it(whole):
    text = json.loads((whole.folder / "recipe.json").read_text())
    assert text == {
        "format": 1,
        "name": "small",
        "recipe": RECIPE,
        "count": COUNT,
        "shard_size": SHARD_SIZE,
        "version": "1",
    }


def test_the_folder_is_in_the_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("POSECORE_CACHE", str(tmp_path))
    store = world(None)
    assert store.folder == tmp_path / "worlds" / "small" / store.key[:16]
    assert not store.folder.exists(), "nothing is written before something is made"
    assert repr(store) == f"Store('small', 23 records in {str(store.folder)!r})"


def test_a_store_goes_to_other_processes(whole):
    whole[5]
    assert_same(pickle.loads(pickle.dumps(whole))[5], make(RECIPE, 5))


def flip(data, position):
    return data[:position] + bytes([data[position] ^ 1]) + data[position + 1 :]


DAMAGES = {
    "flipped in the magic": lambda data, _: flip(data, 0),
    "flipped in the length": lambda data, _: flip(data, 11),
    "flipped in the checksum": lambda data, _: flip(data, 13),
    "flipped in the index": lambda data, _: flip(data, 30),
    "flipped in a record": lambda data, _: flip(data, len(data) // 2),
    "flipped at the end": lambda data, _: flip(data, len(data) - 1),
    "a byte short": lambda data, _: data[:-1],
    "half": lambda data, _: data[: len(data) // 2],
    "only its start": lambda data, _: data[:10],
    "empty": lambda *_: b"",
    "longer": lambda data, _: data + b"\0",
    "zeros": lambda data, _: bytes(len(data)),
    "another shard": lambda _, store: store.path(3).read_bytes(),
}


@pytest.mark.parametrize("kind", DAMAGES)
def test_damage_is_found_named_and_mended(store, whole, tmp_path, kind):
    path = store.path(2)
    damaged = DAMAGES[kind](path.read_bytes(), store)
    path.write_bytes(damaged)

    reading = world(tmp_path, None)
    (problem,) = reading.check()
    assert str(path) in problem
    with pytest.raises(DamagedShard, match=r"000002\.shard"):
        [reading[i] for i in (6, 7, 8)]
    with pytest.raises(ValueError, match="function: expected one that makes records, got none"):
        reading.make()
    assert path.read_bytes() == damaged, "a store that only reads leaves it as it is"
    assert_same(reading[9], make(RECIPE, 9))

    with pytest.warns(DamageWarning, match=r"000002\.shard.*made again") as warnings:
        mended = [world(tmp_path)[i] for i in (6, 7, 8)]
    assert len(warnings) == 1
    for i, record in enumerate(mended, 6):
        assert_same(record, make(RECIPE, i))
    assert files(store) == files(whole)

    path.write_bytes(damaged)
    with pytest.warns(DamageWarning, match=r"000002\.shard"):
        assert store.make(1, progress=False) == 1
    assert files(store) == files(whole)
    assert store.check() == []


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="needs a file that fails to read")
def test_a_bad_disk(store, whole, tmp_path):
    """Where reading fails the system does not say in which file."""
    store.path(2).unlink()
    store.path(2).symlink_to("/proc/self/mem")
    text = r"000002\.shard: cannot be read: Input/output error"
    (problem,) = store.check()
    assert re.search(text, problem)
    with pytest.raises(DamagedShard, match=text):
        world(tmp_path, None)[6]
    with pytest.warns(DamageWarning, match=text):
        assert store.make(1, progress=False) == 1
    assert files(store) == files(whole)


def test_what_is_no_file_is_named(store):
    """And the check goes on."""
    store.path(2).unlink()
    store.path(2).mkdir()
    store.path(5).write_bytes(b"")
    strange, empty = store.check()
    assert strange == f"{store.path(2)}: cannot be opened: Is a directory"
    assert empty == f"{store.path(5)}: empty file"
    with pytest.raises(IsADirectoryError, match=r"000002\.shard"):
        store.make(1, progress=False)


def test_damage_that_cannot_be_mended(store, monkeypatch):
    store.path(2).write_bytes(b"")

    def refuse(*_, **__):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(Path, "unlink", refuse)
    text = r"000002\.shard: empty file; it cannot be deleted: Read-only file system"
    for try_it in (lambda: store[6], lambda: store.make(1, progress=False)):
        with pytest.raises(MakingError, match=text):
            try_it()


def test_a_shard_of_another_world_is_refused(store, whole, tmp_path):
    other = world(tmp_path / "other", seed=6)
    other.make(1, progress=False)
    shutil.copy(other.path(2), store.path(2))
    assert store.missing() == [2]
    with pytest.raises(DamagedShard, match=f"another world, with the key {other.key[:16]}"):
        world(tmp_path, None)[6]
    with pytest.warns(DamageWarning, match="another world"):
        store.make(1, progress=False)
    assert files(store) == files(whole)


def test_damage_after_the_index_was_read(store):
    """What a store remembers of a file is no reason to trust it."""
    store[6]
    store.path(2).write_bytes(flip(store.path(2).read_bytes(), -1))
    with pytest.warns(DamageWarning):
        assert_same(store[8], make(RECIPE, 8))
    store.path(2).write_bytes(b"")
    with pytest.warns(DamageWarning):
        assert_same(store[6], make(RECIPE, 6))


def test_damage_in_a_file_from_elsewhere(tmp_path, monkeypatch):
    """Another version of zlib may have given other lengths: what was remembered of them goes."""
    store = world(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(records, "LEVEL", 0)
        store.make(1, progress=False)
    store[8]
    content = store.path(2).read_bytes()
    store.path(2).write_bytes(flip(content, len(content) - 1))
    with pytest.warns(DamageWarning):
        assert_same(store[8], make(RECIPE, 8))
    assert len(store.path(2).read_bytes()) != len(content)


def test_missing_shards_without_a_function(store, tmp_path):
    reading = world(tmp_path, None)
    reading.path(7).unlink()
    assert reading.missing() == [7]
    assert reading.check() == [f"{reading.path(7)}: missing"]
    with pytest.raises(FileNotFoundError, match=r"000007\.shard: not made yet"):
        reading[22]


def test_forgotten_files_are_taken_away(store):
    old, fresh = (store.folder / f".000001.shard.{c * 16}.tmp" for c in "ab")
    for path, age in ((old, 2 * module.FORGOTTEN), (fresh, 60)):
        path.write_bytes(b"unfinished")
        module.os.utime(path, (time.time() - age,) * 2)
    store.path(1).unlink()
    assert store.make(1, progress=False) == 1
    assert not old.exists()
    assert fresh.exists(), "somebody may still be writing it"


def test_a_file_that_cannot_be_replaced_as_it_is_read(whole, tmp_path, monkeypatch):
    """As on Windows: another process has made the shard in the meantime, and reads it."""
    store = world(tmp_path)
    real = module.write_bytes

    def refuse(path, data):
        real(path, data)
        raise PermissionError(13, "used by another process")

    monkeypatch.setattr(module, "write_bytes", refuse)
    assert store.make(1, progress=False) == SHARDS
    assert files(store) == files(whole)
    monkeypatch.setattr(module, "write_bytes", lambda path, data: real(path / "nowhere", data))
    with pytest.raises(MakingError, match=r"000002\.shard: cannot be written"):
        store._write(store.path(2), b"something else than what is there")


def test_the_bar_counts_records(store, tmp_path, capsys):
    store.path(0).unlink()
    store.path(7).unlink()
    store.make(1)
    assert "small: 100%" in (text := capsys.readouterr().err)
    assert "5/5" in text
    world(tmp_path / "quiet").make(1, progress=False)
    assert capsys.readouterr().err == ""


def some(**changes):
    arguments = {"name": "x", "recipe": {}, "count": 3, "function": make, "version": "1"} | changes
    return Store(**arguments)


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: some(name="a/b"), "name"),
        (lambda: some(name=""), "name"),
        (lambda: some(name="Big"), "name"),
        (lambda: some(name="..") , "name"),
        (lambda: some(name=3), "name"),
        (lambda: some(recipe=[1]), "recipe: expected a dict"),
        (lambda: some(recipe={1: 2}), "recipe: expected strings"),
        (lambda: some(recipe={"a": np.zeros(2)}), r"recipe\['a'\]"),
        (lambda: some(recipe={"a": float("nan")}), r"recipe\['a'\]"),
        (lambda: some(count=-1), "count"),
        (lambda: some(count=2.0), "count"),
        (lambda: some(function="make"), "function"),
        (lambda: some(version=""), "version"),
        (lambda: some(version=1), "version"),
        (lambda: some(shard_size=0), "shard_size"),
        (lambda: some().make(0), "processes"),
        (lambda: some().make(1.5), "processes"),
        (lambda: some().make(1, part=(0, 2)), "part"),
        (lambda: some().make(1, part=(3, 2)), "part"),
        (lambda: some().make(1, part=(1, 0)), "part"),
        (lambda: some().make(1, part=3), "part"),
        (lambda: some().make(1, part=(1, 2, 3)), "part"),
        (lambda: some().make(1, start_method="thread"), "start_method"),
        (lambda: some(function=lambda *_: {}).make(2), "function: expected one from a module"),
        (lambda: some(function=None).make(), "function"),
    ],
)  # fmt: skip
def test_bad_input(call, name, tmp_path, monkeypatch):
    monkeypatch.setenv("POSECORE_CACHE", str(tmp_path))
    with pytest.raises(ValueError, match=f"^{name}"):
        call()
    assert list(tmp_path.iterdir()) == []


def test_a_record_that_cannot_be_kept(tmp_path):
    store = some(function=lambda *_: {"a": object()}, folder=tmp_path)
    with pytest.raises(MakingError, match="x: record 0: ValueError: a: expected what JSON holds"):
        store[0]
    assert not store.folder.exists() or [p.name for p in store.folder.iterdir()] == ["recipe.json"]


@pytest.mark.parametrize(
    ("count", "cores", "started"), [(3, 8, 1), (8, 8, 2), (32, 2, 2), (31, 8, 7), (40, None, 1)]
)
def test_a_few_files_are_not_worth_a_process(tmp_path, monkeypatch, count, cores, started):
    seen = []

    def in_processes(make_shard, todo, processes, start_method, report):
        seen.append(processes)
        for number in todo:
            make_shard(number, report)

    monkeypatch.setattr(module, "make_in_processes", in_processes)
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    made = Store("x", RECIPE, count, make, version="1", shard_size=1, folder=tmp_path)
    made.make(progress=False)
    assert seen == ([] if started == 1 else [started])
    assert not made.missing()
