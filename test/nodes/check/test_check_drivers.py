"""What a check of a cell says of devices behind drivers that are not started yet; no graph."""

from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.methods.configuration import changed, read_configuration
from rotcal_ros.nodes.check.snapshot import driver_lines, roles_of_absent_drivers
from rotcal_ros.nodes.instrument_driver import driver as plugin_driver
from rotcal_ros.nodes.instrument_driver.instrument import Tracer, Tracker

CONFIG = Path(__file__).parents[3] / "config"
TRACER = read_configuration(CONFIG / "tracer.yaml")
PLUGIN = ("instrument.plugin=acme", "instrument.address=10.0.0.5:700")


def heard(configuration, *nodes):
    found = SimpleNamespace(configuration=configuration, nodes=frozenset(nodes), strangers=())
    found.brought = roles_of_absent_drivers(found)
    return found


def instrument(*kinds):
    """Return an instrument of these kinds that must never be connected."""
    kind = type("Fake", kinds, {})
    kind.__abstractmethods__ = frozenset()
    return kind()


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
    monkeypatch.setattr(plugin_driver, "make_instrument", lambda _: instrument(*kinds))
    cell = heard(changed(TRACER, PLUGIN))
    (line,) = driver_lines(cell)
    assert (line.state, line.found) == ("open", f"plug-in acme, 10.0.0.5:700: {words}")
    assert roles_of_absent_drivers(cell) == {key: ["instrument_driver"] for key in roles}


def test_a_plug_in_that_is_not_installed_is_missing():
    cell = heard(changed(TRACER, PLUGIN))
    (line,) = driver_lines(cell)
    assert line.state == "missing"
    assert "acme" in line.found
    assert roles_of_absent_drivers(cell) == {}


def test_without_drivers_there_is_nothing_to_say():
    assert list(driver_lines(heard(TRACER))) == []
    assert roles_of_absent_drivers(heard(TRACER)) == {}
