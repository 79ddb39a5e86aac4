"""What is known of the tables: have they changed, when are they due, and why.

Due is the last day on which the whole curve is within its tolerance with the promised probability
(the conformance probability of JCGM 106:2012, 7, of a forecast). Beside it stand the methods of
ILAC-G24 / OIML D 10:2022 that a series of calibrations allows: staircase and control chart.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from math import isclose
from typing import Any, Final, Literal

import numpy as np

from rotcal_history.charts import FALSE_ALARM, chart_alarms
from rotcal_history.database import (
    EVENT,
    AxisIdentity,
    Campaign,
    ParkHistory,
    RegisteredAxis,
    result_of,
)
from rotcal_history.series import DeviationSeries, make_deviation_series
from rotcal_history.settings import Chart, HistorySettings
from rotcal_history.trend import DRAWS, YEAR_NS, Trend, fit_trend
from rotcal_ros.adjust.distributions import chi2_sf
from rotcal_ros.evaluation.marks import decide_conformity
from rotcal_ros.foundation.arrays import Floats, Ints, std_of
from rotcal_ros.foundation.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.dates import day_of
from rotcal_ros.foundation.errors import BagError, DataError
from rotcal_ros.foundation.language import Phrase, codes_of, join_texts, phrase, with_codes
from rotcal_ros.foundation.records import record
from rotcal_ros.foundation.units import ARCSEC, DEGREE

VERSION: Final = 4
"""A forecast of another version is made again."""
DAY_NS: Final = 86_400_000_000_000
ENOUGH: Final = 3
"""Fewest campaigns since the last step for a forecast."""
_DATES: Final = 16
"""A due date is searched for among so many dates, and then between two of them."""
_EXACT_NS: Final = DAY_NS / 2
_SIGNIFICANT: Final = 3.0
"""Standard uncertainties of a change that is called one."""
_SAME: Final = 1e-6
"""Largest relative difference of what is computed again."""
_CLOSE: Final = 0.8
"""Staircase: within this share of the tolerance the next interval is longer."""
_LONGER, _SHORTER = 1.25, 0.7
KEPT_AFTER: Final = 100
"""New outlooks that are kept at once."""
_FITS: Final = 0.01
"""A jump goes to another table if that would show more in one of a hundred such curves."""
_CLEARLY: Final = 10.0
"""Logarithm of the likelihood ratio from which another table explains a curve better."""
Kind = Literal["jump", "drift", "wear", "beyond", "verdict", "event", "swapped"]


@dataclass(frozen=True)
class TableFinding:
    """Something that a person has to look at, and when it was seen."""

    kind: Kind
    time_ns: int
    words: Phrase


@dataclass(frozen=True)
class DeviationOutlook:
    """One deviation of a table, SI; times in ns since 1970.

    ``largest`` |deviation| of each campaign at ``times_ns``. ``rate`` per year with its standard
    uncertainty, at the ``angle`` (rad) that moves most; ``moved``: more than chance explains.
    ``wearing``: its drift changes itself. ``harmonics`` holds order, change per year and its
    standard uncertainty of each coefficient: cosine and sine by turns on a circle.
    ``due_ns`` is None where nothing can be forecast. ``probability`` is that of conformity on the
    day of the newest campaign. ``intervals_days`` by method. ``per_kelvin`` is the temperature
    coefficient at that angle and its standard uncertainty. ``alarm`` is the campaign of a jump;
    ``expected`` (2, p) what the earlier campaigns said of it, or of the newest, and ``found`` (p,)
    what it showed.
    """

    component: str
    tolerance: float
    times_ns: tuple[int, ...]
    largest: tuple[float, ...]
    decision: str
    notes: tuple[str, ...]
    rate: float | None = None
    rate_std: float = 0.0
    angle: float = 0.0
    moved: bool = False
    wearing: bool = False
    harmonics: tuple[tuple[int, float, float], ...] = ()
    due_ns: int | None = None
    probability: float | None = None
    intervals_days: tuple[tuple[str, float], ...] = ()
    per_kelvin: tuple[float, float] | None = None
    alarm: int | None = None
    expected: tuple[tuple[float, ...], ...] = ()
    found: tuple[float, ...] = ()

    @property
    def trend(self) -> str:
        """The drift for people."""
        if self.rate is None:
            return "—"
        unit, label = unit_of(self.component)
        text = f"{self.rate / unit:+.2g} ± {COVERAGE_FACTOR * self.rate_std / unit:.2g}"
        where = f"{self.angle / DEGREE:.4g}"
        return phrase("{0} {1} {2}/year at {3}°", self.component, text, label, where)


@dataclass(frozen=True)
class Outlook(AxisIdentity):
    """What is known of one axis; times in ns since 1970, ``due_ns`` with the ``reason``."""

    results: int
    last_ns: int
    verdict: str
    verdict_line: Phrase
    covered: bool
    measured_on: str
    due_ns: int
    reason: Phrase
    findings: tuple[TableFinding, ...]
    deviations: tuple[DeviationOutlook, ...]

    @property
    def trend(self) -> str:
        """The largest drift in terms of its tolerance or, without one, of its uncertainty."""
        known = [d for d in self.deviations if d.rate is not None]
        shown = [d for d in known if d.moved]
        if not shown:
            return phrase("no change seen") if known else "—"
        return max(shown, key=lambda d: abs(d.rate or 0.0) / (d.tolerance or d.rate_std)).trend

    @property
    def last(self) -> str:
        """The day of the newest result."""
        return day_of(self.last_ns)

    @property
    def due(self) -> str:
        """The day on which it is due."""
        return day_of(self.due_ns)

    @property
    def urgent(self) -> tuple[TableFinding, ...]:
        """The findings that a person has to look at now: all but a mere drift."""
        return tuple(found for found in self.findings if found.kind != "drift")


def all_outlooks(
    history: ParkHistory,
    settings: HistorySettings,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> list[Outlook]:
    """Return the outlooks of all axes with results, by serial number.

    They are computed where something is new.
    """
    items, bases = _bases(history, settings)
    known, new, found = history.forecasts(bases), dict[str, str](), list[Outlook]()
    for done, (item, basis) in enumerate(zip(items, bases, strict=True), 1):
        view = None
        with suppress(ValueError, KeyError):
            kept = json.loads(known[basis])
            view = record(Outlook, with_codes(kept, kept.pop("codes")))
        if view is None and (view := axis_outlook(history, item, settings)) is not None:
            new[basis] = json.dumps(_kept(view), allow_nan=False)
        if view is not None:
            found.append(view)
        if len(new) >= KEPT_AFTER or done == len(items):
            with suppress(BagError):  # a history that may only be read is shown all the same
                history.note_forecasts(new)
            new.clear()
        progress(done, len(items))
    return _with_swaps(found)


def _kept(view: Outlook) -> dict[str, Any]:
    """Return an outlook as it is kept, with the codes of its texts."""
    found = asdict(view)
    return {**found, "codes": codes_of(found)}


def _bases(
    history: ParkHistory, settings: HistorySettings
) -> tuple[list[RegisteredAxis], list[str]]:
    """Return all axes, and what identifies the forecast of each: its entries and the settings."""
    plain = replace(settings, database="", period_s=1.0)  # the others change what is forecast
    items, hashes = history.items(), history.bases()
    texts = (f"{VERSION} {plain} {hashes.get(item.id)}" for item in items)
    return items, [sha256(text.encode()).hexdigest() for text in texts]


def changed_forecasts(history: ParkHistory, settings: HistorySettings) -> list[str]:
    """Return in a sentence each which kept forecasts do not follow from their entries.

    Those for these settings are made again: entries have hashes of their own, forecasts have not.
    """
    items, bases = _bases(history, settings)
    known, wrong = history.forecasts(bases), list[str]()
    for item, basis in zip(items, bases, strict=True):
        if basis not in known:
            continue
        view = axis_outlook(history, item, settings)
        again = None if view is None else json.loads(json.dumps(_kept(view)))
        kept = None
        with suppress(ValueError):
            kept = json.loads(known[basis])
        if not _alike(kept, again):
            due = "" if view is None else f", by which it is due {view.due}"
            wrong.append(f"{item.title}: its kept forecast is not that of its entries{due}")
    return wrong


def _alike(kept: Any, again: Any) -> bool:
    """Return whether both say the same, but for the last digits of another processor."""
    if isinstance(again, dict) and isinstance(kept, dict):
        return kept.keys() == again.keys() and all(_alike(kept[n], again[n]) for n in again)
    if isinstance(again, list) and isinstance(kept, list):
        return len(kept) == len(again) and all(map(_alike, kept, again))
    if isinstance(again, float) and isinstance(kept, int | float):
        return isclose(kept, again, rel_tol=_SAME, abs_tol=_SAME * ARCSEC)
    if isinstance(again, int) and isinstance(kept, int):
        return abs(kept - again) <= (DAY_NS if max(kept, again) > DAY_NS else 0)
    return bool(kept == again)


def axis_outlook(
    history: ParkHistory, item: RegisteredAxis, settings: HistorySettings
) -> Outlook | None:
    """Return the outlook of one axis; None for one without results."""
    campaigns, entries = history.campaigns(item), history.of_item(item)
    if not campaigns:
        return None
    newest = campaigns[-1]
    found = make_deviation_series(campaigns, entries, settings.common_share)
    each = tuple(_of_deviation(curves, settings) for curves in found.values())
    findings = [f for view in each for f in _findings(view)]
    line = result_of(history.entry(newest.entry_id)).verdict_line
    if newest.verdict != "ok":
        words = phrase("the newest result is {0}: measure again", line)
        findings.insert(0, TableFinding("verdict", newest.measured_ns, words))
    for event in (e for e in entries if e.kind == EVENT and e.measured_ns > newest.measured_ns):
        words = phrase("{0} on {1}, after the newest result: measure again", event.what, event.day)
        findings.insert(0, TableFinding("event", event.measured_ns, words))
    due_ns, reason = _due(newest, each, findings, settings)
    reason = join_texts([reason, *(found.words for found in findings if found.kind == "wear")])
    return Outlook(
        serial=item.serial, axis=item.axis, results=len(campaigns),
        last_ns=newest.measured_ns, verdict=newest.verdict, verdict_line=line,
        covered=newest.covered, measured_on=newest.measured_on, due_ns=due_ns, reason=reason,
        findings=tuple(findings), deviations=each,
    )  # fmt: skip


def deviation_series(
    history: ParkHistory, item: RegisteredAxis, component: str, settings: HistorySettings
) -> DeviationSeries:
    """Return the series of one deviation of an axis; DataError with fewer than two results."""
    found = make_deviation_series(
        history.campaigns(item), history.of_item(item), settings.common_share
    )
    curves = found.get(component)
    if curves is None or len(curves.campaigns) < 2:
        raise DataError(
            f"{item.title} has fewer than two results of {component} that can be compared: add "
            "more, or choose another component"
        )
    return curves


def _due(
    newest: Campaign,
    each: Sequence[DeviationOutlook],
    findings: Sequence[TableFinding],
    settings: HistorySettings,
) -> tuple[int, Phrase]:
    """Return when a table is due, and why."""
    pressing = [f for f in findings if f.kind not in ("drift", "wear")]
    if pressing:
        return min(f.time_ns for f in pressing), pressing[0].words
    latest = newest.measured_ns + round(settings.longest_days * DAY_NS)
    forecast = [d for d in each if d.due_ns is not None]
    if not forecast:
        agreed = newest.measured_ns + round(settings.interval_days * DAY_NS)
        few, none = phrase("fewer than 3 results"), phrase("no tolerance agreed")
        why = few if any(d.tolerance for d in each) else none
        if not each:
            why = phrase("no curves that can be compared")
        words = phrase("{0} days, as agreed ({1})", f"{settings.interval_days:g}", why)
        return min(agreed, latest), words
    first = min(forecast, key=lambda d: d.due_ns or 0)
    if (first.due_ns or 0) >= latest:
        return latest, phrase("{0} days, the longest interval", f"{settings.longest_days:g}")
    chance = f"{100.0 * settings.promise:g} %"
    words = phrase("{0} is within its tolerance with {1} until then", first.component, chance)
    return first.due_ns or 0, words


def _findings(view: DeviationOutlook) -> list[TableFinding]:
    name, newest, jumped = view.component, view.times_ns[-1], view.alarm is not None
    jump_ns = view.times_ns[-1 if view.alarm is None else view.alarm]
    jump = phrase(
        "{0} jumped before {1}: look at the table, then note what happened as an event", name,
        day_of(jump_ns)
    )  # fmt: skip
    beyond = phrase("{0} is beyond its tolerance", name)
    wear = phrase("{0} does not drift evenly: something wears, such as a bearing", name)
    possible = (
        (jumped, TableFinding("jump", jump_ns, jump)),
        (view.decision == "beyond", TableFinding("beyond", newest, beyond)),
        (view.wearing and not jumped, TableFinding("wear", newest, wear)),
        (view.moved, TableFinding("drift", newest, phrase("drift: {0}", view.trend))),
    )
    return [finding for seen, finding in possible if seen]


def _of_deviation(curves: DeviationSeries, settings: HistorySettings) -> DeviationOutlook:
    name, tolerance, curve = curves.component, curves.tolerance, curves.newest
    times = tuple(c.measured_ns for c in curves.campaigns)
    largest = tuple(float(np.max(np.abs(c.curves[name].deviation))) for c in curves.campaigns)
    decision = (
        decide_conformity(curve.deviation, std_of(curve.covariance), tolerance)
        if tolerance
        else ""
    )
    plain = DeviationOutlook(name, tolerance, times, largest, decision, curves.notes)
    if len(times) < 2:
        return plain
    trend = fit_trend(curves.series)
    alarm = _alarm(trend, "t2")
    watched = len(times) - 1 if alarm is None else alarm
    found = replace(
        _changing(plain, curves, trend), alarm=alarm, wearing=_alarm(trend, "cusum") is not None,
        expected=tuple(tuple(row.tolist()) for row in trend.expected(watched)),
        found=tuple(curves.series.values[watched].tolist()),
    )  # fmt: skip
    since = int(np.sum(curves.series.steps == curves.series.steps[-1]))
    if not tolerance or since < ENOUGH or times[0] == times[-1]:
        return found
    due_ns, probability = due_date(curves, trend, tolerance, settings)
    days = (
        (phrase("model"), (due_ns - times[-1]) / DAY_NS),
        (phrase("staircase"), _staircase(found, settings)),
        (phrase("control chart"), _control_chart(found, since, settings)),
    )
    return replace(found, due_ns=due_ns, probability=probability, intervals_days=days)


def due_date(
    curves: DeviationSeries, trend: Trend, tolerance: float, settings: HistorySettings
) -> tuple[int, float]:
    """Return the last moment (ns) at which the promise holds, and the probability today.

    Today is the time of the newest campaign. The moment is that of the newest campaign if the
    promise does not even hold then, and at most ``longest_days`` later.
    """
    begun = int(curves.series.times_ns[-1])
    rest = curves.draw_residuals(DRAWS)

    def conforming(times_ns: Ints) -> Floats:
        drawn = curves.curves_of(trend.forecast(times_ns), rest)
        return np.asarray(np.mean(np.max(np.abs(drawn), axis=2) <= tolerance, axis=0))

    times = np.linspace(begun, begun + round(settings.longest_days * DAY_NS), _DATES + 1)
    held = conforming(times.astype(np.int64))
    broken = np.flatnonzero(held < settings.promise)
    if not len(broken) or broken[0] == 0:
        return int(times[0] if len(broken) else times[-1]), float(held[0])
    low, high = times[broken[0] - 1], times[broken[0]]
    while high - low > _EXACT_NS:
        middle = (low + high) / 2.0
        good = conforming(np.array([middle], dtype=np.int64))[0] >= settings.promise
        low, high = (middle, high) if good else (low, middle)
    return int(low), float(held[0])


def expected_curve(curves: DeviationSeries, trend: Trend, time_ns: int) -> tuple[Floats, Floats]:
    """Return the curve (n,) that is expected at a time, and its covariance (n, n)."""
    modes = trend.forecast(np.array([time_ns], dtype=np.int64))
    drawn = curves.curves_of(modes, curves.draw_residuals(DRAWS))[:, 0]
    return drawn.mean(axis=0), np.atleast_2d(np.cov(drawn.T))


def _changing(view: DeviationOutlook, curves: DeviationSeries, trend: Trend) -> DeviationOutlook:
    """Return a deviation with how it changes, by time and temperature, where it does most."""
    moved, std, years = trend.change()
    curve, deviation = curves.basis @ moved, np.sqrt(curves.basis**2 @ std**2)
    at, kelvin = int(np.argmax(np.abs(curve))), trend.per_kelvin()
    row = curves.basis[at]
    by_kelvin = kelvin and (float(row @ kelvin[0]), float(np.sqrt(row**2 @ kelvin[1] ** 2)))
    view = replace(view, angle=float(curves.newest.angles[at]), per_kelvin=by_kelvin)
    if years <= 0.0:
        return view
    by_mode = (each.tolist() for each in (trend.series.orders, moved / years, std / years))
    return replace(
        view, rate=float(curve[at] / years), rate_std=float(deviation[at] / years),
        moved=bool(np.any(np.abs(moved) > _SIGNIFICANT * std)),
        harmonics=tuple(zip(*by_mode, strict=True)),
    )  # fmt: skip


def _alarm(trend: Trend, chart: Chart) -> int | None:
    """Return the newest campaign that forecasts do not explain; false for one table in 370.

    T2 finds jumps, a CUSUM what wears.
    """
    run_length = FALSE_ALARM * max(1, len(trend.surprise) - 1)
    found = chart_alarms(chart, trend.surprise, run_length)
    since = int(np.searchsorted(trend.series.steps, trend.series.steps[-1]))
    return next((row for row in reversed(found) if row > since), None)


def _staircase(view: DeviationOutlook, settings: HistorySettings) -> float:
    """Return the next interval (days) by method 1 of OIML D 10: automatic adjustment."""
    days = settings.interval_days
    for value in view.largest[1:]:
        days *= _LONGER if value <= _CLOSE * view.tolerance else _SHORTER
        days = min(max(days, 1.0), settings.longest_days)
    return days


def _control_chart(view: DeviationOutlook, since: int, settings: HistorySettings) -> float:
    """Return the next interval (days) by method 2 of OIML D 10: drift and scatter of a chart."""
    times, largest = np.array(view.times_ns[-since:]), np.array(view.largest[-since:])
    years = (times - times[0]) / YEAR_NS
    slope, level = np.polyfit(years, largest, 1)
    left = largest - level - slope * years
    scatter = float(np.sqrt(np.sum(left**2) / max(1, since - 2)))
    room = view.tolerance - COVERAGE_FACTOR * scatter - (level + slope * years[-1])
    if room <= 0.0:
        return 0.0
    days = settings.longest_days if slope <= 0.0 else 365.25 * room / slope
    return float(min(days, settings.longest_days))


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
            day_of(time_ns), other.title
        )  # fmt: skip
        findings = (TableFinding("swapped", time_ns, words), *view.findings)
        due_ns = min(view.due_ns, time_ns)
        named[number] = replace(view, findings=findings, due_ns=due_ns, reason=words)
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
