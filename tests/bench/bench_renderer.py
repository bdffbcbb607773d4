"""The full set of labels beside Embree and others. Run with `pytest -n 0 tests/bench/bench_*.py`.

One core: set OMP_NUM_THREADS=1. Embree gets a tree for each object, which also gives the full
masks, and casts rays only in the object's box in the image; its hits are made into the same labels.
pyrender and Open3D are measured where they import, for depth and instances only.
"""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from data_tools.renderer import Light, prepare, render_colour, render_infrared, render_labels
from data_tools.shapes import Material, Mesh

SIZES = {"128x128": (128, 128), "320x188": (320, 188), "640x480": (640, 480)}


def to_mesh(shape: trimesh.Trimesh) -> Mesh:
    faces = np.asarray(shape.faces, np.int32)
    return Mesh(
        name="shape",
        vertices=np.asarray(shape.vertices, np.float64),
        faces=faces,
        corner_normals=np.asarray(shape.vertex_normals[faces], np.float32),
        material=np.zeros(len(faces), np.int16),
        materials=(Material(colour=(0.5, 0.4, 0.3), specular=0.3),),
        closed=np.ones(len(faces), bool),
    )


@pytest.fixture(scope="module")
def meshes() -> list[Mesh]:
    """Eight meshes of 5000 to 8000 faces."""
    make = trimesh.creation
    shapes = [
        make.torus(0.06, 0.025, 64, 64),
        make.icosphere(4, 0.08),
        make.capsule(0.12, 0.04, count=[56, 56]),
        make.torus(0.05, 0.03, 56, 56),
        make.icosphere(4, 0.05),
        make.capsule(0.05, 0.05, count=[56, 56]),
        make.torus(0.07, 0.01, 96, 32),
        make.capsule(0.2, 0.03, count=[48, 64]),
    ]
    return [to_mesh(shape) for shape in shapes]


def scene(size: tuple[int, int], count: int) -> tuple[list, np.ndarray]:
    """Poses that fill a third of the image or more, and a camera."""
    rng = np.random.default_rng(1)
    K = np.array([[size[0], 0, size[0] / 2 - 0.5], [0, size[0], size[1] / 2 - 0.5], [0, 0, 1]])
    poses = []
    for k in range(count):
        place = 0.12 * (k % 3 - 1) * (count > 1), 0.1 * (k // 3 - 1) * (count > 3), 0.45
        poses.append((Rotation.random(random_state=rng).as_matrix(), np.array(place)))
    return poses, K


class Embree:
    """The same labels as `render_labels` makes, by ray casting."""

    def __init__(self, meshes: list[Mesh]) -> None:
        scenes = pytest.importorskip("embreex.rtcore_scene", reason="embreex is not installed")
        construction = pytest.importorskip("embreex.mesh_construction")
        self.meshes, self.trees = meshes, []
        for mesh in meshes:
            tree = scenes.EmbreeScene()
            construction.TriangleMesh(tree, mesh.vertices.astype(np.float32)[mesh.faces])
            self.trees.append(tree)

    def labels(self, poses: list, K: np.ndarray, size: tuple[int, int]) -> tuple:
        width, height = size
        depth = np.full((height, width), np.inf, np.float32)
        instance = np.full((height, width), -1, np.int16)
        face = np.full((height, width), -1, np.int32)
        place = np.zeros((height, width, 2), np.float32)
        full = np.zeros((len(poses), height, width), bool)
        columns = (np.arange(width) - K[0, 2]) / K[0, 0]
        rows = (np.arange(height) - K[1, 2]) / K[1, 1]
        for k, (mesh, tree, (R, t)) in enumerate(zip(self.meshes, self.trees, poses, strict=False)):
            pixels = (mesh.vertices @ R.T + t) @ K.T
            pixels = pixels[:, :2] / pixels[:, 2:]
            left, top = np.maximum(np.ceil(pixels.min(0)).astype(int), 0)
            right, low = np.minimum(np.floor(pixels.max(0)).astype(int) + 1, size)
            window = np.s_[top:low, left:right]
            shape = max(low - top, 0), max(right - left, 0)
            rays = np.empty((*shape, 3), np.float32)
            rays[..., 0], rays[..., 1] = columns[left:right], rows[top:low, None]
            rays[..., 2] = 1
            rays = (rays @ R.astype(np.float32)).reshape(-1, 3)
            begin = np.broadcast_to((-t @ R).astype(np.float32), rays.shape)
            hit = tree.run(np.ascontiguousarray(begin), rays, query="INTERSECT", output=1)
            found = (hit["primID"] >= 0).reshape(shape)
            full[k][window] = found
            before = found & (hit["tfar"].reshape(shape) < depth[window])
            depth[window][before] = hit["tfar"].reshape(shape)[before]
            face[window][before] = hit["primID"].reshape(shape)[before]
            place[window][before] = np.stack([hit["u"], hit["v"]], -1).reshape(*shape, 2)[before]
            instance[window][before] = k
        coordinates, normals = np.zeros((2, height, width, 3), np.float32)
        boxes, fractions = [], []
        for k, (mesh, (R, t)) in enumerate(zip(self.meshes, poses, strict=False)):
            y, x = np.nonzero(instance == k)
            fractions.append(len(y) / max(np.count_nonzero(full[k]), 1))
            if not len(y):
                continue
            boxes.append((x.min(), y.min(), x.max(), y.max()))
            points = np.stack([columns[x], rows[y], np.ones(len(x))], 1) * depth[y, x, None]
            coordinates[y, x] = (points - t).astype(np.float32) @ R.astype(np.float32)
            u, v = place[y, x].T[..., None]
            corners = mesh.corner_normals[face[y, x]]
            normal = (1 - u - v) * corners[:, 0] + u * corners[:, 1] + v * corners[:, 2]
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            normals[y, x] = normal @ R.astype(np.float32).T
            y, x = np.nonzero(full[k])
            boxes.append((x.min(), y.min(), x.max(), y.max()))
        return np.where(instance >= 0, depth, 0), instance, coordinates, normals, full, boxes


@pytest.mark.parametrize("count", [1, 3, 8])
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("library", ["data_tools", "embree"])
def test_labels(benchmark, meshes, library, size, count):
    """All labels of one image."""
    benchmark.group = f"labels, {size}, {count} meshes"
    poses, K = scene(SIZES[size], count)
    prepared = [prepare(mesh) for mesh in meshes[:count]]
    ours = render_labels(prepared, poses, K, SIZES[size])
    if library == "embree":
        embree = Embree(meshes)
        depth, instance, coordinates, normals, full, _ = benchmark(
            embree.labels, poses, K, SIZES[size]
        )
        assert np.mean(instance != ours.instance) < 1e-4
        assert np.mean(full != ours.full_masks) < 1e-4
        same = instance == ours.instance
        assert np.percentile(np.abs(depth - ours.depth)[same], 99) < 1e-5
        np.testing.assert_allclose(coordinates[same], ours.coordinates[same], atol=1e-3)
        assert np.mean(np.abs(normals - ours.normals)[same] > 0.01) < 1e-3
    else:
        benchmark(render_labels, prepared, poses, K, SIZES[size])


@pytest.mark.parametrize("count", [3])
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("library", ["data_tools", "pyrender", "open3d"])
def test_depth(benchmark, meshes, library, size, count):
    """Against the other renderers of the field, where they install."""
    benchmark.group = f"depth, {size}, {count} meshes"
    poses, K = scene(SIZES[size], count)
    prepared = [prepare(mesh) for mesh in meshes[:count]]
    ours = render_labels(prepared, poses, K, SIZES[size]).depth
    if library == "data_tools":
        benchmark(render_labels, prepared, poses, K, SIZES[size])
        return
    render = {"pyrender": pyrender_depth, "open3d": open3d_depth}[library]
    depth = benchmark(render(meshes[:count], poses, K, SIZES[size]))
    both = (depth > 0) & (ours > 0)
    assert np.mean((depth > 0) != (ours > 0)) < 0.01
    assert np.percentile(np.abs(depth - ours)[both], 90) < 1e-3


def pyrender_depth(meshes: list[Mesh], poses: list, K: np.ndarray, size: tuple[int, int]):
    """A function that draws the depth by OpenGL."""
    pyrender = pytest.importorskip("pyrender", reason="pyrender is not installed")
    scene = pyrender.Scene()
    for mesh, (R, t) in zip(meshes, poses, strict=True):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = R, t
        shape = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        scene.add(pyrender.Mesh.from_trimesh(shape), pose=pose)
    camera = pyrender.IntrinsicsCamera(K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5)
    scene.add(camera, pose=np.diag([1.0, -1, -1, 1]))
    renderer = pyrender.OffscreenRenderer(*size)
    return lambda: renderer.render(scene, flags=pyrender.RenderFlags.DEPTH_ONLY)


def open3d_depth(meshes: list[Mesh], poses: list, K: np.ndarray, size: tuple[int, int]):
    """A function that casts rays in a scene of all objects."""
    open3d = pytest.importorskip("open3d", reason="open3d is not installed")
    tensor = open3d.core.Tensor
    height, width = size[::-1]
    y, x = np.mgrid[:height, :width]
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(K).T
    rays = tensor(np.concatenate([np.zeros_like(rays), rays], -1).astype(np.float32))

    def render() -> np.ndarray:
        scene = open3d.t.geometry.RaycastingScene(nthreads=1)
        for mesh, (R, t) in zip(meshes, poses, strict=True):
            vertices = (mesh.vertices @ R.T + t).astype(np.float32)
            scene.add_triangles(tensor(vertices), tensor(mesh.faces.astype(np.uint32)))
        depth = scene.cast_rays(rays, nthreads=1)["t_hit"].numpy()
        return np.where(np.isfinite(depth), depth, 0)

    return render


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("kind", ["colour", "infrared"])
def test_pictures(benchmark, meshes, kind, size):
    """Three meshes, two lamps with soft shadows, smooth edges."""
    benchmark.group = f"pictures, {size}"
    poses, K = scene(SIZES[size], 3)
    prepared = [prepare(mesh) for mesh in meshes[:3]]
    lights = [Light((0.4, -0.6, 0)), Light((-0.5, -0.3, 0.2), 0.4)]
    render = {"colour": render_colour, "infrared": render_infrared}[kind]
    picture = benchmark(render, prepared, poses, K, SIZES[size], lights)
    assert np.isfinite(picture).all() and picture.max() > 0.1
