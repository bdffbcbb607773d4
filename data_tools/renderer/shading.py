"""How bright a point of a surface is."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from data_tools.renderer.lights import Ambient, Light
from data_tools.renderer.prepared import PreparedMesh
from data_tools.renderer.samples import Samples
from data_tools.renderer.shadows import ShadowMap
from data_tools.renderer.surfaces import (
    CHUNK,
    Surface,
    Triple,
    dot,
    face_normals,
    normalised,
    surface_at,
)
from data_tools.renderer.visibility import Scene
from data_tools.shapes.mesh import Material

__all__ = ["Reflectance", "shade"]

Reflectance = Callable[[tuple[Material, ...], np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""From materials, index (P,), points (P, 3) and normals (P, 3), object frame, to (P,) or (P, 3)."""

AT_NORMAL = 0.04  # what glass, plastic, skin and varnish mirror of the light that meets them square


def shade(
    scene: Scene,
    samples: Samples,
    reflectance: Reflectance,
    channels: int,
    lights: Sequence[tuple[Light, ShadowMap | None]],
    ambient: Ambient,
) -> np.ndarray:
    """The light that comes from each sample, (S, channels) float32, linear.

    Args:
        scene: objects and camera.
        samples: what to shade; every sample sees an object.
        reflectance: the surfaces' colour.
        channels: how many colours, 1 or 3.
        lights: lamps and their shadows.
        ambient: light from all around.
    """
    result = np.empty((len(samples), channels), np.float32)
    order = np.argsort(samples.instance, kind="stable")
    first = np.searchsorted(samples.instance[order], np.arange(len(scene.objects) + 1))
    for index, item in enumerate(scene.objects):
        for start in range(first[index], first[index + 1], CHUNK):
            part = order[start : min(start + CHUNK, first[index + 1])]
            face = samples.face[part]
            surface = surface_at(
                item,
                scene.poses[index],
                scene.K,
                samples.x[part],
                samples.y[part],
                samples.inverse_depth[part],
                face,
            )
            materials, material = _materials(item, face)
            points = np.stack(surface.coordinates, axis=1)
            normals = np.stack(surface.object_normal, axis=1)
            colour = reflectance(materials, material, points, normals).reshape(len(part), channels)
            gloss = np.array([(m.specular, m.shininess) for m in materials], np.float32)[material].T
            flat = face_normals(item, scene.poses[index], face, surface.side)
            for channel, value in enumerate(
                _radiance(surface, flat, colour.T, *gloss, lights, ambient)
            ):
                result[part, channel] = value
    return result


def _materials(item: PreparedMesh, face: np.ndarray) -> tuple[tuple[Material, ...], np.ndarray]:
    return item.mesh.materials, item.mesh.material[item.source[face]]


def _radiance(
    surface: Surface,
    face_normal: Triple,
    colour: np.ndarray,
    specular: np.ndarray,
    shininess: np.ndarray,
    lights: Sequence[tuple[Light, ShadowMap | None]],
    ambient: Ambient,
) -> list[np.ndarray]:
    """Each channel's light: from all around, and of each lamp what is scattered and mirrored.

    Scattered: Lambert. Mirrored: Blinn and Phong (Blinn, "Models of light reflection for computer
    synthesized pictures", 1977) with the factor (s + 8) / 8, by which a sharper highlight is a
    brighter one (Akenine-Möller et al., "Real-Time Rendering", 3rd ed., eq. 7.49). The surroundings
    are mirrored by Fresnel's law as Schlick approximates it (1994).
    """
    normal = surface.normal
    view = normalised(tuple(-c for c in surface.point))
    facing = np.clip(dot(normal, view), 0, 1)
    above, below = ambient.above.astype(np.float32), ambient.below.astype(np.float32)
    up = ambient.up.astype(np.float32)
    height = dot(normal, up)
    mirrored = 2 * facing * height - dot(view, up)
    gloss = specular * (AT_NORMAL + (1 - AT_NORMAL) * (1 - facing) ** 5)
    around = [
        colour[k] * _mix(below[k], above[k], height) + gloss * _mix(below[k], above[k], mirrored)
        for k in range(len(colour))
    ]
    for light, shadows in lights:
        ray = tuple(np.float32(q) - c for q, c in zip(light.position, surface.point, strict=True))
        square = np.maximum(dot(ray, ray), np.float32(1e-6))
        ray = normalised(ray)
        arriving = np.maximum(dot(normal, ray), 0) / square
        if light.beam:
            arriving *= np.maximum(-ray[2], 0) ** np.float32(light.beam)
        if shadows is not None:
            lit = np.flatnonzero(arriving)
            arriving[lit] *= shadows.lit(
                tuple(c[lit] for c in surface.point), tuple(c[lit] for c in face_normal)
            )
        half = normalised(tuple(a + b for a, b in zip(ray, view, strict=True)))
        highlight = np.maximum(dot(normal, half), 0) ** shininess
        highlight *= specular * (shininess + 8) / 8
        for k, channel in enumerate(around):
            channel += np.float32(light.power[k]) * arriving * (colour[k] + highlight)
    return around


def _mix(below: np.float32, above: np.float32, height: np.ndarray) -> np.ndarray:
    """The light that a surface gets from all around; `height` is 1 where it faces up."""
    return below + (above - below) * (np.float32(0.5) + np.float32(0.5) * height)
