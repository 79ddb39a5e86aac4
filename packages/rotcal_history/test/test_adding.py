"""What runs and reports ask of the history."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_park import BEGIN_NS, YEAR_NS, result

from rotcal_history.adding import keep_measurement, keep_session, since_last_time
from rotcal_history.database import ParkHistory
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.language import use_language
from rotcal_ros.foundation.session_folder import SessionFolder

CURVE = np.sin(np.arange(24.0))


def some(year, change=0.0, serial="4711"):
    deviation = CURVE + change * np.cos(np.arange(24) * 2.0 * np.pi / 24)
    return result(serial, BEGIN_NS + round(year * YEAR_NS), deviation, 0.3)


def session(folder, result):
    """Return the folder of a session with a result."""
    folder.mkdir()
    (folder / "result.json").write_text(result.to_json())
    return SessionFolder(folder)


@pytest.fixture
def database(tmp_path):
    """Return a history of one result."""
    place = str(tmp_path / "history.db")
    said = keep_session(session(tmp_path / "first", some(0.0)), place, "C")
    assert said == "entry 1: result of 4711/C, 2021-01-01, added"
    return place


def test_a_report_says_what_has_changed_since_last_time(database):
    ((title, html),) = since_last_time(some(1.0, 3.0), database)
    assert title == "Since last time"
    assert "ECC against 2021-01-01: DISAGREE: rms 2.1" in html
    assert html.count("<svg") == 1
    assert "agree: rms" in since_last_time(some(1.0), database)[0][1]
    with use_language("de"):
        assert "ECC gegen 2021-01-01: " in since_last_time(some(1.0), database)[0][1]


@pytest.mark.parametrize("new", [some(0.0), some(-1.0), some(1.0, serial="4712")])
def test_the_first_result_of_a_table_has_nothing_before_it(database, new):
    assert since_last_time(new, database) == []


def test_a_report_is_kept_beside_its_result(database, tmp_path):
    again = session(tmp_path / "again", some(0.0))
    again.report.write_bytes(b"<html>")
    assert keep_session(again, database, "C").endswith("there already")
    with ParkHistory(database) as history:
        assert [entry.kind for entry in history.entries()] == ["result", "report"]


def test_a_measurement_that_is_solved_again_counts_once(database):
    with ParkHistory(database) as history:
        for change in (0.1, 0.2, 0.2):
            keep_measurement(history, some(0.0, change), "", "bags/one")
        (valid,) = history.of_item(history.item("4711"))
        assert (valid.replaces, valid.why) == (2, "bags/one, solved again")
        fewer = replace(some(0.0, 0.3), n_observations=20)
        assert keep_measurement(history, fewer, "", "bags/half").entry == history.entry(valid.id)
        history.correct(valid.id, "wrong nests")
        with pytest.raises(DataError, match="same measurement was taken from this table"):
            keep_measurement(history, some(0.0, 0.4), "", "bags/one")
        assert history.items() == []


def test_what_does_not_say_whose_it_is_is_not_kept(database, tmp_path):
    with pytest.raises(DataError, match="no serial number"):
        keep_session(session(tmp_path / "no", some(2.0, serial="")), database, "C")
