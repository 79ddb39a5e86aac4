"""Nodes that follow /clock: when none comes, slow, fast and paused."""

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from clock_source import BEGIN_S
from live_cell import DEMO, SUITE

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.methods.configuration import (
    changed,
    node_parameters,
    parse_configuration,
    read_configuration,
)
from rotcal_ros.nodes.runtime.clocks import SimClock
from rotcal_ros.recordings.replay import read_recording


class Clocks:
    """A sim clock and the wall clock, both by hand."""

    def __init__(self, used=True):
        self.ros_time_is_active, self.sim_s, self.wall_s = used, 0.0, 50.0
        self.sim = SimClock(self, lambda: self.wall_s)

    def now(self):
        return SimpleNamespace(nanoseconds=round(self.sim_s * 1e9))

    def live(self, seconds, pace):
        for _ in range(round(seconds * 5)):
            self.wall_s += 0.2
            self.sim_s += 0.2 * pace
            self.sim.poll()


def test_a_clock_that_never_comes_is_named_and_one_that_nobody_follows_is_not():
    clocks = Clocks()
    clocks.live(1.0, 0.0)
    assert clocks.sim.standstill() is None
    clocks.live(2.0, 0.0)
    assert "no time came on /clock" in clocks.sim.standstill()
    assert "no time came on /clock" in clocks.sim.remark()
    unused = Clocks(used=False)
    unused.live(9.0, 0.0)
    assert (unused.sim.standstill(), unused.sim.remark(), unused.sim.values()) == (None, None, {})


@pytest.mark.parametrize("pace", [0.1, 1.0, 7.0])
def test_pace_and_pause_are_told(pace):
    clocks = Clocks()
    clocks.live(10.0, pace)
    assert not clocks.sim.stands()
    assert clocks.sim.remark() == f"time-outs are wall time, /clock runs at {pace:.2g} of it"
    stood_s = clocks.sim_s
    clocks.live(3.0, 0.0)
    assert clocks.sim.standstill() == (
        f"/clock stands still at {stood_s:.3f} s: is the simulation paused?"
    )
    clocks.live(1.0, pace)
    assert clocks.sim.standstill() is None
    clocks.live(5.0, 2 * pace)
    assert f"runs at {2 * pace:.2g} of it" in clocks.sim.remark()


def test_the_configuration_gives_the_parameter_to_all_nodes():
    given = changed(read_configuration(DEMO), ["use_sim_time=true"])
    assert given.use_sim_time
    assert "use_sim_time: true" in node_parameters(given)
    assert not read_configuration(DEMO).use_sim_time
    with pytest.raises(ConfigurationError, match="use_sim_time is true or false, found 'yes'"):
        parse_configuration(given.text.replace("use_sim_time: true", "use_sim_time: 'yes'"))


@pytest.mark.slow
@pytest.mark.ros
def test_a_calibration_follows_a_clock_that_is_slow_fast_and_paused(cell):
    live = cell(
        "use_sim_time=true", "planner.preflight_timeout_s=30.0", "simulation.time_scale=8.0"
    )
    live.start(*SUITE, "simulated_cell")
    hurried = live.folder / "hurried.yaml"
    change = ["planner.preflight_timeout_s=2.5"]
    hurried.write_text(changed(read_configuration(live.file), change).text)
    failed = live.client("early", configuration=hurried).result()
    assert failed["error_code"] == 602, failed["error_msg"]
    assert "no time came on /clock" in failed["error_msg"]

    source = [sys.executable, str(Path(__file__).with_name("clock_source.py")), "0.5"]
    live.processes.start("clock", source, piped=True)
    client = live.client()
    begun = client.wait_for("feedback", "result", where=lambda e: e.get("accepted", 5) >= 5)
    assert begun["event"] == "feedback", begun
    live.processes.tell("clock", "0")
    client.wait_for("warning", where=lambda event: "/clock stands still" in event["text"])
    live.processes.tell("clock", "2")
    outcome = client.result()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    recording = read_recording(live.bag)
    assert recording.same_as_recorded
    assert sum(o.accepted for o in recording.recorded) == 59
    for observation in recording.recorded:
        assert BEGIN_S < observation.window_start_ns * 1e-9 < BEGIN_S + 1000.0
