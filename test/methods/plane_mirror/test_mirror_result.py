"""What a result of the plane mirror states: counted, placed and normalised as the physics says."""

from dataclasses import replace

import numpy as np
import pytest
from chances import LONG
from coded import coded
from mirror_cell import measure, paper_cell, ring_cell
from mirror_scene import PLACES, estimates, measured

from rotcal_ros.adjust.closures import Closure
from rotcal_ros.adjust.engine import SCATTERS, UNCONTRADICTED
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods.plane_mirror.solver import TrackerNoise, solve
from rotcal_ros.methods.plane_mirror.solver.solve import differing

DIRECT, MIRRORED, NEST = PointKind.DIRECT, PointKind.MIRRORED, PointKind.NEST
WAYS = ("direct", "stitching", "registration", "joint")


@pytest.mark.parametrize("reflectors", [1, 3])
@pytest.mark.parametrize("way", WAYS)
def test_degrees_of_freedom_are_observations_less_unknowns(way, reflectors):
    """6 stations, 17 positions in 22 visits, 36 observations of 6 nests, in every way."""
    visits, positions, stations = 22, 17, 6
    nests = 3 * (36 - 6) - 6 * (stations - 1)
    # of each pair three conditions; axis and lean; angle and distance of each position, while the
    # tilts are observed, too
    dof = 3 * reflectors * visits - 3 - 2 * positions + nests
    if way == "direct":
        # three coordinates of two reflectors; a place of each, centre and axis of the table, and
        # an angle of each position, whose zero is open
        dof = 3 * 2 * visits - 3 * 2 - 2 - 2 - (positions - 1) + nests
    result = solve(measured(way, reflectors=reflectors))
    assert result.dof == dof
    assert result.sigma0 < 1e-3


def test_what_is_measured_once_checks_nothing():
    cell = ring_cell(np.radians([0.0, 30.0, 60.0]), ((0, 1, 2),))
    result = solve(measured("stitching", cell))
    assert (result.dof, result.sigma0, result.verdict) == (0, 1.0, "suspect")
    assert UNCONTRADICTED in coded(*result.warnings)
    assert "stations" not in result.details
    assert "closure_rad" not in result.details


@pytest.mark.parametrize(("way", "reflectors"), [("direct", 1), ("registration", 3), ("joint", 3)])
def test_normalised_residuals_have_the_size_one(way, reflectors):
    """Of each kind of point, by its worst coordinate; redundancies count what is checked."""
    largest = {kind: [] for kind in (DIRECT, MIRRORED, NEST)}
    for seed in range(6 if LONG else 2):
        problem = measured(way, rng=np.random.default_rng(seed), reflectors=reflectors)
        result = solve(problem)
        table = result.residuals
        assert table.used.all()
        for kind, found in largest.items():
            found.append(np.abs(table.test_value[problem.kind == kind]))
    of_three = np.abs(np.random.default_rng(0).standard_normal((100_000, 3))).max(axis=1)
    for kind, found in largest.items():
        found = np.concatenate(found)
        if len(found):
            assert found.mean() == pytest.approx(of_three.mean(), rel=0.2), kind
    carried = problem.kind != NEST
    share = 3.0 * table.redundancy
    # a pair's is shared by its two points
    assert share.sum() == pytest.approx(result.dof, abs=17.0)
    assert table.residual[carried].mean() == pytest.approx(8e-6, rel=0.6)
    np.testing.assert_array_equal(table.table_position, problem.position)
    np.testing.assert_array_equal(table.target, problem.nest)


@pytest.mark.parametrize("way", ["direct", "registration", "joint"])
def test_stations_and_nests_stand_where_they_were_put(way):
    cell = paper_cell()
    result = solve(measured(way))
    first = cell.stations[0]
    for s, (entry, stand) in enumerate(
        zip(result.details["stations"], cell.stations, strict=True)
    ):
        assert entry["station"] == str(s)
        np.testing.assert_allclose(
            entry["position_m"], first.to_local(np.array(stand.place)), atol=1e-10
        )
        point = np.array([0.3, -0.7, 1.1])
        np.testing.assert_allclose(
            entry["rotation"] @ stand.to_local(point) + entry["position_m"], first.to_local(point),
            atol=1e-10,
        )  # fmt: skip
    nests = result.details["nests"]
    assert sorted((n["nest"], n["station"]) for n in nests) == [
        (k, str(s)) for k in range(1, 7) for s in range(6)
    ]
    for entry in nests:
        there = first.to_local(cell.nests[entry["nest"] - 1])
        np.testing.assert_allclose(entry["position_m"], there, atol=1e-10)
        assert np.linalg.norm(entry["residual_m"]) < 1e-10
        assert entry["test_value"] < 1e-3


@pytest.mark.parametrize("way", ["stitching", "registration", "joint"])
def test_normals_lean_and_incidence_are_those_of_the_mirror(way):
    cell = paper_cell(reflectors=2, lean=3.0 * DEGREE)
    problem = measured(way, cell)
    result = solve(problem)
    assert result.details["lean_rad"] == pytest.approx(3.0 * DEGREE, abs=1e-9)
    assert result.details["incidence_limit_rad"] == pytest.approx(50.0 * DEGREE)
    if result.details["axis"] is not None:
        up = cell.stations[0].to_local(np.array([0, 0, 1.0])) - cell.stations[0].to_local(
            np.zeros(3)
        )
        np.testing.assert_allclose(result.details["axis"], up, atol=1e-9)
    np.testing.assert_allclose(result.details["tilts_rad"], np.zeros(17), atol=1e-9)
    found = result.details["normals"]
    visits = sorted((i, s) for s, visit in enumerate(cell.visits) for i in visit)
    assert len(found) == len(visits)
    deviation = np.random.default_rng(5).normal(0.0, 5 * ARCSEC, 17)
    for entry, (i, s) in zip(found, visits, strict=True):
        assert entry["station"] == str(s)
        assert entry["angle_rad"] == cell.angles[i]
        a, lean = cell.angles[i] + deviation[i], 3.0 * DEGREE
        n = np.array([np.cos(lean) * np.cos(a), np.cos(lean) * np.sin(a), np.sin(lean)])
        stand = cell.stations[s]
        np.testing.assert_allclose(
            entry["normal"], stand.to_local(n) - stand.to_local(np.zeros(3)), atol=1e-9
        )
        at = (problem.position == i) & (problem.station == s) & (problem.kind == MIRRORED)
        beams = problem.xyz[at] / np.linalg.norm(problem.xyz[at], axis=1)[:, None]
        steepest = np.arccos(-beams @ entry["normal"]).max()
        assert entry["incidence_rad"] == pytest.approx(steepest)


def test_radii_and_axis_of_the_direct_way():
    result = solve(measured("direct"))
    expected = np.hypot(PLACES[:, 0], PLACES[:, 1])
    np.testing.assert_allclose(result.details["radii_m"], expected, atol=1e-9)
    stand = paper_cell().stations[0]
    up = stand.to_local(np.array([0, 0, 1.0])) - stand.to_local(np.zeros(3))
    np.testing.assert_allclose(result.details["axis"], up, atol=1e-9)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_the_closure_counts_in_the_sense_of_the_command(sense):
    """A table that stands 20 arcsec too far on after a turn, whichever way it turned."""
    cell = paper_cell()
    deviations = np.zeros((17, 6))
    deviations[16, 5] = 20 * ARCSEC
    problem = measure(cell, deviations, way="registration")
    flipped = replace(problem, angles=sense * problem.angles)
    result = solve(flipped)
    (entry,) = result.details["repeats"]
    assert (entry["first"], entry["second"]) == (0, 16)
    error = result.deviations["ECC"][16] - result.deviations["ECC"][0]
    assert entry["difference_rad"] == error
    assert result.details["closure_rad"] == pytest.approx(sense * error)
    assert result.details["closure_std_rad"] == entry["std_rad"] > 0.0
    assert entry["std_rad"] == pytest.approx(result.std["ECC"][16], rel=1e-6)


def test_positions_that_differ_are_named_with_what_chance_allows():
    angles = np.radians([0.0, 90.0, 450.0])
    found = Closure(1, 2, 3.3 * ARCSEC, 1.0 * ARCSEC)
    (text,) = differing([Closure(0, 1, 3.2 * ARCSEC, ARCSEC), found], angles, 1e-3)
    assert text.startswith(
        "positions commanded to 90 and 450 deg differ by 3.30 arcsec, expected within 2.00"
    )


@pytest.mark.parametrize("way", WAYS)
def test_too_small_a_noise_scales_the_covariance(way):
    noise = TrackerNoise()
    small = TrackerNoise(*(0.3 * v for v in (2.5e-6, 0.25e-6, 3.75e-6, 1.5e-6)))
    problem = measured(way, rng=np.random.default_rng(1), noise=noise, reflectors=2)
    problem = replace(problem, noise=small, tilt_std=1e-9)
    result = solve(problem)
    assert result.sigma0 > 1.5
    assert result.verdict == "suspect"
    assert SCATTERS in coded(*result.warnings)
    n, step = problem.xyz.size, 1e-6
    moved = problem.xyz + step * np.eye(n).reshape(n, *problem.xyz.shape)
    slope = (estimates(problem, moved) - estimates(problem, 2.0 * problem.xyz - moved)) / (
        2 * step
    )
    slope = slope.reshape(-1, 3, 17)
    expected = np.einsum("rik,rij,rjl->kl", slope, small.covariance(problem.xyz), slope)
    factor = np.sqrt(np.trace(result.covariance["ECC"]) / np.trace(expected))
    assert factor == pytest.approx(1.0 / 0.3, rel=0.3)
