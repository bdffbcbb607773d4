"""The cloud estimator: from one infrared image to a cloud of points, and where it is.

Source: Firintepe et al., "From IR images to point clouds to pose", 2021, Section 3.1.2, Figure 4;
what they leave out is as Insafutdinov and Dosovitskiy have it, "Unsupervised learning of shape and
pose with differentiable point clouds", 2018.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from posecore.arrays import fail, require_integer, require_number

__all__ = ["SIZES", "Cloud", "CloudNet"]

SIZES = ("points", "width", "blocks", "max_channels", "hidden", "cube", "max_scale")
"""What a `CloudNet` is made with, but for the size of its images."""

SLOPE = 0.2  # of the leaky ReLUs


class Cloud(NamedTuple):
    """What the network predicts of B images.

    Attributes:
        points: (B, N, 3) metres, relative to `t`, along the axes of the camera.
        intensities: (B, N) 0 to 1.
        t: (B, 3) metres, the object's translation in the camera's frame.
        scale: (B,) 0 to `max_scale`, of the occupancy: how much of a ray a point stops.
    """

    points: Tensor
    intensities: Tensor
    t: Tensor
    scale: Tensor


class CloudNet(nn.Module):
    """Convolutions, a decoder of two layers, and four heads.

    A block is a convolution of 3 x 3 with stride 2 and one of 1 x 1; the next block has twice as
    many channels. What they say is flattened. Intensities are read off it directly, "as they are in
    the image already"; places, points and scale from the decoder's code of it.

    Args:
        image: (width, height) of the images in pixels.
        points: N, of a cloud.
        width: channels of the first block.
        blocks: how many.
        max_channels: of a block; None for no limit.
        hidden: the decoder's code.
        cube: metres, side of the cube about `t` in which all points are.
        max_scale: of the occupancy; 1 in the paper, more where points are few for the grid.

    Attributes:
        mean, std: of the images, which are normalised by them; 0 and 1 until they are set.
        low, high: (3,) metres, the object box, in whose units translations are predicted.

    Raises:
        ValueError: if a size is no positive integer, or the cube or the scale is not above 0.
    """

    def __init__(
        self,
        image: tuple[int, int],
        points: int,
        *,
        width: int = 16,
        blocks: int = 6,
        max_channels: int | None = None,
        hidden: int = 1024,
        cube: float = 0.4,
        max_scale: float = 1.0,
    ) -> None:
        super().__init__()
        if not isinstance(image, tuple | list) or len(image) != 2:
            fail("image", "a pair (width, height)", repr(image))
        across, down = (require_integer("image", side, 1) for side in image)
        for name, value in (
            ("points", points), ("width", width), ("blocks", blocks), ("hidden", hidden),
            ("max_channels", 1 if max_channels is None else max_channels),
        ):  # fmt: skip
            require_integer(name, value, 1)
        self.image, self.cube = (across, down), require_number("cube", cube, above=0)
        self.max_scale = require_number("max_scale", max_scale, above=0)
        layers, channels = [], 1
        for block in range(blocks):
            out = min(width * 2**block, max_channels or width * 2**block)
            layers += [nn.Conv2d(channels, out, 3, 2, 1), nn.LeakyReLU(SLOPE)]
            layers += [nn.Conv2d(out, out, 1), nn.LeakyReLU(SLOPE)]
            channels, across, down = out, (across + 1) // 2, (down + 1) // 2
        self.encoder = nn.Sequential(*layers)
        features = channels * across * down
        self.decoder = nn.Sequential(
            nn.Linear(features, hidden), nn.LeakyReLU(SLOPE),
            nn.Linear(hidden, hidden), nn.LeakyReLU(SLOPE),
        )  # fmt: skip
        self.place = nn.Linear(hidden, 3)
        self.points = nn.Linear(hidden, 3 * points)
        self.scale = nn.Linear(hidden, 1)
        self.intensity = nn.Linear(features, points)
        for name, value in (("mean", 0.0), ("std", 1.0), ("low", (0, 0, 0)), ("high", (1, 1, 1))):
            self.register_buffer(name, torch.tensor(value, dtype=torch.float32))
        self._reset()

    def _reset(self) -> None:
        for layer in self.encoder:
            if isinstance(layer, nn.Conv2d):
                nn.init.kaiming_normal_(layer.weight, SLOPE)
                nn.init.zeros_(layer.bias)
        # At first all images get the same cloud, spread out, in the middle of the box.
        nn.init.normal_(self.points.weight, std=0.025)
        nn.init.normal_(self.points.bias, std=0.3)
        nn.init.constant_(self.place.bias, 0.5)

    def forward(self, images: Tensor) -> Cloud:
        """The clouds of images.

        Args:
            images: (B, 1, height, width) infrared, 0 to 1.

        Raises:
            ValueError: for images of another shape.
        """
        if images.ndim != 4 or images.shape[1:] != (1, *self.image[::-1]):
            fail("images", f"shape (B, 1, {self.image[1]}, {self.image[0]})", tuple(images.shape))
        features = self.encoder((images - self.mean) / self.std).flatten(1)
        code = self.decoder(features)
        # Half precision is for layers: a point within half a metre would be off by 0.2 mm.
        points = torch.tanh(self.points(code).float()).unflatten(1, (-1, 3))
        place = self.place(code).float()
        return Cloud(
            points * (self.cube / 2),
            torch.sigmoid(self.intensity(features).float()),
            self.low + place * (self.high - self.low),
            torch.sigmoid(self.scale(code).float())[:, 0] * self.max_scale,
        )

    @property
    def middle(self) -> Tensor:
        """(3,) metres, of the object box."""
        return (self.low + self.high) / 2
