"""What a check of a cell says of a machine behind I++ DME before its adapter is started."""

import socket
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from test_check_drivers import heard

from rotcal_ros.methods.configuration import changed, read_configuration
from rotcal_ros.nodes.check.snapshot import (
    absent_driver_line,
    driver_lines,
    roles_of_absent_drivers,
)

DME = read_configuration(Path(__file__).parents[1] / "config" / "ball_plate_dme.yaml")


@pytest.fixture
def server():
    with socket.create_server(("127.0.0.1", 0)) as listening:
        yield listening


def test_a_machine_that_listens_is_there_and_nothing_is_said_to_it(server):
    cell = heard(changed(DME, [f"dme.port={server.getsockname()[1]}"]))
    (line,) = driver_lines(cell)
    assert line.state == "good"
    connection, _ = server.accept()
    assert connection.recv(100) == b""  # hung up without a word
    roles = ("joint_states", "probe_point", "table_angle", "probe_target")
    assert roles_of_absent_drivers(cell) == {role: ["dme_adapter"] for role in roles}


def test_nobody_at_the_address_is_missing_with_what_to_do(server):
    port = server.getsockname()[1]
    server.close()
    simulated = changed(DME, [f"dme.port={port}"])
    (line,) = driver_lines(heard(simulated))
    assert line.state == "missing"
    assert line.found.startswith(f"no server answers at 127.0.0.1:{port}: Connection refused")
    assert line.todo == "start the simulated one: rotcal dme serve CONFIG"


def test_a_driver_that_is_here_is_asked_for_nothing():
    cell = heard(DME, "dme_adapter")
    (line,) = driver_lines(cell)
    assert (line.state, line.found) == (
        "note",
        "node dme_adapter is here and talks to 127.0.0.1:1294",
    )
    assert roles_of_absent_drivers(cell) == {}


def test_two_drivers_for_one_table_are_one_too_many():
    cell = heard(changed(DME, ["table_adapter.controller=/drive"]))
    line = absent_driver_line(cell, "table", "joint_states", "publishes it")
    assert (line.state, line.found) == (
        "missing", "table_adapter and dme_adapter would both do it"
    )  # fmt: skip
    line = absent_driver_line(cell, "probe", "probe_point", "publishes it")
    assert (line.state, line.found) == (
        "note", "rotcal run starts dme_adapter, which publishes it"
    )  # fmt: skip
    assert absent_driver_line(cell, "air", "temperature", "publishes it") is None


def test_a_host_that_can_have_no_address_is_missing_too():
    (line,) = driver_lines(heard(changed(DME, ["dme.host=cmm..lab"])))
    assert line.state == "missing"
    assert line.found.startswith("no server answers at cmm..lab:1294: ")
