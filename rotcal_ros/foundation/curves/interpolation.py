"""Curves through measured points, as linear maps, so that covariances travel with the values.

Every curve here is a matrix W (m, n): values at m wanted angles = W @ values at n measured
angles, and covariance = W @ C @ W.T. Angles are radians.
"""

from __future__ import annotations

from math import pi
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.units import DEGREE, TURN

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

SAME_ANGLE: Final = 1e-9
"""rad; angles closer than this are the same table position."""


def curve_through(nodes: Floats, values: Floats, period: float) -> PPoly:
    """Return the cubic spline through ``values`` (n, ...) at ``nodes`` (n,), which ascend.

    With ``period`` > 0 the nodes lie within one period and the curve closes; then two nodes are
    joined by straight lines. With ``period`` 0 they cover an arc and the spline ends "not-a-knot".
    It takes angles that :func:`wrap_to_period` returned.
    """
    # scipy.interpolate takes longer to load than most verbs, which do without, take to run.
    from scipy.interpolate import CubicSpline, PPoly

    if period == 0.0:
        return CubicSpline(nodes, values, bc_type="not-a-knot")
    knots = np.append(nodes, nodes[0] + period)
    closed = np.concatenate([values, values[:1]])
    if len(nodes) > 2:
        return CubicSpline(knots, closed, bc_type="periodic")
    slopes = (np.diff(closed.T) / np.diff(knots)).T
    return PPoly(np.stack([slopes, closed[:-1]]), knots)


def wrap_to_period(nodes: Floats, at: ArrayLike, period: float) -> Floats:
    """Return the angles ``at`` wrapped into the period that begins at the first node.

    Raises DataError for angles outside an arc (``period`` 0): nothing was measured there.
    """
    angles = np.asarray(at, dtype=np.float64)
    if period > 0.0:
        return np.asarray(nodes[0] + np.mod(angles - nodes[0], period), dtype=np.float64)
    outside = angles[(angles < nodes[0] - SAME_ANGLE) | (angles > nodes[-1] + SAME_ANGLE)]
    if outside.size:
        first, low, high = np.array([outside.flat[0], nodes[0], nodes[-1]]) / DEGREE
        raise DataError(
            f"the angle {first:.6g} deg lies outside the measured arc {low:.6g} .. "
            f"{high:.6g} deg, where nothing is known: choose one inside it"
        )
    return angles


def interpolation_matrix(nodes: Floats, at: Floats, period: float) -> Floats:
    """Return W (m, n) with values(at) = W @ values(nodes), see :func:`curve_through`."""
    curve = curve_through(nodes, np.eye(len(nodes)), period)
    return np.asarray(curve(wrap_to_period(nodes, np.atleast_1d(at), period)), dtype=np.float64)


def row_angles(nodes: Floats, period: float, spacing: float) -> Floats:
    """Return row angles every ``spacing`` rad: from 0 for a circle, else inside the arc.

    If the spacing does not divide the turn, the last interval of a circle is shorter. An arc keeps
    its two ends as rows.
    """
    if not np.isfinite(spacing) or spacing < 1e-5 or spacing > pi:
        raise ConfigurationError(
            f"spacing {spacing / DEGREE:.6g} deg: expected more than 0.001 and at most 180 deg"
        )
    if period > 0.0:
        count = int(np.ceil(period / spacing - 1e-9))
        return np.asarray(np.arange(count) * spacing, dtype=np.float64)
    first, last = float(nodes[0]), float(nodes[-1])
    steps = np.arange(np.ceil(first / spacing), np.floor(last / spacing) + 1) * spacing
    inner = steps[(steps > first + SAME_ANGLE) & (steps < last - SAME_ANGLE)]
    return np.asarray(np.concatenate([[first], inner, [last]]), dtype=np.float64)


def wrap_to_turn(angle: float) -> float:
    """Return ``angle`` within [0, 2 pi); rounding below the full turn counts as zero."""
    within = float(np.mod(angle, TURN))
    return 0.0 if TURN - within < SAME_ANGLE else within


def harmonic_basis(angles: Floats, order: int) -> Floats:
    """Return (n, 2 order + 1) columns 1, cos t, sin t, cos 2t, sin 2t, ... of ``angles`` (n,)."""
    columns = [np.ones_like(angles)]
    for k in range(1, order + 1):
        columns += [np.cos(k * angles), np.sin(k * angles)]
    return np.column_stack(columns)


def without_harmonics(angles: Floats, order: int, free: Floats | None = None) -> Floats:
    """Return the projection (n, n) of n values that removes offset and harmonics up to ``order``.

    It also removes the columns of ``free`` (n, q). It is unweighted, so that nothing depends most
    on an angle whose value is zero by definition. Raises DataError when the ``angles`` leave
    nothing.
    """
    basis = orthonormal_harmonic_basis(angles, order, free)
    return np.asarray(np.eye(len(angles)) - basis @ basis.T, dtype=np.float64)


def orthonormal_harmonic_basis(angles: Floats, order: int, free: Floats | None = None) -> Floats:
    """Return an orthonormal basis (n, u) of offset, harmonics up to ``order`` and ``free`` (n, q).

    Raises DataError if they leave nothing of n values.
    """
    columns = harmonic_basis(angles, order)
    if free is not None:
        columns = np.hstack([columns, free])
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    basis = u[:, s > 1e-9 * s[0]]
    if len(angles) <= basis.shape[1]:
        raise DataError(
            f"{len(angles)} common angles: more than {basis.shape[1]} are needed to compare"
        )
    return np.asarray(basis, dtype=np.float64)


def harmonic_estimator(nodes: Floats, order: int, covariance: Floats) -> Floats:
    """Return H (2 order + 1, n): coefficients of :func:`harmonic_basis` = H @ values(nodes).

    The best linear unbiased estimate for values with ``covariance`` (n, n). A variance common to
    all values is added first: the constant term absorbs it, the other coefficients do not change,
    and a covariance that is exactly zero at the reference angle becomes regular. Raises DataError
    when the nodes cannot separate so many harmonics.
    """
    size = 2 * order + 1
    if order < 0 or size > len(nodes):
        raise DataError(
            f"harmonics up to order {order} need {size} angles, the result has {len(nodes)}: "
            f"choose an order of at most {(len(nodes) - 1) // 2}"
        )
    basis = harmonic_basis(nodes, order)
    root = regularised_cholesky(covariance)
    white = np.linalg.solve(root, basis)
    singular = np.linalg.svd(white / np.linalg.norm(white, axis=0), compute_uv=False)
    if singular[-1] < 1e-8 * singular[0]:
        raise DataError(
            f"the {len(nodes)} angles cannot separate harmonics up to order {order}: "
            "lower the order or measure evenly around the whole circle"
        )
    q, r = np.linalg.qr(white)
    return np.asarray(np.linalg.solve(r, np.linalg.solve(root.T, q).T), dtype=np.float64)


def regularised_cholesky(covariance: Floats) -> Floats:
    """Return the lower Cholesky root of ``covariance`` (n, n) plus a common variance.

    Use it only for estimates with a free offset, which the common variance does not change. Exact
    values (no variance at all) all have the same weight.
    """
    n = len(covariance)
    scale = float(np.trace(covariance)) / n
    if scale <= 0.0:
        return np.eye(n)
    regular = covariance / scale + 1.0
    regular[np.diag_indices(n)] += 1e-12  # regular also where two values are fully correlated
    try:
        return np.asarray(np.linalg.cholesky(regular) * np.sqrt(scale), dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise DataError(
            "the covariance of the deviations is not positive semi-definite: "
            "the result is damaged, solve again"
        ) from error
