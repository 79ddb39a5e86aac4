"""Which transports the nodes get, and that the user has the last word."""

import re
from pathlib import Path

import pytest

import rotcal_ros
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.middleware import (
    ROS_DEFAULT_RANGE,
    discovery_in_words,
    explain_start_failure,
    middleware,
)

NODES = Path(rotcal_ros.__file__).parent / "nodes"


FASTDDS, FASTRTPS = "FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE"


@pytest.fixture
def unknown_ros(monkeypatch):
    monkeypatch.setattr("rotcal_ros.foundation.middleware.rclpy_version", lambda: "")


@pytest.mark.usefixtures("unknown_ros")
def test_one_machine_is_the_loopback_interface_without_shared_memory():
    for environment in ({}, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}):
        found = middleware(environment)
        assert found["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SYSTEM_DEFAULT"
        assert found[FASTDDS].endswith("nodes/fastdds_loopback.xml")
        assert found[FASTRTPS].endswith("nodes/fastrtps_loopback.xml")


@pytest.mark.parametrize(("rclpy", "variable"), [("7.1.4", FASTRTPS), ("9.1.2", FASTDDS)])
def test_a_fast_dds_that_is_known_gets_its_own_profile_alone(monkeypatch, rclpy, variable):
    monkeypatch.setattr("rotcal_ros.foundation.middleware.rclpy_version", lambda: rclpy)
    for default_range in ("LOCALHOST", ROS_DEFAULT_RANGE):
        assert {FASTDDS, FASTRTPS} & middleware({}, default_range).keys() == {variable}


@pytest.mark.usefixtures("unknown_ros")
@pytest.mark.parametrize("environment", [{"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, {}])
def test_several_machines_get_udp_everywhere(environment):
    found = middleware(environment, ROS_DEFAULT_RANGE)
    assert found["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET"
    assert found["FASTDDS_BUILTIN_TRANSPORTS"] == "UDPv4"
    assert found[FASTDDS].endswith("nodes/fastdds_network.xml")


@pytest.mark.parametrize(
    "own",
    [
        {"ROS_STATIC_PEERS": "10.0.0.7"},
        {"FASTDDS_DEFAULT_PROFILES_FILE": "own.xml"},
        {"FASTRTPS_DEFAULT_PROFILES_FILE": "own.xml"},
        {"RMW_IMPLEMENTATION": "rmw_zenoh_cpp"},
    ],
)
def test_what_the_user_has_set_stays(own):
    assert middleware(own) == {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    own["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SUBNET"
    assert middleware(own) == {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}


@pytest.mark.parametrize("kind", ["loopback", "network"])
def test_both_versions_of_fast_dds_get_the_same(kind):
    first, second = (
        re.sub("<!--.*?-->", "", (NODES / f"{name}_{kind}.xml").read_text(), flags=re.DOTALL)
        for name in ("fastdds", "fastrtps")
    )
    types = r"\s*<propertiesPolicy>.*type_propagation.*</propertiesPolicy>"  # version 2 sends none
    alike = re.sub(types, "", first, flags=re.DOTALL)
    assert alike.replace("heartbeat_period", "heartbeatPeriod") == second


def test_where_others_are_looked_for_is_told_as_the_user_would_set_it():
    loopback = {"ROS_DOMAIN_ID": "7", **middleware({})}
    text = discovery_in_words(loopback)
    assert "ROS_DOMAIN_ID=7 and ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST" in text
    assert "other machines ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET" in text
    text = discovery_in_words(middleware({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}))
    assert "ROS_DOMAIN_ID=0 and ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET" in text
    assert "other machines" not in text


def test_security_that_cannot_be_had_is_said_only_where_it_was_asked_for():
    explain_start_failure({}, "no")
    explain_start_failure({"ROS_SECURITY_ENABLE": "false"}, "no")
    with pytest.raises(ConfigurationError) as refused:
        explain_start_failure({"ROS_SECURITY_ENABLE": "true"}, "no libraries\nat line 3")
    text = str(refused.value)
    assert "(no libraries)" in text
    assert "unset ROS_SECURITY_ENABLE" in text
