"""What a bag's metadata say of the measurement."""

import json
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

CONFIG = Path(__file__).parents[3] / "config"


@pytest.mark.parametrize(("name", "simulated"), [("tracer", "false"), ("tracer_demo", "true")])
def test_a_bag_says_what_was_measured_and_whether_anything_was(name, simulated):
    from rotcal_ros.nodes.recorder.node import measured_subject

    found = measured_subject((CONFIG / f"{name}.yaml").read_text())
    assert found["simulated"] == simulated
    assert "rotary table" in found["item"]
    assert measured_subject("no configuration") == {}


class Open:
    """A recording, and the node that records it."""

    def __init__(self):
        self.health = SimpleNamespace(present=lambda: {"solver"})
        self.attached, self.tasks = [], []

    def begin(self, work, *arguments):
        self.tasks.append(work(*arguments))

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


class Turn:
    """What a coroutine waits for that goes on at the next turn."""

    def __await__(self):
        yield


def turn(tasks):
    """Let each of the coroutines go on once; return those that have not ended."""
    left = []
    for task in tasks:
        with suppress(StopIteration):
            task.send(None)
            left.append(task)
    return left


def asked_of(monkeypatch, answer):
    """Return a recording whose nodes are asked, the asking, and its coroutine."""
    from rotcal_ros.nodes.recorder import node as recorder

    async def until(condition, _timeout_s):
        while not condition():
            await Turn()

    monkeypatch.setattr(recorder, "_parameters_of", answer)
    monkeypatch.setattr(recorder, "wait_for_condition", until)
    cell = Open()
    parameters = recorder.NodeParameters(cell, cell)
    return cell, parameters, parameters.ask()


def test_a_silent_node_holds_up_nobody_and_is_named_when_the_bag_is_closed(monkeypatch):
    async def answer(_node, remote):
        while remote == "/cell/planner":
            await Turn()
        return {"speed": 2.0}

    cell, parameters, asking = asked_of(monkeypatch, answer)
    (asking,) = turn([asking])
    (silent,) = turn(cell.tasks)
    assert cell.attached == []
    parameters.attach()  # as the bag is closed
    known = {"planner": None, "recorder": {"depth": 3}, "solver": {"speed": 2.0}}
    assert cell.attached == [("parameters.json", known)]
    silent.close()
    asking.close()


def test_a_node_that_is_slow_at_first_is_asked_again(monkeypatch):
    asked = []

    async def answer(_node, remote):
        await Turn()
        asked.append(remote)
        return {"speed": 2.0} if len(asked) > 2 else None

    cell, _, asking = asked_of(monkeypatch, answer)
    (asking,) = turn([asking])
    while cell.tasks:
        cell.tasks = turn(cell.tasks)
    assert turn([asking]) == []
    assert asked == ["/cell/planner", "/cell/solver"] * 2
    known = {"planner": {"speed": 2.0}, "recorder": {"depth": 3}, "solver": {"speed": 2.0}}
    assert cell.attached == [("parameters.json", known)]
