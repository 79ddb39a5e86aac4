"""What to measure next time: the check of what a history expects decides as often as it says."""

import numpy as np
import pytest
from chances import share
from scipy.optimize import brentq
from simulated_park import ANGLES, BEGIN_NS, YEAR_NS, basis, measured
from simulated_park import Table as KnownTable
from test_due_dates import Mover, series_of

from rotcal_history.adding import expected
from rotcal_history.database import ParkHistory
from rotcal_history.outlook import expected_curve
from rotcal_history.trend import fit_trend
from rotcal_ros.foundation.dates import day_of
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.planning.check_rule import CheckRule

LIMIT = 8.0
YEARS = np.linspace(0.0, 5.0, 8)
LATER = 6.0


def standard_uncertainty(rule, std):
    """Return the standard uncertainty of a check that just reaches its assurance; 0: none does."""
    n = np.ones(len(ANGLES))

    def surplus(u):
        return rule.assurance(u * n, std) - 1.0 + rule.false_alarm

    return brentq(surplus, 1e-9, rule.limit) if surplus(1e-9) > 0.0 else 0.0


def checked(count, seed):
    """Return for how many of the tables that can be checked the check says that they are valid.

    First as they are, then beyond the limit by a hair, and how many there are.
    """
    rng = np.random.default_rng(seed)
    found, asked, missed = 0, 0, 0
    for _ in range(count):
        table = Mover(rng, straight=False)
        curves = series_of(table, YEARS, rng)
        curve, covariance = expected_curve(
            curves, fit_trend(curves.series), round(LATER * YEAR_NS)
        )
        room = LIMIT - float(np.max(np.abs(curve)))
        rule = CheckRule(max(room, 1e-9))
        u = standard_uncertainty(rule, np.sqrt(np.diag(covariance)))
        if not u:  # to be calibrated
            continue
        truth = basis() @ table.modes(LATER)
        accepted = rule.acceptance(np.full(len(ANGLES), u))
        noise = u * rng.standard_normal(len(ANGLES))
        asked += 1
        found += np.all(np.abs(truth - curve + noise) <= accepted)
        worst = int(np.argmax(np.abs(curve)))  # beyond the tolerance by a hair, nowhere else off
        off = np.zeros(len(ANGLES))
        off[worst] = np.sign(curve[worst]) * rule.limit * 1.0001
        missed += np.all(np.abs(off + noise) <= accepted)
    return found, missed, asked


@pytest.mark.slow
def test_of_1000_tables_those_within_are_found_so_and_others_rarely():
    found, missed, asked = checked(1000, 1)
    assert asked > 400
    assert found / asked >= 0.95, (found, asked)
    assert missed / asked <= share(0.05, asked)[1], (missed, asked)


def test_few_tables_are_found_within_as_chance_allows():
    found, missed, asked = checked(30, 2)
    assert found / asked >= share(0.95, asked)[0]
    assert missed / asked <= share(0.05, asked)[1]


def rng():
    return np.random.default_rng(4)


@pytest.fixture(scope="module")
def history(tmp_path_factory):
    """Return the file of a table that drifts by 0.6 arcsec in a year, from 1 arcsec."""
    place = str(tmp_path_factory.mktemp("next") / "history.db")
    start = np.append(1.0, np.zeros(7))
    table = KnownTable("T1", start, drift=0.6 * np.eye(8)[0])
    with ParkHistory(place) as history:
        for each in measured(table, YEARS, rng()):
            history.add_result(each)
    return place


def test_what_is_expected_follows_the_drift_and_leaves_the_rest_of_the_tolerance(history):
    day = day_of(BEGIN_NS + round(LATER * YEAR_NS))
    result, room = expected(history, "T1", "", day)
    amplitude = result.deviations["ECC"] @ np.cos(ANGLES) / 12.0 / ARCSEC
    assert amplitude == pytest.approx(1.0 + 0.6 * LATER, abs=0.4)
    assert room == 8.0 * ARCSEC - np.max(np.abs(result.deviations["ECC"]))
    assert result.verdict == "suspect"  # so that nobody takes it for a measurement
    assert result.circumstances.identity.serial == "T1"
    earlier, _ = expected(history, "T1", "", day_of(BEGIN_NS + round(5.1 * YEAR_NS)))
    assert np.mean(result.std["ECC"]) > np.mean(earlier.std["ECC"])


def test_nothing_is_left_where_the_table_is_expected_beyond_its_tolerance(history):
    assert expected(history, "T1", "", "2040-01-01")[1] < 0.0


def test_of_one_result_nothing_is_expected(tmp_path):
    place = str(tmp_path / "history.db")
    with ParkHistory(place) as history:
        history.add_result(next(measured(KnownTable("T2", np.ones(8)), YEARS, rng())))
    with pytest.raises(DataError, match="T2/C has fewer than two results of ECC"):
        expected(place, "T2", "", "2026-01-01")
