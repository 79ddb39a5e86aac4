"""What a bag's metadata say of the measurement."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

CONFIG = Path(__file__).parents[3] / "config"


@pytest.mark.parametrize(("name", "simulated"), [("tracer", "false"), ("tracer_demo", "true")])
def test_a_bag_says_what_was_measured_and_whether_anything_was(name, simulated):
    from rotcal_ros.nodes.recorder.provenance import subject

    found = subject((CONFIG / f"{name}.yaml").read_text())
    assert found["simulated"] == simulated
    assert "rotary table" in found["item"]
    assert subject("no configuration") == {}


class Open:
    """A recording, and the one node that answers."""

    def __init__(self):
        self.health = SimpleNamespace(present=lambda: {"solver"})
        self.attached = []

    def attach(self, name, _media_type, data):
        self.attached.append((name, json.loads(data)))

    def get_name(self):
        return "recorder"

    def get_namespace(self):
        return "/cell"

    def get_node_names_and_namespaces(self):
        return [("recorder", "/cell"), ("planner", "/cell"), ("stranger", "/")]

    def get_parameters_by_prefix(self, _prefix):
        return {"depth": SimpleNamespace(value=3)}


class Never:
    def __await__(self):
        yield


def test_a_bag_that_is_closed_early_says_which_nodes_had_not_answered(monkeypatch):
    from rotcal_ros.nodes.recorder import provenance as surroundings

    async def answer(_node, remote):
        if remote != "/cell/planner":
            await Never()
        return {"speed": 2.0}

    monkeypatch.setattr(surroundings, "_parameters_of", answer)
    cell = Open()
    parameters = surroundings.NodeParameters(cell, cell)
    asked = parameters.ask()
    asked.send(None)
    assert cell.attached == []
    parameters.attach()  # as the bag is closed
    known = {"planner": {"speed": 2.0}, "recorder": {"depth": 3}, "solver": None}
    assert cell.attached == [("parameters.json", known)]
    with pytest.raises(StopIteration):
        asked.send(None)
    assert len(cell.attached) == 1


def test_a_node_that_is_slow_at_first_is_asked_again(monkeypatch):
    from rotcal_ros.nodes.recorder import provenance as surroundings

    asked = []

    async def answer(_node, remote):
        asked.append(remote)
        return {"speed": 2.0} if len(asked) > 2 else None

    monkeypatch.setattr(surroundings, "_parameters_of", answer)
    cell = Open()
    with pytest.raises(StopIteration):
        surroundings.NodeParameters(cell, cell).ask().send(None)
    assert asked == ["/cell/planner", "/cell/solver"] * 2
    known = {"planner": {"speed": 2.0}, "recorder": {"depth": 3}, "solver": {"speed": 2.0}}
    assert cell.attached == [("parameters.json", known)]
