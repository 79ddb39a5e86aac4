"""Tables of deviations in any form hold the curve that their own form holds."""

from pathlib import Path

import numpy as np
import openpyxl
import pytest

from rotcal_ros.evaluation.reference import read_deviations
from rotcal_ros.foundation.errors import DataError, UndecidedError
from rotcal_ros.foundation.table_columns import SheetSettings
from rotcal_ros.foundation.units import ARCSEC

ROWS = [(0, 0.5), (90, -1.5), (180, 2.25), (270, 1.0)]
"""Table angle in degrees and deviation in arcseconds; the standard uncertainty is 0.25 arcsec."""


def german(path: Path) -> None:
    rows = "".join(f"{a};{d};0,25\n" for a, d in ROWS).replace(".", ",")
    head = 'Prüfprotokoll;;\nSoll-Winkel [°];Winkelabweichung ["];Standardunsicherheit ["]\n'
    path.write_bytes((head + rows + "Mittelwert;0,56;\n").encode("cp1252"))


def chinese_in_microradians(path: Path) -> None:
    rows = "".join(f"{a}\t{d * ARCSEC * 1e6!r}\t{0.5 * ARCSEC * 1e6!r}\n" for a, d in ROWS)
    path.write_bytes(("角度[度]\t偏差[µrad]\t扩展不确定度[µrad]\n" + rows).encode("gb18030"))


def excel_in_degrees(path: Path) -> None:
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.append(["Turned (deg)", "Angle (deg)", "Error", "U (k=2)"])
    sheet.append([None, None, "deg", "arcsec"])
    for angle, deviation in ROWS:
        sheet.append(["yes", angle, deviation / 3600.0, 0.5])
    book.save(path)


@pytest.mark.parametrize("write", [german, chinese_in_microradians, excel_in_degrees])
def test_every_form_holds_the_same_curve(write, tmp_path):
    path, said = tmp_path / ("t.xlsx" if write is excel_in_degrees else "t.csv"), []
    write(path)
    curve = read_deviations(path, announce=said.append)
    np.testing.assert_allclose(np.rad2deg(curve.angles), [0.0, 90.0, 180.0, 270.0], atol=1e-12)
    expected = [deviation for _, deviation in ROWS]
    np.testing.assert_allclose(curve.deviation / ARCSEC, expected, rtol=1e-13)
    np.testing.assert_allclose(np.sqrt(np.diag(curve.covariance)) / ARCSEC, 0.25, rtol=1e-13)
    assert "deviation_rad = " in said[0].line()


def read(path, head, **settings):
    rows = "".join(f"{a},{d},0.5\n" for a, d in ROWS)
    (path / "t.csv").write_text(f"{head}\n{rows}", encoding="utf-8")
    return read_deviations(path / "t.csv", sheet=SheetSettings(**settings))


@pytest.mark.parametrize(
    ("head", "asked"),
    [
        (
            "Angle [deg],Deviation [arcsec],U [arcsec]",
            r'k = 1.* or .*k = 2.*\["expanded=U \[arcsec\]"\]',
        ),
        ("Angle [deg],Deviation [arcsec],Uncertainty [arcsec]", r'\["u=Uncertainty \[arcsec\]"\]'),
        ("Angle [deg],Deviation,u [arcsec]", r"states no unit.*as 'Deviation \[arcsec\]'"),
        ("Angle [deg],Deviation [arcsec],Error [arcsec]", "may both be the column deviation"),
        ("Angle [deg],Deviation [arcsec],Remark", "states no uncertainty"),
    ],
)
def test_what_is_open_is_asked(head, asked, tmp_path):
    with pytest.raises(DataError, match=asked):
        read(tmp_path, head)


def test_names_with_the_units_of_si_leave_nothing_open(tmp_path):
    curve = read(tmp_path, "angle_rad,deviation_rad,u_rad")
    assert curve.deviation.tolist() == [deviation for _, deviation in ROWS]
    assert np.diag(curve.covariance).tolist() == [0.25] * len(ROWS)


def test_a_correction_is_no_deviation_until_a_person_says_of_which_sign(tmp_path):
    head, name = "Angle [deg],Correction [arcsec],u [arcsec]", "Correction [arcsec]"
    with pytest.raises(UndecidedError, match=r"may be .* or a correction") as asked:
        read(tmp_path, head)
    (as_it_is, _), (other, words) = asked.value.question.answers
    assert "the control will add +" in words
    truth = [d for _, d in ROWS]
    for stated in ({"values": other}, {"columns": (f"reversed={name}",)}):
        np.testing.assert_allclose(-read(tmp_path, head, **stated).deviation / ARCSEC, truth)
    np.testing.assert_allclose(read(tmp_path, head, values=as_it_is).deviation / ARCSEC, truth)


def test_the_factor_is_taken_as_it_is_told(tmp_path):
    head = "Angle [deg],Deviation [arcsec],U [arcsec]"
    for column, std in (("u", 0.5), ("expanded", 0.25)):
        curve = read(tmp_path, head, columns=(f"{column}=U arcsec",))
        assert np.sqrt(curve.covariance[0, 0]) / ARCSEC == pytest.approx(std)
