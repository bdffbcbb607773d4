"""Clouds in the car's frame: what is seen, what was predicted, and the pose beside them."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import data_tools
from data_tools import batches
from data_tools.shapes import GLASSES, make_glasses
from posecore.clouds import nearest_neighbours
from posecore.methods.infrared.clouds import CloudSet
from posecore.methods.points_to_pose.pose_clouds import (
    PoseClouds,
    predicted_clouds,
    visible_clouds,
)

COUNT = 200


@pytest.fixture(scope="module")
def data(shared_cache):
    return batches.load(data_tools.open("headset", split="test", scale="tiny"), progress=False)


@pytest.fixture(scope="module")
def seen(data):
    return visible_clouds(data, COUNT)


def test_points_of_the_glasses_lie_on_their_mesh_at_the_pose(seen):
    assert seen.points.shape == (len(seen), COUNT, 3) and seen.points.dtype == torch.float32
    off = []
    for v in range(0, len(seen), 5):
        mesh = make_glasses(GLASSES[int(seen.object_id[v]) - 1])
        worn = seen.points[v, seen.worn[v]]
        if len(worn):
            own = (worn - seen.t[v]) @ seen.R[v]
            triangles = torch.from_numpy(mesh.vertices[mesh.faces].mean(1)).float()
            off.append(nearest_neighbours(triangles, own)[0].median().item())
    assert len(off) > 3 and max(off) < 0.012, off  # triangles are small, and pixels 4 mm wide


def test_views_of_one_instant_agree_in_the_car(data, seen):
    """They have one pose, and clouds about the same place."""
    for group in data.groups[:4]:
        rows = [int((seen.view == view).nonzero()) for view in group]
        for row in rows[1:]:
            torch.testing.assert_close(seen.R[row], seen.R[rows[0]], atol=1e-5, rtol=0)
            torch.testing.assert_close(seen.t[row], seen.t[rows[0]], atol=1e-5, rtol=0)
            assert (seen.points[row].mean(0) - seen.points[rows[0]].mean(0)).norm() < 0.08
            assert seen.scene_id[row] == seen.scene_id[rows[0]]


def test_what_is_drawn_follows_from_the_seed(data, seen):
    assert torch.equal(visible_clouds(data, COUNT).points, seen.points)
    assert not torch.equal(visible_clouds(data, COUNT, seed=1).points, seen.points)
    few = visible_clouds(data, 100_000)  # more than there are pixels
    assert few.points.shape[1] == 100_000


def test_some_of_them(seen):
    part = seen.only(torch.tensor([3, 1]))
    assert len(part) == 2 and torch.equal(part.points[1], seen.points[1])
    assert torch.equal(part.view, seen.view[[3, 1]])
    with pytest.raises(ValueError, match="^points: expected"):
        seen.only(torch.zeros(len(seen), dtype=torch.bool))
    thin = seen.thinned(50)
    assert thin.points.shape == (len(seen), 50, 3) and torch.equal(thin.R, seen.R)
    for v in range(3):
        same = (thin.points[v][:, None] == seen.points[v]).all(-1)
        assert same.any(1).all()
        assert torch.equal(thin.worn[v], seen.worn[v, same.int().argmax(1)])
    for bad in (0, COUNT + 1, 2.5):
        with pytest.raises(ValueError, match="^count: expected"):
            seen.thinned(bad)


def of_views(data, count=7):
    generator = torch.Generator().manual_seed(0)
    points = 0.1 * torch.randn(len(data), count, 3, generator=generator)
    return CloudSet(
        points=points.half(), intensities=torch.zeros(len(data), count).half(),
        t=torch.rand(len(data), 3, generator=generator), scale=torch.ones(len(data)),
        net=torch.zeros(len(data), dtype=torch.int64), scene_id=data.scene_id,
        image_id=data.image_id, group=data.group, T_world_cam=data.T_world_cam, made_from={},
    )  # fmt: skip


def test_predicted_clouds_are_where_they_were_predicted(data, seen):
    clouds = of_views(data)
    found = predicted_clouds(data, clouds)
    assert len(found) == len(data) and found.worn is None
    torch.testing.assert_close(found.points, clouds.in_world().float(), atol=1e-5, rtol=0)
    torch.testing.assert_close(found.R[seen.view], seen.R)
    other = replace(clouds, T_world_cam=clouds.T_world_cam.flip(0))
    with pytest.raises(ValueError, match="^clouds: expected those of the cameras"):
        predicted_clouds(data, other)
    other = replace(clouds, image_id=clouds.image_id.flip(0))
    with pytest.raises(ValueError, match="^clouds: expected those of the"):
        predicted_clouds(data, other)


@pytest.mark.parametrize("name", ["depth", "instance"])
def test_data_that_lack_something(data, monkeypatch, name):
    monkeypatch.setattr(data, "kinds", tuple(kind for kind in data.kinds if kind != name))
    with pytest.raises(ValueError, match=f"^data: expected images of {name}"):
        visible_clouds(data, 5)


def test_numbers_that_do_not_fit(seen):
    with pytest.raises(ValueError, match="^R: expected"):
        replace(seen, R=seen.R[:2])
    broken = seen.points.clone()
    broken[0, 0, 0] = np.nan
    with pytest.raises(ValueError, match="^points: expected finite"):
        replace(seen, points=broken)
    with pytest.raises(ValueError, match="^points: expected shape"):
        PoseClouds(*(getattr(seen, n)[:, 0] if n == "points" else getattr(seen, n)
                     for n in seen.__dataclass_fields__))  # fmt: skip


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("points", torch.Tensor.double), ("points", torch.Tensor.tolist),
        ("worn", lambda worn: worn[:, 1:]), ("worn", torch.Tensor.float),
        ("R", lambda R: R * torch.nan), ("R", lambda R: R[:, :2]), ("t", lambda t: t * torch.inf),
        ("t", lambda t: t[:, 0]), ("scene_id", torch.Tensor.float), ("view", lambda v: v[0]),
    ],
)  # fmt: skip
def test_other_shapes_types_and_values(seen, name, change):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        replace(seen, **{name: change(getattr(seen, name))})
