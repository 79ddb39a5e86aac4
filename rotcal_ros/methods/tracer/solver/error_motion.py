"""The error motion of the table, where nobody stated it: what the stations' circle leaves open.

A station leaves its circle by the radial part of the table's error motion (EXC, EYC, and tilts
times the height of the tracer) and by the noise of its own place. The tangential part cannot be
separated from the angle; it is taken to be as large, which is believed and never measured: a
tracer that mount or cable shift along its circle spoils the angle and leaves no trace. m - 3
residuals do not say much about a standard deviation, so their whole posterior is used: the value
that goes into the covariance is the one with which an interval of +-1.96 standard deviations holds
95 % of what is predicted. From exact stations that is Student's t with m - 3 degrees of freedom;
where the noise of the stations explains the residuals, little is left of it.

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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from scipy.special import erfc

from rotcal_ros.adjust.error_motion import WHITE, Spectrum
from rotcal_ros.adjust.low_rank import LowRank, Slopes
from rotcal_ros.adjust.roots import root_between
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import HALF_OF_95_PERCENT
from rotcal_ros.foundation.results import ErrorMotion
from rotcal_ros.methods.tracer.solver.circle import TableMotion, bearing_slopes

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

    ``seen`` (k,): combinations of them, m, ``combined`` (m, k); ``noise`` (k, k): their covariance
    from that of the stations, m^2.
    """

    seen: Floats
    noise: Floats
    combined: Floats

    @property
    def dof(self) -> int:
        """The number of free residuals, m - 3."""
        return len(self.seen)

    @property
    def variance(self) -> float:
        """The mean variance of a free residual, m^2."""
        return float(np.trace(self.noise)) / self.dof

    @property
    def mean_square(self) -> float:
        """The mean square of the free residuals, m^2."""
        return float(self.seen @ self.seen) / self.dof

    def likelihood(self, variances: Floats, radial: Floats | None = None) -> Floats:
        """Return ln of the likelihood (t,) of what was seen, up to a constant.

        With errors of these ``variances`` (t,), m^2, beside those of the stations: independent
        ones, or by ``radial`` (m, r) columns of a motion at the stations, of size 1.
        """
        noise, axes = self._axes
        std = np.sqrt(noise)[:, None]
        along = axes.T / std if radial is None else axes.T @ (self.combined.T @ radial) / std
        values, vectors = np.linalg.eigh(along @ along.T)
        squares = (vectors.T @ (axes.T @ self.seen / std[:, 0])) ** 2
        larger = 1.0 + np.maximum(values, 0.0) * variances[:, None]
        fit = np.log(larger).sum(axis=1) + (squares / larger).sum(axis=1)
        return np.asarray(-0.5 * (np.log(noise).sum() + fit))

    @cached_property
    def _axes(self) -> tuple[Floats, Floats]:
        """Variances (k,) and axes (k, k) of the noise; TINY keeps exact stations finite."""
        noise, axes = np.linalg.eigh(self.noise)
        return np.maximum(noise, 0.0) + TINY**2, axes


def _circle_residuals(motion: TableMotion, total: LowRank) -> CircleResiduals:
    """Return the free residuals of the circle; ``total`` (3 m, 3 m) are the stations' errors."""
    direction, absorbed = _radial(motion)
    radial = Slopes.alone(direction @ motion.plane.basis()).spread(total)
    free = _free(absorbed)
    return CircleResiduals(free.T @ motion.radial, free.T @ radial.times(free), free)


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


def error_motion_of(
    stations: Floats, motion: TableMotion, covariance: Floats
) -> tuple[ErrorMotion, Spectrum]:
    """Return the error motion that the circle leaves open, and its spectrum.

    ``covariance`` (3 m, 3 m) of the ``stations`` (m, 3), which were bound to no circle.
    """
    total = LowRank.whole(covariance, 3)
    circle = _circle_residuals(motion, total)
    if circle.dof == 0:
        return ErrorMotion(None, 0.0, 0.0, 0, 0.0), WHITE
    bearing = bearing_slopes(stations, motion)
    found = _estimate_error_motion(
        circle, _mean_variance(bearing, total), _supposed(motion, bearing)
    )
    return ErrorMotion(
        None, found.likely, found.allowed, circle.dof, found.allowed
    ), found.spectrum
