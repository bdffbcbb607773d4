"""The refiner: its sizes against the reference, its symmetries, and what it says at first."""

import math
from collections.abc import Callable

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from posecore.nets.pose_refiner import PoseRefiner
from posecore.training import seeded


def clouds(batch: int, points: int, features: int) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    return (
        torch.randn(batch, points, 3, generator=generator),
        torch.randn(batch, points, features, generator=generator),
    )


def spoken(net: PoseRefiner) -> PoseRefiner:
    """Last layers that say something: new ones are zero."""
    with torch.no_grad():
        for head in (net.turn, net.shift):
            head[-1].weight.normal_(0, 0.1)
    return net


def test_weights_are_those_of_the_reference() -> None:
    # Per layer inputs x outputs; the reference's second stream takes 32 colour features.
    found = sorted(tuple(p.shape) for p in PoseRefiner(32).parameters() if p.ndim == 2)
    streams = [(64, 3), (128, 64), (64, 32), (128, 64), (512, 384), (1024, 512)]
    heads = [(512, 1024), (128, 512)] * 2 + [(4, 128), (3, 128)]
    assert found == sorted(streams + heads)


def test_widths_follow_the_first() -> None:
    net = PoseRefiner(19, objects=3, width=8)
    found = sorted(tuple(p.shape) for p in net.parameters() if p.ndim == 2)
    streams = [(8, 3), (16, 8), (8, 19), (16, 8), (64, 48), (128, 64)]
    heads = [(64, 128), (16, 64)] * 2 + [(12, 16), (9, 16)]
    assert found == sorted(streams + heads)


def test_a_new_one_corrects_nothing() -> None:
    said = PoseRefiner(5, width=4)(*clouds(3, 7, 5))
    assert torch.equal(said.quaternion, torch.tensor([[1.0, 0, 0, 0]] * 3))
    assert torch.equal(said.shift, torch.zeros(3, 3))


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 4), st.integers(1, 9), st.integers(1, 5), st.integers(1, 3), st.data())
def test_order_copies_and_company_do_not_matter(
    batch: int, count: int, features: int, objects: int, data: st.DataObject
) -> None:
    with seeded(0):
        net = spoken(PoseRefiner(features, objects, width=4)).double()
    points, known = (x.double() for x in clouds(batch, count, features))
    index = torch.tensor(data.draw(st.lists(st.integers(0, objects - 1), min_size=batch,
                                            max_size=batch)))  # fmt: skip
    said = net(points, known, index)
    order = torch.tensor(data.draw(st.permutations(range(count))))
    other = net(points[:, order], known[:, order], index)
    twice = net(points.repeat(1, 2, 1), known.repeat(1, 2, 1), index)
    alone = [net(points[i : i + 1], known[i : i + 1], index[i : i + 1]) for i in range(batch)]
    for part in (0, 1):
        assert said[part].shape == (batch, 4 - part)
        for same in (other[part], twice[part], torch.cat([one[part] for one in alone])):
            assert torch.allclose(said[part], same, rtol=1e-12, atol=1e-12)


def test_each_object_has_its_own_outputs() -> None:
    with seeded(0):
        net = spoken(PoseRefiner(5, objects=2, width=4))
    points, known = clouds(1, 6, 5)
    first, second = (net(points, known, torch.tensor([i])) for i in (0, 1))
    assert not torch.allclose(first.shift, second.shift)
    second.quaternion.sum().backward()
    gradient = net.turn[-1].weight.grad
    assert (gradient[:4] == 0).all() and (gradient[4:] != 0).any()


def test_it_learns_a_shift() -> None:
    with seeded(0):
        net = PoseRefiner(1, width=8)
    points, known = clouds(32, 10, 1)
    offset = torch.linspace(-1, 1, 32)[:, None].expand(32, 3)
    points = points + offset[:, None]
    descent = torch.optim.Adam(net.parameters(), lr=3e-3)
    errors = []
    for _ in range(150):
        said = net(points, known)
        loss = (said.shift - offset).abs().mean()
        descent.zero_grad()
        loss.backward()
        descent.step()
        errors.append(loss.item())
    assert errors[-1] < 0.2 * errors[0]
    assert all(math.isfinite(value) for value in errors)


POINTS, KNOWN = clouds(2, 5, 4)
NET = PoseRefiner(4, objects=2, width=2)
INDEX = torch.zeros(2, dtype=torch.long)


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: PoseRefiner(0), "features"),
        (lambda: PoseRefiner(4, objects=0), "objects"),
        (lambda: PoseRefiner(4, width=0), "width"),
        (lambda: PoseRefiner(4, width=1.5), "width"),
        (lambda: NET(POINTS[0], KNOWN, INDEX), "points"),
        (lambda: NET(POINTS[:, :0], KNOWN[:, :0], INDEX), "points"),
        (lambda: NET(POINTS[..., :2], KNOWN, INDEX), "points"),
        (lambda: NET(POINTS, KNOWN[..., :3], INDEX), "features"),
        (lambda: NET(POINTS, KNOWN[:, :3], INDEX), "features"),
        (lambda: NET(POINTS, KNOWN), "index"),
        (lambda: NET(POINTS, KNOWN, INDEX[:1]), "index"),
        (lambda: NET(POINTS, KNOWN, INDEX.float()), "index"),
        (lambda: NET(POINTS, KNOWN, INDEX + 2), "index"),
        (lambda: NET(POINTS, KNOWN, INDEX - 1), "index"),
    ],
)
def test_bad_input_is_named(call: Callable[[], object], name: str) -> None:
    with pytest.raises(ValueError, match=rf"^{name}:"):
        call()
