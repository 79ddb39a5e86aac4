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

from rotcal_ros.adjust.distributions import chi2_isf, normal_isf
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.protection import POWER
from rotcal_ros.foundation.raw_data import MOST_INFLUENCES, Influence
from rotcal_ros.methods.tracer.solver.adjustment import ranges
from rotcal_ros.methods.tracer.solver.angles import bearing_slopes
from rotcal_ros.methods.tracer.solver.error_motion import circle_tested
from rotcal_ros.methods.tracer.solver.length_view import view_of
from rotcal_ros.methods.tracer.solver.network import Network, linearise
from rotcal_ros.methods.tracer.solver.network_gain import NetworkGain
from rotcal_ros.methods.tracer.solver.noise import LEAST_REDUNDANCY
from rotcal_ros.methods.tracer.solver.reported import Slope, excess_of
from rotcal_ros.methods.tracer.solver.solution import KNOWN, TracerSolution

NOTHING: Final = 1e-150
MOST_PATTERNS: Final = 4_000_000
"""Lengths of all patterns together, 32 MB, up to which each length's influence is told."""


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
        uncertain = std > 0.0
        share = np.abs(self.deviations[:, uncertain]) / std[uncertain]
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
    cumulative = bearing_slopes(fit.stations, motion).from_first
    deviations = cumulative.times(moved.reshape(len(moved), -1).T).T
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


def influence_of(solution: TracerSolution) -> Influence | None:
    """Return what standard errors of lengths and targets do to ECC; None where they are many."""
    grid, fit, scale = solution.grid, solution.fit, solution.scale
    strip, target = np.nonzero(grid.used)
    k, m = len(strip), len(solution.positions)
    if m * (k + fit.targets.size) > MOST_INFLUENCES or k * grid.used.size > MOST_PATTERNS:
        return None
    cumulative = bearing_slopes(fit.stations, solution.motion).from_first
    if solution.problem.variant == "station":
        moved = _gain(solution)[strip, target] * grid.length_std[strip, target][:, None]
        lengths = (cumulative.dense().reshape(m, m, 3)[:, strip] * moved).sum(axis=2)
    else:
        sensitivity = view_of(_network(solution), cumulative).sensitivity(strip, target)
        lengths = sensitivity.weighted(1.0 / grid.length_std[strip, target]).dense()
    lengths = scale * lengths
    targets = scale * cumulative.times(solution.covariance.sensitivity.reshape(3 * m, -1))
    # Named by the place that is stated for a target: its number is another one in other tables.
    places = (", ".join(f"{x:.4f}" for x in place) for place in grid.targets.tolist())
    causes = tuple(f"{axis} of the target at {place} m" for place in places for axis in "xyz")
    return Influence(grid.row[strip, target], 1, {"ECC": np.hstack([lengths, targets])}, causes)


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
    return np.asarray(np.einsum("kji,jia->kja", errors, _gain(solution)), dtype=np.float64)


def _gain(solution: TracerSolution) -> Floats:
    """Return the move (m, n, 3) of each station that is solved by itself per error of a length."""
    grid, fit = solution.grid, solution.fit
    weights = grid.used / fit.std**2
    _, unit = ranges(fit.stations, fit.targets)
    rows = np.concatenate([unit, -np.ones((*weights.shape, 1))], axis=2)
    weighted = rows * weights[:, :, None]
    gain = weighted @ np.linalg.inv(rows.swapaxes(1, 2) @ weighted)
    return np.asarray(gain[:, :, :3], dtype=np.float64)


def _as_network(solution: TracerSolution, errors: Floats) -> tuple[Floats, Floats]:
    """Return moves of the stations (k, m, 3), and what residuals add to sums of squares (k, 4).

    To those of the lengths and of the targets' x, y and z: both variants are tested as a network.
    """
    network, x, y, left = _left(solution, errors)
    unexplained = np.zeros((len(errors), 4))
    unexplained[:, 0] = (network.weights * left**2).sum(axis=(1, 2))
    if not solution.grid.free:
        std = np.maximum(solution.grid.target_std, KNOWN)
        unexplained[:, 1:] = ((y / std) ** 2).sum(axis=1)
    return x[:, solution.grid.first_strip, :3], unexplained


def _left(solution: TracerSolution, errors: Floats) -> tuple[Network, Floats, Floats, Floats]:
    """Return the network, the moves (k, p, 4), (k, n, 3) by errors (k, p, n), and what is left."""
    network = _network(solution)
    gain = NetworkGain.of(network)
    rows = network.rows
    seen = np.ascontiguousarray(rows[:, :, :3].swapaxes(0, 1))  # (n, m, 3)
    pull = network.weights * errors
    by_target = (pull.transpose(2, 0, 1) @ seen).swapaxes(0, 1)
    x, y = gain.step((pull.swapaxes(0, 1) @ rows).swapaxes(0, 1), -by_target)
    taken = (rows @ x.transpose(1, 2, 0)).transpose(2, 0, 1)
    taken -= (seen @ y.transpose(1, 2, 0)).transpose(2, 1, 0)
    return network, x, y, errors - taken


def _network(solution: TracerSolution) -> Network:
    """Return the network at a solution, of whichever variant; targets are never quite known."""
    grid, fit = solution.grid, solution.fit
    if fit.network is not None:
        return fit.network
    known = replace(grid, target_std=np.maximum(grid.target_std, KNOWN))
    return linearise(known, fit.state, fit.targets)


def slope_along(solution: TracerSolution, errors: Floats) -> Slope:
    """Return what the residuals of a solution say of ``errors`` (k,), m, row by row."""
    grid, fit = solution.grid, solution.fit
    column = np.where(grid.row >= 0, errors[grid.row], 0.0)
    _, unexplained = _as_network(solution, column[None])
    network, _, _, left = _left(solution, column[None])
    # at its minimum a network has taken up what it can of its residuals; lone stations have not
    felt = column if solution.problem.variant == "joint" else left[0]
    score = float((network.weights * felt * fit.residual).sum())
    excess = excess_of(solution.noise, solution.problem.settings.test_significance)
    return Slope(score, float(unexplained.sum()), fit.chi2, fit.dof, excess)


def _off_circle(solution: TracerSolution, moved: Floats) -> tuple[int, Floats]:
    """Return the circle's degrees of freedom, and what moves (k, m, 3) add to its chi-squared."""
    circle = circle_tested(
        solution.fit.stations, solution.motion, solution.covariance.total,
        solution.error_motion.used, solution.grid.circle_std,
    )  # fmt: skip
    dof = circle.residuals.dof
    if dof == 0:
        return 0, np.full(len(moved), NOTHING)
    return dof, circle.residuals.squares(circle.moved(moved)) + NOTHING
