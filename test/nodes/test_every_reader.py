"""Whole bags of every method, live, in the readers of others; on Jazzy and on Kilted."""

from pathlib import Path

import pytest
from bag_readers import read_by_all
from live_cell import DEMO, SHORT, live_cells

from rotcal_ros.bags import names
from rotcal_ros.recordings.replay import read_recording

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

CONFIG = Path(__file__).parents[2] / "config"
WAIT = "planner.preflight_timeout_s=30.0"
PLANS = {
    "tracer": (DEMO, SHORT),
    "tracer_six": (
        CONFIG / "tracer_six_demo.yaml",
        ("plan.table_positions=3", "plan.table_step_deg=120.0", "plan.box_points=[2, 2, 2]"),
    ),
    "ball_plate": (
        CONFIG / "ball_plate_demo.yaml",
        (
            "plan.plate.grid=12", "plan.plate.ball_steps=[0, 1, 3, 5, 8, 9]", "plan.rounds=1",
            "simulation.plate.grid=12", "simulation.plate.ball_steps=[0, 1, 3, 5, 8, 9]",
        ),
    ),
    "two_groups": (CONFIG / "two_groups.yaml", ("plan.points_per_ball=5",)),
    "plane_mirror": (
        CONFIG / "plane_mirror_demo.yaml",
        (
            "plan.table_positions=5", "plan.positions_per_station=3", "plan.reflectors=1",
            "simulation.tracker.station_azimuths_deg=[22.5, 67.5]",
        ),
    ),
    "table_balls": (CONFIG / "table_balls_demo.yaml", ("plan.runs=1",)),
    "angle_comparison": (CONFIG / "angle_comparison_demo.yaml", ()),
}  # fmt: skip


@pytest.mark.parametrize("method", PLANS)
def test_all_readers_understand_every_message_of_a_whole_bag(method, tmp_path, monkeypatch):
    demo, short = PLANS[method]
    cells = live_cells(tmp_path, monkeypatch, demo, (*short, WAIT))
    live = next(cells)()
    outcome, _ = live.calibrate_with_a_person()
    next(cells, None)
    assert outcome["error_code"] == 0, outcome["error_msg"]
    read_by_all(live.bag, tmp_path / "converted")
    (verdict,) = read_recording(live.bag).verdicts
    for topic in (names.PLAN, names.GOAL, names.PROGRESS, names.GOAL_STATUS, "deviations"):
        assert verdict.topics[f"/cell/{topic}"].messages > 0, topic
    assert "_FeedbackMessage" not in {t.type_name for t in verdict.topics.values()}
