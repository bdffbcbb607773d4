"""Vectors to keypoints, and the targets of a batch against a loop over its pixels."""

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posecore.methods.vector_field.fields import (
    field_targets,
    keypoint_vectors,
    project_keypoints,
    unit,
)
from posecore.symmetry import canonical_rotation

SEEDS = st.integers(0, 2**32 - 1)
IDS = (5, 2, 9)
HALF_TURN = np.stack([np.eye(4), np.diag([-1.0, -1, 1, 1])])


def make_batch(seed, images=3, objects=4, size=(12, 10), dtype=torch.float32):
    """Objects of ids 1 to 9 in random masks, some of which are hidden; and places for none."""
    rng = np.random.default_rng(seed)
    h, w = size
    instance = np.full((images, h, w), -1)
    for image, slot in np.ndindex(images, objects):
        y, x = rng.integers(0, h - 3), rng.integers(0, w - 3)
        instance[image, y : y + rng.integers(0, 5), x : x + rng.integers(0, 5)] = slot
    shape = (images, objects)
    R = Rotation.random(images * objects, random_state=rng).as_matrix() if objects else np.zeros(0)
    t = rng.uniform([-0.1, -0.1, 0.5], [0.1, 0.1, 1], (*shape, 3))
    f = rng.uniform(200, 300, images)
    K = np.zeros((images, 3, 3))
    K[:, 0, 0], K[:, 1, 1], K[:, 2, 2], K[:, 0, 2], K[:, 1, 2] = f, f, 1, 5, 6
    return {
        "instance": torch.tensor(instance),
        "K": torch.tensor(K, dtype=dtype),
        "object_id": torch.tensor(rng.choice([1, 2, 5, 7, 9, -1], shape)),
        "R": torch.tensor(R.reshape(*shape, 3, 3), dtype=dtype),
        "t": torch.tensor(t, dtype=dtype),
        "rgb": torch.zeros(images, 3, h, w),
    }


KEYPOINTS = torch.tensor(np.random.default_rng(0).uniform(-0.1, 0.1, (3, 4, 3)))


@pytest.mark.slow
@given(seed=SEEDS)
def test_vectors_lead_to_the_keypoints(seed):
    rng = np.random.default_rng(seed)
    pixels, keypoints = rng.normal(size=(2, 1, 5, 2)), rng.normal(size=(3, 4, 2))
    vectors = keypoint_vectors(pixels, keypoints)
    assert vectors.shape == (2, 3, 5, 4, 2)
    for b, c, p, k in np.ndindex(2, 3, 5, 4):
        reached = pixels[b, 0, p] + vectors[b, c, p, k]
        np.testing.assert_allclose(reached, keypoints[c, k], atol=1e-14)


@given(seed=SEEDS, exponent=st.integers(-5, 12))
def test_unit_vectors(seed, exponent):
    v = np.random.default_rng(seed).normal(size=(3, 4, 2)) * 10.0**exponent
    v[0, 0] = [3 * 10.0**exponent, 4 * 10.0**exponent]
    found = unit(v)
    np.testing.assert_allclose(found[0, 0], [0.6, 0.8])
    long = np.linalg.norm(v, axis=-1) >= 1e-6
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1)[long], 1)
    np.testing.assert_allclose(v[..., 0] * found[..., 1], v[..., 1] * found[..., 0])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("length", [0.0, 1e-30, 1e-9, 1e-3, 1e6])
def test_unit_has_finite_gradients(length, dtype):
    v = torch.tensor([[length, 0], [0, -length], [0, 0]], dtype=dtype, requires_grad=True)
    found = unit(v)
    assert found.norm(dim=-1).max() <= 1 + 1e-6 and (found[2] == 0).all()
    found.sum().backward()
    assert v.grad.abs().max() <= 1.01e6


def test_unit_by_finite_differences():
    v = torch.randn(5, 2, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(unit, v)


@given(seed=SEEDS)
def test_keypoints_are_where_opencv_sees_them(seed):
    rng = np.random.default_rng(seed)
    R = Rotation.random(2, random_state=rng).as_matrix()
    t = rng.uniform([-0.1, -0.1, 0.5], [0.1, 0.1, 1], (2, 3))
    K = np.array([[[300, 0, 100], [0, 310, 90], [0, 0, 1]], [[50, 0, 9], [0, 50, 8.0], [0, 0, 1]]])
    keypoints = rng.uniform(-0.1, 0.1, (2, 5, 3))
    found = project_keypoints(keypoints, R, t, K)
    for i in range(2):
        seen, _ = cv2.projectPoints(keypoints[i], cv2.Rodrigues(R[i])[0], t[i], K[i], None)
        np.testing.assert_allclose(found[i], seen[:, 0], atol=1e-9)


@given(seed=SEEDS, symmetric=st.booleans())
def test_targets_of_all_pixels_by_brute_force(seed, symmetric):
    batch = make_batch(seed, dtype=torch.float64)
    symmetries = [None, HALF_TURN, np.eye(4)[None]] if symmetric else None
    found = field_targets(batch, KEYPOINTS, IDS, symmetries, None)
    labels, rest = np.zeros(batch["instance"].shape, int), []
    for image, y, x in np.ndindex(*labels.shape):
        slot = int(batch["instance"][image, y, x])
        if slot < 0 or int(batch["object_id"][image, slot]) not in IDS:
            continue
        o = IDS.index(int(batch["object_id"][image, slot]))
        labels[image, y, x] = 1 + o
        R, t = batch["R"][image, slot].numpy(), batch["t"][image, slot].numpy()
        if symmetric and o == 1:
            R, t = canonical_rotation(R, t, HALF_TURN)
        K = batch["K"][image].numpy()
        seen, _ = cv2.projectPoints(KEYPOINTS[o].numpy(), cv2.Rodrigues(R)[0], t, K, None)
        rest.append((image, y, x, o, seen[:, 0] - [x, y]))
    np.testing.assert_array_equal(found.labels, labels)
    assert len(found.vectors) == len(rest)
    for i, (image, y, x, o, vectors) in enumerate(rest):
        chosen = found.image[i], found.y[i], found.x[i], found.object[i]
        assert tuple(map(int, chosen)) == (image, y, x, o)
        np.testing.assert_allclose(found.vectors[i], vectors, atol=1e-9)


@given(seed=SEEDS, most=st.integers(1, 20))
def test_drawn_pixels_are_some_of_all(seed, most):
    batch = make_batch(seed)
    every = field_targets(batch, KEYPOINTS, IDS, pixels_per_object=None)
    torch.manual_seed(seed)
    some = field_targets(batch, KEYPOINTS, IDS, pixels_per_object=most)
    torch.manual_seed(seed)
    again = field_targets(batch, KEYPOINTS, IDS, pixels_per_object=most)
    for one, other in zip(some, again, strict=True):
        assert torch.equal(one, other)
    assert torch.equal(some.labels, every.labels)

    place = {(int(i), int(y), int(x)): n for n, (i, y, x) in enumerate(zip(*every[1:4]))}  # noqa: B905
    indices = [place[int(i), int(y), int(x)] for i, y, x in zip(*some[1:4], strict=True)]
    assert indices == sorted(set(indices))  # none twice, in the order of the image
    assert torch.equal(every.object[indices], some.object)
    assert torch.equal(every.vectors[indices], some.vectors)
    rows, kept = (
        4 * part.image + batch["instance"][part.image, part.y, part.x] for part in (every, some)
    )
    for row in rows.unique():  # every object that is seen counts
        assert (kept == row).sum() == min(most, int((rows == row).sum()))


def test_every_pixel_is_drawn_equally_often():
    batch = make_batch(0, images=1, objects=2)
    batch["instance"][:] = -1
    batch["instance"][0, :5, :4] = 0  # 20 pixels
    batch["instance"][0, 8:, :] = 1
    batch["object_id"] = torch.tensor([[5, 9]])
    torch.manual_seed(0)
    count = torch.zeros(batch["instance"].shape[1:])
    for _ in range(500):
        drawn = field_targets(batch, KEYPOINTS, IDS, pixels_per_object=5)
        count[drawn.y, drawn.x] += 1
    # 500 draws of 5 in 20 (of 5 in 40): means 125 and 62.5, deviations 9.7 and 7.4.
    assert (count[:5, :4] - 125).abs().max() < 5 * 9.7
    assert (count[8:] - 62.5).abs().max() < 5 * 7.4
    assert count.sum() == 500 * 10


def test_many_rows_are_not_confused(monkeypatch):
    """A random number near 1 may not lead into the next row, whatever its number."""
    batch = make_batch(0, images=1, objects=3000, size=(60, 50))
    batch["object_id"][:] = 9
    batch["instance"] = torch.arange(3000).flip(0).reshape(1, 60, 50)
    extremes = torch.tensor([0, 1 - 2**-24]).repeat(1500)
    monkeypatch.setattr(torch, "rand", lambda count, device: extremes)
    assert len(field_targets(batch, KEYPOINTS, IDS, pixels_per_object=1).x) == 3000


@pytest.mark.parametrize("objects", [0, 3])
def test_nothing_seen(objects):
    batch = make_batch(1, objects=objects)
    batch["instance"][:] = -1
    batch["t"][..., 2] = -1  # what is not seen may be behind the camera
    for most in (None, 7):
        found = field_targets(batch, KEYPOINTS, IDS, [HALF_TURN] * 3, most)
        assert not found.labels.any() and found.labels.shape == batch["instance"].shape
        assert found.vectors.shape == (0, 4, 2) and len(found.image) == len(found.object) == 0


def test_the_batch_stays_as_it_is():
    batch = make_batch(2)
    before = {name: value.clone() for name, value in batch.items()}
    field_targets(batch, KEYPOINTS, IDS, [HALF_TURN] * 3)
    assert all(torch.equal(batch[name], value) for name, value in before.items())


def test_kinds_of_numbers():
    found = field_targets(make_batch(3), KEYPOINTS.numpy(), IDS, [HALF_TURN] * 3)
    assert found.vectors.dtype == torch.float32
    assert all(part.dtype == torch.int64 for part in found[:-1])


def targets(change=None, keypoints=KEYPOINTS, ids=IDS, symmetries=None, most=8):
    batch = make_batch(0)
    batch["instance"][0, 0, 0], batch["object_id"][0, 0] = 0, 2
    field_targets(batch | (change or {}), keypoints, ids, symmetries, most)


ROW = torch.zeros(3, 12, 10, dtype=torch.int64)
BEHIND = torch.tensor([0.0, 0, -1]).expand(3, 4, 3)


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: project_keypoints(np.ones((4, 3)), np.eye(3), -np.ones(3), np.eye(3)), "points"),
        (lambda: project_keypoints(np.ones((4, 3)), np.eye(3), np.ones(3), np.ones((3, 3))), "K"),
        (lambda: field_targets({}, KEYPOINTS, IDS), "batch"),
        (lambda: targets({"instance": ROW[0]}), r"batch\['instance'\]"),
        (lambda: targets({"instance": ROW + 4}), r"batch\['instance'\]"),
        (lambda: targets({"instance": ROW - 2}), r"batch\['instance'\]"),
        (lambda: targets({"object_id": ROW[0, 0]}), r"batch\['object_id'\]"),
        (lambda: targets({"R": torch.ones(3, 3, 3)}), r"batch\['R'\]"),
        (lambda: targets({"K": torch.ones(4, 3, 3)}), r"batch\['K'\]"),
        (lambda: targets({"t": BEHIND}), "points"),
        (lambda: targets({"t": BEHIND * np.nan}), "t"),
        (lambda: targets(keypoints=KEYPOINTS[:2]), "keypoints"),
        (lambda: targets(keypoints=KEYPOINTS[..., :2]), "keypoints"),
        (lambda: targets(keypoints=KEYPOINTS * np.inf), "keypoints"),
        (lambda: targets(ids=(5, 2, 5)), "object_ids"),
        (lambda: targets(ids=()), "object_ids"),
        (lambda: targets(ids=(5, 2, 9.5)), "object_ids"),
        (lambda: targets(symmetries=[None]), "symmetries"),
        (lambda: targets(symmetries=[np.eye(3)[None]] * 3), "symmetries"),
        (lambda: targets(most=0), "pixels_per_object"),
    ],
)
def test_bad_input_is_named(call, named):
    with pytest.raises(ValueError, match=f"^{named}:"):
        call()
