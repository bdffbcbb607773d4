"""What runs is what was loaded: an edit since is noticed, and nothing is stamped with it."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from posecore.fingerprint import HOME

PROGRAM = """
import sys
from pathlib import Path
import posecore
from posecore import loaded
import posecore.poses
file = Path(posecore.poses.__file__)
print(sorted(loaded.edited()))
file.write_text(file.read_text() + sys.argv[1])
print(sorted(loaded.edited()))
from book.tools.dependencies import dependencies
try:
    dependencies("posecore.poses:compose", (), "tiny")
    print("fresh")
except RuntimeError as error:
    print(error)
"""


def run(tmp_path: Path, text: str) -> list[str]:
    for package in ("posecore", "data_tools", "book"):
        ignored = shutil.ignore_patterns("__pycache__", "*.ipynb", "_build", "weights")
        shutil.copytree(HOME / package, tmp_path / package, ignore=ignored)
    done = subprocess.run(
        [sys.executable, "-P", "-c", PROGRAM, text],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.slow
def test_an_edit_of_what_is_loaded_is_refused(tmp_path: Path) -> None:
    text = "\n\n_old = compose\n\n\ndef compose(*given):\n    return _old(*given)\n"
    first, second, answer = run(tmp_path, text)
    assert (first, second) == ("[]", "['posecore.poses']")
    assert "compose" in answer and answer.endswith("start Python or the kernel anew")


@pytest.mark.slow
def test_a_comment_is_none(tmp_path: Path) -> None:
    assert run(tmp_path, "\n# A word.\n") == ["[]", "['posecore.poses']", "fresh"]
