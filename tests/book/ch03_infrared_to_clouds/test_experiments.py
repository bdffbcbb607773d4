"""What chapter 3 measures: the sizes that are compared, and that each claim has its numbers."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import data_tools
from book.ch03_infrared_to_clouds import cloud_training as training
from book.ch03_infrared_to_clouds import experiments, light, looking, threshold_masks
from book.ch03_infrared_to_clouds.drawing import splats
from data_tools.worlds.redrawn import Redrawn
from posecore.methods.infrared.losses import CloudLoss
from posecore.methods.infrared.recipe import RECIPES, SMALL


def test_the_command_line_knows_the_sizes_that_are_compared(monkeypatch):
    monkeypatch.setenv("POSECORE_SCALE", "book")
    expected, found = training.compared(), replace(RECIPES["book"], **SMALL)
    assert replace(found, loss=expected.loss) == expected
    assert found.loss.keywords == expected.loss.keywords


def test_each_run_differs_from_the_first_in_what_it_says(monkeypatch):
    monkeypatch.setenv("POSECORE_SCALE", "tiny")
    first = training.compared()
    for name, changes in experiments.RUNS.items():
        own = {key: value for key, value in changes.items() if key != "split"}
        recipe = training.compared(**own)
        loss = recipe.new_loss((80, 47))
        for key, value in own.items():
            holder = loss if key in CloudLoss.__annotations__ else recipe
            assert getattr(holder, key) == value, name
        assert (
            replace(
                recipe, loss=first.loss, **{k: getattr(first, k) for k in own if hasattr(first, k)}
            )
            == first
        )


def test_every_claim_is_about_runs_that_there_are():
    known = set(experiments.RUNS) | {"head straight ahead", "head at the true pose"}
    thresholds = {"Li", "Otsu", "fixed"}
    others = {"masks": thresholds, "gains": thresholds, "light": set(light.LIGHTS)}
    for claim in experiments.CLAIMS:
        methods = {claim.favoured.method, claim.other.method}
        assert methods <= others.get(claim.measurement, known)
        assert claim.measurement in experiments.MEASUREMENTS


@pytest.mark.slow
def test_masks_by_thresholds_have_overlaps(shared_cache):
    values = threshold_masks.measure(0)
    assert len(values) == 6 and all(0 < value < 100 for value in values.values())
    by_key = {(key.method, key.split): value for key, value in values.items()}
    assert by_key["Li", "in the cuboid"] > by_key["Li", "whole image"]


@pytest.mark.slow
def test_overlaps_lost_are_differences(shared_cache):
    values = threshold_masks.measure_gains(1)
    assert len(values) == 3 * (6 + 3)
    for name in ("Li", "Otsu", "fixed"):
        for after, before in (("farthest third", "nearest third"), ("gain 0.5", "gain 1")):
            first, then = (
                values[threshold_masks.in_cuboid(name, "overlap", group)]
                for group in (before, after)
            )
            lost = values[threshold_masks.in_cuboid(name, "overlap lost", after)]
            assert lost == pytest.approx(first - then)


@pytest.mark.slow
def test_instants_in_visible_light_are_the_same_in_grey(monkeypatch):
    monkeypatch.setenv("POSECORE_SCALE", "tiny")
    grey = light.drawn("test", "visible", 1.0)
    infrared = light.drawn("test", "infrared", 1.0)
    assert grey.kinds == infrared.kinds and len(grey) == len(infrared) == 6
    assert torch.equal(grey.t, infrared.t)
    for view, colours in enumerate(Redrawn([0], split="test", light="visible", daylight=1.0)):
        assert np.array_equal(grey.image("instance", view), infrared.image("instance", view))
        luma = colours.rgb @ [0.299, 0.587, 0.114]
        assert np.abs(grey.image("ir", view) - luma).max() < 1
        assert not np.array_equal(grey.image("ir", view), infrared.image("ir", view))
    night = light.drawn("test", "visible", 0.0)
    assert night.image("ir", 0).mean() < 0.5 * grey.image("ir", 0).mean()


@pytest.mark.slow
def test_views_of_a_split_are_measured_as_the_split(shared_cache):
    recipe = training.compared()
    net = looking.blank_net(recipe).eval()
    net.high.copy_(torch.tensor([0.2, 0.2, 1.0]))
    by_name = training.evaluate(net, recipe, "test", most=2)
    by_views = training.evaluate(net, recipe, training.stack("test"), most=2)
    for one, other in zip(by_name, by_views, strict=True):
        assert torch.equal(one.nan_to_num(-1), other.nan_to_num(-1))


@pytest.mark.slow
def test_a_training_with_views_is_that_with_their_split(shared_cache):
    recipe = training.compared(steps=2)
    by_name, _ = training.train_net(recipe, split="test", keep=False)
    by_views, history = training.train_net(recipe, split=training.stack("test"))
    assert len(history.losses["loss"]) == 2
    for name, value in by_name.state_dict().items():
        assert torch.equal(value, by_views.state_dict()[name]), name


@pytest.mark.slow
def test_a_step_takes_time(monkeypatch):
    monkeypatch.setenv("POSECORE_SCALE", "tiny")
    assert all(seconds > 0 for seconds in looking.seconds_of_a_step())


def test_overlap_and_otsu():
    image = np.array([[10, 10, 200], [12, 205, 210]], np.uint8)
    assert 12 <= threshold_masks.otsu_threshold(image) < 200
    some, empty = image > 100, np.zeros((2, 3), bool)
    assert threshold_masks.overlap_of(some, image > 203) == pytest.approx(2 / 3)
    assert threshold_masks.overlap_of(empty, empty) == 1


@pytest.mark.slow
def test_measured_clouds_and_floors(shared_cache):
    recipe = training.compared()
    net = looking.blank_net(recipe).eval()
    net.high.copy_(torch.tensor([0.2, 0.2, 1.0]))
    measured = training.evaluate(net, recipe, most=2)
    assert measured.overlaps.shape == measured.at_truth.shape == (2, 3, 3)
    assert measured.off.shape == measured.views.shape == (2, 3)
    unseen = measured.unseen(torch.arange(9.0).view(1, 3, 3))
    assert unseen.tolist() == [[1.5, 4.0, 6.5]]  # without the diagonal
    floors = training.floors(0)
    straight, posed = (overlaps.mean() for overlaps in floors.values())
    assert 0.2 < straight < posed < 1
    assert looking.ceiling(2) > posed
    assert 0.02 < looking.constant_translation() < 0.2


def test_a_cloud_is_watched_while_its_network_learns(monkeypatch):
    """As often as there are panels, and at the end it is the cloud of the trained network."""
    monkeypatch.setenv("POSECORE_SCALE", "tiny")
    drawn, recipe = [], training.compared(steps=12)
    view = data_tools.open("headset", split="test")[1]

    def draw(stages):
        drawn.append(dict(stages))
        return splats.turning(stages)

    net, history = looking.train_watched(recipe, view, draw)
    assert len(history.losses["loss"]) == 12 and history.measured_at[-1] == 12
    assert [len(stages) for stages in drawn] == list(range(1, looking.STAGES + 1))
    last = drawn[-1]
    assert list(last) == [f"step {number}" for number in range(2, 13, 2)]
    expected = looking.predicted(net, view).points[0].numpy()
    np.testing.assert_array_equal(last["step 12"], expected)
    assert not np.array_equal(last["step 2"], expected)
