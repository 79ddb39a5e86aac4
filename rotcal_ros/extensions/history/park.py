"""The outlook of all tables of a history, computed where something is new."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from hashlib import sha256
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import chi2_sf
from rotcal_ros.extensions.history.database import RESULT, Item, ParkHistory, day_of
from rotcal_ros.extensions.history.outlook import (
    VERSION,
    DeviationOutlook,
    Outlook,
    TableFinding,
    outlook,
    with_finding,
)
from rotcal_ros.extensions.history.series import DeviationSeries, series_of, usable
from rotcal_ros.extensions.history.settings import HistorySettings
from rotcal_ros.foundation.errors import BagError, DataError
from rotcal_ros.foundation.language import phrase

KEPT_AFTER: Final = 100
"""New outlooks that are kept at once."""
_FITS: Final = 0.01
"""A jump goes to another table if that would show more in one of a hundred such curves."""
_CLEARLY: Final = 10.0
"""By this logarithm of a likelihood ratio the other table explains it better."""


def park(
    history: ParkHistory,
    settings: HistorySettings,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> list[Outlook]:
    """Return the outlooks of all axes with results, by serial number."""
    bases, known = history.bases(), history.forecasts()
    plain = replace(settings, database="", period_s=1.0)  # the others change what is forecast
    items, found, new = history.items(), list[Outlook](), list[tuple[int, str, str]]()
    for done, item in enumerate(items, 1):
        basis = sha256(f"{VERSION} {plain} {bases.get(item.id)}".encode()).hexdigest()
        text = known.get((item.id, basis))
        view = None
        if text is not None:
            with suppress(ValueError):
                view = Outlook.from_json(text)
        if view is None and (view := outlook_of(history, item, settings)) is not None:
            new.append((item.id, basis, view.to_json()))
        if view is not None:
            found.append(view)
        if len(new) >= KEPT_AFTER or done == len(items):
            with suppress(BagError):  # a history that may only be read is shown all the same
                history.note_forecasts(new)
            new = []
        progress(done, len(items))
    return _with_swaps(found)


def outlook_of(history: ParkHistory, item: Item, settings: HistorySettings) -> Outlook | None:
    """Return the outlook of one axis; None for one without results."""
    entries = history.of_item(item)
    if not any(entry.kind == RESULT for entry in entries):
        return None
    return outlook(item.serial, item.axis, history.campaigns(item), entries, settings)


def deviation_series(
    history: ParkHistory, item: Item, component: str, settings: HistorySettings
) -> DeviationSeries:
    """Return the series of one deviation of an axis; DataError with fewer than two results."""
    campaigns, entries = history.campaigns(item), history.of_item(item)
    known = series_of(usable(campaigns, entries), entries, settings.common_share)
    curves = known.get(component)
    if curves is None or len(curves.campaigns) < 2:
        raise DataError(
            f"{item.title} has fewer than two results of {component} that can be compared: add "
            "more, or choose another component"
        )
    return curves


def _with_swaps(outlooks: Sequence[Outlook]) -> list[Outlook]:
    """Name the tables whose jump shows the curve of another one: a swapped serial number."""
    named = list(outlooks)
    for number, view in enumerate(outlooks):
        jumped = [d for d in view.deviations if d.alarm is not None]
        if not jumped:
            continue
        fits = [(_fit(jumped, other), other) for other in outlooks if other is not view]
        best, other = max(fits, key=lambda pair: pair[0], default=(-np.inf, view))
        if best < sum(_compared(mine, mine)[1] for mine in jumped) + _CLEARLY:
            continue
        time_ns = max(d.times_ns[d.alarm or 0] for d in jumped)
        words = phrase(
            "the result of {0} has the curve of {1}: were the serial numbers swapped?",
            day_of(time_ns),
            other.title,
        )
        named[number] = with_finding(view, TableFinding("swapped", time_ns, words))
    return named


def _fit(jumped: Sequence[DeviationOutlook], other: Outlook) -> float:
    """Return the log-likelihood of jumped curves as those of another table; -inf: they differ."""
    theirs = {d.component: d for d in other.deviations if d.expected}
    total = 0.0
    for mine in jumped:
        their = theirs.get(mine.component)
        if their is None or len(their.found) != len(mine.found):
            return -np.inf
        square, density = _compared(mine, their)
        if chi2_sf(square, len(mine.found)) < _FITS:
            return -np.inf
        total += density
    return total


def _compared(mine: DeviationOutlook, their: DeviationOutlook) -> tuple[float, float]:
    """Return T2 and the log-density of what one deviation showed where another was expected."""
    mean, std = map(np.array, their.expected)
    square = float(np.sum(((np.array(mine.found) - mean) / std) ** 2))
    return square, -0.5 * square - float(np.sum(np.log(std)))
