"""Each blunder of the shop floor: refused or flagged, with the reason and the place."""

from dataclasses import replace

import numpy as np
import pytest
from chances import LONG, most
from coded import coded
from mirror_cell import measure, paper_cell, ring_cell
from mirror_scene import only, rows_of, with_points

from rotcal_ros.adjust.engine import SCATTERS
from rotcal_ros.adjust.look import BEYOND
from rotcal_ros.foundation.errors import DataError, GeometryError
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods.plane_mirror.solver import TrackerNoise, check_nests, solve
from rotcal_ros.methods.plane_mirror.solver.set_up import NO_POINTS, STEEP
from rotcal_ros.methods.plane_mirror.solver.solve import REPEATS_DIFFER

DIRECT, MIRRORED, NEST = PointKind.DIRECT, PointKind.MIRRORED, PointKind.NEST


def simulated(way="joint", reflectors=1, seed=1, cell=None, **more):
    cell = cell if cell is not None else paper_cell(reflectors=reflectors)
    deviations = np.zeros((len(cell.angles), 6))
    deviations[:, 5] = np.random.default_rng(9).normal(0.0, 5 * ARCSEC, len(cell.angles))
    rng = np.random.default_rng(seed)
    return measure(cell, deviations, TrackerNoise(), rng, way=way, **more)


def truth(n=17):
    deviations = np.random.default_rng(9).normal(0.0, 5 * ARCSEC, n)
    return deviations - deviations[0]


def without(problem, gone):
    return only(problem, np.setdiff1d(np.arange(len(problem.xyz)), gone))


def test_direct_and_mirrored_exchanged():
    problem = simulated()
    d, m = (rows_of(problem, position=4, station=1, kind=kind)[0] for kind in (DIRECT, MIRRORED))
    bad = with_points(problem, {d: problem.xyz[m], m: problem.xyz[d]})
    with pytest.raises(DataError, match=r"position 4 \(90 deg\), tracker station 1.*exchange"):
        solve(bad)


def test_two_nests_measured_on_the_same_place():
    problem = simulated("joint")
    a, b = (rows_of(problem, kind=NEST, nest=k, station=4)[0] for k in (2, 5))
    same = with_points(problem, {a: problem.xyz[b] + 2e-5})
    with pytest.raises(DataError, match=r"station 4 nests 2 and 5 are .* mm apart.*wrong nest"):
        solve(same)


def test_reflector_on_the_wrong_mirror_nest():
    """One reflector: its normal is degrees off. Two: they show different planes."""
    problem = simulated()
    m = rows_of(problem, position=5, station=1, kind=MIRRORED)[0]
    bad = with_points(problem, {m: problem.xyz[m] + np.array([0.25, -0.1, 0.2])})
    with pytest.raises(DataError, match=r"station 1.*position 5 \(112.5 deg\).*wrong nest"):
        solve(bad)
    problem = simulated(reflectors=2)
    m = rows_of(problem, position=5, station=1, kind=MIRRORED)
    bad = with_points(problem, {m[0]: problem.xyz[m[1]], m[1]: problem.xyz[m[0]]})
    with pytest.raises(DataError, match=r"position 5.*station 1.*reflectors 1, 2 show different"):
        solve(bad)


def test_of_pairs_that_disagree_a_little_the_cone_tells_which_is_wrong():
    """The table tilts by arcseconds, not by the ten that the wrong one would be."""
    problem = simulated(reflectors=2)
    m = rows_of(problem, position=5, station=1, kind=MIRRORED)[0]
    result = solve(with_points(problem, {m: problem.xyz[m] + np.array([0.0, 0.0, 1.5e-4])}))
    assert m in {r.index for r in result.rejected}
    assert np.all(np.abs(result.deviations["ECC"] - truth())[1:] < 4.0 * result.std["ECC"][1:])


def test_third_reflector_outvotes_the_wrong_one():
    problem = simulated(reflectors=3)
    d, m = (
        rows_of(problem, position=5, station=1, kind=kind, nest=2)[0]
        for kind in (DIRECT, MIRRORED)
    )
    bad = with_points(problem, {m: problem.xyz[m] + np.array([0.0, 0.0, 4e-4])})
    result = solve(bad)
    assert {r.index for r in result.rejected} == {d, m}
    assert BEYOND in coded(result.rejected[0].why)
    assert result.rejected[0].why.parts[0].endswith("nest 2)")
    assert not result.residuals.used[[d, m]].any()
    assert np.abs(result.deviations["ECC"] - truth()).max() < 5 * ARCSEC


def test_mirror_beyond_its_incidence_range():
    """Left out and named; the position is then missing from the result, not wrong."""
    problem = simulated(incidence_limit=33.0 * DEGREE)
    result = solve(problem)
    assert result.rejected
    ((*_, limit),) = coded(result.rejected[0].why)[STEEP]
    assert limit == pytest.approx(33.0)
    assert result.verdict == "suspect"
    assert NO_POINTS in coded(result.warnings[0])
    assert len(result.angles) == len(result.deviations["ECC"]) < 17
    with pytest.raises(DataError, match=r"every beam strikes the mirror beyond 0.5 deg"):
        solve(simulated(incidence_limit=0.5 * DEGREE))


@pytest.mark.parametrize("way", ["stitching", "registration", "joint"])
def test_station_without_overlap(way):
    problem = simulated(way)
    problem = without(
        problem,
        [*rows_of(problem, position=9, station=3), *rows_of(problem, position=12, station=3)],
    )
    if way == "stitching":
        with pytest.raises(DataError, match="tracker station 3 shares no table position"):
            solve(problem)
    else:
        assert np.abs(solve(problem).deviations["ECC"] - truth()).max() < 5 * ARCSEC


def test_station_with_two_nests_or_three_in_a_line():
    problem = simulated("registration")
    few = without(problem, rows_of(problem, station=2, kind=NEST)[:4])
    with pytest.raises(GeometryError, match=r"station 2 shares 2 nests \(5, 6\)"):
        solve(few)
    cell = paper_cell()
    line = np.array([[2.0, y, 0.5] for y in (-1.0, 0.2, 1.0)])
    with pytest.raises(GeometryError, match=r"station \d: the nests 1, 2, 3 .*in a line"):
        solve(simulated("joint", cell=replace(cell, nests=line)))


@pytest.mark.parametrize("way", ["registration", "joint"])
@pytest.mark.parametrize("nest", [1, 4])
@pytest.mark.parametrize("size", [1e-4, 0.05])
def test_moved_nest_is_found_and_named(way, nest, size):
    """From a tenth of a millimetre to a knock over five centimetres, between stations 2 and 3."""
    problem, stations = simulated(way), paper_cell().stations
    shift = size * np.array([0.6, -0.64, 0.48])
    late = [r for r in rows_of(problem, kind=NEST, nest=nest) if problem.station[r] >= 3]
    seen = [stations[problem.station[r]] for r in late]
    moved = {
        r: problem.xyz[r] + s.to_local(shift) - s.to_local(0.0 * shift)
        for r, s in zip(late, seen, strict=True)
    }
    result = solve(with_points(problem, moved))
    assert len(result.warnings) == 1
    assert "a nest moved from " in result.warnings[0]
    assert f"(nest, tracker station 3, nest {nest}) on" in result.warnings[0]
    if way == "joint":
        (found,) = result.details["effects_found"]
        assert np.linalg.norm(found["size"]) == pytest.approx(size, abs=3e-5)
    assert result.verdict == "suspect"
    assert np.abs(result.deviations["ECC"] - truth()).max() < 5 * ARCSEC


def test_nest_seated_badly_once_is_found_and_named():
    problem = simulated("joint")
    row = rows_of(problem, kind=NEST, nest=3, station=2)[0]
    result = solve(with_points(problem, {row: problem.xyz[row] + np.array([0.0, 2e-4, 0.0])}))
    assert "nest 3 stood elsewhere at station 2 (by 0.2" in result.warnings[0]
    assert np.abs(result.deviations["ECC"] - truth()).max() < 5 * ARCSEC


def test_nests_alone_are_checked_while_measuring():
    """As after moving the tracker to its third place: nests only, nothing of the mirror yet."""
    problem = simulated()
    problem = without(problem, np.flatnonzero((problem.kind != NEST) | (problem.station > 2)))
    assert check_nests(problem) == []
    row = rows_of(problem, nest=6, station=2)[0]
    moved = with_points(problem, {row: problem.xyz[row] + np.array([0.0, 0.0, 1.5e-4])})
    assert "a nest moved from row 17 (nest, tracker station 2, nest 6) on" in check_nests(moved)[0]
    assert check_nests(without(problem, np.flatnonzero(problem.station > 0))) == []


@pytest.mark.slow
def test_false_alarms_in_good_registrations_are_rare():
    runs = 40 if LONG else 12
    warned = sum(bool(solve(simulated("registration", seed=s)).warnings) for s in range(runs))
    assert warned <= most(0.01, runs)


def test_three_nests_tell_that_one_moved_but_not_which():
    cell = replace(paper_cell(), nests=paper_cell().nests[[0, 2, 4]])
    problem = simulated("registration", cell=cell)
    row = rows_of(problem, kind=NEST, nest=2, station=3)[0]
    result = solve(with_points(problem, {row: problem.xyz[row] + np.array([4e-4, 4e-4, 0.0])}))
    assert result.verdict != "ok"
    assert SCATTERS in coded(*result.warnings)
    off = np.abs(result.deviations["ECC"] - truth())[1:]
    assert np.all(off < 4.0 * result.std["ECC"][1:])


def test_position_commanded_twice_with_different_results():
    cell = paper_cell()
    deviations = np.zeros((17, 6))
    deviations[16, 5] = 30 * ARCSEC
    result = solve(
        measure(cell, deviations, TrackerNoise(), np.random.default_rng(2), way="joint")
    )
    assert result.verdict == "suspect"
    ((first, last, *_),) = coded(result.warnings[0])[REPEATS_DIFFER]
    assert (first, last) == pytest.approx((0.0, 360.0))
    assert result.details["closure_rad"] == pytest.approx(30 * ARCSEC, abs=5 * ARCSEC)


@pytest.mark.parametrize("way", ["stitching", "registration", "joint"])
def test_half_a_pair(way):
    problem = simulated(way)
    gone = rows_of(problem, position=7, station=2, kind=MIRRORED)
    with pytest.raises(DataError, match=r"position 7.*station 2, nest 1: 1 direct and 0 mirrored"):
        solve(without(problem, gone))


def test_repeated_measurements_are_used():
    problem = simulated("joint", seed=4)
    again = simulated("joint", seed=2)
    columns = {
        k: np.concatenate([getattr(problem, k), getattr(again, k)])
        for k in ("position", "station", "kind", "nest", "xyz")
    }
    twice = solve(replace(problem, **columns))
    ratio = twice.std["ECC"][1:] / solve(problem).std["ECC"][1:]
    assert np.all((ratio > 0.7) & (ratio < 0.78))
    assert twice.residuals.used.all()


def test_direct_way_refuses_a_mirror():
    with pytest.raises(DataError, match=r"row .* in the direct way.*choose joint"):
        solve(simulated("direct"))


def test_stitching_needs_a_plane_somewhere():
    angles = np.radians(np.arange(4) * 20.0)
    cell = ring_cell(angles, ((0, 1), (1, 2), (2, 3)))
    with pytest.raises(GeometryError, match="no tracker station sees three table positions"):
        solve(simulated("stitching", cell=cell))
    close = ring_cell(np.radians([0.0, 0.5, 1.0]), ((0, 1, 2),))
    with pytest.raises(GeometryError, match="station 0 span too small an arc"):
        solve(simulated("stitching", cell=close))
