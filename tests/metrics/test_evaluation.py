"""Matching and measuring whole tables of poses."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posecore import metrics
from posecore.metrics import PoseTable, evaluation, report
from posecore.models import ObjectModel

K = np.array([[570.0, 0, 320], [0, 575, 240], [0, 0, 1]])
HALF_TURN = np.diag([-1.0, -1, 1, 1])


def table(rows):
    """From rows (scene, image, object, score, x in metres, angle about z in degrees)."""
    scene, image, object_id, score, x, angle = map(np.array, zip(*rows, strict=True))
    n = len(rows)
    return PoseTable(
        scene, image, object_id,
        R=Rotation.from_euler("z", angle[:, None], degrees=True).as_matrix(),
        t=np.column_stack([x, np.zeros(n), np.ones(n)]),
        score=score.astype(float),
        time=np.full(n, -1.0),
    )  # fmt: skip


def empty():
    return table([(1, 1, 1, 1, 0.0, 0.0)])[:0]


def model(symmetric=False):
    points = np.array(list(itertools.product((-0.05, 0.05), repeat=3)))
    symmetries = np.stack([np.eye(4), HALF_TURN]) if symmetric else None
    size = np.full(3, 0.1)
    return ObjectModel(
        1, points, 0.1 * np.sqrt(3), symmetries=symmetries, centre=np.zeros(3), size=size
    )


TRUTH = table([(1, 1, 7, 1, 0.0, 0.0), (1, 2, 7, 1, 0.0, 30.0), (1, 2, 8, 1, 0.3, 0.0)])


def test_the_surest_estimate_of_an_image_counts():
    estimates = table(
        [(1, 1, 7, 0.2, 0.0, 0.0), (1, 1, 7, 0.9, 0.5, 0.0), (1, 1, 7, 0.9, 0.1, 0.0),
         (1, 2, 9, 1.0, 0.0, 0.0), (2, 2, 7, 1.0, 0.0, 30.0), (1, 2, 8, 0.0, 0.3, 0.0)]
    )  # fmt: skip
    assert evaluation.match(estimates, TRUTH).tolist() == [1, -1, 5]
    assert evaluation.match(empty(), TRUTH).tolist() == [-1, -1, -1]
    assert evaluation.match(TRUTH, empty()).tolist() == []


def test_several_instances_are_assigned_to_the_nearest():
    truth = table([(1, 1, 7, 1, x, 0.0) for x in (0.0, 0.2, 0.4)])
    estimates = table(
        [(1, 1, 7, 0.9, 0.41, 0.0), (1, 1, 7, 0.8, 0.01, 0.0), (1, 1, 7, 0.1, 0.2, 0.0),
         (1, 1, 7, 0.7, 0.19, 0.0)]
    )  # fmt: skip
    assert evaluation.match(estimates, truth).tolist() == [1, 3, 0]  # the fourth surest is out
    assert evaluation.match(estimates[:2], truth).tolist() == [1, -1, 0]


@given(st.integers(0, 2**32 - 1))
def test_match_uses_no_estimate_twice(seed):
    rng = np.random.default_rng(seed)
    rows = [
        [(1, int(i), int(o), s, x, 0.0) for i, o, s, x in zip(*columns, strict=True)]
        for columns in [
            (rng.integers(0, 2, n), rng.integers(0, 3, n), rng.random(n), rng.random(n))
            for n in (12, 8)
        ]
    ]
    estimates, truth = map(table, rows)
    matched = evaluation.match(estimates, truth)
    used = matched[matched >= 0]
    assert len(set(used.tolist())) == len(used)
    np.testing.assert_array_equal(estimates.object_id[used], truth.object_id[matched >= 0])
    for key in set(zip(truth.image_id.tolist(), truth.object_id.tolist(), strict=True)):
        there = (truth.image_id == key[0]) & (truth.object_id == key[1])
        given_ = (estimates.image_id == key[0]) & (estimates.object_id == key[1])
        assert (matched[there] >= 0).sum() == min(there.sum(), given_.sum())


def test_errors_by_hand():
    """Object 7: one estimate 1 cm off, one pose missed. Object 8 has no model."""
    estimates = table([(1, 1, 7, 1, 0.01, 0.0), (1, 2, 8, 1, 0.3, 10.0)])
    errors = evaluation.evaluate(estimates, TRUTH, {7: model()}, K)
    values = errors[7].errors
    assert errors[7].found.tolist() == [True, False]
    for name in ("translation", "add", "mssd"):
        np.testing.assert_allclose(values[name], [0.01, np.inf], rtol=1e-9)
    np.testing.assert_allclose(values["rotation"], [0, np.inf], atol=1e-9)
    np.testing.assert_allclose(errors[7].overlap, [9 / 11, 0], rtol=1e-6)
    assert errors[7].diameter == 0.1 * np.sqrt(3)
    near, far = 570 * 0.01 / 0.95, 570 * 0.01 / 1.05  # the cube's two depths
    np.testing.assert_allclose(values["mspd"], [near, np.inf])
    np.testing.assert_allclose(values["projection"], [(near + far) / 2, np.inf])
    assert errors[7].precision == pytest.approx({0.25: 0.5, 0.5: 0.5, 0.75: 0.5})
    bare = errors[8].errors
    assert "add" not in bare
    assert errors[8].overlap is None
    assert errors[8].precision == {}
    # About the viewing axis: a turn of 10 degrees is a roll of 10 degrees.
    np.testing.assert_allclose(np.rad2deg(bare["roll"]), [10], rtol=1e-9)
    np.testing.assert_allclose(np.rad2deg(bare["rotation"]), [10], rtol=1e-9)


def test_a_symmetric_object_is_measured_at_its_best_symmetry():
    truth = table([(1, 1, 7, 1, 0.0, 0.0)])
    estimates = table([(1, 1, 7, 1, 0.0, 185.0)])
    plain = evaluation.evaluate(estimates, truth, {7: model()})[7].errors
    best = evaluation.evaluate(estimates, truth, {7: model(symmetric=True)})[7].errors
    assert np.rad2deg(plain["rotation"]) == pytest.approx([175])
    assert np.rad2deg(best["rotation"]) == pytest.approx([5])
    assert np.rad2deg(best["roll"]) == pytest.approx([5])
    assert best["mssd"] < plain["mssd"] / 5
    assert best["add_or_s"] == best["add_s"]
    assert plain["add_or_s"] == plain["add"]


def test_matrices_that_are_no_rotations_get_no_angles():
    truth = table([(1, 1, 7, 1, 0.0, 0.0)])
    stretched = replace(truth, R=truth.R * 1.01)
    errors = evaluation.evaluate(truth, stretched, {7: model()}, K)[7]
    assert {"rotation", "yaw"}.isdisjoint(errors.errors)
    assert errors.overlap is None
    assert errors.errors["add"] == pytest.approx(np.sqrt(3) * 0.05 * 0.01)


def test_one_bad_matrix_takes_the_angles_of_its_object_only():
    bent = replace(TRUTH, R=TRUTH.R * np.array([1, 1, 1.01])[:, None, None])  # of object 8
    errors = evaluation.evaluate(TRUTH, bent, {})
    assert "rotation" in errors[7].errors
    assert "rotation" not in errors[8].errors


def test_wrong_detections_lower_the_precision():
    """An estimate in an image without the object is no pose error, but a false detection."""
    estimates = table([(1, 1, 7, 0.5, 0.0, 0.0), (1, 5, 7, 0.9, 0.0, 0.0)])
    images = [(1, 1), (1, 2), (1, 5)]
    errors = evaluation.evaluate(estimates, TRUTH, {7: model()}, objects=[7], images=images)
    assert list(errors) == [7]
    assert errors[7].precision[0.5] == pytest.approx(0.5 * 0.5)


def test_images_that_are_not_evaluated_do_not_count():
    """The same estimate, in an image of which nothing is known."""
    estimates = table([(1, 1, 7, 0.5, 0.0, 0.0), (1, 5, 7, 0.9, 0.0, 0.0)])
    errors = evaluation.evaluate(estimates, TRUTH, {7: model()}, objects=[7])
    assert errors[7].precision[0.5] == pytest.approx(0.5)
    errors = evaluation.evaluate(estimates, TRUTH, {7: model()}, K, images=[(1, 1)])
    assert errors[7].found.tolist() == [True]
    assert 8 not in errors


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1))
def test_what_looks_right_is_right(seed):
    """Estimates that differ from the truth by a symmetry, about an axis off the origin."""
    rng = np.random.default_rng(seed)
    R, t = Rotation.random(4, rng=rng).as_matrix(), rng.normal(0, 0.1, (4, 3)) + (0, 0, 2)
    half_turn = HALF_TURN.copy()
    half_turn[:3, 3] = (0.1, 0.06, 0)  # about x = 5 cm, y = 3 cm
    corners = np.array(list(itertools.product((0, 0.1), (0, 0.06), (-0.02, 0.02))))
    symmetries = np.stack([np.eye(4), half_turn])
    size = np.array([0.1, 0.06, 0.04])
    box = ObjectModel(
        1, corners, 0.12, symmetries=symmetries, centre=size * (0.5, 0.5, 0), size=size
    )
    ids, ones = np.arange(4), np.ones(4)
    truth = PoseTable(ids, ids, ones.astype(int), R, t, ones, ones)
    flipped = rng.random(4) < 0.5
    T = np.where(flipped[:, None, None], half_turn, np.eye(4))
    estimates = replace(truth, R=R @ T[:, :3, :3], t=(R @ T[:, :3, 3:])[..., 0] + t)
    measured = evaluation.evaluate(estimates, truth, {1: box}, K)[1]
    for name in ("translation", "rotation", "yaw", "roll", "mssd", "mspd", "add_s"):
        assert np.abs(measured.errors[name]).max() < 1e-6, name
    assert measured.overlap.min() > 1 - 1e-6
    assert measured.precision[0.75] == 1
    assert (measured.errors["add"] > 0.05).tolist() == flipped.tolist()


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1))
def test_a_subset_of_the_objects_gets_the_same_errors(seed):
    rng = np.random.default_rng(seed)
    rows = [
        (1, i, o, rng.random(), rng.normal(0, 0.02), 5 * rng.normal())
        for i in range(3)
        for o in (7, 8)
    ]
    estimates, truth = table(rows), table([(*row[:3], 1, 0.0, 0.0) for row in rows])
    models = {7: model(), 8: model(symmetric=True)}
    both = evaluation.evaluate(estimates, truth, models, K)
    alone = evaluation.evaluate(estimates, truth, models, K, objects=[8])
    assert list(alone) == [8]
    assert alone[8].precision == both[8].precision
    for name, values in alone[8].errors.items():
        np.testing.assert_array_equal(values, both[8].errors[name])


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1))
def test_the_place_of_the_camera_does_not_matter(seed):
    """Poses seen from elsewhere have the same errors on the object."""
    rng = np.random.default_rng(seed)
    rows = [(1, i, 7, 1, rng.normal(0, 0.02), 5 * rng.normal()) for i in range(3)]
    estimates, truth = table(rows), table([(*row[:3], 1, 0.0, 0.0) for row in rows])
    R, t = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
    moved = [replace(poses, R=R @ poses.R, t=poses.t @ R.T + t) for poses in (estimates, truth)]
    here = evaluation.evaluate(estimates, truth, {7: model(symmetric=True)})[7]
    there = evaluation.evaluate(*moved, {7: model(symmetric=True)})[7]
    for name in ("translation", "rotation", "add", "add_s", "mssd"):
        np.testing.assert_allclose(there.errors[name], here.errors[name], atol=1e-9)
    np.testing.assert_allclose(there.overlap, here.overlap, atol=1e-7)


def test_a_flat_object_has_no_box():
    flat = replace(model(), size=np.array([0.1, 0.1, 0]))
    errors = evaluation.evaluate(TRUTH, TRUTH, {7: flat})[7]
    assert errors.overlap is None
    assert errors.errors["add"].max() == 0


def test_intrinsics_of_every_pose():
    estimates = table([(1, 1, 7, 1, 0.01, 0.0), (1, 2, 7, 1, 0.01, 30.0)])
    truth = TRUTH[:2]
    doubled = np.stack([K, K * [[2], [2], [1]]])
    values = evaluation.evaluate(estimates, truth, {7: model()}, doubled)[7].errors
    single = [
        metrics.projection_2d(
            doubled[i], estimates.R[i], estimates.t[i], truth.R[i], truth.t[i], model().points
        )
        for i in range(2)
    ]
    np.testing.assert_allclose(values["projection"], single)


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: evaluation.evaluate(TRUTH, empty(), {}), "ground_truth"),
        (lambda: evaluation.evaluate(TRUTH, TRUTH, {}, images=[(9, 9)]), "ground_truth"),
        (lambda: evaluation.evaluate(TRUTH, TRUTH, {}, objects=[7, 99]), "objects.*99"),
        (lambda: evaluation.evaluate(TRUTH, TRUTH, {}, objects=[]), "objects"),
        (lambda: evaluation.evaluate(TRUTH, TRUTH, {}, np.eye(4)), "K"),
        (lambda: evaluation.evaluate(TRUTH, TRUTH, {7: model()}, np.zeros((3, 3))), "object 7: K"),
    ],
)
def test_bad_input_is_named(call, name):
    with pytest.raises(ValueError, match=name):
        call()


def test_estimates_of_what_is_no_target_are_neither_right_nor_false():
    """Two instances, one of them a target; the surest estimate finds the other one."""
    truth = table([(1, 1, 7, 1, 0.0, 0.0)])
    others = table([(1, 1, 7, 1, 0.5, 0.0), (1, 1, 8, 1, 0.9, 0.0)])
    estimates = table([(1, 1, 7, 0.9, 0.5, 0.0), (1, 1, 7, 0.5, 0.001, 0.0)])

    def precision(estimates, others):
        errors = evaluation.evaluate(estimates, truth, {7: model()}, others=others)
        return errors[7].precision[0.5]

    assert precision(estimates, others) == 1
    assert precision(estimates, None) == 0.5  # nobody knows that it is there
    # A second estimate of it is false, and so is one of another object's place.
    again = table([(1, 1, 7, 0.9, 0.5, 0.0), (1, 1, 7, 0.8, 0.501, 0.0), (1, 1, 7, 0.5, 0.0, 0.0)])
    assert precision(again, others) == 0.5
    wrong = table([(1, 1, 7, 0.9, 0.9, 0.0), (1, 1, 7, 0.5, 0.0, 0.0)])
    assert precision(wrong, others) == 0.5


def test_a_true_pose_behind_the_camera_has_no_errors_in_pixels_only():
    behind = replace(TRUTH, t=TRUTH.t * [[1, 1, 1], [1, 1, -1], [1, 1, 1]])
    whole = evaluation.evaluate(TRUTH, TRUTH, {7: model(), 8: model()}, K)
    errors = evaluation.evaluate(TRUTH, behind, {7: model(), 8: model()}, K)
    assert errors[7].in_front.tolist() == [True, False]
    assert errors[7].found.all()
    for name in ("projection", "mspd"):
        assert errors[7].errors[name][0] == whole[7].errors[name][0]
        assert errors[7].errors[name][1] == np.inf
    assert errors[7].errors["add"] == pytest.approx([0, 2])
    lines = report.summarise([errors[7]])
    assert lines[report.CORRECT, "2D projection < 5 px"] == 100
    assert lines[report.CORRECT, "ADD < 0.1 d"] == 50
    assert lines[report.RECALL, "MSPD"] == 100
    assert lines[report.RECALL, "MSSD"] == 50
    assert lines[report.MEDIAN, "MSPD, px"] == pytest.approx(0, abs=1e-6)


def test_all_true_poses_behind_the_camera():
    behind = replace(TRUTH, t=-TRUTH.t)
    errors = evaluation.evaluate(TRUTH, behind, {7: model()}, K, objects=[7])
    lines = report.summarise([errors[7]])
    assert (report.RECALL, "MSPD") not in lines
    assert (report.MEDIAN, "2D projection, px") not in lines
    assert lines[report.RECALL, "MSSD"] == 0


def test_threads_change_no_number_and_are_left_as_they_were():
    before = torch.get_num_threads()
    turned = replace(TRUTH, t=TRUTH.t + 0.01)
    found = {}
    try:
        for threads in (1, 3):
            torch.set_num_threads(threads)
            found[threads] = evaluation.evaluate(turned, TRUTH, {7: model(True), 8: model()}, K)
            assert torch.get_num_threads() == threads
            with pytest.raises(ValueError):
                evaluation.evaluate(turned, TRUTH, {7: replace(model(), points=np.zeros((0, 3)))})
            assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)
    for one, three in zip(found[1].values(), found[3].values(), strict=True):
        assert one.errors.keys() == three.errors.keys()
        assert all(np.array_equal(one.errors[name], three.errors[name]) for name in one.errors)


@pytest.mark.parametrize("far", [1e155, 1e300])
def test_distances_whose_squares_overflow(far):
    """One instance or several: an estimate out there is wrong, and no matrix is infeasible."""
    truth = table([(1, 1, 7, 1, 0.0, 0.0), (1, 1, 7, 1, 0.2, 0.0), (1, 2, 7, 1, 0.0, 0.0)])
    estimates = table([(1, 1, 7, 1, far, 0.0), (1, 1, 7, 0.9, -far, 0.0), (1, 2, 7, 1, far, 0.0)])
    errors = evaluation.evaluate(estimates, truth, {7: model()}, K)[7]
    assert errors.found.all()
    assert (errors.errors["add"] > 1e150).all()
    assert (errors.overlap == 0).all()
    assert report.summarise([errors])[report.RECALL, "MSSD"] == 0
