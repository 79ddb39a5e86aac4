"""A plan gone through without a machine: reach and time against closed forms."""

from math import pi, sqrt
from pathlib import Path

import pytest

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.methods import prepare
from rotcal_ros.methods.configuration import changed, read_configuration
from rotcal_ros.methods.dry_run import DryRun, describe_duration

OWN = Path(__file__).parents[2] / "examples" / "own_cell" / "own_cell.yaml"
CONFIG = Path(__file__).parents[2] / "config"


def lines_of(*changes, path=OWN, **values):
    run = DryRun(prepare(changed(read_configuration(path), changes)), **values)
    return {line.name: line for line in run.lines()}


def test_the_first_order_and_the_counts_are_those_of_the_plan():
    lines = lines_of()
    assert "table to 0°" in lines["first order"].found
    assert "probe to (-0.45, -0.45, 0.3) m (REFLECTOR, target 0)" in lines["first order"].found
    found = lines["steps"].found
    assert found == "48 steps: 6 table angles, 8 targets, 5 turns of the table"
    assert "6 turns" in lines_of(start=1.0)["steps"].found


def test_what_is_not_stated_is_open_and_says_what_to_compare_with():
    lines = lines_of()
    assert lines["table"].state == lines["probe"].state == "open"
    assert "0° to 300°" in lines["table"].found
    assert "x -0.45 to 0.45, y -0.45 to 0.45, z 0.3 to 0.7 m" in lines["probe"].found
    assert "cell.volume_from_m" in lines["probe"].todo


def test_a_table_that_turns_passes_its_angles_and_needs_more_travel():
    turning = ("plan.measure=displacement", "plan.closing=false", "plan.turning_deg_s=[9.0, -9.0]")
    lines = lines_of(*turning, path=CONFIG / "table_balls_demo.yaml")
    assert lines["first order"].found.startswith("table past 0°")
    assert lines["table"].found.startswith("-15° to 345°")


def test_targets_outside_the_stated_volume_are_counted():
    inside = ("cell.volume_from_m=[-0.5, -0.5, 0.0]", "cell.volume_to_m=[0.5, 0.5, 0.8]")
    assert lines_of(*inside)["probe"].state == "good"
    low = (inside[0], "cell.volume_to_m=[0.5, 0.5, 0.6]")
    line = lines_of(*low)["probe"]
    assert line.state == "missing"
    assert "24 of 48 steps lie outside" in line.found
    for half in ((inside[0],), ("cell.volume_from_m=[1, 1, 1]", inside[1])):
        with pytest.raises(ConfigurationError, match="volume_to_m"):
            lines_of(*half)


def test_angles_beyond_the_travel_of_the_adapter_are_missing():
    travel = ("table_adapter.lower_deg=-10.0", "table_adapter.upper_deg=310.0")
    assert lines_of(*travel)["table"].state == "good"
    line = lines_of(travel[0], "table_adapter.upper_deg=250.0")["table"]
    assert line.state == "missing"
    assert "the table cannot go to 300" in line.found


def test_the_time_is_that_of_the_stated_turns_and_steps():
    # from rest at the first angle: 5 turns of 10 s and 48 steps of 5 s
    assert "about 5 min" in lines_of()["time"].found  # 290 s
    changes = ("planner.turn_s=2.0", "planner.step_s=1.0")
    assert "about 58 s" in lines_of(*changes)["time"].found  # 5 * 2 + 48
    assert "about 60 s" in lines_of(*changes, start=1.0)["time"].found  # and one turn more
    # a slow tracer: 0.05 s to settle and 50 readings at 10 Hz make 5.05 s a step
    assert "about 4 min" in lines_of(*changes, tracer_hz=10.0)["time"].found  # 252.4 s


def test_the_time_of_the_turns_is_that_of_the_adapter_s_cubics():
    changes = ("planner.step_s=1.0", "table_adapter.speed_deg_s=10.0",
               "table_adapter.acceleration_deg_s2=1000.0",
               "table_adapter.overshoot_deg=2.0")  # fmt: skip
    # 60 deg at a mean speed of two thirds of the largest: 9 s, and five of them from below;
    # the first angle, at which the table stands, is reached anew from 2 deg below
    two = 1.5 * 2.0 / 10.0
    assert two > sqrt(6.0 * 2.0 / 1000.0)
    expected = 5 * 1.5 * 60.0 / 10.0 + 2 * two + 48 * 1.0
    assert f"about {expected:.0f} s" in lines_of(*changes)["time"].found


def test_beams_longer_than_the_capture_takes_are_missing():
    changes = ("plan.tracer_m=[0.3, 0.05, 0.15]",)
    assert lines_of(*changes)["beams"].state == "good"
    assert lines_of(*changes, "capture.max_length_m=0.5")["beams"].state == "missing"
    assert "beams" not in lines_of()


@pytest.mark.parametrize(
    "path",
    sorted(path for path in CONFIG.glob("*.yaml") if "ros__parameters" in path.read_text()),
    ids=lambda path: path.stem,
)
def test_every_configuration_that_comes_along_can_be_gone_through(path):
    lines = lines_of(path=path, start=pi)
    assert {"first order", "steps", "table", "probe", "time"} <= lines.keys()
    assert not any(line.state == "missing" for line in lines.values())


@pytest.mark.parametrize(
    ("seconds", "words"), [(58.4, "58 s"), (290, "5 min"), (7500, "2 h 05 min")]
)
def test_times_are_as_people_say_them(seconds, words):
    assert describe_duration(seconds) == words
