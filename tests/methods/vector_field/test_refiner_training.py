"""What a refiner learns from: poses near the truth, a loss, and batches of cached fields."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from posecore.methods.vector_field.refinement import FieldRefiner
from posecore.methods.vector_field.refiner_training import RefinerTraining
from posecore.training import fit, seeded
from tests.methods.vector_field.true_fields import HALF_TURN, MODELS, seen


def test_batches_hold_true_poses_and_the_same_again() -> None:
    pairs = [seen(0), seen(1, 4)]
    training = RefinerTraining(pairs, MODELS, size=50)
    assert len(training) == 10
    batch = training.batches(torch.Generator().manual_seed(0))
    again = training.batches(torch.Generator().manual_seed(0))
    assert all(torch.equal(batch[name], again[name]) for name in batch)
    R = torch.cat([pair[1]["R"][:, 0] for pair in pairs]).float()[batch["entry"]]
    symmetric = batch["index"] == 1
    assert torch.equal(batch["R_gt"][~symmetric], R[~symmetric])
    relative = (R.mT @ batch["R_gt"])[symmetric]
    motions = torch.from_numpy(HALF_TURN[:, :3, :3]).float()
    assert ((relative[:, None] - motions).abs().amax((-1, -2)).amin(1) < 1e-5).all()
    assert not torch.allclose(batch["R"], batch["R_gt"], atol=1e-2)


def test_objects_without_a_true_pose_are_left_out() -> None:
    fields, batch = seen(0)
    ids = batch["object_id"].clone()
    ids[0] = -1  # no object
    training = RefinerTraining([(fields, batch | {"object_id": ids})], MODELS)
    assert training.entry.tolist() == [1, 2, 3, 4, 5]
    # Beside places for others, and for none.
    more = {name: torch.cat([batch[name].flip(0), batch[name]], 1) for name in ("R", "t")}
    more |= {"object_id": torch.cat([torch.full_like(ids, -1), batch["object_id"]], 1)}
    there = RefinerTraining([(fields, batch | more)], MODELS)
    assert torch.equal(there.t, RefinerTraining([(fields, batch)], MODELS).t)


def test_own_poses_are_half_of_the_beginnings_unless_they_are_hopeless() -> None:
    fields, batch = seen(0)
    R, t = batch["R"][:, 0].clone(), batch["t"][:, 0] + 0.01
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
            lambda: RefinerTraining(
                [(FIELDS, BATCH | {"object_id": 9 * BATCH["object_id"]})], MODELS
            ),
            "seen",
        ),
        (lambda: RefinerTraining([(FIELDS, BATCH)], []), "models"),
    ],
)
def test_bad_input_is_named(call: Callable[[], object], name: str) -> None:
    with pytest.raises(ValueError, match=rf"^{name}:"):
        call()
