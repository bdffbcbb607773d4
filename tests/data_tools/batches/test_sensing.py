from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from data_tools.batches import Augmentation
from data_tools.batches.sensing import degrade_depth, simulate_sensor, tone_table

OFF = Augmentation.none()


def draws(seed=0, **strengths):
    return Augmentation(**{**vars(OFF), **strengths}).draw(1, seed)


def seen(image, choices):
    out = np.empty(image.shape, np.float32)
    simulate_sensor(image, choices, 0, out)
    return out


def picture(channels=3, seed=0, size=(40, 50)):
    return np.random.default_rng(seed).integers(0, 256, (*size, channels)).astype(np.uint8)


@pytest.mark.parametrize("channels", [1, 3])
def test_nothing_changes_nothing(channels):
    image = picture(channels)
    for choices in (None, draws()):
        assert np.allclose(seen(image, choices), image / 255, atol=1e-6)


@given(st.integers(0, 2**32), st.sampled_from([1, 3]))
def test_tones(seed, channels):
    """The table against its formula, and the image against the table."""
    choices = draws(seed, light=0.5, colour=0.3)
    table = tone_table(choices, 0, channels)
    gains = choices.gains[0] if channels == 3 else [1.0]
    for channel in range(channels):
        for value in (0, 1, 100, 255):
            tone = (value / 255) ** choices.gamma[0]
            tone = (tone - 0.5) * choices.contrast[0] + 0.5
            tone = min(max(tone * choices.brightness[0] * gains[channel], 0), 1)
            assert np.isclose(table[value, channel], tone, atol=1e-6)
    assert (np.diff(table, axis=0) >= 0).all(), "brighter stays brighter"
    if channels == 1:
        image = picture(1)
        assert np.array_equal(seen(image, choices)[..., 0], table[image[..., 0], 0])


def test_saturation():
    image = picture()
    choices = replace(draws(), saturation=np.array([0.0]))
    grey = seen(image, choices)
    assert np.ptp(grey, axis=2).max() < 1e-6
    # OpenCV rounds the result to whole values, and its factors to ten bits.
    bound = 0.5 + 3 * 255 / 2**11
    assert np.abs(255 * grey[..., 0] - image @ [0.299, 0.587, 0.114]).max() <= bound
    strong = seen(image, replace(draws(), saturation=np.array([1.2])))
    assert np.ptp(strong, axis=2).mean() > np.ptp(image / 255, axis=2).mean()


def test_blur_is_gaussian():
    image = picture(size=(60, 60))
    for sigma in (0.6, 1.0, 2.5):
        got = seen(image, replace(draws(), blur=np.array([sigma])))
        expected = gaussian_filter(image / 255, (sigma, sigma, 0), mode="mirror", truncate=4)
        assert np.abs(got - expected).max() < 3 / 255  # OpenCV cuts kernels off at 3 sigma
    sharp = seen(image, replace(draws(), blur=np.array([0.1])))
    assert np.allclose(sharp, image / 255, atol=1e-6)


def test_noise():
    image = np.full((200, 200, 3), 128, np.uint8)
    choices = replace(draws(), noise=np.array([0.05]))
    noise = seen(image, choices) - 128 / 255
    assert abs(noise.std() - 0.05) < 1e-3 and abs(noise.mean()) < 1e-3
    flat = noise.reshape(-1)
    assert abs(np.corrcoef(flat[:-1], flat[1:])[0, 1]) < 0.02
    assert np.array_equal(seen(image, choices), seen(image, choices))
    other = seen(image, replace(choices, seed=choices.seed + 1)) - 128 / 255
    assert abs(np.corrcoef(flat, other.reshape(-1))[0, 1]) < 0.02


def test_more_noise_than_is_in_stock():
    out = np.empty((700, 800, 3), np.float32)
    simulate_sensor(
        np.full(out.shape, 128, np.uint8), replace(draws(), noise=np.array([0.05])), 0, out
    )
    assert abs(out.std() - 0.05) < 1e-3


@given(st.integers(0, 2**32))
def test_colours_stay_between_0_and_1(seed):
    image = picture(seed=seed)
    out = seen(image, Augmentation(light=1, colour=1, noise=0.5).draw(1, seed))
    assert np.isfinite(out).all() and out.min() >= 0 and out.max() <= 1


@given(st.integers(0, 2**32))
def test_depth(seed):
    metres = np.full((80, 90), 2.0, np.float32)
    metres[:10] = 0
    choices = replace(draws(seed), depth_noise=np.array([0.003]))
    noisy = metres.copy()
    degrade_depth(noisy, choices, 0)
    assert not noisy[:10].any(), "nothing appears where there was nothing"
    assert abs((noisy - metres)[10:].std() - 0.012) < 1e-3
    holed = np.full((80, 90), 2.0, np.float32)
    degrade_depth(holed, replace(draws(seed), holes=np.array([True])), 0)
    assert 0 < (holed == 0).sum() < holed.size / 2
    assert (holed[holed != 0] == 2).all()
    untouched = metres.copy()
    degrade_depth(untouched, draws(seed), 0)
    assert np.array_equal(untouched, metres)
