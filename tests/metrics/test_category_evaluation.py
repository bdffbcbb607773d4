"""Category-level average precision against plain loops, and in cases counted by hand."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posecore.metrics import CategoryPoseTable, evaluate_categories, nocs_axes
from posecore.rotations import random_rotations
from tests.metrics import category_loop

EYE = np.eye(3)
IOUS = (0.1, 0.25, 0.5, 0.75)
POSES = ((5, 2), (10, 5), (30, 4), (60, 10))


def scene(rng):
    """A few images with one category: objects, estimates near and far of them, each row a dict."""
    things, estimates = [], []
    scores = iter(rng.permutation(60) / 60)  # no two are equal
    for image in range(3):
        for _ in range(rng.integers(0, 3)):
            R = random_rotations(generator=rng)
            axis = [0.0, float(rng.random() < 0.3), 0.0]
            t, size = rng.uniform(-0.08, 0.08, 3) + [0, 0, 0.8], rng.uniform(0.05, 0.15, 3)
            things.append({"image": image, "R": R, "t": t, "size": size, "axis": np.array(axis)})
            for _ in range(rng.integers(0, 3)):
                w = rng.normal(0, 0.2, 3)
                turn = category_loop.about(w, np.linalg.norm(w))
                if axis[1]:
                    turn = turn @ category_loop.about(np.array(axis), rng.uniform(0, 6))
                estimates.append(
                    {
                        "image": image,
                        "R": R @ turn,
                        "t": t + rng.normal(0, 0.02, 3),
                        "size": size * rng.uniform(0.8, 1.2, 3),
                        "score": next(scores),
                    }
                )
    return [estimates[i] for i in rng.permutation(len(estimates))], things


def table(rows, category="mug"):
    columns = {
        name: [row[name] for row in rows]
        for name in ("image", "R", "t", "size", "axis", "score")
        if rows and name in rows[0]
    }
    columns["image_id"] = np.array(columns.pop("image", []), int)
    if "axis" in columns:
        columns["axis"] = np.array(columns["axis"])
    R, t, size = (columns.pop(name, []) for name in ("R", "t", "size"))
    return CategoryPoseTable.from_arrays(category, R, t, size, **columns)


@pytest.mark.slow
@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_the_papers_protocol_is_that_of_the_plain_loop(seed):
    estimates, things = scene(np.random.default_rng(seed))
    if not things:
        return
    result = evaluate_categories(
        table(estimates), table(things), iou_thresholds=IOUS, pose_thresholds=POSES
    )["mug"]
    box, pose, of_all = category_loop.by_the_paper(estimates, things, IOUS, POSES)
    assert result.iou == pytest.approx(box, abs=1e-9)
    assert result.pose == pytest.approx(pose, abs=1e-9)
    assert result.pose_of_all == pytest.approx(of_all, abs=1e-9)


@pytest.mark.slow
@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_the_codes_protocol_is_that_of_the_plain_loop(seed):
    estimates, things = scene(np.random.default_rng(seed))
    if not things:
        return
    result = evaluate_categories(
        table(estimates),
        table(things),
        protocol="code",
        iou_thresholds=IOUS,
        pose_thresholds=POSES,
    )["mug"]
    box, pose = category_loop.by_the_code(estimates, things, IOUS, POSES)
    assert result.iou == pytest.approx(box, abs=1e-9)
    assert result.pose == pytest.approx(pose, abs=1e-9)


@pytest.mark.slow
def test_the_random_scenes_are_about_something():
    """All kinds of answers come: the loops are not compared on zeros and ones alone."""
    seen, apart = [], 0
    for seed in range(8):
        estimates, things = scene(np.random.default_rng(seed))
        box, pose, of_all = category_loop.by_the_paper(estimates, things, IOUS, POSES)
        literal = category_loop.by_the_code(estimates, things, IOUS, POSES)
        seen += [*box.values(), *pose.values(), *of_all.values()]
        apart += literal != (box, pose)
    assert ((np.array(seen) > 0) & (np.array(seen) < 1)).mean() > 0.3
    assert apart > 2


def boxes(shifts, score=None, category="mug", **columns):
    """Cubes of 10 cm, a row for each shift in metres along x."""
    t = np.array([[shift, 0, 1] for shift in shifts], float)
    size = np.full((len(t), 3), 0.1)
    columns |= {} if score is None else {"score": np.array(score, float)}
    return CategoryPoseTable.from_arrays(category, np.tile(EYE, (len(t), 1, 1)), t, size, **columns)


def test_a_case_counted_by_hand():
    """Two cubes 1 m apart; an estimate of the first, a false one that is surer, none of the second.

    The precision at recall 1/2 is 1/2: AP 1/4 of all; of the one pair it is 1.
    """
    result = evaluate_categories(boxes([0.01, 5], [0.5, 0.9]), boxes([0, 1]))["mug"]
    assert (result.count, result.estimated) == (2, 2)
    assert result.pairs.tolist() == [[0, 0]]
    assert result.iou == {0.25: 0.25, 0.5: 0.25, 0.75: 0.25}  # IoU is 0.09 / 0.11
    assert result.overlap == pytest.approx([9 / 11])
    assert result.pose[5, 2] == 1 and result.pose_of_all[5, 2] == 0.25
    assert result.translation == pytest.approx([0.01])
    assert result.rotation == pytest.approx([0], abs=1e-7)


def test_an_estimate_finds_once_and_the_surest_first():
    """Two estimates of one cube: the surer one has it, though the other is nearer."""
    result = evaluate_categories(boxes([0.0, 0.02], [0.1, 0.9]), boxes([0]))["mug"]
    assert result.pairs.tolist() == [[1, 0]]
    assert result.iou[0.5] == 1.0 and result.iou[0.75] == 0.5  # IoU 2 / 3 of the surer


def test_limits_are_not_reached_by_the_paper_but_by_the_code():
    estimates, truth = boxes([0.0625]), boxes([0])
    limits = [(5, 6.25)]
    for protocol, expected in (("paper", 0.0), ("code", 1.0)):
        result = evaluate_categories(estimates, truth, protocol=protocol, pose_thresholds=limits)[
            "mug"
        ]
        assert result.pose[limits[0]] == expected


def test_the_code_tears_pairs_apart():
    """Two cubes side by side, one of them turned, and estimates that have them the wrong way round.

    By the paper each estimate belongs to the cube that it lies in, and is 10 degrees off; by the
    code it is 7 cm from the other, whose angle it has.
    """
    turn = category_loop.about(np.array([0, 1.0, 0]), np.radians(10))
    truth = boxes([0, 0.07])
    truth = dataclasses.replace(truth, R=np.stack([EYE, turn]))
    estimates = dataclasses.replace(boxes([0.0, 0.07], [0.9, 0.8]), R=np.stack([turn, EYE]))
    paper, code = (
        evaluate_categories(estimates, truth, protocol=p, pose_thresholds=[(5, 10)])["mug"]
        for p in ("paper", "code")
    )
    assert paper.pairs.tolist() == code.pairs.tolist() == [[0, 0], [1, 1]]
    assert (paper.pose[5, 10], code.pose[5, 10]) == (0, 1)


def test_ties_enter_together_but_one_by_one_in_the_code():
    """A right and a wrong estimate of equal scores in two images: AP 1/2, or as the file has it."""
    images = [(0, 0), (0, 1)]
    for right, expected in ((0, 0.5), (1, 1.0)):
        truth = boxes([0], image_id=right)
        estimates = boxes([0, 0], [1, 1], image_id=np.array([0, 1]))
        paper, code = (
            evaluate_categories(estimates, truth, images=images, protocol=p)["mug"].iou[0.5]
            for p in ("paper", "code")
        )
        assert (paper, code) == (0.5, expected)


def test_images_and_categories_stay_apart():
    truth = boxes([0, 0], category=["mug", "can"], image_id=np.array([0, 1]))
    estimates = boxes([0, 0, 0], category=["can", "mug", "bowl"], image_id=np.array([0, 0, 0]))
    result = evaluate_categories(estimates, truth)
    assert list(result) == ["can", "mug"]  # no bowl is there
    assert (result["mug"].iou[0.5], result["can"].iou[0.5]) == (1.0, 0.0)
    foreign = boxes([0, 0], [0.5, 0.9], image_id=np.array([0, 7]))
    assert evaluate_categories(foreign, truth)["mug"].iou[0.5] == 1.0
    images = [(0, 0), (0, 1), (0, 7)]  # where there is no mug, an estimate of one is wrong
    assert evaluate_categories(foreign, truth, images=images)["mug"].iou[0.5] == 0.5


def test_what_is_no_target_neither_helps_nor_harms():
    truth = boxes([0, 1], axis=np.array([[0, 1, 0], [0, 0, 0]]))
    estimates = boxes([0, 1.2, 5], [0.9, 0.8, 0.1])
    for protocol in ("paper", "code"):
        targets = (truth.axis != 0).any(-1)
        one = evaluate_categories(estimates, truth, targets=targets, protocol=protocol)["mug"]
        assert one.count == 1 and one.iou[0.5] == 1.0 and one.pose[5, 2] == 1.0
    both = evaluate_categories(boxes([0, 1]), truth, targets=~targets)["mug"]
    assert both.estimated == 1 and both.pairs.tolist() == [[1, 1]] and both.iou[0.5] == 1.0


def test_a_turned_bottle_is_right_and_a_turned_mug_is_not():
    turn = category_loop.about(np.array([0, 1.0, 0]), 1.0)
    names = ["bottle", "mug", "mug"]
    image = np.arange(3)
    truth = boxes([0] * 3, category=names, image_id=image, axis=nocs_axes(names, [1, 1, 0]))
    estimates = boxes([0] * 3, category=names, image_id=image)
    estimates = dataclasses.replace(estimates, R=np.tile(turn, (3, 1, 1)))
    result = evaluate_categories(estimates, truth)
    assert result["bottle"].pose[5, 2] == 1.0
    assert result["bottle"].overlap == pytest.approx([1.0])
    assert result["mug"].pose[5, 2] == 0.25  # one of two whose handle is hidden, equally sure
    assert np.rad2deg(result["mug"].rotation) == pytest.approx([np.degrees(1), 0], abs=1e-6)


def test_without_estimates_all_is_zero():
    result = evaluate_categories(boxes([]), boxes([0]))["mug"]
    assert set(result.iou.values()) == set(result.pose.values()) == {0.0}
    assert len(result.pairs) == len(result.rotation) == len(result.overlap) == 0


def test_sizes_are_those_of_each_instance():
    truth = dataclasses.replace(boxes([0]), size=np.array([[0.1, 0.2, 0.1]]))
    result = evaluate_categories(boxes([0]), truth)["mug"]
    assert result.overlap == pytest.approx([0.5])
    assert result.scale == pytest.approx([np.sqrt(3 / 6)])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"protocol": "legacy"}, "protocol"),
        ({"iou_thresholds": [1.5]}, "iou_thresholds"),
        ({"pose_thresholds": [(5, 0)]}, "pose_thresholds"),
        ({"targets": np.ones(3, bool)}, "targets"),
        ({"targets": np.zeros(1, bool)}, "ground_truth"),
        ({"images": []}, "ground_truth"),
        ({"estimates": "est.csv"}, "estimates"),
        (
            {"ground_truth": boxes([0], axis=np.array([1, 0, 0])), "protocol": "code"},
            "axes along y",
        ),
    ],
)
def test_what_cannot_be_is_named(changes, message):
    arguments = {"estimates": boxes([0]), "ground_truth": boxes([0])} | changes
    with pytest.raises(ValueError, match=message):
        evaluate_categories(**arguments)
