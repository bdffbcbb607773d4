"""Each equation beside a loop or a number that is known; all are 0 where all is true."""

import math

import pytest
import torch

from posecore.methods.invariant_gcn import losses
from posecore.methods.invariant_gcn.faces import FACES, face_distances, outward_normals, voted_faces
from posecore.registration import Plane
from posecore.rotations import axis_angle_to_matrix
from tests.methods.invariant_gcn.small import batch

NOBODY = torch.zeros(3, dtype=torch.bool)
SECOND = torch.tensor([False, True, False])


def truth():
    given = batch(dtype=torch.float64)
    return given["points"], given["R"], given["t"], given["size"], given["canonical"]


def true_votes():
    points, R, t, size, _ = truth()
    normals = outward_normals(R)[:, None].expand(3, 40, 6, 3)
    return normals, face_distances(points, R, t, size)


def noise(*shape, seed=0):
    return 0.1 * torch.randn(*shape, generator=torch.Generator().manual_seed(seed)).double()


def close(found, expected):
    assert float(found) == pytest.approx(float(expected), rel=1e-9, abs=1e-12)


def test_axes_translation_and_size_eq_4_to_6():
    _, R, t, size, _ = truth()
    x, y = R[:, :, 0] + noise(3, 3), R[:, :, 1] + noise(3, 3, seed=1)
    terms = [
        [float((a[b] - R[b, :, k]).abs().sum()) for k, a in enumerate((x, y))] for b in range(3)
    ]
    close(losses.axis_loss(x, y, R, NOBODY), sum(a + b for a, b in terms) / 3)
    expected = (sum(a + b for a, b in terms) - terms[1][0]) / 3
    close(losses.axis_loss(x, y, R, SECOND), expected)
    off = noise(3, 3)
    for loss, true in ((losses.translation_loss, t), (losses.size_loss, size)):
        close(loss(true + off, true), off.abs().sum() / 3)
        close(loss(true, true), 0)


@pytest.mark.parametrize("reduction", losses.REDUCTIONS)
def test_points_eq_8(reduction):
    points, R, t, size, canonical = truth()
    wrong_t = t + noise(3, 3)
    share = {"mean": 40, "sum": 1}[reduction] * 3
    total = 0.0
    for b in range(3):
        for p, c in zip(points[b], canonical[b], strict=True):
            total += float((R[b].T @ (p - wrong_t[b]) - c).abs().sum())
    close(losses.consistency_loss(points, R, wrong_t, canonical, reduction), total / share)
    close(losses.consistency_loss(points, R, t, canonical, reduction), 0)
    said = canonical / size.norm(dim=-1)[:, None, None]
    close(losses.reconstruction_loss(said, canonical, size, reduction), 0)
    off = noise(3, 40, 3)
    found = losses.reconstruction_loss(said + off, canonical, size, reduction)
    close(found, off.abs().sum() / share)


def test_confidences_of_points():
    """Least where they are what the error says, and only they are pulled."""
    _, _, _, size, canonical = truth()
    said = (canonical / size.norm(dim=-1)[:, None, None] + noise(3, 40, 3)).requires_grad_()
    error = (said - canonical / size.norm(dim=-1)[:, None, None]).norm(dim=-1).detach()
    sure = torch.logit(torch.exp(-((error / 0.06) ** 2))).requires_grad_()
    loss = losses.canonical_loss(said, sure, canonical, size)
    loss.backward()
    assert said.grad is None
    assert sure.grad.abs().max() < 1e-12
    with torch.no_grad():
        assert losses.canonical_loss(said, sure + 0.1, canonical, size) > loss


@pytest.mark.parametrize("squared", [True, False])
def test_confidences_of_faces_eq_10_and_11(squared):
    points, R, t, size, _ = truth()
    normals, distances = true_votes()
    normals, distances = normals + noise(3, 40, 6, 3), distances + noise(3, 40, 6)
    sure = torch.rand(3, 40, 6, generator=torch.Generator().manual_seed(1)).double()
    total = 0.0
    for b in range(3):
        for j in range(40):
            for i, name in enumerate(FACES):
                k, sign = "xyz".index(name[0]), 1 if name[1] == "+" else -1
                r = sign * R[b, :, k]
                f = size[b, k] / 2 - r @ (points[b, j] - t[b])
                off = float((distances[b, j, i] * normals[b, j, i] - f * r).norm())
                wanted = math.exp(-303.5 * (off**2 if squared else off))
                total += abs(float(sure[b, j, i]) - wanted)
    arguments = normals, distances, sure, points, R, t, size
    found = losses.face_confidence_loss(*arguments, squared=squared, reduction="sum")
    close(found, total / 3)
    close(losses.face_confidence_loss(*arguments, squared=squared), found / 240)


def test_five_centimetres_off_is_a_confidence_of_a_half_with_the_square():
    points, R, t, size, _ = truth()
    normals, distances = true_votes()
    sure = torch.full((3, 40, 6), 0.4683, dtype=torch.float64)
    arguments = normals, distances + 0.05, sure, points, R, t, size
    assert losses.face_confidence_loss(*arguments) < 1e-4
    close(losses.face_confidence_loss(*arguments, squared=False), 0.4683 - math.exp(-15.175))


def test_who_learns_by_a_confidence():
    points, R, t, size, _ = truth()
    normals, distances = (x.clone().requires_grad_() for x in true_votes())
    sure = torch.full((3, 40, 6), 0.5, dtype=torch.float64, requires_grad=True)
    for detach in (True, False):
        normals.grad = None
        moved = distances + 0.03
        losses.face_confidence_loss(
            normals, moved, sure, points, R, t, size, detach=detach
        ).backward()
        assert (normals.grad is None) == detach
    x, y = R[:, :, 0] + 0.1, R[:, :, 1] + 0.1
    for detach in (True, False):
        x = x.detach().requires_grad_()
        c = torch.full((3,), 0.5, dtype=torch.float64, requires_grad=True)
        losses.confidence_loss(x, y, c, c, R, NOBODY, detach=detach).backward()
        assert (x.grad is None) == detach


def test_directions_and_distances_of_faces():
    points, R, t, size, _ = truth()
    normals, distances = true_votes()
    close(losses.face_loss(normals, distances, points, R, t, size), 0)
    off, far = noise(3, 40, 6, 3), noise(3, 40, 6, seed=1)
    found = losses.face_loss(normals + off, distances + far, points, R, t, size, 0.1, "sum")
    close(found, (off.abs().sum() + far.abs().sum() / 0.1) / 3)


def test_planes_that_agree_eq_13_to_15():
    points, R, t, size, _ = truth()
    planes = voted_faces(points, *true_votes(), torch.ones(3, 40, 6).double())
    for reduction in losses.REDUCTIONS:
        assert losses.plane_normal_loss(planes, R, NOBODY, reduction) < 1e-6
        assert losses.centre_plane_loss(planes, t, reduction) < 1e-6
        assert losses.size_plane_loss(planes, t, size, reduction) < 1e-6


def test_planes_by_a_loop_eq_13_to_15():
    _, R, t, size, _ = truth()
    normal = outward_normals(R) + noise(3, 6, 3)
    planes = Plane(normal, noise(3, 6, seed=1))
    normals = middles = sizes = 0.0
    for b in range(3):
        away = [abs(float(normal[b, i] @ t[b] - planes.offset[b, i])) for i in range(6)]
        for i in range(6):
            sign = 1 if i < 3 else -1
            normals += float((sign * R[b, :, i % 3] - normal[b, i]).abs().sum())
            sizes += abs(float(size[b, i % 3]) / 2 - away[i])
        middles += sum(abs(away[i] - away[i + 3]) for i in range(3))
    close(losses.plane_normal_loss(planes, R, NOBODY, "sum"), normals / 3)
    close(losses.centre_plane_loss(planes, t, "sum"), middles / 3)
    close(losses.size_plane_loss(planes, t, size, "sum"), sizes / 3)
    close(losses.plane_normal_loss(planes, R, NOBODY), normals / 18)
    close(losses.centre_plane_loss(planes, t), middles / 9)
    close(losses.size_plane_loss(planes, t, size), sizes / 18)


def test_a_turn_about_y_means_nothing_for_symmetric_things():
    _, R, _, _, _ = truth()
    turned = R @ axis_angle_to_matrix(torch.tensor([0, 0.7, 0]).double())
    everyone = ~NOBODY
    c = torch.tensor(1.0).double().expand(3)
    axes = turned[:, :, 0], turned[:, :, 1]
    planes = Plane(outward_normals(R), torch.zeros(3, 6))
    for loss, arguments in (
        (losses.axis_loss, (*axes, R)), (losses.confidence_loss, (*axes, c, c, R)),
        (losses.plane_normal_loss, (planes, turned)),
    ):  # fmt: skip
        close(loss(*arguments, everyone), 0)
        assert loss(*arguments, NOBODY) > 0.1


def test_confidences_of_axes_eq_16():
    _, R, _, _, _ = truth()
    x, y = R[:, :, 0] + noise(3, 3), R[:, :, 1] + noise(3, 3, seed=1)
    c_x, c_y = torch.rand(2, 3, generator=torch.Generator().manual_seed(1)).double()
    total = 0.0
    for b in range(3):
        for k, (axis, c) in enumerate(((x, c_x), (y, c_y))):
            error = float((axis[b] - R[b, :, k]).norm())
            total += abs(float(c[b]) - math.exp(-13.7 * error**2))
    close(losses.confidence_loss(x, y, c_x, c_y, R, NOBODY), total / 3)


def test_numbers_that_cannot_be():
    points, R, t, size, canonical = truth()
    with pytest.raises(ValueError, match="^reduction: expected one of 'mean', 'sum'"):
        losses.consistency_loss(points, R, t, canonical, "median")
    with pytest.raises(ValueError, match="^a: expected"):
        votes = (*true_votes(), torch.ones(3, 40, 6))
        losses.face_confidence_loss(*votes, points, R, t, size, a=0)
    with pytest.raises(ValueError, match="^b: expected"):
        axes = R[:, :, 0], R[:, :, 1], torch.ones(3), torch.ones(3), R, NOBODY
        losses.confidence_loss(*axes, b=0)
    with pytest.raises(ValueError, match="^width: expected"):
        losses.canonical_loss(canonical, canonical[..., 0], canonical, size, 0)
