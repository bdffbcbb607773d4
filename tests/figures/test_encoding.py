"""Files of figures: JPEG for photographs, PNG for drawings, told apart by what is drawn."""

import base64
import io

import numpy as np
import pytest
from PIL import Image

from posecore import figures
from posecore.figures.encoding import holds_photograph, to_jpeg
from posecore.figures.style import new_picture


def photograph(height=120, width=160, grain=6.0):
    yy, xx = np.mgrid[0:height, 0:width] / width
    smooth = 255 * np.stack([xx, yy, 1 - xx], -1)
    noise = np.random.default_rng(0).normal(0, grain, smooth.shape)
    return (smooth + noise).clip(0, 255).astype(np.uint8)


def drawing():
    return figures.accuracy_curves({"a": [0.01, 0.02]})


DRAWN = {
    "a photograph": (lambda: figures.picture(photograph()), True),
    "numbers in [0, 1]": (lambda: figures.picture(photograph() / 255), True),
    "greys of bytes": (lambda: figures.picture(photograph()[..., 0]), True),
    "greys of numbers": (lambda: figures.picture(photograph()[..., 0] / 255), True),
    "one of several": (lambda: figures.picture_grid([np.eye(9), photograph()]), True),
    "a depth map": (lambda: figures.picture(photograph()[..., 0], colour_bar="depth, m"), False),
    "a mask": (lambda: figures.picture(photograph()[..., 0] > 99), False),
    "few colours": (lambda: figures.picture(photograph() // 99 * 99), False),
    "curves": (drawing, False),
    "nothing": (lambda: new_picture(1, 1, "words"), False),
}


@pytest.mark.parametrize("name", DRAWN)
def test_what_holds_a_photograph_is_told_by_what_is_drawn(name):
    make, expected = DRAWN[name]
    assert holds_photograph(make()) is expected


def test_an_image_that_is_not_shown_does_not_count():
    figure = figures.picture(photograph())
    figure.axes[0].images[0].set_visible(False)
    assert not holds_photograph(figure)


@pytest.mark.slow
def test_photographs_are_stored_as_jpeg_with_colour_at_every_pixel():
    figure = figures.picture(photograph(360, 480), alt="words")
    kind, content = figure.stored()
    assert kind == "image/jpeg" and len(content) < len(figure.png()) / 2
    encoded = base64.b64encode(content).decode()
    assert f"data:image/jpeg;base64,{encoded}" in figure._repr_mimebundle_()[0]["text/html"]
    with Image.open(io.BytesIO(content)) as image, Image.open(io.BytesIO(figure.png())) as png:
        assert image.format == "JPEG" and image.size == png.size
        assert [layer[1:3] for layer in image.layer] == [(1, 1)] * 3  # 4:4:4
        off = np.abs(np.asarray(image).astype(int) - np.asarray(png.convert("RGB")))
    assert off.mean() < 5


def test_drawings_are_stored_as_png():
    figure = drawing()
    assert figure.stored() == ("image/png", figure.png())


def test_squares_of_pixels_are_stored_as_png_in_colours_that_come_near():
    figure = figures.picture(photograph(12, 16))
    kind, content = figure.stored()
    with Image.open(io.BytesIO(content)) as image, Image.open(io.BytesIO(figure.png())) as png:
        off = np.abs(np.asarray(image.convert("RGB")).astype(int) - np.asarray(png.convert("RGB")))
    assert kind == "image/png" and len(content) <= len(figure.png())
    assert off.mean() < 2.6 and off.max() <= 80


@pytest.mark.slow
def test_the_same_photograph_is_the_same_file_each_time():
    figure = figures.picture(photograph())
    first = figure.stored()
    figure.png()
    assert figure.stored() == first == figures.picture(photograph()).stored()


@pytest.mark.slow
def test_thin_lines_and_letters_stay_sharp_on_a_photograph():
    figure = figures.picture(photograph(360, 480))
    figure.axes[0].plot([10, 470], [180, 180], color="#D55E00", lw=1)
    kind, content = figure.stored()
    sharp = np.asarray(Image.open(io.BytesIO(figure.png())).convert("RGB")).astype(int)
    assert kind == "image/jpeg"
    found = np.asarray(Image.open(io.BytesIO(content))).astype(int)
    line = np.abs(sharp - [0xD5, 0x5E, 0]).sum(-1) < 60
    assert line.sum() > 400
    assert np.abs(found - sharp)[line].mean() < 14


def test_better_quality_is_a_larger_file():
    image = Image.fromarray(photograph())
    sizes = [len(to_jpeg(image, quality)) for quality in (50, 80, 95)]
    assert sizes == sorted(set(sizes))
