"""Definitions that somebody else wrote, cut or forged: used, or refused in one line."""

from __future__ import annotations

import resource
import struct

import pytest
from rosbags.typesys import Stores, get_typestore

from rotcal_ros.bags.decode import MAX_DEFINITION, Decoder
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.foundation.errors import BagError

LINE = "=" * 80 + "\n"
LITTLE = b"\0\1\0\0"


def with_parts(own: str, **parts: str) -> str:
    return own + "".join(f"{LINE}MSG: a/{name}\n{text}" for name, text in parts.items())


def chain(depth: int, twice: str = "") -> str:
    parts = {f"L{i}": f"L{i + 1} x\n{twice and f'L{i + 1} y'}\n" for i in range(depth)}
    return with_parts("L0 x\n", **parts, **{f"L{depth}": "uint8 x\n"})


def decoder(definition: str, encoding: str = "ros2msg", type_name: str = "a/msg/B") -> Decoder:
    return Decoder(ChannelDefinition(1, "/t", type_name, encoding, definition))


@pytest.mark.parametrize(
    ("definition", "reason"),
    [
        ("B x\n", "a/msg/B contains itself"),
        (with_parts("C x\n", C="B[] y\n"), "contains itself"),
        (chain(200), "more than 64 messages nested in each other"),
        (chain(40, "twice"), "more than 134217728"),
        ("float64 x\nstd_msgs/Hea", "at 'std_msgs/Hea'"),
        ("std_msgs/Header header\n", "it does not define std_msgs/msg/Header"),
        ("\0\x1b[31m%%%", r"makes no sense at '\\x00\\x1b"),
        ("uint8[-5] x\n", "array of -5 elements"),
        ("uint8[0] x\n", "array of 0 elements"),
        ("uint8[" + "9" * 5000 + "] x\n", "cannot be read"),
        (with_parts("C[4000000000] x\n", C=""), "array of 4000000000 elements"),
        ("string[4000000000] x\n", "array of 4000000000 elements"),
        ("uint8[4000000000] x\n", "has at least 4000000000 bytes"),
        ("uint8 x\nuint8 x\n", "conflicting"),
        ("uint8 x\n" * (MAX_DEFINITION // 8 + 1), "longer than 262144 characters"),
    ],
)  # fmt: skip
def test_what_no_message_can_be_is_refused_in_one_line(definition: str, reason: str) -> None:
    with pytest.raises(BagError) as refusal:
        decoder(definition)
    text = str(refusal.value)
    assert text.startswith("topic /t: the definition of a/msg/B cannot be read: ")
    assert reason.replace(r"\\", "\\\\") in text
    assert len(text) < 250
    assert text.isprintable()
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < 2_000_000  # kB


@pytest.mark.parametrize("base", ["wstring", "wchar", "float128"])
def test_idl_types_that_are_not_supported_are_named(base: str) -> None:
    kind = "long double" if base == "float128" else base
    with pytest.raises(BagError, match=f"a/msg/B cannot be read: field x is a {base}"):
        decoder(f"module a {{ module msg {{ struct B {{ {kind} x; }}; }}; }};", "ros2idl")


def test_idl_definitions_are_read() -> None:
    text = "module a { module msg { struct B { double x; sequence<uint8, 3> y; }; }; };"
    data = LITTLE + struct.pack("<dI", 1.5, 2) + b"\7\x08"
    message = decoder(text, "ros2idl").message(data)
    assert (message.x, message.y.tolist()) == (1.5, [7, 8])


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("xcdr2", [False, True])
def test_an_enumeration_of_idl_is_a_number_of_32_bits(xcdr2: bool, big: bool) -> None:
    """DDS-XTypes 1.3, 7.3.1.2.1.5: 32 bits unless ``@bit_bound`` says otherwise."""
    line = "=" * 80
    kinds = "module b { module msg { enum Mode { OFF, @value(5) ON }; }; };"
    own = "module a { module msg { struct B { b::msg::Mode mode; uint8 n; double x; }; }; };"
    text = f"{line}\nIDL: a/msg/B\n{own}\n{line}\nIDL: b/msg/Mode\n{kinds}\n"
    order = ">" if big else "<"
    fields = struct.pack(f"{order}iB3x", 5, 7) + struct.pack(f"{order}d", 1.5)
    data = bytes([0, 6 * xcdr2 + (not big), 0, 0]) + fields
    message = decoder(text, "ros2idl").message(data)
    assert (message.mode.value, message.n, message.x) == (5, 7, 1.5)
    for other in (kinds.replace("enum", "@bit_bound(8) enum"), kinds):
        listed = "b::msg::Mode mode" if other is not kinds else "sequence<b::msg::Mode> mode"
        unsure = text.replace(kinds, other).replace("b::msg::Mode mode", listed)
        with pytest.raises(BagError, match="it does not define b/msg/Mode"):
            decoder(unsure, "ros2idl")


@pytest.mark.parametrize("encoding", ["", "protobuf"])
def test_other_encodings_are_named(encoding: str) -> None:
    with pytest.raises(BagError, match=f"topic /t: .*a/msg/B.*{encoding}"):
        decoder("x", encoding)


def test_constants_defaults_bounds_and_keywords() -> None:
    text = "uint8 A=1\nstring<=5 S='a'\nfloat64 from 2.5\nstring<=3 class\nint8[<=4] self\n"
    text = text.replace("string<=5 S", "string S")
    data = LITTLE + struct.pack("<dI", 1.5, 2) + b"a\0" + bytes(2) + struct.pack("<Ib", 1, -3)
    message = decoder(text).message(data)
    assert (message.from_, message.class_, message.self.tolist()) == (1.5, "a", [-3])


def test_an_empty_definition_is_one_byte_in_cdr() -> None:
    """As rosbags' own std_msgs/Empty, parsed from ROS 2's IDL, is."""
    kilted = get_typestore(Stores.ROS2_KILTED)
    empty = kilted.types["std_msgs/msg/Empty"]()
    data = bytes(kilted.serialize_cdr(empty, "std_msgs/msg/Empty"))
    assert len(data) == 5
    assert decoder("", type_name="std_msgs/msg/Empty").message(data) is not None
    reader = decoder(with_parts("Nothing x\nfloat64 y\n", Nothing="# none\n"))
    message = reader.message(LITTLE + bytes(8) + struct.pack("<d", 2.5))
    assert message.y == 2.5
    assert reader.broken == 0


HOSTILE = {
    "longer list than message": LITTLE + struct.pack("<I", 2**32 - 1),
    "text without end": LITTLE + struct.pack("<I", 9) + b"abc",
    "wrong encapsulation": b"\x07\x07\0\0" + bytes(40),
    "delimited CDR2": b"\0\x09\0\0" + bytes(40),
    "plain CDR2, cut": b"\0\7\0\0" + bytes(2),
    "parameter list": b"\0\3\0\0" + bytes(40),
    "nothing": b"",
    "header only": LITTLE,
}


@pytest.mark.parametrize("field", ["uint8[] x", "string x", "string[] x", "C[] x", "float64[] x"])
@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_messages_are_counted(name: str, field: str) -> None:
    reader = decoder(with_parts(f"{field}\n", C=""))
    assert reader.message(HOSTILE[name]) is None
    assert reader.broken == 1
