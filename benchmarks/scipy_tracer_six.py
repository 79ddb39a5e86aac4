"""Six deviations from lengths as a careful user of scipy would write them.

Opponent of the benchmark and referee of the tests: one sparse least-squares problem with an
analytic Jacobian, and without a line of rotcal. Unknowns in one vector: c and d (m, 3) each of the
table, places (p, 3), zeros (s,), targets (n, 3).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import csr_matrix
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class SparseSix:
    """One row per length; ``target_std`` None: targets without a prior."""

    position: np.ndarray
    place: np.ndarray
    target: np.ndarray
    zero: np.ndarray
    length: np.ndarray
    length_std: float
    targets: np.ndarray
    target_std: float | None
    angles: np.ndarray
    n_places: int

    @cached_property
    def sizes(self):
        m, n = len(self.angles), len(self.targets)
        return np.cumsum([3 * m, 3 * m, 3 * self.n_places, self.zero.max() + 1, 3 * n])

    def split(self, x):
        c, d, q, z, a = np.split(x, self.sizes[:-1])
        return c.reshape(-1, 3), d.reshape(-1, 3), q.reshape(-1, 3), z, a.reshape(-1, 3)

    def misfit(self, x):
        c, d, q, z, a = self.split(x)
        arms = self._arms(self._turned(c), q)
        difference = arms + d[self.position] - a[self.target]
        lengths = np.sqrt((difference**2).sum(axis=1)) - z[self.zero] - self.length
        prior = [] if self.target_std is None else [(a - self.targets).ravel() / self.target_std]
        return np.concatenate([lengths / self.length_std, *prior])

    def _turned(self, c):
        return (
            Rotation.from_rotvec(c) * Rotation.from_euler("z", self.angles[:, None])
        ).as_matrix()

    def _arms(self, turned, q):
        return (turned[self.position] @ q[self.place][:, :, None])[:, :, 0]

    def slope(self, x):
        c, d, q, _, a = self.split(x)
        turned = self._turned(c)
        arms = self._arms(turned, q)
        difference = arms + d[self.position] - a[self.target]
        unit = difference / np.sqrt((difference**2).sum(axis=1))[:, None] / self.length_std
        by_place = (unit[:, None] @ turned[self.position])[:, 0]
        by_turn = (np.cross(arms, unit)[:, None] @ left(c)[self.position])[:, 0]
        zeros = np.full((len(unit), 1), -1.0 / self.length_std)
        values = np.concatenate([by_turn, unit, by_place, zeros, -unit], axis=1).ravel()
        rows, columns = self._pattern
        shape = [len(unit), self.sizes[-1]]
        if self.target_std is not None:
            values = np.concatenate([values, np.full(a.size, 1.0 / self.target_std)])
            shape[0] += a.size
        return csr_matrix((values, (rows, columns)), shape=shape)

    @cached_property
    def _pattern(self):
        first = np.concatenate([[0], self.sizes[:-1]])
        xyz = np.arange(3)
        which = (self.position, self.position, self.place, self.zero, self.target)
        parts = [
            first[b] + (w[:, None] if b == 3 else 3 * w[:, None] + xyz)
            for b, w in enumerate(which)
        ]
        columns = np.concatenate(parts, axis=1)
        rows = np.repeat(np.arange(len(columns)), columns.shape[1])
        columns = columns.ravel()
        if self.target_std is not None:
            n = 3 * len(self.targets)
            rows = np.concatenate([rows, len(self.length) + np.arange(n)])
            columns = np.concatenate([columns, first[4] + np.arange(n)])
        return rows, columns

    def solve(self, start, **options):
        tight = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15, "x_scale": "jac"}
        return least_squares(self.misfit, start, self.slope, **{**tight, **options})


def left(vectors):
    """The left Jacobians (m, 3, 3) of rotation vectors: what a change of one turns by."""
    k = np.zeros((len(vectors), 3, 3))
    k[:, 2, 1], k[:, 0, 2], k[:, 1, 0] = vectors.T
    k -= k.swapaxes(1, 2)
    angle = np.sqrt((vectors**2).sum(axis=1))[:, None, None] + 1e-30
    second = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    third = np.where(angle < 1e-3, 1.0 / 6.0, (angle - np.sin(angle)) / angle**3)
    return np.eye(3) + second * k + third * (k @ k)


def gauge_free(curves, angles):
    """Take mean, and in x and y what turns with the table, off curves (m, 3)."""
    m = len(angles)
    phase = np.column_stack([np.ones(m), np.exp(1j * angles)])
    plane = curves[:, 0] + 1j * curves[:, 1]
    plane = plane - phase @ np.linalg.lstsq(phase, plane, rcond=None)[0]
    return np.column_stack([plane.real, plane.imag, curves[:, 2] - curves[:, 2].mean()])
