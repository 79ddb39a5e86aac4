"""The worked examples of pages print what the pages say."""

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.parametrize("page", ["engine.md", "angle_comparison.md", "table_balls.md"])
def test_the_worked_example_prints_what_the_page_says(page, capsys):
    text = (DOCS / page).read_text()
    every = (re.findall(rf"```{kind}\n(.*?)```", text, re.DOTALL) for kind in ("python", "text"))
    for code, printed in zip(*every, strict=True):
        exec(code, {})
        assert capsys.readouterr().out == printed
