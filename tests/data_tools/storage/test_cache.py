import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_tools.storage import cache_size, clean
from tests.data_tools.storage.small_worlds import world


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """A cache with two worlds of one recipe and another, found through the environment."""
    monkeypatch.setenv("POSECORE_CACHE", str(tmp_path / "cache"))
    for seed in (1, 2):
        world(None, seed=seed).make(1, progress=False)
    return tmp_path / "cache" / "worlds"


def test_sizes(cache):
    stores = [world(None, seed=seed) for seed in (1, 2)]
    assert all(store.folder.parent == cache / "small" for store in stores)
    expected = {
        f"small/{store.key[:16]}": sum(p.stat().st_size for p in store.folder.iterdir())
        for store in stores
    }
    assert cache_size() == expected
    assert cache_size(cache) == expected
    assert list(cache_size()) == sorted(expected)


def test_clean_says_what_it_was(cache):
    unfinished = world(None, seed=1).folder / f".000003.shard.{'0a' * 8}.tmp"
    unfinished.write_bytes(bytes(100))
    sizes = cache_size()
    assert clean() == (sizes, [])
    assert not cache.exists()
    assert cache.parent.exists(), "the cache holds more than worlds"
    assert clean() == ({}, [])
    assert cache_size() == {}


def test_what_is_not_ours_stays(cache, tmp_path):
    store = world(None, seed=1)
    outside = tmp_path / "precious"
    outside.mkdir()
    (outside / "000000.shard").write_bytes(b"precious")
    foreign = [
        cache / "notes.txt",
        cache / "small" / "000000.shard",
        cache / "small" / "thesis" / "000000.shard",
        store.folder / "000000.shard.bak",
        store.folder / "results.csv",
        store.folder / ".000000.shard",
        store.folder / "deeper" / "000000.shard",
        cache / "My worlds" / store.key[:16] / "000000.shard",
    ]
    for path in foreign:
        path.parent.mkdir(exist_ok=True, parents=True)
        path.write_bytes(b"precious")
    links = [cache / "small" / ("0" * 16), store.folder / "900000.shard"]
    os.symlink(outside, links[0])
    os.symlink(outside / "000000.shard", links[1])
    sizes = cache_size()
    assert len(sizes) == 2
    removed, left = clean()
    assert removed == sizes
    assert sorted(left) == sorted(foreign + links)
    for path in foreign:
        assert path.read_bytes() == b"precious"
    assert (outside / "000000.shard").read_bytes() == b"precious"
    assert sorted(path for path in cache.rglob("*") if not path.is_dir() or path.is_symlink()) == (
        sorted(foreign + links)
    ), "all of ours is gone"


@pytest.mark.slow
@given(names=st.lists(st.from_regex(r"[a-zA-Z0-9._-]{1,12}", fullmatch=True), min_size=1))
def test_files_of_any_other_name_stay(tmp_path_factory, names):
    root = tmp_path_factory.mktemp("cache")
    for name in set(names) - {".", ".."}:
        (root / f"{name}.txt").write_bytes(b"precious")
    _, left = clean(root)
    assert sorted(left) == sorted(root.iterdir())
    assert len(left) == len(set(names) - {".", ".."})
