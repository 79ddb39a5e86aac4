"""The ball plate method through TCP and through orders: one physics, the same curves."""

import numpy as np
import pytest
from dme_plates import measure, simulated_cell, small
from known_truth import require_injected_truth

from rotcal_ipp_dme.server import DmeServer, serve_in_thread
from rotcal_ros.foundation.components import COMPONENTS

pytestmark = pytest.mark.slow


def by_orders(calibration):
    """Return the observations of the same cell, driven by the orders of the suite."""
    cell = calibration.method.simulated_cell(calibration.configuration.simulation)
    capture = calibration.capture()
    observations = []
    for step in calibration.plan.steps:
        cell.order_table(step.command(0))
        cell.order_probe(step.command(0))
        count = len(observations)
        while len(observations) == count:
            out = cell.advance(0.5)
            for record in (*out.temperature, *out.table, *out.probe):
                observations += capture.feed(record)
    return observations


@pytest.fixture(scope="module")
def solved():
    """Return calibration, the result through TCP and the one through orders."""
    calibration = small()
    with serve_in_thread(DmeServer(simulated_cell(calibration), "127.0.0.1", 0)) as server:
        through_tcp = measure(calibration, server.port)
    assert [o.reason for o in through_tcp if not o.accepted] == []
    assert len(through_tcp) == len(calibration.plan.steps)
    results = (calibration.solve(through_tcp), calibration.solve(by_orders(calibration)))
    return calibration, *results


def test_the_truth_lies_within_the_stated_intervals_as_often_as_they_say(solved):
    calibration, result, _ = solved
    assert result.verdict == "ok"
    assert set(result.components) == set(COMPONENTS)
    require_injected_truth(calibration, result)


def test_both_ways_give_the_same_curves_to_the_noise(solved):
    _, through_tcp, through_orders = solved
    for name in COMPONENTS:
        difference = through_tcp.deviations[name] - through_orders.deviations[name]
        both = np.hypot(through_tcp.std[name], through_orders.std[name])
        ratio = difference[both > 0] / both[both > 0]
        assert np.sqrt(np.mean(ratio**2)) < 1.8, name
        assert np.ptp(through_tcp.deviations[name]) > 5 * both.max(), name


@pytest.mark.parametrize(
    ("version", "others"), [("2.5", {}), ("1.4.3", {"turn_by": "goto_r", "table_reversed": True})]
)
def test_a_table_turned_by_goto_measures_too(version, others, monkeypatch):
    calibration = small()
    if others:  # a machine whose R counts the other way round
        monkeypatch.setattr("rotcal_ipp_dme.server.DEGREE", -np.pi / 180.0)
    with serve_in_thread(
        DmeServer(simulated_cell(calibration), "127.0.0.1", 0, version)
    ) as server:
        observations = measure(calibration, server.port, steps=4, **others)
    assert [o.reason for o in observations] == [""] * 4
