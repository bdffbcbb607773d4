"""Sphinx's settings for the site, which `python book/make.py site` builds.

For those who write pages; everything is plain Markdown that reads well in JupyterLab too:

- Cite by an ordinary link to the paper's address as `references.bib` has it (`https://doi.org/`
  and its doi, or its url): `[Umeyama, 1991](https://doi.org/10.1109/34.88573)`. The site adds a
  footnote with the full reference. A doi or arXiv link that the bibliography lacks is an error.
- Link to pages as files, `[chapter 1](01_poses_and_cameras.ipynb)`, and to headings as JupyterLab
  does, spaces as hyphens: `[ICP](01_poses_and_cameras.ipynb#Iterative-closest-point)`. A link to a
  file of the project, `[its code](drawing/index.py)`, becomes a download.
- A picture has alt text: that of `Picture` and `Viewer` comes along by itself.
- What a widget drew when the notebook was executed shows on the site; the widget does not.
- Nothing may load from elsewhere: tests/making/test_site.py looks at every page.
"""

project = "6-DoF object pose estimation"
author = ""
project_copyright = "2026, The maintainers"
language = "en"

extensions = ["myst_nb", "sphinx_copybutton", "sphinxcontrib.bibtex"]
root_doc = "index"

nb_execution_mode = "off"
nb_ipywidgets_js: dict[str, dict[str, str]] = {}  # the default loads scripts from elsewhere
myst_enable_extensions = ["amsmath", "dollarmath"]
myst_dmath_double_inline = True
myst_heading_anchors = 6
myst_heading_slug_func = "book.site.heading_anchors.anchor"

bibtex_bibfiles = ["references.bib"]
copybutton_exclude = ".linenos, .gp"
copybutton_selector = "div:not(.output) > .highlight > pre"

mathjax_path = "mathjax/tex-mml-chtml.js"
# The menu would load parts of MathJax that the site does not have.
mathjax3_config = {"options": {"enableMenu": False}}

html_theme = "sphinx_book_theme"
html_title = project
html_favicon = "_static/favicon.svg"
html_static_path = ["_static"]
html_css_files = ["book.css"]
html_js_files = ["book.js"]
html_use_index = False
html_copy_source = True
html_sourcelink_suffix = ""
html_show_sphinx = False
html_last_updated_fmt = None
html_context = {"default_mode": "auto"}
html_theme_options = {
    "logo": {
        "image_light": "_static/favicon.svg",
        "image_dark": "_static/favicon.svg",
        "text": project,
        "alt_text": "Three axes",
    },
    **{f"navbar_{part}": [] for part in ("start", "center", "end", "persistent")},
    "use_fullscreen_button": False,
    "use_download_button": True,
    "show_toc_level": 2,
    "search_bar_text": "Search the book",
}
