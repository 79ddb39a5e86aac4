"""What a finished calibration leaves beside its bag, and what it says when it leaves it out."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from two_groups import GRID, plate_problem

from rotcal_ros.foundation.circumstances import Circumstances
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.session_folder import SessionFolder
from rotcal_ros.methods.ball_plate.solver import solve
from rotcal_ros.sessions.products import write_products


def session_with(folder, result, **groups):
    """A session as far as its products look at it: a real cell whose result is there.

    ``groups``: those of extensions in its configuration.
    """
    place = SessionFolder(folder)
    place.result.write_text(result.to_json())
    cell = SimpleNamespace(axis="C")
    configuration = SimpleNamespace(
        simulated=False, cell=cell, given=frozenset(groups), extensions=groups
    )
    return SimpleNamespace(folder=place, configuration=configuration)


@pytest.mark.parametrize("measured_on", ["none", "unknown"])
def test_two_groups_are_not_exported_at_the_end_of_a_run(tmp_path, measured_on):
    """Controller files were written by itself, with 4 arcsec between odd and even positions."""
    told = []
    six = replace(solve(plate_problem()), measured_on=measured_on)
    paths = write_products(session_with(tmp_path, six), report=False, tell=told.append)
    assert set(paths) == {"bag", "result"}
    assert not (tmp_path / "compensation").exists()
    (why,) = told
    assert why.startswith("no compensation files: the offset between the odd and even table")
    assert "joined by 'rotcal combine'" in why


def test_a_whole_result_is_exported(tmp_path):
    told = []
    twelve = replace(solve(plate_problem(range(GRID))), measured_on="none")
    paths = write_products(session_with(tmp_path, twelve), report=False, tell=told.append)
    assert told == []
    assert "compensation" in paths


def test_with_a_history_the_result_is_kept_in_it(tmp_path):
    database = pytest.importorskip("rotcal_ros.extensions.history.database")
    told, place = [], str(tmp_path / "history.db")
    identity = Identity(serial="4711", measured="2026-03-31")
    circumstances = Circumstances(axis="C", identity=identity)
    twelve = replace(solve(plate_problem(range(GRID))), circumstances=circumstances)
    session = session_with(tmp_path, twelve, history=SimpleNamespace(database=place))
    for words in ("added", "there already"):
        write_products(session, report=False, export=False, tell=told.append)
        assert told[-1] == f"history: entry 1: result of 4711/C, 2026-03-31, {words}"
    with database.ParkHistory(place) as history:
        (entry,) = history.entries(content=True)
    assert database.result_of(entry).to_json() == twelve.to_json()


def test_a_result_that_a_history_refuses_spoils_no_calibration(tmp_path):
    pytest.importorskip("rotcal_ros.extensions.history.database")
    told, settings = [], SimpleNamespace(database=str(tmp_path / "history.db"))
    session = session_with(tmp_path, solve(plate_problem(range(GRID))), history=settings)
    paths = write_products(session, report=False, export=False, tell=told.append)
    assert set(paths) == {"bag", "result"}
    assert "no serial number" in told[0]
    later = f"`rotcal history add {tmp_path} --database {settings.database}` adds it later"
    assert later in told[0]
