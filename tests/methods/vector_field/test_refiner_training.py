"""What a refiner learns from: poses near the truth, a loss, and batches of cached fields."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posecore import metrics
from posecore.methods.vector_field.refinement import FieldRefiner
from posecore.methods.vector_field.refiner_training import RefinerTraining, perturb, pose_loss
from posecore.training import fit, seeded
from tests.methods.vector_field.true_fields import EVEN, HALF_TURN, MODELS, seen, some_poses


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31))
def test_the_loss_is_the_metric_in_diameters(seed: int) -> None:
    (R, t), (R_gt, t_gt) = some_poses(seed, 4), some_poses(seed + 1, 4)
    points, diameter = torch.from_numpy(EVEN), torch.tensor([0.2, 0.1, 0.3, 0.2]).double()
    symmetric = torch.tensor([True, False, True, False])
    found = pose_loss(points, R, t, R_gt, t_gt, diameter, symmetric)
    pair = [metrics.add_s, metrics.add]
    for i in range(4):
        metric = pair[i % 2](R[i], t[i], R_gt[i], t_gt[i], points)
        assert torch.allclose(found[i], metric / diameter[i], rtol=1e-12)
    turned = R_gt @ torch.from_numpy(HALF_TURN[1, :3, :3])
    assert pose_loss(points, turned, t_gt, R_gt, t_gt, diameter, True).max() < 1e-12


@pytest.mark.parametrize("symmetric", [False, True])
def test_the_gradient_of_the_loss(symmetric: bool) -> None:
    points, diameter = torch.from_numpy(EVEN[::8]), torch.tensor(0.2).double()
    (R, t), (R_gt, t_gt) = some_poses(0, 2), some_poses(1, 2)
    t.requires_grad_()
    assert torch.autograd.gradcheck(
        lambda t: pose_loss(points, R, t, R_gt, t_gt, diameter, symmetric), t
    )
    exact = t_gt.clone().requires_grad_()
    pose_loss(points, R_gt, exact, R_gt, t_gt, diameter, symmetric).sum().backward()
    assert torch.isfinite(exact.grad).all()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31))
def test_perturbed_poses_are_within_their_bounds(seed: int) -> None:
    R, t = some_poses(seed, 50)
    centre, diameter = torch.zeros(50, 3).double(), torch.full((50,), 0.2).double()
    generator = torch.Generator().manual_seed(seed)
    R_new, t_new = perturb(R, t, centre, diameter, generator, rotation=0.3)
    angle = torch.from_numpy(Rotation.from_matrix(R_new @ R.mT).magnitude())
    assert angle.max() <= 0.3 + 1e-9 and angle.max() > 0.05
    assert (t_new[:, 2] > 0).all()
    same = perturb(R, t, centre, diameter, generator, rotation=0, lateral=0, depth=0)
    assert torch.allclose(same[0], R, atol=1e-14) and torch.allclose(same[1], t, atol=1e-14)


def test_the_sizes_of_perturbations() -> None:
    R, t = some_poses(0, 1)
    R, t = R.expand(20000, 3, 3), torch.tensor([0, 0, 2.0]).double().expand(20000, 3)
    centre, diameter = torch.zeros(20000, 3).double(), torch.full((20000,), 0.2).double()
    _, moved = perturb(R, t, centre, diameter, torch.Generator().manual_seed(0))
    spread = (moved - t).std(0) / 0.2
    # A part drawn evenly has a mean square of one third.
    expected = torch.tensor([0.08, 0.08, 0.2]).double() / 3**0.5
    assert torch.allclose(spread, expected, rtol=0.03)


def test_batches_hold_true_poses_and_the_same_again() -> None:
    pairs = [seen(0), seen(1, 4)]
    training = RefinerTraining(pairs, MODELS, size=50)
    assert len(training) == 10
    batch = training.batches(torch.Generator().manual_seed(0))
    again = training.batches(torch.Generator().manual_seed(0))
    assert all(torch.equal(batch[name], again[name]) for name in batch)
    R = torch.cat([pair[1]["R"] for pair in pairs]).float()[batch["entry"]]
    symmetric = batch["index"] == 1
    assert torch.equal(batch["R_gt"][~symmetric], R[~symmetric])
    relative = (R.mT @ batch["R_gt"])[symmetric]
    motions = torch.from_numpy(HALF_TURN[:, :3, :3]).float()
    assert ((relative[:, None] - motions).abs().amax((-1, -2)).amin(1) < 1e-5).all()
    assert not torch.allclose(batch["R"], batch["R_gt"], atol=1e-2)


def test_objects_without_a_true_pose_are_left_out() -> None:
    fields, batch = seen(0)
    kept = {name: value[1:] for name, value in batch.items() if name != "K"} | {"K": batch["K"]}
    training = RefinerTraining([(fields, kept)], MODELS)
    assert training.entry.tolist() == [1, 2, 3, 4, 5]
    windows = {name: batch[name][:, None] for name in ("object_id", "R", "t")} | {"K": batch["K"]}
    there = RefinerTraining([(fields, windows)], MODELS)
    assert torch.equal(there.t, RefinerTraining([(fields, batch)], MODELS).t)


def test_own_poses_are_half_of_the_beginnings_unless_they_are_hopeless() -> None:
    fields, batch = seen(0)
    R, t = batch["R"].clone(), batch["t"] + 0.01
    t[2] += 1
    training = RefinerTraining([(fields, batch)], MODELS[:1] + [MODELS[1]], [(R, t)], size=400)
    drawn = training.batches(torch.Generator().manual_seed(0))
    own = (drawn["t"] == t.float()[drawn["entry"]]).all(-1)
    assert not own[drawn["entry"] == 2].any()
    assert abs(own[drawn["entry"] != 2].double().mean() - 0.5) < 0.1


@pytest.mark.slow
def test_it_is_trained_by_fit() -> None:
    training = RefinerTraining([seen(0, 8)], MODELS, size=16)
    with seeded(0):
        refiner = FieldRefiner(MODELS, width=4, points=12)
    history = fit(refiner, training.batches, training.loss, steps=40, lr=3e-3, clip=1.0, show=False)
    losses = history.losses
    assert set(losses) == {"loss", "start", "end"}
    assert np.isfinite(losses["loss"]).all()
    assert losses["end"][0] == pytest.approx(losses["start"][0], rel=1e-4)  # it corrects nothing
    assert np.sum(losses["end"][-15:]) < np.sum(losses["start"][-15:])


FIELDS, BATCH = seen(0, 2)


def training(**options: object) -> RefinerTraining:
    return RefinerTraining([(FIELDS, BATCH)], MODELS, **options)


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: training(size=0), "size"),
        (lambda: training(rotation=4), "rotation"),
        (lambda: training(lateral=-1), "lateral"),
        (lambda: training(depth=np.nan), "depth"),
        (lambda: training(own=[]), "seen and own"),
        (lambda: training(own=[(torch.eye(3)[None], torch.zeros(1, 3))]), "own"),
        (lambda: RefinerTraining([], MODELS), "seen and own"),
        (lambda: RefinerTraining([(FIELDS, {"R": BATCH["R"]})], MODELS), "seen"),
        (
            lambda: RefinerTraining([(FIELDS, BATCH | {"object_id": BATCH["image"]})], MODELS),
            "seen",
        ),
        (lambda: RefinerTraining([(FIELDS, BATCH)], []), "models"),
    ],
)
def test_bad_input_is_named(call: Callable[[], object], name: str) -> None:
    with pytest.raises(ValueError, match=rf"^{name}:"):
        call()
