import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_tools.renderer import rasterise, render_labels
from data_tools.renderer.visibility import Scene, visibility

EYE = (np.eye(3), np.array([0, 0, 1.0]))
K = np.array([[40.0, 0, 19.5], [0, 40.0, 14.5], [0, 0, 1]])


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_the_nearest_object_is_seen(make_scene, seed):
    objects, poses, camera, size = make_scene(seed, size=(60, 40))
    seen = visibility(Scene(objects, poses, camera, size), outside=True)
    inverse_depth = np.zeros((len(objects), 40, 60))
    for k, (item, (R, t)) in enumerate(zip(objects, poses, strict=True)):
        buffer = rasterise(item, R, t, camera, size)
        if buffer is not None:
            inverse_depth[k][buffer.window] = buffer.inverse_depth
            assert seen.buffers[k].full_pixels == buffer.full_pixels
            mine = (seen.instance == k)[buffer.window]
            np.testing.assert_array_equal(seen.face[buffer.window][mine], buffer.face[mine])
    np.testing.assert_array_equal(seen.inverse_depth, inverse_depth.max(0))
    expected = np.where(inverse_depth.any(0), inverse_depth.argmax(0), -1)
    np.testing.assert_array_equal(seen.instance, expected)
    assert seen.instance.dtype == np.int16 and seen.face.dtype == np.int32


def test_of_two_at_one_place_the_first_is_seen(shapes):
    scene = Scene([shapes[0], shapes[0]], [EYE, EYE], K, (40, 30))
    assert set(np.unique(visibility(scene).instance)) == {-1, 0}


def test_an_empty_scene():
    seen = visibility(Scene([], [], K, (40, 30)))
    assert (seen.instance == -1).all() and not seen.face.any() and not seen.inverse_depth.any()
    assert seen.buffers == ()


def test_a_scene_is_a_copy_in_float64(shapes):
    R, t = np.eye(3, dtype=np.float32), [0, 0, 1]
    scene = Scene([shapes[0]], [(R, t)], K.tolist(), [40, 30])
    assert scene.poses[0][0].dtype == np.float64 and scene.K.dtype == np.float64
    assert scene.size == (40, 30) and scene.shape == (30, 40)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"objects": ["cube"]}, "objects"),
        ({"objects": []}, "poses"),
        ({"poses": []}, "poses"),
        ({"poses": [np.eye(4)]}, r"poses\[0\]"),
        ({"poses": [(np.eye(2), np.zeros(3))]}, r"poses\[0\] R"),
        ({"poses": [(np.eye(3), np.zeros(2))]}, r"poses\[0\] t"),
        ({"poses": [(np.eye(3), np.array([0, 0, np.nan]))]}, r"poses\[0\] t"),
        ({"poses": [(2 * np.eye(3), np.zeros(3))]}, "poses"),
        ({"poses": [(np.diag([1, 1, -1]), np.zeros(3))]}, "poses"),
        ({"poses": [(np.eye(3), "here")]}, r"poses\[0\] t"),
        ({"K": np.eye(4)}, "K"),
        ({"K": np.zeros((3, 3))}, "K"),
        ({"K": K * np.nan}, "K"),
        ({"size": 40}, "size"),
        ({"size": (40, 0)}, "size"),
        ({"size": (40.5, 30)}, "size"),
        ({"size": (40, 99999)}, "size"),
        ({"near": 0}, "near"),
        ({"near": np.inf}, "near"),
    ],
)
def test_bad_input(shapes, change, name):
    good = {"objects": [shapes[0]], "poses": [EYE], "K": K, "size": (40, 30), "near": 0.01}
    with pytest.raises(ValueError, match=f"^{name}: "):
        Scene(**{**good, **change})
    with pytest.raises(ValueError, match=f"^{name}: "):
        render_labels(**{**good, **change})
