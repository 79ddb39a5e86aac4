"""The grammar and the lines of I++ DME 1.4.3, chapters 6.1 and 6.2; and input of others."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from rotcal_ipp_dme.protocol import (
    LONGEST,
    Call,
    DmeError,
    LineBuffer,
    ProtocolError,
    ResponseKind,
    ResponseLine,
    TagCounter,
    Word,
    format_value,
    is_tag,
    make_call,
    parse_call,
    parse_response,
    parse_values,
)


def test_calls_are_read_with_spaces_where_the_specification_allows_them():
    assert parse_call("GoTo ( X( 100 ) ,Y(-1.5e1), R(.5))") == Call(
        "GoTo", (Call("X", (100.0,)), Call("Y", (-15.0,)), Call("R", (0.5,)))
    )
    assert parse_call("StartSession()") == Call("StartSession")
    assert parse_call("StopDaemon(E0553)") == Call("StopDaemon", (Word("E0553"),))
    assert parse_call("SetProp(Tool.PtMeasPar.Speed(100))") == Call(
        "SetProp", (Call("Tool.PtMeasPar.Speed", (100.0,)),)
    )
    assert parse_call('ChangeTool("Probe 1")') == Call("ChangeTool", ("Probe 1",))


def test_data_of_all_forms_are_read():
    assert parse_values("X(99.93), Y(17.148)") == (Call("X", (99.93,)), Call("Y", (17.148,)))
    assert parse_values('"Speed", "Number"') == ("Speed", "Number")
    assert parse_values("(1.0, 0.0, 0.0)") == (1.0, 0.0, 0.0)
    assert parse_values("100.0, 0.2,1.5,0") == (100.0, 0.2, 1.5, 0.0)


def test_calls_inside_each_other_are_read_down_to_the_depth_that_the_refusal_names():
    def nested(depth):
        return "A(" * depth + "1" + ")" * depth

    inner = parse_call(nested(8))
    for _ in range(7):
        (inner,) = inner.arguments
    assert inner == Call("A", (1.0,))
    with pytest.raises(ProtocolError, match="more than 8 calls inside each other"):
        parse_call(nested(9))


@pytest.mark.parametrize(
    "text", ["", "GoTo", "GoTo(", "GoTo(X(1)", "GoTo(,)", "GoTo(1,)", "GoTo(X(1)) x", "1", '"a',
             "GoTo(1 2)", "GoTo(1E999)", "GoTo(--1)", "Go.To.(1)", "(" * 50, "A(" * 50]
)  # fmt: skip
def test_what_is_no_call_is_refused_in_a_sentence(text):
    with pytest.raises(ProtocolError):
        parse_call(text)


def test_numbers_are_written_as_the_grammar_has_them():
    assert format_value(1.0) == "1"
    assert format_value(-0.0) == "0"
    assert format_value(-123.456789012) == "-123.456789012"
    assert format_value(1e-9) == "0.000000001"
    for impossible in (1e7, float("nan"), float("inf")):
        with pytest.raises(ProtocolError):
            format_value(impossible)
    assert str(make_call("AlignPart", 1, 0, 0.5)) == "AlignPart(1, 0, 0.5)"


@given(st.floats(-1e6, 1e6))
def test_a_number_comes_back_within_half_a_picometre(number):
    (read,) = parse_values(format_value(number))
    assert abs(read - number) <= 0.5001e-9 + 1e-15 * abs(number)


def test_errors_are_read_as_the_specification_and_as_servers_write_them():
    by_example = '00003 ! Error(3, 2500, GoTo, "Machine limit encountered (Move Out Of Limits)")'
    fault = parse_response(by_example).fault()
    assert (fault.severity, fault.number, fault.cause, fault.stops) == (3, 2500, "GoTo", True)
    quoted = '00401 ! Error(1, 0504, "SetProp", "Argument out of range")'
    fault = parse_response(quoted).fault()
    assert (fault.number, fault.text, fault.stops) == (504, "Argument out of range", False)
    with pytest.raises(ProtocolError, match="severity, number, cause, text"):
        ResponseLine("00001", ResponseKind.ERROR, "Error(3)").fault()


def test_tags_are_five_characters_and_count_round():
    # the examples of 6.2.1
    assert [is_tag(t) for t in ("04711", "01710", "00020")] == [True] * 3
    assert [is_tag(t) for t in ("20", "00000", "E0000", "E20", "A4711")] == [False] * 5
    assert [is_tag(t) for t in ("E3333", "E0456")] == [True] * 2
    tags = TagCounter()
    commands = [tags.command() for _ in range(100_000)]
    assert (commands[0], commands[99_998], commands[99_999]) == ("00001", "99999", "00001")
    events = [tags.event() for _ in range(10_000)]
    assert (events[0], events[9_998], events[9_999]) == ("E0001", "E9999", "E0001")


def test_bytes_become_lines_however_they_are_cut():
    text = b"00001 &\r\n00001 # X(1)\r\n00001 %\r\n"
    for cut in range(len(text)):
        lines = LineBuffer()
        assert lines.feed(text[:cut]) + lines.feed(text[cut:]) == [
            "00001 &", "00001 # X(1)", "00001 %"
        ]  # fmt: skip
        assert lines.rest == b""


@pytest.mark.parametrize(
    "harm", [b"x" * LONGEST, b"00001 &\n\r\n", b"0\x001\r\n", b"00001 # \xff\r\n", b"\r\r\n"]
)
def test_lines_that_none_sends_are_refused(harm):
    with pytest.raises(ProtocolError):
        LineBuffer().feed(harm)


def values_again(values):
    return ", ".join(map(format_value, values)) or "()"  # no values are a line, too


LINES = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=300) | st.text(
    'GX()"1.5-, E0%&#', max_size=12
)
"""Any line, and lines that are more often good ones."""


@pytest.mark.parametrize(
    ("read", "write"), [(parse_call, str), (parse_values, values_again), (parse_response, str)]
)
@given(LINES)
@example("()")
def test_whatever_a_line_holds_it_is_refused_in_words_or_the_same_when_written(read, write, text):
    refused = ""
    try:
        line = write(read(text))  # what cannot be meant is refused when it is written
    except DmeError as error:
        refused = str(error)
    assert refused or write(read(line)) == line
