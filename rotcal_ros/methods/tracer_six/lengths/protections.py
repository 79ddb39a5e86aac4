"""What protects a tracer result against each effect that could spoil it, and how well.

Drift, knock, scale and refraction are worked out for the measurement at hand, to first order about
its solution. Each is a *pattern*: errors (p, n) of the lengths per unit of its size. It moves the
deviations, and it shows in what the fit cannot take up, in the circle of the stations, and in
closures. The size at which one of these turns the verdict with a probability of POWER is the
*detectable* one.

What does not depend on how a method works this out comes first, for one place of the tracer and
for several: the sizes up to which an effect is searched for, the largest error that stays unseen,
effects of the air, and the statements that both methods make.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import Final

import numpy as np

from rotcal_ros.adjust.closures import closures
from rotcal_ros.adjust.distributions import chi2_isf, noise_growth, normal_isf
from rotcal_ros.adjust.effects import Unseen
from rotcal_ros.adjust.low_rank import LowRank
from rotcal_ros.adjust.model import recurring
from rotcal_ros.adjust.noise import LEAST_REDUNDANCY
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import HALF_OF_95_PERCENT
from rotcal_ros.foundation.protection import POWER, Effect, Protection, ordered
from rotcal_ros.foundation.raw_data import MOST_INFLUENCES, Influence
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.geometry.rotations import cross_matrix
from rotcal_ros.methods.tracer_six.lengths.adjustment import ranges, station_gain
from rotcal_ros.methods.tracer.solver.circle import bearing_slopes
from rotcal_ros.methods.tracer_six.lengths.network import (
    KNOWN,
    Network,
    NetworkGain,
    network_of,
    view_of,
)
from rotcal_ros.methods.tracer.solver.problem import share_gone
from rotcal_ros.methods.tracer_six.lengths.reported import Slope, excess_of
from rotcal_ros.methods.tracer_six.lengths.screening import gathering_protection
from rotcal_ros.methods.tracer.solver.solution import TracerSolution
from rotcal_ros.methods.tracer.solver.uncertainty import error_motion_spread
from rotcal_ros.methods.tracer_six.lengths.verdict import FAILED_FACTORS
from rotcal_ros.methods.tracer_six.lengths.zeros import largest_share
from rotcal_ros.planning.readings import passes

LARGEST_MOVE: Final = 1e-4
"""Drift or knock (m, or rad times the largest reach) that could not be overlooked."""
LARGEST_RATIO: Final = 1e-3
"""Error of the scale, or of the air's index per metre of height, that could not be missed."""
KNOCKED_AT: Final = (0.25, 0.5, 0.75)
"""Shares of a run after which a knock is tried."""
NOTHING: Final = 1e-150
"""Keeps divisions by what a test does not feel finite; far below any square of a length."""
MOST_PATTERNS: Final = 4_000_000
"""Lengths of all patterns together, 32 MB, up to which each length's influence is stated."""


def stated(
    effect: Effect, worst: Unseen, *, harmless: str, not_protected: str, tested: str
) -> Protection:
    """Return the statement about ``effect`` in the wording of its treatment."""
    treatment = worst.treatment
    why = {"harmless": harmless, "not protected": not_protected, "tested": tested}[treatment]
    return Protection(effect, treatment, why, worst.error if treatment == "tested" else None)


def refracted(distance: Floats, stations: Floats, targets: Floats) -> Floats:
    """Return lengths (1, p, n) by an index of the air that grows by one per metre of height.

    ``distance`` (p, n) between ``stations`` (p, 3) and ``targets`` (n, 3). The index at the mean
    height of a beam is that along it, for it grows linearly.
    """
    height = 0.5 * (stations[:, None, 2] + targets[:, 2])
    return np.asarray(distance * (height - height.mean()))[None]


def noise_protection(error: float) -> Protection:
    """Return the statement about components of the noise that are larger than stated."""
    return Protection(
        "axis noise",
        "tested",
        "the noise of lengths and of the targets' x, y and z is tested apart, and estimated where "
        "the statement does not hold",
        error,
    )


def tangential_protection(
    radius: float,
    *,
    alike: str,
    of: str = "",
    beside: str = "",
    within: float | None,
    shown: str,
    untested: str,
) -> Protection:
    """Return the statement about a tracer that moves along its circle between the angles.

    All its lengths are those of a table that turned further: none can show it, and an angle that
    was measured again bounds only what does not come back with the angle. ``radius`` (m) of the
    circle; ``alike``: what else looks like it, ``of`` which deviation the angle is, ``beside``:
    what else is said. ``within`` (m): how near the tracer came back, 95 %, as ``shown``; None:
    that is ``untested``.
    """
    why = (
        f"a tracer that mount or cable shift along its circle between the angles{alike} leaves no "
        f"trace in any length: 1 um of it is {MICROMETRE / radius / ARCSEC:.2f} arcsec{of}"
    )
    bound = (
        "no angle was measured again, which would bound what of it does not come back with "
        f"{untested}"
    )
    if within is not None:
        bound = (
            f"what of it does not come back with the angle is less than {within / MICROMETRE:.2g} "
            f"um, {within / radius / ARCSEC:.2g} arcsec (95 %, {shown})"
        )
    why = "; ".join(filter(None, (why, beside, bound)))
    return Protection("tangential motion", "not protected", why)


def protections(solution: TracerSolution) -> tuple[Protection, ...]:
    """Return a statement about every effect, in the fixed order."""
    moving, arrivals = _moving(solution), _arrivals(solution)
    standing, targets = solution.fit.standing, solution.fit.targets
    distance, _ = ranges(standing, targets)
    air = refracted(distance, standing, targets)
    moving |= {"recurring drift": returning(solution)}
    worst = _worst(solution, moving | {"scale": distance[None], "refraction": air})
    alike = "the machine's frame that drifts or turns in each turn of the table alike"
    return ordered(
        (
            *_of_the_order(solution, worst),
            _moved("recurring drift", worst["recurring drift"], solution, alike),
            noise_protection(float(np.max(_hidden_noise(solution)))),
            _error_motion(solution),
            _repeatability(solution, arrivals),
            _of_the_air("refraction", "air in layers", worst["refraction"]),
            _of_the_air("scale", "a wrong scale of the lengths", worst["scale"]),
            _tilt(solution),
            Protection(
                "gauge",
                "harmless",
                "no gauge is carried: the angle is counted on the circle of the stations, in its "
                "own plane, whatever its radius and lean",
            ),
            *_slip(solution),
            _tangential(solution, arrivals),
            *gathering_protection(solution.evidence.gathering, solution.angles.std),
        )
    )


def of_the_order(solution: TracerSolution) -> tuple[Protection, Protection]:
    """Return the statements about drift and knock, which depend on the order of measuring."""
    return _of_the_order(solution, _worst(solution, _moving(solution)))


def _moving(solution: TracerSolution) -> dict[str, Floats]:
    """Return the patterns (p, m, n) of what moves while it is measured."""
    reach = float(np.linalg.norm(solution.fit.targets - solution.motion.centre, axis=1).max())
    return {
        "drift": drifts(solution),
        "turn": turning(solution) / reach,
        "knock": knocks(solution),
    }


def _worst(solution: TracerSolution, patterns: dict[str, Floats]) -> dict[str, Unseen]:
    """Return the largest error of each kind of pattern that may stay unseen."""
    answer = respond(solution, np.concatenate(list(patterns.values())))
    share, first = largest_share(answer.deviations, solution.angles.std), 0
    found: dict[str, Unseen] = {}
    for name, pattern in patterns.items():
        part = slice(first, first + len(pattern))
        largest = LARGEST_RATIO if name in ("scale", "refraction") else LARGEST_MOVE
        found[name] = Unseen.worst(answer.detectable[part], share[part], largest)
        first = part.stop
    return found


def _of_the_order(
    solution: TracerSolution, worst: dict[str, Unseen]
) -> tuple[Protection, Protection]:
    drift = max(worst["drift"], worst["turn"], key=lambda unseen: unseen.error)
    return (
        _moved("drift", drift, solution, "the machine's frame that drifts or turns"),
        _moved("knock", worst["knock"], solution, "a tracer that slips on the table"),
    )


def _slip(solution: TracerSolution) -> tuple[Protection, ...]:
    """Return the statement about a fringe slipped unseen, where lengths share zeros."""
    slips = solution.slips
    if slips is None:
        return ()
    cumulative = bearing_slopes(solution.fit.stations, solution.motion).from_first
    moved = cumulative.times(slips.shifts.moved.T).T
    return (slips.protection(moved, solution.angles.std),)


def _moved(effect: Effect, worst: Unseen, solution: TracerSolution, what: str) -> Protection:
    """Return the statement about ``what`` moves during the run and is a closure's to find."""
    closes = bool(solution.evidence.closures)
    cure = "the closure does not show it"
    if not closes:
        cure = "no position was measured again after a whole turn to show it"
    tests = "residuals, circle and closure" if closes else "residuals and circle"
    return stated(
        effect,
        worst,
        harmless=f"{what} moves what cancels in the angle",
        not_protected=f"{what} turns the curve: {cure}",
        tested=f"{what} shows in {tests} of the stations",
    )


def _of_the_air(effect: Effect, what: str, worst: Unseen) -> Protection:
    """Return the statement about ``what`` spoils all lengths alike."""
    return stated(
        effect,
        worst,
        harmless=f"{what} moves all stations alike",
        not_protected=f"{what} bends the curve and leaves no residual",
        tested=f"{what} shows in the residuals before it matters",
    )


def _hidden_noise(solution: TracerSolution) -> Floats:
    """Return by component (5,) the error of a larger noise that just is found with POWER.

    The sum of squares q is r / h times chi-squared of h = r^2 / H degrees of freedom; with a noise
    f times as large it grows by (f^2 - 1) H.
    """
    evidence, angles = solution.noise_evidence, solution.angles
    # absent components have no redundancy; their share below is zero whatever comes out here
    redundancy = np.maximum(evidence.redundancy, 1e-9)
    information = np.maximum(evidence.information.diagonal(), 1e-9)
    dof = np.maximum(redundancy**2 / information, 1e-3)
    significance = 0.5 * solution.problem.settings.test_significance
    ratio = chi2_isf(significance, dof) / np.maximum(chi2_isf(POWER, dof), 1e-30)
    extra = redundancy / information * (ratio - 1.0)
    uncertain = angles.std > 0.0
    cumulative = bearing_slopes(solution.fit.stations, solution.motion).from_first
    of_targets = solution.covariance.sensitivity
    moved = cumulative.times(of_targets.reshape(len(of_targets), -1))[uncertain]
    by_axis = (moved.reshape(-1, *of_targets.shape[1:]) ** 2).sum(axis=1)
    lengths = angles.budget["lengths"][uncertain] ** 2
    variance = np.column_stack([lengths, lengths, by_axis])
    shares = (variance / angles.std[uncertain, None] ** 2).max(axis=0) * evidence.present
    return np.asarray(np.sqrt(np.minimum(extra, FAILED_FACTORS**2) * shares), dtype=np.float64)


def _error_motion(solution: TracerSolution) -> Protection:
    motion = solution.error_motion
    if motion.estimated:
        return Protection(
            "error motion",
            "estimated",
            f"{motion.used:.2g} m from {motion.dof} residuals of the circle, which show its "
            "radial part; the tangential part is taken to be as large",
        )
    return Protection(
        "error motion",
        "tested",
        f"stated as {motion.stated:.2g} m; the circle of the stations shows the radial part of "
        "more; left unset, it would be estimated",
        _hidden_motion(solution),
    )


@dataclass(frozen=True, slots=True)
class Returned:
    """How nearly the tracer came back to a place of its circle after whole turns of the table.

    Table positions ``first`` and ``last`` stand at the same angle; along the circle their stations
    lie apart by less than ``within`` (m), with 95 %.
    """

    first: int
    last: int
    within: float


def returned(solution: TracerSolution) -> tuple[Returned, ...]:
    """Return what each closing measurement bounds; empty where no angle comes twice."""
    motion, angles, ids = solution.motion, solution.table_angles, solution.positions
    covariance = solution.covariance.enlarged(solution.scale).total
    if solution.slips is not None:
        covariance = covariance + LowRank.whole(solution.slips.covariance(), 3)
    # without the error motion: that is searched for
    measured = bearing_slopes(solution.fit.stations, motion).spread(covariance)
    gathered = solution.evidence.gathering.covariance()
    if gathered is not None:
        measured = measured + LowRank.whole(gathered)
    return tuple(
        Returned(c.first, c.last, motion.radius * (abs(c.error) + HALF_OF_95_PERCENT * c.std))
        for c in closures(angles, motion.cumulative, measured, ids)
    )


def _tangential(solution: TracerSolution, turns: int) -> Protection:
    """Return the statement about a tracer that moves along its circle between the angles.

    Where every position is come to in each of several ``turns``, a frame of the machine that
    drifts in step with them displaces each station by the same each time: that is the same thing.
    """
    closing = max(returned(solution), key=lambda each: each.within, default=None)
    drift = ", or a machine whose origin drifts in step with each turn of the table,"
    held = f"{solution.error_motion.used / MICROMETRE:.2g} um (k = 1)"
    return tangential_protection(
        solution.motion.radius,
        alike=drift if turns > 1 else "",
        beside=f"the uncertainty holds {held}, which is believed and not measured",
        within=None if closing is None else closing.within,
        shown=""
        if closing is None
        else f"positions {closing.first} and {closing.last}, at the same angle",
        untested="the angle",
    )


def _tilt(solution: TracerSolution) -> Protection:
    motion = solution.error_motion
    return Protection(
        "tilt",
        "estimated" if motion.estimated else "tested",
        "the table's tilts shift the tracer by its height, as part of the error motion",
        None if motion.estimated else _hidden_motion(solution),
    )


def _hidden_motion(solution: TracerSolution) -> float:
    """Return the error of an unstated error motion that the circle just shows with POWER."""
    motion, angles = solution.motion, solution.angles
    residuals = solution.circle.residuals
    dof = residuals.dof
    if dof == 0:
        return float("inf")
    significance = solution.problem.settings.test_significance
    growth = noise_growth(significance, POWER, dof)
    bearing = bearing_slopes(solution.fit.stations, motion)
    others = np.arange(1, len(angles.std))
    unit = bearing.spread(error_motion_spread(motion, 1.0)).between(np.zeros_like(others), others)
    felt = np.sqrt(unit) / angles.std[1:]
    return float(np.sqrt((growth - 1.0) * residuals.variance) * felt.max())


def _repeatability(solution: TracerSolution, arrivals: int) -> Protection:
    if solution.problem.repeated_runs:
        return Protection(
            "repeatability", "estimated", "every position is reached in several runs"
        )
    if arrivals < 2:
        return Protection(
            "repeatability",
            "not protected",
            "the table arrives once at a position: what it does not repeat is in the curve and "
            "not in the uncertainty",
        )
    return Protection(
        "repeatability",
        "tested",
        f"the table arrives {arrivals} times or more at each position: what it does not repeat "
        "joins the scatter of the lengths",
        float(_hidden_noise(solution)[0]),
    )


def _gone(solution: TracerSolution) -> Floats:
    """Return which share (p, n), 0 to 1, of the run had gone at each length."""
    return solution.grid.placed(share_gone(solution.problem.measuring_order))


def _arrivals(solution: TracerSolution) -> int:
    """Return how often the table visited the position that it visited least."""
    problem = solution.problem
    at = problem.position[np.argsort(problem.measuring_order, kind="stable")]
    come = np.append(True, np.diff(at) != 0)
    arrivals = np.bincount(at[come], minlength=len(problem.table_angles))
    return int(arrivals[solution.positions].min())


def drifts(solution: TracerSolution, gone: Floats | None = None) -> Floats:
    """Return the frame of the machine drifting by a metre along x, y, z: (3, m, n).

    By the share ``gone`` (m, n) at each length; None: linearly over the run.
    """
    _, unit = ranges(solution.fit.standing, solution.fit.targets)
    gone = _gone(solution) if gone is None else gone
    return np.asarray(-gone * unit.transpose(2, 0, 1), dtype=np.float64)


def turning(solution: TracerSolution, gone: Floats | None = None) -> Floats:
    """Return the frame of the machine turning about the table's axis by a radian: (1, m, n)."""
    motion, fit = solution.motion, solution.fit
    _, unit = ranges(fit.standing, fit.targets)
    arms = cross_matrix(motion.plane.normal[None])[0] @ (fit.targets - motion.centre).T
    gone = _gone(solution) if gone is None else gone
    return np.asarray(-gone * np.einsum("jia,ai->ji", unit, arms), dtype=np.float64)[None]


def returning(solution: TracerSolution) -> Floats:
    """Return the same by a metre, or at the farthest target, in each turn alike: (12, m, n)."""
    problem, motion = solution.problem, solution.motion
    reach = float(np.linalg.norm(solution.fit.targets - motion.centre, axis=1).max())
    order = problem.measuring_order
    run = passes(np.zeros(len(order), np.int64), problem.position, order)
    shapes = [solution.grid.placed(shape) for shape in recurring(run, order.astype(np.float64)).T]
    moves = ((drifts(solution, each), turning(solution, each) / reach) for each in shapes)
    return np.concatenate([pattern for both in moves for pattern in both])


def knocks(solution: TracerSolution) -> Floats:
    """Return the tracer shifted on the table by a metre: out, along, up; (9, m, n)."""
    motion = solution.motion
    _, unit = ranges(solution.fit.standing, solution.fit.targets)
    basis, station = motion.plane.basis(), solution.grid.station
    out = motion.in_plane / np.linalg.norm(motion.in_plane, axis=1)[:, None]
    along = np.column_stack([-out[:, 1], out[:, 0]])
    up = np.broadcast_to(motion.plane.normal, (len(out), 3))
    shifts = np.stack([out @ basis, along @ basis, up])
    felt = np.einsum("sja,jia->sji", shifts[:, station], unit)
    gone = _gone(solution)
    return np.concatenate([felt * (gone >= share) for share in KNOCKED_AT])


@dataclass(frozen=True, eq=False)
class Response:
    """What k patterns of unit size do: to the deviations (k, m) in rad, and to the tests.

    ``detectable`` (k,): size that is found; infinite when no test feels the pattern.
    """

    deviations: Floats
    detectable: Floats


def respond(solution: TracerSolution, errors: Floats) -> Response:
    """Return what errors (k, m, n) of the lengths, in m, do to ``solution``."""
    moved, unexplained = _as_network(solution, errors)
    if solution.problem.variant == "station":
        moved = np.einsum("kji,jia->kja", errors, station_gain(solution.grid, solution.fit))
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
    return Response(deviations, np.sqrt(np.min(found, axis=0)))


def influence_of(solution: TracerSolution) -> Influence | None:
    """Return what standard errors of lengths and targets do to ECC; None where they are many."""
    grid, fit, scale = solution.grid, solution.fit, solution.scale
    strip, target = np.nonzero(grid.used)
    k, m = len(strip), len(solution.positions)
    if m * (k + fit.targets.size) > MOST_INFLUENCES or k * grid.used.size > MOST_PATTERNS:
        return None
    cumulative = bearing_slopes(fit.stations, solution.motion).from_first
    if solution.problem.variant == "station":
        moved = station_gain(grid, fit)[strip, target] * grid.length_std[strip, target][:, None]
        lengths = (cumulative.dense().reshape(m, m, 3)[:, strip] * moved).sum(axis=2)
    else:
        sensitivity = view_of(network_of(grid, fit), cumulative).sensitivity(strip, target)
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
    """Return the network, moves (k, p, 4) and (k, n, 3) by errors (k, p, n), and what is left."""
    network = network_of(solution.grid, solution.fit)
    gain = NetworkGain.of(network)
    rows = network.rows
    seen = np.ascontiguousarray(rows[:, :, :3].swapaxes(0, 1))  # (n, m, 3)
    pull = network.weights * errors
    by_target = (pull.transpose(2, 0, 1) @ seen).swapaxes(0, 1)
    x, y = gain.step((pull.swapaxes(0, 1) @ rows).swapaxes(0, 1), -by_target)
    taken = (rows @ x.transpose(1, 2, 0)).transpose(2, 0, 1)
    taken -= (seen @ y.transpose(1, 2, 0)).transpose(2, 1, 0)
    return network, x, y, errors - taken


def slope_along(solution: TracerSolution, errors: Floats) -> Slope:
    """Return what the residuals of a solution say of ``errors`` (k,), m, row by row."""
    grid, fit = solution.grid, solution.fit
    column = grid.placed(errors)
    _, unexplained = _as_network(solution, column[None])
    network, _, _, left = _left(solution, column[None])
    # at its minimum a network has taken up what it can of its residuals; lone stations have not
    felt = column if solution.problem.variant == "joint" else left[0]
    excess = excess_of(solution.noise, solution.problem.settings.test_significance)
    return Slope.of(fit, network.weights * felt, float(unexplained.sum()), excess)


def _off_circle(solution: TracerSolution, moved: Floats) -> tuple[int, Floats]:
    """Return the circle's degrees of freedom, and what moves (k, m, 3) add to its chi-squared."""
    circle = solution.circle
    dof = circle.residuals.dof
    if dof == 0:
        return 0, np.full(len(moved), NOTHING)
    return dof, circle.residuals.squares(circle.moved(moved)) + NOTHING
