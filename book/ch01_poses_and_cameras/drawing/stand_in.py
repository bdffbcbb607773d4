"""The drawn stand-in for a photograph: a painted mug on a table, with exact pose, mask and depth.

A page may not ship the field's real pictures, so this one is computed. Chapter 2 explains how such
a picture comes about and has the real renderer; here is only as much of it as one picture needs.
"""

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from book.ch01_poses_and_cameras.drawing import things
from posecore import cameras, clouds, poses
from posecore.arrays import require_choice

__all__ = ["Photograph", "can", "mug", "photograph", "rasterise", "sample_surface"]

SIZE = (480, 360)  # pixels, width and height
FINER = 3  # samples a pixel and direction; odd, so that the middle one is the pixel's centre
K = np.array([[700.0, 0, 239.5], [0, 700.0, 175.5], [0, 0, 1]])
EYE, LOOKED_AT = np.array([0.16, -0.50, 0.31]), np.array([0.008, 0.0, 0.043])
LAMP = np.array([-0.62, -0.28, 0.72])


mug, can = things.mug, things.can


@dataclass(frozen=True)
class Photograph:
    """A picture of one object whose pose is known; lengths in metres, None where unknown."""

    name: str
    source: str
    """Where it comes from, in words."""
    rgb: np.ndarray
    """(H, W, 3) bytes."""
    K: np.ndarray
    R: np.ndarray
    t: np.ndarray
    """The true pose of the object."""
    keypoints: np.ndarray
    """(9, 3) eight points spread over the object, and its centre."""
    points: np.ndarray
    """(N, 3) points of its surface: all that is known of it."""
    size: np.ndarray
    centre: np.ndarray
    """Of its bounding box, in its own frame."""
    diameter: float
    """The largest distance of two of its points."""
    normals: np.ndarray | None = None
    """(N, 3) outwards, of length one."""
    colours: np.ndarray | None = None
    """(N, 3) of the points, 0 to 1."""
    mask: np.ndarray | None = None
    """(H, W) true where the object is seen."""
    depth: np.ndarray | None = None
    """(H, W) metres, 0 where there is none."""
    vertices: np.ndarray | None = None
    faces: np.ndarray | None = None


def photograph(name: str = "mug", points: int = 2000) -> Photograph:
    """The picture, with the pose, the mesh and points of its mug or of its can."""
    picture = _drawn()
    if name == "mug":
        mesh, where = mug(), (things.turn(things.MUG_TURN), things.MUG_STANDS_AT)
    else:
        require_choice("name", name, ["mug", "can"])
        mesh, where = can(), (things.turn(things.CAN_TURN), things.CAN_STANDS_AT)
    vertices, faces = mesh
    R, t = poses.compose(*_look_at(EYE, LOOKED_AT), *where)
    samples, normals = sample_surface(vertices, faces, points)
    low, high = vertices.min(0), vertices.max(0)
    chosen = clouds.farthest_point_sampling(vertices, 8)
    return Photograph(
        name=name,
        source="drawn stand-in",
        rgb=picture["rgb"],
        K=K,
        R=R,
        t=t,
        keypoints=np.vstack([vertices[chosen], (low + high) / 2]),
        points=samples,
        normals=normals,
        colours=things.PAINTS[name](poses.apply(*where, samples))[0] ** (1 / 2.2),
        size=high - low,
        centre=(low + high) / 2,
        diameter=float(pdist(vertices[ConvexHull(vertices).vertices]).max()),
        mask=picture["owner"] == ("mug", "can").index(name),
        depth=picture["depth"],
        vertices=vertices,
        faces=faces,
    )


@cache
def _drawn() -> dict[str, np.ndarray]:
    """The colours (H, W, 3), the depth (H, W), and the number of the thing at every pixel."""
    all_things = things.scene()
    vertices, faces, owner = things.join([(v, f) for v, f, _ in all_things])
    fine = tuple(FINER * n for n in SIZE)
    in_camera = poses.apply(*_look_at(EYE, LOOKED_AT), vertices)
    fine_K = cameras.resize_intrinsics(K, SIZE, fine)
    depth, face, weights = rasterise(fine_K, in_camera, faces, fine)
    rgb = _shade([name for *_, name in all_things], vertices, faces, owner, face, weights)
    rgb = cv2.resize(rgb, SIZE, interpolation=cv2.INTER_AREA).clip(0, 1)
    middle = slice(FINER // 2, None, FINER)
    return {
        "rgb": (255 * rgb ** (1 / 2.2)).round().astype(np.uint8),
        "depth": depth[middle, middle],
        "owner": owner[face[middle, middle]],
    }


def rasterise(
    K: np.ndarray, vertices: np.ndarray, faces: np.ndarray, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What every pixel sees of a mesh in the camera's frame that lies in front of the camera.

    Only the outer side of a face is seen, from which its corners go round counter-clockwise.

    Returns:
        Depth (H, W), 0 where nothing is; the number of the face (H, W), there -1; and the weights
        of its corners (H, W, 3).
    """
    inverse = np.zeros((size[1], size[0]))
    face = np.full(inverse.shape, -1)
    weights = np.zeros((*inverse.shape, 3))
    corners = cameras.project(K, vertices)[faces]  # (F, 3, 2)
    low = np.ceil(corners.min(1)).astype(int).clip(0)
    high = np.floor(corners.max(1)).astype(int).clip(None, np.array(size) - 1) + 1
    # The three edge functions, and 1 / z, are linear in the pixel: rows [a, b, c] of a x + b y + c.
    homogeneous = np.concatenate([corners, np.ones((*corners.shape[:2], 1))], -1)
    area = np.linalg.det(homogeneous)
    used = np.flatnonzero((area < -1e-9) & (low < high).all(1))  # backs have another sign
    linear = np.linalg.inv(homogeneous[used]).transpose(0, 2, 1)
    for number, rows, z in zip(used, linear, vertices[faces[used], 2], strict=True):
        (x0, y0), (x1, y1) = low[number], high[number]
        x, y = np.arange(x0, x1), np.arange(y0, y1)[:, None]
        w = [a * x + b * y + c for a, b, c in rows]
        near = w[0] / z[0] + w[1] / z[1] + w[2] / z[2]
        window = np.s_[y0:y1, x0:x1]
        seen = (w[0] >= -1e-9) & (w[1] >= -1e-9) & (w[2] >= -1e-9) & (near > inverse[window])
        inverse[window][seen] = near[seen]
        face[window][seen] = number
        weights[window][seen] = np.stack([v[seen] / d for v, d in zip(w, z, strict=True)], -1)
    found = face >= 0
    weights[found] /= inverse[found, None]  # perspective: linear in space, not in the picture
    return np.divide(1, inverse, out=inverse, where=found), face, weights


def sample_surface(
    vertices: np.ndarray, faces: np.ndarray, count: int, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) spread evenly over a mesh, and the normals (N, 3) of their faces."""
    rng = np.random.default_rng(seed)
    a, b, c = vertices[faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    area = np.linalg.norm(normals, axis=1)
    chosen = rng.choice(len(faces), count, p=area / area.sum())
    u, v = rng.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    points = a[chosen] + u * (b - a)[chosen] + v * (c - a)[chosen]
    return points, normals[chosen] / area[chosen, None]


def _shade(
    names: list[str],
    vertices: np.ndarray,
    faces: np.ndarray,
    owner: np.ndarray,
    face: np.ndarray,
    weights: np.ndarray,
) -> np.ndarray:
    """Linear colours (H, W, 3): paint, times a lamp with a soft shadow and an open sky."""
    corners = faces[face.ravel()]
    weights = weights.reshape(-1, 3).astype(np.float32)
    place = np.einsum("nk,nkc->nc", weights, vertices.astype(np.float32)[corners])
    normal = np.einsum("nk,nkc->nc", weights, _normals(vertices, faces)[corners])
    view = _unit(EYE - place)
    normal = _unit(normal * np.sign(_dot(normal, view))[:, None])
    colour, gloss = _paint(names, place, owner[face.ravel()])
    casters, _ = sample_surface(vertices, faces[owner < 4], 200_000)
    light, shine = np.zeros(len(place)), np.zeros(len(place))
    centre, inside = _inside(face.shape, owner[face.ravel()], normal)
    lit = np.flatnonzero(~inside | (centre == np.arange(len(place))))
    light[lit], shine[lit] = _light(place[lit], normal[lit], view[lit], casters)
    light[inside], shine[inside] = light[centre[inside]], shine[centre[inside]]
    return (colour * light[:, None] + (gloss * shine)[:, None]).reshape(*face.shape, 3)


def _inside(
    shape: tuple[int, int], owner: np.ndarray, normal: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """For every sample (N,) the one in the middle of its pixel, and whether light varies little.

    Light is costly and smooth: it is computed for all samples of a pixel on an edge, else for one.
    """
    row, column = (FINER * (np.arange(n) // FINER) + FINER // 2 for n in shape)
    centre = (row[:, None] * shape[1] + column).ravel()
    alike = (owner == owner[centre]) & (_dot(normal, normal[centre]) > 0.97)
    blocks = alike.reshape(shape[0] // FINER, FINER, shape[1] // FINER, FINER)
    whole = blocks.all((1, 3)).repeat(FINER, 0).repeat(FINER, 1).ravel()
    return centre, whole


def _light(
    place: np.ndarray, normal: np.ndarray, view: np.ndarray, casters: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Diffuse and shining light (N,) at every place."""
    light, shine = np.full(len(place), 0.07), np.zeros(len(place))
    for where, power, is_lamp in _lights():
        to_light = _unit(where - place)
        open_to = _lit(casters, place + 0.0012 * normal, where) * power
        light += open_to * _dot(normal, to_light).clip(0)
        if is_lamp:
            shine += open_to * _dot(normal, _unit(to_light + view)).clip(0) ** 60
    return light, shine


def _lights() -> list[tuple[np.ndarray, float, bool]]:
    """Nine points of a square lamp, and eight of the sky: where, how strong, of the lamp."""
    steps = (-0.09, 0, 0.09)
    lamp = [(LAMP + [x, y, 0], 1.25 / 9, True) for x in steps for y in steps]
    turns = np.arange(8) * 2.39996
    heights = np.linspace(0.25, 0.95, 8)
    flat = np.sqrt(1 - heights**2)
    sky = 3 * np.stack([flat * np.cos(turns), flat * np.sin(turns), heights], 1)
    return lamp + [(direction, 0.4 / 8, False) for direction in sky]


def _lit(casters: np.ndarray, places: np.ndarray, lamp: np.ndarray) -> np.ndarray:
    """Which places (N, 3) the lamp sees: those that no caster is before, in a map of its view."""
    R, t = _look_at(lamp, np.array([0.0, 0.03, 0.03]))
    n = 340
    zoom = n * np.linalg.norm(lamp) / 0.62
    near = np.full(n * n, np.inf, np.float32)
    cell, z = _look(casters.astype(np.float32), R, t, zoom, n)
    np.minimum.at(near, cell, z)
    cell, z = _look(places, R, t, zoom, n)
    return z < near[cell] + 0.004


def _look(
    points: np.ndarray, R: np.ndarray, t: np.ndarray, zoom: float, n: int
) -> tuple[np.ndarray, np.ndarray]:
    """In which cell of an n x n map points are, and how far away."""
    x, y, z = (points @ R.T.astype(np.float32) + t.astype(np.float32)).T
    column, row = ((zoom * v / z + n / 2).astype(np.int32).clip(0, n - 1) for v in (x, y))
    return n * row + column, z


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("nc,nc->n", a, b)


def _unit(v: np.ndarray) -> np.ndarray:
    return (v / np.sqrt(_dot(v, v))[:, None]).astype(np.float32)


def _paint(names: list[str], place: np.ndarray, owner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The colour (N, 3) of what is at each place (N, 3), and how much it shines (N,)."""
    colour, gloss = np.zeros(place.shape), np.zeros(owner.shape)
    for number, name in enumerate(names):
        here = owner == number
        colour[here], gloss[here] = things.PAINTS[name](place[here])
    return colour, gloss


def _look_at(eye: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The pose of the world in a camera at `eye` that looks at `target`, the world's z axis up."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    return R, -R @ eye


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Of every vertex, the mean of its faces' normals (V, 3)."""
    a, b, c = vertices[faces].transpose(1, 0, 2)
    total = np.zeros(vertices.shape)
    np.add.at(total, faces, np.cross(b - a, c - a)[:, None])
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-15)
