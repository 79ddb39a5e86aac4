"""What looks wrong before anything moves: joint, velocity, unit, air, each in a sentence."""

from dataclasses import replace
from math import nan
from pathlib import Path

import numpy as np
import pytest

from rotcal_ros.capture.attempt import CaptureRules
from rotcal_ros.capture.decisions import decide_by_points, mean_point
from rotcal_ros.capture.instruments.plausibility import reading_scatter
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.methods import prepare
from rotcal_ros.methods.configuration import changed, read_configuration
from rotcal_ros.nodes.planner.preflight import (
    expected_air_topics,
    instrument_faults,
    instrument_warnings,
    missing_air_consequence,
)

CONFIG = Path(__file__).parents[3] / "config"
TRACER = read_configuration(CONFIG / "tracer_paper.yaml")
GOOD = {
    "joint.table": "0.500000000 0.000000000",
    "now.tracer_length": "0.350000000 OK",
    "now.temperature": "20.1000 air",
    "now.air_pressure": "101325.0 air",
    "now.relative_humidity": "0.4500 air",
    "valid.temperature": "3",
}


def configured(*changes):
    return changed(TRACER, changes)


def test_good_instruments_have_no_faults():
    assert instrument_faults(GOOD, TRACER) == instrument_warnings(GOOD, TRACER) == []
    assert instrument_faults({}, TRACER) == instrument_warnings({}, TRACER) == []


def test_a_joint_that_is_not_there_is_told_with_those_that_are():
    values = {**GOOD, "joint.spindle": "30.0 0.0"}
    (fault,) = instrument_faults(values, configured("cell.joint=C"))
    assert "no joint 'C' (cell.joint), it has table, spindle" in fault
    assert instrument_faults(values, configured("cell.joint=spindle")) == []


def test_where_there_are_more_joints_than_are_told_one_that_is_not_told_may_be_there():
    for told in (31, 32):
        values = {f"joint.axis_{k}": "0.5 0.0" for k in range(told)}
        assert len(instrument_faults(values, configured("cell.joint=C"))) == (told == 31)
        assert instrument_warnings(values, configured("cell.joint=C")) == []


def test_a_joint_without_velocity_is_read_by_its_angles():
    values = {"joint.x": f"0.5 {nan}", "joint.table": "0.5 0.0"}
    assert instrument_faults(values, configured("cell.joint=''")) == []  # the first one


def test_lengths_in_millimetres_are_a_fault():
    (fault,) = instrument_faults({**GOOD, "now.tracer_length": "350.000000000 OK"}, TRACER)
    assert "says 350 m, plausible are 20 m" in fault


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"refused.tracer_length": "a text is no length"}, "a text is no length"),
        ({"now.probe_point": "500.0 0.0 0.0"}, "set topics.position_unit: mm"),
        ({"rate_hz.tracer_length": "0"}, "stamps stand still, is the header filled?"),
        ({"rate_hz.joint_states": "0.5"}, "comes every 2 s: at rest 1 s are allowed"),
        ({"rate_hz.tracer_length": "5"}, "40 s, more than capture.step_timeout_s = 30 s"),
        ({"rate_hz.tracer_length": "0.4"}, "topics.length_single_shot: true"),
    ],
)
def test_what_no_window_can_come_of_is_a_fault(values, words):
    patient = configured("capture.window_samples=200", "capture.step_timeout_s=30.0")
    found = instrument_faults(GOOD | values, patient, prepare(patient).plan)
    assert words in "; ".join(found)
    asked = configured("topics.length_single_shot=true", "capture.window_samples=1")
    if values.get("rate_hz.tracer_length", "0") != "0":  # its silence is no loss
        assert instrument_faults(GOOD | values, asked) == []


def test_clocks_that_differ_are_a_fault():
    assert instrument_faults({**GOOD, "clock_offset": "4.0 s behind"}, TRACER) == ["4.0 s behind"]


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ({"joint.table": "30.0 0.0"}, "joint_states says 30 rad, 4.8 turns from zero: is it"),
        ({"now.temperature": "293.15 air"}, "temperature says 293.15; degrees Celsius"),
        ({"now.air_pressure": "1013.2 air"}, "air_pressure says 1013.2; pascal"),
        ({"now.relative_humidity": "45.0 air"}, "relative_humidity says 45; a share"),
    ],
)
def test_an_implausible_unit_is_a_doubt(value, words):
    assert instrument_faults(GOOD | value, TRACER) == []
    (doubt,) = instrument_warnings(GOOD | value, TRACER)
    assert words in doubt


def test_the_air_that_is_expected_and_that_without_which_nothing_is_measured():
    assert expected_air_topics(prepare(TRACER)) == ([], ["temperature"])
    none = prepare(configured("capture.temperature_expected=false"))
    assert expected_air_topics(none) == ([], [])
    text = missing_air_consequence("temperature", "/cell/temperature", TRACER)
    assert "no node publishes /cell/temperature: every observation waits for it for" in text
    assert "capture.temperature_expected: false" in text


def test_points_of_another_frame_than_the_machine_s_are_a_doubt():
    named = GOOD | {"frame.probe_point": "base"}
    (doubt,) = instrument_warnings(named, TRACER)
    assert "probe_point is stamped with the frame base" in doubt
    assert "(cell.machine_frame)" in doubt
    assert instrument_warnings(named, configured("cell.machine_frame=base")) == []
    for good in ("", "machine", "/machine"):
        assert instrument_warnings(GOOD | {"frame.probe_point": good}, TRACER) == []
    mirror = read_configuration(CONFIG / "plane_mirror_demo.yaml")
    assert instrument_warnings({"frame.probe_point": "tracker"}, mirror) == []  # a tracker's own


def test_the_points_of_a_tracker_are_in_its_own_frame_and_no_unit_is_read_from_them():
    mirror = read_configuration(CONFIG / "plane_mirror.yaml")
    plan = prepare(mirror).plan
    far = max(abs(x) for step in plan.steps for x in step.position)
    values = {"now.probe_point": f"{1000.0 * max(far, 1.0)} 0.0 0.0"}
    assert instrument_faults(values, mirror, plan) == []


def test_readings_are_no_points_of_the_machine():
    """An autocollimator's own frame and small numbers say nothing of the plan's places."""
    reads = CaptureRules({PointKind.READING: decide_by_points(mean_point)})
    angles = replace(TRACER, method=replace(TRACER.method, capture=reads))
    assert instrument_warnings(GOOD | {"frame.probe_point": "autocollimator"}, angles) == []


@pytest.mark.parametrize(
    ("length", "scatter", "rate", "words"),
    [
        ("0.350000000", 1e-7, 1000.0, None),
        ("0.000700000", 1e-7, 1000.0, None),  # lengths may count from anywhere
        ("0.000700000", 1e-10, 1000.0, "converted to metres twice?"),  # no laser is so quiet
        ("0.700000000", 1e-4, 1000.0, "scatters by 100 um from reading to reading, allowed 2 um"),
        ("0.700000000", 1e-4, 1000.0, "is it in mm? Then set topics.length_unit: mm"),
        ("5.000000000", 1e-7, 1000.0, "times the longest of the plan: is it in mm?"),
        ("0.350000000", 1e-7, 2.0, "comes at 2 Hz: the 20 readings of a window take 10 s"),
    ],
)
def test_the_unit_and_the_rate_of_lengths_show_without_a_motion(length, scatter, rate, words):
    values = {
        **GOOD, "now.tracer_length": f"{length} OK", "scatter_m.tracer_length": f"{scatter}",
        "rate_hz.tracer_length": f"{rate}",
    }  # fmt: skip
    found = instrument_warnings(values, TRACER, prepare(TRACER))
    assert (found == []) == (words is None)
    assert words is None or any(words in doubt for doubt in found), found


def test_a_slow_motion_and_a_jump_are_no_scatter():
    rng = np.random.default_rng(1)
    noise = rng.normal(0.0, 3e-7, 200)
    moved = 0.5 + 1e-5 * np.arange(200) + 0.1 * (np.arange(200) > 150)
    assert reading_scatter(moved + noise) == pytest.approx(3e-7, rel=0.25)
    assert reading_scatter(noise[:5]) is None
