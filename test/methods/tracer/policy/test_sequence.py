"""Time and order of a tracer's lengths: closed forms, all permutations, and another solver."""

from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.methods import changed, prepare, read_configuration
from rotcal_ros.methods.tracer import solver as tracer
from rotcal_ros.methods.tracer.method import problem
from rotcal_ros.methods.tracer.policy.sequence import (
    Forecast,
    SequenceForecast,
    improved,
    least_hidden,
    measuring_orders,
    nearest_next,
    shortest_possible,
)
from rotcal_ros.planning.sequence_time import (
    Drive,
    TimeModel,
    constant_time_model,
    sequence_duration,
)

DEMO = Path(__file__).parents[4] / "config" / "tracer_paper.yaml"
M, N = 11, 24
ANGLES = np.radians(-145.0 + 30.0 * np.arange(M))
MODEL = TimeModel(
    table=Drive(np.radians(20.0), np.radians(40.0), settle=0.5),
    machine=Drive(0.1, 0.5, settle=0.2),
    dwell=3.0,
    report=0.1,
    overshoot=np.radians(2.0),
)


@pytest.mark.parametrize("way", [1e-4, 0.019, 0.5])
def test_a_drive_takes_the_shortest_time_that_its_limits_allow(way):
    """The top speed u that gets there soonest: u / a to reach it, way / u + u / a in all."""
    drive = Drive(speed=0.1, acceleration=0.5, settle=0.2)
    found = minimize_scalar(lambda u: way / u + u / 0.5, bounds=(1e-6, 0.1), method="bounded",
                            options={"xatol": 1e-10})  # fmt: skip
    assert drive.time(np.array(way)) == pytest.approx(found.fun + 0.2, rel=1e-6)
    assert drive.time(np.array(-way)) == drive.time(np.array(way))
    assert drive.time(np.array(0.0)) == 0.0


def test_a_table_that_comes_from_above_passes_its_angle():
    turns = MODEL.turns(np.radians([0.0, 30.0]))
    assert turns[0, 1] == pytest.approx(30.0 / 20.0 + 0.5 + 0.5)
    back = 32.0 / 20.0 + 0.5 + 2.0 * np.sqrt(2.0 / 40.0) + 0.5
    assert turns[1, 0] == pytest.approx(back)
    assert turns[0, 0] == 0.0


def test_both_move_at_once_or_one_after_the_other():
    angles, targets = np.radians([0.0, 30.0]), np.array([[0.0, 0.0, 1.0], [0.3, 0.0, 1.0]])
    pair = np.array([0, 1])
    move = 0.3 / 0.1 + 0.1 / 0.5 + 0.2 + 0.1
    assert MODEL.costs(angles, targets, pair, pair)[0, 1] == pytest.approx(move + 3.0)
    apart = TimeModel(**{**vars(MODEL), "together": False})
    assert apart.costs(angles, targets, pair, pair)[0, 1] == pytest.approx(2.5 + move + 3.0)


def paper_plan(per_position, seed=2):
    """Return position and target of lengths in the volume, ``per_position`` at each angle."""
    rng = np.random.default_rng(seed)
    targets = rng.uniform([-0.6, -0.5, 0.45], [0.6, 0.5, 1.02], (N, 3))
    target = np.concatenate([rng.choice(N, per_position, replace=False) for _ in range(M)])
    return np.repeat(np.arange(M), per_position), target, targets


def test_the_papers_times_are_those_of_its_order():
    """704 lengths of 5 s; all targets of a station first: ten turns of 10 s in between."""
    position, target = np.divmod(np.arange(704), 64)
    targets = np.random.default_rng(0).uniform(0.0, 0.6, (64, 3))
    costs = constant_time_model(10.0, 5.0).costs(ANGLES, targets, position, target)
    assert sequence_duration(costs, np.arange(704)) == pytest.approx(
        703 * 5.0 + 10 * 10.0, abs=0.01
    )
    by_target = np.lexsort((position, target))
    assert sequence_duration(costs, by_target) == pytest.approx(703 * 15.0, abs=0.01)


@pytest.mark.parametrize("seed", range(4))
def test_it_finds_the_shortest_of_all_permutations(seed):
    rng = np.random.default_rng(seed)
    position, target, targets = rng.integers(0, M, 8), np.arange(8), rng.uniform(0.0, 1.0, (8, 3))
    costs = MODEL.costs(ANGLES, targets, position, target)
    shortest = min(sequence_duration(costs, np.array(way)) for way in permutations(range(8)))
    found = improved(costs, nearest_next(costs), kicks=30, seed=seed)
    assert sorted(found) == list(range(8))
    assert sequence_duration(costs, found) == pytest.approx(shortest, rel=1e-12)


def test_nothing_beats_the_spanning_tree():
    costs = np.random.default_rng(5).uniform(1.0, 10.0, (7, 7))
    shortest = min(sequence_duration(costs, np.array(way)) for way in permutations(range(7)))
    assert 6.0 <= shortest_possible(costs) <= shortest


def test_a_plan_of_110_lengths_comes_near_the_bound():
    position, target, targets = paper_plan(10)
    costs = MODEL.costs(ANGLES, targets, position, target)
    found = improved(costs, nearest_next(costs), kicks=5)
    listed = sequence_duration(costs, np.arange(110))
    assert sequence_duration(costs, found) < 1.08 * shortest_possible(costs) < 0.75 * listed


@pytest.fixture(scope="module")
def competing():
    position, target, targets = paper_plan(10)
    pairs = np.column_stack([position, target]).ravel().tolist()
    configuration = changed(
        read_configuration(DEMO),
        [f"plan.targets_m={targets.ravel().tolist()}", f"plan.pairs={pairs}"],
    )
    calibration = prepare(configuration)
    noisy = calibration.measured({}, seed=1).observations
    posed = problem(configuration, calibration.plan, noisy)
    costs = constant_time_model(10.0, 5.0).costs(ANGLES, targets, position, target)
    ways = measuring_orders(position, target, costs, SequenceForecast(posed))
    return calibration, position, costs, ways


@pytest.mark.slow
def test_every_order_measures_every_length(competing):
    _, _, costs, ways = competing
    assert [way.name for way in ways] == [
        "quickest",
        "closed",
        "2 sweeps",
        "2 sweeps and one of every 3 positions",
        "2 sweeps and one of every 2 positions",
        "3 sweeps",
        "3 sweeps and one of every 3 positions",
        "3 sweeps and one of every 2 positions",
        "4 sweeps",
    ]
    for way in ways:
        assert sorted(way.order) == list(range(110))
        assert way.seconds == pytest.approx(sequence_duration(costs, way.order))
        assert way.bound <= way.seconds


def test_their_times_are_lengths_and_turns(competing):
    """109 more lengths of 5 s; turns: 10, one more to close, 10 for each sweep of all positions.

    A last sweep from position 0 comes to 3, 6 and 9, or to 2, 4, ..., 10; one from position 10 to
    9, 6, 3 and 0, or to 8, 6, ..., 0.
    """
    ways = competing[-1]
    turns = [(way.seconds - 109 * 5.0) / 10.0 for way in ways]
    expected = [10.0, 11.0, 20.0, 23.0, 25.0, 30.0, 34.0, 35.0, 40.0]
    assert turns == pytest.approx(expected, abs=0.01)


def test_a_last_sweep_of_some_positions_comes_to_no_others(competing):
    _, position, _, ways = competing
    for way in ways:
        sweeps, _, every = way.name.partition(" sweeps and one of every ")
        if not every:
            continue
        at = position[way.order]
        visits = at[np.append(True, np.diff(at) != 0)]
        last = visits[-len(range(0, 11, int(every[0]))) :]
        assert set(last) == set(range(0, 11, int(every[0])))
        assert len(set(visits[: 11 * int(sweeps) - int(sweeps) + 1])) == 11


def test_a_closed_order_ends_where_it_began(competing):
    _, position, _, ways = competing
    at = position[ways[1].order]
    assert at[0] == at[-1] == 0
    assert (np.diff(at) != 0).sum() == 11


def test_the_quickest_protected_order_is_taken(competing):
    ways = competing[-1]
    protected = [way for way in ways if way.forecast.protected]
    assert ways[0] not in protected
    assert least_hidden(ways) is protected[0]
    assert least_hidden(ways, limit=np.inf) is ways[0]
    assert least_hidden(ways, limit=1e-9).worst == min(way.forecast.worst for way in ways)


def test_the_forecast_is_what_the_result_states(competing):
    """Measured in that order, the solver says the same of drift and knock."""
    calibration, _, _, ways = competing
    observations = calibration.measured({}, seed=1).observations
    for way in ways[:3]:
        rank = np.argsort(way.order)
        posed = problem(calibration.configuration, calibration.plan, observations)
        stated = {p.effect: p for p in tracer.solve(replace(posed, order=rank)).protections}
        for effect in ("drift", "knock"):
            error = stated[effect].error
            forecast = way.forecast.to_dict()[effect]
            if forecast is None:
                assert stated[effect].treatment == "not protected"
            else:
                assert error == pytest.approx(forecast, rel=1e-2)


def test_the_same_seed_gives_the_same_orders(competing):
    _, position, costs, ways = competing
    target = np.array([step.target for step in competing[0].plan.steps])
    again = measuring_orders(position, target, costs)
    np.testing.assert_array_equal(again[0].order, ways[0].order)
    assert least_hidden(again).name == "quickest"  # nothing is asked of drift


def test_a_pair_that_comes_again_is_approached_anew():
    position, target = np.repeat(np.arange(4), 3), np.tile([0, 0, 1], 4)
    apart = np.abs(position - position[:, None]) + np.abs(target - target[:, None])
    shown = []
    ways = measuring_orders(
        position, target, 1.0 + apart, progress=lambda done, total: shown.append((done, total))
    )
    assert shown == [(number, 9) for number in range(1, 10)]
    for way in ways:
        pairs = np.column_stack([position, target])[way.order]
        assert (np.diff(pairs, axis=0) != 0).any(axis=1).all()
    with pytest.raises(PlanError, match="nothing would approach it anew"):
        measuring_orders(np.zeros(9, dtype=int), np.zeros(9, dtype=int), np.ones((9, 9)))


def test_what_nothing_bounds_is_none():
    assert Forecast(np.inf, 0.5).to_dict() == {"drift": None, "knock": 0.5}
    assert not Forecast(np.inf, 0.5).protected
