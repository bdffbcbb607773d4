import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from data_tools.bop.ply import MeshWarning, read_ply

BOX = trimesh.creation.box((100, 60, 40))
HEAD = """ply
format ascii 1.0
comment made by hand, with ünicode
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
"""
VERTICES = "0 0 0\n100 0 0\n100 50.5 0\n0 50.5 -1e1\n"
FACES = "3 0 1 2\n3 0 2 3\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("ply")


def write(folder, content):
    path = folder / "mesh.ply"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def binary(order: str) -> bytes:
    """The same mesh as HEAD + VERTICES + FACES."""
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    head = HEAD.replace("ascii", name).encode()
    points = np.array([row.split() for row in VERTICES.splitlines()], f"{order}f4")
    face = np.dtype([("n", "u1"), ("i", f"{order}i4", 3)])
    faces = np.array([(3, [0, 1, 2]), (3, [0, 2, 3])], face)
    return head + points.tobytes() + faces.tobytes()


@pytest.mark.parametrize(
    "content",
    [
        HEAD + VERTICES + FACES,
        (HEAD + VERTICES + FACES).replace("\n", "\r\n"),
        (HEAD + VERTICES + FACES).replace("\n", "\r"),  # of old Macs
        "\N{BOM}" + HEAD + VERTICES + FACES,
        b"\xef\xbb\xbf" + binary("<"),
        HEAD + VERTICES + FACES + "\n\n",
        binary("<"),
        binary(">"),
    ],
)
def test_one_mesh_in_every_encoding(folder, content):
    mesh = read_ply(write(folder, content))
    expected = [[0, 0, 0], [0.1, 0, 0], [0.1, 0.0505, 0], [0, 0.0505, -0.01]]
    np.testing.assert_array_equal(mesh.vertices, expected)
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [0, 2, 3]])


@given(seed=st.integers(0, 2**32), encoding=st.sampled_from(["ascii", "binary"]))
def test_vertices_faces_normals_and_colours_are_kept(folder, seed, encoding):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 12))
    vertices = rng.normal(size=(n, 3)).astype(np.float32) * 100
    vertices[-1] = vertices[0]  # a duplicate must stay one
    faces = rng.integers(0, n, (5, 3))
    normals = rng.normal(size=(n, 3)).astype(np.float32)
    colours = rng.integers(0, 256, (n, 4), np.uint8)
    source = trimesh.Trimesh(
        vertices, faces, vertex_normals=normals, vertex_colors=colours, process=False
    )
    content = source.export(file_type="ply", encoding=encoding, vertex_normal=True)
    mesh = read_ply(write(folder, content))
    tolerance = 6e-12 if encoding == "ascii" else 0  # the export writes 8 decimals of millimetres
    np.testing.assert_allclose(mesh.vertices, vertices.astype(float) / 1000, rtol=0, atol=tolerance)
    np.testing.assert_array_equal(mesh.faces, faces)
    np.testing.assert_allclose(mesh.vertex_normals, normals, atol=1e-8)
    np.testing.assert_array_equal(mesh.visual.vertex_colors, colours)


@pytest.mark.parametrize("face_texture", [True, False])
def test_textures_do_not_split_vertices(folder, face_texture):
    """trimesh by itself gives back 6 vertices here."""
    if face_texture:
        head = HEAD.replace("end_header", "property list uchar float texcoord\nend_header")
        faces = "3 0 1 2 6 0 0 1 0 1 1\n3 0 2 3 6 .5 .5 .2 .2 .1 .1\n"
        vertices = VERTICES
    else:
        uv = "property float texture_u\nproperty float texture_v\nelement face"
        head = HEAD.replace("element face", uv).replace("made", "TextureFile nowhere.png made")
        vertices = VERTICES.replace("\n", " 0.5 0.5\n")
        faces = FACES
    mesh = read_ply(write(folder, head + vertices + faces))
    assert mesh.vertices.shape == (4, 3)
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [0, 2, 3]])


def test_quads_and_points_alone(folder):
    quad = HEAD.replace("face 2", "face 1") + VERTICES + "4 0 1 2 3\n"
    assert len(read_ply(write(folder, quad)).faces) == 2
    points = HEAD.replace("face 2", "face 0") + VERTICES
    mesh = read_ply(write(folder, points))
    assert mesh.vertices.shape == (4, 3)
    assert mesh.faces.shape == (0, 3)


@pytest.mark.parametrize("content", [(HEAD + VERTICES + FACES).encode(), binary("<"), binary(">")])
def test_a_mesh_is_refused_at_every_length(folder, content):
    # Without the end of its last line text is whole: see test_no_line_end_after_the_last_row.
    for length in range(len(content) - (b"ascii" in content)):
        with pytest.raises(ValueError, match=r"mesh\.ply: "):
            read_ply(write(folder, content[:length]))


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_an_exported_mesh_is_refused_at_any_length(folder, encoding):
    mesh = BOX.copy()
    mesh.visual.vertex_colors = np.tile(np.uint8([1, 2, 3, 4]), (8, 1))
    content = mesh.export(file_type="ply", encoding=encoding, vertex_normal=True)
    for length in range(0, len(content), 3):
        with pytest.raises(ValueError, match=r"mesh\.ply: "):
            read_ply(write(folder, content[:length]))


@pytest.mark.parametrize("end", ["", "\r", " "])
def test_no_line_end_after_the_last_row(folder, end):
    """Some programs write none; a last number that was cut would look the same, so it is said."""
    content = (HEAD + VERTICES + FACES).rstrip("\n")
    with pytest.warns(MeshWarning, match=r"mesh\.ply: no line end after the last row"):
        mesh = read_ply(write(folder, content + end))
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [0, 2, 3]])
    with pytest.warns(MeshWarning):
        points = read_ply(write(folder, HEAD.replace("face 2", "face 0") + VERTICES.rstrip()))
    assert points.vertices.shape == (4, 3)
    # Where the other lines end in a blank, the last one lacks more than its end.
    blanks = (HEAD + VERTICES + FACES).replace("\n3 ", " \n3 ").rstrip()
    with pytest.raises(ValueError, match="no line end after the last row, it may be cut"):
        read_ply(write(folder, blanks))


@pytest.mark.parametrize("order", ["ascii", "<", ">"])
@pytest.mark.parametrize("more", [False, True])
def test_triangles_beside_quads_and_pentagons(folder, order, more):
    """In text as in binary files, also with other lists, colours and elements beside them."""
    corners = [(0, 1, 2), (0, 1, 2, 3), (3, 2, 0), (4, 3, 2, 1, 0)]
    head = HEAD.replace("vertex 4", "vertex 5").replace("face 2", "face 4")
    points = [*(row.split() for row in VERTICES.splitlines()), ["1", "2", "3"]]
    if more:
        beside = "property uchar red\nproperty list uchar float uv\n"
        beside += "element edge 1\nproperty int a\nproperty uchar b\n"
        head = head.replace("end_header", beside + "end_header")
    if order == "ascii":
        rows = [" ".join(point) for point in points]
        rows += [
            " ".join(map(str, [len(face), *face, *([7, 2, 0.5, 0.5] if more else [])]))
            for face in corners
        ]
        content = (head + "\n".join(rows + ["1 2"] * more) + "\n").encode()
    else:
        name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
        content = head.replace("ascii", name).encode() + np.array(points, f"{order}f4").tobytes()
        for face in corners:
            content += bytes([len(face)]) + np.array(face, f"{order}i4").tobytes()
            content += (b"\7\2" + np.array([0.5, 0.5], f"{order}f4").tobytes()) * more
        content += (np.array([1], f"{order}i4").tobytes() + b"\2") * more
    mesh = read_ply(write(folder, content))
    np.testing.assert_array_equal(mesh.vertices, np.array(points, np.float32).astype(float) / 1000)
    expected = [(0, 1, 2), (3, 2, 0), (0, 1, 2), (2, 3, 0), (4, 3, 2), (4, 2, 1), (4, 1, 0)]
    assert sorted(map(tuple, mesh.faces.tolist())) == sorted(expected)
    if order != "ascii":
        for length in range(len(content)):
            with pytest.raises(ValueError, match=r"mesh\.ply: "):
                read_ply(write(folder, content[:length]))
        with pytest.raises(ValueError, match=r"mesh\.ply: damaged PLY"):
            read_ply(write(folder, content + b"\0"))


def test_faces_whose_lengths_add_up_to_those_of_quads(folder):
    """trimesh by itself takes 4, 3 and 5 corners for three times 4, and reads nonsense."""
    head = HEAD.replace("ascii", "binary_little_endian").replace("face 2", "face 3")
    content = head.replace("vertex 4", "vertex 5").encode() + np.zeros((5, 3), "<f4").tobytes()
    for face in ((0, 1, 2, 3), (0, 1, 2), (0, 1, 2, 3, 4)):
        content += bytes([len(face)]) + np.array(face, "<i4").tobytes()
    assert len(read_ply(write(folder, content)).faces) == 2 + 1 + 3


@pytest.mark.parametrize("content", [(HEAD + VERTICES + FACES).encode(), binary("<")])
def test_a_comment_in_any_encoding(folder, content):
    for text in ("ünicode".encode("latin-1"), b"\xff\xfe\0", "Käse".encode("cp437")):
        mesh = read_ply(write(folder, content.replace("ünicode".encode(), text)))
        assert len(mesh.faces) == 2 and mesh.vertices[1, 0] == 0.1


DOUBLE = HEAD.replace("float", "double")
BAD = [
    ("", "empty file"),
    (HEAD.replace("vertex 4", "vertex ²") + VERTICES + FACES, "damaged PLY header"),
    (HEAD.replace("vertex 4", "vertex " + "9" * 5000) + VERTICES + FACES, "damaged PLY header"),
    (HEAD + VERTICES + FACES.replace("3 0 2 3", "9" * 5000 + " 0 2 3"), "face 1 is b'999"),
    (HEAD + VERTICES.replace("-1e1", "1e300") + FACES, "vertex 3 is not finite"),
    (DOUBLE + VERTICES.replace("-1e1", "1e300") + FACES, "vertex 3 is beyond reason"),
    (binary("<").replace(b"vertex 4", b"vertex 9999999999999"), "damaged PLY"),
    (binary("<").replace(b"face 2", b"face 9999999999999"), "damaged PLY"),
    ("solid stl\n", "no PLY file"),
    (HEAD, "4|6"),
    (HEAD.replace("vertex 4", "vertex 5") + VERTICES + FACES, "7 rows announced, got 6"),
    (HEAD.replace("face 2", "face 3") + VERTICES + FACES, "7 rows announced, got 6"),
    (HEAD.replace("face 2", "face 1") + VERTICES + FACES, "5 rows announced"),
    (HEAD + VERTICES + FACES + "3 0 1 2\n", "6 rows announced, got 7"),
    (HEAD.replace("vertex 4", "vertex x") + VERTICES + FACES, "damaged PLY header"),
    (HEAD.replace("vertex 4", "vertex -4") + VERTICES + FACES, "damaged PLY header"),
    (HEAD.replace("ascii", "text") + VERTICES + FACES, "unknown format 'text'"),
    (HEAD.replace("format ascii 1.0\n", "") + VERTICES + FACES, "unknown format"),
    (HEAD.replace("property float x", "propertx float x") + VERTICES + FACES, "header: 'propertx"),
    (HEAD.replace("float x", "float w") + VERTICES + FACES, "damaged PLY: KeyError"),
    (HEAD.replace("float x", "foo x") + VERTICES + FACES, "damaged PLY: KeyError"),
    (HEAD.replace("vertex 4", "vertex 0") + FACES, "without vertices"),
    (HEAD.replace("element vertex 4", "element point 4") + VERTICES + FACES, "without vertices"),
    (HEAD + VERTICES.replace("-1e1", "nan") + FACES, r"vertex 3 is not finite: \[0.0, 50.5, nan"),
    (HEAD + VERTICES.replace("-1e1", "inf") + FACES, "vertex 3 is not finite"),
    (HEAD + VERTICES.replace("-1e1", "") + FACES, r"vertex 3 is b'0 50.5 "),
    (HEAD + VERTICES.replace("-1e1", "1 2") + FACES, "vertex 3 is b'0 50.5 1 2'"),
    (HEAD + VERTICES.replace("-1e1", "abc") + FACES, "damaged PLY"),
    (HEAD + VERTICES + FACES.replace("3 0 2 3", "3 0 2"), "face 1 is b'3 0 2'"),
    (HEAD + VERTICES + FACES.replace("3 0 2 3", "x 0 2 3"), "face 1 is b'x 0 2 3'"),
    (HEAD + VERTICES + FACES.replace("3 0 2 3", "3 0 2 4"), "vertex that does not exist"),
    (HEAD + VERTICES + FACES.replace("3 0 2 3", "3 0 2 -1"), "vertex that does not exist"),
    (HEAD + VERTICES + FACES[:-2], "no line end after the last row"),
    (HEAD + VERTICES + FACES[:-10], "6 rows announced, got "),
    (binary("<") + b"\0", "damaged PLY"),
    (binary("<").replace(b"vertex 4", b"vertex 5"), "damaged PLY"),
    (binary("<").replace(b"face 2", b"face 3"), "damaged PLY"),
]


@pytest.mark.parametrize(("content", "message"), BAD)
def test_damaged_meshes_are_refused(folder, content, message):
    with pytest.raises(ValueError, match=rf"mesh\.ply: .*{message}"):
        read_ply(write(folder, content))


def test_missing_file(folder):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        read_ply(folder / "nowhere.ply")


def test_the_real_can(real_data):
    mesh = read_ply(real_data / "lmo" / "models" / "obj_000005.ply")
    assert mesh.vertices.shape == (22831, 3)
    assert mesh.faces.shape == (45666, 3)
    first = np.float32([-6.631, -40.9674, -76.6654])  # the file says that its numbers are float32
    np.testing.assert_array_equal(mesh.vertices[0], first.astype(np.float64) / 1000)
    np.testing.assert_array_equal(mesh.visual.vertex_colors[0], [197, 187, 184, 255])
    np.testing.assert_allclose(mesh.vertex_normals[0], [-0.119051, -0.991294, -0.0562379], 1e-6)


@pytest.mark.parametrize("keep", [0.00005, 0.0002, 0.3, 0.6, 0.999, 0.999999])
def test_the_real_can_cut_off(real_data, folder, keep):
    content = (real_data / "lmo" / "models" / "obj_000005.ply").read_bytes()
    with pytest.raises(ValueError, match=r"mesh\.ply: "):
        read_ply(write(folder, content[: int(len(content) * keep)]))
