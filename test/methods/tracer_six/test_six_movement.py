"""A machine or a tracer that moves between the runs, or between the beginning of one and its end.

The moves are put on simulated lengths by plain geometry; the table scatters as well.
"""

from pathlib import Path

import numpy as np
import pytest
from chances import LONG
from six_scene import good_targets, scene

import rotcal_ros as rc
from rotcal_ros.foundation.protection import POWER
from rotcal_ros.methods import changed, prepare, read_configuration
from rotcal_ros.methods.tracer_six.solver import SixProblem, solve

M, N = 6, 16
SCATTER = (5e-8, 2.5e-7)


def measured(seed, *, closes=True, drift=None, stands=None, slips=None, scatter=SCATTER):
    """Return what is made of runs whose first angle was measured again at the end.

    ``drift``: the machine (m) moves over each run, ``stands``: and by so much from run to run;
    ``slips``: the second tracer moves on the table (m) in the middle of its run.
    """
    made = scene(np.random.default_rng(seed), good_targets()[:N], m=M, arrivals=2, scatter=scatter)
    rows = dict(made.rows)
    kept = (rows["arrival"] == 0) | ((rows["position"] == 0) & closes)
    for name in ("position", "place", "target", "length", "arrival"):
        rows[name] = rows[name][kept]
    rows.pop("segment")
    place, again = rows["place"], rows["arrival"]
    when = np.where(again, 1.0, rows["position"] / M)
    turn = rows["table_angles"][rows["position"]]
    x, y, z = rows["places"][place].T
    cos, sin = np.cos(turn), np.sin(turn)
    beam = rows["targets"][rows["target"]] - np.column_stack(
        [cos * x - sin * y, sin * x + cos * y, z]
    )
    beam /= np.linalg.norm(beam, axis=1)[:, None]
    moved = np.zeros_like(beam)
    if drift is not None:
        moved += when[:, None] * drift
    if stands is not None:
        moved += place[:, None] * np.asarray(stands)
    if slips is not None:
        a, b, c = slips
        on_table = np.column_stack([cos * a - sin * b, sin * a + cos * b, np.full(len(cos), c)])
        moved -= ((place == 1) & (when >= 0.5))[:, None] * on_table
    rows["length"] = rows["length"] + (beam * moved).sum(axis=1)
    order = (place * (M + 1) + np.where(again, M, rows["position"])) * N + rows["target"]
    return solve(SixProblem(**rows, order=order))


def found(result, effect):
    """Sizes of an effect that was found, the first three, m; None: it was not."""
    each = [e for e in result.details["effects_found"] if e["effect"] == effect]
    return np.asarray(each[0]["size"])[:3] if each else None


def allowed(result, effect):
    return next(p.treatment for p in result.protections if p.effect == effect)


@pytest.mark.slow
@pytest.mark.parametrize("scatter", [SCATTER, (2e-7, 1e-6), (0.0, 1e-6)])
def test_scatter_is_not_taken_for_a_move(scatter):
    """One alarm in a hundred and a few more, where its size and kind are estimated."""
    runs = 60 if LONG else 20
    each = [measured(100 + k, closes=bool(k % 2), scatter=scatter) for k in range(runs)]
    assert sum(result.verdict != "ok" for result in each) <= 0.05 * runs + 2


@pytest.mark.slow
def test_scatter_of_both_sides_is_not_taken_for_a_move():
    """Which makes as many positions as arrivals: all there is to say how large it is."""
    sample = Path(__file__).parents[3] / "examples" / "data" / "tracer_six.yaml"
    configuration, moved = read_configuration(sample), 0
    for seed in range(40 if LONG else 10):
        changes = ("plan.bidirectional=true", f"simulation.seed={seed}")
        table = changed(configuration, changes)
        result = prepare(table).solve(tuple(rc.simulate_observations(table)))
        moved += bool(result.details["effects_found"])
    assert moved <= 1


def test_a_machine_that_drifts_in_all_runs_alike_shows_where_a_run_comes_back():
    drift = np.array([8e-7, -4e-7, 9e-7])
    result = measured(3, drift=drift)
    assert result.verdict == "suspect"
    assert "the machine drifts in each run alike" in result.warnings[0]
    assert np.abs(found(result, "drift") - drift).max() < 4e-7
    assert measured(3, closes=False, drift=drift).verdict == "ok"


def test_a_machine_that_stands_elsewhere_in_the_next_run_is_not_taken_for_scatter():
    result = measured(4, closes=False, stands=[1e-6, 5e-7, 0.0])
    assert result.verdict == "suspect"
    assert "the machine" in result.warnings[0]
    assert found(result, "drift") is not None


def test_a_tracer_that_slips_upward_shows_where_its_run_comes_back():
    slips = [0.0, 0.0, 4e-6]
    result = measured(5, slips=slips)
    assert result.verdict == "suspect"
    assert any("the tracer slipped on the table from place 1" in text for text in result.warnings)
    size = found(result, "knock")
    assert np.abs(np.linalg.norm(size) - 4e-6) < 6e-7


def test_a_tracer_that_slips_sideways_deforms_the_triangle_and_needs_no_return():
    result = measured(6, closes=False, slips=[2e-6, 0.0, 0.0])
    assert result.verdict == "suspect"
    assert any("the tracer slipped on the table" in text for text in result.warnings)


@pytest.mark.slow
def test_what_is_said_of_drift_is_what_the_test_finds():
    """An angle that is measured again bounds what drifts and slips do; both are named."""
    again, bare = measured(6), measured(6, closes=False)
    errors = [
        {p.effect: p.error for p in result.protections if p.error is not None}
        for result in (again, bare)
    ]
    assert errors[0]["drift"] < 0.3 * errors[1]["drift"]
    assert allowed(bare, "knock") == "not protected"
    assert allowed(again, "knock") == "tested"
    # along z, with the curves' standard deviation of EZC as the unit
    noticed = [
        measured(20 + k, drift=[0.0, 0.0, 1.5e-6]).verdict != "ok"
        for k in range(12 if LONG else 6)
    ]
    assert np.mean(noticed) >= POWER - 0.15
