"""What runs and reports ask of the history."""

import numpy as np
import pytest
from simulated_park import BEGIN_NS, YEAR_NS, result

from rotcal_ros.extensions.history.adding import keep, since_last_time
from rotcal_ros.extensions.history.database import ParkHistory
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.language import speaking

CURVE = np.sin(np.arange(24.0))


def some(year, change=0.0, serial="4711"):
    deviation = CURVE + change * np.cos(np.arange(24) * 2.0 * np.pi / 24)
    return result(serial, BEGIN_NS + round(year * YEAR_NS), deviation, 0.3)


@pytest.fixture
def database(tmp_path):
    """Return a history of one result."""
    place = str(tmp_path / "history.db")
    assert keep(some(0.0), place) == "entry 1: result of 4711/C, 2021-01-01, added"
    return place


def test_a_report_says_what_has_changed_since_last_time(database):
    title, html = since_last_time(some(1.0, 3.0), database)
    assert title == "Since last time"
    assert "ECC against 2021-01-01: DISAGREE: rms 2.1" in html
    assert html.count("<svg") == 1
    assert "agree: rms" in since_last_time(some(1.0), database)[1]
    with speaking("de"):
        assert "ECC gegen 2021-01-01: " in since_last_time(some(1.0), database)[1]


@pytest.mark.parametrize("new", [some(0.0), some(-1.0), some(1.0, serial="4712")])
def test_the_first_result_of_a_table_has_nothing_before_it(database, new):
    assert since_last_time(new, database) is None


def test_a_report_is_kept_beside_its_result(database, tmp_path):
    page = tmp_path / "report.html"
    page.write_bytes(b"<html>")
    assert keep(some(0.0), database, report=page).endswith("there already")
    with ParkHistory(database) as history:
        assert [entry.kind for entry in history.entries()] == ["result", "report"]


def test_what_does_not_say_whose_it_is_is_not_kept(database):
    with pytest.raises(DataError, match="no serial number"):
        keep(some(2.0, serial=""), database)
