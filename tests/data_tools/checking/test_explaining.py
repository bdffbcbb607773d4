from dataclasses import replace

import numpy as np
import pytest

from data_tools.checking.corrections import AS_GIVEN
from data_tools.checking.drawing import Placement, Shape, draw
from data_tools.checking.explaining import clearly_better, explain, scores_of
from tests.data_tools.checking.made import sample_of


def of(made, function):
    sample = sample_of(made.items(function))
    return sample, sample.instances, scores_of("masks", sample.instances)


def test_what_fits_needs_no_explanation(sample):
    scores = scores_of("masks", sample.instances)
    assert scores.min() > 0.99
    assert explain("masks", sample, sample.instances, scores) is None


@pytest.mark.slow
def test_the_explanation_has_numbers(made):
    sample, instances, scores = of(made, lambda o: {"R": o.R.T, "t": -o.R.T @ o.t})
    found = explain("masks", sample, instances, scores)
    assert found.correction.key == "inverse poses" and found.others == ()
    assert found.before == np.median(scores) < 0.1 and found.after > 0.97


@pytest.mark.slow
def test_the_least_freedom_is_believed(made):
    """A scale of 1000 is a unit, of 1.3 is not: the first has nothing fitted to it."""
    for factor, cost in ((1 / 1000, 0), (1.3, 1)):
        sample, instances, scores = of(made, lambda o, f=factor: {"t": o.t * f})
        found = explain("masks", sample, instances, scores).correction
        assert found.cost == cost and found.factor == pytest.approx(factor, rel=0.004)


@pytest.mark.slow
def test_what_is_as_likely_is_said(made):
    """Where fx is fy, cx and cy may be swapped alone or with them."""
    square = np.array([[170.0, 0, 83], [0, 170, 57], [0, 0, 1]])
    swapped = np.array([[170.0, 0, 57], [0, 170, 83], [0, 0, 1]])

    def seen(view):
        objects = []
        for item, shape in zip(view.objects, shapes, strict=True):
            mask, _ = draw(shape, Placement(square, item.R, item.t), (160, 120))
            objects.append(replace(item, mask=mask, full_mask=mask))
        return replace(view, K=swapped, objects=objects)

    shapes = [Shape(i, mesh) for i, mesh in made.meshes.items()]
    sample = sample_of(made.each(seen))
    found = explain("masks", sample, sample.instances, scores_of("masks", sample.instances))
    assert found.correction.key == "swapped cx and cy"
    assert [other.key for other in found.others] == ["swapped x and y"]


@pytest.mark.slow
def test_nothing_explains_noise(made, rng):
    def anywhere(item):
        return {"t": item.t + rng.uniform(-0.2, 0.2, 3)}

    sample, instances, scores = of(made, anywhere)
    assert np.median(scores) < 0.5
    assert explain("masks", sample, instances, scores) is None


def test_few_instances_will_do(made):
    sample, instances, _ = of(made, lambda o: {"t": o.t / 1000})
    one = instances[:1]
    found = explain("masks", sample, one, scores_of("masks", one))
    assert found.correction.factor == pytest.approx(1 / 1000)


@pytest.mark.parametrize(
    ("before", "after", "better"),
    [
        ([0.1] * 3, [0.9] * 3, True),
        ([0.1] * 3, [0.4] * 3, False),  # it is better, and still wrong
        ([0.6] * 3, [0.7] * 3, False),  # a fitted size always gains a little
        ([0.5] * 9, [0.65] * 9, True),  # as good as it gets, with masks drawn by hand
        ([0.95] * 9, [0.99] * 9, True),
        ([0.95] * 3, [0.99] * 3, False),  # too few
        ([0.95] * 9, [0.96] * 9, False),
        ([0.95] * 9, [0.99] * 6 + [0.9] * 3, False),
        ([0.2] * 4, [0.9] * 2 + [0.1] * 2, False),
    ],
)
def test_clearly_better(before, after, better):
    assert clearly_better(np.array(before), np.array(after)) is better


def test_scores_are_of_each(sample):
    scores = scores_of("boxes", sample.instances[:3], AS_GIVEN)
    assert scores.shape == (3,) and scores.min() > 0.97
