"""A simulated table that turns on, and its tracer: ripple, lags, jitter, air, a broken beam."""

import numpy as np
import pytest

from rotcal_ros.foundation.observations import LengthStatus, Turn
from rotcal_ros.methods.simulation.settings import TableSettings
from rotcal_ros.methods.simulation.table import SimulatedTable
from rotcal_ros.methods.tracer.settings import FaultSettings, SimulatedTracerSettings
from rotcal_ros.methods.tracer.simulation import SimulatedTracer

DEG, ARCSEC, SECOND = np.pi / 180.0, np.pi / 648000.0, 10**9
TURN = Turn(-20.0 * DEG, 380.0 * DEG, 20.0 * DEG)


def turning(**settings):
    table = SimulatedTable(TableSettings(initial_angle_deg=-20.0, **settings), 1, 0)
    table.turn(0, TURN)
    return table


def test_the_ripple_is_of_the_stated_size_at_the_stated_frequency():
    even, rippling = turning(), turning(ripple_arcsec=3.0)
    stamps = 2 * SECOND + np.arange(0, 16 * SECOND, 10**7)
    off = (rippling.angles(stamps) - even.angles(stamps)) / ARCSEC
    spectrum = np.abs(np.fft.rfft(off)) * 2.0 / len(off)
    assert spectrum[3 * 16] == pytest.approx(3.0, abs=1e-6)
    assert np.delete(spectrum, 3 * 16).max() < 1e-6
    resting = np.array([0, rippling.rest_ns + SECOND])
    assert rippling.angles(resting) == pytest.approx(even.angles(resting), abs=1e-15)


def test_feedback_that_is_late_is_behind_by_lag_times_speed():
    settings = {"feedback_lag_s": 2e-3}
    in_time, late = turning().feedback(0, STAMPS), turning(**settings).feedback(0, STAMPS)
    behind = [(a.angle - b.angle) / DEG for a, b in zip(in_time, late, strict=True)]
    assert behind == pytest.approx([20.0 * 2e-3] * len(STAMPS), abs=1e-9)


STAMPS = 5 * SECOND + np.arange(0, SECOND, 10**7)


def tracer(faults=None, **settings):
    own = {"noise_um": 0.0, "noise_um_per_m": 0.0, "dead_distance_m": 0.0, **settings}
    return SimulatedTracer(SimulatedTracerSettings(**own), faults or FaultSettings(), 7)


def read(own, count, first=0, broken=None):
    stamps = np.arange(first, first + count) * 10**6
    dark = np.zeros(count) if broken is None else broken
    return own.readings(first, stamps, np.ones(count), np.zeros(count), dark)


def test_what_air_adds_is_forgotten_in_the_stated_time_however_it_is_asked_for():
    settings = {"drifting_um": 0.3, "drifting_s": 0.05}
    whole = np.array([s.length for s in read(tracer(**settings), 100_000)]) - 1.0
    assert whole.std() == pytest.approx(0.3e-6, rel=0.1)
    apart = [np.mean(whole[lag:] * whole[: len(whole) - lag]) for lag in (0, 50, 100)]
    assert np.array(apart[1:]) / apart[0] == pytest.approx(np.exp([-1.0, -2.0]), abs=0.1)
    own = tracer(**settings)
    pieces = [s.length for k in range(4) for s in read(own, 25, 25 * k)]
    assert pieces == pytest.approx(whole[:100] + 1.0, abs=1e-15)


def test_readings_are_older_than_their_stamps_by_lag_and_jitter():
    stamps = np.arange(20_000) * 10**6
    late = stamps - tracer(lag_s=1e-3, jitter_s=2e-6).read_at(0, stamps)
    assert late.mean() == pytest.approx(1e6, abs=100)
    assert late.std() == pytest.approx(2e3, rel=0.05)
    assert (tracer().read_at(0, stamps) == stamps).all()


def test_a_broken_beam_is_followed_by_a_dead_time():
    own, dark = tracer(dead_time_s=0.02), np.zeros(50)
    dark[[10, 45]] = 1.0
    status = [s.status for s in (*read(own, 50, broken=dark), *read(own, 50, 50))]
    bad = [k for k, each in enumerate(status) if each == LengthStatus.BEAM_BROKEN]
    assert bad == [*range(10, 30), *range(45, 65)]


def test_a_beam_is_blocked_as_often_as_stated_and_then_no_more():
    faults = FaultSettings(blocked_from_deg=10.0, blocked_to_deg=20.0, blocked_times=2)
    own, way = tracer(faults), np.arange(0.0, 40.0)
    blocked = [int(own.blocked(each, 0).sum()) for each in (way[:15], way[15:], way, way)]
    assert blocked == [5, 6, 11, 0]
