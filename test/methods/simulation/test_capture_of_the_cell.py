"""From the plan through the simulated cell and the capture to lengths that are true."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rotcal_ros.capture import Capture
from rotcal_ros.methods import find_method, prepare
from rotcal_ros.methods.configuration import read_configuration
from rotcal_ros.methods.simulation.table import true_deviations
from rotcal_ros.methods.tracer.method import METHOD
from rotcal_ros.methods.tracer.plan import tracer_plan
from rotcal_ros.methods.tracer.settings import TracerPlanSettings

pytestmark = pytest.mark.slow

CONFIG = Path(__file__).parents[3] / "config"
ATTEMPTS = 3
RULES = find_method("tracer_multistation").capture


def with_fixed_zero(settings):
    """Let the tracer read zero at the stated dead distance, whenever it was started."""
    return replace(settings, tracer=replace(settings.tracer, zero_shift_um=0.0))


def measure(plan, cell, capture):
    """Measure every step; yield (observation, true reading at the window's end, records)."""
    for step in plan.steps:
        for attempt in range(ATTEMPTS):
            command = step.command(attempt)
            cell.order_table(command)
            cell.order_probe(command)
            found, records = (), 0
            while not found:
                out = cell.advance(0.02)
                batch = (*out.table, *out.probe, *out.temperature, *out.tracer)
                records += len(batch)
                for record in batch:
                    found += capture.feed(record)
            (observation,) = found
            true = cell.instrument.distances(np.array([observation.window_end_ns]))[0]
            yield observation, true - cell.settings.tracer.dead_distance_m, records
            if observation.accepted:
                break


def load(name):
    configuration = read_configuration(CONFIG / name)
    return (
        prepare(configuration).plan,
        with_fixed_zero(configuration.simulation),
        configuration.capture,
        configuration.solver,
    )


@pytest.fixture(scope="module")
def demo():
    """The paper's experiment at the last six angles: 384 lengths."""
    plan, simulation, capture_settings, _ = load("tracer_paper.yaml")
    steps = (s for s in plan.steps if s.table_position >= 5)
    plan = replace(plan, steps=tuple(replace(s, index=k) for k, s in enumerate(steps)))
    cell, capture = METHOD.simulated_cell(simulation), Capture(plan, capture_settings, RULES)
    return plan, cell, capture, list(measure(plan, cell, capture))


def test_the_demonstration_is_the_experiment_of_the_paper():
    """64 targets in 450 x 600 x 450 mm, 11 stations from -145 deg, 704 lengths."""
    plan, simulation, _, _ = load("tracer_paper.yaml")
    assert np.ptp(plan.targets, axis=0) == pytest.approx([0.45, 0.6, 0.45])
    assert np.rad2deg(plan.table_angles) == pytest.approx(-145 + 30 * np.arange(11))
    assert (len(plan.targets), len(plan.steps)) == (64, 704)
    cell = METHOD.simulated_cell(simulation)
    assert np.hypot(*simulation.tracer.mount_m[:2]) == pytest.approx(0.0652, abs=1e-4)
    cell.order_probe(plan.steps[0].command(0))
    cell.advance(5.0)
    assert cell.instrument.distances(np.array([cell.now_ns]))[0] == pytest.approx(1.1285, abs=1e-3)
    injected = true_deviations(simulation.table, np.array(plan.table_angles))
    assert all(np.abs(v).max() > 0 for v in injected.values())


def test_all_steps_but_the_blocked_ones_are_accepted(demo):
    plan, _, _, seen = demo
    accepted = [o for o, _, _ in seen if o.accepted]
    given_up = {s.index for s in plan.steps} - {o.step for o in accepted}
    blocked = {s.index for s in plan.steps if s.target in (18, 19) and s.table_position == 8}
    assert given_up == blocked
    retried = {o.step for o, _, _ in seen if not o.accepted} - blocked
    assert 0 < len(retried) < 30
    assert all(
        "lost in the window" in o.reason for o, _, _ in seen if o.step in retried and o.reason
    )


def test_the_captured_lengths_are_true(demo):
    """The error over the stated deviation is standard normal, but for a trend of temperature."""
    _, cell, _, seen = demo
    good = [(o, true) for o, true, _ in seen if o.accepted]
    error = np.array([o.mean[0] - true for o, true in good])
    std = np.array([o.std[0] for o, _ in good])
    scatter = np.array([o.scatter[0] for o, _ in good])
    middle = np.array([(o.window_start_ns + o.window_end_ns) // 2 for o, _ in good])
    distance = np.array([true + cell.settings.tracer.dead_distance_m for _, true in good])
    error -= cell._temperature.length_change(middle, distance)
    # Student's t with 19 degrees of freedom has the variance 19 / 17
    assert np.std(error / std) == pytest.approx(np.sqrt(19 / 17), rel=0.08)
    assert np.mean(error / std) == pytest.approx(0.0, abs=4 / np.sqrt(len(good)))
    expected = cell.settings.tracer.noise_um + cell.settings.tracer.noise_um_per_m * distance
    assert np.sqrt(np.mean((scatter / (expected * 1e-6)) ** 2)) == pytest.approx(1.0, rel=0.03)


def test_little_flows_in_a_step(demo):
    *_, seen = demo
    assert np.mean([records for *_, records in seen]) < 100


def test_spikes_and_gaps_were_met(demo):
    _, _, capture, seen = demo
    counts = capture.counts["tracer"]
    assert counts["lost"] > 0
    assert counts["beam_broken"] > 0
    assert counts["non_finite"] > 0
    assert sum(o.n_used < o.n_samples for o, _, _ in seen if o.accepted) > 10


@pytest.mark.parametrize("order", ["stations_per_target", "targets_per_station"])
def test_both_orders_of_measuring_give_true_lengths(order):
    plan = tracer_plan(TracerPlanSettings(table_positions=3, box_points=(2, 2, 1), order=order))
    _, simulation, settings, _ = load("tracer_paper.yaml")
    cell = METHOD.simulated_cell(replace(simulation, seed=3))
    settings = replace(settings, window_samples=50)
    seen = list(measure(plan, cell, Capture(plan, settings, RULES)))
    assert [o.step for o, *_ in seen if o.accepted] == list(range(12))
    error = [(o.mean[0] - true) / o.std[0] for o, true, _ in seen if o.accepted]
    assert np.abs(error).max() < 4.5


def test_a_real_machine_needs_no_more_than_its_settings():
    plan, simulation, settings, solver = load("tracer_simulated.yaml")
    assert simulation.time_scale == 1.0
    assert solver.variant == "joint"
    plan = replace(plan, steps=plan.steps[:2])
    seen = list(measure(plan, METHOD.simulated_cell(simulation), Capture(plan, settings, RULES)))
    assert [o.accepted for o, *_ in seen] == [True, True]
    assert all(o.n_samples == 500 for o, *_ in seen)
