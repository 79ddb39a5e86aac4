import math

import numpy as np
import pytest

from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.methods.tracer.plan import tracer_plan
from rotcal_ros.methods.tracer.settings import TracerPlanSettings

PAPER = TracerPlanSettings(table_start_deg=-145.0, table_step_deg=30.0, table_positions=11)


def test_the_experiment_of_the_paper_has_704_lengths() -> None:
    plan = tracer_plan(PAPER)
    assert len(plan.steps) == 704
    assert len(plan.targets) == 64
    assert plan.table_angles[0] == pytest.approx(math.radians(-145.0))
    assert plan.table_angles[-1] == pytest.approx(math.radians(155.0))
    size = np.ptp(np.array(plan.targets), axis=0)
    np.testing.assert_allclose(size, [0.45, 0.60, 0.45])


def test_both_orders_hold_the_same_pairs() -> None:
    paper_order = tracer_plan(PAPER)
    other = tracer_plan(TracerPlanSettings(**{**vars(PAPER), "order": "targets_per_station"}))
    pairs = [{(s.table_position, s.target) for s in p.steps} for p in (paper_order, other)]
    assert pairs[0] == pairs[1]
    assert [s.target for s in paper_order.steps[:11]] == [0] * 11
    assert [s.table_position for s in other.steps[:64]] == [0] * 64


def test_neighbouring_targets_are_one_grid_step_apart() -> None:
    targets = np.array(tracer_plan(PAPER).targets)
    np.testing.assert_array_less(np.linalg.norm(np.diff(targets, axis=0), axis=1), 0.2001)
    assert len(np.unique(targets, axis=0)) == 64


def test_angles_must_ascend() -> None:
    with pytest.raises(PlanError, match="ascend"):
        tracer_plan(TracerPlanSettings(table_angles_deg=(0.0, 20.0, 10.0)))


def test_a_step_outside_the_plan_is_named() -> None:
    with pytest.raises(PlanError, match=r"step 704 .* 0 to 703"):
        tracer_plan(PAPER).step(704)
