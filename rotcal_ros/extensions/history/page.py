"""The page of the park: a row for each table, and behind it a page with its curves and entries.

Plain files without a server: the list of tables is data that a script of the page filters and
shows in parts, so that 3 and 3,000 tables are equally quick to look at.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from markupsafe import Markup

from rotcal_ros.extensions.history.database import (
    DOCUMENTS,
    EVENT,
    HistoryEntry,
    ParkHistory,
    day_of,
)
from rotcal_ros.extensions.history.outlook import DeviationOutlook, Outlook, urgent
from rotcal_ros.foundation.components import unit_of
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.language import SPOKEN, phrase
from rotcal_ros.report import template

PAGE: Final = "park.html"
FOLDER: Final = "park"
"""Folder beside the page, for the pages of the tables."""
WIDTH, HEIGHT = 120, 24
"""Of a sparkline, in pixels."""
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
    due, spoken = day_of(view.due_ns), SPOKEN.get()
    state = "look" if urgent(view) else "due" if due <= today else "well"
    shown = max(view.deviations, key=lambda d: d.component == "ECC", default=None)
    return {
        "table": view.title,
        "link": link,
        "last": day_of(view.last_ns),
        "verdict": spoken(view.verdict_line),
        "standing": "partly" if view.verdict == "ok" and not view.covered else view.verdict,
        "trend": spoken(view.trend),
        "due": due,
        "reason": spoken(view.reason),
        "state": state,
        "spark": "" if shown is None else sparkline(shown),
    }


def sparkline(view: DeviationOutlook) -> str:
    """Return the largest deviations over time as the path of an SVG, WIDTH by HEIGHT."""
    first, last = view.times_ns[0], view.times_ns[-1]
    top = max(*view.largest, view.tolerance, 1e-12)
    points = [
        (
            3 + (WIDTH - 6) * ((time - first) / (last - first) if last > first else 0.5),
            HEIGHT - 3 - (HEIGHT - 6) * value / top,
        )
        for time, value in zip(view.times_ns, view.largest, strict=True)
    ]
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)


def _write_table(history: ParkHistory, view: Outlook, folder: Path, name: str) -> None:
    item = history.item(view.serial, view.axis)
    entries = history.of_item(item, valid=False)
    replaced = {entry.replaces for entry in entries}
    text = render(
        "table",
        view=view,
        day_of=day_of,
        figures=[(d.component, over_time(d, entries)) for d in view.deviations],
        rows=[_entry_row(history, entry, folder) for entry in reversed(entries)],
        replaced=replaced,
        verdicts=history.verdicts(item),
        forecast=[d for d in view.deviations if d.intervals_days],
        home=f"../{PAGE}",
    )
    (folder / name).write_text(text, encoding="utf-8")


LEFT, RIGHT, TOP, BOTTOM, WIDE, HIGH = 60, 12, 14, 26, 860, 190
"""Edges and size of the drawing of a table's page, in pixels."""


def over_time(view: DeviationOutlook, entries: Sequence[HistoryEntry]) -> str:
    """Return a drawing of the largest deviations over time, with tolerance, events and due."""
    unit, label = unit_of(view.component)
    events = [e for e in entries if e.kind == EVENT and e.measured_ns >= view.times_ns[0]]
    last = max(view.times_ns[-1], view.due_ns or 0, *(e.measured_ns for e in events), 0)
    top = 1.1 * max(*view.largest, view.tolerance, 1e-12)

    def x(time_ns: int) -> float:
        span = max(last - view.times_ns[0], 1)
        return round(LEFT + (WIDE - LEFT - RIGHT) * (time_ns - view.times_ns[0]) / span, 1)

    def y(value: float) -> float:
        return round(HIGH - BOTTOM - (HIGH - TOP - BOTTOM) * value / top, 1)

    return render(
        "over_time",
        size=(WIDE, HIGH),
        edges=(LEFT, WIDE - RIGHT, TOP, HIGH - BOTTOM),
        label=phrase("largest |{0}| / {1}", view.component, label),
        points=[(x(t), y(v)) for t, v in zip(view.times_ns, view.largest, strict=True)],
        ticks=[(y(share * top), f"{share * top / unit:.3g}") for share in (0.0, 0.5, 1.0)],
        dates=[(x(t), day_of(t)) for t in dict.fromkeys([view.times_ns[0], last])],
        tolerance=y(view.tolerance) if view.tolerance else None,
        events=[(x(e.measured_ns), e.what) for e in events],
        due=None if view.due_ns is None else x(view.due_ns),
    )


def _entry_row(
    history: ParkHistory, entry: HistoryEntry, folder: Path
) -> tuple[HistoryEntry, str]:
    """Return an entry with the link to its file: a report as it was, others as they are."""
    if entry.kind in DOCUMENTS:
        name = f"entry-{entry.id}-{Path(entry.what).name}"
        (folder / name).write_bytes(history.entry(entry.id).content)
        return entry, name
    return entry, ""
