"""How differently the table arrives at the same angle: scatter from run to run.

A run sees one place only, so what moves the table between runs deforms the triangle of the places.
What the rigid network leaves of the stations, the *contrasts*, are as many as stations have
coordinates beyond poses and places. With the network solved without scatter, b = U' W f holds
them: b ~ N(0, A + A G A), A = U' W U - U' W J C J' W U, where G is the covariance of the scatter,
block by block

    S = s_t^2 + s_r^2 [a]x [a]x',      a: the station seen from the point of the axis at z = 0.

In the range of A this is y ~ N(0, 1 + s_t^2 K_t + s_r^2 K_r). This likelihood, free of mean and of
nuisance, is the restricted likelihood of all lengths. Three dozen contrasts do not say much about
two standard deviations, so their whole posterior is used: s_t as likely everywhere, and s_r times
the radius of the places within a factor of two of it (one standard deviation). Arrivals of one run
at one angle are contrasts in all three directions.

With the weights fixed, the variance of a curve is linear in s_t^2 and s_r^2; its standard
deviation is the one with which +-1.96 of it hold 95 % of what is predicted, Student's t in spirit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import erfc

from rotcal_ros.arrays import Floats
from rotcal_ros.components import HALF_OF_95_PERCENT
from rotcal_ros.geometry.rotations import cross_matrix
from rotcal_ros.methods.distributions import chi2_sf
from rotcal_ros.methods.tracer_six.posterior import full_covariance, pulled
from rotcal_ros.methods.tracer_six.rig import Rig

OUTSIDE: Final = 0.05
RATIO_SPREAD: Final = float(np.log(2.0))
"""Standard deviation of ln(s_r radius / s_t)."""
NODES: Final = np.polynomial.hermite_e.hermegauss(5)
LEVELS: Final = np.concatenate([np.linspace(0.0, 2.0, 41)[:-1], 2.0 * 1.12 ** np.arange(81)])
"""Scatter in units of what doubles the noise of a contrast, over which the posterior is summed."""
RANGE: Final = 1e-6
"""Share of the largest eigenvalue of A from which a direction is a contrast."""


@dataclass(frozen=True, eq=False)
class Scatter:
    """``translation`` (m) and ``rotation`` (rad) of the scatter that the covariance holds.

    ``estimated`` says whether from the ``n_contrasts``; ``probability``: how probably chance
    makes the contrasts as large as they are with the stated scatter, None where none is stated.
    ``variances`` (k, 2) with ``weights`` (k,) are the posterior of both squares.
    """

    translation: float
    rotation: float
    estimated: bool
    n_contrasts: int
    probability: float | None
    variances: Floats
    weights: Floats

    def roots(self, arms: Floats) -> Floats | None:
        """Return roots (V, 3, 3) of the covariances at ``arms`` (V, 3), None for no scatter."""
        if self.translation == 0.0 and self.rotation == 0.0:
            return None
        covariance = self.translation**2 * np.eye(3) + self.rotation**2 * turned(arms)
        values, vectors = np.linalg.eigh(covariance)
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None], dtype=np.float64)


def turned(arms: Floats) -> Floats:
    """Return the covariances (V, 3, 3) at ``arms`` (V, 3) of a turn about every axis, m^2."""
    across = cross_matrix(arms)
    return np.asarray(across @ across.swapaxes(1, 2), dtype=np.float64)


def stated(translation: float, rotation: float) -> Scatter:
    """Return a scatter as it is stated, in m and rad."""
    alone = np.array([[translation**2, rotation**2]])
    return Scatter(translation, rotation, False, 0, None, alone, np.ones(1))


@dataclass(frozen=True, eq=False)
class Contrasts:
    """``value`` (q,), which noise makes N(0, 1), ``spread`` (2, q, q): K_t, K_r; ``radius`` m."""

    value: Floats
    spread: Floats
    radius: float


def contrasts(rig: Rig, arms: Floats) -> Contrasts:
    """Return the contrasts of a ``rig`` that was solved without scatter; ``arms`` (V, 3) in m."""
    v = len(arms)
    each = np.arange(v)
    spent = pulled(rig)
    matrix = -spent @ full_covariance(rig) @ spent.T
    matrix.reshape(v, 3, v, 3)[each, :, each] += rig.normal
    values, vectors = np.linalg.eigh(matrix)
    kept = values > RANGE * values[-1]
    force = rig.pull @ rig.slopes.error[:, :, None]
    root = vectors[:, kept] * np.sqrt(values[kept])
    by_station = root.reshape(v, 3, -1)
    moved = turned(arms) @ by_station
    value = (vectors[:, kept].T @ force.ravel()) / np.sqrt(values[kept])
    spread = np.stack([root.T @ root, root.T @ moved.reshape(3 * v, -1)])
    apart = rig.state.places - rig.state.places.mean(axis=0)
    radius = float(np.sqrt((apart**2).sum() / len(apart)))
    return Contrasts(value, spread, radius)


def estimate(
    found: Contrasts, translation: float | None, rotation: float | None, significance: float
) -> Scatter:
    """Return the scatter that ``found`` tells; what is stated (m, rad) stands.

    Both stated: they stand unless the contrasts contradict them with ``significance``; then both
    are estimated.
    """
    q = len(found.value)
    probability = None
    if translation is not None and rotation is not None:
        known = np.eye(q) + translation**2 * found.spread[0] + rotation**2 * found.spread[1]
        if q:
            square = float(found.value @ np.linalg.solve(known, found.value))
            probability = chi2_sf(square, q)
        if probability is None or probability >= significance:
            kept = stated(translation, rotation)
            return Scatter(
                translation, rotation, False, q, probability, kept.variances, kept.weights
            )
        translation = rotation = None
    variances, weights = _posterior(found, translation, rotation)
    mean = weights @ variances
    return Scatter(
        float(np.sqrt(mean[0])), float(np.sqrt(mean[1])), True, q, probability, variances, weights
    )


def _posterior(
    found: Contrasts, translation: float | None, rotation: float | None
) -> tuple[Floats, Floats]:
    """Return squares of both scatters (k, 2) and how likely each pair is (k,)."""
    directions, priors = _directions(found, translation, rotation)
    base = np.array([(translation or 0.0) ** 2, (rotation or 0.0) ** 2])
    noise = np.eye(len(found.value)) + np.tensordot(base, found.spread, 1)
    root = np.linalg.inv(np.linalg.cholesky(noise))
    value = root @ found.value
    variances, logs = [], []
    for direction, prior in zip(directions, priors, strict=True):
        spread = root @ np.tensordot(direction, found.spread, 1) @ root.T
        values, vectors = np.linalg.eigh(spread)
        unit = 1.0 / max(float(values.mean()), np.finfo(np.float64).tiny)
        level = unit * LEVELS**2
        total = 1.0 + level[:, None] * np.maximum(values, 0.0)
        square = (vectors.T @ value) ** 2
        width = np.gradient(LEVELS) * np.sqrt(unit)
        likelihood = -0.5 * (np.log(total) + square / total).sum(axis=1)
        logs.append(likelihood + np.log(width) + np.log(prior))
        variances.append(base + level[:, None] * direction)
    weights = np.concatenate(logs)
    weights = np.exp(weights - weights.max())
    return np.concatenate(variances), weights / weights.sum()


def _directions(
    found: Contrasts, translation: float | None, rotation: float | None
) -> tuple[Floats, Floats]:
    """Return what grows with the level in both squares (k, 2), and how likely each is (k,)."""
    if translation is not None:
        return np.array([[0.0, 1.0]]), np.ones(1)
    if rotation is not None:
        return np.array([[1.0, 0.0]]), np.ones(1)
    ratio = np.exp(2.0 * RATIO_SPREAD * NODES[0]) / found.radius**2
    return np.column_stack([np.ones_like(ratio), ratio]), np.asarray(NODES[1] / NODES[1].sum())


def enlargement(scatter: Scatter, variance: Floats, slope: Floats) -> Floats:
    """Return factors (c,) on standard deviations whose 1.96 fold then holds 95 %.

    ``variance`` (c,) is that with the scatter as used, ``slope`` (2, c) what a unit of each
    square adds to it.
    """
    if not scatter.estimated:
        return np.ones_like(variance)
    likely = scatter.weights > 1e-7
    used = np.array([scatter.translation**2, scatter.rotation**2])
    spread = variance + (scatter.variances[likely] - used) @ slope
    spread = np.maximum(spread / variance, 1e-12)
    weights = scatter.weights[likely] / scatter.weights[likely].sum()
    factor = np.ones_like(variance)
    for _ in range(12):
        reach = HALF_OF_95_PERCENT * factor / np.sqrt(2.0 * spread)
        outside = weights @ erfc(reach) - OUTSIDE
        slope_of = weights @ (np.exp(-(reach**2)) * reach) * (-2.0 / np.sqrt(np.pi)) / factor
        step = np.clip(outside / slope_of, -0.3 * factor, 0.3 * factor)
        factor = factor - step
        if np.abs(step).max() < 1e-6:
            break
    return np.asarray(factor, dtype=np.float64)
