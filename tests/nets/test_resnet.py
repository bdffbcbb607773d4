"""ResNet against torchvision's list of layers and a plain implementation, layer by layer."""

import copy
import math
import re

import pytest
import safetensors.torch
import torch
import torch.nn.functional as F
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from posecore.nets.resnet import BasicBlock, Maps, ResNet, fold_batch_norm

# torchvision 0.20, models.resnet18: the convolutions in their order, and the classifier.
CONVOLUTIONS = {
    "conv1": (64, 3, 7, 7),
    "layer1.0.conv1": (64, 64, 3, 3), "layer1.0.conv2": (64, 64, 3, 3),
    "layer1.1.conv1": (64, 64, 3, 3), "layer1.1.conv2": (64, 64, 3, 3),
    "layer2.0.conv1": (128, 64, 3, 3), "layer2.0.conv2": (128, 128, 3, 3),
    "layer2.0.downsample.0": (128, 64, 1, 1),
    "layer2.1.conv1": (128, 128, 3, 3), "layer2.1.conv2": (128, 128, 3, 3),
    "layer3.0.conv1": (256, 128, 3, 3), "layer3.0.conv2": (256, 256, 3, 3),
    "layer3.0.downsample.0": (256, 128, 1, 1),
    "layer3.1.conv1": (256, 256, 3, 3), "layer3.1.conv2": (256, 256, 3, 3),
    "layer4.0.conv1": (512, 256, 3, 3), "layer4.0.conv2": (512, 512, 3, 3),
    "layer4.0.downsample.0": (512, 256, 1, 1),
    "layer4.1.conv1": (512, 512, 3, 3), "layer4.1.conv2": (512, 512, 3, 3),
}  # fmt: skip
CLASSIFIER = {"fc.weight": (1000, 512), "fc.bias": (1000,)}
STRIDES = (8, 16, 32)


def norm_of(convolution: str) -> str:
    """The name of the normalisation behind a convolution."""
    return re.sub(r"downsample\.0", "downsample.1", convolution.replace("conv", "bn"))


def torchvision_shapes(part: int = 1) -> dict[str, tuple[int, ...]]:
    """Names and shapes; of a net so many times as narrow."""
    shapes = {}
    for name, (outs, ins, *sides) in CONVOLUTIONS.items():
        shape = (outs // part, ins if ins == 3 else ins // part, *sides)
        shapes[f"{name}.weight"] = shape
        for kind in ("weight", "bias", "running_mean", "running_var"):
            shapes[f"{norm_of(name)}.{kind}"] = shape[:1]
        shapes[f"{norm_of(name)}.num_batches_tracked"] = ()
    return shapes


def network(seed: int = 0, **options) -> ResNet:
    """A net in float64 as after training: with statistics that are not those of the start."""
    torch.manual_seed(seed)
    net = ResNet(**{"width": 2, **options}).double()
    for module in net.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.running_mean.normal_()
            module.running_var.uniform_(0.5, 2)
            nn.init.normal_(module.weight)
            nn.init.normal_(module.bias)
    return net.eval()


def plain(net: ResNet, images: torch.Tensor, strides: tuple[int, ...]) -> list[torch.Tensor]:
    """Nothing but functions, from the weights and where each stage strides (else it dilates)."""
    weights = dict(net.named_parameters()) | dict(net.named_buffers())

    def layer(x, name, stride=1, padding=0, dilation=1):
        norm = norm_of(name)
        x = F.conv2d(x, weights[f"{name}.weight"], None, stride, padding, dilation)
        mean, variance = weights[f"{norm}.running_mean"], weights[f"{norm}.running_var"]
        if net.training:
            mean, variance = mean.clone(), variance.clone()
        scale, shift = weights[f"{norm}.weight"], weights[f"{norm}.bias"]
        return F.batch_norm(x, mean, variance, scale, shift, net.training)

    x = F.relu(layer(images, "conv1", 2, 3))
    maps = [x]
    x = F.max_pool2d(x, 3, 2, 1)
    dilation = 1
    for stage, stride in enumerate(strides, 1):
        for block in range(len(getattr(net, f"layer{stage}"))):
            name = f"layer{stage}.{block}"
            step, before = (stride if block == 0 else 1), dilation
            if block == 0 and stage > 1 and stride == 1:
                dilation *= 2
            y = F.relu(layer(x, f"{name}.conv1", step, before, before))
            y = layer(y, f"{name}.conv2", 1, dilation, dilation)
            if f"{name}.downsample.0.weight" in weights:
                x = layer(x, f"{name}.downsample.0", step)
            x = F.relu(x + y)
        maps.append(x)
    return maps


PLAIN_STRIDES = {32: (1, 2, 2, 2), 16: (1, 2, 2, 1), 8: (1, 2, 1, 1)}


def test_it_is_torchvisions_resnet18_without_its_end() -> None:
    for stride in STRIDES:
        net = ResNet(stride=stride)
        assert {k: tuple(v.shape) for k, v in net.state_dict().items()} == torchvision_shapes()
    # The count that is printed everywhere, less the classifier.
    assert sum(p.numel() for p in net.parameters()) == 11_689_512 - 513_000
    assert net.channels == (64, 64, 128, 256, 512)


@pytest.mark.parametrize("stride", STRIDES)
@pytest.mark.parametrize("blocks", [(2, 2, 2, 2), (1, 3, 2, 1)])
@pytest.mark.parametrize("training", [False, True])
def test_maps_and_gradients_are_those_of_a_plain_implementation(stride, blocks, training) -> None:
    net = network(stride=stride, blocks=blocks).train(training)
    images = torch.randn(2, 3, 64, 32, dtype=torch.float64)
    expected = plain(net, images, PLAIN_STRIDES[stride])
    weights = list(net.parameters())
    wanted = torch.autograd.grad(sum(m.square().mean() for m in expected), weights)
    maps = net(images)
    given = torch.autograd.grad(sum(m.square().mean() for m in maps), weights)
    assert isinstance(maps, Maps)
    for value, other in zip((*maps, *given), (*expected, *wanted), strict=True):
        torch.testing.assert_close(value, other, rtol=1e-9, atol=1e-11)


@given(st.integers(0, 99), st.integers(1, 2), st.integers(1, 2), st.sampled_from([8, 16]))
@settings(max_examples=10, deadline=None)
def test_dilation_adds_pixels_and_changes_none(seed, rows, columns, stride) -> None:
    strided, dilated = network(seed, stride=32), network(seed, stride=stride)
    images = torch.randn(1, 3, 32 * rows, 32 * columns, dtype=torch.float64)
    for coarse, fine in zip(strided(images), dilated(images), strict=True):
        step = fine.shape[-1] // coarse.shape[-1]
        torch.testing.assert_close(fine[..., ::step, ::step], coarse, rtol=1e-9, atol=1e-11)
    assert step == 32 // stride


@given(
    st.integers(1, 5), st.sampled_from(STRIDES), st.integers(1, 2), st.integers(1, 4),
    st.integers(1, 70), st.integers(1, 70),
)  # fmt: skip
@settings(max_examples=15, deadline=None)
def test_sides_are_rounded_up(width, stride, batch, channels, height, breadth) -> None:
    net = ResNet(width, stride, blocks=(1, 1, 1, 1), in_channels=channels).eval()
    maps = net(torch.rand(batch, channels, height, breadth))
    steps = [min(s, stride) for s in (2, 4, 8, 16, 32)]
    for value, outs, step in zip(maps, net.channels, steps, strict=True):
        shape = (batch, outs, math.ceil(height / step), math.ceil(breadth / step))
        assert value.shape == shape and value.isfinite().all() and (value >= 0).all()


@pytest.mark.parametrize(("stride", "dilations"), [(1, (1, 1)), (2, (1, 1)), (1, (2, 4))])
def test_a_block_is_its_input_and_something_added(stride, dilations) -> None:
    block = BasicBlock(4, 4, stride, dilations).eval()
    nn.init.zeros_(block.bn2.weight)  # nothing is added
    x = torch.rand(1, 4, 9, 7)
    before = x.clone()
    expected = x if block.downsample is None else F.relu(block.downsample(x))
    assert torch.equal(block(x), expected)
    assert torch.equal(x, before), "the maps that came in were written over"


@pytest.mark.parametrize(("max_channels", "channels"), [(8, [8] * 5), (20, [8, 8, 16, 20, 20])])
def test_later_stages_have_no_more_channels_than_asked(max_channels, channels) -> None:
    net = ResNet(8, max_channels=max_channels)
    assert list(net.channels) == channels
    assert [part.shape[1] for part in net(torch.rand(2, 3, 32, 32))] == channels
    assert sum(x.numel() for x in net.parameters()) < sum(x.numel() for x in ResNet(8).parameters())


def test_a_start_keeps_the_size_of_numbers() -> None:
    torch.manual_seed(0)
    net = ResNet(16).train()
    last = net(torch.randn(4, 3, 64, 64)).layer4
    assert 0.1 < float(last.detach().square().mean().sqrt()) < 10
    torch.manual_seed(0)
    again = ResNet(16)
    assert all(torch.equal(a, b) for a, b in zip(net.parameters(), again.parameters(), strict=True))


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("half", [False, True])
def test_trains_in_channels_last_and_half_precision(half: bool) -> None:
    net = ResNet(8).to(memory_format=torch.channels_last).train()
    images = torch.randn(2, 3, 32, 32).to(memory_format=torch.channels_last)
    with torch.autocast("cpu", torch.bfloat16, enabled=half):
        maps = net(images)
    assert all(m.dtype == (torch.bfloat16 if half else torch.float32) for m in maps)
    assert maps.layer4.is_contiguous(memory_format=torch.channels_last)
    sum(m.float().square().mean() for m in maps).backward()
    for name, parameter in net.named_parameters():
        assert parameter.grad.isfinite().all() and parameter.grad.abs().max() > 0, name


# Weights from a file.


def torchvision_state(part: int = 1) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    shapes = torchvision_shapes(part) | CLASSIFIER
    return {
        name: torch.rand(shape, generator=generator)
        if shape
        else torch.tensor(7, dtype=torch.int64)
        for name, shape in shapes.items()
    }


def saved(state: object, path) -> None:
    if path.suffix == ".safetensors":
        safetensors.torch.save_file(state, path)
    else:
        torch.save(state, path)


@pytest.mark.parametrize(
    ("ending", "part", "without"),
    [
        (".pth", 1, "nothing"),
        (".safetensors", 1, "counts"),
        (".pth", 32, "counts"),
        (".safetensors", 32, "nothing"),
        (".pth", 32, "classifier"),
    ],
)
def test_loads_the_weights_of_torchvision(tmp_path, ending, part, without) -> None:
    state = torchvision_state(part)
    if without == "counts":  # as files of before 2018
        state = {k: v for k, v in state.items() if "num_batches" not in k}
    if without == "classifier":
        state = {k: v for k, v in state.items() if not k.startswith("fc.")}
    path = tmp_path / f"resnet18{ending}"
    saved(state, path)
    net = ResNet(64 // part)
    net.load_imagenet(str(path))
    for name, value in net.state_dict().items():
        if not name.endswith("num_batches_tracked"):
            assert torch.equal(value, state[name]), name


def broken_file(kind: str, path) -> None:
    state = torchvision_state(32)
    if kind == "missing":
        return
    if kind in ("empty", "garbage"):
        path.write_bytes(b"" if kind == "empty" else b"no weights at all" * 9)
        return
    if kind == "cut":
        saved(state, path)
        path.write_bytes(path.read_bytes()[:20_000])
        return
    if kind == "without":
        del state["layer3.1.conv2.weight"]
    if kind == "deeper":
        state["layer1.2.conv1.weight"] = torch.zeros(2, 2, 3, 3)
    if kind == "infinite":
        state["layer2.0.bn1.running_var"][0] = torch.inf
    if kind == "shape":
        state["layer4.0.conv1.weight"] = torch.zeros(16, 8, 1, 1)
    saved(state, path)


@pytest.mark.parametrize("ending", [".pth", ".safetensors"])
@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("missing", "resnet18"),
        ("empty", "resnet18"),
        ("garbage", "resnet18"),
        ("cut", "resnet18"),
        ("without", "without layer3.1.conv2.weight"),
        ("deeper", "with layer1.2.conv1.weight"),
        ("infinite", "layer2.0.bn1.running_var"),
        ("shape", "layer4.0.conv1.weight"),
    ],
)
def test_refuses_a_file_and_keeps_its_weights(tmp_path, ending, kind, words) -> None:
    path = tmp_path / f"resnet18{ending}"
    broken_file(kind, path)
    net = ResNet(2)
    before = copy.deepcopy(net.state_dict())
    with pytest.raises(ValueError, match=f"^path: .*{re.escape(words)}"):
        net.load_imagenet(path)
    assert all(torch.equal(v, before[k]) for k, v in net.state_dict().items())


@pytest.mark.parametrize("content", [[1, 2], {"conv1.weight": 3}, {1: torch.zeros(2)}])
def test_refuses_a_file_of_something_else(tmp_path, content) -> None:
    path = tmp_path / "resnet18.pth"
    torch.save(content, path)
    with pytest.raises(ValueError, match="^path: "):
        ResNet(4).load_imagenet(path)


@pytest.mark.parametrize("options", [{"width": 16}, {"in_channels": 1}])
def test_refuses_weights_of_another_width(tmp_path, options) -> None:
    path = tmp_path / "resnet18.pth"
    torch.save(torchvision_state(), path)
    with pytest.raises(ValueError, match=r"^path: .*conv1.weight of shape .* got shape \(64, 3"):
        ResNet(**options).load_imagenet(path)


# Folding.


@given(st.integers(0, 999), st.sampled_from(STRIDES), st.booleans())
@settings(max_examples=10, deadline=None)
def test_folded_says_the_same(seed, stride, channels_last) -> None:
    net = network(seed, stride=stride)
    before = copy.deepcopy(net.state_dict())
    layout = torch.channels_last if channels_last else torch.contiguous_format
    folded = fold_batch_norm(net.to(memory_format=layout))
    images = torch.randn(1, 3, 40, 33, dtype=torch.float64).to(memory_format=layout)
    for value, expected in zip(folded(images), net(images), strict=True):
        torch.testing.assert_close(value, expected, rtol=1e-9, atol=1e-9)
    assert not any(isinstance(m, nn.BatchNorm2d) for m in folded.modules())
    assert not folded.training and not any(p.requires_grad for p in folded.parameters())
    after = net.state_dict()
    assert all(torch.equal(after[k], v) for k, v in before.items())
    assert all(p.requires_grad for p in net.parameters())


def test_folds_what_is_behind_a_convolution_and_nothing_else() -> None:
    net = nn.Sequential(nn.BatchNorm2d(3), nn.Conv2d(3, 4, 1), nn.ReLU(), nn.BatchNorm2d(4)).eval()
    folded = fold_batch_norm(net)
    assert [type(m) for m in folded] == [type(m) for m in net]
    x = torch.randn(2, 3, 5, 5)
    assert torch.equal(folded(x), net(x))


def half_trained() -> nn.Module:
    net = ResNet(2).eval()
    net.layer3[0].bn1.train()
    return net


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: ResNet(0), "width"),
        (lambda: ResNet(8.5), "width"),
        (lambda: ResNet("64"), "width"),
        (lambda: ResNet(True), "width"),
        (lambda: ResNet(8, 4), "stride"),
        (lambda: ResNet(8, 64), "stride"),
        (lambda: ResNet(8, "8"), "stride"),
        (lambda: ResNet(8, None), "stride"),
        (lambda: ResNet(8, max_channels=7), "max_channels"),
        (lambda: ResNet(8, max_channels=20.5), "max_channels"),
        (lambda: ResNet(8, blocks=(2, 2, 2)), "blocks"),
        (lambda: ResNet(8, blocks=2), "blocks"),
        (lambda: ResNet(8, blocks=(2, 2, 2, 2, 2)), "blocks"),
        (lambda: ResNet(8, blocks=(2, 0, 2, 2)), r"blocks\[1\]"),
        (lambda: ResNet(8, blocks=(2, 2, 2, 1.5)), r"blocks\[3\]"),
        (lambda: ResNet(8, in_channels=0), "in_channels"),
        (lambda: ResNet(2)(torch.rand(3, 32, 32)), "images"),
        (lambda: ResNet(2)(torch.rand(1, 1, 32, 32)), "images"),
        (lambda: ResNet(2)(torch.rand(0, 3, 32, 32)), "images"),
        (lambda: ResNet(2)(torch.rand(1, 3, 0, 32)), "images"),
        (lambda: fold_batch_norm(ResNet(2)), "net"),
        (lambda: fold_batch_norm(half_trained()), "net"),
    ],
)
def test_refuses_what_cannot_be(call, name) -> None:
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        call()
