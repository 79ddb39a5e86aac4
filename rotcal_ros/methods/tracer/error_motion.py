"""The table's radial error motion, as the circle of the stations tells it.

A station leaves its circle by the radial part of the table's error motion (EXC, EYC, and tilts
times the height of the tracer) and by the noise of its own place. The tangential part cannot be
told from the angle; it is taken to be as large. m - 3 residuals do not say much about a standard
deviation, so their whole posterior is used: the value that goes into the covariance is the one
with which an interval of +-1.96 standard deviations holds 95 % of what is predicted. From exact
stations that is Student's t with m - 3 degrees of freedom; where the noise of the stations
explains the residuals, little is left of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import erfc

from rotcal_ros.arrays import Floats
from rotcal_ros.components import HALF_OF_95_PERCENT
from rotcal_ros.methods.roots import root_between
from rotcal_ros.methods.tracer.adjustment import StationCovariance
from rotcal_ros.methods.tracer.angles import TableMotion
from rotcal_ros.methods.tracer.circle_prior import circle_contrasts, without_prior

OUTSIDE: Final = 0.05
TINY: Final = 1e-12
"""Error motion (m) that is none."""
DECADES: Final = np.logspace(-3.0, 3.0, 121)
"""Error motions, in units of the radial residuals, over which the posterior is summed."""


@dataclass(frozen=True, slots=True)
class ErrorMotion:
    """Standard deviations of the error motion per direction in the plane, m.

    ``stated``: None when nothing was stated. ``likely``: the most likely one, from the circle's
    ``dof`` free residuals, ``allowed``: the one that covers what these leave open, ``used``: what
    the covariance holds.
    """

    stated: float | None
    likely: float
    allowed: float
    dof: int
    used: float

    @property
    def estimated(self) -> bool:
        """Whether the circle, not the statement, tells what is used."""
        return self.stated is None or self.used > self.stated


@dataclass(frozen=True, eq=False)
class CircleResiduals:
    """What centre and radius leave of the stations' radial distances, ``seen`` (k,) in m.

    ``noise`` (k, k): their covariance from that of the stations, m^2. k = m - 3, or fewer where
    the circle was stated and the lengths do not tell all of them.
    """

    seen: Floats
    noise: Floats


def circle_residuals(
    motion: TableMotion, total: Floats, circle_std: float | None = None
) -> CircleResiduals:
    """Return the free residuals of the circle; ``total`` (3 m, 3 m) are the stations' errors.

    Where the stations were bound to a circle with ``circle_std`` (m), what the lengths alone say.
    """
    direction, open_part = _radial(motion)
    m = len(direction)
    outward = direction @ motion.plane.basis()
    radial = np.einsum("ja,jakb,kb->jk", outward, total.reshape(m, 3, m, 3), outward)
    noise = open_part.T @ radial @ open_part
    if circle_std is None:
        return CircleResiduals(open_part.T @ motion.radial, noise)
    alone = without_prior(open_part.T @ motion.radial, noise, circle_std)
    return CircleResiduals(alone.seen, np.diag(alone.noise))


@dataclass(frozen=True, eq=False)
class CircleTest:
    """What the circle is tested by: ``seen`` (k,), m, with the ``covariance`` (k, k), m^2.

    ``moved`` takes moves (t, m, 3) of the stations, m, to what they do to them (t, k).
    ``redundancy``: share of a stated circle that the lengths check.
    """

    seen: Floats
    covariance: Floats
    moved: Callable[[Floats], Floats]
    redundancy: float = 1.0


def circle_tested(
    stations: Floats,
    motion: TableMotion,
    total: Floats,
    expected_std: float,
    circle_std: float | None,
) -> CircleTest:
    """Return what tells whether ``stations`` (m, 3) leave their circle by more than expected.

    ``total`` (3 m, 3 m): covariance of the stations, ``expected_std`` (m): of their deviation from
    the circle. Radial distances, with the error motion as expected; where the stations were
    bound to a circle with ``circle_std`` (m), radial and axial ones as the lengths tell them.
    """
    if circle_std is not None:
        value, slope = circle_contrasts(stations)
        alone = without_prior(value, slope @ total @ slope.T, circle_std)
        variance = np.diag(alone.noise + expected_std**2)
        basis = slope.T @ alone.basis
        return CircleTest(
            alone.seen, variance, lambda moves: moves.reshape(len(moves), -1) @ basis,
            alone.redundancy,
        )  # fmt: skip
    total = total + error_motion_covariance(motion, expected_std)
    circle = circle_residuals(motion, total)
    outward, open_part = _radial(motion)

    def moved(moves: Floats) -> Floats:
        radial = np.einsum("kja,ja->kj", moves @ motion.plane.basis().T, outward)
        return np.asarray(radial @ open_part)

    return CircleTest(circle.seen, circle.noise, moved)


def error_motion_covariance(motion: TableMotion, std: float) -> Floats:
    """Return the covariance (3 m, 3 m) of independent error motions ``std`` (m) in the plane."""
    normal = motion.plane.normal
    in_plane = np.eye(3) - np.outer(normal, normal)
    blocks = np.kron(np.eye(len(motion.in_plane)), std**2 * in_plane)
    return np.asarray(blocks, dtype=np.float64)


def _radial(motion: TableMotion) -> tuple[Floats, Floats]:
    """Return the stations' directions (m, 2) from the centre, and what no circle absorbs of them.

    The latter (m, m - 3) takes radial distances to their free residuals.
    """
    direction = motion.in_plane / np.linalg.norm(motion.in_plane, axis=1)[:, None]
    absorbed = np.column_stack([direction, np.ones(len(direction))])
    return direction, np.linalg.qr(absorbed, mode="complete")[0][:, 3:]


def tangential_std(motion: TableMotion, covariance: StationCovariance) -> float:
    """Return the root mean square standard deviation of the stations along their circle, m."""
    across = np.column_stack([-motion.in_plane[:, 1], motion.in_plane[:, 0]]) / motion.radius
    along = across @ motion.plane.basis()
    variance = np.einsum("ja,jab,jb->j", along, covariance.position_blocks(), along)
    return float(np.sqrt(variance.mean()))


def estimate_error_motion(circle: CircleResiduals, tangential: float) -> tuple[float, float]:
    """Return the likely and the allowed standard deviation of the error motion, m.

    ``tangential``: standard deviation of a station along the circle, m, which the error motion
    joins in squares. The prior is that of a variance component beside a known one
    (sigma / (sigma^2 + noise) d sigma), which for exact stations is Jeffreys'.
    """
    noise, axes = np.linalg.eigh(circle.noise)
    noise, squares = np.maximum(noise, 0.0), (axes.T @ circle.seen) ** 2
    level = float(noise.mean())
    sigma = DECADES * np.sqrt(level + float(squares.mean()) + TINY**2)
    variance = noise + sigma[:, None] ** 2
    fit = -0.5 * (np.log(variance) + squares / variance).sum(axis=1)
    posterior = np.exp(fit - fit.max()) * sigma**2 / (sigma**2 + level)
    posterior /= posterior.sum()
    together = np.hypot(sigma, tangential)

    def beyond(limit: float) -> float:
        return float(posterior @ erfc(limit / (np.sqrt(2.0) * together))) - OUTSIDE

    half = root_between(beyond, 0.0, float(20.0 * together[-1]), TINY)
    allowed = np.sqrt(max((half / HALF_OF_95_PERCENT) ** 2 - tangential**2, 0.0))
    likely = sigma[int(np.argmax(fit))] if fit.max() > fit[0] else 0.0
    return float(likely), float(allowed)


def likely_circle(circle: CircleTest, expected_std: float) -> float:
    """Return the deviation from the circle, m, that what was seen leaves open.

    ``expected_std`` (m) is the one in the ``circle``.
    """
    if len(circle.seen) == 0:
        return expected_std
    noise = circle.covariance - expected_std**2 * np.eye(len(circle.seen))
    level = float(np.sqrt(np.trace(noise) / len(noise)))
    return estimate_error_motion(CircleResiduals(circle.seen, noise), level)[1]


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
    circle = circle_residuals(motion, stations.total, circle_std)
    if len(circle.seen) == 0:
        return ErrorMotion(stated, 0.0, 0.0, 0, stated or 0.0)
    likely, allowed = estimate_error_motion(circle, tangential_std(motion, stations))
    used = stated
    if used is None or contradicted:
        used = max(used or 0.0, allowed)
    return ErrorMotion(stated, likely, allowed, len(circle.seen), used)
