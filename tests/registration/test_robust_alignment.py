"""A similarity among wrong pairs: found again, as umeyama without them; what agrees with none."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posecore.registration import ransac_umeyama, umeyama

SEEDS = st.integers(0, 2**32 - 1)


def pairs(seed, count=40, wrong=15, noise=1e-3, scale=0.3):
    rng = np.random.default_rng(seed)
    source = rng.normal(size=(count, 3))
    R, t = Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3)
    target = scale * source @ R.T + t + noise * rng.uniform(-1, 1, (count, 3))
    target[:wrong] += rng.choice([-1, 1], (wrong, 3)) * rng.uniform(0.3, 1, (wrong, 3))
    return source, target, (R, t, scale)


@given(seed=SEEDS, with_scale=st.booleans())
def test_wrong_pairs_do_not_count(seed, with_scale):
    source, target, true = pairs(seed, scale=0.3 if with_scale else 1.0)
    found = ransac_umeyama(source, target, 0.02, with_scale=with_scale)
    assert found.inliers.tolist() == [False] * 15 + [True] * 25
    expected = umeyama(source[15:], target[15:], with_scale=with_scale)
    for one, other in zip(found[:3], expected, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)
    np.testing.assert_allclose(found.R, true[0], atol=0.01)
    all_of_them = umeyama(source, target, with_scale=with_scale)
    assert np.abs(all_of_them.R - true[0]).max() > np.abs(found.R - true[0]).max()


def test_the_same_input_gives_the_same_alone_and_among_others():
    many = [pairs(seed)[:2] for seed in range(3)]
    together = ransac_umeyama(*map(np.stack, zip(*many, strict=True)), 0.02, with_scale=True)
    for i, (source, target) in enumerate(many):
        alone = ransac_umeyama(source, target, 0.02, with_scale=True)
        for one, other in zip(alone, together, strict=True):
            np.testing.assert_allclose(one, other[i], atol=1e-12)


def test_weights_say_who_is_drawn_and_counts():
    """Two motions of as many pairs: the heavier ones win."""
    one, other = pairs(1, 20, 0), pairs(2, 20, 0)
    source, target = (np.concatenate([a, b]) for a, b in zip(one[:2], other[:2], strict=True))
    for heavy, light, wanted in ((1.0, 0.5, one), (0.5, 1.0, other)):
        weights = np.repeat([heavy, light], 20)
        found = ransac_umeyama(source, target, 0.02, weights, with_scale=True)
        np.testing.assert_allclose(found.R, wanted[2][0], atol=0.01)
    sure = np.repeat([0.0, 1.0], 20)
    found = ransac_umeyama(source, target, 0.02, sure, with_scale=True, hypotheses=1)
    np.testing.assert_allclose(found.R, other[2][0], atol=0.01)


def test_copies_in_a_sample_are_only_a_bad_guess():
    source, target, true = pairs(3, 30, 0, noise=0)
    source[5:], target[5:] = source[4], target[4]
    found = ransac_umeyama(source, target, 1e-3, with_scale=True, hypotheses=300, sample=3)
    np.testing.assert_allclose(found.R, true[0], atol=1e-6)


def test_what_cannot_be(rng):
    source, target = rng.normal(size=(2, 20, 3))
    with pytest.raises(ValueError, match="^source and target: expected 3 pairs or more within"):
        ransac_umeyama(source, target, 1e-6, sample=5)
    with pytest.raises(ValueError, match="^source and target: expected"):
        ransac_umeyama(np.zeros((20, 3)), target, 0.1, with_scale=True)  # all in one place
    with pytest.raises(ValueError, match="^weights: expected none negative"):
        ransac_umeyama(source, target, 0.1, -np.ones(20))
    with pytest.raises(ValueError, match="^source: expected at least 3"):
        ransac_umeyama(source[:2], target[:2], 0.1)
    for name, value in (
        ("threshold", 0), ("hypotheses", 0), ("sample", 2), ("refits", 0), ("seed", -1),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=f"^{name}: expected"):
            ransac_umeyama(source, target, **{"threshold": 0.1, name: value})
    assert not ransac_umeyama(*map(torch.from_numpy, pairs(1)[:2]), 0.02, with_scale=True)[
        0
    ].requires_grad
