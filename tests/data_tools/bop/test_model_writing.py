"""Models on disk in BOP's format, read by the rules of the toolkit's reader."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from data_tools.bop import BopDataset, ModelInfo
from data_tools.bop.model_writing import to_ply, write_models
from data_tools.bop.models import Models
from data_tools.shapes import Mesh
from data_tools.shapes.tabletop import make_object

IDS = (2, 3, 4)  # a can, a vase that is round, an egg box that is the same after half a turn


@pytest.fixture(scope="module")
def meshes():
    return {i: make_object(i) for i in IDS}


@pytest.fixture(scope="module")
def folder(meshes, tmp_path_factory):
    folder = tmp_path_factory.mktemp("written") / "models"
    write_models(folder, meshes, {})
    return folder


def read_as_the_toolkit(path):
    """A PLY file by the rules of the toolkit's reader: value by value, types by their names."""
    data = path.read_bytes() if hasattr(path, "read_bytes") else path
    head, body = data.split(b"end_header\n", 1)
    lines = head.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    sizes = {"float": "<f4", "double": "<f8", "int": "<i4", "uchar": "u1"}
    counts, vertex, face = {}, [], []
    for line in lines[2:]:
        words = line.split()
        if words[0] == "element":
            counts[words[1]] = int(words[2])
        elif words[1] == "list":
            assert words[-1] == "vertex_indices"
            face = [("count", sizes[words[2]]), ("corners", sizes[words[3]], 3)]
        else:
            vertex.append((words[2], sizes[words[1]]))
    vertex, face = np.dtype(vertex), np.dtype(face)
    split = counts["vertex"] * vertex.itemsize
    assert len(body) == split + counts["face"] * face.itemsize
    points, faces = np.frombuffer(body[:split], vertex), np.frombuffer(body[split:], face)
    assert (faces["count"] == 3).all()
    return {name: points[name] for name in vertex.names}, faces["corners"]


def test_models(meshes, folder):
    assert sorted(p.name for p in folder.iterdir()) == [
        "models_info.json", *(f"obj_{i:06d}.ply" for i in IDS)
    ]  # fmt: skip
    infos = json.loads((folder / "models_info.json").read_text())
    assert list(infos) == [str(i) for i in IDS]
    for i, mesh in meshes.items():
        columns, faces = read_as_the_toolkit(folder / f"obj_{i:06d}.ply")
        names = ["x", "y", "z", "nx", "ny", "nz", "red", "green", "blue"]
        assert list(columns) == names
        points = np.stack([columns[c] for c in "xyz"], axis=1)
        np.testing.assert_allclose(points, mesh.vertices * 1000, rtol=1e-6, atol=1e-6)
        assert np.array_equal(faces, mesh.faces)
        normals = np.stack([columns[c] for c in ("nx", "ny", "nz")], axis=1)
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
        # They point outwards: to the side from which the faces are counter-clockwise.
        a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
        outwards = np.cross(b - a, c - a)
        agree = (normals[mesh.faces[:, 0]] * outwards).sum(1) > 0
        assert agree.mean() > 0.9
        assert len(np.unique(columns["red"])) > 1, "it has colours"

        info = infos[str(i)]
        low, extent = points.min(0), np.ptp(points, axis=0)
        for k, axis in enumerate("xyz"):
            np.testing.assert_allclose(info[f"min_{axis}"], low[k], rtol=1e-6)
            np.testing.assert_allclose(info[f"size_{axis}"], extent[k], rtol=1e-6)
        hull = ConvexHull(mesh.vertices).vertices
        np.testing.assert_allclose(
            info["diameter"], pdist(mesh.vertices[hull]).max() * 1000, rtol=1e-6
        )
        keys = {"diameter"} | {f"{part}_{axis}" for part in ("min", "size") for axis in "xyz"}
        extra = {2: set(), 3: {"symmetries_continuous"}, 4: {"symmetries_discrete"}}[i]
        assert info.keys() == keys | extra
    assert infos["3"]["symmetries_continuous"] == [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]
    (half_turn,) = infos["4"]["symmetries_discrete"]
    np.testing.assert_allclose(
        half_turn, [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1], atol=1e-12
    )


def test_colours_are_those_of_the_material(meshes):
    """A linear albedo of 0.5 is 188 in sRGB; black stays black."""
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    material = replace(meshes[2].materials[0], pattern="", colour=(0.5, 0.0, 1.0))
    mesh = Mesh(
        name="box",
        vertices=np.array(box.vertices, np.float64),
        faces=np.array(box.faces, np.int32),
        corner_normals=np.repeat(np.float32(box.face_normals)[:, None], 3, axis=1),
        material=np.zeros(12, np.int16),
        materials=(material,),
        closed=np.ones(12, bool),
    )
    columns, _ = read_as_the_toolkit(to_ply("models[1]", mesh))
    assert {tuple(columns[c][i] for c in ("red", "green", "blue")) for i in range(8)} == {
        (188, 0, 255)
    }
    # The triangles that meet in a vertex weigh as much as they are large.
    expected = np.zeros((8, 3))
    for face, normal, area in zip(box.faces, box.face_normals, box.area_faces, strict=True):
        expected[face] += normal * area
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    normals = np.stack([columns[c] for c in ("nx", "ny", "nz")], axis=1)
    np.testing.assert_allclose(normals, expected, atol=1e-6)


def test_symmetries_with_an_offset(tree, tmp_path):
    """Objects 1 and 2 of the readers' tests: an axis beside the origin, a flip with a shift."""
    models = BopDataset(tree.path, "test").models()
    infos = {i: models.info(i) for i in (1, 2)}
    write_models(tmp_path / "models", {i: models.mesh(i) for i in (1, 2)}, infos)
    again = Models(tmp_path / "models")
    for i in (1, 2):
        np.testing.assert_allclose(
            again.info(i).symmetries(), infos[i].symmetries(), rtol=0, atol=1e-15
        )
        assert len(again.info(i).symmetries()) > 1


def test_a_round_object_with_a_flip(tmp_path, meshes):
    """A cylinder: its turns become an axis, its flips one discrete symmetry."""
    turns = meshes[3].symmetries
    flip = np.diag([1.0, -1, -1, 1])
    mesh = replace(meshes[3], symmetries=np.concatenate([turns, turns @ flip]))
    write_models(tmp_path / "models", {3: mesh}, {})
    info = Models(tmp_path / "models").info(3)
    assert len(info.symmetries_discrete) == len(info.symmetries_continuous) == 1
    assert info.symmetries_discrete[0, 2, 2] == pytest.approx(-1)
    away = np.abs(info.symmetries()[:, None] - mesh.symmetries).max((2, 3)).min(0)
    assert away.max() < np.pi / 315


@settings(max_examples=25)
@given(data=st.data())
def test_any_trimesh_comes_back(tmp_path_factory, data):
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    folder = tmp_path_factory.mktemp("any") / "models"
    meshes = {}
    for i in data.draw(st.sets(st.integers(0, 10**6), min_size=1, max_size=3)):
        points = rng.normal(size=(data.draw(st.integers(4, 9)), 3))
        faces = rng.integers(0, len(points), (data.draw(st.integers(1, 9)), 3))
        meshes[i] = trimesh.Trimesh(
            points,
            faces,
            vertex_colors=rng.integers(0, 256, (len(points), 4), np.uint8),
            vertex_normals=rng.normal(size=(len(points), 3)),
            process=False,
        )
    write_models(folder, meshes, {})
    models = Models(folder)
    assert models.ids == tuple(sorted(meshes))
    for i, mesh in meshes.items():
        read = models.mesh(i)
        np.testing.assert_allclose(read.vertices, mesh.vertices, rtol=2e-7)
        np.testing.assert_allclose(read.vertex_normals, mesh.vertex_normals, rtol=2e-7)
        assert np.array_equal(read.faces, mesh.faces)
        assert np.array_equal(read.visual.vertex_colors[:, :3], mesh.visual.vertex_colors[:, :3])
        np.testing.assert_allclose(models.info(i).diameter, pdist(mesh.vertices).max(), rtol=1e-6)
        np.testing.assert_allclose(models.info(i).size, np.ptp(mesh.vertices, 0), rtol=1e-6)
        assert len(models.info(i).symmetries()) == 1


@pytest.mark.parametrize("image", [None, Image.new("RGB", (2, 2), (40, 50, 60))])
def test_a_trimesh_with_a_texture(image):
    material = trimesh.visual.material.SimpleMaterial(image=image, diffuse=[10, 20, 30, 255])
    box = trimesh.creation.box((1, 1, 1))
    box.visual = trimesh.visual.TextureVisuals(uv=np.full((8, 2), 0.5), material=material)
    columns, _ = read_as_the_toolkit(to_ply("box", box))
    colours = {tuple(columns[c][i] for c in ("red", "green", "blue")) for i in range(8)}
    assert colours == {(10, 20, 30) if image is None else (40, 50, 60)}


def test_vertices_without_a_direction(meshes):
    """Two faces back to back, and a vertex that no face has: some unit vector, not a NaN."""
    mesh = replace(
        meshes[2],
        vertices=np.eye(4, 3),
        faces=np.array([[0, 1, 2], [2, 1, 0]], np.int32),
        corner_normals=np.float32([[[0, 0, 1]] * 3, [[0, 0, -1]] * 3]),
        material=np.zeros(2, np.int16),
        closed=np.zeros(2, bool),
    )
    columns, _ = read_as_the_toolkit(to_ply("mesh", mesh))
    normals = np.stack([columns[c] for c in ("nx", "ny", "nz")], axis=1)
    assert np.array_equal(normals, [[0, 0, 1]] * 4)


BOX = trimesh.creation.box((1, 1, 1))
INFO = ModelInfo(1.0, np.zeros(3), np.ones(3), np.zeros((0, 4, 4)))


@pytest.mark.parametrize(
    ("models", "infos", "name"),
    [
        ({}, {}, "models: expected meshes by object id"),
        ([BOX], {}, "models: expected meshes by object id"),
        (None, {}, "models: expected meshes by object id"),
        ({"1": BOX}, {}, "models: expected an integer"),
        ({-1: BOX}, {}, "models: expected an integer"),
        ({True: BOX}, {}, "models: expected an integer"),
        ({1: "box.ply"}, {}, r"models\[1\]: expected a Mesh or a trimesh"),
        ({1: BOX.vertices}, {}, r"models\[1\]: expected a Mesh or a trimesh"),
        ({1: trimesh.Trimesh()}, {}, r"models\[1\]: expected a mesh with vertices"),
        ({1: BOX}, {2: INFO}, "infos: expected a ModelInfo for ids of models"),
        ({1: BOX}, {1: {"diameter": 3}}, "infos: expected a ModelInfo for ids of models"),
    ],
)
def test_bad_input(tmp_path, models, infos, name):
    with pytest.raises(ValueError, match=name):
        write_models(tmp_path / "models", models, infos)


def test_models_are_not_written_among_other_files(meshes, tmp_path):
    write_models(tmp_path, meshes, {})  # an empty folder is as good as a new one
    before = sorted(tmp_path.iterdir())
    with pytest.raises(ValueError, match="^folder: expected a new or an empty folder, got "):
        write_models(tmp_path, meshes, {})
    assert sorted(tmp_path.iterdir()) == before
