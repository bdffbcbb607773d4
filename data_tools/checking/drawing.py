"""Silhouettes of models under any pose, in any unit, before any camera: also under wrong ones.

Only ratios of lengths count in a silhouette, so all of them are divided by the distance before
drawing: a dataset in kilometres is drawn like one in metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from data_tools.renderer import PreparedMesh, prepare, rasterise
from data_tools.shapes.mesh import Material, Mesh

__all__ = ["Placement", "Shape", "draw", "hull_mask", "hull_of"]

NEAR = 0.01  # of the object's distance: what is nearer to the camera is not drawn
FARTHEST = 1e6  # pixels: outlines are cut there
SUBPIXELS = 4  # bits of a pixel's fractions that OpenCV draws polygons with


def _directions(count: int) -> np.ndarray:
    """(count, 3) unit vectors spread evenly, on a spiral from pole to pole."""
    z = (np.arange(count) + 0.5) / count * 2 - 1
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    across = np.sqrt(1 - z**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], 1)


DIRECTIONS = _directions(600)
"""In each of them the farthest vertex of a model is a corner of its convex hull."""


@dataclass(frozen=True, eq=False)
class Placement:
    """How an object is drawn.

    Attributes:
        K: (3, 3) camera matrix.
        R, t: (3, 3) and (3,) pose from object to camera, metres.
        scale: by which the model is enlarged.
    """

    K: np.ndarray
    R: np.ndarray
    t: np.ndarray
    scale: float = 1.0


class Shape:
    """A model, made ready to be drawn many times.

    Args:
        object_id: of the object.
        mesh: with `vertices` (V, 3) metres and `faces` (F, 3), as datasets give it.

    Attributes:
        points: (P, 3) corners of its convex hull, whose projection is that of the silhouette to a
            few thousandths of its size.
        diameter: the largest distance between two of them.
        prepared: the mesh as the renderer takes it; None where it has no faces.
    """

    def __init__(self, object_id: int, mesh: Any) -> None:
        self.object_id = object_id
        vertices = np.asarray(mesh.vertices, np.float64)
        self.points = vertices[np.unique((DIRECTIONS @ vertices.T).argmax(1))]
        self.diameter = _diameter(self.points)
        self.prepared = _prepared(vertices, np.asarray(mesh.faces))

    def camera_points(self, place: Placement) -> np.ndarray:
        """(P, 3) the hull's corners in the camera's frame."""
        return place.scale * self.points @ place.R.T + place.t


def draw(
    shape: Shape, place: Placement, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray | None]:
    """Draw one object alone, from both sides of its faces.

    Args:
        shape: what.
        place: where, and by which camera.
        size: (width, height) of the image.

    Returns:
        (H, W) bool silhouette and (H, W) float64 depth in metres, 0 outside. A model without faces
        is drawn as its convex hull, and has no depth (None).
    """
    width, height = size
    if shape.prepared is None:
        return hull_mask(hull_of(shape, place), size), None
    mask, depth = np.zeros((height, width), bool), np.zeros((height, width))
    distance = max(float(np.linalg.norm(place.t)), 1e-3 * place.scale * shape.diameter)
    factor = place.scale / distance
    planes = shape.prepared.planes * np.array([1, 1, 1, factor])[:, None]
    near = replace(shape.prepared, vertices=shape.prepared.vertices * factor, planes=planes)
    buffer = rasterise(near, place.R, place.t / distance, place.K, size, near=NEAR, outside=False)
    if buffer is not None and buffer.keys.size:
        seen = buffer.mask
        mask[buffer.window] = seen
        inverse = np.where(seen, buffer.inverse_depth, 1)
        depth[buffer.window] = np.where(seen, distance / inverse, 0)
    return mask, depth


def hull_of(shape: Shape, place: Placement) -> np.ndarray | None:
    """(M, 2) float32 the convex hull of the silhouette in pixels; None if not all is in front."""
    points = shape.camera_points(place)
    if (points[:, 2] <= 1e-3 * max(np.abs(points).max(), 1e-300)).any():
        return None
    scaled = points @ place.K.T
    pixels = (scaled[:, :2] / scaled[:, 2:]).clip(-FARTHEST, FARTHEST)
    return cv2.convexHull(pixels.astype(np.float32))[:, 0]


def hull_mask(hull: np.ndarray | None, size: tuple[int, int], step: int = 1) -> np.ndarray:
    """A convex polygon as a mask.

    Args:
        hull: (M, 2) pixels of the whole image; None for nothing.
        size: (width, height) of the whole image.
        step: every how many pixels of it the mask has one.

    Returns:
        (ceil(H / step), ceil(W / step)) bool.
    """
    width, height = (-(-pixels // step) for pixels in size)
    mask = np.zeros((height, width), np.uint8)
    if hull is not None:
        corners = np.round(hull.astype(np.float64) / step * 2**SUBPIXELS).astype(np.int32)
        cv2.fillConvexPoly(mask, corners, 1, shift=SUBPIXELS)
    return mask.astype(bool)


def _diameter(points: np.ndarray) -> float:
    return max(float(np.linalg.norm(points - point, axis=1).max()) for point in points)


def _prepared(vertices: np.ndarray, faces: np.ndarray) -> PreparedMesh | None:
    if not len(faces):
        return None
    count = len(faces)
    mesh = Mesh(
        name="model",
        vertices=vertices,
        faces=faces.astype(np.int32),
        corner_normals=np.zeros((count, 3, 3), np.float32),
        material=np.zeros(count, np.int16),
        materials=(Material((0.5, 0.5, 0.5)),),
        # A scan has holes, and one does not know which way its faces look.
        closed=np.zeros(count, bool),
    )
    prepared = prepare(mesh)
    return prepared if len(prepared.source) else None
