"""The time that is predicted for the simulated cell is that of its own clock."""

from pathlib import Path

import numpy as np
import pytest

from rotcal_design.verbs.sequence import cell_seconds
from rotcal_ros.methods import changed, prepare, read_configuration
from rotcal_ros.methods.tracer.simulation import cell_time

CONFIG = Path(__file__).parents[3] / "config"
TICK = 0.02  # s, how finely the cell's time is cut; each step loses half of it


@pytest.mark.slow
@pytest.mark.parametrize(
    "drives",
    [
        [],
        ["simulation.table.speed_deg_s=150", "simulation.table.acceleration_deg_s2=600"],
        ["simulation.probe.speed_m_s=0.5", "simulation.probe.acceleration_m_s2=2.0"],
    ],
    ids=["demo", "slow table", "slow machine"],
)
def test_the_cell_takes_the_predicted_time(drives):
    rng = np.random.default_rng(1)
    pairs = [(j, i) for j in (0, 4, 2, 10) for i in rng.choice(17, 4, replace=False)]
    pairs += [(j, i) for i in (20, 40) for j in (0, 4, 2, 10)]
    calm = [f"simulation.faults.{name}_probability=0" for name in ("spike", "dropout")]
    calm += ["capture.min_used_share=0.5", "capture.step_timeout_s=60"]
    flat = np.array(pairs).ravel().tolist()
    configuration = changed(
        read_configuration(CONFIG / "tracer_paper.yaml"), [*drives, *calm, f"plan.pairs={flat}"]
    )
    calibration = prepare(configuration)
    predicted = cell_time(configuration).seconds(calibration.plan.steps)
    predicted += 0.5 * TICK * (len(pairs) - 1)
    assert cell_seconds(calibration, TICK) == pytest.approx(predicted, rel=0.03)
