"""Training batches: a whole dataset as tensors, cut and varied so that every label stays exact.

    data = batches.load(data_tools.open("tabletop", split="train"))
    rows = data.rows(object_id=1, visible=0.3)
    batch = data.crops(rows[:64], 128)  # a dict of tensors
    for batch in batches.Batches(data.crops, rows, 64, seed=0, augment=batches.Augmentation()):
        ...

`Stack` says what a batch holds, `Augmentation` what is varied and how; `RandomCrops` cuts around
objects.
"""

from data_tools.batches import compositing, sensing, warps
from data_tools.batches.augmentation import Augmentation
from data_tools.batches.random_crops import CropPool, RandomCrops
from data_tools.batches.sequence import Batches
from data_tools.batches.stacking import Stack, load

__all__ = [
    "Augmentation",
    "Batches",
    "CropPool",
    "RandomCrops",
    "Stack",
    "compositing",
    "load",
    "sensing",
    "warps",
]
