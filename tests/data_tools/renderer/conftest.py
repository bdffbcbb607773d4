"""Meshes and random scenes for the tests of the renderer."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from data_tools.renderer import prepare
from data_tools.shapes import Material, Mesh


def to_mesh(shape, *, smooth=True, closed=True, material=None):
    """A Mesh of a trimesh shape."""
    faces = np.asarray(shape.faces, np.int32)
    flat = np.repeat(np.asarray(shape.face_normals)[:, None], 3, axis=1)
    normals = np.asarray(shape.vertex_normals)[faces] if smooth else flat
    return Mesh(
        name="shape",
        vertices=np.asarray(shape.vertices, np.float64),
        faces=faces,
        corner_normals=np.ascontiguousarray(normals, np.float32),
        material=np.zeros(len(faces), np.int16),
        materials=(material or Material(colour=(0.5, 0.5, 0.5)),),
        closed=np.full(len(faces), closed),
    )


def triangles(*corners, closed=False):
    """A Mesh of single triangles with flat normals."""
    vertices = np.array(corners, np.float64).reshape(-1, 3)
    faces = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
    a, b, c = vertices[faces].swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return Mesh(
        name="triangles",
        vertices=vertices,
        faces=faces,
        corner_normals=np.repeat(normals[:, None], 3, axis=1).astype(np.float32),
        material=np.zeros(len(faces), np.int16),
        materials=(Material(colour=(0.5, 0.5, 0.5)),),
        closed=np.full(len(faces), closed),
    )


@pytest.fixture(scope="session")
def make():
    """`make(shape)`: the prepared mesh of a trimesh shape."""
    return lambda shape, **options: prepare(to_mesh(shape, **options))


@pytest.fixture(scope="session")
def make_triangles():
    """`make_triangles(((x, y, z), ...))`: the prepared mesh of single triangles."""
    return lambda *corners, **options: prepare(triangles(*corners, **options))


@pytest.fixture(scope="session")
def shapes(make):
    """Six prepared objects of about 10 cm: round, with a hole, with edges, open, needle-like."""
    creation = trimesh.creation
    half = creation.icosphere(2, 0.06)
    half.update_faces(half.triangles_center[:, 2] > 0)
    return (
        make(creation.icosphere(2, 0.05)),
        make(creation.torus(0.05, 0.02, 20, 16)),
        make(creation.box((0.08, 0.06, 0.1)), smooth=False),
        make(creation.capsule(0.1, 0.03, count=[12, 12])),
        make(half, closed=False),
        make(creation.cone(0.04, 0.12, sections=64), smooth=False),
    )


@pytest.fixture(scope="session")
def make_scene(shapes):
    """`make_scene(seed)`: objects, poses and camera; some before, on and behind the near plane."""

    def scene(seed, size=(120, 90), count=4):
        rng = np.random.default_rng(seed)
        width, height = size
        focal = width * rng.uniform(0.6, 1.5)
        skew = rng.choice([0.0, 3.0])
        K = np.array(
            [
                [focal, skew, width / 2 + rng.uniform(-9, 9)],
                [0, focal * rng.uniform(0.8, 1.2), height / 2 + rng.uniform(-9, 9)],
                [0, 0, 1],
            ]
        )
        objects = [shapes[k] for k in rng.integers(len(shapes), size=count)]
        poses = []
        for _ in objects:
            z = rng.choice([rng.uniform(0.15, 0.6), rng.uniform(-0.03, 0.1)], p=[0.7, 0.3])
            reach = 0.6 * max(z, 0.05) * width / focal
            t = np.array([*rng.uniform(-reach, reach, 2), z])
            poses.append((Rotation.random(random_state=rng).as_matrix(), t))
        return objects, poses, K, size

    return scene


@pytest.fixture(scope="session")
def cast_rays():
    """`cast_rays(item, R, t, K, x, y, near)`: the first hit of each pixel's ray, slow and sure."""

    def cast(item, R, t, K, x, y, near=0.01):
        """(P,) depth, infinite for none, and (P,) the face in `mesh.faces` (Möller, Trumbore 1997).

        All in float64; every face is tried from both sides.
        """
        mesh = item.mesh
        corners = mesh.vertices[mesh.faces] @ R.T + t
        a, side, other = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        rays = np.stack([x, y, np.ones(len(x))], 1) @ np.linalg.inv(K).T  # depth 1
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1 / (rays @ np.cross(other, side).T)
            u = scale * (rays @ np.cross(a, other).T)
            v = scale * (rays @ np.cross(side, a).T)
            z = scale * (np.cross(side, a) * other).sum(-1)
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (z >= near)
        depth = np.where(hit, z, np.inf)
        return depth.min(1, initial=np.inf), depth.argmin(1) if depth.size else np.zeros(
            len(x), int
        )

    return cast
