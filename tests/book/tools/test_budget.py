"""How long a page is: what counts, what does not, and what is said of it."""

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output

from book.tools import budget as module
from book.tools.budget import budget, count_words, lines_of_code
from book.tools.contents import Page, pages

PAGE = Page("01_a")
LONG = "\n".join(["# a remark", "", *(f"x{n} = {n}" for n in range(16))])


@pytest.fixture
def written(tmp_path):
    def write(*cells):
        nbformat.write(new_notebook(cells=list(cells)), tmp_path / "01_a.ipynb")
        return budget(PAGE, tmp_path)

    return write


def picture(kind="image/png"):
    return new_output("display_data", data={kind: "aGVsbG8="})


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("", 0),
        ("# One, two\n- three (four)", 4),
        ("The network's answer isn’t half-way right: 3.5 of 7.", 7),
        ("Of $x_i$ and\n$$\na = b\n$$\nnothing", 3),
        ("It costs $5 a head\nand saves $10", 6),
        ("[the page](01_a.ipynb#not-words) and ![a picture](figure_of_it.png)", 5),
        ("<details><summary>Why not?</summary>\n\nSo.\n\n</details>", 3),
        ("a < b and c > d", 5),
        ("Read\n```python\nimport nothing\n```\non: `code` counts", 4),
        ("Überall größer", 2),
    ],
)
def test_words(text, count):
    assert count_words(text) == count


@pytest.mark.parametrize(
    ("source", "count"),
    [
        ("", 0),
        ("x = 1\n\n# a remark\ny = 2", 2),
        ('def f():\n    """What.\n\n    More.\n    """\n    return 1', 2),
        ("x = (", 0),
    ],
)
def test_lines_of_code(source, count):
    assert lines_of_code(source) == count


def test_a_page_within_its_budget(written):
    line = written(
        new_markdown_cell("# One page"),
        new_code_cell("x = 1\ny = 2", outputs=[picture(), picture("image/svg+xml")]),
        new_code_cell("z", outputs=[picture("text/html")]),
    )
    assert line.startswith("01_a: words 2 of 7000, cells 3 of 150, a cell 2 of 15 lines, size 0")
    assert line.endswith(" of 1.5 MB, 2 figures")


def test_figures_within_html_count(written):
    html = "<figure id='a'></figure><p><img src='data:'></p><figcaption>no</figcaption>"
    line = written(
        new_code_cell("z", outputs=[new_output("display_data", data={"text/html": html})])
    )
    assert ", 2 figures" in line


def test_what_is_over_is_said(written, monkeypatch):
    monkeypatch.setattr(module, "MOST_WORDS", 3)
    monkeypatch.setattr(module, "MOST_CELLS", 2)
    words, code = new_markdown_cell("one two three"), new_code_cell("x")
    assert "over" not in written(words, code)
    assert written(words, new_markdown_cell("four")).endswith("; over: words")
    assert written(words, code, new_code_cell(LONG)).endswith("; over: cells, a cell")
    monkeypatch.setattr(module, "LARGEST_NOTEBOOK", 10)
    assert written(words).endswith("; over: size")


@pytest.mark.parametrize("first", ["", "two words\n\n"])
def test_an_appendix_is_told_apart(written, first):
    """It may begin within a cell, and what has the word elsewhere is none."""
    line = written(
        new_markdown_cell("The Appendix\n\nsays more"),
        new_markdown_cell(f"{first}## Appendix: reading closely"),
        new_code_cell("x"),
        new_markdown_cell("and more"),
    )
    words, cells = (6, 2) if first else (4, 1)
    assert line.startswith(f"01_a: words {words} of 7000, cells {cells} of 150, ")
    assert line.endswith(", appendix 5 words")


def test_a_notebook_that_cannot_be_read_is_left_to_the_checks(tmp_path):
    assert budget(PAGE, tmp_path) == ""
    (tmp_path / "01_a.ipynb").write_text("half a")
    assert budget(PAGE, tmp_path) == ""


def test_every_page_of_the_book_has_its_line():
    for page in pages():
        line = budget(page)
        assert line.startswith(f"{page.name}: words ") and "\n" not in line
