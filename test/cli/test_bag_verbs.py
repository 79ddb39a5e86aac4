"""``rotcal bag`` and ``rotcal solve``: output, JSON and exit codes."""

from __future__ import annotations

import dataclasses
import json
import re
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from mcap.writer import Writer

from rotcal_ros import methods
from rotcal_ros.cli.main import rotcal
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.results import Result as Solution
from rotcal_ros.planning.choices import PolicyProgress, StepChoice
from rotcal_ros.recordings.recorded_setup import RecordedChoice

sys.path.insert(0, str(Path(__file__).parents[1] / "bags"))
import bag_samples


@pytest.fixture(scope="module")
def simulated() -> bag_samples.Run:
    return bag_samples.simulate()


@pytest.fixture(scope="module")
def bag(simulated: bag_samples.Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cli") / "run"
    bag_samples.write_run(folder, simulated)
    return folder


@pytest.fixture
def cut(bag: Path, tmp_path: Path) -> Path:
    data = (bag / "run_0.mcap").read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(data[: len(data) // 2])
    return path


def run(*arguments: object) -> Result:
    return CliRunner().invoke(rotcal, [str(argument) for argument in arguments])


def stand_in(verdict: str) -> Any:
    """Return a solver that only reports what it was given."""

    def solve(_configuration: Any, plan: Any, observations: Any) -> Solution:
        if len(observations) < 3:
            raise DataError("3 observations are needed")
        angles = np.array(plan.table_angles)
        total = sum(o.mean[0] for o in observations)
        return Solution(
            method=plan.method, angles=angles, deviations={"ECC": angles * total},
            std={"ECC": angles * 0}, covariance={}, sigma0=1.0, dof=1,
            n_observations=len(observations), verdict=verdict,  # type: ignore[arg-type]
        )  # fmt: skip

    return solve


@pytest.fixture
def solver(monkeypatch: pytest.MonkeyPatch) -> Any:
    def install(verdict: str) -> None:
        method = methods.find_method("tracer_multistation")
        changed = dataclasses.replace(method, solve=stand_in(verdict))
        monkeypatch.setattr("rotcal_ros.methods.configuration.find_method", lambda _: changed)

    install("ok")
    return install


def test_info(bag: Path) -> None:
    result = run("bag", "info", bag)
    assert result.exit_code == 0
    assert "rotcal_msgs/msg/TracerLength" in result.stdout
    assert "tracer_multistation" in result.stdout
    data = json.loads(run("bag", "info", bag, "--json").stdout)
    assert data["topics"]["/cell/observation"]["messages"] == 32
    assert data["duration_s"] > 0


def test_check_tells_by_exit_code(bag: Path, cut: Path) -> None:
    assert run("bag", "check", bag).exit_code == 0
    result = run("bag", "check", cut)
    assert result.exit_code == 1
    assert "truncated at byte" in result.stdout
    data = json.loads(run("bag", "check", cut, "--json").stdout)
    assert data["files"][0]["verdict"] == "truncated"


def test_repair(cut: Path, tmp_path: Path) -> None:
    before = cut.read_bytes()
    data = json.loads(run("bag", "repair", cut, "--json").stdout)
    assert Path(data["folder"]) == tmp_path / "cut_repaired"
    assert data["after"][0]["messages"] == data["before"][0]["messages"]
    assert cut.read_bytes() == before
    again = run("bag", "repair", cut)
    assert again.exit_code == 2
    assert "exists already" in again.stderr
    checked = run("bag", "check", tmp_path / "cut_repaired")
    assert checked.exit_code == 1  # it ended within messages, which no repair brings back
    assert "an unknown number of messages lost" in checked.stdout


@pytest.mark.parametrize("verb", ["bag info", "bag check", "bag repair", "solve"])
@pytest.mark.parametrize("content", [None, b"", b"text"])
def test_unreadable_input(verb: str, content: bytes | None, tmp_path: Path) -> None:
    path = tmp_path / "thing.mcap"
    if content is not None:
        path.write_bytes(content)
    result = run(*verb.split(), path)
    # an empty file is a bag that was begun and lost at once
    empty = {"bag info": 1, "bag check": 1, "bag repair": 1, "solve": 2}
    assert result.exit_code == (empty[verb] if content == b"" else 2)
    assert "Traceback" not in result.output


def test_a_bag_without_choices_says_so() -> None:
    """The bag of the examples was made without a planner."""
    outcome = run("bag", "choices", Path(__file__).parents[2] / "examples/data/ball_plate_bag")
    assert outcome.exit_code == 0
    assert outcome.stdout == ""
    assert "no choice of a planner was recorded" in outcome.stderr


@pytest.mark.usefixtures("solver")
@pytest.mark.parametrize(("in_streams", "code"), [((), 0), (("run 1, choice 0: other",), 1)])
def test_choices_are_asked_of_the_streams_where_the_observations_differ(
    in_streams: tuple[str, ...], code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A killed capture had readings on disk that it never reported as an observation."""
    made = RecordedChoice(1, 0, 0, StepChoice(7, "first sweep", PolicyProgress(25)))
    found = {"observations": ("run 1, choice 0: 26 left",), "streams": in_streams}

    def read(_: Path, source: str = "streams", **_options: Any) -> Any:
        return SimpleNamespace(choices=(made,), choices_that_differ=lambda: found[source])

    monkeypatch.setattr("rotcal_ros.recordings.replay.read_recording", read)
    outcome = run("bag", "choices", tmp_path)
    assert outcome.exit_code == code
    assert "run 1     0 step 7: first sweep" in outcome.output
    assert ("choice 0: other" in outcome.output) == bool(in_streams)
    assert "26 left" not in outcome.output


def test_solve_gives_json_and_nothing_else(bag: Path, tmp_path: Path) -> None:
    output = tmp_path / "result.json"
    result = run("solve", bag, "--json", "-o", output)
    assert result.exit_code == 0
    assert json.loads(result.stdout) == json.loads(output.read_text())
    assert json.loads(result.stdout)["n_observations"] == 32
    recorded = run("solve", bag, "--json", "--from", "observations")
    assert recorded.stdout == result.stdout


@pytest.mark.usefixtures("solver")
def test_solve_for_people(bag: Path) -> None:
    result = run("solve", bag)
    assert "ECC/arcsec" in result.stdout
    assert re.search(r"measurement: ok.*: 32 observations", result.stderr)


@pytest.mark.usefixtures("solver")
def test_solve_a_cut_off_bag_warns(cut: Path) -> None:
    result = run("solve", cut, "--json")
    assert result.exit_code == 1
    assert "warning: cut.mcap: truncated at byte" in result.stderr
    assert 3 <= json.loads(result.stdout)["n_observations"] < 32


@pytest.mark.parametrize(("verdict", "code"), [("ok", 0), ("suspect", 1), ("failed", 1)])
def test_exit_code_follows_the_verdict(bag: Path, solver: Any, verdict: str, code: int) -> None:
    solver(verdict)
    assert run("solve", bag, "--json").exit_code == code


@pytest.mark.usefixtures("solver")
def test_not_enough_data(simulated: bag_samples.Run, tmp_path: Path) -> None:
    bag_samples.write_run(tmp_path / "short", bag_samples.Run([*simulated.observations[:2]]))
    result = run("solve", tmp_path / "short", "--from", "observations")
    assert result.exit_code == 3
    assert "3 observations are needed" in result.stderr


@pytest.mark.usefixtures("solver")
def test_solve_a_table(tmp_path: Path) -> None:
    setup = tmp_path / "setup.yaml"
    setup.write_text(bag_samples.CONFIGURATION)
    table = tmp_path / "lengths.csv"
    table.write_text("position,target,length_m\n0,0,0.5\n1,0,0.5\n2,1,0.6\n")
    result = run("solve", table, "--setup", setup, "--json")
    assert result.exit_code == 0
    assert json.loads(result.stdout)["n_observations"] == 3
    without = run("solve", table)
    assert without.exit_code == 2
    assert "--setup" in without.stderr


def test_the_folder_one_stands_in_is_repaired_beside_it(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "mine"
    shutil.copytree(bag, folder)
    monkeypatch.chdir(folder)
    assert run("bag", "repair", ".").exit_code == 0
    assert (tmp_path / "mine_repaired" / "metadata.yaml").is_file()
    (folder / "deeper").mkdir()
    monkeypatch.chdir(folder / "deeper")
    assert "exists already" in run("bag", "repair", "..").stderr


@pytest.mark.parametrize("count", ["--5", "5-", "²", "", "9" * 5000])
def test_a_recorded_loss_that_is_no_number(count: str, tmp_path: Path) -> None:
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/a", "json", 0)
        writer.add_message(channel, 1, b"{}", 1)
        writer.add_metadata("rotcal_losses", {"lost /a": count, "queue": "7"})
        writer.add_metadata("rotcal_run", {"number": count})
        writer.finish()
    found = json.loads(run("bag", "info", tmp_path / "a.mcap", "--json").stdout)
    assert found["losses_recorded"] == {"queue": 7}
    words = f"a loss was recorded (lost /a), but its count is not a number: {count[:20]!r}"
    assert found["losses_unread"] == [f"a.mcap: {words}"]
    assert words in run("bag", "info", tmp_path / "a.mcap").stderr
    assert run("bag", "check", tmp_path / "a.mcap").exit_code == 0
    assert run("bag", "repair", tmp_path / "a.mcap").exit_code == 0
    again = json.loads(run("bag", "info", tmp_path / "a_repaired", "--json").stdout)
    assert again["losses_recorded"] == {"queue": 7}
    assert again["losses_unread"] == [f"a_repaired_0.mcap: {words}"]
