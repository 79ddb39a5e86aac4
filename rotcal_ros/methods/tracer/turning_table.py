"""Lengths of a table that turned, as a table: ``angle_deg,target,direction,length_m``.

``direction`` is 1 for growing angles and -1 for the way back; a last column ``time_s`` tells when
each length was read. Angles and speeds are those of the rows, so a set-up need not state them. A
turn begins with another target or direction, and where an angle comes again. Where the tracer
stands at several places of the table, a first column ``place`` numbers them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.tables import Header, Row, Table, table_hashes
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.methods.calibration import Calibration
from rotcal_ros.methods.configuration import (
    Configuration,
    parse_configuration,
    raw_groups,
    replaced,
)
from rotcal_ros.methods.measurements import TIME, PlannedMeasurements, read_at
from rotcal_ros.methods.tracer.lengths import LengthCheck
from rotcal_ros.planning.plan import Plan, Point, Step
from rotcal_ros.planning.table_angles import ANGLE_SETTINGS, table_angles

PLACE: Final = "place"
_LENGTHS: Final = ("angle_deg", "target", "direction", "length_m")
_READINGS: Final = (TIME, "angle_deg", "length_m")
SENSES: Final = {"1": 1.0, "+1": 1.0, "+": 1.0, "-1": -1.0, "-": -1.0}
SAME_DEG: Final = 1e-6
"""Angles that differ by less are one."""
ALIKE: Final = 0.05
"""Speeds that differ by less than this share are one."""
PLACES: Final = (
    "targets_m", "targets_file", "box_centre_m", "box_size_m", "box_points",
)  # fmt: skip
"""Settings of a plan that say where the targets are."""
AS_STATED: Final = 0.2
"""Share by which a table may turn faster or slower than stated."""


@dataclass(frozen=True)
class TurningTables:
    """The tables of a method whose table turned, and the plan that they are of.

    ``plan`` makes it, checked, of a configuration and the targets (m); to the configuration's own
    without. ``places``: the tracer stands at several, which are the stations of steps, and table
    positions count on from speed to speed; else stations are the speeds.
    """

    plan: Callable[[Configuration, tuple[Point, ...]], Plan]
    places: bool = False

    @property
    def lengths(self) -> tuple[Header, ...]:
        """The headers of tables of lengths."""
        columns = (PLACE,) * self.places + _LENGTHS
        return columns, (*columns, TIME)

    @property
    def readings(self) -> tuple[Header, ...]:
        """The headers of tables of readings."""
        columns = _READINGS + (PLACE,) * self.places
        return columns, (*columns, "target")

    @property
    def headers(self) -> tuple[Header, ...]:
        """The headers of all of them."""
        return *self.lengths, *self.readings

    def steps(self, plan: Plan) -> dict[tuple[int, int, int, int], Step]:
        """Return the steps that turns of a ``plan`` pass, by place, run, angle and target."""
        count, found = len(plan.distinct_angles), dict[tuple[int, int, int, int], Step]()
        for step in plan.steps:
            place, run, angle = 0, step.station, step.table_position
            if self.places:
                place, (run, angle) = step.station, divmod(step.table_position, count)
            if step.turn is not None:
                found[place, run, angle, step.target] = step
        return found

    def count(self, plan: Plan) -> int:
        """Return at how many places the tracer stands."""
        return 1 + max(step.station for step in plan.steps) if self.places else 1


@dataclass(frozen=True, eq=False)
class _Turn:
    """Rows of one unbroken turn, in the order of the table; ``speed`` in deg/s, 0: not known."""

    place: int
    target: int
    sense: float
    rows: tuple[Row, ...]

    @property
    def angles_deg(self) -> Floats:
        """The angles (e,) of its rows."""
        return np.array([row.number("angle_deg") for row in self.rows])

    @property
    def speed(self) -> float:
        """Its speed, deg/s, negative for back, by its times; 0: there are none."""
        if TIME not in self.rows[0].cells or len(self.rows) < 2:
            return 0.0
        when = np.array([row.number(TIME) for row in self.rows])
        if not (np.diff(when) > 0.0).all():
            raise DataError(
                f"{self.rows[0].place}: {TIME} does not grow in the turn that begins here"
            )
        return float(np.median(np.diff(self.angles_deg) / np.diff(when)))


def read(
    form: TurningTables, configuration: Configuration, table: Table, targets: tuple[Point, ...]
) -> PlannedMeasurements:
    """Return the lengths of the turns in a ``table``, to ``targets``; those of the plan without.

    Raises DataError, with the row, for what cannot be, ConfigurationError for speeds that neither
    times nor the set-up tell.
    """
    turns = _turns(table)
    every = np.sort(np.concatenate([turn.angles_deg for turn in turns]))
    angles = every[np.append(True, np.diff(every) > SAME_DEG)]
    _require_stated(configuration, angles, table)
    speeds = configuration.plan.turning_deg_s or _speeds(table, turns)
    calibration = planned(form, configuration, angles, speeds, targets)
    steps, places = form.steps(calibration.plan), form.count(calibration.plan)
    check, observations = LengthCheck(calibration.plan), list[Observation]()
    for number, turn in enumerate(turns):
        run = run_of(turn.sense, turn.speed, turn.rows[0].place, speeds)
        for row, angle in zip(turn.rows, turn.angles_deg.tolist(), strict=True):
            position = int(np.abs(angles - angle).argmin())
            step = steps.get((turn.place, run, position, turn.target))
            if step is None:
                where = (
                    (f"place {turn.place}, ", f" at {places} places") if form.places else ("", "")
                )
                raise DataError(
                    f"{row.place}: {where[0]}target {turn.target} is not one of the "
                    f"{len(calibration.plan.targets)} targets{where[1]} of {configuration.source}"
                )
            read = step.observed((row.metres("length_m"),))
            observation = check(replace(read_at(row, read), segment=number))
            if not observation.accepted:
                raise DataError(f"{row.place}: {observation.reason}")
            observations.append(observation)
    return PlannedMeasurements(calibration, tuple(observations), table_hashes(table))


def _turns(table: Table) -> list[_Turn]:
    """Return the turns of a table, in their order."""

    def kind(row: Row) -> tuple[int, int, float]:
        sense = SENSES.get(row.cells["direction"])
        if sense is None:
            raise DataError(
                f"{row.place}: direction must be 1 (angles grow) or -1 (back), found "
                f"{row.cells['direction']!r}: correct the row"
            )
        return row.index(PLACE) if PLACE in table.header else 0, row.index("target"), sense

    found = list[_Turn]()
    for (place, target, sense), group in groupby(table.rows(), kind):
        rows = list(group)
        along = sense * np.array([row.number("angle_deg") for row in rows])
        ends = [*(np.flatnonzero(np.diff(along) <= SAME_DEG) + 1).tolist(), len(rows)]
        for begin, end in zip([0, *ends[:-1]], ends, strict=True):
            found.append(_Turn(place, target, sense, tuple(rows[begin:end])))
    if not found:
        raise DataError(f"{table.path}: the table has no rows: nothing was measured")
    short = [turn for turn in found if len(turn.rows) == 1]
    if 2 * len(short) > len(found):
        raise DataError(
            f"{short[0].rows[0].place}: angles do not go the way that direction says, or rows are "
            "mixed: list the lengths of a turn one after the other, as they were read"
        )
    return found


def _speeds(table: Table, turns: list[_Turn]) -> tuple[float, ...]:
    """Return the speeds at which the table turned, deg/s, by the times of its rows."""
    if not any(turn.speed for turn in turns):
        raise ConfigurationError(
            f"{table.path} has no column {TIME}, and the set-up states no plan.turning_deg_s: how "
            "fast did the table turn? State its speeds, as [12, -12]"
        )
    return speeds_of(turn.speed for turn in turns if turn.speed)


def speeds_of(turns: Iterable[float]) -> tuple[float, ...]:
    """Return the different ones among the speeds of ``turns``, deg/s, forward ones first."""
    every = sorted(set(turns), key=lambda v: (v < 0.0, abs(v)))
    found = [[every[0]]]
    for speed in every[1:]:
        if abs(speed - found[-1][-1]) <= ALIKE * abs(speed):
            found[-1].append(speed)
        else:
            found.append([speed])
    return tuple(float(np.median(alike)) for alike in found)


def run_of(sense: float, own: float, place: str, speeds: tuple[float, ...]) -> int:
    """Return the number of the speed at which a turn was made.

    ``own`` is that which its times tell, deg/s, 0 for none; ``place`` stands in errors.
    """
    able = [k for k, speed in enumerate(speeds) if speed * sense > 0.0]
    if not able:
        raise DataError(
            f"{place}: direction {sense:g}, but plan.turning_deg_s, {list(speeds)}, has no "
            "speed of this sign: state it"
        )
    if not own:
        if len(able) > 1:
            raise DataError(
                f"{place}: at which of the speeds {[speeds[k] for k in able]} deg/s was this turn "
                f"made? Add a column {TIME}"
            )
        return able[0]
    best = min(able, key=lambda k: abs(speeds[k] - own))
    if abs(speeds[best] - own) > AS_STATED * abs(own):
        raise DataError(
            f"{place}: this turn was made at {own:.4g} deg/s by its times, plan.turning_deg_s "
            f"states {list(speeds)}: correct one of the two, or leave out plan.turning_deg_s"
        )
    return best


def stated(configuration: Configuration) -> list[str]:
    """Return the settings by which a set-up states table angles."""
    return [f"plan.{name}" for name in ANGLE_SETTINGS if f"plan.{name}" in configuration.given]


def places_stated(configuration: Configuration) -> bool:
    """Return whether a set-up says where its targets are."""
    return any(f"plan.{name}" in configuration.given for name in PLACES)


def _require_stated(configuration: Configuration, angles: Floats, table: Table) -> None:
    """Raise DataError for an angle (n,), deg, of a table that is none of those of a set-up."""
    if not (given := stated(configuration)):
        return
    known = np.array(table_angles(configuration.plan)) / DEGREE
    far = [a for a in angles.tolist() if np.abs(known - a).min() > SAME_DEG]
    if far:
        raise DataError(
            f"{table.path}: {far[0]:g} deg is none of the table angles of "
            f"{configuration.source} ({', '.join(given)}): leave them out, for the table "
            "states its own"
        )


def planned(
    form: TurningTables,
    configuration: Configuration,
    angles_deg: Floats,
    speeds: tuple[float, ...],
    targets: tuple[Point, ...],
) -> Calibration:
    """Return the calibration with these angles (n,), speeds (deg/s) and ``targets``."""
    _, groups = raw_groups(configuration.text, configuration.source)
    plan = {k: v for k, v in (groups.get("plan") or {}).items() if k not in ANGLE_SETTINGS}
    plan["table_angles_deg"] = [round(angle, 9) for angle in angles_deg.tolist()]
    plan["turning_deg_s"] = [round(v, 9) for v in speeds]
    text = replaced(configuration, "plan", plan)
    configuration = parse_configuration(text, configuration.source)
    return Calibration(configuration, form.plan(configuration, targets))
