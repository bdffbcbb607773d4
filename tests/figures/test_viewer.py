"""The viewer holds the points, loads nothing, and falls back to its still picture."""

import base64
import html
import io
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from posecore import figures
from posecore.figures.clouds3d import AZIMUTH, ELEVATION
from posecore.figures.scene import directions

CLOUD = arrays(np.float64, st.tuples(st.integers(1, 8), st.just(3)), elements=st.floats(-2, 2))


def _viewer(**arguments):
    rng = np.random.default_rng(0)
    clouds = {"model": rng.normal(size=(300, 3)) * 0.1, "estimate": rng.normal(size=(200, 3)) * 0.1}
    return figures.Viewer(clouds, axes=(np.eye(3), np.zeros(3)), **arguments)


def _payload(text):
    """What the script of a page is called with."""
    return json.loads(re.search(r'\}\)\("viewer-[^"]*",(\{.*\})\)</script>$', text).group(1))


def _positions(part, payload):
    stored = np.frombuffer(base64.b64decode(part["positions"]), "<u2").reshape(-1, 3)
    return np.array(payload["low"]) + stored * payload["resolution"]


@pytest.mark.slow
@settings(max_examples=15)
@given(CLOUD, st.sampled_from(["z", "-y"]))
def test_the_page_holds_the_points_to_its_resolution(points, up):
    viewer = figures.Viewer({"a": torch.from_numpy(points)}, up=up, axes=(np.eye(3), np.ones(3)))
    payload = _payload(viewer.html())
    span = np.ptp(np.concatenate([_positions(part, payload) for part in payload["parts"]]), axis=0)
    assert viewer.resolution == payload["resolution"] == pytest.approx(span.max() / 65535)
    cloud, *axes = payload["parts"]
    assert np.abs(_positions(cloud, payload) - points).max() <= viewer.resolution * 0.5001
    assert [part["label"] for part in axes] == ["x", "y", "z"]
    assert all(part["lines"] and part["onTop"] for part in axes)
    assert payload["up"] == up


def test_colours_are_stored_as_bytes():
    rgb = np.random.default_rng(0).integers(0, 256, (4, 3), dtype=np.uint8)
    viewer = figures.Viewer(
        {"many": np.eye(4, 3), "one": np.eye(3)},
        colours={"many": rgb, "one": "#0072B2"},
        boxes=(np.eye(3), np.zeros(3), np.ones(3)),
    )
    many, one, boxes = _payload(viewer.html())["parts"]
    stored = np.frombuffer(base64.b64decode(many["colours"]), np.uint8)
    np.testing.assert_array_equal(stored.reshape(-1, 3), rgb)
    assert one["colour"] == [0, 0x72, 0xB2]
    assert "colours" not in one
    assert boxes["colour"] is None  # the page's own


def test_one_point_is_a_scene():
    payload = _payload(figures.Viewer({"a": [[1.0, 2.0, 3.0]]}).html())
    assert payload["radius"] > 0
    np.testing.assert_allclose(_positions(payload["parts"][0], payload), [[1, 2, 3]], atol=1e-5)


class _References(HTMLParser):
    """Everything that a browser would load, and all ids."""

    def __init__(self):
        super().__init__()
        self.loaded, self.ids, self.tags = [], [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        for name, value in attrs:
            if name in ("src", "href", "srcset", "data", "poster", "action"):
                self.loaded.append(value)
            if name == "id":
                self.ids.append(value)


def _parse(text):
    parser = _References()
    parser.feed(text)
    return parser


def test_nothing_is_loaded_from_elsewhere():
    text = _viewer().html()
    (still,) = _parse(text).loaded
    assert still.startswith("data:image/png;base64,")
    for word in ("http", "//", "import(", "fetch(", "XMLHttpRequest", "url("):
        without = re.sub(r"//[^\n]*\n", "\n", text.replace(still, ""))  # comments of the script
        without = re.sub(r'"[A-Za-z0-9+/=]{8,}"', '""', without)  # stored positions
        assert word not in without


def test_the_page_says_what_it_shows():
    viewer = _viewer(alt='<model> & "estimate"')
    assert f'alt="{html.escape(viewer.alt)}"' in viewer.html()
    assert viewer.still.alt == viewer.alt
    default = _viewer().alt
    assert default == "model (300 points), estimate (200 points), axes; seen from: oblique; in mm"


def test_labels_cannot_end_the_script():
    text = figures.Viewer({"</script><img src=x>": np.eye(3)}).html()
    assert _parse(text).tags == ["figure", "img", "script"]
    assert _payload(text)["parts"][0]["label"] == "</script><img src=x>"


@pytest.mark.slow
def test_every_figure_has_an_id_of_its_own():
    viewer = _viewer()
    pages = [viewer.html(), viewer.html(), viewer._repr_html_(), _viewer().html()]
    ids = [_parse(page).ids[0] for page in pages]
    assert len(set(ids)) == 4
    for page, name in zip(pages, ids, strict=True):
        assert f'("{name}",' in page


def test_notebooks_store_the_page_and_the_still_picture():
    viewer = _viewer()
    data, metadata = viewer._repr_mimebundle_()
    assert set(data) == {"text/html", "image/png", "text/plain"}
    png = base64.b64decode(data["image/png"])
    assert png == viewer.png()
    assert data["image/png"] in data["text/html"]
    with Image.open(io.BytesIO(png)) as picture:
        picture.load()
        assert picture.format == "PNG"
        assert len(picture.getcolors()) > 10
    assert data["text/plain"] == metadata["image/png"]["alt"] == viewer.alt


@pytest.mark.slow
@pytest.mark.parametrize("coloured", [False, True])
def test_five_thousand_points_are_less_than_150_kb(coloured):
    rng = np.random.default_rng(0)
    colours = {"a": rng.integers(0, 256, (5000, 3))} if coloured else None
    viewer = figures.Viewer({"a": rng.normal(size=(5000, 3))}, colours=colours)
    assert len(viewer.html().encode()) < 150_000


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"clouds": {}}, "clouds"),
        ({"clouds": {"a": [[0, 0, np.nan]]}}, r"clouds\['a'\]"),
        ({"colours": {"b": "red"}}, "colours"),
        ({"axes": (np.eye(3),)}, "axes"),
        ({"axes": (np.eye(3), np.zeros(3)), "axis_length": -1}, "axis_length"),
        ({"boxes": (np.eye(3), np.zeros(3))}, "boxes"),
        ({"lines": {"l": np.eye(3)}}, r"lines\['l'\]"),
        ({"up": "x"}, "up"),
        ({"unit": "inch"}, "unit"),
        ({"alt": " "}, "alt"),
    ],
)
def test_bad_input_is_named(arguments, name):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        figures.Viewer(**{"clouds": {"a": [[0, 0, 0]]}, **arguments})


# Driven in a browser: what the reader does, and what is seen then. The colours of the pixels are
# read back from the canvas of the first figure.
DRIVE = """
function seen() {
  var canvas = document.querySelector('canvas'), gl = canvas.getContext('webgl');
  var data = new Uint8Array(canvas.width * canvas.height * 4), found = {points: 0, sum: 0, ink: 0};
  gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, data);
  for (var i = 0; i < data.length; i += 4) if (data[i + 3]) {
    found.points++; found.sum = (found.sum * 31 + i) % 1000003;
    if (data[i] === 1 && data[i + 1] === 2 && data[i + 2] === 3) found.ink++;
    if (data[i] === 201 && data[i + 1] === 202 && data[i + 2] === 203) found.light =
      (found.light || 0) + 1;
  }
  return found;
}
function pointer(kind, id, x, y) {
  document.querySelector('canvas').dispatchEvent(
    new PointerEvent(kind, {pointerId: id, clientX: x, clientY: y, bubbles: true}));
}
function key(name) {
  document.querySelector('canvas').dispatchEvent(new KeyboardEvent('keydown', {key: name}));
}
function doubleClick() {
  document.querySelector('canvas').dispatchEvent(new MouseEvent('dblclick'));
}
var steps = {
  start: doubleClick,
  drag: function () {
    pointer('pointerdown', 1, 100, 100); pointer('pointermove', 1, 180, 130);
    pointer('pointerup', 1, 180, 130);
  },
  idle: function () { pointer('pointermove', 1, 300, 300); },
  back: doubleClick,
  pinch: function () {
    pointer('pointerdown', 1, 100, 100); pointer('pointerdown', 2, 120, 100);
    pointer('pointermove', 2, 130, 100);
    pointer('pointerup', 1, 0, 0); pointer('pointerup', 2, 0, 0);
  },
  again: doubleClick,
  key: function () { key('ArrowLeft'); },
  unkey: function () { key('ArrowRight'); },
  hide: function () { document.querySelector('button').click(); },
  dark: function () {
    document.querySelector('button').click(); document.body.style.color = 'rgb(201, 202, 203)';
  }
};
var result = {}, names = Object.keys(steps);
function next() {
  var name = names.shift();
  if (!name) {
    var canvas = document.querySelector('canvas');
    result.canvases = document.querySelectorAll('figure > canvas').length;
    result.stills = document.querySelectorAll('figure > img').length;
    result.label = canvas.getAttribute('aria-label');
    result.buttons = Array.from(document.querySelectorAll('figure button'), function (b) {
      return b.textContent; });
    document.getElementById('result').textContent = JSON.stringify(result);
    return;
  }
  steps[name]();
  setTimeout(function () { result[name] = seen(); next(); }, 50);
}
setTimeout(next, 50);
"""


@pytest.fixture(scope="module")
def browse(tmp_path_factory):
    """Opens a page in Chromium without a window and returns what it looks like afterwards."""
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("no chromium on PATH (Debian: apt-get install chromium)")

    def open_page(content):
        folder = tmp_path_factory.mktemp("page")
        (folder / "page.html").write_text(content)
        command = [
            *(chromium, "--headless", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"),
            *("--enable-unsafe-swiftshader", "--disable-background-networking"),
            *("--window-size=700,900", "--virtual-time-budget=10000", "--dump-dom"),
            *(f"--user-data-dir={folder / 'profile'}", (folder / "page.html").as_uri()),
        ]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
        return done.stdout

    return open_page


def _page_of(*parts, head=""):
    head += "<style>body{background:white;color:rgb(1,2,3)}</style>"
    return f"<!doctype html><head><meta charset='utf-8'>{head}</head><body>{''.join(parts)}"


@pytest.mark.slow
def test_a_browser_turns_it(browse):
    viewer = _viewer(boxes=(np.eye(3), np.zeros(3), [0.4, 0.4, 0.4]))
    # A browser without a window paints when it likes: here it paints when it is asked to.
    head = "<script>requestAnimationFrame = function (f) { setTimeout(f, 0); };</script>"
    drive = f"<pre id='result'></pre><script>{DRIVE}</script>"
    shown = browse(_page_of(viewer.html(), _viewer().html(), drive, head=head))
    result = json.loads(html.unescape(re.search(r'<pre id="result">(.*?)</pre>', shown).group(1)))
    assert (result["canvases"], result["stills"]) == (2, 0)
    assert result["label"] == viewer.alt
    names = ["● model", "■ estimate", "— boxes", "— x", "— y", "— z", "● model", "■ estimate"]
    assert result["buttons"] == [*names, "— x", "— y", "— z"]
    start = result["start"]
    assert start["points"] > 1000
    assert start["ink"] > 200  # the box, in the colour of the page's text
    assert result["drag"]["sum"] != start["sum"]
    assert result["idle"] == result["drag"]  # nothing is held any more
    assert result["back"] == result["again"] == start
    assert result["pinch"]["points"] > start["points"]
    assert result["key"]["sum"] != start["sum"]
    assert abs(result["unkey"]["points"] - start["points"]) < 0.01 * start["points"]
    assert result["hide"]["points"] < start["points"]
    assert result["dark"]["ink"] == 0
    assert result["dark"]["light"] > 200  # the box follows the page's theme


@pytest.mark.slow
def test_the_same_piece_twice_on_a_page_works_twice(browse):
    text = _viewer().html()
    shown = browse(_page_of(text, text))
    assert len(re.findall(r"<figure[^>]*><canvas", shown)) == 2


@pytest.mark.slow
def test_without_webgl_the_still_picture_stays(browse):
    forbid = (
        "<script>HTMLCanvasElement.prototype.getContext = function () { return null; }</script>"
    )
    shown = browse(_page_of(_viewer().html(), head=forbid))
    assert _parse(shown).tags.count("canvas") == 0
    assert _parse(shown).tags.count("img") == 1


@pytest.mark.slow
def test_where_scripts_are_forbidden_the_still_picture_stays(browse):
    forbid = '<meta http-equiv="Content-Security-Policy" content="script-src \'none\'">'
    shown = browse(_page_of(_viewer().html(), head=forbid))
    assert _parse(shown).tags.count("canvas") == 0
    assert _parse(shown).tags.count("img") == 1


MANNERS = """
var canvases = document.querySelectorAll('canvas'), one = canvases[0], two = canvases[1];
var frames = 0, result = {}, real = requestAnimationFrame;
function seen(canvas) {
  var gl = canvas.getContext('webgl'), data = new Uint8Array(canvas.width * canvas.height * 4);
  gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, data);
  for (var i = 3, sum = 0; i < data.length; i += 4) if (data[i]) sum = (sum * 31 + i) % 1000003;
  return sum;
}
function wheel(more) {
  var event = Object.assign({deltaY: 100, bubbles: true, cancelable: true}, more);
  return one.dispatchEvent(new WheelEvent('wheel', event));  // false: kept from the page
}
function key(name, more) {
  var event = Object.assign({key: name, bubbles: true, cancelable: true}, more);
  return one.dispatchEvent(new KeyboardEvent('keydown', event));
}
function signs() {
  return Array.from(document.querySelectorAll('figure')[0].querySelectorAll('span'))
    .filter(function (s) { return s.style.left && s.style.display !== 'none'; })
    .map(function (s) { return [s.textContent, parseFloat(s.style.left), parseFloat(s.style.top)];
  });
}
var steps = [
  ['start', function () { return [one.style.touchAction, one.tabIndex, one.clientWidth,
    one.clientHeight]; }],
  ['letters', signs],
  ['focused wheel', function () { one.focus(); return wheel({}); }],
  ['ctrl wheel', function () { return wheel({ctrlKey: true}); }],
  ['lines wheel', function () { return wheel({metaKey: true, deltaY: 3, deltaMode: 1}); }],
  ['key 0', function () { return key('0'); }],
  ['key =', function () { return key('='); }],
  ['key Home', function () { return key('Home'); }],
  ['ctrl +', function () { return key('+', {ctrlKey: true}); }],
  ['key q', function () { return key('q'); }],
  ['hide x', function () {
    Array.from(document.querySelectorAll('figure')[0].querySelectorAll('button'))
      .filter(function (b) { return b.textContent === '\u2014 x'; })[0].click();
  }],
  ['without x', signs],
  ['theme', function () { frames = 0; document.body.setAttribute('data-a', '1'); }],
  ['drawn', function () { return frames; }],
  ['remove', function () { document.querySelectorAll('figure')[0].remove(); }],
  ['theme again', function () { frames = 0; document.body.setAttribute('data-a', '2'); }],
  ['drawn again', function () { return frames; }]
];
function next() {
  var step = steps.shift();
  if (!step) {
    document.getElementById('result').textContent = JSON.stringify(result);
    return;
  }
  var said = step[1]();
  setTimeout(function () {
    result[step[0]] = [said === undefined ? null : said, seen(one), seen(two)]; next();
  }, 60);
}
setTimeout(next, 60);
"""


@pytest.mark.slow
def test_it_leaves_the_page_its_scrolling_and_keys(browse):
    viewer = _viewer()
    count = "<script>requestAnimationFrame = function (f) { frames++; setTimeout(f, 0); };</script>"
    count += "<style>html { overflow-y: scroll }</style>"  # or the width changes at the end
    drive = f"<pre id='result'></pre><script>{MANNERS}</script>"
    shown = browse(_page_of(viewer.html(), _viewer().html(), drive, head=count))
    text = re.search(r'<pre id="result">(.*?)</pre>', shown).group(1)
    result = json.loads(html.unescape(text))
    (touch, tab, width, height), start, other = result["start"]
    assert (touch, tab) == ("pan-y", 0)
    assert all(second == other for _, _, second in result.values())  # the figures are strangers
    went, drawn, _ = result["focused wheel"]
    assert went and drawn == start  # the page scrolls, the figure stays
    for zoomed in ("ctrl wheel", "lines wheel", "key ="):
        went, drawn, _ = result[zoomed]
        assert not went and drawn != start
    assert result["ctrl wheel"][1] != result["lines wheel"][1]
    for back in ("key 0", "key Home"):
        assert result[back][:2] == [False, start]
    for left_alone in ("ctrl +", "key q"):
        assert result[left_alone][:2] == [True, start]
    # The letters stand at the tips of the axes, a little further out.
    payload = viewer.payload()
    middle = np.array(payload["low"]) + 32767.5 * viewer.resolution
    letters = {letter: (x, y) for letter, x, y in result["letters"][0]}
    assert sorted(letters) == ["x", "y", "z"]
    for part in payload["parts"][-3:]:
        foot, tip = (_positions(part, payload) - middle) / (32767.5 * viewer.resolution)
        right, up, near = directions(AZIMUTH, ELEVATION, "z") @ (tip + 0.12 * (tip - foot))
        away = 0.95 * payload["radius"] * np.hypot(1, 2.2) - near
        focal = 2.2 * min(1, width / height)
        due = 50 + 50 * focal * right / away * height / width, 50 - 50 * focal * up / away
        assert letters[part["label"]] == pytest.approx(due, abs=0.1)
    assert [letter for letter, *_ in result["without x"][0]] == ["y", "z"]
    # A figure that a notebook has thrown away draws no more, and nothing holds it.
    assert result["drawn"][0] == 2
    assert result["drawn again"][0] == 1


CENTROIDS = """
var result = Array.from(document.querySelectorAll('canvas'), function (canvas) {
  var gl = canvas.getContext('webgl'), w = canvas.width, h = canvas.height, n = 0, x = 0, y = 0;
  var data = new Uint8Array(w * h * 4);
  gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, data);
  for (var i = 0; i < w * h; i++) if (data[4 * i] > 250 && data[4 * i + 1] < 5) {
    n++; x += i % w + 0.5; y += Math.floor(i / w) + 0.5;
  }
  gl.getExtension('WEBGL_lose_context').loseContext();
  return [w, h, n, x / n, y / n];
});
setTimeout(function () {
  document.getElementById('result').textContent = JSON.stringify(result);
}, 500);
"""


@pytest.mark.slow
def test_a_browser_sees_it_from_the_same_side_as_the_still(browse):
    rng = np.random.default_rng(1)
    clouds = {"others": rng.uniform(-0.1, 0.1, (20, 3)), "one": [[0.14, -0.14, 0.14]]}
    colours = {"others": "blue", "one": "#ff0000"}
    viewers = [figures.Viewer(clouds, colours=colours, up=up) for up in ("z", "-y")]
    script = f"<pre id='result'></pre><script>{CENTROIDS}</script>"
    shown = browse(_page_of(*(viewer.html() for viewer in viewers), script))
    result = json.loads(re.search(r'<pre id="result">(.*?)</pre>', shown).group(1))
    for viewer, (width, height, count, x, y) in zip(viewers, result, strict=True):
        payload = viewer.payload()
        middle = np.array(payload["low"]) + 32767.5 * viewer.resolution
        point = (np.array(clouds["one"][0]) - middle) / (32767.5 * viewer.resolution)
        right, up, near = directions(AZIMUTH, ELEVATION, payload["up"]) @ point
        focal = 2.2
        away = 0.95 * payload["radius"] * np.hypot(1, focal) - near
        assert count > 20
        # Pixels of a round point are as many on either side: the middle is good to half a pixel.
        assert x == pytest.approx(width / 2 + height / 2 * focal * right / away, abs=0.5)
        assert y == pytest.approx(height / 2 * (1 + focal * up / away), abs=0.5)
    # The script then took the canvases away from the browser: the pictures came back.
    assert _parse(shown).tags.count("canvas") == 0
    assert _parse(shown).tags.count("img") == 2
