"""What other rooms ask of the history: keep a result, say what has changed since the last one."""

from __future__ import annotations

from pathlib import Path

from rotcal_ros.evaluation.compare import compare
from rotcal_ros.extensions.history.database import RESULT, Added, ParkHistory, canonical, result_of
from rotcal_ros.extensions.history.page import render
from rotcal_ros.foundation.components import unit_of
from rotcal_ros.foundation.curves.measured import measured_curve
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.language import SPOKEN, phrase
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.session_folder import SessionFolder
from rotcal_ros.recordings.result_sources import read_source
from rotcal_ros.report.comparison import curves_and_errors

TITLE = phrase("Since last time")


def keep(result: Result, database: str, axis: str = "", report: Path | None = None) -> str:
    """Add a result, and its report, to a history; return in words what became of it.

    Raises what :meth:`ParkHistory.add_result` does.
    """
    with ParkHistory(database) as history:
        added = history.add_result(result, axis=_unless_stated(result, axis))
        if report is not None:
            entry, page = added.entry, report.read_bytes()
            facts = (entry.serial, entry.axis, "report", report.name, entry.measured_ns)
            history.add_document(*facts, page)
    return in_words(added)


def keep_session(folder: SessionFolder, database: str, axis: str) -> str:
    """Add the result of a session, and its report if it has one, to a history."""
    report = folder.report if folder.report.is_file() else None
    return keep(read_source(folder.result).result, database, axis, report)


def since_last_time(result: Result, database: str, axis: str = "") -> tuple[str, str] | None:
    """Return title and HTML of the changes since the newest result before; None without one."""
    axis = _unless_stated(result, axis) or result.circumstances.axis
    serial = result.circumstances.identity.serial
    with ParkHistory(database) as history:
        earlier = _earlier(history, result, serial, axis)
    if earlier is None:
        return None
    day, last = earlier
    changes, now = [], SPOKEN.get().say(phrase("now"))
    for name in result.components:
        try:
            curves = {now: measured_curve(result, name), day: measured_curve(last, name)}
            found = compare(curves[now], curves[day])
        except DataError:  # not measured then, or not comparable
            continue
        unit, label = unit_of(name)
        words = phrase("{0} against {1}: {2}", name, day, phrase(found.in_words(unit, label)))
        changes.append((words, curves_and_errors(curves, {(now, day): found}, name), name))
    return (TITLE, render("since_last_time", changes=changes)) if changes else None


def in_words(added: Added) -> str:
    """Say what became of an addition."""
    entry, state = added.entry, "added" if added.new else "there already"
    return f"entry {entry.id}: {entry.kind} of {entry.serial}/{entry.axis}, {entry.day}, {state}"


def _unless_stated(result: Result, axis: str) -> str:
    return "" if result.circumstances.axis else axis


def _earlier(
    history: ParkHistory, result: Result, serial: str, axis: str
) -> tuple[str, Result] | None:
    for item in history.items():
        if (item.serial, item.axis) != (serial, axis):
            continue
        until = result.circumstances.from_ns or 1 << 62
        known = [e for e in history.of_item(item) if e.kind == RESULT and e.measured_ns < until]
        for entry in reversed(known):
            last = result_of(history.entry(entry.id))
            if canonical(last) != canonical(result):
                return entry.day, last
    return None
