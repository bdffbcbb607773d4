"""Writing that cannot leave half a file."""

import errno
import hashlib
import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

from posecore.files import hash_files, write_bytes


@given(old=st.none() | st.binary(), new=st.binary())
def test_write_bytes(tmp_path_factory, old, new):
    folder = tmp_path_factory.mktemp("written")
    path = folder / "written"
    if old is not None:
        path.write_bytes(old)
    write_bytes(path, new)
    assert path.read_bytes() == new
    assert [p.name for p in folder.iterdir() if p.name.endswith(".tmp")] == []


@pytest.mark.parametrize("place", ["os.replace", "os.fsync"])
@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left"), KeyboardInterrupt()])
def test_failing_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch, place, error):
    path = tmp_path / "results.csv"
    path.write_bytes(b"old")

    def fail(*_):
        raise error

    monkeypatch.setattr(place, fail)
    with pytest.raises(type(error)):
        write_bytes(path, b"new" * 1000)
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["results.csv"]


def test_write_into_a_missing_folder(tmp_path):
    with pytest.raises(OSError, match="nowhere"):
        write_bytes(tmp_path / "nowhere" / "a", b"new")
    assert os.listdir(tmp_path) == []


def test_disk_full_in_the_middle_of_writing(tmp_path):
    """A file system with no room at all: the write itself fails, not the rename."""
    if not os.path.exists("/dev/full"):
        pytest.skip("no /dev/full on this system")
    path = tmp_path / "results.csv"
    path.write_bytes(b"old")
    real_open = type(path).open

    def open_full(self, mode):
        return real_open(type(path)("/dev/full"), "wb", buffering=0)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(path), "open", open_full)
        with pytest.raises(OSError, match="No space left"):
            write_bytes(path, b"new" * 100_000)
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["results.csv"]


def test_the_hash_of_files_is_over_names_lengths_and_bytes_but_not_line_ends(tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    one.write_bytes(b"a\r\nb")
    two.write_bytes(b"c")
    expected = hashlib.sha256(b"x 3\na\nby 1\nc").hexdigest()[:16]
    assert hash_files([("x", one), ("y", two)]) == expected
    assert hash_files([("y", two), ("x", one)]) != expected
    assert hash_files([("x", one), ("z", two)]) != expected
    with pytest.raises(OSError):
        hash_files([("x", tmp_path / "none")])
