"""The sample lengths, as 34 programs and people would export them; all written by other code."""

from __future__ import annotations

import csv
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from xml.sax.saxutils import escape

import openpyxl

DATA = Path(__file__).parents[3] / "examples" / "data"
Rows = list[tuple[int, int, str]]


def sample() -> Rows:
    """Return position, target and length in metres, as text, of the sample data."""
    with (DATA / "lengths.csv").open() as file:
        return [
            (int(r["position"]), int(r["target"]), r["length_m"]) for r in csv.DictReader(file)
        ]


def in_mm(metres: str) -> str:
    """Return a length with ten decimals in millimetres, by moving the point in the text.

    >>> in_mm("0.3131669079"), in_mm("-1.0005000000")
    ('313.1669079', '-1000.5000000')
    """
    sign, (whole, places) = metres[: metres.startswith("-")], metres.lstrip("-").split(".")
    return f"{sign}{(whole + places[:3]).lstrip('0') or '0'}.{places[3:]}"


MM = [(p, t, in_mm(length)) for p, t, length in sample()]


def lines(head: Sequence[object], rows: Sequence[Sequence[object]], separator: str) -> str:
    return "\n".join(separator.join(map(str, row)) for row in (head, *rows)) + "\n"


def comma(rows: Rows) -> list[tuple[int, int, str]]:
    return [(p, t, length.replace(".", ",")) for p, t, length in rows]


def german(path: Path) -> None:
    head = ("Tischposition", "Zielpunkt-Nr.", "Länge [mm]")
    path.write_text(lines(head, comma(MM), ";"), encoding="utf-8-sig")


def german_ansi_with_titles(path: Path) -> None:
    rows = [(p + 1, t + 1, length) for p, t, length in comma(MM)]
    table = lines(("Stellung", "Reflektor", "Gemessene Länge (mm)"), rows, ";")
    title = "Prüfprotokoll Drehtisch;;\nPrüfer: Müller;;\n;;\n"
    path.write_bytes((title + table + "Mittelwert;;312,5\n").encode("cp1252"))


def french_utf16(path: Path) -> None:
    head = ("Position de table", "Cible", "Longueur mesurée [mm]")
    path.write_text(lines(head, comma(MM), "\t"), encoding="utf-16")


def chinese_gbk(path: Path) -> None:
    path.write_bytes(lines(("转台位置", "靶标编号", "长度 (毫米)"), MM, ",").encode("gb18030"))


def japanese_shift_jis(path: Path) -> None:
    path.write_bytes(lines(("テーブル位置", "ターゲット", "長さ［mm］"), MM, ",").encode("cp932"))


def stated_separator(path: Path) -> None:
    path.write_text("sep=;\n" + lines(("Position", "Target", "Length [mm]"), MM, ";"))


def units_below(path: Path) -> None:
    rows = [("", "", "mm"), *MM]
    path.write_text(lines(("POSITION", "TARGET", "LENGTH"), rows, ","))


def thousands(path: Path) -> None:
    rows = [(p, t, f"{float(n) * 1000:,.4f}") for p, t, n in MM]
    path.write_text(lines(("Position", "Target", "Length [µm]"), rows, ";"))


def trailing_and_blank(path: Path) -> None:
    text = lines(("position;target;length [mm]",), [(f"{p};{t};{n};;",) for p, t, n in MM], ";")
    path.write_text(text.replace("\n5;", "\n\n;;;;\n5;", 1) + ";;;;\n\n")


def columns_of_spaces(path: Path) -> None:
    rows = [(f"{p:>4}  {t:>6}  {n:>16}",) for p, t, n in MM]
    path.write_text("Report of lengths\n\n" + lines(("Pos.  Target  Length in mm",), rows, ""))


def more_columns(path: Path) -> None:
    head = (
        "Time",
        "Operator",
        "Pos",
        "Target",
        "Nominal length [mm]",
        "Measured length [mm]",
        "OK?",
    )
    rows = [("2026-03-31T10:00:00", "A. B.", p, t, "300.0", n, "yes") for p, t, n in MM]
    path.write_text(lines(head, rows, ","))


def angles(path: Path) -> None:
    rows = [(f"{30 * p}.000", t, n) for p, t, n in MM]
    path.write_text(lines(("Table angle [deg]", "Target", "Length [mm]"), rows, ","))


def minutes_and_seconds(path: Path) -> None:
    rows = [(f"{30 * p}°00'00\"", t, n) for p, t, n in MM]
    path.write_text(lines(("Winkel", "Ziel", "Länge / mm"), rows, ";"), encoding="utf-8")


def gons_the_other_way_round(path: Path) -> None:
    rows = [(f"{30 * p / 0.9:.6f}".replace(".", ","), t, n) for p, t, n in comma(MM)]
    path.write_text(lines(("Drehwinkel [gon]", "Ziel", "Weg [mm]"), rows, ";"), encoding="utf-8")


def inches(path: Path) -> None:
    rows = [(p, t, repr(float(n) / 25.4)) for p, t, n in MM]
    path.write_text(lines(("Position", "SMR", "Range (in)"), rows, ","))


def quoted_all(path: Path) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file, quoting=csv.QUOTE_ALL)
        writer.writerow(("Position\nof the table", "Target", "Length\n[mm]"))
        writer.writerows(comma(MM))


def matrix(path: Path) -> None:
    targets = sorted({t for _, t, _ in MM})
    by = {(p, t): n for p, t, n in MM}
    head = ("Position", *(f"T{t + 1}" for t in targets))
    rows = [(p + 1, *(by[p, t] for t in targets)) for p in sorted({p for p, _, _ in MM})]
    path.write_text("All lengths in mm\n" + lines(head, rows, ","))


def turned_matrix(path: Path) -> None:
    positions = sorted({p for p, _, _ in MM})
    by = {(p, t): n for p, t, n in comma(MM)}
    head = ("Ziel \\ Winkel [°]", *(30 * p for p in positions))
    rows = [(t, *(by[p, t] for p in positions)) for t in sorted({t for _, t, _ in MM})]
    path.write_text("Einheit: mm\n" + lines(head, rows, ";"), encoding="utf-8")


def units_in_cells(path: Path) -> None:
    rows = [(p, t, f"{n} mm") for p, t, n in MM]
    path.write_text(lines(("Position", "Target", "Length"), rows, "\t"))


def labels(path: Path) -> None:
    rows = [(f"P{p:02}", f"SMR-{t:02}", n) for p, t, n in MM]
    path.write_text(lines(("Position", "Reflector", "Distance [mm]"), rows, "|"))


def workbook(path: Path, sheets: dict[str, list[Sequence[object]]]) -> None:
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(row)
    book.save(path)


def excel(path: Path) -> None:
    rows = [(p, t, float(n)) for p, t, n in MM]
    workbook(path, {"Notes": [("made by hand",)], "Lengths": [
        ("Calibration of a rotary table",), (), ("Position", "Target", "Length [mm]"), *rows,
        ("Mean", None, 512.5)]})  # fmt: skip


def excel_with_targets(path: Path) -> None:
    with (DATA / "targets.csv").open() as file:
        places = [(r["target"], r["x_m"], r["y_m"], r["z_m"]) for r in csv.DictReader(file)]
    targets = [(f"R{int(n) + 1}", *(float(in_mm(c)) for c in p)) for n, *p in places]
    rows = [(p, f"R{t + 1}", float(n)) for p, t, n in MM]
    workbook(path, {
        "Messung": [("Position", "Reflektor", "Länge [mm]"), *rows],
        "Ziele": [("Reflektor", "X [mm]", "Y [mm]", "Z [mm]"), *targets],
    })  # fmt: skip


def excel_of_texts(path: Path) -> None:
    workbook(path, {"Blatt1": [("Position", "Ziel", "Länge [mm]"), *comma(MM)]})


def open_document(path: Path) -> None:
    """Write a workbook of OpenDocument with nothing but its content."""
    head = "".join(
        f'<c office:value-type="string"><text:p>{t}</text:p></c>'
        for t in ("Position", "Target", "Length [mm]")
    )
    number = '<c office:value-type="float" office:value="{0}"><text:p>{0}</text:p></c>'
    rows = [f"<r>{head}</r>", *(f"<r>{''.join(map(number.format, row))}</r>" for row in MM)]
    spaces = "urn:oasis:names:tc:opendocument:xmlns"
    content = (
        f'<office:document-content xmlns:office="{spaces}:office:1.0" '
        f'xmlns:table="{spaces}:table:1.0" xmlns:text="{spaces}:text:1.0"><office:body>'
        f'<office:spreadsheet><table:table table:name="{escape("Lengths")}">{"".join(rows)}'
        "</table:table></office:spreadsheet></office:body></office:document-content>"
    )
    names = {"<c": "<table:table-cell", "</c>": "</table:table-cell>"}
    names |= {"<r>": "<table:table-row>", "</r>": "</table:table-row>"}
    for short, long in names.items():
        content = content.replace(short, long)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("mimetype", "application/vnd.oasis.opendocument.spreadsheet")
        archive.writestr("content.xml", content)
        archive.writestr("META-INF/manifest.xml", "<manifest/>")


def of_dos(path: Path) -> None:
    text = "Prüfung;;\n" + lines(("Tischposition", "Ziel", "Länge [mm]"), comma(MM), ";")
    path.write_bytes(text.replace("\n", "\r\n").encode("cp850"))


def of_matlab(path: Path) -> None:
    rows = [(p, t, f"{float(n):.12e}") for p, t, n in MM]
    path.write_text(lines(("Position", "Target", "Length_mm"), [*rows, ("NaN",) * 3], ","))


def of_r(path: Path) -> None:
    rows = [(f'"{k}"', *row) for k, row in enumerate(comma(MM), 1)]
    path.write_text(lines(('""', '"position"', '"target"', '"length_mm"'), rows, ";"))


def fixed_width_with_units(path: Path) -> None:
    rows = [(f"{p:4} {t:6} {n:>15}",) for p, t, n in MM]
    path.write_text(lines((" Pos Target        Length\n [-]    [1]          [mm]",), rows, ""))


def of_fortran(path: Path) -> None:
    rows = [(p, t, f"{length}D+00") for p, t, length in sample()]
    path.write_text(lines(("POS", "TGT", "LENGTH(M)"), rows, "  "))


def head_in_a_comment(path: Path) -> None:
    head = "% lengths of the table\n%\n% Position Target Length/mm"
    path.write_text(lines((head,), [(f"{p} {t} {n}",) for p, t, n in MM], "") + "% end of file\n")


def swiss(path: Path) -> None:
    um = [(p, t, n.replace(".", "")) for p, t, n in MM]
    rows = [(p, t, f"{int(n[:-4]):,}".replace(",", "'") + "." + n[-4:]) for p, t, n in um]
    path.write_text(lines(("Position", "Ziel", "Länge [µm]"), rows, ";"), encoding="utf-8")


def with_totals(path: Path) -> None:
    ends = [(word, "", "12,5") for word in ("Summe:", "Ø", "Anzahl Werte", "Std.-Abw.")]
    head = ("Position", "Ziel", "Länge [mm]")
    path.write_text(lines(head, [*comma(MM), *ends], ";"), encoding="utf-8")


def another_table_below(path: Path) -> None:
    text = lines(("Position", "Ziel", "Länge [mm]"), comma(MM), ";")
    places = lines(("Ziel", "X [mm]", "Y [mm]", "Z [mm]"), [(0, "1,5", "2,5", "3,5")], ";")
    path.write_text(f"{text};;\n{places}", encoding="utf-8")


def two_languages(path: Path) -> None:
    head = "Position;Ziel;Länge\nposition;target;length\n[-];[-];[mm]"
    path.write_text(lines((head,), [(";".join(map(str, r)),) for r in comma(MM)], ""))


EXPORTS: dict[str, Callable[[Path], None]] = {
    "german.csv": german,
    "german_ansi.csv": german_ansi_with_titles,
    "french.txt": french_utf16,
    "chinese.csv": chinese_gbk,
    "japanese.csv": japanese_shift_jis,
    "stated_separator.csv": stated_separator,
    "units_below.csv": units_below,
    "trailing.csv": trailing_and_blank,
    "spaces.txt": columns_of_spaces,
    "more_columns.csv": more_columns,
    "angles.csv": angles,
    "minutes.csv": minutes_and_seconds,
    "gons.csv": gons_the_other_way_round,
    "quoted.csv": quoted_all,
    "matrix.csv": matrix,
    "turned.csv": turned_matrix,
    "cells.tsv": units_in_cells,
    "labels.txt": labels,
    "excel.xlsx": excel,
    "targets_inside.xlsx": excel_with_targets,
    "texts.xlsx": excel_of_texts,
    "open.ods": open_document,
    "dos.csv": of_dos,
    "matlab.csv": of_matlab,
    "r.csv": of_r,
    "units_row.txt": fixed_width_with_units,
    "fortran.dat": of_fortran,
    "comment.txt": head_in_a_comment,
    "swiss.csv": swiss,
    "totals.csv": with_totals,
    "another_below.csv": another_table_below,
    "two_languages.csv": two_languages,
}
"""Name of the file -> what writes it; all hold the sample lengths to the last digit."""
ROUNDED: dict[str, Callable[[Path], None]] = {"inches.csv": inches, "thousands.csv": thousands}
"""Those that round: to the last bit of a double, and to 0.1 nm."""
