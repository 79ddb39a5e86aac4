"""What the front door adds of its own: raw streams, data frames, sources of every kind."""

import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import rotcal_ros as rc
from rotcal_ros.evaluation.iso230 import BidirectionalRuns
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.circumstances import Circumstances
from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.results import RepeatedRuns

ROOT = Path(__file__).parents[2]
DATA = ROOT / "examples" / "data"
GOLDEN = ROOT / "test" / "golden"


@pytest.fixture(scope="module")
def plate():
    return rc.read_result(DATA / "result_ball_plate.json")


def test_raw_streams_are_all_that_the_capture_received():
    """The tracer's golden bag has two files, damaged lengths, and all four streams."""
    streams = rc.read_streams(GOLDEN / "tracer" / "bag")
    counts = rc.read_bag(GOLDEN / "tracer" / "bag").counts
    received = {name: stream["received"] for name, stream in counts.items()}
    assert len(streams.lengths) == received["tracer"]
    assert len(streams.angles) == received["table"]
    assert len(streams.points) == received["probe"]
    assert len(streams.temperatures) == received["temperature"]
    assert np.median(np.diff(streams.angles["stamp_ns"])) == 40_000_000  # 25 Hz
    assert np.any(streams.lengths["status"] != 1)


def test_raw_lengths_average_to_what_the_capture_found():
    streams = rc.read_streams(GOLDEN / "tracer" / "bag")
    observation = next(
        o for o in rc.read_bag(GOLDEN / "tracer" / "bag").observations if o.accepted
    )
    stamps = streams.lengths["stamp_ns"]
    inside = (stamps >= observation.window_start_ns) & (stamps <= observation.window_end_ns)
    good = streams.lengths["length"][inside & (streams.lengths["status"] == 1)]
    assert np.median(good) == pytest.approx(observation.mean[0], abs=1e-6)


def test_raw_streams_of_no_bag(tmp_path):
    with pytest.raises(BagError, match="does not exist"):
        rc.read_streams(tmp_path / "nothing")


def test_the_bag_of_the_examples_is_what_the_cell_delivers():
    recording = rc.read_bag(DATA / "ball_plate_bag")
    configuration = rc.read_configuration(DATA / "ball_plate.yaml")
    simulated = rc.simulate_observations(configuration)
    assert [o.step for o in recording.observations] == [o.step for o in simulated]
    for found, known in zip(recording.observations, simulated, strict=True):
        assert found.mean == pytest.approx(known.mean, abs=1e-9)  # another processor


def test_a_data_frame_has_a_row_for_each_angle(monkeypatch, plate):
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=dict))
    frame = plate.to_dataframe()
    assert list(frame)[:3] == ["angle_rad", "EXC", "EXC_std"]
    assert len(frame) == 13
    np.testing.assert_array_equal(frame["ECC"], plate.deviations["ECC"])
    np.testing.assert_array_equal(frame["ECC_std"], plate.std["ECC"])


def test_without_pandas_a_data_frame_says_what_to_install(monkeypatch, plate):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match="pip install pandas"):
        plate.to_dataframe()


def test_a_dataset_has_every_component_over_the_angles(monkeypatch, plate):
    made = SimpleNamespace(Dataset=lambda *parts: SimpleNamespace(parts=parts))
    monkeypatch.setitem(sys.modules, "xarray", made)
    variables, places, attributes = plate.to_xarray().parts
    assert variables["deviation"][0] == ("component", "angle")
    at = places["component"].index("EAC")
    np.testing.assert_array_equal(variables["std"][1][at], plate.std["EAC"])
    np.testing.assert_array_equal(variables["covariance"][1][at], plate.covariance["EAC"])
    assert (len(places["angle"]), attributes["verdict"]) == (12, "ok")


def test_a_result_says_in_a_few_lines_what_it_is(plate):
    lines = repr(plate).splitlines()
    assert lines[0].startswith("<Result: ball_plate, ok")
    assert len(lines) <= 15
    largest = np.abs(plate.deviations["ECC"]).max() / rc.ARCSEC
    (row,) = [line for line in lines if line.strip().startswith("ECC")]
    assert f"{largest:.4g}" in row
    assert "U (k = 2) at most" in row
    doubted = replace(plate, verdict="suspect", warnings=("<b>odd</b>", "more"))
    assert "U (k" not in repr(doubted)
    assert "2 warnings, the first: &lt;b&gt;odd" in doubted._repr_html_()


def test_a_plot_shows_every_component_with_its_band(plate):
    figure = plate.plot()
    labels = {ax.get_ylabel() for ax in figure.axes}
    assert {"EXC / µm", "ECC / arcsec"} <= labels
    assert figure.legends[0].get_texts()[0].get_text() == "measured, with U (k = 2)"
    assert figure._repr_png_().startswith(b"\x89PNG")  # a notebook asks so, without pyplot


@pytest.mark.slow
@pytest.mark.parametrize("source", ["bag", "table", "result"])
def test_a_report_is_written_of_a_bag_a_table_and_a_result(source, tmp_path):
    made = {
        "bag": lambda: rc.read_bag(DATA / "ball_plate_bag"),
        "table": lambda: rc.read_table(DATA / "lengths.csv", DATA / "tracer.yaml"),
        "result": lambda: rc.read_result(DATA / "result_tracer.json"),
    }[source]()
    page = rc.write_report(made, tmp_path / "report.html").read_text()
    assert "Calibration report of a rotary table" in page
    assert "<svg" in page


def test_the_module_lists_its_interface_and_nothing_else():
    assert dir(rc) == sorted([*rc.__all__, *plugins.names(plugins.FUNCTIONS)])


def test_compare_takes_results_and_files_alike(plate):
    files = rc.compare(DATA / "result_tracer.json", DATA / "result_ball_plate.json")
    results = rc.compare(rc.read_result(DATA / "result_tracer.json"), plate)
    np.testing.assert_array_equal(files.difference, results.difference)
    with pytest.raises(DataError, match="holds no EXC"):
        rc.compare(DATA / "result_tracer.json", plate, "EXC")


def test_iso230_takes_runs_a_result_and_a_file(plate, tmp_path):
    angles = np.radians(np.arange(0, 360, 45))
    forward = np.sin(angles)[:, None] * 1e-5 + 1e-7 * np.arange(5)
    runs = BidirectionalRuns(angles, forward, forward + 5e-6)
    figures = rc.iso230(runs)
    assert figures.reversal == pytest.approx(5e-6)
    result = replace(plate, runs=RepeatedRuns(runs.targets, runs.forward, runs.reverse))
    assert rc.iso230(result).to_dict() == figures.to_dict()
    (tmp_path / "result.json").write_text(result.to_json())
    assert rc.iso230(tmp_path / "result.json").to_dict() == figures.to_dict()
    with pytest.raises(DataError, match="no repeated runs"):
        rc.iso230(plate)


def test_uncertainty_of_a_plan_and_of_what_was_measured():
    configuration = rc.read_configuration(DATA / "ball_plate.yaml")
    before = rc.uncertainty(configuration, trials=2000).components["ECC"].std
    after = rc.uncertainty(rc.read_bag(DATA / "ball_plate_bag"), trials=2000).components["ECC"].std
    assert before == pytest.approx(after, rel=0.1)


@pytest.mark.parametrize(
    ("table", "setup"),
    [("lengths", "tracer"), ("balls", "ball_plate"), ("tracker", "plane_mirror")],
)
def test_uncertainty_of_a_plain_table(table, setup):
    measured = rc.read_table(DATA / f"{table}.csv", DATA / f"{setup}.yaml")
    spread, result = rc.uncertainty(measured, trials=2000), measured.solve()
    assert list(spread.components) == list(result.components)
    for name, part in spread.components.items():
        np.testing.assert_array_equal(part.value, result.deviations[name])
        np.testing.assert_allclose(part.std, result.std[name], rtol=0.08)
        assert np.all(np.abs(part.mean - part.value) < 0.1 * part.std + 1e-15)
    assert spread.warnings == ()


def test_uncertainty_of_a_table_is_that_of_its_residuals_where_they_contradict_the_statement():
    """Twice the noise is stated that the points have: a component of noise is estimated then."""
    other = ("mirror_slope_std_arcsec=0", "uneven_drift_std_arcsec=0", "tilt_std_arcsec=0.001")
    base = [f"solver.{setting}" for setting in other]
    spreads = []
    for factor in (1.0, 2.0):
        noise = {"range_std_m": 2.5e-6, "transverse_std_m": 4e-6}
        changes = [f"solver.{name}={factor * value:.9f}" for name, value in noise.items()]
        zero = ["solver.range_std_relative=0", "solver.transverse_std_relative=0"]
        configuration = rc.read_configuration(DATA / "plane_mirror.yaml", *base, *zero, *changes)
        measured = rc.read_table(DATA / "tracker.csv", configuration)
        spreads.append(rc.uncertainty(measured, trials=1000).components["ECC"].std[1:])
    np.testing.assert_allclose(spreads[1] / spreads[0], 1.1, rtol=0.2)


def test_the_correction_has_a_sign_and_a_side(plate):
    reverse = replace(plate, deviations={"ECC": plate.deviations["ECC"] + 2e-6})
    table = rc.make_table(plate, reverse=reverse, reference_angle=0.0)
    up = rc.correction(table, plate.angles)
    assert up == pytest.approx(plate.deviations["ECC"][0] - plate.deviations["ECC"], abs=1e-15)
    down = rc.correction(table, plate.angles, "negative")
    assert down == pytest.approx(up - 2e-6, abs=1e-15)
    with pytest.raises(ConfigurationError, match="sideways"):
        rc.correction(table, 0.0, "sideways")


def test_controller_files_are_never_overwritten(plate, tmp_path):
    table = rc.make_table(plate, reference_angle=0.0)
    files = rc.write_controller_files(table, "linuxcnc", tmp_path, replaces=True)
    assert all(file.parent == tmp_path for file in files)
    with pytest.raises(rc.RotcalError, match="exists already"):
        rc.write_controller_files(table, "linuxcnc", tmp_path, replaces=True)
    with pytest.raises(rc.RotcalError, match="did you mean 'linuxcnc'"):
        rc.write_controller_files(table, "linuxcn", tmp_path, replaces=True)


def of_machine(result, axis="", serial="", days=0.0):
    begun_ns = time.time_ns() - round(days * 86_400e9)
    identity = Identity(serial=serial)
    around = Circumstances(axis=axis, identity=identity, begun_ns=begun_ns, ended_ns=begun_ns)
    return replace(result, circumstances=around)


def test_a_table_has_the_axis_that_was_measured(plate):
    other = replace(plate, deviations={"ECC": plate.deviations["ECC"] + 2e-6})
    assert rc.make_table(of_machine(plate, "B")).axis == "B"
    assert rc.make_table(of_machine(plate, "B"), axis="B").axis == "B"
    backward = of_machine(other, "B")
    assert rc.make_table(of_machine(plate), reverse=backward).axis == "B"
    assert rc.make_table(of_machine(plate), axis="A").axis == "A"
    with pytest.raises(ConfigurationError, match=r"axis B was measured.*named for axis C"):
        rc.make_table(of_machine(plate, "B"), axis="C")
    with pytest.raises(ConfigurationError, match="forward run is of axis B, the reverse run of a"):
        rc.make_table(of_machine(plate, "B"), reverse=of_machine(other, "C"))


@pytest.mark.parametrize(
    ("word", "asked"), [("axis", {"axis": "C"}), ("serial", {"serial": "9999"}), ("age", {})]
)
def test_files_are_for_the_machine_that_was_measured(word, asked, plate, tmp_path):
    table = rc.make_table(of_machine(plate, "B", "4711", days=40.0 if word == "age" else 1.0))
    with pytest.raises(rc.RotcalError, match=f"--accept {word}"):
        rc.write_controller_files(table, "csv", tmp_path, replaces=True, **asked)
    assert list(tmp_path.iterdir()) == []
    files = rc.write_controller_files(
        table, "csv", tmp_path, replaces=True, accept=[word], **asked
    )
    assert any("accepted by a person" in file.read_text() for file in files)
    if word == "age":
        old = tmp_path / "old"
        rc.write_controller_files(table, "csv", old, replaces=True, largest_age_days=60.0)


def test_files_say_which_table_was_in_force(plate, tmp_path):
    table = rc.make_table(plate)
    with pytest.raises(DataError, match="not known which table was in force"):
        rc.write_controller_files(table, "csv", tmp_path)
    rc.write_controller_files(table, "csv", tmp_path, replaces=True)
    on_top = tmp_path / "on_top"
    with pytest.raises(ConfigurationError, match="exclude each other"):
        rc.write_controller_files(table, "csv", on_top, replaces=True, add_to=tmp_path)
    # What is added to itself says that the deviation was as large with the table as without.
    with pytest.raises(DataError, match="not added"):
        rc.write_controller_files(table, "csv", on_top, add_to=tmp_path)
    less = replace(plate, deviations={"ECC": 1e-7 * np.cos(3 * plate.angles)})
    files = rc.write_controller_files(rc.make_table(less), "csv", on_top, add_to=str(tmp_path))
    assert any("adds to the table" in file.read_text() for file in files)


def test_changes_of_a_configuration_are_checked():
    with pytest.raises(ConfigurationError, match="points_per_ball"):
        rc.read_configuration(DATA / "ball_plate.yaml", "plan.points_per_bal=9")


def test_a_real_cell_is_not_simulated_behind_its_back():
    """Its result would say that an instrument had measured."""
    real = rc.read_configuration(ROOT / "config" / "tracer.yaml")
    for simulate in (rc.simulate_records, rc.simulate_observations, rc.simulated_truth):
        with pytest.raises(ConfigurationError, match="no group 'simulation'"):
            simulate(real)


def test_a_cell_that_nobody_turns_is_not_simulated_for_ever():
    external = rc.read_configuration(
        DATA / "ball_plate.yaml", "simulation.table.external=true", "simulation.time_scale=1.0"
    )
    with pytest.raises(ConfigurationError, match="does not finish step 0"):
        rc.simulate_observations(external)


def test_methods_and_controllers_have_names():
    assert {"tracer_multistation", "ball_plate", "plane_mirror"} <= set(rc.method_names())
    assert {"csv", "linuxcnc"} <= set(rc.controller_names())


def test_what_several_instruments_observed_is_solved_together():
    """Bag, result and file: the plate brings its centres, the tracer its result."""
    bag, known = DATA / "ball_plate_bag", DATA / "result_tracer.json"
    joint = rc.solve_together(rc.read_bag(bag), rc.read_result(known))
    of_files = rc.solve_together(bag, known)
    assert joint.details["noise"].keys() == {
        "the centres in the plane of ball_plate (1)",
        "the centres along the axis of ball_plate (1)",
        "the result of tracer_multistation (2)",
    }
    for c in joint.components:
        np.testing.assert_array_equal(joint.deviations[c], of_files.deviations[c])
    alone = rc.combine(bag)
    assert (joint.std["ECC"] < alone.std["ECC"]).all()
    with pytest.raises(DataError, match="share 78 observations"):
        rc.solve_together(rc.read_bag(bag), replace_ecc(rc.read_result(bag)))


def replace_ecc(result):
    """Return a result of the same observations with other numbers."""
    doubled = {c: 2.0 * values for c, values in result.deviations.items()}
    return replace(result, deviations=doubled)
