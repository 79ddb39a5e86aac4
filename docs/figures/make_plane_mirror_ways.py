"""Draw docs/figures/plane_mirror_ways.svg: the demonstration, solved in every way.

The simulated cell of config/plane_mirror_demo.yaml is measured without ROS; the drawing is that of
the report.
"""

from pathlib import Path

from rotcal_ros.foundation.observations import Observation
from rotcal_ros.methods import prepare
from rotcal_ros.methods.configuration import read_configuration
from rotcal_ros.methods.plane_mirror.figures import ways
from rotcal_ros.methods.simulation.table import true_deviations

HERE = Path(__file__).parent
STEP_S = 0.1


def main() -> None:
    """Measure, solve, draw."""
    configuration = read_configuration(HERE.parents[1] / "config" / "plane_mirror_demo.yaml")
    calibration = prepare(configuration)
    cell = calibration.method.simulated_cell(configuration.simulation)
    capture = calibration.capture()
    observations: list[Observation] = []
    for step in calibration.plan.steps:
        cell.order_table(step.command(0))
        cell.order_probe(step.command(0))
        while len(observations) <= step.index:
            output = cell.advance(STEP_S)
            for record in (*output.table, *output.probe, *output.temperature):
                observations += capture.feed(record)
    result = calibration.solve(observations)
    truth = true_deviations(configuration.simulation.table, result.angles)
    drawing = ways(result, {"angles_rad": result.angles, "deviations": truth})
    (HERE / "plane_mirror_ways.svg").write_text(drawing + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
