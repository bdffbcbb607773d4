"""VSD of poses in a dataset's images, beside whole depth images and a loop over their pixels."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from data_tools.bop import BopDataset, write_dataset
from data_tools.renderer import prepare_surface, render_depth
from data_tools.views import ObjectView, View
from posecore.methods import surfaces
from posecore.methods.surfaces import DatasetSurfaces
from posecore.metrics import PoseTable
from posecore.metrics.visible_surface import VSD_TAUS
from tests.metrics import bop_loop

K = np.array([[60.0, 0, 23.4], [0, 61, 17.8], [0, 0, 1]])
SIZE = (48, 36)
SHAPES = {
    3: trimesh.creation.box((0.1, 0.06, 0.04)),
    4: trimesh.creation.icosphere(subdivisions=2, radius=0.04),
}
DIAMETER = {3: 0.129, 4: 0.08}


def drawn(mesh, R, t):
    window = render_depth(prepare_surface(mesh.vertices, mesh.faces), (R, t), K, SIZE)
    return window.within((0, 0, *SIZE))


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """Two images of a box and a ball before a wall; poses near them, behind them and elsewhere."""
    rng = np.random.default_rng(0)
    views, rows, others = [], [], []
    for image in range(2):
        depth, objects = np.full(SIZE[::-1], 0.9), []
        for i in SHAPES:
            R = Rotation.random(rng=rng).as_matrix()
            t = np.array([*rng.uniform(-0.06, 0.06, 2), 0.5 + rng.uniform(0, 0.1)])
            alone = drawn(SHAPES[i], R, t)
            depth = np.where((alone > 0) & (alone < depth), alone, depth)
            mask = alone > 0
            objects.append(ObjectView(object_id=i, R=R, t=t, mask=mask, full_mask=mask))
            for shift in ((0.004, 0, 0), (0, 0.01, 0.02), (0, 0, 0.25), (0.9, 0, 0), (0, 0, -1.5)):
                turned = Rotation.from_rotvec(rng.normal(0, 0.1, 3)).as_matrix() @ R
                rows.append((image, i, R, t))
                others.append((image, i, turned, t + shift))
        depth[rng.random(depth.shape) < 0.1] = 0
        depth = depth.astype(np.float32)
        views.append(View(K=K, scene_id=1, image_id=image, depth=depth, objects=tuple(objects)))
    path = tmp_path_factory.mktemp("bop") / "shapes"
    write_dataset({"test": views}, path, SHAPES)
    return BopDataset(path), table(rows), table(others)


def table(rows):
    image, object_id, R, t = zip(*rows, strict=True)
    ones = np.ones(len(rows))
    return PoseTable(ones.astype(int), np.array(image), np.array(object_id), R, t, ones, -ones)


def test_it_is_that_of_whole_images(case):
    dataset, truth, estimates = case
    measure = DatasetSurfaces(dataset, dataset.models(), DIAMETER)
    got = measure(estimates, truth)
    assert got.shape == (20, 10)
    expected = []
    for row in range(20):
        depth = dataset[int(truth.image_id[row])].depth
        i = int(truth.object_id[row])
        mesh = dataset.models().mesh(i)
        both = (drawn(mesh, table.R[row], table.t[row]) for table in (estimates, truth))
        expected.append(bop_loop.vsd(*both, depth, K, DIAMETER[i], 0.015, VSD_TAUS))
    np.testing.assert_allclose(got, expected, atol=1e-9)
    assert 0 < got[0].max() < 0.9 and (got[3] == 1).all() and (got[4] == 1).all()
    np.testing.assert_array_equal(measure(truth, truth), np.zeros((20, 10)))


def test_the_order_of_the_pairs_is_kept(case):
    dataset, truth, estimates = case
    measure = DatasetSurfaces(dataset, dataset.models(), DIAMETER)
    some = np.random.default_rng(1).permutation(20)
    np.testing.assert_array_equal(
        measure(estimates[some], truth[some]), measure(estimates, truth)[some]
    )
    assert measure(estimates[:0], truth[:0]).shape == (0, 10)


def test_a_pose_is_drawn_once_and_an_image_read_once(case, monkeypatch):
    dataset, truth, estimates = case
    drawings, readings = [], []
    monkeypatch.setattr(
        surfaces,
        "render_depth",
        lambda item, pose, *rest: drawings.append(pose) or render_depth(item, pose, *rest),
    )
    read = surfaces.read_depth_image
    monkeypatch.setattr(
        surfaces,
        "read_depth_image",
        lambda data, *image: readings.append(image) or read(data, *image),
    )
    DatasetSurfaces(dataset, dataset.models(), DIAMETER)(estimates, truth)
    assert len(drawings) == 20 + 4
    assert sorted(readings) == [(1, 0), (1, 1)]


def test_delta_and_what_cannot_be_drawn(case):
    dataset, truth, estimates = case
    blind = DatasetSurfaces(dataset, dataset.models(), {3: 0.129}, delta=0.5)
    strict = DatasetSurfaces(dataset, dataset.models(), {3: 0.129}, delta=0.0)
    assert blind.object_ids == {3}
    rows = truth.object_id == 3
    given = estimates[rows], truth[rows]
    assert not np.array_equal(blind(*given), strict(*given))

    class NoFaces:
        def mesh(self, object_id):
            return trimesh.Trimesh(np.eye(3), np.zeros((0, 3), int), process=False)

    assert DatasetSurfaces(dataset, NoFaces(), DIAMETER).object_ids == set()


def test_a_scene_without_depth_is_named(case, monkeypatch):
    dataset, truth, estimates = case
    monkeypatch.setattr(surfaces, "read_depth_image", lambda *_: None)
    with pytest.raises(ValueError, match="depth images, got none of scene 1"):
        DatasetSurfaces(dataset, dataset.models(), DIAMETER)(estimates, truth)
