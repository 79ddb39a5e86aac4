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

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.special import erfc

from rotcal_ros.arrays import Floats
from rotcal_ros.components import HALF_OF_95_PERCENT
from rotcal_ros.methods.roots import root_between
from rotcal_ros.methods.tracer.adjustment import StationCovariance
from rotcal_ros.methods.tracer.angles import TableMotion

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
    """What centre and radius leave of the stations' radial distances, ``seen`` (m - 3,) in m.

    ``noise`` (m - 3, m - 3): their covariance from that of the stations, m^2. ``open_part``
    (m, m - 3): takes radial distances to them.
    """

    seen: Floats
    noise: Floats
    open_part: Floats


def circle_residuals(motion: TableMotion, total: Floats) -> CircleResiduals:
    """Return the free residuals of the circle; ``total`` (3 m, 3 m) are the stations' errors."""
    direction = motion.in_plane / np.linalg.norm(motion.in_plane, axis=1)[:, None]
    m = len(direction)
    absorbed = np.column_stack([direction, np.ones(m)])
    open_part = np.linalg.qr(absorbed, mode="complete")[0][:, 3:]
    outward = direction @ motion.plane.basis()
    radial = np.einsum("ja,jakb,kb->jk", outward, total.reshape(m, 3, m, 3), outward)
    noise = open_part.T @ radial @ open_part
    return CircleResiduals(open_part.T @ motion.radial, noise, open_part)


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


def error_motion_of(
    motion: TableMotion,
    covariance: StationCovariance,
    scale: float,
    stated: float | None,
    contradicted: bool,
) -> ErrorMotion:
    """Return the error motion that the covariance has to hold.

    What was stated, unless the circle contradicts it or nothing was: then what the circle leaves
    open, if that is more. ``scale`` enlarges the covariance of the stations.
    """
    stations = replace(
        covariance,
        lengths=scale**2 * covariance.lengths,
        targets=scale**2 * covariance.targets,
    )
    circle = circle_residuals(motion, stations.lengths + stations.targets)
    likely, allowed = estimate_error_motion(circle, tangential_std(motion, stations))
    used = stated
    if used is None or contradicted:
        used = max(used or 0.0, allowed)
    return ErrorMotion(stated, likely, allowed, len(circle.seen), used)
