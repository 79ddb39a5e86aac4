"""A run keeps its result in the history that its configuration names."""

from dataclasses import replace
from types import SimpleNamespace

from test_products import session_with
from two_groups import GRID, plate_problem

from rotcal_history import database
from rotcal_ros.foundation.circumstances import Circumstances
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.methods.ball_plate.solver import solve
from rotcal_ros.sessions.products import write_products


def test_with_a_history_the_result_is_kept_in_it(tmp_path):
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
    told, settings = [], SimpleNamespace(database=str(tmp_path / "history.db"))
    session = session_with(tmp_path, solve(plate_problem(range(GRID))), history=settings)
    paths = write_products(session, report=False, export=False, tell=told.append)
    assert set(paths) == {"bag", "result"}
    assert "no serial number" in told[0]
    later = f"`rotcal history add {tmp_path} --database {settings.database}` adds it later"
    assert later in told[0]
