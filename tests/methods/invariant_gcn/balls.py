"""Pictures of balls, whose depth and coordinates are known exactly: a dataset of categories."""

import numpy as np

from data_tools.batches import load
from data_tools.views import Dataset, ObjectView, View
from posecore.rotations import random_rotations

K = np.array([[80.0, 0, 31.5], [0, 80, 23.5], [0, 0, 1]])
RADIUS = 0.06
NAMES = ("bottle", "laptop", "mug", "mug")


class Balls(Dataset):
    """One ball in each view, with a pose; the sizes are those of other things.

    The first mug, `handle` True, has a size by which some of the ball is a handle.
    """

    def __init__(self, names=NAMES, count=8, noise=0.0, hole=None):
        self.names, self.count, self.noise, self.hole = names, count, noise, hole

    def __len__(self):
        return self.count

    def __getitem__(self, index):
        rng = np.random.default_rng(index)
        R = random_rotations(generator=rng)
        t = np.array([*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.4, 0.5)])
        rows, columns = np.mgrid[:48, :64]
        rays = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(K).T
        a, b, c = (rays**2).sum(-1), rays @ t, t @ t - RADIUS**2
        inside = b**2 - a * c
        mask = inside > 0
        z = np.where(mask, (b - np.sqrt(np.maximum(inside, 0))) / a, 0)
        coordinates = np.where(mask[..., None], (rays * z[..., None] - t) @ R, 0)
        depth = np.where(mask, z + self.noise * rng.normal(size=z.shape), 0.9)
        if self.hole is not None:
            depth[self.hole] = 0
        # x > -s_x / 2 + s_z is handle: from the middle on, or nowhere.
        narrow = index % len(self.names) == 2
        size = np.array([0.2, 0.12, 0.1 if narrow else 0.25])
        item = ObjectView(
            object_id=index + 1, category=self.names[index % len(self.names)], R=R, t=t, mask=mask,
            size=size, coordinates=coordinates.astype(np.float32), visible_fraction=1.0,
        )  # fmt: skip
        return View(
            K=K, scene_id=0, image_id=index, depth=depth.astype(np.float32), objects=(item,)
        )

    @property
    def object_ids(self):
        return tuple(range(1, self.count + 1))

    def models(self):
        raise ValueError("no models")


def stack(**options):
    return load(Balls(**options), progress=False)
