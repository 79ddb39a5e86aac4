"""Ordinary exports of sound data are read as the table of our own form with the same numbers."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from exports import DATA, EXPORTS, ROUNDED, in_mm, lines, sample, workbook

from rotcal_ros.methods.configuration import Configuration, read_configuration
from rotcal_ros.methods.measurements import read_measurements


@pytest.fixture(scope="module")
def configuration() -> Configuration:
    return read_configuration(DATA / "tracer.yaml")


def lengths(path: Path, configuration: Configuration) -> list[tuple[int, int, float]]:
    data = read_measurements(path, configuration)
    return [(o.table_position, o.target, o.mean[0]) for o in data.observations]


@pytest.mark.parametrize("name", EXPORTS)
def test_an_export_holds_the_same_digits(
    name: str, configuration: Configuration, tmp_path: Path
) -> None:
    EXPORTS[name](tmp_path / name)
    if not name.startswith("targets"):
        shutil.copy(DATA / "targets.csv", tmp_path)
    expected = sorted((p, t, float(length)) for p, t, length in sample())
    assert sorted(lengths(tmp_path / name, configuration)) == expected


@pytest.mark.parametrize("name", ROUNDED)
def test_an_export_that_rounds(name: str, configuration: Configuration, tmp_path: Path) -> None:
    ROUNDED[name](tmp_path / name)
    shutil.copy(DATA / "targets.csv", tmp_path)
    expected = sorted((p, t, float(length)) for p, t, length in sample())
    found = sorted(lengths(tmp_path / name, configuration))
    for (*key, length), (*other, other_length) in zip(found, expected, strict=True):
        assert key == other
        assert length == pytest.approx(other_length, abs=6e-11)


def rows_of(name: str) -> list[dict[str, str]]:
    with (DATA / name).open() as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def balls_by_number(path: Path) -> None:
    """Balls are numbered as they stand on the plate, from 1."""
    number = {step: n for n, step in enumerate(["0", "1", "3", "5", "8", "9"], start=1)}
    rows = [
        (r["position"], number[r["ball_step"]], *(in_mm(r[c]).replace(".", ",") for c in XYZ))
        for r in rows_of("balls.csv")
    ]
    head = ("Tischposition", "Kugel Nr.", "X [mm]", "Y [mm]", "Z [mm]")
    path.write_text(lines(head, rows, ";"), encoding="cp1252")


def balls_in_merged_cells(path: Path) -> None:
    rows = rows_of("balls.csv")[:72]  # the closing measurement has no place in a matrix
    by = {(r["position"], r["ball_step"]): [float(in_mm(r[c])) for c in XYZ] for r in rows}
    steps = ["0", "1", "3", "5", "8", "9"]
    above = ["Pos.", *(cell for step in steps for cell in (f"Ball step {step}", None, None))]
    below = [None, *["X [mm]", "Y [mm]", "Z [mm]"] * 6]
    body = [[p, *(c for step in steps for c in by[str(p), step])] for p in range(12)]
    workbook(path, {"Balls": [above, below, *body]})


def points_in_japanese(path: Path) -> None:
    kinds = {"direct": "直接", "mirrored": "鏡像", "nest": "ネスト"}
    rows = [
        (r["position"], r["tracker_station"], kinds[r["kind"]], r["nest"],
         *(in_mm(r[c]) for c in XYZ))
        for r in rows_of("tracker.csv")
    ]  # fmt: skip
    head = (
        "テーブル位置",
        "ステーション",
        "種類",
        "ネスト",
        "X座標［mm］",
        "Y座標［mm］",
        "Z座標［mm］",
    )
    path.write_text(lines(head, rows, "\t"), encoding="utf-16")


def places_in_french(path: Path) -> None:
    rows = [
        (r["place"], r["position"], r["target"], in_mm(r["length_m"]).replace(".", ","))
        for r in rows_of("three_places/lengths.csv")
    ]
    head = ("Emplacement", "Position de table", "Cible n°", "Longueur (mm)")
    path.write_text(lines(head, rows, ";"), encoding="utf-8-sig")


XYZ = ("x_m", "y_m", "z_m")
OTHERS: dict[str, tuple[Callable[[Path], None], str, str, int]] = {
    "balls_by_number.csv": (balls_by_number, "balls.csv", "ball_plate.yaml", 78),
    "balls_merged.xlsx": (balls_in_merged_cells, "balls.csv", "ball_plate.yaml", 72),
    "places.csv": (places_in_french, "three_places/lengths.csv", "tracer_six.yaml", 0),
}


@pytest.mark.parametrize("name", OTHERS)
def test_exports_of_other_methods(name: str, tmp_path: Path) -> None:
    write, own, setup, count = OTHERS[name]
    write(tmp_path / name)
    if (targets := (DATA / own).with_name("targets.csv")).exists() and "balls" not in name:
        shutil.copy(targets, tmp_path)
    configuration = read_configuration(DATA / setup)
    found, expected = (
        [(o.table_position, o.station, o.target, o.mean) for o in read.observations]
        for read in (
            read_measurements(tmp_path / name, configuration),
            read_measurements(DATA / own, configuration),
        )
    )
    assert sorted(found) == sorted(expected[: count or None])


def test_a_trackers_points_in_japanese(tmp_path: Path) -> None:
    points_in_japanese(tmp_path / "points.txt")
    configuration = read_configuration(DATA / "plane_mirror.yaml")
    found, expected = (
        read_measurements(path, configuration).solve().deviations["ECC"]
        for path in (tmp_path / "points.txt", DATA / "tracker.csv")
    )
    assert found.tolist() == expected.tolist()


def test_a_set_up_of_two_lines_for_a_table_with_angles(tmp_path: Path) -> None:
    """Without a plan the table itself gives its angles."""
    EXPORTS["angles.csv"](tmp_path / "angles.csv")
    shutil.copy(DATA / "targets.csv", tmp_path)
    (tmp_path / "setup.yaml").write_text("method: tracer_multistation\nlength_std_m: 1.2e-7\n")
    result = read_measurements(
        tmp_path / "angles.csv", read_configuration(tmp_path / "setup.yaml")
    ).solve()
    expected = read_measurements(
        DATA / "lengths.csv", read_configuration(DATA / "tracer.yaml")
    ).solve()
    assert result.angles.tolist() == expected.angles.tolist()
    # the sample's set-up states more, so only the uncertainty's size can differ
    difference = result.deviations["ECC"] - expected.deviations["ECC"]
    assert (abs(difference) <= 0.5 * expected.std["ECC"]).all()
