"""What else these controls do with an axis: named by every export, and put into the table."""

import json
from dataclasses import replace
from datetime import datetime, timezone

import numpy as np
import pytest
from compensation_examples import d4_table, two_ways
from controls_beside_the_core import OURS, pmac, twincat

from rotcal_ros.compensation.controllers import make_controller
from rotcal_ros.compensation.export import prepare_export
from rotcal_ros.compensation.writing import without_provenance
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.units import ARCSEC, DEGREE

NOW = datetime(2026, 1, 2, tzinfo=timezone.utc)


def exported(table, name, **settings):
    return prepare_export(table, name, now=NOW, settings=settings, accept_unverified=True)


@pytest.mark.parametrize("name", [*OURS, "linuxcnc"])
def test_every_export_names_them_and_ends_with_what_switches_the_table_on(name):
    done = exported(
        replace(two_ways(24), correction_reverse=two_ways(24).correction_forward), name
    )
    controller = make_controller(name)
    *beside, last = done.describe()
    assert last == f"switch on: {controller.switch_on}" != "switch on: "
    assert beside[len(beside) - len(controller.own_settings) :] == [
        own.describe() for own in controller.own_settings
    ]
    (side,) = (json.loads(t) for n, t in done.files.items() if n.endswith(".json"))
    assert [own["name"] for own in side["own_settings"]] == [
        own.name for own in controller.own_settings
    ]
    own_file = "".join(without_provenance(done.files).values())
    if controller.comment:
        assert all(line in own_file for line in (*beside[-len(controller.own_settings) :], last))


def test_what_no_page_confirms_is_marked():
    assert "not confirmed by a page" in make_controller("fanuc").own_settings[2].describe()


def both_equal():
    """Measured while the control took the play off: both directions see the same."""
    table = two_ways(24)
    return replace(table, correction_reverse=table.correction_forward)


PLAY = 800
"""Sixteenths of a count, of 3600000 per turn: 18 arcsec."""


def test_a_backlash_that_the_file_of_a_pmac_overwrites_is_in_its_table(tmp_path):
    settings = {"counts_per_turn": 3_600_000}
    lines = tmp_path / "motor.txt"
    lines.write_text(f"I184=0\nI185=16\nI186 = {PLAY}\nI285=9\nI286=7\n")
    stated = exported(both_equal(), "pmac", backlash_sixteenths=PLAY, **settings)
    read = exported(both_equal(), "pmac", machine_file=str(lines), **settings)
    assert read.files["c_pmac.pmc"] == stated.files["c_pmac.pmc"]
    assert f"I186={PLAY}\n" in read.files["c_pmac.pmc"]
    at = np.arange(0.0, 360.0, 15.0)
    rule = pmac(without_provenance(read.files))
    assert rule(at, True) - rule(at, False) == pytest.approx(18.0 / 3600.0, abs=1e-5)
    (said,) = (text for text in read.warnings if "I186" in text)
    assert f"I186 = {PLAY}" in said
    assert "-18 arcsec in the reverse column" in said
    for changed, text in ((16, f"I185=0\nI186={PLAY}\n"), (0, "I185=16\nI186=0\n")):
        lines.write_text(text)
        none = exported(both_equal(), "pmac", machine_file=str(lines), **settings)
        assert "I186" not in none.files["c_pmac.pmc"].split("DEFINE")[1], changed
    lines.write_text("I185=16\n")
    with pytest.raises(ConfigurationError, match=r"expected lines I185=\.\.\. and I186=\.\.\."):
        exported(both_equal(), "pmac", machine_file=str(lines), **settings)
    one = exported(both_equal(), "pmac", backlash_sixteenths=PLAY, reversal="mean", **settings)
    assert not any("I186" in text for text in one.warnings)  # it stays, and acts as before


def test_a_backlash_beside_a_list_of_both_directions_of_twincat_is_in_the_list():
    plain = twincat(without_provenance(exported(both_equal(), "twincat").files))
    done = exported(both_equal(), "twincat", backlash_deg=0.01)
    rule, at = twincat(without_provenance(done.files)), np.arange(0.0, 360.0, 15.0)
    assert rule(at, True) - rule(at, False) == pytest.approx(0.01, abs=1e-9)
    np.testing.assert_array_equal(rule(at, True), plain(at, True))
    (said,) = (text for text in done.warnings if "P-AXIS-00103" in text)
    assert "-36 arcsec in the reverse column" in said
    assert "set P-AXIS-00021 to 0" in said


@pytest.mark.parametrize(
    ("name", "settings", "words"),
    [
        ("pmac", {"counts_per_turn": 3_600_000}, "I186 during the measurement is not known"),
        ("twincat", {}, "P-AXIS-00103 during the measurement is not known"),
    ],
)
def test_a_backlash_that_is_not_known_is_asked_where_it_would_be_lost(name, settings, words):
    table = two_ways(24)
    shifted = table.correction_forward - 9.0 * ARCSEC  # play, in the sense that Ixx86 holds
    with pytest.raises(ConfigurationError, match=words):
        exported(replace(table, correction_reverse=shifted), name, **settings)
    assert not any(words in text for text in exported(both_equal(), name, **settings).warnings)
    none = {"pmac": {"backlash_sixteenths": 0}, "twincat": {"backlash_deg": 0.0}}[name]
    stated = exported(replace(table, correction_reverse=shifted), name, **settings, **none)
    assert not any(words in text for text in stated.warnings)


def test_on_top_of_a_table_nothing_is_added_and_the_reason_is_said():
    table = replace(d4_table(), adds_to="a" * 64, measured_on="a" * 64)
    controller = make_controller("twincat", {"backlash_deg": 0.01})
    assert "is not added, since a table was in force" in controller.replaced(table)
    assert controller.without_table(1) == pytest.approx(-0.01 * DEGREE)
