import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_tools.batches.compositing import NONE, OUTSIDE, Layers, add_occluder, replace_background


def layers(seed, channels=3, depth=True, objects=2):
    """Noise, with rectangles for objects and a strip that lies outside."""
    rng = np.random.default_rng(seed)
    height, width = 40, 50
    kind = "rgb" if channels == 3 else "ir"
    colours = rng.integers(0, 256, (height, width, channels)).astype(np.uint8)
    metres = rng.integers(8000, 12000, (height, width)).astype(np.uint16)
    metres[rng.random((height, width)) < 0.05] = 0
    instance = np.full((height, width), NONE, np.uint8)
    instance[:, :4] = OUTSIDE
    for slot in range(objects):
        x, y = rng.integers(5, 30), rng.integers(0, 22)
        instance[y : y + rng.integers(5, 18), x : x + rng.integers(5, 18)] = slot
    return Layers({kind: colours}, metres if depth else None, instance)


worlds = st.tuples(st.integers(0, 2**32), st.sampled_from([1, 3]), st.booleans(), st.integers(0, 2))


@given(worlds, st.booleans(), st.booleans())
def test_behind(world, alone, only_outside):
    image, other = layers(*world), None if alone else layers(world[0] + 1, *world[1:])
    before = image.copy()
    replace_background(image, other, only_outside, np.random.default_rng(world[0]))
    free = before.instance == OUTSIDE if only_outside else before.instance >= OUTSIDE
    assert np.array_equal(image.instance, np.where(free, NONE, before.instance))
    for kind, colours in image.colours.items():
        assert np.array_equal(colours[~free], before.colours[kind][~free])
        assert (colours[free] != before.colours[kind][free]).any(-1).mean() > 0.8
    if image.depth is not None:
        assert np.array_equal(image.depth[~free], before.depth[~free])
        known = before.depth[before.instance < OUTSIDE]
        if known.any():
            ratio = np.median(image.depth[free & (image.depth > 0)]) / np.median(known[known > 0])
            assert 0.8 < ratio < 1.9


@given(worlds, st.booleans(), st.booleans(), st.floats(0, 1))
def test_in_front(world, alone, whole, keep):
    image = layers(*world[:3], 2)
    other = None if alone else layers(world[0] + 1, *world[1:3], 2)
    before = image.copy()
    rng = np.random.default_rng(world[0])
    target = int(image.instance[image.instance < OUTSIDE].min(initial=NONE))
    done = add_occluder(image, target, other, 0 if whole and not alone else None, keep, rng)
    changed = image.instance != before.instance
    assert (image.instance[changed] == NONE).all()
    for slot in range(2):
        left, was = ((layer.instance == slot).sum() for layer in (image, before))
        assert left >= keep * was
    if not done:
        assert not changed.any()
        assert all(np.array_equal(image.colours[k], before.colours[k]) for k in image.colours)
        return
    hidden = changed & (before.instance < OUTSIDE)
    if image.depth is not None:
        both = hidden & (before.depth > 0) & (image.depth > 0)
        assert (image.depth[both] <= before.depth[both]).all(), "it is in front"


def test_cut_outs_are_copied():
    image, other = layers(0), layers(1)
    for seed in range(40):
        result = image.copy()
        if not add_occluder(result, 0, other, 0, 0.0, np.random.default_rng(seed)):
            continue
        changed = (result.colours["rgb"] != image.colours["rgb"]).any(-1)
        y, x = np.nonzero(other.instance == 0)
        colours = {tuple(c) for c in other.colours["rgb"][y, x].tolist()}
        if {tuple(c) for c in result.colours["rgb"][changed].tolist()} <= colours:
            return
    pytest.fail("never an object of the other image")


def test_nothing_to_hide():
    image = layers(0, objects=0)
    before = image.copy()
    assert not add_occluder(image, 0, None, None, 0.5, np.random.default_rng(0))
    assert np.array_equal(image.colours["rgb"], before.colours["rgb"])
