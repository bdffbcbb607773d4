"""Chapter 2's exercises, solved as students would: rightly and wrongly."""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from posecore import cameras
from tests.book.exercises import Solutions

SOLUTIONS = Solutions()
right, wrong = SOLUTIONS.right, SOLUTIONS.wrong


@right("edge_function")
def edge_by_determinants(a: Any, b: Any, points: Any) -> np.ndarray:
    triangles = [np.array([[1, *a], [1, *p], [1, *b]]) for p in points]
    return np.array([np.linalg.det(triangle) for triangle in triangles])


@wrong("edge_function", "a point above a level edge", "[8.], got")
def edge_of_a_textbook(a: Any, b: Any, points: Any) -> np.ndarray:
    d, q = b - a, points - a
    return d[0] * q[:, 1] - d[1] * q[:, 0]


@wrong("edge_function", "a point above a level edge", "[4.]")
def edge_as_area(a: Any, b: Any, points: Any) -> np.ndarray:
    return -edge_of_a_textbook(a, b, points) / 2


@wrong("edge_function", "a point below a level edge", "[8.]")
def edge_without_sign(a: Any, b: Any, points: Any) -> np.ndarray:
    return np.abs(edge_of_a_textbook(a, b, points))


@wrong("edge_function", "a point above a level edge", "[2.]")
def edge_as_distance(a: Any, b: Any, points: Any) -> np.ndarray:
    return -edge_of_a_textbook(a, b, points) / np.linalg.norm(b - a)


@wrong("edge_function", "a random edge", "got")
def edge_from_the_origin(a: Any, b: Any, points: Any) -> np.ndarray:
    return -edge_of_a_textbook(0 * a, b - a, points)


@wrong("edge_function", "a point above a level edge", "got")
def edge_of_rows_and_columns(a: Any, b: Any, points: Any) -> np.ndarray:
    return -edge_of_a_textbook(a, b, points[:, ::-1])


@wrong("edge_function", "a point above a level edge", "got")
def edge_by_dot_product(a: Any, b: Any, points: Any) -> np.ndarray:
    return (points - a) @ (b - a)


@wrong("edge_function", "a point above a level edge", "Error")
def edge_mixing_rows_and_columns(a: Any, b: Any, points: Any) -> np.ndarray:
    d, q = b - a, points - a
    return d[1] * q[0] - d[0] * q[1]


@wrong("edge_function", "an edge without length", "raised ValueError")
def edge_refusing_no_length(a: Any, b: Any, points: Any) -> np.ndarray:
    if (a == b).all():
        raise ValueError("no edge")
    return -edge_of_a_textbook(a, b, points)


@wrong("edge_function", "a point above a level edge", "[1.]")
def edge_as_sign(a: Any, b: Any, points: Any) -> np.ndarray:
    return np.sign(-edge_of_a_textbook(a, b, points))


# 2. What lies between the corners -----------------------------------------------------------------


@right("interpolate")
def interpolate_one_by_one(weights: Any, depths: Any, values: Any) -> np.ndarray:
    result = np.empty((len(weights), values.shape[1]))
    for row, w in enumerate(weights):
        z = 1 / (w / depths).sum()
        result[row] = sum(z * w[k] * values[k] / depths[k] for k in range(3))
    return result


@wrong("interpolate", "halfway between a corner at 1 m", "[[0.5]]")
def interpolate_by_weights_alone(weights: Any, depths: Any, values: Any) -> np.ndarray:
    return weights @ values


@wrong("interpolate", "halfway between a corner at 1 m", "[[0.75]]")
def interpolate_by_depths(weights: Any, depths: Any, values: Any) -> np.ndarray:
    shares = weights * depths
    return shares / shares.sum(1, keepdims=True) @ values


@wrong("interpolate", "corners that are equally far", "got")
def interpolate_undivided(weights: Any, depths: Any, values: Any) -> np.ndarray:
    return weights / depths @ values


@wrong("interpolate", "halfway between a corner at 1 m", "got")
def interpolate_by_linear_depth(weights: Any, depths: Any, values: Any) -> np.ndarray:
    return (weights / depths @ values) * (weights @ depths)[:, None]


@wrong("interpolate", "corners that are equally far", "got")
def interpolate_reciprocals(weights: Any, depths: Any, values: Any) -> np.ndarray:
    return 1 / (weights @ (1 / values))


@wrong("interpolate", "the corners themselves", "got")
def interpolate_with_one_sum(weights: Any, depths: Any, values: Any) -> np.ndarray:
    shares = weights / depths
    return shares / shares.sum() * len(weights) @ values


@wrong("interpolate", "corners that are equally far", "shape (2,)")
def interpolate_without_columns(weights: Any, depths: Any, values: Any) -> np.ndarray:
    shares = weights / depths
    return (shares / shares.sum(1, keepdims=True) @ values)[:, 0]


@wrong("interpolate", "a pixel just outside", "got")
def interpolate_cutting_weights(weights: Any, depths: Any, values: Any) -> np.ndarray:
    return interpolate_one_by_one(np.clip(weights, 0, 1), depths, values)


# 3. The z-buffer ----------------------------------------------------------------------------------


@right("merge_layers")
def merge_by_argmin(layers: Any) -> Any:
    none = np.full((1, *layers.shape[1:]), np.inf)
    far = np.concatenate([np.where(layers > 0, layers, np.inf), none])
    instance, depth = far.argmin(0), far.min(0)
    nothing = np.isinf(depth)
    return np.where(nothing, 0, depth), np.where(nothing, -1, instance)


@wrong("merge_layers", "a near layer with a hole", "got")
def merge_with_zeros(layers: Any) -> Any:
    instance = layers.argmin(0) if len(layers) else np.full(layers.shape[1:], -1)
    return layers.min(0, initial=np.inf), instance


@wrong("merge_layers", "two layers, the second nearer", "got")
def merge_the_farthest(layers: Any) -> Any:
    instance = np.where(layers.any(0), layers.argmax(0), -1)
    return layers.max(0), instance


@wrong("merge_layers", "two layers equally far", "in result [1]")
def merge_to_the_last(layers: Any) -> Any:
    depth, instance = merge_by_argmin(layers[::-1])
    return depth, np.where(instance >= 0, len(layers) - 1 - instance, -1)


@wrong("merge_layers", "a pixel that is empty in all layers", "[[0, 0]]")
def merge_naming_nothing_0(layers: Any) -> Any:
    depth, instance = merge_by_argmin(layers)
    return depth, np.maximum(instance, 0)


@wrong("merge_layers", "one layer without holes", "got")
def merge_counting_from_1(layers: Any) -> Any:
    depth, instance = merge_by_argmin(layers)
    return depth, instance + 1


@wrong("merge_layers", "a pixel that is empty in all layers", "inf")
def merge_leaving_infinity(layers: Any) -> Any:
    depth, instance = merge_by_argmin(layers)
    return np.where(instance < 0, np.inf, depth), instance


@wrong("merge_layers", "random layers far away", "got")
def merge_with_a_far_plane(layers: Any) -> Any:
    depth, instance = merge_by_argmin(np.where(layers < 1000, layers, 0))
    return depth, instance


@wrong("merge_layers", "a near layer with a hole", "work on a copy")
def merge_changing_layers(layers: Any) -> Any:
    layers[layers == 0] = np.inf
    return merge_by_argmin(np.where(np.isinf(layers), 0, layers))


@wrong("merge_layers", "no layers at all", "raised ValueError")
def merge_some_layers_only(layers: Any) -> Any:
    far = np.where(layers > 0, layers, np.inf)
    instance = np.where(layers.any(0), far.argmin(0), -1)
    return np.where(layers.any(0), far.min(0), 0), instance


@wrong("merge_layers", "one layer without holes", "whole numbers")
def merge_with_numbers_as_floats(layers: Any) -> Any:
    depth, instance = merge_by_argmin(layers)
    return depth, instance.astype(float)


@wrong("merge_layers", "one layer without holes", "expected a tuple")
def merge_into_one(layers: Any) -> Any:
    return merge_by_argmin(layers)[0]


# 4. Cut at the near plane -------------------------------------------------------------------------


def walk(triangle: Any, near: float, crosses: Callable[[float, float], bool]) -> np.ndarray:
    corners = []
    for P, Q in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
        if P[2] >= near:
            corners.append(P)
        if crosses(P[2] - near, Q[2] - near):
            corners.append(P + (near - P[2]) / (Q[2] - P[2]) * (Q - P))
    return np.array(corners).reshape(-1, 3)


@right("clip_near")
def clip_and_tidy_up(triangle: Any, near: float) -> np.ndarray:
    found = walk(triangle, near, lambda p, q: (p < 0) != (q < 0))
    corners = [
        c for k, c in enumerate(found) if not any(np.allclose(c, d, atol=1e-12) for d in found[:k])
    ]
    return np.array(corners) if len(corners) > 2 else np.zeros((0, 3))


@right("clip_near")
def clip_beginning_elsewhere(triangle: Any, near: float) -> np.ndarray:
    return np.roll(clip_and_tidy_up(triangle, near), 1, axis=0)


@wrong("clip_near", "a corner on the plane, two behind", "shape (1, 3)")
def clip_leaving_points(triangle: Any, near: float) -> np.ndarray:
    return walk(triangle, near, lambda p, q: p * q < 0)


@wrong("clip_near", "a corner on the plane, one in front", "(4, 3)")
def clip_with_corners_twice(triangle: Any, near: float) -> np.ndarray:
    found = walk(triangle, near, lambda p, q: (p < 0) != (q < 0))
    return found if (triangle[:, 2] > near).any() else clip_and_tidy_up(triangle, near)


@wrong("clip_near", "a triangle in the plane", "got shape (0, 3)")
def clip_strictly(triangle: Any, near: float) -> np.ndarray:
    keep = triangle[:, 2] > near
    return clip_and_tidy_up(triangle, near) if keep.any() else np.zeros((0, 3))


@wrong("clip_near", "only the first corner in front", "got [[")
def clip_nothing(triangle: Any, near: float) -> np.ndarray:
    return triangle if (triangle[:, 2] >= near).any() else np.zeros((0, 3))


@wrong("clip_near", "only the first corner in front", "got shape (0, 3)")
def clip_to_nothing(triangle: Any, near: float) -> np.ndarray:
    return triangle if (triangle[:, 2] >= near).all() else np.zeros((0, 3))


@wrong("clip_near", "only the first corner in front", "got [[")
def clip_by_pushing(triangle: Any, near: float) -> np.ndarray:
    pushed = triangle.copy()
    pushed[:, 2] = np.maximum(pushed[:, 2], near)
    return pushed if (triangle[:, 2] > near).any() else np.zeros((0, 3))


@wrong("clip_near", "a triangle in front", "got shape (0, 3)")
def clip_what_is_in_front(triangle: Any, near: float) -> np.ndarray:
    return clip_and_tidy_up(triangle * [1, 1, -1], -near) * [1, 1, -1]


@wrong("clip_near", "a triangle in front", "in this order")
def clip_the_other_way_round(triangle: Any, near: float) -> np.ndarray:
    return clip_and_tidy_up(triangle, near)[::-1]


@wrong("clip_near", "only the first corner behind", "in this order")
def clip_with_cuts_last(triangle: Any, near: float) -> np.ndarray:
    corners = clip_and_tidy_up(triangle, near)
    cut = ~(corners[:, None] == triangle).all(-1).any(-1)
    return np.concatenate([corners[~cut], corners[cut]])


@wrong("clip_near", "only the first corner in front", "got [[")
def clip_by_the_wrong_share(triangle: Any, near: float) -> np.ndarray:
    corners = []
    for P, Q in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
        if P[2] >= near:
            corners.append(P)
        if (P[2] < near) != (Q[2] < near):
            corners.append(P + (Q[2] - near) / (Q[2] - P[2]) * (Q - P))
    return np.array(corners).reshape(-1, 3)


@wrong("clip_near", "a triangle behind", "got shape (0,)")
def clip_to_a_flat_nothing(triangle: Any, near: float) -> np.ndarray:
    corners = clip_and_tidy_up(triangle, near)
    return corners if len(corners) else np.array([])


# 5. How much of it is seen ------------------------------------------------------------------------


@right("visible_fraction")
def visible_by_comparing(layers: Any, margin: int) -> np.ndarray:
    far = np.where(layers > 0, layers, np.inf)
    first = np.array(
        [
            (layer < np.inf) & (layer < far[:k].min(0, initial=np.inf)) & (layer <= far[k:].min(0))
            for k, layer in enumerate(far)
        ]
    )
    _, height, width = layers.shape
    shares = []
    for k in range(len(layers)):
        seen = first[k][margin : height - margin, margin : width - margin].sum()
        total = (layers[k] > 0).sum()
        shares.append(seen / total if total else 0.0)
    return np.array(shares)


@wrong("visible_fraction", "an object half outside the image", "got")
def visible_of_the_inside(layers: Any, margin: int) -> np.ndarray:
    _, height, width = layers.shape
    return visible_by_comparing(layers[:, margin : height - margin, margin : width - margin], 0)


@wrong("visible_fraction", "an object half outside the image", "got")
def visible_anywhere(layers: Any, margin: int) -> np.ndarray:
    return visible_by_comparing(layers, 0)


@wrong("visible_fraction", "an object behind another", "got")
def visible_through_others(layers: Any, margin: int) -> np.ndarray:
    _, height, width = layers.shape
    inside = layers[:, margin : height - margin, margin : width - margin]
    return (inside > 0).sum((1, 2)) / np.maximum((layers > 0).sum((1, 2)), 1)


@wrong("visible_fraction", "an object of no pixel", "nan")
def visible_nan_for_none(layers: Any, margin: int) -> np.ndarray:
    shares = visible_by_comparing(layers, margin)
    return np.where(layers.any((1, 2)), shares, np.nan)


@wrong("visible_fraction", "an object of no pixel", "got")
def visible_all_of_none(layers: Any, margin: int) -> np.ndarray:
    return np.where(layers.any((1, 2)), visible_by_comparing(layers, margin), 1.0)


@wrong("visible_fraction", "no margin around the image", "got")
def visible_with_minus_margin(layers: Any, margin: int) -> np.ndarray:
    image = layers[:, margin:-margin, margin:-margin]
    _, instance = merge_by_argmin(image)
    seen = np.array([(instance == k).sum() for k in range(len(layers))])
    return seen / np.maximum((layers > 0).sum((1, 2)), 1)


@wrong("visible_fraction", "two objects equally far", "got")
def visible_both_of_equals(layers: Any, margin: int) -> np.ndarray:
    _, height, width = layers.shape
    image = layers[:, margin : height - margin, margin : width - margin]
    nearest = np.where(image > 0, image, np.inf).min(0)
    return (image == nearest).sum((1, 2)) / np.maximum((layers > 0).sum((1, 2)), 1)


@wrong("visible_fraction", "an object inside the image", "got")
def visible_of_the_image(layers: Any, margin: int) -> np.ndarray:
    total = np.maximum((layers > 0).sum((1, 2)), 1)
    return visible_by_comparing(layers, margin) * total / layers[0].size


# 6. Turn the picture ------------------------------------------------------------------------------


def turn(angle: float) -> np.ndarray:
    return np.vstack([np.c_[cv2.getRotationMatrix2D((0, 0), -np.rad2deg(angle), 1)], [0, 0, 1]])


@right("turn_picture")
def turn_by_opencv(R: Any, t: Any, K: Any, angle: float) -> Any:
    Z = cv2.Rodrigues(np.array([0, 0, angle]))[0]
    corners = np.array([[0, 0], [100, 0], [0, 100]], np.float32)
    rays = np.c_[corners, np.ones(3)] @ np.linalg.inv(K).T @ Z.T
    A = cv2.getAffineTransform(corners, cameras.project(K, rays).astype(np.float32))
    exact = K @ Z @ np.linalg.inv(K)  # that of OpenCV has the digits of float32 only
    assert np.allclose(A, exact[:2], atol=1e-3)
    return Z @ R, Z @ t, exact


@wrong("turn_picture", "a quarter turn, in pixels from the axis", "got")
def turn_against_the_clock(R: Any, t: Any, K: Any, angle: float) -> Any:
    return turn_by_opencv(R, t, K, -angle)


@wrong("turn_picture", "a quarter turn, an object beside", "result [1]")
def turn_the_rotation_only(R: Any, t: Any, K: Any, angle: float) -> Any:
    R_new, _, A = turn_by_opencv(R, t, K, angle)
    return R_new, t, A


@wrong("turn_picture", "a random turn", "in result [0]")
def turn_the_object(R: Any, t: Any, K: Any, angle: float) -> Any:
    _, t_new, A = turn_by_opencv(R, t, K, angle)
    return R @ turn(angle), t_new, A


@wrong("turn_picture", "a quarter turn, in pixels from", "in result [2]")
def turn_about_the_middle(R: Any, t: Any, K: Any, angle: float) -> Any:
    R_new, t_new, _ = turn_by_opencv(R, t, K, angle)
    to = np.array([[1, 0, 320], [0, 1, 240], [0, 0, 1]])
    return R_new, t_new, to @ turn(angle) @ np.linalg.inv(to)


@wrong("turn_picture", "a quarter turn, an object", "in result [2]")
def turn_about_the_first_pixel(R: Any, t: Any, K: Any, angle: float) -> Any:
    return *turn_by_opencv(R, t, K, angle)[:2], turn(angle)


@wrong("turn_picture", "another camera, fx and fy differ", "result [2]")
def turn_pixels_as_if_square(R: Any, t: Any, K: Any, angle: float) -> Any:
    R_new, t_new, _ = turn_by_opencv(R, t, K, angle)
    to = np.array([[1, 0, K[0, 2]], [0, 1, K[1, 2]], [0, 0, 1]])
    return R_new, t_new, to @ turn(angle) @ np.linalg.inv(to)


@wrong("turn_picture", "a camera with skew", "in result [2]")
def turn_without_skew(R: Any, t: Any, K: Any, angle: float) -> Any:
    straight = K.copy()
    straight[0, 1] = 0
    return turn_by_opencv(R, t, straight, angle)


@wrong("turn_picture", "a quarter turn, in pixels from the axis", "result [2]")
def turn_mapping_back(R: Any, t: Any, K: Any, angle: float) -> Any:
    R_new, t_new, A = turn_by_opencv(R, t, K, angle)
    return R_new, t_new, np.linalg.inv(A)


@wrong("turn_picture", "a quarter turn, in pixels from the axis", "result [0]")
def turn_by_degrees(R: Any, t: Any, K: Any, angle: float) -> Any:
    return turn_by_opencv(R, t, K, np.rad2deg(angle))


@wrong("turn_picture", "a turn by 0", "expected shape (3, 3), got shape (2, 3)")
def turn_in_two_rows(R: Any, t: Any, K: Any, angle: float) -> Any:
    R_new, t_new, A = turn_by_opencv(R, t, K, angle)
    return R_new, t_new, A[:2]


# 7. Undo the lamp ---------------------------------------------------------------------------------


def undo(brightness: Any, depth: Any, normals: Any, K: Any, power: Any, noise: Any) -> Any:
    """Albedo and its noise, not yet judged."""
    y, x = np.indices(depth.shape)
    rays = np.stack([x, y, np.ones(depth.shape)], -1) @ np.linalg.inv(K).T
    length = np.linalg.norm(rays, axis=-1)
    cosine = -(rays * normals).sum(-1) / length
    factor = (depth * length) ** 2 / power / cosine
    factor = np.where((cosine > 0) & (depth > 0), factor, np.inf)
    return brightness * factor, noise * factor


def recover(limit: float) -> Callable[..., np.ndarray]:
    def recover(brightness: Any, *rest: Any) -> np.ndarray:
        albedo, deviation = undo(brightness, *rest)
        return np.where((deviation < limit) & (brightness < 1), albedo, np.nan)

    return recover


right("recover_albedo")(recover(0.04))
right("recover_albedo")(recover(0.25))


@right("recover_albedo")
def recover_up_to_1(brightness: Any, *rest: Any) -> np.ndarray:
    return np.clip(recover(0.1)(brightness, *rest), 0, 1)


@wrong("recover_albedo", "a thing so near that it is white", "the pixel is white")
def recover_white(brightness: Any, *rest: Any) -> np.ndarray:
    albedo, deviation = undo(brightness, *rest)
    return np.where(deviation < 0.1, albedo, np.nan)


@wrong("recover_albedo", "a background too far for the lamp", "noise alone")
def recover_noise(brightness: Any, *rest: Any) -> np.ndarray:
    return recover(100)(brightness, *rest)


@wrong("recover_albedo", "a wall", "got nan")
def recover_little(brightness: Any, *rest: Any) -> np.ndarray:
    return recover(0.005)(brightness, *rest)


@wrong("recover_albedo", "a wall", "got nan")
def recover_nothing(brightness: Any, *rest: Any) -> np.ndarray:
    return np.full(brightness.shape, np.nan)


@wrong("recover_albedo", "a wall with holes", "the depth is missing")
def recover_with_zeros(brightness: Any, *rest: Any) -> np.ndarray:
    return np.nan_to_num(recover(0.1)(brightness, *rest))


@wrong("recover_albedo", "a wall", "got")
def recover_by_depth(brightness: Any, depth: Any, normals: Any, K: Any, *rest: Any) -> np.ndarray:
    right = recover(0.1)(brightness, depth, normals, K, *rest)
    points = cameras.back_project(depth, K)
    return right * depth**2 / (points**2).sum(-1)


@wrong("recover_albedo", "a wall", "got")
def recover_by_distance(brightness: Any, depth: Any, normals: Any, K: Any, *rest: Any) -> Any:
    right = recover(0.1)(brightness, depth, normals, K, *rest)
    return right / np.linalg.norm(cameras.back_project(depth, K), axis=-1)


@wrong("recover_albedo", "a wall", "got")
def recover_without_cosine(brightness: Any, depth: Any, normals: Any, K: Any, *rest: Any) -> Any:
    points = cameras.back_project(depth, K)
    cosine = -(points * normals).sum(-1) / np.linalg.norm(points, axis=-1)
    return recover(0.1)(brightness, depth, normals, K, *rest) * cosine


@wrong("recover_albedo", "a wall", "got")
def recover_along_the_axis(brightness: Any, depth: Any, normals: Any, K: Any, *rest: Any) -> Any:
    points = cameras.back_project(depth, K)
    cosine = -(points * normals).sum(-1) / np.linalg.norm(points, axis=-1)
    right = recover(0.1)(brightness, depth, normals, K, *rest)
    return right * cosine / -normals[..., 2]


@wrong("recover_albedo", "a wall", "got")
def recover_with_power_1(
    brightness: Any, depth: Any, normals: Any, K: Any, power: Any, noise: Any
) -> np.ndarray:
    return recover(0.1)(brightness, depth, normals, K, power, noise) * power
