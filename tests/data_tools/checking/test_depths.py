from dataclasses import replace

import numpy as np
import pytest

from data_tools.checking.corrections import AS_GIVEN
from data_tools.checking.depths import (
    corrected,
    depth_mistake,
    depth_state,
    unit_correction,
    whose_factor,
)
from data_tools.checking.fits import rescaled
from tests.data_tools.checking.made import HEIGHT, WIDTH, K, Made, sample_of


def found(made):
    sample = sample_of(made)
    state = depth_state(sample.instances, AS_GIVEN.place)
    return state, depth_mistake(sample, sample.instances, AS_GIVEN.place, state)


def with_depth(made, function):
    return made.each(lambda view: replace(view, depth=function(view.depth).astype(np.float32)))


def test_depth_that_agrees(made):
    state, mistake = found(made)
    assert state.agrees and state.count == 16 and state.share == 1
    assert state.ratio == pytest.approx(1) and abs(state.offset) < 1e-6
    assert mistake is None and unit_correction(state) is None


def test_sensors_are_a_little_off(made, rng):
    def noisy(depth):
        return depth * rng.normal(1.006, 0.005, depth.shape)

    state, mistake = found(with_depth(made, noisy))
    assert state.agrees and mistake is None


@pytest.mark.parametrize("factor", [1e-3, 0.1, 1.25, 10, 5000])
def test_another_unit(made, factor):
    state, mistake = found(with_depth(made, lambda depth: depth * factor))
    assert not state.agrees and state.ratio == pytest.approx(factor, rel=1e-3)
    assert mistake.key == "depth unit" and mistake.factor == pytest.approx(factor, rel=0.01)
    assert mistake.before == 0 and mistake.after == 1
    correction = unit_correction(state)
    assert correction.depth == mistake.factor and correction.key == "depth unit"


def test_lengths_of_rays(made):
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(K).T
    lengths = np.linalg.norm(rays, axis=-1)
    state, mistake = found(with_depth(made, lambda depth: depth * lengths))
    assert state.of_rays and not state.agrees
    assert state.slope == pytest.approx(1, abs=0.1)
    assert mistake.key == "lengths of rays" and mistake.after == 1


@pytest.mark.parametrize(("step", "name"), [(1, "previous"), (-1, "next")])
def test_depth_of_another_image(made, step, name):
    depths = [view.depth for view in made.views]
    views = [
        replace(view, depth=depths[(i + step) % len(depths)]) for i, view in enumerate(made.views)
    ]
    state, mistake = found(Made(views))
    assert mistake.key == "depth shifted by one image" and name in mistake.remedy
    assert mistake.before == state.share < 0.5


def test_nonsense_is_not_explained(made, rng):
    state, mistake = found(with_depth(made, lambda d: rng.uniform(0.1, 5, d.shape)))
    assert not state.agrees and mistake is None


def test_nothing_to_compare(sample):
    assert depth_state([], AS_GIVEN.place) is None
    bare = [replace(i, depth=None) for i in sample.instances]
    assert depth_state(bare, AS_GIVEN.place) is None
    assert whose_factor(bare, AS_GIVEN.place, 2) is None


@pytest.mark.parametrize("factor", [1e-3, 0.9, 1.1, 1000])
def test_whose_factor(made, factor):
    """Where translations are too large, or models too small."""
    far = sample_of(made.items(lambda o: {"t": o.t * factor})).instances
    assert whose_factor(far, rescaled(AS_GIVEN, factor).place, factor) == "translations"
    meshes = {i: mesh.copy().apply_scale(1 / factor) for i, mesh in made.meshes.items()}
    small = sample_of(Made(made.views, meshes)).instances
    assert whose_factor(small, rescaled(AS_GIVEN, factor).place, factor) == "models"
    odd = [replace(i, depth=i.depth / np.sqrt(factor)) for i in small]  # as far from both
    assert whose_factor(odd, rescaled(AS_GIVEN, factor).place, factor) is None


def test_corrected_instances(sample):
    instance = sample.instances[0]
    assert corrected(instance, AS_GIVEN) is instance
    other = corrected(instance, replace(AS_GIVEN, depth=10))
    np.testing.assert_allclose(other.depth, instance.depth / 10)
    assert corrected(instance, replace(AS_GIVEN, targets=lambda _: [])).visible is None
