"""The tracker drifts while it stands: found from nests that are measured again, and taken away.

A tracker that stays at its station should see a fixed nest where it saw it before. Between two
rounds of nests its frame turns by w (rad: tilts about x and y, azimuth about z), shifts by s (m)
and its range grows by r (m), so that a point seen at x later appears at

    x + c (w x x + s + r x / |x|),

with a course c that is linear in time from round to round. Only differences between readings of
one nest determine (w, s, r); their means show where the station stands, and the two are
independent. So the drift is estimated first, station by station, and counted from the mean of the
station's nests (:func:`find_drift`); what its uncertainty does to the deviations is added to their
covariance (:class:`DriftCorrection`).

Two rounds of nests show that the frame moved, not how: slowly, or by a knock. The correction
takes it as linear, and a knock would leave up to KNOCK times what it moved. So a correction that
is large makes a result suspect, and more rounds of nests make each part of it small.

What the azimuth turns by while the positions are measured, and back again before the nests are
looked at again, leaves no trace in them (:func:`swings`). Between two knots of the drift this
departure from the straight line is taken as

    a1 sin(pi t) + a2 sin(2 pi t),    t from 0 to 1,

the first terms of a random walk that is tied at both ends (Karhunen-Loeve). Both amplitudes are
held to be N(0, s^2): s is the stated ``uneven_drift_std`` for knots a whole station apart, less by
the root of the time for closer ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.linalg import block_diag

from rotcal_ros.adjust.distributions import chi2_isf, chi2_sf, normal_isf
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.protection import POWER
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.geometry.rotations import cross_matrix
from rotcal_ros.methods.plane_mirror.solver.problem import PlaneMirrorProblem, nest_rounds

KNOCK: Final = 4.0
"""A knock leaves up to this many times what the correction moved, found by simulation."""
_N_PARTS: Final = 7
"""Turns about x, y, z (rad), shifts along x, y, z (m) and range (m) from one knot to the next."""
_LARGE: Final = 1.0
"""A part of the correction may move a deviation by so many of its standard uncertainties."""
_TERMS: Final = 2
"""Half sines between two knots that a swing is made of."""
_MIN_NESTS: Final = 3
"""Nests seen twice that show how a frame turned and shifted."""
_REACH: Final = 3.0
"""A round reaches so many times as far to one side of its median as to the other, not more."""
_WEAKEST: Final = 1e-3
"""Smallest singular value of the scaled equations, to the largest: below, nests show no drift."""


@dataclass(frozen=True, eq=False)
class StationDrift:
    """The drift of one tracker station as its nests show it.

    ``change`` (R, 7) is what the frame moved by from each knot to the next (R + 1 ``knots``, in
    the unit of the problem's ``moment``), ``covariance`` (7 R, 7 R) that of its elements in order.
    ``chi_square`` and ``dof`` are those of the nests about it. ``gain`` (7 R, 3 Q) makes changes
    of the coordinates of the nest ``rows`` (Q,). ``suspects`` (Q,) were not used: they do not
    stand where they stood.
    """

    station: int
    knots: Floats
    rows: Ints
    gain: Floats
    change: Floats
    covariance: Floats
    chi_square: float
    dof: int
    suspects: Bools

    def probability(self, significance: float) -> float:
        """Return how probable changes this large are when nothing drifts.

        Nests that scatter more than stated, at this ``significance``, scale the noise.
        """
        values = self.change.ravel()
        square = float(values @ np.linalg.solve(self.covariance, values))
        if self.dof and self.chi_square > chi2_isf(significance, self.dof):
            square *= self.dof / self.chi_square
        return chi2_sf(square, len(values))


@dataclass(frozen=True, eq=False)
class NestDrift:
    """The drift of all stations whose nests were closed, and how far it had come at each row.

    ``course`` (n, K) is the share of each of K changes that a row has, counted from the mean
    nest of its station; ``open_stations`` were left without seeing their nests again.
    """

    stations: tuple[StationDrift, ...]
    course: Floats
    open_stations: tuple[int, ...]

    @property
    def size(self) -> int:
        """Number of estimated values."""
        return _N_PARTS * int(self.course.shape[1])

    @property
    def covariance(self) -> Floats:
        """Covariance (size, size) of all changes: each station's is found from its own nests."""
        # The empty block makes a matrix (0, 0) where no station has a drift.
        own = [station.covariance for station in self.stations]
        return np.asarray(block_diag(np.zeros((0, 0)), *own), dtype=np.float64)

    def spans(self) -> Iterator[tuple[StationDrift, slice]]:
        """Yield each station with its columns of ``course``."""
        at = 0
        for station in self.stations:
            yield station, slice(at, at + len(station.change))
            at += len(station.change)

    def corrected(self, points: Floats) -> Floats:
        """Return points (..., n, 3) as the tracker would have seen them without drift."""
        if not self.stations:
            return points
        change = [
            points[..., s.rows, :].reshape(*points.shape[:-2], -1) @ s.gain.T
            for s in self.stations
        ]
        return points - self.displacement(points, np.concatenate(change, axis=-1))

    def displacement(self, points: Floats, change: Floats) -> Floats:
        """Return by how much changes (..., size) move points (..., n, 3)."""
        parts = change.reshape(*change.shape[:-1], -1, _N_PARTS)
        moved = self.course @ parts
        beam = points / np.linalg.norm(points, axis=-1, keepdims=True)
        turned = np.cross(moved[..., :3], points)
        total: Floats = turned + moved[..., 3:6] + moved[..., 6:] * beam
        return total


@dataclass(frozen=True, eq=False)
class DriftCorrection:
    """What taking the ``drift`` away did to the deviations: K parts, one station and span each.

    A span goes from one knot to the next. ``moved`` (K, N) is what each part did to the deviations
    in rad, ``noise`` (K, N) the standard uncertainty of that, ``covariance`` (N, N) what all parts
    add to that of the deviations. K is zero where no drift was estimated.
    """

    problem: PlaneMirrorProblem
    drift: NestDrift
    moved: Floats
    noise: Floats
    covariance: Floats

    @classmethod
    def of(
        cls, problem: PlaneMirrorProblem, drift: NestDrift, response: Floats
    ) -> DriftCorrection:
        """Return what the ``drift`` did; ``response`` (N, size): deviations per change."""
        n, spans = len(response), drift.size // _N_PARTS
        change = np.concatenate([np.zeros(0), *(s.change.ravel() for s in drift.stations)])
        parts = response.reshape(n, spans, _N_PARTS)
        moved = np.einsum("nkp,kp->kn", parts, change.reshape(spans, _N_PARTS))
        covariance = drift.covariance
        blocks = covariance.reshape(spans, _N_PARTS, spans, _N_PARTS)
        own = np.einsum("kpkq->kpq", blocks)
        noise = np.sqrt(np.einsum("nkp,kpq,nkq->kn", parts, own, parts))
        return cls(problem, drift, moved, noise, response @ covariance @ response.T)

    def doubts(self, std: Floats) -> list[str]:
        """Return in words at which stations it is larger than may be taken as linear.

        ``std`` (N,): standard uncertainties of the deviations, rad.
        """
        if not len(self.moved):
            return []
        share, noise = self._shares(std)
        beyond = np.any(share > self._limits(noise), axis=1)
        return [
            f"tracker station {self.problem.station_name(station.station)} moved between "
            f"rounds of nests ({_in_words(station)}), which moves deviations by up to "
            f"{share[spans].max():.1f} standard uncertainties; it is taken away as linear in "
            "time, but a knock or a bend would stay: let the tracker settle, or measure the "
            "nests more often (plan.nests_every)"
            for station, spans in self.drift.spans()
            if beyond[spans].any()
        ]

    def unseen_knock(self, std: Floats) -> float:
        """Return the error of a knock of the tracker that is found with POWER.

        In standard uncertainties ``std`` (N,) of the deviations.
        """
        _, noise = self._shares(std)
        found = self._limits(noise) + normal_isf(1.0 - POWER) * noise
        return float(KNOCK * found[:, 1:].max())

    def details(self, std: Floats) -> dict[str, Any]:
        """Return the drift of each station for a result; nothing where none was estimated."""
        if not self.drift.size:
            return {}
        share, _ = self._shares(std)
        entries = []
        for station, spans in self.drift.spans():
            spread = np.sqrt(np.diag(station.covariance)).reshape(-1, _N_PARTS)
            entries.append(
                {
                    "station": self.problem.station_name(station.station),
                    "knots": station.knots,
                    "turn_rad": station.change[:, :3],
                    "turn_std_rad": spread[:, :3],
                    "shift_m": station.change[:, 3:6],
                    "shift_std_m": spread[:, 3:6],
                    "range_m": station.change[:, 6],
                    "range_std_m": spread[:, 6],
                    "probability": station.probability(self.problem.significance),
                    "moved_standard_uncertainties": share[spans].max(axis=1),
                }
            )
        return {"drift": entries}

    def _shares(self, std: Floats) -> tuple[Floats, Floats]:
        """Return what each part moved (K, N), and its noise, in standard uncertainties (N,)."""
        scale = np.where(std > 0.0, std, np.inf)  # the first position has none
        return np.abs(self.moved) / scale, self.noise / scale

    def _limits(self, noise: Floats) -> Floats:
        """Return from where on (K, N) a part is too large: _LARGE, or what noise does at most."""
        tests = noise[:, 1:].size
        return np.maximum(_LARGE, normal_isf(self.problem.significance / 2.0 / tests) * noise)


def find_drift(problem: PlaneMirrorProblem) -> NestDrift:
    """Estimate the drift of every station that saw its nests before and after its positions."""
    found: list[StationDrift] = []
    still_open: list[int] = []
    columns: list[Floats] = []
    for station in range(int(problem.station.max()) + 1):
        drift = _station_drift(problem, station)
        if drift is None:
            still_open.append(station)
            continue
        found.append(drift)
        own = problem.station == station
        columns += list((_course(problem.moment, drift) * own[:, None]).T)
    course = np.column_stack(columns) if columns else np.zeros((len(problem.xyz), 0))
    return NestDrift(tuple(found), course, tuple(still_open))


def displaced_nests(problem: PlaneMirrorProblem, drift: NestDrift) -> list[str]:
    """Return in words which nests the drift leaves out because they did not stay at a station."""
    return [
        f"nest {name} moved while the tracker was at station "
        f"{problem.station_name(station.station)}; it is left out of the drift there"
        for station in drift.stations
        for name in np.unique(problem.nest[station.rows[station.suspects]])
    ]


def movement(places: Floats) -> Floats:
    """Return how the seven parts of a change move points (K, 3): (K, 3, 7)."""
    beam = places / np.linalg.norm(places, axis=1, keepdims=True)
    shift = np.broadcast_to(np.eye(3), (len(places), 3, 3))
    return np.concatenate([-cross_matrix(places), shift, beam[:, :, None]], axis=2)


def swings(problem: PlaneMirrorProblem, drift: NestDrift) -> Floats:
    """Return by how much each point moves (n, 3, K), m, per amplitude of one standard deviation.

    K is zero where no drift is known or nothing is stated.
    """
    courses = [np.zeros((len(problem.xyz), 0))]
    for station in drift.stations if problem.uneven_drift_std > 0.0 else ():
        own = problem.station == station.station
        lasting = np.diff(station.knots)
        size = problem.uneven_drift_std * np.sqrt(lasting / lasting.sum())
        share = _shares(problem.moment, station.knots)
        courses += [
            size * np.sin(term * np.pi * share) * own[:, None] for term in range(1, _TERMS + 1)
        ]
    course = np.concatenate(courses, axis=1)
    sideways = np.cross([0.0, 0.0, 1.0], problem.xyz)  # per rad of azimuth
    return np.asarray(sideways[:, :, None] * course[:, None, :])


def _station_drift(problem: PlaneMirrorProblem, station: int) -> StationDrift | None:
    """Return the drift of a station; None when nests do not determine it."""
    own = problem.station == station
    rows = np.flatnonzero(own & (problem.kind == PointKind.NEST))
    others = problem.moment[own & (problem.kind != PointKind.NEST)]
    when = problem.moment[rows]
    if not len(rows) or not len(others):
        return None
    if when.min() >= others.min() or when.max() <= others.max():
        return None  # no nest before the first position, or none behind the last
    suspects = np.zeros(len(rows), dtype=np.bool_)
    knots = _knots(problem, rows)
    found = _fit(problem, station, rows, knots, suspects)
    while found is not None:
        worse = _moved_nest(problem, found)
        if worse is None:
            break
        fewer = _fit(problem, station, rows, knots, suspects | worse)
        if fewer is None:
            break
        found, suspects = fewer, suspects | worse
    return found


def _knots(problem: PlaneMirrorProblem, rows: Ints) -> Floats:
    """Return the times between which the drift is linear: first nest, inner rounds, last nest.

    A nest that stands alone, long before the others of the first round or long after those of the
    last one (an interrupted run), does not stretch the time: it counts as measured with them.
    """
    when, rounds = problem.moment[rows], nest_rounds(problem)[rows]
    inner = [
        when[rounds == number].mean()
        for number in np.unique(rounds)[1:-1]
        if len(np.unique(problem.nest[rows[rounds == number]])) >= _MIN_NESTS
    ]
    first, last = when[rounds == rounds.min()], when[rounds == rounds.max()]
    middle, end = np.median(first), np.median(last)
    begun = max(first.min(), middle - _REACH * (first.max() - middle))
    done = min(last.max(), end + _REACH * (end - last.min()))
    return np.unique([begun, *inner, done])


def _course(time: Floats, drift: StationDrift) -> Floats:
    """Return the share (n, R) of each change that has come by ``time``, from the mean nest."""
    share = _shares(time, drift.knots)
    shares: Floats = share - share[drift.rows[~drift.suspects]].mean(axis=0)
    return shares


def _shares(time: Floats, knots: Floats) -> Floats:
    """Return how much (n, R) of the way from each knot to the next is done by ``time`` (n,)."""
    share: Floats = (time[:, None] - knots[:-1]) / np.diff(knots)
    return np.clip(share, 0.0, 1.0)


def _fit(
    problem: PlaneMirrorProblem, station: int, rows: Ints, knots: Floats, suspects: Bools
) -> StationDrift | None:
    """Fit the changes to the differences between readings of each nest; None if too weak."""
    used = rows[~suspects]
    name, nest, counts = np.unique(problem.nest[used], return_inverse=True, return_counts=True)
    if int((counts > 1).sum()) < _MIN_NESTS:
        return None
    # Each reading from the mean of its nest: the unknown place of the nest drops out, and nothing
    # else does, for all readings of one nest weigh alike (noise at its mean place).
    to_mean = (np.arange(len(name))[:, None] == nest) / counts[:, None]
    contrast = np.eye(len(used)) - to_mean[nest]
    places = to_mean @ problem.xyz[used]
    root = np.linalg.cholesky(problem.noise.weight(places)).swapaxes(1, 2)[nest]
    course = contrast @ _shares(problem.moment[used], knots)
    design = (root @ movement(places)[nest])[:, :, None, :] * course[:, None, :, None]
    design = design.reshape(3 * len(used), -1)
    inverse = _inverse(design)
    if inverse is None:
        return None
    observed = (root @ (contrast @ problem.xyz[used])[:, :, None]).ravel()
    change = inverse @ observed
    rest = observed - design @ change
    # The changes as a linear function of the coordinates, which trials use again and again.
    by_point = np.einsum("kqi,qij->kqj", inverse.reshape(len(change), -1, 3), root)
    gain = np.zeros((len(change), len(rows), 3))
    gain[:, ~suspects] = np.einsum("kqj,qp->kpj", by_point, contrast)
    return StationDrift(
        station=station,
        knots=knots,
        rows=rows,
        gain=gain.reshape(len(change), -1),
        change=change.reshape(-1, _N_PARTS),
        covariance=inverse @ inverse.T,
        chi_square=float(rest @ rest),
        dof=3 * (len(used) - len(name)) - len(change),
        suspects=suspects,
    )


def _inverse(design: Floats) -> Floats | None:
    """Return the pseudo-inverse of a design; None when it does not determine all its columns."""
    scale = np.linalg.norm(design, axis=0)
    if not np.all(scale > 0.0):
        return None
    u, size, v = np.linalg.svd(design / scale, full_matrices=False)
    if len(size) < len(scale) or size[-1] < _WEAKEST * size[0]:
        return None
    inverse: Floats = (v.T / size) @ u.T / scale[:, None]
    return inverse


def _moved_nest(problem: PlaneMirrorProblem, found: StationDrift) -> Bools | None:
    """Return the readings (Q,) of the nest that spoils the fit, if leaving it out mends it."""
    if found.dof <= 0 or found.chi_square <= chi2_isf(problem.significance, found.dof):
        return None
    nest = problem.nest[found.rows]
    names = np.unique(nest[~found.suspects])
    best: tuple[float, Bools] | None = None
    for name in names:
        without = found.suspects | (nest == name)
        fewer = _fit(problem, found.station, found.rows, found.knots, without)
        if fewer is None or fewer.dof <= 0 or fewer.dof == found.dof:
            continue
        drop = found.chi_square - fewer.chi_square
        noise = max(1.0, fewer.chi_square / fewer.dof)
        limit = chi2_isf(problem.significance / len(names), found.dof - fewer.dof)
        if drop / noise > limit and (best is None or drop > best[0]):
            best = drop, nest == name
    return None if best is None else best[1]


def _in_words(station: StationDrift) -> str:
    """Return the whole change of a station's frame from its first nest to its last."""
    total = station.change.sum(axis=0)
    x, y, azimuth = total[:3] / ARCSEC
    return (
        f"azimuth {azimuth:.1f}, tilts {x:.1f} and {y:.1f} arcsec, range "
        f"{total[6] / MICROMETRE:.1f} um"
    )
