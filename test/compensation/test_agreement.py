"""Serial number, axis and age: what contradicts is refused, unless its own word accepts it."""

from dataclasses import replace

import pytest
from test_feed import made_before, table_of

from rotcal_ros.compensation.agreement import (
    AcceptedConflicts,
    MachineIdentity,
    check_table_for_machines,
    split_words,
)
from rotcal_ros.foundation.errors import ConfigurationError, DataError

DAY_NS = 86_400 * 10**9
MACHINE = {"this cell": MachineIdentity("C", "4711")}


def table(serial="4711", axis="C"):
    return replace(made_before(table_of(axis=axis)), serial=serial)


def asked(made, days=1.0, machines=MACHINE, words=(), largest=30.0):
    now_ns = made.measured_from_ns + round(days * DAY_NS)
    return check_table_for_machines(made, machines, AcceptedConflicts(words, largest), now_ns)


def test_what_agrees_is_as_it_was():
    made = table()
    assert asked(made) is made
    assert asked(made, machines={"other": MachineIdentity()}) is made
    assert asked(replace(made, serial="")).serial == ""


CONFLICTS = {
    "serial": (table("9999"), 1.0, "serial number 9999 was measured and this cell has 4711"),
    "axis": (table(axis="B"), 1.0, "axis B was measured and this cell has axis C"),
    "age": (table(), 366.0, "the measurement is 366 days old, at most 30 are accepted"),
}


@pytest.mark.parametrize("word", CONFLICTS)
def test_each_contradiction_is_named_and_has_its_own_word(word):
    made, days, words = CONFLICTS[word]
    with pytest.raises(DataError, match=f"{words}.*--accept {word}"):
        asked(made, days)
    others = tuple(other for other in CONFLICTS if other != word)
    with pytest.raises(DataError, match=f"--accept {word}"):
        asked(made, days, words=others)
    taken = asked(made, days, words=(word,))
    assert taken.axis == "C"
    assert any(words in text and "accepted by a person" in text for text in taken.warnings)


def test_all_that_contradicts_is_told_at_once():
    with pytest.raises(DataError, match="--accept axis --accept serial --accept age"):
        asked(table("9999", "B"), 99.0)


def test_the_largest_age_can_be_set_and_what_has_no_date_goes_by_when_it_was_made():
    assert asked(table(), 366.0, largest=400.0)
    undated = replace(table(), measured_from_ns=0)
    now_ns = 500 * DAY_NS
    (*_, said) = check_table_for_machines(undated, MACHINE, AcceptedConflicts(), now_ns).warnings
    assert "it is not known how many days ago this was measured, at most 30 are accepted" in said
    dated = check_table_for_machines(
        undated, MACHINE, AcceptedConflicts(), now_ns, made_ns=490 * DAY_NS
    )
    assert dated is undated
    with pytest.raises(DataError, match="100 days old"):
        check_table_for_machines(
            undated, MACHINE, AcceptedConflicts(), now_ns, made_ns=400 * DAY_NS
        )


@pytest.mark.parametrize("wrong", [("seriel",), ("",), ("all",)])
def test_a_word_that_accepts_nothing_is_refused(wrong):
    with pytest.raises(ConfigurationError, match="expected one of axis, serial, age"):
        AcceptedConflicts(wrong)
    with pytest.raises(ConfigurationError, match="largest age"):
        AcceptedConflicts(largest_age_days=0.0)


def test_words_come_in_any_grouping():
    assert split_words(["serial,age", "axis"]) == ("serial", "age", "axis")
