"""A ball plate calibration without ROS: simulated cell, capture and solver in one process."""

from pathlib import Path

from rotcal_ros.methods import changed, prepare
from rotcal_ros.methods.configuration import read_configuration

DEMO = Path(__file__).parents[2] / "config" / "ball_plate_demo.yaml"
SMALL = (
    "plan.plate.grid=12",
    "plan.plate.ball_steps=[0, 1, 3, 5, 8, 9]",
    "plan.rounds=1",
    "simulation.plate.grid=12",
    "simulation.plate.ball_steps=[0, 1, 3, 5, 8, 9]",
)


def small(*changes):
    """Return the calibration of a 6-ball plate on a 30 degree grid, 72 balls."""
    return prepare(changed(read_configuration(DEMO), (*SMALL, *changes)))


def simulated_cell(calibration):
    return calibration.method.simulated_cell(calibration.configuration.simulation)


def measure(calibration, *, steps=None, order=iter, turn_s=0.5):
    """Return the observations of all steps; ``order`` reorders the records of every turn."""
    cell = simulated_cell(calibration)
    capture = calibration.capture()
    observations = []
    for step in calibration.plan.steps[:steps]:
        command = step.command(0)
        cell.order_table(command)
        cell.order_probe(command)
        count = len(observations)
        while len(observations) == count:
            out = cell.advance(turn_s)
            for record in order([*out.temperature, *out.table, *out.probe]):
                observations += capture.feed(record)
    return tuple(observations)
