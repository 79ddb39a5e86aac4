"""Tables of angles that occur again: a known play comes back, by order of rows or a column."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods import changed, prepare, read_configuration
from rotcal_ros.methods.calibration import Calibration
from rotcal_ros.methods.measurements import read_measurements

DATA = Path(__file__).parents[3] / "examples" / "data"
PLAY = 6.0 * ARCSEC
BOTH = "plan.bidirectional=true"
ORDER = "plan.order=targets_per_station"
KINDS = {PointKind.DIRECT: "direct", PointKind.MIRRORED: "mirrored", PointKind.NEST: "nest"}
HEADS = {
    "tracer": "angle [deg],target,length [m]",
    "tracer_six": "angle [deg],place,target,length [m]",
    "ball_plate": "angle [deg],ball step,x [m],y [m],z [m]",
    "plane_mirror": "angle [deg],tracker station,kind,nest,x [m],y [m],z [m]",
}


def planned(method, *changes):
    few = ("plan.closing=false",) if method == "ball_plate" else ()
    few += (ORDER,) if method == "tracer" else ()
    return prepare(changed(read_configuration(DATA / f"{method}.yaml"), (*few, *changes)))


def observed(calibration, seed=3):
    """What is seen of a table that turns PLAY farther whenever it comes from above."""
    plan, n = calibration.plan, len(calibration.plan.distinct_angles)
    way = np.arange(len(plan.table_angles)) // n % 2 * calibration.configuration.plan.bidirectional
    angles = tuple((np.array(plan.table_angles) + PLAY * way).tolist())
    steps = tuple(replace(s, table_angle=angles[s.table_position]) for s in plan.steps)
    moved = Calibration(calibration.configuration, replace(plan, table_angles=angles, steps=steps))
    return moved.measured({}, seed).observations


def cells(method, calibration, o):
    angle = f"{calibration.plan.table_angles[o.table_position] / DEGREE % 360:.9g}"
    keys = {
        "tracer": (o.target,),
        "tracer_six": (o.station, o.target),
        "ball_plate": (o.target,),
        "plane_mirror": (o.station, KINDS.get(o.kind, ""), o.target),
    }[method]
    values = o.mean[:1] if "tracer" in method else o.mean
    return angle, *map(str, keys), *map(repr, values)


def write(folder, method, calibration, observations, head="", column=None):
    extra = [(column(o),) if column else () for o in observations]
    rows = [(*cells(method, calibration, o), *e) for o, e in zip(observations, extra, strict=True)]
    text = "\n".join([HEADS[method] + head, *map(",".join, rows)]) + "\n"
    (folder / "table.csv").write_text(text)
    if "tracer" in method:
        targets = enumerate(calibration.plan.targets)
        lines = [f"{n},{','.join(map(repr, map(float, p)))}" for n, p in targets]
        (folder / "targets.csv").write_text("\n".join(["target,x_m,y_m,z_m", *lines]) + "\n")
    return folder / "table.csv"


def shows_the_play(result):
    both = result.directions["ECC"]
    assert len(both.angles) == len(result.angles)
    assert np.abs((both.reversal + PLAY) / both.reversal_std).max() < 4.5
    assert both.reversal_std.max() < 0.3 * PLAY


@pytest.mark.parametrize("method", HEADS)
def test_the_order_of_the_rows_tells_the_direction(method, tmp_path):
    calibration = planned(method, BOTH)
    table = write(tmp_path, method, calibration, observed(calibration))
    result = read_measurements(table, calibration.configuration).solve()
    assert len(result.angles) == len(calibration.plan.distinct_angles)
    shows_the_play(result)


def test_trials_of_a_table_of_points_are_those_of_its_mean_curve(tmp_path):
    calibration = planned("plane_mirror", BOTH)
    table = write(tmp_path, "plane_mirror", calibration, observed(calibration))
    read = read_measurements(table, calibration.configuration)
    values, std = read.trials()(np.random.default_rng(1), 400), read.solve().std["ECC"]
    np.testing.assert_allclose(values.std(axis=0), std, rtol=0.25, atol=1e-12)


def set_up(folder, text):
    (folder / "setup.yaml").write_text(text)
    return read_configuration(folder / "setup.yaml")


def test_without_a_plan_the_table_tells_directions_and_runs(tmp_path):
    calibration = planned("tracer", BOTH, "plan.runs=2")
    observations = observed(calibration)
    table = write(tmp_path, "tracer", calibration, observations)
    own = set_up(tmp_path, "method: tracer_multistation\nlength_std_m: 1.2e-7\n")
    read = read_measurements(table, own)
    assert (read.configuration.plan.runs, read.configuration.plan.bidirectional) == (2, True)
    found = [(o.table_position, o.target, o.mean[0]) for o in read.observations]
    assert found == [(o.table_position, o.target, o.mean[0]) for o in observations]
    result = read.solve()
    shows_the_play(result)
    assert result.runs.forward.shape == result.runs.reverse.shape == (12, 2)


@pytest.mark.parametrize("method", ["tracer", "ball_plate"])
def test_a_column_tells_the_direction_in_any_order(method, tmp_path):
    """Rows are missing and stand in the order of their values, which shows nothing."""
    calibration = planned(method, BOTH)
    observations = sorted(observed(calibration)[1:], key=lambda o: o.mean)
    n = len(calibration.plan.distinct_angles)

    def words(o):
        return "Rück" if o.table_position >= n else "Hin"

    table = write(tmp_path, method, calibration, observations, ",Richtung", words)
    read = read_measurements(table, calibration.configuration)
    found = [(o.table_position, o.target) for o in read.observations]
    assert found == [(o.table_position, o.target) for o in observations]


@pytest.mark.parametrize("last", ["0", "360"])
def test_a_closing_angle_is_a_position_of_its_own(last, tmp_path):
    calibration = planned("tracer", "plan.table_positions=13")
    table = write(tmp_path, "tracer", calibration, observed(calibration))
    n = len(calibration.plan.targets)
    *rows, _ = table.read_text().split("\n")
    rows[-n:] = [f"{last},{row.partition(',')[2]}" for row in rows[-n:]]
    table.write_text("\n".join(rows) + "\n")
    own = set_up(tmp_path, "method: tracer_multistation\nlength_std_m: 1.2e-7\n")
    for configuration in (own, calibration.configuration):
        read = read_measurements(table, configuration)
        assert read.configuration.plan.table_positions == 13 or own is configuration
        assert [o.table_position for o in read.observations][-n:] == [12] * n
    result = read.solve()
    assert result.angles[-1] == pytest.approx(2 * np.pi)
    assert abs(result.deviations["ECC"][-1]) < 4.5 * result.std["ECC"][-1]


def test_a_missing_row_and_a_plan_of_one_direction_are_asked_about(tmp_path):
    calibration = planned("tracer", BOTH)
    observations = observed(calibration)
    table = write(tmp_path, "tracer", calibration, observations[:7] + observations[8:])
    with pytest.raises(DataError, match=r"Add a column 'direction' \(up or down\)"):
        read_measurements(table, calibration.configuration)
    write(tmp_path, "tracer", calibration, observations)
    with pytest.raises(DataError, match=r"measures it once: .* plan.bidirectional=true"):
        read_measurements(table, planned("tracer").configuration)
