"""What is kept of a trained network: its fields of each view once, and a system's own poses."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from posecore.methods.vector_field import predictions
from posecore.methods.vector_field.masked_fields import MaskedFields, predict_fields
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.methods.vector_field.predictions import initial_poses, predict_views
from posecore.methods.vector_field.refinement import FieldRefiner
from posecore.methods.vector_field.refiner_training import RefinerTraining
from posecore.methods.vector_field.systems import VectorFieldSystem
from posecore.training import seeded
from tests.methods.vector_field.true_fields import KEYPOINTS, MODELS, K, seen, some_poses


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
        return {
            "rgb": rgb, "view": views, "K": K.expand(len(views), 3, 3),
            "R": R.unflatten(0, (-1, 2)), "t": t.unflatten(0, (-1, 2)),
            "object_id": torch.tensor([[3, 5]] * len(views)),
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
    found = predict_views(net, photos, max_images=most)
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
        assert same_fields(fields, predict_fields(net, images))
        assert set(batch) == {"object_id", "R", "t", "K"}
        assert torch.equal(batch["R"].flatten(0, 1), some_poses(views[0], 2 * len(views))[0])
    assert len(RefinerTraining(found, MODELS)) == 2 * len(asked)  # it sees both everywhere


def test_views_are_varied_by_the_seed_alone(net: VectorFieldNet) -> None:
    def looks(**options: int) -> MaskedFields:
        return predict_views(net, Photos(6), augment=0.5, **options)[0][0]

    first = looks(seed=3)
    torch.manual_seed(1)
    assert same_fields(looks(seed=3), first)
    assert looks(seed=4).counts.tolist() != first.counts.tolist()


def test_images_in_which_nothing_is_seen_are_left_out(net, monkeypatch):
    calls = []

    def blind(net, images):
        calls.append(len(images))
        return predict_fields(net, images, min_pixels=20 if len(calls) == 2 else 10**6)

    monkeypatch.setattr(predictions, "predict_fields", blind)
    assert [len(batch["K"]) for _, batch in predict_views(net, Photos(20))] == [8]
    assert calls == [8, 8, 4]
    assert predict_views(net, Photos(3)) == []


def test_a_bar_where_it_is_asked_for(net, capsys):
    system = VectorFieldSystem(VectorFieldNet(objects=2, keypoints=6, width=4), MODELS)
    for show, shown in ((False, False), (None, False), (True, True)):
        predict_views(net, Photos(2), show=show)
        assert ("fields" in capsys.readouterr().err) == shown
        initial_poses(system, [seen(3)], show=show)
        assert ("poses" in capsys.readouterr().err) == shown


def test_a_systems_own_poses() -> None:
    """True fields give true poses; the symmetric object's are those that its field points at."""
    net = VectorFieldNet(objects=2, keypoints=6, width=4)
    parts = [seen(3), seen(4, 5)]
    own = initial_poses(VectorFieldSystem(net, MODELS), parts)
    for (fields, batch), (R, t) in zip(parts, own, strict=True):
        assert R.dtype == t.dtype == torch.float32 and len(R) == len(fields)
        # Entries are in order of their image, and each image shows one object.
        torch.testing.assert_close(R, batch["R"][:, 0].float(), atol=1e-3, rtol=0)
        torch.testing.assert_close(t, batch["t"][:, 0].float(), atol=1e-3, rtol=0)
    learning = RefinerTraining(parts, MODELS, own)
    assert learning.own is not None and bool(learning.own[2].all())


def test_own_poses_are_those_before_a_refiner() -> None:
    net = VectorFieldNet(objects=2, keypoints=6, width=4)
    with seeded(0):
        refiner = FieldRefiner(MODELS, width=4, points=20)
        torch.nn.init.normal_(refiner.net.shift[1].bias, std=0.3)
    refining = VectorFieldSystem.named("OPEPL-R", net, MODELS, refiner)
    ((R, t),) = initial_poses(refining, [seen(3)])
    ((R_plain, t_plain),) = initial_poses(VectorFieldSystem(net, MODELS), [seen(3)])
    assert torch.equal(R, R_plain) and torch.equal(t, t_plain)
    refined = refining.estimate_fields(seen(3)[0], K)
    assert np.abs(refined[0].t - t[0].numpy()).max() > 1e-3


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"max_images": 0}, "max_images"),
        ({"max_images": 1.5}, "max_images"),
        ({"seed": -1}, "seed"),
    ],
)
def test_bad_input_is_named(net: VectorFieldNet, options: dict[str, float], name: str) -> None:
    with pytest.raises(ValueError, match=rf"^{name}:"):
        predict_views(net, Photos(2), **options)
