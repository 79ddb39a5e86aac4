"""Spheres through probed points: orthogonal distance fit of many balls at once.

A touch point is the centre of the probe tip; it lies at the distance ball radius + tip radius
from the ball's centre. All balls are fitted in one go: arrays carry the ball as first axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import GeometryError
from rotcal_ros.foundation.language import Phrase, phrase

MAX_STEPS = 50
CONVERGED = 1e-12
"""Last step of the centre, as part of the radius."""
WEAKEST = 20.0
"""Largest accepted standard deviation of the centre, in standard deviations of a touch point."""
FALSE_ALARM = 0.01
"""Probability that a good ball loses a touch point."""
NOISE_FLOOR = 1e-12
"""Residuals below this part of the radius are rounding, not outliers."""


@dataclass(frozen=True)
class Spheres:
    """Fitted spheres, B of them, from up to n points each.

    ``centres`` (B, 3) and ``radii`` (B,), radius of the ball without the tip, in metres;
    ``unit_covariance`` (B, 3, 3) of the centre for unit standard deviation of a touch point;
    ``std`` (B,) that standard deviation from the residuals, m; ``dof`` (B,); ``radius_std`` (B,)
    that of the radius, m, 0 if it is known.
    ``residuals`` (B, n), metres, distance to the sphere, outside positive, also of unused
    points; ``used`` (B, n). ``form_deviation`` (B,), metres: largest minus smallest residual of
    the used points. ``reason`` says why a ball was refused, None for a good one; the numbers
    of refused balls are NaN.
    """

    centres: Floats
    radii: Floats
    radius_std: Floats
    unit_covariance: Floats
    std: Floats
    dof: Ints
    residuals: Floats
    used: Bools
    form_deviation: Floats
    reason: tuple[Phrase | None, ...]

    @property
    def covariance(self) -> Floats:
        """Covariance (B, 3, 3) of the centres in m^2, from each ball's own scatter."""
        return self.std[:, None, None] ** 2 * self.unit_covariance


def fit_spheres(
    points: Floats,
    *,
    radius: float | None,
    tip_radius: float = 0.0,
    used: Bools | None = None,
    reject: bool = True,
) -> Spheres:
    """Fit spheres to probe points (B, n, 3) by orthogonal distance.

    ``radius`` is the known radius of the balls, None to fit it; ``tip_radius`` that of the probe
    tip, both in metres. ``used`` (B, n) leaves points out, so that balls may have different
    counts; points that are not finite are left out as well. The outlier test removes the worst
    point of a ball as long as it stands out of the others, unless ``reject`` is False. Balls with
    too few or badly spread points are refused one by one, see :attr:`Spheres.reason`. Raises
    GeometryError when the arrays do not fit together.
    """
    points, mask = _checked(points, used)
    free = radius is None
    offset = tip_radius if free else float(radius or 0.0) + tip_radius
    reason = _too_few(mask, 4 if free else 3)
    while True:
        centres, radii, design = _gauss_newton(points, mask, offset, free)
        residuals = np.linalg.norm(points - centres[:, None], axis=2) - radii[:, None]
        inverse, spread = _invert(design)
        dof = mask.sum(axis=1) - design.shape[2]
        square = np.sum(np.where(mask, residuals, 0.0) ** 2, axis=1)
        if not reject:
            break
        bad = _worst(residuals, design, inverse, mask, square, dof, offset)
        bad &= np.array([not why for why in reason])[:, None]
        if not bad.any():
            break
        mask = mask & ~bad
    reason = _badly_spread(reason, spread, inverse, centres, free)
    good = np.array([not why for why in reason])
    shown = np.where(mask & good[:, None], residuals, np.nan)
    with np.errstate(all="ignore"):
        form = np.fmax.reduce(shown, axis=1) - np.fmin.reduce(shown, axis=1)
        std = np.sqrt(np.where(good & (dof > 0), square / np.maximum(dof, 1), np.nan))
    return Spheres(
        centres=np.where(good[:, None], centres, np.nan),
        radii=np.where(good, radii - tip_radius, np.nan),
        radius_std=std * np.sqrt(inverse[:, 3, 3]) if free else np.where(good, 0.0, np.nan),
        unit_covariance=np.where(good[:, None, None], inverse[:, :3, :3], np.nan),
        std=std,
        dof=dof,
        residuals=residuals,
        used=mask,
        form_deviation=form,
        reason=tuple(reason),
    )


def _checked(points: Floats, used: Bools | None) -> tuple[Floats, Bools]:
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 3 or points.shape[2] != 3:
        raise GeometryError(f"touch points must have the shape (balls, n, 3), not {points.shape}")
    finite: Bools = np.all(np.isfinite(points), axis=2)
    if used is not None:
        if np.shape(used) != points.shape[:2]:
            raise GeometryError(f"mask {np.shape(used)} does not fit points {points.shape}")
        finite = finite & np.asarray(used, dtype=np.bool_)
    return np.where(finite[:, :, None], points, 0.0), finite


def _too_few(mask: Bools, unknowns: int) -> list[Phrase | None]:
    """Return the reason for balls with too few points to check the fit."""
    return [
        None
        if count > unknowns
        else phrase(
            "{0} usable touch points, at least {1} are needed (one to check)", count, unknowns + 1
        )
        for count in mask.sum(axis=1)
    ]


def _gauss_newton(
    points: Floats, mask: Bools, offset: float, free: bool
) -> tuple[Floats, Floats, Floats]:
    """Return centres (B, 3), distances tip centre - ball centre (B,) and the Jacobian (B, n, p).

    Unused points have weight zero. Starts from the algebraic sphere, which is linear.
    """
    weight = mask.astype(np.float64)
    centres, radii = _algebraic(points, weight)
    if not free:
        centres, radii = _outer_start(points, weight, centres, offset)
    design = np.empty((*mask.shape, 4 if free else 3))
    for _ in range(MAX_STEPS):
        away = points - centres[:, None]
        distance = np.maximum(np.linalg.norm(away, axis=2), 1e-300)  # never 0 / 0
        design[..., :3] = -away / distance[..., None] * weight[..., None]
        if free:
            design[..., 3] = -weight
        residual = (distance - radii[:, None]) * weight
        step = -_solve(design, residual)
        centres = centres + step[:, :3]
        if free:
            radii = radii + step[:, 3]
        if not np.max(np.abs(step), initial=0.0) > CONVERGED * np.max(radii, initial=1e-6):
            break
    return centres, radii, design


def _solve(design: Floats, residual: Floats) -> Floats:
    """Least squares step per ball; a ridge keeps degenerate balls (refused later) finite."""
    p = design.shape[2]
    adjoint = design.swapaxes(1, 2)
    normal = adjoint @ design
    size = np.einsum("bii->b", normal) + 1e-30
    normal += (1e-14 * size)[:, None, None] * np.eye(p)
    solved = np.linalg.solve(normal, adjoint @ residual[:, :, None])[:, :, 0]
    return np.asarray(solved, dtype=np.float64)


def _algebraic(points: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Return centre and radius of |p|^2 = 2 c p + const, solved about the mean point."""
    count = np.maximum(weight.sum(axis=1), 1.0)
    middle = np.sum(points * weight[..., None], axis=1) / count[:, None]
    local = (points - middle[:, None]) * weight[..., None]
    square = np.sum(local**2, axis=2)
    mean_square = square.sum(axis=1) / count
    centred = (square - mean_square[:, None]) * weight
    centre = 0.5 * _solve(local, centred)
    radii = np.sqrt(mean_square + np.sum(centre**2, axis=1))
    return middle + centre, radii


def _outer_start(
    points: Floats, weight: Floats, centres: Floats, offset: float
) -> tuple[Floats, Floats]:
    """Start for a known radius: on the ray from the mean point through the algebraic centre.

    A small cap has two spheres of the given radius; this picks the one on the algebraic side.
    """
    count = np.maximum(weight.sum(axis=1), 1.0)
    middle = np.sum(points * weight[..., None], axis=1) / count[:, None]
    toward = centres - middle
    length = np.linalg.norm(toward, axis=1)
    limited = np.minimum(length, offset) / np.maximum(length, 1e-300)
    return middle + toward * limited[:, None], np.full(len(points), offset)


def _invert(design: Floats) -> tuple[Floats, Floats]:
    """Return (J'J)^-1 (B, p, p) and the smallest singular value of J per root of the points."""
    normal = design.swapaxes(1, 2) @ design
    values, vectors = np.linalg.eigh(normal)
    safe = np.maximum(values, 1e-12)
    inverse: Floats = (vectors / safe[:, None, :]) @ vectors.swapaxes(1, 2)
    return inverse, values[:, 0]


def _worst(
    residuals: Floats,
    design: Floats,
    inverse: Floats,
    mask: Bools,
    square: Floats,
    dof: Ints,
    offset: float,
) -> Bools:
    """Mark the worst point of every ball that has one beyond the critical value.

    Each point is tested against the scatter of the others.
    """
    leverage = np.einsum("bni,bij,bnj->bn", design, inverse, design)
    share = np.clip(1.0 - leverage, 1e-9, 1.0)
    level = FALSE_ALARM / np.maximum(mask.sum(axis=1), 1) / 2.0  # of all points, both signs
    gain = residuals**2 / share  # by so much the sum of squares falls without the point
    others = np.maximum(dof - 1, 1)
    variance = np.maximum(square[:, None] - gain, 0.0) / others[:, None]
    critical = np.where(dof > 1, stdtrit(others, 1.0 - level), np.inf)
    variance = np.maximum(variance, (NOISE_FLOOR * max(offset, 1e-3)) ** 2)
    value = np.where(mask, np.sqrt(gain / variance), -1.0)
    worst = np.zeros_like(mask)
    rows = np.arange(len(mask))
    worst[rows, value.argmax(axis=1)] = value.max(axis=1, initial=-1.0) > critical
    return worst


def _badly_spread(
    reason: list[Phrase | None], spread: Floats, inverse: Floats, centres: Floats, free: bool
) -> list[Phrase | None]:
    """Add the reason for balls whose points hardly determine the centre."""
    weakest = np.sqrt(np.maximum(np.linalg.eigvalsh(inverse[:, :3, :3])[:, -1], 0.0))
    found = []
    for ball, why in enumerate(reason):
        if not why and not np.isfinite(centres[ball]).all():
            why = phrase("the fit does not converge: the points do not lie on a sphere")
        if not why and (spread[ball] < 1e-9 or weakest[ball] > WEAKEST):
            remedy = phrase("spread the points over half the ball")
            if free:
                remedy = phrase("spread the points over half the ball, or state its radius")
            why = phrase(
                "badly spread touch points: they lie nearly in one plane or patch, the "
                "centre's uncertainty is {0:.0f} times that of a point; {1}", weakest[ball], remedy
            )  # fmt: skip
        found.append(why)
    return found
