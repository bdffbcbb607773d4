"""Two small objects and their true fields on small images, for what learns from fields."""

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from posecore import cameras, poses
from posecore.methods.vector_field.masked_fields import MaskedFields
from posecore.models import ObjectModel

K = torch.tensor([[60.0, 0, 24], [0, 60, 18], [0, 0, 1]]).double()
RNG = np.random.default_rng(0)
POINTS = RNG.normal(size=(40, 3)) * [0.05, 0.03, 0.04]
KEYPOINTS = np.concatenate([POINTS[:5], [[0.01, -0.02, 0.005]]])
HALF_TURN = np.stack([np.eye(4), np.diag([-1.0, -1, 1, 1])])
EVEN = np.concatenate([POINTS, POINTS * [-1, -1, 1]])
MODELS = [ObjectModel(3, POINTS, 0.2, KEYPOINTS), ObjectModel(5, EVEN, 0.2, KEYPOINTS, HALF_TURN)]


def some_poses(seed: int, count: int) -> tuple[torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(seed)
    t = rng.uniform([-0.05, -0.05, 0.4], [0.05, 0.05, 0.7], (count, 3))
    R = Rotation.random(count, random_state=rng).as_matrix()
    return torch.from_numpy(R), torch.from_numpy(t)


def seen(seed: int, count: int = 6) -> tuple[MaskedFields, dict[str, torch.Tensor]]:
    """True fields on whole small images, the objects in turns."""
    R, t = some_poses(seed, count)
    ys, xs = (v.ravel() for v in np.mgrid[:36, :48])
    ends = cameras.project(K, poses.apply(R, t, torch.from_numpy(KEYPOINTS)))
    vectors = ends[:, None] - torch.from_numpy(np.stack([xs, ys], -1))[:, None]
    image = torch.arange(count)
    columns = [
        image.repeat_interleave(len(xs)),
        torch.from_numpy(ys).repeat(count),
        torch.from_numpy(xs).repeat(count),
        (image % 2).repeat_interleave(len(xs)),
    ]
    known = {"object_id": 3 + 2 * (image % 2), "R": R, "t": t}
    batch = {name: values[:, None] for name, values in known.items()}  # one object an image
    batch["K"] = K.expand(count, 3, 3)
    return MaskedFields(*columns, vectors.flatten(0, 1)), batch
