"""The best curve of several by generalised least squares, the zero of every input being unknown.

Model of input k: values_k = design_k @ curve + free_k @ unknowns_k + noise_k with a full
covariance. What all inputs leave open together is taken from the estimate, which is therefore the
one of smallest norm, and so is its covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.optimize import brentq

from rotcal_ros.arrays import Floats
from rotcal_ros.errors import DataError

WEAK: Final = 1e-9
"""Directions whose singular value is smaller than this part of the largest are not determined."""
FLOOR: Final = 1e-12
"""Smallest variance of any direction, in mean variances: keeps exact combinations finite."""


@dataclass(frozen=True, eq=False)
class Part:
    """One input: ``values`` (m,) with ``covariance`` (m, m), in rad or m.

    ``design`` (m, n) selects or interpolates the curve at the n unknowns, ``free`` (m, q) holds
    what the input cannot know, such as its offset. The first ``known`` of its columns are what
    no input of the kind knows; the others it leaves open by itself.
    """

    values: Floats
    covariance: Floats
    design: Floats
    free: Floats
    known: int = 0


@dataclass(frozen=True, eq=False)
class Pooled:
    """The estimate (n,) with ``covariance`` (n, n), both without what nobody knows.

    ``variance_parts`` (k, n) tell which part of each variance comes from each input; they sum to
    one. ``free`` holds the estimated unknowns (q,) of every input. ``chi2`` has ``dof`` degrees
    of freedom.
    """

    values: Floats
    covariance: Floats
    variance_parts: Floats
    free: tuple[Floats, ...]
    chi2: float
    dof: int


def pool(parts: Sequence[Part], gauge: Floats) -> Pooled:
    """Return the best estimate of all ``parts``; ``gauge`` (n, g) is what none of them knows.

    Every part is whitened by the root of its covariance and freed of its own unknowns by an
    orthogonal projection; the rest is solved by singular values. Raises DataError when more than
    the gauge stays undetermined.
    """
    white = [_whitened(part) for part in parts]
    design = np.concatenate([w.design for w in white])
    values = np.concatenate([w.values for w in white])
    u, s, vt = np.linalg.svd(design, full_matrices=False)
    rank = int(np.sum(s > WEAK * s[0]))
    if rank != design.shape[1] - gauge.shape[1]:
        raise DataError(
            "the inputs share too few angles to be joined: measure at two common angles or more"
        )
    u, root = u[:, :rank], vt[:rank].T / s[:rank]
    estimate = root @ (u.T @ values)
    covariance = root @ root.T
    rest = values - design @ estimate
    ends = np.cumsum([len(w.values) for w in white])
    variances = np.maximum(np.diag(covariance), np.finfo(np.float64).tiny)
    gains = np.split(u @ root.T, ends[:-1])
    return Pooled(
        values=estimate,
        covariance=covariance,
        variance_parts=np.array([np.sum(gain**2, axis=0) for gain in gains]) / variances,
        free=tuple(
            np.linalg.lstsq(part.free, part.values - part.design @ estimate, rcond=None)[0]
            for part in parts
        ),
        chi2=float(rest @ rest),
        dof=sum(len(p.values) - p.free.shape[1] for p in parts) - rank,
    )


def common_std(parts: Sequence[Part], gauge: Floats) -> float:
    """Return the standard deviation that, added to every value, makes chi-square equal to dof.

    Mandel and Paule's between-laboratory component, here of every single value. Zero when
    chi-square is not above its expectation.
    """

    def excess(variance: float) -> float:
        pooled = pool(widened(parts, variance), gauge)
        return pooled.chi2 - pooled.dof

    if excess(0.0) <= 0.0:
        return 0.0
    high = max(float(np.mean(np.diag(part.covariance))) for part in parts)
    while excess(high) > 0.0:
        high *= 4.0
    return float(np.sqrt(brentq(excess, 0.0, high, xtol=1e-6 * high, rtol=1e-9)))


def widened(parts: Sequence[Part], variance: float) -> list[Part]:
    """Return the parts with an independent ``variance`` added to every value."""
    return [
        replace(part, covariance=part.covariance + variance * np.eye(len(part.values)))
        for part in parts
    ]


def farthest(parts: Sequence[Part], gauge: Floats) -> int:
    """Return the part whose omission lowers chi-square most."""
    without = []
    for k, part in enumerate(parts):
        # Not left out but made worthless: angles that it alone measured stay determined.
        loose = replace(part, covariance=1e6 * part.covariance)
        without.append(pool([*parts[:k], loose, *parts[k + 1 :]], gauge).chi2)
    return int(np.argmin(without))


def _whitened(part: Part) -> Part:
    """Return the part with unit covariance, and orthogonal to its own unknowns.

    A large variance along the unknowns changes nothing but makes singular covariances regular:
    those of curves that are exactly zero at their first angle or in their mean.
    """
    m = len(part.values)
    scale = float(np.trace(part.covariance)) / m
    regular = part.covariance / scale + part.free @ part.free.T + FLOOR * np.eye(m)
    try:
        root = np.linalg.cholesky(regular) * np.sqrt(scale)
    except np.linalg.LinAlgError as error:
        raise DataError(
            "the covariance of the deviations is not positive semi-definite: the result is "
            "damaged, solve again"
        ) from error
    columns = np.column_stack([part.design, part.values])
    white = np.linalg.solve(root, columns)
    q, _ = np.linalg.qr(np.linalg.solve(root, part.free))
    white -= q @ (q.T @ white)
    return Part(white[:, -1], np.eye(m), white[:, :-1], q)
