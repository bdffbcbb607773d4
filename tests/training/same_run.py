"""Two trainings of one program, which depend on each other and note things; run as a script.

It reads lines of JSON, each a list of programs that run at once: [[WORDS, {NAME: VALUE}], ...],
a program in a fork of its own with these variables of the environment, and answers each line with
[[STATUS, OUTPUT], ...]. The words of a program are

FOLDER            trains both, prints their last losses
FOLDER STEP       kills itself after so many steps of the second one
FOLDER - EDIT ... with another "weight", "data" or "code", one after the other, and prints why each
                  is refused
"""

import functools
import json
import os
import signal
import sys
import traceback
from pathlib import Path

import torch
import torch._dynamo  # which optimisers import when they begin; here, once for all forks
from torch import nn

from posecore.training import fit, seeded

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


def main(folder, edit):
    global WEIGHT
    options = {"steps": 12, "save_seconds": 0, "show": False}
    WEIGHT = 2.0 if edit == "weight" else 1.0
    data, loss = points(1.0 if edit == "data" else 0.0), Loss(1.0)
    if edit == "code":
        Loss.error = lambda self, said, batch: (said - batch.sum(1, keepdim=True)).abs()

    def drawn(generator):
        return data[torch.randint(len(data), (16,), generator=generator)]

    first = fit(net(), drawn, loss, resume=folder / "first", **options)
    loss.notes["second"] = 0  # the same object, which has been used or has not
    items = list(data[:1400].split(200))
    second = fit(net(), items, loss, resume=folder / "second", **options)
    if os.environ.get("RANK", "0") == "0":
        print(first.losses["loss"][-1].hex(), second.losses["loss"][-1].hex(), calls)


def program(folder, *words):
    """What a fork does."""
    edits = words[1:]
    for edit in edits or ["none"]:
        try:
            main(Path(folder), edit)
        except ValueError as error:
            if edit not in edits:
                raise
            print(error)


def forked(words, variables):
    """Begin a program; its process and the end of its output."""
    reads, writes = os.pipe()
    child = os.fork()  # torch is imported once, and has not computed yet
    if child:
        os.close(writes)
        return child, reads
    status = 1
    try:
        signal.alarm(120)  # whatever it waits for
        os.dup2(writes, 1)
        os.environ.update(variables)
        sys.argv[1:] = words
        torch.set_num_threads(int(os.environ["OMP_NUM_THREADS"]))
        program(*words)
        sys.stdout.flush()
        status = 0
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(status)


def ended(child, reads):
    """The exit status of a program, negative for a signal, and its output."""
    with open(reads) as output:
        text = output.read()
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), text


if __name__ == "__main__":
    for line in sys.stdin:
        begun = [forked(*one) for one in json.loads(line)]
        print(json.dumps([ended(*one) for one in begun]), flush=True)
