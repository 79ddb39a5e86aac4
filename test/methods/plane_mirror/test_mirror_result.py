"""What a result of the plane mirror states: counted, placed and normalised as the physics says."""

from dataclasses import replace

import numpy as np
import pytest
from chances import LONG
from mirror_cell import measure, paper_cell, ring_cell
from mirror_scene import PLACES, measured
from scipy.optimize import least_squares

from rotcal_ros.adjust.closures import Closure
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods.plane_mirror.solver import TrackerNoise, solve
from rotcal_ros.methods.plane_mirror.solver.prepare import prepare
from rotcal_ros.methods.plane_mirror.solver.solve import differing

DIRECT, MIRRORED, NEST = PointKind.DIRECT, PointKind.MIRRORED, PointKind.NEST
WAYS = ("direct", "stitching", "registration", "joint")


@pytest.mark.parametrize("reflectors", [1, 3])
@pytest.mark.parametrize("way", WAYS)
def test_degrees_of_freedom_are_observations_less_unknowns(way, reflectors):
    """6 stations, 17 positions in 22 visits, 36 observations of 6 nests."""
    visits, positions, stations = 22, 17, 6
    nests = 3 * (36 - 6) - 6 * (stations - 1)
    pairs = reflectors * visits
    planes = 3 * (pairs - visits)  # of each pair three conditions, of each plane three unknowns
    dof = {
        # each of two reflectors: heights about a plane, radii about a circle, angles twice
        "direct": 2 * (2 * visits) - 2 * 6 + (2 * visits - positions - 1) + nests,
        # five stations with four normals have cones, and angles of their own zero
        "stitching": planes + 5 * (4 - 3) + (visits - (positions + stations - 1)),
        "registration": planes + (visits - 3) + (visits - positions) + nests,
        # axis and lean; of each position angle, tilt and distance, and the tilt is observed too
        "joint": planes + 3 * visits - 3 - 2 * positions + nests,
    }[way]
    if way == "direct":
        dof -= 2 * visits - positions - 1  # the ties of equal positions are not tested
    result = solve(measured(way, reflectors=reflectors))
    assert result.dof == dof
    assert result.sigma0 < 1e-3


def test_what_is_measured_once_checks_nothing():
    cell = ring_cell(np.radians([0.0, 30.0, 60.0]), ((0, 1, 2),))
    result = solve(measured("stitching", cell))
    assert (result.dof, result.sigma0, result.verdict) == (0, 1.0, "suspect")
    assert result.warnings == ("nothing is measured twice: the noise could not be checked",)
    assert "stations" not in result.details
    assert "closure_rad" not in result.details


@pytest.mark.parametrize(("way", "reflectors"), [("direct", 1), ("registration", 3), ("joint", 3)])
def test_normalised_residuals_have_the_size_one(way, reflectors):
    """Of each kind of row, over many measurements; redundancies count what is checked."""
    squares = {kind: [] for kind in (DIRECT, MIRRORED, NEST)}
    for seed in range(6 if LONG else 2):
        problem = measured(way, rng=np.random.default_rng(seed), reflectors=reflectors)
        table = solve(problem).residuals
        assert table.used.all()
        for kind, found in squares.items():
            found.append(table.test_value[problem.kind == kind] ** 2)
    for kind, found in squares.items():
        found = np.concatenate(found)
        if len(found):
            assert found.mean() == pytest.approx(1.0, abs=5.0 / np.sqrt(len(found))), kind
    nests = problem.kind == NEST
    assert 3.0 * table.redundancy[nests].sum() == pytest.approx(60.0)
    if way == "direct":
        # each circle takes 6 of the 2 checked coordinates of 22 points, evenly
        assert 3.0 * table.redundancy[~nests].sum() == pytest.approx(2 * (2 * 22 - 2 * 3))
        assert table.residual[~nests].mean() == pytest.approx(8e-6, rel=0.5)
    else:
        assert 3.0 * table.redundancy[~nests].sum() == pytest.approx(3 * (66 - 22), rel=1e-6)
    np.testing.assert_array_equal(table.table_position, problem.position)
    np.testing.assert_array_equal(table.target, problem.nest)


def test_residuals_of_pairs_are_the_corrections_that_the_plane_wants():
    """Least squares over places of reflectors and the plane, by scipy; one position."""
    cell = ring_cell(np.radians([0.0, 20.0, 40.0, 60.0]), ((0, 1, 2, 3),), reflectors=3)
    problem = measured("stitching", cell, rng=np.random.default_rng(3))
    table = solve(problem).residuals
    at = (problem.position == 1) & (problem.kind != NEST)
    near, far = (problem.xyz[at & (problem.kind == kind)] for kind in (DIRECT, MIRRORED))
    roots = [
        np.linalg.inv(np.linalg.cholesky(problem.noise.covariance(points)))
        for points in (near, far)
    ]

    def corrections(unknown):
        n, h = unknown[:3] / np.linalg.norm(unknown[:3]), unknown[3]
        place = near + unknown[4:].reshape(-1, 3)
        image = place - 2.0 * (place @ n - h)[:, None] * n
        return near - place, far - image

    def misfit(unknown):
        both = [
            np.einsum("pij,pj->pi", root, off)
            for root, off in zip(roots, corrections(unknown), strict=True)
        ]
        return np.append(np.concatenate(both).ravel(), 1e3 * (np.linalg.norm(unknown[:3]) - 1.0))

    n = (near - far).sum(axis=0)
    n /= np.linalg.norm(n)
    start = np.concatenate([n, [((near + far) @ n).mean() / 2], np.zeros(9)])
    best = least_squares(misfit, start, x_scale=np.r_[np.ones(4), np.full(9, 1e-5)],
                         xtol=1e-15, ftol=1e-15, gtol=1e-15).x  # fmt: skip
    for kind, wanted in zip((DIRECT, MIRRORED), corrections(best), strict=True):
        found = table.residual[at & (problem.kind == kind)]
        np.testing.assert_allclose(found, np.linalg.norm(wanted, axis=1), atol=1e-8)


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
            entry["position_m"], first.seen(np.array(stand.place)), atol=1e-10
        )
        point = np.array([0.3, -0.7, 1.1])
        np.testing.assert_allclose(
            entry["rotation"] @ stand.seen(point) + entry["position_m"], first.seen(point),
            atol=1e-10,
        )  # fmt: skip
    nests = result.details["nests"]
    assert sorted((n["nest"], n["station"]) for n in nests) == [
        (k, str(s)) for k in range(1, 7) for s in range(6)
    ]
    for entry in nests:
        there = first.seen(cell.nests[entry["nest"] - 1])
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
    if way != "stitching":
        up = cell.stations[0].seen(np.array([0, 0, 1.0])) - cell.stations[0].seen(np.zeros(3))
        np.testing.assert_allclose(result.details["axis"], up, atol=1e-9)
    if way == "joint":
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
            entry["normal"], stand.seen(n) - stand.seen(np.zeros(3)), atol=1e-9
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
    up = stand.seen(np.array([0, 0, 1.0])) - stand.seen(np.zeros(3))
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
    assert result.warnings[0].startswith(
        f"the residuals are {result.sigma0:.2f} times what the stated noise explains"
    )
    prepared = prepare(problem).prepared
    n, step = problem.xyz.size, 1e-6
    moved = problem.xyz + step * np.eye(n).reshape(n, *problem.xyz.shape)
    slope = (prepared.estimate(moved) - prepared.estimate(2.0 * problem.xyz - moved)) / (2 * step)
    slope = slope.reshape(-1, 3, 17)
    expected = np.einsum("rik,rij,rjl->kl", slope, small.covariance(problem.xyz), slope)
    found = result.covariance["ECC"] / result.sigma0**2
    np.testing.assert_allclose(found, expected, atol=2e-3 * expected.max())
