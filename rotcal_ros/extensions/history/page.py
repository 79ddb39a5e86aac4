"""The page of the park: a row for each table, and behind it a page with its curves and entries.

Plain files without a server: the list of tables is data that a script of the page filters and
shows in parts, so that 3 and 3,000 tables are equally quick to look at.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from markupsafe import Markup

from rotcal_ros.extensions.history.database import EVENT, HistoryEntry, ParkHistory
from rotcal_ros.extensions.history.outlook import DeviationOutlook, Outlook
from rotcal_ros.extensions.history.settings import DOCUMENTS
from rotcal_ros.foundation.components import unit_of
from rotcal_ros.foundation.dates import day_of
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.language import SPOKEN, phrase
from rotcal_ros.report import template

PAGE: Final = "park.html"
FOLDER: Final = "park"
"""Folder beside the page, for the pages of the tables."""
_SPARK: Final = (3, 117, 3, 21)
_DRAWING: Final = (60, 848, 14, 164)
"""Left, right, upper and lower edge of a sparkline, and of the drawing of a table, in pixels."""
render = partial(template.render, package="rotcal_ros.extensions.history")


def write_park(
    history: ParkHistory, outlooks: Sequence[Outlook], folder: Path, today: str
) -> Path:
    """Write the page and those it leads to into ``folder``; return where it is.

    ``today``, as 2026-03-31, is the day from which on a table counts as overdue.
    """
    folder.mkdir(parents=True, exist_ok=True)
    new, place = folder / f".{FOLDER}-new", folder / FOLDER
    shutil.rmtree(new, ignore_errors=True)
    new.mkdir()
    rows = []
    for number, view in enumerate(outlooks):
        name = f"table-{number}.html"
        _write_table(history, view, new, name)
        rows.append(_row(view, f"{FOLDER}/{name}", today))
    shutil.rmtree(place, ignore_errors=True)
    new.rename(place)
    # No tag can begin in it.
    data = json.dumps(rows).replace("<", "\\u003c")
    counts = {kind: sum(row["state"] == kind for row in rows) for kind in ("look", "due", "well")}
    text = render("park", data=Markup(data), tables=len(rows), counts=counts, today=today)
    write_atomically(folder / PAGE, text)
    return folder / PAGE


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


def _write_table(history: ParkHistory, view: Outlook, folder: Path, name: str) -> None:
    item = history.item(view.serial, view.axis)
    entries = history.of_item(item, valid=False)
    documents = {e.id: f"entry-{e.id}-{Path(e.what).name}" for e in entries if e.kind in DOCUMENTS}
    for number, file in documents.items():
        (folder / file).write_bytes(history.entry(number).content)
    text = render(
        "table",
        view=view,
        day_of=day_of,
        figures=[(d.component, over_time(d, entries)) for d in view.deviations],
        entries=entries[::-1],
        documents=documents,
        home=f"../{PAGE}",
    )
    (folder / name).write_text(text, encoding="utf-8")


def over_time(view: DeviationOutlook, entries: Sequence[HistoryEntry]) -> str:
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
