"""The cell: reproducible whatever the cut, true to its settings."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rotcal_ros.foundation.observations import Approach, Command, LengthStatus, PointKind
from rotcal_ros.methods.simulation.settings import (
    AngularHarmonics,
    TableSettings,
    TemperatureSettings,
)
from rotcal_ros.methods.simulation.table import true_deviations
from rotcal_ros.methods.tracer.method import METHOD
from rotcal_ros.methods.tracer.settings import (
    FaultSettings,
    SimulatedProbeSettings,
    SimulatedTracerSettings,
    TracerSimulationSettings,
)

SECOND = 1_000_000_000
QUIET_PROBE = SimulatedProbeSettings(
    systematic_um=0.0, repeatability_um=0.0, following_um=0.0, settling_um=0.0, speed_m_s=2.0
)
FAULTY = TracerSimulationSettings(
    table=TableSettings(ecc=AngularHarmonics(amplitudes_arcsec=(4.0,)), repeatability_arcsec=0.5),
    tracer=SimulatedTracerSettings(rate_hz=300.0),
    probe=SimulatedProbeSettings(speed_m_s=1.0),
    temperature=TemperatureSettings(rate_hz=7.0, length_um_per_m_k=1.0),
    faults=FaultSettings(
        blocked_from_deg=20.0,
        blocked_to_deg=25.0,
        spike_probability=0.01,
        dropout_probability=0.01,
        non_finite_probability=0.01,
    ),
)


def command(step=0, angle=0.3, position=(0.1, 0.2, 0.8), **changes):
    base = Command(step, 0, angle, Approach.POSITIVE, PointKind.REFLECTOR, 0, position)
    return replace(base, **changes)


def run(cell_settings, cuts_ns, orders, start_ns=0):
    """Return repr of all samples: NaN equals NaN there, and every bit counts."""
    cell = METHOD.simulated_cell(cell_settings, start_ns)
    streams = ([], [], [], [])
    for cut in sorted({*cuts_ns, *orders}):
        out = cell.advance((cut + start_ns - cell.now_ns) * 1e-9)
        for stream, part in zip(
            streams, (out.tracer, out.table, out.probe, out.temperature), strict=True
        ):
            stream.extend(part)
        if cut in orders:
            cell.order_table(orders[cut])
            cell.order_probe(orders[cut])
    return streams


ORDERS = {
    100_000_000: command(0),
    2_000_000_000: command(1, angle=0.4),
    2_020_000_000: command(2, angle=-0.1, position=(0.3, 0.2, 0.8), target=1),
}
END = 4 * SECOND
WHOLE = run(FAULTY, [END], ORDERS)


@settings(max_examples=25, deadline=None)
@given(cuts=st.lists(st.integers(0, END), max_size=60))
def test_the_samples_do_not_depend_on_the_cut(cuts):
    assert repr(run(FAULTY, [*cuts, END], ORDERS)) == repr(WHOLE)


def test_same_seed_same_data_another_seed_other_data():
    assert repr(run(FAULTY, [END], ORDERS)) == repr(WHOLE)
    other = run(replace(FAULTY, seed=2), [END], ORDERS)
    same = [a == b for a, b in zip(WHOLE[0], other[0], strict=False)]
    assert not any(same)


def test_rates_and_stamps():
    tracer, table, _, temperature = run(TracerSimulationSettings(), [SECOND], {}, start_ns=5)
    assert [s.stamp_ns for s in tracer[:3]] == [5, 1_000_005, 2_000_005]
    assert (len(tracer), len(table), len(temperature)) == (1001, 101, 2)
    assert [s.sequence for s in tracer] == list(range(1001))


def test_noise_grows_with_the_distance():
    std = []
    for height in (1.0, 3.0):
        cell_settings = TracerSimulationSettings(
            tracer=SimulatedTracerSettings(
                noise_um=0.3, noise_um_per_m=0.2, mount_m=(0.0, 0.0, 0.0)
            ),
            probe=replace(QUIET_PROBE, initial_position_m=(0.0, 0.0, height)),
        )
        lengths = [s.length for s in run(cell_settings, [20 * SECOND], {})[0]]
        assert np.mean(lengths) == pytest.approx(height - 1.0, abs=5e-8)
        std.append(np.std(lengths))
    assert std == pytest.approx([0.5e-6, 0.9e-6], rel=0.03)


def test_reading_is_the_distance_less_the_dead_distance():
    cell_settings = TracerSimulationSettings(
        table=TableSettings(settling_arcsec=0.0),
        tracer=SimulatedTracerSettings(noise_um=0.0, noise_um_per_m=0.0, mount_m=(0.05, 0.0, 0.1)),
        probe=QUIET_PROBE,
    )
    orders = {0: command(angle=np.pi / 2, position=(0.2, 0.3, 0.9))}
    tracer, table, probe, _ = run(cell_settings, [20 * SECOND], orders)
    expected = np.sqrt(0.2**2 + 0.25**2 + 0.8**2) - 1.0
    assert tracer[-1].length == pytest.approx(expected, abs=1e-13)
    assert table[-1].angle == pytest.approx(np.pi / 2, abs=1e-6)
    assert abs(table[-1].velocity) < 1e-12
    assert probe[0].position == (0.2, 0.3, 0.9)


def test_probe_answers_the_last_order_when_it_has_arrived():
    probe = WHOLE[2]
    assert [(p.step, p.attempt, p.target) for p in probe] == [(0, 0, 0), (2, 0, 1)]
    way, speed, acceleration = 0.2, 1.0, 0.5
    duration = 2 * np.sqrt(way / acceleration)
    assert duration * acceleration / 2 < speed
    assert (probe[1].stamp_ns - 2_020_000_000) * 1e-9 == pytest.approx(duration + 0.05, abs=1e-3)


def test_a_probe_that_is_there_answers_at_once():
    orders = {0: command(0), 9 * SECOND: command(1, angle=0.5)}
    probe = run(FAULTY, [20 * SECOND], orders)[2]
    assert probe[1].stamp_ns == 9 * SECOND + 50_000_000
    assert probe[1].position == probe[0].position


def test_other_kinds_are_measured_with_the_table_at_rest():
    slow = replace(FAULTY, table=TableSettings(speed_deg_s=1.0))
    orders = {0: command(0, angle=0.2, kind=PointKind.CENTRE)}
    cell = METHOD.simulated_cell(slow)
    cell.order_probe(orders[0])
    assert cell.advance(5.0).probe == ()  # the table has not even been ordered
    cell.order_table(orders[0])
    (sample,) = cell.advance(30.0).probe
    assert sample.stamp_ns > 5 * SECOND + 0.2 / np.deg2rad(1.0) * SECOND


@pytest.mark.slow
def test_probe_errors():
    """The reflector misses the reported place: the same at each visit, and a little anew."""
    cell_settings = replace(
        FAULTY,
        tracer=SimulatedTracerSettings(rate_hz=1.0),
        probe=SimulatedProbeSettings(systematic_um=3.0, repeatability_um=0.1, speed_m_s=10.0),
    )
    cell = METHOD.simulated_cell(cell_settings)
    missed, follows = [], []
    for number in range(300):
        target = number // 3
        order = command(number, target=target, position=(0.001 * target, number % 3 * 1.0, 1.0))
        cell.order_probe(order)
        (sample,) = cell.advance(20.0).probe
        actual = cell.instrument.positions(np.array([cell.now_ns]))[0]
        missed.append((actual - sample.position) * 1e6)
        follows.append((np.array(sample.position) - order.position) * 1e6)
    missed = np.array(missed).reshape(100, 3, 3)
    assert np.std(missed.mean(axis=1)) == pytest.approx(3.0, rel=0.15)
    assert np.std(missed - missed.mean(axis=1, keepdims=True)) == pytest.approx(
        0.1 * np.sqrt(2 / 3), rel=0.15
    )
    assert np.std(follows) == pytest.approx(0.5, rel=0.15)


def test_blocked_beam_is_broken_in_the_sector_only():
    cell_settings = replace(
        FAULTY, faults=FaultSettings(blocked_from_deg=350.0, blocked_to_deg=10.0)
    )
    for angle, dark in [(0.0, True), (-0.17, True), (0.18, False), (6.3, True), (3.0, False)]:
        cell = METHOD.simulated_cell(cell_settings)
        cell.order_table(command(angle=angle))
        cell.advance(60.0)
        last = cell.advance(0.1).tracer[-1]
        assert (last.status is LengthStatus.BEAM_BROKEN) == dark, angle
        assert np.isnan(last.length) == dark


def test_blocked_targets_only():
    faults = FaultSettings(blocked_from_deg=350.0, blocked_to_deg=10.0, blocked_targets=(3, 5))
    cell = METHOD.simulated_cell(replace(FAULTY, faults=faults))
    seen = {}
    for target in range(6):
        cell.order_probe(command(target, target=target, position=(0.1 * target, 0.0, 1.0)))
        cell.advance(5.0)
        seen[target] = cell.advance(0.1).tracer[-1].status
    assert [t for t, s in seen.items() if s is LengthStatus.BEAM_BROKEN] == [3, 5]


def test_spikes_dropouts_and_bad_numbers_come_at_their_rates():
    faults = FaultSettings(
        spike_probability=0.01,
        spike_um=50.0,
        dropout_probability=0.001,
        dropout_samples=7,
        non_finite_probability=0.005,
    )
    cell_settings = TracerSimulationSettings(probe=QUIET_PROBE, faults=faults)
    tracer = run(cell_settings, [100 * SECOND], {})[0]
    lengths = np.array([s.length for s in tracer])
    bad = np.isnan(lengths)
    assert bad.mean() == pytest.approx(0.005, rel=0.2)
    spikes = np.abs(lengths[~bad] - np.median(lengths[~bad])) > 40e-6
    assert spikes.mean() == pytest.approx(0.01, rel=0.15)
    gaps = np.diff([s.sequence for s in tracer]) - 1
    assert len(gaps[gaps > 0]) == pytest.approx(100, rel=0.35)
    assert gaps[gaps > 0].min() == 7
    assert np.median(gaps[gaps > 0]) == 7


def test_temperature_and_its_effect():
    temperature = TemperatureSettings(
        mean_c=21.0,
        drift_k_per_h=36.0,
        swing_k=0.0,
        noise_k=0.0,
        length_um_per_m_k=2.0,
        dead_distance_um_per_k=5.0,
    )
    cell_settings = TracerSimulationSettings(
        tracer=SimulatedTracerSettings(noise_um=0, noise_um_per_m=0, mount_m=(0.0, 0.0, 0.0)),
        probe=replace(QUIET_PROBE, initial_position_m=(0.0, 0.0, 1.5)),
        temperature=temperature,
    )
    tracer, _, _, readings = run(cell_settings, [100 * SECOND], {}, start_ns=10**18)
    assert readings[-1].temperature_c == pytest.approx(22.0)
    assert readings[-1].sensor == "air"
    assert tracer[-1].length == pytest.approx(0.5 + 1.0 * (2e-6 * 1.5 + 5e-6), abs=1e-12)


def test_busy_while_moving_settling_and_a_little_longer():
    cell = METHOD.simulated_cell(TracerSimulationSettings(hold_s=1.0))
    cell.advance(5.0)
    assert not cell.busy
    cell.order_table(command(angle=np.deg2rad(20.0)))  # 0.5 s up, 0.5 s cruise, 0.5 s down
    assert cell.busy
    cell.advance(2.4)
    assert cell.busy
    cell.advance(0.2)
    assert not cell.busy
    cell.order_probe(command())
    assert cell.busy


def test_the_true_deviations_are_those_of_the_settings():
    angles = np.array([0.0, 0.5, 1.0])
    true = true_deviations(FAULTY.table, angles)
    arcsec = np.pi / 180 / 3600
    assert true["ECC"] == pytest.approx(4 * arcsec * (np.cos(angles) - 1))
    assert set(true) == {"EXC", "EYC", "EZC", "EAC", "EBC", "ECC"}
