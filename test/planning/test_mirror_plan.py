"""The plan of the plane mirror: stations, overlaps, incidence, pauses."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.methods import changed, prepare, read_configuration
from rotcal_ros.methods.plane_mirror.mirror_physics import incidence
from rotcal_ros.methods.plane_mirror.plan import mirror_plan, station_visits
from rotcal_ros.methods.plane_mirror.settings import MirrorPlanSettings

NESTS = (1.5, 0.5, 0.1, 0.4, 1.7, 0.6, -1.4, 1.3, 1.0, -2.0, -0.6, 0.1, -0.3, -1.6, 0.6)
PAPER = MirrorPlanSettings(table_step_deg=22.5, table_positions=17, nests_m=NESTS)


def test_the_stations_of_the_paper() -> None:
    """Positions 1-4, 4-7, 7-10, 10-13, 13-16 and 16-17, counted from one."""
    visits = station_visits(17, 4, 1)
    assert [(v[0] + 1, v[-1] + 1) for v in visits] == [
        (1, 4), (4, 7), (7, 10), (10, 13), (13, 16), (16, 17),
    ]  # fmt: skip


def test_each_station_measures_nests_then_reflector_and_image_then_nests_again() -> None:
    plan = mirror_plan(replace(PAPER, reflectors=2))
    assert [p.first for p in plan.pauses if p.again_from is None] == [0, 26, 52, 78, 104, 130]
    assert len(plan.steps) == 6 * 5 * 2 + 22 * 2 * 2
    block = plan.steps[26:52]
    assert {s.station for s in block} == {1}
    nests = [(PointKind.NEST, n) for n in range(1, 6)]
    assert [(s.kind, s.target) for s in block[:5]] == nests
    assert [(s.kind, s.target) for s in block[-5:]] == nests
    assert [(s.table_position, s.kind, s.target) for s in block[5:10]] == [
        (3, PointKind.DIRECT, 1),
        (3, PointKind.MIRRORED, 1),
        (3, PointKind.DIRECT, 2),
        (3, PointKind.MIRRORED, 2),
        (4, PointKind.DIRECT, 1),
    ]
    assert plan.pauses[2].last == 30
    assert plan.pause_before(26) is plan.pauses[2]
    assert plan.pause_before(27) is None
    assert block[0].command(0).station == 1
    # The table stands where the station before left it, and stays there for the closing nests.
    assert block[0].table_angle == plan.steps[25].table_angle
    assert {s.table_angle for s in block[-5:]} == {block[-6].table_angle}


def test_closing_nests_are_judged_and_a_bad_station_is_measured_again_whole() -> None:
    plan = mirror_plan(replace(PAPER, reflectors=2))
    closing = plan.pauses[3]
    assert (closing.first, closing.last, closing.again_from) == (47, 51, 26)
    assert "leave the tracker where it is" in closing.instruction


def test_nests_are_measured_in_between_where_a_station_takes_long() -> None:
    plan = mirror_plan(replace(PAPER, nests_every=2))
    block = [s for s in plan.steps if s.station == 0]
    kinds = [s.kind == PointKind.NEST for s in block]
    assert kinds == [True] * 5 + [False] * 4 + [True] * 5 + [False] * 4 + [True] * 5
    assert {s.table_position for s in block[9:14]} == {1}
    # The last station has two positions: there is nothing in between.
    assert sum(s.kind == PointKind.NEST for s in plan.steps if s.station == 5) == 10


def test_without_closing_nests_each_station_measures_them_once() -> None:
    once = mirror_plan(replace(PAPER, reflectors=2, closing_nests=False))
    assert len(once.steps) == 6 * 5 + 22 * 2 * 2
    assert [p.first for p in once.pauses] == [0, 21, 42, 63, 84, 105]


def test_the_tracker_stands_where_it_is_put_in_plans_of_both_directions_too() -> None:
    demo = read_configuration(Path(__file__).parents[2] / "config" / "plane_mirror_demo.yaml")
    calibration = prepare(changed(demo, ["plan.bidirectional=true"]))
    plan = calibration.plan
    put = [pause.move.position for pause in plan.pauses if pause.move is not None]
    assert list(dict.fromkeys(calibration.instrument_place(step) for step in plan.steps)) == put


def test_the_instruction_names_place_nests_and_positions() -> None:
    text = mirror_plan(PAPER).pauses[2].instruction
    assert "place 2 of 6 (number 1 in the data)" in text
    # Middle of the positions 67.5 to 135 deg: the tracker faces the mirror there.
    assert f"x {2 * math.cos(101.25 * DEGREE):.2f}, y {2 * math.sin(101.25 * DEGREE):.2f}" in text
    assert "nests 1 to 5 and table positions 67.5 to 135 deg" in text


def test_the_reflector_is_on_the_reflected_beam() -> None:
    plan = mirror_plan(PAPER)
    step = next(s for s in plan.steps if s.station == 2 and s.kind == PointKind.MIRRORED)
    angle = step.table_angle
    normal = np.array([math.cos(angle), math.sin(angle), 0.0])
    centre = 0.05 * normal + [0.0, 0.0, 0.15]
    azimuth = 168.75 * DEGREE
    station = np.array([2 * math.cos(azimuth), 2 * math.sin(azimuth), 0.35])
    to_station = (station - centre) / np.linalg.norm(station - centre)
    to_reflector = (np.array(step.position) - centre) / 1.5
    np.testing.assert_allclose(np.linalg.norm(to_reflector), 1.0)
    half_way = to_station + to_reflector
    np.testing.assert_allclose(half_way / np.linalg.norm(half_way), normal, atol=1e-12)
    frame = np.column_stack([np.zeros((3, 2)), normal])
    assert incidence(station, centre, frame) == pytest.approx(math.acos(to_station @ normal))


def test_a_mirror_turned_past_its_range_is_refused_with_station_and_position() -> None:
    with pytest.raises(PlanError) as error:
        mirror_plan(replace(PAPER, positions_per_station=6))
    assert "from tracker station 0" in str(error.value)
    assert "position 0 (0 deg) at 57.6 deg of incidence, allowed 50" in str(error.value)
    mirror_plan(replace(PAPER, positions_per_station=6, incidence_limit_deg=60.0))


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"nests_m": NESTS[:4]}, "nests_m has 4 values, expected x y z"),
        ({"nests_m": NESTS[:6]}, "2 nests, the registration needs at least three"),
        ({"nests_m": (0, 0, 0, 1, 1, 0.1, 2, 2, 0.21)}, "the 3 nests lie in a line"),
        ({"shared_positions": 4}, "no station would get on"),
        ({"station_azimuths_deg": (0.0, 90.0)}, "6 tracker stations .* names 2"),
        ({"carries": "reflectors"}, "table_reflectors_m names none"),
        ({"table_angles_deg": (0.0, 20.0, 10.0)}, "ascend"),
    ],
)
def test_impossible_plans_are_refused(changes: dict[str, object], text: str) -> None:
    with pytest.raises(PlanError, match=text):
        mirror_plan(replace(PAPER, **changes))


def test_one_station_needs_no_nests() -> None:
    plan = mirror_plan(replace(PAPER, table_positions=4, nests_m=()))
    assert {s.kind for s in plan.steps} == {PointKind.DIRECT, PointKind.MIRRORED}
    assert (plan.pauses[0].first, plan.pauses[0].last) == (0, -1)


def test_one_station_measures_nests_to_show_its_drift() -> None:
    plan = mirror_plan(replace(PAPER, table_positions=4))
    assert [(p.first, p.last) for p in plan.pauses] == [(0, 4), (13, 17)]


def test_reflectors_on_the_table_turn_with_it() -> None:
    plan = mirror_plan(
        replace(
            PAPER,
            carries="reflectors",
            positions_per_station=17,
            nests_m=(),
            table_reflectors_m=(0.3, 0.0, 0.1, -0.2, 0.1, 0.1),
        )
    )
    assert {s.kind for s in plan.steps} == {PointKind.DIRECT}
    quarter = [s for s in plan.steps if s.table_position == 4]
    assert [s.target for s in quarter] == [1, 2]
    np.testing.assert_allclose(quarter[0].position, (0.0, 0.3, 0.1), atol=1e-12)
    np.testing.assert_allclose(quarter[1].position, (-0.1, -0.2, 0.1), atol=1e-12)


@pytest.mark.parametrize("name", ["nests_m", "table_reflectors_m"])
def test_coordinates_come_in_threes(name: str) -> None:
    settings = replace(PAPER, carries="reflectors", table_reflectors_m=(0.1, 0.0, 0.2))
    with pytest.raises(PlanError, match=f"plan: {name} has 4 values, expected x y z of each"):
        mirror_plan(replace(settings, **{name: (1.0, 2.0, 3.0, 4.0)}))
