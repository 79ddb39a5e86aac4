"""What the length methods are asked: lengths, targets, commanded angles, and how to judge them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, get_args

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.methods.columns import broadcast, indices, matrix, require, vector
from rotcal_ros.methods.tracer.solver_settings import (
    Datum,
    TracerLimits,
    TracerSolverSettings,
    Variant,
)

_DEFAULTS: Final = TracerSolverSettings()
_LATEST: Final = 2**62


@dataclass(frozen=True, eq=False)
class LengthProblem:
    """Lengths from a tracer on the table to targets, in any order, wherever it stood.

    ``position``, ``target`` (k,): indices into ``table_angles`` (m,) and ``targets`` (n, 3).
    ``length`` (k,): tracer readings in metres, growing with distance, from an unknown zero;
    ``length_std`` (k,) or one number: their standard deviation. ``distance_std`` (k,) or one
    number, below ``length_std``: the part of it that grows with the distance, m; it joins the rest
    in squares.
    ``targets``: positions of the reflector in the machine's frame, metres; ``target_std``: their
    standard deviation, one number, three, or (n, 3). ``datum`` "prior" weighs them by it, "free"
    uses them as start values only. ``table_angles``: commanded angles, radians, counter-clockwise
    about +z.

    ``order`` (k,), optional: when each length was taken, in any growing numbers. ``segment``
    (k,), optional: number of the unbroken beam with which each length was read, which count from
    one zero. ``slip``: a fringe (m) by which the counter may slip unseen where lengths share
    zeros, allowed for in the uncertainty (:mod:`.zeros`); 0: it does not slip.

    Raises DataError for values that are not finite, indices out of range, and standard
    deviations that are not positive; ConfigurationError for unknown names.
    """

    position: Ints
    target: Ints
    length: Floats
    length_std: Floats
    targets: Floats
    target_std: Floats
    table_angles: Floats
    datum: Datum = _DEFAULTS.datum
    distance_std: Floats = 0.0  # type: ignore[assignment]
    order: Ints | None = None
    segment: Ints | None = None
    slip: float = _DEFAULTS.slip_m
    settings: TracerLimits = _DEFAULTS

    def __post_init__(self) -> None:
        """Check and freeze the columns."""
        self._require_known("datum", get_args(Datum))
        self._require_sizes("slip")
        angles = self._store("table_angles", vector("table_angles", self.table_angles))
        targets = self._store("targets", matrix("targets", self.targets))
        position = self._store("position", indices("position", self.position, len(angles)))
        k = len(position)
        length = self._store("length", vector("length", self.length, k))
        self._store("target", indices("target", self.target, len(targets), k))
        std = broadcast("length_std", self.length_std, length.shape)
        self._store("length_std", require(std > 0.0, std, "length_std", "a positive number"))
        std = broadcast("distance_std", self.distance_std, length.shape)
        inside = (std >= 0.0) & (std < self.length_std)
        self._store("distance_std", require(inside, std, "distance_std", "0 to below length_std"))
        std = np.asarray(self.target_std, dtype=np.float64)
        std = np.broadcast_to(std, targets.shape) if std.shape == (3,) else std
        std = broadcast("target_std", std, targets.shape)
        self._store("target_std", require(std >= 0.0, std, "target_std", "zero or more"))
        self._store_numbers("order", "segment")

    def missing(self, positions: Ints) -> tuple[int, ...]:
        """Return the table positions that are not among those with a result."""
        every = np.arange(len(self.table_angles))
        return tuple(np.setdiff1d(every, positions).tolist())

    def _store_numbers(self, *names: str) -> None:
        """Check and freeze columns (k,) of whole numbers that may be absent."""
        for name in names:
            if (values := getattr(self, name)) is not None:
                self._store(name, indices(name, values, _LATEST, len(self.position)))

    def _require_known(self, name: str, known: tuple[str, ...]) -> None:
        if getattr(self, name) not in known:
            raise ConfigurationError(
                f"{name} {getattr(self, name)!r} is unknown: expected one of {known}"
            )

    def _require_sizes(self, *names: str, positive: bool = False) -> None:
        """Refuse sizes that are negative or not finite, or zero where ``positive``."""
        expected = "a positive number" if positive else "zero or more"
        for name in names:
            value = getattr(self, name)
            large = value is None or value > 0.0 or (value == 0.0 and not positive)
            if not (large and np.isfinite(value or 0.0)):
                raise ConfigurationError(f"{name} is {value}, expected {expected}, or None")

    def _store(self, name: str, values: NDArray[Any]) -> NDArray[Any]:
        values.setflags(write=False)
        object.__setattr__(self, name, values)
        return values


def share_gone(order: Ints) -> Floats:
    """Return which share (k,), 0 to 1, of the lengths had been taken when each was."""
    share = np.empty(len(order))
    share[np.argsort(order, kind="stable")] = np.linspace(0.0, 1.0, len(order))
    return share


@dataclass(frozen=True, eq=False)
class TracerProblem(LengthProblem):
    """One calibration run: k lengths from m table positions to n targets, in any order.

    At each position of the table the tracer has one station, whose place is unknown; its lengths
    have one zero, or those of a segment. Unequal steps, arcs and a full circle with its first
    angle repeated at the end (closure) are all welcome.

    ``variant`` "station": targets are taken as known, one small problem per station (Eq. 5-17).
    ``variant`` "joint": stations and targets are adjusted together (Eq. 1-4); the
    ``datum`` "free" fixes position and attitude of the network by inner constraints on the
    targets.

    ``error_motion_std``: standard deviation, per direction in the plane, of the table's own
    radial error motion (EXC, EYC, and tilts times the tracer's height) in metres. One tracer
    position cannot tell it from the angle; it enters the uncertainty as a type B component. Zero
    is known to be none; None: it is estimated from what the stations leave their circle by.

    ``circle_std``: standard deviation, m, by which the stations leave one circle about the table's
    axis, radially and along it; the circle is unknown. It is an observation that the lengths may
    contradict (:mod:`.circle`), and says nothing of errors along the circle: those are
    ``error_motion_std``, which is taken as large when it is None. None: nothing is said.

    ``repeated_runs``: equal table angles are separate arrivals, whose differences are the table's
    repeatability and reversal and no closure of the measurement.

    ``order`` tells the arrivals of the table and what a drift does; without it the stations are
    held to be measured one after the other, each at one arrival.

    ``segment``: all lengths of one count from the same unknown zero, at whatever table position;
    a beam that was broken begins a new segment. None: each station has a zero of its own.
    ``zero_walk_std``: with segments, the zero wanders by so much (m, standard deviation) from one
    length to the next of its segment, in their ``order``; 0: it stands, None: it is estimated.

    ``again`` (k,), optional: how often the pair of each length had been measured before, 0, 1,
    ...: what a plan repeats is a length of its own, to the same place of the target. None: every
    pair is measured once.

    ``start_stations`` (m, 3), optional: start values in metres; without them the start is
    found by linear multilateration. They also settle which of two mirror images is meant when
    all targets lie in one plane, and tell how the positions are numbered
    (:class:`~.observability.Numbering`).

    Lengths may be missing (a blocked beam): leave the row out. A pair (position, target) has one
    length in each segment, or each time it is measured ``again``; an identical repetition is
    dropped and counted as rejected, a different one raises DataError.
    """

    variant: Variant = _DEFAULTS.variant
    error_motion_std: float | None = _DEFAULTS.error_motion_std_m
    circle_std: float | None = None
    repeated_runs: bool = False
    zero_walk_std: float | None = 0.0
    again: Ints | None = None
    start_stations: Floats | None = None

    def __post_init__(self) -> None:
        """Check what is asked, too."""
        self._require_known("variant", get_args(Variant))
        self._require_sizes("error_motion_std", "zero_walk_std")
        self._require_sizes("circle_std", positive=True)
        super().__post_init__()
        self._store_numbers("again")
        self._check_ties()
        if self.start_stations is not None:
            start = matrix("start_stations", self.start_stations)
            if len(start) != len(self.table_angles):
                raise DataError(
                    f"start_stations has shape {start.shape}, one row per table angle "
                    f"is expected: {(len(self.table_angles), 3)}"
                )
            self._store("start_stations", start)
        if self.variant == "joint" and self.datum == "prior" and not (self.target_std > 0).all():
            raise DataError(
                "target_std holds zeros: the joint variant with a prior weighs the "
                "targets by it; give their standard deviation, or use the variant "
                "'station', which takes the targets as known"
            )

    @property
    def measuring_order(self) -> Ints:
        """When each length (k,) was taken: ``order``, or else station by station."""
        if self.order is not None:
            return self.order
        return np.lexsort((self.target, self.position)).argsort()

    def _check_ties(self) -> None:
        """Refuse a zero that wanders for itself, and ties for the variant 'station'."""
        if self.segment is None and self.zero_walk_std != 0.0:
            raise ConfigurationError(
                "zero_walk_std is for a zero per segment; lengths without segments have a zero "
                "per station, which does not wander: set it to 0"
            )
        if self.variant != "station":
            return
        solves = "and the variant 'station' solves each by itself: choose the variant 'joint', or"
        if self.segment is not None:
            raise ConfigurationError(
                f"segments tie all stations together, {solves} a zero per station"
            )
        if self.circle_std is not None:
            raise ConfigurationError(
                f"a stated circle ties all stations together, {solves} leave out circle_std"
            )
        if self.again is not None and self.again.any():
            raise ConfigurationError(
                "pairs measured several times share the error of their target, and the variant "
                "'station' takes a target for known: choose the variant 'joint', or average them"
            )
