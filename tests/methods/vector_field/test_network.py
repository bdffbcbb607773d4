"""The network against functions only, its parts against the whole, and what it may be given."""

import copy
import math
import pickle

import pytest
import torch
import torch.nn.functional as F
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor, nn

from posecore.methods.vector_field.network import Fields, VectorFieldNet
from posecore.nets.resnet import fold_batch_norm
from posecore.training import fit, seeded

LAST = torch.channels_last
DECODER = ("coarse", "stride8", "stride4", "stride2", "stride1")


def network(objects: int = 2, keypoints: int = 3, width: int = 4, seed: int = 0) -> VectorFieldNet:
    """A net as after training: with statistics that are not those of the start."""
    torch.manual_seed(seed)
    net = VectorFieldNet(objects, keypoints, width)
    for module in net.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.running_mean.normal_(0, 0.1)
            module.running_var.uniform_(0.5, 2)
            nn.init.uniform_(module.weight, 0.5, 1)
            nn.init.normal_(module.bias, 0, 0.1)
    return net.eval()


def images_of(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


def test_sizes_are_the_papers() -> None:
    net = VectorFieldNet()
    assert net.backbone.channels == (64, 64, 128, 256, 512)
    shapes = [tuple(getattr(net, name).conv.weight.shape) for name in DECODER]
    assert shapes == [
        (256, 512, 3, 3),
        (128, 256 + 128, 3, 3),
        (64, 128 + 64, 3, 3),
        (32, 64 + 64, 3, 3),
        (32, 32 + 3, 3, 3),
    ]
    assert net.mask_layer.out_features + net.vector_layer.out_features == 2 + 2 * 9
    for name in DECODER:
        layer = getattr(net, name)
        assert isinstance(layer.norm, nn.BatchNorm2d) and layer.relu.negative_slope == 0.1


@pytest.mark.parametrize(
    ("width", "max_channels", "outs"),
    [(4, None, (64, 64, 64, 32, 32)), (16, None, (64, 64, 64, 32, 32)),
     (24, None, (96, 64, 64, 32, 32)), (64, None, (256, 128, 64, 32, 32)),
     (80, None, (320, 160, 80, 40, 40)), (128, None, (512, 256, 128, 64, 64)),
     (64, 72, (64, 64, 64, 32, 32)), (64, 160, (80, 80, 64, 32, 32))],
)  # fmt: skip
def test_sizes_follow_the_width_but_keep_64_and_at_last_32(width, max_channels, outs) -> None:
    with torch.device("meta"):
        net = VectorFieldNet(width=width, max_channels=max_channels)
    assert tuple(getattr(net, name).conv.out_channels for name in DECODER) == outs
    assert net.channels == outs[-1]


def plain(net: VectorFieldNet, images: Tensor) -> Fields:
    """The decoder as the papers draw it: maps put together, then one convolution of all."""
    mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    images = (images - mean.to(images)[:, None, None]) / std.to(images)[:, None, None]
    maps = net.backbone(images)

    def layer(name: str, *parts: Tensor) -> Tensor:
        module = getattr(net, name)
        x = F.conv2d(torch.cat(parts, dim=1), module.conv.weight, padding=1)
        return F.leaky_relu(module.norm(x), 0.1)

    def double(x: Tensor) -> Tensor:
        size = [2 * side for side in x.shape[-2:]]
        return F.interpolate(x, size, mode="bilinear", align_corners=False)

    x = layer("stride8", layer("coarse", maps.layer4), maps.layer2)
    x = layer("stride4", double(x), maps.layer1)
    x = layer("stride2", double(x), maps.stem)
    x = layer("stride1", double(x), images)
    mask = F.conv2d(x, net.mask_layer.weight[:, :, None, None], net.mask_layer.bias)
    vectors = F.conv2d(x, net.vector_layer.weight[:, :, None, None], net.vector_layer.bias)
    shape = (len(x), net.objects, net.keypoints, 2, *x.shape[2:])
    return Fields(mask, vectors.reshape(shape))


@pytest.mark.parametrize("training", [False, True])
def test_fields_and_gradients_are_those_of_a_plain_implementation(training: bool) -> None:
    net = network().double().train(training)
    images = images_of(2, 3, 24, 16).double()
    weights = list(net.parameters())
    expected = plain(copy.deepcopy(net), images)  # statistics of the batch move the running ones
    fields = net(images)
    assert isinstance(fields, Fields)
    again = plain(net, images)
    grads = [
        torch.autograd.grad(sum(f.square().mean() for f in some), weights)
        for some in (fields, again)
    ]
    for value, other in zip((*fields, *grads[0]), (*expected, *grads[1]), strict=True):
        torch.testing.assert_close(value, other, rtol=1e-9, atol=1e-11)


@given(st.integers(1, 2), st.integers(1, 40), st.integers(1, 40), st.integers(1, 2))
@settings(max_examples=12, deadline=None)
def test_sides_of_any_length_are_padded_and_cut_again(batch, height, width, objects) -> None:
    net = network(objects)
    images = images_of(batch, 3, height, width)
    fields = net(images)
    assert fields.mask.shape == (batch, 1 + objects, height, width)
    assert fields.vectors.shape == (batch, objects, 3, 2, height, width)
    assert fields.mask.dtype == fields.vectors.dtype == torch.float32
    assert all(f.isfinite().all() for f in fields)
    # As if the image went on as it ends.
    rows = torch.arange(8 * math.ceil(height / 8)).clamp(max=height - 1)
    columns = torch.arange(8 * math.ceil(width / 8)).clamp(max=width - 1)
    for value, whole in zip(fields, net(images[:, :, rows][..., columns]), strict=True):
        torch.testing.assert_close(value, whole[..., :height, :width], rtol=1e-4, atol=1e-5)


def pixels_of(seed: int, count: int, sizes: tuple[int, ...]) -> list[Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return [torch.randint(size, (count,), generator=generator) for size in sizes]


@given(st.integers(0, 999), st.integers(0, 50), st.integers(1, 3), st.booleans())
@settings(max_examples=12, deadline=None)
def test_vectors_at_pixels_are_those_of_the_whole(seed, count, objects, half) -> None:
    net = network(objects).to(memory_format=LAST)
    images = images_of(2, 3, 13, 24, seed=seed).to(memory_format=LAST)
    image, y, x, of = pixels_of(seed, count, (2, 13, 24, objects))
    with torch.autocast("cpu", torch.bfloat16, enabled=half):
        features = net.features(images)
        vectors = net.vectors_at(features, image, y, x, of)
        fields = net(images)
    assert features.dtype == (torch.bfloat16 if half else torch.float32)
    assert vectors.shape == (count, 3, 2)
    for value in (vectors, fields.mask, fields.vectors):
        assert value.dtype == torch.float32  # also where the rest is in half precision
    torch.testing.assert_close(vectors, fields.vectors[image, of, :, :, y, x], rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(net.mask(features), fields.mask, rtol=1e-4, atol=1e-5)


def test_gradients_at_pixels_are_those_of_the_whole() -> None:
    net = network().double().train()
    images = images_of(2, 3, 16, 16).double()
    image, y, x, of = pixels_of(0, 300, (2, 16, 16, 2))  # some of them twice
    weights = [p for name, p in net.named_parameters() if not name.startswith("mask")]
    few = net.vectors_at(net.features(images), image, y, x, of)
    whole = net(images).vectors[image, of, :, :, y, x]
    for value, expected in zip(
        torch.autograd.grad(few.square().sum(), weights),
        torch.autograd.grad(whole.square().sum(), weights),
        strict=True,
    ):
        torch.testing.assert_close(value, expected, rtol=1e-8, atol=1e-10)


def test_more_objects_are_more_outputs_and_nothing_else() -> None:
    one, three = (dict(VectorFieldNet(n, 9, 8).named_parameters()) for n in (1, 3))
    differ = {name for name in one if one[name].shape != three[name].shape}
    assert one.keys() == three.keys()
    assert differ == {f"{layer}_layer.{part}" for layer in ("mask", "vector")
                      for part in ("weight", "bias")}  # fmt: skip
    added = sum(p.numel() for p in three.values()) - sum(p.numel() for p in one.values())
    assert added == 2 * (1 + 2 * 9) * (32 + 1)


@given(st.integers(0, 999), st.integers(1, 30), st.integers(1, 30), st.booleans())
@settings(max_examples=8, deadline=None)
def test_folded_says_the_same(seed, height, width, last) -> None:
    net = network(seed=seed).double()
    images = images_of(1, 3, height, width, seed=seed).double()
    if last:
        net, images = net.to(memory_format=LAST), images.to(memory_format=LAST)
    folded = fold_batch_norm(net)
    assert not any(isinstance(m, nn.BatchNorm2d) for m in folded.modules())
    for value, expected in zip(folded(images), net(images), strict=True):
        torch.testing.assert_close(value, expected, rtol=1e-9, atol=1e-10)


def test_half_precision_is_the_same_field_but_coarser() -> None:
    net = network().to(memory_format=LAST)
    images = images_of(2, 3, 32, 32).to(memory_format=LAST)
    exact = net(images)
    with torch.autocast("cpu", torch.bfloat16):
        coarse = net(images)
    for value, expected in zip(coarse, exact, strict=True):
        error = (value - expected).square().mean().sqrt() / expected.std()
        assert 0 < error < 0.05  # 8 bits: 0.004 a layer, of which there are two dozen


def test_constants_are_not_in_checkpoints() -> None:
    net = network()
    assert not {"mean", "std"} & net.state_dict().keys()
    images = images_of(1, 3, 8, 8)
    other = network(seed=1)
    other.load_state_dict(net.state_dict())
    for copied in (other, copy.deepcopy(net), pickle.loads(pickle.dumps(net))):
        assert torch.equal(copied(images).vectors, net(images).vectors)


def test_images_are_left_as_they_were() -> None:
    images = images_of(1, 3, 8, 16)
    before = images.clone()
    network().train()(images)
    assert torch.equal(images, before)


@pytest.mark.slow
def test_learns_where_a_corner_is() -> None:
    """Four bright squares, whose keypoint is their corner: the loop, half precision, all of it."""

    def batch(generator: torch.Generator) -> dict[str, Tensor]:
        corner = torch.randint(2, 20, (4, 2), generator=generator)
        grid = torch.stack(torch.meshgrid(torch.arange(32), torch.arange(32), indexing="xy"))
        away = grid - corner[:, :, None, None]  # (B, 2, H, W)
        inside = ((away >= 0) & (away < 10)).all(dim=1)
        noise = torch.rand((4, 3, 32, 32), generator=generator) * 0.3
        return {"rgb": noise + 0.6 * inside[:, None], "inside": inside.long(), "away": away}

    def loss(net: VectorFieldNet, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        features = net.features(batch["rgb"])
        image, y, x = batch["inside"].nonzero(as_tuple=True)
        vectors = net.vectors_at(features, image, y, x, torch.zeros_like(x))[:, 0]
        target = F.normalize(-batch["away"][image, :, y, x].float(), dim=-1)
        mask = F.cross_entropy(net.mask(features), batch["inside"])
        error = F.smooth_l1_loss(vectors, target)
        return {"loss": mask + error, "mask": mask, "vectors": error}

    with seeded(0):
        net = VectorFieldNet(1, 1, 8)
    fit(net, batch, loss, steps=60, lr=5e-3, show=False)
    fresh = batch(torch.Generator().manual_seed(99))
    with torch.no_grad():
        fields = net(fresh["rgb"])
    inside = fresh["inside"].bool()
    assert (fields.mask.argmax(dim=1) == fresh["inside"]).float().mean() > 0.95
    vectors = fields.vectors[:, 0, 0].permute(0, 2, 3, 1)[inside]
    target = -fresh["away"].permute(0, 2, 3, 1)[inside].float()
    assert F.cosine_similarity(vectors, target).median() > 0.8


NET = VectorFieldNet(2, 3, 4).eval()
MAPS = torch.zeros(2, 16, 5, 7)
ZERO = torch.zeros(4, dtype=torch.int64)


def at(**changed: Tensor) -> Tensor:
    given = {"image": ZERO, "y": ZERO, "x": ZERO, "object": ZERO} | changed
    return NET.vectors_at(MAPS, **given)


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: VectorFieldNet(0), "objects"),
        (lambda: VectorFieldNet(1.5), "objects"),
        (lambda: VectorFieldNet(True), "objects"),
        (lambda: VectorFieldNet(1, 0), "keypoints"),
        (lambda: VectorFieldNet(1, "9"), "keypoints"),
        (lambda: VectorFieldNet(1, 9, 0), "width"),
        (lambda: VectorFieldNet(1, 9, 12.5), "width"),
        (lambda: NET(torch.rand(3, 16, 16)), "images"),
        (lambda: NET(torch.rand(1, 1, 16, 16)), "images"),
        (lambda: NET(torch.rand(1, 4, 16, 16)), "images"),
        (lambda: NET(torch.rand(0, 3, 16, 16)), "images"),
        (lambda: NET(torch.rand(1, 3, 16, 0)), "images"),
        (lambda: NET(torch.zeros(1, 3, 16, 16, dtype=torch.uint8)), "images"),
        (lambda: NET.features(torch.rand(16, 16)), "images"),
        (lambda: at(image=ZERO + 2), "image"),
        (lambda: at(image=ZERO.int()), "image"),
        (lambda: at(image=ZERO[0]), "image"),
        (lambda: at(y=ZERO + 5), "y"),
        (lambda: at(y=ZERO - 1), "y"),
        (lambda: at(x=ZERO + 7), "x"),
        (lambda: at(x=ZERO[:3]), "x"),
        (lambda: at(x=ZERO.float()), "x"),
        (lambda: at(x=ZERO[None]), "x"),
        (lambda: at(object=ZERO + 2), "object"),
        (lambda: at(object=ZERO.bool()), "object"),
    ],
)
def test_refuses_what_cannot_be(call, name) -> None:
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        call()
