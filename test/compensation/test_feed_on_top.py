"""The bridge's feed and the table in force: what it announces, replaces, adds to, refuses."""

from dataclasses import replace

import numpy as np
import pytest
from test_feed import COMP, Cell, applied, table_of, trims, undone

from rotcal_ros.compensation.bridge_settings import BridgeSettings
from rotcal_ros.compensation.feed import Feed
from rotcal_ros.compensation.held import in_force_of
from rotcal_ros.errors import DataError


@pytest.fixture
def cell(tmp_path):
    return Cell(tmp_path)


def held_now(cell):
    return in_force_of({n: t.decode() for n, t in cell.files().items()})


def test_what_is_in_force_is_unknown_before_the_first_change_and_a_hash_after(cell):
    feed = cell.feed()
    assert feed.in_force() == "unknown"
    applied(feed, table_of())
    assert feed.in_force() == held_now(cell)
    assert cell.feed().in_force() == held_now(cell)
    undone(feed)
    assert feed.in_force() == "none"


def test_a_table_by_hand_and_a_changed_one_are_tables_too(cell):
    (cell.folder / COMP).write_text("0 0 0\n")
    by_hand = cell.feed().in_force()
    assert by_hand == held_now(cell)
    (cell.folder / COMP).write_text("0 1 1\n")
    assert cell.feed().in_force() not in (by_hand, "unknown", "none")


def test_files_copied_by_hand_are_seen_whatever_the_settings(tmp_path):
    """Rows every 7 degrees are nothing for this control; the file that lies there is."""
    (tmp_path / "c_sinumerik.ini").write_text("M17\n")
    settings = BridgeSettings(
        controller="sinumerik", spacing_deg=7.0, controller_folder=str(tmp_path)
    )
    held = Feed(settings, "C", lambda: 1).in_force()
    assert held == in_force_of({"c_sinumerik.ini": "M17\n"})


def test_an_unfinished_change_makes_it_unknown(cell):
    feed = cell.feed()
    applied(feed, table_of())
    journal = feed._journal
    journal.note(replace(journal.entries()[-1], action="applying", in_force=""))
    assert feed.in_force() == "unknown"


def test_what_a_table_leaves_is_added_to_it(cell):
    feed = cell.feed()
    applied(feed, table_of())
    first = trims(cell)
    applied(feed, table_of(0.25, measured_on=feed.in_force()))
    # a quarter more at each row, the 2nd order (13 arcsec * 2e-4) aside
    np.testing.assert_allclose(trims(cell), 1.25 * first, atol=0.01 / 3600.0)
    with pytest.raises(DataError, match="adds to the table"):
        feed.apply(feed.offer.confirmation)


def test_what_was_measured_on_another_table_is_refused(cell):
    feed = cell.feed()
    applied(feed, table_of())
    old = feed.in_force()
    applied(feed, table_of(1.5))
    with pytest.raises(DataError, match="not added: measured on top of the table"):
        feed.take(table_of(0.1, measured_on=old), 2)
    undone(feed)
    feed.take(table_of(0.1, measured_on=old), feed._now_ns())
    text = (cell.folder / COMP).read_text()
    (cell.folder / COMP).write_text(text.replace("0.00", "0.01", 1))
    before = cell.files()
    with pytest.raises(DataError, match=r"which it was given at .* what is in force now is"):
        feed.apply(feed.offer.confirmation)
    assert cell.files() == before


def test_the_unknown_needs_the_word_of_a_person(cell):
    table = table_of(0.5, measured_on="unknown")
    with pytest.raises(DataError, match=r"bridge\.combine"):
        cell.feed().take(table, 1)
    for settings, other, factor in (
        ({}, table_of(), 1.0),
        ({"combine": "add"}, table, 1.5),
        ({"combine": "replace"}, table, 0.5),
    ):
        feed = cell.feed(**settings)
        applied(feed, other)
        feed.close()
        if factor == 1.0:
            first = trims(cell)
        np.testing.assert_allclose(trims(cell), factor * first, atol=0.02 / 3600.0)


def test_the_journal_is_the_history_of_what_the_controller_held(cell):
    feed, held = cell.feed(), []
    for scale in (1.0, 1.5):
        applied(feed, table_of(scale))
        held.append(held_now(cell))
    undone(feed)
    undone(feed)
    history = feed._journal.history()
    assert [state for _, state in history] == [*held, held[0], "none"]
    assert [time_ns for time_ns, _ in history] == sorted(time_ns for time_ns, _ in history)
