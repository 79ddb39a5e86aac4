"""A plan whose data could never be solved is refused before anything moves."""

from dataclasses import replace
from pathlib import Path

import pytest

from rotcal_ros.foundation.errors import ConfigurationError, ObservabilityError, PlanError
from rotcal_ros.methods import changed, prepare_to_measure, read_configuration

CONFIG = Path(__file__).parents[2] / "config"
FREE = "solver.datum=free"
ONE_STOP = ("plan.order=targets_per_station", "plan.table_step_deg=60.0")
PLATE = ("plan.plate.grid=12", "plan.plate.ball_steps=[0, 1, 3, 5, 8, 9]", "plan.rounds=1")


def made(name, *changes):
    """Return the calibration of a demonstration with changes."""
    return prepare_to_measure(changed(read_configuration(CONFIG / f"{name}.yaml"), changes))


@pytest.mark.parametrize(
    ("name", "changes", "words"),
    [
        ("tracer_paper", ["plan.table_positions=2"], "2 stations"),
        ("tracer_paper", ["plan.table_positions=3"], "3 stations"),
        ("tracer_paper", ["plan.box_points=[3, 1, 1]"], "0 stations with at least 4 usable"),
        # 55 lengths, 44 + 15 unknowns
        ("tracer_paper", [FREE, "plan.box_points=[5, 1, 1]"], "55 usable lengths from 11"),
        # 4 stations: 4 x 15 = 60 lengths, 16 + 45 = 61 unknowns
        ("tracer_paper", [FREE, "plan.table_positions=4", "plan.box_points=[5, 3, 1]"],
         "= 61 unknowns"),
        ("tracer_paper", ["plan.box_size_m=[0, 0, 0]"], "64 targets at 1 places"),
        ("tracer_paper", ["plan.box_size_m=[0.4, 0, 0.4]"], "64 targets at 16 places"),
        ("tracer_paper", ["plan.box_points=[5, 1, 1]"], "5 targets lie in a line"),
        ("tracer_paper", ["plan.box_points=[1, 1, 9]"], "9 targets lie in a line"),
        ("tracer_paper", ["plan.box_points=[2, 2, 1]"], "4 targets in one plane"),
        ("tracer_paper", ["plan.box_points=[2, 1, 2]"], "4 targets in one plane"),
        ("plane_mirror_demo", ["plan.table_positions=2"], "2 table angles: the plane in which"),
        ("tracer_six_demo", ["plan.table_positions=2"], "2 table angles"),
        ("tracer_six_demo", ["plan.box_points=[5, 1, 1]"], "5 targets"),
        ("tracer_paper", [*ONE_STOP, "plan.runs=3", "plan.table_positions=2"], "2 table angles"),
        ("plane_mirror_demo", ["solver.range_std_m=0", "solver.range_std_relative=0"],
         "solver: .*range_std_m and range_std_relative"),
        ("plane_mirror_demo", ["solver.transverse_std_m=0", "solver.transverse_std_relative=0"],
         "solver: .*transverse_std_m and transverse_std_relative"),
        ("ball_plate_demo", ["plan.cmm_positions=[0, 1]"], "fewer than 3 balls"),
        ("ball_plate_demo", [*PLATE, "plan.cmm_positions=[0, 3, 6]"], "fewer than 3 balls"),
    ],
    ids=str,
)  # fmt: skip
def test_it_is_refused_with_its_place(name, changes, words):
    with pytest.raises((ConfigurationError, PlanError), match=rf"{name}\.yaml.*{words}"):
        made(name, *changes)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        # 4 x 16 = 64 lengths, 16 + 48 unknowns
        ("tracer_paper", [FREE, "plan.table_positions=4", "plan.box_points=[4, 4, 1]"]),
        # the machine gives the targets: 4 lengths of a station for its place and zero, one more
        ("tracer_paper", ["plan.table_positions=4", "plan.box_points=[3, 2, 1]"]),
        ("plane_mirror_demo", ["plan.table_positions=3"]),
        ("tracer_six_demo", ["plan.table_positions=3"]),
        ("tracer_paper", ["plan.box_size_m=[0.4, 0, 0.4]", "plan.box_points=[4, 1, 4]"]),
        ("tracer_paper", [*ONE_STOP, "plan.runs=2", "plan.table_positions=3"]),
        ("plane_mirror_demo", ["solver.range_std_m=0", "solver.transverse_std_relative=0"]),
        ("ball_plate_demo", [*PLATE, "plan.cmm_positions=[0, 1, 2, 3, 4, 5, 6, 7]"]),
    ],
    ids=str,
)
def test_the_least_that_can_be_solved_is_taken(name, changes):
    assert made(name, *changes).plan.steps


def test_where_too_little_of_a_plan_was_accepted_the_error_says_why():
    calibration = made("angle_comparison_demo")
    whole = calibration.nominal_observations()
    assert len(whole) == 3 * 13
    dark = [replace(o, accepted=False, reason="no light") for o in whole[:38]]
    late = [replace(o, accepted=False, reason="too late") for o in whole[:3]]
    with pytest.raises(
        ObservabilityError,
        match=r"; 38 of 39 steps have no accepted observation, most often because no light$",
    ):
        calibration.solve([*late, *dark, whole[38]])
    with pytest.raises(ObservabilityError, match=r"38 of 39 steps have no accepted observation$"):
        calibration.solve(whole[38:])
