"""Deviations as programs of other countries and habits write them: the same digits, or a question.

The forms are written here by Python's own means; none is one of our own writers.
"""

import numpy as np
import pytest

from rotcal_ros.foundation.errors import BagError, DataError, UndecidedError
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.recordings.inputs import MeasurementInput

ANGLES = range(0, 360, 30)
TRUTH = np.round(14.0 * np.sin(np.deg2rad(ANGLES) + 0.7) - 2.5, 2)
ROWS = list(zip(ANGLES, TRUTH.tolist(), strict=True))


def comma(value, places=2):
    return f"{value:.{places}f}".replace(".", ",")


def listed(head, line, separator=";"):
    return head + "\n" + "".join(separator.join(map(str, line(*row))) + "\n" for row in ROWS)


def own(head):
    return listed(head, lambda a, d: (a, comma(d)))


def pairs(head, separator=";"):
    return listed(head, lambda a, d: (a, comma(a + d / 3600, 8)), separator)


FORMS = {
    "italian.csv": own("Angolo [gradi];Scostamento [secondi d'arco]"),
    "spanish.csv": own("Ángulo (°);Desviación (″)"),
    "portuguese.csv": own("Ângulo [graus];Desvio [arcsec]"),
    "czech.csv": own('Úhel [°];Odchylka ["]'),
    "swedish.csv": own("Vinkel [grader];Avvikelse [bågsekunder]"),
    "dutch.csv": pairs("Gewenste hoek [°];Werkelijke hoek [°]"),
    "polish.txt": pairs("Kąt zadany [°]\tKąt zmierzony [°]", "\t"),
    "russian.csv": own("Угол [град];Отклонение [угл. сек]").encode("cp1251"),
    "korean.csv": own("각도 [°];편차 [arcsec]").encode("cp949"),
    "utf16_without_mark.txt": listed(
        "Position [°]\tDeviation [″]", lambda a, d: (a, d), "\t"
    ).encode("utf-16-be"),
    "a_lone_sign_of_seconds.txt": listed("Angle\tDev.\n°\t\"", lambda a, d: (a, d), "\t"),
    "a_sign_apart.csv": listed(
        "Angle [deg];Deviation [arcsec]", lambda a, d: (a, f"{'−' if d < 0 else '+'} {abs(d)}")
    ),
    "no_numbers_please.csv": listed(
        "Angle [deg],Deviation [arcsec]", lambda a, d: (f'="{a}"', f'="{d}"'), ","
    ),
    "two_signs_for_seconds.csv": listed(
        "Nominal;Actual", lambda a, d: (f"{a}°00'00.0\"\"", f"{a + d / 3600:.8f}°")
    ),
    "figures_below.csv": listed("Angle [deg],Deviation [arcsec]", lambda a, d: (a, d), ",")
    + "Accuracy A,30.2\nPeak-to-peak,28.4\n\nR,1.2\n",
    "lines.jsonl": "".join(
        f'{{"angle_deg": {a}, "note": null, "deviation_arcsec": {d}}}\n' for a, d in ROWS
    ),
}  # fmt: skip

WITH_THEIR_SIGN = {"dutch.csv", "polish.txt", "two_signs_for_seconds.csv", "lines.jsonl"}
"""Forms with both angles, or our own name of the deviation."""


def solved(folder, name, content, *changes):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return MeasurementInput(path, changes=("solver.u_arcsec=1", *changes)).read().solve()


@pytest.mark.parametrize("name", FORMS)
def test_the_same_digits_or_a_question_of_the_sign(name, tmp_path):
    changes = () if name in WITH_THEIR_SIGN else ("sheet.values=deviations",)
    if changes:
        with pytest.raises(UndecidedError) as asked:
            solved(tmp_path, name, FORMS[name])
        assert asked.value.question.setting == "sheet.values"
        assert not asked.value.question.also
    result = solved(tmp_path, name, FORMS[name], *changes)
    assert result.angles / DEGREE == pytest.approx(ANGLES)
    assert result.deviations["ECC"] / ARCSEC == pytest.approx(TRUTH, abs=2e-5)


def test_an_error_of_a_spreadsheet_was_not_measured(tmp_path):
    content = own("Angle [deg];Deviation [arcsec]").replace(
        f"\n60;{comma(TRUTH[2])}", "\n60;#DIV/0!"
    )
    result = solved(tmp_path, "t.csv", content, "sheet.values=deviations")
    assert result.angles / DEGREE == pytest.approx([a for a in ANGLES if a != 60])


def test_a_unit_that_is_not_known_is_named_where_no_head_is_known(tmp_path):
    with pytest.raises(BagError, match=r"'mil' in the heading 'angle \[mil\]' is an unknown unit"):
        solved(tmp_path, "t.csv", own("angle [mil];deviation [mil]"))


def test_a_line_of_json_that_is_none_is_refused(tmp_path):
    content = FORMS["lines.jsonl"]
    for bad in ('{"angle_deg": 3', "[1, 2]"):
        with pytest.raises(BagError, match="expected an object of JSON on each line"):
            solved(tmp_path, "t.jsonl", f"{content}{bad}\n")


@pytest.mark.parametrize("kinds", [("A", "C"), ("OK", "FAULT"), ("A1", "C1", "A1")])
def test_words_that_part_the_rows_of_an_angle_are_asked(kinds, tmp_path):
    """They were taken for runs: two axes became their mean."""
    head = "Axis,Angle [deg],Deviation [arcsec]\n"
    content = head + "".join(
        f"{kind},{a},{d * (1 + 3 * k)}\n" for k, kind in enumerate(kinds) for a, d in ROWS
    )
    with pytest.raises(UndecidedError, match=r"'Axis' is .* in rows of one angle") as asked:
        solved(tmp_path, "t.csv", content, "sheet.values=deviations")
    run, nothing = (value for value, _ in asked.value.question.answers)
    assert (run, nothing) == ("run=Axis", "nothing=Axis")
    if len({*kinds}) == len(kinds):
        result = solved(
            tmp_path, "t.csv", content, "sheet.values=deviations", f'sheet.columns=["{run}"]'
        )
        assert result.deviations["ECC"] / ARCSEC == pytest.approx(2.5 * TRUTH)
    result = solved(
        tmp_path, "t.csv", content, "sheet.values=deviations", f'sheet.columns=["{nothing}"]'
    )
    mean = 1.0 + 1.5 * (len(kinds) - 1)
    assert result.deviations["ECC"] / ARCSEC == pytest.approx(mean * TRUTH)


def test_a_table_without_values_of_its_formulas_says_so(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["Commanded [deg]", "Deviation [arcsec]"])
    book.active.append([0, "=1+1"])
    book.save(tmp_path / "t.xlsx")
    with pytest.raises(DataError, match="or save the workbook where its formulas are computed"):
        MeasurementInput(tmp_path / "t.xlsx").read()


@pytest.mark.parametrize(
    "head",
    [
        "Run {r} {way} deviation [arcsec]",
        "Deviation run {r} {way} [arcsec]",
        "Error {r} {way} / arcsec",
    ],
)
def test_heads_of_runs_may_say_what_they_hold(head, tmp_path):
    runs = [(r, way) for r in (1, 2) for way in ("up", "down")]
    content = ",".join(["Angle [deg]", *(head.format(r=r, way=way) for r, way in runs)]) + "\n"
    for a, d in ROWS:
        cells = (d + 0.25 * r - 2.0 * (way == "down") for r, way in runs)
        content += ",".join([str(a), *map(str, cells)]) + "\n"
    result = solved(tmp_path, "t.csv", content, "method=deviations", "sheet.values=deviations")
    assert result.deviations["ECC"] / ARCSEC == pytest.approx(TRUTH + 0.375 - 1.0)
    assert result.verdict == "ok"


@pytest.mark.parametrize("head", ["Deviation [%]", "Deviation [‰]", "|Deviation| [arcsec]"])
def test_a_share_and_an_absolute_value_are_no_deviations(head, tmp_path):
    """Signs of a name did not count."""
    with pytest.raises(BagError, match=r"unknown unit|no column deviation_rad"):
        solved(tmp_path, "t.csv", own(f"Angle [deg];{head}"), "sheet.values=deviations")


def test_a_column_of_several_units_is_refused(tmp_path):
    def line(a, d):
        return (a, d, "arcsec") if abs(d) < 8 else (a, f"{d / 60:.6f}", "arcmin")

    content = listed("Angle [deg];Deviation;Unit", line)
    stated = "sheet.values=deviations", "sheet.reading_unit=arcsec"
    with pytest.raises(DataError, match="'Unit' states several units, arcsec, arcmin"):
        solved(tmp_path, "t.csv", content, *stated)
    alike = listed("Angle [deg];Deviation;Unit", lambda a, d: (a, d, "arcsec"))
    assert solved(tmp_path, "t.csv", alike, *stated).verdict == "ok"
