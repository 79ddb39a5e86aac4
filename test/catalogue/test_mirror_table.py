import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rotcal_ros.catalogue.plane_mirror.mirror_physics import measure, paper_cell
from rotcal_ros.catalogue.plane_mirror.table import read_points, write_points
from rotcal_ros.errors import DataError
from rotcal_ros.methods.plane_mirror import (
    PlaneMirrorProblem,
    problem_from_observations,
    solve,
)
from rotcal_ros.observations import Observation, PointKind

HEAD = "position,tracker_station,kind,nest,x_m,y_m,z_m\n"


def test_table_gives_the_same_result_to_the_last_bit():
    problem = measure(paper_cell(), np.zeros((17, 6)), rng=np.random.default_rng(1))
    again = read_points(write_points(problem), "points.csv", problem.angles)
    np.testing.assert_array_equal(again.xyz, problem.xyz)
    np.testing.assert_array_equal(solve(again).deviations["ECC"], solve(problem).deviations["ECC"])


@given(
    st.lists(
        st.tuples(
            st.integers(0, 4),
            st.sampled_from(["A", "B2", "Süd"]),
            st.sampled_from(["direct", "mirrored", "nest"]),
            st.integers(0, 99),
            st.tuples(*[st.floats(-1e3, 1e3).filter(lambda v: v != 0.0)] * 3),
        ),
        min_size=1,
        max_size=8,
        unique_by=lambda row: row[4],
    )
)
@settings(max_examples=60, deadline=None)
def test_every_table_survives_the_way_out_and_back(rows):
    lines = [f"{p},{s},{k},{n},{','.join(map(repr, x))}" for p, s, k, n, x in rows]
    problem = read_points(HEAD + "\r\n".join(lines) + "\n\n", "points.csv", np.arange(5.0))
    assert [problem.station_names[s] for s in problem.station] == [row[1] for row in rows]
    np.testing.assert_array_equal(problem.xyz, [row[4] for row in rows])
    again = read_points(write_points(problem), "points.csv", np.arange(5.0))
    np.testing.assert_array_equal(again.xyz, problem.xyz)
    np.testing.assert_array_equal(again.kind, problem.kind)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "t.csv: the columns are missing, expected position, tracker_station"),
        ("position;x\n", "t.csv: the columns are position;x, expected"),
        (HEAD, "t.csv: no points below the header"),
        (HEAD + "0,A,direct,1,1,2\n", "line 2: 6 columns, expected 7"),
        (HEAD + "0,A,direkt,1,1,2,3\n", "line 2: kind 'direkt', expected direct, mirrored, nest"),
        (HEAD + "x,A,direct,1,1,2,3\n", "line 2: position 'x', expected a whole number"),
        (HEAD + "0,,direct,1,1,2,3\n", "line 2: the tracker station is missing"),
        (HEAD + ",A,nest,R1,1,2,3\n", "line 2: nest 'R1', expected a whole number"),
        (HEAD + "\n0,A,direct,1,1,2,three\n", "line 3: coordinate 'three' is not a number"),
        (HEAD + "0,A,direct,1,1,2,nan\n", "line 2: coordinate 'nan' is not a finite number"),
        (HEAD + "0,A,direct,1,1,2,3040.5\n", "are the points in millimetres"),
        (HEAD + "7,A,direct,1,1,2,3\n", "line 2 names position 7, but there are 2"),
    ],
)
def test_bad_tables_name_the_line(text, message):
    with pytest.raises(DataError) as caught:
        read_points(text, "t.csv", np.array([0.0, 1.0]))
    assert message in str(caught.value)


def observation(kind, index, station, nest, mean, accepted=True):
    triple = (1e-6, 1e-6, 1e-6)
    return Observation(
        0, 0, index, 0.0, nest, station, kind, mean, triple, triple, (0.0, 0.0, 0.0), 9, 9,
        accepted, "", 0.0, None, 0, 1,
    )  # fmt: skip


def test_observations_become_the_problem():
    problem = problem_from_observations(
        [
            observation(PointKind.NEST, 0, 4, 2, (1.0, 2.0, 3.0)),
            observation(PointKind.DIRECT, 1, 7, 1, (1.5, 2.0, 3.0)),
            observation(PointKind.MIRRORED, 1, 7, 1, (2.5, 2.0, 3.0), accepted=False),
            observation(PointKind.CENTRE, 1, 7, 1, (2.5, 2.0, 3.0)),
        ],
        np.array([0.0, 1.0]),
    )
    assert isinstance(problem, PlaneMirrorProblem)
    assert problem.station.tolist() == [0, 1]
    assert problem.station_names == ("4", "7")
    assert problem.kind.tolist() == [PointKind.NEST, PointKind.DIRECT]
    np.testing.assert_array_equal(problem.xyz[1], [1.5, 2.0, 3.0])
