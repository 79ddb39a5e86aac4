"""The plan of six deviations: places of the tracer, order, pauses, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.methods import changed, prepare_to_measure, read_configuration
from rotcal_ros.methods.tracer.lengths import times_before
from rotcal_ros.methods.tracer_six.plan import places_of, six_plan
from rotcal_ros.methods.tracer_six.settings import SixPlanSettings

CONFIG = Path(__file__).parents[2] / "config"
SMALL = SixPlanSettings(table_positions=4, table_step_deg=90.0, box_points=(2, 2, 2))
BY_TARGET = replace(SMALL, order="stations_per_target")


def made(*changes):
    """Return the calibration of the demonstration with changes."""
    return prepare_to_measure(
        changed(read_configuration(CONFIG / "tracer_six_demo.yaml"), changes)
    )


def test_the_demonstration_is_the_issue_s_measurement():
    plan = made().plan
    assert len(plan.steps) == 24 * 12 * 3
    assert len(prepare_to_measure(read_configuration(CONFIG / "tracer_six.yaml")).plan.steps) == (
        12 * 24 * 3
    )


def test_places_are_even_around_the_axis_and_climb():
    settings = SixPlanSettings(place_azimuth_deg=30.0, place_height_step_m=0.05)
    places = np.array(places_of(settings))
    np.testing.assert_allclose(np.hypot(*places[:, :2].T), 0.15)
    np.testing.assert_allclose(np.degrees(np.arctan2(*places[:, 1::-1].T)), [30.0, 150.0, -90.0])
    np.testing.assert_allclose(places[:, 2], [0.12, 0.17, 0.22])
    given = replace(settings, places_m=(0.1, 0.0, 0.1, 0.0, 0.1, 0.1, 0.0, -0.1, 0.2))
    assert places_of(given) == ((0.1, 0.0, 0.1), (0.0, 0.1, 0.1), (0.0, -0.1, 0.2))


def test_from_each_place_all_targets_at_each_angle():
    plan = six_plan(replace(SMALL, arrivals=2, closes=True))
    assert [step.station for step in plan.steps] == [0] * 72 + [1] * 72 + [2] * 72
    first = plan.steps[:72]
    assert [step.table_position for step in first[::8]] == [0, 1, 2, 3, 0, 1, 2, 3, 0]
    assert [step.target for step in first[:16]] == [*range(8), *range(8)]
    assert first[9].command(0).station == 0
    assert plan.steps[80].command(0).station == 1
    assert times_before(plan)[:72:8].tolist() == [0, 0, 0, 0, 1, 1, 1, 1, 2]


def test_or_all_angles_at_each_target_and_again_the_first():
    plan = six_plan(replace(BY_TARGET, closes=True))
    first = plan.steps[:40]
    assert [step.table_position for step in first[:10]] == [0, 1, 2, 3, 0] * 2
    assert [step.target for step in first[::5]] == [*range(8)]
    assert times_before(plan)[:10].tolist() == [0, 0, 0, 0, 1] * 2


def test_a_person_fixes_the_tracer_at_every_place_and_the_first_lengths_show_it():
    plan = six_plan(SMALL)
    assert [(p.first, p.last) for p in plan.pauses] == [(0, 7), (32, 39), (64, 71)]
    text = plan.pauses[1].instruction
    assert text.startswith("fix the tracer at place 2 of 3 (number 1 in the data) on the table, ")
    assert (
        "150 mm from the table axis towards 120 deg of the table, its centre 120 mm above it"
        in text
    )
    assert "8 targets at 4 table angles" in text
    # Six targets at the first angle are enough; the sweeps of five lie between.
    by_target = six_plan(BY_TARGET).pauses[0]
    assert (by_target.first, by_target.last) == (0, 20)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (["plan.places=1"], "1 place"),
        (["plan.places=2"], r"the 2 places: a turn of the table about the line through them "
         r"\(1.000, 0.000, 0.000\) moves none of them.*no length determines the tilt.*r.tilt"),
        (["plan.places_m=[0.15, 0, 0.1, -0.15, 0, 0.1, 0.05, 0, 0.1]"], "3 places lie in a line"),
        (["plan.places_m=[0.1, 0, 0.1, 0.1, 0, 0.2, 0.1, 0, 0.3]"],
         r"\(0.000, 0.000, 1.000\).*no length determines ECC"),
        (["plan.places_m=[0.1, 0, 0.1, 0.1]"], "4 values, expected x y z"),
        (["plan.targets_m=[0.1, 0]"], "2 values, expected x y z"),
        (["plan.arrivals=2", "plan.order=stations_per_target"], "several arrivals need the order"),
        (["plan.box_points=[5, 1, 1]"], "5 targets: .* at least 6"),
        (["plan.box_size_m=[1.2, 0, 0.5]"], "24 targets at 8 places"),
        (["plan.table_positions=2"], "2 table angles"),
    ],
    ids=str,
)  # fmt: skip
def test_what_loses_a_deviation_is_refused_before_anything_moves(changes, words):
    with pytest.raises(PlanError, match=rf"tracer_six_demo\.yaml.*{words}"):
        made(*changes)


def test_two_places_are_enough_where_the_tilt_is_stated_and_lost():
    assert made("plan.places=2", "solver.tilt_std_rad=1e-6").plan.steps
    above = "plan.places_m=[0.1, 0, 0.1, 0.1, 0, 0.2]"
    with pytest.raises(PlanError, match="no length determines ECC"):
        made(above, "solver.tilt_std_rad=1e-6")
