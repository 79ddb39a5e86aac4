import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rotcal_ros.foundation.errors import BagError, DataError
from rotcal_ros.foundation.tables import read_table, require_header
from rotcal_ros.methods.plane_mirror.method import HEADER, TIMED, read_points

HEAD = "position,tracker_station,kind,nest,x_m,y_m,z_m\n"


def read(folder, text, angles):
    path = folder / "points.csv"
    path.write_bytes(text.encode())
    table = read_table(path)
    require_header(table, (HEADER, TIMED))
    return read_points(table, np.asarray(angles))


def test_a_column_of_times_tells_when_a_row_was_measured(tmp_path):
    head = HEAD.replace("z_m", "z_m,time_s")
    rows = "0,A,direct,1,1,2,3,12.5\n0,A,mirrored,1,2,3,4,13\n,A,nest,1,1,0,0,-2e1\n"
    problem = read(tmp_path, head + rows, [0.0, 1.0])
    assert problem.moment.tolist() == [12.5, 13.0, -20.0]
    assert read(tmp_path, HEAD + "0,A,direct,1,1,2,3\n", [0.0, 1.0]).moment.tolist() == [0.0]
    with pytest.raises(DataError, match="row 2: time_s must be a finite number, found 'noon'"):
        read(tmp_path, head + "0,A,direct,1,1,2,3,noon\n", [0.0, 1.0])


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
def test_every_row_is_read_to_the_last_bit(tmp_path_factory, rows):
    lines = [f"{p},{s},{k},{n},{','.join(map(repr, x))}" for p, s, k, n, x in rows]
    folder = tmp_path_factory.getbasetemp()
    problem = read(folder, HEAD + "\r\n".join(lines) + "\n\n", np.arange(5.0))
    assert [problem.station_names[s] for s in problem.station] == [row[1] for row in rows]
    np.testing.assert_array_equal(problem.xyz, [row[4] for row in rows])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "points.csv: expected the header line 'position,tracker_station"),
        ("position,x\n", "found 'position,x'"),
        (HEAD, "points.csv: the table has a header but no rows"),
        (HEAD + "0,A,direct,1,1,2\n", "row 2: expected 7 values"),
        (HEAD + "0,A,direkt,1,1,2,3\n", "row 2: kind 'direkt', expected direct, mirrored, nest"),
        (HEAD + "x,A,direct,1,1,2,3\n", "row 2: position must be a whole number from 0"),
        (HEAD + "0,A,direct,1000000000000000000000,1,2,3\n", "row 2: nest must be a whole number"),
        (HEAD + "0,,direct,1,1,2,3\n", "row 2: the tracker station is missing"),
        (HEAD + ",A,nest,R1,1,2,3\n", "row 2: nest must be a whole number from 0, found 'R1'"),
        (HEAD + "\n0,A,direct,1,1,2,three\n", "row 3: z_m must be a finite number, found 'three'"),
        (HEAD + "0,A,direct,1,1,2,nan\n", "row 2: z_m must be a finite number, found 'nan'"),
        (HEAD + "0,A,direct,1,1,2,3040.5\n", "row 2: z_m is 3040.5 m, more than 1000 m"),
        (HEAD + "7,A,direct,1,1,2,3\n", "line 2 names position 7, but there are 2"),
    ],
)
def test_bad_tables_name_the_row(tmp_path, text, message):
    with pytest.raises((BagError, DataError)) as caught:
        read(tmp_path, text, [0.0, 1.0])
    assert message in str(caught.value)
