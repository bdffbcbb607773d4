"""Which parts are there for which branches, their weights, and that a few steps make it smaller."""

import pytest
import torch

from posecore.methods.invariant_gcn.faces import face_distances, outward_normals
from posecore.methods.invariant_gcn.network import Cloud, Prediction
from posecore.methods.invariant_gcn.total_loss import TotalLoss
from tests.methods.invariant_gcn.small import batch, network

AXES = {"rotation", "translation", "size", "axis_confidence", "consistency"}
POINTS = {"reconstruction", "point_confidence", "proportions"}
FACES = {"face_confidence", "faces"}
PLANES = {"plane_rotation", "plane_translation", "plane_size"}


def true_words(given):
    """What a network says that is right in all."""
    R, size = given["R"], given["size"]
    b, n = given["points"].shape[:2]
    diagonal = size.norm(dim=-1)
    one = torch.ones(b)
    return Prediction(
        x=R[:, :, 0], y=R[:, :, 1], x_confidence=one, y_confidence=one, t=given["t"], size=size,
        canonical=given["canonical"] / diagonal[:, None, None],
        canonical_confidence=torch.full((b, n), 100.0), proportions=size / diagonal[:, None],
        face_normals=outward_normals(R)[:, None].expand(b, n, 6, 3),
        face_distances=face_distances(given["points"], R, given["t"], size),
        face_confidences=torch.ones(b, n, 6),
    )  # fmt: skip


def test_what_is_right_costs_nothing():
    given = batch()
    for reduction in ("mean", "sum"):
        parts = TotalLoss(reduction=reduction)(true_words(given), given)
        assert parts.keys() == {"loss"} | AXES | POINTS | FACES | PLANES
        assert all(part < 2e-3 for part in parts.values()), parts


@pytest.mark.parametrize(
    ("branches", "names"),
    [
        (("axes",), AXES), (("canonical",), POINTS), (("faces",), FACES),
        (("axes", "canonical"), AXES | POINTS), (("axes", "faces"), AXES | FACES | PLANES),
    ],
)  # fmt: skip
def test_parts_are_those_of_the_branches(branches, names):
    given = batch()
    net = network(branches=branches)
    parts = TotalLoss()(net(Cloud.of(given)), given)
    assert parts.keys() == {"loss"} | names
    parts["loss"].backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in net.parameters())


def test_the_sum_is_that_of_the_equations():
    """Eq. 7, 12, 17 and 18, with the printed weights and those that are not."""
    given = batch()
    said = network()(Cloud.of(given))
    loss = TotalLoss(plane_rotation=2, plane_translation=3, plane_size=4, faces=5, confidence=6)
    p = loss(said, given)
    basic = p["rotation"] + p["translation"] + p["size"]
    pc = p["consistency"] + p["reconstruction"] + 6 * p["point_confidence"] + p["proportions"]
    bb = p["face_confidence"] + p["axis_confidence"] + 5 * p["faces"]
    bb = bb + 2 * p["plane_rotation"] + 3 * p["plane_translation"] + 4 * p["plane_size"]
    torch.testing.assert_close(p["loss"], 8 * basic + pc + bb)
    metres = TotalLoss(unit=0.1)(said, given)
    torch.testing.assert_close(metres["translation"], 10 * p["translation"])
    assert metres["rotation"] == p["rotation"]


def test_a_weight_of_nothing_leaves_a_part_out():
    given = batch()
    said = network()(Cloud.of(given))
    assert TotalLoss(pc=0)(said, given).keys() == {"loss"} | AXES - {"consistency"} | FACES | PLANES
    assert TotalLoss(faces=0)(said, given).keys() == {"loss"} | AXES | POINTS | PLANES | {
        "face_confidence"
    }


def test_symmetric_things():
    given = batch()
    said = network()(Cloud.of(given))
    asked = TotalLoss(skip_symmetric=False)(said, given)
    every = {**given, "symmetric": torch.ones(3, dtype=torch.bool)}
    skipped = TotalLoss()(said, every)
    assert skipped["rotation"] < asked["rotation"]
    other = said._replace(x=said.x + torch.randn(3, 3), x_confidence=torch.rand(3))
    for name, part in TotalLoss()(other, every).items():
        torch.testing.assert_close(part, skipped[name])


def test_a_few_steps_make_it_smaller():
    given = batch()
    net = network(norm="batch", dropout=0.0)
    descent = torch.optim.Adam(net.parameters(), lr=3e-3)
    seen = []
    for _ in range(15):
        loss = TotalLoss(unit=0.1)(net(Cloud.of(given)), given)["loss"]
        descent.zero_grad()
        loss.backward()
        descent.step()
        seen.append(float(loss.detach()))
    assert seen[-1] < 0.8 * seen[0]


def test_what_cannot_be():
    given = batch()
    for name, value in (("basic", -1), ("a", 0), ("b", 0), ("unit", 0), ("reduction", "median")):
        with pytest.raises(ValueError, match=f"^{name}: expected"):
            TotalLoss(**{name: value})
    with pytest.raises(ValueError, match="^said: expected one branch or more"):
        TotalLoss()(Prediction(), given)
    for name in ("R", "t", "size", "canonical", "symmetric"):
        with pytest.raises(ValueError, match=f"^{name}: expected shape"):
            TotalLoss()(true_words(given), {**given, name: given[name][:2]})
    with pytest.raises(ValueError, match="^symmetric: expected booleans"):
        TotalLoss()(true_words(given), {**given, "symmetric": torch.zeros(3)})
