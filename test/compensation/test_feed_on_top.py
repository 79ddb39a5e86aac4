"""The bridge's feed and the table in force: what it announces, replaces, adds to, refuses."""

from dataclasses import replace

import numpy as np
import pytest
from test_feed import COMP, Cell, applied, made_before, table_of, trims, undone

from rotcal_ros.compensation.feed import Feed
from rotcal_ros.compensation.held_table import hash_in_force
from rotcal_ros.foundation.errors import DataError


@pytest.fixture
def cell(tmp_path):
    return Cell(tmp_path)


def held_now(cell):
    return hash_in_force({n: t.decode() for n, t in cell.files().items()})


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
    with pytest.raises(DataError, match="not added: measured with table"):
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


# The journal and the word of others.


def measured_now(cell, table):
    """The same table, measured from the next second of the cell's clock on, for a second."""
    return replace(table, measured_from_ns=cell.clock(), measured_until_ns=cell.clock())


def test_the_journal_knows_that_none_is_wrong(cell):
    """A cell that says 'none' while the bridge's table acts: its residual would replace it."""
    feed = cell.feed()
    applied(feed, table_of())
    held, before = feed.in_force(), cell.files()
    left = measured_now(cell, table_of(0.02, measured_on="none"))
    with pytest.raises(DataError, match=rf"journal of this bridge .* held the table {held[:12]}"):
        feed.take(left, cell.clock())
    assert feed.offer is None
    word = cell.feed(combine="replace")
    with pytest.raises(
        DataError, match=r"bridge.combine says 'replace', but according to the journal"
    ):
        word.take(replace(left, measured_on="unknown"), cell.clock())
    undated = replace(left, measured_from_ns=0, measured_until_ns=0)
    with pytest.raises(DataError, match="journal of this bridge"):
        feed.take(undated, cell.clock())
    assert cell.files() == before


def test_a_table_that_was_measured_before_the_one_in_force_replaces_it(cell):
    feed = cell.feed()
    applied(feed, table_of())
    assert applied(feed, table_of(1.5)).files


def test_after_a_restore_to_nothing_none_is_what_the_journal_says_too(cell):
    feed = cell.feed()
    applied(feed, table_of())
    undone(feed)
    assert applied(feed, measured_now(cell, table_of(1.2))).files


def test_a_table_that_was_in_force_for_a_part_of_the_measurement_is_one(cell):
    feed = cell.feed()
    begun_ns = cell.clock()
    applied(feed, table_of())
    mixed = replace(table_of(), measured_from_ns=begun_ns, measured_until_ns=cell.clock())
    with pytest.raises(DataError, match="journal of this bridge"):
        feed.take(mixed, cell.clock())


def test_a_hash_that_the_journal_contradicts_is_named_and_refused(cell):
    """Announced was the table of now, and by the journal another one, or none, was held then."""
    feed = cell.feed()
    early_ns = cell.clock()
    applied(feed, table_of())
    first, between_ns = feed.in_force(), cell.clock()
    applied(feed, table_of(1.5))
    second = feed.in_force()
    left = replace(table_of(), correction_forward=np.roll(table_of().correction_forward, 5))
    left = replace(left, measured_on=second, measured_from_ns=between_ns)
    for until_ns in (between_ns, cell.clock()):
        wrong = replace(left, measured_until_ns=until_ns)
        with pytest.raises(
            DataError, match=rf"{second[:12]}.*journal .* held the table {first[:12]}"
        ):
            feed.take(wrong, cell.clock())
    undone(feed)
    undone(feed)
    applied(feed, made_before(table_of()))
    begun_without = replace(left, measured_on=first, measured_from_ns=early_ns)
    with pytest.raises(DataError, match="according to the journal"):
        feed.take(replace(begun_without, measured_until_ns=between_ns), cell.clock())
    sound = replace(left, measured_on=first, measured_from_ns=cell.clock())
    assert feed.take(replace(sound, measured_until_ns=cell.clock()), cell.clock())


def test_the_word_add_is_held_against_the_journal_too(cell):
    """Measured without a table, which came only then: what was measured is the whole."""
    feed = cell.feed()
    applied(feed, table_of())
    undone(feed)
    whole = replace(measured_now(cell, table_of(0.3)), measured_on="unknown")
    applied(feed, made_before(table_of(1.5)))
    feed = cell.feed(combine="add")
    with pytest.raises(DataError, match=r"bridge.combine says 'add', but .* held no table then"):
        feed.take(whole, cell.clock())


def test_a_controller_that_shows_no_table_is_not_believed_against_the_journal(cell):
    feed = cell.feed()
    applied(feed, table_of())
    held = feed.in_force()
    assert feed.contradiction(held) is None
    for name in cell.files():
        (cell.folder / name).unlink()
    assert feed.in_force() == "unknown"
    assert f"according to the journal it was given {held[:12]}" in feed.contradiction("unknown")


def test_a_setting_that_says_none_is_named_where_the_controller_holds_a_table(cell):
    def feed():
        return Feed(cell.settings, "C", cell.clock, stated="none")

    one = feed()
    assert one.in_force() == "none"  # no file, no journal, and a person who says so
    applied(one, table_of())
    held = one.in_force()
    assert held == held_now(cell)
    assert one.contradiction(held).startswith(
        f"cell.table_in_force says none, and the controller holds {held[:12]}"
    )


# Serial number, axis, age: of the cell, and of what the controller holds.


def numbered(table, serial):
    return replace(table, serial=serial)


def test_an_item_is_not_fed_over_another_one(cell):
    feed = cell.feed()
    applied(feed, numbered(table_of(), "4711"))
    before = cell.files()
    other = numbered(table_of(1.5), "9999")
    with pytest.raises(DataError, match="9999 was measured and the table in force has 4711"):
        applied(feed, other)
    rest = replace(other, measured_on=feed.in_force())
    rest = replace(rest, correction_forward=np.roll(rest.correction_forward, 4))
    with pytest.raises(DataError, match="--accept serial"):
        feed.take(rest, cell.clock())
    assert cell.files() == before
    feed.close()
    accepting = cell.feed(accept=("serial",))
    assert applied(accepting, other).files


def test_a_measurement_without_a_number_does_not_wash_that_of_the_table_away(cell):
    feed = cell.feed()
    applied(feed, numbered(table_of(), "4711"))
    left = replace(table_of(), correction_forward=np.roll(table_of().correction_forward, 5))
    applied(feed, replace(measured_now(cell, left), measured_on=feed.in_force()))
    other = replace(measured_now(cell, numbered(left, "9999")), measured_on=feed.in_force())
    with pytest.raises(DataError, match="9999 was measured and the table in force has 4711"):
        feed.take(other, cell.clock())
    feed.close()
    elsewhere = Feed(cell.settings, "C", cell.clock, serial="9999")
    with pytest.raises(
        DataError, match=r"cell has the serial number 9999 and .* in force has 4711"
    ):
        elsewhere.take(replace(other, serial=""), cell.clock())


def test_the_cell_has_a_number_and_a_largest_age_of_its_own(cell):
    feed = Feed(cell.settings, "C", cell.clock, serial="4711")
    with pytest.raises(DataError, match="9999 was measured and this cell has 4711"):
        feed.take(numbered(table_of(), "9999"), cell.clock())
    assert feed.take(numbered(table_of(), "4711"), cell.clock())
    day_ns = 86_400 * 10**9
    old = replace(table_of(), measured_from_ns=cell.clock.ns - 366 * day_ns)
    with pytest.raises(DataError, match=r"366 days old.*--accept age"):
        feed.take(old, cell.clock())
    assert cell.feed(max_age_days=400.0).take(old, cell.clock())


def test_a_table_grows_too_old_while_it_is_on_offer(cell):
    feed = cell.feed()
    feed.take(table_of(), cell.clock())
    cell.clock.ns += 40 * 86_400 * 10**9
    with pytest.raises(DataError, match="40 days old"):
        feed.apply(feed.offer.confirmation)
    assert cell.files() == {}


def test_another_axis_needs_its_word_and_becomes_that_of_the_cell(cell):
    feed = cell.feed(accept=("axis",))
    feed.take(table_of(axis="B"), cell.clock())
    assert feed.offer.table.axis == "C"


# A table in force that does not do what it should.


@pytest.mark.parametrize(("gain", "words"), [(1.0, "inactive"), (2.0, "sign is wrong")])
def test_what_a_wrong_table_left_is_not_added_to_it(cell, gain, words):
    """Deviation d, correction -d: inactive it leaves d, with the wrong sign 2 d."""
    feed = cell.feed()
    applied(feed, table_of())
    before = cell.files()
    left = table_of(gain, measured_on=feed.in_force())
    with pytest.raises(DataError, match=f"not added: the table in force .* {words}"):
        feed.take(left, cell.clock())
    assert feed.offer is None
    assert cell.files() == before
