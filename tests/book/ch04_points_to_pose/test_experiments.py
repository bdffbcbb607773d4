"""What chapter 4 measures: that runs differ in what they say, and each claim has its numbers."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from book.ch04_points_to_pose import cloud_sources as sources
from book.ch04_points_to_pose import experiments, later, runs
from book.ch04_points_to_pose import pose_training as training
from book.ch04_points_to_pose.pose_training import Views
from book.ch04_points_to_pose.runs import RUNS, key
from data_tools.shapes import GLASSES


@pytest.fixture(autouse=True)
def at_tiny(monkeypatch):
    monkeypatch.setenv("POSECORE_SCALE", "tiny")


def test_runs_of_a_method_differ_in_what_they_say():
    told = [
        replace(run, changes=tuple(sorted(map(str, run.changes.items())))) for run in RUNS.values()
    ]
    same = [name for name, run in zip(RUNS, told, strict=True) if told.count(run) > 1]
    # At tiny the last abstraction is as it is; the same views are drawn by two names on purpose.
    assert set(same) <= {"p2p", "p2p, 16 of all", "p2p, all", "bins, frontal", "bins, quarter"}


@pytest.mark.parametrize("scale", ["tiny", "book"])
def test_recipes_of_all_runs_can_be_made(scale, monkeypatch):
    monkeypatch.setenv("POSECORE_SCALE", scale)
    for name, run in RUNS.items():
        recipe = runs.recipe_of(run)
        known = training.at_book_size("p2p") if run.book else training.compared("p2p")
        assert recipe.batch == known.batch, name
        if scale == "book":
            assert recipe.steps == round(run.steps * known.steps), name
        if run.method not in ("bins", "regression"):
            recipe.new_net()
            recipe.new_loss()


def test_heads_and_losses_speak_of_the_same_rotation(monkeypatch):
    monkeypatch.setenv("POSECORE_SCALE", "book")
    for name in ("6d", "procrustes", "euler"):
        recipe = runs.recipe_of(RUNS[f"p2r, {name}"])
        assert recipe.new_net().head.representation == name
        assert recipe.new_loss().loss.representation == name
    assert not runs.recipe_of(RUNS["p2r, plain quaternion"]).new_loss().loss.sign_free
    assert runs.recipe_of(RUNS["p2r"]).new_loss().loss.unit == 0.1


def test_every_claim_is_measured_or_named_as_not():
    for page in ((experiments.CLAIMS, experiments), (later.NOT_MEASURED, later)):
        assert {claim.measurement for claim in page[0]} == set(page[1].MEASUREMENTS)
    ids = [claim.id for claim in (*experiments.CLAIMS, *later.NOT_MEASURED)]
    assert len(set(ids)) == len(ids)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(later.MEASUREMENTS))
def test_what_is_not_measured_yet_could_be(name, shared_cache):
    values = later.MEASUREMENTS[name].function(0)
    claims = [claim for claim in later.NOT_MEASURED if claim.measurement == name]
    assert {side for claim in claims for side in (claim.favoured, claim.other)} <= set(values)
    assert claims and all(np.isfinite(value) for value in values.values())


@pytest.mark.slow
def test_views_that_are_learned_from(shared_cache):
    data, truth = training.stack("crowd"), training.true_poses("crowd")
    every = training.chosen_views(Views(drivers=1.0), 0)
    assert sorted(every.tolist()) == list(range(len(data)))
    for glasses in (1, 4):
        part = training.chosen_views(Views(glasses=(glasses,)), 0)
        assert (truth.object_id[part] == glasses).all()
    some = training.chosen_views(Views(), 0)
    drivers = data.scene_id[some].unique()
    assert 2 <= len(drivers) < len(data.scene_id.unique())
    quarter = training.chosen_views(Views(share=0.25), 0)
    assert set(quarter.tolist()) < set(some.tolist())
    assert len(quarter) == 3 * max(2, round(0.25 * len(some) / 3))
    assert not torch.equal(quarter, training.chosen_views(Views(share=0.25), 1))


@pytest.mark.parametrize("values", [{"share": 0}, {"share": 2}, {"drivers": 0}, {"glasses": (9,)}])
def test_views_that_cannot_be(values):
    with pytest.raises(ValueError, match=next(iter(values))):
        Views(**values)


@pytest.mark.slow
def test_even_views_look_further_aside(monkeypatch):
    angles = torch.zeros(3000, 3)
    angles[:, 0] = torch.deg2rad(torch.linspace(-1, 1, 3000) ** 5 * 70)
    monkeypatch.setattr(training, "true_poses", lambda split: training.TruePoses(
        torch.eye(3).expand(3000, 3, 3), angles, angles, torch.ones(3000, dtype=torch.long)
    ))  # fmt: skip

    class Data:
        groups = torch.arange(3000).view(1000, 3)
        scene_id = torch.arange(3000) // 30

    monkeypatch.setattr(training, "stack", lambda split: Data)
    plain, even = (
        angles[training.chosen_views(Views(share=0.25, even=turn), 0), 0].abs().mean()
        for turn in (False, True)
    )
    assert even > 1.5 * plain


@pytest.mark.slow
def test_clouds_that_are_cut_are_parts_of_the_whole(shared_cache):
    whole, cut = training.visible("test", 128), sources.cut("test", 64)
    assert cut.points.shape == (len(whole), 64, 3)
    assert torch.equal(cut.t, whole.t) and torch.equal(cut.view, whole.view)
    far = torch.cdist(cut.points, whole.points, compute_mode="donot_use_mm_for_euclid_dist").amin(
        -1
    )
    assert far.max() < 1e-6
    extents = [clouds.points.amax(1) - clouds.points.amin(1) for clouds in (cut, whole)]
    assert (extents[0] <= extents[1] + 1e-6).all() and extents[0].mean() < extents[1].mean()


@pytest.mark.slow
def test_clouds_of_two_networks_are_exchanged(shared_cache):
    own = sources.crossed(True, 0)("crowd", 32, 0)
    other = sources.crossed(False, 0)("crowd", 32, 0)
    assert torch.equal(own.view, other.view) and not torch.equal(own.points, other.points)
    again = sources.crossed(True, 0)("crowd", 32, 0)
    assert torch.equal(own.points, again.points)
    tests = [sources.crossed(kind, 0)("test", 32, 0).points for kind in (True, False)]
    assert torch.equal(*tests)


@pytest.mark.slow
def test_estimated_clouds_are_where_chapter_3_says(shared_cache):
    clouds = sources.estimated("test", 64)
    found = sources.estimated_places("test")
    centre = clouds.points.mean(1) - clouds.t
    assert len(clouds) == len(found.errors)
    assert np.corrcoef(centre[:, 2].numpy(), found.errors.offset[:, 2])[0, 1] > 0.9


@pytest.mark.slow
def test_numbers_of_a_run_are_those_of_its_errors(shared_cache):
    found = training.constant()
    values = runs.measured("constant", found)
    table = found.errors.orientation()
    assert values[key("constant", "MAE yaw")] == pytest.approx(table["MAE"]["yaw"])
    assert values[key("constant", "BMAE")] == pytest.approx(table["BMAE"]["average"])
    assert values[key("constant", "position")] == pytest.approx(found.errors.position()["L2"])
    each = [values[key("constant", "rotation", name)] for name in GLASSES]
    shares = [(found.object_id == number).float().mean().item() for number in range(1, 5)]
    assert np.dot(each, shares) == pytest.approx(values[key("constant", "rotation")])


def test_single_is_the_mean_over_glasses(monkeypatch):
    def measure(names, seed):
        return {key(n, "MAE", g): float(len(n) + len(g)) for n in names for g in ("", *GLASSES)}

    monkeypatch.setattr(experiments, "_measure", measure)
    values = experiments.measure_unseen(0)
    each = [values[key(f"p2p, without {name}", "MAE", name)] for name in GLASSES]
    assert values[key("p2p, unseen", "MAE")] == pytest.approx(np.mean(each))
