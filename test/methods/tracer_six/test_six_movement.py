"""A machine or a tracer that moves between the runs, or between the beginning of one and its end.

The moves are put on simulated lengths by plain geometry; the table scatters as well.
"""

import numpy as np
import pytest
from chances import LONG
from six_scene import good_targets, scene

from rotcal_ros.foundation.protection import POWER
from rotcal_ros.methods.tracer_six.solver import SixProblem, solve
from rotcal_ros.methods.tracer_six.solver.solution import adjust

M, N = 6, 16
SCATTER = (5e-8, 2.5e-7)


def measured(
    seed, *, closes=True, drift=None, stands=None, slips=None, scatter=SCATTER, solved=solve
):
    """Return what ``solved`` makes of runs whose first angle was measured again at the end.

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
    return solved(SixProblem(**rows, order=order))


def move_of(result, kind):
    return next((test for test in result.details["moves"] if test["kind"] == kind), None)


@pytest.mark.slow
@pytest.mark.slow
def test_probabilities_are_uniform_where_nothing_moves():
    """Over scatter that is estimated: at most every thousandth cell at rest is suspect."""
    found = [measured(seed, solved=adjust).moves for seed in range(24)]
    for kind in ("between runs", "within runs", "slip"):
        p = np.sort([moves.test(kind).probability for moves in found])
        assert p[0] > 0.001
        if kind != "slip":  # the best of many moments: its bound is Bonferroni's
            distance = np.abs(p - (np.arange(24) + 0.5) / 24).max()
            assert distance < 0.32  # Kolmogorov: 0.32 at 1 %
    assert measured(1, closes=False, solved=adjust).moves.test("within runs") is None


def test_a_machine_that_drifts_in_all_runs_alike_shows_where_a_run_comes_back():
    drift = np.array([8e-7, -4e-7, 9e-7])
    result = measured(3, drift=drift)
    test = move_of(result, "within runs")
    assert result.verdict == "suspect"
    assert "angles measured again in the same run contradict" in result.warnings[0]
    # the stations come back beside where they were, against a reflector that went with the drift
    assert np.abs(np.mean(test["moved"], axis=0) + drift).max() < 2e-7
    assert move_of(result, "between runs")["p_value"] > 0.001
    assert measured(3, closes=False, drift=drift).verdict == "ok"


def test_a_machine_that_stands_elsewhere_in_the_next_run_is_not_taken_for_scatter():
    result = measured(4, closes=False, stands=[1e-6, 5e-7, 0.0])
    test = move_of(result, "between runs")
    assert result.verdict == "suspect"
    assert "the machine stands elsewhere in one run than in another" in result.warnings[0]
    expected = -np.outer([1.0, 2.0], [1e-6, 5e-7])
    assert np.abs(np.asarray(test["moved"])[:, :2] - expected).max() < 3e-7


def test_a_tracer_that_slips_upward_shows_where_its_run_comes_back():
    slips = [0.0, 0.0, 4e-6]
    result = measured(5, slips=slips)
    assert result.verdict == "suspect"
    assert any("the tracer slipped on the table" in text for text in result.warnings)
    test = move_of(result, "slip")
    assert test["place_ids"] == [1]
    assert np.abs(np.subtract(test["moved"][0], slips)).max() < 6e-7
    assert measured(5, closes=False, slips=slips).verdict == "ok"


def test_a_tracer_that_slips_sideways_deforms_the_triangle_and_needs_no_return():
    result = measured(6, closes=False, slips=[2e-6, 0.0, 0.0])
    assert result.verdict == "suspect"
    assert any("the tracer slipped on the table" in text for text in result.warnings)


@pytest.mark.slow
def test_what_is_said_of_drift_is_what_the_test_finds():
    """From the size on that the protection names, POWER of the drifts turn the verdict."""
    protections = {p.effect: p for p in measured(6).protections}
    assert "3 of 3 runs came back to an angle" in protections["drift"].why
    bare = {p.effect: p for p in measured(6, closes=False).protections}
    assert "plan.closes" in bare["drift"].why
    assert protections["drift"].error < 0.3 * bare["drift"].error
    assert bare["knock"].treatment == "not protected"
    assert protections["knock"].treatment == "tested"
    # along z, with the curves' standard deviation of EZC as the unit
    found = [
        measured(20 + k, drift=[0.0, 0.0, 1.5e-6]).verdict != "ok"
        for k in range(12 if LONG else 6)
    ]
    assert np.mean(found) >= POWER - 0.15
