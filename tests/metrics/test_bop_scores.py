"""BOP's scores beside plain loops of their definitions; times, and who is looked at."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posecore.metrics import bop_scores
from posecore.metrics.bop_scores import average_precisions, average_recalls, detection_precision
from posecore.metrics.detection import Detections
from posecore.metrics.evaluation import ObjectErrors
from tests.metrics import bop_loop
from tests.metrics.test_bop_recall import table

THRESHOLDS = np.arange(1, 11) * 0.05


def images_of(rng):
    """Random errors of one object, as the loop and as the library have them."""
    estimates, poses, counted, gaps, parts = [], [], [], {}, []
    for image in range(rng.integers(1, 5)):
        D, G = rng.integers(0, 6), rng.integers(1, 5)
        errors = rng.uniform(0, 0.8, (D, G))
        errors[rng.random((D, G)) < 0.2] = np.inf
        scores, some = rng.choice([0.1, 0.4, 0.4, 0.8], D), rng.random(G) < 0.7
        for (i, j), gap in np.ndenumerate(errors):
            gaps[len(estimates) + i, len(poses) + j] = gap
        estimates += [{"image": (1, image), "object": 5, "score": s} for s in scores.tolist()]
        poses += [{"image": (1, image), "object": 5} for _ in range(G)]
        counted += some.tolist()
        parts.append(Detections(scores, some, {"mssd": errors}))
    return estimates, poses, counted, lambda k, number: gaps[k, number], parts


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=15)
def test_precision_is_that_of_the_loop(seed):
    estimates, poses, counted, gap, parts = images_of(np.random.default_rng(seed))
    limits = THRESHOLDS.tolist()
    expected = bop_loop.detection_precision(gap, limits, estimates, poses, counted, 5)
    got = detection_precision(parts, "mssd", THRESHOLDS)
    assert got == expected if expected is None else got == pytest.approx(expected, abs=1e-9)


def test_who_finds_what_does_not_count_is_left_out():
    """Two poses, one of them hidden: an estimate of it is neither right nor wrong."""
    errors = np.array([[0.0, 9.0], [9.0, 0.0], [9.0, 9.0]])
    counted = np.array([True, False])
    one = Detections(np.array([0.5, 0.9, 0.1]), counted, {"mssd": errors})
    assert detection_precision([one], "mssd", THRESHOLDS) == 1
    wrong = replace(one, scores=np.array([0.5, 0.9, 0.7]))  # the surest that counts is wrong
    assert detection_precision([wrong], "mssd", THRESHOLDS) == pytest.approx(0.5)
    assert detection_precision([replace(one, counted=~counted)], "mssd", THRESHOLDS) == 1
    nobody = replace(one, counted=np.zeros(2, bool))
    assert detection_precision([nobody], "mssd", THRESHOLDS) is None
    assert detection_precision([one], "mssd", THRESHOLDS, unit=1e-3) == 1  # 0 stays 0


def alone(**errors):
    """Errors of an object that is alone in each of its images."""
    values = {name: np.array(value, float) for name, value in errors.items()}
    count = len(next(iter(values.values())))
    return ObjectErrors(np.ones(count, bool), values, {}, None, {}, 0.2)


def test_recalls_by_hand():
    """Of VSD every tolerance and every threshold: 0 at half of the tolerances, then 1."""
    one = alone(vsd=[[0.0] * 5 + [1.0] * 5, [0.3] * 10], mssd=[0.05, 9], mspd=[12.0, 9e9])
    recalls = average_recalls([one])
    below = np.mean(bop_scores.VSD_THRESHOLDS > 0.3)  # as the toolkit's own digits have it
    assert recalls["VSD"] == pytest.approx((0.5 + below) / 2)
    assert recalls["MSSD"] == pytest.approx(0.25)
    assert recalls["MSPD"] == pytest.approx(0.4)
    assert recalls["AR, their mean"] == pytest.approx(np.mean([*recalls.values()][:3]))


def test_ar_is_of_objects_that_have_all_three():
    full = alone(vsd=[[0.0] * 10], mssd=[0.0], mspd=[0.0])
    without = alone(mssd=[9.0], mspd=[999.0])
    recalls = average_recalls([full, without])
    assert recalls["MSSD"] == 0.5
    assert recalls["AR, their mean"] == 1
    assert "AR, their mean" not in average_recalls([without])


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=10)
def test_recall_of_pairs_is_that_of_the_loop(seed):
    """VSD has errors of its own at each tolerance, and pairs of its own at each threshold."""
    rng = np.random.default_rng(seed)
    D, G = rng.integers(1, 4), rng.integers(1, 4)
    errors = rng.integers(0, 11, (10, D, G)) / 20  # many of them are equal to a threshold
    estimates = [{"image": 1, "object": 5, "score": -k} for k in range(D)]
    poses = [{"image": 1, "object": 5}] * G
    expected = np.mean(
        [
            bop_loop.recall(
                lambda k, number, tau=tau: errors[tau, k, number],
                *(threshold, estimates, poses, [True] * G, {(1, 5): D}),
            )
            for tau in range(10)
            for threshold in bop_loop.THRESHOLDS["vsd"]
        ]
    )
    one = alone(vsd=np.zeros((G, 10)))
    got = average_recalls([replace(one, pairs={"vsd": [errors]})])["VSD"]
    assert got == pytest.approx(expected, abs=1e-9)


def test_precisions_need_detections():
    one = alone(mssd=[0.0], mspd=[0.0])
    assert average_precisions([one]) == {}
    errors = {"mssd": np.array([[0.05]]), "mspd": np.array([[12.0]])}
    found = replace(one, detections=[Detections(np.ones(1), np.ones(1, bool), errors)])
    got = average_precisions([found, one])
    assert got == pytest.approx({"MSSD": 0.5, "MSPD": 0.8, "AP, their mean": 0.65})
    wide = average_precisions([found], image_width=1280)
    assert wide["MSPD"] == pytest.approx(0.9)


def rows(*given):
    """From (image, score, time)."""
    eye = np.eye(3)
    some = [{"image": (1, i), "object": 1, "R": eye, "t": eye[2], "score": s} for i, s, _ in given]
    return replace(table(some), time=np.array([time for *_, time in given], float))


def test_the_surest_of_an_image():
    some = rows((1, 0.5, 0), (2, 0.1, 0), (1, 0.9, 0), (1, 0.5, 0), (1, 0.7, 0), (2, 0.2, 0))
    assert bop_scores.surest_of_images(some, 3).tolist() == [True, True, True, False, True, True]
    assert bop_scores.surest_of_images(some, 1).tolist() == [False, False, True, False, False, True]
    assert bop_scores.surest_of_images(some[:0]).tolist() == []


def test_time_of_an_image():
    assert bop_scores.time_per_image(rows((1, 0, 0.5), (1, 0, 0.5004), (2, 0, 0.1))) == (0.3, 2)
    assert bop_scores.time_per_image(rows((1, 0, 0.5), (2, 0, -1))) is None
    assert bop_scores.time_per_image(rows((1, 0, 0.5))[:0]) is None
    with pytest.raises(ValueError, match="0.5 s and 0.6 s in scene 1, image 2"):
        bop_scores.time_per_image(rows((2, 0, 0.5), (2, 0, 0.6)))
