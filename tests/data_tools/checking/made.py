"""A small dataset in memory whose masks, depth and colours are those of its poses."""

from dataclasses import replace

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from data_tools.checking.agreement import agreement
from data_tools.checking.drawing import Placement, Shape, draw
from data_tools.checking.sample import read_sample
from data_tools.views import Dataset, ObjectView, View

WIDTH, HEIGHT = 160, 120
K = np.array([[170.0, 0, 83], [0, 200, 57], [0, 0, 1]])


def corner(a, b, c):
    """Three bars of different lengths that meet: no rotation leaves it as it is."""
    parts = [
        trimesh.creation.box(size).apply_translation(place)
        for size, place in (
            ((a, 0.03, 0.03), (a / 2, 0, 0)),
            ((0.03, b, 0.03), (0, b / 2, 0)),
            ((0.03, 0.03, c), (0, 0, c / 2)),
        )
    ]
    return trimesh.util.concatenate(parts)


MESHES = {3: corner(0.16, 0.1, 0.06), 8: corner(0.07, 0.08, 0.15)}


class Models:
    def __init__(self, meshes):
        self.meshes, self.ids = meshes, tuple(meshes)

    def mesh(self, object_id):
        return self.meshes[object_id]

    def info(self, object_id):
        return Shape(object_id, MESHES[object_id])


class Made(Dataset):
    """Views in a list, and meshes that a test may change."""

    def __init__(self, views, meshes=None):
        self.views, self.meshes = list(views), dict(meshes or MESHES)

    object_ids = (3, 8)

    def __len__(self):
        return len(self.views)

    def __getitem__(self, index):
        if isinstance(view := self.views[index], Exception):
            raise view
        return view

    def models(self):
        return Models(self.meshes)

    def each(self, function):
        """With `function(view)` in the place of each view."""
        return Made([function(view) for view in self.views], self.meshes)

    def items(self, function):
        """With what `function(item)` says in the place of fields of each object."""
        return self.each(
            lambda view: replace(view, objects=[replace(o, **function(o)) for o in view.objects])
        )


def made(count=8, seed=0):
    """Two objects in each view, before a wall; lit so that edges are seen."""
    rng = np.random.default_rng(seed)
    shapes = {i: Shape(i, mesh) for i, mesh in MESHES.items()}
    views = []
    for number in range(count):
        depth, picture = np.full((HEIGHT, WIDTH), 3.0), rng.integers(60, 80, (HEIGHT, WIDTH))
        items = []
        for side, object_id in ((-1, 3), (1, 8)):
            R = Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()
            z = rng.uniform(0.6, 1.1)
            t = z * np.array([side * 0.22, 0, 1]) + rng.uniform(-0.05, 0.05, 3)
            mask, own = draw(shapes[object_id], Placement(K, R, t), (WIDTH, HEIGHT))
            depth[mask] = own[mask]
            picture[mask] = 150 + 20 * side
            y, x = np.nonzero(mask)
            box = [x.min(), y.min(), np.ptp(x) + 1, np.ptp(y) + 1]
            items.append(
                ObjectView(
                    object_id=object_id, R=R, t=t, mask=mask, full_mask=mask, box=box,
                    visible_fraction=1.0,
                )
            )  # fmt: skip
        grey = picture.astype(np.uint8)
        views.append(
            View(
                K=K, scene_id=1, image_id=number, rgb=np.stack([grey] * 3, -1),
                depth=depth.astype(np.float32), objects=items,
            )
        )  # fmt: skip
    return Made(views)


def sample_of(dataset):
    """All of its views."""
    shapes = {i: Shape(i, dataset.meshes[i]) for i in dataset.meshes}
    return read_sample(dataset, range(len(dataset)), shapes)


def changed(sample, pose=None, K=None):
    """The instances with other poses or cameras."""
    for instance in sample.instances:
        item = instance.item
        if pose is not None:
            R, t = pose(item.R, item.t)
            item = replace(item, R=R, t=t)
        yield replace(instance, item=item, K=instance.K if K is None else K @ instance.K)


def median(instances, correction):
    return np.median([agreement("masks", i, correction) for i in instances])
