"""Definitions and encodings of other writers: read right, or named with what to do."""

import struct

import numpy as np
import pytest
from bag_samples import STORE

from rotcal_ros.bags.blocks import HEADER_TYPE, Block
from rotcal_ros.bags.decode import Decoder
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.foundation.errors import BagError

SEPARATOR = "=" * 80
TIME = ("builtin_interfaces/msg/Time", "struct Time { int32 sec; uint32 nanosec; };")
HEADER = (
    "std_msgs/msg/Header",
    "struct Header { builtin_interfaces::msg::Time stamp; string frame_id; };",
)
STATE = (
    "sensor_msgs/msg/JointState",
    """@verbatim (language="comment", text=
      "The state of joints; # is no comment in IDL")
    struct JointState {
      std_msgs::msg::Header header;

      sequence<string> name;

      @verbatim (language="comment", text="rad" "\\n" "or m")
      @unit (value="rad")
      sequence<double> position;
      sequence<double> velocity;
      sequence<double> effort;
    };""",
)
COVARIANCE = (
    "geometry_msgs/msg/PoseWithCovariance",
    """typedef double double__36[36];
    @verbatim (language="comment", text="36 numbers")
    struct PoseWithCovariance {
      double__36 covariance;
    };""",
)


def part(name, body, *includes):
    """Return one definition as rosidl generates it."""
    package, kind, _ = name.split("/")
    return (
        "// generated from rosidl_adapter/resource/msg.idl.em\n"
        f"// with input from {name}.msg\n\n"
        + "".join(f'#include "{other}.idl"\n' for other in includes)
        + f"\nmodule {package} {{\n  module {kind} {{\n    {body}\n  }};\n}};\n"
    )


FORMS = {
    "as the registry says": (1, True, "\n"),
    "CRLF": (1, True, "\r\n"),
    "reversed": (-1, True, "\n"),
    "reversed, CRLF": (-1, True, "\r\n"),
    "without the first line": (1, False, "\n"),
}


@pytest.mark.parametrize("form", FORMS)
def test_ros2idl_is_read_as_the_registry_specifies_it(form):
    order, first, line_end = FORMS[form]
    parts = [(*STATE, HEADER[0]), (*HEADER, TIME[0]), TIME]
    texts = [f"{SEPARATOR}\nIDL: {name}\n{part(name, *rest)}" for name, *rest in parts]
    text = "\n".join(texts[::order])
    if not first:
        text = text.split("\n", 2)[2]
    text = text.replace("\n", line_end)
    decoder = Decoder(ChannelDefinition(1, "/cell/joint_states", STATE[0], "ros2idl", text))
    truth = STORE.types
    message = truth[STATE[0]](
        truth[HEADER[0]](truth[TIME[0]](3, 4), "base"), ["table"],
        np.array([0.5]), np.array([0.25]), np.array([]),
    )  # fmt: skip
    read = decoder.message(bytes(STORE.serialize_cdr(message, STATE[0])))
    assert (read.header.stamp.nanosec, read.name) == (4, ["table"])
    assert (read.position.tolist(), read.velocity.tolist()) == ([0.5], [0.25])


def test_typedefs_of_generated_idl_are_read():
    text = f"{SEPARATOR}\nIDL: {COVARIANCE[0]}\n{part(*COVARIANCE)}"
    decoder = Decoder(ChannelDefinition(1, "/pose", COVARIANCE[0], "ros2idl", text))
    data = b"\0\1\0\0" + np.arange(36.0).tobytes()
    assert decoder.message(data).covariance.tolist() == list(range(36))


class Cdr2:
    """Writes plain CDR2 by DDS-XTypes 1.3, 7.4.3: at most 4 bytes of alignment, DHEADERs."""

    def __init__(self, order):
        self.order, self.out = order, b""

    def number(self, kind, value):
        size = struct.calcsize(kind)
        self.out += bytes(-len(self.out) % min(size, 4)) + struct.pack(self.order + kind, value)

    def text(self, value):
        self.number("I", len(value) + 1)
        self.out += value.encode() + b"\0"

    def delimited(self, write):
        """Put the size of what is written before it."""
        self.out += bytes(-len(self.out) % 4)
        at = len(self.out)
        self.out += bytes(4)
        write()
        size = struct.pack(self.order + "I", len(self.out) - at - 4)
        self.out = self.out[:at] + size + self.out[at + 4 :]


def joint_state(order, stamp, joints, position, velocity):
    cdr = Cdr2(order)
    cdr.number("i", stamp[0])
    cdr.number("I", stamp[1])
    cdr.text("b")

    def listed():
        cdr.number("I", len(joints))
        for name in joints:
            cdr.text(name)

    cdr.delimited(listed)
    for numbers in (position, velocity, []):
        cdr.number("I", len(numbers))
        for number in numbers:
            cdr.number("d", number)
    return bytes((0, 7 if order == "<" else 6, 0, 0)) + cdr.out


def joint_decoder():
    text = STORE.generate_msgdef(STATE[0], ros_version=2)[0]
    return Decoder(ChannelDefinition(1, "/cell/joint_states", STATE[0], "ros2msg", text))


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("joints", [["table"], ["arm", "t"], ["abc", "de", "table"]])
def test_plain_cdr2_is_read_right_one_by_one_and_many_at_once(order, joints):
    position = [0.5 + n for n in range(len(joints))]
    velocity = [-0.25 * n for n in range(len(joints))]
    data = joint_state(order, (3, 4), joints, position, velocity)
    decoder = joint_decoder()
    read = decoder.message(data)
    assert (read.header.stamp.sec, read.header.frame_id, read.name) == (3, "b", joints)
    assert (read.position.tolist(), read.velocity.tolist()) == (position, velocity)
    block = Block(
        data * 3, np.arange(3) * len(data), np.full(3, len(data)), np.zeros(3, HEADER_TYPE)
    )
    (columns,) = decoder.columns(block, ("position", "velocity"), ("name",))
    assert columns.layout.texts["name"] == joints
    assert columns.values["position"].tolist() == [position] * 3
    assert columns.values["velocity"].tolist() == [velocity] * 3
    assert decoder.broken == 0


def test_lists_of_messages_in_plain_cdr2():
    name = "diagnostic_msgs/msg/DiagnosticStatus"
    text = STORE.generate_msgdef(name, ros_version=2)[0]
    cdr = Cdr2("<")
    cdr.number("B", 1)
    for value in ("node", "", "xyz"):
        cdr.text(value)

    def pairs():
        cdr.number("I", 2)
        for value in ("a", "1", "bcd", "22"):
            cdr.text(value)

    cdr.delimited(pairs)
    read = Decoder(ChannelDefinition(1, "/d", name, "ros2msg", text)).message(
        b"\0\7\0\0" + cdr.out
    )
    assert (read.level, read.name, read.hardware_id) == (1, "node", "xyz")
    assert [(v.key, v.value) for v in read.values] == [("a", "1"), ("bcd", "22")]


@pytest.mark.parametrize(("kind", "name"), [(3, "PL_CDR"), (9, "D_CDR2"), (11, "PL_CDR2")])
def test_other_forms_of_cdr_are_named(kind, name):
    decoder = joint_decoder()
    data = bytes((0, kind)) + joint_state("<", (3, 4), ["table"], [0.5], [0.0])[2:]
    assert decoder.message(data) is None
    assert decoder.broken == 1
    for word in ("/cell/joint_states", STATE[0], name, "record with a middleware of ROS 2"):
        assert word in decoder.unreadable


@pytest.mark.parametrize(
    ("encoding", "serialised"), [("jsonschema", "json"), ("protobuf", "protobuf")]
)
def test_schemas_of_no_ros_are_refused_by_name(encoding, serialised):
    channel = ChannelDefinition(
        1,
        "/cell/joint_states",
        "foxglove.JointStates",
        encoding,
        "{}",
        message_encoding=serialised,
    )
    with pytest.raises(BagError) as refused:
        Decoder(channel)
    for word in (
        "/cell/joint_states",
        "foxglove.JointStates",
        encoding,
        serialised,
        "as a message of ROS 2",
    ):
        assert word in str(refused.value)
