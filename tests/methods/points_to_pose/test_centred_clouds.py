"""Clouds about their mean: their poses, what is drawn of them, and what a network says of them."""

from functools import partial

import pytest
import torch

from posecore.methods.points_to_pose import centred_clouds
from posecore.methods.points_to_pose.centred_clouds import (
    CentredClouds,
    pose_of_clouds,
    predict_poses,
)
from posecore.methods.points_to_pose.network import PointsToPose, PointsToRotation
from posecore.nets.pointnet2 import Geometry, build_geometry
from posecore.rotations import geodesic_distance
from tests.methods.points_to_pose.small import LAYERS, small

BUILD = partial(build_geometry, layers=LAYERS, propagations=2)


@pytest.fixture(scope="module")
def clouds(seen):
    return CentredClouds(seen, BUILD)


def points_of(batch):
    """In the frame of the glasses."""
    return (batch["points"] - batch["t"][:, None]) @ batch["R"]


def test_poses_are_relative_to_the_mean(seen, clouds):
    assert len(clouds) == len(seen)
    torch.testing.assert_close(
        clouds.geometry.points.mean(1), torch.zeros(len(seen), 3), atol=1e-6, rtol=0
    )
    own = (seen.points - seen.t[:, None]) @ seen.R
    batch = {"points": clouds.geometry.points, "R": clouds.R, "t": clouds.t}
    torch.testing.assert_close(points_of(batch), own, atol=1e-5, rtol=0)


def test_parts_that_are_built_one_by_one_are_what_all_are(seen, clouds, monkeypatch):
    monkeypatch.setattr(centred_clouds, "AT_ONCE", 7)
    parts = CentredClouds(seen, BUILD).geometry.tensors()
    for name, values in clouds.geometry.tensors().items():
        torch.testing.assert_close(parts[name], values)


def test_what_is_drawn_is_turned_with_its_pose(clouds):
    batch = clouds.draw(40, generator=torch.Generator().manual_seed(0), turn=20.0)
    still = clouds.draw(40, generator=torch.Generator().manual_seed(0))
    assert batch.keys() == still.keys() == {"R", "t", *clouds.geometry.tensors()}
    torch.testing.assert_close(points_of(batch), points_of(still), atol=1e-5, rtol=0)
    angles = torch.rad2deg(geodesic_distance(batch["R"], still["R"]))
    assert angles.max() < 20.01 and angles.max() > 15 and angles.min() < 5
    for name in batch.keys() - {"R", "t", "points"}:
        assert torch.equal(batch[name], still[name])
    # The geometry that was turned is that of the turned points, up to ties.
    again = BUILD(batch["points"])
    same = (again.levels[0].balls == Geometry.of(batch).levels[0].balls).float().mean()
    assert same > 0.99
    for name, bad in (("count", 0), ("turn", -1), ("turn", 181)):
        with pytest.raises(ValueError, match=f"^{name}: expected"):
            clouds.draw(**({"count": 2, "generator": torch.Generator()} | {name: bad}))


def test_some_of_them(clouds):
    part = clouds.only(torch.tensor([3, 1]))
    assert len(part) == len(part.geometry) == 2
    assert torch.equal(part.R, clouds.R[[3, 1]]) and torch.equal(part.view, clouds.view[[3, 1]])
    assert torch.equal(part.geometry.points, clouds.geometry.points[[3, 1]])
    with pytest.raises(ValueError, match="^chosen: expected one cloud or more"):
        clouds.only(torch.zeros(len(clouds), dtype=torch.bool))


@pytest.mark.parametrize("kind", [PointsToPose, partial(PointsToRotation, translation=True)])
def test_answers_are_in_the_world(seen, clouds, kind, monkeypatch):
    """A cloud that is moved moves its answer, prepared or not, few at once or many."""
    net = small(kind).eval()
    R, t = predict_poses(net, clouds)
    assert R.shape == (len(seen), 3, 3) and t.shape == (len(seen), 3)
    alone = pose_of_clouds(net, seen.points[:5])
    torch.testing.assert_close(alone[0], R[:5], atol=1e-4, rtol=0)
    torch.testing.assert_close(alone[1], t[:5], atol=1e-4, rtol=0)
    moved = torch.tensor([1.0, -2, 3])
    far = pose_of_clouds(net, seen.points[:5] + moved)
    torch.testing.assert_close(far[0], R[:5], atol=1e-3, rtol=0)
    torch.testing.assert_close(far[1], t[:5] + moved, atol=1e-4, rtol=0)
    monkeypatch.setattr(centred_clouds, "AT_ONCE", 20)
    torch.testing.assert_close(predict_poses(net, clouds), (R, t), atol=1e-4, rtol=0)


def test_without_a_translation_it_is_the_mean(seen, clouds):
    _, t = predict_poses(small(PointsToRotation).eval(), clouds)
    assert torch.equal(t, clouds.centre)


def test_too_few_points(seen):
    with pytest.raises(ValueError, match="^points: expected"):
        CentredClouds(seen.thinned(10), BUILD)


def test_clouds_that_do_not_fit_into_memory(seen, monkeypatch):
    monkeypatch.setattr("data_tools.batches.memory.machine_memory", lambda: 1000)
    with pytest.raises(ValueError, match="^clouds: expected geometry that fits into"):
        CentredClouds(seen, BUILD)
