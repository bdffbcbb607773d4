"""The checks of chapter 2's exercises: what they are tried on, their hints, and what is right."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from book.tools.checks import Exercise
from posecore import cameras, rotations

SECONDS = 5.0
K = np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])

Inputs = Iterator[tuple]


# 1. The edge function ---------------------------------------------------------------------------


def edge_function(a: np.ndarray, b: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Twice the signed area (N,) of the triangles a, b, p; positive left of the way to b."""
    along, there = b - a, points - a
    return along[1] * there[:, 0] - along[0] * there[:, 1]


def _edges_and_points(rng: np.random.Generator) -> Inputs:
    origin, right = np.zeros(2), np.array([4.0, 0])
    yield "a point above a level edge", origin, right, np.array([[1.0, -2]])
    yield "a point below a level edge", origin, right, np.array([[1.0, 2]])
    yield "the same edge the other way round", right, origin, np.array([[1.0, -2]])
    yield "an upright edge", origin, np.array([0, 3.0]), np.array([[2.0, 1], [-2, 1]])
    line = np.array([[0.0, 0], [1, 0], [4, 0], [9, 0], [-9, 0]])
    yield "points on the line through the edge", origin, right, line
    for _ in range(3):
        a, b = rng.uniform(0, 100, size=(2, 2))
        yield "a random edge", a, b, rng.uniform(0, 100, size=(5, 2))
    yield "as many points as a point has coordinates", a, b, rng.uniform(0, 100, size=(2, 2))
    yield "an edge without length", a, a.copy(), rng.uniform(0, 100, size=(3, 2))
    yield "no points at all", a, b, np.zeros((0, 2))


check_edge_function = Exercise(
    edge_function,
    _edges_and_points,
    hints=(
        "Write d = b - a and q = points - a, rows of x and y. The area of the parallelogram that "
        "d and a row q span is the determinant of the two.",
        "d[1] * q[:, 0] - d[0] * q[:, 1]. If the sign is wrong: y runs down, so a point above an "
        "edge that goes to the right has a smaller y, and must be positive. Nothing is divided, so "
        "no edge is too short.",
    ),
    tolerance=1e-9,
    seconds=SECONDS,
)


# 2. What lies between the corners -----------------------------------------------------------------


def interpolate(weights: np.ndarray, depths: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The values (N, C) on the triangle in space, at pixels with these weights (N, 3)."""
    shares = weights / depths
    return shares / shares.sum(1, keepdims=True) @ values


def _weights_and_corners(rng: np.random.Generator) -> Inputs:
    def weights(count: int) -> np.ndarray:
        return rng.dirichlet(np.ones(3), size=count)

    ramp, corners = np.array([[0.0], [1], [1]]), np.eye(3)
    yield "corners that are equally far", weights(2), np.full(3, 2.0), ramp
    halfway = np.array([[0.5, 0.5, 0]])
    yield "halfway between a corner at 1 m and one at 3 m", halfway, np.array([1.0, 3, 3]), ramp
    depths = np.array([1.0, 2, 4])
    yield "the corners themselves", np.eye(3), depths, corners
    yield "the depth as value: 1 / z is linear", weights(3), depths, depths[:, None]
    yield "values of both signs", weights(3), depths, np.array([[-1.0, 2], [0, 0], [1, -3]])
    for _ in range(3):
        depths = rng.uniform(0.2, 5, size=3)
        yield "a random triangle", weights(6), depths, rng.normal(size=(3, 2))
        yield "a random triangle, three values", weights(3), depths, rng.normal(size=(3, 3))
    beyond = np.array([[1.2, -0.1, -0.1]])
    yield "a pixel just outside", beyond, np.array([1.0, 1.5, 2]), rng.normal(size=(3, 2))
    yield "no pixels at all", np.zeros((0, 3)), depths, corners


check_interpolate = Exercise(
    interpolate,
    _weights_and_corners,
    hints=(
        "Along the image it is value / z that changes evenly, and 1 / z, too. Interpolate both "
        "with the weights, and divide.",
        "w = weights / depths has a column for each corner. Let each row sum to 1: "
        "w / w.sum(1, keepdims=True). These are the weights on the triangle in space, and @ values "
        "does the rest.",
    ),
    tolerance=1e-9,
    seconds=SECONDS,
)


# 3. The z-buffer ----------------------------------------------------------------------------------


def merge_layers(layers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What is seen of N layers (N, H, W): its depth (H, W), and which layer it is (H, W)."""
    depth = np.zeros(layers.shape[1:])
    instance = np.full(layers.shape[1:], -1)
    for number, layer in enumerate(layers):
        nearer = (layer > 0) & ((instance < 0) | (layer < depth))
        depth = np.where(nearer, layer, depth)
        instance = np.where(nearer, number, instance)
    return depth, instance


def _layers(rng: np.random.Generator, shape: tuple[int, ...], empty: float) -> np.ndarray:
    """Depths with two digits, so that some are equal, and a share of pixels without."""
    depth = rng.integers(1, 9, size=shape) / 4
    return np.where(rng.random(shape) < empty, 0.0, depth)


def _layers_to_merge(rng: np.random.Generator) -> Inputs:
    yield "one layer without holes", np.array([[[1.0, 2]]])
    yield "two layers, the second nearer", np.array([[[2.0, 2]], [[1, 1.5]]])
    yield "a near layer with a hole", np.array([[[1.0, 0]], [[2, 2]]])
    yield "a pixel that is empty in all layers", np.array([[[0.0, 1]], [[0, 2]]])
    yield "two layers equally far", np.array([[[1.0, 2]], [[1, 2]]])
    for _ in range(3):
        yield "random layers", _layers(rng, (4, 3, 5), 0.5)
        yield "random layers far away", 1000 * _layers(rng, (3, 2, 4), 0.5)
    yield "layers with nothing in them", np.zeros((3, 2, 2))
    yield "no layers at all", np.zeros((0, 2, 3))


check_merge_layers = Exercise(
    merge_layers,
    _layers_to_merge,
    hints=(
        "0 says that there is nothing, but it is also the smallest number. Put np.inf there first, "
        "in a copy: np.where(layers > 0, layers, np.inf).",
        "np.argmin over axis 0 takes the first of equals, and fails without any layer. A loop over "
        "the layers does not: begin with depth 0 and instance -1 everywhere, and replace where the "
        "layer is above 0 and the pixel is empty or farther.",
    ),
    tolerance=1e-9,
    seconds=SECONDS,
)


# 4. Cut at the near plane -------------------------------------------------------------------------


def clip_near(triangle: np.ndarray, near: float) -> np.ndarray:
    """The corners (M, 3), in order, of the part of a triangle (3, 3) that is at z >= near."""
    z = triangle[:, 2]
    if not (z > near).any() and not (z == near).all():
        return np.zeros((0, 3))
    corners = []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        if z[i] >= near:
            corners.append(triangle[i])
        if (z[i] - near) * (z[j] - near) < 0:
            share = (near - z[i]) / (z[j] - z[i])
            corners.append(triangle[i] + share * (triangle[j] - triangle[i]))
    return np.array(corners)


def _triangles_to_cut(rng: np.random.Generator) -> Inputs:
    def triangle(*z: float) -> np.ndarray:
        return np.array([[0.0, 0, z[0]], [2, 0, z[1]], [0, 1, z[2]]])

    yield "a triangle in front", triangle(1, 2, 3), 0.5
    yield "a triangle behind", triangle(-1, 0, 0.25), 0.5
    for number in range(3):
        corner = ("first", "second", "third")[number]
        z = np.roll([2.0, 0, 0], number)
        yield f"only the {corner} corner in front", triangle(*z), 0.5
        yield f"only the {corner} corner behind", triangle(*(2 - z)), 0.5
    for _ in range(4):
        yield "a random triangle", rng.normal(size=(3, 3)), 0.1
    yield "a corner on the plane, two in front", triangle(0.5, 2, 1), 0.5
    yield "a corner on the plane, two behind", triangle(0.5, 0, -1), 0.5
    yield "a corner on the plane, one in front, one behind", triangle(0.5, 2, -1), 0.5
    yield "the same, the other way round", triangle(0.5, -1, 2), 0.5
    yield "an edge on the plane, the third corner in front", triangle(0.5, 0.5, 2), 0.5
    yield "an edge on the plane, the third corner behind", triangle(2 - 1.5, 0.5, 0), 0.5
    yield "a triangle in the plane", triangle(0.5, 0.5, 0.5), 0.5


def _is_that_polygon(answer: np.ndarray, triangle: np.ndarray, near: float) -> str:
    expected = clip_near(triangle, near)
    turns = [np.roll(expected, k, axis=0) for k in range(max(1, len(expected)))]
    if any(np.allclose(answer, turn, rtol=0, atol=1e-9) for turn in turns):
        return ""
    before, wanted, came = (np.round(c, 3).tolist() for c in (triangle, expected, answer))
    return f"of {before} expected {wanted}, beginning anywhere but in this order, got {came}"


check_clip_near = Exercise(
    clip_near,
    _triangles_to_cut,
    hints=(
        "Walk around the triangle. A corner with z >= near stays. Where an edge from P to Q "
        "crosses the plane, add P + s (Q - P) with s = (near - P_z) / (Q_z - P_z).",
        "An edge crosses only if one end is really in front and the other really behind; with an "
        "end on the plane it does not, or that corner comes twice. And if no corner is really in "
        "front, return np.zeros((0, 3)), unless all three are on the plane.",
    ),
    judge=_is_that_polygon,
    seconds=SECONDS,
)


# 5. How much of it is seen ------------------------------------------------------------------------


def visible_fraction(layers: np.ndarray, margin: int) -> np.ndarray:
    """The share (N,) that the camera sees of each object's whole silhouette."""
    height, width = layers.shape[1:]
    image = layers[:, margin : height - margin, margin : width - margin]
    _, instance = merge_layers(image)
    seen = np.array([(instance == number).sum() for number in range(len(layers))])
    return seen / np.maximum((layers > 0).sum((1, 2)), 1)


def _canvases(rng: np.random.Generator) -> Inputs:
    def canvas(*boxes: tuple[int, int, int, int, float]) -> np.ndarray:
        """Layers of 6 x 8 pixels, each a box: its rows, its columns, its depth."""
        layers = np.zeros((len(boxes), 6, 8))
        for layer, (top, bottom, left, right, depth) in zip(layers, boxes, strict=True):
            layer[top:bottom, left:right] = depth
        return layers

    yield "an object inside the image", canvas((2, 4, 2, 5, 1)), 1
    yield "an object half outside the image", canvas((2, 4, 0, 2, 1)), 1
    yield "an object outside the image", canvas((0, 1, 0, 3, 1), (2, 3, 2, 3, 1)), 1
    yield "an object behind another", canvas((1, 5, 1, 4, 2), (2, 4, 2, 7, 1)), 1
    yield "an object behind another and half outside", canvas((1, 5, 0, 4, 2), (0, 3, 2, 7, 1)), 1
    yield "two objects equally far", canvas((1, 3, 2, 6, 1), (2, 4, 2, 6, 1)), 1
    yield "an object of no pixel", canvas((1, 3, 2, 6, 1), (3, 3, 2, 6, 1)), 1
    yield "no margin around the image", canvas((1, 5, 1, 4, 2), (2, 4, 2, 7, 1)), 0
    for _ in range(4):
        yield "random objects", _layers(rng, (3, 7, 9), 0.6), 2


check_visible_fraction = Exercise(
    visible_fraction,
    _canvases,
    hints=(
        "Cut the image out of the canvas and merge the layers there: that says who is seen. The "
        "silhouette's pixels are counted on the whole canvas.",
        "With margin 0, layers[:, margin:-margin] is empty; write height - margin for the end. "
        "And divide by np.maximum(count, 1), so that an object of no pixel gives 0.",
    ),
    tolerance=1e-9,
    seconds=SECONDS,
)


# 6. Turn the picture ------------------------------------------------------------------------------


def turn_picture(
    R: np.ndarray, t: np.ndarray, K: np.ndarray, angle: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The pose (R, t) in the turned picture, and the map (3, 3) from old pixels to new ones."""
    turn = rotations.axis_angle_to_matrix(np.array([0, 0, angle]))
    return turn @ R, turn @ t, K @ turn @ np.linalg.inv(K)


def _pictures_to_turn(rng: np.random.Generator) -> Inputs:
    ahead, aside = np.array([0, 0, 1.0]), np.array([0.1, -0.2, 0.8])
    pixels = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])
    yield "a turn by 0", np.eye(3), ahead, K, 0.0
    yield "a quarter turn, in pixels from the axis", np.eye(3), ahead, pixels, np.pi / 2
    yield "a quarter turn, an object beside the axis", np.eye(3), aside, K, np.pi / 2
    for _ in range(2):
        R, angle = rotations.random_rotations(generator=rng), rng.uniform(-3, 3)
        yield "a random turn", R, aside, K, angle
    crop = np.array([[600.0, 0, 20], [0, 600, -35], [0, 0, 1]])
    yield "a principal point that is not in the middle", R, aside, crop, 0.5
    stretched = np.array([[400.0, 0, 100], [0, 500, 80], [0, 0, 1]])
    yield "another camera, fx and fy differ", R, aside, stretched, 0.5
    skewed = np.array([[400.0, 30, 100], [0, 500, 80], [0, 0, 1]])
    yield "a camera with skew", R, aside, skewed, -0.7


check_turn_picture = Exercise(
    turn_picture,
    _pictures_to_turn,
    hints=(
        "Turn the points and not the pixels: with the turn Z about the optical axis, a point X of "
        "the camera's frame becomes Z X. So both R and t get Z from the left.",
        "A pixel p = (x, y, 1) belongs to the ray inv(K) p. Turn the ray and project it again: "
        "A = K @ Z @ np.linalg.inv(K), with Z = [[c, -s, 0], [s, c, 0], [0, 0, 1]].",
    ),
    tolerance=1e-9,
    seconds=SECONDS,
)


# 7. Undo the lamp ---------------------------------------------------------------------------------

SURE, UNSURE = 0.03, 0.3
"""Standard deviations of the albedo, below which a pixel has to be known and above which not."""


def recover_albedo(
    brightness: np.ndarray,
    depth: np.ndarray,
    normals: np.ndarray,
    K: np.ndarray,
    power: float,
    noise: float,
) -> np.ndarray:
    """The albedo (H, W) of what a camera with a lamp at its centre sees, NaN where unknown."""
    albedo, deviation = _undone(brightness, depth, normals, K, power, noise)
    return np.where((brightness < 1) & (deviation < 0.1), albedo, np.nan)


def _undone(
    brightness: np.ndarray,
    depth: np.ndarray,
    normals: np.ndarray,
    K: np.ndarray,
    power: float,
    noise: float,
) -> tuple[np.ndarray, np.ndarray]:
    """The albedo and its standard deviation, infinite where nothing is lit or depth is missing."""
    points = cameras.back_project(depth, K)
    squared = (points**2).sum(-1)
    distance = np.sqrt(squared)
    cosine = -(points * normals).sum(-1) / np.where(depth > 0, distance, 1)
    lit = (depth > 0) & (cosine > 0)
    factor = np.where(lit, squared, np.inf) / (power * np.where(lit, cosine, 1))
    return np.where(lit, brightness, 0) * np.where(lit, factor, 0), noise * factor


def _scenes_by_lamp(rng: np.random.Generator) -> Inputs:
    camera = np.array([[8.0, 0, 3.5], [0, 8, 2.5], [0, 0, 1]])
    shape = 6, 8
    upright = np.zeros((*shape, 3)) - [0, 0, 1]
    noise = 0.005

    def lit(depth: np.ndarray, normals: np.ndarray, power: float) -> np.ndarray:
        _, deviation = _undone(depth, depth, normals, camera, power, 1.0)
        clean = rng.uniform(0.1, 0.8, size=shape) / deviation
        return np.clip(clean + noise * rng.normal(size=shape), 0, 1)

    wall = np.full(shape, 0.6)
    yield "a wall", lit(wall, upright, 0.3), wall, upright, camera, 0.3, noise
    yield "a brighter lamp", lit(wall, upright, 0.4), wall, upright, camera, 0.4, noise
    slope = -np.array([0.6, 0, 0.8])
    x = (np.arange(8) - 3.5) / 8
    tilted = np.broadcast_to(0.5 / (0.6 * x + 0.8), shape).copy()
    normals = np.broadcast_to(slope, (*shape, 3)).copy()
    yield "a tilted wall", lit(tilted, normals, 0.2), tilted, normals, camera, 0.2, noise
    holes = np.where(rng.random(shape) < 0.3, 0, 0.6)
    seen = upright * (holes > 0)[..., None]
    yield "a wall with holes in its depth", lit(holes, seen, 0.3), holes, seen, camera, 0.3, noise
    near = np.where(np.arange(8) < 4, 0.2, 0.6) * np.ones(shape)
    yield (
        "a thing so near that it is white",
        lit(near, upright, 0.4),
        near,
        upright,
        camera,
        0.4,
        noise,
    )
    far = np.where(np.arange(8) < 4, 0.6, 5.0) * np.ones(shape)
    yield (
        "a background too far for the lamp",
        lit(far, upright, 0.4),
        far,
        upright,
        camera,
        0.4,
        noise,
    )
    turned = upright.copy()
    turned[:, 4:] = [-0.6, 0, 0.8]
    yield "normals that look away", lit(wall, turned, 0.4), wall, turned, camera, 0.4, noise


def _is_recovered(
    answer: np.ndarray,
    brightness: np.ndarray,
    depth: np.ndarray,
    normals: np.ndarray,
    K: np.ndarray,
    power: float,
    noise: float,
) -> str:
    albedo, deviation = _undone(brightness, depth, normals, K, power, noise)
    white, hole = brightness >= 1, depth == 0
    known = ~np.isnan(answer)
    clipped = np.clip(answer, 0, 1), np.clip(albedo, 0, 1)  # more than all light nobody returns
    for wrong, expected in (
        (known & hole, "nan, as the depth is missing"),
        (known & white, "nan, as the pixel is white, so that more light would look the same"),
        (known & (deviation > UNSURE), "nan, as noise alone makes more of it than {noise:.2g}"),
        (
            ~known & ~white & (deviation < SURE),
            "{albedo:.3g}, as the noise makes {noise:.2g} of it",
        ),
        (known & ~np.isclose(*clipped, rtol=0, atol=1e-6), "{albedo:.3g}"),
    ):
        if wrong.any():
            place = tuple(np.argwhere(wrong)[0].tolist())
            value = expected.format(albedo=albedo[place], noise=min(deviation[place], 1))
            return f"expected {value}, at [{place[0]}, {place[1]}], got {answer[place]:.3g}"
    return ""


check_recover_albedo = Exercise(
    recover_albedo,
    _scenes_by_lamp,
    hints=(
        "X = cameras.back_project(depth, K) is where each pixel's point is, and the lamp is at the "
        "origin. So r = |X|, which is longer than z, and the cosine is -(normal . X) / r.",
        "albedo = brightness r^2 / (power cos). The noise is multiplied by the same factor: where "
        "noise r^2 / (power cos) is above 0.1, say NaN. Also where the depth is 0, where the "
        "brightness is 1 and where the cosine is not above 0.",
    ),
    judge=_is_recovered,
    seconds=SECONDS,
)
