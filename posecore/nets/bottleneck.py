"""ResNet-50 without its end: blocks of three convolutions, the middle one narrow.

Layers and their names are those of torchvision's resnet50.
"""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor, nn

from posecore.arrays import fail, require_integer

__all__ = ["Bottleneck", "BottleneckResNet"]

WIDER = 4  # times as many channels go out of a block as its 3x3 has


class Bottleneck(nn.Module):
    """1x1 to `channels`, 3x3 with the stride, 1x1 to four times as many, added to what came in.

    Args:
        in_channels: of the maps that come in.
        channels: of the 3x3 convolution.
        stride: of the same.
    """

    def __init__(self, in_channels: int, channels: int, stride: int = 1) -> None:
        super().__init__()
        out = WIDER * channels
        self.conv1 = nn.Conv2d(in_channels, channels, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(channels)
        self.conv2 = nn.Conv2d(channels, channels, 3, stride, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(channels)
        self.conv3 = nn.Conv2d(channels, out, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(out)
        self.relu = nn.ReLU(inplace=True)
        self.downsample = None
        if stride > 1 or in_channels != out:
            conv = nn.Conv2d(in_channels, out, 1, stride, bias=False)
            self.downsample = nn.Sequential(conv, nn.BatchNorm2d(out))

    def forward(self, x: Tensor) -> Tensor:
        """(B, in_channels, H, W) to (B, 4 channels, H / stride, W / stride)."""
        shortcut = x if self.downsample is None else self.downsample(x)
        x = self.relu(self.bn1(self.conv1(x)))
        x = self.relu(self.bn2(self.conv2(x)))
        return self.relu(self.bn3(self.conv3(x)).add_(shortcut))


class BottleneckResNet(nn.Module):
    """ResNet-50 (He et al., "Deep Residual Learning for Image Recognition", CVPR 2016).

    Attributes:
        channels: of the last maps.

    Args:
        width: of the first stage's 3x3 convolutions; 64 in ResNet-50.
        blocks: how many of each of the four stages.
        in_channels: of the images.

    Raises:
        ValueError: if an argument is out of range.
    """

    def __init__(
        self, width: int = 64, blocks: Sequence[int] = (3, 4, 6, 3), in_channels: int = 3
    ) -> None:
        super().__init__()
        require_integer("width", width, 1)
        require_integer("in_channels", in_channels, 1)
        if not isinstance(blocks, Sequence) or len(blocks) != 4:
            fail("blocks", "four numbers, one of each stage", repr(blocks))
        self.conv1 = nn.Conv2d(in_channels, width, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.relu = nn.ReLU(inplace=True)
        self.maxpool = nn.MaxPool2d(3, 2, 1)
        channels = width
        for stage, count in enumerate(blocks):
            require_integer(f"blocks[{stage}]", count, 1)
            made = []
            for block in range(count):
                stride = 2 if stage and not block else 1
                made.append(Bottleneck(channels, width * 2**stage, stride))
                channels = WIDER * width * 2**stage
            setattr(self, f"layer{stage + 1}", nn.Sequential(*made))
        self.channels = channels
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, images: Tensor) -> Tensor:
        """(B, in_channels, H, W) to (B, 32 width, H / 32, W / 32), sides rounded up.

        Raises:
            ValueError: for images of another shape.
        """
        channels = self.conv1.in_channels
        if images.ndim != 4 or images.shape[1] != channels or not images.numel():
            fail("images", f"shape (B, {channels}, H, W), none 0", f"shape {tuple(images.shape)}")
        x = self.maxpool(self.relu(self.bn1(self.conv1(images))))
        return self.layer4(self.layer3(self.layer2(self.layer1(x))))
