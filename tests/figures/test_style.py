"""Figures carry their words, and every notebook can show them."""

import base64
import io

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

from posecore.figures import style


def test_a_picture_is_a_figure_that_notebooks_show_with_its_words():
    picture = style.new_picture(3, 2, "mine", "default")
    assert isinstance(picture, Figure)
    data, metadata = picture._repr_mimebundle_()
    assert data["text/plain"] == metadata["image/png"]["alt"] == picture.alt == "mine"
    with Image.open(io.BytesIO(base64.b64decode(data["image/png"]))) as image:
        assert (image.format, image.size) == ("PNG", (300, 200))


def test_ipython_takes_the_picture_and_its_words():
    formatters = pytest.importorskip("IPython.core.formatters")
    data, metadata = formatters.DisplayFormatter().format(style.new_picture(1, 1, None, "words"))
    assert set(data) == {"image/png", "text/plain"}
    assert metadata == {"image/png": {"alt": "words"}}


def test_the_same_figure_is_the_same_file():
    files = [style.new_picture(1, 1, None, "d").png() for _ in range(2)]
    assert files[0] == files[1]


def test_neighbours_differ_in_grey():
    grey = [np.dot([0.299, 0.587, 0.114], to_rgb(colour)) for colour in style.CLOUD_COLOURS]
    assert (np.abs(np.diff(grey)) > 0.1).all()
    assert len(set(style.STYLES)) == len(set(style.MARKERS)) == 4


@given(
    arrays(np.float32, array_shapes(min_dims=2, max_dims=2), elements=st.floats(-9, 9, width=32))
)
def test_arrays_tensors_and_lists_are_the_same_floats(values):
    for given_ in (values, torch.from_numpy(values).requires_grad_(), values.tolist()):
        result = style.to_floats("x", given_, "N", values.shape[1])
        assert result.dtype == np.float64
        np.testing.assert_array_equal(result, values)
    assert style.to_floats("x", values[None], "...", *values.shape).shape == (1, *values.shape)


@pytest.mark.parametrize(
    "value",
    [
        [[1.0, np.nan]],
        [[1.0, 2.0, 3.0]],
        [1.0, 2.0],
        np.zeros((0, 2)),
        [["a", "b"]],
        [[1.0], [1.0, 2.0]],
        None,
        [[1j, 1]],
        torch.full((1, 2), np.inf),
    ],
)
def test_bad_arrays_are_named(value):
    with pytest.raises(ValueError, match="points: expected"):
        style.to_floats("points", value, "N", 2)


@pytest.mark.parametrize("alt", ["", "  ", 3])
def test_bad_words_are_named(alt):
    with pytest.raises(ValueError, match="alt"):
        style.new_picture(1, 1, alt, "default")
