"""Methods: a package for each paper, and the command line that is written once for all of them.

A method is a package of this folder, listed in `METHODS`. Its module `command` has `add_train`, and
`add_estimate` or `add_clouds`, which add it to the parser; what commands share stands in
`training`, `estimating`, `runs` and `sources`.
"""

from typing import Any

from posecore.lazy import submodule, submodules

__all__ = ["METHODS"]

METHODS = (
    "cloudpose",
    "infrared",
    "invariant_gcn",
    "points_to_pose",
    "random_bins",
    "vector_field",
)
"""The packages of this folder, in the order in which the command line names them."""


def __getattr__(name: str) -> Any:
    return submodule(__name__, name)


def __dir__() -> list[str]:
    return sorted([*__all__, *submodules(__name__)])
