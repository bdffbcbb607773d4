"""What cameras make of a perfect picture: noise, blur, too little and too much light, holes.

Every function takes linear, noise-free images of `data_tools.renderer` and a generator, and gives
what a file of a dataset would hold. The same generator state gives the same image.
"""

from __future__ import annotations

import cv2
import numpy as np

from posecore.arrays import fail, require_integer, require_number, to_numbers
from posecore.cameras import require_intrinsics

__all__ = ["depth_sensor", "infrared_sensor", "linear_to_srgb", "rgb_sensor", "srgb_to_linear"]

EDGE = 1.5  # pixels of disparity between neighbours, above which there is a step in depth
SHADOW = 1.0  # pixels of disparity by which something stands before what the projector lights
GLARE = 0.4  # specular times cosine to a power, above which a surface blinds the camera
GLOSS = 60  # that power


def linear_to_srgb(linear: np.ndarray) -> np.ndarray:
    """From linear light to the numbers of an image, 0 to 1; brighter than 1 becomes 1.

    Source: IEC 61966-2-1.
    """
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def srgb_to_linear(encoded: np.ndarray) -> np.ndarray:
    """From the numbers of an image, 0 to 1, to linear light: undoes `linear_to_srgb`."""
    encoded = np.clip(encoded, 0, 1)
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def rgb_sensor(
    linear: np.ndarray,
    generator: np.random.Generator,
    *,
    exposure: float = 1.0,
    shot_noise: float = 0.02,
    read_noise: float = 0.004,
    blur: float = 0.5,
) -> np.ndarray:
    """A colour photograph.

    Args:
        linear: (H, W, 3) light, at least 0.
        generator: of random numbers.
        exposure: factor before anything else; what is then above 1 is white.
        shot_noise: standard deviation of the photon noise at brightness 1; it grows with the square
            root of the light.
        read_noise: standard deviation of the noise of the electronics, the same everywhere.
        blur: pixels, standard deviation of the lens's blur.

    Returns:
        (H, W, 3) uint8, sRGB.

    Raises:
        ValueError: naming the argument that does not fit this description.
    """
    image = _image("linear", linear, 3)
    noisy = _exposed(image, generator, exposure, shot_noise, read_noise, blur)
    return np.round(linear_to_srgb(noisy) * 255).astype(np.uint8)


def infrared_sensor(
    linear: np.ndarray,
    generator: np.random.Generator,
    *,
    exposure: float = 1.0,
    shot_noise: float = 0.02,
    read_noise: float = 0.01,
    column_noise: float = 0.003,
    blur: float = 0.6,
    bits: int = 8,
) -> np.ndarray:
    """An infrared image: its numbers grow with the light itself, and columns differ a little.

    Args:
        linear: (H, W) light, at least 0.
        generator: of random numbers.
        exposure, shot_noise, read_noise, blur: as in `rgb_sensor`.
        column_noise: standard deviation of what each column adds to all its pixels.
        bits: of a pixel, 8 to 16; the brightest number is 2**bits - 1.

    Returns:
        (H, W) uint8 for 8 bits, otherwise uint16.

    Raises:
        ValueError: naming the argument that does not fit this description.
    """
    image = _image("linear", linear, 1)
    bits = require_integer("bits", bits, 8, 16)
    column_noise = require_number("column_noise", column_noise, 0)
    noisy = _exposed(image, generator, exposure, shot_noise, read_noise, blur)
    columns = generator.standard_normal((1, image.shape[1]), np.float32)
    noisy = np.clip(noisy + np.float32(column_noise) * columns, 0, 1)
    return np.round(noisy * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)


def depth_sensor(
    depth: np.ndarray,
    K: np.ndarray,
    generator: np.random.Generator,
    *,
    normals: np.ndarray | None = None,
    reflectance: float | np.ndarray = 0.5,
    specular: float | np.ndarray = 0.0,
    baseline: float = 0.075,
    disparity_noise: float = 0.08,
    disparity_step: float = 0.125,
    faintest: float = 0.01,
    edge_loss: float = 0.6,
) -> np.ndarray:
    """The depth image of a structured light camera: a projector beside a camera.

    It measures by how many pixels its pattern is displaced, `d = fx * baseline / z`, with some
    noise and in steps; so the noise of z and its steps grow with z^2 (Khoshelham and Elberink,
    "Accuracy and resolution of Kinect depth data", 2012, eq. 11). It measures nothing where the
    projector's light does not arrive, where too little of it comes back (far, dark or grazing
    surfaces, or shiny ones), where a shiny surface mirrors it into the camera, and at most edges.

    Args:
        depth: (H, W) metres, 0 for none.
        K: (3, 3) camera matrix.
        generator: of random numbers.
        normals: (H, W, 3) unit normals in the camera's frame; without them every surface is taken
            to face the camera.
        reflectance: one number or (H, W), share of infrared light that surfaces scatter.
        specular: one number or (H, W), share that they mirror, 0 to 1.
        baseline: metres from the camera to the projector, which stands to its right.
        disparity_noise: pixels, standard deviation.
        disparity_step: pixels between two disparities that the camera can tell apart; 0 for none.
        faintest: reflectance times cosine over squared distance (1/m^2) below which nothing is
            measured; the threshold itself varies from pixel to pixel.
        edge_loss: share of the pixels at edges that are lost.

    Returns:
        (H, W) float32 metres, 0 for holes.

    Raises:
        ValueError: naming the argument that does not fit this description.
    """
    depth = _image("depth", depth, 1)
    camera = to_numbers("K", K)
    require_intrinsics("K", camera)
    _require_generator(generator)
    shares = [
        _share(name, value, depth.shape, highest)
        for name, value, highest in (
            ("reflectance", reflectance, np.inf),
            ("specular", specular, 1),
        )
    ]
    scale = abs(camera[0, 0]) * require_number("baseline", baseline, above=0)
    disparity_noise = require_number("disparity_noise", disparity_noise, 0)
    step = require_number("disparity_step", disparity_step, 0)
    faintest = require_number("faintest", faintest, 0)
    edge_loss = require_number("edge_loss", edge_loss, 0, 1)
    cosine = _cosines(normals, depth.shape, camera)

    measured = depth > 0
    disparity = np.zeros(depth.shape)
    np.divide(scale, depth, out=disparity, where=measured)
    # All random numbers are drawn before anything is decided, so that they do not depend on it.
    jitter = _smooth_noise(generator, depth.shape)
    variation = np.exp(0.3 * _smooth_noise(generator, depth.shape))
    luck = generator.random(depth.shape)

    returned = shares[0] * (1 - shares[1]) * cosine * (disparity / scale) ** 2
    seen = measured & (returned >= faintest * variation)
    seen &= shares[1] * cosine**GLOSS <= GLARE * variation
    seen &= ~(_edges(disparity) & (edge_loss > luck))
    seen &= ~_in_shadow(disparity, measured)
    disparity += disparity_noise * jitter
    if step:
        disparity = np.round(disparity / step) * step
    seen &= disparity > 0
    result = np.zeros(depth.shape, np.float32)
    np.divide(scale, disparity, out=result, where=seen, casting="same_kind")
    return result


def _exposed(
    image: np.ndarray,
    generator: np.random.Generator,
    exposure: float,
    shot_noise: float,
    read_noise: float,
    blur: float,
) -> np.ndarray:
    """Blurred, exposed and noisy; may leave 0 to 1."""
    _require_generator(generator)
    exposure = require_number("exposure", exposure, above=0)
    shot_noise = require_number("shot_noise", shot_noise, 0)
    read_noise = require_number("read_noise", read_noise, 0)
    if require_number("blur", blur, 0, 100):
        image = cv2.GaussianBlur(image, (0, 0), blur)
    image = image * np.float32(exposure)
    deviation = np.sqrt(np.float32(shot_noise**2) * image + np.float32(read_noise**2))
    return image + deviation * generator.standard_normal(image.shape, np.float32)


def _smooth_noise(generator: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Noise of variance 1 that neighbours share in part, since a sensor compares windows."""
    kernel = cv2.getGaussianKernel(5, 0.8)
    noise = generator.standard_normal(shape)
    return cv2.sepFilter2D(noise, -1, kernel, kernel) / (kernel**2).sum()


def _edges(disparity: np.ndarray) -> np.ndarray:
    """(H, W) bool, pixels at a step in depth."""
    window = np.ones((3, 3), np.uint8)
    return cv2.dilate(disparity, window) - cv2.erode(disparity, window) > EDGE


def _in_shadow(disparity: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """(H, W) bool, where something nearer stands before the projector's light.

    The projector sees the point of pixel x in its own column x - d; of all points in one column
    it lights the nearest.
    """
    height, width = disparity.shape
    rows, columns = np.nonzero(measured)
    own = disparity[measured]
    # Further than an image's width to the left the projector does not reach.
    lit = np.clip(np.round(columns - own), -width, width).astype(np.int64)
    nearest = np.zeros(height * (2 * width + 1))
    place = rows * (2 * width + 1) + lit + width
    np.maximum.at(nearest, place, own)
    result = np.zeros(disparity.shape, bool)
    result[measured] = (nearest[place] - own > SHADOW) | (lit == -width)
    return result


def _cosines(normals: np.ndarray | None, shape: tuple[int, ...], camera: np.ndarray) -> np.ndarray:
    """(H, W) cosine between the surface's normal and the line of sight."""
    if normals is None:
        return np.ones(shape)
    normals = to_numbers("normals", normals)
    if normals.shape != (*shape, 3) or not np.isfinite(normals).all():
        fail("normals", f"finite numbers of shape {(*shape, 3)}", f"shape {normals.shape}")
    y, x = np.indices(shape)
    rays = np.stack([x, y, np.ones(shape)], axis=-1) @ np.linalg.inv(camera).T
    return np.clip(-(rays * normals).sum(-1) / np.linalg.norm(rays, axis=-1), 0, 1)


def _image(name: str, image: np.ndarray, channels: int) -> np.ndarray:
    """The image as float32; refused if it has another shape or holds no light."""
    values = to_numbers(name, image)
    shape = "(H, W)" if channels == 1 else f"(H, W, {channels})"
    good = values.ndim == 2 if channels == 1 else values.ndim == 3 and values.shape[2] == channels
    if not good or not values.size:
        fail(name, f"shape {shape}", f"shape {values.shape}")
    if not np.isfinite(values).all() or (values < 0).any():
        fail(name, "finite numbers of at least 0", "others")
    return values.astype(np.float32)


def _share(name: str, value: float | np.ndarray, shape: tuple, highest: float) -> np.ndarray:
    values = to_numbers(name, value)
    if values.shape not in ((), shape):
        fail(name, f"one number or shape {shape}", f"shape {values.shape}")
    if not np.isfinite(values).all() or (values < 0).any() or (values > highest).any():
        fail(name, f"numbers from 0 to {highest}", "others")
    return np.broadcast_to(values, shape)


def _require_generator(generator: np.random.Generator) -> None:
    if not isinstance(generator, np.random.Generator):
        fail("generator", "a numpy.random.Generator", type(generator).__name__)
