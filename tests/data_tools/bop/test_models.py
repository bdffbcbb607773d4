import math
import tempfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from data_tools.bop import ModelInfo, ModelInfoWarning, Models
from data_tools.bop.models import _diameter

NONE = np.zeros((0, 4, 4))


def info(discrete=NONE, continuous=(), diameter=0.2):
    return ModelInfo(diameter, [-0.1, -0.1, -0.1], [0.2, 0.2, 0.2], discrete, continuous)


def move(T, points):
    return points @ T[:3, :3].T + T[:3, 3]


VECTOR = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array)


@given(
    axis=VECTOR.filter(lambda v: np.linalg.norm(v) > 1e-3),
    offset=VECTOR,
    step=st.sampled_from([0.01, 0.05, 0.3, 1.0]),
)
def test_continuous_symmetry(axis, offset, step):
    symmetries = info(continuous=[(axis, offset)]).symmetries(step)
    count = math.ceil(math.pi / step)
    assert symmetries.shape == (count, 4, 4)
    np.testing.assert_array_equal(symmetries[0], np.eye(4))
    # An independent formula for a turn about an axis through a point.
    for i in range(0, count, max(1, count // 7)):
        expected = trimesh.transformations.rotation_matrix(2 * math.pi * i / count, axis, offset)
        np.testing.assert_allclose(symmetries[i], expected, atol=1e-13)
    # The farthest point that a circle of the diameter 0.2 can have moves by no more than the step.
    direction = axis / np.linalg.norm(axis)
    radius = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    point = offset + 0.1 * radius / np.linalg.norm(radius)
    travelled = np.linalg.norm(
        move(symmetries[1 % count], point) - move(symmetries[0], point), axis=-1
    )
    assert travelled <= step * 0.2 * (1 + 1e-12)
    # The last step closes the circle.
    last = np.linalg.norm(move(symmetries[-1], point) - point)
    np.testing.assert_allclose(last, travelled, atol=1e-12)


def test_the_number_of_steps_is_that_of_the_benchmark():
    assert len(info(continuous=[([0, 0, 1], [0, 0, 0])]).symmetries()) == 315
    assert len(info().symmetries()) == 1
    assert info().symmetries().shape == (1, 4, 4)


def test_discrete_times_continuous():
    """A cylinder about x = 10 mm, y = 20 mm, that may also stand on its head."""
    flip = np.diag([1.0, -1, -1, 1])
    flip[1, 3] = 0.04
    model = info(flip[None], [([0, 0, -3], [0.01, 0.02, 0.5])])
    symmetries = model.symmetries(0.2)
    turns = math.ceil(math.pi / 0.2)
    assert len(symmetries) == 2 * turns
    expected = [
        trimesh.transformations.rotation_matrix(2 * np.pi * i / turns, [0, 0, -1], [0.01, 0.02, 0])
        @ D
        for D in (np.eye(4), flip)
        for i in range(turns)
    ]
    np.testing.assert_allclose(symmetries, expected, atol=1e-14)
    # They are a group: with any two of them their product is there too.
    for product in (symmetries[3] @ symmetries[turns + 5], symmetries[turns] @ symmetries[turns]):
        assert np.abs(symmetries - product).max((1, 2)).min() < 1e-13


def test_several_axes_give_each_its_steps():
    model = info(continuous=[([1, 0, 0], [0, 0, 0]), ([0, 1, 0], [0, 0, 0])])
    assert len(model.symmetries(0.5)) == 1 + 2 * 6  # the identity once


@given(
    kind=st.sampled_from(["cloud", "plane", "line", "copies", "one", "two"]),
    seed=st.integers(0, 2**32),
)
def test_diameter_is_exact(kind, seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(5, 40))
    points = {
        "cloud": rng.normal(size=(n, 3)),
        "plane": rng.normal(size=(n, 3)) * [1, 1, 0],
        "line": rng.normal(size=(n, 1)) * rng.normal(size=3),
        "copies": np.repeat(rng.normal(size=(1, 3)), n, 0),
        "one": rng.normal(size=(1, 3)),
        "two": rng.normal(size=(2, 3)),
    }[kind]
    assert _diameter(points) == pytest.approx(max(pdist(points), default=0), rel=1e-15, abs=0)


def test_large_flat_model_is_compared_in_pieces():
    points = np.random.default_rng(0).normal(size=(1300, 3)) * [1, 1, 0]
    assert _diameter(points) == pdist(points).max()


def test_models_of_the_toy(tree):
    models = Models(tree.path / "models")
    assert models.ids == (1, 2, 3)
    assert repr(models).endswith("objects [1, 2, 3])")
    for i in models.ids:
        mesh = models.mesh(i)
        np.testing.assert_allclose(mesh.vertices, tree.vertices[i] / 1000, atol=1e-15)
        np.testing.assert_array_equal(mesh.faces, tree.faces)
        assert models.mesh(i) is mesh

    one = models.info(1)
    assert one.diameter == 0.1235
    np.testing.assert_array_equal(one.minimum, [-0.05, -0.03, -0.015])
    np.testing.assert_array_equal(one.size, [0.1, 0.06, 0.04])
    ((axis, offset),) = one.symmetries_continuous
    np.testing.assert_array_equal(axis, [0, 0, 1])
    np.testing.assert_array_equal(offset, [0.01, 0.02, 0])
    point = np.array([[0.01, 0.02, 0.7]])
    for T in one.symmetries()[::50]:
        np.testing.assert_allclose(move(T, point), point, atol=1e-15)

    expected = [[-1, 0, 0, 0.004], [0, -1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    np.testing.assert_array_equal(models.info(2).symmetries(), [np.eye(4), expected])


def test_what_models_info_does_not_list_is_computed(tree):
    models = Models(tree.path / "models")
    expected = (
        r"models: no entry for object 3 in models_info\.json: its diameter is measured, "
        "no symmetries are known"
    )
    with pytest.warns(ModelInfoWarning, match=expected):
        three = models.info(3)
    assert models.info(3) is three  # and nothing more is said
    assert models.info(1).diameter == 0.1235
    assert three.diameter == pytest.approx(math.sqrt(100**2 + 60**2 + 40**2) / 1000, rel=1e-15)
    np.testing.assert_allclose(three.minimum, [-0.05, -0.03, -0.005], atol=1e-17)
    np.testing.assert_allclose(three.size, [0.1, 0.06, 0.04], atol=1e-16)
    np.testing.assert_array_equal(three.symmetries(), [np.eye(4)])
    tree.remove("models/models_info.json")
    without = Models(tree.path / "models")
    assert without.ids == (1, 2, 3)
    with pytest.warns(ModelInfoWarning, match="no entry for object 1"):
        one = without.info(1)
    assert one.diameter == pytest.approx(three.diameter, rel=1e-15)


def change(tree, **entries):
    tree.json["models/models_info"]["1"].update(entries)


def drop(tree, key):
    del tree.json["models/models_info"]["1"][key]


DAMAGE = [
    (lambda tree: drop(tree, "diameter"), r"models_info\.json: object 1: diameter is missing"),
    (lambda tree: drop(tree, "size_y"), "object 1: size_y is missing"),
    (lambda tree: change(tree, diameter="1"), "object 1: diameter: expected a finite number"),
    (lambda tree: change(tree, diameter=-1), "object 1: diameter: .* above 0"),
    (lambda tree: change(tree, diameter=0), "object 1: diameter: .* above 0"),
    (lambda tree: change(tree, size_x=-5), "object 1: size: expected lengths of at least 0"),
    (lambda tree: change(tree, symmetries_discrete=5), "object 1: expected lists of symmetries"),
    (lambda tree: change(tree, symmetries_discrete=[[1] * 15]), "discrete 0: expected 16"),
    (lambda tree: change(tree, symmetries_discrete=[[1] * 16]), "discrete 0: expected a rotation"),
    (
        lambda tree: change(tree, symmetries_discrete=[[*np.diag([1, 1, 1, 2]).ravel().tolist()]]),
        "symmetries_discrete: expected last rows 0 0 0 1",
    ),
    (
        lambda tree: change(tree, symmetries_continuous=[{"axis": [0, 0, 0], "offset": [0, 0, 0]}]),
        "object 1: symmetries_continuous: expected an axis",
    ),
    (
        lambda tree: change(tree, symmetries_continuous=[{"axis": [0, 0, 1]}]),
        "object 1: offset is missing",
    ),
    (
        lambda tree: change(tree, symmetries_continuous=[{"axis": [1], "offset": [0, 0, 0]}]),
        "axis: expected 3 finite numbers",
    ),
    (
        lambda tree: tree.json["models/models_info"].update(can={}),
        r"models_info\.json: expected ids as keys, got 'can'",
    ),
    (lambda tree: tree.json["models/models_info"].update({"1": []}), "object 1: expected a JSON"),
]


@pytest.mark.parametrize(("damage", "message"), DAMAGE)
def test_damaged_models_info_is_refused(tree, damage, message):
    damage(tree)
    tree.save()
    with pytest.raises(ValueError, match=message):
        Models(tree.path / "models")


@pytest.mark.slow
def test_symmetries_without_end(tree):
    """30 000 of them, or as many in all: refused at once, with the file's name."""
    flip = np.eye(4).ravel().tolist()
    turn = {"axis": [0, 0, 1], "offset": [0, 0, 0]}
    for entries in (
        {"symmetries_discrete": [flip] * 30_000},
        {"symmetries_continuous": [turn] * 30_000},
        {"symmetries_discrete": [flip] * 99, "symmetries_continuous": [turn]},
        {"symmetries_continuous": [turn] * 99},
    ):
        change(tree, **{"symmetries_discrete": [], "symmetries_continuous": []} | entries)
        tree.save()
        with pytest.raises(ValueError, match=r"models_info\.json: object 1: .*at most 10000"):
            Models(tree.path / "models")
    with pytest.raises(ValueError, match="symmetries: expected at most 10000 motions, got more"):
        info(continuous=[([0, 0, 1], [0, 0, 0])]).symmetries(1e-4)
    with pytest.raises(ValueError, match="symmetries: expected at most 10000, got 10001"):
        info(np.tile(np.eye(4), (10_001, 1, 1)))
    assert len(info(np.tile(np.eye(4), (9_999, 1, 1))).symmetries()) == 10_000


@pytest.mark.parametrize("key", ["diameter", "size_y", "min_z"])
def test_lengths_beyond_reason(tree, key):
    change(tree, **{key: 1e300})
    tree.save()
    with pytest.raises(ValueError, match=r"models_info\.json: object 1: .* below 1e\+12 m"):
        Models(tree.path / "models")


@pytest.mark.parametrize("keep", [0, 0.1, 0.5, 0.99])
def test_cut_files_are_refused(tree, keep):
    tree.cut("models/obj_000002.ply", keep)
    with pytest.raises(ValueError, match=r"obj_000002\.ply: "):
        Models(tree.path / "models").mesh(2)
    tree.cut("models/models_info.json", keep)
    with pytest.raises(ValueError, match=r"models_info\.json: "):
        Models(tree.path / "models")


@pytest.mark.parametrize(
    ("call", "argument"),
    [
        (lambda p: Models(p / "nowhere"), "path: expected a folder of models"),
        (lambda p: Models(p / "test"), "path: expected a folder with obj_"),
        (lambda p: Models(p / "models").mesh(4), "object_id: expected one of 1, 2, 3, got 4"),
        (lambda p: Models(p / "models").info("1"), "object_id: expected one of 1, 2, 3, got '1'"),
        (lambda p: info().symmetries(0), "max_step"),
        (lambda p: info().symmetries(float("nan")), "max_step"),
        (lambda p: info().symmetries(1.5), "max_step"),
        (lambda p: info(diameter=float("inf")), "diameter"),
        (lambda p: info(np.eye(4)), "symmetries_discrete"),
        (lambda p: info(np.full((1, 4, 4), np.nan)), "symmetries_discrete"),
        (lambda p: info(continuous=[([0, 0, 0], [0, 0, 0])]), "symmetries_continuous"),
        (lambda p: info(continuous=[([0, 0, np.inf], [0, 0, 0])]), "symmetries_continuous"),
        (lambda p: info(continuous=[([0, 0, 1], [0, 0])]), "symmetries_continuous"),
        (lambda p: ModelInfo(1, [0, 0], [1, 1, 1], NONE), "minimum"),
        (lambda p: ModelInfo(1, [0, 0, 0], [1, 1, np.nan], NONE), "size"),
    ],
)
def test_bad_input_is_refused(tree, call, argument):
    with pytest.raises(ValueError, match=argument):
        call(tree.path)


def test_a_lost_mesh_is_named(tree):
    tree.remove("models/obj_000001.ply")
    models = Models(tree.path / "models")
    assert models.info(1).diameter == 0.1235
    with pytest.raises(FileNotFoundError, match=r"obj_000001\.ply"):
        models.mesh(1)


def test_models_of_other_formats(tree):
    """OBJ and STL are read where there is no PLY file of an object, in millimetres as well."""
    vertices = Models(tree.path / "models").mesh(1).vertices * 1000
    mesh = trimesh.Trimesh(vertices, tree.faces, process=False)
    tree.remove("models/obj_000001.ply")
    tree.write("models/obj_000001.obj", mesh.export(file_type="obj").encode())
    tree.write("models/obj_000002.obj", b"not looked at, as there is a PLY file")
    tree.remove("models/obj_000003.ply")
    tree.write("models/obj_000003.STL", mesh.export(file_type="stl"))
    models = Models(tree.path / "models")
    assert models.ids == (1, 2, 3)
    np.testing.assert_allclose(models.mesh(1).vertices, vertices / 1000, atol=1e-10)
    np.testing.assert_array_equal(models.mesh(2).vertices, tree.vertices[2] / 1000)
    np.testing.assert_allclose(models.mesh(3).bounds, mesh.bounds / 1000, atol=1e-9)
    np.testing.assert_allclose(models.measured(3).size, [0.1, 0.06, 0.04], atol=1e-8)


@pytest.mark.parametrize("name", ["obj_².ply", "obj_٣.ply", "obj_" + "9" * 30 + ".ply"])
def test_files_whose_names_are_no_numbers(tree, name):
    tree.write(f"models/{name}", b"not looked at")
    assert Models(tree.path / "models").ids == (1, 2, 3)


def test_two_files_of_one_object(tree):
    tree.write("models/obj_2.ply", b"which one?")
    with pytest.raises(ValueError, match=r"models: two files of object 2, obj_000002.ply and obj_"):
        Models(tree.path / "models")


def test_the_real_can(real_data):
    models = Models(real_data / "lmo" / "models")
    assert models.ids == (5,)
    can = models.info(5)
    assert can.diameter == pytest.approx(0.201403586, abs=1e-12)
    # models_info.json has nine digits, and was computed from the same vertices.
    assert _diameter(models.mesh(5).vertices) == pytest.approx(0.201403586, abs=1e-9)
    np.testing.assert_allclose(models.mesh(5).bounds[0], can.minimum, atol=1e-8)
    np.testing.assert_allclose(np.ptp(models.mesh(5).vertices, 0), can.size, atol=1e-8)
    np.testing.assert_array_equal(can.symmetries(), [np.eye(4)])


def test_symmetries_with_noise_are_projected(tree):
    flip = np.diag([1.0, -1, -1, 1])
    flip[:3, :3] = Rotation.from_rotvec([np.pi, 0, 0]).as_matrix().round(4)
    change(tree, symmetries_discrete=[flip.ravel().tolist()])
    tree.save()
    symmetry = Models(tree.path / "models").info(1).symmetries_discrete[0]
    np.testing.assert_allclose(symmetry @ symmetry, np.eye(4), atol=1e-14)


@given(st.integers(0, 2**32 - 1), st.integers(4, 12))
def test_a_model_is_read_as_it_was_written(seed, n):
    """Millimetres on disk, metres here; what no models_info says is measured."""
    rng = np.random.default_rng(seed)
    vertices = rng.normal(0, 50, (n, 3)).round(3)
    faces = [rng.choice(n, 3, replace=False) for _ in range(3)]
    rows = [" ".join(map(str, v)) for v in vertices.tolist()] + [
        f"3 {a} {b} {c}" for a, b, c in faces
    ]
    head = [
        "ply", "format ascii 1.0", f"element vertex {n}",
        *(f"property double {axis}" for axis in "xyz"),
        "element face 3", "property list uchar int vertex_indices", "end_header",
    ]  # fmt: skip
    with tempfile.TemporaryDirectory() as name:
        Path(name, "obj_000007.ply").write_text("\n".join(head + rows) + "\n")
        models = Models(name)
        mesh, found = models.mesh(7), models.measured(7)
    assert models.ids == (7,)
    np.testing.assert_allclose(mesh.vertices, vertices / 1000, rtol=1e-12)
    np.testing.assert_array_equal(mesh.faces, faces)
    np.testing.assert_allclose(found.size, np.ptp(vertices, axis=0) / 1000, rtol=1e-12)
    gaps = np.linalg.norm(vertices[:, None] - vertices, axis=-1)
    assert found.diameter == pytest.approx(gaps.max() / 1000)
