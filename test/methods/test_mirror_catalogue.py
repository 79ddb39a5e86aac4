"""The plane mirror from its configuration to the result: plan, problem, checks, other ways."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mirror_points import points_table

from rotcal_ros.foundation.errors import ConfigurationError, DataError, PlanError
from rotcal_ros.foundation.observations import ATTEMPTS_PER_RUN, Approach, PointKind
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods import changed, prepare
from rotcal_ros.methods.configuration import read_configuration
from rotcal_ros.methods.continuation import continued
from rotcal_ros.methods.measurements import read_measurements
from rotcal_ros.methods.plane_mirror.solver import PlaneMirrorProblem
from rotcal_ros.methods.plane_mirror.solver.problem import problem_from_observations
from rotcal_ros.methods.simulation.table import true_deviations

CONFIG = Path(__file__).parents[2] / "config"
SHORT = ("plan.table_positions=9", "plan.table_step_deg=15.0", "plan.reflectors=2",
         "simulation.tracker.station_azimuths_deg=[22.5, 67.5, 105.0]")  # fmt: skip


def configured(*changes):
    return changed(read_configuration(CONFIG / "plane_mirror_demo.yaml"), changes)


def measured(configuration):
    """Return the calibration, its accepted observations, and the true ECC."""
    calibration = prepare(configuration)
    cell = configuration.method.simulated_cell(configuration.simulation)
    capture = calibration.capture()
    observations = []
    for step in calibration.plan.steps:
        command = step.command(0)
        cell.order_table(command)
        cell.order_probe(command)
        found = ()
        while not found:
            out = cell.advance(0.2)
            for record in (*out.table, *out.probe, *out.temperature):
                found += capture.feed(record)
        observations += found
    truth = true_deviations(cell.table.settings, np.array(calibration.plan.table_angles))["ECC"]
    return calibration, observations, truth


@pytest.fixture(scope="module")
def short():
    return measured(configured(*SHORT))


def consistent(result, truth):
    """Return whether the error is what the covariance allows (99.9 % of a chi square)."""
    error = (result.deviations["ECC"] - truth)[1:]
    covariance = result.covariance["ECC"][1:, 1:]
    return error @ np.linalg.solve(covariance, error) < {8: 26.1, 16: 39.3, 11: 31.3}[len(error)]


def test_the_configurations_are_what_they_say():
    demo = prepare(configured()).plan
    assert (len(demo.table_angles), len(demo.pauses), len(demo.targets)) == (17, 12, 6)
    assert len(demo.steps) == 6 * 12 + 22 * 3 * 2
    real = prepare(read_configuration(CONFIG / "plane_mirror.yaml"))
    assert not real.configuration.simulated
    assert len(real.plan.pauses) == 12
    assert "tracer_length" not in real.topics


def test_the_demonstration_is_solved_to_the_truth():
    calibration, observations, truth = measured(configured())
    assert all(o.accepted for o in observations)
    assert calibration.check(observations) == ()
    result = calibration.solve(observations)
    assert result.verdict == "ok", result.warnings
    assert consistent(result, truth)
    swing = calibration.configuration.solver.uneven_drift_std_arcsec * ARCSEC
    noise = np.sqrt(np.maximum(result.std["ECC"] ** 2 - swing**2, 0.0))
    assert np.all(noise < 0.8 * ARCSEC)
    assert result.details["left_out"] == []


def test_all_ways_of_the_same_points_are_in_the_details(short):
    calibration, observations, truth = short
    result = calibration.solve(observations)
    assert result.details["way"] == "joint"
    assert consistent(result, truth)
    found = {way["way"]: way for way in result.details["ways"]}
    assert found.keys() == {"stitching", "registration"}
    for name, way in found.items():
        other = prepare(configured(*SHORT, f"solver.way={name}"))
        alone = other.solve(observations)
        np.testing.assert_array_equal(way["ecc_rad"], alone.deviations["ECC"])
        np.testing.assert_allclose(way["ecc_std_rad"], alone.std["ECC"], rtol=1e-12)
        assert consistent(alone, truth)


def test_the_order_of_the_observations_does_not_matter(short):
    calibration, observations, _ = short
    text = calibration.solve(observations).to_json()
    assert calibration.solve(observations[::-1]).to_json() == text


def test_a_reflector_without_its_image_is_left_out_and_named(short):
    calibration, observations, truth = short
    lost = next(o for o in observations if o.kind == PointKind.MIRRORED and o.table_position == 1)
    rest = [o for o in observations if o is not lost]
    result = calibration.solve(rest)
    assert result.details["left_out"] == [
        "position 1, tracker station 0, reflector 1: only direct was measured"
    ]
    assert result.n_observations == len(observations) - 2
    assert consistent(result, truth)


def test_nests_are_checked_as_soon_as_the_second_station_has_seen_them(short):
    calibration, observations, _ = short
    second = calibration.plan.pauses[2]
    before = [o for o in observations if o.step < second.first]
    so_far = [o for o in observations if o.step <= second.last]
    assert calibration.check(before) == ()
    assert calibration.check(so_far) == ()
    last = so_far[-1]
    moved = replace(last, mean=(last.mean[0] + 1e-3, *last.mean[1:]))
    (text,) = calibration.check([*so_far[:-1], moved])
    assert text.startswith(f"nest {last.target} stood elsewhere at station 1 (by 1.0")
    nests = [o for o in so_far if o.kind == PointKind.NEST and o.station == 1][:2]
    with pytest.raises(DataError, match="2 nests"):
        calibration.check([*before, *nests])


def test_a_tracker_that_drifts_is_told_at_once_and_corrected():
    calibration, observations, truth = measured(
        configured(
            *SHORT,
            "simulation.tracker.azimuth_drift_arcsec_per_h=3000.0",
            "simulation.tracker.range_drift_um_per_h=300.0",
            "plan.drift_limit_arcsec=3.0",
        )
    )
    closing = calibration.plan.pauses[3]
    assert calibration.check([o for o in observations if o.step < closing.first]) == ()
    (text,) = calibration.check([o for o in observations if o.step <= closing.last])
    assert text.startswith("the tracker turned by ")
    assert "between two rounds of nests at station 1, allowed 3: let it settle" in text
    result = calibration.solve(observations)
    assert consistent(result, truth)
    assert "drift" not in result.unprotected
    span = [np.ptp(d["knots"]) / 3600.0 for d in result.details["drift"]]
    turned = [d["turn_rad"][0, 2] / ARCSEC for d in result.details["drift"]]
    np.testing.assert_allclose(turned, 3000.0 * np.array(span), atol=2.5)
    once = prepare(configured(*SHORT, "plan.closing_nests=false"))
    assert len(once.plan.steps) == len(calibration.plan.steps) - 3 * 6


@pytest.mark.parametrize("done", [20, 25, 29, 40])
def test_an_interrupted_station_goes_on_where_it_was_and_is_closed(short, done):
    """Between positions, within the closing nests, behind them, within the next first nests."""
    calibration, observations, truth = short
    configuration, plan = calibration.configuration, calibration.plan
    rest = continued(
        plan, configuration.plan_id, 1, observations[:done], max_attempts=3, join_steps=0
    )
    assert rest.steps == tuple(range(done, len(plan.steps)))
    hour = 3_600_000_000_000
    later = [
        replace(o, run=1, attempt=ATTEMPTS_PER_RUN, window_start_ns=o.window_start_ns + hour,
                window_end_ns=o.window_end_ns + hour)
        for o in observations[done:]
    ]  # fmt: skip
    result = calibration.solve([*rest.observations, *later])
    assert result.verdict == "ok", result.warnings
    assert "drift" not in result.unprotected
    assert consistent(result, truth)


def test_exchanged_direct_and_mirrored_is_refused(short):
    calibration, observations, _ = short
    swap = {PointKind.DIRECT: PointKind.MIRRORED, PointKind.MIRRORED: PointKind.DIRECT}
    wrong = [
        replace(o, kind=swap[o.kind]) if o.table_position == 2 and o.kind in swap else o
        for o in observations
    ]
    with pytest.raises(DataError, match="direct and mirrored exchanged"):
        calibration.solve(wrong)


def test_no_points_yet_is_said_so(short):
    calibration, observations, _ = short
    with pytest.raises(DataError, match="no reflector was measured both"):
        calibration.solve([])
    nests_only = observations[:6]
    with pytest.raises(DataError, match="no reflector was measured through the mirror"):
        calibration.solve(nests_only)


def test_the_table_of_a_run_gives_the_result_of_the_run(short, tmp_path):
    """CSV round trip: the same points in the same order, hence the same numbers."""
    calibration, observations, _ = short
    live = calibration.solve(observations)
    problem = problem_from_observations(observations, np.array(calibration.plan.table_angles))
    assert isinstance(problem, PlaneMirrorProblem)
    path = tmp_path / "points.csv"
    path.write_text(points_table(problem))
    table = read_measurements(path, calibration.configuration).solve()
    np.testing.assert_array_equal(table.deviations["ECC"], live.deviations["ECC"])
    np.testing.assert_array_equal(table.covariance["ECC"], live.covariance["ECC"])
    assert table.verdict == live.verdict == "ok"


@pytest.mark.parametrize(("way", "other"), [("direct", "joint"), ("joint", "direct")])
def test_reflectors_on_the_table_are_solved(way, other):
    calibration, observations, truth = measured(
        configured(
            "plan.carries=reflectors",
            "plan.table_reflectors_m=[0.3, 0.0, 0.1, -0.1, 0.28, 0.1]",
            "plan.table_positions=12",
            "plan.table_step_deg=30.0",
            "plan.positions_per_station=12",
            f"solver.way={way}",
            "simulation.tracker.reflectors_on_table=true",
        )
    )
    assert {o.kind for o in observations} == {PointKind.DIRECT, PointKind.NEST}
    result = calibration.solve(observations)
    assert result.verdict == "ok", result.warnings
    assert [found["way"] for found in result.details["ways"]] == [other]
    assert consistent(result, truth)


@pytest.mark.parametrize("way", ["joint", "stitching"])
def test_both_directions_show_the_play_of_the_table(way):
    """Every station goes up and down its positions; a table with 6 arcsec of play."""
    calibration, observations, _ = measured(
        configured(
            *SHORT,
            "plan.bidirectional=true",
            "simulation.table.backlash_arcsec=6.0",
            f"solver.way={way}",
        )
    )
    plan = calibration.plan
    assert len(plan.table_angles) == 18
    assert plan.table_angles[9:] == plan.table_angles[8::-1]
    for step in plan.steps:
        down = step.table_position >= 9
        assert step.approach is (Approach.NEGATIVE if down else Approach.POSITIVE)
    result = calibration.solve(observations)
    assert result.verdict == "ok", result.warnings
    assert len(result.angles) == 9
    both = result.directions["ECC"]
    errors = (both.reversal + 6.0 * ARCSEC) / both.reversal_std
    assert np.all(np.abs(errors) < 4.0)
    assert np.all(both.reversal_std < 2.0 * ARCSEC)
    settings = calibration.configuration.simulation.table
    truth = true_deviations(settings, result.angles)["ECC"]
    forward = both.forward - both.forward[0] - truth + truth[0]
    assert np.all(np.abs(forward) < 4.0 * ARCSEC)
    values = calibration.trials(observations)(np.random.default_rng(1), 400)
    assert values.shape == (400, 9)
    np.testing.assert_allclose(values.std(axis=0)[1:], result.std["ECC"][1:], rtol=0.2)


def test_one_arrival_that_is_missing_leaves_the_others():
    calibration, observations, _ = measured(configured(*SHORT, "plan.bidirectional=true"))
    rest = [
        o for o in observations if o.table_position != 12 or o.kind is PointKind.NEST
    ]  # the fifth angle (60 deg: 17 - 12 = 5) on the way down
    result = calibration.solve(rest)
    assert len(result.angles) == 9
    np.testing.assert_allclose(result.directions["ECC"].angles, np.delete(result.angles, 5))


@pytest.mark.parametrize(
    ("changes", "kind", "text"),
    [
        (["solver.way=direct"], ConfigurationError, "way = direct does not fit .* mirror"),
        (["plan.carries=reflectors"], PlanError, "table_reflectors_m names none"),
        (
            ["plan.carries=reflectors", "solver.way=stitching"],
            ConfigurationError,
            "stitching and registration a mirror",
        ),
        (["plan.nests_m=[]"], PlanError, "joint joins 6 tracker stations through nests"),
        (["solver.way=stitching", "plan.shared_positions=0"], PlanError, "shares none"),
        (["solver.way=guessing"], ConfigurationError, "none of direct, stitching"),
        (["plan.incidence_limit_deg=30.0"], PlanError, "tracker station 0 .* incidence"),
    ],
)
def test_what_cannot_work_is_refused_before_the_first_motion(changes, kind, text):
    with pytest.raises(kind, match=text):
        prepare(configured(*changes))


def test_stitching_needs_no_nests():
    calibration = prepare(configured("solver.way=stitching", "plan.nests_m=[]"))
    pause = calibration.plan.pauses[1]
    assert (pause.first, pause.last) == (24, 23)
