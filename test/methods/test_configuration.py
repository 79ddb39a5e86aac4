import hashlib
from pathlib import Path

import pytest

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.methods import find_method, prepare
from rotcal_ros.methods.configuration import (
    GROUPS,
    dump_configuration,
    parse_configuration,
    read_configuration,
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


def test_a_group_whose_extension_is_missing_is_refused_with_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    groups = tuple(name for name in GROUPS if name != "page")
    monkeypatch.setattr("rotcal_ros.methods.configuration.GROUPS", groups)
    text = dump_configuration("ball_plate", {"page": {"port": 8001}})
    with pytest.raises(ConfigurationError, match=r"group 'page'; .* pip install rotcal_ros"):
        parse_configuration(text)
