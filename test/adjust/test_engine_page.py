"""The worked examples of pages print what the pages say."""

import re
import runpy
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"


def test_the_worked_example_prints_what_the_page_says(capsys):
    text = (DOCS / "engine.md").read_text()
    every = (re.findall(rf"```{kind}\n(.*?)```", text, re.DOTALL) for kind in ("python", "text"))
    for code, printed in zip(*every, strict=True):
        exec(code, {})
        assert capsys.readouterr().out == printed


@pytest.mark.parametrize(
    ("page", "script"),
    [("angle_comparison.md", "circle_shifts.py"), ("table_balls.md", "touches_of_balls.py")],
)
def test_a_script_prints_what_the_page_says(page, script, capsys):
    (printed,) = re.findall(
        rf"python research/{script}\n```\n\n```text\n(.*?)```",
        (DOCS / page).read_text(),
        re.DOTALL,
    )
    runpy.run_path(str(DOCS.parent / "research" / script))
    assert capsys.readouterr().out == printed
