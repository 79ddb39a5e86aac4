"""Lengths of stations that share zeros, and their adjustment dense, column by column."""

from dataclasses import dataclass

import numpy as np
from tracer_scene import arc, low_ring, simulate

from rotcal_ros.methods.tracer.solver import TracerProblem

LENGTH_STD, TARGET_STD = 2e-7, 1e-6


@dataclass(frozen=True)
class Lengths:
    """Rows of one run: all stations at each target, or all targets at each station."""

    angles: np.ndarray
    deviation: np.ndarray
    stations: np.ndarray
    targets: np.ndarray
    position: np.ndarray
    target: np.ndarray
    distance: np.ndarray
    noise: np.ndarray
    order: np.ndarray

    def problem(self, zero, segment, **options):
        """``zero`` (k,) in m and ``segment`` (k,) in the order of measuring."""
        length = self.distance + self.noise
        length[self.order.argsort()] -= np.broadcast_to(zero, len(length))
        if segment is not None:
            segment = np.broadcast_to(segment, len(length))[self.order]
        rows = {
            "position": self.position,
            "target": self.target,
            "length": length,
            "length_std": LENGTH_STD,
            "targets": self.targets,
            "target_std": TARGET_STD,
            "table_angles": self.angles,
            "order": self.order,
            "segment": segment,
            "error_motion_std": 0.0,
        }
        return TracerProblem(**{**rows, **options})


def measure(seed=0, m=7, n=20, kept=None, by_target=True, layout=low_ring):
    """``kept``: this many lengths at each station, to targets of its own choice."""
    rng = np.random.default_rng(1000 + seed)
    scene = simulate(seed, arc(m, 45.0), n, layout)
    position, target = np.divmod(np.arange(m * n), n)
    if kept is not None:
        places = np.concatenate([n * j + np.sort(rng.permutation(n)[:kept]) for j in range(m)])
        position, target = position[places], target[places]
    true_targets = scene.targets + TARGET_STD * rng.standard_normal(scene.targets.shape)
    distance = np.linalg.norm(scene.stations[position] - true_targets[target], axis=1)
    keys = (position, target) if by_target else (target, position)
    order = np.lexsort(keys).argsort()
    noise = LENGTH_STD * rng.standard_normal(len(distance))
    return Lengths(
        scene.angles, scene.deviation, scene.stations, scene.targets, position, target, distance,
        noise, order,
    )  # fmt: skip


class Dense:
    """Stations, zeros and targets in one vector (3 m + s + 3 n,), solved by Gauss-Newton."""

    def __init__(self, problem, walk=None):
        self.p, self.walk = problem, walk
        self.m, self.n = len(problem.table_angles), len(problem.targets)
        self.zero = np.unique(problem.segment, return_inverse=True)[1]
        if walk is not None:
            self.zero = problem.order
        self.s = int(self.zero.max()) + 1

    def split(self, x):
        m, s = self.m, self.s
        return x[: 3 * m].reshape(m, 3), x[3 * m : 3 * m + s], x[3 * m + s :].reshape(-1, 3)

    def misfit(self, x):
        stations, zeros, targets = self.split(x)
        p = self.p
        apart = stations[p.position] - targets[p.target]
        rows = [(np.linalg.norm(apart, axis=1) - zeros[self.zero] - p.length) / p.length_std]
        if p.datum == "prior":
            rows.append(((targets - p.targets) / p.target_std).ravel())
        if self.walk is not None:
            rows.append(np.diff(zeros) / self.walk)
        return np.concatenate(rows)

    def slope(self, x):
        stations, _, targets = self.split(x)
        p, k, m, s = self.p, np.arange(len(self.p.length)), self.m, self.s
        apart = stations[p.position] - targets[p.target]
        unit = apart / np.linalg.norm(apart, axis=1)[:, None] / p.length_std[:, None]
        rows = np.zeros((len(k), len(x)))
        for a in range(3):
            rows[k, 3 * p.position + a] = unit[:, a]
            rows[k, 3 * m + s + 3 * p.target + a] = -unit[:, a]
        rows[k, 3 * m + self.zero] = -1.0 / p.length_std
        parts = [rows]
        if p.datum == "prior":
            prior = np.zeros((3 * self.n, len(x)))
            prior[:, 3 * m + s :] = np.diag(1.0 / p.target_std.ravel())
            parts.append(prior)
        if self.walk is not None:
            steps = np.zeros((s - 1, len(x)))
            steps[:, 3 * m : 3 * m + s] = np.diff(np.eye(s), axis=0) / self.walk
            parts.append(steps)
        return np.concatenate(parts)

    def solve(self, stations):
        start = np.concatenate([stations.ravel(), np.zeros(self.s), self.p.targets.ravel()])
        x = start
        for _ in range(5):
            jacobian = self.slope(x)
            scale = 1.0 / np.linalg.norm(jacobian, axis=0)
            q, r = np.linalg.qr(jacobian * scale)
            x = x - scale * np.linalg.solve(r, q.T @ self.misfit(x))
        return x
