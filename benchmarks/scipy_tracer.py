"""The tracer's least-squares problems as a careful user of scipy would write them.

Opponent of the benchmark and referee of the tests: dense, with analytic Jacobians, and without
a line of rotcal.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import coo_matrix, csr_matrix, vstack
from scipy.sparse.linalg import spsolve

EXACT = {"method": "lm", "xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
HARD = 1e10  # 1/m: soft rows would let the weak directions pull


def station_misfit(p, targets, length):
    return np.sqrt(((p[:3] - targets) ** 2).sum(axis=1)) - p[3] - length


def station_slope(p, targets, length):
    difference = p[:3] - targets
    slope = np.empty((len(targets), 4))
    slope[:, :3] = difference / np.sqrt((difference**2).sum(axis=1))[:, None]
    slope[:, 3] = -1.0
    return slope


def locate_station(targets, length, start):
    """Return (X, Y, Z, d) of one station."""
    return least_squares(station_misfit, start, station_slope, args=(targets, length), **EXACT).x


def locate_stations_batched(targets, length, start, rounds=8):
    """Return (m, 4): Gauss-Newton for all stations at once, in numpy alone."""
    state = np.tile(start, (len(length), 1))
    for _ in range(rounds):
        difference = state[:, None, :3] - targets
        away = np.sqrt((difference**2).sum(axis=2))
        slope = np.concatenate([difference / away[:, :, None], -np.ones((*away.shape, 1))], axis=2)
        right = slope.swapaxes(1, 2) @ (away - state[:, 3:] - length)[:, :, None]
        step = np.linalg.solve(slope.swapaxes(1, 2) @ slope, right)[:, :, 0]
        state = state - step
        if np.abs(step).max() < 1e-13:
            break
    return state


@dataclass(frozen=True)
class DenseNetwork:
    """Stations, distances and targets in one vector (4 m + 3 n,).

    With ``target_std`` the machine's coordinates are observations; without, shift, turn and the
    rms distance of the stations from their centroid (``radius``) are held by stiff rows.
    """

    targets: np.ndarray
    length: np.ndarray
    length_std: float
    target_std: float | None
    radius: float = 0.0

    def misfit(self, p):
        state, targets = self._split(p)
        distance = np.sqrt(((state[:, None, :3] - targets) ** 2).sum(axis=2))
        lengths = ((distance - state[:, 3:] - self.length) / self.length_std).ravel()
        shift = targets - self.targets
        if self.target_std is not None:
            return np.concatenate([lengths, shift.ravel() / self.target_std])
        turn = np.cross(self.targets - self.targets.mean(axis=0), shift).sum(axis=0)
        spread = state[:, :3] - state[:, :3].mean(axis=0)
        radius = np.sqrt((spread**2).sum() / len(spread))
        held = np.concatenate([shift.sum(axis=0), turn, [radius - self.radius]])
        return np.concatenate([lengths, HARD * held])

    def slope(self, p):
        state, targets = self._split(p)
        m, n = self.length.shape
        difference = state[:, None, :3] - targets
        unit = difference / np.sqrt((difference**2).sum(axis=2))[:, :, None] / self.length_std
        lengths = np.zeros((m, n, 4 * m + 3 * n))
        for j in range(m):
            lengths[j, :, 4 * j : 4 * j + 3] = unit[j]
            lengths[j, :, 4 * j + 3] = -1.0 / self.length_std
        for i in range(n):
            lengths[:, i, 4 * m + 3 * i : 4 * m + 3 * i + 3] = -unit[:, i]
        if self.target_std is not None:
            rest = np.zeros((3 * n, 4 * m + 3 * n))
            rest[:, 4 * m :] = np.eye(3 * n) / self.target_std
        else:
            rest = HARD * self._held_slope(state, n)
        return np.concatenate([lengths.reshape(m * n, -1), rest])

    def solve(self, start):
        return least_squares(self.misfit, start, self.slope, x_scale="jac", **EXACT).x

    def _split(self, p):
        m, n = self.length.shape
        return p[: 4 * m].reshape(m, 4), p[4 * m :].reshape(n, 3)

    def _held_slope(self, state, n):
        m = len(state)
        slope = np.zeros((7, 4 * m + 3 * n))
        arm = self.targets - self.targets.mean(axis=0)
        for axis in range(3):
            slope[axis, 4 * m + axis :: 3] = 1.0
            along = np.zeros(3)
            along[axis] = 1.0
            slope[3:6, 4 * m + axis :: 3] = np.cross(arm, along).T
        spread = state[:, :3] - state[:, :3].mean(axis=0)
        slope[6, : 4 * m].reshape(m, 4)[:, :3] = spread / np.sqrt(m * (spread**2).sum())
        return slope


class SparseNetwork(DenseNetwork):
    """The same with a sparse Jacobian: by scipy's trf with lsmr, or by Gauss-Newton."""

    def slope(self, p):
        """Return the Jacobian: seven entries for each length."""
        state, targets = self._split(p)
        m, n = self.length.shape
        difference = state[:, None, :3] - targets
        unit = difference / np.sqrt((difference**2).sum(axis=2))[:, :, None] / self.length_std
        values = np.concatenate([unit, np.full((m, n, 1), -1.0 / self.length_std), -unit], axis=2)
        station, target = np.divmod(np.arange(m * n), n)
        own, shared = 4 * station[:, None] + np.arange(4), 4 * m + 3 * target[:, None]
        columns = np.concatenate([own, shared + np.arange(3)], axis=1).ravel()
        size = 4 * m + 3 * n
        places = (np.repeat(np.arange(m * n), 7), columns)
        lengths = coo_matrix((values.ravel(), places), (m * n, size))
        if self.target_std is None:
            return vstack([lengths, csr_matrix(HARD * self._held_slope(state, n))]).tocsr()
        places = (np.arange(3 * n), 4 * m + np.arange(3 * n))
        known = coo_matrix((np.full(3 * n, 1.0 / self.target_std), places), (3 * n, size))
        return vstack([lengths, known]).tocsr()

    def solve(self, start):
        """Return the solution by scipy's trust region, whose steps are lsmr's."""
        exact = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
        options = {"method": "trf", "tr_solver": "lsmr", "x_scale": "jac", **exact}
        return least_squares(self.misfit, start, self.slope, **options).x

    def gauss_newton(self, p, rounds=20):
        """Return the solution by Gauss-Newton on the sparse normal equations."""
        for _ in range(rounds):
            slope = self.slope(p)
            step = spsolve((slope.T @ slope).tocsc(), slope.T @ self.misfit(p))
            p = p - step
            if np.abs(step).max() < 1e-13:
                break
        return p
