"""The book: its pages, what belongs to each chapter, and the tools that make it."""

import posecore.loaded  # noqa: F401 - before all others of this package
