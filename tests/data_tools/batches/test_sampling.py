"""Pose, camera matrix, masks, boxes, visible fractions and coordinates after every augmentation."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import binary_erosion, distance_transform_edt

from data_tools.batches import Augmentation
from data_tools.renderer import prepare, render_labels
from data_tools.shapes import make_object
from data_tools.worlds.categories import WORLD as CATEGORIES
from posecore.cameras import project, resize_intrinsics
from posecore.rotations import special_procrustes
from tests.data_tools.batches.conftest import load, make_view

pytestmark = pytest.mark.slow

OFF = Augmentation.none()
GEOMETRY = Augmentation(**{**vars(OFF), "turn": np.pi, "shift": 0.3, "zoom": 1.6})
COVERS = Augmentation(**{**vars(GEOMETRY), "background": 0.5, "occluder": 1.0, "keep": 0.4})
SENSOR = Augmentation(**{**vars(Augmentation()), "turn": 0, "shift": 0, "zoom": 1, "background": 0,
                         "occluder": 0})  # fmt: skip
WORLDS = ("categories", "headset", "tabletop")
every_world = pytest.mark.parametrize("world", WORLDS)


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


def numbers(batch):
    return {name: value.numpy() for name, value in batch.items()}


def crops(stack, size=64, augment=None, seed=0, **options):
    rows = stack.rows(**options)
    generator = None if augment is None else seeded(seed)
    return rows, numbers(stack.crops(rows, size, augment=augment, generator=generator))


def colours(batch):
    return batch["rgb" if "rgb" in batch else "ir"]


def mesh_of(world, object_id):
    if world == "tabletop":
        return prepare(make_object(int(object_id)))
    return prepare(CATEGORIES.models.mesh(int(object_id)))


OF_OBJECTS = {"R", "t", "size", "box", "object_id", "visible_fraction"}


@every_world
def test_whole_images_are_the_views(world, stack_of, views_of):
    stack, views = stack_of(world), views_of(world)
    batch = numbers(stack.frames(torch.arange(len(views))))
    for index, view in enumerate(views):
        image = view.rgb if view.ir is None else view.ir[..., None]
        assert np.allclose(colours(batch)[index].transpose(1, 2, 0), image / 255, atol=1e-7)
        assert np.allclose(batch["depth"][index], view.depth, atol=0.6e-4)
        assert np.allclose(batch["K"][index], view.K, rtol=1e-6)
        assert (batch["object_id"][index] >= 0).sum() == len(view.objects)
        for slot, item in enumerate(view.objects):
            known = {name: batch[name][index, slot] for name in OF_OBJECTS & batch.keys()}
            assert np.array_equal(batch["instance"][index] == slot, item.mask)
            assert np.allclose(known["R"], item.R, atol=1e-6)
            assert np.allclose(known["t"], item.t, atol=1e-6)
            assert known["object_id"] == item.object_id
            assert np.isclose(known["visible_fraction"], item.visible_fraction, atol=1e-6)
            assert np.allclose(known["size"], item.size, atol=1e-6)
            assert np.allclose(known["box"], np.zeros(4) if item.box is None else item.box)
            if item.coordinates is not None:
                got = batch["coordinates"][index][item.mask]
                # Depth is kept in steps of 0.1 mm; a ray is at most a little longer than its depth.
                assert np.abs(got - item.coordinates[item.mask]).max() < 1e-4


@given(st.integers(0, 2**32), st.sampled_from(WORLDS), st.booleans())
def test_points_are_where_the_image_shows_them(stack_of, seed, world, whole):
    """An affine map takes the old pixels of an object's points to their new ones, for any depth."""
    stack = stack_of(world)
    if whole:
        batch = stack.frames(torch.arange(4), augment=GEOMETRY, generator=seeded(seed))
        image, slot = (batch["object_id"] >= 0).nonzero(as_tuple=True)
        batch |= {name: batch[name][image, slot] for name in ("row", "R", "t")}
    else:
        batch = stack.crops(stack.rows()[:9], 64, augment=GEOMETRY, generator=seeded(seed))
        image = torch.arange(9)
    rows = batch["row"]
    points = torch.rand(len(rows), 30, 3, generator=seeded(seed), dtype=torch.float64) * 0.1 - 0.05
    old_K, new_K = stack.K[stack.view[rows]], batch["K"][image].double()
    old = project(old_K, points @ stack.R[rows].mT + stack.t[rows, None])
    new = project(new_K, points @ batch["R"].double().mT + batch["t"].double()[:, None])
    ones = torch.ones_like(old[..., :1])
    fit = torch.linalg.lstsq(torch.cat([old, ones], -1), new).solution
    assert (torch.cat([old, ones], -1) @ fit - new).abs().max() < 1e-3
    # Nothing is mirrored or sheared: the map turns, and scales both ways alike where fx = fy.
    linear = fit[:, :2]
    assert (torch.linalg.det(linear) > 0).all()
    assert torch.allclose(
        batch["R"].mT @ batch["R"], torch.eye(3).expand(len(rows), 3, 3), atol=1e-5
    )
    assert torch.allclose(batch["t"][:, 2], stack.t[rows, 2].float(), atol=1e-6)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("world, size", [("tabletop", 64), ("tabletop", 24), ("categories", 64)])
def test_masks_are_what_a_renderer_draws_with_the_new_pose(stack_of, world, size, seed):
    """A mask is right at the centres of old pixels, so wrong only where the rim is nearer."""
    stack = stack_of(world)
    rows, batch = crops(stack, size, GEOMETRY, seed, visible=1.0)
    assert len(rows) > 5
    finer = 5  # since a handle may be thinner than a pixel
    K = [
        resize_intrinsics(K.astype(np.float64), (size, size), (finer * size,) * 2)
        for K in batch["K"]
    ]
    for i in range(min(12, len(rows))):
        mesh = mesh_of(world, batch["object_id"][i])
        R = special_procrustes(batch["R"][i].astype(np.float64))
        pose = [(R, batch["t"][i].astype(np.float64))]
        fine = render_labels([mesh], pose, K[i], (finer * size,) * 2).full_masks[0]
        centre = np.s_[finer // 2 :: finer, finer // 2 :: finer]
        drawn, mask = fine[centre], batch["mask"][i]
        zoom = zoom_of(stack, rows[i], batch, i)
        # How far the nearest place with the other answer is, in pixels.
        away = np.where(fine, distance_transform_edt(fine), distance_transform_edt(~fine))[centre]
        wrong = (drawn != mask) & inside_of_source(stack, rows[i], batch, i, size)
        reach = zoom / np.sqrt(2) + np.sqrt(2) / finer
        assert away[wrong].max(initial=0) / finer <= reach
        # On average a rim is off by a quarter of an old pixel.
        rim = drawn & ~binary_erosion(drawn)
        assert wrong.sum() <= 0.5 * max(zoom, 1) * rim.sum()


def map_of(stack, row, batch, i):
    """(3, 3) from old to new pixels, from camera matrices and poses alone."""
    view = stack.view[row]
    old = stack.K[view].numpy()
    turn = batch["R"][i].astype(np.float64) @ stack.R[row].numpy().T
    return batch["K"][i].astype(np.float64) @ turn @ np.linalg.inv(old)


def zoom_of(stack, row, batch, i):
    return np.linalg.svd(map_of(stack, row, batch, i)[:2, :2])[1].max()


def inside_of_source(stack, row, batch, i, size):
    y, x = np.mgrid[:size, :size]
    back = np.linalg.inv(map_of(stack, row, batch, i))
    at = np.stack([x, y, np.ones_like(x)], -1) @ back.T
    width, height = stack.size
    return ((at[..., :2] > 0) & (at[..., :2] < (width - 1, height - 1))).all(-1)


@pytest.mark.parametrize("augment", [None, GEOMETRY, COVERS, Augmentation()])
def test_coordinates(stack_of, augment):
    stack = stack_of("categories")
    rows, batch = crops(stack, 64, augment)
    for i in range(len(rows)):
        mask, coordinates = batch["mask"][i], batch["coordinates"][i]
        assert not coordinates[~mask].any()
        points = coordinates[mask].astype(np.float64)
        camera = points @ batch["R"][i].T.astype(np.float64) + batch["t"][i]
        pixels = project(batch["K"][i].astype(np.float64), camera)
        y, x = np.nonzero(mask)
        assert np.abs(pixels - np.stack([x, y], 1)).max() < 1e-3
        # On the object, up to the slope of its surface within half an old pixel.
        assert (np.abs(points) < batch["size"][i] / 2 + 0.01).all()


def test_coordinates_are_on_the_surface(stack_of):
    """As near as the nearest old pixel, whose depth they have."""
    stack = stack_of("categories")
    rows, batch = crops(stack, 64, GEOMETRY, visible=1.0)
    for i in range(len(rows)):
        K = stack.K[stack.view[rows[i]]].numpy()
        pose = stack.R[rows[i]].numpy(), stack.t[rows[i]].numpy()
        labels = render_labels(
            [mesh_of("categories", batch["object_id"][i])], [pose], K, stack.size
        )
        back = np.linalg.inv(map_of(stack, rows[i], batch, i))
        y, x = np.nonzero(batch["mask"][i])
        at = np.rint(np.stack([x, y, np.ones_like(x)], 1) @ back.T)[:, :2].astype(int)
        at = at[:, 1], at[:, 0]
        same = labels.instance[at] == 0
        assert same.mean() > 0.99  # at ties two roundings may differ
        error = np.linalg.norm(batch["coordinates"][i][y, x] - labels.coordinates[at], axis=1)
        half_a_pixel = labels.depth[at] / K[0, 0] / np.sqrt(2)
        assert (error[same] <= 1.01 * half_a_pixel[same] + 2e-4).all()


@pytest.mark.parametrize("size", [1, 7, (26, 17)])
@pytest.mark.parametrize("centre", [(15.5, 11.5), (-300.0, 500.0)])
def test_every_pixel_at_the_extremes(size, centre):
    """A skewed camera, its centre outside the image, turned, zoomed and shifted by all there is."""
    K = np.array([[120, 20, centre[0]], [0, 90, centre[1]], [0, 0, 1]])
    rng = np.random.default_rng(0)
    depths = rng.uniform(0.5, 3, (6, 24, 32)).astype(np.float32)
    stack = load([make_view(i, 2, K=K, depth=depth) for i, depth in enumerate(depths)])
    far = Augmentation(**{**vars(OFF), "turn": np.pi, "zoom": 10, "shift": 1})
    rows, batch = crops(stack, size, far)
    seen = 0
    for i, row in enumerate(rows):
        _, height, width = batch["rgb"][i].shape
        back = np.linalg.inv(map_of(stack, row, batch, i))
        instance = stack.image("instance", stack.view[row])
        for y, x in np.ndindex(height, width):
            at = back[:2] @ [x, y, 1]
            column, line = (int(np.floor(a + 0.5)) for a in at)
            if np.abs(at - np.floor(at) - 0.5).min() < 5e-3:
                continue  # as near to the next pixel
            inside = 0 <= column < 32 and 0 <= line < 24
            mask = inside and instance[line, column] == stack.slot[row]
            depth = depths[stack.view[row], line, column] if inside else 0
            assert batch["mask"][i, y, x] == mask
            assert np.isclose(batch["depth"][i, y, x], depth, atol=0.6e-4)
            seen += mask
    assert seen > 0


@every_world
@pytest.mark.parametrize("augment", [GEOMETRY, COVERS])
def test_boxes_and_fractions_are_those_of_the_masks(stack_of, world, augment):
    stack = stack_of(world)
    rows, batch = crops(stack, (60, 48), augment)
    for i, mask in enumerate(batch["mask"]):
        area = abs(np.linalg.det(map_of(stack, rows[i], batch, i)))
        view = stack.view[rows[i]]
        seen = (stack.image("instance", view) == stack.slot[rows[i]].item()).sum()
        fraction = mask.sum() * stack.visible_fraction[rows[i]].item() / (seen * area)
        assert np.isclose(batch["visible_fraction"][i], min(fraction, 1), atol=1e-3)
        y, x = np.nonzero(mask)
        box = [x.min(), y.min(), np.ptp(x) + 1, np.ptp(y) + 1] if len(x) else [0, 0, 0, 0]
        assert batch["box"][i].tolist() == box


@every_world
def test_occluders(stack_of, world):
    """They hide, they leave enough, they are in front, and all else stays as it was."""
    stack = stack_of(world)
    off = Augmentation(**{**vars(COVERS), "occluder": 0.0})
    _, free = crops(stack, 64, off, 3)
    _, batch = crops(stack, 64, COVERS, 3)
    hidden = free["mask"] & ~batch["mask"]
    assert not (batch["mask"] & ~free["mask"]).any()
    assert (hidden.sum((1, 2)) > 0).mean() > 0.3
    assert (batch["mask"].sum((1, 2)) >= 0.4 * free["mask"].sum((1, 2))).all()
    for name in ("K", "R", "t", "row"):
        assert np.array_equal(batch[name], free[name])
    kept = np.broadcast_to(batch["mask"][:, None], colours(batch).shape)
    assert np.array_equal(colours(batch)[kept], colours(free)[kept])
    both = hidden & (free["depth"] > 0) & (batch["depth"] > 0)
    assert both.sum() > 100
    assert (batch["depth"] < free["depth"])[both].mean() > 0.99
    assert (batch["visible_fraction"] <= free["visible_fraction"]).all()


@every_world
def test_backgrounds(stack_of, world):
    stack = stack_of(world)
    on = Augmentation(**{**vars(OFF), "background": 1.0})
    _, before = crops(stack, 64, OFF)
    _, batch = crops(stack, 64, on)
    objects = np.broadcast_to(before["mask"][:, None], colours(batch).shape)
    assert np.array_equal(colours(batch)[objects], colours(before)[objects])
    assert np.array_equal(batch["depth"][before["mask"]], before["depth"][before["mask"]])
    for name in ("mask", "box", "visible_fraction", "K", "R", "t"):
        assert np.array_equal(batch[name], before[name])
    assert (colours(batch) != colours(before)).mean() > 0.2


@every_world
def test_sensors_leave_labels_alone(stack_of, world):
    stack = stack_of(world)
    _, before = crops(stack)
    _, batch = crops(stack, augment=SENSOR)
    for name in batch.keys() - {"rgb", "ir", "depth"}:
        assert np.array_equal(batch[name], before[name]), name
    assert not np.allclose(colours(batch), colours(before), atol=0.02)
    assert colours(batch).min() >= 0 and colours(batch).max() <= 1


def test_cameras_stay_where_they_are_in_the_world(stack_of):
    """A turned camera is another camera, but the object is where it was."""
    stack = stack_of("headset")
    rows, batch = crops(stack, augment=Augmentation())
    T = stack.T_world_cam[stack.view[rows]].numpy()
    old = T[:, :3, :3] @ stack.t[rows, :, None].numpy() + T[:, :3, 3:]
    T_new = batch["T_world_cam"]
    new = T_new[:, :3, :3] @ batch["t"][..., None] + T_new[:, :3, 3:]
    assert np.abs(new - old).max() < 1e-6
    turned = T_new[:, :3, :3] @ batch["R"]
    assert np.abs(turned - T[:, :3, :3] @ stack.R[rows].numpy()).max() < 1e-5


@every_world
def test_the_same_seed_gives_the_same_batch(stack_of, world):
    stack = stack_of(world)
    threads = torch.get_num_threads()
    _, first = crops(stack, augment=Augmentation(), seed=5)
    try:
        torch.set_num_threads(3)
        _, again = crops(stack, augment=Augmentation(), seed=5)
    finally:
        torch.set_num_threads(threads)
    _, other = crops(stack, augment=Augmentation(), seed=6)
    assert all(np.array_equal(first[name], again[name]) for name in first)
    assert not np.array_equal(colours(first), colours(other))


@every_world
def test_memory_is_channels_last(stack_of, world):
    images = colours(stack_of(world).crops(stack_of(world).rows()[:4], 32))
    assert images.is_contiguous(memory_format=torch.channels_last)
    assert images.dtype == torch.float32


def test_whole_images_with_everything(stack_of):
    """Labels of several objects in an image agree with each other."""
    stack = stack_of("tabletop")
    batch = numbers(stack.frames(torch.arange(10), augment=Augmentation(), generator=seeded()))
    for image, slot in np.argwhere(batch["object_id"] >= 0):
        mask = batch["instance"][image] == slot
        box, R, t, size = (batch[name][image, slot] for name in ("box", "R", "t", "size"))
        assert box[2] == (np.ptp(np.nonzero(mask)[1]) + 1 if mask.any() else 0)
        if mask.sum() > 30:
            corners = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), -1).reshape(-1, 3)
            pixels = project(batch["K"][image], (corners * size * 1.2) @ R.T + t)
            y, x = np.nonzero(mask)
            assert pixels[:, 0].min() < x.mean() < pixels[:, 0].max()
            assert pixels[:, 1].min() < y.mean() < pixels[:, 1].max()
