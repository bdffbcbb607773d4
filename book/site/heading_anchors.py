"""Anchors of headings as JupyterLab makes them, so that one link serves there and on the site."""


def anchor(heading: str) -> str:
    """What `[text](page.ipynb#ANCHOR)` says to reach a heading: its text, spaces as hyphens."""
    return heading.replace(" ", "-")
