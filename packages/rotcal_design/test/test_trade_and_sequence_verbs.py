"""``rotcal plan trade`` and ``rotcal plan sequence``."""

import json
from dataclasses import replace
from math import ceil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from rotcal_design.trades import USUAL_MIRROR, USUAL_TURNS, mirror_trade, turning_trade
from rotcal_design.verbs.sequence import best_order
from rotcal_ros.cli.plan import command
from rotcal_ros.foundation.errors import ConfigurationError, PlanError
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods import prepare
from rotcal_ros.methods.configuration import changed, parse_configuration
from rotcal_ros.methods.tracer.policy.sequence import Forecast, MeasuringOrder
from rotcal_ros.methods.tracer.table import read_pairs

CONFIG = Path(__file__).parents[3] / "config"


def run(*arguments):
    return CliRunner().invoke(command, [str(a) for a in arguments], standalone_mode=False)


def data_of(*arguments):
    done = run(*arguments, "--json")
    if done.exception:
        raise done.exception
    return json.loads(done.stdout)


@pytest.mark.slow
def test_the_mirrors_hours_and_uncertainties_are_the_known_ones():
    """6 stations with a reflector: 1.28 arcsec in 1.5 h; more reflectors replace stations.

    The statement that the tracker may swing between its nests, 0.5 arcsec, is beside the noise.
    """
    still = changed(parse_configuration(USUAL_MIRROR), ["solver.uneven_drift_std_arcsec=0"])
    rows = mirror_trade(still, [4, 6], [1, 3], move_s=600.0, pair_s=50.0, nest_s=10.0)
    noise = {(row.stations, row.reflectors): row.expanded for row in rows}
    assert np.degrees(noise[6, 1]) * 3600.0 == pytest.approx(1.28, rel=0.03)
    assert np.degrees(noise[4, 3]) * 3600.0 < 0.87
    ways = data_of("trade", "mirror", "--stations", "4,6", "--reflectors", "1,3")["ways"]
    found = {(way["stations"], way["reflectors"]): way for way in ways}
    six = found[6, 1]
    for way, own in found.items():
        assert noise[way] < own["expanded"] < np.hypot(noise[way], 2.0 * 0.5 * ARCSEC), way
    assert six["seconds"] / 3600.0 == pytest.approx(1.5, abs=0.02)
    # 17 positions and 5 shared, six nests twice at each of six stations
    assert (six["pairs"], six["nests"]) == (22, 72)
    more = found[4, 3]
    assert more["seconds"] == 4 * 600.0 + 60 * 50.0 + 48 * 10.0
    assert [way["seconds"] for way in ways] == sorted(way["seconds"] for way in ways)


@pytest.mark.slow
def test_turning_and_standing_stand_side_by_side():
    """120 angles of white lengths, 65 mm off the axis: 0.13 arcsec (docs/tracer_turning.md)."""
    quiet = changed(parse_configuration(USUAL_TURNS), ["solver.length_std_m=3.5e-8"])
    rows = turning_trade([quiet], [4, 8], [12])
    found = {(row.stands, row.targets): row for row in rows}
    turns, stands = found[False, 4], found[True, 4]
    assert np.degrees(turns.expanded) * 3600.0 == pytest.approx(0.135, rel=0.1)
    assert found[False, 8].expanded < turns.expanded
    # from 15 deg before 0 to 15 deg behind 357 at 12 deg/s, after 5 s at rest
    assert turns.seconds == pytest.approx(4 * 2 * (387.0 / 12.0 + 5.0), rel=1e-9)
    assert (turns.lengths, stands.lengths) == (4 * 2 * 120, 4 * 2 * 12)
    assert [row.seconds for row in rows] == sorted(row.seconds for row in rows)
    with pytest.raises(PlanError, match=r"none of \[9\] targets"):
        turning_trade([quiet], [9], [12])
    with pytest.raises(ConfigurationError, match="a tracer on a table that turns is traded"):
        turning_trade([parse_configuration(USUAL_MIRROR)], [4], [12])


@pytest.mark.slow
def test_one_place_and_three_are_traded_side_by_side():
    ways = ("trade", "turning", "--targets", "4,6", "--angles", "6")
    shown = run(*ways).output
    found = {(w["places"], w["stands"], w["targets"]): w for w in data_of(*ways)["ways"]}
    assert set(found) == {
        (1, False, 4), (1, False, 6), (1, True, 4), (1, True, 6),
        (3, False, 4), (3, False, 6), (3, True, 6),
    }  # fmt: skip
    assert "3 places and 4 targets: only while the table turns" in shown
    turns, stands = found[3, False, 6], found[3, True, 6]
    # three moves by hand; each target there and back, from 15 deg before 0 to 15 deg behind 350
    assert turns["seconds"] == pytest.approx(3 * 90.0 + 3 * 6 * 2 * (380.0 / 12.0 + 5.0))
    assert (turns["lengths"], stands["lengths"]) == (3 * 6 * 2 * 36, 3 * 6 * 2 * 6)
    assert found[1, False, 4]["shift"] is None
    for row in (turns, stands):
        assert 0.02e-6 < row["shift"] < 0.3e-6
        assert 0.02 * ARCSEC < row["lean"] < 0.5 * ARCSEC


def usual_mirror(swing):
    """Return the plan of four stations with three reflectors, and a statement of the swings."""
    usual = parse_configuration(USUAL_MIRROR)
    each = ceil((usual.plan.table_positions - usual.plan.shared_positions) / 4)
    return changed(usual, [
        f"plan.positions_per_station={each + usual.plan.shared_positions}", "plan.reflectors=3",
        f"solver.uneven_drift_std_arcsec={swing}",
    ])  # fmt: skip


def traded(swing):
    (row,) = mirror_trade(usual_mirror(swing), [4], [3], move_s=600.0, pair_s=50.0, nest_s=10.0)
    return row.expanded


@pytest.mark.slow
def test_the_more_a_tracker_may_swing_the_larger_is_the_uncertainty_of_a_mirror():
    assert (np.diff([traded(swing) for swing in (0.0, 0.5, 2.0, 5.0, 7.0, 10.0)]) > 0.0).all()


@pytest.mark.slow
def test_a_mirror_is_traded_for_what_its_result_states():
    """Of points that scatter as the tracker does, in a run that contradicts no statement."""
    calibration, rng = prepare(usual_mirror(0.5)), np.random.default_rng(0)
    solver, seen = calibration.configuration.solver, []
    for exact in calibration.nominal_observations():
        place, white = np.array(exact.mean), rng.standard_normal(3)
        distance = np.linalg.norm(place)
        beam = place / distance
        along = (solver.range_std_m + solver.range_std_relative * distance) * (white @ beam)
        across = solver.transverse_std_m + solver.transverse_std_relative * distance
        place = place + along * beam + across * (white - (white @ beam) * beam)
        seen.append(replace(exact, mean=tuple(place)))
    result = calibration.solve(seen)
    assert set(result.details["noise"].values()) == {1.0}
    turn = np.eye(len(result.angles)) - 1.0 / len(result.angles)
    expanded = 2.0 * np.sqrt(np.diag(turn @ result.covariance["ECC"] @ turn).mean())
    assert traded(0.5) == pytest.approx(expanded, rel=1e-4)


def test_stations_that_see_nothing_are_refused():
    with pytest.raises(PlanError, match=r"none of \[2\] tracker stations"):
        data_of("trade", "mirror", "--stations", "2")


def test_balls_of_a_perfect_table_reach_the_bound_and_take_what_is_stated(tmp_path):
    """Of one ball that only the noise keeps from giving the axis: a circle is the best plan."""
    setup = tmp_path / "setup.yaml"
    setup.write_text(
        "method: table_balls\nballs_m: [[0.15, 0.0, 0.08]]\naxis_m: [0.0, 0.0, 0.08]\n"
        "closing: false\nerror_motion_std_m: 1.0e-9\ntilt_std_arcsec: 0.001\n"
        "scale_std_um_per_m: 0.001\nsquareness_std_um_per_m: 0.001\n"
    )
    options = ("--angles", "4,12", "--runs", "1,2", "--touch-s", "2", "--way-s", "3")
    ways = data_of("trade", "balls", str(setup), *options, "--turn-deg-s", "10")["ways"]
    assert {way["balls"] for way in ways} == {1}
    for way in ways:
        assert way["bound"] == pytest.approx(2e-6 / np.sqrt(way["centres"]))
        # both coordinates share the radius, which is not known: sin and cos, each n / 2
        assert way["bound"] <= way["place"] < 1.5 * way["bound"]
        assert way["touches"] == 5 * way["centres"] == 5 * way["angles"] * way["runs"]
        turned = 360.0 * way["runs"] - 360.0 / way["angles"]
        assert way["seconds"] == pytest.approx(13.0 * way["centres"] + turned / 10.0)
    done = run("trade", "balls", str(setup), *options, "--need-um", "1.0")
    assert "fewest touches for U <= 1 um: " in done.stderr
    done = run("trade", "balls", str(setup), *options, "--need-um", "0.001")
    assert "none of these reaches 0.001 um within 15 minutes" in done.stderr
    with pytest.raises(PlanError, match="none of these numbers of balls"):
        data_of("trade", "balls", str(setup), "--balls", "3")


def test_tables_for_people():
    done = run("trade", "plate", "--grid", "12", "--balls", "6")
    assert done.exception is None
    assert done.stdout.startswith("balls,centres,hours,U/arcsec,or R/mm,or sigma/um")
    assert "11 to 11 % of the centres" in done.stderr
    done = run("trade", "tracer", "--radius-m", "0.1", "--sigma-um", "0.1", "--need-arcsec", "2")
    assert done.exception is None
    assert "R/mm,sigma/um,targets,lengths,no plan below" in done.stdout


@pytest.mark.parametrize("text", ["", "0,1", "x", "-1"])
def test_lists_are_of_positive_numbers(text):
    with pytest.raises(PlanError, match=r"expected (positive )?numbers"):
        data_of("trade", "tracer", f"--sigma-um={text}")


def test_numbers_of_balls_are_whole():
    with pytest.raises(PlanError, match="expected whole numbers"):
        data_of("trade", "plate", "--balls", "6.5")


def test_the_order_of_a_plan_is_found_and_written(tmp_path):
    order = ["plan.order=targets_per_station", "plan.box_points=[2, 2, 2]"]
    changes = [part for change in order for part in ("--set", change)]
    written = tmp_path / "pairs.csv"
    demo = CONFIG / "tracer_paper.yaml"
    found = data_of("sequence", demo, *changes, "--limit", "1e9", "-o", written)
    assert found["lengths"] == 88
    assert found["listed_s"] == pytest.approx(87 * 5.0 + 10 * 10.0, abs=0.01)
    assert found["bound_s"] == pytest.approx(found["listed_s"], abs=0.01)
    assert found["best"] == "closed"  # nothing bounds what drifts in the quickest
    pairs = np.reshape(read_pairs(written), (-1, 2))
    assert {tuple(pair) for pair in pairs.tolist()} == {
        (j, i) for j in range(11) for i in range(8)
    }
    assert (np.diff(pairs[:, 0]) != 0).sum() == 11


def test_only_tracer_plans_have_such_orders():
    with pytest.raises(ConfigurationError, match="only plans of a laser tracer"):
        data_of("sequence", CONFIG / "ball_plate_demo.yaml")


def test_an_order_that_hides_less_than_asked_for_is_needed():
    way = MeasuringOrder("closed", np.arange(2), 1.0, 1.0, Forecast(0.5, 1.5))
    assert best_order((way,)) is way
    with pytest.raises(PlanError, match=r"no order .* 1 standard .* best \(closed\) leaves 1.5"):
        best_order((way,), limit=1.0)
    endless = replace(way, forecast=Forecast(np.inf, 0.5))
    with pytest.raises(PlanError, match="leaves inf"):
        best_order((endless,))
