"""What the README promises of the packages is so. (Its report is tested in test_main.)"""

import ast
import re
from pathlib import Path

import pytest

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


def test_its_commands_exist():
    from data_tools.main import _parser

    listed = re.search(r"`python -m data_tools`\s+has (.*?)\. In Python", README, re.S).group(1)
    commands = re.findall(r"`(\w+)`", listed)
    choices = next(a.choices for a in _parser()._actions if a.choices)
    assert set(commands) == set(choices)
