"""Clouds from infrared and from visible light, by night and by day: chapter 3's question of light.

Both networks learn from the same instants, one from infrared pictures and one from the grey of
pictures that colour cameras take in the same places, without lamps and with a fixed exposure.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2

from book.ch03_infrared_to_clouds import cloud_training as training
from book.tools.keys import Key
from data_tools import batches
from data_tools.views import Dataset, View
from data_tools.worlds.redrawn import Redrawn
from data_tools.worlds.world import WorldModels
from posecore.scale import choose, scale

__all__ = ["DAYLIGHTS", "LIGHTS", "Grey", "drawn", "key", "measure"]

LIGHTS = ("infrared", "visible")
DAYLIGHTS = (0.0, 0.1, 0.5, 1.0)


class Grey(Dataset):
    """Views of a dataset with the grey of their colours as `ir`, which is how networks take them.

    Args:
        dataset: of views with `rgb`.
    """

    def __init__(self, dataset: Redrawn) -> None:
        self.dataset = dataset

    def __len__(self) -> int:
        return len(self.dataset)

    def __getitem__(self, index: int) -> View:
        view = self.dataset[index]
        return replace(view, rgb=None, ir=cv2.cvtColor(view.rgb, cv2.COLOR_RGB2GRAY))

    @property
    def object_ids(self) -> tuple[int, ...]:
        """The ids of the objects, in ascending order."""
        return self.dataset.object_ids

    def models(self) -> WorldModels:
        """The glasses' meshes and what is known of their shape."""
        return self.dataset.models()


def key(light: str, metric: str, daylight: float | None = None) -> Key:
    """What a light is measured by; over all daylights if none is given."""
    return Key(light, "" if daylight is None else f"daylight {daylight:g}", metric)


@cache
def drawn(split: str, light: str, daylight: float | None = None) -> batches.Stack:
    """The first instants of a split in a light, of one channel, drawn once.

    Args:
        split: of `headset`.
        light: one of `LIGHTS`.
        daylight: from 0 at night to 1; None for that of the records.
    """
    if split == training.CROWD:
        count = choose(tiny=4, book=600, paper=600)
    else:
        count = choose(tiny=2, book=60, paper=60)
    views = Redrawn(range(count), split=split, scale=scale(), light=light, daylight=daylight)
    return batches.load(views if light == "infrared" else Grey(views), progress=False)


def measure(seed: int) -> dict[Key, float]:
    """What a network of each light knows of new drivers, from night to day.

    "overlap" is in % and in the views that were not shown, "translation" the median error in mm;
    "overlap spread" the largest overlap of all daylights less the smallest. Both networks are
    trained on instants as bright outside as their records are. A seed has other weights, and other
    batches of the same instants.
    """
    recipe = training.compared()
    values: dict[Key, float] = {}
    for light in LIGHTS:
        net, _ = training.train_net(recipe, split=drawn(training.CROWD, light), seed=seed)
        overlaps = []
        for daylight in DAYLIGHTS:
            views = drawn(training.TEST, light, daylight)
            measured = training.evaluate(net, recipe, views, surfaces=False)
            overlaps.append(100 * float(measured.unseen().mean()))
            values[key(light, "overlap", daylight)] = overlaps[-1]
            values[key(light, "translation", daylight)] = 1000 * float(measured.off.median())
        values[key(light, "overlap spread")] = max(overlaps) - min(overlaps)
    return values
