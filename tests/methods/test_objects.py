"""Models of a dataset's objects: points on the surface, keypoints among them, what BOP knows."""

import numpy as np
import pytest
import trimesh

import data_tools
from posecore.methods.objects import object_models


@pytest.fixture(scope="module")
def known():
    return data_tools.open("tabletop", split="easy", scale="tiny").models()


def test_points_lie_on_the_surface_and_keypoints_among_them(known):
    duck, vase = object_models(known, [1, 3], points=300, keypoints=5)
    for model in (duck, vase):
        mesh = known.mesh(model.object_id)
        surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        _, distance, _ = trimesh.proximity.closest_point_naive(surface, model.points[:40])
        assert distance.max() < 2e-6  # metres; the oracle is no better at slivers
        assert model.points.shape == (300, 3) and model.keypoints.shape == (6, 3)
        for keypoint in model.keypoints[:-1]:
            assert (model.points == keypoint).all(-1).any()
        middle = (model.points.min(0) + model.points.max(0)) / 2
        np.testing.assert_allclose(model.keypoints[-1], middle)
        assert model.diameter == known.info(model.object_id).diameter
    assert vase.symmetric and not duck.symmetric


def test_points_are_spread_by_area(known):
    """Half of the surface holds about half of the points, however fine its triangles are."""
    model = object_models(known, [5], points=4000)[0]
    mesh = known.mesh(5)
    surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    low = np.median(mesh.vertices[:, 2])
    share = surface.area_faces[surface.triangles_center[:, 2] < low].sum() / surface.area
    found = (model.points[:, 2] < low).mean()
    assert abs(found - share) < 4 * np.sqrt(share * (1 - share) / 4000) + 0.01


def test_the_same_every_time(known):
    first, second = (object_models(known, [1], points=50)[0] for _ in range(2))
    assert np.array_equal(first.points, second.points)
    assert np.array_equal(first.keypoints, second.keypoints)


class Flat:
    """A model set with one object whose triangles have no area."""

    def mesh(self, object_id):
        return trimesh.Trimesh(np.zeros((3, 3)), [[0, 1, 2]], process=False)

    def info(self, object_id):
        return data_tools.open("tabletop", split="easy", scale="tiny").models().info(1)


def test_bad_input(known):
    with pytest.raises(ValueError, match="99"):
        object_models(known, [99])
    with pytest.raises(ValueError, match="models"):
        object_models(known, [])
    with pytest.raises(ValueError, match="models"):
        object_models(known, [1, 1], points=20)
    with pytest.raises(ValueError, match=r"known.*area"):
        object_models(Flat(), [1])
    with pytest.raises(ValueError, match="count"):
        object_models(known, [1], points=5, keypoints=8)
