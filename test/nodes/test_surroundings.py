"""What a bag's metadata say of the measurement."""

from pathlib import Path

import pytest

pytest.importorskip("rclpy")

CONFIG = Path(__file__).parents[2] / "config"


@pytest.mark.parametrize(("name", "simulated"), [("tracer", "false"), ("tracer_demo", "true")])
def test_a_bag_says_what_was_measured_and_whether_anything_was(name, simulated):
    from rotcal_ros.nodes.surroundings import subject

    found = subject((CONFIG / f"{name}.yaml").read_text())
    assert found["simulated"] == simulated
    assert "rotary table" in found["item"]
    assert subject("no configuration") == {}
