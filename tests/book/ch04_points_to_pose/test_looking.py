"""What chapter 4's page looks at, and its tables."""

import numpy as np
import pytest
import torch

from book.ch04_points_to_pose import later, looking, runs, tables
from book.ch04_points_to_pose import pose_training as training
from book.ch04_points_to_pose.pose_training import Trained
from book.ch04_points_to_pose.runs import key
from data_tools.shapes import GLASSES


@pytest.fixture(autouse=True)
def at_tiny(monkeypatch):
    monkeypatch.setenv("POSECORE_SCALE", "tiny")


@pytest.fixture
def net(shared_cache):
    recipe = runs.recipe_of(runs.RUNS["p2p, book"])
    return Trained("p2p", recipe, recipe.new_net().eval(), None, 0.0)


@pytest.mark.slow
def test_an_answer_moves_with_its_cloud(net):
    points = training.visible("test", net.recipe.points).points[0]
    here, there = looking.answer(net, points), looking.answer(net, points + 1.0)
    assert torch.allclose(here.R, there.R, atol=1e-4)
    for name in ("t", "seeds", "votes", "keypoints"):
        assert torch.allclose(getattr(here, name) + 1, getattr(there, name), atol=1e-4), name


@pytest.mark.slow
def test_heads_are_measured_as_elsewhere(net):
    heads, formula = looking.by_formula(net)
    expected = training.measure(net)
    assert np.allclose(heads.errors.rotation, expected.errors.rotation, atol=1e-6)
    assert not np.allclose(formula.errors.rotation, heads.errors.rotation)


@pytest.mark.slow
def test_whole_clouds_do_not_move(net):
    moved = looking.moved_by(net, 4)
    names = ["drawn anew", "without as much of the head", "without glasses", "glasses alone"]
    assert list(moved) == ["whole", *names]
    assert moved["drawn anew"].turned.max() > 1e-3
    assert moved["whole"].turned.max() < 1e-3
    assert moved["glasses alone"].turned.max() > 0.01
    for part in moved.values():
        assert np.isfinite(part.error).all() and np.isfinite(part.off).all()


@pytest.mark.slow
def test_examples_are_the_best_the_median_and_the_worst(net):
    shown = looking.examples(net)
    errors = np.rad2deg(training.measure(net).errors.rotation)
    degrees = [float(name.split(", ")[1].rstrip("°")) for name in shown]
    assert degrees == sorted(degrees)
    assert degrees[0] == pytest.approx(errors.min(), abs=0.06)
    assert degrees[2] == pytest.approx(errors.max(), abs=0.06)


@pytest.mark.slow
def test_a_training_that_is_watched(shared_cache):
    history = looking.watch(2, 1)
    assert len(history.losses["loss"]) == 2


def fake(names=("constant", "bins, book", "cloudpose, book", "p2r, book", "p2p, book")):
    metrics = [m + a for m in ("MAE", "RMSE", "BMAE") for a in ("", " yaw", " pitch", " roll")]
    metrics += ["position", "position x", "position y", "position z"]
    return {
        key(name, metric, glasses): np.array([2.0, 3.0, 4.0]) + 10 * number
        for number, name in enumerate(names)
        for metric in metrics
        for glasses in ("", *GLASSES)
    }


def test_tables_say_mean_and_spread():
    text = tables.orientation(fake())._repr_markdown_()
    assert "| **ALL** | MAE | 3 ± 1 | 13 ± 1 | 23 ± 1 | 33 ± 1 | 43 ± 1 |" in text
    assert len(text.splitlines()) == 2 + 9 + 15
    text = tables.position(fake())._repr_markdown_()
    assert "| ALL | x | 3 ± 1 |" in text and len(text.splitlines()) == 2 + 3 + 5
    assert "not measured" in tables.position({})._repr_markdown_()


def test_reductions_are_by_seed():
    numbers = {key("a", "MAE"): np.array([1.0, 1.0]), key("b", "MAE"): np.array([2.0, 4.0])}
    mean, spread = tables.reduction(numbers, "a", "b", "MAE")
    assert mean == pytest.approx(62.5) and spread == pytest.approx(np.std([50, 75], ddof=1))
    with pytest.raises(ValueError, match="numbers"):
        tables.reduction(numbers, "a", "c", "MAE")


def test_claims_that_are_not_measured_are_named():
    text = tables.not_measured(later.NOT_MEASURED)._repr_markdown_()
    for claim in later.NOT_MEASURED:
        assert f"| {claim.statement} | {claim.source} | {claim.measurement} |" in text
