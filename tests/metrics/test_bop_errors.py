"""What is added for BOP's scores, beside plain loops and where images hold several."""

import numpy as np
import pytest

from posecore.metrics import bop_errors, evaluation
from posecore.metrics.bop_errors import Present, add_bop_errors
from posecore.metrics.bop_scores import average_precisions, average_recalls
from tests.metrics import bop_loop
from tests.metrics.test_bop_recall import IMAGES, MODELS, WIDTH, K, scenes, table


class Distances:
    """In place of VSD, a number from the distance of the two poses; tells of what it is asked."""

    object_ids = (7, 8)

    def __init__(self):
        self.asked = []

    def __call__(self, estimates, truth):
        assert estimates.images == truth.images
        assert (estimates.object_id == truth.object_id).all()
        self.asked += list(zip(estimates.t.tolist(), truth.t.tolist(), strict=True))
        values = [surface(*pair) for pair in zip(estimates.t, truth.t, strict=True)]
        return np.reshape(values, (-1, 10))


def surface(t_est, t_gt):
    """(10,) errors in [0, 1]."""
    return np.minimum(1, np.linalg.norm(t_est - t_gt) / np.linspace(0.02, 0.2, 10))


def measured(poses, estimates, wanted, counted, counts=None, given=None):
    """The errors of all objects, with what is added."""
    both = (
        table([p for p, w in zip(poses, wanted, strict=True) if w]),
        table([p for p, w in zip(poses, wanted, strict=True) if not w]),
    )
    order = np.argsort(~np.array(wanted), kind="stable")
    present = Present(*both, K, np.array(counted)[order], counts or {})
    errors = evaluation.evaluate(table(estimates), both[0], MODELS, K, None, IMAGES, both[1])
    return add_bop_errors(errors, table(estimates), present, MODELS, IMAGES, given)


def visible(poses, seed):
    rng = np.random.default_rng(seed)
    return (rng.random(len(poses)) < 0.6).tolist(), (rng.random(len(poses)) < 0.7).tolist()


@pytest.mark.parametrize("seed", range(2))
def test_detection_is_that_of_the_loop(seed):
    """Poses that are not to be found are there all the same, in localisation and in detection."""
    poses, estimates = scenes(seed)
    wanted, counted = visible(poses, seed)
    errors = measured(poses, estimates, wanted, counted)
    for name in ("mssd", "mspd"):
        gap = bop_loop.scaled(name, estimates, poses, MODELS, K, WIDTH)
        limits = bop_loop.THRESHOLDS[name]
        for i, one in errors.items():
            expected = bop_loop.detection_precision(gap, limits, estimates, poses, counted, i)
            got = average_precisions([one], WIDTH).get(name.upper())
            assert got == expected if expected is None else got == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("seed", range(2))
def test_recalls_are_those_of_the_loop(seed):
    """With as many estimates looked at as is asked for, fewer or more than there are poses."""
    poses, estimates = scenes(seed)
    wanted, counted = visible(poses, seed)
    there = {(pose["image"], pose["object"]) for pose in poses}
    counts = {key: int(n) for key, n in zip(sorted(there), [1, 2, 3, 1, 4, 2], strict=False)}
    by_key = {(*image, i): n for (image, i), n in counts.items()}
    errors = measured(poses, estimates, wanted, counted, by_key, Distances())
    recalls = average_recalls(list(errors.values()), WIDTH)
    for name in ("mssd", "mspd"):
        given = estimates, poses, wanted, counts, MODELS, K, WIDTH
        assert recalls[name.upper()] == pytest.approx(bop_loop.average_recall(name, *given))
    expected = np.mean(
        [
            bop_loop.recall(
                lambda k, number, at=at: surface(estimates[k]["t"], poses[number]["t"])[at],
                *(threshold, estimates, poses, wanted, counts),
            )
            for at in range(10)
            for threshold in bop_loop.THRESHOLDS["vsd"]
        ]
    )
    assert recalls["VSD"] == pytest.approx(expected, abs=1e-9)


def test_a_pair_is_measured_once(monkeypatch):
    poses, estimates = scenes(1)
    given, mssd, measurements = Distances(), bop_errors.model_errors.mssd, []

    def counting(R, *arguments):
        measurements.append(len(R))
        return mssd(R, *arguments)

    monkeypatch.setattr(bop_errors.model_errors, "mssd", counting)
    everything = [True] * len(poses)
    measured(poses, estimates, everything, everything, given=given)
    asked = [tuple(map(tuple, pair)) for pair in given.asked]
    assert len(set(asked)) == len(asked) > 0
    pairs = sum(
        (e["image"], e["object"]) == (p["image"], p["object"]) for e in estimates for p in poses
    )
    assert sum(measurements) <= pairs + len(asked)  # what was known is not measured again


def test_without_pixels_and_without_a_model():
    poses, estimates = scenes(2)
    truth, rows = table(poses), table(estimates)
    errors = evaluation.evaluate(rows, truth, {7: MODELS[7]}, None, None, IMAGES)
    present = Present(truth, truth[:0], None, np.ones(len(truth), bool), {})
    result = add_bop_errors(errors, rows, present, {7: MODELS[7]}, IMAGES, Distances())
    assert result[8] is errors[8]
    assert set(result[7].detections[0].errors) == {"mssd"}
    assert "vsd" in result[7].errors and "mspd" not in result[7].errors
    for name in ("found", "overlap"):
        assert getattr(result[7], name) is getattr(errors[7], name)


def test_only_the_surest_of_an_image_are_looked_at():
    """A hundred sure estimates of one object leave no room for the others of that image."""
    poses, estimates = scenes(0)
    image = poses[0]["image"]
    noise = [e | {"score": 2.0, "object": 7, "image": image} for e in estimates[:1]] * 100
    errors = measured(poses, estimates + noise, [True] * len(poses), [True] * len(poses))
    assert [len(one.scores) for one in errors[8].detections][IMAGES.index(image)] == 0
    assert len(errors[7].detections[IMAGES.index(image)].scores) == 100


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"counted": np.ones(1, bool)}, "counted"),
        ({"counted": np.ones(2)}, "counted"),
        ({"K": np.ones((3, 3, 3))}, "K"),
    ],
)
def test_what_does_not_fit_is_named(change, name):
    two = table(scenes(0)[0][:2])
    given = {"truth": two, "others": two[:0], "K": K, "counted": np.ones(2, bool), "counts": {}}
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        Present(**given | change)
