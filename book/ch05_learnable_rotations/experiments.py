"""What chapter 5 measures: Table IV, Table III's lower half in small, and what of it is the loss.

The networks are in `05_rotation_tables` and `05_rotations_seen`, as whatever changes there, and not
here, makes measurements stale.
"""

from __future__ import annotations

from torch import Tensor

from book.ch05_learnable_rotations import rotation_tables as tables
from book.ch05_learnable_rotations import rotations_seen as seen
from book.tools.claims import Claim
from posecore.nets.rotation_heads import train_codec
from posecore.scale import choose

ERRATA = "the paper leaves it out"


def _lower(
    id: str,
    measurement: str,
    favoured: str,
    other: str,
    statement: str,
    source: str,
    paper: tuple[float | None, float | None] = (None, None),
) -> Claim:
    return Claim(id, statement, source, "lower", favoured, other, paper, measurement, "degrees")


CLAIMS = [
    # Table IV
    _lower("iv_6d", "self_regression", "6d", "quaternion",
           "Self-regression: 6D errs less than quaternions", "Table IV, mean", (0.49, 1.52)),
    _lower("iv_6d_largest", "self_regression", "6d, largest", "quaternion, largest",
           "Self-regression: the worst rotation of 6D is better than that of quaternions",
           "Table IV, max", (1.78, 71.24)),
    _lower("iv_procrustes", "self_regression", "procrustes", "6d",
           "Self-regression: Procrustes errs less than 6D", "Table IV, mean", (0.38, 0.49)),
    _lower("iv_learnable", "self_regression", "learnable", "quaternion",
           "Self-regression: the learnable representation errs less than quaternions",
           "Table IV, mean", (0.68, 1.52)),
    _lower("iv_not_the_best", "self_regression", "6d", "learnable",
           "Self-regression: the learnable representation is not the best", "Table IV, mean",
           (0.49, 0.68)),
    _lower("iv_axis_angle", "self_regression", "6d", "axis_angle",
           "Self-regression: 6D errs less than axis-angle", ERRATA),
    _lower("iv_euler", "self_regression", "6d", "euler",
           "Self-regression: 6D errs less than Euler angles", ERRATA),
    # Table III, lower half
    _lower("iii_quaternion", "from_images", "procrustes, chordal, easy",
           "quaternion, chordal, easy",
           "From an image: Procrustes errs less than quaternions",
           "Table III, R. error on LM-O", (36.2, 71.9)),
    _lower("iii_learnable_6d", "from_images", "learnable, output, easy", "6d, chordal, easy",
           "From an image: the learnable representation errs less than 6D",
           "Table III, R. error on LM-O", (28.1, 38.8)),
    _lower("iii_learnable", "from_images", "learnable, output, easy", "procrustes, chordal, easy",
           "From an image: the learnable representation errs less than Procrustes",
           "Table III, R. error on LM-O", (28.1, 36.2)),
    _lower("iii_learnable_occluded", "from_images", "learnable, output, occluded",
           "procrustes, chordal, occluded",
           "From an image, occluded: the learnable representation errs less than Procrustes",
           "Table III, R. error on LM-O", (28.1, 36.2)),
    _lower("points_quaternion", "from_points", "procrustes, chordal, easy",
           "quaternion, chordal, easy",
           "From points: Procrustes errs less than quaternions", ERRATA),
    _lower("points_learnable", "from_points", "learnable, output, easy",
           "procrustes, chordal, easy",
           "From points: the learnable representation errs less than Procrustes", ERRATA),
    # Is it the representation, or the loss?
    _lower("loss_rotation", "crossed_self_regression", "procrustes, output", "procrustes, chordal",
           "Self-regression: with R itself as target, a loss in Euclidean space is better than one "
           "between rotations", "sections III-C and IV-E-2"),
    _lower("loss_image", "from_images", "procrustes, output, easy", "procrustes, chordal, easy",
           "From an image: with R itself as target, a loss in Euclidean space is better than one "
           "between rotations", "sections III-C and IV-E-2"),
    _lower("loss_image_6d", "from_images", "6d, output, easy", "6d, chordal, easy",
           "From an image, 6D: a loss in Euclidean space is better than one between rotations",
           "sections III-C and IV-E-2"),
    _lower("loss_points", "from_points", "procrustes, output, easy", "procrustes, chordal, easy",
           "From points: with R itself as target, a loss in Euclidean space is better than one "
           "between rotations", "sections III-C and IV-E-2"),
    _lower("code_rotation", "crossed_self_regression", "learnable, output", "procrustes, output",
           "Self-regression: a learned code is a better target than R itself",
           "section III-C, implied"),
    _lower("code_image", "from_images", "learnable, output, easy", "procrustes, output, easy",
           "From an image: a learned code is a better target than R itself",
           "section III-C, implied"),
    _lower("code_points", "from_points", "learnable, output, easy", "procrustes, output, easy",
           "From points: a learned code is a better target than R itself",
           "section III-C, implied"),
    _lower("either_sign", "from_images", "quaternion, sign_free, easy", "quaternion, output, easy",
           "From an image, quaternions: taking q or -q, whichever is nearer, helps a loss in "
           "Euclidean space", "errata"),
]  # fmt: skip

MEASUREMENTS = {
    "self_regression": (tables.self_regression, range(5)),
    "crossed_self_regression": (tables.crossed_self_regression, range(3)),
    "from_images": (seen.from_images, range(3)),
    "from_points": (seen.from_points, range(3)),
}


def train_shipped_codec() -> dict[str, Tensor]:
    """The codec that comes with the book, trained for longer than the page trains its own."""
    codec = train_codec(seed=0, steps=choose(tiny=50, book=12_000, paper=50_000))
    return dict(codec.state_dict())


CHECKPOINTS = {"codec": train_shipped_codec}
