"""What chapter 5 measures: Table IV, Table III's lower half in small, and what of it is the loss.

Networks and tests are in `rotation_tables` and `rotations_seen`. Errors are mean angles in degrees.
"""

from __future__ import annotations

from torch import Tensor

from book.ch05_learnable_rotations import rotation_tables as tables
from book.ch05_learnable_rotations import rotations_seen as seen
from book.tools.checkpoints import Training
from book.tools.claims import Claim
from book.tools.keys import Key
from book.tools.ledger import Measurement
from posecore.nets.rotation_heads import train_codec
from posecore.scale import choose

LOWER = {"better": "lower", "unit": "degrees"}
OURS = {"source": "the paper leaves it out", "ours": True}
TABLE_III = "Table III, R. error on LM-O"

CLAIMS = [
    # Table IV
    Claim(id="iv_6d", statement="Self-regression: 6D errs less than quaternions",
          source="Table IV, mean", measurement="self_regression",
          favoured=Key("6d", metric="rotation"), other=Key("quaternion", metric="rotation"),
          paper=(0.49, 1.52), **LOWER),
    Claim(id="iv_6d_largest",
          statement="Self-regression: the worst rotation of 6D is better than that of quaternions",
          source="Table IV, max", measurement="self_regression",
          favoured=Key("6d", metric="rotation largest"),
          other=Key("quaternion", metric="rotation largest"), paper=(1.78, 71.24), **LOWER),
    Claim(id="iv_procrustes", statement="Self-regression: Procrustes errs less than 6D",
          source="Table IV, mean", measurement="self_regression",
          favoured=Key("procrustes", metric="rotation"), other=Key("6d", metric="rotation"),
          paper=(0.38, 0.49), **LOWER),
    Claim(id="iv_learnable",
          statement="Self-regression: the learnable representation errs less than quaternions",
          source="Table IV, mean", measurement="self_regression",
          favoured=Key("learnable", metric="rotation"), other=Key("quaternion", metric="rotation"),
          paper=(0.68, 1.52), **LOWER),
    Claim(id="iv_not_the_best",
          statement="Self-regression: the learnable representation is not the best",
          source="Table IV, mean", measurement="self_regression",
          favoured=Key("6d", metric="rotation"), other=Key("learnable", metric="rotation"),
          paper=(0.49, 0.68), **LOWER),
    Claim(id="iv_axis_angle", statement="Self-regression: 6D errs less than axis-angle",
          measurement="self_regression", favoured=Key("6d", metric="rotation"),
          other=Key("axis_angle", metric="rotation"), **LOWER, **OURS),
    Claim(id="iv_euler", statement="Self-regression: 6D errs less than Euler angles",
          measurement="self_regression", favoured=Key("6d", metric="rotation"),
          other=Key("euler", metric="rotation"), **LOWER, **OURS),
    # Table III, lower half
    Claim(id="iii_quaternion",
          statement="From an image: Procrustes errs less than quaternions",
          source=TABLE_III, measurement="from_images",
          favoured=Key("procrustes, chordal", "easy", "rotation"),
          other=Key("quaternion, chordal", "easy", "rotation"), paper=(36.2, 71.9), **LOWER),
    Claim(id="iii_learnable_6d",
          statement="From an image: the learnable representation errs less than 6D",
          source=TABLE_III, measurement="from_images",
          favoured=Key("learnable, output", "easy", "rotation"),
          other=Key("6d, chordal", "easy", "rotation"), paper=(28.1, 38.8), **LOWER),
    Claim(id="iii_learnable",
          statement="From an image: the learnable representation errs less than Procrustes",
          source=TABLE_III, measurement="from_images",
          favoured=Key("learnable, output", "easy", "rotation"),
          other=Key("procrustes, chordal", "easy", "rotation"), paper=(28.1, 36.2), **LOWER),
    Claim(id="iii_learnable_occluded",
          statement="From an image, occluded: the learnable representation errs less than "
          "Procrustes",
          source=TABLE_III, measurement="from_images",
          favoured=Key("learnable, output", "occluded", "rotation"),
          other=Key("procrustes, chordal", "occluded", "rotation"), paper=(28.1, 36.2), **LOWER),
    Claim(id="points_quaternion",
          statement="From points: Procrustes errs less than quaternions",
          measurement="from_points", favoured=Key("procrustes, chordal", "easy", "rotation"),
          other=Key("quaternion, chordal", "easy", "rotation"), **LOWER, **OURS),
    Claim(id="points_learnable",
          statement="From points: the learnable representation errs less than Procrustes",
          measurement="from_points", favoured=Key("learnable, output", "easy", "rotation"),
          other=Key("procrustes, chordal", "easy", "rotation"), **LOWER, **OURS),
    # Is it the representation, or the loss? The paper says it of poses that are seen in images: of
    # self-regression it says itself that its representation is not the best, and it has no points.
    Claim(id="loss_rotation",
          statement="Self-regression: with R itself as target, a loss in Euclidean space is better "
          "than one between rotations",
          measurement="crossed_self_regression",
          favoured=Key("procrustes, output", metric="rotation"),
          other=Key("procrustes, chordal", metric="rotation"), **LOWER, **OURS),
    Claim(id="loss_image",
          statement="From an image: with R itself as target, a loss in Euclidean space is better "
          "than one between rotations",
          source="sections III-C and IV-E-2", measurement="from_images",
          favoured=Key("procrustes, output", "easy", "rotation"),
          other=Key("procrustes, chordal", "easy", "rotation"), **LOWER),
    Claim(id="loss_image_6d",
          statement="From an image, 6D: a loss in Euclidean space is better than one between "
          "rotations",
          source="sections III-C and IV-E-2", measurement="from_images",
          favoured=Key("6d, output", "easy", "rotation"),
          other=Key("6d, chordal", "easy", "rotation"), **LOWER),
    Claim(id="loss_points",
          statement="From points: with R itself as target, a loss in Euclidean space is better "
          "than one between rotations",
          measurement="from_points", favoured=Key("procrustes, output", "easy", "rotation"),
          other=Key("procrustes, chordal", "easy", "rotation"), **LOWER, **OURS),
    Claim(id="code_rotation",
          statement="Self-regression: a learned code is a better target than R itself",
          measurement="crossed_self_regression",
          favoured=Key("learnable, output", metric="rotation"),
          other=Key("procrustes, output", metric="rotation"), **LOWER, **OURS),
    Claim(id="code_image",
          statement="From an image: a learned code is a better target than R itself",
          source="section III-C, implied", measurement="from_images",
          favoured=Key("learnable, output", "easy", "rotation"),
          other=Key("procrustes, output", "easy", "rotation"), **LOWER),
    Claim(id="code_points",
          statement="From points: a learned code is a better target than R itself",
          measurement="from_points", favoured=Key("learnable, output", "easy", "rotation"),
          other=Key("procrustes, output", "easy", "rotation"), **LOWER, **OURS),
    Claim(id="either_sign",
          statement="From an image, quaternions: taking q or -q, whichever is nearer, helps a loss "
          "in Euclidean space",
          source="errata", ours=True, measurement="from_images",
          favoured=Key("quaternion, sign_free", "easy", "rotation"),
          other=Key("quaternion, output", "easy", "rotation"), **LOWER),
]  # fmt: skip

TEAPOTS = ("tabletop/train", "tabletop/easy", "tabletop/occluded")
MEASUREMENTS = {
    "self_regression": Measurement(tables.self_regression, range(5)),
    "crossed_self_regression": Measurement(tables.crossed_self_regression, range(3)),
    "from_images": Measurement(seen.from_images, range(3), TEAPOTS),
    "from_points": Measurement(seen.from_points, range(3), TEAPOTS),
}


def train_shipped_codec() -> dict[str, Tensor]:
    """The codec that comes with the book, trained for longer than the page trains its own."""
    codec = train_codec(seed=0, steps=choose(tiny=50, book=12_000, paper=50_000))
    return dict(codec.state_dict())


CHECKPOINTS = {"codec": Training(train_shipped_codec)}
