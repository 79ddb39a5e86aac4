"""The plan of a ball plate: where each ball is when the table has turned there."""

import numpy as np
import pytest

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.observations import Approach, PointKind
from rotcal_ros.methods.ball_plate.plan import ball_plate_plan, measuring_order
from rotcal_ros.methods.ball_plate.settings import CENTRE, BallPlatePlanSettings, Plate

PLATE = Plate(grid=12, ball_steps=(0, 3, 4, 8), circle_radius_m=0.2, ball_diameter_m=0.025)
AXIS = (1.0, -2.0, 0.5)


def plan(**changes):
    return ball_plate_plan(
        BallPlatePlanSettings(plate=PLATE, centre_m=AXIS, table_start_deg=40.0, **changes)
    )


@pytest.mark.parametrize(
    "changes",
    [{}, {"order": "probe_rests"}, {"rounds": 3}, {"backlash": False}, {"order": "table_once"}],
)
def test_the_table_brings_each_ball_to_its_place(changes):
    """A ball at plate angle b stands at b plus the turn of the table from its start."""
    made = plan(**changes)
    assert [step.index for step in made.steps] == list(range(4 * 12 + 4))
    assert {step.table_position for step in made.steps[-4:]} == {made.steps[0].table_position}
    for step in made.steps:
        turn = step.table_angle - np.radians(40.0)
        angle = np.radians(30.0 * step.target) + turn
        place = np.array(AXIS) + 0.2 * np.array([np.cos(angle), np.sin(angle), 0.0])
        assert step.position == pytest.approx(place, abs=1e-12)
        assert step.table_position == round(np.degrees(turn) / 30.0) % 12
        assert (step.kind, step.n_points, step.ball_diameter) == (PointKind.SURFACE, 15, 0.025)
        assert step.approach == (
            Approach.POSITIVE if changes.get("backlash", True) else Approach.UNKNOWN
        )
    met = {(step.table_position, step.target) for step in made.steps}
    assert met == {(k, ball) for k in range(12) for ball in PLATE.ball_steps}


def test_angles_and_targets_are_those_of_the_grid():
    made = plan()
    assert np.degrees(made.table_angles) == pytest.approx(40.0 + 30.0 * np.arange(12))
    angle = np.radians(30.0 * np.arange(12))
    places = np.column_stack([1 + 0.2 * np.cos(angle), -2 + 0.2 * np.sin(angle), 0.5 + 0 * angle])
    np.testing.assert_allclose(made.targets, places, atol=1e-12)
    assert made.method == "ball_plate"


def test_only_the_wanted_positions_are_measured():
    made = plan(cmm_positions=(2, 7))
    assert len(made.steps) == 8  # no position has the three balls that closing needs
    wanted = {tuple(np.round(made.targets[k], 9)) for k in (2, 7)}
    assert {tuple(np.round(step.position, 9)) for step in made.steps} == wanted


def test_a_machine_that_computes_centres_gives_one_point():
    step = plan(measure=CENTRE).steps[0]
    assert (step.kind, step.n_points) == (PointKind.CENTRE, 1)
    assert plan(points_per_ball=9).steps[0].n_points == 9


def test_the_probe_that_rests_lets_the_table_travel_more():
    visiting = BallPlatePlanSettings(plate=PLATE, order="table_once", closing=False)
    resting = BallPlatePlanSettings(plate=PLATE, order="probe_rests", closing=False)
    assert measuring_order(visiting).table_travel == pytest.approx(2 * np.pi)
    assert measuring_order(resting).table_travel > 2 * np.pi
    assert measuring_order(visiting).duration < measuring_order(resting).duration


def test_a_plate_that_cannot_be_is_refused():
    wrong = Plate(grid=12, ball_steps=(0, 3, 12), circle_radius_m=0.2, ball_diameter_m=0.025)
    with pytest.raises(ConfigurationError, match=r"plan\.plate"):
        ball_plate_plan(BallPlatePlanSettings(plate=wrong))
