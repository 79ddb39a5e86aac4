"""What a systematic error of the lengths does to the deviations, and which tests would see it.

To first order, about a solution. A pattern of errors is told by what the fit cannot take up, by
the circle of the stations, and by closures. The size at which one of them turns the verdict with
a probability of POWER is the *detectable* one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt
from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.methods.distributions import chi2_isf, normal_isf
from rotcal_ros.methods.tracer.adjustment import ranges
from rotcal_ros.methods.tracer.angles import bearing_jacobian
from rotcal_ros.methods.tracer.error_motion import circle_tested
from rotcal_ros.methods.tracer.gain import NetworkGain
from rotcal_ros.methods.tracer.network import linearise
from rotcal_ros.methods.tracer.noise import LEAST_REDUNDANCY
from rotcal_ros.methods.tracer.solution import KNOWN, TracerSolution
from rotcal_ros.protection import POWER

NOTHING: Final = 1e-150


@dataclass(frozen=True, slots=True)
class Worst:
    """The largest error that may stay unseen, in standard uncertainties; ``seen``: no larger."""

    error: float
    seen: bool


@dataclass(frozen=True, eq=False)
class Response:
    """What k patterns of unit size do: to the deviations (k, m) in rad, and to the tests.

    ``stations`` (k, m, 3) in m. ``detectable`` (k,): size that is found; infinite when no test
    feels the pattern.
    """

    deviations: Floats
    stations: Floats
    detectable: Floats

    def worst(self, std: Floats, largest: float) -> Worst:
        """Return the largest error that may stay unseen; no pattern is larger than ``largest``.

        ``std`` (m,): stated standard uncertainties, rad.
        """
        felt = std > 0.0
        share = np.abs(self.deviations[:, felt]) / std[felt]
        error = np.minimum(self.detectable, largest) * share.max(axis=1)
        k = int(np.argmax(error))
        return Worst(float(error[k]), bool(self.detectable[k] <= largest))

    def take(self, which: slice) -> Response:
        """Return some of the patterns."""
        return Response(self.deviations[which], self.stations[which], self.detectable[which])


def respond(solution: TracerSolution, errors: Floats) -> Response:
    """Return what errors (k, m, n) of the lengths, in m, do to ``solution``."""
    moved, unexplained = _as_network(solution, errors)
    if solution.problem.variant == "station":
        moved = _by_station(solution, errors)
    motion, fit = solution.motion, solution.fit
    bearing = bearing_jacobian(fit.stations, motion)
    deviations = moved.reshape(len(moved), -1) @ (bearing - bearing[0]).T
    significance = solution.problem.settings.test_significance
    redundancy = solution.noise_evidence.redundancy
    by_part = np.array([redundancy[:2].sum(), *redundancy[2:]])
    found = [
        _needed(dof, significance) / (seen + NOTHING)
        for dof, seen in zip(by_part.tolist(), unexplained.T, strict=True)
        if dof > LEAST_REDUNDANCY
    ]
    dof, off_circle = _off_circle(solution, moved)
    if dof:
        found.append(_needed(dof, significance) / off_circle)
    for closure in solution.evidence.closures:
        first, last = np.searchsorted(solution.positions, [closure.first, closure.last])
        jump = deviations[:, last] - deviations[:, first]
        found.append(_needed(1.0, significance) / ((jump / closure.std) ** 2 + NOTHING))
    return Response(deviations, moved, np.sqrt(np.min(found, axis=0)))


def _needed(dof: float, significance: float) -> float:
    """Return the noncentrality of chi-squared that is found with POWER.

    Normal approximation, exact for one degree of freedom.
    """
    beyond = normal_isf(1.0 - POWER)
    if dof == 1.0:
        return (normal_isf(0.5 * significance) + beyond) ** 2
    above = float(chi2_isf(significance, dof)) - dof
    # above + x with a variance of 2 dof + 4 (above + x) about it has to stay beyond it
    return above + 2.0 * beyond**2 + beyond * sqrt(4.0 * beyond**2 + 4.0 * above + 2.0 * dof)


def _by_station(solution: TracerSolution, errors: Floats) -> Floats:
    """Return moves (k, m, 3) of stations that are solved one by one."""
    grid, fit = solution.grid, solution.fit
    weights = grid.used / fit.std**2
    _, unit = ranges(fit.stations, fit.targets)
    rows = np.concatenate([unit, -np.ones((*weights.shape, 1))], axis=2)
    normal = rows.swapaxes(1, 2) @ (rows * weights[:, :, None])
    pull = np.einsum("kji,jia->kja", errors * weights, rows)
    moved = np.einsum("jab,kjb->kja", np.linalg.inv(normal), pull)[:, :, :3]
    return np.asarray(moved, dtype=np.float64)


def _as_network(solution: TracerSolution, errors: Floats) -> tuple[Floats, Floats]:
    """Return moves of the stations (k, m, 3), and what residuals add to sums of squares (k, 4).

    To those of the lengths and of the targets' x, y and z: both variants are tested as a network.
    """
    std = np.maximum(solution.grid.target_std, KNOWN)
    grid, fit = replace(solution.grid, target_std=std), solution.fit
    network = fit.network or linearise(grid, fit.state, fit.targets)
    gain = NetworkGain.of(network)
    rows = network.rows
    seen = np.ascontiguousarray(rows[:, :, :3].swapaxes(0, 1))  # (n, m, 3)
    pull = network.weights * errors
    by_target = (pull.transpose(2, 0, 1) @ seen).swapaxes(0, 1)
    x, y = gain.step((pull.swapaxes(0, 1) @ rows).swapaxes(0, 1), -by_target)
    taken = (rows @ x.transpose(1, 2, 0)).transpose(2, 0, 1)
    taken -= (seen @ y.transpose(1, 2, 0)).transpose(2, 1, 0)
    unexplained = np.zeros((len(errors), 4))
    unexplained[:, 0] = (network.weights * (errors - taken) ** 2).sum(axis=(1, 2))
    if not grid.free:
        unexplained[:, 1:] = ((y / std) ** 2).sum(axis=1)
    return x[:, grid.first_strip, :3], unexplained


def _off_circle(solution: TracerSolution, moved: Floats) -> tuple[int, Floats]:
    """Return the circle's degrees of freedom, and what moves (k, m, 3) add to its chi-squared."""
    circle = circle_tested(
        solution.fit.stations, solution.motion, solution.covariance.total,
        solution.error_motion.used, solution.grid.circle_std,
    )  # fmt: skip
    seen = circle.moved(moved)
    chi2 = (seen * np.linalg.solve(circle.covariance, seen.T).T).sum(axis=1) + NOTHING
    return len(circle.seen), np.asarray(chi2)
