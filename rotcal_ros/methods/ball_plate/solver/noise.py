"""The noise of a centre, axis by axis: estimated from the residuals, tested, and what is used.

The nominal design keeps z apart from x and y: z has residuals and degrees of freedom of its own.
x and y share the plane: their variances follow from two quadratic forms of the residuals r,
r'r and r'Dr with D = +1 for x and -1 for y, and the expectation of both (Helmert's estimator).
With M the projector that takes noise to residuals these expectations hold traces of M, M D and
M D M D.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rotcal_ros.adjust.distributions import chi2_sf, f_sf, normal_sf
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.ball_plate.solver import model
from rotcal_ros.methods.ball_plate.solver.rejection import Fitted

SIGNIFICANCE = 0.01
"""Level of the chi-square test of the stated noise."""
AXIS_SIGNIFICANCE = 0.001
"""Level of each test of a single axis: against the others, and against its statement."""
OWN_SIGMA = 20
"""Degrees of freedom from which on z has a standard deviation of its own without further cause."""
QUIETEST = 0.05
"""An axis is no quieter than this part of the noisiest one: what looks so is a drift or a motion
along the other, and would get senseless weights."""
PROBES = 3000
"""Degrees of freedom of all probes together, for the one trace that has no closed form."""
NO_FREEDOM = 0.5
"""Degrees of freedom, a trace with rounding, below which there are none."""
PLANE = "x and y"


@dataclass(frozen=True)
class CentreNoise:
    """Standard deviations of a centre in x, y, z: ``used`` and ``estimated`` (3,).

    In metres, or in units of the rows' own ``std``. ``dof`` (3,) are their degrees of freedom.
    ``axial`` and ``plane`` are the probabilities that chance makes equal noise differ so much: of
    z and of the plane, of x and of y. ``p_value`` belongs to the two-sided chi-square test of the
    ``stated`` noise, ``p_axes`` (3,) to that of each axis; None when nothing was stated.
    ``weights`` (3,) are the standard deviations that the fits assumed: their unit covariances
    belong to them.
    """

    used: Floats
    estimated: Floats
    dof: Floats
    axial: float
    plane: float
    stated: float | None
    p_value: float | None
    p_axes: Floats | None
    weights: Floats

    @property
    def unequal(self) -> bool:
        """Whether one axis is noisier than another."""
        return min(self.axial, self.plane) < AXIS_SIGNIFICANCE

    @property
    def pooled(self) -> float:
        """Estimated standard deviation of a coordinate, all axes together."""
        return _pooled(self.estimated, self.dof)

    @property
    def sigma0(self) -> float:
        """Estimate / statement over all axes, 1 when nothing was stated."""
        return 1.0 if self.stated is None else self.pooled / self.stated

    @property
    def contradicts(self) -> bool:
        """Whether the residuals contradict the stated noise, in all, in one or between axes."""
        if self.p_value is None or self.p_axes is None:
            return False
        each = bool(np.any(self.p_axes < AXIS_SIGNIFICANCE))
        return self.p_value < SIGNIFICANCE or each or self.unequal

    @property
    def larger(self) -> bool:
        """Whether they contradict it and are larger: uncertainties follow them."""
        return self.stated is not None and bool(np.any(self.used > self.stated))

    @property
    def scale(self) -> Floats:
        """Factors (3,) of unit standard deviations that come from x and y, x and y, and z.

        Of x and y the larger one: they differ only where a statement holds for one of them, or
        where the fit could not weigh them.
        """
        factors = self.used / self.weights
        return np.array([factors[:2].max(), factors[:2].max(), factors[2]])

    def sentences(self, own_std: bool, explained: bool = False) -> list[str]:
        """Say which axis is noisier, and what of the statement does not hold.

        ``own_std``: the rows have standard deviations of their own, so there are only factors.
        ``explained``: why the axes differ is known, and reported.
        """
        found = [] if explained else self._differences(own_std)
        if not self.contradicts or self.p_axes is None:
            return found
        follow = "larger: uncertainties follow the residuals" if self.larger else "smaller"
        p_value = 0.0 if self.p_value is None else self.p_value
        if p_value >= SIGNIFICANCE:
            p_value = float(self.p_axes.min())
            follow += ", not in all axes"
        found.append(
            f"the residuals contradict the stated noise (sigma0 = {self.sigma0:.3f}, p = "
            f"{p_value:.2g}): they are {follow}"
        )
        return found

    def _differences(self, own_std: bool) -> list[str]:
        """Say which axis is noisier than which."""
        x, y, z = self.estimated
        plane = float(np.sqrt(0.5 * (x**2 + y**2)))
        state = "correct what is stated" if own_std else "state a standard deviation"
        found = []
        for p, first, second, names in (
            (self.axial, z, plane, ("z", PLANE)),
            (self.plane, x, y, ("x", "y")),
        ):
            if p < AXIS_SIGNIFICANCE:
                (small, quiet), (large, loud) = sorted(((first, names[0]), (second, names[1])))
                sizes = f"{large / MICROMETRE:.3g} um against {small / MICROMETRE:.3g} um, "
                unit = "" if own_std else sizes
                found.append(
                    f"the noise of {loud} is {large / small:.2f} times that of "
                    f"{quiet} ({unit}p = {p:.2g}): every component has the uncertainty of its "
                    f"axes; find out why, or {state} for each axis"
                )
        return found

    def details(self) -> dict[str, Any]:
        """Return the entries for the details of a result."""
        return {
            "estimated": self.estimated,
            "used": self.used,
            "dof": self.dof,
            "p_z_against_plane": self.axial,
            "p_x_against_y": self.plane,
            "p_stated": self.p_axes,
            "equal": not self.unequal,
        }


def assess(
    fits: Iterable[tuple[Fitted, float]],
    stated: float | None,
    *,
    first: CentreNoise | None = None,
    weights: Floats | None = None,
) -> CentreNoise:
    """Return the noise of a centre from fits and the angles their frames are turned by, rad.

    ``stated`` is the standard deviation to be tested, None when nothing was stated. ``weights``
    (3,) are the standard deviations that the fits assumed because the ``first`` assessment found
    the axes different; whether they are is not asked again.
    """
    sums, plane, dof_z = np.zeros(3), np.zeros((2, 2)), 0.0
    rounding, least = 0.0, 0.0
    for fit, turn in fits:
        rounding = max(rounding, model.rounding_variance(fit.problem))
        least = max(least, model.least_variance(fit.problem, fit.solution.estimate))
        squares, expected, axial = _moments(fit, turn)
        sums += squares
        plane += expected
        dof_z += axial
    weights = np.ones(3) if weights is None else weights
    # mean and half difference of the variances of x and y
    mean, half = np.linalg.solve(plane, [sums[0] + sums[1], sums[0] - sums[1]])
    squares = np.array([mean + half, mean - half, sums[2] / max(dof_z, 1.0)])
    factors = np.sqrt(np.maximum(squares, rounding))
    factors = np.maximum(factors, QUIETEST * factors.max())
    dof = np.array([0.5 * (plane[0, 0] + plane[0, 1]), 0.5 * (plane[0, 0] - plane[0, 1]), dof_z])
    if squares.max() < least:  # no noise at all: nothing can differ
        p_axial = p_plane = 1.0
    elif first is None:
        p_axial, p_plane = _z_against_plane(sums, plane, dof_z), _x_against_y(sums, plane)
    else:
        p_axial, p_plane = first.axial, first.plane
    # x and y share one factor unless they differ beyond what the weights hold already; z shares
    # theirs while it has too few residuals for one of its own
    used = factors.copy()
    if p_plane >= AXIS_SIGNIFICANCE or weights[0] != weights[1]:
        used[:2] = _pooled(factors[:2], dof[:2])
    if p_axial >= AXIS_SIGNIFICANCE and dof_z < OWN_SIGMA and first is None:
        used[:] = _pooled(factors, dof)
    found = CentreNoise(
        used * weights, factors * weights, dof, p_axial, p_plane, None, None, None, weights
    )
    return found if stated is None else _tested(found, stated)


def _tested(noise: CentreNoise, stated: float) -> CentreNoise:
    """Test a statement; where the residuals contradict it and are larger, they are used."""
    total = float(noise.dof.sum())
    p_value = _two_sided(chi2_sf(noise.pooled**2 * total / stated**2, total))
    p_axes = np.array(
        [
            _two_sided(chi2_sf(e**2 * d / stated**2, d)) if d > NO_FREEDOM else 1.0
            for e, d in zip(noise.estimated, noise.dof, strict=True)
        ]
    )
    follow = (p_axes < AXIS_SIGNIFICANCE) | (p_value < SIGNIFICANCE) | noise.unequal
    used = np.where(follow & (noise.used > stated), noise.used, stated)
    return replace(noise, used=used, stated=stated, p_value=p_value, p_axes=p_axes)


def _z_against_plane(sums: Floats, plane: Floats, dof_z: float) -> float:
    """Return how often equal noise makes z and the plane so different."""
    total, dof = sums[0] + sums[1], plane[0, 0]
    if dof_z < NO_FREEDOM or not total > 0.0:
        return 1.0
    return _two_sided(f_sf(sums[2] / dof_z / (total / dof), dof_z, dof))


def _moments(fit: Fitted, turn: float) -> tuple[Floats, Floats, float]:
    """Return the sums of squares (3,) of the residuals in x, y, z, and what is expected of them.

    The latter: the matrix (2, 2) that takes mean and half difference of the variances of x and y
    to the expectations of the sum and the difference of the squares; degrees of freedom of z.
    """
    own = fit.problem.noise_unit
    back = rotation_about_z(turn)
    residuals = (fit.solution.residuals / own) @ back.T
    cofactor = np.einsum("nij,ni,nj->ij", fit.solution.cofactor(), 1.0 / own, 1.0 / own)
    x, y, z = np.diag(back @ cofactor @ back.T)
    # M is a projector: the trace of M D M D is that of M less four times what mixes x and y
    squared = x + y - 4.0 * _mixed(fit, own, back, x + y)
    return np.sum(residuals**2, axis=0), np.array([[x + y, x - y], [x - y, squared]]), float(z)


def _mixed(fit: Fitted, own: Floats, back: Floats, dof: float) -> float:
    """Return the sum of squares of the part of M, which takes noise to residuals, from y to x.

    Of few centres column by column; of many from random signs s, as the mean of |x of M s|^2 where
    s has only y: one fit each. The signs are those of a fixed seed.
    """
    n, count = len(own), int(np.ceil(PROBES / max(dof, 1.0)))
    if n <= count:
        return sum(_to_x(fit, own, back, column) for column in np.eye(n))
    signs = np.random.default_rng(0).choice([-1.0, 1.0], size=(count, n))
    return sum(_to_x(fit, own, back, s) for s in signs) / count


def _to_x(fit: Fitted, own: Floats, back: Floats, noise: Floats) -> float:
    """Return the sum of squares in x of the residuals that noise (n,) in y alone leaves."""
    along = np.outer(noise, [0.0, 1.0, 0.0])
    left = (fit.linear.fit((along @ back) * own)[1] / own) @ back.T
    return float(left[:, 0] @ left[:, 0])


def _x_against_y(sums: Floats, plane: Floats) -> float:
    """Return how often equal noise gives x and y so different sums of squares.

    Of equal noise the ratio of difference and sum has the mean tr(M D)/dof and this variance,
    whatever the noise; it is nearly normal.
    """
    dof, first, second = plane[0, 0], plane[0, 1], plane[1, 1]
    total = sums[0] + sums[1]
    variance = 2.0 * (dof * second - first**2) / (dof**2 * (dof + 2.0))
    if not (total > 0.0 and variance > 0.0):
        return 1.0
    away = abs((sums[0] - sums[1]) / total - first / dof)
    return float(2.0 * normal_sf(away / np.sqrt(variance)))


def _pooled(std: Floats, dof: Floats) -> float:
    return float(np.sqrt(np.sum(std**2 * dof) / np.sum(dof)))


def _two_sided(tail: float) -> float:
    return float(2.0 * min(tail, 1.0 - tail))
