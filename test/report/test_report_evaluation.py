"""What the report says about the axis: harmonic content and ISO 230-2."""

import json
from dataclasses import replace

import numpy as np
import pytest

from rotcal_ros.foundation.results import RepeatedRuns, Result
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.report.page import ReportInput, render_report

pytestmark = pytest.mark.usefixtures("without_figures")


def result(count=12, step=30.0, runs=None):
    t = np.deg2rad(np.arange(count) * step)
    ecc = (3.0 * np.cos(2 * t - np.deg2rad(40.0))) * ARCSEC
    return Result(
        method="m",
        angles=t,
        deviations={"ECC": ecc},
        std={"ECC": np.full(len(t), 0.1 * ARCSEC)},
        covariance={"ECC": (0.1 * ARCSEC) ** 2 * np.eye(len(t))},
        sigma0=1.0,
        dof=10,
        n_observations=20,
        runs=runs,
    )


def page(shown):
    return render_report(ReportInput(result=shown, title="t", method_title="m"))


def runs(missing=False):
    steps = np.array([-1.0, 0.0, 1.0])
    forward = (np.array([0.0, 2.0, 1.0])[:, None] + 0.5 * steps) * ARCSEC
    reverse = forward - 1.0 * ARCSEC
    if missing:
        reverse[1, 2] = np.nan
    return RepeatedRuns(np.array([0.0, 1.0, 2.0]), forward, reverse)


def test_harmonic_content_of_a_full_circle():
    """k = 2: amplitude std sqrt(2 / 12) times 0.1, phase std a third of 0.1 / 3 rad."""
    text = page(result())
    assert "Harmonic content" in text
    assert '<th scope="row">2</th><td>3.000 ± 0.082</td><td>40.0 ± 1.6</td>' in text
    assert text.count("<td>–</td>") == 4  # five orders, the others do not differ from zero


def test_an_arc_has_no_harmonic_content():
    assert "Harmonic content" not in page(result(6, 10.0))


def test_iso_section_with_figures_and_warnings():
    """s = 0.5, B = 1: R = 4 * 0.5 + 1 = 3 arcsec, E = 3, A = 3 + 4 * 0.5 = 5."""
    text = page(result(runs=runs()))
    assert "ISO 230-2: positioning of the axis" in text
    for row in (
        '<th scope="row">Repeatability R</th><td>3.000</td><td>2.000</td><td>2.000</td>',
        '<th scope="row">Systematic deviation E</th><td>3.000</td><td>2.000</td><td>2.000</td>',
        '<th scope="row">Accuracy A</th><td>5.000</td><td>4.000</td><td>4.000</td>',
    ):
        assert row in text
    assert "3 runs in each direction, the standard requires 5" in text


@pytest.mark.parametrize(
    ("sides", "kept"),
    [
        ({}, ["targets", "forward", "reverse"]),
        ({"reverse": None}, ["targets", "forward"]),
        ({"repeatability_std": 1e-7}, ["targets", "forward", "reverse", "repeatability_std"]),
    ],
)
def test_runs_stand_among_the_details_of_a_file_and_are_read_back(sides, kept):
    given = replace(result(runs=replace(runs(missing=True), **sides)), details={"tilt": 1.0})
    text = given.to_json()
    stored = json.loads(text)["details"]
    assert list(stored) == ["tilt", "runs"]
    assert list(stored["runs"]) == kept
    again = Result.from_dict(json.loads(text))
    assert again.details == {"tilt": 1.0}
    np.testing.assert_array_equal(again.runs.forward, given.runs.forward)
    assert again.to_json() == text


def test_no_runs_no_section_and_a_missing_arrival_is_named():
    assert "ISO 230-2" not in page(result())
    text = page(Result.from_dict(result(runs=runs(missing=True)).to_dict()))
    assert "Not evaluated: reverse run 3 has no deviation at target 2" in text
    assert "ISO 230-2" not in page(result(runs=replace(runs(), reverse=None)))
