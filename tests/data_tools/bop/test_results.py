import csv
import errno
import os
import warnings
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from data_tools.bop import RotationWarning, read_results, write_results
from data_tools.bop.scenes import PlaceholderWarning
from posecore.metrics.pose_table import PoseTable
from posecore.rotations import rotation_defect

HEADER = "scene_id,im_id,obj_id,score,R,t,time\n"
ROW = "2,3,5,0.5,1 0 0 0 1 0 0 0 1,161.68945982 -113.74032768 1112.83112737,1.25\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("results")


def write(folder, content):
    path = folder / "results.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def assert_same(a, b):
    """Equal bit by bit, the sign of zero included."""
    for field in fields(PoseTable):
        x, y = getattr(a, field.name), getattr(b, field.name)
        assert x.dtype == y.dtype
        assert x.tobytes() == y.tobytes(), field.name


def table(R, t, **columns):
    n = len(R)
    defaults = {name: np.zeros(n, np.int64) for name in ("scene_id", "image_id", "object_id")}
    return PoseTable(R=R, t=t, **(defaults | {"score": np.ones(n), "time": np.ones(n)} | columns))


NUMBERS = st.floats(-1e300, 1e300)  # subnormals and both zeros among them
IDS = st.integers(0, 10**18 - 1)


@st.composite
def tables(draw):
    n = draw(st.integers(0, 5))
    R = Rotation.random(n, random_state=draw(st.integers(0, 2**32 - 1))).as_matrix() if n else None
    return table(
        np.zeros((0, 3, 3)) if R is None else R,
        draw(arrays(np.float64, (n, 3), elements=NUMBERS)),
        scene_id=draw(arrays(np.int64, n, elements=IDS)),
        image_id=draw(arrays(np.int64, n, elements=IDS)),
        object_id=draw(arrays(np.int64, n, elements=IDS)),
        score=draw(arrays(np.float64, n, elements=NUMBERS)),
        time=draw(arrays(np.float64, n, elements=NUMBERS)),
    )


@given(written=tables(), rotations=st.sampled_from(["project", "as_read"]))
def test_what_is_written_is_read_bit_by_bit(folder, written, rotations):
    path = folder / "written.csv"
    write_results(path, written)
    read = read_results(path, rotations)
    first = path.read_bytes()
    assert_same(read, written)
    write_results(path, read)
    assert path.read_bytes() == first


@given(seed=st.integers(0, 2**32 - 1))
def test_projected_rotations_do_not_change_any_more(folder, seed):
    rng = np.random.default_rng(seed)
    R = Rotation.random(5, random_state=seed).as_matrix() + rng.uniform(-1e-4, 1e-4, (5, 3, 3))
    path = folder / "written.csv"
    write_results(path, table(R, rng.normal(size=(5, 3))))
    once = read_results(path)
    assert rotation_defect(once.R).max() < 1e-14
    write_results(path, once)
    assert_same(read_results(path), once)


def test_a_row(folder):
    read = read_results(write(folder, HEADER + ROW))
    assert (read.scene_id, read.image_id, read.object_id) == (2, 3, 5)
    assert (read.score, read.time) == (0.5, 1.25)
    np.testing.assert_array_equal(read.R, [np.eye(3)])
    # The float64 nearest to the decimal number, which a division by 1000 need not be.
    np.testing.assert_array_equal(read.t, [[0.16168945982, -0.11374032768, 1.11283112737]])


def test_the_bytes_that_are_written(folder):
    path = folder / "written.csv"
    R = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    write_results(path, table(R[None], [[0.1, -2.5e-9, 1234.0]], score=[1 / 3], time=[-1.0]))
    assert path.read_bytes().decode() == (
        HEADER + "0,0,0,0.3333333333333333,0.0 -1.0 0.0 1.0 0.0 0.0 0.0 0.0 1.0,"
        "100 -0.0000025 1234000,-1.0\n"
    )


@pytest.mark.parametrize(
    "content",
    [
        HEADER + ROW + ROW,
        (HEADER + ROW + ROW)[:-1],
        ROW + ROW,
        "\ufeff" + HEADER + ROW + ROW,
        (HEADER + ROW + ROW).replace("\n", "\r\n"),
        HEADER + "\n" + ROW + "\n" + ROW + "\n\n",
        HEADER + (ROW + ROW).replace(",", " , "),
        HEADER + (ROW + ROW).replace("1 0", "1.0e0   0."),
    ],
)
def test_what_is_read_alike(folder, content):
    assert_same(read_results(write(folder, content)), read_results(write(folder, HEADER + 2 * ROW)))


def test_header_alone(folder):
    assert len(read_results(write(folder, HEADER))) == 0


@pytest.mark.parametrize("rotations", ["project", "as_read"])
def test_placeholders_are_left_out(folder, rotations):
    none = ROW.replace("1 0 0 0 1 0 0 0 1", "-1 -1 -1 -1 -1 -1 -1 -1 -1")
    with pytest.warns(PlaceholderWarning, match=r"results\.csv: 2 of 3 poses are placeholders"):
        read = read_results(write(folder, HEADER + none + ROW + none), rotations)
    assert_same(read, read_results(write(folder, HEADER + ROW)))
    with pytest.raises(ValueError, match="line 4, column R: expected a rotation"), pytest.warns():
        read_results(write(folder, HEADER + none + ROW + ROW.replace("1 0 0", "9 0 0")))


def swap(old, new):
    return HEADER + ROW + ROW.replace(old, new, 1)


BAD = [
    ("", "empty file"),
    ("\n \n", "expected the header"),
    ("scene_id,im_id,obj_id,score,R,t\n" + ROW, "expected the header .*obj_id,score,R,t'"),
    ("scene_id;im_id;obj_id;score;R;t;time\n" + ROW, "expected the header .*'scene_id;im_id"),
    ("im_id,scene_id,obj_id,score,R,t,time\n" + ROW, "expected the header .*'im_id,scene_id"),
    ("# a comment\n" + HEADER + ROW, "expected the header .*'# a comment'"),
    (HEADER + HEADER + ROW, "line 2: column scene_id: expected an integer.*'scene_id'"),
    (b"\xff\xfe\x00" + ROW.encode(), "expected a text file"),
    (HEADER + ROW + "\0" * 40, "line 3: expected 7 columns"),
    (swap(",1.25", ""), "line 3: expected 7 columns .*, got 6"),
    (swap(",1.25", ",1.25,"), "line 3: expected 7 columns .*, got 8"),
    (swap(",1.25", ","), "line 3: column time: expected 1 numbers, got 0"),
    (swap(",1.25", ",1.25 2"), "line 3: column time: expected 1 numbers, got 2"),
    (swap(",1.25", ",fast"), "line 3: column time: expected finite numbers, got 'fast'"),
    (swap(",1.25", ",nan"), "line 3: column time: expected finite numbers, got 'nan'"),
    (swap(",1.25", ",1.25e"), "line 3: column time: expected finite numbers"),
    (swap("1 0 0 0 1 0 0 0 1", "1 0 0 0 1 0 0 0"), "line 3: column R: expected 9 numbers, got 8"),
    (
        swap("1 0 0 0 1 0 0 0 1", "1 0 0 0 1 0 0 0 1 0"),
        "line 3: column R: expected 9 numbers, got 10",
    ),
    (swap("1 0 0", "1 x 0"), "line 3: column R: expected finite numbers, got 'x'"),
    (swap("1 0 0", "1 NaN 0"), "line 3: column R: expected finite numbers, got 'NaN'"),
    (swap("1 0 0", "1 0,0"), "line 3: expected 7 columns .*, got 8"),
    (swap("1 0 0 0 1 0 0 0 1", "1 0 0 0 1 0 0 0 -1"), "line 3, column R: expected a rotation"),
    (swap("1 0 0 0 1 0 0 0 1", "0 0 0 0 0 0 0 0 0"), "line 3, column R: expected a rotation"),
    (swap("1 0 0", "10 0 0"), "line 3, column R: expected a rotation"),
    (swap("161.68945982 ", ""), "line 3: column t: expected 3 numbers, got 2"),
    (swap("161.68945982 ", "1 2 "), "line 3: column t: expected 3 numbers, got 4"),
    (swap("161.68945982", "inf"), "line 3: column t: expected finite numbers, got 'inf'"),
    (swap("161.68945982", "1e999"), "line 3: column t: expected finite numbers, got '1e999'"),
    (swap("161.68945982", "1_61"), "line 3: column t: expected finite numbers, got '1_61'"),
    (swap("161.68945982", "0x10"), "line 3: column t: expected finite numbers, got '0x10'"),
    (swap("2,3,5,0.5", "2,3,5,"), "line 3: column score: expected 1 numbers, got 0"),
    (swap("2,3,5,0.5", "2,3,5,1e400"), "line 3: column score: expected finite numbers"),
    (swap("2,3,5", "2,3,5.0"), "line 3: column obj_id: expected an integer of at least 0"),
    (swap("2,3,5", "2,-3,5"), "line 3: column im_id: expected an integer of at least 0, got '-3'"),
    (swap("2,3,5", "2,3," + "9" * 19), "line 3: column obj_id: expected an integer"),
    (swap("2,3,5", ",3,5"), "line 3: column scene_id: expected 1 numbers, got 0"),
    (swap("2,3,5", "²,3,5"), "line 3: column scene_id: expected an integer"),
    (swap("161.68945982", "١٦١"), "line 3: column t: expected finite numbers, got '١٦١'"),
    (swap("0.5", "٥"), "line 3: column score: expected finite numbers, got '٥'"),
    (swap("161.68945982", "9" * 5000), r"line 3: column t: expected finite numbers, .{,90}\.\.\.$"),
    (swap("2,3,5", "2,3," + "9" * 5000), r"line 3: column obj_id: expected .{,120}\.\.\.$"),
    (HEADER + ROW.strip() + ROW, "line 2: expected 7 columns .*, got 13"),
]


@pytest.mark.parametrize(("content", "message"), BAD)
def test_damaged_files_are_refused(folder, content, message):
    with pytest.raises(ValueError, match=rf"results\.csv: {message}"):
        read_results(write(folder, content))


def test_a_file_cut_anywhere(folder):
    """Refused, unless cut between lines or in the last number, where nothing shows it."""
    whole = HEADER + ROW + ROW
    expected = read_results(write(folder, whole))
    ends = [len(HEADER), len(HEADER + ROW), len(whole)]
    for length in range(len(whole)):
        path = write(folder, whole[:length])
        if length in ends or length + 1 in ends:
            rows = ends.index(length if length in ends else length + 1)
            assert_same(read_results(path), expected[:rows])
        elif any(end - len("1.25\n") < length < end for end in ends[1:]):
            read = read_results(path)
            rows = len(read)
            np.testing.assert_array_equal(read.t, expected.t[:rows])
            np.testing.assert_array_equal(read.time[:-1], expected.time[: rows - 1])
        else:
            with pytest.raises(ValueError, match=r"results\.csv: "):
                read_results(path)


@given(position=st.integers(0, len(HEADER + ROW) - 1), byte=st.integers(0, 255))
def test_any_byte_may_be_wrong(folder, position, byte):
    """A changed digit cannot be seen, but nothing else than a ValueError may come of it."""
    content = bytearray((HEADER + ROW).encode())
    content[position] = byte
    try:
        assert len(read_results(write(folder, bytes(content)), "as_read")) <= 1
    except ValueError as error:
        assert "results.csv: " in str(error)


def test_missing_file_and_unknown_choice(folder):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        read_results(folder / "nowhere.csv")
    with pytest.raises(ValueError, match="rotations: expected one of"):
        read_results(write(folder, HEADER), "round")
    with pytest.raises(ValueError, match=r"^path: expected the name of a file or a folder, got ''"):
        read_results("")


def test_what_is_no_table_of_poses_is_not_written(tmp_path):
    bad = table(np.eye(3)[None], [[0, 0, 1]], image_id=np.array([-1]))
    with pytest.raises(ValueError, match=r"table\.image_id: expected ids of at least 0"):
        write_results(tmp_path / "results.csv", bad)
    with pytest.raises(ValueError, match="table: expected a PoseTable, got list"):
        write_results(tmp_path / "results.csv", [])
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("place", ["os.replace", "os.fsync"])
def test_failing_write_leaves_the_old_file(tmp_path, monkeypatch, place):
    path = tmp_path / "results.csv"
    write_results(path, table(np.eye(3)[None], [[0, 0, 1]]))
    old = path.read_bytes()

    def fail(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(place, fail)
    with pytest.raises(OSError, match="No space left"):
        write_results(path, table(np.eye(3)[None], [[0, 0, 2]]))
    assert path.read_bytes() == old
    assert os.listdir(tmp_path) == ["results.csv"]


@pytest.mark.parametrize(("name", "rows"), [("gt", 1445), ("megapose", 1645)])
def test_real_files_against_a_plain_reading(real_data, folder, name, rows):
    path = real_data / "bop_results" / f"{name}_lmo-test.csv"
    read = read_results(path, "as_read")
    assert len(read) == rows
    assert len(np.unique(read.image_id)) == 200
    assert set(read.scene_id) == {2}
    assert set(read.object_id) == {1, 5, 6, 8, 9, 10, 11, 12}
    with path.open(newline="") as file:
        plain = list(csv.DictReader(file))
    columns = {"im_id": read.image_id, "obj_id": read.object_id, "score": read.score}
    for column, values in (columns | {"time": read.time}).items():
        assert [float(row[column]) for row in plain] == values.tolist()
    R = [[float(x) for x in row["R"].split()] for row in plain]
    np.testing.assert_array_equal(read.R.reshape(-1, 9), R)
    t = np.array([[float(x) for x in row["t"].split()] for row in plain])
    np.testing.assert_allclose(read.t, t / 1000, rtol=2.3e-16)  # one unit in the last place

    copy = folder / "copy.csv"
    write_results(copy, read)
    assert_same(read_results(copy, "as_read"), read)
    if name == "gt":  # its numbers are short enough to come back as they were, all bytes of them
        assert copy.read_bytes() == path.read_bytes() + b"\n"


def test_real_ground_truth_is_not_orthonormal(real_data):
    path = real_data / "bop_results" / "gt_lmo-test.csv"
    as_read = read_results(path, "as_read")
    assert rotation_defect(as_read.R).max() == pytest.approx(0.0096, abs=5e-5)
    with pytest.warns(RotationWarning, match="348 of 1445 .* up to 0.0096") as record:
        projected = read_results(path)
    assert len(record) == 1
    assert (rotation_defect(as_read.R) > 1e-3).sum() == 348
    assert rotation_defect(projected.R).max() < 1e-14
    assert np.abs(projected.R - as_read.R).max() < 0.0096
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_results(real_data / "bop_results" / "megapose_lmo-test.csv")
