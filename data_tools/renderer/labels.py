"""Ground truth of an image: everything that a method may be asked to find."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from data_tools.renderer.prepared import PreparedMesh
from data_tools.renderer.rasteriser import NEAR
from data_tools.renderer.surfaces import CHUNK, surface_at
from data_tools.renderer.visibility import Pose, Scene, visibility
from posecore.arrays import fail

__all__ = ["Labels", "material_images", "render_labels"]


@dataclass(frozen=True, eq=False, repr=False)
class Labels:
    """What is known of each pixel and of each object. Boxes are x, y, width and height in pixels,
    all 0 where there is nothing to enclose.

    Attributes:
        depth: (H, W) float32 distance along the optical axis in metres, 0 for none.
        instance: (H, W) int16 index of the object, -1 for none.
        face: (H, W) int32 index in the mesh's own `faces`, -1 for none.
        coordinates: (H, W, 3) float32 metres in the object's frame, 0 for none.
        normals: (H, W, 3) float32 unit shading normals in the camera's frame, on the side from
            which the face is seen, 0 for none.
        full_masks: (N, H, W) bool, where each object would be if nothing stood before it.
        visible_pixels: (N,) int64.
        full_pixels: (N,) int64 size of the full silhouette, which includes pixels outside the
            image, up to the image's width and height beyond its border, as BOP counts.
        visible_boxes: (N, 4) int64, of the pixels in which the object is seen.
        full_boxes: (N, 4) int64, of the full silhouette; may leave the image.
    """

    depth: np.ndarray
    instance: np.ndarray
    face: np.ndarray
    coordinates: np.ndarray
    normals: np.ndarray
    full_masks: np.ndarray
    visible_pixels: np.ndarray
    full_pixels: np.ndarray
    visible_boxes: np.ndarray
    full_boxes: np.ndarray

    @cached_property
    def visible_masks(self) -> np.ndarray:
        """(N, H, W) bool, the pixels in which each object is seen."""
        return self.instance == np.arange(len(self.full_masks), dtype=np.int16)[:, None, None]

    @property
    def visible_fraction(self) -> np.ndarray:
        """(N,) float64 share of the full silhouette that is seen, 0 where there is none."""
        return self.visible_pixels / np.maximum(self.full_pixels, 1)


def render_labels(
    objects: Sequence[PreparedMesh],
    poses: Sequence[Pose],
    K: np.ndarray,
    size: tuple[int, int],
    *,
    near: float = NEAR,
) -> Labels:
    """Exact ground truth of one image.

    Args:
        objects: N prepared meshes; one may be there several times.
        poses: for each its (R, t) from object to camera, metres.
        K: (3, 3) camera matrix; the centre of the first pixel is (0, 0).
        size: (width, height) of the image in pixels.
        near: metres; surfaces are cut where they come closer to the camera. Of an object that is
            cut open, or has the camera inside it, the inside is seen.

    Raises:
        ValueError: naming the argument, if an object is not prepared, a pose is not a rotation and
            a translation, `K` is no camera matrix, or `size` or `near` is not positive.
    """
    scene = Scene(objects, poses, K, size, near)
    seen = visibility(scene, outside=True)
    width, height = scene.size
    count = len(scene.objects)
    full_masks = np.zeros((count, height, width), bool)
    visible_pixels, full_pixels = np.zeros((2, count), np.int64)
    visible_boxes, full_boxes = np.zeros((2, count, 4), np.int64)
    depth = np.zeros(height * width, np.float32)
    face = np.full(height * width, -1, np.int32)
    coordinates, normals = np.zeros((2, height * width, 3), np.float32)
    prepared_face, inverse_depth = seen.face.reshape(-1), seen.inverse_depth.reshape(-1)
    for index, buffer in enumerate(seen.buffers):
        if buffer is None:
            continue
        full_pixels[index], full_boxes[index] = buffer.full_pixels, buffer.full_box
        full_masks[index][buffer.window] = buffer.mask
        line, column = np.nonzero(seen.instance[buffer.window] == index)
        if not len(line):
            continue
        line, column = line + buffer.y, column + buffer.x
        visible_pixels[index] = len(line)
        corner = np.array([column.min(), line.min()])
        visible_boxes[index] = *corner, *(column.max() + 1, line.max() + 1) - corner
        item, pose = scene.objects[index], scene.poses[index]
        pixels = line * width + column
        for start in range(0, len(pixels), CHUNK):
            part = slice(start, start + CHUNK)
            pixel = pixels[part]
            surface = surface_at(
                item,
                pose,
                scene.K,
                column[part],
                line[part],
                inverse_depth[pixel],
                prepared_face[pixel],
            )
            depth[pixel] = surface.point[2]
            face[pixel] = item.source[prepared_face[pixel]]
            coordinates[pixel] = np.stack(surface.coordinates, axis=1)
            normals[pixel] = np.stack(surface.normal, axis=1)
    return Labels(
        depth=depth.reshape(height, width),
        instance=seen.instance,
        face=face.reshape(height, width),
        coordinates=coordinates.reshape(height, width, 3),
        normals=normals.reshape(height, width, 3),
        full_masks=full_masks,
        visible_pixels=visible_pixels,
        full_pixels=full_pixels,
        visible_boxes=visible_boxes,
        full_boxes=full_boxes,
    )


def material_images(
    objects: Sequence[PreparedMesh], labels: Labels
) -> tuple[np.ndarray, np.ndarray]:
    """What the seen surfaces do with infrared light, as `sensors.depth_sensor` wants to know it.

    Args:
        objects: the objects that were drawn.
        labels: what `render_labels` made of them.

    Returns:
        (H, W) float32 infrared albedo and (H, W) float32 specular strength, 0 where nothing is.

    Raises:
        ValueError: if there are not as many objects as in the labels.
    """
    if len(objects) != len(labels.full_masks):
        fail("objects", f"the {len(labels.full_masks)} of the labels", len(objects))
    infrared, specular = np.zeros((2, *labels.instance.shape), np.float32)
    for index, item in enumerate(objects):
        seen = labels.instance == index
        material = item.mesh.material[labels.face[seen]]
        infrared[seen] = np.array([m.infrared for m in item.mesh.materials])[material]
        specular[seen] = np.array([m.specular for m in item.mesh.materials])[material]
    return infrared, specular
