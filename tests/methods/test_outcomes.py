"""What became of each object: against the metrics, and percentages by any grouping."""

import numpy as np
import pytest
import torch

import data_tools
from data_tools import batches
from posecore import metrics
from posecore.methods.objects import object_models
from posecore.methods.outcomes import Outcome, outcomes, recall, recall_by

pytestmark = pytest.mark.slow

IDS = (3, 7)  # the first is symmetric


@pytest.fixture(scope="module")
def easy():
    dataset = data_tools.open("tabletop", split="easy", scale="tiny")
    return batches.load(dataset, progress=False), object_models(dataset.models(), IDS)


def truth(data, row):
    return data.R[row].numpy(), data.t[row].numpy()


def test_each_object_that_counts_is_there_once_and_measured(easy):
    data, models = easy
    rows = {i: data.rows(object_id=i, visible=0.1).tolist() for i in IDS}
    keys = {(int(data.view[row]), i): row for i in IDS for row in rows[i]}
    found = {}
    for number, (key, row) in enumerate(keys.items()):
        R, t = truth(data, row)
        if number % 3:
            found[key] = R, t + [0, 0, 0.01 * number]
    found[9, 99] = np.eye(3), np.ones(3)  # of an object that nobody asks for
    done = outcomes(data, models, found)
    assert {key: one.row for key, one in done.items()} == keys
    assert [key[1] for key in done] == sorted((key[1] for key in keys), key=IDS.index)
    for key, one in done.items():
        model = models[IDS.index(key[1])]
        assert one.object_id == key[1]
        assert one.visible == pytest.approx(float(data.visible_fraction[one.row]))
        if key not in found:
            assert one.add == one.projection == one.t == np.inf and not one.right
            continue
        pair = (*found[key], *truth(data, one.row))
        distance = metrics.add_s if model.symmetric else metrics.add
        assert one.add == pytest.approx(distance(*pair, model.points) / model.diameter)
        assert one.t == pytest.approx(np.linalg.norm(pair[1] - pair[3]) / model.diameter)
        K = data.K[key[0]].numpy()
        moved = metrics.projection_2d(K, *pair, model.points) / data.size[0]
        assert one.projection == pytest.approx(moved, rel=1e-6, abs=1e-9)


def test_poses_that_look_alike_are_right(easy):
    data, models = easy
    row = int(data.rows(object_id=3, visible=0.5)[0])
    R, t = truth(data, row)
    S = models[0].symmetries[len(models[0].symmetries) // 2]
    key = int(data.view[row]), 3
    one = outcomes(data, models, {key: (R @ S[:3, :3], R @ S[:3, 3] + t)})[key]
    assert one.right and one.projected_right and one.projection < 1e-6


def test_less_visible_objects_do_not_count(easy):
    data, models = easy
    many = outcomes(data, models, {}, visible=0.0)
    limit = float(np.median([one.visible for one in many.values()])) + 1e-6
    limit = min(limit, 1.0)
    few = outcomes(data, models, {}, visible=limit)
    assert few == {key: one for key, one in many.items() if one.visible >= limit}


def test_an_object_twice_in_a_view_is_refused(easy, monkeypatch):
    data, models = easy
    monkeypatch.setattr(data, "view", torch.zeros_like(data.view))
    with pytest.raises(ValueError, match="^data: expected an object once in a view"):
        outcomes(data, models, {})


def made(object_id, add, visible=1.0, projection=0.0):
    return Outcome(object_id, 0, visible, add, projection, 0.0)


def test_recall_is_the_mean_over_objects():
    some = [made(1, 0.05), made(1, 0.2), made(1, np.inf), made(1, 0.3), made(2, 0.0999)]
    assert recall(some) == pytest.approx((25 + 100) / 2)
    assert recall(some[:4]) == 25
    far = [made(1, 0.05, projection=1.0), made(2, 9.0)]
    assert recall(far, lambda one: one.projected_right) == 50


def test_recall_by_any_grouping():
    some = [made(1, 0.05, 0.2), made(2, 0.5, 0.2), made(1, 0.5, 0.9), made(1, 0.05, 0.05)]
    shares = recall_by(some, lambda one: None if one.visible < 0.1 else one.visible > 0.5)
    assert shares == {False: 0.5, True: 0.0}
    assert recall_by(some, lambda one: one.object_id) == {1: pytest.approx(2 / 3), 2: 0}
    assert recall_by([], lambda one: 0) == {}
