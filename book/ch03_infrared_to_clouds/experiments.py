"""What chapter 03 measures: whether its network learns more than where things usually are."""

from __future__ import annotations

from itertools import islice

import torch
from torch import Tensor

import data_tools
from book.tools.claims import Claim
from book.tools.keys import Key
from book.tools.ledger import Measurement
from posecore.methods.infrared_to_clouds.recipe import RECIPES, Samples, collect, train
from posecore.scale import choose, scale

__all__ = ["CLAIMS", "MEASUREMENTS", "TEAPOT", "seen"]

TEAPOT = 5
NETWORK, MEAN = (Key(name, "easy", "translation") for name in ("network", "mean pose"))

CLAIMS = [
    Claim(id="learns", statement="The network is nearer than the mean of what it was trained on",
          source="not in the paper", ours=True, measurement="whole_images",
          favoured=NETWORK, other=MEAN, better="lower", unit="mm"),
]  # fmt: skip


def seen(split: str) -> Samples:
    """The teapot in the first images of a split of `tabletop`; no others are made."""
    views = data_tools.open("tabletop", split=split, whole=False)
    few = islice(views, choose(tiny=40, book=160, paper=None))
    return collect(few, TEAPOT, RECIPES[scale()].size)


def whole_images(seed: int) -> dict[Key, float]:
    """Millimetres by which both are off on `easy`, on average."""
    samples, test = seen("train"), seen("easy")

    def off(t: Tensor) -> float:
        return 1000 * (t - test.t).norm(dim=-1).mean().item()

    net, _ = train(samples, RECIPES[scale()], seed=seed, device="cpu", show=False)
    with torch.no_grad():
        _, t = net(test.images, test.K)
    return {NETWORK: off(t), MEAN: off(samples.t.mean(0))}


MEASUREMENTS = {
    "whole_images": Measurement(whole_images, range(3), ("tabletop/train", "tabletop/easy")),
}
