"""What systematic errors of the lengths do to the six curves, and whether a test sees them.

To first order, about a solution: a pattern of errors moves the curves, and what the network cannot
take up of it is left in chi-squared.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import noncentrality
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.protection import POWER
from rotcal_ros.foundation.raw_data import MOST_INFLUENCES, Influence
from rotcal_ros.geometry.rotations import cross_matrix
from rotcal_ros.methods.tracer.solver.error_response import MOST_PATTERNS, Worst
from rotcal_ros.methods.tracer.solver.reported import (
    Slope,
    WeighedSolution,
    excess_of,
    noticed,
    scatter_along,
    weigh,
)
from rotcal_ros.methods.tracer_six.solver.patterns import pattern_gradient
from rotcal_ros.methods.tracer_six.solver.problem import SixProblem
from rotcal_ros.methods.tracer_six.solver.solution import PLACE, SixSolution, adjust
from rotcal_ros.methods.tracer_six.solver.timing import NetworkTiming

KNOCKED_AT: Final = (0.25, 0.5, 0.75)
"""Shares of a run after which a knock is tried."""
NOTHING: Final = 1e-150


def worst(solution: SixSolution, patterns: Floats, largest: float) -> Worst:
    """Return the worst of ``patterns`` (k, V, n), m per unit, none of them beyond ``largest``."""
    moved, left = _respond(solution, patterns)
    std = np.sqrt(np.einsum("ajaj->aj", solution.covariance))
    share = (np.abs(moved) / np.maximum(std, NOTHING)).max(axis=(1, 2))
    significance = solution.problem.settings.test_significance
    needed = noncentrality(significance, POWER, max(solution.fit.dof, 1))
    seen_at = np.sqrt(needed / (left + NOTHING))
    for name, found in solution.closures.items():
        for c in found:
            first, last = np.searchsorted(solution.positions, [c.first, c.last])
            jump = moved[:, PLACE[name], last] - moved[:, PLACE[name], first]
            size = np.sqrt(noncentrality(significance, POWER)) * c.std
            seen_at = np.minimum(seen_at, size / (np.abs(jump) + NOTHING))
    seen_at = np.minimum(seen_at, solution.moves.found_at(patterns, significance))
    error = np.minimum(seen_at, largest) * share
    k = int(np.argmax(error))
    return Worst(float(error[k]), bool(seen_at[k] <= largest))


def _respond(solution: SixSolution, patterns: Floats) -> tuple[Floats, Floats]:
    """Return moves of the curves (k, 6, m), and what is left in chi-squared (k,)."""
    layout, here, k = solution.layout, pattern_gradient(solution.network, patterns), len(patterns)
    step = here.slope @ solution.fit.posterior.covariance
    left = (here.weighted * patterns).sum(axis=(1, 2)) - (step * here.slope).sum(axis=1)
    moved = step[:, layout.size :] @ solution.table.jacobian.T
    m = len(layout.angles)
    ordered = moved.reshape(k, 2, m, 3).transpose(0, 1, 3, 2).reshape(k, 6, m)
    return ordered, np.maximum(left, 0.0)


def adjust_at_equal_places(problem: SixProblem, along: Floats) -> WeighedSolution[SixSolution]:
    """Solve a problem with each length as it would be at the mean place of its target.

    ``along`` (k,): how much longer the machine said that each length was, m; believed as far as
    the lengths follow it (:mod:`rotcal_ros.methods.tracer.solver.reported`).
    """

    def moved(weight: float, left: float) -> SixSolution:
        length_std = np.hypot(problem.length_std, left)
        length = problem.length - weight * along
        return adjust(replace(problem, length=length, length_std=length_std))

    if not noticed(along, problem.length_std):
        return WeighedSolution(moved(1.0, 0.0), None)
    scatter = scatter_along(along, problem.target)
    return weigh(adjust(problem), moved, lambda solution: _slope_along(solution, along), scatter)


def _slope_along(solution: SixSolution, errors: Floats) -> Slope:
    """Return what the residuals of a solution say of ``errors`` (k,), m, row by row."""
    row, fit = solution.grid.row, solution.fit
    column = np.where(row >= 0, errors[row], 0.0)[None]
    _, information = _respond(solution, column)
    score = (pattern_gradient(solution.network, column).weighted[0] * fit.residual).sum()
    excess = excess_of(solution.noise, solution.problem.settings.test_significance)
    return Slope(float(score), float(information[0]), fit.chi2, fit.dof, excess)


def influence_of(solution: SixSolution) -> Influence | None:
    """Return what a standard error of each length does to the curves; None where they are many."""
    grid = solution.grid
    station, target = np.nonzero(grid.used)
    k, m = len(station), len(solution.positions)
    if 6 * m * k > MOST_INFLUENCES or k * grid.used.size > MOST_PATTERNS:
        return None
    patterns = np.zeros((k, *grid.used.shape))
    patterns[np.arange(k), station, target] = solution.scale * grid.length_std[station, target]
    moved, _ = _respond(solution, patterns)
    return Influence(
        grid.row[station, target], 1, {name: moved[:, at].T for name, at in PLACE.items()}
    )


def drifts(solution: SixSolution, when: NetworkTiming) -> Floats:
    """Return the machine drifting by a metre, or turning by a radian times the reach: (12, V, n).

    Over all runs, and anew in each run.
    """
    state, unit = solution.network.state, solution.network.slopes.unit
    reach = float(np.linalg.norm(state.targets, axis=1).max())
    turns = -cross_matrix(state.targets / reach)  # (n, 3, 3)
    shifts = np.broadcast_to(np.eye(3), turns.shape)
    moves = np.concatenate([shifts, turns], axis=2)  # (n, 3, 6)
    felt = -(unit[:, :, None] @ moves)[:, :, 0].transpose(2, 0, 1)
    return np.concatenate([when.whole * felt, when.own * felt])


def knocks(solution: SixSolution, when: NetworkTiming) -> Floats:
    """Return the tracer of each run slipping by a metre along three directions: (9 p, V, n)."""
    layout, unit = solution.layout, solution.network.slopes.unit
    along = (unit @ solution.network.state.rotation[layout.position]).transpose(2, 0, 1)
    late = [when.own >= share for share in KNOCKED_AT]
    runs = [(layout.place == k)[:, None] for k in range(len(layout.places))]
    return np.concatenate([along * after * mine for after in late for mine in runs])


def scale(solution: SixSolution) -> Floats:
    """Return lengths that are too long by their own size: (1, V, n)."""
    return _distance(solution)[None]


def refraction(solution: SixSolution) -> Floats:
    """Return an index of the air that grows by one per metre of height: (1, V, n)."""
    network = solution.network
    stations = network.state.stations(network.layout)
    height = 0.5 * (stations[:, None, 2] + network.state.targets[:, 2])
    return np.asarray(_distance(solution) * (height - height.mean()))[None]


def _distance(solution: SixSolution) -> Floats:
    state = solution.network.state
    stations = state.stations(solution.layout)
    return np.asarray(np.linalg.norm(stations[:, None] - state.targets, axis=2))
