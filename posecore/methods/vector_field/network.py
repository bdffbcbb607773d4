"""The network: of each pixel, what it belongs to and where the keypoints of that object lie."""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from posecore.arrays import fail, require_integer
from posecore.nets.resnet import IMAGENET_MEAN, IMAGENET_STD, ResNet

__all__ = ["Fields", "VectorFieldNet"]


class Fields(NamedTuple):
    """The network's predictions for each pixel, in float32."""

    mask: Tensor  # (B, 1 + O, H, W) logits: background, and each object
    vectors: Tensor  # (B, O, K, 2, H, W) towards the keypoints, x right and y down


class VectorFieldNet(nn.Module):
    """PVNet (Peng et al. 2019): a ResNet-18 at stride 8, and a decoder back to all pixels.

    The decoder goes 256-128-64-32-32 at `width` 64, each step from what the last one saw and from
    the map of the ResNet, at last the image, of the same resolution. Objects share all but the
    output layers. Those are 1x1 convolutions: a loss that looks at some pixels only computes them
    there (`features`, then `mask` and `vectors_at`), and so does an estimate.

    Args:
        objects: how many the network knows.
        keypoints: how many directions each pixel says, for each object.
        width: of the ResNet. The decoder follows it, but its maps keep the paper's 64, the last two
            its 32 channels at least: what all keypoints of all objects need has to go through,
            however narrow the ResNet. It costs next to nothing.
        max_channels: channels of the ResNet's later stages, as `ResNet` has it.

    Attributes:
        channels: of the last maps.

    Raises:
        ValueError: if an argument is out of range.
    """

    def __init__(
        self, objects: int = 1, keypoints: int = 9, width: int = 64, max_channels: int | None = None
    ) -> None:
        super().__init__()
        self.objects = require_integer("objects", objects, 1)
        self.keypoints = require_integer("keypoints", keypoints, 1)
        self.backbone = ResNet(width, stride=8, max_channels=max_channels)
        stem, layer1, layer2, layer3, layer4 = self.backbone.channels
        coarse, middle, late = (max(channels // 2, 64) for channels in (layer4, layer3, layer2))
        self.channels = fine = max(stem // 2, 32)
        self.coarse = _Layer(layer4, coarse)
        self.stride8 = _Layer(coarse, middle, beside=layer2)
        self.stride4 = _Layer(middle, late, beside=layer1)
        self.stride2 = _Layer(late, fine, beside=stem)
        self.stride1 = _Layer(fine, fine, beside=3)
        self.mask_layer = nn.Linear(fine, 1 + objects)
        self.vector_layer = nn.Linear(fine, objects * keypoints * 2)
        shape = (1, 3, 1, 1)
        self.register_buffer("mean", torch.tensor(IMAGENET_MEAN).reshape(shape), persistent=False)
        self.register_buffer("std", torch.tensor(IMAGENET_STD).reshape(shape), persistent=False)

    def features(self, images: Tensor) -> Tensor:
        """The last maps, of which the output layers speak.

        Args:
            images: (B, 3, H, W) RGB, 0 to 1; sides of any length.

        Returns:
            (B, C, H, W), in half precision under autocast.

        Raises:
            ValueError: if they have another shape or are no floating-point numbers.
        """
        if images.ndim != 4 or images.shape[1] != 3 or not images.numel():
            fail("images", "shape (B, 3, H, W), none 0", f"shape {tuple(images.shape)}")
        if not images.is_floating_point():
            fail("images", "floating-point numbers, 0 to 1", images.dtype)
        height, width = images.shape[-2:]
        images = (images.to(self.mean.dtype) - self.mean) / self.std
        if height % 8 or width % 8:
            images = F.pad(images, (0, -width % 8, 0, -height % 8), mode="replicate")
        maps = self.backbone(images)
        x = self.stride8(self.coarse(maps.layer4), maps.layer2)
        x = self.stride4(_doubled(x), maps.layer1)
        x = self.stride2(_doubled(x), maps.stem)
        x = self.stride1(_doubled(x), images)
        return x[..., :height, :width]

    def mask(self, features: Tensor) -> Tensor:
        """(B, 1 + O, H, W) logits of `features`, in float32."""
        return _at_each_pixel(self.mask_layer, features)

    def vectors_at(
        self, features: Tensor, image: Tensor, y: Tensor, x: Tensor, object: Tensor
    ) -> Tensor:
        """The vectors of some pixels, each for its own object.

        Args:
            features: (B, C, H, W), from `features`.
            image: (N,) which of the B images; int64, as the next three.
            y: (N,) row.
            x: (N,) column.
            object: (N,) from 0.

        Returns:
            (N, K, 2) in float32, as `forward` has them at these pixels.

        Raises:
            ValueError: if indices are not int64, not as many, or not in the maps.
        """
        maps = features.permute(0, 2, 3, 1)  # (B, H, W, C)
        sizes = (*maps.shape[:3], self.objects)
        for name, index, size in zip(
            ("image", "y", "x", "object"), (image, y, x, object), sizes, strict=True
        ):
            if index.dtype != torch.int64 or index.ndim != 1 or len(index) != len(image):
                words = f"{index.dtype} of shape {tuple(index.shape)}"
                fail(name, f"int64 of shape (N,), as many as in image ({image.numel()})", words)
            if len(index) and not 0 <= int(index.min()) <= int(index.max()) < size:
                words = f"{int(index.min())} to {int(index.max())}"
                fail(name, f"indices from 0 and below {size}", words)
        # Rows by one index: three times as fast as pixels by three.
        row = (image * maps.shape[1] + y) * maps.shape[2] + x
        chosen = maps.flatten(0, 2).index_select(0, row)  # (N, C)
        vectors = _in_full(self.vector_layer, chosen)  # (N, O K 2)
        row = torch.arange(len(row), device=row.device) * self.objects + object
        vectors = vectors.reshape(-1, self.keypoints * 2).index_select(0, row)
        return vectors.unflatten(1, (self.keypoints, 2))

    def forward(self, images: Tensor) -> Fields:
        """All vectors of all pixels of images (B, 3, H, W) RGB, 0 to 1."""
        features = self.features(images)
        vectors = _at_each_pixel(self.vector_layer, features)
        vectors = vectors.unflatten(1, (self.objects, self.keypoints, 2))
        return Fields(self.mask(features), vectors)


class _Layer(nn.Module):
    """A 3x3 convolution, of two maps side by side if there is a second, normalised, LeakyReLU."""

    def __init__(self, ins: int, outs: int, beside: int = 0) -> None:
        super().__init__()
        self.ins = ins
        self.conv = nn.Conv2d(ins + beside, outs, 3, padding=1, bias=False)
        self.norm = nn.BatchNorm2d(outs)
        self.relu = nn.LeakyReLU(0.1, inplace=True)

    def forward(self, x: Tensor, beside: Tensor | None = None) -> Tensor:
        # A convolution of two maps put together is the sum of one of each. Putting them together
        # first takes nearly twice as long at stride 1, there and back.
        weight, bias = self.conv.weight, self.conv.bias
        x = F.conv2d(x, weight[:, : self.ins], bias, padding=1)
        if beside is not None:
            x += F.conv2d(beside, weight[:, self.ins :], padding=1)
        return self.relu(self.norm(x))


def _at_each_pixel(layer: nn.Linear, features: Tensor) -> Tensor:
    """A 1x1 convolution; as a product of matrices it is faster here."""
    return _in_full(layer, features.permute(0, 2, 3, 1)).permute(0, 3, 1, 2)


def _in_full(layer: nn.Linear, features: Tensor) -> Tensor:
    """In the precision of the weights: 8 bits are too few for the numbers that are the answer."""
    with torch.autocast(features.device.type, enabled=False):
        return layer(features.to(layer.weight.dtype))


def _doubled(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)
