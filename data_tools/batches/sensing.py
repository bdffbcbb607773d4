"""Simulated light, lens and sensor: from bytes to floats, with blur, noise and holes."""

from __future__ import annotations

import functools

import cv2
import numpy as np

from data_tools.batches.augmentation import Draws

__all__ = ["degrade_depth", "simulate_sensor", "tone_table"]

LUMA_WEIGHTS = np.array([0.299, 0.587, 0.114])  # Rec. ITU-R BT.601
NOISE_SAMPLES = 1 << 20
SHARP = 0.25  # pixels; less blur than this cannot be seen


def simulate_sensor(image: np.ndarray, draws: Draws | None, index: int, out: np.ndarray) -> None:
    """Simulate lens and sensor: colour, blur, tone and noise, from bytes to floats.

    Args:
        image: (H, W, C) uint8, three colours or one.
        draws: random choices; None for none.
        index: the image among those of the draws.
        out: (H, W, C) float32, where 0 to 1 is written.
    """
    if draws is None:
        np.multiply(image, np.float32(1 / 255), out=out)
        return
    channels = image.shape[2]
    if channels == 3 and draws.saturation[index] != 1:
        keep = draws.saturation[index]
        image = cv2.transform(image, keep * np.eye(3) + (1 - keep) * LUMA_WEIGHTS[None])
    if draws.blur[index] > SHARP:
        image = cv2.GaussianBlur(image, (0, 0), draws.blur[index])
    table = tone_table(draws, index, channels)
    cv2.LUT(image.reshape(out.shape), table[None], dst=out)
    if draws.noise[index] > 0:
        rng = np.random.default_rng(draws.seed[index, 1])
        out += np.float32(draws.noise[index]) * _noise(out.shape, rng)
        np.clip(out, 0, 1, out=out)


def tone_table(draws: Draws, index: int, channels: int) -> np.ndarray:
    """(256, channels) float32: what becomes of each byte by gamma, contrast, brightness, gains."""
    tone = np.linspace(0, 1, 256) ** draws.gamma[index]
    tone = (tone - 0.5) * draws.contrast[index] + 0.5
    gains = draws.gains[index] if channels == 3 else np.ones(channels)
    tone = tone[:, None] * (draws.brightness[index] * gains)
    return np.clip(tone, 0, 1).astype(np.float32)


def degrade_depth(metres: np.ndarray, draws: Draws, index: int) -> None:
    """Noise on depth, and holes in it, in place.

    Args:
        metres: (H, W) float32, 0 for none.
        draws: random choices.
        index: the image among those of the draws.
    """
    rng = np.random.default_rng([draws.seed[index, 1], 1])
    if draws.depth_noise[index] > 0:
        noise = np.float32(draws.depth_noise[index]) * _noise(metres.shape, rng)
        np.maximum(metres + metres * metres * noise, 0, out=metres)
    if draws.holes[index]:
        height, width = metres.shape
        for _ in range(rng.integers(1, 6)):
            centre = (int(rng.integers(width)), int(rng.integers(height)))
            axes = np.maximum(1, max(height, width) * rng.uniform(0.01, 0.1, 2)).astype(int)
            cv2.ellipse(metres, centre, axes.tolist(), rng.uniform(0, 180), 0, 360, 0.0, -1)


def _noise(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """Normal numbers out of a stock, since to draw them takes longer than all else together."""
    count, start = int(np.prod(shape)), int(rng.integers(NOISE_SAMPLES))
    if start + count > NOISE_SAMPLES:
        return np.resize(_stock(), start + count)[start:].reshape(shape)
    return _stock()[start : start + count].reshape(shape)


@functools.cache
def _stock() -> np.ndarray:
    return np.random.default_rng(0).standard_normal(NOISE_SAMPLES, dtype=np.float32)
