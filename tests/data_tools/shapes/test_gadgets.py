import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from data_tools.shapes.gadgets import camera, laptop

seeds = st.integers(0, 2**32 - 1)


def facing(part):
    """The direction that the largest face of a part looks in, among its two broad sides."""
    a, b, c = np.moveaxis(part.vertices[part.faces], 1, 0)
    normal = np.cross(b - a, c - a)
    return normal[np.linalg.norm(normal, axis=1).argmax()]


@settings(deadline=None, max_examples=25)
@given(seeds)
def test_laptops_open_by_80_to_135_degrees(seed):
    base, deck, pad, lid, *_, sheet, _ = laptop(np.random.default_rng(seed))
    across = np.abs(facing(sheet) / np.linalg.norm(facing(sheet)))
    tilt = np.degrees(np.arccos(across[1]))  # of the screen from upright
    assert across[0] < 1e-9
    rear, top = lid.vertices[lid.vertices[:, 2].argmax()], base.vertices[:, 1].max()
    opening = 90 + np.sign(rear[1] - top) * tilt
    assert 79.9 < opening < 135.1
    # Keys and pad lie on the base, keys nearer to the hinge.
    assert deck.vertices[:, 2].max() > base.vertices[:, 2].max()
    assert deck.vertices[:, 1].mean() > pad.vertices[:, 1].mean()
    assert (np.abs(deck.vertices[:, :2]) <= base.vertices.max(0)[:2]).all()


@settings(deadline=None, max_examples=25)
@given(seeds)
def test_keyboards_and_screens_show_all_of_their_picture(seed):
    _, deck, _, _, _, sheet, _ = laptop(np.random.default_rng(seed))
    for part in (deck, sheet):
        place = np.reshape(part.materials[0].place, (3, 4))
        seen = part.vertices @ place[:2, :3].T + place[:2, 3]
        np.testing.assert_allclose([seen.min(0), seen.max(0)], [[0, 0], [1, 1]], atol=1e-6)


@settings(deadline=None, max_examples=25)
@given(seeds)
def test_the_lens_is_the_front_of_a_camera(seed):
    parts = camera(np.random.default_rng(seed))
    body, lens = parts[0], parts[3]
    assert lens.vertices[:, 1].min() < body.vertices[:, 1].min() - 0.015
    assert np.abs(lens.vertices[:, 1].max() - body.vertices[:, 1].min()) < 0.0011  # attached
    everything = np.vstack([part.vertices for part in parts])
    assert everything[:, 1].min() == lens.vertices[:, 1].min() or len(parts) > 8
    assert lens.vertices[:, 0].min() > body.vertices[:, 0].min()


def test_three_kinds_of_cameras():
    assert len({len(camera(np.random.default_rng(k))) for k in range(20)}) >= 2
