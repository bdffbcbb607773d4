"""What is drawn into pictures lies where the camera sees it."""

import io

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from PIL import Image

from posecore import cameras, figures, metrics, poses, rotations
from posecore.figures.overlays import BOX_EDGES, box_edges

A_FEW = settings(max_examples=15)  # each draws a figure

K = np.array([[120.0, 0, 40], [0, 110.0, 30], [0, 0, 1]])
R = rotations.axis_angle_to_matrix([0.3, -0.5, 0.2])
T = np.array([0.05, -0.02, 0.6])
SIZE = np.array([0.1, 0.2, 0.3])
SEEDS = st.integers(0, 2**32 - 1)


def _axes():
    return figures.picture(np.zeros((60, 80), np.uint8)).axes[0]


def _lines(axes, name):
    return np.array([line.get_xydata() for line in axes.lines if line.get_gid() == name])


@given(SEEDS, st.floats(0.01, 0.2))
@A_FEW
def test_axes_are_where_the_camera_sees_them(seed, length):
    rng = np.random.default_rng(seed)
    R = rotations.axis_angle_to_matrix(rng.normal(size=3))
    t = rng.normal(size=3) * 0.2 + [0, 0, 1.5]
    axes = _axes()
    figures.draw_axes(axes, K, R, t, length)
    for number, letter in enumerate("xyz"):
        ends = np.stack([t, t + length * R[:, number]])
        (drawn,) = _lines(axes, f"axis {letter}")
        np.testing.assert_allclose(drawn, cameras.project(K, ends), rtol=1e-12)
    assert [text.get_text() for text in axes.texts] == ["x", "y", "z"]
    assert axes.get_xlim() == (-0.5, 79.5)
    assert axes.get_ylim() == (59.5, -0.5)


def _is_hidden(corners, edge):
    """Whether the box lies before the middle of its edge: the ray goes through the inside."""
    middle = corners[list(edge)].mean(0)
    frame = np.linalg.inv(np.stack([corners[4] - corners[0], corners[2] - corners[0],
                                    corners[1] - corners[0]], 1))  # fmt: skip
    before = np.linspace(0, 1, 4001)[1:-1, None] * middle
    inside = (before - corners[0]) @ frame.T
    return bool(((inside > 1e-4) & (inside < 1 - 1e-4)).all(1).any())


@given(SEEDS)
@A_FEW
def test_a_box_is_where_the_camera_sees_it_and_dashed_where_hidden(seed):
    rng = np.random.default_rng(seed)
    R = rotations.axis_angle_to_matrix(rng.normal(size=3))
    t, size = rng.normal(size=3) * 0.2 + [0, 0, 1.5], rng.uniform(0.1, 0.4, 3)
    centre = rng.normal(size=3) * 0.1
    axes = _axes()
    figures.draw_box(axes, K, R, t, size, centre=centre)
    corners = metrics.box_corners(R, R @ centre + t, size)
    pixels = cameras.project(K, corners)
    expected = {True: [], False: []}
    for one in range(8):
        for two in range(one + 1, 8):
            difference = np.abs(np.linalg.norm(corners[one] - corners[two]) - size)
            if difference.min() > 1e-9 or not _shares_two_coordinates(
                R, corners[one], corners[two]
            ):
                continue
            expected[_is_hidden(corners, (one, two))].append(pixels[[one, two]])
    assert len(expected[True]) + len(expected[False]) == 12
    for hidden, name in ((True, "hidden edge"), (False, "edge")):
        drawn = _lines(axes, name)
        wanted = np.array(expected[hidden])
        assert len(drawn) == len(wanted)
        np.testing.assert_allclose(drawn, wanted, rtol=1e-9, atol=1e-9)


def _shares_two_coordinates(R, one, two):
    return (np.abs(R.T @ (one - two)) < 1e-9).sum() == 2


def test_hidden_edges_are_dashed_and_the_others_are_not():
    axes = _axes()
    figures.draw_box(axes, K, R, T, SIZE)
    styles = {line.get_gid(): line.get_linestyle() for line in axes.lines}
    assert styles == {"edge": "-", "hidden edge": "--"}
    assert len(_lines(axes, "hidden edge")) == 3


def test_from_inside_a_box_all_edges_are_hidden():
    corners, hidden = box_edges(np.eye(3), [0, 0, 0.1], [1, 1, 1], [0, 0, 0])
    assert hidden.all()
    assert (corners[:, 2] < 0).any()


def test_what_is_behind_the_camera_is_cut():
    axes = _axes()
    figures.draw_axes(axes, K, np.eye(3), [0.1, 0, -0.05], 0.1)  # only the z axis comes forward
    assert [line.get_gid() for line in axes.lines] == ["axis z"]
    (drawn,) = _lines(axes, "axis z")
    assert np.isfinite(drawn).all()
    np.testing.assert_allclose(drawn[1], cameras.project(K, [[0.1, 0, 0.05]])[0])
    np.testing.assert_allclose(drawn[0], cameras.project(K, [[0.1, 0, 1e-4]])[0])
    figures.draw_box(axes, K, np.eye(3), [0, 0, -1], [0.1, 0.1, 0.1])
    assert len(axes.lines) == 1


def test_a_matrix_that_is_not_quite_a_rotation_is_drawn_as_it_is():
    bent = R * 1.004
    axes = _axes()
    figures.draw_axes(axes, K, bent, T, 0.1)
    ends = cameras.project(K, poses.apply(bent, T, [[0, 0, 0], [0.1, 0, 0]]))
    np.testing.assert_allclose(_lines(axes, "axis x")[0], ends)


@given(arrays(np.float64, st.tuples(st.integers(1, 9), st.just(2)), elements=st.floats(0, 50)))
@A_FEW
def test_keypoints_are_where_they_are(pixels):
    axes = _axes()
    figures.draw_keypoints(axes, torch.from_numpy(pixels), label="found", numbers=True)
    (drawn,) = axes.collections
    np.testing.assert_array_equal(drawn.get_offsets(), pixels)
    assert drawn.get_label() == "found"
    assert [text.get_text() for text in axes.texts] == [str(i) for i in range(len(pixels))]


def test_crosses_can_be_keypoints():
    axes = _axes()
    figures.draw_keypoints(axes, [[1, 2]], marker="x")
    axes.figure.png()
    assert len(axes.collections) == 1


@given(arrays(bool, array_shapes(min_dims=2, max_dims=2, max_side=9)))
@A_FEW
def test_an_outline_is_the_border_of_the_mask(mask):
    axes = _axes()
    figures.draw_outline(axes, mask)
    points = axes.lines[0].get_xydata()
    pairs = np.stack([points[:-1], points[1:]], axis=1)
    segments = pairs[np.isfinite(pairs).all((1, 2))]
    padded = np.pad(mask, 1).astype(int)
    border = np.abs(np.diff(padded, axis=0)).sum() + np.abs(np.diff(padded, axis=1)).sum()
    assert np.abs(np.diff(segments, axis=1)).sum() == border
    # Walking right from the left edge, an odd number of borders has been crossed inside.
    rows, columns = np.indices(mask.shape)
    upright = segments[segments[:, 0, 0] == segments[:, 1, 0]]
    x, low, high = upright[:, 0, 0], upright[..., 1].min(1), upright[..., 1].max(1)
    left = (x < columns[..., None]) & (low < rows[..., None]) & (rows[..., None] < high)
    np.testing.assert_array_equal(left.sum(-1) % 2 == 1, mask)
    # Every part of the line is closed, so that dashes run on and corners have no gap.
    for part in np.split(points, np.flatnonzero(np.isnan(points[:, 0]))):
        closed = part[np.isfinite(part[:, 0])]
        np.testing.assert_array_equal(closed[:1], closed[-1:])


def test_the_rim_of_an_outline_does_not_cover_the_outline():
    """The rim of each small piece used to be drawn over its neighbours."""
    yy, xx = np.mgrid[0:60, 0:60]
    figure = figures.picture(np.zeros((60, 60), np.uint8), width=4)
    figures.draw_outline(figure.axes[0], (xx - 30) ** 2 + (yy - 30) ** 2 < 400, colour="#D55E00")
    pixels = np.asarray(Image.open(io.BytesIO(figure.png())).convert("RGB")).astype(int)
    inked = (np.abs(pixels - [0xD5, 0x5E, 0]).sum(-1) < 60).sum()
    assert inked > 950  # 772 with gaps between its pieces


def test_no_keypoints_draw_nothing():
    axes = _axes()
    figures.draw_keypoints(axes, np.zeros((0, 2)), numbers=True)
    figures.draw_keypoints(axes, torch.zeros(0, 2))
    assert not axes.collections and not axes.texts


def test_the_outline_of_a_disc_agrees_with_opencv():
    disc = cv2.circle(np.zeros((40, 40), np.uint8), (20, 20), 12, 1, -1)
    axes = _axes()
    figures.draw_outline(axes, torch.from_numpy(disc), label="mask", style="--")
    points = axes.lines[0].get_xydata()
    points = points[np.isfinite(points[:, 0])]
    assert (axes.lines[0].get_label(), axes.lines[0].get_linestyle()) == ("mask", "--")
    contour = cv2.findContours(disc, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0][0][:, 0]
    np.testing.assert_array_equal(points.min(0), contour.min(0) - 0.5)
    np.testing.assert_array_equal(points.max(0), contour.max(0) + 0.5)


def test_edges_join_corners_that_differ_in_one_coordinate():
    signs = metrics.box_corners(np.eye(3), np.zeros(3), [2, 2, 2])
    assert len(BOX_EDGES) == 12
    assert (np.abs(signs[BOX_EDGES[:, 0]] - signs[BOX_EDGES[:, 1]]).sum(1) == 2).all()


BAD_K = np.array([[0.0, 0, 1], [0, 1, 1], [0, 0, 1]])


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda a: figures.draw_axes(a, BAD_K, R, T, 0.1), "K"),
        (lambda a: figures.draw_axes(a, K[:2], R, T, 0.1), "K"),
        (lambda a: figures.draw_axes(a, K, R[:2], T, 0.1), "R"),
        (lambda a: figures.draw_axes(a, K, R * np.nan, T, 0.1), "R"),
        (lambda a: figures.draw_axes(a, K, R, T[:2], 0.1), "t"),
        (lambda a: figures.draw_axes(a, K, R, T, 0), "length"),
        (lambda a: figures.draw_box(a, BAD_K, R, T, SIZE), "K"),
        (lambda a: figures.draw_box(a, K, R * 0, T, SIZE), "R"),
        (lambda a: figures.draw_box(a, K, R, T, -SIZE), "size"),
        (lambda a: figures.draw_box(a, K, R, T, SIZE[:2]), "size"),
        (lambda a: figures.draw_box(a, K, R, T, SIZE, centre=[0, 0]), "centre"),
        (lambda a: figures.draw_keypoints(a, [1, 2]), "pixels"),
        (lambda a: figures.draw_keypoints(a, np.zeros((0, 3))), "pixels"),
        (lambda a: figures.draw_keypoints(a, [[1, np.inf]]), "pixels"),
        (lambda a: figures.draw_outline(a, np.zeros(3)), "mask"),
        (lambda a: figures.draw_outline(a, "mask"), "mask"),
    ],
)
def test_bad_input_is_named(call, name):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        call(_axes())


def test_an_ellipse_holds_two_deviations():
    axes = figures.picture(np.zeros((60, 80))).axes[0]
    turn = np.radians(30)
    along, across = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    covariance = 9 * np.outer(along, along) + 4 * np.outer(across, across)
    figures.draw_ellipse(axes, [40, 30], covariance)
    (ring,) = axes.patches
    assert (ring.width, ring.height) == pytest.approx((12, 8))
    assert np.mod(ring.angle, 180) == pytest.approx(30)
    tip = ring.get_patch_transform().transform([1, 0])
    assert abs((tip - [40, 30]) @ along) == pytest.approx(6)
    figures.draw_ellipse(axes, [1, 1], np.zeros((2, 2)), rim=True)
    with pytest.raises(ValueError, match="covariance"):
        figures.draw_ellipse(axes, [1, 1], np.eye(3))
