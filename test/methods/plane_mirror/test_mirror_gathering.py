"""Readings that are wrong together at one place, and a tracker that swings between its nests."""

from dataclasses import replace
from itertools import product

import gathered_worlds as worlds
import numpy as np
import pytest
from chances import LONG
from coded import coded
from drifting_tracker import KINDS, campaign
from gathered_worlds import ARCSEC, carried_world, mirror_world
from mirror_scene import estimates

from rotcal_ros.foundation.errors import DataError
from rotcal_ros.methods.plane_mirror.solver import (
    PlaneMirrorProblem,
    mirror_trials,
    solve,
)
from rotcal_ros.methods.plane_mirror.solver.solve import STATED_SWING, MirrorSolution

WAYS = ("stitching", "registration", "joint")


def problem_of(world, points, **settings):
    position, station, kind, nest = world.rows.T
    kinds = np.array([int(KINDS[k]) for k in kind.tolist()])
    settings = {"uneven_drift_std": 0.0, **settings}
    return PlaneMirrorProblem(world.angles, position, station, kinds, nest, points, **settings)


def worst(result, truth):
    return float((np.abs(result.deviations["ECC"] - truth)[1:] / result.std["ECC"][1:]).max())


def wrong_rows(world):
    return set(np.flatnonzero(np.abs(world.error).any(axis=1)).tolist())


@pytest.mark.slow
@pytest.mark.parametrize("size", [12.0, 2000.0])
@pytest.mark.parametrize("seed", [1, 4])
def test_a_minority_of_40_percent_at_one_position_is_found(seed, size):
    """Two of five; two thousand standard deviations are two centimetres."""
    world = mirror_world(seed, "random", size, reflectors=5, count=2)
    result = solve(problem_of(world, world.disturbed))
    gone = {r.index for r in result.rejected}
    assert wrong_rows(world) <= gone
    assert len(gone) == 2 * len(wrong_rows(world))  # with their direct points
    assert result.verdict == "suspect"
    assert worst(result, world.truth) < 4.0


def test_of_two_that_disagree_grossly_nothing_tells_which_is_right():
    world = mirror_world(2, "random", 2000.0, reflectors=2, count=1)
    with pytest.raises(DataError, match="neither can be shown to be right"):
        solve(problem_of(world, world.disturbed))


@pytest.mark.parametrize(
    ("pattern", "way"),
    list(product(worlds.PATTERNS, WAYS) if LONG else zip(worlds.PATTERNS, WAYS, strict=True)),
)
def test_half_of_a_position_against_the_other_half_is_named(pattern, way):
    world = mirror_world(7, pattern, 8.0)
    result = solve(problem_of(world, world.disturbed, way=way))
    position = int(world.rows[min(wrong_rows(world)), 0])
    assert result.verdict == "suspect"
    assert any(f"position {position}" in text for text in result.warnings)


@pytest.mark.slow
@pytest.mark.parametrize("pattern", worlds.PATTERNS)
def test_half_of_the_reflectors_of_a_station_are_left_out_or_inside_u(pattern):
    for seed in range(2 if LONG else 1):
        world = mirror_world(seed, pattern, 6.0, place="station")
        result = solve(problem_of(world, world.disturbed))
        assert result.verdict == "suspect"
        assert worst(result, world.truth) < 4.0


@pytest.mark.slow
@pytest.mark.parametrize("pattern", worlds.PATTERNS)
def test_reflectors_on_the_table_that_are_off_together_are_named(pattern):
    world = carried_world(4, pattern, 6.0)
    result = solve(problem_of(world, world.disturbed, way="direct"))
    position = int(world.rows[min(wrong_rows(world)), 0])
    assert result.verdict == "suspect"
    assert any(f"position {position}" in text for text in result.warnings)


@pytest.mark.slow
def test_sound_reflectors_on_the_table_stay_ok():
    for seed in range(2):
        world = carried_world(seed)
        result = solve(problem_of(world, world.sound, way="direct"))
        assert result.verdict == "ok", result.warnings
        assert worst(result, world.truth) < 4.0


def test_one_reflector_on_the_table_cannot_tell_and_says_so():
    """A reading that is off along the circle is an angle: nothing else is there to contradict."""
    world = carried_world(4, "first", 8.0, reflectors=1, count=1)
    result = solve(problem_of(world, world.disturbed, way="direct"))
    assert result.verdict == "ok"
    assert "one place" in result.verdict_line


@pytest.mark.slow
def test_small_ones_are_seldom_ok_and_wrong():
    """The figures for 100 worlds of each size are in docs/evidence.md."""
    missed = 0
    for seed in range(10 if LONG else 2):
        world = mirror_world(seed, "random", 5.0)
        result = solve(problem_of(world, world.disturbed))
        missed += result.verdict == "ok" and worst(result, world.truth) > 4.0
    assert missed <= 1


@pytest.mark.slow
def test_sound_points_stay_ok_and_keep_their_uncertainty():
    added = 0
    for seed in range(12 if LONG else 3):
        world = mirror_world(seed)
        problem = problem_of(world, world.sound)
        assert solve(problem).verdict == "ok"
        gathering = MirrorSolution.of(problem).joint.diagnosis.gathering
        added += gathering.covariance() is not None
    assert added <= (3 if LONG else 1)


def test_what_gathers_is_said_with_its_figures():
    world = mirror_world(3, "half", 10.0)
    result = solve(problem_of(world, world.disturbed))
    (blamed,) = result.details["gathering"]["blamed"]
    assert blamed["observations"] in (3, 6)  # six at a position that two stations see
    away = np.linalg.norm(world.error, axis=1).max()
    assert blamed["size"] == pytest.approx(away, rel=0.4)
    statement = {p.effect: p for p in result.protections}["one place"]
    assert statement.treatment == "tested"


def test_one_reflector_at_a_position_is_not_protected():
    world = mirror_world(3, reflectors=1)
    result = solve(problem_of(world, world.sound))
    assert "one place" in result.unprotected


@pytest.mark.parametrize("cycles", [0.5, 1.0])
def test_u_holds_a_swing_of_an_arcsecond_between_two_looks_at_the_nests(cycles):
    """A sine leaves the nests where they were: only a statement can hold it."""
    for seed in range(3 if LONG else 1):
        world = mirror_world(seed, reflectors=3, swing=ARCSEC, cycles=cycles)
        result = solve(problem_of(world, world.sound, uneven_drift_std=0.5 * ARCSEC))
        still = mirror_world(seed, reflectors=3)
        swung, without = (
            estimates(problem_of(w, w.sound), w.sound[None])[0] for w in (world, still)
        )
        caused = swung - without
        assert (np.abs(caused)[1:] / result.std["ECC"][1:]).max() < 2.5
        told = {p.effect: p for p in result.protections}["uneven drift"]
        assert told.treatment == "bounded"
        assert coded(told.why)[STATED_SWING] == [(pytest.approx(0.5),)]


@pytest.mark.slow
def test_the_statement_widens_u_and_more_looks_at_the_nests_make_it_small():
    """Of a tracker that does not swing, it moves values by no more than it widens U."""
    grown = []
    for rounds in ((), (1, 2, 3)):
        world = mirror_world(1, reflectors=3, rounds=rounds)
        problem = replace(problem_of(world, world.sound), tilt_std=0.05 * ARCSEC)  # it never tilts
        without = solve(problem)
        result = solve(replace(problem, uneven_drift_std=0.5 * ARCSEC))
        more = result.std["ECC"][1:] ** 2 - without.std["ECC"][1:] ** 2
        moved = result.deviations["ECC"][1:] - without.deviations["ECC"][1:]
        assert np.abs(moved / np.sqrt(more)).max() < 4.0
        grown.append(np.mean(more))
    assert 0.0 < grown[1] < 0.8 * grown[0]


def test_nothing_is_allowed_for_where_no_drift_is_known():
    found = campaign(closing=False)
    points = found.noisy(np.random.default_rng(3), 1)[0]
    first, second = (solve(found.problem(points, uneven_drift_std=s * ARCSEC)) for s in (0.0, 0.5))
    np.testing.assert_array_equal(first.covariance["ECC"], second.covariance["ECC"])


@pytest.mark.slow
def test_trials_swing_as_the_uncertainty_says():
    """Residuals hardly show a small swing, so that its square is that of the statement."""
    found = campaign()
    problem = found.problem(
        found.noisy(np.random.default_rng(3), 1)[0], uneven_drift_std=0.3 * ARCSEC
    )
    drawn = mirror_trials(problem)(np.random.default_rng(1), 500).std(axis=0)[1:]
    stated = solve(problem).std["ECC"][1:]
    assert np.mean(drawn**2) == pytest.approx(np.mean(stated**2), rel=0.25)
