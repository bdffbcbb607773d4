"""The site: whole, without loads from elsewhere, every link and picture in its place."""

import base64
import json
import os
import re
import shutil
import subprocess
import sys
import time
from functools import lru_cache
from urllib.parse import unquote, urlsplit

import nbformat
import pytest
from bs4 import BeautifulSoup
from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output

from book.tools import site as making
from book.tools.contents import pages
from posecore.figures import Picture

pytestmark = pytest.mark.slow  # builds with Sphinx

ORDER = [
    "01_first",
    "exercises/exercises_01_first",
    "02_second",
    "solutions/solutions_01_first",
    "references",
]
LOADED = {
    "src": ("script", "img", "iframe", "embed", "source", "video", "audio", "track", "input"),
    "href": ("link", "image", "use", "base"),
    "data": ("object",),
    "poster": ("video",),
    "srcset": ("img", "source"),
    "imagesrcset": ("link",),
}
NOT_LOADED = {"next", "prev", "search", "index"}  # what a <link> may say of other pages


@lru_cache
def _pages(folder):
    """Path -> parsed page."""
    found = {
        path.relative_to(folder).as_posix(): BeautifulSoup(path.read_text("utf-8"), "html.parser")
        for path in sorted(folder.rglob("*.html"))
    }
    assert found
    return found


@pytest.fixture(scope="module")
def small(small_site):
    return _pages(small_site.folder)


def _loads(soup):
    """Every address that a browser fetches by itself to show a page."""
    for attribute, tags in LOADED.items():
        for tag in soup.find_all(tags, attrs={attribute: True}):
            if NOT_LOADED & set(tag.get("rel", ())):
                continue
            value = tag[attribute]
            if "srcset" in attribute:
                yield from (part.split()[0] for part in value.split(","))
            else:
                yield value
    for tag in soup.find_all(style=True):
        yield from _css_loads(tag["style"])
    for tag in soup.find_all("style"):
        yield from _css_loads(tag.get_text())


def _css_loads(text):
    text = re.sub(r"/\*.*?\*/", "", text, flags=re.S)
    yield from re.findall(r"@import\s+[\"']([^\"']+)", text)
    for quoted, bare in re.findall(r"url\(\s*(?:[\"'](.*?)[\"']|([^\"')]*))\s*\)", text):
        yield quoted or bare


def _foreign(addresses, place):
    """Those that are neither in the page nor a file beside it."""
    for address in addresses:
        parts = urlsplit(address)
        if parts.scheme == "data" or (address.startswith("#") and len(address) > 1):
            continue
        if parts.scheme or parts.netloc or not (place / unquote(parts.path)).is_file():
            yield address


@pytest.mark.parametrize(
    "text",
    [
        '<script src="https://cdn.example.org/x.js"></script>',
        '<script src="//cdn.example.org/x.js"></script>',
        '<link rel="stylesheet" href="http://example.org/x.css">',
        '<img src="/there.png">',
        '<img src="not_there.png">',
        '<img srcset="there.png 1x, https://example.org/b.png 2x">',
        '<iframe src="https://example.org"></iframe>',
        '<p style="background: url(https://example.org/b.png)">',
        '<style>@import "https://example.org/x.css";</style>',
        '<style>@font-face { src: url("https://example.org/f.woff") }</style>',
        '<object data="https://example.org"></object>',
        '<base href="https://example.org/">',
    ],
)
def test_a_load_from_elsewhere_would_be_seen(text, tmp_path):
    (tmp_path / "there.png").write_bytes(b"")
    assert list(_foreign(_loads(BeautifulSoup(text, "html.parser")), tmp_path))


def test_what_is_no_load_from_elsewhere(tmp_path):
    (tmp_path / "there.png").write_bytes(b"")
    text = (
        '<a href="https://example.org">x</a><img src="there.png?v=1"><img src="data:image/png;x">'
        "<style>/* url(https://example.org) */ p { background: url(there.png) }</style>"
    )
    assert not list(_foreign(_loads(BeautifulSoup(text, "html.parser")), tmp_path))


def test_nothing_loads_from_elsewhere(site):
    for name, soup in _pages(site.folder).items():
        assert not list(_foreign(_loads(soup), (site.folder / name).parent)), name
    sheets = list(site.folder.rglob("*.css"))
    assert len(sheets) > 3
    for sheet in sheets:
        assert not list(_foreign(_css_loads(sheet.read_text("utf-8")), sheet.parent)), sheet


def test_every_link_arrives(site):
    everything = _pages(site.folder)
    ids = {name: {tag["id"] for tag in soup.find_all(id=True)} for name, soup in everything.items()}
    for name, soup in everything.items():
        links = [tag["href"] for tag in soup.find_all("a", href=True)]
        assert links
        for link in links:
            parts = urlsplit(link)
            if parts.scheme:
                assert parts.scheme in ("http", "https"), (name, link)
                continue
            assert not parts.netloc and not parts.path.startswith("/"), (name, link)
            here = (site.folder / name).parent
            target = here / unquote(parts.path) if parts.path else site.folder / name
            assert target.is_file(), (name, link)
            if parts.fragment:
                page = target.resolve().relative_to(site.folder).as_posix()
                assert unquote(parts.fragment) in ids[page], (name, link)


def test_every_picture_says_what_it_shows(site):
    for name, soup in _pages(site.folder).items():
        for image in soup.find_all("img"):
            assert image.get("alt", "").strip(), (name, str(image)[:200])


def test_every_page_has_its_head(site):
    titles, descriptions = set(), set()
    for name, soup in _pages(site.folder).items():
        assert soup.html["lang"] == "en"
        assert soup.find("meta", attrs={"name": "viewport"}), name
        assert soup.find("link", rel="icon")["href"].endswith("favicon.svg")
        titles.add(soup.title.get_text())
        assert len(soup.find(id="main-content").select("article h1, #search-results h1")) <= 1, name
        if name.removesuffix(".html") + ".ipynb" in _notebooks(site.book):
            (found,) = soup.find_all("meta", attrs={"name": "description"})
            descriptions.add(found["content"])
            assert 10 < len(found["content"]) <= 200
            assert len(soup.select("article h1")) == 1
    assert len(titles) == len(_pages(site.folder))
    assert len(descriptions) >= len(pages(site.book))


def _notebooks(book):
    return making._Stage(book, book).names()


def test_previous_and_next_go_through_the_book(site):
    everything = _pages(site.folder)
    path, read = "index.html", []
    while link := everything[path].find("a", class_="right-next"):
        before, path = path, os.path.normpath(os.path.join(os.path.dirname(path), link["href"]))
        back = everything[path].find("a", class_="left-prev")["href"]
        assert os.path.normpath(os.path.join(os.path.dirname(path), back)) == before
        read.append(path.removesuffix(".html"))
    names = [name.removesuffix(".ipynb") for name in _notebooks(site.book)]
    assert sorted(read) == sorted([*names[1:], "references"])
    assert [name for name in read if "/" not in name] == [
        *(page.name for page in pages(site.book) if page.name != "index"),
        "references",
    ]
    for name in read:
        if name.startswith("exercises/"):
            assert read[read.index(name) - 1] == name.removeprefix("exercises/exercises_")


def test_the_order_of_the_small_book(small):
    links = [a["href"] for a in small["index.html"].select("nav.bd-links a.internal")]
    assert [link.removesuffix(".html") for link in links] == ORDER


def test_the_search_knows_every_page(site):
    text = (site.folder / "searchindex.js").read_text("utf-8")
    index = json.loads(text.removeprefix("Search.setIndex(").removesuffix(")"))
    names = [name.removesuffix(".ipynb") for name in _notebooks(site.book)]
    assert sorted(index["docnames"]) == sorted([*names, "references"])
    assert len(index["terms"]) > 50


def test_the_search_finds_a_word(small_site):
    text = (small_site.folder / "searchindex.js").read_text("utf-8")
    index = json.loads(text.removeprefix("Search.setIndex(").removesuffix(")"))
    assert index["docnames"][index["terms"]["zymurg"]] == "index"


def test_mathjax_comes_along_and_is_asked_for_where_there_are_formulas(small_site, small):
    home = small_site.folder / "_static" / "mathjax"
    assert (home / "tex-mml-chtml.js").stat().st_size > 1e6
    assert len(list((home / "output/chtml/fonts/woff-v2").glob("*.woff"))) > 20
    assert (home / "input/tex/extensions/boldsymbol.js").is_file()
    asked = {n for n, soup in small.items() if soup.find("script", src=re.compile("mathjax"))}
    assert asked == {"01_first.html"}


def test_the_download_is_the_notebook_itself(site):
    for name in _notebooks(site.book):
        original = (site.book / name).read_bytes()
        assert (site.folder / "_sources" / name).read_bytes() == original
    soup = _pages(site.folder)[name.replace(".ipynb", ".html")]
    assert soup.find("a", href=re.compile(r"_sources/.*\.ipynb$"))


def test_a_site_is_not_large(small_site):
    files = [path for path in small_site.folder.rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) < 6e6
    assert not [path for path in files if path.suffix in (".map", ".mo", ".pickle", ".doctree")]


def test_alt_texts_arrive_as_they_were_written(small):
    from_notebook = [image["alt"] for image in small["01_first.html"].select("article img")]
    assert from_notebook == [
        "accuracy of two methods over the threshold",
        "four pictures [of] *noise* & <more>, 100 % \\",
        "two spheres of points, a box around the first",
    ]


@pytest.fixture
def stage(tmp_path):
    stage = making._Stage.__new__(making._Stage)
    stage.source = tmp_path
    (tmp_path / "pictures").mkdir()
    return stage


@pytest.mark.parametrize("kind, suffix", [("image/png", ".png"), ("image/jpeg", ".jpeg")])
def test_stored_pictures_become_files_with_their_alt_text(kind, suffix, stage):
    data = {kind: base64.b64encode(b"content").decode(), "text/plain": "words"}
    output = new_output("display_data", data, metadata={kind: {"alt": "some words"}})
    (shown,) = stage._outputs([output])
    (file,) = (stage.source / "pictures").iterdir()
    assert file.suffix == suffix and file.read_bytes() == b"content"
    assert shown.data == {"text/markdown": f"![some words](/pictures/{file.name})"}


@pytest.mark.parametrize("kind, suffix", [("image/png", ".png"), ("image/jpeg", ".jpeg")])
def test_figures_become_files_with_their_alt_text(kind, suffix, stage):
    figure = Picture(figsize=(1, 1))
    figure.alt, figure.stored = 'a "word" & <b>', lambda: (kind, b"content")
    (shown,) = stage._outputs([new_output("display_data", figure._repr_mimebundle_()[0])])
    (file,) = (stage.source / "pictures").iterdir()
    assert file.suffix == suffix and file.read_bytes() == b"content"
    words = r"a \"word\" \& \<b\>"
    assert shown.data == {"text/markdown": f"![{words}](/pictures/{file.name})"}


def test_html_that_is_more_than_a_figure_stays_as_it_is(stage):
    data = {"text/html": '<p><img alt="x" src="data:image/png;base64,AAAA"></p>'}
    output = new_output("display_data", data)
    assert list(stage._outputs([output])) == [output]


MARKDOWN = MarkdownIt()
WORDS = st.text(st.characters(codec="utf-8", exclude_categories=("Cc", "Cs")), min_size=1)


@given(WORDS.filter(str.strip))
def test_any_alt_text_survives_markdown(text):
    page = MARKDOWN.render(f"![{making._escape(text)}](x.png)")
    image = BeautifulSoup(page, "html.parser").find("img")
    assert image["alt"] == " ".join(text.split())


def test_citations_have_footnotes_in_their_order(small):
    article = small["01_first.html"].find("article")
    footnotes = [tag.get_text(" ", strip=True) for tag in article.select("aside.footnote")]
    assert [re.search("Umeyama|Besl|own", text)[0] for text in footnotes] == [
        *("Umeyama", "Besl", "own"),
    ]
    paragraph = article.find("p").get_text()
    assert "Umeyama, 1991[1])" in paragraph  # the link's own words, then the footnote's number
    assert article.find("a", string="Umeyama, 1991")["href"] == "https://doi.org/10.1109/34.88573"
    assert "footcite" not in article.get_text() and "{" not in paragraph
    assert "[no link](https://doi.org/10.1/none)" in [c.get_text() for c in article("code")]


def test_the_bibliography_is_whole(small):
    entries = [tag.get_text() for tag in small["references.html"].select("article li")]
    assert len(entries) >= 19
    for words in ("6DoF pose estimation", "Umeyama", "McKay", "EPnP", "RANSAC|consensus"):
        assert [entry for entry in entries if re.search(words, entry)], words
    assert "Tomáš Hodaň" in " ".join(entries)


def test_every_work_has_an_address_of_its_own():
    works = making._works()
    text = (making.CONFIGURATION / "references.bib").read_text("utf-8")
    assert len(works) == len(re.findall(r"^  (?:doi|url) = ", text, re.M)) > 15
    assert all(making._address(address) == address for address in works)


def test_links_between_pages_and_to_files(small):
    article = small["01_first.html"].find("article")
    to = {a.get_text(strip=True): a["href"] for a in article.select("p a")}
    assert to["goes on"] == "02_second.html"
    assert to["a heading in it"] == "02_second.html#a-heading-with-capitals"
    assert to["one here"] == "#a-formula"
    assert re.fullmatch(r"_downloads/\w+/drawing\.py", to["code of their own"])
    assert re.fullmatch(r"_downloads/\w+/metrics\.py", to["the library"])


def test_exercises_and_solutions_say_what_they_are(small):
    exercises, solutions = (small[f"{part}/{part}_01_first.html"] for part in making.PARTS)
    assert exercises.find("h1").get_text().startswith("Exercises: poses")
    assert solutions.find("h1").get_text().startswith("Solutions: poses")
    assert "python book/make.py start 01" in exercises.find(class_="admonition").get_text()
    assert solutions.select_one(".admonition a")["href"] == "../exercises/exercises_01_first.html"


def test_outputs_are_there_and_widgets_are_not(small):
    article = small["01_first.html"].find("article")
    text = article.get_text()
    assert "IntSlider" not in text and not article.find("script", type=re.compile("widget"))
    assert article.find("figure", id=re.compile("^viewer-")).find("img")
    assert "6D beats quaternions <by far>" in article.find("td", string=re.compile("6D")).string
    assert article.select_one("div.highlight-python pre").get_text().startswith("@array_function")
    states = small["exercises/exercises_01_first.html"].find_all(attrs={"role": "status"})
    assert [state.get_text()[0] for state in states] == ["✓", "…", "✗"]
    assert "0, not <1>" in states[2].get_text()


def _files(folder):
    return {
        p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()
    }


@pytest.fixture
def copy(small_site, tmp_path):
    """The small book and its site, to be spoilt."""
    book = tmp_path / "project" / "book"
    shutil.copytree(small_site.book.parent, book.parent)
    shutil.copytree(small_site.folder, tmp_path / "html")
    return book, tmp_path / "html"


def _change(book, name, cell):
    notebook = new_notebook(cells=[new_markdown_cell("# Title\n\nSome words."), cell])
    nbformat.write(notebook, book / name)


def test_the_same_book_gives_the_same_site_in_place_of_the_old(copy):
    book, output = copy
    before = _files(output)
    (output / "of_an_older_site.html").write_text("old")
    assert making.build(output, book) == output
    assert _files(output) == before
    assert sorted(path.name for path in output.parent.iterdir()) == ["html", "project"]


def _picture(alt):
    return new_code_cell(
        "x",
        execution_count=1,
        outputs=[new_output("display_data", {"image/png": "AAAA"}, metadata={"image/png": alt})],
    )


SECOND = "02_second.ipynb"


def _spoil_contents(book):
    (book / "02_second.ipynb").unlink()


def _spoil_notebook(book):
    (book / "02_second.ipynb").write_text('{"cells": [')


def _spoil_citation(book):
    _change(book, "02_second.ipynb", new_markdown_cell("[A](https://arxiv.org/abs/0000.00000)"))


def _spoil_picture(book):
    _change(book, "02_second.ipynb", _picture({"alt": " "}))


def _spoil_title(book):
    _change(book, "solutions/solutions_01_first.ipynb", new_markdown_cell("x"))
    notebook = nbformat.read(book / "solutions/solutions_01_first.ipynb", 4)
    notebook.cells[0].source = "no title"
    nbformat.write(notebook, book / "solutions/solutions_01_first.ipynb")


def _spoil_words(book):
    cell = new_code_cell("x", execution_count=1)
    nbformat.write(new_notebook(cells=[new_markdown_cell("# Second"), cell]), book / SECOND)


def _spoil_links(book):
    text = "[gone](03_third.ipynb), [gone](01_first.ipynb#No-such-heading)"
    _change(book, "02_second.ipynb", new_markdown_cell(text))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (_spoil_contents, r"02_second\.ipynb"),
        (_spoil_notebook, r"02_second\.ipynb"),
        (_spoil_citation, r"02_second\.ipynb: cites https://arxiv\.org/abs/0000\.00000"),
        (_spoil_picture, r"02_second\.ipynb: cell 2: a picture without alt text"),
        (_spoil_title, r"solutions/solutions_01_first\.ipynb: expected a first cell with a title"),
        (_spoil_words, r"02_second\.ipynb: expected a paragraph of text"),
        (_spoil_links, r"(?s)Sphinx.*02_second\.ipynb, cell 2: .*03_third.*No-such-heading"),
    ],
)
def test_a_book_that_is_not_whole_is_refused_and_the_old_site_stays(copy, spoil, message):
    book, output = copy
    before = _files(output)
    spoil(book)
    with pytest.raises(ValueError, match=message):
        making.build(output, book)
    assert _files(output) == before
    assert sorted(path.name for path in output.parent.iterdir()) == ["html", "project"]


def test_a_folder_of_other_things_is_never_replaced(tmp_path, small_site):
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(ValueError, match=r"^output: expected a new or empty folder"):
        making.build(tmp_path, small_site.book)
    assert (tmp_path / "thesis.txt").read_text() == "years of work"


def test_the_old_site_stays_if_the_disk_is_full_at_the_last_moment(copy, monkeypatch):
    book, output = copy
    before, replace = _files(output), os.replace

    def sphinx(source, built):
        for folder in ("_static", *(f"_sources/{part}" for part in making.PARTS)):
            (built / folder).mkdir(parents=True)

    def full(source, target):
        if source.parent != output.parent and source.name == "html":
            raise OSError("no space left")
        replace(source, target)

    monkeypatch.setattr(making, "_run_sphinx", sphinx)
    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError, match="no space left"):
        making.build(output, book)
    assert _files(output) == before
    assert sorted(path.name for path in output.parent.iterdir()) == ["html", "project"]


def test_the_old_site_comes_back_if_the_new_one_cannot_take_its_place(tmp_path, monkeypatch):
    for name in ("built", "output"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "index.html").write_text(name)
    replace = os.replace

    def full(source, target):
        if source == tmp_path / "built":
            raise OSError("no space left")
        replace(source, target)

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError, match="no space left"):
        making._replace(tmp_path / "built", tmp_path / "output", tmp_path / "old")
    assert (tmp_path / "output" / "index.html").read_text() == "output"


def test_no_header_cell_of_a_table_is_empty(small, site):
    tables = 0
    for folder in (small, _pages(site.folder)):
        for name, page in folder.items():
            for table in page.find_all("table"):
                tables += 1
                empty = [th for th in table.find_all("th") if not th.get_text(strip=True)]
                assert not empty, (name, empty[0].parent)
                assert table.find("th"), name
    assert tables > 5


def test_killed_builds_leave_nothing_for_long(tmp_path, monkeypatch):
    """A build that goes on is known by its lock."""
    folders = {}
    for name, age in (("killed", 99), ("begun", 5), ("running", 99), ("old", 7200), ("new", 99)):
        folders[name] = folder = tmp_path / f".site-{name}"
        (folder / "html").mkdir(parents=True)
        if name in ("killed", "begun", "running"):
            (folder / "alive").touch()
        os.utime(folder, (time.time() - age,) * 2)
    (tmp_path / "html").mkdir()
    held = """
import sys, time
from pathlib import Path
from data_tools.storage.locks import byte_lock
with byte_lock(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""
    owner = subprocess.Popen(
        [sys.executable, "-c", held, folders["running"] / "alive"], stdout=subprocess.PIPE
    )
    try:
        owner.stdout.readline()
        making._forget_killed(tmp_path)
        assert {path.name for path in tmp_path.iterdir()} == {
            "html", ".site-begun", ".site-running", ".site-new",
        }  # fmt: skip
    finally:
        owner.kill()
        owner.communicate()
    making._forget_killed(tmp_path)
    assert not folders["running"].exists()


def test_a_build_takes_away_what_a_killed_one_left_and_tells_that_it_runs(copy, monkeypatch):
    book, output = copy
    left = output.parent / ".site-left"
    left.mkdir()
    os.utime(left, (0, 0))

    def sphinx(source, built):
        assert not left.exists()
        assert (built.parent / "alive").is_file()
        raise ValueError("enough")

    monkeypatch.setattr(making, "_run_sphinx", sphinx)
    with pytest.raises(ValueError, match="enough"):
        making.build(output, book)
    assert sorted(path.name for path in output.parent.iterdir()) == ["html", "project"]
