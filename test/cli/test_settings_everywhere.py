"""A misspelt group or setting is answered by every verb that takes a configuration."""

from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner

from rotcal_ros.cli.main import rotcal, verbs
from rotcal_ros.sessions import processes, running

CONFIG = Path(__file__).parents[2] / "config"
MISSPELT = [
    ("solver.variannt=station", "variant"),
    ("topics.trcer_length=/x", "tracer_length"),
    ("recorder.silence=1", "silence_s"),
    ("simulation.tabel.x=1", "table"),
    ("bridge.controler=csv", "controller"),
    ("planer.max_attempts=1", "planner"),
]
WITH_FILE = [
    ["run", "CONFIG"],
    ["verify", "CONFIG"],
    ["solve", "missing.mcap", "--setup", "CONFIG"],
    ["solve", "missing.csv", "--setup", "CONFIG"],
    ["reprocess", "missing.mcap", "--setup", "CONFIG"],
    ["uncertainty", "CONFIG"],
    ["plan", "order", "CONFIG"],
]
WITH_FILE = [words for words in WITH_FILE if words[0] in verbs()]


@pytest.fixture
def refused(tmp_path, monkeypatch):
    """Return a function that runs a verb in an empty folder and returns its error text."""
    monkeypatch.chdir(tmp_path)
    # Neither is ROS needed for the answer nor does any process start.
    monkeypatch.setattr(processes, "require_ros", lambda: None)
    monkeypatch.setattr(running, "Processes", None)

    def run(*arguments):
        before = sorted(tmp_path.rglob("*"))
        ran = CliRunner().invoke(rotcal, [str(argument) for argument in arguments])
        assert ran.exit_code == 2, ran.output
        assert ran.stdout == ""
        assert sorted(tmp_path.rglob("*")) == before
        return ran.stderr

    return run


def misspelt(path, change):
    """Write the demo with a change that no --set would accept."""
    document = yaml.safe_load((CONFIG / "tracer_paper.yaml").read_text())
    name, value = change.split("=")
    *groups, last = name.split(".")
    place = document["/**"]["ros__parameters"]
    for group in groups:
        place = place.setdefault(group, {})
    place[last] = yaml.safe_load(value)
    path.write_text(yaml.safe_dump(document))
    return path


@pytest.mark.slow
@pytest.mark.parametrize(("change", "nearest"), MISSPELT)
@pytest.mark.parametrize("words", ["run --set", "run --resume . --set", "verify --set",
                                   "verify --check"])  # fmt: skip
def test_a_change_on_the_command_line(refused, words, change, nearest):
    verb, *options = words.split()
    text = refused(verb, CONFIG / "tracer_paper.yaml", *options, change)
    assert f"did you mean '{nearest}'" in text
    assert "with --set" in text


@pytest.mark.parametrize(("change", "nearest"), MISSPELT)
@pytest.mark.parametrize("arguments", WITH_FILE, ids=lambda a: " ".join(a[:2]))
def test_a_configuration_file(refused, tmp_path, arguments, change, nearest):
    path = misspelt(tmp_path / "cell.yaml", change)
    text = refused(*(path if argument == "CONFIG" else argument for argument in arguments))
    assert f"did you mean '{nearest}'" in text
    assert str(path) in text


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--to", "linuxcnf"], "did you mean 'linuxcnc'"),
        (["--spacing", "nan"], "spacing nan deg"),
        (["--spacing", 400], "spacing 400 deg"),
        (["--spacing", -10], "spacing -10 deg"),
        (["--spacing", 0.5], "the controller holds 256"),
        (["-o", "file/out"], "takes no new files"),
        (["-o", "taken"], "exists already and nothing is overwritten"),
    ],
    ids=str,
)  # fmt: skip
def test_what_verify_will_write_is_checked_before_it_measures(refused, tmp_path, options, words):
    (tmp_path / "file").write_text("")
    (tmp_path / "taken" / "bag").mkdir(parents=True)
    (tmp_path / "taken" / "bag" / "bag_0.mcap").write_text("")
    assert words in refused("verify", CONFIG / "verify_demo.yaml", "-o", "out", *options)
    assert not (tmp_path / "out").exists()
