"""Control charts: limits from the literature, average run lengths by simulation."""

from typing import get_args

import numpy as np
import pytest
from scipy.stats import chi2

from rotcal_history.charts import (
    FALSE_ALARM,
    chart_alarms,
    chart_statistic,
    control_limit,
    self_scaled_deviates,
)
from rotcal_history.settings import Chart

CHARTS = get_args(Chart)
EWMA_STD = np.sqrt(0.2 / 1.8)


def mean_run_length(chart, shift=0.0, count=1, runs=400, longest=6000, seed=1):
    """Return the campaigns until an alarm, simulated: all runs side by side."""
    rng = np.random.default_rng(seed)
    edge, alive = control_limit(chart, count), np.ones(runs, dtype=bool)
    up, down, smooth = (np.zeros((runs, count)) for _ in range(3))
    total = 0
    for _ in range(longest):
        z = rng.standard_normal((runs, count))
        z[:, 0] += shift
        total += int(alive.sum())
        up, down = np.maximum(0.0, up + z - 0.5), np.maximum(0.0, down - z - 0.5)
        smooth = 0.2 * z + 0.8 * smooth
        value = {
            "shewhart": np.abs(z), "cusum": np.maximum(up, down), "ewma": np.abs(smooth),
            "t2": np.sum(z**2, axis=1, keepdims=True),
        }[chart]  # fmt: skip
        alive &= ~np.any(value > edge, axis=1)
        if not alive.any():
            break
    return total / runs


def test_limits_are_those_of_the_literature():
    """Montgomery, Statistical Quality Control: 3 sigma; h = 4.77; L = 2.86 at 0.2; chi-square."""
    assert control_limit("shewhart", 1) == pytest.approx(3.0, abs=1e-4)
    assert control_limit("cusum", 1) == pytest.approx(4.77, abs=0.02)
    assert control_limit("ewma", 1) / EWMA_STD == pytest.approx(2.86, abs=0.01)
    assert control_limit("t2", 5) == pytest.approx(chi2.isf(1.0 / FALSE_ALARM, 5))


@pytest.mark.parametrize("count", [1, 8])
@pytest.mark.parametrize("chart", CHARTS)
def test_a_false_alarm_comes_once_in_370_campaigns(chart, count):
    runs = 400
    found = mean_run_length(chart, count=count, runs=runs)
    spread = 4.0 / np.sqrt(runs)  # run lengths scatter as much as they are long
    assert FALSE_ALARM * (1.0 - spread) < found < FALSE_ALARM * (1.0 + spread) * 1.1


def test_a_shift_of_one_uncertainty_is_found_as_the_page_says():
    """docs/history.md; Montgomery gives 43.9, 10.4 (h = 5), 9.6 (L = 2.7), of one value."""
    found = {chart: mean_run_length(chart, 1.0, runs=2000) for chart in CHARTS}
    assert found["shewhart"] == pytest.approx(43.9, rel=0.1)
    assert found["cusum"] == pytest.approx(9.9, rel=0.1)
    assert found["ewma"] == pytest.approx(10.4, rel=0.1)
    assert found["t2"] == pytest.approx(43.9, rel=0.1)


def test_statistics_by_hand():
    z = np.array([[2.0], [np.nan], [-3.0]])
    assert chart_statistic("shewhart", z)[:, 0].tolist() == [2.0, 0.0, -3.0]
    assert chart_statistic("cusum", z)[:, 0].tolist() == [1.5, 1.0, -2.5]
    assert chart_statistic("ewma", z)[:, 0] == pytest.approx([0.4, 0.32, -0.344])
    assert chart_statistic("t2", np.array([[3.0, 4.0]]))[:, 0].tolist() == [25.0]
    assert chart_alarms("shewhart", np.array([[0.0], [-3.5], [1.0]])) == [1]


def test_own_scatter_does_not_depend_on_what_is_stated():
    stated = np.vstack([np.full((1, 2), np.nan), np.random.default_rng(2).normal(size=(40, 2))])
    one, other = self_scaled_deviates(stated), self_scaled_deviates(7.0 * stated)
    assert np.isnan(one[:2]).all()
    assert one[2:] == pytest.approx(other[2:])
    assert np.std(one[5:]) == pytest.approx(1.0, abs=0.25)
