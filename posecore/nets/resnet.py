"""ResNet of basic blocks, whose last stages may be dilated instead of strided.

Layers and their names are those of torchvision's resnet18, so that weights which were trained on
ImageNet load from its file. There is no pooling and no classifier at the end.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from posecore import weights
from posecore.arrays import fail, require_choice, require_integer

__all__ = [
    "IMAGENET_MEAN",
    "IMAGENET_STD",
    "BasicBlock",
    "Maps",
    "ResNet",
    "fold_batch_norm",
]

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)
"""Of red, green and blue in ImageNet, 0 to 1: what its networks subtract and divide by."""


class Maps(NamedTuple):
    """The feature maps of a ResNet, from fine to coarse."""

    stem: Tensor  # (B, width, H/2, W/2)
    layer1: Tensor  # (B, width, H/4, W/4)
    layer2: Tensor  # (B, 2 width, H/8, W/8)
    layer3: Tensor  # (B, 4 width, H/16, W/16) unless dilated
    layer4: Tensor  # (B, 8 width, H/32, W/32) unless dilated


class BasicBlock(nn.Module):
    """Two 3x3 convolutions, added to what came in.

    Args:
        in_channels: of the maps that come in.
        channels: of those that go out.
        stride: of the first convolution.
        dilations: of each: pixels from one tap of the 3x3 to the next.
    """

    def __init__(
        self,
        in_channels: int,
        channels: int,
        stride: int = 1,
        dilations: tuple[int, int] = (1, 1),
    ) -> None:
        super().__init__()
        self.conv1 = _convolution(in_channels, channels, stride, dilations[0])
        self.bn1 = nn.BatchNorm2d(channels)
        self.relu = nn.ReLU(inplace=True)
        self.conv2 = _convolution(channels, channels, 1, dilations[1])
        self.bn2 = nn.BatchNorm2d(channels)
        self.downsample = None
        if stride > 1 or in_channels != channels:
            conv = nn.Conv2d(in_channels, channels, 1, stride, bias=False)
            self.downsample = nn.Sequential(conv, nn.BatchNorm2d(channels))

    def forward(self, x: Tensor) -> Tensor:
        """(B, in_channels, H, W) to (B, channels, H/stride, W/stride)."""
        shortcut = x if self.downsample is None else self.downsample(x)
        x = self.relu(self.bn1(self.conv1(x)))
        x = self.bn2(self.conv2(x))
        return self.relu(x.add_(shortcut))


class ResNet(nn.Module):
    """ResNet-18 (He et al. 2016) without its end; at stride 8 as PVNet has it.

    A stage that would go past `stride` keeps its resolution. From its first convolution on, which
    would have left out pixels, taps are as far apart as the remaining pixels would have been. So
    the same weights give the same numbers where the strided net has any, and more between them (Yu
    and Koltun 2016).

    Attributes:
        channels: of the five maps.

    Args:
        width: channels of the first maps; 64 is ResNet-18.
        stride: image pixels from one pixel of the last map to the next: 8, 16 or 32.
        blocks: how many of each stage.
        in_channels: of the images.
        max_channels: stages that would have more channels have so many; None for no limit. A net
            that is to be small keeps its first channels, which are cheap and see the details.

    Raises:
        ValueError: if an argument is out of range.
    """

    def __init__(
        self,
        width: int = 64,
        stride: int = 8,
        blocks: Sequence[int] = (2, 2, 2, 2),
        in_channels: int = 3,
        max_channels: int | None = None,
    ) -> None:
        super().__init__()
        width = require_integer("width", width, 1)
        require_choice("stride", stride, (8, 16, 32))
        if not isinstance(blocks, Sequence) or len(blocks) != 4:
            fail("blocks", "four numbers, one of each stage", repr(blocks))
        counts = [require_integer(f"blocks[{i}]", count, 1) for i, count in enumerate(blocks)]
        in_channels = require_integer("in_channels", in_channels, 1)
        self.channels = (width, width, 2 * width, 4 * width, 8 * width)
        if max_channels is not None:
            require_integer("max_channels", max_channels, width)
            self.channels = tuple(min(channels, max_channels) for channels in self.channels)

        self.conv1 = nn.Conv2d(in_channels, width, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.relu = nn.ReLU(inplace=True)
        self.maxpool = nn.MaxPool2d(3, 2, 1)
        reached, dilation = 4, 1
        for stage, count in enumerate(counts, 1):
            step, before = (1 if stage == 1 else 2), dilation
            if reached * step > stride:
                step, dilation = 1, 2 * dilation
            reached *= step
            ins, outs = self.channels[stage - 1 : stage + 1]
            first = BasicBlock(ins, outs, step, (before, dilation))
            others = [BasicBlock(outs, outs, 1, (dilation, dilation)) for _ in range(count - 1)]
            setattr(self, f"layer{stage}", nn.Sequential(first, *others))
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, images: Tensor) -> Maps:
        """The maps of images (B, in_channels, H, W); sides that do not divide are rounded up.

        Raises:
            ValueError: if the images have another shape, or none of their sides.
        """
        channels = self.conv1.in_channels
        if images.ndim != 4 or images.shape[1] != channels or not images.numel():
            fail("images", f"shape (B, {channels}, H, W), none 0", f"shape {tuple(images.shape)}")
        stem = self.relu(self.bn1(self.conv1(images)))
        layer1 = self.layer1(self.maxpool(stem))
        layer2 = self.layer2(layer1)
        layer3 = self.layer3(layer2)
        return Maps(stem, layer1, layer2, layer3, self.layer4(layer3))

    def load_imagenet(self, path: str | Path) -> None:
        """Take the weights of torchvision's resnet18; its classifier is left out.

        Args:
            path: its state dict, as `.pth` or `.safetensors`.

        Raises:
            ValueError: if the file cannot be read, or holds another network than this.
        """
        # Old files have no count of batches, and nothing asks for it.
        leave = ("fc.weight", "fc.bias", "num_batches_tracked")
        given = {k: v for k, v in _state_dict(Path(path)).items() if not k.endswith(leave)}
        own = {k: v for k, v in self.state_dict().items() if not k.endswith(leave)}
        for words, names in (("without", own.keys() - given), ("with", given.keys() - own)):
            if names:
                shown = ", ".join(sorted(names)[:3]) + (", ..." if len(names) > 3 else "")
                fail("path", "the weights of this network", f"{path} {words} {shown}")
        for name, value in own.items():
            if given[name].shape != value.shape:
                expected = f"{name} of shape {tuple(value.shape)} (width {self.channels[0]})"
                fail("path", expected, f"shape {tuple(given[name].shape)} in {path}")
            if not given[name].isfinite().all():
                fail("path", f"finite weights in {name}", f"others in {path}")
        self.load_state_dict(given, strict=False)


def fold_batch_norm(net: nn.Module) -> nn.Module:
    """A faster copy, for use only: batch normalisations are drawn into the convolutions before.

    In evaluation mode the two are one affine map, so outputs are equal up to rounding. Which
    belongs to which is told by order: a normalisation that is the next child after a convolution.

    Args:
        net: a network in evaluation mode; it stays as it is.

    Raises:
        ValueError: if it is in training mode, where statistics are those of the batch.
    """
    if any(module.training for module in net.modules()):
        fail("net", "a network in evaluation mode", "one in training mode")
    net = copy.deepcopy(net)
    for module in list(net.modules()):
        children = list(module.named_children())
        for (name, conv), (other, norm) in itertools.pairwise(children):
            if isinstance(conv, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d):
                setattr(module, name, fuse_conv_bn_eval(conv, norm))
                setattr(module, other, nn.Identity())
    return net.requires_grad_(False)


def _convolution(ins: int, outs: int, stride: int, dilation: int) -> nn.Conv2d:
    return nn.Conv2d(ins, outs, 3, stride, dilation, dilation, bias=False)


def _state_dict(path: Path) -> dict[str, Tensor]:
    try:
        if path.suffix == ".safetensors":
            return weights.parse(path.read_bytes())
        state = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as e:  # whatever trips over damaged input, it is the file's fault
        words = f"{path}: {e}".splitlines()[0]
        # Of what is no such file PyTorch advises to run what is in it, or says nothing of use.
        if path.suffix != ".safetensors" and not isinstance(e, OSError | RuntimeError):
            words = f"{path}, which is none, or holds more than tensors"
        fail("path", "a file of weights, .pth or .safetensors", words)
    named = isinstance(state, dict) and all(isinstance(name, str) for name in state)
    if not named or not all(isinstance(value, Tensor) for value in state.values()):
        fail("path", "a file that holds tensors by name", f"something else in {path}")
    return state
