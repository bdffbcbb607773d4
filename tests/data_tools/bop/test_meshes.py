import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from data_tools.bop.meshes import MESH_SUFFIXES, read_mesh

BOX = trimesh.creation.box((100, 60, 40))
OBJ = """# made by hand, with ünicode
mtllib nowhere.mtl
o one
v 0 0 0
v 100 0 0 0.5 0.5 0.5
v 100 50.5 0
v 0 50.5 -1e1
v 7 7 7
vt 0 0
vt 1 0
vn 0 0 1
usemtl wood
f 1/1/1 2/2/1 3/1/1
g other
f -5//1 3//1 4//1
f 1/1 2/2 \\
3/1 4/2
"""
FACES = [[0, 1, 2], [0, 2, 3], [0, 1, 2], [0, 2, 3]]


def write(folder, name, content):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


CHANGES = {
    "as it is": str,
    "lines of Windows": lambda text: text.replace("\n", "\r\n"),
    "lines of old Macs": lambda text: text.replace("\n", "\r"),
    "no last line end": str.rstrip,
    "a mark that says UTF-8": lambda text: "\ufeff" + text.partition("\n")[2],
    "a mark before a vertex": lambda text: "\ufeff" + text[text.index("v 0 0 0") :],
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_vertices_of_obj_stay_as_they_are(tmp_path, change):
    """trimesh by itself gives two meshes here, and more vertices than the file has."""
    mesh = read_mesh(write(tmp_path, "mesh.obj", change(OBJ)))
    expected = np.array([[0, 0, 0], [100, 0, 0], [100, 50.5, 0], [0, 50.5, -10], [7, 7, 7]])
    np.testing.assert_array_equal(mesh.vertices, expected / 1000)
    np.testing.assert_array_equal(mesh.faces, FACES)
    latin = write(tmp_path, "MESH.OBJ", change(OBJ).encode("latin-1", "ignore"))
    np.testing.assert_array_equal(read_mesh(latin).faces, FACES)


@given(seed=st.integers(0, 2**32))
def test_obj_as_trimesh_writes_it(tmp_path_factory, seed):
    rng = np.random.default_rng(seed)
    vertices, faces = rng.normal(size=(9, 3)) * 100, rng.integers(0, 9, (5, 3))
    source = trimesh.Trimesh(vertices, faces, process=False)
    path = write(tmp_path_factory.mktemp("obj"), "m.obj", source.export(file_type="obj"))
    mesh = read_mesh(path)
    np.testing.assert_allclose(mesh.vertices, vertices / 1000, atol=1e-10)
    np.testing.assert_array_equal(mesh.faces, faces)


@pytest.mark.parametrize("kind", ["stl", "stl_ascii"])
def test_corners_of_stl_become_vertices(tmp_path, kind):
    mesh = read_mesh(write(tmp_path, "mesh.stl", BOX.export(file_type=kind)))
    assert mesh.vertices.shape == (8, 3) and mesh.faces.shape == (12, 3)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(0.1 * 0.06 * 0.04, rel=1e-6)
    np.testing.assert_allclose(mesh.bounds, BOX.bounds / 1000, atol=1e-9)


def test_a_binary_stl_whose_title_says_solid(tmp_path):
    content = b"solid cube".ljust(80) + BOX.export(file_type="stl")[80:]
    assert len(read_mesh(write(tmp_path, "mesh.stl", content)).faces) == 12


def test_a_text_stl_in_capitals(tmp_path):
    content = BOX.export(file_type="stl_ascii").upper()
    assert len(read_mesh(write(tmp_path, "mesh.stl", content)).vertices) == 8


@pytest.mark.parametrize("names", [(" one", " two"), ("", "")])
def test_a_text_stl_of_two_solids(tmp_path, names):
    """What programs for construction write of an assembly."""
    text = BOX.export(file_type="stl_ascii").replace("solid ", "solid").strip()
    solids = [text.replace("\n", f"{name}\n", 1) + name for name in names]
    solids[1] = solids[1].replace("50.0", "70.0")
    mesh = read_mesh(write(tmp_path, "mesh.stl", "\n".join(solids)))
    assert (len(mesh.vertices), len(mesh.faces)) == (16, 24)
    with pytest.raises(ValueError, match="damaged STL"):
        read_mesh(write(tmp_path, "mesh.stl", "\n".join(solids)[: -len("endsolid two")]))


@pytest.mark.parametrize("kind", ["stl", "stl_ascii"])
def test_stl_is_refused_at_any_length(tmp_path, kind):
    content = BOX.export(file_type=kind)
    content = content if isinstance(content, bytes) else content.encode()
    end = len(content.rstrip())
    for length in (*range(0, end - 9, 7), *range(end - 9, end if kind == "stl" else end - 1)):
        with pytest.raises(ValueError, match=r"mesh\.stl: "):
            read_mesh(write(tmp_path, "mesh.stl", content[:length]))


BAD = [
    ("a.obj", "", "empty file"),
    ("a.obj", "hello\n", "without vertices"),
    ("a.obj", OBJ.replace("v 7 7 7", "v 7 7"), r"damaged OBJ: line 8: 'v 7 7'"),
    ("a.obj", OBJ.replace("v 7 7 7", "v 7 x 7"), "damaged OBJ: line 8"),
    ("a.obj", OBJ.replace("v 7 7 7", "v 7 1_0 7"), "damaged OBJ: line 8"),
    ("a.obj", OBJ.replace("v 7 7 7", "v 7 ٣ 7"), "damaged OBJ: line 8"),
    ("a.obj", OBJ.replace("v 7 7 7", "v 7 nan 7"), "vertex 4 is not finite, or beyond reason"),
    ("a.obj", OBJ.replace("v 7 7 7", "v 7 1e999 7"), "vertex 4 is not finite"),
    ("a.obj", OBJ.replace("v 7 7 7", "v 7 1e200 7"), "vertex 4 is not finite, or beyond"),
    ("a.obj", OBJ.replace("f -5//1", "f -6//1"), "damaged OBJ: line 15"),
    ("a.obj", OBJ.replace("f -5//1", "f 0"), "damaged OBJ: line 15"),
    ("a.obj", OBJ.replace("f -5//1 3//1 4//1", "f 1 2"), "damaged OBJ: line 15"),
    ("a.obj", OBJ.replace("f -5//1", "f " + "9" * 5000), "damaged OBJ: line 15"),
    ("a.obj", OBJ.replace("f -5//1", "f 6//1"), "face 1 has a vertex that does not exist"),
    ("a.stl", "hello", "damaged STL"),
    ("a.stl", bytes(84) + b"x", "damaged STL: 85 bytes, expected 84"),
    ("a.stl", bytes(84), "without vertices"),
    ("a.stl", b" " * 90, "damaged STL"),
    ("a.stl", BOX.export(file_type="stl_ascii").replace("50.0", "nan"), "damaged STL|not finite"),
    ("a.stl", BOX.export(file_type="stl_ascii").replace("endfacet", "", 1), "damaged STL"),
]


@pytest.mark.parametrize(("name", "content", "message"), BAD)
def test_damaged_meshes_are_refused(tmp_path, name, content, message):
    with pytest.raises(ValueError, match=rf"{name}: .*{message}|{name}: {message}"):
        read_mesh(write(tmp_path, name, content))


def test_missing_files(tmp_path):
    for suffix in MESH_SUFFIXES:
        with pytest.raises(FileNotFoundError, match="nowhere"):
            read_mesh(tmp_path / f"nowhere{suffix}")
