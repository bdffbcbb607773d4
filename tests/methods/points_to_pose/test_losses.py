"""The three losses by hand, and what a sign does to one of them."""

import pytest
import torch

from posecore.methods.points_to_pose.losses import PoseLoss
from posecore.methods.points_to_pose.network import Prediction
from posecore.rotations import matrix_to_quaternion, matrix_to_rotation_6d, random_rotations

R = random_rotations(4, generator=torch.Generator().manual_seed(0)).double()
T = torch.tensor([0.1, 0.2, 0.3]).double().expand(4, 3)
KEYPOINTS = torch.randn(5, 3, generator=torch.Generator().manual_seed(1)).double()
TRUE = KEYPOINTS @ R.mT + T[:, None]


def votes(off=(0.0, 0.0, 0.0)):
    return TRUE[:, None].expand(4, 7, 5, 3) + torch.tensor(off).double()


def test_all_is_well():
    said = Prediction(3 * matrix_to_quaternion(R), T, votes(), TRUE)
    parts = PoseLoss()(said, R, T, KEYPOINTS)
    assert parts.keys() == {"loss", "rotation", "translation", "votes"}
    assert all(part.item() == pytest.approx(0, abs=1e-12) for part in parts.values())


def test_the_sum_by_hand():
    said = Prediction(-matrix_to_quaternion(R), T + torch.tensor([0, 0.03, 0.04]), votes((3, 0, 4)))
    parts = PoseLoss(sign_free=False)(said, R, T, KEYPOINTS)
    expected = {"rotation": 2, "translation": 0.05, "votes": 5, "loss": 0.4 + 0.01 + 3}
    assert {k: v.item() for k, v in parts.items()} == pytest.approx(expected, rel=1e-6)
    parts = PoseLoss((1, 2, 3), False, True, unit=0.1, vote_norm=1)(said, R, T, KEYPOINTS)
    expected = {"rotation": 4, "translation": 0.25, "votes": 4900, "loss": 4 + 0.5 + 14700}
    assert {k: v.item() for k, v in parts.items()} == pytest.approx(expected, rel=1e-6)


def test_both_signs_of_a_quaternion_are_one_rotation():
    q = matrix_to_quaternion(R)
    for sign_free, expected in ((True, 0.0), (False, 2.0)):
        loss = PoseLoss(sign_free=sign_free)
        assert loss(Prediction(-q), R)["rotation"].item() == pytest.approx(expected, abs=1e-6)
        assert loss(Prediction(q), R)["rotation"].item() == pytest.approx(0, abs=1e-6)


def test_the_length_of_a_quaternion_is_nothing_to_the_loss():
    outputs = torch.randn(4, 4).double().requires_grad_()
    losses = [PoseLoss()(Prediction(scale * outputs), R)["loss"] for scale in (1, 5)]
    torch.testing.assert_close(*losses)
    (gradient,) = torch.autograd.grad(losses[0], outputs)
    torch.testing.assert_close((gradient * outputs).sum(-1), torch.zeros(4).double())
    zero = torch.zeros(4, 4).double().requires_grad_()
    (gradient,) = torch.autograd.grad(PoseLoss()(Prediction(zero), R)["loss"], zero)
    assert gradient.isfinite().all()


def test_other_representations():
    said = Prediction(2 * matrix_to_rotation_6d(R))
    parts = PoseLoss(representation="6d")(said, R)
    assert parts["rotation"].item() == pytest.approx(2**0.5)


def test_what_a_network_does_not_say_has_no_part():
    parts = PoseLoss()(Prediction(matrix_to_quaternion(R)), R)
    assert parts.keys() == {"loss", "rotation"}
    parts = PoseLoss()(Prediction(matrix_to_quaternion(R), T), R, T)
    assert parts.keys() == {"loss", "rotation", "translation"}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("weights", (1, 2)), ("weights", (1, 2, -1)), ("unit", 0), ("vote_norm", 3),
        ("representation", "lie"),
    ],
)  # fmt: skip
def test_numbers_that_cannot_be(name, value):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        PoseLoss(**{name: value})


def test_what_is_missing():
    said = Prediction(matrix_to_quaternion(R), T, votes(), TRUE)
    with pytest.raises(ValueError, match=r"^t: expected shape \(4, 3\), got None"):
        PoseLoss()(said, R)
    with pytest.raises(ValueError, match=r"^keypoints: expected shape \(5, 3\)"):
        PoseLoss()(said, R, T, KEYPOINTS[:4])
