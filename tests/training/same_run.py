"""Two trainings of one program, which depend on each other and note things; run as a script.

same_run.py FOLDER          trains both, prints their last losses
same_run.py FOLDER STEP     kills itself after so many steps of the second one
same_run.py FOLDER - EDIT ...   with another "weight", "data" or "code", one after the other, and
                            prints why each is refused
"""

import functools
import os
import signal
import sys
from pathlib import Path

import torch
from torch import nn

from posecore.training import fit, seeded

FOLDER, EDITS = Path(sys.argv[1]), sys.argv[3:]
WEIGHT = 1.0
calls = 0


@functools.cache
def points(moved):
    """Computed: sums in another order round otherwise, and what is chosen by them is another."""
    with seeded(0):
        x = torch.randn(4000, 3) + torch.randn(2**18).sum()
    chosen = x[(x[:, 0] * 2**20).frac().abs() > 0.5]
    return chosen + moved


class Loss:
    """A loss that counts, keeps a mean and remembers."""

    def __init__(self, weight):
        self.weight, self.scale = weight, points(0.0).std().item()
        self.calls, self.last, self.mean, self.notes = 0, None, torch.zeros(3), {}

    def __call__(self, net, batch):
        global calls
        calls, self.calls, self.last = calls + 1, self.calls + 1, batch
        self.mean.lerp_(batch.mean(0), 0.1)
        self.notes[self.calls] = len(batch)
        if "second" in self.notes and str(self.notes["second"]) in sys.argv[2:]:
            os.kill(os.getpid(), getattr(signal, "SIGKILL", signal.SIGTERM))
        if "second" in self.notes:
            self.notes["second"] += 1
        return self.weight * WEIGHT * self.error(net(batch), batch).square().mean()

    def error(self, said, batch):
        return said - batch.sum(1, keepdim=True) / self.scale


def net():
    with seeded(1):
        return nn.Sequential(nn.Linear(3, 8), nn.Tanh(), nn.Linear(8, 1))


def main(edit):
    global WEIGHT
    options = {"steps": 12, "save_seconds": 0, "show": False}
    WEIGHT = 2.0 if edit == "weight" else 1.0
    data, loss = points(1.0 if edit == "data" else 0.0), Loss(1.0)
    if edit == "code":
        Loss.error = lambda self, said, batch: (said - batch.sum(1, keepdim=True)).abs()

    def drawn(generator):
        return data[torch.randint(len(data), (16,), generator=generator)]

    first = fit(net(), drawn, loss, resume=FOLDER / "first", **options)
    loss.notes["second"] = 0  # the same object, which has been used or has not
    items = list(data[:1400].split(200))
    second = fit(net(), items, loss, resume=FOLDER / "second", **options)
    if os.environ.get("RANK", "0") == "0":
        print(first.losses["loss"][-1].hex(), second.losses["loss"][-1].hex(), calls)


if __name__ == "__main__":
    for edit in EDITS or ["none"]:
        try:
            main(edit)
        except ValueError as error:
            if edit not in EDITS:
                raise
            print(error)
