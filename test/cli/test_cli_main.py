"""The frame of the command line: what is loaded, what is printed where, how it ends."""

import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import click
import pytest
from click.testing import CliRunner

import rotcal_ros
from rotcal_ros.cli import main
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import BagError, ConfigurationError, ObservabilityError
from rotcal_ros.foundation.plugins import VERBS, Verb, names


def run(*arguments):
    return CliRunner().invoke(main.rotcal, arguments, prog_name="rotcal")


@pytest.fixture
def verb(monkeypatch):
    """Return a function that replaces the verb ``doctor`` by one that does what it is given."""

    def replace(action):
        monkeypatch.setattr("rotcal_ros.cli.doctor.command", click.command()(action))

    return replace


@pytest.fixture
def foreign(monkeypatch):
    """Return a function that installs a verb of another package, or one that fails to load."""
    found = dict(plugins._found(plugins.VERBS))
    monkeypatch.setattr(plugins, "_found", lambda _group: found)
    caches = (main.verbs, plugins.load)

    def install(name, verb):
        load = raising(verb) if isinstance(verb, Exception) else lambda: verb
        found[name] = SimpleNamespace(load=load, module="nowhere", dist=None)
        for cached in caches:
            cached.cache_clear()

    yield install
    for cached in caches:
        cached.cache_clear()


def raising(error):
    def action():
        raise error

    return action


@pytest.mark.parametrize("name", main.verbs())
def test_every_verb_has_help(name):
    result = run(name, "--help")
    assert result.exit_code == 0
    assert f"Usage: rotcal {name}" in result.stdout


def test_help_lists_every_verb_and_loads_none():
    script = (
        "import sys; from rotcal_ros.cli.main import rotcal\n"
        "try: rotcal(['--help'])\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'scipy', 'rich', 'matplotlib', 'mcap', 'rclpy', 'yaml'}\n"
        "verbs = {m for m in sys.modules if m.startswith('rotcal_ros.cli.')} \n"
        "verbs |= {m for m in sys.modules if m.endswith('.verbs')}\n"
        "print(sorted(heavy & set(sys.modules)), sorted(verbs))"
    )
    run_ = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    *help_, loaded = run_.stdout.splitlines()
    assert loaded == "[] ['rotcal_ros.cli.console', 'rotcal_ros.cli.main']"
    for name in main.verbs():
        assert any(line.startswith(f"  {name} ") for line in help_)


@pytest.mark.parametrize(
    ("typed", "hint"),
    [
        ("slove", "did you mean 'solve'"),
        ("reporrt", "did you mean 'report'"),
        ("xyz", "known: new"),
    ],
)
def test_a_misspelt_verb_gets_the_nearest_name(typed, hint):
    result = run(typed, "--json")
    assert result.exit_code == 2
    assert f"no verb '{typed}'" in result.stderr
    assert hint in result.stderr


def test_version():
    result = run("--version")
    assert result.exit_code == 0
    assert result.stdout == f"rotcal, version {rotcal_ros.__version__}\n"


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (ConfigurationError("no such method"), 2),
        (BagError("a.mcap: damaged at byte 7"), 2),
        (ObservabilityError("the angle cannot be determined"), 3),
    ],
)
def test_an_error_is_one_line_and_its_exit_code(verb, error, code):
    verb(raising(error))
    result = run("doctor")
    assert result.exit_code == code
    assert result.stdout == ""
    assert result.stderr == f"rotcal: {error}\n"


def test_an_unreadable_file_is_one_line(verb):
    verb(lambda: Path("/nowhere/at/all").read_bytes())
    result = run("doctor")
    assert result.exit_code == 2
    assert result.stderr == "rotcal: No such file or directory: /nowhere/at/all\n"


def test_an_unexpected_error_is_one_line_that_says_how_to_learn_more(verb):
    verb(raising(ZeroDivisionError("division by zero")))
    result = run("doctor")
    assert result.exit_code == 2
    assert result.stderr == (
        "rotcal: unexpected ZeroDivisionError: division by zero "
        "('rotcal --debug ...' shows where)\n"
    )


def test_a_package_of_pip_alone_that_is_missing_is_named(verb):
    verb(raising(ModuleNotFoundError("No module named 'mcap.writer'", name="mcap")))
    result = run("doctor")
    assert result.exit_code == 2
    assert result.stderr == "rotcal: mcap is missing: pip install mcap rosbags threadpoolctl\n"


def test_debug_shows_the_traceback(verb):
    verb(raising(BagError("damaged")))
    assert isinstance(run("--debug", "doctor").exception, BagError)


def test_interruption(verb):
    verb(raising(KeyboardInterrupt()))
    result = run("doctor")
    assert result.exit_code == 130
    assert result.stderr == "rotcal: interrupted\n"


@pytest.mark.parametrize(("value", "code"), [(None, 0), (0, 0), (1, 1), (3, 3)])
def test_a_verb_may_return_its_exit_code(verb, value, code):
    verb(lambda: value)
    assert run("doctor").exit_code == code


@pytest.mark.parametrize("arguments", [["nonsense"], ["--nonsense"], ["doctor", "--nonsense"]])
def test_wrong_usage(arguments):
    result = run(*arguments)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert "nonsense" in result.stderr
    assert "Traceback" not in result.stderr


def test_a_reader_that_goes_away_is_no_error():
    script = "from rotcal_ros.cli.main import main; main()"
    with subprocess.Popen(
        [sys.executable, "-c", script, "--help"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        process.stdout.close()
        complaint = process.stderr.read()
    assert complaint == b""
    assert process.returncode in (0, 1, -signal.SIGPIPE)


def test_an_extension_adds_a_verb_and_takes_the_place_of_none(foreign):
    foreign("measure", Verb("Measure.", "nowhere", "bag"))
    foreign("solve", Verb("Solve otherwise.", "nowhere"))
    listed = list(main.verbs())
    assert listed[listed.index("bag") + 1] == "measure"
    assert main.verbs()["solve"].help == main.OWN_VERBS["solve"]


def test_a_verb_that_cannot_be_loaded_harms_no_other(foreign):
    foreign("broken", ImportError("No module named 'gone'"))
    listed = run("--help")
    assert listed.exit_code == 0
    assert "the verb 'broken'" in listed.stdout
    assert run("settings", "--help").exit_code == 0
    result = run("broken")
    assert result.exit_code == 2
    assert result.stderr.startswith("rotcal: the verb 'broken'")
    assert "No module named 'gone'" in result.stderr


def test_every_verb_of_ours_stands_once_in_the_help():
    listed = [name for names in main.SECTIONS.values() for name in names]
    assert sorted(listed) == sorted(main.OWN_VERBS)
    assert listed[:4] == ["run", "new", "solve", "report"]


def test_a_verb_of_another_package_stands_behind_the_one_it_follows():
    lines = CliRunner().invoke(main.rotcal, ["--help"]).output.splitlines()
    verbs = [line.split()[0] for line in lines if line.startswith("  ") and line[2:3] != " "]
    if "web" in names(VERBS):
        assert verbs[verbs.index("solve") + 1] == "web"
    assert verbs.index("plan") < verbs.index("attach") < verbs.index("compare")
