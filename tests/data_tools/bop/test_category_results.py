"""Category-level results files: exact, and refused when they are damaged."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_tools.bop import (
    has_categories,
    read_category_results,
    read_results,
    write_category_results,
    write_results,
)
from posecore.metrics import CategoryPoseTable
from posecore.rotations import random_rotations

HEADER = "scene_id,im_id,obj_id,score,R,t,time,category,size"
ROW = "1,2,0,0.5,1 0 0 0 1 0 0 0 1,0 0 1000,-1,mug,100 110 80"


def table(rng, n=4):
    return CategoryPoseTable.from_arrays(
        rng.choice(["mug", "can", "wine glass", "tasse à café"], n).tolist(),
        random_rotations(n, generator=rng),
        rng.normal(size=(n, 3)),
        rng.uniform(1e-3, 1, (n, 3)),
        axis=rng.integers(0, 2, (n, 1)) * [0.0, 1, 0],
        score=rng.random(n),
        image_id=rng.integers(0, 9, n),
        scene_id=rng.integers(0, 9, n),
        object_id=rng.integers(0, 9, n),
        time=rng.random(n),
    )


def assert_same(one, other, *names):
    for name in names:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


ALL = ("scene_id", "image_id", "object_id", "t", "score", "time", "category", "size")


@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(0, 5))
def test_what_is_written_is_read(tmp_path_factory, seed, n):
    path = tmp_path_factory.mktemp("results") / "est.csv"
    written = table(np.random.default_rng(seed), n)
    write_category_results(path, written, axes=True)
    read = read_category_results(path, axes=True)
    assert_same(written, read, *ALL, "axis")
    np.testing.assert_allclose(read.R, written.R, atol=1e-15)
    write_category_results(path, written)
    read = read_category_results(path)
    assert_same(written, read, *ALL)
    assert not read.axis.any()


def test_files_say_what_they_are(tmp_path, rng):
    path = tmp_path / "est.csv"
    write_category_results(path, table(rng))
    assert has_categories(path)
    with pytest.raises(ValueError, match="header"):
        read_results(path)
    with pytest.raises(ValueError, match=r"est.csv: expected the header .*axis, got"):
        read_category_results(path, axes=True)
    write_results(path, table(rng))
    assert not has_categories(path)
    with pytest.raises(ValueError, match="header"):
        read_category_results(path)


def read(tmp_path, text, **options):
    (tmp_path / "est.csv").write_text(text)
    return read_category_results(tmp_path / "est.csv", **options)


def test_lengths_are_millimetres(tmp_path):
    one = read(tmp_path, f"\ufeff{HEADER}\r\n\r\n{ROW}\r\n")
    assert one.t.tolist() == [[0, 0, 1]] and one.size.tolist() == [[0.1, 0.11, 0.08]]
    assert one.category.tolist() == ["mug"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (HEADER, HEADER + ",color", "header"),
        (HEADER + "\n", "", "header"),
        (",mug", "", "line 3: expected 9 columns"),
        (",mug", ",mug,red", "line 3: expected 9 columns"),
        ("mug", " ", "line 3: column category"),
        ("100 110 80", "100 110", "line 3: column size: expected 3"),
        ("100 110 80", "100 110 0", "line 3: column size: expected lengths above 0"),
        ("100 110 80", "100 110 -80", "line 3: column size: expected lengths above 0"),
        ("100 110 80", "100 nan 80", "line 3: column size: expected finite"),
        ("100 110 80", "100 1_0 80", "line 3: column size: expected finite"),
        ("0 0 1000", "0 0 inf", "line 3: column t"),
        ("1 0 0 0 1 0 0 0 1", "1 0 0 0 1 0 0 0 0", "line 3, column R"),
        ("1,2,", "-1,2,", "line 3: column scene_id"),
    ],
)
def test_damage_is_named(tmp_path, old, new, message):
    good = ROW.replace("mug", "can").replace("1,2,0", "3,4,5").replace("80", "81")
    text = f"{HEADER}\n{good}\n{ROW}\n"
    head, _, tail = text.rpartition(old)
    with pytest.raises(ValueError, match=f"est.csv: (expected the )?{message}"):
        read(tmp_path, head + new + tail)


def test_an_axis_is_three_numbers(tmp_path):
    text = f"{HEADER},axis\n{ROW},0 1\n"
    with pytest.raises(ValueError, match="line 2: column axis: expected 3"):
        read(tmp_path, text)
    assert read(tmp_path, f"{HEADER},axis\n{ROW},0 2 0\n").axis.tolist() == [[0, 2, 0]]


@pytest.mark.parametrize("name", ["mug,red", "mug\nred", " mug", "mug\u2028red"])
def test_names_that_would_break_a_line_are_not_written(tmp_path, rng, name):
    one = CategoryPoseTable.from_arrays([name], np.eye(3)[None], np.ones((1, 3)), np.ones((1, 3)))
    with pytest.raises(ValueError, match="category"):
        write_category_results(tmp_path / "est.csv", one)
    assert not list(tmp_path.iterdir())


def test_other_tables_are_refused(tmp_path, rng):
    with pytest.raises(ValueError, match="table"):
        write_category_results(tmp_path / "est.csv", [1, 2])
    with pytest.raises(ValueError, match=r"table\.image_id"):
        one = CategoryPoseTable.from_arrays(
            "mug", np.eye(3)[None], np.ones((1, 3)), np.ones((1, 3)), image_id=-1
        )
        write_category_results(tmp_path / "est.csv", one)
    with pytest.raises(FileNotFoundError):
        has_categories(tmp_path / "none.csv")
