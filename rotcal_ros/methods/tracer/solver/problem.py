"""What the tracer method is asked: lengths, targets, commanded angles, and how to judge them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.methods.columns import broadcast as _broadcast
from rotcal_ros.methods.columns import indices as _indices
from rotcal_ros.methods.columns import matrix as _matrix
from rotcal_ros.methods.columns import require as _require
from rotcal_ros.methods.columns import vector as _vector
from rotcal_ros.methods.tracer.solver_settings import (
    Datum,
    TracerLimits,
    TracerSolverSettings,
    Variant,
)

_DEFAULTS = TracerSolverSettings()
_LATEST = 2**62


@dataclass(frozen=True, eq=False)
class TracerProblem:
    """One calibration run: k lengths from m table positions to n targets, in any order.

    ``position`` (k,), ``target`` (k,): indices into ``table_angles`` (m,) and ``targets`` (n, 3).
    At each position of the table the tracer has one station, whose place is unknown.
    ``length`` (k,): tracer readings in metres, growing with distance, relative to an unknown zero
    that is common to each station or segment; ``length_std`` (k,) or one number: their
    standard deviation. ``distance_std`` (k,) or one number, below ``length_std``: the part of it
    that grows with the distance, m; it joins the rest in squares.
    ``targets``: positions of the reflector in the machine's frame, metres; ``target_std``: their
    standard deviation, one number or (n, 3). ``table_angles``: commanded angles, radians,
    counter-clockwise about +z; unequal steps, arcs and a full circle with its first angle
    repeated at the end (closure) are all welcome.

    ``variant`` "station": targets are taken as known, one small problem per station (Eq. 5-17).
    ``variant`` "joint": stations and targets are adjusted together (Eq. 1-4); ``datum`` "prior"
    weighs the machine's coordinates by ``target_std``, "free" uses them as start values only and
    fixes position and attitude of the network by inner constraints on the targets.

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

    ``order`` (k,), optional: when each length was taken, in any growing numbers. It tells the
    arrivals of the table and what a drift does; without it the stations are held to be measured
    one after the other, each at one arrival.

    ``segment`` (k,), optional: number of the unbroken beam with which each length was read. All
    lengths of one segment count from the same unknown zero, at whatever table position; a beam
    that was broken begins a new segment. None: each station has a zero of its own.
    ``zero_walk_std``: with segments, the zero wanders by so much (m, standard deviation) from one
    length to the next of its segment, in their ``order``; 0: it stands, None: it is estimated.
    ``slip``: with segments, a fringe (m) by which the counter may slip unseen, allowed for in the
    uncertainty (:mod:`.zeros`); 0: it does not slip.

    ``again`` (k,), optional: how often the pair of each length had been measured before, 0, 1,
    ...: what a plan repeats is a length of its own, to the same place of the target. None: every
    pair is measured once.

    ``start_stations`` (m, 3), optional: start values in metres; without them the start is
    found by linear multilateration. They also settle which of two mirror images is meant when
    all targets lie in one plane, and tell how the positions are numbered
    (:class:`~.observability.Numbering`).

    Lengths may be missing (a blocked beam): leave the row out. A pair (position, target) has one
    length in each segment, or each time it is measured ``again``; an identical repetition is
    dropped and counted as rejected, a different one raises.

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
    variant: Variant = _DEFAULTS.variant
    datum: Datum = _DEFAULTS.datum
    error_motion_std: float | None = _DEFAULTS.error_motion_std_m
    circle_std: float | None = None
    repeated_runs: bool = False
    distance_std: Floats = 0.0  # type: ignore[assignment]
    order: Ints | None = None
    segment: Ints | None = None
    zero_walk_std: float | None = 0.0
    again: Ints | None = None
    slip: float = _DEFAULTS.slip_m
    start_stations: Floats | None = None
    settings: TracerLimits = _DEFAULTS

    def __post_init__(self) -> None:
        self._check_names()
        angles = self._store("table_angles", _vector("table_angles", self.table_angles))
        targets = self._store("targets", _matrix("targets", self.targets))
        position = self._store("position", _indices("position", self.position, len(angles)))
        length = self._store("length", _vector("length", self.length, len(position)))
        self._store("target", _indices("target", self.target, len(targets), len(position)))
        std = _broadcast("length_std", self.length_std, length.shape)
        self._store("length_std", _require(std > 0.0, std, "length_std", "a positive number"))
        std = _broadcast("distance_std", self.distance_std, length.shape)
        inside = (std >= 0.0) & (std < self.length_std)
        self._store("distance_std", _require(inside, std, "distance_std", "0 to below length_std"))
        std = _broadcast("target_std", self.target_std, targets.shape)
        self._store("target_std", _require(std >= 0.0, std, "target_std", "zero or more"))
        if self.order is not None:
            self._store("order", _indices("order", self.order, _LATEST, len(position)))
        if self.segment is not None:
            self._store("segment", _indices("segment", self.segment, _LATEST, len(position)))
        if self.again is not None:
            self._store("again", _indices("again", self.again, _LATEST, len(position)))
        if self.start_stations is not None:
            start = _matrix("start_stations", self.start_stations)
            if start.shape != (len(angles), 3):
                raise DataError(
                    f"start_stations has shape {start.shape}, one row per table angle "
                    f"is expected: {(len(angles), 3)}"
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

    def _check_names(self) -> None:
        for name, known in (("variant", ("station", "joint")), ("datum", ("prior", "free"))):
            if getattr(self, name) not in known:
                raise ConfigurationError(
                    f"tracer {name} {getattr(self, name)!r} is unknown: expected one of {known}"
                )
        motion = self.error_motion_std
        if motion is not None and not (np.isfinite(motion) and motion >= 0.0):
            raise ConfigurationError(
                f"error_motion_std is {motion}, expected zero or more metres, or None"
            )
        circle = self.circle_std
        if circle is not None and not (np.isfinite(circle) and circle > 0.0):
            raise ConfigurationError(
                f"circle_std is {circle}, expected a positive number of metres, or None"
            )
        self._check_zero()
        self._check_ties()

    def _check_zero(self) -> None:
        walk = self.zero_walk_std
        if walk is not None and not (np.isfinite(walk) and walk >= 0.0):
            raise ConfigurationError(
                f"zero_walk_std is {walk}, expected zero or more metres, or None"
            )
        if not (np.isfinite(self.slip) and self.slip >= 0.0):
            raise ConfigurationError(f"slip is {self.slip}, expected zero or more metres")
        if self.segment is None and walk != 0.0:
            raise ConfigurationError(
                "zero_walk_std is for a zero per segment; lengths without segments have a zero "
                "per station, which does not wander"
            )

    def _check_ties(self) -> None:
        """Refuse for the variant 'station' what is solved with several stations or strips only."""
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

    def _store(self, name: str, values: NDArray[Any]) -> NDArray[Any]:
        values.setflags(write=False)
        object.__setattr__(self, name, values)
        return values
