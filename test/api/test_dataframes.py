"""DataFrames in and out: the same bits as files hold, and errors that name the row."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import rotcal_ros as rc

pandas = pytest.importorskip("pandas", reason="needs pandas: pip install 'rotcal_ros[notebook]'")

DATA = Path(__file__).parents[2] / "examples" / "data"
TABLES = {
    "lengths.csv": "tracer.yaml",
    "balls.csv": "ball_plate.yaml",
    "tracker.csv": "plane_mirror.yaml",
    "three_places/lengths.csv": "tracer_six.yaml",
    "paper/stations.csv": "paper/stations.yaml",
}


def frame_of(path):
    return pandas.read_csv(path, comment="#")


@pytest.fixture
def lengths():
    return frame_of(DATA / "lengths.csv")


@pytest.fixture
def targets():
    return frame_of(DATA / "targets.csv")


@pytest.mark.slow
@pytest.mark.parametrize("name", TABLES)
def test_the_result_has_the_bits_of_that_of_the_file(name):
    path, setup = DATA / name, DATA / TABLES[name]
    beside = path.with_name("targets.csv")
    targets = frame_of(beside) if path.name == "lengths.csv" else None
    of_frame = rc.read_table(frame_of(path), setup, targets).solve()
    assert of_frame.to_json() == rc.read_table(path, setup).solve().to_json()


def test_every_bit_of_a_number_arrives(tmp_path, lengths, targets):
    """Also as pandas itself writes them, and whatever the types of the columns are."""
    rng = np.random.default_rng(1)
    for column in ("x_m", "y_m", "z_m"):
        targets[column] += 1e-7 * rng.random(len(targets))
    lengths["length_m"] += 1e-9 * rng.random(len(lengths))
    lengths.to_csv(tmp_path / "lengths.csv", index=False)
    targets.to_csv(tmp_path / "targets.csv", index=False)
    of_file = rc.read_table(tmp_path / "lengths.csv", DATA / "tracer.yaml")
    typed = lengths.astype({"position": float, "target": "Int64"})
    for table, places in ((lengths, targets), (typed, targets), (lengths.astype(object), targets)):
        of_frame = rc.read_table(table, DATA / "tracer.yaml", places)
        assert of_frame.observations == of_file.observations
        assert of_frame.calibration.plan == of_file.calibration.plan
    assert of_frame.observations[5].mean[0] == lengths["length_m"][5]
    assert list(of_file.sha256) == ["lengths.csv", "targets.csv"]
    assert list(of_frame.sha256) == ["DataFrame", "DataFrame of targets"]
    assert list(of_frame.sha256.values()) == list(of_file.sha256.values())


def test_a_file_and_a_dataframe_go_together(targets):
    table = rc.read_table(DATA / "lengths.csv", DATA / "tracer.yaml", targets)
    same = rc.read_table(DATA / "lengths.csv", DATA / "tracer.yaml")
    assert table.observations == same.observations


def test_targets_that_lie_about_are_not_those_of_a_dataframe(tmp_path, monkeypatch, lengths):
    (tmp_path / "targets.csv").write_text("nothing")
    monkeypatch.chdir(tmp_path)
    table = rc.read_table(lengths, DATA / "tracer.yaml")
    assert list(table.sha256) == ["DataFrame"]


@pytest.mark.parametrize(
    ("column", "value", "words"),
    [
        ("length_m", float("nan"), "^DataFrame, row 7: length_m must be a finite number, found"),
        ("length_m", 313.1, "^DataFrame, row 7: length_m is 313.1 m, .*millimetres"),
        (
            "position",
            0.5,
            "^DataFrame, row 7: position must be a whole number from 0, found '0.5'",
        ),
        ("position", None, "^DataFrame, row 7: position must be a whole number"),
        ("position", 99, "^DataFrame, row 7: position 99, target 0 is not in the plan"),
    ],
)
def test_an_error_names_the_row(column, value, words, lengths):
    lengths[column] = lengths[column].astype(object)
    lengths.loc[7, column] = value
    with pytest.raises(rc.RotcalError, match=words):
        rc.read_table(lengths, DATA / "tracer.yaml")


def test_an_error_names_what_is_no_table(lengths, targets):
    with pytest.raises(rc.RotcalError, match="DataFrame is a table of the method tracer_multi"):
        rc.read_table(lengths, DATA / "ball_plate.yaml")
    with pytest.raises(rc.RotcalError, match=r"^DataFrame: no column length_m: found '?position"):
        rc.read_table(lengths.rename(columns={"length_m": "mm"}), DATA / "tracer.yaml")
    with pytest.raises(rc.RotcalError, match="has a header but no rows"):
        rc.read_table(lengths[:0], DATA / "tracer.yaml")
    with pytest.raises(rc.RotcalError, match=r"^DataFrame of targets, row 3: target 2 is listed"):
        rc.read_table(lengths, DATA / "tracer.yaml", targets.replace({"target": {3: 2}}))


def test_polars_has_other_names_for_the_same(lengths):
    rows = list(lengths.itertuples(index=False, name=None))
    of_polars = SimpleNamespace(columns=list(lengths.columns), iter_rows=lambda: iter(rows))
    found = rc.read_table(of_polars, DATA / "tracer.yaml")
    assert found.observations == rc.read_table(lengths, DATA / "tracer.yaml").observations


def test_results_and_evaluations_become_dataframes():
    plate, tracer = (
        rc.read_result(DATA / f"result_{name}.json") for name in ("ball_plate", "tracer")
    )
    for of_angles in (
        rc.compare(tracer, plate),
        rc.check(plate, tracer, within=rc.ARCSEC),
        rc.iso230(DATA / "runs.csv"),
    ):
        frame = of_angles.to_dataframe()
        assert next(iter(frame)) == "angle_rad"
        for name in list(frame)[1:]:
            np.testing.assert_array_equal(frame[name], getattr(of_angles, name))
    assert {"mean_forward", "mean_reverse", "reversal_i"} < set(frame)
    configuration = rc.read_configuration(DATA / "ball_plate.yaml")
    spread = rc.uncertainty(configuration, trials=4)
    frame = spread.to_dataframe()
    np.testing.assert_array_equal(frame["angle_rad"], spread.result.angles)
    np.testing.assert_array_equal(frame["EXC"], spread.result.deviations["EXC"])
    np.testing.assert_array_equal(frame["EXC_linear_std"], spread.result.std["EXC"])
    np.testing.assert_array_equal(frame["EXC_high"], spread.components["EXC"].high)


def test_a_dataframe_with_other_columns_and_units_is_read_as_the_file_would_be(lengths, targets):
    other = lengths.rename(columns={"length_m": "length [mm]"})
    other["length [mm]"] *= 1000.0
    other["remark"] = "as exported"
    found = rc.read_table(other, DATA / "tracer.yaml", targets).solve()
    usual = rc.read_table(lengths, DATA / "tracer.yaml", targets).solve()
    assert found.deviations["ECC"] == pytest.approx(usual.deviations["ECC"], abs=1e-12)


def test_lists_and_dicts_are_tables_and_a_dict_is_a_set_up(lengths, targets):
    """A list of rows, of mappings, and a dict of columns are what people hold without pandas."""
    setup = {
        "method": "tracer_multistation",
        "table_positions": np.int64(12),
        "table_step_deg": 30,
        "length_std_m": 1e-7,
    }
    expected = rc.read_table(lengths, setup, targets)
    rows = [list(lengths.columns), *lengths.values.tolist()]
    for table in (rows, lengths.to_dict("records"), lengths.to_dict("list")):
        assert rc.read_table(table, setup, targets.to_dict("list")).observations == (
            expected.observations
        )
    assert expected.configuration.solver.length_std_m == 1e-7
    assert rc.read_configuration(setup, "plan.table_positions=6").plan.table_positions == 6


@pytest.mark.parametrize(
    "table", [[], [1, 2], [["position"], 3], {"position": [0], "target": [0, 1]}, {}, None, 5]
)
def test_what_is_no_table_is_said_to_be_none(table):
    with pytest.raises(rc.RotcalError, match="is no table: give a file, a DataFrame"):
        rc.read_table(table, DATA / "tracer.yaml")
    with pytest.raises(rc.RotcalError, match="is no table"):
        rc.compare(DATA / "result_tracer.json", table)


@pytest.mark.parametrize("setup", [None, 3, ["tracer.yaml"]])
def test_what_is_no_set_up_is_said_to_be_none(setup, lengths):
    with pytest.raises(rc.RotcalError, match="a set-up is a file, a dict or a Configuration"):
        rc.read_table(lengths, setup)
    with pytest.raises(rc.RotcalError, match="set-up in a dict"):
        rc.read_table(lengths, {"method": "tracer_multistation", "length": object()})


def test_the_dataframe_of_a_result_is_compared_checked_and_combined():
    tracer, plate = (
        rc.read_result(DATA / f"result_{name}.json") for name in ("tracer", "ball_plate")
    )
    frame = tracer.to_dataframe()
    compared, known = rc.compare(plate, frame), rc.compare(plate, tracer)
    np.testing.assert_allclose(compared.difference, known.difference, atol=1e-15)
    assert compared.agree == known.agree
    assert rc.check(frame, plate, within=3 * rc.ARCSEC).verdict == "still valid"
    assert rc.combine(plate, frame).components == rc.combine(plate, tracer).components
    other = rc.compare(plate.to_dataframe(), plate, "EXC")
    assert not other.difference.any()
    with pytest.raises(rc.RotcalError, match=r"^DataFrame: (no column deviation_rad|.* no unit)"):
        rc.compare(plate, frame[["angle_rad", "ECC"]])


@pytest.mark.parametrize("name", TABLES)
def test_what_was_read_shows_itself_in_a_line(name):
    shown = repr(rc.read_table(DATA / name, DATA / TABLES[name]))
    assert len(shown.splitlines()) == 1
    assert len(shown) < 200
    assert Path(name).name in shown


def test_targets_of_the_same_places_change_no_verdict(lengths, targets):
    """The order of the default plan counted as that of the table where no targets were given."""
    found = [rc.read_table(lengths, DATA / "tracer.yaml", t).solve() for t in (None, targets)]
    assert found[0].verdict_line == found[1].verdict_line
