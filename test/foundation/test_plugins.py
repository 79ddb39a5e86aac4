"""What somebody else's plug-in does wrong is said with its name; the plug-ins are made here."""

import sys
from importlib.metadata import EntryPoint

import pytest

from rotcal_ros.cli.main import _explain
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import ConfigurationError

MODULE = """
import json

def write(table):
    return 1 / table

def parse(text):
    return json.loads(text)
"""


@pytest.fixture
def plugin(tmp_path, monkeypatch):
    """Install a module as the controller "broken" and as the method "other"."""

    def install(text, name="broken_drive"):
        (tmp_path / f"{name}.py").write_text(text)
        points = {
            plugins.CONTROLLERS: {
                "broken": EntryPoint("broken", f"{name}:write", plugins.CONTROLLERS),
                "csv": EntryPoint("csv", "rotcal_ros.compensation.plain_csv:PlainCsv", "x"),
            }
        }
        monkeypatch.setattr(plugins, "_found", lambda group: points.get(group, {}))
        monkeypatch.syspath_prepend(str(tmp_path))
        plugins.load.cache_clear()
        return lambda: plugins.load(plugins.CONTROLLERS, "broken", "controller")

    yield install
    plugins.load.cache_clear()
    sys.modules.pop("broken_drive", None)


def raised(call, *arguments):
    with pytest.raises(Exception) as found:  # noqa: PT011  whatever the plug-in raises
        call(*arguments)
    return found.value


def test_an_exception_of_a_plug_in_names_it_and_the_line(plugin, tmp_path, capsys):
    error = raised(plugin(MODULE)(), 0)
    assert isinstance(error, ZeroDivisionError)
    place = f"in the controller 'broken' (broken_drive: {tmp_path / 'broken_drive.py'}, line 5)"
    assert plugins.failing_plugin(error) == place
    assert _explain(error) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "unexpected ZeroDivisionError in the controller 'broken'" in told


def test_a_file_that_a_plug_in_does_not_find_is_its_own(plugin, tmp_path, capsys):
    error = raised(plugin("def write(path):\n    return open(path)\n")(), tmp_path / "gone")
    assert _explain(error) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "unexpected FileNotFoundError in the controller 'broken'" in told
    assert plugins.describe_error(error).startswith(
        "FileNotFoundError in the controller 'broken' (bro"
    )


TWO = """
class First:
    def write(self, table):
        return 1 / table

class Second(First):
    pass

SECOND = Second
"""


@pytest.mark.parametrize("name", ["First", "Second"])
def test_of_two_plug_ins_in_one_module_the_one_at_work_is_named(plugin, monkeypatch, name):
    points = {
        known: EntryPoint(known.lower(), f"broken_drive:{attribute}", plugins.CONTROLLERS)
        for known, attribute in (("First", "First"), ("Second", "SECOND"))
    }
    plugin(TWO)
    monkeypatch.setattr(
        plugins, "_found", lambda group: points if group == plugins.CONTROLLERS else {}
    )
    told = plugins.failing_plugin(raised(points[name].load()().write, 0))
    assert told.startswith(f"in the controller {name.lower()!r} (broken_drive: ")
    nobody = plugins.failing_plugin(raised(points[name].load().write, None, 0))
    assert nobody.startswith("in the controller 'first' or controller 'second' (broken_drive: ")


def test_what_a_plug_in_calls_is_its_own_matter(plugin):
    plugin(MODULE)()
    error = raised(sys.modules["broken_drive"].parse, "{")
    assert "in the controller 'broken'" in plugins.failing_plugin(error)


def test_an_error_of_ours_is_blamed_on_nobody(plugin):
    plugin(MODULE)()
    assert plugins.failing_plugin(raised(lambda: 1 / 0)) is None
    assert plugins.failing_plugin(ValueError("never raised")) is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("import no_such_thing", "No module named 'no_such_thing'"),
        ("1 / 0", "ZeroDivisionError: division by zero"),
        ("def write(:", "SyntaxError"),
        ("", "AttributeError"),
    ],
)
def test_a_plug_in_that_cannot_be_loaded_is_named_whatever_it_raises(plugin, text, words):
    with pytest.raises(ConfigurationError) as found:
        plugin(text)()
    told = str(found.value)
    assert told.startswith("the controller 'broken' (broken_drive) cannot be loaded: ")
    assert words in told


def test_the_groups_that_other_packages_name_stay():
    """They stand in the pyproject.toml of others: renaming a package must not rename them."""
    assert (plugins.METHODS, plugins.METHOD_SETTINGS, plugins.CONTROLLERS) == (
        "rotcal_ros.methods", "rotcal_ros.method_settings", "rotcal_ros.controllers",
    )  # fmt: skip
    assert (plugins.INSTRUMENTS, plugins.VERBS, plugins.SETTINGS) == (
        "rotcal_ros.instruments", "rotcal_ros.verbs", "rotcal_ros.settings",
    )  # fmt: skip
