"""Table positions numbered off by some: what is stated of the tracer's place shows it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from coded import coded

from rotcal_ros.foundation.errors import DataError
from rotcal_ros.methods import changed, prepare, read_configuration
from rotcal_ros.methods.tracer import solver as tracer
from rotcal_ros.methods.tracer.solver.observability import (
    MOVES_TOO_LITTLE,
    NUMBERED_OFF,
    ROUND_THE_TABLE,
    STATE_THE_PLACE,
    WOULD_SHOW,
)

CONFIG = Path(__file__).parents[2] / "config"
ONE = ("plan.box_points=[3, 3, 2]", "planner.policy=as_listed", "plan.table_positions=12")
SIX = ("plan.table_positions=24", "plan.table_step_deg=15.0", "plan.box_points=[3, 3, 2]",
       "plan.arrivals=1")  # fmt: skip
NOT_STATED = ("plan.tracer_m=[]", "plan.min_elevation_deg=null", "plan.min_distance_m=0.0")
ECC = 30e-6


def measured(calibration, places, number_of):
    """Observations of a table that deviates by ECC cos(angle), its positions renumbered.

    Written down anew: targets and tracer as points, the table a rotation about z.
    """
    rng = np.random.default_rng(4)
    targets = np.array(calibration.plan.targets)
    targets = targets + 8.5e-7 * rng.normal(size=targets.shape)  # of the machine, as stated
    angles = np.array(calibration.plan.table_angles)
    seen = []
    for o in calibration.nominal_observations():
        angle = angles[number_of(o.table_position, len(angles))]
        angle = angle + ECC * np.cos(angle)
        c, s = np.cos(angle), np.sin(angle)
        x, y, z = places[max(o.station, 0)]
        tracer = np.array([c * x - s * y, s * x + c * y, z])
        length = np.linalg.norm(targets[o.target] - tracer) - 0.5 + 7e-8 * rng.normal()
        seen.append(replace(o, mean=(float(length),), std=(1e-9,)))
    return seen


def one_place(*changes):
    calibration = prepare(changed(read_configuration(CONFIG / "tracer_demo.yaml"), ONE + changes))
    return calibration, [calibration.configuration.plan.tracer_m]


def solved(calibration, places, number_of):
    return calibration.solve(measured(calibration, places, number_of))


@pytest.mark.parametrize("shift", [1, -1, 4])
def test_a_stated_place_tells_positions_that_are_numbered_off(shift):
    calibration, places = one_place()
    result = solved(calibration, places, lambda i, n: (i + shift) % n)
    assert result.verdict == "suspect"
    found = coded(*result.warnings)
    ((_, _, count, where),) = found[NUMBERED_OFF]
    assert (count, where) == (abs(shift), "plan.tracer_m")
    assert found[ROUND_THE_TABLE][0][0] == pytest.approx(30.0 * shift, abs=0.05)


def test_rightly_numbered_positions_pass_with_a_place_known_to_a_centimetre():
    calibration, places = one_place()
    for away in ((0.01, 0.0, 0.0), (0.0, -0.01, 0.01)):
        moved = [np.array(places[0]) + away]
        result = solved(calibration, moved, lambda i, n: i)
        assert result.verdict == "ok", result.warnings
        error = result.deviations["ECC"] - ECC * (np.cos(result.angles) - 1.0)
        assert np.abs(error[1:] / result.std["ECC"][1:]).max() < 4.0


def test_a_reversed_sequence_of_angles_is_refused():
    calibration, places = one_place()
    with pytest.raises(DataError, match=r"clockwise|reversed|sign"):
        solved(calibration, places, lambda i, n: n - 1 - i)


def numbering(result):
    return next(p for p in result.protections if p.effect == "numbering")


@pytest.mark.parametrize("shift", [0, 1])
def test_without_a_stated_place_it_is_named_as_no_length_tells_it(shift):
    calibration, places = one_place()
    bare = prepare(changed(calibration.configuration, NOT_STATED))
    result = solved(bare, places, lambda i, n: (i + shift) % n)
    assert result.verdict == "ok"
    assert "numbering" in result.verdict_line
    ((_, where),) = coded(numbering(result).why)[STATE_THE_PLACE]
    assert where == "plan.tracer_m"
    told = solved(calibration, places, lambda i, n: i)
    assert "numbering" not in told.verdict_line
    ((apart, _),) = coded(numbering(told).why)[WOULD_SHOW]
    assert apart == pytest.approx(34.0, abs=0.5)  # 2 x 65.2 mm x sin 15 degrees


def test_positions_nearer_to_each_other_than_the_stated_place_is_known_are_named():
    """5 degrees at 65.2 mm are 5.7 mm: a place known to 20 mm separates no neighbours."""
    calibration, places = one_place("plan.table_positions=72", "plan.table_step_deg=5.0")
    result = solved(calibration, places, lambda i, n: (i + 1) % n)
    assert "numbering" in result.verdict_line
    ((_, moved, *_),) = coded(numbering(result).why)[MOVES_TOO_LITTLE]
    assert moved == pytest.approx(5.7, abs=0.05)


def test_what_was_captured_is_numbered_by_the_feedback_of_the_table():
    calibration, places = one_place()
    bare = prepare(changed(calibration.configuration, NOT_STATED))
    seen = measured(bare, places, lambda i, n: i)
    result = bare.solve([replace(o, window_start_ns=7, window_end_ns=8) for o in seen])
    assert numbering(result).treatment == "harmless"
    assert "numbering" not in result.verdict_line


def test_a_place_that_is_off_by_no_whole_positions_is_a_warning():
    """0.4 rad of steps of 60 degrees, at 65.2 mm: 2 x 65.2 mm x sin 0.2 beside its place."""
    calibration, places = one_place("plan.table_positions=6", "plan.table_step_deg=60.0")
    c, s = np.cos(0.4), np.sin(0.4)
    x, y, z = places[0]
    result = solved(calibration, [(c * x - s * y, s * x + c * y, z)], lambda i, n: i)
    ((turned, away, _),) = coded(*result.warnings)[ROUND_THE_TABLE]
    assert (turned, away) == (pytest.approx(22.9, abs=0.05), pytest.approx(26.0, abs=0.5))
    assert result.verdict == "ok"


def test_scripts_state_the_place_by_start_values():
    calibration, places = one_place()
    seen = measured(calibration, places, lambda i, n: (i + 1) % n)
    angles = np.array(calibration.plan.table_angles)
    x, y, z = places[0]
    beside = np.array([0.5, -0.2, 0.0])  # where the axis stands in the machine
    stations = np.column_stack(
        [np.cos(angles) * x - np.sin(angles) * y, np.sin(angles) * x + np.cos(angles) * y,
         np.full(len(angles), z)]
    )  # fmt: skip
    posed = tracer.TracerProblem(
        position=[o.table_position for o in seen], target=[o.target for o in seen],
        length=[o.mean[0] for o in seen], length_std=1e-7, targets=calibration.plan.targets,
        target_std=8.5e-7, table_angles=angles, start_stations=stations + beside,
    )  # fmt: skip
    posed = replace(posed, targets=posed.targets + beside)
    found = tracer.solve(posed)
    assert found.verdict == "suspect"
    assert coded(*found.warnings)[NUMBERED_OFF][0][2] == 1
    assert "numbering" in tracer.solve(replace(posed, start_stations=None)).unprotected


def six_places():
    calibration = prepare(changed(read_configuration(CONFIG / "tracer_six_demo.yaml"), SIX))
    plan = calibration.configuration.plan
    around = np.deg2rad(plan.place_azimuth_deg) + 2 * np.pi * np.arange(plan.places) / plan.places
    height = plan.place_height_m + plan.place_height_step_m * np.arange(plan.places)
    r = plan.place_radius_m
    return calibration, np.column_stack([r * np.cos(around), r * np.sin(around), height])


@pytest.mark.parametrize("shift", [0, 1])
def test_six_deviations_tell_it_by_the_places_of_the_plan(shift):
    calibration, places = six_places()
    result = solved(calibration, places, lambda i, n: (i + shift) % n)
    off = coded(*result.warnings).get(NUMBERED_OFF, [])
    assert len(off) == (shift != 0), result.warnings
    if shift:
        assert result.verdict == "suspect"
        assert off[0][2] == abs(shift)


def test_six_deviations_of_positions_shifted_by_several_are_refused():
    calibration, places = six_places()
    with pytest.raises(DataError, match="numbering of the positions"):
        solved(calibration, places, lambda i, n: (i - 3) % n)
    with pytest.raises(DataError, match="sense of the table angles"):
        solved(calibration, places, lambda i, n: n - 1 - i)
