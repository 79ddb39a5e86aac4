"""tf against the solution: a cell whose true geometry is known, in the machine's frame."""

from dataclasses import replace
from math import cos, pi, radians, sin
from pathlib import Path

import pytest

import rotcal_ros as rc
from rotcal_ros.geometry.frames import StaticFrame
from rotcal_ros.methods import prepare
from rotcal_ros.methods.calibration import frame_conflicts
from rotcal_ros.methods.configuration import changed, read_configuration

CONFIG = Path(__file__).parents[2] / "config" / "tracer_paper.yaml"
NO_TURN = (0.0, 0.0, 0.0, 1.0)
SMALL = ("plan.table_positions=6", "plan.box_points=[3, 2, 2]")


@pytest.fixture(scope="module")
def solved():
    """A tracer's calibration, simulated: the axis is z of the machine, the tracer at mount_m."""
    configuration = changed(read_configuration(CONFIG), SMALL)
    calibration = prepare(configuration)
    observations = rc.simulate_observations(configuration)
    return calibration, observations, configuration.simulation.tracer.mount_m


def conflicts(solved, *frames, **cell):
    calibration, observations, _ = solved
    given = calibration.configuration
    configured = replace(given, cell=replace(given.cell, **cell))
    return frame_conflicts(
        configured.cell, calibration.plan, calibration.solve(observations), frames
    )


def base(*translation, rotation=NO_TURN):
    return StaticFrame("machine", "table_base", translation, rotation)


def test_the_truth_is_no_conflict(solved):
    mount = StaticFrame("table_base", "tracer", tuple(solved[2]), NO_TURN)
    assert conflicts(solved, base(0.0, 0.0, 0.0), mount) == ()
    assert conflicts(solved, base(0.0, 0.0, -0.7)) == ()  # the axis goes through that, too
    assert conflicts(solved) == ()
    assert conflicts(solved, StaticFrame("map", "odom", (9.0, 9.0, 9.0), NO_TURN)) == ()


def test_a_table_that_tf_has_elsewhere_is_told_with_the_distance(solved):
    (text,) = conflicts(solved, base(0.03, 0.04, 0.2))
    assert "tf has table_base in machine at (0.0300, 0.0400, 0.2000) m, 50." in text
    assert "mm from the axis of the solution" in text
    assert conflicts(solved, base(0.003, 0.004, 0.2)) == ()


def test_an_axis_that_tf_has_in_another_direction_is_told_with_the_angle(solved):
    half = radians(1.5)
    (text,) = conflicts(solved, base(0.0, 0.0, 0.0, rotation=(sin(half), 0.0, 0.0, cos(half))))
    assert "3.0" in text
    assert "degrees from the axis of the solution" in text
    (text,) = conflicts(solved, base(0.0, 0.0, 0.0, rotation=(1.0, 0.0, 0.0, 0.0)))
    assert "180.00 degrees" in text or "179.99 degrees" in text


def test_a_tracer_that_tf_has_elsewhere_is_told(solved):
    x, y, z = solved[2]
    (text,) = conflicts(solved, StaticFrame("machine", "tracer", (x, y, z + 0.02), NO_TURN))
    assert "tf has tracer in machine at" in text
    assert "that is 20." in text
    turned = StaticFrame("machine", "tracer", (-x, -y, z), NO_TURN)  # by half a turn
    assert len(conflicts(solved, turned)) == 1


def test_other_names_are_those_of_the_configuration(solved):
    frame = StaticFrame("cmm", "rotary", (0.5, 0.0, 0.0), NO_TURN)
    assert conflicts(solved, frame) == ()
    names = {"machine_frame": "cmm", "table_frame": "rotary"}
    assert "500." in conflicts(solved, frame, **names)[0]


def test_a_conflict_is_a_warning_of_the_result_and_changes_nothing_else(solved):
    calibration, observations, _ = solved
    plain = calibration.solve(observations)
    warned = calibration.solve(observations, (), [base(1.0, 0.0, 0.0)])
    (text,) = set(warned.warnings) - set(plain.warnings)
    assert "table_base" in text
    assert warned.verdict == plain.verdict
    assert (warned.deviations["ECC"] == plain.deviations["ECC"]).all()


def test_a_method_that_finds_no_axis_is_not_compared(solved):
    calibration, observations, _ = solved
    result = replace(calibration.solve(observations), placement=None)
    cell = calibration.configuration.cell
    assert frame_conflicts(cell, calibration.plan, result, [base(pi, 0.0, 0.0)]) == ()
