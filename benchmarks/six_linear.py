"""Measurements of one network to first order: curves and contrasts, drawn and judged."""

import numpy as np
from six_coverage import NONE, Coverage
from six_scene import scene

from rotcal_ros.foundation.components import HALF_OF_95_PERCENT
from rotcal_ros.methods.tracer_six.solver import SixProblem
from rotcal_ros.methods.tracer_six.solver.network import pulled
from rotcal_ros.methods.tracer_six.solver.scatter import (
    ScatterContrasts,
    contrasts,
    enlargement,
    estimate,
    turned,
)
from rotcal_ros.methods.tracer_six.solver.solution import adjust


class Linear:
    """A network without noise. Its curves feel shifts of the stations by ``gain`` (6 m, 3 V)."""

    def __init__(self, targets=None, arrivals=1, **layout):
        quiet = {"noise": 0.0, "mounted": 0.0, "curves": (0.0, 0.0)}
        rng = np.random.default_rng(1)
        rows = scene(rng, targets, arrivals=arrivals, **quiet, **layout).rows
        solution = adjust(SixProblem(**rows, slip=0.0, **NONE))
        network, whole = solution.network, solution.fit.posterior.covariance
        self.arms = network.state.arms(network.layout)
        self.contrasts = contrasts(network, self.arms)
        self.gain = solution.table.jacobian @ whole[network.layout.size :] @ pulled(network).T
        values, vectors = np.linalg.eigh(solution.table.covariance)
        self.noise = vectors * np.sqrt(np.maximum(values, 0.0))
        self.level, turn = np.linalg.eigh(self.contrasts.spread[0])
        self.basis = self.contrasts.root @ turn
        self.turn = turn

    def shaped(self, rows):
        """Return what belongs to d and c (6 m,) in the order of COMPONENTS, (6, m)."""
        return rows.reshape(2, -1, 3).transpose(0, 2, 1).reshape(6, -1)

    def slopes(self, gain):
        """Return what a unit of both squared scatters adds to the variances of curves (2, 6 m)."""
        across, by_station = turned(self.arms), gain.reshape(len(gain), -1, 3)
        turns = (by_station[:, :, None] @ across)[:, :, 0]
        return np.stack([(gain**2).sum(axis=1), (turns * by_station).sum(axis=(1, 2))])

    def drawn(self, rng, scatter):
        """Return errors of the curves (6 m,) and contrasts (q,) of a measurement."""
        shift = scatter[0] * rng.normal(size=self.arms.shape)
        shift += np.cross(scatter[1] * rng.normal(size=self.arms.shape), self.arms)
        error = self.noise @ rng.normal(size=self.noise.shape[1]) + self.gain @ shift.ravel()
        value = rng.normal(size=len(self.level)) + self.contrasts.root.T @ shift.ravel()
        return error, value

    def solved(self, error, value):
        """Return errors (6, m) and standard deviations (6, m) as the solver has them."""
        found = self.contrasts
        here = ScatterContrasts(value, found.spread, found.radius, found.root)
        scatter = estimate(here, None, None, 0.01)
        used = scatter.weighing(self.arms)
        shrunk = used[0] / (1.0 + used[0] * np.maximum(self.level, 0.0))
        taken = (self.gain @ self.basis) * shrunk
        error = error - taken @ (self.turn.T @ value)
        slope = self.slopes(self.gain - taken @ self.basis.T)
        # noise and the contrasts' own, with which it is independent
        variance = (self.noise**2).sum(axis=1) + (taken**2).sum(axis=1) + used[0] * slope[0]
        std = np.sqrt(variance) * enlargement(scatter, used, variance, slope)
        return self.shaped(error), self.shaped(std)


def linear_coverage(network, runs, scatter, seed=0):
    """Return the :class:`Coverage` of ``runs`` measurements with ``scatter`` (m, rad)."""
    rng, inside, errors, stds = np.random.default_rng(seed), [], [], []
    for _ in range(runs):
        error, std = network.solved(*network.drawn(rng, scatter))
        inside.append((np.abs(error) < HALF_OF_95_PERCENT * std).mean(axis=1))
        errors.append((error**2).mean(axis=1))
        stds.append(np.sqrt((std**2).mean(axis=1)))
    return Coverage(
        np.mean(inside, axis=0), np.sqrt(np.mean(errors, axis=0)), np.mean(stds, axis=0)
    )
