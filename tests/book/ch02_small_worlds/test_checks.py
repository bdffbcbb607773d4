"""Chapter 2's exercises: plausible wrong solutions are caught, other right ones are accepted."""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from book.ch02_small_worlds import checks
from book.tools.checks import DONE, NOT_DONE
from posecore import cameras, poses

# 1. The edge function ---------------------------------------------------------------------------


def edge_by_determinants(a: Any, b: Any, points: Any) -> np.ndarray:
    triangles = [np.array([[1, *a], [1, *p], [1, *b]]) for p in points]
    return np.array([np.linalg.det(triangle) for triangle in triangles])


def edge_of_a_textbook(a: Any, b: Any, points: Any) -> np.ndarray:
    d, q = b - a, points - a
    return d[0] * q[:, 1] - d[1] * q[:, 0]


def edge_as_area(a: Any, b: Any, points: Any) -> np.ndarray:
    return -edge_of_a_textbook(a, b, points) / 2


def edge_without_sign(a: Any, b: Any, points: Any) -> np.ndarray:
    return np.abs(edge_of_a_textbook(a, b, points))


def edge_as_distance(a: Any, b: Any, points: Any) -> np.ndarray:
    return -edge_of_a_textbook(a, b, points) / np.linalg.norm(b - a)


def edge_from_the_origin(a: Any, b: Any, points: Any) -> np.ndarray:
    return -edge_of_a_textbook(0 * a, b - a, points)


def edge_of_rows_and_columns(a: Any, b: Any, points: Any) -> np.ndarray:
    return -edge_of_a_textbook(a, b, points[:, ::-1])


def edge_by_dot_product(a: Any, b: Any, points: Any) -> np.ndarray:
    return (points - a) @ (b - a)


def edge_mixing_rows_and_columns(a: Any, b: Any, points: Any) -> np.ndarray:
    d, q = b - a, points - a
    return d[1] * q[0] - d[0] * q[1]


def edge_refusing_no_length(a: Any, b: Any, points: Any) -> np.ndarray:
    if (a == b).all():
        raise ValueError("no edge")
    return -edge_of_a_textbook(a, b, points)


def edge_as_sign(a: Any, b: Any, points: Any) -> np.ndarray:
    return np.sign(-edge_of_a_textbook(a, b, points))


# 2. What lies between the corners -----------------------------------------------------------------


def interpolate_one_by_one(weights: Any, depths: Any, values: Any) -> np.ndarray:
    result = np.empty((len(weights), values.shape[1]))
    for row, w in enumerate(weights):
        z = 1 / (w / depths).sum()
        result[row] = sum(z * w[k] * values[k] / depths[k] for k in range(3))
    return result


def interpolate_by_weights_alone(weights: Any, depths: Any, values: Any) -> np.ndarray:
    return weights @ values


def interpolate_by_depths(weights: Any, depths: Any, values: Any) -> np.ndarray:
    shares = weights * depths
    return shares / shares.sum(1, keepdims=True) @ values


def interpolate_undivided(weights: Any, depths: Any, values: Any) -> np.ndarray:
    return weights / depths @ values


def interpolate_by_linear_depth(weights: Any, depths: Any, values: Any) -> np.ndarray:
    return (weights / depths @ values) * (weights @ depths)[:, None]


def interpolate_reciprocals(weights: Any, depths: Any, values: Any) -> np.ndarray:
    return 1 / (weights @ (1 / values))


def interpolate_with_one_sum(weights: Any, depths: Any, values: Any) -> np.ndarray:
    shares = weights / depths
    return shares / shares.sum() * len(weights) @ values


def interpolate_without_columns(weights: Any, depths: Any, values: Any) -> np.ndarray:
    shares = weights / depths
    return (shares / shares.sum(1, keepdims=True) @ values)[:, 0]


def interpolate_cutting_weights(weights: Any, depths: Any, values: Any) -> np.ndarray:
    return interpolate_one_by_one(np.clip(weights, 0, 1), depths, values)


# 3. The z-buffer ----------------------------------------------------------------------------------


def merge_by_argmin(layers: Any) -> Any:
    none = np.full((1, *layers.shape[1:]), np.inf)
    far = np.concatenate([np.where(layers > 0, layers, np.inf), none])
    instance, depth = far.argmin(0), far.min(0)
    nothing = np.isinf(depth)
    return np.where(nothing, 0, depth), np.where(nothing, -1, instance)


def merge_with_zeros(layers: Any) -> Any:
    instance = layers.argmin(0) if len(layers) else np.full(layers.shape[1:], -1)
    return layers.min(0, initial=np.inf), instance


def merge_the_farthest(layers: Any) -> Any:
    instance = np.where(layers.any(0), layers.argmax(0), -1)
    return layers.max(0), instance


def merge_to_the_last(layers: Any) -> Any:
    depth, instance = merge_by_argmin(layers[::-1])
    return depth, np.where(instance >= 0, len(layers) - 1 - instance, -1)


def merge_naming_nothing_0(layers: Any) -> Any:
    depth, instance = merge_by_argmin(layers)
    return depth, np.maximum(instance, 0)


def merge_counting_from_1(layers: Any) -> Any:
    depth, instance = merge_by_argmin(layers)
    return depth, instance + 1


def merge_leaving_infinity(layers: Any) -> Any:
    depth, instance = merge_by_argmin(layers)
    return np.where(instance < 0, np.inf, depth), instance


def merge_with_a_far_plane(layers: Any) -> Any:
    depth, instance = merge_by_argmin(np.where(layers < 1000, layers, 0))
    return depth, instance


def merge_changing_layers(layers: Any) -> Any:
    layers[layers == 0] = np.inf
    return merge_by_argmin(np.where(np.isinf(layers), 0, layers))


def merge_some_layers_only(layers: Any) -> Any:
    far = np.where(layers > 0, layers, np.inf)
    instance = np.where(layers.any(0), far.argmin(0), -1)
    return np.where(layers.any(0), far.min(0), 0), instance


def merge_with_numbers_as_floats(layers: Any) -> Any:
    depth, instance = merge_by_argmin(layers)
    return depth, instance.astype(float)


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


def clip_and_tidy_up(triangle: Any, near: float) -> np.ndarray:
    found = walk(triangle, near, lambda p, q: (p < 0) != (q < 0))
    corners = [
        c for k, c in enumerate(found) if not any(np.allclose(c, d, atol=1e-12) for d in found[:k])
    ]
    return np.array(corners) if len(corners) > 2 else np.zeros((0, 3))


def clip_beginning_elsewhere(triangle: Any, near: float) -> np.ndarray:
    return np.roll(clip_and_tidy_up(triangle, near), 1, axis=0)


def clip_leaving_points(triangle: Any, near: float) -> np.ndarray:
    return walk(triangle, near, lambda p, q: p * q < 0)


def clip_with_corners_twice(triangle: Any, near: float) -> np.ndarray:
    found = walk(triangle, near, lambda p, q: (p < 0) != (q < 0))
    return found if (triangle[:, 2] > near).any() else clip_and_tidy_up(triangle, near)


def clip_strictly(triangle: Any, near: float) -> np.ndarray:
    keep = triangle[:, 2] > near
    return clip_and_tidy_up(triangle, near) if keep.any() else np.zeros((0, 3))


def clip_nothing(triangle: Any, near: float) -> np.ndarray:
    return triangle if (triangle[:, 2] >= near).any() else np.zeros((0, 3))


def clip_to_nothing(triangle: Any, near: float) -> np.ndarray:
    return triangle if (triangle[:, 2] >= near).all() else np.zeros((0, 3))


def clip_by_pushing(triangle: Any, near: float) -> np.ndarray:
    pushed = triangle.copy()
    pushed[:, 2] = np.maximum(pushed[:, 2], near)
    return pushed if (triangle[:, 2] > near).any() else np.zeros((0, 3))


def clip_what_is_in_front(triangle: Any, near: float) -> np.ndarray:
    return clip_and_tidy_up(triangle * [1, 1, -1], -near) * [1, 1, -1]


def clip_the_other_way_round(triangle: Any, near: float) -> np.ndarray:
    return clip_and_tidy_up(triangle, near)[::-1]


def clip_with_cuts_last(triangle: Any, near: float) -> np.ndarray:
    corners = clip_and_tidy_up(triangle, near)
    cut = ~(corners[:, None] == triangle).all(-1).any(-1)
    return np.concatenate([corners[~cut], corners[cut]])


def clip_by_the_wrong_share(triangle: Any, near: float) -> np.ndarray:
    corners = []
    for P, Q in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
        if P[2] >= near:
            corners.append(P)
        if (P[2] < near) != (Q[2] < near):
            corners.append(P + (Q[2] - near) / (Q[2] - P[2]) * (Q - P))
    return np.array(corners).reshape(-1, 3)


def clip_to_a_flat_nothing(triangle: Any, near: float) -> np.ndarray:
    corners = clip_and_tidy_up(triangle, near)
    return corners if len(corners) else np.array([])


# 5. How much of it is seen ------------------------------------------------------------------------


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


def visible_of_the_inside(layers: Any, margin: int) -> np.ndarray:
    _, height, width = layers.shape
    return visible_by_comparing(layers[:, margin : height - margin, margin : width - margin], 0)


def visible_anywhere(layers: Any, margin: int) -> np.ndarray:
    return visible_by_comparing(layers, 0)


def visible_through_others(layers: Any, margin: int) -> np.ndarray:
    _, height, width = layers.shape
    inside = layers[:, margin : height - margin, margin : width - margin]
    return (inside > 0).sum((1, 2)) / np.maximum((layers > 0).sum((1, 2)), 1)


def visible_nan_for_none(layers: Any, margin: int) -> np.ndarray:
    shares = visible_by_comparing(layers, margin)
    return np.where(layers.any((1, 2)), shares, np.nan)


def visible_all_of_none(layers: Any, margin: int) -> np.ndarray:
    return np.where(layers.any((1, 2)), visible_by_comparing(layers, margin), 1.0)


def visible_with_minus_margin(layers: Any, margin: int) -> np.ndarray:
    image = layers[:, margin:-margin, margin:-margin]
    _, instance = merge_by_argmin(image)
    seen = np.array([(instance == k).sum() for k in range(len(layers))])
    return seen / np.maximum((layers > 0).sum((1, 2)), 1)


def visible_both_of_equals(layers: Any, margin: int) -> np.ndarray:
    _, height, width = layers.shape
    image = layers[:, margin : height - margin, margin : width - margin]
    nearest = np.where(image > 0, image, np.inf).min(0)
    return (image == nearest).sum((1, 2)) / np.maximum((layers > 0).sum((1, 2)), 1)


def visible_of_the_image(layers: Any, margin: int) -> np.ndarray:
    total = np.maximum((layers > 0).sum((1, 2)), 1)
    return visible_by_comparing(layers, margin) * total / layers[0].size


# 6. Turn the picture ------------------------------------------------------------------------------


def turn(angle: float) -> np.ndarray:
    return np.vstack([np.c_[cv2.getRotationMatrix2D((0, 0), -np.rad2deg(angle), 1)], [0, 0, 1]])


def turn_by_opencv(R: Any, t: Any, K: Any, angle: float) -> Any:
    Z = cv2.Rodrigues(np.array([0, 0, angle]))[0]
    corners = np.array([[0, 0], [100, 0], [0, 100]], np.float32)
    rays = np.c_[corners, np.ones(3)] @ np.linalg.inv(K).T @ Z.T
    A = cv2.getAffineTransform(corners, cameras.project(K, rays).astype(np.float32))
    exact = K @ Z @ np.linalg.inv(K)  # that of OpenCV has the digits of float32 only
    assert np.allclose(A, exact[:2], atol=1e-3)
    return Z @ R, Z @ t, exact


def turn_against_the_clock(R: Any, t: Any, K: Any, angle: float) -> Any:
    return turn_by_opencv(R, t, K, -angle)


def turn_the_rotation_only(R: Any, t: Any, K: Any, angle: float) -> Any:
    R_new, _, A = turn_by_opencv(R, t, K, angle)
    return R_new, t, A


def turn_the_object(R: Any, t: Any, K: Any, angle: float) -> Any:
    _, t_new, A = turn_by_opencv(R, t, K, angle)
    return R @ turn(angle), t_new, A


def turn_about_the_middle(R: Any, t: Any, K: Any, angle: float) -> Any:
    R_new, t_new, _ = turn_by_opencv(R, t, K, angle)
    to = np.array([[1, 0, 320], [0, 1, 240], [0, 0, 1]])
    return R_new, t_new, to @ turn(angle) @ np.linalg.inv(to)


def turn_about_the_first_pixel(R: Any, t: Any, K: Any, angle: float) -> Any:
    return *turn_by_opencv(R, t, K, angle)[:2], turn(angle)


def turn_pixels_as_if_square(R: Any, t: Any, K: Any, angle: float) -> Any:
    R_new, t_new, _ = turn_by_opencv(R, t, K, angle)
    to = np.array([[1, 0, K[0, 2]], [0, 1, K[1, 2]], [0, 0, 1]])
    return R_new, t_new, to @ turn(angle) @ np.linalg.inv(to)


def turn_without_skew(R: Any, t: Any, K: Any, angle: float) -> Any:
    straight = K.copy()
    straight[0, 1] = 0
    return turn_by_opencv(R, t, straight, angle)


def turn_mapping_back(R: Any, t: Any, K: Any, angle: float) -> Any:
    R_new, t_new, A = turn_by_opencv(R, t, K, angle)
    return R_new, t_new, np.linalg.inv(A)


def turn_by_degrees(R: Any, t: Any, K: Any, angle: float) -> Any:
    return turn_by_opencv(R, t, K, np.rad2deg(angle))


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


def recover_up_to_1(brightness: Any, *rest: Any) -> np.ndarray:
    return np.clip(recover(0.1)(brightness, *rest), 0, 1)


def recover_white(brightness: Any, *rest: Any) -> np.ndarray:
    albedo, deviation = undo(brightness, *rest)
    return np.where(deviation < 0.1, albedo, np.nan)


def recover_noise(brightness: Any, *rest: Any) -> np.ndarray:
    return recover(100)(brightness, *rest)


def recover_little(brightness: Any, *rest: Any) -> np.ndarray:
    return recover(0.005)(brightness, *rest)


def recover_nothing(brightness: Any, *rest: Any) -> np.ndarray:
    return np.full(brightness.shape, np.nan)


def recover_with_zeros(brightness: Any, *rest: Any) -> np.ndarray:
    return np.nan_to_num(recover(0.1)(brightness, *rest))


def recover_by_depth(brightness: Any, depth: Any, normals: Any, K: Any, *rest: Any) -> np.ndarray:
    right = recover(0.1)(brightness, depth, normals, K, *rest)
    points = cameras.back_project(depth, K)
    return right * depth**2 / (points**2).sum(-1)


def recover_by_distance(brightness: Any, depth: Any, normals: Any, K: Any, *rest: Any) -> Any:
    right = recover(0.1)(brightness, depth, normals, K, *rest)
    return right / np.linalg.norm(cameras.back_project(depth, K), axis=-1)


def recover_without_cosine(brightness: Any, depth: Any, normals: Any, K: Any, *rest: Any) -> Any:
    points = cameras.back_project(depth, K)
    cosine = -(points * normals).sum(-1) / np.linalg.norm(points, axis=-1)
    return recover(0.1)(brightness, depth, normals, K, *rest) * cosine


def recover_along_the_axis(brightness: Any, depth: Any, normals: Any, K: Any, *rest: Any) -> Any:
    points = cameras.back_project(depth, K)
    cosine = -(points * normals).sum(-1) / np.linalg.norm(points, axis=-1)
    right = recover(0.1)(brightness, depth, normals, K, *rest)
    return right * cosine / -normals[..., 2]


def recover_with_power_1(
    brightness: Any, depth: Any, normals: Any, K: Any, power: Any, noise: Any
) -> np.ndarray:
    return recover(0.1)(brightness, depth, normals, K, power, noise) * power


RIGHT = [
    ("edge_function", edge_by_determinants),
    ("interpolate", interpolate_one_by_one),
    ("merge_layers", merge_by_argmin),
    ("clip_near", clip_and_tidy_up),
    ("clip_near", clip_beginning_elsewhere),
    ("visible_fraction", visible_by_comparing),
    ("turn_picture", turn_by_opencv),
    ("recover_albedo", recover(0.04)),
    ("recover_albedo", recover(0.25)),
    ("recover_albedo", recover_up_to_1),
]


@pytest.mark.parametrize(("exercise", "student"), RIGHT)
def test_another_way_to_be_right(exercise: str, student: Callable[..., Any]) -> None:
    answer = getattr(checks, f"check_{exercise}")(student)
    assert answer.status == DONE, answer.line


# The exercise, the wrong solution, the input that gives it away, and a part of how the line ends.
WRONG = [
    ("edge_function", edge_of_a_textbook, "a point above a level edge", "[8.], got"),
    ("edge_function", edge_as_area, "a point above a level edge", "[4.]"),
    ("edge_function", edge_without_sign, "a point below a level edge", "[8.]"),
    ("edge_function", edge_as_distance, "a point above a level edge", "[2.]"),
    ("edge_function", edge_from_the_origin, "a random edge", "got"),
    ("edge_function", edge_of_rows_and_columns, "a point above a level edge", "got"),
    ("edge_function", edge_by_dot_product, "a point above a level edge", "got"),
    ("edge_function", edge_mixing_rows_and_columns, "a point above a level edge", "Error"),
    ("edge_function", edge_refusing_no_length, "an edge without length", "raised ValueError"),
    ("edge_function", edge_as_sign, "a point above a level edge", "[1.]"),
    ("interpolate", interpolate_by_weights_alone, "halfway between a corner at 1 m", "[[0.5]]"),
    ("interpolate", interpolate_by_depths, "halfway between a corner at 1 m", "[[0.75]]"),
    ("interpolate", interpolate_undivided, "corners that are equally far", "got"),
    ("interpolate", interpolate_by_linear_depth, "halfway between a corner at 1 m", "got"),
    ("interpolate", interpolate_reciprocals, "corners that are equally far", "got"),
    ("interpolate", interpolate_with_one_sum, "the corners themselves", "got"),
    ("interpolate", interpolate_without_columns, "corners that are equally far", "shape (2,)"),
    ("interpolate", interpolate_cutting_weights, "a pixel just outside", "got"),
    ("merge_layers", merge_with_zeros, "a near layer with a hole", "got"),
    ("merge_layers", merge_the_farthest, "two layers, the second nearer", "got"),
    ("merge_layers", merge_to_the_last, "two layers equally far", "in result [1]"),
    ("merge_layers", merge_naming_nothing_0, "a pixel that is empty in all layers", "[[0, 0]]"),
    ("merge_layers", merge_counting_from_1, "one layer without holes", "got"),
    ("merge_layers", merge_leaving_infinity, "a pixel that is empty in all layers", "inf"),
    ("merge_layers", merge_with_a_far_plane, "random layers far away", "got"),
    ("merge_layers", merge_changing_layers, "a near layer with a hole", "work on a copy"),
    ("merge_layers", merge_some_layers_only, "no layers at all", "raised ValueError"),
    ("merge_layers", merge_with_numbers_as_floats, "one layer without holes", "whole numbers"),
    ("merge_layers", merge_into_one, "one layer without holes", "expected a tuple"),
    ("clip_near", clip_leaving_points, "a corner on the plane, two behind", "shape (1, 3)"),
    ("clip_near", clip_with_corners_twice, "a corner on the plane, one in front", "(4, 3)"),
    ("clip_near", clip_strictly, "a triangle in the plane", "got shape (0, 3)"),
    ("clip_near", clip_nothing, "only the first corner in front", "got [["),
    ("clip_near", clip_to_nothing, "only the first corner in front", "got shape (0, 3)"),
    ("clip_near", clip_by_pushing, "only the first corner in front", "got [["),
    ("clip_near", clip_what_is_in_front, "a triangle in front", "got shape (0, 3)"),
    ("clip_near", clip_the_other_way_round, "a triangle in front", "in this order"),
    ("clip_near", clip_with_cuts_last, "only the first corner behind", "in this order"),
    ("clip_near", clip_by_the_wrong_share, "only the first corner in front", "got [["),
    ("clip_near", clip_to_a_flat_nothing, "a triangle behind", "got shape (0,)"),
    ("visible_fraction", visible_of_the_inside, "an object half outside the image", "got"),
    ("visible_fraction", visible_anywhere, "an object half outside the image", "got"),
    ("visible_fraction", visible_through_others, "an object behind another", "got"),
    ("visible_fraction", visible_nan_for_none, "an object of no pixel", "nan"),
    ("visible_fraction", visible_all_of_none, "an object of no pixel", "got"),
    ("visible_fraction", visible_with_minus_margin, "no margin around the image", "got"),
    ("visible_fraction", visible_both_of_equals, "two objects equally far", "got"),
    ("visible_fraction", visible_of_the_image, "an object inside the image", "got"),
    ("turn_picture", turn_against_the_clock, "a quarter turn, in pixels from the axis", "got"),
    ("turn_picture", turn_the_rotation_only, "a quarter turn, an object beside", "result [1]"),
    ("turn_picture", turn_the_object, "a random turn", "in result [0]"),
    ("turn_picture", turn_about_the_middle, "a quarter turn, in pixels from", "in result [2]"),
    ("turn_picture", turn_about_the_first_pixel, "a quarter turn, an object", "in result [2]"),
    ("turn_picture", turn_pixels_as_if_square, "another camera, fx and fy differ", "result [2]"),
    ("turn_picture", turn_without_skew, "a camera with skew", "in result [2]"),
    ("turn_picture", turn_mapping_back, "a quarter turn, in pixels from the axis", "result [2]"),
    ("turn_picture", turn_by_degrees, "a quarter turn, in pixels from the axis", "result [0]"),
    ("turn_picture", turn_in_two_rows, "a turn by 0", "expected shape (3, 3), got shape (2, 3)"),
    ("recover_albedo", recover_white, "a thing so near that it is white", "the pixel is white"),
    ("recover_albedo", recover_noise, "a background too far for the lamp", "noise alone"),
    ("recover_albedo", recover_little, "a wall", "got nan"),
    ("recover_albedo", recover_nothing, "a wall", "got nan"),
    ("recover_albedo", recover_with_zeros, "a wall with holes", "the depth is missing"),
    ("recover_albedo", recover_by_depth, "a wall", "got"),
    ("recover_albedo", recover_by_distance, "a wall", "got"),
    ("recover_albedo", recover_without_cosine, "a wall", "got"),
    ("recover_albedo", recover_along_the_axis, "a wall", "got"),
    ("recover_albedo", recover_with_power_1, "a wall", "got"),
]


@pytest.mark.parametrize(("exercise", "student", "words", "result"), WRONG)
def test_a_wrong_solution_is_caught(
    refused: Callable[..., str], exercise: str, student: Callable[..., Any], words: str, result: str
) -> None:
    line = refused(getattr(checks, f"check_{exercise}"), exercise, student, words)
    assert result in line.partition("): ")[2], line


NAMES = [name for name in vars(checks) if name.startswith("check_")]


def test_every_exercise_has_wrong_solutions_and_two_hints() -> None:
    assert len(NAMES) == 7
    for name in NAMES:
        assert len(getattr(checks, name).hints) == 2
        assert sum(f"check_{exercise}" == name for exercise, *_ in WRONG) >= 3
        assert sum(f"check_{exercise}" == name for exercise, _ in RIGHT) >= 1


@pytest.mark.parametrize("name", NAMES)
def test_a_stub_is_not_done_and_the_reference_is(name: str) -> None:
    check = getattr(checks, name)

    def stub(*given: Any) -> None:
        """As a student gets it."""
        ...

    assert check(stub).status == NOT_DONE
    assert check(check.reference).status == DONE


# What the references say, against the world -------------------------------------------------------

numbers = st.floats(-2, 2)
triples = st.tuples(numbers, numbers, numbers)


@given(st.tuples(triples, triples, triples), numbers)
def test_what_is_clipped_off_lies_behind(triangle: tuple, near: float) -> None:
    """Both sides of the plane have the triangle's area together, and each is on its side."""
    corners = np.array(triangle)
    front = checks.clip_near(corners, near)
    behind = checks.clip_near(corners * [1, 1, -1], -near) * [1, 1, -1]
    assert (front[:, 2] >= near - 1e-9).all() and (behind[:, 2] <= near + 1e-9).all()
    if not (corners[:, 2] == near).all():

        def area(polygon: np.ndarray) -> np.ndarray:
            return np.cross(polygon, np.roll(polygon, -1, axis=0)).sum(0) if len(polygon) else 0

        assert np.allclose(area(front) + area(behind), area(corners), atol=1e-9)


@given(st.integers(0, 2**32 - 1))
def test_interpolated_points_are_seen_where_they_are(seed: int) -> None:
    """The oracle is a ray cut with the triangle's plane."""
    rng = np.random.default_rng(seed)
    K = np.array([[100.0, 3, 20], [0, 90, 10], [0, 0, 1]])
    X = rng.uniform([-1, -1, 1], [1, 1, 4], size=(3, 3))
    corners, weights = cameras.project(K, X), rng.dirichlet(np.ones(3), size=4)
    rays = np.c_[weights @ corners, np.ones(4)] @ np.linalg.inv(K).T
    normal = np.cross(X[1] - X[0], X[2] - X[0])
    expected = rays * (normal @ X[0] / (rays @ normal))[:, None]
    if np.abs(rays @ normal).min() > 1e-2:  # else the triangle is nearly seen edge on
        assert np.allclose(checks.interpolate(weights, X[:, 2], X), expected, atol=1e-8)


@given(st.lists(st.tuples(st.integers(-9, 9), st.integers(-9, 9)), min_size=3, max_size=3))
def test_edge_values_are_twice_the_area(corners: list) -> None:
    a, b, c = np.array(corners, float)
    E = float(checks.edge_function(a, b, c[None])[0])
    if E == 0:
        assert np.linalg.matrix_rank([b - a, c - a]) < 2
    else:
        assert np.isclose(abs(E), 2 * ConvexHull(corners).volume)


@given(st.floats(-4, 4), st.integers(0, 2**32 - 1))
def test_points_land_on_their_turned_pixels(angle: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    K = np.array([[500.0, 20, 300], [0, 400, 100], [0, 0, 1]])
    points, t = rng.normal(size=(5, 3)) / 10, np.array([0.1, -0.2, 1.5])
    R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    R_new, t_new, A = checks.turn_picture(R, t, K, angle)
    before = cameras.project(K, poses.apply(R, t, points))
    after = cameras.project(K, poses.apply(R_new, t_new, points))
    assert np.allclose(before @ A[:2, :2].T + A[:2, 2], after, atol=1e-8)
    assert A[2].tolist() == [0, 0, 1]


@given(st.integers(0, 2**32 - 1), st.integers(0, 2))
def test_merging_and_counting_agree_with_loops(seed: int, margin: int) -> None:
    rng = np.random.default_rng(seed)
    layers = rng.integers(0, 4, size=(3, 5, 6)) / 2
    depth, instance = checks.merge_layers(layers)
    seen = np.zeros(3)
    for row, column in np.ndindex(5, 6):
        there = [(z, k) for k, z in enumerate(layers[:, row, column]) if z > 0]
        assert (depth[row, column], instance[row, column]) == min(there, default=(0, -1))
        if there and margin <= row < 5 - margin and margin <= column < 6 - margin:
            seen[min(there)[1]] += 1
    counts = (layers > 0).sum((1, 2))
    assert np.allclose(checks.visible_fraction(layers, margin) * counts, seen)


def test_albedo_is_what_the_lamp_was_told() -> None:
    """A plane and light made by hand, without noise."""
    K = np.array([[10.0, 0, 2], [0, 10, 1], [0, 0, 1]])
    n, albedo = np.array([0.0, -0.6, -0.8]), np.linspace(0.1, 0.9, 15).reshape(3, 5)
    depth, brightness = np.zeros((2, 3, 5))
    for v, u in np.ndindex(3, 5):
        ray = np.array([(u - 2) / 10, (v - 1) / 10, 1])
        X = ray * (n @ [0, 0, 0.7] / (n @ ray))
        r = np.linalg.norm(X)
        depth[v, u], brightness[v, u] = X[2], 0.3 * albedo[v, u] * (-n @ X / r) / r**2
    found = checks.recover_albedo(brightness, depth, np.tile(n, (3, 5, 1)), K, 0.3, 0.001)
    assert np.allclose(found, albedo)
