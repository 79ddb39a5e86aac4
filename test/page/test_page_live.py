"""The operator's page with the real nodes over DDS, looked at by a program."""

from dataclasses import replace

import numpy as np
import pytest
from live_cell import SUITE, wait_until
from page_viewer import Viewer, address, english
from test_bridge import SECRET, Bench, table

from rotcal_ros.foundation.observations import place_in_words
from rotcal_ros.recordings.replay import read_recording

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytest.importorskip("starlette")
pytestmark = pytest.mark.ros

SLOW = "simulation.time_scale=4.0"


def test_a_whole_calibration_is_shown_and_a_late_viewer_sees_the_same(cell):
    live = cell()
    live.start(*SUITE, "simulated_cell", "operator_page")
    viewer = Viewer(address(live))
    assert viewer.state["cell"]["simulated"] is True
    client = live.client()
    running = viewer.wait(lambda s: s["steps"] and s["steps"]["accepted"] > 5, "steps")
    assert running["now"]["stop"] is True
    assert english(running["cell"]["method"]) == "Laser tracer, multi-station"
    assert len(running["view"]["angles_deg"]) == 5
    outcome = client.result()
    assert outcome["error_code"] == 0, outcome
    shown = viewer.wait_for("done")
    assert english(shown["now"]["headline"]) == f"Finished, measurement {outcome['verdict']}"
    shown = viewer.wait(lambda s: s["deviations"]["final"], "the final deviations")
    (ecc,) = shown["deviations"]["curves"]
    assert (ecc["name"], ecc["unit"], len(ecc["values"])) == ("ECC", "arcsec", 5)
    rejected = [(english(r["place"]), english(r["reason"])) for r in reversed(shown["rejections"])]
    recorded = [
        (place_in_words(o.table_position, o.target, o.attempt), o.reason)
        for o in read_recording(live.bag).recorded
        if not o.accepted
    ]
    # A goal does not wait for who only looks on: the first may be over before the page is found.
    assert rejected in (recorded, recorded[1:])
    assert sum("beam broken" in reason for _, reason in recorded) >= 2
    assert {n["name"] for n in shown["nodes"]} == {*SUITE, "simulated_cell"}
    assert shown["recording"]["lost"] == 0
    late = Viewer(viewer.url).wait_for("done")
    for name in ("cell", "now", "deviations", "rejections", "view", "standing"):
        assert late[name] == shown[name], name
    live.processes.end()
    viewer.wait(lambda s: s["ended"], "the end")


def test_stop_on_the_page_cancels_the_goal_with_a_valid_bag(cell):
    live = cell(SLOW)
    live.start(*SUITE, "simulated_cell", "operator_page")
    viewer = Viewer(address(live))
    status, answer = viewer.post("stop")
    assert (status, answer["success"]) == (409, False)
    assert english(answer["message"]) == "no calibration runs"
    client = live.client()
    viewer.wait(lambda s: s["steps"] and s["steps"]["accepted"] > 2, "steps")
    assert viewer.post("stop")[0] == 200
    outcome = client.result()
    assert (outcome["canceled"], outcome["error_code"]) == (True, 607)
    shown = viewer.wait_for("stopped")
    assert "Canceled at step" in shown["now"]["detail"]
    assert (live.bag / "bag_0.mcap").is_file()


def test_resume_is_refused_in_words_when_nothing_waits(cell):
    live = cell()
    live.start("planner", "operator_page")
    viewer = Viewer(address(live))
    viewer.wait_for("ready")
    status, answer = viewer.post("resume", instruction="put it there")
    assert status == 409
    assert "nothing is waiting to be resumed" in english(answer["message"])


@pytest.mark.long
def test_a_calibration_outlives_its_page(cell):
    live = cell(SLOW)
    live.start(*SUITE, "simulated_cell", "operator_page")
    viewer = Viewer(address(live))
    client = live.client()
    viewer.wait(lambda s: s["steps"] and s["steps"]["accepted"] > 2, "steps")
    live.kill("operator_page")
    live.wait_for_log("planner", "node operator_page is lost")
    outcome = client.result()
    assert outcome["error_code"] == 0, outcome


@pytest.mark.long
def test_a_lost_node_is_shown_with_the_end_of_the_calibration(cell):
    live = cell(SLOW)
    live.start(*SUITE, "simulated_cell", "operator_page")
    viewer = Viewer(address(live))
    live.client()
    viewer.wait(lambda s: s["steps"] and s["steps"]["accepted"] > 2, "steps")
    live.kill("capture")
    shown = viewer.wait_for("failed")
    assert "Node capture is lost" in shown["now"]["detail"]
    viewer.wait(
        lambda s: {"name": "capture", "words": "silent", "level": 3} in s["nodes"], "capture lost"
    )


def test_a_port_that_is_taken_is_told(cell):
    live = cell()
    live.start("operator_page")
    port = address(live).rpartition(":")[2]
    live.file.write_text(f"/**:\n  ros__parameters:\n    page: {{port: {port}}}\n")
    live.start("operator_page", name="second")
    wait_until(lambda: "second" in live.processes.ended(), "the second page ends")
    assert live.processes.ended()["second"] == 2
    assert f"the page cannot be served on 127.0.0.1, port {port}" in live.log("second")
    assert "operator_page" not in live.processes.ended()


@pytest.fixture
def bench(cell, tmp_path):
    made = Bench(cell, tmp_path)
    yield made
    made.end()


def test_a_table_is_drawn_and_applied_on_its_hash_with_the_secret(bench):
    made = table()
    bench.publish(made)
    bench.start()
    bench.live.start("operator_page")
    viewer = Viewer(address(bench.live))
    shown = viewer.wait(lambda s: s["offer"] and s["offer"]["angles_deg"], "the drawing")["offer"]
    viewer.wait_for("confirm")
    angles = np.radians(shown["angles_deg"])
    np.testing.assert_allclose(shown["before_arcsec"], 0.0, atol=1e-3)
    np.testing.assert_allclose(shown["after_arcsec"], -10 * np.sin(angles), atol=1e-3)
    assert shown["after_reverse_arcsec"] == shown["after_arcsec"]
    # Against the reference, whose own uncertainty it carries: U = 2 sqrt(2) 0.1 arcsec.
    at_reference, opposite = shown["expanded_arcsec"][0], shown["expanded_arcsec"][12]
    assert (at_reference, opposite) == (0.0, pytest.approx(2 * 2**0.5 * 0.1, abs=1e-3))
    assert (shown["table_hash"], english(shown["verdict"])) == (made.table_hash, "ok")
    hash_ = shown["confirmation"]
    for wrong in ({"confirmation": hash_, "secret": "guess"},
                  {"confirmation": "0" * 64, "secret": SECRET}):  # fmt: skip
        assert viewer.post("apply", **wrong)[0] == 409
    assert bench.files() == set()
    status, answer = viewer.post("apply", confirmation=hash_, secret=SECRET)
    assert (status, answer["success"]) == (200, True)
    assert "verified by reading it back" in english(answer["message"])
    assert "c_linuxcnc.comp" in bench.files()
    viewer.wait(lambda s: s["offer"]["applied"] and s["now"]["kind"] != "confirm", "it is applied")
    assert SECRET not in bench.live.log("operator_page")


def test_a_simulated_table_is_called_so_and_not_to_be_confirmed_at_a_real_cell(bench):
    bench.publish(replace(table(), simulated=True))
    bench.start()
    bench.live.start("operator_page")
    viewer = Viewer(address(bench.live))
    shown = viewer.wait(lambda s: s["offer"] and s["offer"]["simulated"], "the table")
    assert "SIMULATED" in english(shown["offer"]["why_not"])
    assert shown["now"]["kind"] != "confirm"
    answer = bench.apply(bench.wait_for_state("written")["confirmation"])
    assert not answer.success
    assert "no instrument measured it" in answer.message
    assert bench.files() == set()


def test_a_table_that_the_bridge_refuses_is_shown_with_the_reason(bench):
    bench.publish(table(axis="B"))
    bench.start()
    bench.live.start("operator_page")
    shown = Viewer(address(bench.live)).wait(lambda s: s["offer"], "the table")
    assert "axis B was measured" in english(shown["offer"]["why_not"])
    assert shown["now"]["kind"] != "confirm"
