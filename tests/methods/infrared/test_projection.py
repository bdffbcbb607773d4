"""Clouds of one camera, seen by others."""

import numpy as np
import pytest
import torch

from posecore.cameras import project
from posecore.methods.infrared.projection import Projector, into_views
from posecore.poses import from_matrix, relative
from posecore.splat import render
from tests.methods.infrared.dots import SIZE, K, cameras

GRID = (32, 24, 20)
PROJECTOR = Projector(SIZE, GRID, 0.5)


def scene(count=2, points=9):
    """Clouds in the frames of the middle camera, seen by all three."""
    generator = torch.Generator().manual_seed(0)
    poses = torch.from_numpy(cameras())
    cloud = 0.2 * torch.rand(count, points, 3, generator=generator, dtype=torch.float64) - 0.1
    t = torch.tensor([[0.0, -0.05, 0.75], [0.02, 0, 0.7]], dtype=torch.float64)[:count]
    return {
        "points": cloud, "t": t, "own": poses[1].expand(count, 4, 4),
        "K": torch.from_numpy(K).expand(count, 3, 3, 3),
        "T_world_cam": poses.expand(count, 3, 4, 4),
    }  # fmt: skip


def test_points_go_through_the_world_into_the_other_frames():
    given = scene()
    found = into_views(given["points"], given["own"], given["T_world_cam"])
    R, t = from_matrix(cameras()[1])
    world = given["points"].numpy() @ R.T + t
    for j, pose in enumerate(cameras()):
        R, t = from_matrix(pose)
        np.testing.assert_allclose(found[:, j], (world - t) @ R, atol=1e-12)
    torch.testing.assert_close(found[:, 1], given["points"], rtol=0, atol=1e-12)
    pose = relative(*from_matrix(cameras()[0]), *from_matrix(cameras()[1]))
    expected = given["points"].numpy() @ pose[0].T + pose[1]
    np.testing.assert_allclose(found[:, 0], expected, atol=1e-12)


def test_a_point_is_drawn_where_its_pixel_is_and_the_middle_midway():
    given = scene()
    given["points"][:, 0] = 0
    voxels = PROJECTOR.to_voxels(**given)
    assert voxels.shape == (2, 3, 9, 3)
    np.testing.assert_allclose(voxels[:, :, 0, 2], (GRID[2] - 1) / 2, atol=1e-12)
    seen = into_views(
        given["points"] + given["t"][:, None], given["own"], given["T_world_cam"]
    ).numpy()
    pixels = project(K, seen)
    np.testing.assert_allclose(voxels[..., :2], (pixels + 0.5) / 2 - 0.5, atol=1e-12)
    depth = (seen[..., 2] - seen[:, :, :1, 2]) / 0.5 * GRID[2] + (GRID[2] - 1) / 2
    np.testing.assert_allclose(voxels[..., 2], depth, atol=1e-12)


def test_pictures_are_those_of_the_voxels():
    given = scene()
    shades = torch.rand(2, 9, dtype=torch.float64)
    scales = torch.tensor([0.5, 0.9], dtype=torch.float64)
    found = PROJECTOR(**given, intensities=shades, scale=scales, sigma=0.8)
    voxels = PROJECTOR.to_voxels(**given)
    for b in range(2):
        for j in range(3):
            expected = render(
                voxels[b, j], GRID, intensities=shades[b], scale=float(scales[b]), sigma=0.8
            )
            for one, other in zip(found, expected, strict=True):
                assert other.max() > 0.01
                torch.testing.assert_close(one[b, j], other, rtol=0, atol=1e-12)
    plain = PROJECTOR(**given)
    assert plain.intensity is None
    torch.testing.assert_close(plain.silhouette[0, 1], render(voxels[0, 1], GRID).silhouette)


def test_a_picture_pulls_at_points_places_and_the_rest():
    given = scene()
    shades, scales = torch.rand(2, 9).double(), torch.tensor([0.5, 0.9]).double()
    free = [value.requires_grad_() for value in (given["points"], given["t"], shades, scales)]
    found = PROJECTOR(**given, intensities=shades, scale=scales, sigma=0.8)
    weights = torch.rand_like(found.silhouette)
    for grad in torch.autograd.grad(((found.silhouette + found.intensity) * weights).sum(), free):
        assert grad.isfinite().all() and grad.any(-1).all()


@pytest.mark.parametrize("name", ["points", "t"])
def test_half_precision_around_it_moves_no_point(name):
    """bfloat16 has three digits: of places in a car that is several millimetres."""
    given = {key: value.float() for key, value in scene().items()}
    plain = PROJECTOR.to_voxels(**given)
    with torch.autocast("cpu", torch.bfloat16):
        found = PROJECTOR.to_voxels(**given)
        given[name].requires_grad_()
        total = PROJECTOR.to_voxels(**given).sum()
    total.backward()  # outside, as `fit` has it
    assert torch.equal(found, plain)
    exact = {key: value.detach().clone() for key, value in given.items()}
    exact[name].requires_grad_()
    PROJECTOR.to_voxels(**exact).sum().backward()
    assert torch.equal(given[name].grad, exact[name].grad)
