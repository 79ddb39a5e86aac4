"""Raw readings of a tracer on a table that turned: turns are found, and become lengths."""

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet
from turning_scene import assert_true, turning_scene, write_turns

import rotcal_ros as rc
from rotcal_ros.foundation.errors import BagError, DataError

NOISE = "solver: {length_std_m: 8.0e-8, error_motion_std_m: 0.0}\n"
ANGLES = ", table_positions: 36, table_step_deg: 10, passing_deg: 0.51"


@pytest.fixture(scope="module")
def scene():
    return turning_scene(41, angles=36, speeds_deg_s=(60.0, -60.0), window_deg=0.51)


def rows_of(scene, turns=None):
    """Return the readings (n, 3) of turns, and (n,) the target of each."""
    turns = range(len(scene.readings)) if turns is None else turns
    target = [np.full(len(scene.readings[k]), k // 2) for k in turns]
    return np.concatenate([scene.readings[k] for k in turns]), np.concatenate(target)


def written(scene, folder, rows, target=None, plan=ANGLES):
    """Write readings as a table; one that is nan is left empty. Return what is read of it."""
    setup = f"plan: {{tracer_m: {scene.place.round(3).tolist()}{plan}}}\n{NOISE}"
    table, settings = write_turns(scene, folder, setup=setup)
    cells = [[f"{t!r},{a!r},{'' if np.isnan(x) else repr(x)}"] for t, a, x in rows.tolist()]
    if target is not None:
        cells = [[*line, str(number)] for line, number in zip(cells, target.tolist(), strict=True)]
    header = "time_s,angle_deg,length_m" + ",target" * (target is not None)
    table.write_text("\n".join([header, *map(",".join, cells)]) + "\n")
    return rc.read_table(table, rc.read_configuration(settings))


def test_turns_are_found_and_their_lengths_are_those_of_a_cubic(scene, tmp_path):
    rows, _ = rows_of(scene)
    rows[:, 1] %= 360.0  # a feedback that wraps around
    measured = written(scene, tmp_path, rows)
    assert measured.configuration.plan.turning_deg_s == pytest.approx((60.0, -60.0), rel=1e-6)
    assert_true(scene, measured, 1e-10)


def test_a_broken_turn_counts_from_another_zero_and_again_where_it_is_made_again(scene, tmp_path):
    rows, target = rows_of(scene)
    way, again = scene.readings[6][::4].copy(), scene.readings[7].copy()  # four times as fast
    way[:, 0] = rows[-1, 0] + 1.0 + 1e-3 * np.arange(len(way))
    again[:, 0] += way[-1, 0] + 1.0 - again[0, 0]
    of_last = slice(len(rows) - len(again), len(rows))
    rows = np.concatenate([rows, way, again])
    target = np.append(target, np.full(len(way) + len(again), 3))
    dark = np.flatnonzero(np.abs(rows[of_last, 1] - 200.0) < 1.0) + of_last.start
    rows[dark, 2] = np.nan
    rows[dark[-1] + 1 : of_last.stop, 2] += 2e-3
    speeds = ANGLES + ", turning_deg_s: [60, -60]"
    measured = written(scene, tmp_path, rows, target, speeds)
    refused = [o for o in measured.observations if not o.accepted]
    assert [(o.target, o.station, o.table_position, o.attempt) for o in refused] == [(3, 1, 20, 0)]
    assert refused[0].reason == "beam broken while the table passed"
    last = [o for o in measured.observations if (o.target, o.station) == (3, 1)]
    assert {o.attempt for o in last} == {0, 1}
    zeros = {o.segment for o in last if o.attempt == 0 and o.table_position > 20}
    others = {o.segment for o in last if o.attempt == 0 and o.table_position < 20}
    assert len(zeros) == len(others) == 1
    assert zeros != others
    assert measured.solve().verdict == "ok"


def test_the_same_readings_as_parquet_are_the_same_lengths(scene, tmp_path):
    rows, target = rows_of(scene)
    rows[100:110, 2] = np.nan  # before the first angle
    as_text = written(scene, tmp_path, rows, target)
    columns = dict(zip(("time_s", "angle_deg", "length_m"), rows.T.tolist(), strict=True))
    columns |= {"target": target.tolist()}
    columns["length_m"] = [None if np.isnan(x) else x for x in columns["length_m"]]
    path = tmp_path / "turns.parquet"
    parquet.write_table(pyarrow.table(columns), path)
    measured = rc.read_table(path, rc.read_configuration(tmp_path / "setup.yaml"))
    assert measured.observations == as_text.observations
    assert set(measured.sha256) == {"turns.parquet"}
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(BagError, match="cannot read the table"):
        rc.read_table(path, rc.read_configuration(tmp_path / "setup.yaml"))


def test_without_angles_a_whole_turn_is_wanted_by_degrees(scene, tmp_path):
    measured = written(scene, tmp_path, rows_of(scene)[0], plan="")
    assert measured.configuration.plan.table_angles_deg == tuple(map(float, range(360)))
    assert len(measured.observations) == 8 * 360
    part = np.concatenate([t[np.abs(t[:, 1] - 90.0) < 80.0] for t in scene.readings])
    with pytest.raises(DataError, match="no whole turn: at which angles"):
        written(scene, tmp_path, part, plan="")


def test_what_tells_no_target_or_no_turn_is_asked_for(scene, tmp_path):
    rows, target = rows_of(scene, range(7))
    with pytest.raises(
        DataError, match="found 7 turns, expected one at each of 2 speeds for each"
    ):
        written(scene, tmp_path, rows)
    with pytest.raises(DataError, match="is of target 0, 1, expected one of 0 to 3"):
        written(scene, tmp_path, rows, np.append(target[1:], 0) + (np.arange(len(rows)) == 900))
    with pytest.raises(DataError, match=r"never turned from -0\.5 to 400\.5 deg"):
        written(scene, tmp_path, rows, plan=", table_positions: 41, table_step_deg: 10.0")
    with pytest.raises(DataError, match="row 12: time_s does not grow"):
        written(scene, tmp_path, np.concatenate([rows[:10], rows[3:]]))
