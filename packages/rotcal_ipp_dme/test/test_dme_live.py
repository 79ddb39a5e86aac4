"""The adapter beside the real nodes: an error, a person, a second adapter, a cancel; over TCP."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from dme_relay import ERROR, NEVER_DONE, Relay
from live_cell import SUITE, LiveCell, wait_until

from rotcal_ros.methods.configuration import changed, read_configuration

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

CONFIGURATION = Path(__file__).parents[1] / "config" / "ball_plate_dme.yaml"
CLEAR = """
import rclpy
from rclpy.node import Node
from std_srvs.srv import Trigger
rclpy.init()
node = Node("person")
client = node.create_client(Trigger, "/cell/clear_errors")
assert client.wait_for_service(30.0)
future = client.call_async(Trigger.Request())
rclpy.spin_until_future_complete(node, future, timeout_sec=30.0)
print(future.result().success, future.result().message)
"""


@pytest.fixture
def cell(tmp_path, monkeypatch):
    """Return a live cell, and the relay to its machine."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    slower = ("planner.step_timeout_s=3.0", "simulation.time_scale=100.0")
    configuration = changed(read_configuration(CONFIGURATION), slower)
    live = LiveCell(tmp_path, configuration)
    command = [sys.executable, "-m", "rotcal_ros.cli.main", "dme", "serve", str(live.file)]
    live.processes.start("server", [*command, "--port", "0"])
    wait_until(lambda: "I++ DME" in live.log("server"), "the server listens")
    relay = Relay(int(re.search(r"127\.0\.0\.1:(\d+)", live.log("server"))[1]))
    text = changed(configuration, (f"dme.port={relay.port}",)).text
    live.file.write_text(text, encoding="utf-8")
    yield live, relay
    live.processes.end()
    relay.close()


@pytest.mark.slow
def test_a_machine_that_stops_goes_on_by_a_person_and_is_aborted_by_a_cancel(cell):
    live, relay = cell
    live.start(*SUITE, "dme_adapter")
    client = live.client()
    client.wait_for_step(2)

    again = live.processes.children["dme_adapter"].args
    live.processes.start("second", ["env", "-u", "ROTCAL_SESSION", *again])  # of somebody else
    live.wait_for_log("second", "node dme_adapter already runs in /cell")
    second = live.processes.children["second"]
    wait_until(lambda: second.poll() is not None, "the second adapter ends")
    assert relay.clients == 1

    relay.answers["PtMeas"] = ERROR
    told = client.wait_for("warning", where=lambda event: "error 1006" in event["text"])
    assert told["text"].startswith("dme_adapter: PtMeas(")
    assert "a person continues with the service clear_errors" in told["text"]
    assert "ClearAllErrors" not in relay.orders
    person = subprocess.run(
        [sys.executable, "-c", CLEAR], env={**os.environ, **live.processes.environment},
        capture_output=True, text=True,
    )  # fmt: skip
    assert person.stdout.startswith("True cleared: PtMeas("), person.stderr
    measured = relay.orders.count("PtMeas")
    wait_until(lambda: relay.orders.count("PtMeas") > measured + 6, "it measures again")
    assert relay.orders.count("ClearAllErrors") == 1
    assert "AbortE" not in relay.orders

    relay.answers["GoTo"] = NEVER_DONE
    wait_until(lambda: not relay.answers, "the machine moves without an end")
    client.cancel()
    outcome = client.result()
    assert outcome["canceled"]
    wait_until(lambda: relay.orders[-1] == "AbortE", "the machine is stopped")
    live.wait_for_log("dme_adapter", "the calibration ended in the middle of a step")
