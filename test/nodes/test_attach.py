"""``rotcal run`` outlives its terminal, and ``rotcal attach`` shows it again."""

import json
import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import pytest
import warm
import yaml
from live_cell import DEADLINE_S, DEMO, SHORT, LiveCell, process_of, wait_until
from pseudo_terminal import PseudoTerminal

from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.methods.configuration import changed, read_configuration
from rotcal_ros.recordings.replay import read_recording
from rotcal_ros.recordings.result_sources import read_source

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

ROTCAL = (sys.executable, "-m", "rotcal_ros.cli.main")
SLOW = "simulation.time_scale=5.0"
ENTER, CTRL_C = b"\n", b"\x03"
MIRROR = Path(__file__).parents[2] / "config" / "plane_mirror_demo.yaml"
TWO_STATIONS = (
    "plan.table_positions=5",
    "plan.positions_per_station=3",
    "plan.reflectors=1",
    "planner.preflight_timeout_s=30.0",
    "simulation.tracker.station_azimuths_deg=[22.5, 67.5]",
)


@pytest.fixture(autouse=True)
def _importable(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))


@pytest.fixture
def terminal():
    """Return a function that starts a verb on a terminal of its own; all end with the test."""
    started = []

    def start(*arguments, **more):
        made = PseudoTerminal([*ROTCAL, *arguments], **more)
        started.append(made)
        return made

    yield start
    for made in started:
        if made.process.poll() is None:
            made.process.send_signal(signal.SIGCONT)
            made.process.terminate()
            made.process.wait(load_scaled_timeout(DEADLINE_S))
        made.hang_up()


def running(folder, *changes):
    parts = [part for change in (*SHORT, *changes) for part in ("--set", change)]
    return ["run", DEMO, "--output", folder, *parts]


def rotcal(*arguments, code=0):
    """Run a verb without a terminal and return what it printed."""
    done = warm.run(
        [*ROTCAL, *arguments],
        timeout=load_scaled_timeout(2 * DEADLINE_S),
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode == code, done.stderr
    return done


@pytest.mark.slow
def test_a_lost_terminal_does_not_end_a_calibration_and_attach_shows_it_again(tmp_path, terminal):
    folder = tmp_path / "out"
    run = terminal(*running(folder, SLOW))
    run.wait_for("/60")
    run.hang_up()
    attached = rotcal("attach", folder)
    assert "of 60 steps, " in attached.stderr
    assert run.process.wait(load_scaled_timeout(DEADLINE_S)) == 0

    result = read_source(folder / "result.json").result
    verdict, _, untested = result.verdict_line.partition(". ")
    assert attached.stdout.startswith(f"measurement: {verdict}: 59 steps used, 1 skipped")
    assert untested in attached.stdout
    assert str(folder / "report.html") in attached.stdout
    assert (folder / "report.html").exists()
    assert (folder / "compensation").is_dir()
    log = (folder / "log" / "run.log").read_text()
    assert "60 of 60 steps" in log
    assert attached.stdout.strip() in log
    assert "Traceback" not in log
    assert not (folder / "running.json").exists()
    assert "is finished" in rotcal("attach", folder, code=2).stderr


def test_a_pause_is_answered_by_one_of_two_who_are_attached(tmp_path, terminal):
    """Its first terminal is lost while a person is waited for, here a real one."""
    instruments = LiveCell(tmp_path, changed(read_configuration(MIRROR), TWO_STATIONS))
    parameters = yaml.safe_load(instruments.file.read_text())
    parameters["/**"]["ros__parameters"].pop("simulation")
    file = tmp_path / "real.yaml"
    file.write_text(yaml.safe_dump(parameters))
    folder = tmp_path / "out"
    try:
        instruments.start("simulated_cell")
        run = terminal("run", file, "--output", folder, "--no-report", "--no-export")
        run.wait_for("put the tracker at place 1 of 2")
        run.hang_up()
        first, second = terminal("attach", folder), terminal("attach", folder)
        for viewer in (first, second):
            viewer.wait_for("put the tracker at place 1 of 2")
            viewer.wait_for("press Enter")
        second.press(ENTER)
        for viewer in (first, second):
            viewer.wait_for("put the tracker at place 2")
        first.press(ENTER)
        for viewer in (first, second):
            assert viewer.process.wait(load_scaled_timeout(DEADLINE_S)) == 0
            viewer.wait_for("measurement: ok")
        assert run.process.wait(load_scaled_timeout(DEADLINE_S)) == 0
    finally:
        instruments.processes.end()


@pytest.mark.long  # two are attached in the test above
def test_viewers_come_and_go_and_one_of_them_stops_it(tmp_path, terminal):
    folder = tmp_path / "out"
    run = terminal(*running(folder, "simulation.time_scale=1.0"))
    run.wait_for("/60")
    address = Path(json.loads((folder / "running.json").read_text())["socket"])
    assert stat.S_IMODE(address.stat().st_mode) == 0o600
    assert stat.S_IMODE(address.parent.stat().st_mode) == 0o700

    killed, leaving, stuck, waiting = (terminal("attach", folder) for _ in range(4))
    for viewer in (killed, leaving, stuck, waiting):
        viewer.wait_for("/60")
    killed.process.kill()
    stuck.process.send_signal(signal.SIGSTOP)
    leaving.press(CTRL_C)
    assert leaving.process.wait(load_scaled_timeout(DEADLINE_S)) == 130
    leaving.wait_for("left; the calibration continues")
    leaving.wait_for(f"rotcal attach {folder} --stop")
    steps = run.text.count("/60")
    wait_until(lambda: run.text.count("/60") > steps + 20, "the calibration continues")

    rotcal("attach", folder, "--stop")
    assert run.process.wait(load_scaled_timeout(DEADLINE_S)) == 130
    assert waiting.process.wait(load_scaled_timeout(DEADLINE_S)) == 130
    for shown in (run, waiting):
        shown.wait_for("interrupted; the bag is closed")
        shown.wait_for(f"--resume {folder}")
    assert [v.state for v in read_recording(folder / "bag").verdicts] == ["complete"]
    assert not address.parent.exists()
    assert "it was interrupted; resume with" in rotcal("attach", folder, code=2).stderr


@pytest.mark.long
def test_in_the_background_from_the_start(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cell.yaml").write_text(changed(read_configuration(DEMO), SHORT).text)
    begun = rotcal("run", "cell.yaml", "--detach", "--no-report")
    try:
        folder = tmp_path / "out" / "cell"
        assert begun.stdout.endswith(f"to see it: rotcal attach {folder}\n")
        outcome = json.loads(rotcal("attach", "--json").stdout)  # the only one
        assert outcome["n_used"] == 59
        assert outcome["verdict_line"] == read_source(folder / "result.json").result.verdict_line
        assert "no calibration runs" in rotcal("attach", code=2).stderr
        assert "measurement: ok" in (folder / "log" / "run.log").read_text()
    finally:
        warm.run([*ROTCAL, "attach", folder, "--stop"])


@pytest.mark.long
def test_an_ignored_hangup_stays_ignored_and_the_dead_terminal_kills_nothing(tmp_path, terminal):
    folder = tmp_path / "out"
    run = terminal(
        *running(folder),
        "--no-report",
        "--no-export",
        prepare=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN),
    )
    run.wait_for("/60")
    run.hang_up()
    assert run.process.wait(load_scaled_timeout(DEADLINE_S)) == 0
    assert "measurement: ok" in (folder / "log" / "run.log").read_text()


@pytest.mark.long  # test_run.py has the exit code
def test_an_error_is_told_to_those_who_are_attached_with_its_exit_code(tmp_path, terminal):
    folder = tmp_path / "out"
    run = terminal(*running(folder, SLOW))
    run.wait_for("/60")
    viewer = terminal("attach", folder)
    viewer.wait_for("/60")
    os.kill(process_of(run.process.pid, "capture"), signal.SIGKILL)
    assert (
        run.process.wait(load_scaled_timeout(DEADLINE_S))
        == viewer.process.wait(load_scaled_timeout(DEADLINE_S))
        == 3
    )
    for shown in (run, viewer):
        shown.wait_for("capture")
        shown.wait_for("resume with: rotcal run")
