"""How far points are from the surface of a mesh."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.spatial import cKDTree

__all__ = ["Surface"]

DENSE = 50_000  # points of the surface, at which its triangles are found
NEAR, MANY = 8, 64  # of them, for each point, whose triangles are looked at
BLOCK, FEW = 20_000, 500  # points at once, of the two
MOST_VERTICES = 20_000  # of those that are moved
DRAWN = 5_000  # points of the surface that are moved besides


class Surface:
    """The surface of a mesh, in the unit of its vertices; of a mesh without faces, its vertices.

    Attributes:
        points: (P, 3) points on it: its vertices, if there are many a part of them, and points
            drawn evenly from its triangles, always the same ones.
    """

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        plain = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        vertices = np.asarray(plain.vertices)
        rng = np.random.default_rng(0)
        if len(vertices) > MOST_VERTICES:
            vertices = vertices[np.sort(rng.choice(len(vertices), MOST_VERTICES, replace=False))]
        self.points, self._triangles = vertices, None
        self._tree = cKDTree(np.unique(plain.vertices, axis=0))
        if plain.area > 0:
            drawn, _ = trimesh.sample.sample_surface(plain, DRAWN, seed=0)
            dense, faces = trimesh.sample.sample_surface(plain, DENSE, seed=1)
            # The smallest triangles, which get no point by chance, have their middle.
            self._triangles = np.asarray(plain.triangles)
            self._faces = np.concatenate([faces, np.arange(len(plain.faces))])
            middles = self._triangles.mean(1)
            self._tree = cKDTree(np.concatenate([dense, middles]))
            self.points = np.concatenate([vertices, drawn])

    def distances(self, points: np.ndarray, near: int = NEAR) -> np.ndarray:
        """How far points (P, 3) are from the surface, (P,).

        Each is measured to the triangles on which the `near` drawn points nearest to it lie; so a
        distance is never too small, and too large by less than drawn points are apart.
        """
        blocks = [points[i : i + BLOCK] for i in range(0, len(points), BLOCK)]
        return np.concatenate([self._distances(block, near) for block in blocks])

    def gap(self, points: np.ndarray) -> tuple[float, float]:
        """The largest distance of points (P, 3) from the surface, and their mean.

        The farthest ones are looked at more closely: where many thin triangles meet, few of them
        are not enough.
        """
        distances = self.distances(points)
        order, largest = np.argsort(-distances), 0.0
        for begin in range(0, len(points), FEW):
            chosen = order[begin : begin + FEW]
            if distances[chosen[0]] <= largest:
                break
            distances[chosen] = self.distances(points[chosen], MANY)
            largest = max(largest, float(distances[chosen].max()))
        return largest, float(distances.mean())

    def _distances(self, points: np.ndarray, near: int) -> np.ndarray:
        if self._triangles is None:
            return self._tree.query(points)[0]
        _, found = self._tree.query(points, min(near, self._tree.n))
        found = found.reshape(len(points), -1)
        triangles = self._triangles[self._faces[found.ravel()]]
        repeated = np.repeat(points, found.shape[1], axis=0)
        feet = trimesh.triangles.closest_point(triangles, repeated)
        away = np.linalg.norm(feet - repeated, axis=1)
        return away.reshape(found.shape).min(1)
