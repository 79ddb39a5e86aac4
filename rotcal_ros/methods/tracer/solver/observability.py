"""What lengths cannot determine: the angle in a weak geometry, and how positions are numbered.

Counting comes first (Eq. 2), then the rank of each station's design, then the size of the
uncertainty: a station that is known worse than to a hundredth of the circle's radius makes every
first-order statement about the angle worthless. What is refused names the weak direction.

No length shows which table angle belongs to which station: with all positions renumbered by one
every length fits as well, and each deviation stands at its neighbour's angle; so it does where the
table's zero is another one. Where the tracer stands on the table decides it, if that was stated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, Final, TypeVar

import numpy as np

from rotcal_ros.adjust.diagnosis import Limits
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import DataError, GeometryError, ObservabilityError, RotcalError
from rotcal_ros.foundation.language import Phrase, noted, phrase
from rotcal_ros.foundation.protection import Protection
from rotcal_ros.foundation.results import Verdict
from rotcal_ros.foundation.units import DEGREE, MILLIMETRE
from rotcal_ros.methods.tracer.settings import TracerLimits
from rotcal_ros.methods.tracer.solver.circle import contrast_count
from rotcal_ros.methods.tracer.solver.problem import Grid

WOULD_SHOW: Final = noted(
    "positions that are numbered off by one or more put the tracer {0:.2g} mm or farther from "
    "where {1} has it"
)
MOVES_TOO_LITTLE: Final = noted(
    "{0}: the tracer moves {1:.2g} mm from one position to the next, and {2} is believed to "
    "{3:.2g} mm only"
)
STATE_THE_PLACE: Final = noted("{0}: state {1}, which would show it")
ROUND_THE_TABLE: Final = noted(
    "the tracer stands {0:.1f} degrees round the table, {1:.0f} mm, from where {2} has it"
)
NUMBERED_OFF: Final = noted(
    "{0}, which is {1}: the positions are numbered off by {2}, or the table's zero or {3} is "
    "wrong; every deviation may stand at the angle of another"
)

RANK_TOLERANCE: Final = 1e-12
"""Smallest eigenvalue of the mean outer product of the design's rows, relative to the largest."""
MOST_NAMED: Final = 3
"""Reasons for dropped lengths that a refusal quotes."""
CURE: Final = (
    "spread the targets in height and sideways, nearer to the tracer's height and to its sides"
)
HARDLY_MOVED_M: Final = 1e-3
"""Radius of the stations below which targets are no cure."""
NEVER_TURNED: Final = (
    "the stations hardly move: does the table turn, and does the tracer stand on it, away from "
    "its axis?"
)
Solution = TypeVar("Solution")
NEAR: Final = 0.02
"""Distance, m, to which a person knows where the tracer stands on the table."""


def limits_of(settings: TracerLimits) -> Limits:
    """Return what the engine holds for chance."""
    return Limits(
        settings.rejection_significance, settings.noise_significance, settings.max_rejected_share
    )


def prior_datum_advice(*, free: bool) -> str:
    """Return the advice to take the datum 'prior', for a network that does without: ``free``."""
    return ", or use the datum 'prior'" if free else ""


def check_counts(grid: Grid, dropped: Iterable[str] = ()) -> None:
    """Raise ObservabilityError unless there are lengths enough.

    m >= 4, and in a free network lengths >= 4 m + 3 n (Eq. 2); else as many as the 3 m unknowns
    of stations and s of zeros, less 2 (m - 3) where the stations stand on a stated circle, and in
    a free network with shared zeros as many as its 3 m + s + 3 n - 7 unknowns. ``dropped``: why
    lengths have no place on the grid.
    """
    m, n = grid.n_stations, grid.used.shape[1]
    lengths = int(grid.used.sum())
    missing = what_is_missing(m, n, lengths, grid.free and grid.zero is None, grid.station_minimum)
    needed = 3 * m + grid.n_zeros + (3 * n - 7 if grid.free else 0)
    needed -= 0 if grid.circle_std is None else contrast_count(m)
    if not missing and lengths < needed:
        missing = (
            f"{lengths} usable lengths from {m} stations to {n} targets with {grid.n_zeros} "
            f"unknown zero(s) are fewer than the {needed} that are needed: measure more targets, "
            "or look for what breaks the beam"
        )
    if missing:
        named = sorted({why for why in dropped if why.startswith("station")})[:MOST_NAMED]
        raise ObservabilityError("; ".join([missing, *named]))


def what_is_missing(m: int, n: int, lengths: int, free: bool, least: int) -> str | None:
    """Return what m stations and n targets lack; None when they can be solved (Eq. 2).

    A station is one with at least ``least`` usable lengths. Where the machine gives the targets,
    three coordinates of each are observed and their unknowns count for nothing: ``least`` m
    lengths are enough.
    """
    unknowns = 4 * m + 3 * n
    if m < 4:
        return (
            f"{m} stations with at least {least} usable lengths each, at least 4 are needed "
            "(Eq. 2): measure at more table angles"
        )
    if free and lengths < unknowns:
        return (
            f"{lengths} usable lengths from {m} stations to {n} targets are fewer than the "
            f"4 m + 3 n = {unknowns} unknowns (Eq. 2): measure more targets (with 4 stations at "
            "least 16) or more stations"
        )
    return None


def check_station_rank(design: Floats, position_ids: Ints) -> None:
    """Raise ObservabilityError where the rows ``design`` (m, n, 4) leave a direction open."""
    values, vectors = np.linalg.eigh(design.swapaxes(1, 2) @ design)
    weak = values[:, 0] < RANK_TOLERANCE * values[:, -1]
    if weak.any():
        j = int(np.flatnonzero(weak)[0])
        direction = vectors[j, :3, 0]
        raise ObservabilityError(
            f"station {position_ids[j]}: the targets cannot determine the tracer's place along "
            f"{name_direction(direction)}: {CURE}"
        )


def check_each_alone(grid: Grid, state: Floats, largest: float) -> None:
    """Raise ObservabilityError where lengths do not place a station of ``state`` (m, 4) alone.

    ``largest``: how well it has to be known, in radii of the circle. Targets are taken as known.
    """
    apart = state[:, None, :3] - grid.targets
    unit = apart / np.linalg.norm(apart, axis=2)[:, :, None]
    rows = np.concatenate([unit, -np.ones((*grid.used.shape, 1))], axis=2)
    check_station_rank(rows * grid.used[:, :, None], grid.position_ids)
    blocks = np.linalg.inv(rows.swapaxes(1, 2) @ (rows * grid.weights[:, :, None]))[:, :3, :3]
    check_station_spread(state[:, :3], blocks, grid.position_ids, largest)


def check_station_spread(
    stations: Floats, blocks: Floats, position_ids: Ints, largest: float
) -> None:
    """Raise ObservabilityError when a station is known worse than ``largest`` circle radii.

    ``stations`` (m, 3), ``blocks`` (m, 3, 3) their covariances in m^2.
    """
    j, std, direction = weakest_direction(blocks)
    radius, unturned = _radius(stations), stand_at_one_place(stations)
    if std > largest * radius or unturned:
        raise ObservabilityError(
            f"station {position_ids[j]} is known to {std:.3g} m only along "
            f"{name_direction(direction)}, more than {largest:g} of the {radius:.3g} m radius of "
            "the stations: this geometry cannot determine the angle; "
            + (NEVER_TURNED if unturned else CURE)
        )


def stand_at_one_place(stations: Floats) -> bool:
    """Whether ``stations`` (m, 3) all stand at one place: the table never turned."""
    return _radius(stations) < HARDLY_MOVED_M


def _radius(stations: Floats) -> float:
    """Return how far stations are from their middle, root mean square, m."""
    return float(np.sqrt(((stations - stations.mean(axis=0)) ** 2).sum(axis=1).mean()))


def weakest_direction(blocks: Floats) -> tuple[int, float, Floats]:
    """Return the station, standard deviation (m) and unit vector (3,) of the largest uncertainty.

    ``blocks`` (m, 3, 3) are the covariances of the stations. The vector's largest component is
    positive.
    """
    values, vectors = np.linalg.eigh(blocks)
    j = int(np.argmax(values[:, -1]))
    direction = vectors[j, :, -1]
    direction = direction * np.sign(direction[np.argmax(np.abs(direction))])
    return j, float(np.sqrt(max(values[j, -1], 0.0))), direction


def name_direction(direction: Floats) -> str:
    """Return a text like "(0.02, 0.05, 1.00), mostly z" for a vector (3,) in the machine frame."""
    length = float(np.linalg.norm(direction))
    if length < 1e-6:
        return "the beam (the distance d alone)"
    x, y, z = direction / length * np.sign(direction[np.argmax(np.abs(direction))])
    axis = "xyz"[int(np.argmax(np.abs(direction)))]
    return f"({x:.2f}, {y:.2f}, {z:.2f}), mostly {axis}"


def told_of_a_turned_sign(
    problem: Any, adjust: Callable[[Any], Solution], fits: Callable[[Solution], bool]
) -> Solution:
    """Return what ``adjust`` makes of a ``problem`` of lengths.

    Raises what it raises, unless the lengths fit with the opposite sign: then a DataError that
    says so, since no other cure would help.
    """
    try:
        return adjust(problem)
    except (DataError, GeometryError, ObservabilityError):
        try:
            turned = fits(adjust(replace(problem, length=-problem.length)))
        except RotcalError:
            turned = False
        if turned:
            raise DataError(
                "the lengths shrink while the distance grows, with the opposite sign they fit: "
                "turn their sign round (a reading grows with the distance from the tracer)"
            ) from None
        raise


@dataclass(frozen=True, slots=True)
class Numbering:
    """How far round the table a tracer stands from its stated place.

    ``bearing`` (rad, counter-clockwise seen from +z) is None where no place is stated, with
    ``where`` (a name for people), and known to ``near`` (m). ``step`` (rad): from one table
    position to the next, ``radius`` (m) of the tracer about the axis.
    """

    where: str
    step: float
    radius: float
    bearing: float | None
    near: float = NEAR

    @classmethod
    def of(
        cls, where: str, angles: Floats, radius: float, bearing: float | None, near: float = NEAR
    ) -> Numbering:
        """Return that of positions at commanded ``angles`` (m,), rad."""
        steps = np.diff(np.unique(angles))
        return cls(where, float(np.median(steps)) if len(steps) else 0.0, radius, bearing, near)

    def judged(
        self, verdict: Verdict, warnings: tuple[Phrase, ...]
    ) -> tuple[Verdict, tuple[Phrase, ...]]:
        """Return ``verdict`` and ``warnings``; whole positions off make an ok suspect."""
        off = 2.0 * self.radius * abs(np.sin(0.5 * (self.bearing or 0.0)))
        if self.bearing is None or self.step == 0.0 or off <= self.near:
            return verdict, warnings
        found = phrase(ROUND_THE_TABLE, self.bearing / DEGREE, off / MILLIMETRE, self.where)
        count = round(self.bearing / self.step)
        if not count or self.radius * abs(self.bearing - count * self.step) > self.near:
            return verdict, (
                *warnings,
                phrase(
                    "{0}: if that is right, the table's zero is another one than was "
                    "commanded, and every deviation stands at an angle that is off by as "
                    "much",
                    found,
                ),
            )
        several = phrase("{0} table positions", abs(count))
        positions = several if abs(count) > 1 else phrase("1 table position")
        warning = phrase(NUMBERED_OFF, found, positions, abs(count), self.where)
        return "suspect" if verdict == "ok" else verdict, (*warnings, warning)

    def protection(self) -> Protection:
        """Return whether positions numbered off by one would be found."""
        apart = 2.0 * self.radius * abs(np.sin(0.5 * self.step))
        unseen = phrase(
            "positions that are all numbered off by one, or a table's zero elsewhere, fit every "
            "length as well, and each deviation stands at another angle"
        )
        if self.bearing is None:
            return Protection(
                "numbering",
                "not protected",
                phrase(STATE_THE_PLACE, unseen, self.where),
            )
        if apart <= self.near:
            return Protection(
                "numbering",
                "not protected",
                phrase(
                    MOVES_TOO_LITTLE,
                    unseen,
                    apart / MILLIMETRE,
                    self.where,
                    self.near / MILLIMETRE,
                ),
            )
        return Protection(
            "numbering",
            "tested",
            phrase(WOULD_SHOW, apart / MILLIMETRE, self.where),
        )


def rotation_about_z_between(found: Floats, stated: Floats) -> float:
    """Return by which angle (rad) about z points ``found`` (k, 3) are turned from ``stated``.

    Wherever the axis is: places of a circle that is shifted are turned by nothing.
    """
    here, there = ((points - points.mean(axis=0))[:, :2] @ (1.0, 1j) for points in (found, stated))
    return float(np.angle(np.vdot(there, here)))
