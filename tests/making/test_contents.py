import pytest

from book.making.contents import BOOK, ROOT, Page, find_page, notebooks, pages

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
    with pytest.raises(ValueError, match=r"page: expected one of index, 01_a, 10_b, got"):
        find_page(name, book)


def test_exercises_and_solutions_are_notebooks_too(book):
    names = [path.relative_to(book).as_posix() for path in notebooks(book)]
    assert names == ["index.py", "01_a.py", "solutions/01_a.py", "exercises/01_a.py", "10_b.py"]


def test_the_real_book_lies_in_the_project():
    assert BOOK.parent == ROOT and (ROOT / "pyproject.toml").is_file()
    assert pages()[0].name == "index"
    assert len({page.name for page in pages()}) == len(pages())
