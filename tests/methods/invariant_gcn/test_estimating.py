"""Views to poses with sizes: what is given to the network, what is said, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from posecore.methods.estimating import estimate_views
from posecore.methods.invariant_gcn.estimating import CategoryEstimator
from posecore.methods.invariant_gcn.recipe import NETS, RECIPES, ROADS_OF
from posecore.methods.invariant_gcn.runs import InvariantGCNRun
from tests.methods.invariant_gcn.balls import RADIUS, Balls

CATEGORIES = ["bottle", "laptop", "mug"]


def run_of(kind="printed", **numbers):
    recipe = replace(RECIPES["tiny"], kind=kind)
    values = {
        "path": Path("run"), "options": {}, "kind": kind, "net": recipe.net, "objects": [1],
        "points": recipe.points, "sizes": list(recipe.sizes), "near": list(recipe.near),
        "categories": CATEGORIES, "revolution": ["bottle"], "mean_size": [[0.1, 0.2, 0.1]] * 3,
    }  # fmt: skip
    return InvariantGCNRun(**values | numbers)


def estimator(kind="printed", **options):
    run = run_of(kind)
    torch.manual_seed(0)
    return CategoryEstimator(run, run.new_net().eval(), **options)


@pytest.mark.parametrize("kind", NETS)
def test_poses_of_a_view(kind):
    views = Balls()
    table, seconds = estimate_views(estimator(kind), views, "balls")
    assert len(seconds) == 8
    assert table.object_id.tolist() == list(range(1, 9))
    assert ((table.score > 0) & (table.score < 1)).all()
    true = np.array([view.objects[0].t for view in views])
    # An untrained network knows no more than where the points are, and a scale for them.
    if ROADS_OF[kind] == "direct":
        assert np.linalg.norm(table.t - true, axis=1).max() < 0.15
    np.testing.assert_allclose(table.R @ table.R.mT, np.tile(np.eye(3), (8, 1, 1)), atol=1e-5)


def test_what_the_network_is_given():
    view = Balls()[2]
    (things,) = estimator().look(view)
    (thing,) = things
    assert (thing.object_id, thing.category) == (3, 2)
    assert thing.points.shape == (80, 3)  # a few more than the network's 64
    radius = np.linalg.norm(thing.points - view.objects[0].t, axis=1)
    np.testing.assert_allclose(radius, RADIUS, atol=1e-6)
    (found,) = estimator().estimate(things)
    assert found.size.shape == (3,) and (found.size > 0).all()
    assert estimator().estimate([]) == []


def test_the_same_view_gives_the_same_first():
    one, same = (estimator().estimate(*estimator().look(Balls()[0]))[0] for _ in range(2))
    np.testing.assert_array_equal(one.R, same.R)


def test_what_is_not_seen_has_no_pose():
    (things,) = estimator().look(Balls(hole=np.s_[:, :])[0])
    assert things == []


def test_roads():
    given = estimator().look(Balls()[0])[0]
    for road in ("direct", "plain", "weighted", "ransac"):
        assert len(estimator(road=road).estimate(given)) <= 1
    with pytest.raises(ValueError, match="^--road: expected one of 'direct'"):
        estimator(road="straight")
    with pytest.raises(ValueError, match="^--road: expected one that a network of kind nocs has"):
        estimator("nocs", road="direct")
    with pytest.raises(ValueError, match="^--road: expected one that a network of kind gpv has"):
        estimator("gpv", road="plain")


def test_views_that_lack_something():
    view = Balls()[0]
    item = view.objects[0]
    for wrong in (
        replace(view, depth=None), replace(view, objects=(replace(item, category=None),)),
        replace(view, objects=(replace(item, mask=None),)),
    ):  # fmt: skip
        with pytest.raises(ValueError, match="^--data: expected data with depth, masks and"):
            estimator().look(wrong)
    bowl = replace(view, objects=(replace(item, category="bowl"),))
    with pytest.raises(ValueError, match="^--data: expected things of the categories bottle, lap"):
        estimator().look(bowl)


def test_runs_that_cannot_be():
    for name, value in (
        ("points", 2), ("categories", []), ("categories", ["mug", "mug", "can"]),
        ("revolution", ["bowl"]), ("mean_size", [[0.1, 0.2, 0.1]]),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=f"^{name}: expected"):
            run_of(**{name: value})
