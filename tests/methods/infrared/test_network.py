"""The cloud estimator: what it gives, and what it is made of."""

import pytest
import torch

from posecore.methods.infrared.network import SIZES, CloudNet
from posecore.methods.infrared.recipe import RECIPES
from posecore.randomness import seeded


def small(**changes):
    with seeded(0):
        return CloudNet((20, 12), 7, **({"width": 4, "blocks": 2, "hidden": 16} | changes))


IMAGES = torch.rand(3, 1, 12, 20, generator=torch.Generator().manual_seed(0))


@pytest.mark.slow
@pytest.mark.parametrize("scale", ["tiny", "book", "paper"])
def test_clouds_at_every_scale(scale):
    recipe = RECIPES[scale]
    with torch.no_grad(), seeded(0):
        net = CloudNet(recipe.image, **{name: getattr(recipe, name) for name in SIZES})
        cloud = net(torch.rand(2, 1, *recipe.image[::-1]))
    shapes = [tuple(value.shape) for value in cloud]
    assert shapes == [(2, recipe.points, 3), (2, recipe.points), (2, 3), (2,)]
    assert all(value.isfinite().all() for value in cloud)
    # All images get nearly the same cloud at first, which fills most of the cube, amid the box.
    assert (cloud.points[0] - cloud.points[1]).abs().max() < 0.5 * recipe.cube
    spread = cloud.points.abs().amax((0, 1)) / (recipe.cube / 2)
    assert (spread > 0.5).all() and (spread <= 1).all()
    assert (cloud.t - 0.5).abs().max() < 0.5


def test_blocks_of_two_convolutions_that_double_the_channels():
    net = small(blocks=4, max_channels=24)
    layers = [layer for layer in net.encoder if isinstance(layer, torch.nn.Conv2d)]
    assert [layer.kernel_size[0] for layer in layers] == [3, 1] * 4
    assert [layer.stride[0] for layer in layers] == [2, 1] * 4
    assert [layer.out_channels for layer in layers] == [4, 4, 8, 8, 16, 16, 24, 24]
    assert net.intensity.in_features == net.decoder[0].in_features == 24 * 2 * 1


def test_intensities_come_from_the_features_and_all_else_from_the_code():
    net = small()
    before = net(IMAGES)
    torch.nn.init.zeros_(net.decoder[-2].weight)
    after = net(IMAGES)
    assert torch.equal(before.intensities, after.intensities)
    for name in ("points", "t", "scale"):
        assert not torch.equal(getattr(before, name), getattr(after, name))
        assert torch.equal(getattr(after, name)[0], getattr(after, name)[1])


def test_what_it_says_stays_in_its_range():
    net = small(cube=0.3, max_scale=3)
    with seeded(1):
        for layer in (net.points, net.intensity, net.scale):
            torch.nn.init.normal_(layer.weight, std=30)
    cloud = net(IMAGES)
    assert cloud.points.abs().max().item() == pytest.approx(0.15)
    assert 0 <= cloud.intensities.min() < 0.01 and 0.99 < cloud.intensities.max() <= 1
    assert (cloud.scale >= 0).all() and 2.9 < cloud.scale.max() <= 3


def test_translations_are_in_units_of_the_box():
    net = small()
    inside = net(IMAGES).t
    low, high = torch.tensor([-1.0, 0, 0.5]), torch.tensor([1.0, 0.1, 0.9])
    net.low.copy_(low), net.high.copy_(high)
    torch.testing.assert_close(net(IMAGES).t, low + inside * (high - low))
    torch.testing.assert_close(net.middle, torch.tensor([0, 0.05, 0.7]))


def test_images_are_normalised():
    net = small()
    expected = net((IMAGES - 0.3) / 0.2)
    net.mean.fill_(0.3), net.std.fill_(0.2)
    for one, other in zip(net(IMAGES), expected, strict=True):
        torch.testing.assert_close(one, other)


def test_what_is_known_of_the_data_belongs_to_the_weights():
    net, other = small(), small()
    net.mean.fill_(0.3), net.std.fill_(0.2), net.low.fill_(-1), net.high.fill_(2)
    assert {"mean", "std", "low", "high"} <= net.state_dict().keys()
    assert not any(value.requires_grad for value in net.buffers())
    other.load_state_dict(net.state_dict())
    assert torch.equal(other(IMAGES).t, net(IMAGES).t)


def test_half_precision_is_for_layers():
    net = small()
    with torch.autocast("cpu", torch.bfloat16):
        cloud = net(IMAGES)
    assert all(value.dtype == torch.float32 for value in cloud)
    assert not torch.equal(cloud.points, net(IMAGES).points)
    # Of 0.5 m bfloat16 has steps of 2 mm: the places are not rounded to these.
    assert not torch.equal(cloud.points, cloud.points.bfloat16().float())


@pytest.mark.parametrize("shape", [(3, 1, 20, 12), (3, 3, 12, 20), (1, 12, 20), (3, 1, 12, 21)])
def test_images_of_another_shape(shape):
    with pytest.raises(ValueError, match=r"^images: expected shape \(B, 1, 12, 20\)"):
        small()(torch.zeros(shape))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("image", (20,)), ("image", 20), ("image", (20, 0)), ("points", 0), ("width", 2.5),
        ("blocks", 0), ("hidden", -1), ("max_channels", 0), ("cube", 0), ("max_scale", 0),
    ],
)  # fmt: skip
def test_sizes_that_cannot_be(name, value):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        CloudNet(**({"image": (20, 12), "points": 7} | {name: value}))
