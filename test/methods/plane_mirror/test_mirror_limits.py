"""Where the limits of the mirror's screening lie: just inside is taken, just outside refused."""

import re
from dataclasses import replace

import numpy as np
import pytest
from mirror_cell import measure, measure_direct, paper_cell, ring_cell
from mirror_scene import measured, only, rows_of, with_points

from rotcal_ros.foundation.errors import DataError, GeometryError
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods.plane_mirror.solver import check_nests, mirror_trials, solve
from rotcal_ros.methods.plane_mirror.solver.problem import find_nests, find_pairs, find_reflectors
from rotcal_ros.methods.plane_mirror.solver.set_up import check_normals, check_pairs
from rotcal_ros.methods.plane_mirror.solver.solve import check_size

DIRECT, MIRRORED, NEST = PointKind.DIRECT, PointKind.MIRRORED, PointKind.NEST


def exact(way="joint", cell=None, **more):
    cell = paper_cell() if cell is None else cell
    return measure(cell, np.zeros((len(cell.angles), 6)), way=way, **more)


@pytest.mark.parametrize("apart", [0.99e-3, 1.01e-3])
def test_a_reflector_and_its_image_are_a_millimetre_apart(apart):
    problem = exact()
    d, m = (rows_of(problem, position=4, station=1, kind=kind)[0] for kind in (DIRECT, MIRRORED))
    beam = problem.xyz[d] / np.linalg.norm(problem.xyz[d])
    close = with_points(problem, {m: problem.xyz[d] + apart * beam})
    if apart > 1e-3:
        check_pairs(close, find_pairs(close))
        return
    with pytest.raises(DataError, match=r"mirrored point is 0.990 mm from the direct.*twice"):
        check_pairs(close, find_pairs(close))


@pytest.mark.parametrize("further", [-1e-6, 0.0, 1e-6])
def test_the_image_is_the_farther_one(further):
    """As far away as the reflector is not farther; a place aside of it."""
    problem = exact()
    d, m = (rows_of(problem, position=4, station=1, kind=kind)[0] for kind in (DIRECT, MIRRORED))
    distance = np.linalg.norm(problem.xyz[d])
    aside = np.cross(problem.xyz[d], [0.0, 0.0, 1.0])
    aside *= (1.0 + further) * distance / np.linalg.norm(aside)
    if further == 0.0:
        x, y, z = problem.xyz[d]
        aside = np.array([-x, y, z])
    moved = with_points(problem, {m: aside})
    if further > 0.0:
        check_pairs(moved, find_pairs(moved))
        return
    text = r"position 4 \(90 deg\), tracker station 1.*"
    text += rf"point is {distance:.4f} m away, the direct one {distance:.4f} m"
    with pytest.raises(DataError, match=text):
        check_pairs(moved, find_pairs(moved))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_deviations_of_a_degree_are_none(sign):
    problem, angles = exact(), np.radians([0.0, 30.0, 60.0])
    check_size(problem, angles, np.radians([0.0, 0.1, sign * 0.999]))
    with pytest.raises(
        DataError, match=f"commanded to 30 deg comes out {sign * 1.01:.2f} deg off"
    ):
        check_size(problem, angles, np.radians([0.0, sign * 1.01, 0.1]))
    with pytest.raises(DataError, match="no table is that wrong"):
        check_size(problem, angles, np.array([0.0, np.nan, 0.0]))


@pytest.mark.parametrize("error", [1.99, 2.01])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_normals_may_stand_two_degrees_from_their_command(error, sign):
    """Upright normals turn as the table does; position 5 is seen from station 1 alone."""
    problem = exact(cell=paper_cell(lean=0.0))
    angles = problem.angles.copy()
    angles[5] += sign * error * DEGREE
    wrong = replace(problem, angles=angles)
    pairs = find_pairs(wrong)
    if error < 2.0:
        check_normals(wrong, pairs)
        return
    with pytest.raises(DataError) as raised:
        check_normals(wrong, pairs)
    text = str(raised.value)
    assert f"from tracker station 1 the mirror at position 5 ({112.5 + sign * 2.01:g} deg)" in text
    seen = float(text.split(" stands ")[1].split(" deg")[0])
    assert seen % 22.5 == pytest.approx(0.0, abs=0.01)
    assert "one of them wrong" not in text
    assert "wrong commanded angle" in text


def test_of_two_normals_either_may_be_wrong():
    cell = ring_cell(np.radians([0.0, 20.0, 40.0, 60.0]), ((0, 1, 2), (2, 3)))
    problem = exact(cell=cell)
    angles = problem.angles.copy()
    angles[3] += 3.0 * DEGREE
    with pytest.raises(DataError, match=r"station 1 .* stands 19.99 deg .*, one of them wrong:"):
        solve(replace(problem, angles=angles))


@pytest.mark.parametrize("margin", [-1e-6, 1e-6])
def test_pairs_are_left_out_beyond_the_limit(margin):
    problem = exact("registration")
    angle = [entry["incidence_rad"] for entry in solve(problem).details["normals"]]
    limit = max(angle) * (1.0 + margin)
    result = solve(replace(problem, incidence_limit=limit))
    steepest = np.flatnonzero(np.isclose(angle, max(angle), rtol=1e-9))
    assert len(result.rejected) == (2 * len(steepest) if margin < 0 else 0)
    for rejection in result.rejected:
        assert rejection.why == (
            f"angle of incidence {np.degrees(max(angle)):.1f} deg is beyond the limit of "
            f"{np.degrees(limit):g} deg"
        )
        assert not result.residuals.used[rejection.index]


@pytest.mark.parametrize("apart", [4.99e-3, 5.01e-3])
def test_nests_of_one_station_are_five_millimetres_apart(apart):
    problem = exact()
    a = rows_of(problem, kind=NEST, nest=2, station=4)[0]
    b = rows_of(problem, kind=NEST, nest=5, station=4)[0]
    near = with_points(problem, {a: problem.xyz[b] + [0.0, 0.0, apart]})
    if apart < 5e-3:
        text = r"tracker station 4 nests (2 and 5|5 and 2) are 4.990 mm apart"
        with pytest.raises(DataError, match=text):
            check_nests(near)
    else:  # it then counts as a nest that stood elsewhere
        assert "nest 2 stood elsewhere at station 4" in check_nests(near)[0]


@pytest.mark.parametrize("station", [1, 3, 5])
def test_exchanged_nests_are_named_at_any_station(station):
    problem = exact()
    a, b = (rows_of(problem, kind=NEST, nest=k, station=station)[0] for k in (1, 4))
    swapped = with_points(problem, {a: problem.xyz[b], b: problem.xyz[a]})
    with pytest.raises(
        DataError, match=rf"nests 1 and 4 are exchanged at tracker station {station}"
    ):
        check_nests(swapped)


@pytest.mark.parametrize(("nest", "station"), [(1, 1), (4, 2), (6, 4), (3, 5)])
def test_a_nest_that_moved_for_good_is_named(nest, station):
    """The last move leaves one station after it, the first one before it: as if badly seated."""
    cell = paper_cell()
    problem = measured("joint", rng=np.random.default_rng(1))
    shift = np.array([3e-4, -2e-4, 4e-4])
    places = {}
    for row in rows_of(problem, kind=NEST, nest=nest):
        s = problem.station[row]
        if s >= station:
            moved = cell.stations[s].to_local(cell.nests[nest - 1] + shift)
            places[row] = (
                problem.xyz[row] + moved - cell.stations[s].to_local(cell.nests[nest - 1])
            )
    (text,) = check_nests(with_points(problem, places))
    moved = rf"a nest moved from row \d+ \(nest, tracker station {station}, nest {nest}\) on"
    assert re.search(rf"{moved}|nest {nest} stood elsewhere at station (0|5)", text)


def test_a_position_without_points_is_absent_in_the_direct_way():
    cell = paper_cell()
    one = replace(
        cell, stations=cell.stations[:1], visits=((*range(5), *range(6, 11), *range(12, 17)),)
    )
    deviations = np.zeros((17, 6))
    deviations[:, 5] = np.random.default_rng(2).normal(0.0, 5 * ARCSEC, 17)
    places = np.array([[0.3, 0.1, 0.1], [0.0, -0.25, 0.2]])
    result = solve(measure_direct(one, deviations, places))
    kept = np.setdiff1d(np.arange(17), [5, 11])
    np.testing.assert_array_equal(result.angles, cell.angles[kept])
    truth = deviations[kept, 5] - deviations[0, 5]
    np.testing.assert_allclose(result.deviations["ECC"], truth, atol=1e-10)
    names = "position 5 (112.5 deg), position 11 (247.5 deg)"
    assert result.warnings[0] == f"no usable points at {names}: left out of the result"
    assert result.verdict == "suspect"


@pytest.mark.parametrize("way", ["stitching", "registration", "joint"])
def test_a_position_without_points_is_absent_with_a_mirror(way):
    cell = paper_cell()
    visits = (*cell.visits[:3], (9, 10, 12), *cell.visits[4:])
    deviations = np.zeros((17, 6))
    deviations[:, 5] = np.random.default_rng(2).normal(0.0, 5 * ARCSEC, 17)
    result = solve(measure(replace(cell, visits=visits), deviations, way=way))
    kept = np.delete(np.arange(17), 11)
    truth = deviations[kept, 5] - deviations[0, 5]
    np.testing.assert_allclose(result.deviations["ECC"], truth, atol=1e-10)
    assert result.warnings[0].startswith("no usable points at position 11 (247.5 deg): left out")


@pytest.mark.parametrize("count", [2, 3])
def test_a_plane_of_rotation_needs_three_normals(count):
    angles = np.radians([0.0, 25.0, 50.0][:count])
    problem = exact("registration", cell=ring_cell(angles, (tuple(range(count)),)))
    if count == 3:
        assert len(solve(problem).angles) == 3
        return
    with pytest.raises(DataError, match=r"2 table positions have a mirror normal, .* at least 3"):
        solve(problem)


@pytest.mark.parametrize("count", [2, 3])
def test_a_circle_needs_three_places(count):
    cell = replace(paper_cell(), stations=paper_cell().stations[:1])
    visits = (tuple(range(0, 6 * count, 6)),)
    problem = measure_direct(
        replace(cell, visits=visits), np.zeros((17, 6)), np.array([[0.3, 0.0, 0.1]])
    )
    if count == 3:
        assert len(solve(problem).angles) == 3
    else:
        with pytest.raises(DataError, match="reflector 1 was measured at 2 table positions"):
            solve(problem)


@pytest.mark.parametrize("arc_deg", [3.5, 6.0])
def test_a_circle_needs_an_arc(arc_deg):
    """The smallest singular value of three directions is about arc^2 / sqrt(96)."""
    angles = np.radians(np.linspace(0.0, 4.0 * arc_deg, 3))
    cell = replace(ring_cell(angles, ((0, 1, 2),)), nests=np.zeros((0, 3)))
    size = np.linalg.svd(
        np.column_stack([np.cos(angles), np.sin(angles), np.ones(3)]), compute_uv=False
    )[-1]
    places = np.array([[0.3, 0.0, 0.1]])
    small = measure_direct(cell, np.zeros((3, 6)), places)
    assert size > 1e-3
    assert len(solve(small).angles) == 3
    tiny = replace(small, angles=0.1 * angles)
    with pytest.raises(GeometryError, match="the places of reflector 1 span too small an arc"):
        solve(tiny)


def test_rows_are_gathered_whatever_their_order():
    problem = measure_direct(
        paper_cell(), np.zeros((17, 6)), np.array([[0.3, 0.1, 0.1], [0.0, -0.25, 0.2]])
    )
    order = np.random.default_rng(4).permutation(len(problem.xyz))
    mixed = only(problem, order)
    found = find_reflectors(mixed)
    assert found.name.tolist() == [1, 2]
    np.testing.assert_array_equal(mixed.nest[found.row], found.name[found.reflector])
    np.testing.assert_array_equal(mixed.position[found.row], found.position)
    np.testing.assert_array_equal(mixed.station[found.row], found.station)
    assert sorted(found.row) == sorted(np.flatnonzero(mixed.kind == DIRECT))
    keys = list(zip(found.reflector, found.position, found.row, strict=True))
    assert keys == sorted(keys)
    nests = find_nests(mixed)
    assert nests.name.tolist() == [1, 2, 3, 4, 5, 6]
    np.testing.assert_array_equal(mixed.nest[nests.row], nests.name[nests.point])
    np.testing.assert_array_equal(mixed.station[nests.row], nests.station)
    assert solve(mixed).deviations["ECC"] == pytest.approx(solve(problem).deviations["ECC"])


def test_a_nest_that_one_station_sees_joins_nothing():
    problem = exact("registration")
    gone = rows_of(problem, kind=NEST, nest=3)
    kept = np.setdiff1d(np.arange(len(problem.xyz)), gone[gone != gone[2]])
    nests = find_nests(only(problem, kept))
    assert nests.name.tolist() == [1, 2, 4, 5, 6]


def test_trials_come_in_any_number():
    trials = mirror_trials(exact("stitching"))
    for count in (1, 250, 251):
        assert trials(np.random.default_rng(1), count).shape == (count, 17)
    assert len(np.unique(trials(np.random.default_rng(1), 501)[:, 3])) == 501


def alternating_without_ties(apart):
    """Two reflectors, at even and at odd positions, but for one if not ``apart``."""
    problem = measured("direct")
    odd = problem.position % 2 == 1
    at_even = problem.nest == problem.nest[problem.kind == PointKind.DIRECT][0]
    keep = (problem.kind != PointKind.DIRECT) | (odd != at_even)
    if not apart:
        keep |= problem.position == 0
    return only(problem, keep)


def test_positions_that_no_reflector_ties_have_zeros_of_their_own():
    """The offset between them was whatever had the smallest norm, at the verdict ok."""
    truth = np.random.default_rng(5).normal(0.0, 5 * ARCSEC, 17)
    tied = solve(alternating_without_ties(apart=False))
    assert tied.zeros.free == ()
    assert tied.zeros.counts_from == "first angle"
    np.testing.assert_allclose(tied.deviations["ECC"], truth - truth[0], atol=1e-9)

    result = solve(alternating_without_ties(apart=True))
    assert result.verdict == "suspect"
    assert "between table positions that share no reflector is not measured (ECC)" in (
        result.verdict_line
    )
    assert result.zeros.counts_from == "first angle of each group"
    np.testing.assert_array_equal(result.zeros.of("ECC", 17)[:, 0], np.arange(17) % 2)
    found = result.deviations["ECC"]
    for first in (0, 1):
        own = truth[first::2] - truth[first]
        np.testing.assert_allclose(found[first::2], own, atol=1e-9)
        assert result.std["ECC"][first] == 0.0
