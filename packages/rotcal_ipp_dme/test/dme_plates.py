"""A ball plate measured through I++ DME without ROS: server, client and capture in one process."""

import time
from pathlib import Path
from threading import Lock

from rotcal_ipp_dme.client import DmeClient
from rotcal_ipp_dme.driver import OrderRunner
from rotcal_ipp_dme.settings import DmeSettings
from rotcal_ros.methods import changed, prepare
from rotcal_ros.methods.configuration import read_configuration

DEMO = Path(__file__).parents[3] / "config" / "ball_plate_demo.yaml"
SMALL = (
    "plan.plate.grid=12",
    "plan.plate.ball_steps=[0, 1, 3, 5, 8, 9]",
    "plan.rounds=1",
    "plan.points_per_ball=6",
    "simulation.plate.grid=12",
    "simulation.plate.ball_steps=[0, 1, 3, 5, 8, 9]",
    "simulation.touch_probe.points_per_ball=6",
    "simulation.time_scale=1000.0",
    "capture.temperature_expected=false",
)
QUICK = {"settle_s": 0.004, "idle_period_s": 0.05, "reply_timeout_s": 5.0}


def small(*changes):
    """Return the calibration of a 6-ball plate on a 30 degree grid, 78 balls of 6 points."""
    return prepare(changed(read_configuration(DEMO), (*SMALL, *changes)))


def simulated_cell(calibration):
    """Return the cell that a server is given, from now on."""
    settings = calibration.configuration.simulation
    return calibration.method.simulated_cell(settings, time.time_ns())


def settings(port, **others):
    return DmeSettings(**{"port": port, "home": True, **QUICK, **others})


def measure(calibration, port, *, steps=None, **others):
    """Return the observations of all steps, measured through the server at ``port``."""
    records, lock, observations = [], Lock(), []

    def receive(feedback, _position):
        if feedback is not None:
            with lock:
                records.append(feedback)

    client = DmeClient(settings(port, **others), receive, lambda fault: None)
    client.start()
    measuring, capture = OrderRunner(client, time.time_ns), calibration.capture()
    for step in calibration.plan.steps[:steps]:
        for point in measuring.carry_out(step.command(0), step, lambda: False):
            with lock:
                records.append(point)
        client.where()
        with lock:
            came, records[:] = list(records), []
        for record in came:
            observations += capture.feed(record)
    client.close()
    return tuple(observations)
