"""Directions of a viewer and the parts of a scene."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from posecore import metrics, poses
from posecore.figures.scene import build_scene, directions

POINTS = np.random.default_rng(0).normal(size=(5, 3))
R = np.stack([np.eye(3), np.eye(3)[[1, 2, 0]]])
T = np.array([[0.0, 0, 1], [1, 0, 0]])


def _build(clouds=None, colours=None, axes=None, length=None, boxes=None, lines=None, up="z"):
    return build_scene(clouds or {}, colours, axes, length, boxes, lines, up)


@given(st.floats(-4, 4), st.floats(-1.5, 1.5), st.sampled_from(["z", "-y"]))
def test_directions_are_a_rotation_with_up_upwards(azimuth, elevation, up):
    rows = directions(azimuth, elevation, up)
    np.testing.assert_allclose(rows @ rows.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rows) == pytest.approx(1)
    upwards = np.array([0, 0, 1] if up == "z" else [0, -1, 0])
    assert rows[0] @ upwards == pytest.approx(0)
    assert rows[1] @ upwards == pytest.approx(np.cos(elevation))


def test_the_front_of_a_camera_frame_is_what_the_camera_sees():
    np.testing.assert_allclose(
        directions(-np.pi / 2, 0, "-y"), [[1, 0, 0], [0, -1, 0], [0, 0, -1]], atol=1e-12
    )


@given(st.floats(0.01, 1))
def test_axes_and_boxes_are_where_the_pose_puts_them(length):
    size = np.array([0.1, 0.2, 0.3])
    scene = _build(axes=(R, torch.tensor(T)), length=length, boxes=(R, T, size))
    boxes, *axes = scene.parts
    assert [part.label for part in axes] == ["x", "y", "z"]
    for number, part in enumerate(axes):
        tips = poses.apply(R, T, [np.eye(3)[number] * length])
        np.testing.assert_allclose(part.positions, np.concatenate([T[:, None], tips], 1))
    assert boxes.positions.shape == (24, 2, 3)
    corners = metrics.box_corners(R, T, size).reshape(-1, 3)
    ends = boxes.positions.reshape(-1, 3)
    np.testing.assert_array_equal(np.unique(ends, axis=0), np.unique(corners, axis=0))
    edges = np.linalg.norm(boxes.positions[:, 0] - boxes.positions[:, 1], axis=-1)
    np.testing.assert_allclose(np.sort(edges), np.repeat(size, 8))


def test_colours_are_chosen_or_taken_from_the_palette():
    rgb = np.arange(15, dtype=np.uint8).reshape(5, 3)
    clouds = {"a": POINTS, "b": POINTS, "c": POINTS}
    scene = _build(
        clouds, {"a": rgb, "b": "red", "l": [0, 0.5, 1.0]}, lines={"l": POINTS[None, :2]}
    )
    a, b, c, line = scene.parts
    np.testing.assert_allclose(a.colours, rgb / 255)
    np.testing.assert_allclose(b.colours, [1, 0, 0])
    assert c.colours.shape == (3,)
    np.testing.assert_allclose(line.colours, [0, 0.5, 1])
    assert scene.describe() == "a (5 points), b (5 points), c (5 points), l"
    tensor = _build({"a": POINTS}, {"a": torch.from_numpy(rgb)}).parts[0]
    np.testing.assert_allclose(tensor.colours, a.colours)
    learnt = torch.rand(5, 3, requires_grad=True)
    byte = np.array([1, 0, 1], np.uint8)
    (a, b) = _build({"a": POINTS, "b": POINTS}, {"a": learnt, "b": byte}).parts
    np.testing.assert_allclose(a.colours, learnt.detach())
    np.testing.assert_allclose(b.colours, byte / 255)


def test_one_point_with_axes_has_axes_of_some_length():
    scene = _build({"a": [[0, 0, 1]]}, axes=(np.eye(3), [0, 0, 1]))
    assert np.ptp(scene.parts[-1].positions) > 0


CLOUD = {"a": POINTS}


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: _build(), "clouds"),
        (lambda: build_scene(POINTS, None, None, None, None, None, "z"), "clouds"),
        (lambda: _build({1: POINTS}), "clouds"),
        (lambda: _build({"a": POINTS[:, :2]}), r"clouds\['a'\]"),
        (lambda: _build({"a": POINTS[:0]}), r"clouds\['a'\]"),
        (lambda: _build({"a": POINTS * np.inf}), r"clouds\['a'\]"),
        (lambda: _build(CLOUD, {"b": "red"}), "colours"),
        (lambda: _build(CLOUD, {"a": "no colour"}), r"colours\['a'\]"),
        (lambda: _build(CLOUD, {"a": np.ones((4, 3))}), r"colours\['a'\]"),
        (lambda: _build(CLOUD, {"a": np.full((5, 3), 1.1)}), r"colours\['a'\]"),
        (lambda: _build(CLOUD, {"a": np.full((5, 3), 256)}), r"colours\['a'\]"),
        (lambda: _build(CLOUD, {"a": [None, 1]}), r"colours\['a'\]"),
        (lambda: _build(CLOUD, {"a": (1, 0, 0)}), r"colours\['a'\]"),  # red, or nearly black?
        (lambda: _build(CLOUD, {"a": torch.tensor([1, 1, 0])}), r"colours\['a'\]"),
        (lambda: _build(CLOUD, {"a": [[1, 2], [3]]}), r"colours\['a'\]"),
        (lambda: _build(CLOUD, lines={"l": POINTS}), r"lines\['l'\]"),
        (lambda: _build(CLOUD, lines=POINTS), "lines"),
        (lambda: _build(CLOUD, axes=R), "axes"),
        (lambda: _build(CLOUD, axes=(R, T, T)), "axes"),
        (lambda: _build(CLOUD, axes=(R[:, :2], T)), "axes: R"),
        (lambda: _build(CLOUD, axes=(R, np.ones((3, 3)))), "axes: t"),
        (lambda: _build(CLOUD, axes=(R, T), length=0), "axis_length"),
        (lambda: _build(CLOUD, boxes=(R, T)), "boxes"),
        (lambda: _build(CLOUD, boxes=(R, T, [1, 2])), "boxes: size"),
        (lambda: _build(CLOUD, boxes=(R, T, [1, 2, -1])), "size"),
        (lambda: _build(CLOUD, up="y"), "up"),
    ],
)
def test_bad_input_is_named(call, name):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        call()
