"""Figures carry their words, and every notebook can show them."""

import base64
import io
import subprocess
import sys
from html.parser import HTMLParser

import matplotlib
import matplotlib.style
import numpy as np
import pytest
import torch
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

from posecore import figures
from posecore.figures import style


def test_a_picture_is_a_figure_that_notebooks_show_with_its_words():
    picture = style.new_picture(3, 2, "mine", "default")
    assert isinstance(picture, Figure)
    data, metadata = picture._repr_mimebundle_()
    assert data["text/plain"] == picture.alt == "mine" and not metadata
    kind, content = picture.stored()
    encoded = base64.b64encode(content).decode()
    assert data["text/html"] == f'<img alt="mine" src="data:{kind};base64,{encoded}">'
    assert set(data) == {"text/html", "text/plain"}  # a second form would double the size
    with Image.open(io.BytesIO(content)) as image:
        assert (image.format, image.size) == ("PNG", (300, 200))


class _Images(HTMLParser):
    def __init__(self):
        super().__init__()
        self.tags = []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.tags.append(data)


@given(st.text(st.characters(codec="utf-8", exclude_characters="\0\r")).filter(str.strip))
@example('a "quoted" <b>word</b> & \'more\'\nin two lines &amp; "><script>')
def test_any_words_are_the_alt_text_of_the_html(words):
    picture = style.Picture(figsize=(1, 1))
    picture.alt = words
    picture.stored = lambda: ("image/png", b"content")
    parser = _Images()
    parser.feed(picture._repr_mimebundle_()[0]["text/html"])
    parser.close()
    source = "data:image/png;base64,Y29udGVudA=="
    assert parser.tags == [("img", {"alt": words, "src": source})]


NOTEBOOK = """
import base64
import matplotlib.pyplot as plt
from IPython.utils.capture import capture_output
from IPython.core.interactiveshell import InteractiveShell
from matplotlib_inline.backend_inline import configure_inline_support
from posecore import figures

shell = InteractiveShell.instance()
shell.push({"a": figures.accuracy_curves({"a": [0.01]}, alt="words")})
a = shell.user_ns["a"]
for with_pyplot in (False, True):
    if with_pyplot:
        plt.figure()
        configure_inline_support(shell, "module://matplotlib_inline.backend_inline")
    for cell in ("a", "a.show(); 3", "for i in range(2): a.show()"):
        with capture_output() as captured:
            result = shell.run_cell(cell)
        result.raise_error()
        for output in captured.outputs:
            assert set(output.data) == {"text/html", "text/plain"}, output.data
            content = base64.b64encode(a.png()).decode()
            image = f'<img alt="words" src="data:image/png;base64,{content}">'
            assert output.data["text/html"] == image, "other bytes"
        print(len(captured.outputs))
assert len(plt.get_fignums()) == 1
"""


@pytest.mark.slow
def test_notebooks_show_the_picture_and_its_words_also_once_pyplot_is_there():
    """IPython has a way of its own to draw figures anew, which loses size and determinism."""
    pytest.importorskip("IPython")
    pytest.importorskip("matplotlib_inline")
    done = subprocess.run([sys.executable, "-c", NOTEBOOK], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["1", "1", "2"] * 2, done.stdout


def test_the_same_figure_is_the_same_file():
    files = [style.new_picture(1, 1, None, "d").png() for _ in range(2)]
    assert files[0] == files[1]


def _grid():
    return figures.picture_grid([np.eye(9)] * 5, list("abcde"), columns=3, colour_bar="x")


def _clouds():
    return figures.point_clouds({"a": np.eye(3)}, axes=(np.eye(3), np.zeros(3)))


@pytest.mark.slow
@pytest.mark.parametrize("make", [_grid, _clouds])
def test_shown_twice_it_is_the_same_file(make):
    """Laying out a figure used to move its axes a little every time."""
    figure = make()
    first = figure.png()
    figure.png(dpi=60)
    assert figure.png() == first == make().png()
    figure.axes[0].set_title("a title that came later")
    assert figure.png() != first


@pytest.mark.slow
def test_a_style_of_the_reader_does_not_change_figures():
    make = {
        "curves": lambda: figures.accuracy_curves({"a": [0.01]}),
        "histogram": lambda: figures.error_histogram({"a": [0.01]}),
        "poses": lambda: figures.pose_picture(
            np.eye(30), np.diag([9.0, 9, 1]), np.eye(3), [0, 0, 3], [1, 1, 1], labels=["a"]
        ),
        "clouds": _clouds,
    }
    before = {name: draw().png() for name, draw in make.items()}
    with matplotlib.style.context("dark_background"), matplotlib.rc_context():
        matplotlib.rcParams.update({"font.size": 30, "savefig.bbox": "tight", "axes.grid": True})
        kept = dict(matplotlib.rcParams)
        assert {name: draw().png() for name, draw in make.items()} == before
        assert dict(matplotlib.rcParams) == kept


@pytest.mark.slow
def test_drawings_are_small_and_photographs_keep_their_colours():
    drawing = figures.point_clouds({"a": np.random.default_rng(0).normal(size=(5000, 3))})
    assert len(drawing.png()) < 80_000
    yy, xx = np.mgrid[0:240, 0:320] / 320
    photograph = np.stack([xx, yy, 1 - xx], -1)
    with Image.open(io.BytesIO(figures.picture(photograph).png())) as image:
        pixels = np.asarray(image.convert("RGB"))
    step = photograph[0, 1] - photograph[0, 0]
    middle = pixels[len(pixels) // 2]
    assert len(np.unique(middle, axis=0)) > 200 and step[0] > 0


def test_a_small_mark_keeps_its_colour_beside_a_photograph():
    image = np.repeat(np.random.default_rng(0).uniform(0.3, 0.7, (200, 200, 1)), 3, 2)
    image[100, 100] = [1, 0, 0]
    with Image.open(io.BytesIO(figures.picture(image).png())) as picture:
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    assert (np.abs(pixels - [255, 0, 0]).sum(-1) < 20).any()


@pytest.mark.parametrize("shape", [(1, 3000), (3000, 1), (400, 4), (1, 1)])
def test_the_longest_and_the_thinnest_images_are_pictures(shape):
    with Image.open(io.BytesIO(figures.picture(np.eye(*shape)).png())) as picture:
        assert 30 <= min(picture.size) and max(picture.size) <= 2000


def test_show_in_the_middle_of_a_cell(capsys, monkeypatch):
    figure = style.new_picture(1, 1, "words", "")
    figure.show()
    figures.Viewer({"a": np.eye(3)}, alt="more words").show()
    assert capsys.readouterr().out == "words\nmore words\n"
    ipython = pytest.importorskip("IPython")
    shown = []
    monkeypatch.setattr(ipython, "get_ipython", lambda: object())
    monkeypatch.setattr("IPython.display.display", shown.append)
    figure.show()
    assert shown == [figure]


def test_boxes_and_axes_have_no_colour_in_common():
    assert not set(style.BOX_COLOURS) & set(style.AXIS_COLOURS.values())
    assert len(set(style.BOX_COLOURS)) == 4


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
