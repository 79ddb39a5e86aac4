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

The prior is that of Jeffreys, d sigma / sigma, for error motions well above the stations' noise
across the circle (x = sigma / noise), times y^6 / (1 + y^6) with y = x / 1.5, and beside it "none
at all" with the weight of ABSENT natural logarithms of sigma. It was set by the coverage of 8 and
9 residuals of equal noise, which is an integral over chi-squared: 94 to 97 % for every size. With
d sigma / sigma alone a round table's intervals held 99 %. With fewer residuals a round table's
hold more (98.8 % with 4), since so few cannot show that it is round.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.special import erfc

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


@dataclass(frozen=True, eq=False)
class CircleResiduals:
    """The stations' radial distances as far as no circle takes them up.

    ``seen`` (k,): distances, m; ``noise`` (k, k): their covariance from that of the stations, m^2.
    What their combinations ``absorbed`` (k, 3), orthonormal, say went into centre and radius; of
    whole matrices those were taken off before, and none is left, (k, 0).
    """

    seen: Floats
    noise: LowRank
    absorbed: Floats

    @classmethod
    def free(cls, seen: Floats, noise: LowRank) -> CircleResiduals:
        """Return residuals of which nothing is absorbed any more."""
        return cls(seen, noise, np.zeros((len(seen), 0)))

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

    def likelihood(self, variances: Floats) -> Floats:
        """Return ln of the likelihood (t,) of what was seen, up to a constant.

        With noises of these ``variances`` (t,), m^2, beside that of the stations.
        """
        if self.noise.columns is None:
            noise, axes = np.linalg.eigh(self.noise.dense())
            squares = (axes.T @ self.seen) ** 2
            variance = np.maximum(noise, 0.0) + variances[:, None]
            return np.asarray(-0.5 * (np.log(variance) + squares / variance).sum(axis=1))
        seen = self._open(self.seen[None])
        found = [self._fit(self.noise.lifted(v), seen) for v in variances.tolist()]
        return np.array([-0.5 * (log + squares[0]) for squares, log in found])

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
    if radial.columns is not None and circle_std is None:
        return CircleResiduals(motion.radial, radial, np.linalg.qr(absorbed)[0])
    free = _free(absorbed)
    seen, noise = free.T @ motion.radial, free.T @ radial.times(free)
    if circle_std is None:
        return CircleResiduals.free(seen, LowRank.whole(noise))
    alone = without_prior(seen, noise, circle_std)
    return CircleResiduals.free(alone.seen, LowRank.of_blocks(alone.noise[:, None, None]))


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
) -> CircleTest:
    """Return the test of whether ``stations`` (m, 3) leave their circle by more than expected.

    ``total`` (3 m, 3 m): covariance of the stations, ``expected_std`` (m): of their deviation from
    the circle. Radial distances, with the error motion as expected; where the stations were
    bound to a circle with ``circle_std`` (m), radial and axial ones as the lengths determine them.
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
    circle = _circle_residuals(motion, total + error_motion_spread(motion, expected_std))
    direction, absorbed = _radial(motion)
    outward = direction @ motion.plane.basis()

    def moved(moves: Floats) -> Floats:
        radial = np.einsum("kja,ja->kj", moves, outward)
        return radial if circle.absorbed.size else np.asarray(radial @ _free(absorbed))

    return CircleTest(circle, moved)


def error_motion_spread(motion: TableMotion, std: float) -> LowRank:
    """Return the covariance (3 m, 3 m) of independent error motions ``std`` (m) in the plane."""
    normal = motion.plane.normal
    in_plane = std**2 * (np.eye(3) - np.outer(normal, normal))
    return LowRank.of_blocks(np.tile(in_plane, (len(motion.in_plane), 1, 1)))


def _radial(motion: TableMotion) -> tuple[Floats, Floats]:
    """Return the stations' directions (m, 2) from the centre, and what a circle absorbs (m, 3)."""
    direction = motion.in_plane / np.linalg.norm(motion.in_plane, axis=1)[:, None]
    return direction, np.column_stack([direction, np.ones(len(direction))])


def _free(absorbed: Floats) -> Floats:
    """Return the combinations (m, m - 3) of radial distances of which nothing is ``absorbed``."""
    return np.asarray(np.linalg.qr(absorbed, mode="complete")[0][:, 3:], dtype=np.float64)


def _tangential_std(motion: TableMotion, covariance: StationCovariance) -> float:
    """Return the root mean square standard deviation of the stations along their circle, m."""
    across = np.column_stack([-motion.in_plane[:, 1], motion.in_plane[:, 0]]) / motion.radius
    along = across @ motion.plane.basis()
    variance = np.einsum("ja,jab,jb->j", along, covariance.position_blocks(), along)
    return float(np.sqrt(variance.mean()))


def _estimate_error_motion(circle: CircleResiduals, tangential: float) -> tuple[float, float]:
    """Return the likely and the allowed standard deviation of the error motion, m.

    ``tangential``: standard deviation of a station along the circle, m, which the error motion
    joins in squares. The prior is in this module's docstring.
    """
    level = circle.variance
    sigma = DECADES * np.sqrt(level + circle.mean_square + TINY**2)
    sigma = np.concatenate([[0.0], sigma])
    # exact stations on an exact circle: TINY keeps the likelihood of "none" finite
    fit = circle.likelihood(sigma**2 + TINY**2)
    seen = sigma[1:] ** STEEPNESS
    prior = SPACING * seen / (seen + (NOTICED**2 * level) ** (STEEPNESS / 2))
    posterior = np.exp(fit - fit.max()) * np.concatenate([[ABSENT], prior])
    posterior /= posterior.sum()
    together = np.hypot(sigma, tangential)

    def beyond(limit: float) -> float:
        reach = limit / (np.sqrt(2.0) * np.maximum(together, TINY))
        return float(posterior @ erfc(reach)) - OUTSIDE

    half = root_between(beyond, 0.0, float(20.0 * together[-1]), TINY)
    allowed = np.sqrt(max((half / HALF_OF_95_PERCENT) ** 2 - tangential**2, 0.0))
    return float(sigma[int(np.argmax(fit))]), float(allowed)


def likely_circle(circle: CircleTest, expected_std: float) -> float:
    """Return the deviation from the circle, m, that what was seen leaves open.

    ``expected_std`` (m) is the one in the ``circle``.
    """
    if circle.residuals.dof == 0:
        return expected_std
    alone = circle.residuals.lifted(-(expected_std**2))
    return _estimate_error_motion(alone, float(np.sqrt(alone.variance)))[1]


def error_motion_of(
    motion: TableMotion,
    covariance: StationCovariance,
    scale: float,
    stated: float | None,
    contradicted: bool,
    circle_std: float | None = None,
) -> ErrorMotion:
    """Return the error motion that the covariance has to hold.

    What was stated, unless the circle contradicts it or nothing was: then what the circle leaves
    open, if that is more. ``scale`` enlarges the covariance of the stations, which were bound to
    a circle with ``circle_std`` (m).
    """
    stations = covariance.enlarged(scale)
    circle = _circle_residuals(motion, stations.total, circle_std)
    if circle.dof == 0:
        return ErrorMotion(stated, 0.0, 0.0, 0, stated or 0.0)
    likely, allowed = _estimate_error_motion(circle, _tangential_std(motion, stations))
    used = stated
    if used is None or contradicted:
        used = max(used or 0.0, allowed)
    return ErrorMotion(stated, likely, allowed, circle.dof, used)


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
) -> AngleUncertainty:
    """Propagate the stations' covariance times ``scale``^2 and the error motion to the angles.

    ``stations`` (m, 3), m, have gone through this ``motion``.
    ``slips`` (3 m, 3 m): what unseen slips add to that of the stations, m^2. ``gathered`` (m, m):
    what disturbances that gather in one place add to that of the cumulative angles, rad^2.
    """
    bearing, own = bearing_slopes(stations, motion), covariance.enlarged(scale)
    sources = {
        "lengths": own.lengths,
        "targets": own.targets,
        "error_motion": error_motion_spread(motion, error_motion_std),
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
