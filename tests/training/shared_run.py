"""A small training for one process or for those of torchrun; run as a script by test_torchrun.

shared_run.py FILE FOLDER  writes the losses as JSON; FOLDER is for what is interrupted
"""

import json
import os
import sys
from pathlib import Path

import torch
from torch import nn

from posecore.training import fit, seeded

STEPS = 8


class Net(nn.Module):
    def __init__(self, dropout):
        super().__init__()
        self.hidden = nn.Sequential(nn.Linear(5, 32), nn.Tanh(), nn.Dropout(dropout))
        self.out = nn.Linear(32, 2)

    def answer(self, x):
        return self.out(self.hidden(x))


def batches(generator):
    x = torch.randn(12, 5, generator=generator)
    return {"x": x, "y": torch.stack([x.sum(1), x.prod(1)], 1), "scale": torch.tensor(2.0)}


def train(dropout=0.0, most=STEPS, **options):
    with seeded(3):
        net = Net(dropout)
    calls, noise, left = [], [], [None] * most  # what a run notes is none of its origins

    def loss(net, batch):
        noise.append(torch.rand(()).item())  # from where dropout takes its masks
        calls.append(len(batch["x"]))
        if not left:
            raise InterruptedError
        left.pop()
        # A method that is not forward, as nets have that are asked for several things.
        error = batch["scale"] * (net.answer(batch["x"]) - batch["y"])
        return {"loss": error.square().mean(), "error": error.abs().mean()}

    history = fit(net, batches, loss, steps=STEPS, lr=0.01, show=False, **options)
    weights = [value.hex() for value in nn.utils.parameters_to_vector(net.parameters()).tolist()]
    return {"losses": history.losses, "rows": calls, "noise": noise, "weights": weights}


def write(file, folder):
    result = {"plain": train(), "dropout": train(0.5)}
    again = dict(resume=folder, save_seconds=0.0)
    try:
        train(0.5, most=5, **again)
    except InterruptedError:
        result["resumed"] = train(0.5, **again)
    Path(f"{file}.{os.environ.get('RANK', '0')}").write_text(json.dumps(result))


if __name__ == "__main__":
    torch.set_num_threads(1)
    write(*sys.argv[1:])
