from dataclasses import replace

import numpy as np
import pytest

from data_tools.checking.colours import edge_fit
from tests.data_tools.checking.made import Made, sample_of


def fit_of(dataset, outlined=lambda instance: instance.mask):
    sample = sample_of(dataset)
    return edge_fit(sample, sample.instances, outlined)


def with_pictures(made, function):
    return made.each(lambda view: replace(view, rgb=function(view.rgb)))


def test_edges_lie_on_the_outlines(made):
    fit = fit_of(made)
    assert fit.views == 8 and fit.strength > 2 and not fit.off and fit.neighbour is None
    assert max(map(abs, fit.shift)) <= 1


@pytest.mark.parametrize("shift", [(5, 3), (-4, 0), (0, 7)])
def test_shifted_pictures(made, shift):
    fit = fit_of(with_pictures(made, lambda rgb: np.roll(rgb, shift[::-1], (0, 1))))
    assert fit.off and np.abs(np.subtract(fit.shift, shift)).max() <= 1
    assert fit.shifted > fit.strength + 1


@pytest.mark.parametrize("step", [1, -1])
def test_pictures_of_other_images(made, step):
    pictures = [view.rgb for view in made.views]
    views = [replace(v, rgb=pictures[(i + step) % 8]) for i, v in enumerate(made.views)]
    assert fit_of(Made(views)).neighbour == -step


def test_grey_pictures_will_do(made):
    grey = made.each(lambda v: replace(v, rgb=None, ir=v.rgb[..., 0].astype(np.uint16) * 100))
    assert fit_of(grey).strength == pytest.approx(fit_of(made).strength, abs=0.2)


def test_pictures_of_nothing(made, rng):
    assert fit_of(with_pictures(made, np.zeros_like)) is None
    noise = with_pictures(made, lambda rgb: rng.integers(0, 255, rgb.shape).astype(np.uint8))
    fit = fit_of(noise)
    assert not fit.off and fit.neighbour is None and fit.shifted < 2.5


def test_too_few_images(made):
    assert fit_of(Made(made.views[:4])) is None
    assert fit_of(made, lambda _: None) is None
    assert fit_of(made.each(lambda view: replace(view, rgb=None))) is None
