"""References and repeated runs in forms of other people, by ``compare`` and ``iso230``."""

import json
import shlex

import numpy as np
import pytest
from test_evaluation_verbs import DOWN, UP, result_file, run, runs_file, table, truth

pytestmark = pytest.mark.usefixtures("without_figures")


def test_a_reference_of_another_form_is_read_and_said(tmp_path):
    degrees = np.arange(12) * 30.0
    off = np.random.default_rng(3).normal(0.0, 0.05, 12)
    pair = (
        result_file(tmp_path / "plate.json", degrees, truth(degrees)),
        table(tmp_path / "polygon.csv", degrees, truth(degrees) + off),
    )
    own = np.loadtxt(pair[1], delimiter=",", skiprows=1)
    rows = "".join(f"{a};{d};{2 * u}\n" for a, d, u in own).replace(".", ",")
    path = tmp_path / "referenz.csv"
    path.write_text(f"Winkel [°];Abweichung [Winkelsekunden];U [Winkelsekunden]\n{rows}")
    asked = run("compare", pair[0], path)
    assert asked.exit_code == 2
    given = ("--set", 'sheet.columns=["expanded=U [Winkelsekunden]"]')
    assert shlex.join(given) in asked.stderr
    read, expected = (
        run("compare", pair[0], path, *given, "--json"),
        run("compare", *pair, "--json"),
    )
    assert "deviation_rad = 'Abweichung [Winkelsekunden]'" in read.stderr
    found, wanted = (json.loads(ran.stdout)["pairs"][0]["chi2"] for ran in (read, expected))
    assert found == pytest.approx(wanted, rel=1e-9)


GERMAN = "Lauf;Richtung;Winkel [°];Abweichung [Winkelsekunden];Prüfer"
IN_ORDER = "Table angle [deg];Deviation [arcsec]"
NUMBERED = "Position;Table angle [deg];Deviation [arcsec]"


def in_another_form(path, head, told=("up", "down")):
    """Write the runs of ``runs_file`` as each was measured: up, and down again."""
    rows = [
        (j + 1, name, 45 * i, side[0][i] + side[1][i] * (j - 2))
        for j in range(5)
        for name, side, order in ((told[0], UP, range(8)), (told[1], DOWN, reversed(range(8))))
        for i in order
    ]
    cells = {
        GERMAN: lambda run, way, angle, value: (run, way, angle, f"{value:.6f}", "me"),
        IN_ORDER: lambda _run, _way, angle, value: (angle, value),
        NUMBERED: lambda _run, _way, angle, value: (angle // 45 + 1, angle, value),
    }[head]
    body = "\n".join(";".join(map(str, cells(*row))) for row in rows)
    body = body.replace(".", ",") if head == GERMAN else body
    path.write_text(f"{head}\n{body}\n", encoding="utf-8-sig")
    return path


@pytest.mark.parametrize("head", [GERMAN, IN_ORDER, NUMBERED])
def test_iso230_reads_any_form_by_columns_or_by_the_order_of_rows(tmp_path, head):
    path = in_another_form(tmp_path / "läufe.txt", head, ("auf", "ab"))
    expected = json.loads(run("iso230", runs_file(tmp_path / "runs.csv"), "--json").stdout)
    done = run("iso230", path, "--json")
    assert done.exit_code == 0, done.stderr
    assert "runs: 5, up and down" in done.stderr
    found = json.loads(done.stdout)
    for name in ("accuracy", "repeatability", "systematic", "reversal", "mean_range"):
        assert found[name] == pytest.approx(expected[name], rel=1e-9)
    assert found["targets"] == pytest.approx(expected["targets"], abs=1e-15)


def test_iso230_explains_a_table_and_stops(tmp_path):
    explained = run("iso230", in_another_form(tmp_path / "läufe.txt", GERMAN), "--explain")
    assert (explained.exit_code, explained.stderr) == (0, "")
    assert "'Winkel [°]'" in explained.stdout
    assert "not needed: Prüfer" in explained.stdout


@pytest.mark.parametrize(
    ("text", "given", "code", "words"),
    [
        ("Winkel [°];Abweichung\n0;1\n90;2\n", (), 2, "name, as 'Abweichung [arcsec]'"),
        ("Position;Deviation [arcsec]\n0;1\n90;2\n", (), 2, '["angle=Position"]'),
        ("Position;Deviation [arcsec]\n0;1\n90;2\n", ("--set", "sheet.columns=[angle=Position]"),
         2, "--set sheet.angle_unit=deg or --set"),
        ("Angle [deg];Deviation [arcsec]\n0;1\n90;2\n0;1\n90;2\n", (), 3, "one direction"),
    ],
)  # fmt: skip
def test_iso230_says_what_a_table_of_another_form_lacks(tmp_path, text, given, code, words):
    (tmp_path / "runs.txt").write_text(text)
    done = run("iso230", tmp_path / "runs.txt", *given)
    assert (done.exit_code, done.stdout) == (code, "")
    assert words in done.stderr
