"""What the solver of the plane mirror is given: noise, rows, names and what is refused."""

from dataclasses import astuple, replace

import numpy as np
import pytest

from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.observations import Approach, PointKind
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.plane_mirror.settings import MirrorSolverSettings
from rotcal_ros.methods.plane_mirror.solver import TrackerNoise, problem_from_observations
from rotcal_ros.methods.plane_mirror.solver.problem import PlaneMirrorProblem, noise_of
from rotcal_ros.planning.plan import Step

DIRECT, MIRRORED, NEST = PointKind.DIRECT, PointKind.MIRRORED, PointKind.NEST


def test_the_noise_of_the_settings_in_metres_and_radians():
    settings = MirrorSolverSettings(
        range_std_m=1e-6,
        range_std_relative=2e-7,
        transverse_std_m=3e-6,
        transverse_std_relative=4e-7,
        mirror_slope_std_arcsec=5.0,
    )
    expected = (1e-6, 2e-7, 3e-6, 4e-7, np.radians(5.0 / 3600.0))
    assert astuple(noise_of(settings)) == pytest.approx(expected, rel=1e-12)
    usual = TrackerNoise(2.5e-6, 2.5e-7, 3.75e-6, 1.5e-6, 0.0)
    assert TrackerNoise() == usual == noise_of(MirrorSolverSettings())


@pytest.mark.parametrize("place", range(5))
@pytest.mark.parametrize("value", [-1e-9, np.nan, np.inf])
def test_noise_is_finite_and_not_negative(place, value):
    values = [1e-6] * 5
    values[place] = value
    with pytest.raises(DataError, match="finite and not negative"):
        TrackerNoise(*values)


def test_noise_along_and_across_may_have_one_part_alone():
    for parts in ((0, 1e-9, 0, 1e-9, 0), (1e-9, 0, 1e-9, 0, 0)):
        assert TrackerNoise(*parts).mirror_slope_std == 0
    for parts in ((0, 0, 1e-6, 1e-6, 0), (1e-6, 1e-6, 0, 0, 1e-6)):
        with pytest.raises(DataError, match="must be above zero"):
            TrackerNoise(*parts)


def test_a_problem_of_accepted_points():
    """Stations count from 0 in the problem; names keep those of the plan."""
    seen = [(DIRECT, 7, 1), (MIRRORED, 7, 1), (NEST, 4, 3), (NEST, 7, 3), (DIRECT, 7, 2)]
    points = [(1.0 + k, 2.0, 3.0) for k in range(5)]
    observations = [
        Step(k, k % 2, 0.5, Approach.POSITIVE, kind, nest, (0.0, 0.0, 0.0), station=station)
        .observed(points[k])
        for k, (kind, station, nest) in enumerate(seen)
    ]  # fmt: skip
    observations.insert(1, replace(observations[0], accepted=False))
    observations.append(replace(observations[0], kind=PointKind.SURFACE))
    problem = problem_from_observations(iter(observations), np.array([0.0, 0.5]))
    assert problem.kind.tolist() == [kind for kind, _, _ in seen]
    assert problem.station.tolist() == [1, 1, 0, 1, 1]
    assert problem.nest.tolist() == [nest for _, _, nest in seen]
    assert problem.position.tolist() == [0, 1, 0, 1, 0]
    np.testing.assert_array_equal(problem.xyz, points)
    assert problem.station_names == ("4", "7")
    assert problem.angles.tolist() == [0.0, 0.5]
    for name in ("kind", "station", "nest", "position"):
        assert getattr(problem, name).dtype == np.int64
    assert problem.way == "joint"
    with pytest.raises(DataError, match="points must be"):
        problem_from_observations([], np.array([0.0, 0.5]))


def small(**changes):
    fields = {
        "angles": [0.0, np.pi / 2],
        "position": [0, 1, 5],
        "station": [0, 0, 1],
        "kind": [DIRECT, MIRRORED, NEST],
        "nest": [1, 2, 3],
        "xyz": np.eye(3),
    }
    return PlaneMirrorProblem(**{**fields, **changes})


def test_rows_are_named_by_their_places():
    problem = small()
    assert problem.row_name(0) == "row 0 (direct, position 0 (0 deg), tracker station 0, nest 1)"
    assert (
        problem.row_name(1) == "row 1 (mirrored, position 1 (90 deg), tracker station 0, nest 2)"
    )
    assert problem.row_name(2) == "row 2 (nest, tracker station 1, nest 3)"
    named = small(station_names=("A", "B"), lines=(3, 5, 8))
    assert named.row_name(2) == "line 8 (nest, tracker station B, nest 3)"
    assert (named.place(0), named.station_name(0)) == ("line 3", "A")
    assert named.position_name(1) == "position 1 (90 deg)"
    assert problem.tilt_std == pytest.approx(ARCSEC)
    assert problem.significance == 0.005
    assert problem.incidence_limit == pytest.approx(np.radians(50.0))


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"way": "sideways"}, "unknown way 'sideways'; choose one of direct"),
        ({"angles": [0.0]}, "at least 2 commanded angles"),
        ({"angles": [0.0, np.nan]}, "commanded angle is not a number"),
        ({"angles": [[0.0, 1.0]]}, "at least 2 commanded angles"),
        ({"xyz": np.ones((3, 2))}, r"points must be \(n, 3\), found \(3, 2\)"),
        ({"position": [0, 1]}, r"position has shape \(2,\), expected \(3,\)"),
        ({"station": [0, 0, 2]}, r"must count from 0, found \[0, 2\]"),
        ({"station": [0, 0, -1]}, r"must count from 0, found \[-1, 0\]"),
        ({"position": [0, 2, 5]}, "row 1 names position 2, but there are 2 commanded"),
        ({"position": [-1, 1, 5]}, "row 0 names position -1"),
        ({"incidence_limit": 0.0}, "incidence_limit between 0 and"),
        ({"incidence_limit": np.pi / 2}, "incidence_limit between 0 and"),
        ({"tilt_std": 0.0}, "tilt_std must be above 0"),
        ({"kind": [DIRECT, PointKind.CENTRE, NEST]}, "row 1 has kind 3"),
        ({"xyz": np.diag([1.0, 0.0, 1.0])}, r"row 1 .* no valid coordinates: \[0.0, 0.0, 0.0\]"),
        ({"xyz": np.diag([1.0, np.inf, 1.0])}, "row 1 .* no valid coordinates"),
        ({"xyz": np.ones((3, 3))}, "row 1 .* and row 0 .* are the same point to the last digit"),
    ],
)
def test_problems_that_cannot_be(changes, text):
    with pytest.raises(DataError, match=text):
        small(**changes)
    assert small().lines == ()


def test_a_nest_measured_again_may_come_out_the_same():
    point = np.full(3, 0.5)
    nests = {"kind": [NEST] * 3, "station": [0, 0, 0]}
    twice = small(**nests, nest=[0, 1, 0], xyz=np.array([point, 2 * point, point]))
    assert len(twice.xyz) == 3
    with pytest.raises(DataError, match=r"row 2 .* and row 0 .* are the same point"):
        small(**nests, nest=[0, 1, 2], xyz=twice.xyz)
