from functools import cache
from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from data_tools.shapes import GLASSES, PIVOT, make_glasses, make_seat, make_subject
from data_tools.shapes.heads import BEARDS, HAIR

subject = cache(make_subject)
SEEDS = range(12)


def colour(mesh, pattern):
    return next(m for m in mesh.materials if m.pattern == pattern)


def inside(vertices, faces, points):
    """Whether points lie in a closed surface: its solid angle there (Van Oosterom, 1983)."""
    a, b, c = (vertices[faces[:, k]] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    top = (a * np.cross(b, c)).sum(-1)
    low = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    return np.arctan2(top, low).sum(-1) / (2 * np.pi) > 0.5


@pytest.mark.slow
def test_the_frame_is_that_of_the_glasses():
    """y is down and z runs to the back: nose in front of the origin, hair above, chin below."""
    for seed in SEEDS:
        low, high = subject(seed).head.bounds
        assert -0.04 < low[2] or subject(seed).hair == "cap"
        assert 0.19 < high[2] < 0.27
        assert -0.2 < low[1] < -0.1
        assert 0.09 < high[1] < 0.2
        np.testing.assert_allclose(low[0] + high[0], 0, atol=0.012)
        face = subject(seed).head.vertices
        tip = face[np.abs(face[:, 0]) < 0.004]
        tip = tip[(tip[:, 1] > 0.02) & (tip[:, 1] < 0.045)]
        assert tip[:, 2].min() < -0.001  # the nose stands out before the lenses


@pytest.mark.slow
def test_twelve_subjects_differ():
    for one, two in combinations(SEEDS, 2):
        a, b = subject(one), subject(two)
        gap = cKDTree(a.head.vertices).query(b.head.vertices)[0]
        back = cKDTree(b.head.vertices).query(a.head.vertices)[0]
        assert max(np.percentile(gap, 99), np.percentile(back, 99)) > 0.004, (one, two)
        assert not np.array_equal(a.head.vertices[:100], b.head.vertices[:100])


@pytest.mark.slow
def test_hair_and_beards_come_in_turns():
    people = [subject(seed) for seed in range(16)]
    assert {person.hair for person in people} == set(HAIR)
    assert {person.beard for person in people} == set(BEARDS)
    assert len({person.hair for person in people[:8]}) == len(HAIR)
    assert all(p.hair != q.hair for p, q in pairwise(people))


@pytest.mark.slow
def test_infrared_is_plausible():
    """Skin is bright, whatever its colour; hair is darker; the seat is darkest."""
    skins = [colour(subject(seed).head, "face") for seed in SEEDS]
    assert all(0.5 <= skin.infrared <= 0.68 for skin in skins)
    assert np.ptp([skin.infrared for skin in skins]) > 0.08
    assert max(s.colour[0] for s in skins) > 3 * min(s.colour[0] for s in skins)
    for seed in SEEDS:
        for material in subject(seed).head.materials:
            if material.pattern == "strands":
                assert 0.1 < material.infrared < skins[seed].infrared
    assert max(m.infrared for m in make_seat().materials if m.pattern) < 0.2  # posts aside
    for name in GLASSES:
        dark = [m for m in make_glasses(name).materials if m.shininess >= 120]
        assert dark and all(m.infrared < 0.1 for m in dark)  # lenses and cameras


@pytest.mark.slow
@pytest.mark.parametrize("name", GLASSES)
def test_glasses_rest_before_the_face(name):
    """Beside the nose nothing of the frame's front sinks into the skin."""
    worn = make_glasses(name).vertices
    front = worn[(np.abs(worn[:, 0]) > 0.018) & (worn[:, 2] < 0.03)]
    for seed in SEEDS:
        head = subject(seed).head
        skin = head.vertices[np.unique(head.faces[head.material == 0])]
        assert colour(head, "face") == head.materials[0]
        distance, nearest = cKDTree(skin).query(front)
        deeper = front[:, 2] - skin[nearest][:, 2]
        sideways = np.linalg.norm((front - skin[nearest])[:, :2], axis=1)
        assert (deeper[sideways < 0.003] < 0.004).all()
        assert distance.min() < 0.02  # and it is worn: near the face


def test_the_head_stays_on_its_neck():
    """However the head turns, the core of the neck ends inside it; below it meets the clothes."""
    ring = np.array([[np.cos(a), 0, np.sin(a)] for a in np.arange(6)])
    core = PIVOT + np.vstack([0.01 * ring + [0, -0.04, 0], [[0, 0, 0], [0, -0.045, 0]]])
    for seed in (0, 3, 7, 9):
        head, torso = subject(seed).head, subject(seed).torso
        assert colour(head, "face") == head.materials[0]
        faces = head.faces[head.material == 0]
        for turned in ((0, 0, 0), (70, 0, 0), (-70, 15, 10), (20, 25, -20), (0, -25, 20)):
            R = Rotation.from_euler("YXZ", turned, degrees=True).as_matrix()
            assert inside(head.vertices, faces, (core - PIVOT) @ R + PIVOT).all()
        assert inside(torso.vertices, torso.faces[torso.material == 0], core).all()
        neck = torso.vertices[torso.faces[torso.material == 0]].reshape(-1, 3)
        cloth = torso.vertices[torso.faces[torso.material != 0]].reshape(-1, 3)
        assert neck[:, 1].min() < PIVOT[1] - 0.04
        assert neck[:, 1].max() > cloth[:, 1].min() + 0.02


def test_the_seat_is_behind():
    seat = make_seat()
    for seed in SEEDS:
        person = subject(seed)
        assert seat.bounds[0, 2] > 0.15
        assert seat.bounds[0, 2] > np.percentile(person.head.vertices[:, 2], 50)
        assert seat.bounds[1, 2] > person.torso.bounds[1, 2]


@given(st.one_of(st.integers(max_value=-1), st.floats(), st.text(), st.booleans(), st.none()))
def test_bad_seeds(seed):
    with pytest.raises(ValueError, match="^seed:"):
        make_subject(seed)
