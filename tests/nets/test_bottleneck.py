"""ResNet-50's trunk: its sizes and shapes."""

import pytest
import torch

from posecore.nets.bottleneck import Bottleneck, BottleneckResNet


@pytest.mark.slow
def test_resnet_50():
    net = BottleneckResNet()
    # torchvision's resnet50 has 25 557 032 weights, its classifier 2048 x 1000 and 1000.
    assert sum(p.numel() for p in net.parameters()) == 25_557_032 - 2_049_000
    assert net.channels == 2048
    assert net.layer4[2].conv3.weight.shape == (2048, 512, 1, 1)


@pytest.mark.parametrize(("size", "expected"), [((64, 96), (2, 3)), ((33, 65), (2, 3))])
def test_maps(size, expected):
    net = BottleneckResNet(4, (1, 2, 1, 1), in_channels=1)
    assert net(torch.rand(2, 1, *size)).shape == (2, 128, *expected)


def test_a_block_adds_to_what_comes_in():
    block = Bottleneck(16, 4).eval()
    assert block.downsample is None
    x = torch.rand(1, 16, 5, 5)
    torch.nn.init.zeros_(block.bn3.weight)
    torch.testing.assert_close(block(x), x)
    assert Bottleneck(16, 8, 2)(x).shape == (1, 32, 3, 3)


def test_what_cannot_be():
    for name, value in (("width", 0), ("blocks", (1, 1)), ("in_channels", 0)):
        with pytest.raises(ValueError, match=f"^{name}: expected"):
            BottleneckResNet(**{name: value})
    with pytest.raises(ValueError, match=r"^images: expected shape \(B, 3, H, W\)"):
        BottleneckResNet(2, (1, 1, 1, 1))(torch.zeros(1, 1, 32, 32))
