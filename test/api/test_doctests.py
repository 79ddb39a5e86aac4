"""The examples in the docstrings of the front door run as they stand."""

import doctest
import pkgutil
from importlib import import_module
from inspect import getmembers, isfunction
from pathlib import Path

import pytest

from rotcal_ros import api

ROOT = Path(__file__).parents[2]
MODULES = [import_module(f"{api.__name__}.{m.name}") for m in pkgutil.iter_modules(api.__path__)]
FUNCTIONS = [
    function
    for module in MODULES
    for name, function in getmembers(module, isfunction)
    if function.__module__ == module.__name__ and name[0] != "_"
]


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.__name__)
def test_examples_run(module, monkeypatch):
    monkeypatch.chdir(ROOT)  # they name the sample data from here
    outcome = doctest.testmod(module, optionflags=doctest.ELLIPSIS)
    assert outcome.failed == 0
    assert outcome.attempted


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda function: function.__name__)
def test_every_function_has_an_example_and_names_its_errors(function):
    assert ">>> import rotcal_ros as rc" in function.__doc__
    assert "Error" in function.__doc__ or "errors as" in function.__doc__.lower()


def test_the_snippet_of_the_readme_runs(monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    section = (ROOT / "README.md").read_text().split("## From Python\n")[1].split("\n## ")[0]
    lines = [line[4:] for line in section.splitlines() if line.startswith("    ")]
    exec(compile("\n".join(lines), "README.md", "exec"), {})
    assert capsys.readouterr().out.startswith("ok")
