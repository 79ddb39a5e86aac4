"""The bridge over DDS: a latched table in, files out, and services that ask for confirmation."""

import json
import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from live_cell import DEADLINE_S

from rotcal_ros.compensation.table import CompensationTable, table_from_result
from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

SECRET = "correct horse battery staple"
HOUR_AGO_NS = time.time_ns() - 3600 * 10**9
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
        measured_on="none",
    )
    made = table_from_result(result, axis=axis)
    # an hour ago, when nothing was in force yet by any journal of these tests
    return replace(made, measured_from_ns=HOUR_AGO_NS, measured_until_ns=HOUR_AGO_NS)


class Bench:
    """A node that publishes tables and calls the bridge."""

    def __init__(self, cell, tmp_path):

        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor
        from rotcal_msgs.msg import CompensationTable as CompensationTableMsg

        from rotcal_ros.nodes.runtime.qos import LATCHED

        self.live = cell()
        self.controller = tmp_path / "controller"
        self.controller.mkdir()
        self.secret_file = tmp_path / "secret"
        self.secret_file.write_text(f"{SECRET}\n")
        self.secret_file.chmod(0o600)
        self.context = Context()
        rclpy.init(context=self.context, domain_id=int(os.environ["ROS_DOMAIN_ID"]))
        self.node = rclpy.create_node("bench", namespace="/cell", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.tables = self.node.create_publisher(
            CompensationTableMsg, "compensation_table", LATCHED
        )
        self.others = {}
        from diagnostic_msgs.msg import DiagnosticArray

        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._hear, 10)

    def start(self, name="bridge", **settings):
        bridge = {
            "controller": "linuxcnc",
            "spacing_deg": 15.0,
            "controller_folder": str(self.controller),
            "output_folder": str(self.controller.parent / "output"),
            "secret_file": str(self.secret_file),
            **settings,
        }
        text = yaml.safe_dump({"/**": {"ros__parameters": {"bridge": bridge}}})
        self.live.file.write_text(text)
        self.live.start("bridge", name=name)

    def publish(self, table, table_hash=None, **changes):
        """Publish a table, with other numbers than those of its hash if they are given."""
        from rotcal_ros.nodes.runtime.conversions import compensation_message

        now_ns = self.node.get_clock().now().nanoseconds
        message = compensation_message(table, "p", now_ns)
        message.table_hash = table_hash or message.table_hash
        for name, value in changes.items():
            setattr(message, name, value)
        self.tables.publish(message)

    def call(self, kind, name, request):
        client = self.node.create_client(kind, name)
        self.wait(client.service_is_ready, name)
        future = client.call_async(request)
        self.wait(future.done, f"answer of {name}")
        return future.result()

    def apply(self, confirmation=None, secret=SECRET):
        """Apply what the diagnostics show, or what has another hash."""
        from rotcal_msgs.srv import ApplyTable

        shown = self.status["confirmation"] if confirmation is None else confirmation
        return self.call(
            ApplyTable, "apply", ApplyTable.Request(confirmation=shown, secret=secret)
        )

    def restore(self, kept_hash=None, secret=SECRET, max_change_arcsec=0.0):
        """Undo the last change, as the first refusal names it."""
        from rotcal_msgs.srv import RestoreTable

        if kept_hash is None:
            kept_hash = self.restore("").kept_hash
        request = RestoreTable.Request(
            kept_hash=kept_hash, secret=secret, max_change_arcsec=max_change_arcsec
        )
        return self.call(RestoreTable, "restore", request)

    def correction(self, angle, approach):
        from rotcal_msgs.srv import GetCorrection

        request = GetCorrection.Request(angle=angle, approach=approach)
        return self.call(GetCorrection, "get_correction", request)

    def wait_for_state(self, words):
        self.wait(lambda: words in self.status.get("message", ""), f"diagnostics say {words!r}")
        return self.status

    def wait(self, condition, what):
        deadline = time.monotonic() + load_scaled_timeout(DEADLINE_S)
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
            values = {v.key: v.value for v in status.values}
            self.others[status.name.rpartition("/")[2]] = {
                "message": status.message, "level": status.level, **values
            }  # fmt: skip

    @property
    def status(self):
        """What the bridge said last."""
        return self.others.get("bridge", {})

    def wait_for_log(self, name, text):
        self.wait(lambda: text in self.live.log(name), f"{name} logs {text!r}")


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
    paths = [Path(path) for path in status["files"].split(", ")]
    assert all(path.is_file() for path in paths)
    assert {path.parent.name for path in paths} == {f"c-{status['confirmation']}"}
    assert bench.files() == set()

    for wrong in ("not this one", made.table_hash):
        refused = bench.apply(wrong)
        assert (refused.success, bench.files()) == (False, set())
        assert "confirm this hash" in refused.message
        assert refused.confirmation == status["confirmation"]

    answer = bench.apply(status["confirmation"])
    assert answer.success, answer.message
    assert answer.largest_change == pytest.approx(10 * ARCSEC, rel=1e-6)
    assert {Path(path).name for path in answer.files} == bench.files()
    assert {p.name: p.read_bytes() for p in paths} == {
        p.name: p.read_bytes() for p in map(Path, answer.files)
    }
    rows = np.loadtxt(bench.controller / "c_linuxcnc.comp")
    np.testing.assert_allclose(rows[:-1, 1], -10 / 3600 * np.sin(rows[:-1, 0] * DEGREE), atol=2e-9)
    bench.wait_for_state("applied and verified by reading it back")

    named = bench.restore("")
    assert (named.success, len(named.kept_hash)) == (False, 64)
    assert named.kept_hash in named.message
    assert bench.restore(named.kept_hash).success
    assert bench.files() == set()
    again = bench.restore("")
    assert not again.success
    assert "no table was applied" in again.message
    stale = bench.apply(status["confirmation"])
    assert not stale.success
    assert "stale" in stale.message


def test_a_foreign_node_can_neither_apply_nor_restore(bench):
    """It hears everything, publishes a table of its own, and confirms it as it should."""
    bench.start()
    bench.publish(table())
    bench.wait_for_state("written")
    assert bench.apply().success
    held = {p.name: p.read_bytes() for p in bench.controller.iterdir() if p.is_file()}
    kept = bench.restore("").kept_hash

    own = table(1.5)
    bench.publish(own)
    bench.wait(lambda: bench.status["table_hash"] == own.table_hash, "the foreign table")
    bench.wait(lambda: "confirmation" in bench.status, "its hash")
    guesses = ("", "guess", SECRET[:-1], f"{SECRET}x", str(bench.secret_file), "\x00\u20ac")
    for guess in guesses:
        for answer in (bench.apply(secret=guess), bench.restore(kept, secret=guess)):
            assert not answer.success
            assert "does not carry the secret" in answer.message
    assert {p.name: p.read_bytes() for p in bench.controller.iterdir() if p.is_file()} == held
    assert SECRET not in bench.live.log("bridge")
    assert SECRET not in "".join(map(str, bench.status.values()))
    from rcl_interfaces.srv import GetParameters

    request = GetParameters.Request(names=["bridge.secret_file"])
    values = bench.call(GetParameters, "bridge/get_parameters", request).values
    assert values[0].string_value == str(bench.secret_file)


@pytest.mark.parametrize(
    ("without", "words"),
    [
        ("secret_file", "bridge.secret_file is empty"),
        ("controller_folder", "controller_folder is"),
    ],
)
def test_without_a_secret_or_a_controller_nothing_is_offered(bench, without, words):
    bench.start(**{without: ""})
    bench.wait(lambda: words in bench.status.get("apply_withheld", ""), words)
    assert bench.node.count_services("/cell/get_correction") == 1
    assert [bench.node.count_services(f"/cell/{name}") for name in ("apply", "restore")] == [0, 0]


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
    assert "the side from which" in bench.correction(1.0, 0).message
    assert not bench.correction(1.0, 77).success


def test_what_does_not_fit_is_refused_and_told_on_diagnostics(bench):
    bench.start(max_change_arcsec=5.0)
    bench.publish(table(axis="B"))
    bench.wait_for_state("axis B was measured and this cell has axis C")
    bench.publish(table(), table_hash="0" * 64)
    bench.wait_for_state("it was changed on the way")
    bench.publish(replace(table(), open_zeros="the offset between odd and even is not measured"))
    bench.wait_for_state("joined by 'rotcal combine'")
    assert "no table has arrived" in bench.apply("0" * 64).message
    bench.publish(table())
    bench.wait_for_state("written, not applied")
    assert "max_change_arcsec is 5" in bench.apply().message
    confirmation = bench.status["confirmation"]
    bench.publish(table(), correction_forward=np.zeros(24))  # other numbers under the same hash
    bench.wait_for_state("it was changed on the way")
    assert "no table has arrived" in bench.apply(confirmation).message
    assert bench.files() == set()


def test_of_two_bridges_one_offers_to_apply(bench):
    bench.publish(table())
    bench.start()
    bench.wait_for_state("written")
    bench.wait(lambda: "apply_offered" in bench.status, "the services")
    bench.start(name="second")
    bench.wait_for_log("second", "apply and restore are not offered: the controller in")
    assert bench.node.count_services("/cell/apply") == 1
    for _ in range(3):
        answer = bench.apply()
        assert answer.success, answer.message
    assert bench.restore().success
    bench.live.processes.signal("bridge", signal.SIGTERM)
    bench.wait(lambda: "apply_offered" in bench.others.get("second", {}), "the second takes over")


@pytest.mark.long  # above two bridges meet at one controller
def test_a_second_controller_in_the_same_cell_is_not_confused_with_the_first(bench):
    other = bench.controller.with_name("other")
    other.mkdir()
    bench.start()
    bench.wait(lambda: "apply_offered" in bench.status, "the services")
    bench.publish(table())
    bench.start(name="second", controller_folder=str(other))
    decided = {"apply_offered", "apply_withheld"}
    bench.wait(lambda: decided & bench.others.get("second", {}).keys(), "the second has decided")
    if "apply_offered" in bench.others["second"]:  # it had not yet heard of the first
        bench.wait(lambda: bench.node.count_services("/cell/apply") == 2, "both are known")
        bench.wait(lambda: "more than one node" in bench.apply().message, "the refusal")
        assert bench.files() == set()
        return
    assert "another node offers apply and restore here" in bench.live.log("second")
    assert bench.apply().success


def test_a_controller_that_is_gone_and_comes_back(bench):
    bench.publish(table())
    bench.start()
    bench.wait_for_state("written")
    assert bench.apply().success
    held = bench.files()
    away = bench.controller.with_name("away")
    bench.controller.rename(away)
    answer = bench.apply()
    assert not answer.success
    assert "does not answer" in answer.message or "cannot" in answer.message
    away.rename(bench.controller)
    assert bench.files() == held


def test_a_change_that_was_never_finished_is_reported_and_undone(bench):
    """The bridge was killed between the first and the last file."""
    bench.publish(table())
    bench.start()
    bench.wait_for_state("written")
    assert bench.apply().success
    bench.live.kill("bridge")
    bench.live.processes.children["bridge"].wait(load_scaled_timeout(30))
    held = {p.name: p.read_bytes() for p in bench.controller.iterdir() if p.is_file()}
    journal = bench.controller / ".rotcal" / "journal.jsonl"
    (bench.controller / "c_linuxcnc.comp").write_text("half")
    first, _ = map(json.loads, journal.read_text().splitlines())
    backup = bench.controller / ".rotcal" / "before-9"
    backup.mkdir()
    text = json.dumps({name: content.decode() for name, content in held.items()})
    (backup / "contents.json").write_text(text)
    begun = {**first, "before_hash": first["after_hash"], "after_hash": "0" * 64}
    with journal.open("a") as stream:
        stream.write(json.dumps({**begun, "backup": backup.name}) + "\n")
    bench.start(name="again")
    told = {"unfinished", "confirmation"}  # what was left behind, and the table, which comes later
    bench.wait(lambda: told <= bench.others.get("again", {}).keys(), "warning and table")
    status = bench.others["again"]
    assert status["level"] == b"\x01"
    assert "neither all old nor all new files" in status["unfinished"]
    assert first["after_hash"] in status["unfinished"]
    bench.wait_for_log("again", "was never finished")
    assert "was never finished" in bench.apply(status["confirmation"]).message
    answer = bench.restore()
    assert answer.success, answer.message
    assert "was never finished" in answer.message
    assert {p.name: p.read_bytes() for p in bench.controller.iterdir() if p.is_file()} == held
    bench.wait(lambda: bench.others["again"]["level"] == b"\x00", "all is well")


def test_nothing_is_changed_while_a_calibration_runs(bench):
    from rotcal_msgs.msg import NodeState

    beats = bench.node.create_publisher(NodeState, "heartbeat", 10)
    beat = NodeState(node="planner", state=NodeState.STATE_CALIBRATING)
    bench.node.create_timer(0.1, lambda: beats.publish(beat))
    bench.publish(table())
    bench.start()
    bench.wait(lambda: beats.get_subscription_count() > 0, "a bridge that listens")
    bench.wait_for_state("written")
    held = bench.files()
    bench.wait(lambda: "a calibration runs" in bench.apply().message, "the refusal")
    assert bench.files() == held
    beat.state = NodeState.STATE_READY
    bench.wait(lambda: bench.apply().success, "the table")
    assert bench.files() > held
