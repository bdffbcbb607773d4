"""From many errors to one number: accuracy, area under its curve, average and balanced errors.

A missing estimate is an infinite error: it lowers every accuracy and every area, as it should, and
makes a mean infinite rather than wrong.
"""

from __future__ import annotations

import numpy as np
import torch

from posecore.arrays import Array, array_function, fail, require_number, to_numbers

__all__ = [
    "accuracy",
    "accuracy_curve",
    "angle_difference",
    "auc",
    "average_recall",
    "balanced_mean_angular_error",
    "mean_absolute_error",
    "root_mean_squared_error",
    "within",
]


def accuracy(errors: Array, threshold: float | Array) -> float:
    """The share of errors below a threshold, in [0, 1].

    Args:
        errors: (N,) errors, at least one; infinite for an estimate that is missing.
        threshold: one number, or (N,) one for each error (0.1 of each object's diameter, say).

    Raises:
        ValueError: if there are no errors, or one is negative or not a number.
    """
    errors = _errors(errors)
    threshold = _thresholds("threshold", threshold)
    if threshold.ndim and threshold.shape != errors.shape:
        fail("threshold", f"one number or shape {errors.shape}", f"shape {threshold.shape}")
    return float((errors < threshold).mean())


def accuracy_curve(errors: Array, thresholds: Array) -> np.ndarray:
    """The accuracy at every threshold.

    Args:
        errors: (N,) errors, infinite where the estimate is missing.
        thresholds: (T,) thresholds in the unit of the errors.

    Returns:
        (T,) shares in [0, 1].

    Raises:
        ValueError: if there are no errors, or one is negative or not a number.
    """
    ordered = np.sort(_errors(errors))
    return np.searchsorted(ordered, _thresholds("thresholds", thresholds), side="left") / len(
        ordered
    )


def auc(errors: Array, max_threshold: float = 0.1) -> float:
    """The area under the accuracy curve from 0 to `max_threshold`, divided by `max_threshold`.

    Accuracy is a step function, so its integral is exact: an error e adds max(0, 1 - e / max).
    Toolboxes that interpolate or sample the curve differ from this by up to a percent.
    Xiang et al., PoseCNN, RSS 2018, use it on ADD and ADD-S with 0.1 m.

    Args:
        errors: (N,) errors, infinite where the estimate is missing.
        max_threshold: the largest threshold, in the unit of the errors (0.1 m).

    Returns:
        A number in [0, 1].

    Raises:
        ValueError: if there are no errors, one is negative or not a number, or the threshold is not
            positive.
    """
    limit = require_number("max_threshold", max_threshold, above=0)
    return float((1 - np.minimum(_errors(errors), limit) / limit).mean())


def average_recall(errors: Array, thresholds: Array) -> float:
    """The accuracy averaged over thresholds, as the BOP challenges define it for given pairs.

    Where an image holds several instances of an object, BOP pairs estimates and true poses anew at
    each threshold: `match_by_error`. Hodan et al., BOP Challenge 2020: MSSD at 0.05 to 0.5 of
    the diameter in steps of 0.05; MSPD at 5 to 50 px in steps of 5, times the image's width / 640.

    Args:
        errors: (N,) errors, infinite where the estimate is missing.
        thresholds: (T,) thresholds in the unit of the errors, at least one.

    Raises:
        ValueError: if there are no errors or thresholds, or one is negative or not a number.
    """
    curve = accuracy_curve(errors, thresholds)
    if not curve.size:
        fail("thresholds", "at least one", "none")
    return float(curve.mean())


def within(
    rotation_errors: Array, translation_errors: Array, degrees: float, centimetres: float
) -> np.ndarray:
    """Which poses are right to n degrees and m centimetres at once.

    Shotton et al., Scene Coordinate Regression Forests, CVPR 2013, for 5 degrees and 5 cm.

    Args:
        rotation_errors: (N,) radians.
        translation_errors: (N,) metres.
        degrees, centimetres: the two limits; an error must be below both.

    Returns:
        (N,) booleans.

    Raises:
        ValueError: if there are no errors, one is negative or not a number, the shapes differ, or a
            limit is not positive.
    """
    rotation = _errors(rotation_errors, "rotation_errors")
    translation = _errors(translation_errors, "translation_errors")
    if rotation.shape != translation.shape:
        fail("translation_errors", f"shape {rotation.shape}", f"shape {translation.shape}")
    degrees = require_number("degrees", degrees, above=0)
    centimetres = require_number("centimetres", centimetres, above=0)
    return (np.rad2deg(rotation) < degrees) & (translation * 100 < centimetres)


@array_function(estimated="...", true="...")
def angle_difference(estimated: Array, true: Array) -> Array:
    """`estimated - true` (...) in radians, the short way round: in [-pi, pi)."""
    return torch.remainder(estimated - true + torch.pi, 2 * torch.pi) - torch.pi


def mean_absolute_error(errors: Array) -> float:
    """The mean of |errors| (N,), signed or not; infinite if an estimate is missing.

    Raises:
        ValueError: if there are no errors, or one is not a number.
    """
    return float(_errors(np.abs(to_numbers("errors", errors))).mean())


def root_mean_squared_error(errors: Array) -> float:
    """The root of the mean of errors^2 (N,), signed or not; infinite if an estimate is missing.

    Raises:
        ValueError: if there are no errors, or one is not a number.
    """
    sizes = _errors(np.abs(to_numbers("errors", errors)))
    largest = sizes.max()
    if largest in (0, np.inf):
        return float(largest)
    return float(largest * np.sqrt(np.square(sizes / largest).mean()))  # no square overflows


def balanced_mean_angular_error(
    errors: Array,
    true_angles: Array,
    bin_width: float = np.deg2rad(5),
    max_angle: float = np.pi,
) -> float:
    """BMAE: the absolute error averaged inside bins of the true angle, then over the bins.

    Rare, extreme poses so weigh as much as frequent ones. `ir_point_clouds`, Eq 5, with bins of
    5 degrees over 180. As printed the sum has 37 terms for 36 bins and does not say what happens
    with empty ones. Here bins are half-open in the absolute true angle of the axis, the last one
    includes its end, empty bins are skipped and the divisor is the number of bins in use.

    Args:
        errors: (N,) errors of one angle, signed or not, radians.
        true_angles: (N,) the ground truth of that angle, radians; only its size counts.
        bin_width: radians.
        max_angle: radians; the end of the last bin.

    Returns:
        Radians.

    Raises:
        ValueError: if a true angle lies beyond `max_angle`, the shapes differ, or there would be
            more than a billion bins.
    """
    errors = _errors(np.abs(to_numbers("errors", errors)))
    width = require_number("bin_width", bin_width, above=0)
    limit = require_number("max_angle", max_angle, low=width)
    if limit / width > 1e9:  # the numbers of bins must be integers
        fail("bin_width", f"at least a billionth of max_angle, {limit}", width)
    angles = _errors(np.abs(to_numbers("true_angles", true_angles)), "true_angles")
    if angles.shape != errors.shape:
        fail("true_angles", f"shape {errors.shape}", f"shape {angles.shape}")
    tiny = 1e-9  # a bin's edge is rounded: 3 * (pi / 36) is not the float next to pi / 12
    if angles.max() > limit + tiny:
        fail("true_angles", f"angles of at most {limit} in size", angles.max())
    bins = np.floor(angles / width + tiny).astype(int)
    bins = np.minimum(bins, int(np.ceil(limit / width - tiny)) - 1)
    means = [errors[bins == b].mean() for b in np.unique(bins)]
    return float(np.mean(means))


def _errors(errors: Array, name: str = "errors") -> np.ndarray:
    """Errors may be infinite, so they have a check of their own."""
    array = to_numbers(name, errors)
    if array.ndim != 1 or not array.size:
        fail(name, "shape (N,) with N of at least 1", f"shape {array.shape}")
    if np.isnan(array).any() or (array < 0).any():
        worst = int(np.argmax(np.isnan(array) | (array < 0)))
        fail(name, "numbers of at least 0", f"{array[worst]} at index {worst}")
    return array


def _thresholds(name: str, thresholds: float | Array) -> np.ndarray:
    array = to_numbers(name, thresholds)
    if array.ndim > 1 or np.isnan(array).any() or (array < 0).any():
        fail(name, "numbers of at least 0", array.tolist())
    return array
