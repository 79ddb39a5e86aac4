"""Readings of a tracer on a table that turned: of a table, or of streams without orders.

Each row is one reading, and where the feedback of the table was at that moment; an empty length
is a broken beam. Turns are found by themselves: one goes from before the first angle to behind the
last, or back, at one of the speeds if they are stated. Where the tracer stands at several places
of the table, a column ``place`` numbers them; in streams, each place has all its turns one after
the other. Readings become lengths as live ones do.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from math import ceil, fsum
from typing import Final

import numpy as np

from rotcal_ros.capture.passage import (
    Passage,
    missing_readings,
    reduce_passing_lengths,
    why_no_reading_counts,
)
from rotcal_ros.capture.unordered import UnorderedStreams
from rotcal_ros.capture.window import SEQUENCE, ReadingFault, ReducedWindow
from rotcal_ros.foundation.arrays import Floats, Ints, Stamps
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.language import NOTHING
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.tables import Table, table_hashes
from rotcal_ros.foundation.units import DEGREE, NANOSECOND, TURN
from rotcal_ros.methods.calibration import Calibration
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.measurements import LATEST_S, TIME, PlannedMeasurements
from rotcal_ros.methods.tracer.lengths import LengthCheck
from rotcal_ros.methods.tracer.turning_table import (
    AS_STATED,
    PLACE,
    TurningTables,
    places_stated,
    planned,
    run_of,
    speeds_of,
    stated,
)
from rotcal_ros.planning.plan import Point, Step
from rotcal_ros.planning.table_angles import table_angles

_TURN_DEG: Final = TURN / DEGREE
_LEAST: Final = 3
"""Readings in a turn, without which it has no speed."""


@dataclass(frozen=True, eq=False)
class _RawReadings:
    """All readings of a ``source``, (n,): stamps, ns, and degrees without a wrap.

    ``values`` (n, 3) are those of an admitted tracer stream. ``beam``: how often the zero of the
    lengths was lost before. ``target`` and ``place`` are None where nothing names them.
    ``begin_ns``: from when on seconds count for people.
    """

    source: str
    stamps: Stamps
    angle_deg: Floats
    values: Floats
    beam: Ints
    place: Ints | None = None
    target: Ints | None = None
    begin_ns: int = 0

    @classmethod
    def of(cls, table: Table) -> _RawReadings:
        """Return those of a table; raises DataError, with the row, for what is no number."""
        rows = table.rows()
        time = np.array([row.number(TIME) for row in rows])
        angle = np.array([row.number("angle_deg") for row in rows])
        length = np.array([
            row.metres("length_m") if row.cells["length_m"].strip() else np.nan for row in rows
        ])  # fmt: skip
        target = [row.index("target") for row in rows] if "target" in table.header else None
        place = [row.index(PLACE) for row in rows] if PLACE in table.header else None
        if (back := np.flatnonzero(np.diff(time) <= 0.0)).size:
            raise DataError(f"{rows[int(back[0]) + 1].place}: {TIME} does not grow")
        if np.abs(time[[0, -1]]).max() > LATEST_S:
            raise DataError(f"{table.path}: {TIME} is {time[-1]:g} s; are these milliseconds?")
        whole = np.unwrap(angle, period=_TURN_DEG)
        dark = np.isnan(length)
        fault = np.where(dark, ReadingFault.BEAM_BROKEN, ReadingFault.NONE)
        return cls(
            str(table.path),
            np.round(time / NANOSECOND).astype(np.int64),
            whole,
            np.column_stack([np.arange(len(time)), length, fault]),
            np.cumsum(dark),
            None if place is None else np.array(place),
            None if target is None else np.array(target),
        )

    def seconds(self, rows: slice) -> Floats:
        """Return when ``rows`` were read."""
        return np.asarray((self.stamps[rows] - self.begin_ns) * NANOSECOND)

    def about(self, middle_deg: float) -> _RawReadings:
        """Return them with angles, whole turns apart, as near to ``middle_deg`` as can be."""
        own = 0.5 * (self.angle_deg.min() + self.angle_deg.max())
        turns = round((middle_deg - own) / _TURN_DEG)
        return replace(self, angle_deg=self.angle_deg + turns * _TURN_DEG)


@dataclass(frozen=True, eq=False)
class _FoundTurn:
    """One turn: the ``rows`` of its readings, its ``speed`` (deg/s), ``place`` and ``target``."""

    rows: slice
    speed: float
    place: int = -1
    target: int = -1


def read(
    form: TurningTables, configuration: Configuration, table: Table, targets: tuple[Point, ...]
) -> PlannedMeasurements:
    """Return the lengths at the table angles, of the readings in a ``table``.

    ``targets``: in place of the plan's. Without angles in the set-up, a whole turn by degrees.
    Raises DataError where there are no turns, or none knows which targets they are of.
    """
    calibration, seen = _lengths(form, configuration, _RawReadings.of(table), targets)
    return PlannedMeasurements(calibration, seen, table_hashes(table))


def of_streams(
    form: TurningTables, configuration: Configuration, streams: UnorderedStreams, source: str
) -> PlannedMeasurements:
    """Return the lengths at the table angles of streams that nobody ordered, as :func:`read`."""
    if not places_stated(configuration):
        raise ConfigurationError(
            f"{source} needs the places of its targets, and {configuration.source} states none: "
            "state plan.targets_m, targets_file, or box_centre_m, box_size_m and box_points"
        )
    stamps, angle, values, beam = streams.readings(configuration.capture)
    readings = _RawReadings(source, stamps, angle / DEGREE, values, beam, begin_ns=int(stamps[0]))
    return PlannedMeasurements(*_lengths(form, configuration, readings, ()))


def _lengths(
    form: TurningTables,
    configuration: Configuration,
    readings: _RawReadings,
    targets: tuple[Point, ...],
) -> tuple[Calibration, tuple[Observation, ...]]:
    """Return the plan that readings show, and its lengths."""
    passing = configuration.plan.passing_deg
    wanted = _wanted(configuration, readings)
    readings = readings.about(0.5 * (wanted[0] + wanted[-1]))
    found = _turns(readings, wanted[0] - passing, wanted[-1] + passing)
    if speeds := configuration.plan.turning_deg_s:
        found = [turn for turn in found if any(_alike(turn.speed, speed) for speed in speeds)]
    else:
        speeds = speeds_of(turn.speed for turn in found)
    calibration = planned(form, configuration, wanted, speeds, targets)
    places, of = form.count(calibration.plan), len(calibration.plan.targets)
    found = _with_places(found, readings, places, of * len(speeds))
    found = _with_targets(found, readings, of, len(speeds), places)
    steps = form.steps(calibration.plan)
    check, observations = LengthCheck(calibration.plan), list[Observation]()
    attempts = Counter[tuple[int, int, int]]()
    for number, turn in enumerate(found):
        place = f"{readings.source}, from {readings.seconds(turn.rows)[0]:.6g} s on"
        run = run_of(turn.speed, turn.speed, place, speeds)
        count = len(wanted)
        sense = 1 if turn.speed > 0.0 else -1
        passed = [steps[turn.place, run, k, turn.target] for k in range(count)][::sense]
        for step in passed:
            seen = _observed(readings, turn, step, calibration, number)
            seen = replace(seen, attempt=attempts[turn.place, run, turn.target])
            observations.append(check(seen))
        attempts[turn.place, run, turn.target] += 1
    return calibration, tuple(observations)


def _alike(own: float, stated_deg_s: float) -> bool:
    """Return whether a turn was made at a speed that is stated, and is not a way to the next."""
    return abs(own - stated_deg_s) <= AS_STATED * abs(stated_deg_s)


def _wanted(configuration: Configuration, readings: _RawReadings) -> Floats:
    """Return the angles (n,), deg: those of the set-up, or all degrees of a turn."""
    if stated(configuration):
        return np.array(table_angles(configuration.plan)) / DEGREE
    least, most = float(readings.angle_deg.min()), float(readings.angle_deg.max())
    if most - least < _TURN_DEG + 2.0 * configuration.plan.passing_deg:
        raise DataError(
            f"{readings.source}: the table turned from {least:.4g} to {most:.4g} deg, which "
            "is no whole turn: at which angles are lengths wanted? State plan.table_start_deg, "
            "table_step_deg and table_positions"
        )
    first = ceil(0.5 * (least + most) - 0.5 * _TURN_DEG)
    return np.arange(first, first + _TURN_DEG)


def _turns(readings: _RawReadings, first_deg: float, last_deg: float) -> list[_FoundTurn]:
    """Return the turns that pass all from one angle to the other, either way, in their order."""
    angle = readings.angle_deg
    outside = np.flatnonzero((angle <= first_deg) | (angle >= last_deg))
    side = angle[outside] >= last_deg
    found = list[_FoundTurn]()
    for at in np.flatnonzero(side[1:] != side[:-1]).tolist():
        rows = slice(int(outside[at]), int(outside[at + 1]) + 1)
        if rows.stop - rows.start < _LEAST:
            continue
        time, way = readings.seconds(rows), angle[rows]
        found.append(_FoundTurn(rows, float((way[-1] - way[0]) / (time[-1] - time[0]))))
    if not found:
        raise DataError(
            f"{readings.source}: the table never turned from {first_deg:g} to {last_deg:g} "
            f"deg or back, it went from {angle.min():.4g} to {angle.max():.4g} deg: correct the "
            "angles that the plan wants, or plan.passing_deg"
        )
    return found


def _with_places(
    found: list[_FoundTurn], readings: _RawReadings, places: int, each: int
) -> list[_FoundTurn]:
    """Return the turns with their places: by the column, or ``each`` of them, in their order."""
    if readings.place is not None:
        numbers = [_number_of(t, readings, PLACE, readings.place, places) for t in found]
    elif places == 1:
        numbers = [0] * len(found)
    elif len(found) == places * each:
        numbers = [k // each for k in range(len(found))]
    else:
        raise DataError(
            f"{readings.source}: found {len(found)} turns, expected {each} at each of {places} "
            "places, one place after the other: which turn was made where? Give the readings as a "
            f"table with a column {PLACE}"
        )
    return [replace(turn, place=number) for turn, number in zip(found, numbers, strict=True)]


def _with_targets(
    found: list[_FoundTurn], readings: _RawReadings, targets: int, speeds: int, places: int
) -> list[_FoundTurn]:
    """Return the turns with their targets: by the column, or as many for each, in their order."""
    if readings.target is not None:
        numbers = [_number_of(t, readings, "target", readings.target, targets) for t in found]
        return [replace(turn, target=k) for turn, k in zip(found, numbers, strict=True)]
    here = Counter(turn.place for turn in found)
    for place in range(places):
        if here[place] != targets * speeds:
            where = f" at place {place}" if places > 1 else ""
            raise DataError(
                f"{readings.source}: found {here[place]} turns{where}, expected one at each "
                f"of {speeds} speeds for each of {targets} targets: which target was which turn "
                "of? Add a column target"
            )
    before = Counter[int]()
    named = list[_FoundTurn]()
    for turn in found:
        named.append(replace(turn, target=before[turn.place] // speeds))
        before[turn.place] += 1
    return named


def _number_of(
    turn: _FoundTurn, readings: _RawReadings, what: str, column: Ints, count: int
) -> int:
    """Return the number in a ``column`` (n,) that all readings of a ``turn`` have."""
    numbers = np.unique(column[turn.rows])
    if len(numbers) > 1 or numbers[0] >= count:
        raise DataError(
            f"{readings.source}: the turn from {readings.seconds(turn.rows)[0]:.6g} s on is of "
            f"{what} {', '.join(map(str, numbers.tolist()))}, expected one of 0 to {count - 1}"
        )
    return int(numbers[0])


def _observed(
    readings: _RawReadings, turn: _FoundTurn, step: Step, calibration: Calibration, number: int
) -> Observation:
    """Return what readings beside its angle make of a ``step``; judged as in a live cell.

    ``number`` of the turn, each of which has a zero of its own.
    """
    settings, sense = calibration.configuration.capture, float(np.sign(turn.speed))
    ahead = sense * (readings.angle_deg[turn.rows] * DEGREE - step.table_angle)
    at = int(np.flatnonzero(ahead >= 0.0)[0])
    first = int(np.flatnonzero(ahead[:at] <= -step.passing)[-1])
    last = at + int(np.flatnonzero(ahead[at:] >= step.passing)[0])
    rows = slice(turn.rows.start + first, turn.rows.start + last + 1)
    stamps, values = readings.stamps[rows], readings.values[rows]
    passed = Passage(stamps, ahead[first : last + 1])
    near = np.abs(passed.ahead) < step.passing
    away, beam = passed.ahead[near], readings.beam[rows][near]
    if reason := why_no_reading_counts(passed, away, step, settings):
        reduced = ReducedWindow(reason=reason)
    else:
        missing = missing_readings(values[:, SEQUENCE], passed.ahead, step.passing)
        reduced = reduce_passing_lengths(away, values[near], missing, settings)
    return replace(
        step.observed(reduced.mean),
        std=reduced.std,
        scatter=reduced.scatter,
        n_samples=int(near.sum()),
        n_used=reduced.n_used,
        accepted=not reduced.reason,
        reason=reduced.reason or NOTHING,
        table_angle_measured=step.table_angle + sense * fsum(away) / max(len(away), 1),
        window_start_ns=int(stamps[0]),
        window_end_ns=int(stamps[-1]),
        segment=number + int(beam[:1].sum() + beam[-1:].sum()),
    )
