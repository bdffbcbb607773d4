import re

import pytest

from book.tools.contents import BOOK, ROOT, Page, find_page, notebooks, notebooks_of, pages

TABLE = """
[[page]]
name = "index"

[[page]]
name = "01_a"
exercises = true

[[page]]
name = "10_b"
"""


@pytest.fixture
def book(tmp_path):
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "contents.toml").write_text(TABLE)
    return tmp_path


def test_pages_come_in_their_order(book):
    assert pages(book) == (Page("index"), Page("01_a", True), Page("10_b"))


@pytest.mark.parametrize(
    "name, page",
    [("index", "index"), ("01_a", "01_a"), ("01", "01_a"), ("1", "01_a"), ("10", "10_b")],
)
def test_a_page_has_a_name_and_a_number(name, page, book):
    assert find_page(name, book).name == page


@pytest.mark.parametrize("name", ["", "2", "a", "01_", "1_a", "index.py", "001"])
def test_other_pages_are_refused_with_those_there_are(name, book):
    with pytest.raises(
        ValueError, match=r"page: expected one of index, 01_a, 10_b \(site/contents.toml\), got"
    ):
        find_page(name, book)


@pytest.mark.parametrize(
    "text, message",
    [
        ("[[page]\n", "TOMLDecodeError"),
        ("", "KeyError('page')"),
        ('[[page]]\ntitle = "x"\n', "unexpected keyword argument 'title'"),
        ("[[page]]\nexercises = true\n", "missing 1 required positional argument: 'name'"),
        ('[[page]]\nname = "2_b"\n', "name: expected index or NN_name in small letters, each once"),
        ('[[page]]\nname = "02_b c"\n', "got '02_b c'"),
        ('[[page]]\nname = "index"\n' * 2, "got 'index'"),
        ("[[page]]\nname = 2\n", "expected string"),
    ],
)
def test_a_table_that_is_none_is_told_of(text, message, book):
    (book / "site" / "contents.toml").write_text(text)
    with pytest.raises(ValueError, match=r"contents\.toml: no table of contents: ") as caught:
        pages(book)
    assert message in str(caught.value)


def test_exercises_and_solutions_are_notebooks_too(book):
    names = [path.relative_to(book).as_posix() for path in notebooks(book)]
    assert names == [
        *("index.ipynb", "01_a.ipynb"),
        *("solutions/solutions_01_a.ipynb", "exercises/exercises_01_a.ipynb"),
        "10_b.ipynb",
    ]
    assert notebooks_of(Page("10_b"), book) == (book / "10_b.ipynb",)


def test_names_differ_from_their_beginning_on(book):
    """JupyterLab's tabs show so much of a file's name, and no folder."""
    for page in pages():
        if page.exercises:
            names = [path.name[:12] for path in notebooks_of(page)]
            assert len({*names, f"my_{page.name}"[:12]}) == 4


def test_what_belongs_to_a_page_is_a_package(book):
    assert [page.package for page in pages(book)] == ["ch00_index", "ch01_a", "ch10_b"]
    assert all(package.isidentifier() for package in (page.package for page in pages()))
    there = {path.name for path in BOOK.glob("ch[0-9][0-9]_*")}
    assert there <= {page.package for page in pages()}


def test_the_real_book_lies_in_the_project():
    assert BOOK.parent == ROOT and (ROOT / "pyproject.toml").is_file()
    assert pages()[0].name == "index"
    assert len({page.name for page in pages()}) == len(pages())


def test_the_readme_leads_to_every_page_and_to_nothing_that_is_not_there():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    links = {link for link in re.findall(r"\]\(([^)]+)\)", text) if "://" not in link}
    assert links >= {f"book/{page.name}.ipynb" for page in pages()}
    assert not [link for link in links if not (ROOT / link).is_file()]
