"""Fields at the pixels of masks: grouped, looked up, joined; and what a network says there."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from posecore.methods.vector_field import masked_fields
from posecore.methods.vector_field.masked_fields import MaskedFields, predict_fields
from posecore.methods.vector_field.network import VectorFieldNet
from posecore.training import seeded

Columns = list[torch.Tensor]


def drawn(seed: int, count: int = 40) -> tuple[np.ndarray, Columns]:
    """Dense fields (image, object, y, x, K, 2), zero where there is none, and their columns."""
    rng = np.random.default_rng(seed)
    dense = np.zeros((3, 2, 6, 7, 4, 2), np.float32)
    flat = rng.choice(3 * 6 * 7, count, replace=False)
    image, y, x = np.unravel_index(flat, (3, 6, 7))
    object = rng.integers(0, 2, count)
    vectors = rng.normal(size=(count, 4, 2)).astype(np.float32)
    dense[image, object, y, x] = vectors
    return dense, [torch.from_numpy(v) for v in (image, y, x, object, vectors)]


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31), st.integers(0, 60))
def test_it_says_what_the_dense_field_says(seed: int, count: int) -> None:
    dense, columns = drawn(seed, count)
    fields = MaskedFields(*columns)
    pairs = sorted(set(zip(columns[0].tolist(), columns[3].tolist(), strict=True)))
    assert list(zip(fields.image.tolist(), fields.object.tolist(), strict=True)) == pairs
    ys, xs = np.mgrid[-2:9, -2:10]
    grid = torch.from_numpy(np.stack([xs, ys], -1).reshape(1, -1, 2) + 0.4)
    padded = np.pad(dense, ((0, 0), (0, 0), (2, 3), (2, 3), (0, 0), (0, 0)))
    for entry, (i, o) in enumerate(pairs):
        vectors, inside = fields.at(torch.tensor([entry]), grid)
        expected = padded[i, o].reshape(1, -1, 4, 2)
        assert np.array_equal(vectors.numpy(), expected)
        assert np.array_equal(inside.numpy(), (expected != 0).any((2, 3)))
        assert torch.equal(fields.contains(torch.tensor([entry]), grid), inside)
        pixels, own = fields.of(entry)
        assert len(pixels) == fields.counts[entry] == inside.sum()
        assert np.array_equal(own, dense[i, o, pixels[:, 1].numpy(), pixels[:, 0].numpy()])


def test_infinite_pixels_are_outside() -> None:
    fields = MaskedFields(*drawn(0)[1])
    pixels = torch.tensor([[[np.inf, np.inf], [-np.inf, 1], [1e30, 2]]])
    vectors, inside = fields.at(torch.tensor([1]), pixels)
    assert not inside.any() and (vectors == 0).all()


def test_small_masks_are_left_out_and_probabilities_averaged() -> None:
    image = torch.tensor([1, 0, 1, 1, 0])
    y, x = torch.tensor([0, 0, 1, 2, 1]), torch.tensor([3, 3, 3, 3, 3])
    object = torch.tensor([0, 0, 0, 1, 0])
    sure = torch.tensor([0.5, 0.75, 1.0, 0.1, 0.25])
    fields = MaskedFields(image, y, x, object, torch.ones(5, 4, 2), sure, min_pixels=2)
    assert fields.image.tolist() == [0, 1] and fields.object.tolist() == [0, 0]
    assert fields.counts.tolist() == [2, 2] and fields.confidence.tolist() == [0.5, 0.75]
    none = MaskedFields(image, y, x, object, torch.ones(5, 4, 2), min_pixels=3)
    assert len(none) == 0


def test_joined() -> None:
    parts = [MaskedFields(*drawn(seed, count)[1]) for seed, count in ((0, 30), (1, 0), (2, 50))]
    both = MaskedFields.joined(parts, torch.float16)
    assert len(both) == len(parts[0]) + len(parts[2])
    grid = torch.tensor([[[x, y] for x in range(7) for y in range(6)]]).double()
    entry = 0
    for part in (parts[0], parts[2]):
        for own in range(len(part)):
            said, expected = (
                both.at(torch.tensor([entry]), grid),
                part.at(torch.tensor([own]), grid),
            )
            assert torch.equal(said[0], expected[0].half().double())
            assert torch.equal(said[1], expected[1])
            assert both.object[entry] == part.object[own]
            entry += 1


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**31), st.integers(0, 60))
def test_on_another_device_they_are_the_same(seed: int, count: int) -> None:
    fields = MaskedFields(*drawn(seed, count)[1])
    same = fields.to("cpu")
    assert same is not fields
    for name, value in vars(fields).items():
        assert torch.equal(getattr(same, name), value)
    away = fields.to("meta")  # a device that has no numbers, only shapes
    for name, value in vars(away).items():
        assert value.device.type == "meta" and value.shape == getattr(fields, name).shape
    assert fields.image.device.type == "cpu" and len(away) == len(fields)


def test_a_network_is_looked_at_where_its_masks_are() -> None:
    with seeded(0):
        net = VectorFieldNet(objects=2, keypoints=4, width=4).eval()
        images = torch.rand(2, 3, 24, 32)
    with torch.no_grad():
        logits, dense = net(images)
    label, sure = logits.argmax(1), logits.softmax(1)
    fields = predict_fields(net, images, min_pixels=5, precision="float32")
    found = []
    for image in (0, 1):
        for object in (0, 1):
            mask = label[image] == object + 1
            if mask.sum() < 5:
                continue
            found.append((image, object))
            entry = len(found) - 1
            pixels, vectors = fields.of(entry)
            x, y = pixels.unbind(-1)
            assert len(x) == mask.sum() and mask[y, x].all()
            expected = dense[image, object, :, :, y, x].permute(2, 0, 1)
            assert torch.allclose(vectors, expected, atol=1e-5)
            assert abs(fields.confidence[entry] - sure[image, object + 1][mask].mean()) < 1e-6
    assert found == list(zip(fields.image.tolist(), fields.object.tolist(), strict=True))
    assert found


COLUMNS = drawn(0)[1]


def columns(**changed: torch.Tensor) -> Columns:
    names = ("image", "y", "x", "object", "vectors")
    return [changed.get(name, value) for name, value in zip(names, COLUMNS, strict=True)]


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: MaskedFields(*columns(vectors=COLUMNS[4][..., :1])), "vectors"),
        (lambda: MaskedFields(*columns(vectors=COLUMNS[4][:, 0])), "vectors"),
        (lambda: MaskedFields(*columns(y=COLUMNS[1][1:])), "y"),
        (lambda: MaskedFields(*columns(x=COLUMNS[2] - 1)), "x"),
        (lambda: MaskedFields(*columns(object=COLUMNS[3][None])), "object"),
        (lambda: MaskedFields(*columns(image=COLUMNS[0] - 1)), "image"),
        (lambda: MaskedFields(*COLUMNS, torch.ones(3)), "probability"),
        (lambda: MaskedFields(*COLUMNS, min_pixels=0), "min_pixels"),
        (lambda: MaskedFields.joined([], torch.float16), "parts"),
    ],
)
def test_bad_input_is_named(call: Callable[[], object], name: str) -> None:
    with pytest.raises(ValueError, match=rf"^{name}:"):
        call()


@pytest.mark.parametrize("precision", ["auto", "bfloat16", "float32"])
@pytest.mark.parametrize("native", [False, True])
def test_a_network_is_looked_at_in_the_precision_of_fit(monkeypatch, precision, native):
    with seeded(0):
        net = VectorFieldNet(objects=1, keypoints=4, width=4).eval()
    asked, seen_in = [], []

    def chosen(*arguments):
        asked.append(arguments)
        return native if arguments[0] == "auto" else arguments[0] == "bfloat16"

    def spied(images):
        seen_in.append(torch.is_autocast_enabled("cpu"))
        assert images.is_contiguous(memory_format=torch.channels_last)
        return VectorFieldNet.features(net, images)

    monkeypatch.setattr(masked_fields, "uses_bfloat16", chosen)
    monkeypatch.setattr(net, "features", spied)
    fields = predict_fields(net, torch.rand(2, 3, 16, 24), precision=precision)
    assert asked == [(precision, torch.device("cpu"), net)]
    assert seen_in == [native if precision == "auto" else precision == "bfloat16"]
    assert all(vectors.dtype == torch.float32 for _, vectors in map(fields.of, range(len(fields))))


def test_a_precision_that_does_not_exist() -> None:
    net = VectorFieldNet(objects=1, keypoints=4, width=4).eval()
    with pytest.raises(ValueError, match="^precision: expected .*'float8'"):
        predict_fields(net, torch.rand(1, 3, 16, 24), precision="float8")
