"""Windows as parts of images with all that is known of them, and the loss against one over all."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import data_tools
from data_tools import batches
from posecore import cameras, poses
from posecore.methods.objects import object_models
from posecore.methods.vector_field.fields import field_targets
from posecore.methods.vector_field.learning import Objective, Pool, Windows, _by_object, _by_window
from posecore.methods.vector_field.losses import VectorFieldLoss
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.models import ObjectModel
from posecore.training import fit, seeded

pytestmark = pytest.mark.slow

IDS = (1, 3)


@pytest.fixture(scope="module")
def stack():
    return batches.load(data_tools.open("tabletop", split="easy", scale="tiny"), progress=False)


@pytest.fixture(scope="module")
def models():
    return object_models(data_tools.open("tabletop", split="easy", scale="tiny").models(), IDS)


@pytest.fixture
def windows(stack, models):
    def make(**options):
        return Windows(stack, models, **({"steps": 4, "count": 3, "size": 48} | options))

    return make


def same(a, b):
    return a.keys() == b.keys() and all(torch.equal(a[name], b[name]) for name in a)


def test_a_window_shows_what_its_labels_say(windows, models):
    batch = next(iter(windows(count=8, shift=0, augment=batches.Augmentation(), visible=0.5)))
    assert batch["rgb"].shape == (8, 3, 48, 48) and batch["instance"].shape == (8, 48, 48)
    assert batch["done"] == 0
    known = {model.object_id: model for model in models}
    compared = 0
    for b in range(8):
        shown = batch["instance"][b].unique().tolist()
        assert set(batch["object_id"][b][[i for i in shown if i >= 0]].tolist()) & set(IDS)
        for slot in shown:
            if slot < 0 or int(batch["object_id"][b, slot]) not in known:
                continue
            model = known[int(batch["object_id"][b, slot])]
            points = poses.apply(batch["R"][b, slot], batch["t"][b, slot], model.points)
            pixels = cameras.project(batch["K"][b], points.float())
            y, x = (batch["instance"][b] == slot).nonzero(as_tuple=True)
            low, high = pixels.amin(0), pixels.amax(0)
            seen = torch.stack([x, y], -1)
            assert bool((seen >= low - 1).all() and (seen <= high + 1).all())
            compared += 1
    assert compared >= 8


def test_an_unmoved_window_is_a_part_of_its_image(stack, windows):
    batch = next(iter(windows(shift=0)))
    whole = stack.frames(torch.arange(len(stack)))
    for b in range(3):
        inside = batch["rgb"][b, :, 20:28, 20:28]
        parts = whole["rgb"].unfold(2, 8, 1).unfold(3, 8, 1)  # (V, 3, ..., ..., 8, 8)
        away = (parts - inside[:, None, None]).abs().amax((1, 4, 5)).amin()
        # The box's middle may lie between pixels: then half a pixel is interpolated.
        assert away < 0.35


@given(seed=st.integers(0, 2**32 - 1))
def test_tables_by_window_and_by_object_say_the_same(seed):
    rng = np.random.default_rng(seed)
    image = torch.tensor(np.sort(rng.integers(0, 4, rng.integers(1, 9))))
    count = len(image)
    batch = {
        "rgb": torch.zeros(4, 3, 5, 6),
        "K": torch.eye(3).expand(4, 3, 3),
        "image": image,
        "object_id": torch.tensor(rng.integers(1, 9, count)),
        "R": torch.tensor(rng.normal(size=(count, 3, 3))),
        "t": torch.tensor(rng.normal(size=(count, 3))),
    }
    instance = np.full((4, 5, 6), -1)
    for row in range(count):  # an image shows objects of its own only
        instance[image[row], rng.integers(5), rng.integers(6)] = row
    batch["instance"] = torch.tensor(instance)
    again = _by_object(_by_window(batch))
    for b, y, x in np.ndindex(instance.shape):
        row, other = int(instance[b, y, x]), int(again["instance"][b, y, x])
        assert (row < 0) == (other < 0)
        if row >= 0:
            assert int(again["image"][other]) == b == int(image[row])
            for name in ("object_id", "R", "t"):
                assert torch.equal(again[name][other], batch[name][row])
    assert int((again["object_id"] >= 0).sum()) == count


def test_a_zoomed_window_shows_more_and_its_camera_knows(windows):
    plain = next(iter(windows(count=6, shift=0, visible=0.5)))
    zoomed = next(iter(windows(count=6, shift=0, visible=0.5, size=24, zoom=0.5)))
    assert zoomed["rgb"].shape[2:] == (24, 24)
    torch.testing.assert_close(zoomed["K"][:, 0, 0], plain["K"][:, 0, 0] / 2)
    for one, two in zip(plain["K"], zoomed["K"], strict=True):  # the same corner
        torch.testing.assert_close(2 * (two[:2, 2] + 0.5), one[:2, 2] + 0.5, atol=1e-3, rtol=0)
    for name in ("object_id", "R", "t"):
        assert torch.equal(plain[name], zoomed[name])
    means = plain["rgb"].unfold(2, 2, 2).unfold(3, 2, 2).mean((-2, -1))
    assert float((means - zoomed["rgb"]).abs().mean()) < 0.02


def test_left_and_taken_up_again(windows):
    options = {"augment": batches.Augmentation(), "seed": 3}
    whole = list(windows(**options))
    assert len(whole) == 4 and not same(whole[0], whole[1])
    first = windows(**options)
    iterator = iter(first)
    next(iterator), next(iterator)
    second = windows(**options)
    second.load_state_dict(first.state_dict())
    assert all(same(a, b) for a, b in zip(second, whole[2:], strict=True))
    assert all(same(a, b) for a, b in zip(second, whole, strict=True))  # and from the beginning
    assert [float(batch["done"]) for batch in whole] == [0, 0.25, 0.5, 0.75]


def test_a_pool_has_the_windows_that_were_cut(windows):
    cut = list(windows(steps=5, count=2, augment=batches.Augmentation()))
    pool = Pool(windows(steps=5, count=2, augment=batches.Augmentation()), steps=30, count=3)
    assert pool.size == 10 and len(pool) == 30
    seen = set()
    for step, batch in enumerate(pool):
        assert batch["rgb"].shape == (3, 3, 48, 48) and batch["rgb"].dtype == torch.float32
        assert float(batch["done"]) == pytest.approx(step / 30)
        for b in range(3):
            away = [
                float((batch["rgb"][b] - window["rgb"][w]).abs().max())
                for window in cut
                for w in range(2)
            ]
            row = int(np.argmin(away))
            assert away[row] < 0.51 / 255
            own = {
                name: values[row % 2] for name, values in cut[row // 2].items() if name != "done"
            }
            assert torch.equal(batch["instance"][b], own["instance"])
            assert torch.equal(batch["K"][b], own["K"])
            count = len(own["object_id"])
            assert torch.equal(batch["object_id"][b][:count], own["object_id"])
            assert (batch["object_id"][b][count:] == -1).all()
            assert torch.equal(batch["R"][b][:count], own["R"])
            assert torch.equal(batch["t"][b][:count], own["t"])
            seen.add(row)
    assert len(seen) == 10  # of 90 draws


def test_a_pool_teaches_what_its_windows_teach(windows, models):
    (window,) = windows(steps=1, count=1)
    (drawn,) = Pool(windows(steps=1, count=1), steps=1, count=1)
    with seeded(0):
        net = VectorFieldNet(len(models), width=8).eval()
    objective = Objective(models, pixels_per_object=None)
    for name, value in objective(net, window).items():
        torch.testing.assert_close(objective(net, drawn)[name], value, rtol=0.01, atol=1e-4)


def test_a_pool_is_cut_when_it_is_wanted_and_once(windows, monkeypatch):
    cut, draw = [], Windows._draw

    def counted(self, generator):
        cut.append(self.count)
        return draw(self, generator)

    monkeypatch.setattr(Windows, "_draw", counted)
    begun = windows(steps=3, count=2)
    next(iter(begun))
    cut.clear()
    pool = Pool(begun, steps=4, count=2)
    other = pool.drawn(steps=2, count=1)
    assert pool.size == other.size == 6
    pool.load_state_dict({**pool.state_dict(), "step": 4})
    assert list(pool) == [] and cut == []  # a training that is finished
    assert len(list(other)) == 2 and cut == [2, 2, 2]  # all of them, whatever was drawn before
    assert len(list(pool)) == 4 and len(cut) == 3
    assert begun.step == 1


def test_a_pool_is_drawn_from_again_and_taken_up_again(windows):
    pool = Pool(windows(), steps=4, count=2)
    other = pool.drawn(steps=6, count=3, seed=1)
    assert len(pool) == 4 and len(other) == 6 and next(iter(other))["rgb"].shape[0] == 3
    whole = list(pool)
    first, second = pool.drawn(steps=4, count=2), pool.drawn(steps=4, count=2)
    iterator = iter(first)
    next(iterator), next(iterator)
    second.load_state_dict(first.state_dict())
    assert all(same(a, b) for a, b in zip(second, whole[2:], strict=True))
    with pytest.raises(ValueError, match="^state"):
        second.load_state_dict(other.state_dict())
    with pytest.raises(ValueError, match="^windows"):
        Pool(whole, steps=1, count=1)
    with pytest.raises(ValueError, match="^count"):
        pool.drawn(steps=1, count=0)


def test_other_seeds_have_other_windows(windows):
    assert not torch.equal(next(iter(windows(seed=0)))["rgb"], next(iter(windows(seed=1)))["rgb"])


@pytest.mark.parametrize("projection", ["none", "pixel", "unit"])
def test_gathered_first_the_loss_is_that_of_whole_images(windows, models, projection):
    with seeded(0):
        net = VectorFieldNet(2, width=8).eval()
    batch = next(iter(windows()))
    objective = Objective(models, VectorFieldLoss(projection, 0.3), pixels_per_object=None)
    gathered = objective(net, batch)
    fields = net(batch["rgb"])
    targets = field_targets(
        _by_object(batch),
        torch.stack([torch.from_numpy(model.keypoints).float() for model in models]),
        IDS,
        [model.symmetries if model.symmetric else None for model in models],
        None,
    )
    chosen = fields.vectors[targets.image, targets.object, :, :, targets.y, targets.x]
    whole = VectorFieldLoss(projection, 0.3)(fields.mask, chosen, targets, 0.0)
    for name, value in whole.items():
        torch.testing.assert_close(gathered[name], value, rtol=1e-4, atol=1e-5)


def test_training_lowers_the_loss(stack, models):
    with seeded(0):
        net = VectorFieldNet(2, width=8)
    steps = Windows(stack, models, steps=30, count=4, size=48)
    history = fit(net, steps, Objective(models), steps=30, lr=3e-3, show=False, device="cpu")
    mask = np.asarray(history.losses["mask"])
    assert mask[-5:].mean() < 0.7 * mask[:5].mean()


def test_windows_elsewhere(windows, stack, models):
    """None without asking, and then some; what they show is still what their labels say."""

    def shown(**options):
        batch = next(iter(windows(count=32, size=24, shift=0, visible=0.5, **options)))
        known = torch.isin(batch["object_id"], torch.tensor(IDS)).any(1)
        seen = torch.stack([
            torch.isin(row[labels.clamp(min=0)], torch.tensor(IDS))[labels >= 0].any()
            for row, labels in zip(batch["object_id"], batch["instance"], strict=True)
        ])  # fmt: skip
        return batch, float((known & seen).double().mean())

    first, always = shown()
    again, same_share = shown(background_fraction=0.0)
    assert same(first, again) and always == same_share == 1
    _, some = shown(background_fraction=0.5)
    batch, rare = shown(background_fraction=1.0)
    assert rare < some < always and rare < 0.5
    middles = (torch.tensor([11.5, 11.5]) - batch["K"][:, :2, 2]) / batch["K"][:, [0, 1], [0, 1]]
    whole = stack.frames(torch.tensor([0]))["K"][0]
    pixels = middles * whole[[0, 1], [0, 1]] + whole[:2, 2]
    width, height = stack.size
    assert bool((pixels >= -1).all()) and bool((pixels <= torch.tensor([width, height])).all())
    assert pixels[:, 0].max() - pixels[:, 0].min() > 0.6 * width  # and not only in the middle
    with seeded(0):
        net = VectorFieldNet(2, width=8)
    losses = Objective(models)(net, batch)
    losses["loss"].backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in net.parameters())


def test_windows_without_an_object_of_the_network(models):
    """They have a mask to learn, and no vectors."""
    batch = {
        "rgb": torch.rand(2, 3, 16, 16),
        "K": torch.eye(3).expand(2, 3, 3),
        "instance": torch.full((2, 16, 16), -1),
        "object_id": torch.full((2, 1), 7),
        "R": torch.eye(3).expand(2, 1, 3, 3),
        "t": torch.ones(2, 1, 3),
        "done": torch.tensor(0.5),
    }
    with seeded(0):
        net = VectorFieldNet(2, width=8)
    losses = Objective(models)(net, batch)
    losses["loss"].backward()
    assert losses["vectors"] == losses["projection"] == 0 and losses["mask"] > 0
    assert all(p.grad is not None and p.grad.isfinite().all() for p in net.parameters())


BAD = [
    ({"steps": 0}, "steps"),
    ({"count": 0}, "count"),
    ({"size": 0}, "size"),
    ({"size": (32, 0)}, "size"),
    ({"size": 0.5}, "size"),
    ({"seed": -1}, "seed"),
    ({"shift": -0.1}, "shift"),
    ({"shift": np.nan}, "shift"),
    ({"visible": 2}, "visible"),
    ({"zoom": 0}, "zoom"),
    ({"background_fraction": 1.5}, "background_fraction"),
    ({"background_fraction": np.nan}, "background_fraction"),
]


@pytest.mark.parametrize("options, name", BAD)
def test_bad_input(windows, options, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        windows(**options)


def test_bad_models(stack, models):
    other = ObjectModel(77, models[0].points, 0.1, models[0].keypoints)
    with pytest.raises(ValueError, match=r"^data.*77"):
        Windows(stack, [other], steps=1)
    with pytest.raises(ValueError, match="^models"):
        Windows(stack, [], steps=1)
    with pytest.raises(ValueError, match="^models"):
        Objective([models[0], models[0]])


@pytest.mark.parametrize(
    "state", [None, {}, {"step": 1}, {"step": 1, "steps": 4, "seed": 9, "count": 3}]
)
def test_a_state_of_others(windows, state):
    with pytest.raises(ValueError, match="^state"):
        windows().load_state_dict(state)
