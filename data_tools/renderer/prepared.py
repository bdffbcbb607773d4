"""What the renderer needs to know of a mesh, worked out once instead of in every picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_tools.shapes.mesh import Mesh
from posecore.arrays import fail

__all__ = ["PreparedMesh", "prepare"]

THINNEST = 1e-12  # height over longest edge of a face that is still drawn


@dataclass(frozen=True, eq=False, repr=False)
class PreparedMesh:
    """A mesh as the rasteriser reads it: one row of numbers for each coordinate.

    Attributes:
        mesh: the mesh itself.
        vertices: (3, V) float64 metres.
        corners: (3, F) int64, the three vertices of each face that is drawn.
        planes: (4, F) float64, unit normal n and offset d of each face: n . x + d = 0.
        two_sided: (F,) bool, faces whose back may be seen; None where there are none.
        normals: (F, 3, 4) float32: the shading normal at the point x is N @ (x, 1), not yet of
            unit length.
        source: (F,) int32, the number of each drawn face in `mesh.faces`.
    """

    mesh: Mesh
    vertices: np.ndarray
    corners: np.ndarray
    planes: np.ndarray
    two_sided: np.ndarray | None
    normals: np.ndarray
    source: np.ndarray

    def __repr__(self) -> str:
        return f"PreparedMesh({self.mesh.name}, {len(self.source)} faces)"


def prepare(mesh: Mesh) -> PreparedMesh:
    """Make a mesh ready to be drawn any number of times.

    Faces without an area cover no pixel and are left out.

    Args:
        mesh: the mesh.

    Raises:
        ValueError: if `mesh` is not a `Mesh`.
    """
    if not isinstance(mesh, Mesh):
        fail("mesh", "a Mesh", type(mesh).__name__)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    double_area = np.linalg.norm(cross, axis=1)
    longest = np.max([np.sum((p - q) ** 2, 1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    drawn = np.flatnonzero(double_area > THINNEST * longest)
    a, b, c = a[drawn], b[drawn], c[drawn]
    normal = cross[drawn] / double_area[drawn, None]
    two_sided = ~mesh.closed[drawn]
    return PreparedMesh(
        mesh=mesh,
        vertices=np.ascontiguousarray(mesh.vertices.T),
        corners=np.ascontiguousarray(mesh.faces[drawn].T.astype(np.int64)),
        planes=np.vstack([normal.T, -np.sum(normal * a, 1)]),
        two_sided=two_sided if two_sided.any() else None,
        normals=_normal_maps(a, b, c, normal, mesh.corner_normals[drawn].astype(np.float64)),
        source=drawn.astype(np.int32),
    )


def _normal_maps(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, normal: np.ndarray, corner_normals: np.ndarray
) -> np.ndarray:
    """(F, 3, 4) float32: the affine maps from a point of a face to its shading normal.

    Barycentric coordinates are affine in the point: the one of corner b rises from 0 on the edge ac
    to 1 at b, so its gradient lies in the face, across ac.
    """
    double_area = np.sum(np.cross(b - a, c - a) * normal, 1)[:, None]
    rise_b = np.cross(c - a, normal) / double_area
    rise_c = np.cross(normal, b - a) / double_area
    n_a, n_b, n_c = corner_normals.swapaxes(0, 1)
    slope = (n_b - n_a)[:, :, None] * rise_b[:, None] + (n_c - n_a)[:, :, None] * rise_c[:, None]
    # Needles would need more digits than float32 has: their normal is the mean of the corners'.
    steep = np.abs(slope).max((1, 2)) > 1e5 if len(slope) else np.zeros(0, bool)
    slope[steep] = 0
    constant = n_a - np.einsum("fij,fj->fi", slope, a)
    constant[steep] = corner_normals[steep].mean(1)
    return np.concatenate([slope, constant[:, :, None]], axis=2).astype(np.float32)
