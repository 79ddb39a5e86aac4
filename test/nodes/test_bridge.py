"""The bridge over DDS: a latched table in, files out, and services that ask for confirmation."""

import json
import os
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from live_cell import DEADLINE_S

from rotcal_ros.compensation.table import CompensationTable, table_from_result
from rotcal_ros.results import Result
from rotcal_ros.units import ARCSEC, DEGREE

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

ANGLES = np.arange(24) * np.pi / 12


def table(scale=1.0, axis="C") -> CompensationTable:
    result = Result(
        method="tracer_multistation",
        angles=ANGLES,
        deviations={"ECC": scale * 10 * ARCSEC * np.sin(ANGLES)},
        std={"ECC": np.full(24, 0.1 * ARCSEC)},
        covariance={},
        sigma0=1.0,
        dof=10,
        n_observations=100,
    )
    return table_from_result(result, axis=axis)


class Bench:
    """A node that publishes tables and calls the bridge."""

    def __init__(self, cell, tmp_path):

        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor
        from rotcal_msgs.msg import CompensationTable as CompensationTableMsg

        from rotcal_ros.nodes.qos import LATCHED

        self.live = cell()
        self.controller = tmp_path / "controller"
        self.controller.mkdir()
        self.parameters = tmp_path / "bridge.yaml"
        self.context = Context()
        rclpy.init(context=self.context, domain_id=int(os.environ["ROS_DOMAIN_ID"]))
        self.node = rclpy.create_node("bench", namespace="/cell", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.tables = self.node.create_publisher(
            CompensationTableMsg, "compensation_table", LATCHED
        )
        self.status = {}
        from diagnostic_msgs.msg import DiagnosticArray

        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._hear, 10)

    def start(self, name="bridge", **settings):
        bridge = {
            "controller": "linuxcnc",
            "spacing_deg": 15.0,
            "controller_folder": str(self.controller),
            "output_folder": str(self.controller.parent / "output"),
            **settings,
        }
        text = yaml.safe_dump({"/**": {"ros__parameters": {"bridge": bridge}}})
        self.live.file.write_text(text)
        self.live.start("bridge", name=name)

    def publish(self, table, table_hash=None):
        from rotcal_ros.nodes.conversions import compensation_message

        now_ns = self.node.get_clock().now().nanoseconds
        message = compensation_message(table, "p", now_ns)
        message.table_hash = table_hash or message.table_hash
        self.tables.publish(message)

    def call(self, kind, name, request):
        client = self.node.create_client(kind, name)
        self.wait(client.service_is_ready, name)
        future = client.call_async(request)
        self.wait(future.done, f"answer of {name}")
        return future.result()

    def apply(self, table_hash):
        from rotcal_msgs.srv import ApplyTable

        return self.call(ApplyTable, "apply", ApplyTable.Request(table_hash=table_hash))

    def restore(self):
        from std_srvs.srv import Trigger

        return self.call(Trigger, "restore", Trigger.Request())

    def correction(self, angle, approach):
        from rotcal_msgs.srv import GetCorrection

        request = GetCorrection.Request(angle=angle, approach=approach)
        return self.call(GetCorrection, "get_correction", request)

    def wait_for_state(self, words):
        self.wait(lambda: words in self.status.get("message", ""), f"diagnostics say {words!r}")
        return self.status

    def wait(self, condition, what):
        deadline = time.monotonic() + DEADLINE_S
        while not condition():
            if time.monotonic() > deadline:
                pytest.fail(f"not within {DEADLINE_S} s: {what}; status {self.status}")
            self.executor.spin_once(timeout_sec=0.1)

    def files(self):
        return {p.name for p in self.controller.iterdir() if p.is_file()}

    def end(self):
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def _hear(self, array):
        for status in array.status:
            if status.name == "bridge":
                self.status = {
                    "message": status.message,
                    **{v.key: v.value for v in status.values},
                }


@pytest.fixture
def bench(cell, tmp_path):
    made = Bench(cell, tmp_path)
    yield made
    made.end()


def test_a_table_is_written_applied_on_confirmation_and_taken_back(bench):
    made = table()
    bench.publish(made)  # before the bridge is there: the topic is latched
    bench.start()
    status = bench.wait_for_state("written, not applied")
    assert status["table_hash"] == made.table_hash
    assert all(Path(path).is_file() for path in status["files"].split(", "))
    assert bench.files() == set()

    refused = bench.apply("not this one")
    assert (refused.success, bench.files()) == (False, set())
    assert "confirm this hash" in refused.message

    answer = bench.apply(made.table_hash)
    assert answer.success, answer.message
    assert answer.largest_change == pytest.approx(10 * ARCSEC, rel=1e-6)
    assert {Path(path).name for path in answer.files} == bench.files()
    rows = np.loadtxt(bench.controller / "c_linuxcnc.comp")
    np.testing.assert_allclose(rows[:-1, 1], -10 / 3600 * np.sin(rows[:-1, 0] * DEGREE), atol=2e-9)
    bench.wait_for_state("applied, read back and equal")

    assert bench.restore().success
    assert bench.files() == set()
    again = bench.restore()
    assert not again.success
    assert "no table was applied" in again.message
    stale = bench.apply(made.table_hash)
    assert not stale.success
    assert "stale" in stale.message


def test_the_correction_is_looked_up_with_its_direction(bench):
    bench.start()
    bench.wait_for_state("waiting for a table")
    assert "no table" in bench.correction(1.0, 1).message
    made = table()
    bench.publish(made)
    bench.wait_for_state("written")
    answer = bench.correction(np.pi / 2 + 2 * np.pi, 1)
    assert answer.success, answer.message
    assert answer.correction == pytest.approx(-10 * ARCSEC, rel=1e-9)
    assert answer.table_hash == made.table_hash
    assert 0 < answer.std < ARCSEC
    assert "from which side" in bench.correction(1.0, 0).message
    assert not bench.correction(1.0, 77).success


def test_what_does_not_fit_is_refused_and_told_on_diagnostics(bench):
    bench.start(max_change_arcsec=5.0)
    bench.publish(table(axis="B"))
    bench.wait_for_state("for axis B and the export for axis C")
    bench.publish(table(), table_hash="0" * 64)
    bench.wait_for_state("it was changed on its way")
    made = table()
    bench.publish(made)
    bench.wait_for_state("written")
    assert "max_change_arcsec is 5" in bench.apply(made.table_hash).message
    assert bench.files() == set()


def test_two_bridges_and_a_controller_that_is_not_there(bench):
    made = table()
    bench.publish(made)
    bench.start()
    bench.wait_for_state("written")
    assert bench.apply(made.table_hash).success
    from rotcal_ros.compensation.controller_folder import ControllerFolder
    from rotcal_ros.errors import ControllerError

    with pytest.raises(ControllerError, match="fed by process"):
        ControllerFolder(bench.controller, 20.0).lock()
    held = json.dumps(sorted(bench.files()))
    away = bench.controller.with_name("away")
    bench.controller.rename(away)
    answer = bench.apply(made.table_hash)
    assert not answer.success
    assert "does not answer" in answer.message or "cannot" in answer.message
    away.rename(bench.controller)
    assert json.dumps(sorted(bench.files())) == held
