"""What goes beside a controller's file: where it comes from, what it leaves, all components."""

import hashlib
import json
from dataclasses import replace
from datetime import datetime, timezone

import numpy as np
import pytest
from compensation_examples import TAU, d4_table, even, result_of, wavy

from rotcal_ros.compensation import export as export_module
from rotcal_ros.compensation.controllers import controller_names, make_controller
from rotcal_ros.compensation.export import ResidualBudget, prepare_export
from rotcal_ros.compensation.linuxcnc import UNKNOWN_BACKLASH, UNKNOWN_LIMITS
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.compensation.volumetric import volumetric_files
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.units import ARCSEC, DEGREE

NOW = datetime(2026, 1, 2, 3, 4, 5, tzinfo=timezone.utc)


def side_of(done):
    (text,) = (t for n, t in done.files.items() if n.endswith(".provenance.json"))
    return json.loads(text)


FACTS_OF_A_TABLE = {
    "schema": 1,
    "written": "2026-01-02T03:04:05+00:00",
    "axis": "C",
    "item": "",
    "serial": "",
    "measured_from": "",
    "measured_until": "",
    "simulated": False,
    "method": "simulated",
    "verdict": "ok",
    "verdict_line": "ok",
    "sources_sha256": {},
    "measured_on": "unknown",
    "adds_to": "",
    "in_force": "replaces the table in force; not known which table was in force: the whole "
    "deviation, or what a table leaves",
    "sign_of_the_table": "correction = -(actual - commanded); add it to the commanded angle",
    "rows": 72,
    "row_angles_deg": pytest.approx(list(range(0, 360, 5))),
    "closed": True,
    "first_angle_deg": 0.0,
    "last_angle_deg": pytest.approx(355.0),
    "widest_spacing_deg": pytest.approx(5.0),
    "reference_angle_deg": 0.0,
    "blind_to": "what repeats more than 36 times in a turn: the measured angles are up to "
    "5 deg apart; a reversal: both directions are equal",
}
"""What the side file says of a simulated table of 72 rows, whatever the controller."""


@pytest.mark.parametrize("name", controller_names())
def test_the_side_file_holds_what_the_page_promises(name):
    """docs/compensation.md: hashes, date, verdict, units, sign, settings, residual, warnings."""
    table = table_from_result(result_of(even(72), wavy(even(72))))
    table = replace(table, warnings=("a remark",))
    done = prepare_export(table, name, now=NOW, spacing=5.0 * DEGREE, accept_unverified=True)
    side = side_of(done)
    facts = make_controller(name).facts
    beside = [own._asdict() for own in make_controller(name).own_settings]
    confirmation = side.pop("confirmation_sha256")
    decided = json.dumps({k: v for k, v in side.items() if k != "written"}, sort_keys=True)
    assert confirmation == done.confirmation == hashlib.sha256(decided.encode()).hexdigest()
    residual = side.pop("residual_arcsec")
    assert set(residual) == {"before", "interpolation", "sampling", "rounding", "direction",
                             "second_order", "following", "simulated", "std",
                             "stated"}  # fmt: skip
    for part, value in residual.items():
        assert value == pytest.approx(getattr(done.residual, part) / ARCSEC, rel=1e-12)
    assert set(side.pop("files_sha256")) == set(done.files) - {f"c_{name}.provenance.json"}
    settings = side.pop("settings")
    assert make_controller(name, settings) == make_controller(name)
    own = {n: t for n, t in done.files.items() if not n.endswith(".provenance.json")}
    text = json.dumps(own, sort_keys=True).encode()
    assert side.pop("contents_sha256") == hashlib.sha256(text).hexdigest()
    unverified = [f"not verified: {text}" for text in make_controller(name).unverified]
    assert tuple(side["warnings"]) == done.warnings
    wide = [text for text in done.warnings if text.startswith("between rows 5 deg apart")]
    assert bool(wide) == make_controller(name).staircase
    assert side.pop("warnings") == [
        "a remark",
        *([UNKNOWN_BACKLASH] if name == "linuxcnc" else []),
        *unverified,
        *wide,
        *([UNKNOWN_LIMITS] if name == "linuxcnc" else []),
    ]
    assert side.pop("residual") == done.residual.describe()
    assert {k: v for k, v in side.items() if k not in FACTS_OF_A_TABLE} == {
        "table_sha256": table.table_hash,
        "controller": name,
        "controller_title": facts.title,
        "own_settings": beside,
        "switch_on": make_controller(name).switch_on,
        "sign": facts.sign,
        "wrap": facts.wrap,
        "unit": facts.unit,
        "source": facts.source,
        "verified_on": facts.verified_on,
    }
    assert {k: side[k] for k in FACTS_OF_A_TABLE} == FACTS_OF_A_TABLE


def test_rows_and_reference_of_the_file_are_those_written():
    """An arc with rows at 0, 20, 50 and 90 deg; 7 measured rows."""
    angles = np.deg2rad([0.0, 10.0, 20.0, 30.0, 50.0, 70.0, 90.0])
    table = table_from_result(result_of(angles, 1e-5 * angles))
    done = prepare_export(
        table, "csv", now=NOW, spacing=40.0 * DEGREE, reference_angle=30.0 * DEGREE, stem="own"
    )
    assert set(done.files) == {"own.csv", "own.provenance.json"}
    side = side_of(done)
    assert (side["rows"], len(done.table.angles)) == (4, 4)
    np.testing.assert_allclose(np.rad2deg(done.table.angles), [0.0, 40.0, 80.0, 90.0])
    assert side["widest_spacing_deg"] == pytest.approx(40.0)
    assert side["reference_angle_deg"] == pytest.approx(30.0)
    assert side["blind_to"].startswith("what repeats more than 9 times in a turn")
    expected = -1e-5 * (done.table.angles - np.deg2rad(30.0))
    np.testing.assert_allclose(done.table.correction_forward, expected, atol=1e-15)


def budget(simulated, **changes):
    parts = {"before": 4.0, "interpolation": 1.0, "sampling": 0.0, "rounding": 0.5,
             "direction": 0.25, "second_order": 0.25, "std": 0.0}  # fmt: skip
    return ResidualBudget(simulated=simulated, **{**parts, **changes})


@pytest.mark.parametrize(
    ("residual", "words"),
    [
        (budget(2.0), None),
        (budget(2.0 + 1e-10), None),
        (
            budget(2.0 + 1e-7),
            "by the control's rule, the file leaves 4.125e.05 arcsec, expected at",
        ),
        (budget(2.0, before=2.0), None),
        (budget(2.0, before=2.0 - 1e-13), "the table would leave .* arcsec of a deviation of"),
        (budget(0.0, before=0.0, interpolation=0.0), None),
    ],
)
def test_a_file_may_leave_what_it_promised_and_no_more_than_there_was(
    residual, words, monkeypatch
):
    monkeypatch.setattr(export_module, "residual_budget", lambda *_: residual)
    if words is None:
        assert prepare_export(d4_table(), "csv", now=NOW).residual is residual
        return
    with pytest.raises(DataError, match=words):
        prepare_export(d4_table(), "csv", now=NOW)


def test_the_residual_in_words_and_in_sum():
    """What is nothing is not listed."""
    scaled = budget(3.0 * ARCSEC, before=400.0 * ARCSEC, interpolation=0.1 * ARCSEC,
                    rounding=0.2 * ARCSEC, direction=0.4 * ARCSEC, second_order=0.8 * ARCSEC,
                    std=0.05 * ARCSEC)  # fmt: skip
    assert scaled.stated / ARCSEC == pytest.approx(1.5)
    assert scaled.describe() == (
        "largest deviation 400 arcsec, after compensation at most 1.5 arcsec (interpolation 0.1, "
        "rounding 0.2, one column for both directions 0.4, second order 0.8), 3 arcsec by the "
        "control's own rule; standard uncertainty 0.05 arcsec"
    )
    assert (
        "(second order 0.8)"
        in replace(scaled, interpolation=0.0, rounding=0.0, direction=0.0).describe()
    )


def test_a_table_for_its_own_axis_only():
    with pytest.raises(ConfigurationError, match="for axis C1 and the export for axis C: leave"):
        prepare_export(d4_table(), "csv", now=NOW, axis="C")
    with pytest.raises(ConfigurationError, match="axis name 'c1'"):
        prepare_export(d4_table(), "csv", now=NOW, axis="c1")
    done = prepare_export(d4_table(), "csv", now=NOW, axis="C1", sources={"a.mcap": "12"})
    assert set(done.files) == {"c1_csv.csv", "c1_csv.provenance.json"}
    assert side_of(done)["sources_sha256"] == {"a.mcap": "12"}


def test_the_volumetric_file_is_whole():
    result = replace(
        result_of(even(3), [0.0, 1e-5, 2e-5], EXC=np.array([1e-6, 2e-6, 3e-6])),
        warnings=("a remark",),
    )
    files = volumetric_files(result, "v", "B")
    std = result.std["ECC"].tolist()
    assert json.loads(files["v.json"]) == {
        "schema": 1,
        "kind": "rotcal_volumetric",
        "axis": "B",
        "sign": "deviation = actual - commanded; angles counter-clockwise about +z",
        "units": {"EXC": "m", "ECC": "rad"},
        "method": "simulated",
        "simulated": False,
        "item": "",
        "serial": "",
        "measured_on": "unknown",
        "verdict": "ok",
        "verdict_line": "ok",
        "not_protected": [],
        "angles_rad": [0.0, TAU / 3, 2 * TAU / 3],
        "deviations": {"EXC": [1e-6, 2e-6, 3e-6], "ECC": [0.0, 1e-5, 2e-5]},
        "std": {"EXC": std, "ECC": std},
        "warnings": ["a remark"],
    }
    assert json.loads(volumetric_files(result, "v")["v.json"])["axis"] == "C"
    head, first, *_ = files["v.csv"].splitlines()
    assert head == "angle_rad,EXC_m,u_EXC_m,ECC_rad,u_ECC_rad"
    assert first == f"0.0,1e-06,{std[0]!r},0.0,{std[0]!r}"
    for stem, axis in (("../v", "C"), ("v", "c")):
        with pytest.raises(ConfigurationError, match="name"):
            volumetric_files(result, stem, axis)
