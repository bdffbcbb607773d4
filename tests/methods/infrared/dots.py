"""Instants that are exact: a bright dot where an object's origin is, seen by three cameras."""

import numpy as np

from data_tools import batches
from data_tools.views import Dataset, ObjectView, View
from posecore.cameras import project
from posecore.methods.infrared.network import Cloud
from posecore.poses import from_matrix, relative, to_matrix
from posecore.rotations import axis_angle_to_matrix

SIZE = (64, 48)
K = np.array([[70.0, 2, 29.5], [0, 75, 25.0], [0, 0, 1]])
TURNS = ([0, 0.3, 0], [0.1, 0, 0.05], [0, -0.3, 0])
EYES = ([-0.2, 0, -0.7], [0, 0.05, -0.75], [0.2, 0, -0.7])


def cameras():
    """(3, 4, 4) poses of the cameras in the world."""
    return np.stack(
        [to_matrix(axis_angle_to_matrix(np.array(a)), e) for a, e in zip(TURNS, EYES, strict=True)]
    )


class Dots(Dataset):
    """Three views of each instant; a dot of 1.5 pixels on darkness, and its mask."""

    object_ids = (1, 5)

    def __init__(self, count=4, scenes=2, masks=True, **changes):
        rng = np.random.default_rng(0)
        self.places = rng.uniform(-0.06, 0.06, (count, 3))
        self.turned = axis_angle_to_matrix(rng.normal(size=(count, 3)))
        self.scenes, self.masks, self.changes = scenes, masks, changes

    def __len__(self):
        return 3 * len(self.places)

    def __getitem__(self, index):
        instant, camera = divmod(index, 3)
        T = cameras()[camera]
        R, t = relative(*from_matrix(T), self.turned[instant], self.places[instant])
        y, x = np.mgrid[: SIZE[1], : SIZE[0]]
        u, v = project(K, t[None])[0]
        squares = (x - u) ** 2 + (y - v) ** 2
        mask = squares < 9
        objects = [
            ObjectView(object_id=1, R=R, t=t, mask=mask if self.masks else None),
            ObjectView(
                object_id=5, R=np.eye(3), t=t + 0.1, mask=0 * mask > 0 if self.masks else None
            ),
        ]
        usual = {
            "K": K, "scene_id": instant % self.scenes, "image_id": index, "objects": objects,
            "group": ("dots", instant), "T_world_cam": T,
            "ir": np.round(200 * np.exp(-squares / 4.5)).astype(np.uint8),
        }  # fmt: skip
        return View(**(usual | self.changes))

    def models(self):
        raise ValueError("there are no models")


def load(*arguments, **options):
    return batches.load(Dots(*arguments, **options), progress=False)


def centre(picture):
    """(x, y) of what is bright, in pixels."""
    y, x = np.mgrid[: picture.shape[-2], : picture.shape[-1]]
    weights = np.asarray(picture, np.float64)
    return np.array([(x * weights).sum(), (y * weights).sum()]) / weights.sum()


class Says:
    """A network that says the same of every image."""

    def __init__(self, cloud: Cloud, low, high):
        self.cloud, self.low, self.high = cloud, low, high
        self.middle = (low + high) / 2

    def __call__(self, images):
        return self.cloud
