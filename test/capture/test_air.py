"""Pressure and humidity go with observations as the temperature does, whatever comes first."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from capture_scenes import MS, RULES, SETTINGS, make_plan, make_scene, replay

from rotcal_ros.capture import Capture
from rotcal_ros.foundation.observations import HumiditySample, PressureSample, TemperatureSample

PLAN = make_plan()
ALL = replace(SETTINGS, pressure_expected=True, humidity_expected=True)


def slow_streams(scene):
    """Return pressures (Pa) and humidities that follow the temperature of the scene."""
    pressure = [PressureSample(t.stamp_ns, "p", 1e5 + t.temperature_c) for t in scene.temperature]
    humidity = [HumiditySample(t.stamp_ns, "h", t.temperature_c / 100) for t in scene.temperature]
    return pressure, humidity


def test_all_three_are_read_at_the_same_stamp():
    scene = make_scene(PLAN, 1)
    pressure, humidity = slow_streams(scene)
    (observation,) = replay(PLAN, [*pressure, *humidity, *scene.by_stamp()], ALL)
    assert observation.temperature_c == pytest.approx(20.2)
    assert observation.pressure_pa == 1e5 + observation.temperature_c
    assert observation.humidity == observation.temperature_c / 100


def test_the_order_of_arrival_changes_nothing():
    scene = make_scene(PLAN, 3)
    pressure, humidity = slow_streams(scene)
    streams = (scene.tracer, scene.table, scene.probe, scene.temperature, pressure, humidity)
    wanted = replay(PLAN, sorted((r for s in streams for r in s), key=lambda r: r.stamp_ns), ALL)
    assert len(wanted) == 3
    assert all(o.pressure_pa and o.humidity for o in wanted)
    orders = list(permutations(range(6)))
    for order in orders[:: len(orders) // 24]:
        records = [record for k in order for record in streams[k]]
        assert replay(PLAN, records, ALL) == wanted


def test_what_is_not_expected_is_not_attached_however_early_it_comes():
    scene = make_scene(PLAN, 1)
    pressure, humidity = slow_streams(scene)
    (observation,) = replay(PLAN, [*pressure, *humidity, *scene.by_stamp()])
    assert (observation.pressure_pa, observation.humidity) == (None, None)


def test_a_silent_barometer_is_done_without_and_said():
    impatient = replace(ALL, clock_tolerance_s=0.4, humidity_expected=False)
    scene = make_scene(PLAN, 2)
    capture = Capture(PLAN, impatient, RULES)
    found = [o for record in scene.by_stamp() for o in capture.feed(record)]
    assert found
    assert all(o.accepted and o.pressure_pa is None and o.temperature_c for o in found)
    assert "no pressure came in time" in capture.remarks()[0]


def test_counts_hold_what_is_expected_or_came():
    scene = make_scene(PLAN, 1)
    capture = Capture(PLAN, ALL, RULES)
    capture.feed(PressureSample(50 * MS, "p", np.nan))
    assert capture.counts["pressure"] == {"received": 1, "non_finite": 1}
    assert capture.counts["humidity"] == {"received": 0}
    plain = Capture(PLAN, SETTINGS, RULES)
    assert "humidity" not in plain.counts
    assert isinstance(scene.temperature[0], TemperatureSample)


def test_what_is_useless_without_its_pressure_is_measured_again():
    """The correction of its length needs it: a retry may have it, the solver never would."""
    impatient = replace(ALL, clock_tolerance_s=0.4)
    scene = make_scene(PLAN, 2)
    capture = Capture(PLAN, impatient, RULES, 0, {"pressure"})
    found = [o for record in scene.by_stamp() for o in capture.feed(record)]
    assert found
    assert not any(o.accepted for o in found)
    assert all(o.reason.startswith("no pressure of the air arrived in time") for o in found)
    pressure, _ = slow_streams(scene)
    capture = Capture(PLAN, impatient, RULES, 0, {"pressure"})
    records = sorted([*scene.by_stamp(), *pressure], key=lambda r: r.stamp_ns)
    assert all(o.accepted for record in records for o in capture.feed(record))
