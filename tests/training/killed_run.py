"""A small training that is killed again and again and goes on; run as a script by test_kills.

killed_run.py FOLDER         prints JSON: how each run ended, and what came out
killed_run.py FOLDER MOMENT  one run, which kills itself at that moment
"""

import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import threading
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import torch
import torch._dynamo  # which optimisers import when they begin; here, once for all forks
from torch import nn

from posecore import files
from posecore.training import fit, seeded

STEPS = 80
MOMENTS = [  # what happens for which time when the process dies
    *("start:1", "batch:4", "loss:5", "backward:3", "before descent:4", "after descent:2"),
    *("half written:3", "half written:6", "before rename:3", "before rename:6"),
    *("after rename:3", "after rename:6", "delete:3", "delete:8", "evaluate:1"),
    *("timer:0.02", "timer:0.05", "timer:0.1"),
]


class Batches:
    """Images from a generator whose state is where the run stands."""

    def __init__(self):
        self.generator = torch.Generator().manual_seed(5)

    def __iter__(self):
        return self

    def __next__(self):
        happens("batch")
        images = torch.randn(6, 3, 8, 8, generator=self.generator)
        return {"images": images, "sums": images.sum((1, 2, 3))[:, None] / 10}

    def state_dict(self):
        return {"generator": self.generator.get_state()}

    def load_state_dict(self, state):
        self.generator.set_state(state["generator"])


class Descent(torch.optim.AdamW):
    def step(self, closure=None):
        happens("before descent")
        super().step(closure)
        happens("after descent")


def loss(net, batch):
    happens("loss")
    error = net(batch["images"]) - batch["sums"]
    # Numbers of all three global generators, as a careless loss might take them.
    noise = random.random() + torch.rand(()) / 10
    return {"loss": error.square().mean() * (1 + 0.01 * noise), "error": error.abs().mean()}


def evaluate(net):
    happens("evaluate")
    return {"answer": net(torch.ones(1, 3, 8, 8)).item()}


def train(folder, save_seconds=0.0):
    """What comes out, as numbers that show every bit."""
    with seeded(1):
        net = nn.Sequential(
            *(nn.Conv2d(3, 8, 3), nn.BatchNorm2d(8), nn.ReLU(), nn.Dropout2d(0.2)),
            *(nn.Flatten(), nn.Dropout(0.2), nn.Linear(8 * 36, 1)),
        )
    net[0].weight.register_hook(lambda gradient: happens("backward"))
    happens("start")
    history = fit(
        *(net, Batches(), loss),
        **{"steps": STEPS, "optimiser": Descent, "clip": 0.5, "precision": "float32"},
        **{"evaluate": evaluate, "evaluate_every": 7, "resume": folder},
        **{"save_seconds": save_seconds, "show": False},
    )
    digest = hashlib.sha256()
    for name, value in net.state_dict().items():
        digest.update(name.encode() + value.contiguous().numpy().tobytes())
    return {
        "weights": digest.hexdigest(),
        "losses": [value.hex() for values in history.losses.values() for value in values],
        "measured": [value.hex() for value in history.measured["answer"]],
        "measured_at": history.measured_at,
    }


# Dying -------------------------------------------------------------------------------------------

seen, death = Counter(), SimpleNamespace(event="never", time="1")  # none of the loss's origins


def happens(event):
    seen[event] += 1
    if (event, str(seen[event])) == (death.event, death.time):
        die()


def die():
    os.kill(os.getpid(), getattr(signal, "SIGKILL", signal.SIGTERM))


def run(folder, words):
    """One run in this process, killed at the moment that the words say."""
    death.event, death.time = words.split(":")
    if death.event == "timer":
        threading.Timer(float(death.time), die).start()
    rename, sync, unlink = os.replace, os.fsync, Path.unlink

    def watched_rename(old, new):
        happens("before rename")
        rename(old, new)
        happens("after rename")

    def watched_sync(descriptor):
        if (name := "half written") == death.event and str(seen[name] + 1) == death.time:
            os.ftruncate(descriptor, os.fstat(descriptor).st_size // 2)
        happens("half written")
        sync(descriptor)

    def watched_unlink(path, missing_ok=False):
        happens("delete")
        unlink(path, missing_ok)

    files.os.replace, files.os.fsync, Path.unlink = watched_rename, watched_sync, watched_unlink
    return train(folder)


def in_a_process(folder, words):
    """How such a run ends: 0, or the number of what killed it."""
    if not hasattr(os, "fork"):
        return subprocess.run([sys.executable, __file__, folder, words]).returncode
    child = os.fork()  # torch is imported once, and has not computed yet
    if child == 0:
        try:
            run(folder, words)
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def main():
    torch.set_num_threads(1)
    folder, *words = sys.argv[1:]
    if words:
        run(folder, words[0])
        return
    before, ends = [], {}
    for words in MOMENTS:
        ends[words] = in_a_process(folder, words)
        before.append(max((path.name for path in Path(folder).glob("state-*.pt")), default=""))
    resumed = train(folder)
    print(json.dumps({"ends": ends, "states": before, "resumed": resumed, "whole": train(None)}))


if __name__ == "__main__":
    main()
