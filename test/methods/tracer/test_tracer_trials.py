"""Vectorised trials: each equals the solver's own answer, and together its covariance."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from tracer_scene import arc, low_ring, simulate

from rotcal_ros.methods.tracer.solver import TracerLimits, adjust, solve, trials_about
from rotcal_ros.methods.tracer.solver.circle import table_motion
from rotcal_ros.methods.tracer.solver.trials import NetworkGain, cumulative_deviations

VARIANTS = (
    {"variant": "station"},
    {"variant": "joint", "datum": "prior"},
    {"variant": "joint", "datum": "free"},
)


AS_STATED = TracerLimits(noise_significance=1e-300, rejection_significance=1e-12)
"""A trial about a measurement carries twice its variance: more than the solver would believe."""


def problem(options, **more):
    scene = simulate(3, n=24, layout=low_ring, target_std=2e-6)
    return scene.problem(target_std=2e-6, settings=AS_STATED, **options, **more)


@pytest.mark.slow
@pytest.mark.parametrize("options", VARIANTS, ids=lambda o: "-".join(o.values()))
def test_every_trial_is_what_the_solver_finds_for_the_same_numbers(options):
    task = problem(options)
    trials = trials_about(adjust(task))
    lengths, places, _ = trials.draw(np.random.default_rng(5), 4)
    found = trials(np.random.default_rng(5), 4)
    for length, targets, deviation in zip(lengths, places, found, strict=True):
        answer = solve(replace(task, length=length.ravel(), targets=targets))
        # The size of a free network is open; the angle feels where it is fixed to second order.
        exact = 1e-9 if options.get("datum") == "free" else 5e-12
        np.testing.assert_allclose(deviation, answer.deviations["ECC"], atol=exact)


@pytest.mark.slow
@pytest.mark.slow
@pytest.mark.parametrize("options", VARIANTS, ids=lambda o: "-".join(o.values()))
def test_trials_scatter_as_the_solver_states(options):
    task = problem(options, error_motion_std=1e-7)
    result = solve(task)
    count = 300 if options.get("datum") == "free" else 3000
    values = trials_about(adjust(task))(np.random.default_rng(7), count)
    within = 4.5 / np.sqrt(2 * count)
    np.testing.assert_allclose(values.std(axis=0)[1:], result.std["ECC"][1:], rtol=within)
    shift = values.mean(axis=0) - result.deviations["ECC"]
    assert np.all(np.abs(shift) <= 4.5 * result.std["ECC"] / np.sqrt(count) + 1e-15)


def test_more_stations_than_targets():
    """Then the targets, not the stations, are what is left of the network after reduction."""
    scene = simulate(3, arc(24, 14.0), n=10, layout=low_ring, target_std=2e-6)
    task = scene.problem(variant="joint", datum="prior", target_std=2e-6, settings=AS_STATED)
    trials = trials_about(adjust(task))
    assert isinstance(trials.gain, NetworkGain)
    assert not trials.gain.stations_kept
    lengths, places, _ = trials.draw(np.random.default_rng(5), 2)
    found = trials(np.random.default_rng(5), 2)
    for length, targets, deviation in zip(lengths, places, found, strict=True):
        answer = solve(replace(task, length=length.ravel(), targets=targets))
        np.testing.assert_allclose(deviation, answer.deviations["ECC"], atol=5e-12)


@pytest.mark.parametrize("options", VARIANTS[:2], ids=lambda o: "-".join(o.values()))
def test_trials_of_a_fixed_datum_settle_without_help(options, monkeypatch):
    """Solving a trial alone is the way out of a limber free network, and slow."""

    def refuse(*_):
        pytest.fail("a trial was solved alone")

    monkeypatch.setattr("rotcal_ros.methods.tracer.solver.trials.relax", refuse)
    values = trials_about(adjust(problem(options)))(np.random.default_rng(7), 200)
    assert values.shape == (200, 11)


def test_missing_lengths_and_pickling():
    task = problem({"variant": "joint"})
    keep = np.arange(len(task.length)) % 17 != 0
    rows = {name: getattr(task, name)[keep] for name in
            ("position", "target", "length", "length_std", "distance_std")}  # fmt: skip
    part = replace(task, **rows)
    trials = pickle.loads(pickle.dumps(trials_about(adjust(part))))
    lengths, places, _ = trials.draw(np.random.default_rng(1), 1)
    grid = trials.grid
    answer = solve(replace(part, length=lengths[0][part.position, part.target], targets=places[0]))
    assert not grid.used.all()
    np.testing.assert_allclose(
        trials(np.random.default_rng(1), 1)[0], answer.deviations["ECC"], atol=2e-12
    )


def test_many_sets_of_stations_at_once_turn_like_one():
    rng = np.random.default_rng(2)
    angles = np.arange(9) * 0.6
    stations = np.column_stack([np.cos(angles), np.sin(angles), 0.1 * np.cos(angles)]) * 0.07
    sets = stations + rng.normal(0.0, 1e-5, (5, 9, 3))
    for one, found in zip(sets, cumulative_deviations(sets, angles), strict=True):
        np.testing.assert_allclose(found, table_motion(one, angles).cumulative, atol=1e-14)


@pytest.mark.parametrize("options", VARIANTS[1:], ids=lambda o: "-".join(o.values()))
def test_what_has_not_settled_is_solved_alone(options, monkeypatch):
    """After a single step nothing has: the answers are those of the solver all the same."""
    trials = trials_about(adjust(problem(options)))
    lengths, places, wobble = trials.draw(np.random.default_rng(5), 3)
    settled = trials.solve(lengths, places, wobble)
    monkeypatch.setattr("rotcal_ros.methods.tracer.solver.trials.MOST_STEPS", 1)
    alone = trials.solve(lengths, places, wobble)
    exact = 1e-9 if options["datum"] == "free" else 5e-12
    np.testing.assert_allclose(alone, settled, atol=exact)


def test_draws_have_the_stated_deviations():
    """Those of lengths, coordinates, error motion in the plane, and of zeros that runs share."""
    task = problem(VARIANTS[0], error_motion_std=3e-7)
    plain = trials_about(adjust(task))
    shared = np.zeros((2, 11, 24))
    shared[0, :, 5], shared[1, 3] = 4e-7, -6e-7
    trials = replace(plain, zeros=shared, scale=2.0)
    lengths, places, wobble = trials.draw(np.random.default_rng(2), 3000)
    grid = trials.grid
    expected = np.sqrt((2.0 * grid.length_std) ** 2 + (shared**2).sum(axis=0))
    np.testing.assert_allclose((lengths - grid.length).std(axis=0), expected, rtol=0.07)
    np.testing.assert_allclose((places - grid.targets).std(axis=0), 4e-6, rtol=0.07)
    off = wobble.reshape(-1, 3)
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(off.T @ off / len(off)), 0.0))
    np.testing.assert_allclose(spread, [0.0, 3e-7, 3e-7], rtol=0.03, atol=1e-12)
    together = np.corrcoef(lengths[:, 0, 5], lengths[:, 9, 5])[0, 1]
    assert together == pytest.approx(4e-7**2 / (4e-7**2 + 4e-7**2), abs=0.06)


@pytest.mark.parametrize("count", [1, 4, 5, 9])
def test_trials_come_in_any_number_from_chunks(count, monkeypatch):
    trials = trials_about(adjust(problem(VARIANTS[0])))
    monkeypatch.setattr("rotcal_ros.methods.tracer.solver.trials.PLACES", 4 * 11 * 24)
    values = trials(np.random.default_rng(1), count)
    assert values.shape == (count, 11)
    assert len(np.unique(values[:, 5])) == count
