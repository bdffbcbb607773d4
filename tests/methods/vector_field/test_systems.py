"""The systems: exact on clean fields, an answer for every mask, and who refines when."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posecore import cameras, metrics, poses
from posecore.methods.vector_field.masked_fields import MaskedFields
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.methods.vector_field.refinement import FieldRefiner, overlap
from posecore.methods.vector_field.systems import STAGES, SYSTEMS, VectorFieldSystem, is_refined
from posecore.methods.vector_field.voting import VoteOptions, vote_pixels
from posecore.models import ObjectModel
from posecore.training import seeded

K = np.array([[130.0, 0, 48], [0, 130, 36], [0, 0, 1]])
RNG = np.random.default_rng(0)
POINTS = RNG.normal(size=(300, 3)) * [0.05, 0.03, 0.04]
POINTS = POINTS[np.abs(POINTS).max(1) < 0.09]
MODELS = [
    ObjectModel(number, scale * POINTS, scale * 0.3, scale * POINTS[[3, 50, 100, 150, 200, 7]])
    for number, scale in ((3, 1.0), (5, 0.8))
]
with seeded(0):
    NET = VectorFieldNet(objects=2, keypoints=6, width=4).eval()


def poses_of(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    t = rng.uniform([-0.05, -0.05, 0.5], [0.05, 0.05, 0.8], (3, 3))
    return Rotation.random(3, random_state=rng).as_matrix(), t


IMAGE, OBJECT = [0, 0, 2], [0, 1, 1]


def clean(
    seed: int, holes: float = 0.0, noise: float = 0.0
) -> tuple[MaskedFields, list[np.ndarray]]:
    """True fields of both objects in image 0, of the second in image 2; and their masks.

    Holes are a share of the masks; noise, relative, is added to the vectors.
    """
    columns, masks = [], []
    for image, object, R, t in zip(IMAGE, OBJECT, *poses_of(seed), strict=True):
        model = MODELS[object]
        x, y = np.round(cameras.project(K, poses.apply(R, t, model.points))).astype(int).T
        mask = np.zeros((72, 96), bool)
        for dy in (-1, 0, 1):
            for dx in (-1, 0, 1):
                mask[np.clip(y + dy, 0, 71), np.clip(x + dx, 0, 95)] = True
        mask &= np.random.default_rng(seed).random(mask.shape) >= holes
        y, x = mask.nonzero()
        ends = cameras.project(K, poses.apply(R, t, model.keypoints))
        vectors = ends - np.stack([x, y], -1)[:, None]
        lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
        vectors += noise * lengths * np.random.default_rng(seed).normal(size=vectors.shape)
        columns.append([np.full(len(x), image), y, x, np.full(len(x), object), vectors])
        masks.append(mask)
    joined = (torch.from_numpy(np.concatenate(column)) for column in zip(*columns, strict=True))
    return MaskedFields(*joined), masks


def refiner() -> FieldRefiner:
    """One that turns and shifts by a fixed amount."""
    found = FieldRefiner(MODELS, width=2, points=20, iterations=1)
    with torch.no_grad():
        found.net.shift[-1].bias[:] = 0.01
        found.net.turn[-1].bias[1::4] = 0.01
    return found


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 2**31))
def test_a_clean_field_gives_the_pose(seed: int) -> None:
    fields, masks = clean(seed)
    R, t = poses_of(seed)
    found = VectorFieldSystem.named("OPEPL", NET, MODELS).estimate_fields(fields, K)
    assert [e.image for e in found] == IMAGE
    assert [e.object_id for e in found] == [MODELS[o].object_id for o in OBJECT]
    for estimate, object, R_gt, t_gt, mask in zip(found, OBJECT, R, t, masks, strict=True):
        points = MODELS[object].points
        # Float64 throughout: what the vote leaves is far below a thousandth of a pixel.
        assert metrics.add(estimate.R, estimate.t, R_gt, t_gt, points) < 1e-6
        ends = cameras.project(K, poses.apply(R_gt, t_gt, MODELS[object].keypoints))
        assert np.abs(estimate.keypoints - ends).max() < 1e-3
        assert estimate.overlap == overlap(points, estimate.R, estimate.t, K, mask)
        assert estimate.score > 0.99 and not estimate.refined
        assert np.array_equal(estimate.first[0], estimate.R)
        assert list(estimate.seconds) == list(STAGES)
        assert all(value >= 0 for value in estimate.seconds.values())


def test_the_vote_fits_what_it_is_told_to() -> None:
    noisy, _ = clean(4, noise=0.05)
    found = {}
    for fit in ("lines", "angles"):
        system = VectorFieldSystem.named("OPEPL", NET, MODELS, voting=VoteOptions(fit=fit))
        found[fit] = system.estimate_fields(noisy, K)
        for entry, estimate in enumerate(found[fit]):
            vote = vote_pixels(*(part.double() for part in noisy.of(entry)), VoteOptions(fit=fit))
            assert np.array_equal(estimate.keypoints, vote.points)
            assert np.array_equal(estimate.covariances, vote.covariances)
    assert VectorFieldSystem(NET, MODELS).voting == VoteOptions()
    for one, other in zip(found["lines"], found["angles"], strict=True):
        assert one.score == other.score
        assert not np.array_equal(one.t, other.t)


def test_who_refines_when() -> None:
    whole, holed = clean(1)[0], clean(1, holes=0.6)[0]
    refined = {}
    for name, when in SYSTEMS.items():
        system = VectorFieldSystem.named(name, NET, MODELS, refiner())
        assert system.refine == when
        for fields, holes in ((whole, False), (holed, True)):
            found = system.estimate_fields(fields, K)
            refined[name, holes] = {estimate.refined for estimate in found}
            for estimate in found:
                moved = not np.array_equal(estimate.t, estimate.first[1])
                assert moved == estimate.refined
                assert np.allclose(estimate.R @ estimate.R.T, np.eye(3), atol=1e-6)
                assert estimate.R.dtype == estimate.t.dtype == np.float64
    assert refined == {
        ("OPEPL", False): {False}, ("OPEPL", True): {False},
        ("OPEPL-R", False): {True}, ("OPEPL-R", True): {True},
        ("OPEPL-DR", False): {True}, ("OPEPL-DR", True): {False},
    }  # fmt: skip


def test_the_threshold_is_the_overlap_that_must_be_exceeded() -> None:
    fields, _ = clean(2, holes=0.4)
    first = VectorFieldSystem(NET, MODELS).estimate_fields(fields, K)
    middle = sorted(estimate.overlap for estimate in first)[1]
    system = VectorFieldSystem(NET, MODELS, refiner(), "overlap", threshold=middle)
    found = system.estimate_fields(fields, K)
    assert [e.refined for e in found] == [e.overlap > middle for e in first]
    assert sum(e.refined for e in found) == 1


def test_one_refined_alone_is_refined_the_same() -> None:
    fields, _ = clean(3)
    system = VectorFieldSystem(NET, MODELS, refiner(), "always")
    together = system.estimate_fields(fields, K)
    again = system.estimate_fields(fields, np.stack([K] * 3))
    for one, other in zip(together, again, strict=True):
        assert np.array_equal(one.R, other.R) and np.array_equal(one.t, other.t)
    second, _ = clean(3)
    pixels, vectors = second.of(1)
    zeros = torch.zeros(len(pixels), dtype=torch.long)
    alone = MaskedFields(zeros, pixels[:, 1], pixels[:, 0], zeros + 1, vectors)
    (estimate,) = system.estimate_fields(alone, K)
    assert np.allclose(estimate.R, together[1].R, rtol=0, atol=1e-6)
    assert np.allclose(estimate.t, together[1].t, rtol=0, atol=1e-6)


@pytest.mark.parametrize("kind", ["zero", "parallel", "random", "one pixel"])
def test_every_mask_has_an_answer(kind: str) -> None:
    ys, xs = (torch.from_numpy(v.ravel()) for v in np.mgrid[20:32, 30:50])
    vectors = torch.zeros(len(xs), 6, 2)
    if kind == "parallel":
        vectors[..., 0] = 1
    elif kind == "random":
        vectors = torch.randn(len(xs), 6, 2, generator=torch.Generator().manual_seed(0))
    elif kind == "one pixel":
        xs, ys, vectors = xs[:1], ys[:1], vectors[:1] + 1
    zeros = torch.zeros(len(xs), dtype=torch.long)
    fields = MaskedFields(zeros, ys, xs, zeros, vectors)
    for refine in SYSTEMS.values():
        (found,) = VectorFieldSystem(NET, MODELS, refiner(), refine).estimate_fields(fields, K)
        assert np.isfinite(found.R).all() and np.isfinite(found.t).all() and found.t[2] > 0
        assert 0 <= found.score < 0.6 and 0 <= found.overlap <= 1
    if kind != "random":  # a guess: in front of the mask, as far as its size tells
        assert found.score == 0
        (pixel,) = cameras.project(
            K, (found.first[0] @ MODELS[0].keypoints[-1] + found.first[1])[None]
        )
        middle = [(xs.min() + xs.max()) / 2, (ys.min() + ys.max()) / 2]
        assert np.allclose(pixel, middle, rtol=0, atol=1e-9)


def test_images_go_through_the_network() -> None:
    generator = torch.Generator().manual_seed(0)
    images = torch.rand(2, 3, 24, 32, generator=generator)
    system = VectorFieldSystem(NET, MODELS, min_pixels=5, voting=VoteOptions(hypotheses=8))
    found = system.estimate(images, K)
    again = system.estimate(images.numpy(), np.stack([K, K]))
    assert found and len(found) == len(again)
    for one, other in zip(found, again, strict=True):
        assert one.image == other.image and np.array_equal(one.R, other.R)
        assert one.seconds["network"] > 0 and one.seconds["voting"] > 0
    assert [e.image for e in found] == sorted(e.image for e in found)
    assert VectorFieldSystem(NET, MODELS, min_pixels=24 * 32 + 1).estimate(images, K) == []


IMAGES = torch.zeros(1, 3, 24, 32)
SYSTEM = VectorFieldSystem(NET, MODELS)
FIELDS = clean(0)[0]


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: VectorFieldSystem(None, MODELS), "net"),
        (lambda: VectorFieldSystem(NET, MODELS[:1]), "net"),
        (lambda: VectorFieldSystem(VectorFieldNet(2, 5, 4), MODELS), "net"),
        (lambda: VectorFieldSystem(NET, []), "models"),
        (lambda: VectorFieldSystem(NET, MODELS, refine="sometimes"), "refine"),
        (lambda: VectorFieldSystem(NET, MODELS, refine="always"), "refiner"),
        (lambda: VectorFieldSystem(NET, MODELS, NET), "refiner"),
        (lambda: VectorFieldSystem(NET, MODELS[::-1], refiner()), "refiner"),
        (lambda: VectorFieldSystem(NET, MODELS, threshold=1.5), "threshold"),
        (lambda: VectorFieldSystem(NET, MODELS, min_pixels=0), "min_pixels"),
        (lambda: VectorFieldSystem(NET, MODELS, voting={"hypotheses": 8}), "voting"),
        (lambda: VectorFieldSystem.named("PVNet", NET, MODELS), "name"),
        (lambda: SYSTEM.estimate(IMAGES[0], K), "images"),
        (lambda: SYSTEM.estimate(IMAGES[:, :2], K), "images"),
        (lambda: SYSTEM.estimate(255 + IMAGES, K), "images"),
        (lambda: SYSTEM.estimate(IMAGES * np.nan, K), "images"),
        (lambda: SYSTEM.estimate(IMAGES.byte(), K), "images"),
        (lambda: SYSTEM.estimate(IMAGES, np.zeros((3, 3))), "K"),
        (lambda: SYSTEM.estimate(IMAGES, K[None, :2]), "K"),
        (lambda: SYSTEM.estimate_fields(FIELDS, K[None]), "K"),
        (lambda: VectorFieldSystem(VectorFieldNet(1, 6, 4), MODELS[:1])
         .estimate_fields(FIELDS, K), "fields"),
    ],
)  # fmt: skip
def test_bad_input_is_named(call: Callable[[], object], name: str) -> None:
    with pytest.raises(ValueError, match=rf"^{name}:"):
        call()


@pytest.mark.parametrize(
    ("refine", "overlap", "expected"),
    [
        ("never", 1.0, False),
        ("always", 0.0, True),
        ("overlap", 0.8, False),
        ("overlap", 0.81, True),
    ],
)
def test_which_poses_are_refined(refine: str, overlap: float, expected: bool) -> None:
    assert is_refined(refine, overlap, 0.8) is expected
