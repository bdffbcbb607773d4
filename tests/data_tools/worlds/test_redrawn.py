import numpy as np
import pytest
import torch

from data_tools import batches
from data_tools.worlds.headset import WORLD, draw
from data_tools.worlds.redrawn import Redrawn

pytestmark = pytest.mark.slow

NIGHT = {"split": "test", "scale": "tiny", "daylight": 0.0}


def test_views_are_those_that_draw_gives():
    dataset = Redrawn([5, 2], **NIGHT, gain=2.0)
    assert len(dataset) == 6
    expected = [view for i in (5, 2) for view in draw(i, **NIGHT, gain=2.0)]
    for view, other in zip(dataset, expected, strict=True):
        assert (view.scene_id, view.image_id) == (other.scene_id, other.image_id)
        assert np.array_equal(view.ir, other.ir)
    assert np.array_equal(dataset[-1].ir, expected[-1].ir)
    assert dataset.object_ids == WORLD.object_ids
    assert dataset.models() is WORLD.models


def test_models_are_as_large_as_what_is_worn():
    dataset = Redrawn([5], split="test", scale="tiny", glasses_scale=0.8)
    worn = dataset[0].objects[0]
    assert dataset.models().ids == WORLD.models.ids
    mesh = dataset.models().mesh(worn.object_id)
    assert np.allclose(mesh.size, worn.size)
    assert np.allclose(mesh.size, 0.8 * WORLD.models.mesh(worn.object_id).size)


@pytest.mark.parametrize(("light", "kind"), [("infrared", "ir"), ("visible", "rgb")])
def test_batches_take_them(light, kind):
    dataset = Redrawn(range(2), **NIGHT, light=light)
    stack = batches.load(dataset, progress=False)
    assert kind in stack.kinds
    assert len(stack.rows(object_id=5)) == 6
    frames = stack.frames(torch.arange(6))
    given = np.stack([getattr(view, kind) for view in dataset])
    found = (frames[kind].numpy() * 255).round().astype(np.uint8)
    assert np.array_equal(found.reshape(6, -1).sum(1), given.reshape(6, -1).sum(1))


def test_bad_input():
    with pytest.raises(ValueError, match="indices"):
        Redrawn([0, -1], **NIGHT)
    with pytest.raises(IndexError):
        Redrawn([0], **NIGHT)[3]
    with pytest.raises(ValueError, match="index"):
        Redrawn([16], **NIGHT)[0]
    with pytest.raises(ValueError, match="indices"):
        Redrawn([1, 1], **NIGHT)
    for scale in (5.0, 0.0, float("nan"), None):
        with pytest.raises(ValueError, match="glasses_scale"):
            Redrawn([0], **NIGHT, glasses_scale=scale)
    assert len(Redrawn([0], **NIGHT, glasses_scale=np.float32(0.7))) == 3
    with pytest.raises(ValueError, match="gain"):
        Redrawn([0], **NIGHT, gain=0.0)[0]
