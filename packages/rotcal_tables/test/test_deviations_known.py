"""Deviations that somebody has already become a result, and a controller's table."""

import json
from math import sqrt
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.stats import t as student

from rotcal_ros.cli.main import rotcal
from rotcal_ros.evaluation.iso230 import iso230, runs_of
from rotcal_ros.evaluation.marks import conformities
from rotcal_ros.foundation.errors import ConfigurationError, DataError, UndecidedError
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods.configuration import parse_configuration
from rotcal_ros.recordings.inputs import MeasurementInput

DATA = Path(__file__).with_name("data")
SAID = "sheet.values=deviations"
FIGURES = {
    "reversal": 184.46, "mean_reversal": 127.60, "repeatability": 853.74, "systematic": 228.75,
    "mean_range": 80.14, "accuracy": 876.13, "accuracy_forward": 509.00,
    "accuracy_reverse": 876.13,
}  # fmt: skip
"""Of the runs of the ISO files, arcsec."""


def solved(path, *changes):
    return MeasurementInput(path, changes=changes).read().solve()


def table(folder, text):
    (path := folder / "t.csv").write_text(text, encoding="utf-8")
    return path


def run(*arguments):
    return CliRunner().invoke(rotcal, [str(a) for a in arguments], prog_name="rotcal")


@pytest.mark.parametrize(
    "name",
    ["actual_positions", "deviations_long", "deviations_matrix", "unknown_headings"],
)
def test_runs_of_both_directions_are_their_mean_scatter_and_reversal(name):
    result = solved(DATA / f"iso230_{name}.csv", SAID)
    figures = iso230(runs_of(result))
    for figure, expected in FIGURES.items():
        assert getattr(figures, figure) / ARCSEC == pytest.approx(expected, abs=0.006), figure
    both = result.directions["ECC"]
    np.testing.assert_allclose(both.reversal, figures.reversal_i, atol=1e-15)
    np.testing.assert_allclose(result.deviations["ECC"], figures.mean, atol=1e-15)
    assert result.verdict == "ok"
    assert result.dof == 40  # 50 values about 10 means
    pooled = sqrt(np.mean([figures.s_forward**2, figures.s_reverse**2]))
    u = pooled * student.ppf(0.97725, 40) / 2.0
    np.testing.assert_allclose(result.std["ECC"], u / sqrt(10), rtol=1e-3)
    np.testing.assert_allclose(both.reversal_std, u * sqrt(2 / 5), rtol=1e-3)
    assert result.runs.repeatability_std == pytest.approx(pooled, rel=1e-12)
    again = Result.from_dict(json.loads(result.to_json()))
    assert iso230(runs_of(again)).accuracy == figures.accuracy


def test_positions_are_less_what_was_commanded_and_sixtieths_are_read():
    result = solved(DATA / "target_actual_error.csv", "solver.u_arcsec=5")
    degrees = result.deviations["ECC"] / DEGREE
    assert degrees[:3] == pytest.approx([2.77135, 3.38744, 3.44158], abs=1e-12)
    assert result.std["ECC"] / ARCSEC == pytest.approx(5.0)
    for name in ("dms_decimal_comma.csv", "deviation_in_time_cells.xlsx"):
        ecc = solved(DATA / name, "solver.u_arcsec=0.5", SAID).deviations["ECC"] / ARCSEC
        assert ecc[1] - ecc[0] == pytest.approx(3.2, abs=1e-9)


SMALL = "angle [deg],error [arcsec]\n0,0.5\n90,3.2\n180,-1\n270,2\n"


def test_the_sign_is_asked_with_both_tables_at_one_angle(tmp_path):
    path = table(tmp_path, SMALL)
    with pytest.raises(UndecidedError) as asked:
        solved(path, "solver.u_arcsec=0.5")
    assert asked.value.question.setting == "sheet.values"
    deviations, corrections = (words for _, words in asked.value.question.answers)
    assert "stands 3.2 arcsec too far; the control will add -3.2 arcsec" in deviations
    assert "stands 3.2 arcsec too little; the control will add +3.2 arcsec" in corrections
    one = solved(path, "solver.u_arcsec=0.5", SAID).deviations["ECC"]
    other = solved(path, "solver.u_arcsec=0.5", "sheet.values=corrections").deviations["ECC"]
    assert one / ARCSEC == pytest.approx([0.5, 3.2, -1.0, 2.0])
    assert other.tolist() == (-one).tolist()


@pytest.mark.parametrize("name", ["dev {}", "Deviation {}", "{} error", "x{}", "x {}", "{}"])
@pytest.mark.parametrize(("up", "down"), [("+", "-"), ("↑", "↓")])
def test_one_column_for_each_sign_of_the_direction_is_a_run_in_both(tmp_path, name, up, down):
    head = ",".join(["Target [deg]", *(f"{name.format(w)} [arcsec]" for w in (up, down))])
    path = table(tmp_path, f"{head}\n0,1,2\n90,3.5,4\n180,-1,0.25\n270,2,7\n")
    both = solved(path, "solver.u_arcsec=0.5", SAID).directions["ECC"]
    assert both.forward / ARCSEC == pytest.approx([1.0, 3.5, -1.0, 2.0])
    assert both.reverse / ARCSEC == pytest.approx([2.0, 4.0, 0.25, 7.0])


@pytest.mark.parametrize(("unit", "value"), [("arcsec", "3.2"), ("deg", "8.8889e-4")])
def test_a_column_named_as_in_our_own_form_has_our_sign_in_any_unit(unit, value, tmp_path):
    text = f"angle_deg,deviation_{unit},u_arcsec\n0,0,1\n90,{value},1\n180,0,1\n"
    assert solved(table(tmp_path, text)).deviations["ECC"][1] / ARCSEC == pytest.approx(3.2, 1e-4)


def test_an_uncertainty_is_a_column_or_a_word_or_shown_by_runs_and_never_guessed(tmp_path):
    with pytest.raises(DataError, match=r"nothing states how sure .* --reference-u"):
        solved(table(tmp_path, SMALL), SAID)
    rows = "0,0.5,0.4\n90,3.2,0.6\n180,-1,0.4\n"
    head = "angle [deg],deviation [arcsec],{} [arcsec]\n"
    expanded = solved(table(tmp_path, head.format("expanded uncertainty") + rows), SAID)
    assert expanded.std["ECC"] / ARCSEC == pytest.approx([0.2, 0.3, 0.2])
    with pytest.raises(UndecidedError, match="k = 1"):
        solved(table(tmp_path, head.format("U") + rows), SAID)
    single = "\n".join(f"{a},1,up,{a / 1e3}\n{a},1,down,{a / 2e3}" for a in (0, 120, 240))
    copied = table(tmp_path, "angle_deg,deviation_arcsec\n0,1\n120,2.5\n240,-3\n120,2.5\n")
    with pytest.raises(DataError, match="what was measured twice is the same"):
        solved(copied)
    with pytest.raises(DataError, match="none was measured twice"):
        solved(table(tmp_path, f"angle [deg],run,direction,deviation [arcsec]\n{single}\n"), SAID)
    with pytest.raises(DataError, match="row 2: the uncertainty is"):
        solved(table(tmp_path, head.format("std") + rows.replace("0.4", "0", 1)), SAID)


def runs_table(values):
    """Return deviations (angles, runs) in arcsec as a table of one direction."""
    rows = [f"{30 * a},{r},{float(v)!r}" for (a, r), v in np.ndenumerate(values)]
    return "angle [deg],run,deviation [arcsec]\n" + "\n".join(rows) + "\n"


def test_what_is_stated_is_the_same_in_all_runs_and_scatter_comes_on_top(tmp_path):
    values = np.random.default_rng(5).normal(0.0, 0.3, (12, 4))
    path = table(tmp_path, runs_table(values))
    bare, stated = solved(path, SAID), solved(path, SAID, "solver.u_arcsec=0.2")
    expected = np.hypot(bare.std["ECC"] / ARCSEC, 0.2)
    np.testing.assert_allclose(stated.std["ECC"] / ARCSEC, expected, rtol=1e-9)
    assert bare.unprotected[:2] == ("drift", "knock")
    assert {"axis noise", "repeatability"}.isdisjoint(bare.unprotected)


def test_u_holds_the_truth_in_95_of_100_also_for_few_runs(tmp_path):
    rng, inside = np.random.default_rng(11), []
    for _ in range(60):
        values = rng.normal(0.0, 1.0, (3, 2))
        result = solved(table(tmp_path, runs_table(values)), SAID)
        inside.append(np.abs(result.deviations["ECC"]) <= 2.0 * result.std["ECC"])
    assert 0.90 <= np.mean(inside) <= 0.99  # 0.955 expected, 180 values of 60 tables


def test_a_value_that_stands_out_of_its_runs_is_named_and_no_table_is_made(tmp_path):
    values = np.random.default_rng(5).normal(0.0, 0.3, (12, 4))
    assert solved(table(tmp_path, runs_table(values)), SAID).verdict == "ok"
    values[7, 2] += 4.0
    result = solved(table(tmp_path, runs_table(values)), SAID)
    assert result.verdict == "suspect"
    assert "run 3 up at 210 degrees is" in result.warnings[0]


def test_a_table_for_a_control_comes_from_a_table_alone(tmp_path):
    path, out = table(tmp_path, SMALL), tmp_path / "out"
    asked = ("export", path, "--to", "csv", "--axis", "A", "-o", out, "--replace")
    done = run(*asked, "--set", SAID, "--reference-u", 0.5)
    assert done.exit_code == 0, done.stderr
    side = json.loads((out / "a_csv.provenance.json").read_text())
    assert (side["axis"], side["method"], side["verdict"]) == ("A", "deviations", "ok")
    assert "nothing checked its values: none was measured twice" in side["warnings"]
    assert "single readings" in side["verdict_line"]
    assert "t.csv" in side["sources_sha256"]
    rows = (out / "a_csv.csv").read_text().splitlines()
    at_90 = next(row.split(",") for row in rows if row.startswith("90"))
    # the correction takes off what is too much, counted from the first angle
    assert float(at_90[1]) == pytest.approx(-(3.2 - 0.5), abs=1e-4)
    refused = run(*asked, "--reference-u", 0.5)
    assert refused.exit_code == 2
    assert "--set sheet.values=corrections" in refused.stderr


def test_the_tolerance_is_decided_as_for_a_result_of_our_own(tmp_path):
    path = table(tmp_path, SMALL)
    for tolerance, expected in ((5.0, "within"), (3.5, "undecided"), (1.0, "beyond")):
        result = solved(
            path, SAID, "solver.u_arcsec=0.5", f"identity.tolerance_arcsec={tolerance}"
        )
        (found,) = conformities(result, result.circumstances.identity)
        assert found.decision == expected


@pytest.mark.parametrize(
    ("name", "methods"),
    [
        ("lengths_5_degrees_on.csv", ["tracer_multistation"]),
        ("polygon_settings.csv", ["angle_comparison"]),
        ("balls_meas_nom.csv", ["ball_plate", "table_balls", "tracer_multistation"]),
    ],
)
def test_a_table_without_set_up_lists_the_methods_that_its_columns_fit(name, methods):
    with pytest.raises(ConfigurationError) as refused:
        MeasurementInput(DATA / name).read()
    found = [m for m in methods if f"rotcal new --method {m} -o {m}.yaml" in str(refused.value)]
    assert found == methods
    assert str(refused.value).count("rotcal new") == len(methods)


def test_a_person_says_that_numbered_columns_are_runs_of_known_deviations(tmp_path):
    path = table(tmp_path, 'angle [deg],deviation 1 ["],deviation 2 ["]\n0,0,0\n90,3,5\n')
    with pytest.raises(ConfigurationError, match="the same command with --set method=deviations"):
        solved(path, SAID)
    result = solved(path, SAID, "method=deviations")
    assert result.deviations["ECC"] / ARCSEC == pytest.approx([0.0, 4.0])
    with pytest.raises(ConfigurationError, match=r"rotcal new --method table_balls"):
        solved(path, "method=table_balls")


def test_a_set_up_may_state_all_of_it(tmp_path):
    text = "method: deviations\nu_arcsec: 0.5\nsheet: {values: corrections}\n"
    (setup := tmp_path / "s.yaml").write_text(text)
    assert parse_configuration(text).solver.u_arcsec == 0.5
    result = MeasurementInput(table(tmp_path, SMALL), setup).read().solve()
    assert result.deviations["ECC"] / ARCSEC == pytest.approx([-0.5, -3.2, 1.0, -2.0])


def test_deviations_that_differ_after_a_turn_are_suspect(tmp_path):
    (path := tmp_path / "t.csv").write_text(
        "angle [deg],deviation_arcsec,u [arcsec]\n"
        + "".join(f"{a},{a / 36.0 + a % 7},0.5\n" for a in range(0, 361, 30))
    )
    result = MeasurementInput(path).read().solve()
    assert result.verdict == "suspect"
    assert "do not close: at 0 and 360 deg" in result.warnings[0]
