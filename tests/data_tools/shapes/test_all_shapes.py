"""What must hold for every mesh of every world."""

import sys
from collections import Counter
from functools import cache

import numpy as np
import pytest
import trimesh

from data_tools.shapes import (
    CATEGORIES,
    GLASSES,
    NAMES,
    make_category,
    make_glasses,
    make_object,
    make_seat,
    make_subject,
)
from data_tools.textures import PATTERNS, albedo, infrared

# How many faces a mesh may have, so that the renderer stays fast.
BUDGET = {"head": (7_000, 13_000), "torso": (3_000, 4_500), "": (2_000, 9_000)}
SUBJECTS = range(16)  # every style of hair and beard
INSTANCES = range(3)

MAKERS = {
    **{f"object {k}": (make_object, k) for k in range(1, len(NAMES) + 1)},
    **{f"{c} {k}": (make_category, c, k) for c in CATEGORIES for k in INSTANCES},
    **{f"{name} glasses": (make_glasses, name) for name in GLASSES},
    **{f"head {k}": (lambda k: subject(k).head, k) for k in SUBJECTS},
    **{f"torso {k}": (lambda k: subject(k).torso, k) for k in SUBJECTS},
    "seat": (make_seat,),
}
subject = cache(make_subject)


def make(name):
    function, *arguments = MAKERS[name]
    return function(*arguments)


mesh_of = cache(make)
every_mesh = pytest.mark.parametrize("name", MAKERS)


@every_mesh
def test_parts_are_watertight_and_wound_outward(name):
    mesh = mesh_of(name)
    assert mesh.closed.all()
    body = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert body.is_watertight
    assert body.is_winding_consistent
    # Some parts may go through others, but each has its own volume.
    parts = trimesh.graph.connected_components(body.face_adjacency, min_len=1)
    assert sum(len(part) for part in parts) == len(mesh.faces)
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    volume = (np.cross(a, b) * c).sum(1) / 6
    assert min(volume[part].sum() for part in parts) > 1e-9


@every_mesh
def test_faces_are_sound_and_few(name):
    mesh = mesh_of(name)
    low, high = BUDGET.get(name.split()[0], BUDGET[""])
    assert low <= len(mesh.faces) <= high
    assert len(np.unique(mesh.faces)) == len(mesh.vertices)
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    assert area.min() > 1e-10  # square metres: a tenth of a millimetre by two micrometres


@every_mesh
def test_normals_are_unit_and_agree_with_the_winding(name):
    mesh = mesh_of(name)
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(np.linalg.norm(mesh.corner_normals, axis=-1), 1, atol=1e-6)
    agreement = (mesh.corner_normals * normal[:, None]).sum(-1)
    assert agreement.min() > np.cos(0.7)  # creases are at 0.7 rad


@every_mesh
def test_materials_can_be_shaded(name):
    mesh = mesh_of(name)
    assert set(np.unique(mesh.material)) == set(range(len(mesh.materials)))
    assert {material.pattern for material in mesh.materials} <= set(PATTERNS)
    points = mesh.vertices[mesh.faces].mean(1)
    arguments = mesh.materials, mesh.material, points, mesh.corner_normals[:, 0]
    colour, bright = albedo(*arguments), infrared(*arguments)
    assert 0 <= colour.min() and colour.max() <= 1
    assert 0 <= bright.min() and bright.max() <= 1
    assert colour.std(0).max() > 0.005


@pytest.mark.parametrize("name", [*list(MAKERS)[:14:2], "classic glasses", "head 3", "seat"])
def test_the_same_seed_makes_the_same_bytes(name):
    function, *arguments = MAKERS[name]
    again = make_subject(3).head if name == "head 3" else function(*arguments)
    mesh = mesh_of(name)
    for field in ("vertices", "faces", "corner_normals", "material", "closed", "symmetries"):
        assert getattr(mesh, field).tobytes() == getattr(again, field).tobytes()
    assert mesh.materials == again.materials


@pytest.mark.parametrize("name", [n for n in MAKERS if n[-1] in "3s" or n.startswith("object")])
def test_a_mesh_is_made_without_a_loop_over_its_corners(name):
    """A call for each of its ten thousand corners would make the calls many times as many."""
    mesh_of(name)  # what is kept for all is made by now
    calls = Counter()
    sys.setprofile(lambda frame, event, of: calls.update([event]))
    try:
        make_subject(int(name.split()[1])) if name.startswith(("head", "torso")) else make(name)
    finally:
        sys.setprofile(None)
    assert 0 < calls["call"] + calls["c_call"] < 40_000  # a head takes 27 000
