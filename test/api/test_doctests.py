"""The examples in the docstrings of the front door run as they stand."""

import ast
import doctest
import pkgutil
from importlib import import_module
from inspect import getmembers, getmodule, isfunction, ismodule
from pathlib import Path

import pytest

import rotcal_ros as rc
from rotcal_ros import api

ROOT = Path(__file__).parents[2]
MODULES = [import_module(f"{api.__name__}.{m.name}") for m in pkgutil.iter_modules(api.__path__)]
FUNCTIONS = [
    function
    for module in MODULES
    for name, function in getmembers(module, isfunction)
    if function.__module__ == module.__name__ and name[0] != "_"
]


CONSTANTS = {"ARCSEC", "DEGREE", "MICROMETRE"}
NEEDS_A_GRAPH = {"ros"}
"""Its docstring says so; test/nodes runs it."""
WITH_EXAMPLE = sorted(set(rc.__all__) - CONSTANTS - NEEDS_A_GRAPH)


@pytest.mark.slow
@pytest.mark.parametrize("name", WITH_EXAMPLE)
def test_every_name_has_an_example_that_runs(name, monkeypatch):
    monkeypatch.chdir(ROOT)  # they name the sample data from here
    value = getattr(rc, name)
    place = value if ismodule(value) else getmodule(value)
    (example,) = doctest.DocTestFinder(recurse=False).find(value, name, module=place)
    assert example.examples
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    assert runner.run(example).failed == 0


def test_what_has_no_example_says_why():
    assert all(isinstance(getattr(rc, name), float) for name in CONSTANTS)
    text = (ROOT / "rotcal_ros" / "ros.py").read_text()
    assert "live graph" in ast.get_docstring(ast.parse(text))


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
