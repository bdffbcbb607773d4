"""How long chapter 8's system takes for an image, by stage, number of objects and size."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from book.ch08_vector_fields import comparison
from book.ch08_vector_fields import field_training as training
from book.tools.keys import Key
from posecore import weights
from posecore.methods.vector_field.masked_fields import MaskedFields, predict_fields
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.methods.vector_field.systems import STAGES, VectorFieldSystem
from posecore.nets.resnet import fold_batch_norm
from posecore.scale import choose, scale

__all__ = ["LARGER", "THREE_TIMES_ONE", "measure_speed", "part_of", "time_key"]

LARGER = ((320, 240), (640, 480))
"""Width and height of images in which only the time is of interest."""
THREE_TIMES_ONE = Key("3 x 1 object", "easy", "time")
"""Three times the time for one object."""


def time_key(count: int, stage: str = "", group: str = "") -> Key:
    """The key of the time for an image of `easy`.

    Args:
        count: of objects.
        stage: of `STAGES`; "" for all of them together.
        group: "WIDTH x HEIGHT" of larger images; "" for those that networks are trained on.
    """
    method = f"{count} object" if count == 1 else f"{count} objects"
    return Key(method, "easy", f"time of {stage}" if stage else "time", group)


def measure_speed(seed: int) -> dict[Key, float]:
    """Milliseconds for one image with one, two and three objects, in all and by stage.

    The network is the one that the page ships, as no training of its own would change what time it
    takes; a seed has other images. The networks with fewer objects are parts of the one with three:
    the same but for the last layers. Images are looked at one by one, of those that show most of
    the three. In larger images the objects are larger than in training, so there the votes and what
    follows are given the true field, as many pixels as it has.
    """
    net = _shipped() if scale() == "book" else comparison.trained("pixel", seed)
    known = training.models()
    data = training.stack("easy")
    rows = data.rows(object_id=training.OBJECTS, visible=0.5)
    shown = torch.bincount(data.view[rows], minlength=len(data))
    views = shown.argsort(descending=True, stable=True)[seed % 3 :: 3]
    views = views[: choose(tiny=2, book=20, paper=50)]
    usual = training.recipe().image_size(data)
    values = {}
    for count in range(1, 1 + len(known)):
        system = training.recipe().system("OPEPL", part_of(net, count), known[:count])
        for size in (usual, *LARGER):
            batches = [data.frames(view[None], size) for view in views]
            timed = _of_an_image if size == usual else _of_a_larger_image
            times = [timed(system, batch) for batch in (batches[0], *batches)]
            times = 1000 * np.median(times[1:], axis=0)  # the first call sets things up
            group = "" if size == usual else f"{size[0]} x {size[1]}"
            values[time_key(count, group=group)] = float(times[0])
            for stage, spent in zip(STAGES, times[1:], strict=True):
                values[time_key(count, stage, group)] = float(spent)
    values[THREE_TIMES_ONE] = 3 * values[time_key(1)]
    return values


def _shipped() -> VectorFieldNet:
    net = training.new_net()
    path = Path(__file__).with_name("weights") / "field.safetensors"
    net.load_state_dict(weights.parse(path.read_bytes()))
    return net.eval()


def part_of(net: VectorFieldNet, count: int) -> VectorFieldNet:
    """The same network for the first `count` of its objects, and for use only."""
    smaller = training.recipe().new_net(training.models()[:count])
    kept = dict(net.state_dict())
    rows = {"mask_layer": 1 + count, "vector_layer": 2 * net.keypoints * count}
    for layer, number in rows.items():
        for name in ("weight", "bias"):
            kept[f"{layer}.{name}"] = kept[f"{layer}.{name}"][:number]
    smaller.load_state_dict(kept)
    return fold_batch_norm(smaller.eval()).to(memory_format=torch.channels_last)


def _of_an_image(system: VectorFieldSystem, batch: dict[str, Tensor]) -> list[float]:
    """Seconds, in all and of each stage."""
    began = time.perf_counter()
    estimates = system.estimate(batch["rgb"], batch["K"])
    total = time.perf_counter() - began
    return [total, *(estimates[0].seconds.values() if estimates else [total, 0, 0, 0])]


def _of_a_larger_image(system: VectorFieldSystem, batch: dict[str, Tensor]) -> list[float]:
    fields = MaskedFields(*training.true_fields(batch, system.models)[1:])
    began = time.perf_counter()
    predict_fields(system.net, batch["rgb"])
    seconds = time.perf_counter() - began
    estimates = system.estimate_fields(fields, batch["K"], seconds)
    total = time.perf_counter() - began
    return [total, *(estimates[0].seconds.values() if estimates else [total, 0, 0, 0])]
