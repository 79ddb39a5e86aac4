import hashlib
from pathlib import Path

import pytest

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.methods import find_method, prepare
from rotcal_ros.methods.configuration import (
    changed,
    configuration_text,
    dump_configuration,
    node_parameters,
    parse_configuration,
    read_configuration,
    read_policy,
    read_subject,
    read_topics,
)

TEXT = dump_configuration("tracer_multistation", {"plan": {"table_positions": 5}})


def test_dump_is_parsed_again() -> None:
    configuration = parse_configuration(TEXT)
    assert configuration.method is find_method("tracer_multistation")
    assert configuration.plan.table_positions == 5
    assert configuration.given == {"plan", "plan.table_positions"}
    assert not configuration.simulated
    assert configuration.plan_id == hashlib.sha256(TEXT.encode()).hexdigest()
    assert len(prepare(configuration).plan.table_angles) == 5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected 'method: NAME' at the top"),
        ("a: [", "not valid YAML"),
        ("/**: {ros__parameters: {}}", "expected 'method: NAME' at the top"),
        ("/**: {ros__parameters: {method: 3}}", "method must be a name"),
        (
            "/**: {ros__parameters: {method: ball_plate, plam: {}}}",
            "unknown group 'plam'; did you mean 'plan'",
        ),
    ],
)
def test_refused_with_the_source_named(text: str, message: str) -> None:
    with pytest.raises(ConfigurationError, match=f"somewhere.*{message}"):
        parse_configuration(text, "somewhere")


def test_unknown_method_names_the_known_ones() -> None:
    with pytest.raises(
        ConfigurationError, match=r"unknown method 'astrology'.*tracer_multistation"
    ):
        parse_configuration(TEXT.replace("tracer_multistation", "astrology"))


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"cannot read .*nothing\.yaml"):
        read_configuration(tmp_path / "nothing.yaml")


GROUPS_AT_THE_TOP = """
method: tracer_multistation
identity: {item: table, serial: '0815'}
planner: {policy: until_goal}
topics: {tracer_length: /laser}
plan: {table_positions: 7, targets_m: [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]}
"""


def in_ros_form(text: str) -> str:
    return "/**:\n  ros__parameters:\n" + "".join(f"    {line}\n" for line in text.splitlines())


def test_groups_at_the_top_are_read_wherever_those_in_rosform_are() -> None:
    top = parse_configuration(GROUPS_AT_THE_TOP)
    ros = parse_configuration(in_ros_form(GROUPS_AT_THE_TOP))
    assert top.plan.table_positions == 7
    assert top.plan.targets_m == (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0)
    assert (top.identity.serial, top.given) == ("0815", ros.given)
    assert node_parameters(top) == node_parameters(ros)
    assert node_parameters(top).startswith("/**:\n  ros__parameters:")
    subject, simulated = read_subject(GROUPS_AT_THE_TOP + "simulation: {}\n")
    assert (subject.item, simulated) == ("table", True)
    assert read_topics(GROUPS_AT_THE_TOP).tracer_length == "/laser"
    assert read_policy(GROUPS_AT_THE_TOP) == "until_goal"
    assert changed(top, ["plan.table_positions=9"]).identity == top.identity


SHORT = {
    "tracer_multistation": (
        "table_positions: 12\ntable_step_deg: 30\nlength_std_m: 3.0e-8\n",
        {"plan.table_positions": 12, "plan.table_step_deg": 30.0, "solver.length_std_m": 3e-8},
    ),
    "tracer_six": (
        "places_m: [[0.1, 0, 0.2], [0, 0.1, 0.2], [0, 0, 0.2]]\nzero: per_station\n",
        {
            "plan.places_m": (0.1, 0.0, 0.2, 0.0, 0.1, 0.2, 0.0, 0.0, 0.2),
            "solver.zero": "per_station",
        },
    ),
    "plane_mirror": (
        "nests_m: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nrange_std_m: 1e-6\n",
        {
            "plan.nests_m": (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
            "solver.range_std_m": 1e-6,
        },
    ),
    "ball_plate": (
        "grid: 24\nball_steps: [0, 3, 4]\ncircle_radius_m: 0.2\nball_diameter_m: 0.02\n"
        "drift: linear\nplan: {cmm_positions: [0, 1], measure: surface}\n",
        {"plan.plate.grid": 24, "plan.plate.ball_steps": (0, 3, 4), "plan.measure": "surface",
         "plan.cmm_positions": (0, 1), "solver.drift": "linear", "solver.cmm_positions": ()},
    ),
}  # fmt: skip


@pytest.mark.parametrize("method", SHORT)
def test_a_short_setup_states_settings_of_plan_and_solver_beside_groups(method: str) -> None:
    lines, expected = SHORT[method]
    made = parse_configuration(f"method: {method}\nidentity: {{item: table}}\n{lines}")
    assert (made.method.name, made.identity.item, made.simulated) == (method, "table", False)
    for name, value in expected.items():
        found = made
        for part in name.split("."):
            found = getattr(found, part)
        assert found == value, name


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("plam: {table_positions: 3}", "unknown group 'plam'; did you mean 'plan'"),
        ("table_position: 3", "unknown setting 'table_position'; did you mean 'table_positions'"),
        ("joint: table", "unknown setting 'joint'; it belongs to a group: cell.joint"),
        ("table_positions: many", "plan.table_positions: expected int"),
        (
            "table_positions: 3\nplan: {table_positions: 4}",
            "table_positions is given at the top, and in a group as plan.table_positions",
        ),
        (
            "plan.table_positions: 3\nplan: {table_positions: 4}",
            "plan.table_positions is given at the top, and in a group",
        ),
        ("table_positions: 3\nplan: 4", "plan is a value, not a group"),
        ("targets_m: [[1, 2, 3], [4, 5]]", r"targets_m\[0\]: expected float"),
        ("/**: {ros__parameters: {method: tracer_six}}", "'method' stands beside '/\\*\\*'"),
    ],
)
def test_what_is_wrong_at_the_top_is_refused_with_the_name_that_was_meant(
    lines: str, message: str
) -> None:
    with pytest.raises(ConfigurationError, match=f"here: .*{message}"):
        parse_configuration(f"method: tracer_multistation\n{lines}", "here")
    with pytest.raises(ConfigurationError, match=r"plan.cmm_positions or solver.cmm_positions"):
        parse_configuration("method: ball_plate\ncmm_positions: [1]")


@pytest.mark.parametrize("where", ["targets_file: t.csv", "plan: {targets_file: t.csv}"])
def test_a_file_that_is_named_at_the_top_is_read_into_the_text(tmp_path: Path, where: str) -> None:
    (tmp_path / "t.csv").write_text("target,x_m,y_m,z_m\n0,1,2,3\n1,4,5,6\n")
    (tmp_path / "c.yaml").write_text(f"method: tracer_multistation\n{where} # far\n")
    text = configuration_text(tmp_path / "c.yaml")
    assert parse_configuration(text).plan.targets_m == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    assert text.endswith(" # far\n")


@pytest.mark.parametrize(
    ("change", "item"),
    [
        ("4711", "4711"),
        ("007", "007"),
        ("2026-11-25", "2026-11-25"),
        ("'007'", "007"),
        ('"no. 7"', "no. 7"),
        ("no", "no"),
        ("a: b # c", "a: b # c"),
        ("[1]", "[1]"),
        ("'", "'"),
        ("", ""),
    ],
)
def test_a_text_is_set_as_it_stands_behind_the_equals_sign(change: str, item: str) -> None:
    assert changed(parse_configuration(TEXT), [f"identity.item={change}"]).identity.item == item


def test_a_change_of_anything_but_one_text_is_yaml() -> None:
    changes = ["plan.table_positions=9", "plan.box_points=[2, 3, 4]", "bridge.accept=[age]"]
    made = changed(parse_configuration(TEXT), changes)
    assert made.plan.table_positions == 9
    assert (made.plan.box_points, made.bridge.accept) == ((2, 3, 4), ("age",))
