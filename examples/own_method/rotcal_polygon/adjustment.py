"""Cross calibration of table and polygon: one linear least-squares problem, and nothing else.

    reading = t[position] + f[face] + o[mounting] + noise

All angles are radians, counter-clockwise about the table axis positive: ``t`` is the table's
deviation (actual - commanded), ``f`` by how much a face's normal is turned from its nominal
direction, ``o`` how the person placed the polygon. Faces are numbered in the order in which they
come to the autocollimator while the table angle increases, so that mounting ``m`` shows face
``(position + first_faces[m]) mod N``.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import gcd

import numpy as np

from rotcal_ros.adjust.distributions import normal_isf
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import ObservabilityError

FALSE_ALARM = 0.01
"""Probability that good readings lose any one at all."""
REDUNDANT = 1e-6
"""A reading with less redundancy than this is checked by no other."""


@dataclass(frozen=True)
class PolygonProblem:
    """Readings (n,) rad with standard deviation ``sigma`` (rad) of each; ``position`` < ``faces``.

    ``certificate`` (N,) rad are known face errors, each with standard uncertainty
    ``certificate_std``. Without ``unknown_faces`` the polygon is taken for perfect.
    """

    faces: int
    position: Ints
    face: Ints
    mounting: Ints
    reading: Floats
    sigma: float
    certificate: Floats | None = None
    certificate_std: float = 0.0
    unknown_faces: bool = True


@dataclass(frozen=True)
class Adjustment:
    """The solution: ``table`` (N,), zero at position 0, and ``face`` (N,), zero in the mean.

    Rows are the readings, then the certificate: ``residual`` = observed - computed, its
    ``redundancy`` in [0, 1] and ``test_value`` = residual / its own standard deviation; not
    ``used`` are rejected readings. ``gain_table``, ``gain_face`` (N, rows) map rows to estimates;
    ``std`` (rows,) is the noise that they were weighted with.
    """

    table: Floats
    face: Floats
    gain_table: Floats
    gain_face: Floats
    std: Floats
    residual: Floats
    redundancy: Floats
    used: Bools

    @property
    def test_value(self) -> Floats:
        """Normalised residuals; 0 where no other row checks one."""
        checked = self.redundancy > REDUNDANT
        scale = self.std * np.sqrt(np.where(checked, self.redundancy, 1.0))
        return np.asarray(np.where(checked, self.residual / scale, 0.0), dtype=np.float64)

    @property
    def square_sum(self) -> float:
        """Chi-squared of the used rows."""
        return float(np.sum((self.residual / self.std)[self.used] ** 2))

    @property
    def dof(self) -> int:
        """Used rows minus unknowns: the sum of their redundancies."""
        return round(float(self.redundancy[self.used].sum()))

    def covariance(self, gain: Floats) -> Floats:
        """Return the covariance (N, N) of what ``gain`` estimates."""
        return np.asarray((gain * self.std**2) @ gain.T, dtype=np.float64)


def separable(faces: int, first_faces: tuple[int, ...]) -> bool:
    """Whether mountings that begin with ``first_faces`` separate face errors from the table's."""
    return gcd(faces, *(face - first_faces[0] for face in first_faces)) == 1


def adjust(problem: PolygonProblem) -> Adjustment:
    """Solve, reject the worst reading if it stands out, and solve again until none does.

    What counts is the scatter of all others where that is more than the stated noise.
    Raises ObservabilityError while the readings do not determine every position.
    """
    used = np.ones(len(problem.reading), dtype=np.bool_)
    critical = normal_isf(0.5 * FALSE_ALARM / len(used))
    while True:
        solution = solve(problem, used)
        test = np.abs(solution.test_value[: len(used)]) * used
        others = (solution.square_sum - test**2) / max(solution.dof - 1, 1)
        outside = test / np.sqrt(np.maximum(others, 1.0))
        worst = int(np.argmax(outside))
        if outside[worst] <= critical:
            return solution
        used[worst] = False


def solve(problem: PolygonProblem, used: Bools) -> Adjustment:
    """Return the weighted least-squares solution with the ``used`` (n,) readings."""
    design, observed, std = _design(problem)
    rows = np.append(used, np.ones(len(observed) - len(used), dtype=np.bool_))
    weighted = design / std[:, None] * rows[:, None]
    u, s, vt = np.linalg.svd(weighted, full_matrices=False)
    if len(s) < design.shape[1] or s[-1] < 1e-9 * s[0]:
        raise ObservabilityError(_what_is_missing(problem, used))
    gain = (vt.T / s) @ u.T / std
    unknowns = gain @ observed
    n = problem.faces
    gain_table = np.vstack([np.zeros(len(std)), gain[: n - 1]])
    gain_face = np.zeros((n, len(std)))
    if problem.unknown_faces:
        gain_face = gain[n - 1 : 2 * n - 1] - gain[n - 1 : 2 * n - 1].mean(axis=0)
    return Adjustment(
        table=gain_table @ observed,
        face=gain_face @ observed,
        gain_table=gain_table,
        gain_face=gain_face,
        std=std,
        residual=observed - design @ unknowns,
        redundancy=1.0 - np.sum(u**2, axis=1),
        used=rows,
    )


def _design(problem: PolygonProblem) -> tuple[Floats, Floats, Floats]:
    """Return design matrix, observed values and their standard deviations, row by row.

    The columns are t[1:], f, o[1:], then the zero of the certificate: its face errors count from
    a zero of their own, as if it were one more mounting. With a perfect polygon f is left out
    and o[0] is not.
    """
    n, rows = problem.faces, np.arange(len(problem.reading))
    known = problem.certificate
    mountings, mounting = np.unique(problem.mounting, return_inverse=True)
    design = np.zeros((len(rows) + (0 if known is None else n), 2 * n + len(mountings) + 1))
    design[rows, problem.position] = 1.0
    design[rows, n + problem.face] = 1.0
    design[rows, 2 * n + mounting] = 1.0
    observed, std = problem.reading, np.full(len(rows), problem.sigma)
    if known is not None:
        design[len(rows) :, n : 2 * n] = np.eye(n)
        design[len(rows) :, -1] = 1.0
        observed = np.append(observed, known)
        std = np.append(std, np.full(n, problem.certificate_std))
    dropped = [0, *([2 * n] if problem.unknown_faces else range(n, 2 * n))]
    dropped += [design.shape[1] - 1] * (known is None)
    return np.delete(design, dropped, axis=1), observed, std


def _what_is_missing(problem: PolygonProblem, used: Bools) -> str:
    unseen = sorted(set(range(problem.faces)) - set(problem.position[used].tolist()))
    if unseen:
        return f"table positions {unseen} have no reading: measure them"
    return (
        f"the readings of {len(np.unique(problem.mounting))} mountings do not separate the face "
        "errors of the polygon from those of the table: measure the other mountings"
    )
