"""The page of the park: a row for each table, and behind it a page with its curves and entries.

Plain files without a server: the list of tables is data that a script of the page filters and
shows in parts, so that 3 and 3,000 tables are equally quick to look at.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any, Final, NamedTuple

from markupsafe import Markup

from rotcal_history.database import (
    EVENT,
    REPLACED,
    RESULT,
    HistoryEntry,
    ParkHistory,
    result_of,
)
from rotcal_history.outlook import DeviationOutlook, Outlook
from rotcal_history.settings import DOCUMENTS
from rotcal_ros.foundation.components import unit_of
from rotcal_ros.foundation.dates import day_of
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.files import naming, scratch_folder, write_atomically
from rotcal_ros.foundation.folder_lock import FolderLock
from rotcal_ros.foundation.language import SPOKEN, phrase
from rotcal_ros.foundation.untrusted import load_json, read_bytes, read_text
from rotcal_ros.report import template

PAGE: Final = "park.html"
FOLDER: Final = "park"
"""Folder beside the page, for the pages of the tables."""
OURS: Final = ".rotcal-pages.json"
"""List of the files in it that we wrote, with their hashes."""
PATIENCE_S: Final = 60.0
"""How long another page may take to be written."""
_SPARK: Final = (3, 117, 3, 21)
_DRAWING: Final = (60, 848, 14, 164)
"""Left, right, upper and lower edge of a sparkline, and of the drawing of a table, in pixels."""
render = partial(template.render, package="rotcal_history")


def write_park(
    history: ParkHistory, outlooks: Sequence[Outlook], folder: Path, today: str
) -> Path:
    """Write the page and those it leads to into ``folder``; return where it is.

    ``today``, as 2026-03-31, is the day from which on a table counts as overdue. The files of an
    earlier page are replaced or removed, and nothing else: OURS lists them with their hashes.
    Raises BagError, before anything is written, where a file of somebody else is in the way, and
    if another process writes there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lock = _waited_for(folder)
    try:
        return _write_park(history, outlooks, folder, today)
    finally:
        lock.release()


def _waited_for(folder: Path) -> FolderLock:
    """Return the lock of ``folder``, when another page is written."""
    until = time.monotonic() + PATIENCE_S
    while time.monotonic() < until:
        with suppress(BagError):
            return FolderLock(folder)
        time.sleep(0.1)
    return FolderLock(folder)


def _write_park(
    history: ParkHistory, outlooks: Sequence[Outlook], folder: Path, today: str
) -> Path:
    rows, pages, lines = [], dict[str, _File](), dict[str, str]()
    for number, view in enumerate(outlooks):
        name = f"{FOLDER}/table-{number}.html"
        pages |= _table_files(history, view, name, lines)
        rows.append(_row(view, name, today))
    # No tag can begin in it.
    data = json.dumps(rows).replace("<", "\\u003c")
    counts = {kind: sum(row["state"] == kind for row in rows) for kind in ("look", "well")}
    counts["due"] = sum(row["due"] <= today for row in rows)  # those to look at among them
    text = render("park", data=Markup(data), tables=len(rows), counts=counts, today=today)
    _replace(folder, pages | _text_file(PAGE, text))
    return folder / PAGE


class _File(NamedTuple):
    """A file to be written: the hash of its content, and what gives it."""

    hash: str
    content: Callable[[], bytes]


def _text_file(name: str, text: str) -> dict[str, _File]:
    content = text.encode()
    return {name: _File(sha256(content).hexdigest(), lambda: content)}


def _replace(folder: Path, pages: Mapping[str, _File]) -> None:
    """Write files by name, the last one at last, in place of those that were written before."""
    if (folder / FOLDER).is_symlink():
        raise BagError(f"{folder / FOLDER} is a link, through which nothing is written: remove it")
    ours = _written_before(folder)
    for name in pages:
        path = folder / name
        if os.path.lexists(path) and ours.get(name) != _hash_of(path):
            raise BagError(
                f"{path} is not as a page of ours left it, and is not replaced: move it away, or "
                "name another folder"
            )
    (folder / FOLDER).mkdir(exist_ok=True)
    hashes = {name: file.hash for name, file in pages.items()}
    # Both are listed meanwhile: whenever this ends, the next page knows what is ours.
    _note(folder, {**ours, **hashes}, ours)
    with scratch_folder(folder / FOLDER) as scratch:
        for name, file in pages.items():
            if ours.get(name) != file.hash:
                new = scratch / Path(name).name
                with naming(folder / name):
                    new.write_bytes(file.content())
                    new.replace(folder / name)
    for name in ours.keys() - pages.keys():
        if ours[name] == _hash_of(folder / name):
            (folder / name).unlink()
    _note(folder, hashes, {})


def _note(folder: Path, hashes: Mapping[str, str], before: Mapping[str, str]) -> None:
    """List which files are ours, with their hash, and the one that they had before."""
    known = {name: [now, before.get(name, now)] for name, now in hashes.items()}
    write_atomically(folder / FOLDER / OURS, json.dumps(known))


def _written_before(folder: Path) -> dict[str, str]:
    """Return the files that a page of ours left in ``folder``, those that are as they were."""
    try:
        known = load_json(read_text(folder / FOLDER / OURS))
        pairs = [(name, h) for name, hashes in known.items() for h in hashes]
    except (OSError, ValueError, TypeError, AttributeError):
        return {}
    inside = [(name, h) for name, h in pairs if name == PAGE or _is_of_folder(name)]
    return {name: h for name, h in inside if h and h == _hash_of(folder / name)}


def _is_of_folder(name: str) -> bool:
    """Return whether a name leads to a file of the folder itself: a list may be anybody's."""
    place, _, file = name.partition("/")
    return place == FOLDER and file not in ("", ".", "..", OURS) and "/" not in file


def _hash_of(path: Path) -> str:
    """Return the hash of a plain file; empty for all else, such as a link."""
    if path.is_symlink() or not path.is_file():
        return ""
    with suppress(OSError):
        return sha256(read_bytes(path)).hexdigest()
    return ""


def _row(view: Outlook, link: str, today: str) -> dict[str, Any]:
    """Return what the page knows of a table."""
    spoken = SPOKEN.get()
    state = "look" if view.urgent else "due" if view.due <= today else "well"
    shown = max(view.deviations, key=lambda d: d.component == "ECC", default=None)
    spark = shown and _path(shown, *_scales(shown, shown.times_ns[-1], _SPARK))
    return {
        "table": view.title,
        "link": link,
        "last": view.last,
        "verdict": spoken(view.verdict_line),
        "standing": view.verdict,
        "trend": spoken(view.trend),
        "due": view.due,
        "reason": spoken(view.reason),
        "state": state,
        "is_due": view.due <= today,
        "spark": spark or "",
    }


def _scales(
    view: DeviationOutlook, last_ns: int, edges: tuple[int, ...]
) -> tuple[Callable[[int], float], Callable[[float], float]]:
    """Return what gives the places of a time and of a deviation between the edges, in pixels."""
    left, right, upper, lower = edges
    top = max(*view.largest, view.tolerance, 1e-12)
    begin, span = view.times_ns[0], last_ns - view.times_ns[0]
    return (
        lambda time: round(left + (right - left) * ((time - begin) / span if span else 0.5), 1),
        lambda value: round(lower - (lower - upper) * value / top, 1),
    )


def _path(view: DeviationOutlook, x: Callable[[int], float], y: Callable[[float], float]) -> str:
    """Return the largest deviations over time as the path of an SVG."""
    points = zip(view.times_ns, view.largest, strict=True)
    return "M" + "L".join(f"{x(time)} {y(value)}" for time, value in points)


def _state(history: ParkHistory, entry: HistoryEntry, lines: dict[str, str]) -> str:
    """Return the state of an entry as a phrase, which the text in the database no longer is.

    ``lines`` keeps the verdict lines by their text: of results that read alike one is opened.
    """
    if entry.kind != RESULT or entry.state == REPLACED:
        return entry.state
    if entry.state not in lines:
        lines[entry.state] = result_of(history.entry(entry.id)).verdict_line
    return lines[entry.state]


def _table_files(
    history: ParkHistory, view: Outlook, name: str, lines: dict[str, str]
) -> dict[str, _File]:
    """Return the page ``name`` of a table, and its documents, by name."""
    item = history.item(view.serial, view.axis)
    entries = history.of_item(item, valid=False)
    documents = {e.id: f"entry-{e.id}-{Path(e.what).name}" for e in entries if e.kind in DOCUMENTS}
    text = render(
        "table",
        view=view,
        day_of=day_of,
        figures=[(d.component, draw_over_time(d, entries)) for d in view.deviations],
        entries=[(entry, _state(history, entry, lines)) for entry in entries[::-1]],
        documents=documents,
        home=f"../{PAGE}",
    )
    hashes = {entry.id: entry.content_sha256 for entry in entries}
    return _text_file(name, text) | {
        f"{FOLDER}/{file}": _File(hashes[number], partial(_content, history, number))
        for number, file in documents.items()
    }


def _content(history: ParkHistory, number: int) -> bytes:
    return history.entry(number).content


def draw_over_time(view: DeviationOutlook, entries: Sequence[HistoryEntry]) -> str:
    """Return a drawing of the largest deviations over time, with tolerance, events and due."""
    unit, label = unit_of(view.component)
    events = [e for e in entries if e.kind == EVENT and e.measured_ns >= view.times_ns[0]]
    last = max(view.times_ns[-1], view.due_ns or 0, *(e.measured_ns for e in events), 0)
    x, y = _scales(view, last, _DRAWING)
    top = max(*view.largest, view.tolerance)
    return render(
        "over_time",
        edges=_DRAWING,
        label=phrase("largest |{0}| / {1}", view.component, label),
        path=_path(view, x, y),
        points=[(x(t), y(v)) for t, v in zip(view.times_ns, view.largest, strict=True)],
        ticks=[(y(share * top), f"{share * top / unit:.3g}") for share in (0.0, 0.5, 1.0)],
        dates=[(x(t), day_of(t)) for t in dict.fromkeys([view.times_ns[0], last])],
        tolerance=y(view.tolerance) if view.tolerance else None,
        events=[(x(e.measured_ns), e.what) for e in events],
        due=None if view.due_ns is None else x(view.due_ns),
    )
