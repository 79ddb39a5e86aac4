"""What others ask of the history: keep a result, say what has changed since the last one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from itertools import groupby, islice
from pathlib import Path
from typing import Any, Final

import numpy as np

from rotcal_history.database import (
    ENTRIES,
    ITEMS,
    REPLACED,
    RESULT,
    AdditionOutcome,
    ParkHistory,
    canonical_json,
    result_of,
)
from rotcal_history.outlook import deviation_series, expected_curve
from rotcal_history.page import render
from rotcal_history.settings import HistorySettings
from rotcal_history.trend import fit_trend
from rotcal_ros.evaluation.compare import compare
from rotcal_ros.foundation.arrays import std_of
from rotcal_ros.foundation.circumstances import Circumstances
from rotcal_ros.foundation.components import unit_of
from rotcal_ros.foundation.curves.measured import measured_curve
from rotcal_ros.foundation.dates import time_of
from rotcal_ros.foundation.errors import ConfigurationError, DataError, RotcalError
from rotcal_ros.foundation.language import SPOKEN, phrase
from rotcal_ros.foundation.results import Result, Zeros
from rotcal_ros.foundation.session_folder import SessionFolder
from rotcal_ros.foundation.untrusted import read_bytes, read_errors_as
from rotcal_ros.recordings.result_sources import ResultSource, read_source
from rotcal_ros.report.comparison import curves_and_errors

TITLE = phrase("Since last time")
AT_ONCE: Final = 50
"""Results in files that are added in one transaction."""
REFUSALS: Final = (DataError, ConfigurationError)
"""Errors of one addition; all others are errors of the history."""
LONGEST_NS: Final = 86_400_000_000_000
"""No measurement takes longer."""


def add_sources(
    history: ParkHistory, sources: Iterable[Path], given: Mapping[str, Any], kind: str | None
) -> Iterator[list[AdditionOutcome] | RotcalError]:
    """Yield what was added of each source, or why nothing was; files of a ``kind`` as they are.

    It is on the medium then: of result files AT_ONCE share a transaction. ``given`` is what a
    result does not state. Raises BagError where the history does not take them.
    """
    read: Callable[[Path], Any] = _content if kind else read_source
    add = partial(_add_document, history, given, kind) if kind else partial(_add, history, given)
    for files, alike in groupby(sources, lambda source: source.suffix == ".json"):
        while group := list(islice(alike, AT_ONCE if files else 1)):
            found = [(source, _or_error(RotcalError, read, source)) for source in group]
            with history.transaction():
                done = [
                    new if isinstance(new, RotcalError) else _or_error(REFUSALS, add, source, new)
                    for source, new in found
                ]
            yield from done


def _content(path: Path) -> bytes:
    with read_errors_as(path, DataError):
        return read_bytes(path)


def _or_error(kinds: Any, function: Callable[..., Any], *given: Any) -> Any:
    try:
        return function(*given)
    except kinds as error:
        return error


def _add(
    history: ParkHistory, given: Mapping[str, Any], source: Path, found: ResultSource
) -> list[AdditionOutcome]:
    """Add the result that was found in a file, bag or session, and the report of a session."""
    given = {**given, "axis": given.get("axis") or found.axis or ""}
    added = [history.add_result(found.result, **given, where=str(source))]
    report, entry = SessionFolder(source).report, added[0].entry
    if source.is_dir() and report.is_file():
        about = entry, "report", report.name, entry.measured_ns
        added.append(history.add_document(*about, report.read_bytes()))
    return added


def _add_document(
    history: ParkHistory, given: Mapping[str, Any], kind: str, source: Path, content: bytes
) -> list[AdditionOutcome]:
    item = history.item(given["serial"], given["axis"])
    day = given["measured_ns"] or round(source.stat().st_mtime) * 1_000_000_000
    return [history.add_document(item, kind, source.name, day, content)]


def keep_session(folder: SessionFolder, database: str, axis: str) -> str:
    """Add the result and the report of a session to a history; return what became of it."""
    with ParkHistory(database) as history:
        found = read_source(folder.path)
        return _add(history, {"axis": axis}, folder.path, found)[0].describe()


def keep_measurement(
    history: ParkHistory, result: Result, serial: str, source: str
) -> AdditionOutcome:
    """Add the result of a bag, in place of an earlier one of the same measurement.

    So a bag that is solved again counts once. The earlier one stays if it had more observations:
    a damaged copy replaces no whole recording. ``serial`` is for a result that states none,
    ``source`` for people. Raises what :meth:`ParkHistory.add_result` does, and DataError for a
    measurement that somebody withdrew or gave to another table.
    """
    known = result.circumstances
    serial, begun = known.identity.serial or serial, known.from_ns
    ended = max(begun, known.ended_ns or 0)
    about = (
        ITEMS.c.serial == serial, ITEMS.c.axis == known.axis, ENTRIES.c.kind == RESULT,
        ENTRIES.c.what == result.method,
        ENTRIES.c.measured_ns.between(begun - LONGEST_NS, ended),
    )  # fmt: skip
    near = ((entry, result_of(entry)) for entry in history.entries(*about, content=True))
    same = [(entry, earlier) for entry, earlier in near if _same_measurement(result, earlier)]
    add, why = partial(history.add_result, result, serial, where=source), f"{source}, solved again"
    for entry, earlier in same:
        if entry.state != REPLACED:
            fuller = _observed(earlier) > _observed(result)
            as_before = fuller or canonical_json(earlier) == canonical_json(result)
            return AdditionOutcome(entry, new=False) if as_before else add(why=why, corrects=entry)
    if same:
        raise DataError(
            f"entry {same[-1][0].id} of the same measurement was taken from this table: add it "
            "with `rotcal history add` if it counts after all"
        )
    return add(why=source)


def _same_measurement(result: Result, earlier: Result) -> bool:
    """Return whether two results of an axis share observations, or were measured together."""
    if set(result.raw_data.hashes) & set(earlier.raw_data.hashes):
        return True
    a, b = result.circumstances, earlier.circumstances
    if a.begun_ns is None or b.begun_ns is None:
        return False
    return a.begun_ns <= (b.ended_ns or b.begun_ns) and b.begun_ns <= (a.ended_ns or a.begun_ns)


def _observed(result: Result) -> int:
    """Return how many observations there were, used or not."""
    return result.n_observations + len(result.rejected)


def since_last_time(result: Result, database: str, axis: str = "") -> list[tuple[str, str]]:
    """Return title and HTML of the changes since the newest result before, if there is one."""
    known = result.circumstances
    about = ITEMS.c.serial == known.identity.serial, ITEMS.c.axis == (known.axis or axis)
    with ParkHistory(database) as history:
        valid = (entry for item in history.items(*about) for entry in history.of_item(item))
        before = [e for e in valid if e.kind == RESULT and e.measured_ns < known.from_ns]
        if not before:
            return []
        day, last = before[-1].day, result_of(history.entry(before[-1].id))
    changes, now = [], SPOKEN.get().say(phrase("now"))
    for name in result.components:
        try:
            curves = {now: measured_curve(result, name), day: measured_curve(last, name)}
            found = compare(curves[now], curves[day])
        except DataError:  # not measured then, or not comparable
            continue
        unit, label = unit_of(name)
        words = phrase("{0} against {1}: {2}", name, day, found.describe(unit, label))
        changes.append((words, curves_and_errors(curves, {(now, day): found}, name), name))
    return [(TITLE, render("since_last_time", changes=changes))] if changes else []


def expected(database: str, serial: str, axis: str, day: str) -> tuple[Result, float]:
    """Return the ECC that a history expects of a table on a day, and what its tolerance leaves.

    The day is as 2026-03-31, the result suspect, since it was not measured. If nowhere the
    table is further than what is left (rad) from this curve, both about their mean, it is within
    its tolerance; zero or less without a tolerance, or where the curve itself is beyond. Raises
    DataError for a table of which too little is known.
    """
    with ParkHistory(database, must_exist=True) as history:
        item, settings = history.item(serial, axis), HistorySettings()
        curves = deviation_series(history, item, "ECC", settings)
        newest = result_of(history.entry(curves.campaigns[-1].entry_id))
    curve, covariance = expected_curve(curves, fit_trend(curves.series), time_of(day))
    # A curve that counts from an angle moves by the error there, too.
    room = (curves.tolerance - float(np.max(np.abs(curve)))) / (1 if curves.zero is None else 2)
    words = phrase("expected of {0} results for {1}: not measured", len(curves.campaigns), day)
    identity = newest.circumstances.identity
    result = Result(
        method=newest.method, angles=curves.newest.angles, deviations={"ECC": curve},
        std={"ECC": std_of(covariance)}, covariance={"ECC": covariance}, sigma0=1.0, dof=0,
        n_observations=0, verdict="suspect", warnings=(words,),
        circumstances=Circumstances(
            newest.simulated, axis=item.axis, identity=identity, begun_ns=time_of(day)
        ),
        zeros=Zeros(newest.zeros.counts_from),
    )  # fmt: skip
    return result, room
