import hashlib
import json
import os
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import pytest
from compensation_examples import TAU, even, result_of, wavy
from hypothesis import given
from hypothesis import strategies as st

from rotcal_ros.compensation import controller_files
from rotcal_ros.compensation.controllers import controller_names, make_controller
from rotcal_ros.compensation.export import prepare_export
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.compensation.volumetric import volumetric_files
from rotcal_ros.compensation.writing import check_stem, write_files
from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.foundation.units import ARCSEC

NOW = datetime(2026, 1, 2, 3, 4, 5, tzinfo=timezone.utc)


def table_of(verdict="ok", axis="C"):
    angles = even(36)
    return table_from_result(result_of(angles, wavy(angles), verdict=verdict), axis=axis)


def test_side_file_says_where_the_numbers_come_from(tmp_path):
    table = table_of()
    done = prepare_export(
        table, "linuxcnc", now=NOW, spacing=TAU / 36, sources={"run.mcap": "ab" * 32}
    )
    paths = write_files(done.files, tmp_path / "out")
    assert sorted(p.name for p in paths) == [
        "c_linuxcnc.comp",
        "c_linuxcnc.ini",
        "c_linuxcnc.provenance.json",
    ]
    side = json.loads((tmp_path / "out" / "c_linuxcnc.provenance.json").read_text())
    for name, digest in side["files_sha256"].items():
        assert hashlib.sha256((tmp_path / "out" / name).read_bytes()).hexdigest() == digest
    assert side["table_sha256"] == table.table_hash
    assert side["sources_sha256"] == {"run.mcap": "ab" * 32}
    assert side["written"] == "2026-01-02T03:04:05+00:00"
    assert side["verdict"] == "ok"
    assert "correction = -(actual - commanded)" in side["sign_of_the_table"]
    assert side["unit"].startswith("degrees")
    assert side["residual_arcsec"]["simulated"] <= side["residual_arcsec"]["stated"]
    assert side["residual_arcsec"]["before"] == pytest.approx(
        np.max(np.abs(wavy(np.linspace(0, TAU, 5000)) - wavy(0.0))) / ARCSEC, rel=1e-3
    )


@pytest.mark.parametrize("verdict", ["suspect", "failed"])
def test_only_a_good_verdict_is_exported(verdict):
    with pytest.raises(DataError, match=f"verdict of the simulated result is '{verdict}'"):
        prepare_export(table_of(verdict), "csv", now=NOW)
    with pytest.raises(DataError, match=verdict):
        volumetric_files(result_of(even(4), np.zeros(4), verdict=verdict), "v")


def test_table_for_another_axis_is_refused():
    with pytest.raises(ConfigurationError, match="for axis C and the export for axis A"):
        prepare_export(table_of(), "csv", now=NOW, axis="A")
    assert prepare_export(table_of(axis="A"), "csv", now=NOW, axis="A").files


@pytest.mark.parametrize("name", controller_names())
def test_what_is_not_verified_needs_a_word_and_is_written_down(name):
    unverified = make_controller(name).unverified
    if unverified:
        with pytest.raises(ConfigurationError, match="--accept-unverified"):
            prepare_export(table_of(), name, now=NOW)
    done = prepare_export(table_of(), name, now=NOW, accept_unverified=True)
    side = json.loads(next(t for n, t in done.files.items() if n.endswith("provenance.json")))
    assert [w for w in side["warnings"] if w.startswith("not verified: ")] == [
        f"not verified: {text}" for text in unverified
    ]


def test_verified_controllers_are_those_with_a_documented_file():
    assert not any(make_controller(name).unverified for name in ("csv", "linuxcnc"))


@pytest.mark.parametrize("name", ["csv", "linuxcnc"])
def test_a_table_that_makes_it_worse_is_not_written(name):
    """Rows every 120 degrees mistake four waves a turn for one and add to them."""
    angles = even(72)
    table = table_from_result(result_of(angles, wavy(angles, [(4, 20.0, 0.0)])))
    with pytest.raises(DataError, match="spacing is too coarse"):
        prepare_export(table, name, now=NOW, spacing=TAU / 3, accept_unverified=True)


def test_nothing_is_overwritten_and_all_or_nothing(tmp_path):
    done = prepare_export(table_of(), "linuxcnc", now=NOW)
    (tmp_path / "c_linuxcnc.ini").write_text("mine")
    with pytest.raises(BagError, match="exists already"):
        write_files(done.files, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["c_linuxcnc.ini"]
    assert (tmp_path / "c_linuxcnc.ini").read_text() == "mine"


def test_a_link_in_the_way_is_not_followed(tmp_path):
    elsewhere = tmp_path / "elsewhere"
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "a.csv").symlink_to(elsewhere)
    with pytest.raises(BagError, match="exists already"):
        write_files({"a.csv": "1\n"}, tmp_path / "out")
    assert not elsewhere.exists()


def test_a_full_disk_leaves_nothing(tmp_path, monkeypatch):
    calls = []

    def fails(descriptor):
        calls.append(descriptor)
        if len(calls) == 2:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fails)
    with pytest.raises(BagError, match="No space left"):
        write_files({"a.txt": "1\n", "b.txt": "2\n"}, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_a_file_is_an_error(tmp_path):
    (tmp_path / "f").write_text("")
    with pytest.raises(BagError, match="cannot make the folder"):
        write_files({"a.txt": "1\n"}, tmp_path / "f")


@pytest.mark.parametrize("name", ["../a.csv", "/etc/a", "a/b", "", ".", "..", ".hidden", "a\n"])
def test_names_do_not_leave_the_folder(name, tmp_path):
    with pytest.raises(ConfigurationError, match="file name"):
        write_files({"good.txt": "", name: "x"}, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    with pytest.raises(ConfigurationError, match="file name"):
        prepare_export(table_of(), "csv", now=NOW, stem=name or "/")


@pytest.mark.slow
@given(st.text(max_size=20))
def test_any_accepted_name_is_a_plain_one(text):
    try:
        stem = check_stem(text)
    except ConfigurationError:
        return
    assert Path(stem).name == stem
    assert stem.isascii()
    assert not set(stem) & set("./\\\0\n ")


def volumetric_result():
    rng = np.random.default_rng(8)
    components = {name: rng.normal(size=24) * 1e-6 for name in ("EXC", "EYC", "EBC")}
    return result_of(even(24), wavy(even(24)), **components)


def test_volumetric_tables_hold_every_bit():
    """Read with numpy and json alone, as a stranger would."""
    result = volumetric_result()
    files = volumetric_files(result, "vol")
    rows = np.genfromtxt(files["vol.csv"].splitlines(), delimiter=",", names=True)
    data = json.loads(files["vol.json"])
    assert set(data["deviations"]) == set(result.deviations)
    assert data["units"] == {"EXC": "m", "EYC": "m", "EBC": "rad", "ECC": "rad"}
    for angles in (rows["angle_rad"], data["angles_rad"]):
        np.testing.assert_array_equal(angles, result.angles)
    for name, unit in data["units"].items():
        for found in (rows[f"{name}_{unit}"], data["deviations"][name]):
            np.testing.assert_array_equal(found, result.deviations[name])
        for found in (rows[f"u_{name}_{unit}"], data["std"][name]):
            np.testing.assert_array_equal(found, result.std[name])
    head = files["vol.csv"].splitlines()[0]
    assert head.startswith("angle_rad,EXC_m,u_EXC_m,EYC_m")
    assert "EZC" not in head
    assert data["sign"].startswith("deviation = actual - commanded")


@pytest.mark.parametrize(("form", "module", "name"), [
    ("csv", controller_files, "parse_numbers"), ("json", json, "loads"),
])  # fmt: skip
def test_a_volumetric_file_that_reads_back_differently_is_refused(form, module, name, monkeypatch):
    reader = getattr(module, name)

    def off_by_one_bit(*arguments):
        found = reader(*arguments)
        column = found["deviations"]["EBC"] if form == "json" else found[:, 1]
        column[3] = np.nextafter(column[3], 1.0)
        return found

    monkeypatch.setattr(module, name, off_by_one_bit)
    with pytest.raises(BagError, match=rf"vol\.{form}: read back, it differs from what was"):
        volumetric_files(volumetric_result(), "vol")


def test_a_volumetric_table_needs_uncertainties():
    result = replace(volumetric_result(), std={"ECC": np.zeros(24)})
    with pytest.raises(DataError, match="no uncertainty of EXC, EYC, EBC"):
        volumetric_files(result, "vol")
