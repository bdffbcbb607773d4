"""Worlds that are made in a moment, in a module that other processes can import."""

import os
from pathlib import Path

import numpy as np

from data_tools.storage import Store

RECIPE = {"seed": 5, "size": [6, 4]}
COUNT, SHARD_SIZE = 23, 3


def make(recipe, index):
    """A record with arrays of every kind, and values."""
    rng = np.random.default_rng([recipe["seed"], index])
    return {
        "rgb": rng.integers(0, 256, (*recipe["size"], 3), np.uint8),
        "depth": rng.random(recipe["size"]).astype(np.float32),
        "masks": rng.random((2, *recipe["size"])) < 0.5,
        "K": rng.random((3, 3)),
        "index": index,
        "process": "many",
        "ids": rng.integers(0, 9, 2).tolist(),
    }


def make_or_fail(recipe, index):
    if index == recipe["bad"]:
        raise ZeroDivisionError("nothing to divide by")
    return make(recipe, index)


def make_or_die(recipe, index):
    """The process ends without a word, once."""
    if index == recipe["bad"] and not Path(recipe["done"]).exists():
        Path(recipe["done"]).touch()
        os._exit(9)
    return make(recipe, index)


def make_wrong(recipe, index):
    return {"fine": 1, "odd": {1, 2}} if index == recipe["bad"] else make(recipe, index)


def world(folder, function=make, shard_size=SHARD_SIZE, **changes):
    return Store(
        "small",
        RECIPE | changes,
        COUNT,
        function,
        version="1",
        shard_size=shard_size,
        folder=folder,
    )


def files(store):
    """The bytes of all files of a world by name."""
    return {p.name: p.read_bytes() for p in sorted(store.folder.iterdir())}
