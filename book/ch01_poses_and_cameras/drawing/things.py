"""The things on the table of chapter 1's stand-in picture: their meshes and their paint.

World: metres, z up, the table at z = 0. The mug's frame: z is its axis, x points out of the handle,
and the fish is painted on the side that -y points to. Faces go round counter-clockwise, seen from
outside.
"""

import numpy as np

from posecore import poses

__all__ = ["PAINTS", "can", "join", "mug", "scene", "turn"]

MUG_STANDS_AT, MUG_TURN = np.array([0.015, 0.0, 0.0475]), np.radians(-8)
CAN_STANDS_AT, CAN_TURN = np.array([-0.105, 0.075, 0.05]), 0.6
CREAM, BLUE, ORANGE, INK = (
    np.array(c) for c in ([0.86, 0.82, 0.72], [0.07, 0.2, 0.42], [0.85, 0.32, 0.06], [0.03] * 3)
)


def scene() -> list[tuple[np.ndarray, np.ndarray, str]]:
    """Vertices and faces in the world, and the name, of all things; the mug is the first."""
    ball = np.radians(np.linspace(-90, 90, 40))
    ball = 0.034 * np.stack([np.cos(ball), 0.96 * np.sin(ball)], 1)
    table = np.array([[-0.6, -0.28, 0], [0.6, -0.28, 0], [2, 2, 0], [-2, 2, 0]])
    quad = np.array([[0, 1, 2], [0, 2, 3]])
    box, box_faces = _box(np.array([0.15, 0.105, 0.028]))
    return [
        (poses.apply(turn(MUG_TURN), MUG_STANDS_AT, mug()[0]), mug()[1], "mug"),
        (poses.apply(turn(CAN_TURN), CAN_STANDS_AT, can()[0]), can()[1], "can"),
        (*_moved(_revolve(ball, 64), -0.078, -0.052, 0.0327, 0.0), "orange"),
        (*_moved((box, box_faces), 0.125, 0.135, 0.014, 0.5), "book"),
        (table, quad, "table"),
    ]


def mug(sections: int = 96, rings: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) and faces (F, 3) of the mug in its own frame; fewer for a quick outline."""
    profile = [
        [0, -44], [31, -44], [31, -46.6], [32.5, -47.5], [34.5, -47], [37, -43], [39, -35],
        [40, -20], [40, 0], [40, 20], [40, 40], [39.8, 46], [39, 47.3], [38, 47.5], [37, 47],
        [36.4, 45], [36, 30], [36, 0], [36, -25], [34.5, -36], [31, -41], [0, -42],
    ]  # fmt: skip
    body = _revolve(_refine(np.array(profile) / 1000, rings), sections)
    across = np.linspace(-np.pi / 2, np.pi / 2, 8 * rings + 1)
    path = np.stack([38.6 + 30 * np.cos(across) ** 0.8, 0 * across, 1 + 27 * np.sin(across)], 1)
    return join([body, _tube(path / 1000, 0.0048, 0.0066, sections // 4)])[:2]


def can(sections: int = 72, rings: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of the tin can, which any turn about its axis leaves as it is."""
    profile = [
        [0, -50], [32, -50], [33, -49], [33, -47], [32.3, -45], [32.3, 45], [33, 47], [33, 49],
        [32, 50], [31, 47], [0, 47],
    ]  # fmt: skip
    return _revolve(_refine(np.array(profile) / 1000, rings), sections)


def _paint_mug(place: np.ndarray) -> tuple[np.ndarray, float]:
    x, y, z = ((place - MUG_STANDS_AT) @ turn(MUG_TURN)).T  # in the mug's own frame
    radius = np.hypot(x, y)
    along = 0.04 * np.arctan2(x, -y)  # metres along the wall, 0 where the fish is
    outside = (radius > 0.0378) & (radius < 0.0412)
    colour = np.broadcast_to(CREAM, place.shape).copy()
    wave = 0.0022 * np.sin(along / 0.04 * 12)
    sea = (np.abs(z + 0.029 - wave) < 0.0022) | (np.abs(z + 0.036 - wave) < 0.0011)
    body = (along / 0.0185) ** 2 + ((z - 0.002) / 0.0105) ** 2
    tail = (along > 0.0145) & (along < 0.027) & (np.abs(z - 0.002) < 0.85 * (along - 0.0125))
    stripe = np.abs(np.mod(along + 0.004, 0.008) - 0.004) < 0.0011
    eye = np.hypot(along + 0.0115, z - 0.005)
    colour[outside & sea] = BLUE
    colour[outside & ((body < 1) | tail)] = ORANGE
    colour[outside & (body < 0.9) & stripe & (along > -0.006)] = 0.55 * ORANGE
    colour[outside & (eye < 0.0034)] = [0.9, 0.9, 0.86]
    colour[outside & (eye < 0.0017)] = INK
    for bubble in ([-0.024, 0.012, 0.0026], [-0.028, 0.02, 0.0018], [-0.0255, 0.027, 0.0012]):
        ring = np.hypot(along - bubble[0], z - bubble[1]) - bubble[2]
        colour[outside & (np.abs(ring) < 0.0006)] = BLUE
    colour[(z > 0.0445) | (radius > 0.0415)] = BLUE  # rim and handle
    return colour, 0.35


def _paint_can(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x, y, z = (place - CAN_STANDS_AT + [0, 0, 0.05]).T
    angle = np.arctan2(y, x)
    colour = np.tile([0.12, 0.3, 0.2], (len(z), 1))
    colour[np.abs(z - 0.052) < 0.021] = CREAM
    dots = np.hypot(np.mod(angle, 0.5) - 0.25, (z - 0.052) / 0.0323) < 0.15
    colour[dots] = [0.55, 0.09, 0.1]
    tin = (z < 0.006) | (z > 0.0945)
    colour[tin] = [0.42, 0.42, 0.43]
    return colour, np.where(tin, 0.6, 0.2)


def _paint_orange(place: np.ndarray) -> tuple[np.ndarray, float]:
    x, y, z = (place - [-0.078, -0.052, 0.0327]).T
    pores = _noise(0.034 * np.arctan2(y, x), 0.034 * np.arcsin((z / 0.0327).clip(-1, 1)), 0.0016)
    return np.array([0.85, 0.36, 0.04]) * (0.9 + 0.2 * pores[:, None]), 0.25


def _paint_book(place: np.ndarray) -> tuple[np.ndarray, float]:
    x, y, z = ((place - [0.125, 0.135, 0.014]) @ turn(0.5)).T
    colour = np.tile([0.33, 0.07, 0.09], (len(z), 1))
    frame = np.maximum(np.abs(x) / 0.075, np.abs(y) / 0.0525)
    colour[(z > 0.0138) & (np.abs(frame - 0.84) < 0.02)] = [0.75, 0.6, 0.3]
    pages = (np.abs(z) < 0.011) & ((x > 0.0745) | (np.abs(y) > 0.052))
    colour[pages] = [0.75, 0.71, 0.6]
    return colour, 0.08


def _paint_table(place: np.ndarray) -> tuple[np.ndarray, float]:
    x, y = place[:, 0] + 0.3 * place[:, 1], place[:, 1] - 0.3 * place[:, 0]
    plank = np.floor(y / 0.11)
    shift = 7.3 * plank
    grain = _noise(0.12 * x + shift, y + 0.01 * _noise(x + shift, y, 0.08), 0.0035)
    broad = _noise(0.3 * x + shift, y, 0.03)
    tone = 0.85 + 0.13 * np.sin(2.4 * plank) + 0.2 * (grain - 0.5) + 0.25 * (broad - 0.5)
    colour = np.array([0.36, 0.27, 0.19]) * tone[:, None]
    colour[np.abs(np.mod(y, 0.11) - 0.055) > 0.0543] *= 0.5
    return colour, 0.03


PAINTS = {
    "mug": _paint_mug,
    "can": _paint_can,
    "orange": _paint_orange,
    "book": _paint_book,
    "table": _paint_table,
}


def _noise(x: np.ndarray, y: np.ndarray, cell: float) -> np.ndarray:
    """Smooth random numbers in [0, 1] that vary over lengths of `cell`."""
    table = np.random.default_rng(1).random((64, 64))
    i, j = np.floor(x / cell).astype(int), np.floor(y / cell).astype(int)
    u, v = x / cell - i, y / cell - j
    u, v = u * u * (3 - 2 * u), v * v * (3 - 2 * v)
    near = table[i % 64, j % 64] * (1 - u) + table[(i + 1) % 64, j % 64] * u
    far = table[i % 64, (j + 1) % 64] * (1 - u) + table[(i + 1) % 64, (j + 1) % 64] * u
    return near * (1 - v) + far * v


def join(meshes: list) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One mesh of several, and which of them every face is from; -1 stays for "no face"."""
    starts = np.cumsum([0] + [len(v) for v, _ in meshes])
    faces = [f + start for (_, f), start in zip(meshes, starts, strict=False)]
    owner = np.repeat(np.arange(len(meshes)), [len(f) for f in faces])
    return np.concatenate([v for v, _ in meshes]), np.concatenate(faces), owner


def _refine(profile: np.ndarray, parts: int) -> np.ndarray:
    at = np.arange(len(profile))
    fine = np.linspace(0, len(profile) - 1, parts * (len(profile) - 1) + 1)
    return np.stack([np.interp(fine, at, column) for column in profile.T], 1)


def _revolve(profile: np.ndarray, sections: int) -> tuple[np.ndarray, np.ndarray]:
    """The surface that a profile (radius, z) sweeps about the z axis."""
    angles = np.linspace(0, 2 * np.pi, sections, endpoint=False)[:, None]
    r, z = profile.T
    rings = np.stack([r * np.cos(angles), r * np.sin(angles), z + 0 * angles], -1)
    return _skin(rings)


def _tube(
    path: np.ndarray, thick: float, wide: float, sections: int
) -> tuple[np.ndarray, np.ndarray]:
    """An elliptic tube around a path in the plane y = 0."""
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    up = np.cross([0, 1, 0], along)
    angles = np.linspace(0, 2 * np.pi, sections, endpoint=False)[:, None, None]
    return _skin(path + thick * np.cos(angles) * up + wide * np.sin(angles) * np.array([0, 1, 0]))


def _skin(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A grid (A, B, 3) of points as a mesh; its last row is joined to its first."""
    a, b = rows.shape[:2]
    corner = np.arange(a * b).reshape(a, b)
    one, two = corner[:, :-1], corner[:, 1:]
    three, four = np.roll(two, -1, 0), np.roll(one, -1, 0)
    quads = np.stack([one, four, three, two], -1).reshape(-1, 4)
    return rows.reshape(-1, 3), np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _box(size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A box around the origin; its sides share no corners, so that its edges stay sharp."""
    square = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]])
    sides = [np.roll(sign * square, turn, 1) for turn in range(3) for sign in (1, -1)]
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    outwards = [faces[:, :: 1 if i % 2 == 0 else -1] + 4 * i for i in range(6)]
    return np.concatenate(sides) * size / 2, np.concatenate(outwards)


def _moved(mesh: tuple, x: float, y: float, z: float, angle: float) -> tuple:
    return poses.apply(turn(angle), np.array([x, y, z]), mesh[0]), mesh[1]


def turn(angle: float) -> np.ndarray:
    """The rotation (3, 3) about z."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
