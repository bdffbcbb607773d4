"""f1 by a loop; what a turn, a move, a scale and a mirror leave of each form."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from posecore.methods.invariant_gcn.invariants import (
    FORMS,
    LocalFeatures,
    pair_channels,
    point_channels,
)
from posecore.rotations import random_rotations
from tests.methods.invariant_gcn.small import batch

MIRROR = torch.tensor([-1.0, 1, 1]).double()
each_form = pytest.mark.parametrize("form", FORMS)


def cloud(seed=0):
    given = batch(2, 24, torch.float64, seed)
    return given["points"], given["normals"], given["neighbours"].long(), given["view"]


def turned(points, normals, neighbours, view, Q):
    return points @ Q.mT, normals @ Q.mT, neighbours, (Q @ view[..., None])[..., 0]


def all_of(points, normals, neighbours, view, form, **options):
    pairs = pair_channels(points, normals, neighbours, view, form, toward_camera=True)
    single = point_channels(points, normals, view, form)
    f1 = LocalFeatures(form, **options)(points, normals, neighbours, view)
    return pairs, single, f1


def test_f1_by_a_loop():
    points, normals, near, view = cloud()
    options = {"pairs": 5, "unit": 0.1}
    found = LocalFeatures("oriented", **options)(points, normals, near, view)
    wide = LocalFeatures("oriented", divisor=20, **options)(points, normals, near, view)
    for b in range(2):
        for i in range(24):
            rows = []
            for j in near[b, i, :5].tolist():
                way = points[b, j] - points[b, i]
                u = way / way.norm()
                angles = [(n @ u).clamp(-1, 1).acos() for n in normals[b, [i, j]]]
                rows.append(torch.stack([way.norm() / 0.1, *angles]))
            torch.testing.assert_close(found[b, i], torch.stack(rows).mean(0))
    torch.testing.assert_close(wide, found / 4)


@each_form
@given(seed=st.integers(0, 10**6))
def test_a_turn_changes_nothing(form, seed):
    given = cloud(seed)
    Q = random_rotations(2, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    for one, other in zip(all_of(*given, form), all_of(*turned(*given, Q), form), strict=True):
        torch.testing.assert_close(other, one, rtol=1e-8, atol=1e-8)


@each_form
def test_a_mirror_image(form):
    """The same, to the bit, but for what is handed: that changes its sign."""
    points, normals, near, view = cloud()
    if form == "printed":  # its normals are no mirror images: a cross product turns the other way
        form, normals = "order_free", normals
    one = all_of(points, normals, near, view, form)
    other = all_of(points * MIRROR, normals * MIRROR, near, view * MIRROR, form)
    if form != "handed":
        for a, b in zip(one, other, strict=True):
            assert torch.equal(a, b)
        return
    signs = (
        torch.tensor([1, 1, 1, -1, -1, 1]), torch.tensor([1, 1, 1, -1, 1]),
        torch.tensor([1, 1, 1, -1, -1]),
    )  # fmt: skip
    for a, b, sign in zip(one, other, signs, strict=True):
        torch.testing.assert_close(b, a * sign)
        assert not torch.allclose(b, a)


def test_printed_normals_change_side_in_a_mirror_and_with_the_order_of_two():
    points, normals, near, view = cloud()
    one = LocalFeatures("printed")(points, normals, near, view)
    right = torch.pi
    mirrored = LocalFeatures("printed")(points * MIRROR, normals, near, view)
    # The first angle becomes the other side's; so an accident of the order sees the mirror.
    torch.testing.assert_close(mirrored[..., 1], right - one[..., 1])
    near = near.clone()
    near[..., :2] = near[..., [1, 0]]
    swapped = LocalFeatures("printed")(points, normals, near, view)
    torch.testing.assert_close(swapped[..., 1], right - one[..., 1])
    torch.testing.assert_close(swapped[..., 0], one[..., 0])


@each_form
def test_scale(form):
    given = cloud()
    larger = (3 * given[0], *given[1:])
    pairs, _, f1 = all_of(*given, form)
    scaled, _, more = all_of(*larger, form)
    torch.testing.assert_close(scaled[..., 1:], pairs[..., 1:])
    torch.testing.assert_close(scaled[..., 0], 3 * pairs[..., 0])
    torch.testing.assert_close(more[..., 0], 3 * f1[..., 0])
    options = {"form": form, "relative": True}
    one, other = (LocalFeatures(**options)(*each) for each in (given, larger))
    torch.testing.assert_close(other, one)
    torch.testing.assert_close(one[..., 0], torch.ones_like(one[..., 0]))  # so it says nothing
    torch.testing.assert_close(one[..., 1:], f1[..., 1:])


def test_nearest_by_features():
    """Those alike are sought among all points, and of them the nearest in space are taken."""
    points, normals, near, view = cloud()
    features = torch.zeros(2, 24, 1).double()
    features[:, 12:] = 1
    local = LocalFeatures("oriented", nearest=8, pairs=2, by_features=True)
    found = local(points, normals, near, view, features)
    assert torch.equal(local(points, normals, near, view), LocalFeatures(
        "oriented", pairs=2)(points, normals, near, view))  # fmt: skip
    exact = LocalFeatures("oriented", nearest=11, pairs=2, by_features=True)
    found = exact(points, normals, near, view, features)
    for half in (slice(0, 12), slice(12, 24)):
        distances = torch.cdist(points[:, half], points[:, half])
        distances.diagonal(dim1=1, dim2=2).fill_(torch.inf)
        nearest = distances.topk(2, largest=False).values.mean(-1) / 0.02
        torch.testing.assert_close(found[:, half, 0], nearest)


def test_copies_are_numbers_too():
    given = cloud()
    given[0][:, :10] = given[0][:, :1]
    for form in FORMS:
        for part in all_of(*given, form, relative=True):
            assert part.isfinite().all()


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("form", {"form": "signed"}), ("pairs", {"pairs": 1}), ("nearest", {"nearest": 4}),
        ("unit", {"unit": 0}), ("divisor", {"divisor": 0}),
    ],
)  # fmt: skip
def test_what_cannot_be(name, options):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        LocalFeatures(**options)


def test_too_few_neighbours():
    points, normals, near, view = cloud()
    with pytest.raises(ValueError, match="^pairs: expected an integer between 2 and 4"):
        LocalFeatures()(points, normals, near[..., :4], view)
