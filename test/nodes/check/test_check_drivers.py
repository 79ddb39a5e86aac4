"""What a check of a cell says of devices behind drivers that are not started yet; no graph."""

import socket
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.extensions.instrument_plugins import driver as plugin_driver
from rotcal_ros.extensions.instrument_plugins.instrument import Tracer, Tracker
from rotcal_ros.methods.configuration import changed, read_configuration
from rotcal_ros.nodes.check.snapshot import brought, brought_line, driver_lines

CONFIG = Path(__file__).parents[3] / "config"
DME = read_configuration(CONFIG / "ball_plate_dme.yaml")
TRACER = read_configuration(CONFIG / "tracer.yaml")
PLUGIN = ("instrument.plugin=acme", "instrument.address=10.0.0.5:700")


def heard(configuration, *nodes):
    found = SimpleNamespace(configuration=configuration, nodes=frozenset(nodes), strangers=())
    found.brought = brought(found)
    return found


def instrument(*kinds):
    """Return an instrument of these kinds that must never be connected."""
    kind = type("Fake", kinds, {})
    kind.__abstractmethods__ = frozenset()
    return kind()


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
    assert brought(cell) == {role: ["dme_adapter"] for role in roles}


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
    assert brought(cell) == {}


@pytest.mark.parametrize(
    ("kinds", "words", "roles"),
    [
        ((Tracer,), "measures lengths", {"tracer_length"}),
        ((Tracker,), "finds reflectors", {"probe_point", "probe_target"}),
        (
            (Tracer, Tracker), "measures lengths and finds reflectors",
            {"tracer_length", "probe_point", "probe_target"},
        ),
    ],
)  # fmt: skip
def test_a_plug_in_is_made_and_not_connected(monkeypatch, kinds, words, roles):
    monkeypatch.setattr(plugin_driver, "instrument_of", lambda _: instrument(*kinds))
    cell = heard(changed(TRACER, PLUGIN))
    (line,) = driver_lines(cell)
    assert (line.state, line.found) == ("open", f"plug-in acme, 10.0.0.5:700: {words}")
    assert brought(cell) == {key: ["instrument_driver"] for key in roles}


def test_a_plug_in_that_is_not_installed_is_missing():
    cell = heard(changed(TRACER, PLUGIN))
    (line,) = driver_lines(cell)
    assert line.state == "missing"
    assert "acme" in line.found
    assert brought(cell) == {}


def test_without_drivers_there_is_nothing_to_say():
    assert list(driver_lines(heard(TRACER))) == []
    assert brought(heard(TRACER)) == {}


def test_two_drivers_for_one_table_are_one_too_many():
    cell = heard(changed(DME, ["table_adapter.controller=/drive"]))
    line = brought_line(cell, "table", "joint_states", "publishes it")
    assert (line.state, line.found) == (
        "missing", "table_adapter and dme_adapter would both do it"
    )  # fmt: skip
    line = brought_line(cell, "probe", "probe_point", "publishes it")
    assert (line.state, line.found) == (
        "note", "rotcal run starts dme_adapter, which publishes it"
    )  # fmt: skip
    assert brought_line(cell, "air", "temperature", "publishes it") is None


def test_a_host_that_can_have_no_address_is_missing_too():
    (line,) = driver_lines(heard(changed(DME, ["dme.host=cmm..lab"])))
    assert line.state == "missing"
    assert line.found.startswith("no server answers at cmm..lab:1294: ")
