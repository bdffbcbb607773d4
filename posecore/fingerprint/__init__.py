"""What a result depends on: the definitions of this project that a piece of code reaches.

    before = closure(measure_table)          # functions, classes, assignments, however indirectly
    before.text                              # "choose:4f0c... table:1b22...", to be kept
    changes(kept_text, closure(measure_table))  # ["choose"], where that has another body now

Nothing is run or imported: files are read. A comment, a docstring, an annotation, a better error
message or a plain move to another module changes nothing; another number in a body does.
"""

from posecore.fingerprint.closure import (
    Closure,
    changes,
    closure,
    closure_as_loaded,
    digest,
    of_source,
)
from posecore.fingerprint.modules import HOME, PACKAGES

__all__ = [
    "HOME",
    "PACKAGES",
    "Closure",
    "changes",
    "closure",
    "closure_as_loaded",
    "digest",
    "of_source",
]
