"""Who may import whom: a floor only from the floors under it, or from its own."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FLOORS = {
    "arrays": 0, "rotations": 0, "scale": 0, "files": 0,
    "poses": 1, "cameras": 1, "clouds": 1,
    "metrics": 2, "registration": 2,
    "nets": 3,
    "training": 4,
    "figures": 4, "book": 4,
    "papers": 5,
    "commands": 6,
}  # fmt: skip
MODULES = sorted(p for name in ("posecore", "data_tools") for p in (ROOT / name).rglob("*.py"))


def imported(path: Path) -> set[str]:
    """The modules of this project that a file imports, by their full names."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return {name for name in names if name.split(".")[0] in ("posecore", "data_tools", "book")}


@pytest.mark.parametrize("path", MODULES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_imports_go_down(path):
    package, *rest = path.relative_to(ROOT).with_suffix("").parts
    if package == "posecore" and rest[0] not in ("__init__", "__main__"):
        floor = FLOORS[rest[0]]  # a new room has to be entered above
    else:
        floor = 6
    for name in imported(path):
        other, *room = name.split(".")
        if package == "posecore":
            joins = rest[0] in ("__main__", "commands")  # datasets with what is done with them
            assert other == "posecore" or joins, f"{path.name} imports {name}"
        if other == "posecore" and room and room[0] in FLOORS:
            assert FLOORS[room[0]] <= floor, f"{path.name} imports {name} from a floor above"
            if package == "data_tools":
                assert FLOORS[room[0]] <= 2 or room[0] == "figures", f"{path.name}: {name}"
        assert other != "book", f"{path.name} imports from the chapters"


def test_the_rule_sees_imports():
    found = imported(ROOT / "posecore" / "metrics" / "model_errors.py")
    assert {"posecore.cameras", "posecore.poses", "posecore.arrays.fail"} <= found
