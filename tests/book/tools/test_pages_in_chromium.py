"""The site as a reader sees it: pages opened as files in Chromium without a window."""

import base64
import contextlib
import functools
import http.server
import io
import itertools
import json
import re
import shutil
import subprocess
import threading
import time

import numpy as np
import pytest
import websocket
from PIL import Image

pytestmark = pytest.mark.slow

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
PHONE, DESK = (390, 844), (1280, 900)


class Browser:
    """One tab, spoken to in Chrome's DevTools protocol."""

    def __init__(self, folder):
        options = (
            *("--headless", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"),
            *("--enable-unsafe-swiftshader", "--disable-background-networking"),
            *("--remote-debugging-port=0", f"--user-data-dir={folder}", "about:blank"),
        )
        self.process = subprocess.Popen(
            [CHROMIUM, *options], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        self.socket = self.session = None
        self.numbers = itertools.count(1)
        self.errors, self.requests = [], []
        try:
            self._connect(folder / "DevToolsActivePort")
        except BaseException:
            self.close()
            raise

    def _connect(self, door):
        # Made empty first, then filled.
        port, path = _wait(lambda: (door.exists() and door.read_text().split()) or None)
        address = f"ws://127.0.0.1:{port}{path}"
        self.socket = websocket.create_connection(address, suppress_origin=True, timeout=60)
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        attached = self.send("Target.attachToTarget", targetId=target, flatten=True)
        self.session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.send(f"{domain}.enable")

    def send(self, method, **parameters):
        number = next(self.numbers)
        message = {"id": number, "method": method, "params": parameters}
        if self.session:
            message["sessionId"] = self.session
        self.socket.send(json.dumps(message))
        while True:
            answer = json.loads(self.socket.recv())
            if answer.get("id") == number:
                if "error" in answer:
                    raise LookupError(answer["error"])
                return answer["result"]
            self._note(answer.get("method"), answer.get("params", {}))

    def _note(self, event, what):
        if event == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(what["exceptionDetails"])[:400])
        elif event == "Runtime.consoleAPICalled" and what["type"] in ("error", "warning"):
            self.errors.append(json.dumps(what["args"])[:400])
        elif event == "Log.entryAdded" and what["entry"]["level"] in ("error", "warning"):
            self.errors.append(json.dumps(what["entry"])[:400])
        elif event == "Network.requestWillBeSent":
            self.requests.append(what["request"]["url"])

    def run(self, script):
        """The value of an expression in the page; a promise is waited for."""
        answer = self.send(
            "Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def open(self, address, size=DESK, dark=False, scripts=True):
        """Open a page and wait until it stands still: formulas set, fonts there."""
        self.run("window.isOld = true")
        self.errors, self.requests = [], []
        self.send("Emulation.setDeviceMetricsOverride", width=size[0], height=size[1],
                  deviceScaleFactor=1, mobile=size == PHONE)  # fmt: skip
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.send("Emulation.setEmulatedMedia", media="", features=[scheme])
        self.send("Emulation.setScriptExecutionDisabled", value=not scripts)
        self.send("Page.navigate", url=address)
        _wait(lambda: self.run("!window.isOld && document.readyState === 'complete'") or None)
        if scripts:
            self.run("window.MathJax ? MathJax.startup.promise.then(() => 1) : 1")
        self.run("document.fonts.ready.then(() => 1)")

    def close(self):
        if self.socket:
            with contextlib.suppress(Exception):
                self.session = None
                self.send("Browser.close")
            self.socket.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(10)
        self.process.kill()
        self.process.wait()


def _wait(ready, seconds=60):
    """The first answer that is one, and neither None nor an error of a page on its way."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        with contextlib.suppress(LookupError, ValueError):
            if (answer := ready()) is not None:
                return answer
        time.sleep(0.02)
    raise TimeoutError(f"nothing came in {seconds} s")


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    if CHROMIUM is None:
        pytest.skip("no chromium on PATH (Debian: apt-get install chromium)")
    browser = Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


def _names(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*.html"))


@pytest.fixture
def page(browser, small_site):
    """Opens a page of the small site."""

    def open_page(name, *arguments, **more):
        browser.open(f"{small_site.folder.as_uri()}/{name}", *arguments, **more)
        return browser

    return open_page


@pytest.mark.parametrize(("size", "dark"), [(PHONE, False), (DESK, True)])
def test_no_page_is_wider_than_the_window_or_has_errors_or_asks_the_network(
    browser, site, size, dark
):
    for name in _names(site.folder):
        browser.open(f"{site.folder.as_uri()}/{name}", size, dark)
        assert browser.run("document.documentElement.scrollWidth <= innerWidth"), name
        wide = browser.run(TOO_WIDE)
        assert not wide, (name, wide)
        assert not browser.errors, (name, browser.errors)
        foreign = [url for url in browser.requests if not url.startswith(("file:", "data:"))]
        assert not foreign, (name, foreign)
        assert not browser.run("document.querySelectorAll('mjx-merror').length"), name


# Elements of the article that reach over its right edge, and cannot be scrolled to.
TOO_WIDE = """
Array.from(document.querySelectorAll('article *')).filter(function (element) {
  if (element.getBoundingClientRect().right <= innerWidth + 1) return false;
  if (element.closest('.visually-hidden, mjx-assistive-mml')) return false;
  for (var box = element; box.tagName !== 'ARTICLE'; box = box.parentElement)
    if (['auto', 'scroll', 'hidden'].includes(getComputedStyle(box).overflowX)) return false;
  return true;
}).map(function (element) { return element.outerHTML.slice(0, 200); })
"""


def test_formulas_are_set(page):
    browser = page("01_first.html")
    assert browser.run("document.querySelectorAll('article mjx-container').length") == 2
    assert not browser.run("document.querySelector('article').innerText.includes('\\\\mathbf')")
    width = "document.querySelector('mjx-container[display=true] mjx-math').offsetWidth"
    assert browser.run(width) > 300
    loaded = "Array.from(document.fonts).filter(f => f.status === 'loaded').map(f => f.family)"
    assert "MJXTEX-I" in " ".join(browser.run(loaded))


def _luminance(browser, script):
    """Of a CSS colour in the page, 0 to 255."""
    red, green, blue = (float(n) for n in re.findall(r"[\d.]+", browser.run(script))[:3])
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def _picture(browser, selector):
    """The pixels of an element as they are on the screen."""
    browser.run(f"document.querySelector({selector!r}).scrollIntoView({{block: 'center'}})")
    browser.run("new Promise(f => requestAnimationFrame(() => requestAnimationFrame(f)))")
    box = browser.run(f"""(function () {{
        var r = document.querySelector({selector!r}).getBoundingClientRect();
        return {{x: r.x + scrollX, y: r.y + scrollY, width: r.width, height: r.height, scale: 1}};
    }})()""")
    shot = browser.send("Page.captureScreenshot", format="png", clip=box)["data"]
    with Image.open(io.BytesIO(base64.b64decode(shot))) as image:
        return np.asarray(image.convert("RGB"))


@pytest.mark.parametrize(("size", "dark"), [(PHONE, False), (DESK, True)])
def test_the_viewer_draws_in_the_colours_of_the_page(page, size, dark):
    browser = page("01_first.html", size, dark)
    assert browser.run("document.querySelectorAll('figure img').length") == 0
    pixels = _picture(browser, "figure canvas").astype(int)
    height, width = pixels.shape[:2]
    assert 300 < width <= size[0] and height > 200
    assert (pixels.max(-1) < 60 if dark else pixels.min(-1) > 230).mean() > 0.5  # the ground
    ink = pixels.min(-1) > 180 if dark else pixels.max(-1) < 80
    assert ink.sum() > 200  # the box, in the colour of the text
    blue = (pixels[..., 2] - pixels[..., 0] > 60).sum()
    orange = (pixels[..., 0] - pixels[..., 2] > 60).sum()
    assert min(blue, orange) > 300  # the clouds


def test_dark_and_light(page):
    ground = "getComputedStyle(document.body).backgroundColor"
    text = "getComputedStyle(document.querySelector('article p')).color"
    browser = page("01_first.html", dark=True)
    assert _luminance(browser, ground) < 40 and _luminance(browser, text) > 180
    picture = _picture(browser, "article .cell_output img")
    assert 150 < np.median(picture) < 235  # a figure's white ground does not glare
    for part in (".text_html td", ".text_html + *, .text_html"):
        colour = f"getComputedStyle(document.querySelector({part!r})).color"
        assert _luminance(browser, colour) > 150
    browser = page("exercises/exercises_01_first.html", dark=True)
    answer = "getComputedStyle(document.querySelector('[role=status]'))"
    assert _luminance(browser, f"{answer}.color") > 150
    assert _luminance(browser, f"{answer}.backgroundColor") < 80
    browser = page("01_first.html")
    assert _luminance(browser, ground) > 240 and _luminance(browser, text) < 80
    assert np.median(_picture(browser, "article .cell_output img")) == 255
    browser.run("document.querySelector('.theme-change-button[data-mode=dark]').click()")
    assert _luminance(browser, ground) < 40
    assert _luminance(page("02_second.html"), ground) < 40  # the choice holds for all pages
    browser.run("localStorage.clear()")


def test_paper_is_white(page):
    browser = page("01_first.html", dark=True)
    theme = "document.documentElement.dataset.theme"
    assert browser.run(f"(dispatchEvent(new Event('beforeprint')), {theme})") == "light"
    browser.send("Emulation.setEmulatedMedia", media="print")
    assert browser.run("document.querySelector('#jb-print-docs-body h1').offsetHeight") > 10
    assert browser.run("document.querySelector('.prev-next-area').offsetHeight") == 0
    assert browser.run(f"(dispatchEvent(new Event('afterprint')), {theme})") == "dark"


def test_the_search_finds_a_word_in_pages_opened_as_files(page):
    browser = page("search.html?q=zymurgical")
    links = "Array.from(document.querySelectorAll('#search-results li a'), a => a.href)"
    (link,) = _wait(lambda: browser.run(links) or None)
    assert not browser.errors
    browser.open(link)
    assert "zymurgical" in browser.run("document.querySelector('article').innerText")


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *arguments):
        pass


def test_the_site_works_on_a_server_in_a_folder_of_it(browser, small_site):
    handler = functools.partial(_Quiet, directory=small_site.folder.parent)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        home = f"http://127.0.0.1:{server.server_port}/{small_site.folder.name}/"
        browser.open(f"{home}search.html?q=zymurgical")
        excerpt = "document.querySelector('#search-results li p.context')?.innerText"
        assert "zymurgical" in _wait(lambda: browser.run(excerpt))
        for name in ("01_first.html", "exercises/exercises_01_first.html"):
            browser.open(home + name)
            assert not browser.errors
            assert {url[: len(home)] for url in browser.requests if url[:5] != "data:"} == {home}
        browser.open("about:blank")
        server.shutdown()


def test_without_scripts_the_still_picture_stands_in(page):
    browser = page("01_first.html", PHONE, scripts=False)
    assert browser.run("document.querySelectorAll('canvas').length") == 0
    assert browser.run("document.querySelector('figure img').clientWidth") > 250
    assert browser.run("document.documentElement.scrollWidth <= innerWidth")
    assert "What it is good for" in browser.run("document.querySelector('article').innerText")


def test_code_can_be_copied_and_outputs_cannot(page):
    browser = page("01_first.html")
    inputs = browser.run("document.querySelectorAll('.cell_input pre').length")
    shown = browser.run("document.querySelectorAll('.cell_output .highlight-python pre').length")
    assert browser.run("document.querySelectorAll('button.copybtn').length") == inputs + shown


def test_wide_things_scroll_in_their_own_box(page):
    browser = page("01_first.html", PHONE)
    for part in (".cell_input pre", "article mjx-container[display=true]", ".output.stream pre"):
        wider = f"""Array.from(document.querySelectorAll({part!r})).some(function (box) {{
            return box.scrollWidth > box.clientWidth + 5 &&
                ['auto', 'scroll'].includes(getComputedStyle(box).overflowX); }})"""
        assert browser.run(wider), part


FIGURE = "document.querySelectorAll('.figure-frame')[0]"


def test_a_figure_that_a_phone_shrinks_grows_at_a_tap(page):
    browser = page("02_second.html", PHONE)
    width = f"{FIGURE}.querySelector('img').clientWidth"
    natural = browser.run(f"{FIGURE}.querySelector('img').naturalWidth")
    assert browser.run(width) < natural / 2
    button = f"{FIGURE}.querySelector('button')"
    assert browser.run(f"{button}.innerText") == "Enlarge"
    assert browser.run(f"{button}.getAttribute('aria-expanded')") == "false"
    for tapped in ("img", "button"):
        browser.run(f"{FIGURE}.querySelector({tapped!r}).click()")
        assert browser.run(width) == natural
        assert browser.run(f"{button}.getAttribute('aria-expanded')") == "true"
        view = f"{FIGURE}.querySelector('.figure-view')"
        assert browser.run(f"{view}.scrollWidth > {view}.clientWidth && {view}.tabIndex === 0")
        assert browser.run("document.documentElement.scrollWidth <= innerWidth")
        browser.run(f"{button}.click()")
        assert browser.run(width) < natural / 2
    assert browser.run(f"{FIGURE}.querySelector('img').alt") == "four pictures in a row"


def test_a_figure_that_is_whole_has_no_button(page):
    browser = page("01_first.html", (1800, 900))
    shown = "Array.from(document.querySelectorAll('.figure-size')).filter(b => b.offsetHeight)"
    shrunk = """Array.from(document.querySelectorAll('.figure-frame img')).filter(
        i => i.clientWidth < 0.85 * i.naturalWidth)"""
    assert browser.run(f"{shown}.length") == browser.run(f"{shrunk}.length") < 2


def test_what_scrolls_is_reached_by_keyboard(page):
    browser = page("01_first.html", PHONE)
    boxes = """Array.from(document.querySelectorAll('article *')).filter(function (box) {
        return box.scrollWidth > box.clientWidth + 1 && box.clientWidth > 0 &&
            ['auto', 'scroll'].includes(getComputedStyle(box).overflowX) &&
            !box.closest('mjx-assistive-mml'); })"""
    assert _wait(lambda: browser.run(f"{boxes}.length") >= 3 or None)
    unreached = f"{boxes}.filter(b => b.tabIndex < 0).map(b => b.outerHTML.slice(0, 200))"
    assert not browser.run(unreached)
    claims = "document.querySelector('[role=region][aria-label=Claims]')"
    browser.run(f"{claims}.focus()")
    assert browser.run(f"document.activeElement === {claims}")
