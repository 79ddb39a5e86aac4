"""Some beams of one station that are too long together: found, left out, or allowed for.

Worlds come from plain geometry in gathered_worlds; with and without the disturbance they have the
same noise. The whole criterion, a hundred worlds a size, is `make power`'s.
"""

import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from chances import LONG, most
from coded import coded

from rotcal_ros.adjust.engine import RIVALLED
from rotcal_ros.adjust.gathering import AS_WELL
from rotcal_ros.methods.tracer.solver import TracerProblem, solve

sys.path.insert(0, str(Path(__file__).parents[1]))
from gathered_worlds import NOISE, TARGET_STD, world

UM = 1e-6
BOTH = pytest.mark.parametrize("one_zero", [False, True], ids=["own zeros", "one zero"])


def problem(here, lengths, one_zero=False, **options):
    m, n = lengths.shape
    position, target = np.divmod(np.arange(m * n), n)
    rows = {
        "position": position,
        "target": target,
        "length": lengths.ravel(),
        "length_std": NOISE,
        "targets": here.targets,
        "target_std": TARGET_STD,
        "table_angles": here.angles,
        "segment": np.zeros(m * n, dtype=int) if one_zero else None,
        "error_motion_std": 0.0,
        "variant": "joint",
    }
    return TracerProblem(**{**rows, **options})


def bad_rows(here):
    return set(np.flatnonzero(here.error.ravel()).tolist())


def rejected_rows(result):
    return {one.index for one in result.rejected}


@BOTH
@pytest.mark.parametrize("pattern", ["sector", "random"])
@pytest.mark.parametrize("spread", [0.0, 0.5])
def test_the_bad_beams_are_left_out_and_no_good_ones(one_zero, pattern, spread):
    """Eight of twenty, 2 um or 1 to 3 um too long: once good ones were rejected instead."""
    exact = 0
    runs = 6 if LONG else 2
    for seed in range(runs):
        here = world(seed, pattern, 2 * UM, spread=spread, one_zero=one_zero)
        result = solve(problem(here, here.disturbed, one_zero))
        assert result.verdict == "suspect"
        error = np.abs(result.deviations["ECC"] - here.truth)[1:] / result.std["ECC"][1:]
        assert error.max() < 4.0
        exact += rejected_rows(result) == bad_rows(here)
    assert exact >= runs / 2


@BOTH
def test_sixteen_of_forty_eight(one_zero):
    for seed in range(3 if LONG else 1):
        here = world(seed, "sector", 1 * UM, n=48, one_zero=one_zero)
        result = solve(problem(here, here.disturbed, one_zero))
        assert result.verdict == "suspect"
        assert len(rejected_rows(result) & bad_rows(here)) >= 15


@BOTH
def test_the_warning_names_the_station_and_how_many(one_zero):
    here = world(2, "sector", 3 * UM, one_zero=one_zero)
    station = int(np.flatnonzero(here.error.any(axis=1))[0])
    result = solve(problem(here, here.disturbed, one_zero))
    said = " ".join(result.warnings)
    assert f"8 of the 20 lengths of station {station} are off together" in said
    assert f"one of 8 of station {station} that are off together" in result.rejected[0].why


def test_a_half_against_the_other_half_is_suspect_and_covered():
    """No length of a station with a zero of its own can show which ten of twenty are right."""
    for seed in range(4):
        here = world(seed, "half", 2 * UM)
        sound, result = (solve(problem(here, x)) for x in (here.sound, here.disturbed))
        assert result.verdict == "suspect"
        assert {AS_WELL, RIVALLED} & coded(*result.warnings).keys()
        caused = result.deviations["ECC"] - sound.deviations["ECC"]
        assert (np.abs(caused)[1:] < 2.5 * result.std["ECC"][1:]).all()


@BOTH
def test_no_ok_with_a_large_error_of_large_disturbances(one_zero):
    """1.5 um and more, as the issue had them; smaller ones are in the table of make power."""
    for seed in range(8):
        pattern = ("sector", "random", "half")[seed % 3]
        here = world(seed, pattern, (1.5 + 0.5 * (seed % 4)) * UM, one_zero=one_zero)
        assert solve(problem(here, here.disturbed, one_zero)).verdict != "ok"


@BOTH
def test_sound_lengths_stay_sound_and_their_covariance_as_it_was(one_zero):
    alarms, grown = 0, 0
    runs = 40 if LONG else 12
    for seed in range(runs):
        here = world(100 + seed, one_zero=one_zero)
        result = solve(problem(here, here.sound, one_zero))
        alarms += result.verdict != "ok"
        grown += "gathered" in result.budget
        assert all(one["rejected"] <= 2 for one in result.details["gathering"]["groups"])
    assert alarms <= most(0.01, runs)
    assert grown <= runs * 0.15


def test_two_outliers_of_one_station_are_no_gathering():
    here = world(5)
    lengths = here.sound.copy()
    lengths[4, 3] += 20 * UM
    lengths[4, 11] -= 15 * UM
    result = solve(problem(here, lengths))
    assert rejected_rows(result) == {4 * 20 + 3, 4 * 20 + 11}
    assert result.verdict == "ok"


def test_a_lost_share_is_counted_by_station():
    """Seven gross errors of one station are 3.2 % of all lengths, and a third of the station."""
    here = world(6)
    lengths = here.sound.copy()
    rng = np.random.default_rng(1)
    lengths[4, :7] += rng.choice([-1, 1], 7) * rng.uniform(20, 90, 7) * UM
    result = solve(problem(here, lengths))
    assert result.verdict != "ok"
    assert any("station 4" in text for text in result.warnings)


def test_a_stretch_of_time_over_several_stations_is_a_group():
    here = world(7)
    m, n = here.sound.shape
    order = np.arange(m * n).reshape(n, m).T.ravel()  # target by target
    lengths = here.sound.copy()
    away = (order >= 66) & (order < 77)
    lengths.ravel()[away] += 1.2 * UM * np.sign(np.random.default_rng(0).normal(size=11))
    groups = solve(problem(here, here.sound, order=order)).details["gathering"]["groups"]
    kinds = {each["name"].rstrip("0123456789 ") for each in groups}
    assert kinds == {"station", "target", "stretch of time"}
    assert solve(problem(here, lengths, order=order)).verdict == "suspect"


def test_the_variant_station_is_judged_too():
    solved = partial(problem, variant="station")
    here = world(9, "sector", 3 * UM)
    assert solve(solved(here, here.sound)).verdict == "ok"
    assert solve(solved(here, here.disturbed)).verdict == "suspect"
