"""Reflector positions through I++ DME: the tracer method, with the table and probe behind TCP.

The lengths are those of the tracer of examples/own_cell, whose truth is known.
"""

import runpy
import time
from pathlib import Path
from threading import Lock

import numpy as np
import pytest
from dme_plates import settings, simulated_cell, small
from known_truth import require_truth

from rotcal_ipp_dme.client import DmeClient
from rotcal_ipp_dme.driver import OrderRunner
from rotcal_ipp_dme.server import DmeServer, serve_in_thread
from rotcal_ros.foundation.observations import LengthStatus, PointKind, TracerSample
from rotcal_ros.methods import changed, prepare
from rotcal_ros.methods.configuration import read_configuration

OWN = Path(__file__).parents[3] / "examples" / "own_cell"
CHANGES = (
    "capture.settle_time_s=0.002", "capture.window_samples=10",
    "capture.temperature_expected=false",
    "capture.position_tolerance_arcsec=20.0",
)  # fmt: skip


@pytest.fixture(scope="module")
def own():
    return runpy.run_path(str(OWN / "own_cell.py"))


class Session:
    """A client, and a capture that hears it and the tracer."""

    def __init__(self, calibration, port, own):
        self.records, self.lock, self.own = [], Lock(), own
        self.capture, self.noise, self.count = calibration.capture(), np.random.default_rng(3), 0
        self.client = DmeClient(settings(port), self.receive, lambda fault: None)
        self.client.start()
        self.measuring = OrderRunner(self.client, time.time_ns)

    def receive(self, record, _position=None):
        if record is not None:
            with self.lock:
                self.records.append(record)

    def fed(self):
        with self.lock:
            came, self.records[:] = list(self.records), []
        return [o for record in came for o in self.capture.feed(record)]

    def measured(self, step):
        """Return the observation of a step, and its point; noise may look like spikes once."""
        first, point = self.tried(step, 0)
        return (first, point) if first.accepted else self.tried(step, 1)

    def tried(self, step, attempt):
        """Return the observation of an attempt, and its point."""
        order = step.command(attempt)
        assert self.fed() == []
        self.capture.feed(order)
        (point,) = self.measuring.carry_out(order, step, lambda: False)
        self.receive(point)
        away = np.array(point.position) - self.own["tracer_at"](step.table_angle)
        length = float(np.linalg.norm(away)) - self.own["DEAD_DISTANCE_M"]
        while not (observations := self.fed()):
            self.client.where()
            self.count += 1
            noisy = length + self.noise.normal(0.0, self.own["NOISE_M"])
            self.receive(
                TracerSample(
                    time.time_ns(), self.count, noisy, self.own["NOISE_M"], LengthStatus.OK
                )
            )
        return observations[0], point


@pytest.mark.slow
def test_reflector_positions_through_tcp_find_the_truth(own):
    calibration = prepare(changed(read_configuration(OWN / "own_cell.yaml"), CHANGES))
    with serve_in_thread(DmeServer(simulated_cell(small()), "127.0.0.1", 0)) as server:
        session = Session(calibration, server.port, own)
        found = [session.measured(step) for step in calibration.plan.steps]
        session.client.close()
    assert [o.reason for o, _ in found if not o.accepted] == []
    assert {point.kind for _, point in found} == {PointKind.REFLECTOR}
    result = calibration.solve(tuple(o for o, _ in found))
    truth = np.array([own["error_rad"](angle) for angle in result.angles])
    assert np.ptp(truth) > 4e-5
    require_truth(result, {"ECC": truth - truth[0]})
