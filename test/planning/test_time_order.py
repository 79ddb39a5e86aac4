"""Observations in the order of time, and what the tests of drift and jumps then see."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from rotcal_ros.methods import changed, prepare, read_configuration
from rotcal_ros.methods.tracer.method import problem
from rotcal_ros.planning.readings import time_ranks

PAPER = Path(__file__).parents[2] / "config" / "tracer_paper.yaml"


def stamped(step, run, moment):
    return replace(step.observed((0.0,)), run=run, window_end_ns=moment)


def test_runs_come_first_then_the_clock_then_the_plan():
    steps = prepare(read_configuration(PAPER)).plan.steps
    # a clock that begins anew with the second run, and two rows without a time
    seen = [
        stamped(steps[3], 1, 5),
        stamped(steps[9], 0, 70),
        stamped(steps[2], 0, 80),
        stamped(steps[8], 1, 0),
        stamped(steps[7], 1, 0),
    ]
    assert time_ranks(seen).tolist() == [4, 0, 1, 3, 2]
    assert time_ranks([]).tolist() == []


def test_a_slip_between_two_sweeps_is_seen_in_the_order_of_measuring():
    changes = ["plan.box_points=[4, 2, 2]", "solver.zero=per_segment", "solver.length_std_m=1e-7"]
    cell = prepare(changed(read_configuration(PAPER), changes))
    plan = cell.plan
    second = np.array([(step.table_position + step.target) % 2 == 1 for step in plan.steps])
    clock = np.lexsort((np.arange(len(second)), second)).argsort()
    slipped = [
        replace(o, window_end_ns=int(at), mean=(o.mean[0] + 2 * 0.3164e-6 * late,))
        for o, at, late in zip(cell.measured({}, seed=5).observations, clock, second, strict=True)
    ]
    np.testing.assert_array_equal(problem(cell.configuration, plan, slipped).order, clock)
    result = cell.solve(slipped)
    # half of them later: a drift of all lengths, or a tracer that moved, explains it as well
    (found,) = result.details["effects_found"]
    assert (result.verdict, found["effect"] in ("slip", "drift", "knock")) == ("suspect", True)
    assert np.abs(found["size"]).max() > 2 * 0.3164e-6 - 4.0 * found["std"].max()
