from dataclasses import replace

import numpy as np
import pytest

from data_tools.checking.corrections import AS_GIVEN
from data_tools.checking.drawing import Placement, draw
from data_tools.checking.shifts import MeanShift, mean_shift, swap_share
from tests.data_tools.checking.made import sample_of


def shifted(instances, x, y):
    """Masks of cameras whose centre is moved, hidden behind others where these are."""
    for instance in instances:
        K = instance.K + [[0, 0, x], [0, 0, y], [0, 0, 0]]
        place = Placement(K, instance.item.R, instance.item.t)
        mask = draw(instance.shape, place, instance.size)[0]
        if instance.others is not None:
            mask &= ~instance.others
        yield replace(instance, mask=mask)


@pytest.mark.parametrize("shift", [(0, 0), (0.5, 0.5), (-0.5, 0.25), (1.5, -2)])
def test_a_shift_is_measured_to_a_fraction_of_a_pixel(sample, shift):
    found = mean_shift(list(shifted(sample.instances, *shift)), AS_GIVEN.place)
    np.testing.assert_allclose(found.shift, shift, atol=0.06)
    assert found.error.max() < 0.05 and found.count >= 14
    assert (np.abs(found.shift - shift) < 5 * found.error + 0.02).all()


def test_borders_behind_others_do_not_move(sample):
    """They do not take the shift for smaller than it is."""
    hidden = np.zeros((120, 160), bool)
    instances = []
    for instance in sample.instances:
        others = hidden.copy()
        x = np.nonzero(instance.mask)[1]
        others[:, int(np.quantile(x, 0.7)) :] = True
        instances.append(replace(instance, others=others))
    found = mean_shift(list(shifted(instances, 0.5, -0.5)), AS_GIVEN.place)
    np.testing.assert_allclose(found.shift, [0.5, -0.5], atol=0.1)


def test_outliers_do_not_count(sample):
    instances = list(shifted(sample.instances, 0.5, 0.5))
    instances[0] = replace(instances[0], mask=np.roll(instances[0].mask, 9, 1))
    found = mean_shift(instances, AS_GIVEN.place)
    assert instances[0].number not in found.numbers
    np.testing.assert_allclose(found.shift, [0.5, 0.5], atol=0.06)


def test_too_few(sample):
    assert mean_shift(sample.instances[:2], AS_GIVEN.place) is None
    assert mean_shift(sample.instances, lambda _: None) is None
    bare = [replace(i, mask=None) for i in sample.instances]
    assert mean_shift(bare, AS_GIVEN.place) is None


def test_swap_share_is_least_squares(rng):
    expected = rng.normal(0, 1, (30, 2))
    each = 0.8 * expected + [0.3, -0.1] + rng.normal(0, 0.05, (30, 2))
    shifts = MeanShift(each.mean(0), each.std(0), 30, each, np.arange(30))
    share, error = swap_share(shifts, dict(enumerate(expected)))
    columns = np.zeros((60, 3))
    columns[:, 0] = expected.ravel()
    columns[0::2, 1] = columns[1::2, 2] = 1
    solution, residual, *_ = np.linalg.lstsq(columns, each.ravel(), rcond=None)
    assert share == pytest.approx(solution[0])
    covariance = residual[0] / 57 * np.linalg.inv(columns.T @ columns)
    assert error == pytest.approx(np.sqrt(covariance[0, 0]))
    assert swap_share(shifts, {i: np.ones(2) for i in range(30)}) == (0, np.inf)


def test_what_is_measured_of_whole_datasets(made):
    """That it is said is tested in test_diagnosis; here, that a moved camera moves the mean."""
    moved = made.each(lambda view: replace(view, K=view.K + [[0, 0, 0.5], [0, 0, 0], [0, 0, 0]]))
    found = mean_shift(sample_of(moved).instances, AS_GIVEN.place)
    np.testing.assert_allclose(found.shift, [-0.5, 0], atol=0.06)
