"""What the README promises of the packages is so. (Its report is tested in test_main.)"""

import ast
import re
from pathlib import Path

import pytest

from data_tools.bop import read_category_results

README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_example_of_batches_runs():
    (code,) = [
        block for block in re.findall(r"```python\n(.*?)```", README, re.S) if "Batches" in block
    ]
    *lines, loop = ast.parse(code).body
    names = {}
    exec(compile(ast.Module(lines, []), "README", "exec"), names)
    assert isinstance(loop, ast.For)
    source = eval(compile(ast.Expression(loop.iter), "README", "eval"), names)
    used = {node.slice.value for node in ast.walk(loop) if isinstance(node, ast.Subscript)}
    batch = next(iter(source))
    assert used and used <= batch.keys()
    assert len(batch["rgb"]) == 16


def test_the_example_of_categories_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (code,) = [b for b in re.findall(r"```python\n(.*?)```", README, re.S) if "Category" in b]
    names = {}
    exec(code, names)
    errors = names["metrics"].evaluate_categories(names["estimates"], names["truth"])
    said = re.search(r"\.pose\[5, 2\]  # (.*)", code)[1]
    assert errors["mug"].pose[5, 2] == float(said)
    head = re.search(r"```\n(scene_id.*?)\n(.*?)\n```", README, re.S)
    assert Path("estimates.csv").read_text().startswith(head[1] + "\n")
    Path("row.csv").write_text(head[0].strip("`\n") + "\n")
    assert read_category_results("row.csv").size.tolist() == [[0.12, 0.095, 0.084]]


def test_its_commands_exist():
    from data_tools.main import _parser

    listed = re.search(r"`python -m data_tools`\s+has (.*?)\. In Python", README, re.S).group(1)
    commands = re.findall(r"`(\w+)`", listed)
    choices = next(a.choices for a in _parser()._actions if a.choices)
    assert set(commands) == set(choices)
