"""From the covariance of the stations to that of the angles, the table's error motion included.

Standard uncertainties are for a normal distribution: the 95 % interval is +-1.96 times the
standard deviation. The stated standard deviations are taken as known (GUM type B) while the
residuals do not contradict them; then the estimates of :mod:`.screening` take their place. There
is no t factor for those, for lengths are many. The few residuals of the circle get theirs here:

A station leaves its circle by the radial part of the table's error motion (EXC, EYC, and tilts
times the height of the tracer) and by the noise of its own place. The tangential part cannot be
separated from the angle; it is taken to be as large, which is believed and never measured: a
tracer that mount or cable shift along its circle spoils the angle and leaves no trace
(:mod:`.protections` says so). m - 3 residuals do not say much about a standard deviation, so their
whole posterior is used: the value that goes into the covariance is the one with which an interval
of +-1.96 standard deviations holds 95 % of what is predicted. From exact stations that is
Student's t with m - 3 degrees of freedom; where the noise of the stations explains the residuals,
little is left of it.

Real axes move in few undulations, which few residuals witness; of order 2 the half that turns the
way of the table leaves none, for the centre of the circle takes it up, and the angle feels it
twice. So it is open which orders the motion has (:data:`SPECTRA`): white, or orders from 2 up, of
equal or falling sizes. The residuals weigh them, and the covariance is that of their mean.

The prior of the size is that of Jeffreys, d sigma / sigma, for error motions well above the
stations' noise across the circle (x = sigma / noise), times y^6 / (1 + y^6) with y = x / 1.5, and
beside it "none at all" with the weight of ABSENT natural logarithms of sigma. It was set by the
coverage of 8 and 9 residuals of equal noise, which is an integral over chi-squared: 94 to 97 % for
every size. With d sigma / sigma alone a round table's intervals held 99 %. With fewer residuals a
round table's hold more (98.8 % with 4), since so few cannot show that it is round.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from scipy.special import erfc

from rotcal_ros.adjust.error_motion import WHITE, Spectrum
from rotcal_ros.adjust.low_rank import LowRank, Slopes
from rotcal_ros.adjust.noise import UNTESTED, GlobalTest
from rotcal_ros.adjust.roots import root_between
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import HALF_OF_95_PERCENT
from rotcal_ros.foundation.results import ErrorMotion
from rotcal_ros.methods.tracer.solver.adjustment import StationCovariance
from rotcal_ros.methods.tracer.solver.circle import (
    TableMotion,
    bearing_slopes,
    circle_contrasts,
    without_prior,
)

OUTSIDE: Final = 0.05
"""Probability that the interval misses what is predicted."""
TINY: Final = 1e-12
"""Error motion (m) that is none."""
DECADES: Final = np.logspace(-3.0, 3.0, 121)
"""Error motions, in units of the radial residuals, over which the posterior is summed."""
SPACING: Final = float(np.log(DECADES[1] / DECADES[0]))
"""Spacing of their natural logarithms: the width that each represents in the sum."""
ABSENT: Final = 0.8
"""Prior weight of no error motion, in natural logarithms of sigma far above the noise."""
NOTICED: Final = 1.5
"""Error motion, in units of the stations' noise, from which the prior is that of Jeffreys."""
STEEPNESS: Final = 6
"""Power of sigma by which the prior vanishes below, so that "none" and "some" stay apart."""
FEW: Final = 64
"""Stations up to which whole matrices are as quick, and lose no digits where these are exact."""
SPECTRA: Final[Mapping[Spectrum, float]] = {
    WHITE: 0.4,
    **{
        Spectrum.of_sizes([0.0, *(k**-fall for k in range(2, highest + 1))]): 0.1
        for highest in (3, 5, 8)
        for fall in (0.0, 1.0)
    },
}
"""Which orders an error motion may have, with what probability beforehand."""


@dataclass(frozen=True, eq=False)
class CircleResiduals:
    """The stations' radial distances as far as no circle takes them up.

    ``seen`` (k,): distances, m; ``noise`` (k, k): their covariance from that of the stations, m^2.
    What their combinations ``absorbed`` (k, 3), orthonormal, say went into centre and radius; of
    whole matrices those were taken off before, and none is left, (k, 0). ``combined`` (m, k): what
    of the stations' radial distances they are; None: these distances themselves.
    """

    seen: Floats
    noise: LowRank
    absorbed: Floats
    combined: Floats | None = None

    @classmethod
    def free(cls, seen: Floats, noise: LowRank, combined: Floats | None = None) -> CircleResiduals:
        """Return residuals of which nothing is absorbed any more."""
        return cls(seen, noise, np.zeros((len(seen), 0)), combined)

    @property
    def dof(self) -> int:
        """The number of free residuals: m - 3, or fewer where lengths do not determine all."""
        return int(len(self.seen) - self.absorbed.shape[1])

    @property
    def variance(self) -> float:
        """The mean variance of a free residual, m^2."""
        taken = (self.absorbed * self.noise.times(self.absorbed)).sum()
        return float(self.noise.diagonal().sum() - taken) / self.dof

    def lifted(self, variance: float) -> CircleResiduals:
        """Return residuals with a noise of this ``variance`` (m^2) more."""
        return replace(self, noise=self.noise.lifted(variance))

    def squares(self, values: Floats) -> Floats:
        """Return chi-squared (t,) of ``values`` (t, k) in place of what was seen."""
        return self._fit(self.noise, self._open(values))[0]

    def likelihood(self, variances: Floats, radial: Floats | None = None) -> Floats:
        """Return ln of the likelihood (t,) of what was seen, up to a constant.

        With errors of these ``variances`` (t,), m^2, beside those of the stations: independent
        ones, or by ``radial`` (m, r) columns of a motion at the stations, of size 1.
        """
        columns = radial if self.combined is None or radial is None else self.combined.T @ radial
        if self.noise.columns is None:
            noise, axes = self._axes
            std = np.sqrt(noise)[:, None]
            along = axes.T / std if columns is None else axes.T @ columns / std
            values, vectors = np.linalg.eigh(along @ along.T)
            squares = (vectors.T @ (axes.T @ self.seen / std[:, 0])) ** 2
            larger = 1.0 + np.maximum(values, 0.0) * variances[:, None]
            fit = np.log(larger).sum(axis=1) + (squares / larger).sum(axis=1)
            return np.asarray(-0.5 * (np.log(noise).sum() + fit))
        seen = self._open(self.seen[None])
        if columns is None:
            found = [self._fit(self.noise.lifted(v + TINY**2), seen) for v in variances.tolist()]
            return np.array([-0.5 * (log + squares[0]) for squares, log in found])
        inner, log = self._products(np.column_stack([seen.T, self._open(columns.T).T]))
        values, vectors = np.linalg.eigh(inner[1:, 1:])
        explained = variances[:, None] * (vectors.T @ inner[1:, 0]) ** 2
        larger = 1.0 + np.maximum(values, 0.0) * variances[:, None]
        fit = (np.log(larger) - explained / larger).sum(axis=1)
        return np.asarray(-0.5 * (log + inner[0, 0] + fit))

    @cached_property
    def _axes(self) -> tuple[Floats, Floats]:
        """Variances (k,) and axes (k, k) of the noise; TINY keeps exact stations finite."""
        noise, axes = np.linalg.eigh(self.noise.dense())
        return np.maximum(noise, 0.0) + TINY**2, axes

    def _products(self, columns: Floats) -> tuple[Floats, float]:
        """Return C'N^-1 C of open ``columns`` (k, c), N what is free of the noise; ln det N."""
        noise = self.noise.lifted(TINY**2)
        solved, log = noise.solved(np.column_stack([columns, self.absorbed]))
        inner = np.column_stack([columns, self.absorbed]).T @ solved
        c = columns.shape[1]
        taken = inner[:c, c:] @ np.linalg.solve(inner[c:, c:], inner[c:, :c])
        return inner[:c, :c] - taken, log + float(np.linalg.slogdet(inner[c:, c:])[1])

    @property
    def mean_square(self) -> float:
        """The mean square of the free residuals, m^2."""
        return float((self._open(self.seen[None]) ** 2).sum()) / self.dof

    def _open(self, values: Floats) -> Floats:
        """Return ``values`` (t, k) without what is absorbed of them."""
        return np.asarray(values - (values @ self.absorbed) @ self.absorbed.T)

    def _fit(self, noise: LowRank, values: Floats) -> tuple[Floats, float]:
        """Return chi-squared (t,) of open ``values`` (t, k), and ln det of the free covariance."""
        t = len(values)
        solved, log = noise.solved(np.column_stack([values.T, self.absorbed]))
        mixed, inner = self.absorbed.T @ solved[:, :t], self.absorbed.T @ solved[:, t:]
        squares = (values.T * solved[:, :t]).sum(axis=0)
        squares -= (mixed * np.linalg.solve(inner, mixed)).sum(axis=0)
        return np.asarray(squares), log + float(np.linalg.slogdet(inner)[1])


def _circle_residuals(
    motion: TableMotion, total: LowRank, circle_std: float | None = None
) -> CircleResiduals:
    """Return the free residuals of the circle; ``total`` (3 m, 3 m) are the stations' errors.

    Where the stations were bound to a circle with ``circle_std`` (m), what the lengths alone say.
    """
    direction, absorbed = _radial(motion)
    radial = Slopes.alone(direction @ motion.plane.basis()).spread(total).quick()
    if radial.columns is not None and circle_std is None and len(absorbed) > FEW:
        return CircleResiduals(motion.radial, radial, np.linalg.qr(absorbed)[0])
    free = _free(absorbed)
    seen, noise = free.T @ motion.radial, free.T @ radial.times(free)
    if circle_std is None:
        return CircleResiduals.free(seen, LowRank.whole(noise), free)
    alone = without_prior(seen, noise, circle_std)
    return CircleResiduals.free(
        alone.seen, LowRank.whole(np.diag(alone.noise)), free @ alone.basis
    )


@dataclass(frozen=True, eq=False)
class CircleTest:
    """What the circle is tested by: ``residuals`` with all noise that is expected of them.

    ``moved`` takes moves (t, m, 3) of the stations, m, to what they do to them (t, k).
    ``redundancy``: share of a stated circle that the lengths check.
    """

    residuals: CircleResiduals
    moved: Callable[[Floats], Floats]
    redundancy: float = 1.0


def circle_tested(
    stations: Floats,
    motion: TableMotion,
    total: LowRank,
    expected_std: float,
    circle_std: float | None,
    spectrum: Spectrum = WHITE,
) -> CircleTest:
    """Return the test of whether ``stations`` (m, 3) leave their circle by more than expected.

    ``total`` (3 m, 3 m): covariance of the stations, ``expected_std`` (m): of their deviation from
    the circle, with a ``spectrum``. Radial distances, with the error motion as expected; where
    the stations were bound to a circle with ``circle_std`` (m), radial and axial ones as the
    lengths determine them.
    """
    if circle_std is not None:
        value, slope = circle_contrasts(stations)
        alone = without_prior(value, slope @ total.times(slope.T), circle_std)
        variance = LowRank.of_blocks((alone.noise + expected_std**2)[:, None, None])
        basis = slope.T @ alone.basis
        return CircleTest(
            CircleResiduals.free(alone.seen, variance),
            lambda moves: moves.reshape(len(moves), -1) @ basis,
            alone.redundancy,
        )
    circle = _circle_residuals(motion, total + error_motion_spread(motion, expected_std, spectrum))
    direction, absorbed = _radial(motion)
    outward = direction @ motion.plane.basis()

    def moved(moves: Floats) -> Floats:
        radial = np.einsum("kja,ja->kj", moves, outward)
        return radial if circle.absorbed.size else np.asarray(radial @ _free(absorbed))

    return CircleTest(circle, moved)


def error_motion_spread(motion: TableMotion, std: float, spectrum: Spectrum = WHITE) -> LowRank:
    """Return the covariance (3 m, 3 m) of error motions ``std`` (m) in the plane.

    Of both directions by themselves, with a ``spectrum`` over the angles.
    """
    normal, m = motion.plane.normal, len(motion.in_plane)
    in_plane = spectrum.white * std**2 * (np.eye(3) - np.outer(normal, normal))
    white = LowRank.of_blocks(np.tile(in_plane, (m, 1, 1)))
    if not spectrum.orders:
        return white
    columns = np.kron(_of_orders(motion, spectrum), motion.plane.basis().T)
    core = std**2 * np.eye(columns.shape[1])
    return white + LowRank(np.zeros_like(white.blocks), columns, core)


def _of_orders(motion: TableMotion, spectrum: Spectrum) -> Floats:
    """Return columns (m, 2 r) of what the r orders of a ``spectrum`` do along one direction."""
    angles = np.arctan2(motion.in_plane[:, 1], motion.in_plane[:, 0])
    return spectrum.root(angles)[:, : 2 * len(spectrum.orders)]


def _radial(motion: TableMotion) -> tuple[Floats, Floats]:
    """Return the stations' directions (m, 2) from the centre, and what a circle absorbs (m, 3)."""
    direction = motion.in_plane / np.linalg.norm(motion.in_plane, axis=1)[:, None]
    return direction, np.column_stack([direction, np.ones(len(direction))])


def _free(absorbed: Floats) -> Floats:
    """Return the combinations (m, m - 3) of radial distances of which nothing is ``absorbed``."""
    return np.asarray(np.linalg.qr(absorbed, mode="complete")[0][:, 3:], dtype=np.float64)


class _Supposed(NamedTuple):
    """A ``spectrum`` that an error motion may have, and its probability beforehand.

    ``radial`` (m, r): columns of what its unit does to the radial distances; None: it is white.
    ``felt``: by what its unit adds to the mean variance of what is predicted.
    """

    spectrum: Spectrum
    probability: float
    radial: Floats | None
    felt: float


class _Estimate(NamedTuple):
    """Likely and allowed standard deviation of an error motion, m, and its spectrum."""

    likely: float
    allowed: float
    spectrum: Spectrum


def _supposed(motion: TableMotion, bearing: Slopes) -> list[_Supposed]:
    """Return what error motions may be like; what is predicted are angles, from the first."""
    direction, _ = _radial(motion)
    found = []
    for spectrum, probability in SPECTRA.items():
        felt = _mean_variance(bearing, error_motion_spread(motion, 1.0, spectrum))
        radial = None
        if spectrum.orders:
            along = _of_orders(motion, spectrum)
            radial = (direction[:, None] * along[:, :, None]).reshape(len(along), -1)
        found.append(_Supposed(spectrum, probability, radial, felt))
    return found


def _mean_variance(bearing: Slopes, stations: LowRank) -> float:
    """Return the mean variance of the angles from the first, of ``stations`` (3 m, 3 m), rad^2."""
    others = np.arange(1, len(bearing.own))
    return float(bearing.spread(stations).between(np.zeros_like(others), others).mean())


def _estimate_error_motion(
    circle: CircleResiduals, variance: float, supposed: Sequence[_Supposed]
) -> _Estimate:
    """Return what the ``circle`` leaves open of the error motion.

    ``variance``: of what is predicted without it. The prior is in this module's docstring.
    """
    level = circle.variance
    sigma = DECADES * np.sqrt(level + circle.mean_square + TINY**2)
    some = sigma**STEEPNESS
    prior = SPACING * some / (some + (NOTICED**2 * level) ** (STEEPNESS / 2))
    fits = [circle.likelihood(np.zeros(1))]
    fits += [circle.likelihood(sigma**2, each.radial) for each in supposed]
    fit = np.concatenate(fits)
    prior = np.concatenate([[ABSENT], *(each.probability * prior for each in supposed)])
    posterior = np.exp(fit - fit.max()) * prior
    posterior /= posterior.sum()
    felt = np.array([each.felt for each in supposed])
    together = np.sqrt(variance + np.append(0.0, np.outer(felt, sigma**2)))

    def beyond(limit: float) -> float:
        reach = limit / (np.sqrt(2.0) * np.maximum(together, TINY))
        return float(posterior @ erfc(reach)) - OUTSIDE

    half = root_between(beyond, 0.0, float(20.0 * together.max()), TINY)
    share = posterior[1:].reshape(len(supposed), -1).sum(axis=1) + TINY
    share = share / share.sum()
    more = max((half / HALF_OF_95_PERCENT) ** 2 - variance, 0.0)
    return _Estimate(
        float(np.append(0.0, np.tile(sigma, len(supposed)))[int(np.argmax(fit))]),
        float(np.sqrt(more / (share @ felt))),
        Spectrum.mean({e.spectrum: p for e, p in zip(supposed, share.tolist(), strict=True)}),
    )


def likely_circle(circle: CircleTest, expected_std: float) -> float:
    """Return the deviation from the circle, m, that what was seen leaves open.

    ``expected_std`` (m) is the one in the ``circle``.
    """
    if circle.residuals.dof == 0:
        return expected_std
    alone = circle.residuals.lifted(-(expected_std**2))
    white = [_Supposed(WHITE, 1.0, None, 1.0)]
    return _estimate_error_motion(alone, alone.variance, white).allowed


def error_motion_of(
    stations: Floats,
    motion: TableMotion,
    covariance: StationCovariance,
    scale: float,
    stated: float | None,
    contradicted: bool,
    circle_std: float | None = None,
) -> tuple[ErrorMotion, Spectrum]:
    """Return the error motion that the covariance has to hold, and its spectrum.

    What was stated, as white, unless the circle contradicts it or nothing was: then what the
    circle leaves open, if that is more. ``scale`` enlarges the ``covariance`` of the ``stations``
    (m, 3), which were bound to a circle with ``circle_std`` (m).
    """
    total = covariance.enlarged(scale).total
    circle = _circle_residuals(motion, total, circle_std)
    if circle.dof == 0:
        return ErrorMotion(stated, 0.0, 0.0, 0, stated or 0.0), WHITE
    bearing = bearing_slopes(stations, motion)
    found = _estimate_error_motion(
        circle, _mean_variance(bearing, total), _supposed(motion, bearing)
    )
    used, spectrum = stated, WHITE
    if used is None or (contradicted and found.allowed > used):
        used, spectrum = found.allowed, found.spectrum
    return ErrorMotion(stated, found.likely, found.allowed, circle.dof, used), spectrum


@dataclass(frozen=True, eq=False)
class AngleUncertainty:
    """Covariance of the cumulative deviations (m, m) in rad^2, and standard deviations from it.

    ``adjacent_std`` (m - 1,) belongs to the adjacent deviations. ``budget`` maps each source to
    its share (m,) of the cumulative standard deviation; the shares add in squares.
    """

    covariance: Floats
    std: Floats
    adjacent_std: Floats
    budget: Mapping[str, Floats]


@dataclass(frozen=True, slots=True)
class CircleStatement:
    """What was stated of the stations' circle, and what became of it.

    ``stated``, ``used``: standard deviations, m. ``redundancy``: share of the statement that the
    lengths check, ``dof`` of its test.
    """

    stated: float
    used: float
    redundancy: float
    dof: int
    sigma0: float
    probability: float


def angle_uncertainty(
    motion: TableMotion,
    stations: Floats,
    covariance: StationCovariance,
    error_motion_std: float,
    scale: float,
    slips: Floats | None = None,
    gathered: Floats | None = None,
    spectrum: Spectrum = WHITE,
) -> AngleUncertainty:
    """Propagate the stations' covariance times ``scale``^2 and the error motion to the angles.

    ``stations`` (m, 3), m, have gone through this ``motion``, whose errors have a ``spectrum``.
    ``slips`` (3 m, 3 m): what unseen slips add to that of the stations, m^2. ``gathered`` (m, m):
    what disturbances that gather in one place add to that of the cumulative angles, rad^2.
    """
    bearing, own = bearing_slopes(stations, motion), covariance.enlarged(scale)
    sources = {
        "lengths": own.lengths,
        "targets": own.targets,
        "error_motion": error_motion_spread(motion, error_motion_std, spectrum),
    }
    if own.circle is not None:
        sources["circle"] = own.circle
    if slips is not None:
        sources["slips"] = LowRank.whole(slips, 3)
    spread = bearing.spread(sum(list(sources.values())[1:], own.lengths))
    every = np.arange(len(stations))
    first = np.zeros_like(every)
    budget = {
        name: _root(bearing.spread(part).between(first, every)) for name, part in sources.items()
    }
    joint = spread.from_first()
    of_steps = _root(spread.between(every[:-1], every[1:]))
    if gathered is not None:
        joint += 0.5 * (gathered + gathered.T)
        steps = LowRank.whole(gathered).between(every[:-1], every[1:])
        of_steps = np.hypot(of_steps, _root(steps))
        budget["gathered"] = _root(gathered.diagonal())
    return AngleUncertainty(
        covariance=joint, std=np.sqrt(joint.diagonal()), adjacent_std=of_steps, budget=budget
    )


def circle_test(circle: CircleTest) -> GlobalTest:
    """Compare the stations' distances from the circle with their covariance.

    What the circle has absorbed (centre and radius) is projected out; m - 3 degrees of freedom
    remain. The table's error motion shows here by its radial part; its tangential part is what
    cannot be separated from the angle. A stated circle has twice as many, the axial ones, or fewer
    where the lengths do not determine them.
    """
    residuals = circle.residuals
    if residuals.dof == 0:
        return UNTESTED
    return GlobalTest.of(float(residuals.squares(residuals.seen[None])[0]), residuals.dof)


def _root(variance: Floats) -> Floats:
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)), dtype=np.float64)
