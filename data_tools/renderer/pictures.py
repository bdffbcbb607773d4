"""Pictures of a scene, in colour and in infrared light, before any camera has spoilt them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from data_tools.renderer.lights import Ambient, Light
from data_tools.renderer.prepared import PreparedMesh
from data_tools.renderer.rasteriser import NEAR
from data_tools.renderer.samples import (
    Samples,
    all_in_pixels,
    contrasting,
    one_per_pixel,
    refined,
)
from data_tools.renderer.shading import Reflectance, shade
from data_tools.renderer.shadows import ShadowMap, shadow_map
from data_tools.renderer.surfaces import camera_points
from data_tools.renderer.visibility import Pose, Scene, visibility
from data_tools.textures import albedo, infrared
from posecore.arrays import fail, require_integer, require_number, to_numbers

__all__ = ["render_colour", "render_infrared"]


def render_colour(
    objects: Sequence[PreparedMesh],
    poses: Sequence[Pose],
    K: np.ndarray,
    size: tuple[int, int],
    lights: Sequence[Light],
    *,
    ambient: Ambient | None = None,
    background: float | np.ndarray = 0.0,
    casters: Sequence[int] | None = None,
    samples: int = 2,
    shadow_texels: int = 512,
    near: float = NEAR,
) -> np.ndarray:
    """A colour picture of a scene, in linear light.

    Args:
        objects, poses, K, size, near: as in `render_labels`.
        lights: the lamps.
        ambient: the light from all around.
        background: one number, a colour (3,) or a picture (H, W, 3), linear.
        casters: which objects throw shadows, all by default. A ground that only receives them
            is better left out: the shadow maps are then as sharp as the objects allow.
        samples: edges are smoothed with `samples` x `samples` points a pixel.
        shadow_texels: width of a shadow map.

    Returns:
        (H, W, 3) float32, 1 where white is lit by a light of power 1 at 1 m; may exceed 1.

    Raises:
        ValueError: naming the argument that does not fit this description.
    """
    scene = Scene(objects, poses, K, size, near)
    ambient = Ambient() if ambient is None else ambient
    options = _options(scene, lights, ambient, background, (3,), casters, samples, shadow_texels)
    return _render(scene, albedo, *options)


def render_infrared(
    objects: Sequence[PreparedMesh],
    poses: Sequence[Pose],
    K: np.ndarray,
    size: tuple[int, int],
    lights: Sequence[Light],
    *,
    ambient: float = 0.01,
    background: float | np.ndarray = 0.0,
    casters: Sequence[int] | None = None,
    samples: int = 2,
    shadow_texels: int = 512,
    near: float = NEAR,
) -> np.ndarray:
    """What an infrared camera sees, in linear light; its lamps stand beside it.

    The lamps' light falls with the square of the distance, so what is near is bright and the
    background is dark, however bright it is by day.

    Args:
        objects, poses, K, size, casters, samples, shadow_texels, near: as in `render_colour`.
        lights: the lamps; of their power the first number counts.
        ambient: light from all around.
        background: one number or a picture (H, W), linear.

    Returns:
        (H, W) float32.

    Raises:
        ValueError: naming the argument that does not fit this description.
    """
    scene = Scene(objects, poses, K, size, near)
    ambient = require_number("ambient", ambient, 0)
    around = Ambient(above=ambient, below=ambient)
    options = _options(scene, lights, around, background, (), casters, samples, shadow_texels)
    return _render(scene, infrared, *options)[..., 0]


def _options(
    scene: Scene,
    lights: Sequence[Light],
    ambient: Ambient,
    background: float | np.ndarray,
    channels: tuple[int, ...],
    casters: Sequence[int] | None,
    samples: int,
    shadow_texels: int,
) -> tuple:
    """The arguments that both kinds of picture share, checked."""
    lights = list(lights)
    if not all(isinstance(light, Light) for light in lights):
        fail("lights", "Lights", [type(light).__name__ for light in lights])
    if not isinstance(ambient, Ambient):
        fail("ambient", "an Ambient", repr(ambient))
    count = channels[0] if channels else 1
    values = to_numbers("background", background)
    allowed = {(), channels, scene.shape + channels}
    if values.shape not in allowed or not np.isfinite(values).all() or (values < 0).any():
        shapes = " or ".join(map(str, sorted(allowed, key=len)))
        fail("background", f"numbers of at least 0 of shape {shapes}", f"shape {values.shape}")
    if values.shape == scene.shape:
        values = values[..., None]
    values = np.broadcast_to(values.astype(np.float32), (*scene.shape, count))
    if casters is None:
        casters = range(len(scene.objects))
    casters = [require_integer("casters", k, 0, len(scene.objects) - 1) for k in casters]
    samples = require_integer("samples", samples, 1, 8)
    texels = require_integer("shadow_texels", shadow_texels, 16, 8192)
    return lights, ambient, values, casters, samples, texels


def _render(
    scene: Scene,
    reflectance: Reflectance,
    lights: list[Light],
    ambient: Ambient,
    background: np.ndarray,
    casters: list[int],
    fineness: int,
    texels: int,
) -> np.ndarray:
    """(H, W, C) float32: every pixel is shaded once, and once more where that is not enough.

    A pixel is looked at more closely where its samples see different things, or where it differs
    from a neighbour (Whitted, "An improved illumination model for shaded display", 1980; by
    contrast, as Mitchell, "Generating antialiased images at low sampling densities", 1987): at
    edges, but also in fine patterns, on creases, and at the rims of shadows and highlights.
    """
    fine = visibility(refined(scene, fineness))
    whole, coarse = one_per_pixel(fine, fineness)
    maps = [(light, _shadows(scene, coarse, light, casters, texels)) for light in lights]
    channels = background.shape[2]
    picture = background.copy()
    picture[whole] = shade(scene, coarse, reflectance, channels, maps, ambient)
    if fineness > 1:
        closer = ~whole | contrasting(picture, whole)
        pixel, samples = all_in_pixels(fine, fineness, closer)
        colours = shade(scene, samples, reflectance, channels, maps, ambient)
        area, share = whole.size, 1 / fineness**2
        covered = np.bincount(pixel, minlength=area).reshape(whole.shape)[closer] * share
        for channel in range(channels):
            total = np.bincount(pixel, colours[:, channel], area).reshape(whole.shape)[closer]
            behind = background[..., channel][closer]
            picture[..., channel][closer] = share * total + (1 - covered) * behind
    return picture


def _shadows(
    scene: Scene, samples: Samples, light: Light, casters: list[int], texels: int
) -> ShadowMap | None:
    """The lamp's shadows on what is seen."""
    if not light.shadows:
        return None
    objects, poses = [scene.objects[k] for k in casters], [scene.poses[k] for k in casters]
    points = camera_points(scene.K, samples.x, samples.y, samples.inverse_depth)
    return shadow_map(objects, poses, light.position, light.radius, points, texels)
