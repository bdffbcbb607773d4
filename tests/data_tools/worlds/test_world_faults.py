"""A real world, made and checked by the command line, and all that may go wrong meanwhile."""

import multiprocessing
import os
import shutil
import signal
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

import data_tools
from data_tools.main import main
from data_tools.storage import DamageWarning
from data_tools.worlds import tabletop
from data_tools.worlds.world import Size

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not hasattr(os, "fork"), reason="these tests fork"),
    pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning"),
]
SHARDS = 6
MAKE = ["make", "tabletop", "--split", "train", "--processes", "1", "--quiet"]
CHECK = ["check", "tabletop", "--split", "train"]
SMALL = replace(tabletop.WORLD, sizes={"tiny": Size(24, 18, {"train": 6})}, shard_size=1)


@pytest.fixture(autouse=True)
def small_world(monkeypatch):
    monkeypatch.setattr(tabletop, "WORLD", SMALL)
    monkeypatch.setenv("POSECORE_SCALE", "tiny")


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The files of the world by name, and how many seconds they take."""
    folder = tmp_path_factory.mktemp("undisturbed")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("POSECORE_CACHE", str(folder))
        patch.setenv("POSECORE_SCALE", "tiny")
        SMALL.store("train").make(1, progress=False)
        shutil.rmtree(folder)  # now all that is made only once is there
        start = time.perf_counter()
        SMALL.store("train").make(1, progress=False)
        return files(SMALL.store("train")), time.perf_counter() - start


@pytest.fixture
def store(tmp_path, monkeypatch):
    """The world in a folder of its own, that nobody has made yet; its name is not an easy one."""
    monkeypatch.setenv("POSECORE_CACHE", str(tmp_path / "Größe 'n\" Tiefe"))
    return SMALL.store("train")


def files(store):
    """The bytes of all files, without those of killed processes."""
    return {p.name: p.read_bytes() for p in sorted(store.folder.glob("[!.]*"))}


def start(arguments):
    """The command line in another process, with all that is loaded here."""

    def run():
        signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.exit(main(arguments))

    process = multiprocessing.get_context("fork").Process(target=run)
    process.start()
    return process


def ended(process):
    process.join(20)
    assert not process.is_alive()
    return process.exitcode


def finished(store):
    """When each file that is there was made."""
    return {number: store.path(number).stat().st_mtime_ns
            for number in set(range(store.shards)) - set(store.missing())}  # fmt: skip


@pytest.mark.parametrize("moment", np.arange(0.5, 12) / 12)
def test_killed_at_any_moment(store, undisturbed, moment, capfd):
    expected, seconds = undisturbed
    process = start(MAKE)
    time.sleep(moment * seconds)
    os.kill(process.pid, signal.SIGKILL)
    status = ended(process)
    kept = finished(store)
    assert status == -signal.SIGKILL or len(kept) == SHARDS  # on a busy machine it may come late
    capfd.readouterr()
    assert main(CHECK) == int(len(kept) < SHARDS)
    wrong = capfd.readouterr().err.splitlines()
    assert len(wrong) == SHARDS - len(kept)
    assert all(line.endswith(".shard: missing") for line in wrong), "and nothing is damaged"
    assert main(MAKE) == 0
    out = capfd.readouterr().out
    assert out == f"{store.folder}: {SHARDS - len(kept)} of {SHARDS} files made\n"
    assert files(store) == expected
    assert kept.items() <= finished(store).items(), "what was there is not made again"


def test_interrupted_from_the_keyboard(store, undisturbed, capfd):
    process = start(MAKE)
    while not (store.folder.exists() and list(store.folder.glob("[0-9]*"))):
        time.sleep(0.002)
    os.kill(process.pid, signal.SIGINT)
    assert ended(process) == 130
    out, err = capfd.readouterr()
    assert (out, err) == ("", "stopped; finished files of worlds are kept\n")
    assert not list(store.folder.glob(".*")), "no half of a file is left"
    assert 1 <= len(finished(store)) < SHARDS
    assert main(MAKE) == 0
    assert files(store) == undisturbed[0]


def test_two_at_once(store, undisturbed):
    makers = [start(MAKE) for _ in range(2)]
    assert [ended(maker) for maker in makers] == [0, 0]
    assert files(store) == undisturbed[0]
    assert not list(store.folder.glob(".*"))


def test_parts_in_any_order(store, undisturbed, capsys):
    for i in (3, 1, 2):
        assert main([*MAKE, "--shard", f"{i}/3"]) == 0
    assert capsys.readouterr().out == f"{store.folder}: 2 of 6 files made\n" * 3
    assert files(store) == undisturbed[0]


def damage(path, number):
    data = bytearray(path.read_bytes())
    if number == 1:
        data[len(data) // 2] ^= 8
    path.write_bytes([b"", data, data[:-7]][number])


def test_every_damage_is_named_and_mended(store, undisturbed, capsys):
    assert main(MAKE) == 0
    for number in range(3):
        damage(store.path(number), number)
    store.path(4).write_bytes(store.path(5).read_bytes())
    capsys.readouterr()
    assert main(CHECK) == 1
    out, err = capsys.readouterr()
    assert out == f"{store.folder}: 2 of 6 files are good\n"
    reasons = ["empty file", "wrong checksum", "cut off", "shard 5 in the place of shard 4"]
    for line, number, reason in zip(err.splitlines(), (0, 1, 2, 4), reasons, strict=True):
        assert line.startswith(f"{store.path(number)}: ")
        assert reason in line
    assert main(MAKE) == 0
    notes = capsys.readouterr().err.splitlines()
    assert len(notes) == 4
    assert all(one.startswith("note: ") and one.endswith("it is made again") for one in notes)
    assert main(CHECK) == 0
    assert files(store) == undisturbed[0]


@pytest.mark.parametrize("number", range(3))
def test_views_of_a_damaged_file(store, undisturbed, number):
    assert main(MAKE) == 0
    before = list(data_tools.open("tabletop", split="train"))
    damage(store.path(number), number)
    with pytest.warns(DamageWarning, match=rf"00000{number}\.shard.*it is made again"):
        after = list(data_tools.open("tabletop", split="train", processes=1, progress=False))
    for old, new in zip(before, after, strict=True):
        assert np.array_equal(old.rgb, new.rgb)
        assert np.array_equal(old.depth, new.depth)
    assert files(store) == undisturbed[0]


def test_a_full_disk(store, undisturbed, capsys):
    """The system itself ends the writing in the middle of a file; then there is room again."""
    resource = pytest.importorskip("resource")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    size = min(len(data) for name, data in undisturbed[0].items() if name.endswith("shard"))
    resource.setrlimit(resource.RLIMIT_FSIZE, (size - 1, limits[1]))
    try:
        assert main(MAKE) == 1
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    err = capsys.readouterr().err
    assert err.startswith(f"error: {store.folder}")
    assert err.endswith(".shard: cannot be written: File too large; finished shards are kept\n")
    assert [path.name for path in store.folder.iterdir()] == ["recipe.json"]
    assert main(MAKE) == 0
    assert files(store) == undisturbed[0]
