"""Questions of a table that are asked at once: those that come whatever is answered before."""

import pytest

from rotcal_ros.foundation.errors import BagError, DataError
from rotcal_ros.foundation.table_columns import AS_IT_STANDS, SheetSettings, undecided
from rotcal_ros.foundation.table_questions import asking_at_once, further_lines

UNIT = ("sheet.length_unit", (("mm", "milli"), ("m", "whole")))
ANGLE = ("sheet.angle_unit", (("deg", "360"), ("gon", "400")))
COUNTS = ("sheet.counts_per_turn", (("N", "of the encoder"),))
SIGN = ("sheet.values", (("deviations", "as it stands"), ("corrections", "turned")))


def question(each, found="open"):
    setting, answers = each
    return undecided(found, setting, answers)


def asked_of(read, sheet=AS_IT_STANDS):
    """Return what is asked besides the first question, with what was found; the lines say it."""
    with pytest.raises(DataError) as error:
        asking_at_once(lambda stated, _: read(stated), sheet, str)
    lines = list(further_lines(error.value.question))
    return [(each.setting, each.found) for each in error.value.question.also], lines


def test_all_that_is_open_is_asked_with_an_option_for_each():
    def read(sheet):
        for name, each in (("length_unit", UNIT), ("angle_unit", ANGLE), ("values", SIGN)):
            if not getattr(sheet, name):
                raise question(each, f"no {name}")

    found, lines = asked_of(read)
    assert found == [("sheet.angle_unit", "no angle_unit"), ("sheet.values", "no values")]
    assert lines[1] == "--set sheet.angle_unit=deg: 360"
    assert lines[-1] == (
        "all at once: --set sheet.length_unit=LENGTH_UNIT --set sheet.angle_unit=ANGLE_UNIT "
        "--set sheet.values=VALUES"
    )
    found, _ = asked_of(read, SheetSettings(angle_unit="deg"))
    assert found == [("sheet.values", "no values")]


@pytest.mark.parametrize("only_if", ["mm", "m"])
def test_what_only_some_answers_lead_to_is_not_asked_yet(only_if):
    def read(sheet):
        if not sheet.length_unit:
            raise question(UNIT)
        if sheet.length_unit == only_if and not sheet.angle_unit:
            raise question(ANGLE)
        if not sheet.values:
            raise question(SIGN)

    found, lines = asked_of(read)
    assert [setting for setting, _ in found] == ["sheet.values"]
    assert "ANGLE_UNIT" not in lines[-1]


def test_what_a_question_says_only_after_an_answer_names_that_answer():
    def read(sheet):
        if not sheet.length_unit:
            raise question(UNIT)
        if not sheet.angle_unit:
            raise question(ANGLE)
        if not sheet.values:
            raise question(SIGN, f"3 {sheet.length_unit}")

    assert asked_of(read)[0] == [
        ("sheet.angle_unit", "open"), ("sheet.values", "3 mm (if length_unit=mm)"),
    ]  # fmt: skip


def test_an_answer_that_is_refuted_leaves_the_rest_open():
    def read(sheet):
        if not sheet.length_unit:
            raise question(UNIT)
        if sheet.length_unit == "m":
            raise BagError("no table is that large")
        if not sheet.values:
            raise question(SIGN)

    assert [setting for setting, _ in asked_of(read)[0]] == ["sheet.values"]


def test_an_answer_that_only_shows_its_form_is_the_last():
    def read(sheet):
        if not sheet.angle_unit:
            raise question(ANGLE)
        raise question(SIGN if sheet.counts_per_turn else COUNTS)

    assert [setting for setting, _ in asked_of(read)[0]] == ["sheet.counts_per_turn"]


def test_an_answer_that_settles_nothing_is_not_tried_for_ever():
    def read(_sheet):
        raise question(UNIT)

    assert asked_of(read) == ([], [])


def test_columns_are_told_apart_by_what_they_are():
    def columns(name):
        return "sheet.columns", tuple((f"{name}={head}", head) for head in "abc")

    def read(sheet):
        for name in ("angle", "deviation"):
            if name not in sheet.named():
                raise question(columns(name), name)

    found, lines = asked_of(read)
    assert found == [("sheet.columns", "deviation")]
    assert lines[-1] == """all at once: --set 'sheet.columns=["angle=HEAD", "deviation=HEAD"]'"""


def test_a_table_that_would_take_too_many_trials_is_asked_one_by_one():
    many = "sheet.up", tuple((str(n), "way") for n in range(100))

    def read(sheet):
        if not sheet.up:
            raise question(many)
        if not sheet.values:
            raise question(SIGN)

    assert asked_of(read) == ([], [])
