"""``rotcal plan plate`` and ``rotcal plan effort``."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from rotcal_ros.cli import main
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE

PAPER = "0,8,12,18,21,28,32,37,42,50,58,62"


def run(*arguments):
    return CliRunner().invoke(main.rotcal, arguments, prog_name="rotcal")


def plan(*arguments):
    result = run("plan", *arguments, "--json")
    assert result.exit_code == 0, result.stderr
    return json.loads(result.stdout)


def test_best_six_of_the_papers_plate():
    found = plan("plate", "--grid", "72", "--balls", "6", "--subset-of", PAPER)
    assert found["ball_steps"] == [0, 12, 28, 37, 50, 58]
    assert found["evaluated"] == 924
    assert found["optimal"]
    # mean variances by Eq. 21, dense: 0.2120, 0.2039, 0.4561, 0.2309 per unit sigma^2
    std = found["predicted_std"]
    assert std["ECC"] == pytest.approx(0.05e-6 / 0.185 * np.sqrt(0.2120), rel=0.003)
    assert std["EXC"] == pytest.approx(0.05e-6 * np.sqrt(0.2039), rel=0.003)
    assert std["EAC"] == pytest.approx(0.05e-6 / 0.185 * np.sqrt(0.4561), rel=0.003)
    assert std["EZC"] == pytest.approx(0.05e-6 * np.sqrt(0.2309), rel=0.003)
    assert 0.0 < found["gap"] < 0.2
    assert found["orders"]["table_once"]["reversals"] == 0


def test_weights_choose_and_a_gap_is_kept():
    text = run("plan", "plate", "--grid", "24", "--balls", "5", "--weights", "1,0,0,0").stdout
    assert "proven optimal" in text
    assert "ECC  0.0" in text
    found = plan("plate", "--grid", "24", "--balls", "5", "--min-gap", "4", "--weights", "1,0,0,0")
    steps = np.array(found["ball_steps"])
    assert np.diff(steps, append=steps[0] + 24).min() >= 4


def test_effort_reaches_the_limit_with_the_least_work_first():
    found = plan("effort", "--grid", "12", "--need", "ECC=0.06", "--most-balls", "7")
    ways = found["ways"]
    assert [w["centres"] for w in ways] == sorted(w["centres"] for w in ways)
    for way in ways:
        assert way["expanded"] <= 0.06 * ARCSEC
        assert way["centres"] == way["balls"] * way["cmm_positions"]
        assert way["duration_s"] > 0
    words = run("plan", "effort", "--grid", "12", "--need", "ECC=0.06", "--most-balls", "6")
    assert "for U(ECC) <= 0.06 arcsec" in words.stderr
    assert words.stdout.splitlines()[0] == "balls,CMM positions,centres,hours,U/arcsec,ball steps"


def test_effort_that_no_layout_reaches_is_told_in_the_unit_of_the_question():
    refused = run("plan", "effort", "--grid", "12", "--need", "ECC=0.0001", "--most-balls", "6")
    assert refused.exit_code == 2
    assert "U(ECC) <= 0.0001 arcsec with 0.05 um per centre" in refused.stderr


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["plate", "--grid", "12", "--balls", "5", "--weights", "1,x"], "expected numbers"),
        (["plate", "--grid", "12", "--balls", "5", "--weights", "1,1"], "four weights"),
        (["plate", "--grid", "12", "--balls", "5", "--min-gap", "3"], "do not fit"),
        (["plate", "--grid", "12", "--balls", "5", "--subset-of", "0.5"], "whole numbers"),
        (["effort", "--grid", "12", "--need", "ECC"], "COMPONENT=LIMIT"),
        (["effort", "--grid", "12", "--need", "EQC=1"], "'EQC' is no deviation of a rotary axis"),
        (["effort", "--grid", "12", "--need", "ECC=1e-6", "--most-balls", "6"], "reaches"),
    ],
)
def test_impossible_wishes_are_explained(arguments, text):
    result = run("plan", *arguments)
    assert result.exit_code == 2
    assert text in result.stderr
    assert "Traceback" not in result.output


@pytest.mark.slow
def test_each_order_is_told_what_drift_and_knocks_would_do():
    found = plan("plate", "--grid", "36", "--balls", "12", "--min-gap", "2", "--starts", "2")
    orders = found["orders"]
    assert set(orders) == {"interleaved", "table_once", "probe_rests"}
    assert orders["table_once"]["duration_s"] < orders["interleaved"]["duration_s"]
    assert max(orders["interleaved"]["unseen_std"].values()) < 2.0
    assert min(orders["table_once"]["unseen_std"].values()) > 2.0
    effects = {(e["kind"], e["axis"]): e for e in orders["table_once"]["effects"]}
    assert len(effects) == 9
    lift = effects["shift", "z"]
    # one turn: from the knock on, every position keeps the lift, less the mean of the curve
    assert 0.5 < lift["error_per_unit"]["EZC"] < 1.0
    assert lift["error_per_unit"]["ECC"] == pytest.approx(0.0, abs=1e-9)
    assert 5e-8 < lift["found_from"] < 3e-7
    coarse = plan(
        "plate", "--grid", "36", "--balls", "12", "--min-gap", "2", "--starts", "2",
        "--sigma-um", "0.1",
    )  # fmt: skip
    again = coarse["orders"]["table_once"]["effects"][5]
    assert again["found_from"] == pytest.approx(2.0 * lift["found_from"], rel=1e-9)
    words = run("plan", "plate", "--grid", "24", "--balls", "5", "--starts", "2").stdout
    assert words.count("CMM drifts in x, 1 um") == 3
    assert "unseen at worst: drift" in words
    assert "(not protected)" in words


@pytest.mark.slow
@pytest.mark.parametrize("steps", [PAPER, "0,8,12,18,21,28"])
def test_the_page_has_what_half_a_kelvin_does_in_each_order(steps):
    balls = str(len(steps.split(",")))
    found = plan("plate", "--grid", "72", "--balls", balls, "--subset-of", steps)
    table = Path(__file__).parents[3] / "research" / "figures" / "plate_growth.csv"
    rows = list(csv.reader(table.read_text().splitlines()))
    for order, told in found["orders"].items():
        (row,) = (row[2:] for row in rows if row[:2] == [balls, f"`{order}`"])
        growth = told["growth"]
        assert (growth["material"], growth["warming_k"]) == ("steel", 0.5)
        error = growth["error"]
        assert row == [
            *(f"{error[name] / MICROMETRE:.3f}" for name in ("EXC", "EYC")),
            f"{error['ECC'] / ARCSEC:.3f}",
            f"{growth['found_from_k']:.3f}",
            f"{growth['unseen_std']:.2f}",
        ]
        assert max(error[name] for name in ("EZC", "EAC", "EBC")) < 1e-12


def test_the_growth_follows_material_and_kelvin():
    layout = ("plate", "--grid", "12", "--balls", "6")
    steel = plan(*layout)["orders"]["interleaved"]["growth"]
    other = plan(*layout, "--material", "aluminium", "--warming-k", "1")
    other = other["orders"]["interleaved"]["growth"]
    assert other["error"]["EXC"] == pytest.approx(2.0 * 23.6 / 11.5 * steel["error"]["EXC"])
    assert other["found_from_k"] == pytest.approx(11.5 / 23.6 * steel["found_from_k"])
    assert other["unseen_std"] == pytest.approx(steel["unseen_std"])
    words = run("plan", *layout, "--material", "invar").stdout
    assert words.count("invar plate warms by 0.5 K") == 3
