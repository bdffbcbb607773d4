"""The depth of one object beside that of labels, and beside closed forms."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from data_tools.renderer import prepare_surface, render_depth, render_labels

K = np.array([[80.0, 0, 31.3], [0, 82, 22.8], [0, 0, 1]])
SIZE = (64, 48)


@pytest.fixture(scope="module")
def ball():
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.1)
    return prepare_surface(mesh.vertices, mesh.faces)


def whole(window):
    return window.within((0, 0, *SIZE))


def test_it_is_that_of_the_labels(ball):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        pose = (
            Rotation.random(random_state=seed).as_matrix(),
            rng.uniform(-0.15, 0.15, 3)
            + (
                *(0, 0),
                0.5,
            ),
        )
        depth = whole(render_depth(ball, pose, K, SIZE))
        labels = render_labels([ball], [pose], K, SIZE)
        np.testing.assert_array_equal(depth > 0, labels.full_masks[0])
        np.testing.assert_allclose(depth, labels.depth, rtol=1e-6)


def test_it_is_exact():
    """A slanted square: on a plane n . x = c the depth is c / (n . ray)."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    square = prepare_surface(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    R, t = Rotation.from_euler("xyz", [0.3, -0.4, 0.1]).as_matrix(), np.array([0.02, 0.01, 0.7])
    depth = whole(render_depth(square, (R, t), K, SIZE))
    y, x = np.indices(depth.shape)
    rays = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones(x.shape)], -1)
    assert (depth > 0).mean() > 0.9
    expected = (R[:, 2] @ t) / (rays @ R[:, 2])
    np.testing.assert_allclose(depth[depth > 0], expected[depth > 0], rtol=1e-9)
    behind = whole(render_depth(square, (R @ np.diag([1, -1, -1]), t), K, SIZE))
    np.testing.assert_allclose(behind, depth, rtol=1e-9)  # backs of faces are seen


def test_a_matrix_that_is_no_rotation(ball):
    """Published ones stretch by a percent: as if the mesh were stretched."""
    R, t = np.diag([1.01, 0.99, 1.0]), np.array([0.02, 0, 0.5])
    stretched = prepare_surface(ball.mesh.vertices @ R.T, ball.mesh.faces)
    depth = whole(render_depth(ball, (R, t), K, SIZE))
    assert (depth > 0).any()
    np.testing.assert_allclose(depth, whole(render_depth(stretched, (np.eye(3), t), K, SIZE)))


@pytest.mark.parametrize(
    "t", [(0, 0, -0.5), (9, 0, 0.5), (0, 0, 1e9), (1e300, 0, 0.5), (0, 0, -1e300)]
)
def test_what_is_not_in_the_image(ball, t):
    window = render_depth(ball, (np.eye(3), np.array(t, float)), K, SIZE)
    assert window.depth.shape == (0, 0)
    assert not whole(window).any()


def test_inside_and_before_the_near_plane(ball):
    inside = whole(render_depth(ball, (np.eye(3), np.zeros(3)), K, SIZE))
    assert (inside > 0.01).all() and inside.max() < 0.1


def test_what_cannot_be_is_named(ball):
    pose = np.eye(3), np.array([0, 0, 0.5])
    for arguments, name in (
        ((ball.mesh, pose, K, SIZE), "item"),
        ((ball, (np.zeros((3, 3)), pose[1]), K, SIZE), "poses"),
        ((ball, (pose[0], [0, 0, np.nan]), K, SIZE), "poses"),
        ((ball, pose, np.zeros((3, 3)), SIZE), "K"),
        ((ball, pose, K, (0, 3)), "size"),
    ):
        with pytest.raises(ValueError, match=rf"^{name}(\[0\])?.*: expected"):
            render_depth(*arguments)
    with pytest.raises(ValueError, match="^near"):
        render_depth(ball, pose, K, SIZE, near=0)
    vertices, faces = np.eye(3), np.array([[0, 1, 2]])
    for arguments, name in (
        ((vertices[0], faces), "vertices"),
        ((vertices, faces[:0]), "faces"),
        ((vertices, faces + 1), "faces"),
        ((vertices, faces + 0.5), "faces"),
    ):
        with pytest.raises(ValueError, match=f"^{name}: expected"):
            prepare_surface(*arguments)
