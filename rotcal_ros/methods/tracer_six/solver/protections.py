"""What protects six curves against each effect that could spoil them, and how well.

To first order about a solution: a pattern of errors of the lengths moves the curves, and what the
network cannot take up of it is left in chi-squared. Closures and the tests of movement find some
of what chi-squared does not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rotcal_ros.adjust.distributions import noncentrality
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import HALF_OF_95_PERCENT
from rotcal_ros.foundation.protection import POWER, Effect, Protection, ordered
from rotcal_ros.foundation.raw_data import MOST_INFLUENCES, Influence
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.geometry.rotations import cross_matrix
from rotcal_ros.methods.tracer.solver import gathering
from rotcal_ros.methods.tracer.solver.effects import (
    KNOCKED_AT,
    LARGEST_MOVE,
    LARGEST_RATIO,
    MOST_PATTERNS,
    NOTHING,
    Worst,
    found_growth,
    noise_protection,
    refracted,
    tangential_protection,
)
from rotcal_ros.methods.tracer.solver.reported import (
    Slope,
    WeighedSolution,
    excess_of,
    noticed,
    scatter_along,
    weigh,
)
from rotcal_ros.methods.tracer_six.solver.network import pattern_gradient
from rotcal_ros.methods.tracer_six.solver.problem import NetworkTiming, SixProblem, timing
from rotcal_ros.methods.tracer_six.solver.solution import PLACE, SixSolution, adjust


def protections(solution: SixSolution) -> tuple[Protection, ...]:
    """Return a statement about every effect, in the fixed order."""
    when = timing(solution.problem, solution.grid)
    distance = _distance(solution)
    standing, targets = _standing(solution), solution.network.state.targets
    drift = _worst(solution, _drifts(solution, when), LARGEST_MOVE)
    knock = _worst(solution, _knocks(solution, when), LARGEST_MOVE)
    scale = _worst(solution, distance[None], LARGEST_RATIO)
    air = _worst(solution, refracted(distance, standing, targets), LARGEST_RATIO)
    return ordered(
        (
            _moved(
                solution,
                "drift",
                drift,
                "a machine that drifts in each run alike moves the curves",
            ),
            _moved(
                solution,
                "knock",
                knock,
                "a tracer that slips on the table, up above all, tilts the curves",
            ),
            noise_protection(_hidden(solution, max(solution.fit.dof, 1))),
            Protection("error motion", "estimated", "EXC, EYC and EZC are measured"),
            _repeatability(solution),
            _felt("refraction", air, "air in layers bends all runs alike"),
            _felt("scale", scale, "a wrong scale of the lengths stretches places and targets"),
            _tilt(solution),
            Protection(
                "gauge",
                "harmless",
                "the curves are referred to the axis itself: what a lean or shift of the machine "
                "or of the table's own frame does is taken off",
            ),
            *_slip(solution),
            _tangential(solution),
            *gathering.protection(solution.gathering, _std(solution)),
        )
    )


def _std(solution: SixSolution) -> Floats:
    """Return the standard uncertainties (6 m,) of the curves: d of all positions, then c."""
    std = np.sqrt(np.einsum("ajaj->aj", solution.covariance))
    return np.concatenate([std[:3].T.ravel(), std[3:].T.ravel()])


def _slip(solution: SixSolution) -> tuple[Protection, ...]:
    """Return the statement about a fringe slipped unseen, where lengths share zeros."""
    slips = solution.slips
    if slips is None:
        return ()
    m = len(solution.layout.angles)
    std = np.sqrt(np.einsum("ajaj->ja", solution.covariance))  # (m, 6)
    moved = slips.size * slips.shifts.moved.reshape(-1, 2, m, 3).swapaxes(1, 2).reshape(-1, m, 6)
    share = (np.abs(moved) / np.maximum(std, NOTHING)).max(axis=(1, 2))
    cure = "; several arrivals at each angle (plan.arrivals) show more"
    return (slips.protection(share, cure),)


def returned(solution: SixSolution) -> float | None:
    """Return within how many m the tracer came back along its circle, 95 %; None: untested.

    Seen by an angle that comes again, after a whole turn or in the same run, whichever says less.
    """
    closings = [
        _radius(solution) * (abs(c.error) + HALF_OF_95_PERCENT * c.std)
        for c in solution.closures["ECC"]
    ]
    return max([*closings, *filter(None, [solution.moves.returned()])], default=None)


def _radius(solution: SixSolution) -> float:
    """Return the mean distance of the places from the axis, m."""
    return float(np.hypot(*solution.places[:, :2].T).mean())


def _tangential(solution: SixSolution) -> Protection:
    """Return the statement about a tracer that moves by the same at every place."""
    return tangential_protection(
        _radius(solution),
        alike=", by the same at every place,",
        beside=" of ECC; what differs from place to place is scatter",
        within=returned(solution),
        shown="angles that were measured again",
        untested="it",
    )


def _moved(solution: SixSolution, effect: Effect, worst: Worst, what: str) -> Protection:
    """Return the statement about ``what`` moves, which an angle measured again can show."""
    again = solution.moves.test("within runs")
    if again is None:
        shown = f"{what}; no run measured an angle again to show it (plan.closes)"
    else:
        shown = f"{what}; {len(again.places)} of {len(solution.layout.places)} runs came back to"
        shown += " an angle, and are tested for it"
    return _felt(effect, worst, shown)


def _felt(effect: Effect, worst: Worst, what: str) -> Protection:
    return worst.stated(
        effect,
        f"{what}, by less than a tenth of their uncertainty",
        f"{what}, and no test shows it",
        f"{what}; the verdict turns from that size on",
    )


def _hidden(solution: SixSolution, dof: int) -> float:
    """Return the error, in standard uncertainties, of noise that chi-squared just shows."""
    significance = solution.problem.settings.test_significance
    return float(np.sqrt(max(found_growth(significance, dof) - 1.0, 0.0)))


def _repeatability(solution: SixSolution) -> Protection:
    scatter = solution.scatter
    if scatter.estimated:
        return Protection(
            "repeatability",
            "estimated",
            f"{scatter.in_words()} between runs, from {scatter.n_contrasts} contrasts between the "
            "places",
        )
    contrasts = scatter.n_contrasts
    if not contrasts:
        return Protection(
            "repeatability", "not protected", "no distance between places shows it: it is stated"
        )
    return Protection(
        "repeatability",
        "tested",
        f"stated as {scatter.in_words()} between runs; {contrasts} contrasts between the places "
        "show more of it; left unset, it is estimated",
        _hidden(solution, contrasts),
    )


def _tilt(solution: SixSolution) -> Protection:
    std = solution.problem.tilt_std
    if std is None:
        return Protection("tilt", "estimated", "EAC and EBC are measured")
    return Protection(
        "tilt",
        "bounded",
        f"EAC and EBC are held to a stated {std / ARCSEC:.2g} arcsec, which the budget holds",
    )


def _worst(solution: SixSolution, patterns: Floats, largest: float) -> Worst:
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
    return Worst.of(seen_at, share, largest)


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
    fit, column = solution.fit, solution.grid.placed(errors)[None]
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


def _drifts(solution: SixSolution, when: NetworkTiming) -> Floats:
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


def _knocks(solution: SixSolution, when: NetworkTiming) -> Floats:
    """Return the tracer of each run slipping by a metre along three directions: (9 p, V, n)."""
    layout, unit = solution.layout, solution.network.slopes.unit
    along = (unit @ solution.network.state.rotation[layout.position]).transpose(2, 0, 1)
    late = [when.own >= share for share in KNOCKED_AT]
    runs = [(layout.place == k)[:, None] for k in range(len(layout.places))]
    return np.concatenate([along * after * mine for after in late for mine in runs])


def _standing(solution: SixSolution) -> Floats:
    """Return where the stations (V, 3) are without scatter, m."""
    return solution.network.state.stations(solution.layout)


def _distance(solution: SixSolution) -> Floats:
    """Return the distances (V, n) from stations to targets, m."""
    apart = _standing(solution)[:, None] - solution.network.state.targets
    return np.asarray(np.linalg.norm(apart, axis=2))
