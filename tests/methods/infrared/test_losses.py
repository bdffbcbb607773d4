"""The three losses, against what one computes by hand, and the options of each."""

import cv2
import numpy as np
import pytest
import torch

from posecore.methods.infrared.losses import CloudLoss, between, blur_masks
from posecore.methods.infrared.network import Cloud
from posecore.methods.infrared.projection import Projector
from posecore.splat import Pictures
from tests.methods.infrared.dots import Says

BOX = torch.tensor([-0.2, 0.0, 0.5]), torch.tensor([0.3, 1.0, 0.9])
TRUE = torch.tensor([[0.1, 0.2, 0.6]])


class Shows:
    """A projector that shows the same of every cloud, and keeps what it was given."""

    def __init__(self, silhouette, intensity=None):
        self.pictures = Pictures(silhouette, intensity)

    def __call__(self, points, t, own, K, T_world_cam, *, intensities, scale, sigma):
        self.given = {
            "points": points, "t": t, "own": own, "K": K, "T_world_cam": T_world_cam,
            "intensities": intensities, "scale": scale, "sigma": sigma,
        }  # fmt: skip
        return Pictures(
            self.pictures.silhouette, None if intensities is None else self.pictures.intensity
        )


def example(done=1.0, points=10, off=(0.0, 0.0, 0.0), **options):
    """A loss, a network and a batch: one instant in two views of 2 x 3 pixels."""
    silhouette = torch.tensor([[[[1.0, 1, 1], [1, 1, 1]], [[0, 0, 0], [0, 0, 0]]]])
    intensity = torch.full_like(silhouette, 0.5)
    generator = torch.Generator().manual_seed(0)
    cloud = Cloud(
        torch.rand(1, points, 3, generator=generator), torch.rand(1, points, generator=generator),
        TRUE + torch.tensor(off), torch.tensor([0.7]),
    )  # fmt: skip
    batch = {
        "images": torch.zeros(1, 1, 2, 3), "t": TRUE, "own": torch.eye(4)[None],
        "K": torch.eye(3).expand(1, 2, 3, 3), "T_world_cam": torch.eye(4).expand(1, 2, 4, 4),
        "masks": torch.full((1, 2, 2, 3), 0.25), "shades": torch.full((1, 2, 2, 3), 0.2),
        "done": torch.tensor(done),
    }  # fmt: skip
    projector = Shows(silhouette, intensity)
    return CloudLoss(projector, **options), Says(cloud, *BOX), batch, projector


def test_the_sum_by_hand():
    loss, net, batch, _ = example(off=(0.1, 0.0, 0.2))
    parts = loss(net, batch)
    # Of masks that are the same all over, a blur leaves nothing but that.
    mask, intensity = (0.75**2 + 0.25**2) / 2, 0.3**2
    translation = (0.1 / 0.5) ** 2 + (0.2 / 0.4) ** 2
    assert parts.keys() == {"loss", "translation", "mask", "intensity"}
    assert parts["translation"].item() == pytest.approx(translation, rel=1e-5)
    assert parts["mask"].item() == pytest.approx(mask)
    assert parts["intensity"].item() == pytest.approx(intensity)
    expected = 0.2 * translation + 0.2 * mask + 0.6 * intensity
    assert parts["loss"].item() == pytest.approx(expected, rel=1e-5)


def test_weights_are_a_b_c():
    loss, net, batch, _ = example(off=(0.1, 0, 0), weights=(3, 5, 7))
    parts = loss(net, batch)
    expected = 3 * parts["translation"] + 5 * parts["mask"] + 7 * parts["intensity"]
    assert parts["loss"].item() == pytest.approx(expected.item())


def test_a_translation_in_metres():
    loss, net, batch, _ = example(off=(0.1, 0.0, 0.2), box_units=False)
    assert loss(net, batch)["translation"].item() == pytest.approx(0.05, rel=1e-5)


def test_a_box_without_extent_gives_no_infinite_loss():
    loss, net, batch, _ = example(off=(0.0, 0.0, 0.0))
    net.high = net.low
    assert loss(net, batch)["translation"].item() == 0


def test_sums_over_pixels():
    mean, net, batch, _ = example()
    total = example(by_resolution=False)[0]
    for name in ("mask", "intensity"):
        assert total(net, batch)[name].item() == pytest.approx(6 * mean(net, batch)[name].item())


def test_no_intensities():
    loss, net, batch, projector = example(weights=(0.5, 0.5, 0))
    parts = loss(net, batch)
    assert parts.keys() == {"loss", "translation", "mask"}
    assert projector.given["intensities"] is None


def test_clouds_are_projected_from_their_true_place():
    loss, net, batch, projector = example(off=(0.1, 0.1, 0.1))
    loss(net, batch)
    given = projector.given
    for name in ("t", "own", "K", "T_world_cam"):
        assert torch.equal(given[name], batch[name])
    assert torch.equal(given["points"], net.cloud.points)
    assert torch.equal(given["scale"], net.cloud.scale)
    loss, net, batch, projector = example(relative=False, use_scale=False)
    loss(net, batch)
    torch.testing.assert_close(projector.given["t"], torch.tensor([[0.05, 0.5, 0.7]]))
    assert projector.given["scale"] == 1.0


@pytest.mark.parametrize(
    ("done", "keep", "count"),
    [
        (0.0, (0.07, 1.0), 14), (0.4, (0.07, 1.0), 107), (0.8, (0.07, 1.0), 200),
        (1.0, (0.07, 1.0), 200), (0.5, (1.0, 1.0), 200), (0.8, (1.0, 0.5), 100),
        (0.0, (1e-9, 1.0), 1),
    ],
)  # fmt: skip
def test_some_of_the_points_are_kept(done, keep, count):
    loss, net, batch, projector = example(done, 200, keep=keep)
    torch.manual_seed(0)
    loss(net, batch)
    given = projector.given
    assert given["points"].shape == (1, count, 3) and given["intensities"].shape == (1, count)
    # Each once, with its own intensity.
    rows = (given["points"][0][:, None] == net.cloud.points[0]).all(-1)
    assert (rows.sum(1) == 1).all() and (rows.sum(0) <= 1).all()
    assert torch.equal(given["intensities"][0], net.cloud.intensities[0][rows.int().argmax(1)])
    if 1 < count < 200:
        loss(net, batch)
        assert not torch.equal(projector.given["points"], given["points"])  # drawn anew


def test_the_blur_goes_from_one_end_to_the_other_in_equal_ratios():
    loss, net, batch, projector = example(0.5, blur=(3.2, 0.2))
    assert [loss.sigma(done) for done in (0, 0.25, 0.5, 1)] == pytest.approx([3.2, 1.6, 0.8, 0.2])
    loss(net, batch)
    assert projector.given["sigma"] == pytest.approx(0.8)


def test_the_blur_of_masks_grows_with_the_training():
    masks = torch.zeros(1, 2, 2, 3)
    masks[..., 1] = 1
    for done, variance in ((0.0, 0.2), (0.5, 0.6), (1.0, 1.0)):
        loss, net, batch, projector = example(done)
        batch["masks"] = masks
        expected = (projector.pictures.silhouette - blur_masks(masks, variance)).square().mean()
        assert loss(net, batch)["mask"].item() == pytest.approx(expected.item())
    loss, net, batch, projector = example(mask_blur=(0, 0))
    batch["masks"] = masks
    expected = (projector.pictures.silhouette - masks).square().mean()
    assert loss(net, batch)["mask"].item() == pytest.approx(expected.item())


@pytest.mark.parametrize("variance", [1e-3, 0.2, 0.6, 1.0, 100])
def test_masks_are_blurred_as_by_opencv(variance):
    masks = torch.rand(2, 3, 7, 9, generator=torch.Generator().manual_seed(0))
    found = blur_masks(masks, variance)
    for one, other in zip(found.flatten(0, 1), masks.flatten(0, 1), strict=True):
        expected = cv2.GaussianBlur(
            other.numpy(), (3, 3), variance**0.5, borderType=cv2.BORDER_REPLICATE
        )
        np.testing.assert_allclose(one, expected, atol=1e-6)


def test_masks_that_are_not_blurred():
    masks = torch.rand(2, 5, 5)
    assert torch.equal(blur_masks(masks, 0), masks)
    torch.testing.assert_close(blur_masks(masks, 1e-300), masks)
    one = torch.ones(1, 1, 1)
    torch.testing.assert_close(blur_masks(one, 1.0), one)
    with pytest.raises(ValueError, match="^variance"):
        blur_masks(masks, -1)


def test_from_one_end_to_the_other():
    assert [between((0.2, 1.0), done) for done in (0, 0.5, 1)] == pytest.approx([0.2, 0.6, 1.0])


@pytest.mark.parametrize("name", ["masks", "shades"])
def test_masks_of_other_views_are_refused(name):
    """Those of one view would count for all."""
    loss, net, batch, _ = example()
    with pytest.raises(ValueError, match=rf"^{name}: expected shape \(1, 2, 2, 3\), got"):
        loss(net, batch | {name: batch[name][:, :1]})


def test_the_gradient_pulls_a_cloud_into_the_mask():
    """By its true projector: a cloud that lies beside the mask moves into it."""
    projector = Projector((16, 16), (16, 16, 16), 1.0)
    masks = torch.zeros(1, 1, 16, 16)
    masks[..., 6:10, 9:13] = 1
    batch = {
        "images": torch.zeros(1, 1, 16, 16), "t": torch.tensor([[0.0, 0, 1]]),
        "own": torch.eye(4)[None], "T_world_cam": torch.eye(4)[None, None],
        "K": torch.tensor([[[[16.0, 0, 7.5], [0, 16, 7.5], [0, 0, 1]]]]),
        "masks": masks, "shades": masks, "done": torch.tensor(1.0),
    }  # fmt: skip
    points = torch.rand(1, 60, 3, generator=torch.Generator().manual_seed(0)) * 0.3 - 0.05
    points.requires_grad_()
    loss = CloudLoss(projector, blur=(1.0, 1.0))
    descent = torch.optim.Adam([points], lr=0.02)
    values = []
    for _ in range(40):
        cloud = Cloud(points, torch.ones(1, 60), batch["t"], torch.ones(1))
        value = loss(Says(cloud, *BOX), batch)["loss"]
        descent.zero_grad()
        value.backward()
        descent.step()
        values.append(value.item())
    assert values[-1] < 0.4 * values[0]
    # The middle of the mask is at pixel (10.5, 7.5), which is 3 / 16 m aside at 1 m.
    assert points.detach().mean(1)[0, :2].tolist() == pytest.approx([3 / 16, 0], abs=0.06)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("weights", (1, 2)), ("weights", (1, 2, -1)), ("weights", 1), ("mask_blur", (0.2,)),
        ("mask_blur", (-0.1, 1)), ("blur", (3, 0)), ("blur", (float("inf"), 1)),
        ("keep", (0, 1)), ("keep", (0.5, 1.1)), ("keep", (0.5, float("nan"))),
    ],
)  # fmt: skip
def test_numbers_that_cannot_be(name, value):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        CloudLoss(None, **{name: value})
