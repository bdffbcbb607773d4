"""The table of poses: what it holds, what it refuses."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from posecore.metrics import CategoryPoseTable, PoseTable


def table(n=3, **changes):
    columns = {
        "scene_id": np.arange(n),
        "image_id": np.arange(n) + 10,
        "object_id": np.arange(n) + 20,
        "R": np.tile(np.eye(3), (n, 1, 1)),
        "t": np.arange(3.0 * n).reshape(n, 3),
        "score": np.linspace(0, 1, n),
        "time": np.full(n, -1),
    }
    return PoseTable(**(columns | changes))


@given(st.integers(0, 9), st.integers(0, 2**9 - 1))
def test_rows_are_chosen_in_every_column(n, bits):
    mask = np.array([bool(bits >> i & 1) for i in range(n)], bool)
    whole, some = table(n), table(n)[mask]
    assert len(some) == mask.sum()
    for name in ("scene_id", "image_id", "object_id", "R", "t", "score", "time"):
        np.testing.assert_array_equal(getattr(some, name), getattr(whole, name)[mask])


def test_single_rows_are_tables_and_tables_are_not_compared():
    whole = table(3)
    assert whole[1].object_id.tolist() == whole[-2].object_id.tolist() == [21]
    assert [row.object_id.item() for row in whole] == [20, 21, 22]
    assert whole != table(3)  # identity: arrays have no one truth value
    assert len({whole, whole}) == 1


def test_every_row_has_its_image():
    assert table(3).images == [(0, 10), (1, 11), (2, 12)]
    assert table(0).images == []


def test_types_are_the_same_whatever_comes_in():
    poses = table(t=[[1, 2, 3]] * 3, scene_id=np.arange(3, dtype=np.uint8))
    assert poses.t.dtype == poses.time.dtype == np.float64
    assert poses.scene_id.dtype == np.int64
    assert len(table(0)) == 0


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"scene_id": np.zeros(2, int)}, "scene_id"),
        ({"image_id": np.zeros(3)}, "image_id"),
        ({"object_id": np.array(["a", "b", "c"])}, "object_id"),
        ({"R": np.zeros((3, 9))}, "R"),
        ({"R": np.full((3, 3, 3), np.nan)}, "R.*row 0"),
        ({"t": np.zeros(3)}, "t"),
        ({"t": np.array([[0, 0, 0], [0, 0, 0], [0, np.inf, 0]])}, "t.*row 2"),
        ({"score": np.array(["high"] * 3)}, "score"),
        ({"time": np.zeros((3, 1))}, "time"),
    ],
)
def test_bad_input_is_named(changes, name):
    with pytest.raises(ValueError, match=name):
        table(**changes)


# Categories ---------------------------------------------------------------------------------------


def categories(n=3, **changes):
    columns = {
        "category": ["mug", "can", "mug"][:n],
        "R": np.tile(np.eye(3), (n, 1, 1)),
        "t": np.arange(3.0 * n).reshape(n, 3),
        "size": np.tile([0.1, 0.2, 0.2], (n, 1)),
    }
    return CategoryPoseTable.from_arrays(**(columns | changes))


def test_each_row_has_its_category_size_and_scale():
    some = categories(axis=[0, 1, 0])
    assert some.category.tolist() == ["mug", "can", "mug"]
    assert some.axis.tolist() == [[0, 1, 0]] * 3 and categories().axis.tolist() == [[0, 0, 0]] * 3
    np.testing.assert_allclose(some.scale, 0.3)
    assert some.score.tolist() == [1, 1, 1] and some.time.tolist() == [-1, -1, -1]
    assert len(categories(0)) == len(CategoryPoseTable.from_arrays([], [], [], [])) == 0
    assert categories(category="mug").category.tolist() == ["mug"] * 3


def test_rows_of_categories_are_chosen_in_every_column():
    whole = categories(score=[0.1, 0.2, 0.3], image_id=[4, 5, 6])
    some = whole[np.array([True, False, True])]
    assert isinstance(some, CategoryPoseTable)
    assert some.category.tolist() == ["mug", "mug"] and some.size.shape == (2, 3)
    assert some.images == [(0, 4), (0, 6)] and some.score.tolist() == [0.1, 0.3]
    assert whole[1].category.tolist() == ["can"]


def test_tensors_come_in_as_well():
    t = torch.arange(9.0, requires_grad=True).reshape(3, 3)
    some = categories(t=t, image_id=torch.tensor([1, 2, 3]), score=torch.ones(3))
    assert some.t.tolist() == t.tolist() and some.image_id.tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"category": ["mug", "can"]}, "category"),
        ({"category": ["mug", "", "can"]}, "category"),
        ({"category": [1, 2, 3]}, "category"),
        ({"size": np.zeros((3, 3))}, "size.*row 0"),
        ({"size": np.ones(3)}, "size"),
        ({"size": np.full((3, 3), np.nan)}, "size.*row 0"),
        ({"axis": np.zeros((2, 3))}, "axis"),
        ({"axis": np.full((3, 3), np.inf)}, "axis.*row 0"),
        ({"t": []}, "t"),
        ({"image_id": 0.5}, "image_id"),
        ({"score": np.ones(2)}, "score"),
    ],
)
def test_bad_categories_are_named(changes, name):
    with pytest.raises(ValueError, match=name):
        categories(**changes)
