"""Two marks: may the measurement be believed, and is the table within its tolerance?"""

import json
import re
from dataclasses import asdict, replace
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner

from rotcal_ros.cli.console import print_outcome
from rotcal_ros.evaluation.marks import (
    COLOURS,
    Mark,
    further_statements,
    marks,
    reversal_statements,
)
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.results import AxisLine, Directions, Result
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.report.page import ReportInput, render_report
from rotcal_ros.report.terminal.tables import print_result

pytestmark = pytest.mark.usefixtures("without_figures")

DATA = Path(__file__).parents[2] / "examples" / "data"


def result(tolerance_arcsec, verdict="ok", tolerance_um=0.0, **more):
    """Return a result whose ECC reaches 10 arcsec with U 1, and EZC 5 um with U 0.2."""
    known = Result.from_dict(json.loads((DATA / "result_tracer.json").read_text()))
    size = np.linspace(-1.0, 1.0, len(known.angles))
    identity = Identity(tolerance_arcsec=tolerance_arcsec, tolerance_um=tolerance_um)
    return replace(
        known,
        deviations={"ECC": 10.0 * ARCSEC * size, "EZC": 5.0 * MICROMETRE * size},
        std={"ECC": 0.5 * ARCSEC + 0 * size, "EZC": 0.1 * MICROMETRE + 0 * size},
        covariance={}, verdict=verdict, warnings=("a doubt",) * (verdict != "ok"), protections=(),
        circumstances=replace(known.circumstances, identity=identity),
        **more,
    )  # fmt: skip


# |deviation| + U <= limit: within; |deviation| - U > limit: beyond.
CASES = [
    (11.1, 0.0, "within", "within ±11.1 arcsec (ECC)"),
    (10.5, 0.0, "undecided", "undecided ±10.5 arcsec (ECC)"),
    (8.9, 0.0, "beyond", "beyond ±8.9 arcsec (ECC)"),
    (11.1, 5.1, "undecided", "undecided ±5.1 µm (EZC)"),
    (8.9, 5.1, "beyond", "beyond ±8.9 arcsec (ECC)"),
    (11.1, 5.3, "within", "within ±11.1 arcsec (ECC), ±5.3 µm (EZC)"),
]


@pytest.mark.parametrize(("arcsec", "um", "kind", "words"), CASES)
def test_a_good_measurement_says_nothing_of_the_tolerance_and_the_other_way(
    arcsec, um, kind, words
):
    about, against = marks(result(arcsec, tolerance_um=um))
    assert (about.name, about.kind) == ("measurement", "ok")
    assert against.words == words
    assert (against.name, against.kind) == ("tolerance", kind)


def test_the_axis_is_told_where_a_method_finds_it(capsys):
    std = np.array([1e-7, 1e-7, 0.1 * ARCSEC, 0.1 * ARCSEC])
    axis = AxisLine(
        ("XOC", "YOC", "AOC", "BOC"),
        np.array([3.94e-5, -3.1e-6, 10.0 * ARCSEC, -2.5 * ARCSEC]),
        std,
        np.diag(std**2),
        np.array([0.1, 0.0, 0.08]),
    )
    given = result(0.0, axes=(axis,))
    told = (
        "Axis at (100, 0, 80) mm, from its nominal place: XOC +39.40 ± 0.20 µm, "
        "YOC −3.10 ± 0.20 µm, AOC +10.00 ± 0.20 arcsec, BOC −2.50 ± 0.20 arcsec."
    )
    assert told in render_report(ReportInput(given, "method"))
    print_result(given)
    assert told in capsys.readouterr().err
    (bare,) = further_statements(given, valid=False)
    assert "XOC +39.40 µm, YOC −3.10 µm" in bare
    assert further_statements(result(0.0), valid=True) == []


def test_the_reversal_of_what_was_measured_from_both_sides_is_told_by_page_terminal_and_figure(
    capsys,
):
    """B_i = 1, 1, 4 arcsec, each with U = 2 sqrt(2) 0.1; the mean 2 with that by sqrt(3)."""
    forward = np.array([1.0, 2.0, 5.0]) * ARCSEC
    both = Directions(
        np.radians([0.0, 90.0, 180.0]), forward, np.array([0.0, 1.0, 1.0]) * ARCSEC,
        (0.1 * ARCSEC) ** 2 * np.eye(6),
    )  # fmt: skip
    given = result(0.0, directions={"ECC": both})
    told = "mean +2.00 ± 0.16 arcsec; largest +4.00 ± 0.28 arcsec, at 180°."
    assert told in render_report(ReportInput(given, "method"))
    print_result(given)
    assert told in capsys.readouterr().err
    assert "mean +2.00 arcsec; largest +4.00 arcsec" in reversal_statements(given, valid=False)[0]
    of_ecc = next(ax for ax in given.plot().axes if ax.get_ylabel() == "ECC / arcsec")
    lines = {line.get_label(): line.get_ydata() for line in of_ecc.lines}
    np.testing.assert_allclose(lines["↑ forward"], forward / ARCSEC)
    np.testing.assert_allclose(lines["↓ reverse"], both.reverse / ARCSEC)


@pytest.mark.parametrize("verdict", ["suspect", "failed"])
def test_where_u_is_withheld_nothing_is_decided(verdict):
    about, against = marks(result(8.9, verdict))
    assert about.kind == verdict
    assert against.kind == "undecided"
    assert "U is not stated" in against.words


def test_without_a_tolerance_there_is_one_mark():
    assert [mark.name for mark in marks(result(0.0))] == ["measurement"]


@pytest.mark.parametrize("tolerance_arcsec", [11.1, 10.5, 8.9])
def test_page_and_terminal_show_the_same_marks_in_their_colours(tolerance_arcsec, capsys):
    given = result(tolerance_arcsec)
    page = render_report(ReportInput(given, "method"))
    shown = re.findall(r'<span class="verdict (\w+)">([^<]*)</span>', page)
    print_result(given)
    words = capsys.readouterr().err
    outcome = {
        "n_used": 1, "skipped_steps": [], "n_rejected": 0, "verdict": "ok",
        "marks": [asdict(mark) for mark in marks(given)],
    }  # fmt: skip
    ended = CliRunner().invoke(click.command()(lambda: print_outcome(outcome)), color=True).stdout
    codes = {"green": 32, "yellow": 33, "red": 31}
    for mark in marks(given):
        assert (mark.kind, mark.line[0].upper() + mark.line[1:]) in shown
        assert mark.line in words
        assert f"\x1b[{codes[mark.colour]}m{mark.line}" in ended
    style = page.partition("</style>")[0]
    shades = dict(re.findall(r"--(\w+): (#\w+);", style))
    shown_as = {
        kind: shades[name]
        for kind, name in re.findall(r"\.(\w+) \{ background: var\(--(\w+)", style)
    }
    # one shade for one colour: what is red at the terminal is not brown on the page
    pairs = {(colour, shown_as[kind]) for kind, colour in COLOURS.items()}
    assert len(pairs) == len({colour for colour, _ in pairs}) == 3
    assert len({shade for _, shade in pairs}) == 3


@pytest.mark.parametrize("tolerance_arcsec", [11.1, 10.5, 8.9])
def test_solve_shows_the_marks_in_their_colours_at_a_terminal(
    tolerance_arcsec, capsys, monkeypatch
):
    monkeypatch.setattr("rotcal_ros.report.terminal.columns.is_terminal", lambda: True)
    monkeypatch.setattr("click.utils.should_strip_ansi", lambda *_: False)
    given = result(tolerance_arcsec)
    print_result(given)
    words = capsys.readouterr().out
    codes = {"green": 32, "yellow": 33, "red": 31}
    for mark in marks(given):
        assert f"\x1b[{codes[mark.colour]}m{mark.line[:40]}" in words


def test_a_green_mark_never_stands_for_a_table_that_is_beyond():
    assert {kind for kind, colour in COLOURS.items() if colour == "green"} == {"ok", "within"}
    assert Mark("tolerance", "beyond", "beyond").colour == "red"
