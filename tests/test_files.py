"""Writing that cannot leave half a file."""

import errno
import os
import socket
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from posecore.files import write_bytes


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


def test_a_link_stays_a_link(tmp_path):
    there, link, dangling = tmp_path / "there", tmp_path / "link", tmp_path / "dangling"
    there.write_bytes(b"old")
    there.chmod(0o600)
    link.symlink_to("there")
    dangling.symlink_to("new")
    write_bytes(link, b"new")
    assert link.is_symlink() and there.read_bytes() == b"new" and not there.is_symlink()
    assert there.stat().st_mode & 0o777 == 0o600
    write_bytes(dangling, b"first")
    assert dangling.is_symlink() and (tmp_path / "new").read_bytes() == b"first"
    assert sorted(os.listdir(tmp_path)) == ["dangling", "link", "new", "there"]


def test_what_is_no_file_is_written_to_and_stays(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_bytes(pipe, b"through")
    assert os.read(reader, 100) == b"through" and pipe.is_fifo()
    os.close(reader)
    null = tmp_path / "null"  # of its own: as root, the real one would be replaced
    null.symlink_to(os.devnull)
    write_bytes(null, b"nothing")
    assert null.is_symlink() and null.is_char_device()
    assert sorted(os.listdir(tmp_path)) == ["null", "pipe"]


def test_a_device_is_never_replaced(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "replace", lambda *_: pytest.fail("replaced"))
    write_bytes(os.devnull, b"nothing")


def test_what_cannot_be_written_to_is_refused(tmp_path):
    (folder := tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match="expected a file to write, got a folder: .*folder"):
        write_bytes(folder, b"new")
    with socket.socket(socket.AF_UNIX) as there:
        there.bind(str(tmp_path / "socket"))
        with pytest.raises(OSError, match="neither a file nor a stream: .*socket"):
            write_bytes(tmp_path / "socket", b"new")
    (loop := tmp_path / "loop").symlink_to("loop")
    with pytest.raises(OSError, match="loop"):
        write_bytes(loop, b"new")
    assert sorted(os.listdir(tmp_path)) == ["folder", "loop", "socket"]


OWN = """
import sys
from pathlib import Path
from posecore.files import write_bytes
print("before")
write_bytes(Path(sys.argv[1]), b"data\\n")
print("after")
"""


@pytest.mark.parametrize("kind", ["file", "pipe"])
@pytest.mark.parametrize("name", ["/dev/stdout", "/dev/fd/1", "out.txt"])
def test_its_own_output_is_written_in_order(tmp_path, kind, name):
    if name.startswith("/dev") and not os.path.exists("/dev/fd/1"):
        pytest.skip("no /dev/fd on this system")
    if (kind, name) == ("pipe", "out.txt"):
        pytest.skip("a pipe has no name")
    path = tmp_path / "out.txt"
    with path.open("wb") as file:
        done = subprocess.run(
            [sys.executable, "-c", OWN, name],
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
            stdout=file if kind == "file" else subprocess.PIPE,
            check=True,
        )
    text = path.read_bytes() if kind == "file" else done.stdout
    assert text == b"before\ndata\nafter\n"
    assert os.listdir(tmp_path) == ["out.txt"]


def test_errors_name_the_file(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=r"No space left on device: '.*results.csv'"):
        write_bytes(tmp_path / "results.csv", b"new")
    if os.path.exists("/dev/full"):
        with pytest.raises(OSError, match="No space left on device: '/dev/full'"):
            write_bytes("/dev/full", b"new")
