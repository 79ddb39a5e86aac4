"""200 tables over five years: the right ones are named, at the stated error rates."""

from dataclasses import replace

import numpy as np
import pytest
from chances import most
from simulated_park import Table, drawn, measured

from rotcal_history.database import ParkHistory
from rotcal_history.outlook import all_outlooks
from rotcal_history.settings import HistorySettings

YEARS = np.linspace(0.0, 5.0, 11)
CRASHED, WORN, SWAPPED = 5, 9, (16, 21)


def relabelled(result, serial):
    known = result.circumstances
    identity = replace(known.identity, serial=serial)
    return replace(result, circumstances=replace(known, identity=identity))


def results_of(count, seed):
    """Return the results of a park in which four tables had mishaps, by serial number."""
    rng = np.random.default_rng(seed)
    tables = [drawn(number, rng) for number in range(count)]
    tables[CRASHED].jump = (3.2, 2.5 * np.eye(8)[1])
    tables[WORN].bearing = (2.5, np.array([0.5, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    found = {table.serial: list(measured(table, YEARS, rng)) for table in tables}
    one, other = (tables[number].serial for number in SWAPPED)
    lasts = found[one][-1], found[other][-1]
    found[one][-1] = relabelled(lasts[1], one)
    found[other][-1] = relabelled(lasts[0], other)
    return found


@pytest.mark.parametrize("count", [24, pytest.param(200, marks=pytest.mark.slow)])
def test_the_right_tables_are_named(tmp_path, count):
    with ParkHistory(str(tmp_path / "history.db")) as history:
        for results in results_of(count, 7).values():
            for each in results:
                history.add_result(each)
        outlooks = all_outlooks(history, HistorySettings())
        again = all_outlooks(history, HistorySettings())
    assert outlooks == again
    named = {o.serial: {f.kind for f in o.urgent} for o in outlooks if o.urgent}
    words = {o.serial: o.reason for o in outlooks}
    mishaps = {f"T{number:04}" for number in (CRASHED, WORN, *SWAPPED)}
    assert mishaps <= named.keys()
    assert "jump" in named[f"T{CRASHED:04}"]
    assert named[f"T{WORN:04}"] & {"wear", "jump"}
    for mine, theirs in (SWAPPED, SWAPPED[::-1]):
        assert f"curve of T{theirs:04}/C" in words[f"T{mine:04}"]
    # One table in 370 is named for a jump, and about as many for wear.
    assert len(named.keys() - mishaps) <= most(2.0 / 370.0, count), named


def test_an_event_explains_a_jump(tmp_path):
    table = Table("HIT", np.eye(8)[0], jump=(3.2, 2.5 * np.eye(8)[1]))
    with ParkHistory(str(tmp_path / "history.db")) as history:
        for each in measured(table, YEARS, np.random.default_rng(1)):
            history.add_result(each)
        (before,) = all_outlooks(history, HistorySettings())
        history.add_event(
            history.item("HIT"), "crash", before.findings[0].time_ns - 1, "tailstock"
        )
        (after,) = all_outlooks(history, HistorySettings())
    assert [found.kind for found in before.findings] == ["jump"] + ["drift"] * (
        len(before.findings) - 1
    )
    assert not after.urgent
    assert after.due_ns > before.due_ns


@pytest.mark.parametrize("what", ["crash", "bearing"])
def test_after_an_event_a_table_has_to_be_measured(tmp_path, what):
    table = Table("HIT", np.eye(8)[0])
    with ParkHistory(str(tmp_path / "history.db")) as history:
        for each in measured(table, YEARS, np.random.default_rng(1)):
            history.add_result(each)
        (before,) = all_outlooks(history, HistorySettings())
        history.add_event(history.item("HIT"), what, before.last_ns + 1, "")
        (after,) = all_outlooks(history, HistorySettings())
    assert not before.urgent
    assert after.due_ns == before.last_ns + 1
    assert f"{what} on 2026-01-01, after the newest result: measure again" in after.reason
