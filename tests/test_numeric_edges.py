"""Numbers and arguments at the ends of what there are: refused by name, or what they should be."""

import numpy as np
import pytest
import torch

from posecore import metrics, rotations

EYE, ZERO = np.eye(3), np.zeros(3)
CASES = [
    ("size_1 and size_2", lambda: metrics.oriented_iou_3d(EYE, ZERO, [1e103] * 3, EYE, ZERO,
                                                          [1e103] * 3)),
    ("size_1 and size_2", lambda: metrics.oriented_iou_3d(EYE, ZERO, [1e-108] * 3, EYE, ZERO,
                                                          [1e-108] * 3)),
    ("size_1 and size_2", lambda: metrics.oriented_iou_3d(EYE, ZERO, [1, 1, 1], EYE, ZERO,
                                                          [1e-108] * 3)),
    ("p and q", lambda: rotations.quaternion_multiply([1e200] * 4, [1e200] * 4)),
    ("p and q", lambda: rotations.quaternion_multiply([0, 1e200, 0, 0], [0, 0, 1e200, 0])),
    ("bin_width", lambda: metrics.balanced_mean_angular_error([0.1], [0.1], bin_width=1e-300)),
    ("bin_width", lambda: metrics.balanced_mean_angular_error([0.1], [0.1], bin_width=5e-324)),
    ("generator", lambda: rotations.random_rotations(2, generator=2**80)),
    ("dtype", lambda: rotations.random_rotations(2, generator=0, dtype=torch.int32)),
    ("dtype", lambda: rotations.random_rotations(2, generator=0, dtype="float32")),
    ("R_est", lambda: metrics.add(np.ma.array(EYE, mask=EYE > 0), ZERO, EYE, ZERO, EYE)),
    ("errors", lambda: metrics.balanced_mean_angular_error(np.ma.array([0.1, 1], mask=[0, 1]),
                                                           [0.1, 0.1])),
]  # fmt: skip


@pytest.mark.parametrize(("name", "call"), CASES)
def test_what_would_be_no_number_is_refused_by_name(name, call):
    with pytest.raises(ValueError, match=f"^{name}: expected "):
        call()


def test_what_is_within_is_taken():
    assert metrics.oriented_iou_3d(EYE, ZERO, [1e-102] * 3, EYE, ZERO, [1e-102] * 3) == 1
    assert metrics.oriented_iou_3d(EYE, ZERO, [1e100] * 3, EYE, ZERO, [1e100] * 3) == 1
    assert rotations.random_rotations(2, generator=2**64 - 1).shape == (2, 3, 3)
    unmasked = np.ma.array(EYE, mask=False)
    assert metrics.add(unmasked, ZERO, EYE, ZERO, EYE) == 0
    with pytest.raises(ValueError, match=r"^points: expected an array without masked .*, got 1 "):
        metrics.add(EYE, ZERO, EYE, ZERO, [np.ma.array([1.0, 2, 3], mask=[0, 1, 0]), EYE[0]])


def test_the_legacy_score_of_cubes_around_the_origin_is_not_a_number():
    """As the public function has it, which the docstring says."""
    size = np.ones(3)
    assert np.isnan(metrics.nocs_legacy_iou(EYE, ZERO, size, EYE, ZERO, size))
    corners = metrics.box_corners(EYE, ZERO, size)
    product = np.prod(corners.max(1) - corners.min(1))  # of the public function's intervals
    assert product == 0
