"""What a refiner learns from: poses near the truth, a loss, and batches of cached fields."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posecore import cameras, metrics, poses
from posecore.papers.vector_field import frozen_fields
from posecore.papers.vector_field.frozen_fields import look_at_views, own_poses, weights_digest
from posecore.papers.vector_field.masked_fields import MaskedFields, look_at
from posecore.papers.vector_field.models import ObjectModel
from posecore.papers.vector_field.network import VectorFieldNet
from posecore.papers.vector_field.refinement import FieldRefiner
from posecore.papers.vector_field.refiner_training import RefinerTraining, perturb, pose_loss
from posecore.papers.vector_field.systems import VectorFieldSystem
from posecore.training import fit, seeded

K = torch.tensor([[60.0, 0, 24], [0, 60, 18], [0, 0, 1]]).double()
RNG = np.random.default_rng(0)
POINTS = RNG.normal(size=(40, 3)) * [0.05, 0.03, 0.04]
KEYPOINTS = np.concatenate([POINTS[:5], [[0.01, -0.02, 0.005]]])
HALF_TURN = np.stack([np.eye(4), np.diag([-1.0, -1, 1, 1])])
EVEN = np.concatenate([POINTS, POINTS * [-1, -1, 1]])
MODELS = [ObjectModel(3, POINTS, KEYPOINTS, 0.2), ObjectModel(5, EVEN, KEYPOINTS, 0.2, HALF_TURN)]


def some_poses(seed: int, count: int) -> tuple[torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(seed)
    t = rng.uniform([-0.05, -0.05, 0.4], [0.05, 0.05, 0.7], (count, 3))
    R = Rotation.random(count, random_state=rng).as_matrix()
    return torch.from_numpy(R), torch.from_numpy(t)


def seen(seed: int, count: int = 6) -> tuple[MaskedFields, dict[str, torch.Tensor]]:
    """True fields on whole small images, the objects in turns."""
    R, t = some_poses(seed, count)
    ys, xs = (v.ravel() for v in np.mgrid[:36, :48])
    ends = cameras.project(K, poses.apply(R, t, torch.from_numpy(KEYPOINTS)))
    vectors = ends[:, None] - torch.from_numpy(np.stack([xs, ys], -1))[:, None]
    image = torch.arange(count)
    columns = [
        image.repeat_interleave(len(xs)),
        torch.from_numpy(ys).repeat(count),
        torch.from_numpy(xs).repeat(count),
        (image % 2).repeat_interleave(len(xs)),
    ]
    batch = {"image": image, "object_id": 3 + 2 * (image % 2), "R": R, "t": t,
             "K": K.expand(count, 3, 3)}  # fmt: skip
    return MaskedFields(*columns, vectors.flatten(0, 1)), batch


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


class Photos:
    """A dataset of small images, each with both objects."""

    def __init__(self, count: int) -> None:
        generator = torch.Generator().manual_seed(1)
        self.rgb = torch.rand(count, 3, 24, 32, generator=generator)
        self.asked: list[int] = []

    def __len__(self) -> int:
        return len(self.rgb)

    def frames(self, views, size=None, *, augment=None, generator=None):
        self.asked += views.tolist()
        rgb = self.rgb[views]
        if augment is not None:
            rgb = (rgb + augment * torch.rand(rgb.shape, generator=generator)).clamp(0, 1)
        R, t = some_poses(int(views[0]), 2 * len(views))
        image = torch.arange(len(views))
        return {
            "rgb": rgb, "view": views, "K": K.expand(len(views), 3, 3), "R": R, "t": t,
            "image": image.repeat_interleave(2), "object_id": torch.tensor([3, 5] * len(views)),
        }  # fmt: skip


@pytest.fixture(scope="module")
def net() -> VectorFieldNet:
    with seeded(0):
        return VectorFieldNet(objects=2, keypoints=len(KEYPOINTS), width=4).eval()


def same_fields(one: MaskedFields, other: MaskedFields) -> bool:
    pairs = zip(vars(one).values(), vars(other).values(), strict=True)
    return all(torch.equal(a, b) for a, b in pairs)


@settings(max_examples=8, deadline=None)
@given(st.integers(1, 20), st.none() | st.integers(1, 25))
def test_each_view_is_looked_at_once(net: VectorFieldNet, count: int, most: int | None) -> None:
    photos = Photos(count)
    found = look_at_views(net, photos, most=most)
    asked, some = photos.asked, count if most is None else most
    assert asked == sorted(set(asked)) and len(asked) <= some
    gaps = np.diff([*asked, max(count, asked[-1] + 1)])
    assert asked[0] == 0 and set(gaps[:-1]) <= {gaps[0]} and gaps[-1] <= gaps[0]
    if some >= count:
        assert asked == list(range(count))
    assert len(found) == -(-len(asked) // 8)
    for n, (fields, batch) in enumerate(found):
        views = asked[8 * n : 8 * n + 8]
        images = photos.rgb[views].contiguous(memory_format=torch.channels_last)
        assert same_fields(fields, look_at(net, images))
        assert set(batch) == {"image", "object_id", "R", "t", "K"}
        assert torch.equal(batch["R"], some_poses(views[0], 2 * len(views))[0])
    assert len(RefinerTraining(found, MODELS)) == 2 * len(asked)  # it sees both everywhere


def test_views_are_varied_by_the_seed_alone(net: VectorFieldNet) -> None:
    def looks(**options: int) -> MaskedFields:
        return look_at_views(net, Photos(6), augment=0.5, **options)[0][0]

    first = looks(seed=3)
    torch.manual_seed(1)
    assert same_fields(looks(seed=3), first)
    assert looks(seed=4).counts.tolist() != first.counts.tolist()


def test_images_in_which_nothing_is_seen_are_left_out(net, monkeypatch):
    calls = []

    def blind(net, images):
        calls.append(len(images))
        return look_at(net, images, min_pixels=20 if len(calls) == 2 else 10**6)

    monkeypatch.setattr(frozen_fields, "look_at", blind)
    assert [len(batch["K"]) for _, batch in look_at_views(net, Photos(20))] == [8]
    assert calls == [8, 8, 4]
    assert look_at_views(net, Photos(3)) == []


def test_a_bar_where_it_is_asked_for(net, capsys):
    system = VectorFieldSystem(VectorFieldNet(objects=2, keypoints=6, width=4), MODELS)
    for show, shown in ((False, False), (None, False), (True, True)):
        look_at_views(net, Photos(2), show=show)
        assert ("fields" in capsys.readouterr().err) == shown
        own_poses(system, [seen(3)], show=show)
        assert ("poses" in capsys.readouterr().err) == shown


def test_a_systems_own_poses() -> None:
    """True fields give true poses; the symmetric object's are those that its field points at."""
    net = VectorFieldNet(objects=2, keypoints=6, width=4)
    parts = [seen(3), seen(4, 5)]
    own = own_poses(VectorFieldSystem(net, MODELS), parts)
    for (fields, batch), (R, t) in zip(parts, own, strict=True):
        assert R.dtype == t.dtype == torch.float32 and len(R) == len(fields)
        # Entries are in order of their image, and each image shows one object.
        torch.testing.assert_close(R, batch["R"].float(), atol=1e-3, rtol=0)
        torch.testing.assert_close(t, batch["t"].float(), atol=1e-3, rtol=0)
    learning = RefinerTraining(parts, MODELS, own)
    assert learning.own is not None and bool(learning.own[2].all())


def test_own_poses_are_those_before_a_refiner() -> None:
    net = VectorFieldNet(objects=2, keypoints=6, width=4)
    with seeded(0):
        refiner = FieldRefiner(MODELS, width=4, points=20)
        torch.nn.init.normal_(refiner.net.shift[1].bias, std=0.3)
    refining = VectorFieldSystem.named("OPEPL-R", net, MODELS, refiner)
    ((R, t),) = own_poses(refining, [seen(3)])
    ((R_plain, t_plain),) = own_poses(VectorFieldSystem(net, MODELS), [seen(3)])
    assert torch.equal(R, R_plain) and torch.equal(t, t_plain)
    refined = refining.estimate_fields(seen(3)[0], K)
    assert np.abs(refined[0].t - t[0].numpy()).max() > 1e-3


FIELDS, BATCH = seen(0, 2)
NET = VectorFieldNet(objects=2, keypoints=2, width=4).eval()
POSE = (torch.eye(3), torch.zeros(3))


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
        (lambda: look_at_views(NET, Photos(2), most=0), "most"),
        (lambda: look_at_views(NET, Photos(2), most=1.5), "most"),
        (lambda: look_at_views(NET, Photos(2), seed=-1), "seed"),
        (lambda: pose_loss(POINTS[:0], *POSE, *POSE, 1.0), "points"),
        (lambda: pose_loss(POINTS, *POSE, POSE[0], np.inf * POSE[1], 1.0), "t_gt"),
    ],
)
def test_bad_input_is_named(call: Callable[[], object], name: str) -> None:
    with pytest.raises(ValueError, match=rf"^{name}:"):
        call()


def test_the_digest_tells_weights_apart_and_nothing_else():
    with seeded(0):
        net = torch.nn.Conv2d(2, 3, 3)
    first = weights_digest(net)
    assert len(first) == 16
    assert weights_digest(net.to(memory_format=torch.channels_last)) == first
    with torch.no_grad():
        net.weight[0, 0, 0, 0] += 1e-6
    assert weights_digest(net) != first
