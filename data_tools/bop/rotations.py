"""What is done about published rotations that are no rotations, for every reader of this package.

Published ground truth is rounded, and some of it was never orthonormal: LM-O's matrices are off by
up to 0.0096. An angle between such matrices depends on the formula, so a reader projects them to
the nearest rotation and says so, unless it is asked for the numbers as they are.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

from posecore.arrays import require_choice
from posecore.rotations import rotation_defect, special_procrustes

__all__ = ["RotationWarning", "check_rotations"]

ROUNDING = 1e-12  # rotations computed in float64 are closer: projecting them would only add noise
NOTICEABLE = 1e-3  # above any rounding of a written rotation; what posecore accepts as a rotation
LARGEST = 0.1  # ten times the worst ground truth known: what is farther off is something else


class RotationWarning(UserWarning):
    """A file's rotations are noticeably off, and were projected to the nearest rotations."""


def check_rotations(
    path: Path, R: np.ndarray, rotations: str, name_of: Callable[[int], str]
) -> np.ndarray:
    """Refuse matrices that are no rotations; project the others, or leave them as read.

    Matrices that are orthonormal to 1e-12 are returned bit by bit; above 1e-3 one `RotationWarning`
    for the whole file says how many there are and how far the worst is off.

    Args:
        path: the file they come from, for messages.
        R: (N, 3, 3) matrices.
        rotations: "project" for the nearest rotations, "as_read" for the matrices as they are.
        name_of: what to call the matrix with a given index in messages.

    Returns:
        (N, 3, 3) matrices.

    Raises:
        ValueError: if a determinant is not above 0, or an entry of `|R R^T - I|` is above 0.1.
    """
    require_choice("rotations", rotations, ("project", "as_read"))
    if len(R) == 0:
        return R
    defect = rotation_defect(R)
    with np.errstate(over="ignore"):  # huge entries are refused for their defect
        determinant = np.linalg.det(R)
    wrong = np.flatnonzero((defect > LARGEST) | (determinant <= 0))
    if wrong.size:
        i = int(wrong[0])
        raise ValueError(
            f"{path}: {name_of(i)}: expected a rotation, got a matrix with |R R^T - I| up to "
            f"{defect[i]:.3g} and determinant {determinant[i]:.3g}"
        )
    if rotations == "as_read":
        return R
    off = defect > NOTICEABLE
    if off.any():
        warnings.warn(
            f"{path}: {int(off.sum())} of {len(R)} rotations are not orthonormal, |R R^T - I| is "
            f"up to {defect.max():.2g}; projected to the nearest (rotations='as_read' leaves them)",
            RotationWarning,
            stacklevel=2,
        )
    return np.where((defect > ROUNDING)[:, None, None], special_procrustes(R), R)
