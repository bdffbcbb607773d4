"""Oriented boxes against closed forms, an independent solver of half-spaces, and the errata."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection
from scipy.spatial.transform import Rotation

from posecore import metrics

seeds = st.integers(0, 2**32 - 1)
EYE, ZERO, ONE = np.eye(3), np.zeros(3), np.ones(3)


def random_box(rng, spread=0.6):
    R = Rotation.random(random_state=rng).as_matrix()
    return R, rng.uniform(-spread, spread, 3), rng.uniform(0.1, 1.5, 3)


def halfspaces(R, t, size):
    normals = np.concatenate([R.T, -R.T])
    return np.column_stack([normals, -normals @ t - np.tile(size, 2) / 2])


def iou_by_halfspaces(one, two):
    """Another road to the same volume: the dual of the twelve half-spaces."""
    planes = np.concatenate([halfspaces(*one), halfspaces(*two)])
    # The centre of the largest ball that fits is an interior point.
    lifted = np.column_stack([planes[:, :3], np.ones(12)])
    best = linprog(
        [0, 0, 0, -1], A_ub=lifted, b_ub=-planes[:, 3], bounds=[(None, None)] * 3 + [(0, None)]
    )
    if best.status != 0 or best.x[3] < 1e-9:
        return 0.0
    corners = HalfspaceIntersection(planes, best.x[:3]).intersections
    shared = ConvexHull(corners).volume
    return shared / (one[2].prod() + two[2].prod() - shared)


@given(seeds)
def test_iou_agrees_with_halfspaces(seed):
    rng = np.random.default_rng(seed)
    one, two = random_box(rng), random_box(rng)
    expected = iou_by_halfspaces(one, two)
    assert metrics.oriented_iou_3d(*one, *two) == pytest.approx(expected, abs=1e-7)


@given(seeds)
def test_iou_of_aligned_boxes_is_a_product_of_intervals(seed):
    """Both boxes turned alike: the overlap along each axis is an overlap of intervals."""
    rng = np.random.default_rng(seed)
    R, t, size = random_box(rng)
    offset, other = rng.uniform(-0.5, 0.5, 3), rng.uniform(0.1, 1.5, 3)
    low, high = np.maximum(-size, 2 * offset - other) / 2, np.minimum(size, 2 * offset + other) / 2
    shared = np.prod(np.clip(high - low, 0, None))
    expected = shared / (size.prod() + other.prod() - shared)
    iou = metrics.oriented_iou_3d(R, t, size, R, t + R @ offset, other)
    assert iou == pytest.approx(expected, abs=1e-7)


@given(seeds)
def test_iou_properties(seed):
    rng = np.random.default_rng(seed)
    one, two = random_box(rng), random_box(rng)
    iou = metrics.oriented_iou_3d(*one, *two)
    assert 0 <= iou <= 1
    assert metrics.oriented_iou_3d(*two, *one) == pytest.approx(iou, abs=1e-9)
    assert metrics.oriented_iou_3d(*one, *one) == pytest.approx(1, abs=1e-9)
    # Moving both boxes, or measuring in other units, changes nothing.
    R, t = Rotation.random(random_state=rng).as_matrix(), rng.normal(0, 10, 3)
    moved = [(R @ B, R @ c + t, s) for B, c, s in (one, two)]
    assert metrics.oriented_iou_3d(*moved[0], *moved[1]) == pytest.approx(iou, abs=1e-8)
    for unit in (1e-3, 1e3):
        scaled = [(B, c * unit, s * unit) for B, c, s in (one, two)]
        assert metrics.oriented_iou_3d(*scaled[0], *scaled[1]) == pytest.approx(iou, abs=1e-8)


def test_iou_of_special_positions():
    quarter = Rotation.from_euler("z", 45, degrees=True).as_matrix()
    octagon = 2 * (
        np.sqrt(2) - 1
    )  # area that a unit square shares with itself turned by 45 degrees
    cases = [
        (EYE, (1, 0, 0), ONE, 0.0),  # faces touch
        (EYE, (1, 1, 0), ONE, 0.0),  # edges touch
        (EYE, (1, 1, 1), ONE, 0.0),  # corners touch
        (EYE, (0.5, 0, 0), ONE, 1 / 3),
        (EYE, (0, 0, 0), ONE / 2, 1 / 8),  # inside
        (EYE, (0.25, 0.25, 0.25), ONE / 2, 1 / 8),  # inside, three faces shared
        (quarter, (0, 0, 0), ONE, octagon / (2 - octagon)),
        (EYE, (50, 0, 0), ONE, 0.0),
        (EYE, (0, 0, 0), np.array([10, 1e-3, 1e-3]), 1e-6 / (1 + 1e-5 - 1e-6)),  # a needle
        (-EYE * [1, 1, -1], (0, 0, 0), ONE, 1.0),  # half a turn
    ]
    for R, t, size, expected in cases:
        iou = metrics.oriented_iou_3d(EYE, ZERO, ONE, R, t, size)
        assert iou == pytest.approx(expected, abs=1e-8), (R, t, size)


@pytest.mark.parametrize("angle", [1e-13, 1e-12, 1e-10, 1e-8, 1e-6, 1e-4])
def test_iou_of_nearly_equal_boxes(angle):
    """Edges that lie almost in a face of the other box must not get lost."""
    for axis in (*EYE, ONE, np.array([1, -2, 0.5])):
        R = Rotation.from_rotvec(axis * angle).as_matrix()
        iou = metrics.oriented_iou_3d(EYE, ZERO, ONE, R, axis * angle, ONE)
        assert 1 - 8 * angle - 1e-8 <= iou <= 1


def test_iou_batches():
    rng = np.random.default_rng(0)
    boxes = [random_box(rng) for _ in range(4)]
    R, t, size = (np.stack(x) for x in zip(*boxes, strict=True))
    table = metrics.oriented_iou_3d(R[:, None], t[:, None], size[:, None], R, t, size)
    assert table.shape == (4, 4)
    for i in range(4):
        for j in range(4):
            single = metrics.oriented_iou_3d(*boxes[i], *boxes[j])
            assert table[i, j] == pytest.approx(single, abs=1e-12)
    assert metrics.oriented_iou_3d(R[:0], t[:0], size[:0], R[0], t[0], size[0]).shape == (0,)
    assert metrics.oriented_iou_3d(*(torch.tensor(x) for x in (R, t, size)), *boxes[0]).shape == (
        4,
    )


@given(seeds)
def test_corners_are_half_a_size_away(seed):
    R, t, size = random_box(np.random.default_rng(seed))
    corners = metrics.box_corners(R, t, size)
    local = (corners - t) @ R
    np.testing.assert_allclose(np.abs(local), np.tile(size / 2, (8, 1)), atol=1e-12)
    np.testing.assert_allclose(corners.mean(0), t, atol=1e-12)
    assert (local[0] < 0).all()
    assert (local[1] > 0).tolist() == [False, False, True]
    assert len(np.unique(local > 0, axis=0)) == 8


def cube(*centre, edge=0.1):
    return EYE, np.array(centre), np.full(3, edge)


def test_legacy_iou_is_no_iou():
    """A 10 cm cube at 0.8 m, shifted by 5 cm: 0.885 where the truth is a third (errata, CIPE)."""
    assert metrics.oriented_iou_3d(*cube(0, 0, 0.8), *cube(0.05, 0, 0.8)) == pytest.approx(1 / 3)
    legacy = metrics.nocs_legacy_iou(*cube(0, 0, 0.8), *cube(0.05, 0, 0.8))
    assert legacy == pytest.approx(0.885, abs=5e-4)


@given(seeds)
def test_legacy_iou_is_the_formula_of_the_errata(seed):
    """Corner by corner, in a loop: an interval from the smallest to the largest coordinate."""
    rng = np.random.default_rng(seed)
    one, two = random_box(rng), random_box(rng)
    shared = volume_1 = volume_2 = 1.0
    for a, b in zip(metrics.box_corners(*one), metrics.box_corners(*two), strict=True):
        low, high = max(a.min(), b.min()), min(a.max(), b.max())
        shared = 0.0 if high < low else shared * (high - low)
        volume_1, volume_2 = volume_1 * np.ptp(a), volume_2 * np.ptp(b)
    expected = shared / (volume_1 + volume_2 - shared)
    assert metrics.nocs_legacy_iou(*one, *two) == pytest.approx(expected, rel=1e-9)


def test_legacy_iou_takes_the_best_turn_of_a_symmetric_object():
    R, t, size = random_box(np.random.default_rng(1))
    turned = R @ Rotation.from_euler("y", 18 * 3, degrees=True).as_matrix()  # 3 of 20 steps
    assert metrics.nocs_legacy_iou(R, t, size, turned, t, size) < 0.999
    score = metrics.nocs_legacy_iou(R, t, size, turned, t, size, symmetric=True)
    assert score == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: metrics.oriented_iou_3d(EYE * 2, ZERO, ONE, EYE, ZERO, ONE), "R_1"),
        (lambda: metrics.oriented_iou_3d(EYE, ZERO, ONE, -EYE, ZERO, ONE), "R_2"),
        (lambda: metrics.oriented_iou_3d(EYE, ZERO, ZERO, EYE, ZERO, ONE), "size_1"),
        (lambda: metrics.oriented_iou_3d(EYE, ZERO, ONE, EYE, ZERO, -ONE), "size_2"),
        (lambda: metrics.nocs_legacy_iou(EYE, ZERO, ZERO, EYE, ZERO, ONE), "size_1"),
        (lambda: metrics.nocs_legacy_iou(EYE, ZERO, ONE, EYE, ZERO, ONE, True, 0), "steps"),
        (lambda: metrics.box_corners(EYE, ZERO, -ONE), "size"),
    ],
)
def test_bad_input_is_named(call, name):
    with pytest.raises(ValueError, match=name):
        call()


# Boxes that may turn ------------------------------------------------------------------------------


def turned(R, axis, angle):
    return R @ Rotation.from_rotvec(axis / np.linalg.norm(axis) * angle).as_matrix()


@settings(max_examples=8)
@given(seeds, st.booleans())
def test_a_turned_box_is_as_good_as_the_best_of_many_turns(seed, upright):
    """Never better than is possible, never more than a little worse than 90 turns."""
    rng = np.random.default_rng(seed)
    axis = np.array([0, 2.0, 0]) if upright else rng.normal(size=3)
    one, two = random_box(rng, 0.3), random_box(rng, 0.3)
    angles = np.arange(90) * 2 * np.pi / 90
    turns = np.stack([turned(one[0], axis, angle) for angle in angles])
    best = metrics.oriented_iou_3d(turns, *one[1:], *two).max()
    iou = metrics.turned_iou_3d(*one, *two, axis)
    assert iou >= metrics.oriented_iou_3d(*one, *two) - 0.03
    assert best - 0.03 <= iou <= best + 0.01


@settings(max_examples=15)
@given(seeds)
def test_what_is_only_turned_overlaps_wholly(seed):
    """Whatever the angle: 20 steps from the estimate's own angle would miss it."""
    rng = np.random.default_rng(seed)
    R, t, size = random_box(rng)
    axis = rng.normal(size=3)
    other = turned(R, axis, rng.uniform(-4, 4))
    assert metrics.turned_iou_3d(R, t, size, other, t, size, axis) == pytest.approx(1, abs=1e-6)


def test_the_docstrings_example():
    nine = turned(EYE, np.array([0, 1, 0]), np.deg2rad(9))
    step = np.deg2rad(18) * np.arange(20)
    turns = np.stack([turned(EYE, np.array([0, 1, 0]), angle) for angle in step])
    assert metrics.oriented_iou_3d(turns, ZERO, ONE, nine, ZERO, ONE).max() == pytest.approx(
        0.87, abs=0.005
    )


def test_each_box_turns_about_its_own_axis_or_not_at_all():
    quarter = turned(EYE, np.array([0, 1, 0]), np.pi / 2)
    size, axes = np.array([1, 1, 3.0]), np.array([[0, 0, 0], [0, 1, 0], [0, 0, 1]])
    iou = metrics.turned_iou_3d(EYE, ZERO, size, quarter, ZERO, size, axes)
    np.testing.assert_allclose(iou, [0.2, 1, 0.2], atol=1e-9)
    whole = metrics.turned_iou_3d(EYE, ZERO, size, quarter, ZERO, size, axes, steps=1)
    np.testing.assert_allclose(whole, [0.2, 1, 0.2], atol=1e-9)
    with pytest.raises(ValueError, match="steps"):
        metrics.turned_iou_3d(EYE, ZERO, size, quarter, ZERO, size, axes, steps=0)
