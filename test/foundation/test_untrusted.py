"""YAML that people write: what two readers would read as two things is refused, with its line."""

from pathlib import Path

import pytest

from rotcal_ros.bags.rosbag2_metadata import parse_description
from rotcal_ros.bags.settings import changed_limits
from rotcal_ros.compensation.controllers import parse_options
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.untrusted import load_yaml
from rotcal_ros.methods.configuration import (
    node_parameters,
    parse_configuration,
    read_configuration,
)

EXAMPLE = Path(__file__).parents[2] / "examples/data/tracer.yaml"
# What YAML 1.1 (ROS, PyYAML, yaml-cpp) reads, by the tables of its types at yaml.org/type.
TRAPS = {
    "1:30": "90",
    "190:20:30": "685230",
    "1:30.5": "90.5",
    "010": "8",
    "-017": "-15",
    "1_000": "1000",
    "1_0.5": "10.5",
    "0b101": "5",
    "0x1_0": "16",
    "yes": "true",
    "Yes": "true",
    "on": "true",
    "no": "false",
    "OFF": "false",
}


@pytest.mark.parametrize(("written", "read"), TRAPS.items())
def test_what_two_versions_of_yaml_read_differently_is_refused_with_its_line(written, read):
    with pytest.raises(ConfigurationError) as refused:
        load_yaml(f"a:\n  b: [1, 2]\n  c: {written}\n", "my.yaml")
    assert str(refused.value).startswith(f"my.yaml: line 3: {written} is {read} in YAML 1.1 and ")
    if ":" in written:  # nobody who means a degree and a half is told to write 90
        assert f"such as {read}" not in str(refused.value)
    assert load_yaml(f"- '{written}'\n- \"{written}\"", "quoted") == [written, written]


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ("90", 90), ("-7", -7), ("0", 0), ("0x1F", 31), ("1.5", 1.5), (".5", 0.5), ("+3", 3),
        ("1.0e-07", 1e-7), ("true", True), ("False", False), ("~", None), ("null", None),
        ("", None), ("2026-11-23", "2026-11-23"), ("2026-02-30", "2026-02-30"), ("C", "C"),
        ("12:75", "12:75"), ("y", "y"), ("[1, 2]", [1, 2]), ("/cell/joint", "/cell/joint"),
    ],
)  # fmt: skip
def test_what_all_read_alike_is_read(written, value):
    assert load_yaml(f"name: {written}", "") == {"name": value}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "solver:\n  length_std_m: 0.42\n  gain: 1\n  length_std_m: 2.1\n",
            "line 4: length_std_m is given a second time, the first time in line 2: keep one",
        ),
        ("{a: 1, b: 2, a: 3}", "line 1: a is given a second time, the first time in line 1"),
        ('a: 1\n"a": 2', "line 2: a is given a second time, the first time in line 1"),
        ("x: &x {a: 1}\ny: {<<: *x, <<: *x}", "line 2: << is given a second time"),
    ],
)
def test_a_name_that_is_given_twice_is_refused_with_both_lines(text, words):
    with pytest.raises(ConfigurationError, match=f"^my.yaml: {words}"):
        load_yaml(text, "my.yaml")


def test_an_alias_and_a_merged_group_are_no_second_name():
    text = "x: &x {a: 1, b: 2}\ny: {<<: *x, a: 3}\nz: *x\nw: [{a: 1}, {a: 2}]"
    read = load_yaml(text, "")
    assert read["y"] == {"a": 3, "b": 2}
    assert read["z"] == {"a": 1, "b": 2}
    assert read["w"] == [{"a": 1}, {"a": 2}]


def test_every_reader_of_what_people_write_refuses_it(tmp_path):
    text = EXAMPLE.read_text()
    line = next(n for n, row in enumerate(text.splitlines(), 1) if "table_start_deg" in row)
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(
        "\n".join(
            "      table_start_deg: 1:30" if "table_start_deg" in row else row
            for row in text.splitlines()
        )
    )
    with pytest.raises(ConfigurationError, match=f"wrong.yaml: line {line}: 1:30 is 90"):
        read_configuration(wrong)
    with pytest.raises(ConfigurationError, match=f"line {line}: 1:30 is 90"):
        parse_configuration(wrong.read_text())
    with pytest.raises(ConfigurationError, match="010 is 8"):
        parse_options(["turns=010"])
    with pytest.raises(ConfigurationError, match="1:00:00 is 3600"):
        changed_limits(["reading.kept_bytes=1:00:00"])


@pytest.mark.parametrize(
    ("added", "name"),
    [
        ("solver: {length_std_m: 0.001}\n", "solver"),
        ("/cell/planner: {ros__parameters: {plan: {table_start_deg: 90.0}}}\n", "/cell/planner"),
        ("  solver: {length_std_m: 0.001}\n", "solver"),
        ("1: 2\n", "1"),
    ],
)
def test_what_stands_beside_the_parameters_is_refused_with_its_line(added, name):
    text = EXAMPLE.read_text() + added
    line = len(text.splitlines())
    with pytest.raises(ConfigurationError) as refused:
        parse_configuration(text, "my.yaml")
    assert str(refused.value).startswith(f"my.yaml: line {line}: ")
    assert f"{name}" in str(refused.value)
    assert "where it is not read" in str(refused.value)


def test_the_description_of_a_bag_is_read_as_programs_write_it():
    # yaml-cpp, by which rosbag2 writes, leaves such texts without quotes.
    text = (
        "rosbag2_bagfile_information:\n  version: 9\n  storage_identifier: mcap\n"
        "  duration: {nanoseconds: 1}\n  starting_time: {nanoseconds_since_epoch: 1}\n"
        "  message_count: 0\n  topics_with_message_count: []\n  compression_format: ''\n"
        "  compression_mode: ''\n  relative_file_paths: [a.mcap]\n  files: []\n"
        "  custom_data: {operator: no, shift: 010, shift: 011}\n"
    )
    assert parse_description(text, "metadata.yaml").storage == "mcap"


def test_texts_that_ros_would_read_as_something_else_reach_the_nodes_as_texts():
    configuration = parse_configuration(
        EXAMPLE.read_text().replace(
            "    method:", '    identity: {serial: "1e3", item: "y", operator: "007"}\n    method:'
        )
    )
    written = node_parameters(configuration)
    for text in ("1e3", "y", "007"):
        assert f"'{text}'" in written or f'"{text}"' in written
