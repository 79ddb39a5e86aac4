"""What protects a tracer result against each effect that could spoil it, and how well.

Drift, knock, scale and refraction are worked out for the measurement at hand: what each does to
the deviations, and at which size a test would turn the verdict (:mod:`.error_response`).

What could go wrong while a tracer measures, as errors of its lengths per unit of size.

Each pattern has shape (p, n), m per unit; see :class:`LengthTiming` for when a length was taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import chi2_isf
from rotcal_ros.adjust.low_rank import LowRank
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.components import HALF_OF_95_PERCENT
from rotcal_ros.foundation.protection import POWER, Effect, Protection, ordered
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.geometry.rotations import cross_matrix
from rotcal_ros.methods.tracer.solver import gathering
from rotcal_ros.methods.tracer.solver.adjustment import ranges
from rotcal_ros.methods.tracer.solver.angles import bearing_slopes
from rotcal_ros.methods.tracer.solver.error_motion import circle_tested, error_motion_spread
from rotcal_ros.methods.tracer.solver.error_response import Worst, respond
from rotcal_ros.methods.tracer.solver.solution import TracerSolution
from rotcal_ros.methods.tracer.solver.verdict import FAILED_FACTORS, closures

LARGEST_MOVE: Final = 1e-4
"""Drift or knock (m, or rad times the largest reach) that nobody would overlook."""
LARGEST_RATIO: Final = 1e-3
"""Error of the scale, or of the air's index per metre of height, that nobody would overlook."""
HARMLESS: Final = 0.1
"""Error, in standard uncertainties, of what cannot be told from nothing."""


def protections(solution: TracerSolution) -> tuple[Protection, ...]:
    """Return a statement about every effect, in the fixed order."""
    when = timing(solution)
    moving = _moving(solution, when)
    worst = _worst(
        solution,
        moving | {"scale": scale(solution), "refraction": refraction(solution)},
    )
    return ordered(
        (
            *_of_the_order(solution, worst),
            _noise(solution),
            _error_motion(solution),
            _repeatability(solution, int(when.arrivals.min())),
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
            _tangential(solution, int(when.arrivals.min())),
            *gathering.protection(solution.evidence.gathering, solution.angles.std),
        )
    )


def of_the_order(solution: TracerSolution) -> tuple[Protection, Protection]:
    """Return the statements about drift and knock, which depend on the order of measuring."""
    return _of_the_order(solution, _worst(solution, _moving(solution, timing(solution))))


def _moving(solution: TracerSolution, when: LengthTiming) -> dict[str, Floats]:
    """Return the patterns (p, m, n) of what moves while it is measured."""
    reach = float(np.linalg.norm(solution.fit.targets - solution.motion.centre, axis=1).max())
    return {
        "drift": drifts(solution, when),
        "turn": turning(solution, when) / reach,
        "knock": knocks(solution, when),
    }


def _worst(solution: TracerSolution, patterns: dict[str, Floats]) -> dict[str, Worst]:
    """Return the largest error of each kind of pattern that may stay unseen."""
    answer, std = respond(solution, np.concatenate(list(patterns.values()))), solution.angles.std
    ends = np.cumsum([len(pattern) for pattern in patterns.values()])
    part = {
        name: answer.take(slice(end - len(patterns[name]), end))
        for name, end in zip(patterns, ends.tolist(), strict=True)
    }
    return {
        name: found.worst(std, LARGEST_RATIO if name in ("scale", "refraction") else LARGEST_MOVE)
        for name, found in part.items()
    }


def _of_the_order(
    solution: TracerSolution, worst: dict[str, Worst]
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
    moved = slips.size * cumulative.times(slips.shifts.moved.T).T
    std = solution.angles.std
    share = np.abs(moved[:, std > 0.0]) / std[std > 0.0]
    return (slips.protection(share.max(axis=1, initial=0.0)),)


def _moved(effect: Effect, worst: Worst, solution: TracerSolution, what: str) -> Protection:
    """Return the statement about ``what`` moves during the run and is a closure's to find."""
    if worst.error <= HARMLESS:
        return Protection(effect, "harmless", f"{what} moves what cancels in the angle")
    closes = bool(solution.evidence.closures)
    if not worst.seen:
        cure = (
            "the closure does not show it"
            if closes
            else "no position was measured again after a whole turn to show it"
        )
        return Protection(effect, "not protected", f"{what} turns the curve: {cure}")
    tests = "residuals, circle and closure" if closes else "residuals and circle"
    return Protection(effect, "tested", f"{what} shows in {tests} of the stations", worst.error)


def _of_the_air(effect: Effect, what: str, worst: Worst) -> Protection:
    """Return the statement about ``what`` spoils all lengths alike."""
    if worst.error <= HARMLESS:
        return Protection(effect, "harmless", f"{what} moves all stations alike")
    if not worst.seen:
        return Protection(
            effect, "not protected", f"{what} bends the curve and leaves no residual"
        )
    return Protection(
        effect, "tested", f"{what} shows in the residuals before it matters", worst.error
    )


def _noise(solution: TracerSolution) -> Protection:
    """Return the statement about components of the noise that are larger than stated."""
    return Protection(
        "axis noise",
        "tested",
        "the noise of lengths and of the targets' x, y and z is tested apart, and estimated where "
        "the statement does not hold",
        float(np.max(_hidden_noise(solution))),
    )


def _hidden_noise(solution: TracerSolution) -> Floats:
    """Return by component (5,) the error of a larger noise that just is found with POWER.

    The sum of squares q is r / h times chi-squared of h = r^2 / H degrees of freedom; with a noise
    f times as large it grows by (f^2 - 1) H.
    """
    evidence, angles = solution.noise_evidence, solution.angles
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
    # without the error motion: that is looked for
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

    All its lengths are those of a table that turned further: none can show it, and a closing
    measurement bounds only what does not come back with the angle. Where every position is come
    to in each of several ``turns``, a frame of the machine that drifts in step with them displaces
    each station by the same each time: that is the same thing.
    """
    radius = solution.motion.radius
    origin = ", or a machine whose origin drifts in step with each turn of the table,"
    why = (
        "a tracer that mount or cable shift along its circle between the angles"
        f"{origin if turns > 1 else ''} leaves no trace "
        f"in any length: 1 um of it is {MICROMETRE / radius / ARCSEC:.2f} arcsec; the uncertainty "
        f"holds {solution.error_motion.used / MICROMETRE:.2g} um (k = 1), which is believed and "
        "not measured"
    )
    closing = max(returned(solution), key=lambda each: each.within, default=None)
    if closing is None:
        bound = (
            "no angle was measured again, which would bound what of it does not come back with "
            "the angle"
        )
    else:
        bound = (
            f"what of it does not come back with the angle is less than "
            f"{closing.within / MICROMETRE:.2g} um, {closing.within / radius / ARCSEC:.2g} arcsec "
            f"(95 %, positions {closing.first} and {closing.last}, at the same angle)"
        )
    return Protection("tangential motion", "not protected", f"{why}; {bound}")


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
    circle = circle_tested(
        solution.fit.stations, motion, solution.covariance.total, solution.error_motion.used,
        solution.grid.circle_std,
    )  # fmt: skip
    dof = circle.residuals.dof
    if dof == 0:
        return float("inf")
    significance = solution.problem.settings.test_significance
    ratio = float(chi2_isf(significance, dof) / chi2_isf(POWER, dof))
    bearing = bearing_slopes(solution.fit.stations, motion)
    others = np.arange(1, len(angles.std))
    unit = bearing.spread(error_motion_spread(motion, 1.0)).between(np.zeros_like(others), others)
    felt = np.sqrt(unit) / angles.std[1:]
    return float(np.sqrt((ratio - 1.0) * circle.residuals.variance) * felt.max())


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


KNOCKED_AT: Final = (0.25, 0.5, 0.75)
"""Shares of the run after which a knock is tried."""


@dataclass(frozen=True, eq=False)
class LengthTiming:
    """When the lengths were taken: ``share`` (m, n) of the run that had gone, 0 to 1.

    ``arrivals`` (m,): how often the table came to each position.
    """

    share: Floats
    arrivals: Ints


def timing(solution: TracerSolution) -> LengthTiming:
    """Return when the lengths of ``solution`` were taken; see TracerProblem.order."""
    problem, row = solution.problem, solution.grid.row
    first = np.argsort(problem.measuring_order, kind="stable")
    rank = np.empty(len(first))
    rank[first] = np.linspace(0.0, 1.0, len(first))
    at = problem.position[first]
    come = np.append(True, np.diff(at) != 0)
    arrivals = np.bincount(at[come], minlength=len(problem.table_angles))
    return LengthTiming(np.where(row >= 0, rank[row], 0.0), arrivals[solution.positions])


def drifts(solution: TracerSolution, when: LengthTiming) -> Floats:
    """Return the frame of the machine drifting linearly by a metre along x, y, z: (3, m, n)."""
    _, unit = ranges(solution.fit.standing, solution.fit.targets)
    return np.asarray(-when.share * unit.transpose(2, 0, 1), dtype=np.float64)


def turning(solution: TracerSolution, when: LengthTiming) -> Floats:
    """Return the frame of the machine turning about the table's axis by a radian: (1, m, n)."""
    motion, fit = solution.motion, solution.fit
    _, unit = ranges(fit.standing, fit.targets)
    arms = cross_matrix(motion.plane.normal[None])[0] @ (fit.targets - motion.centre).T
    return np.asarray(-when.share * np.einsum("jia,ai->ji", unit, arms), dtype=np.float64)[None]


def knocks(solution: TracerSolution, when: LengthTiming) -> Floats:
    """Return the tracer shifted on the table by a metre: out, along, up; (9, m, n)."""
    motion = solution.motion
    _, unit = ranges(solution.fit.standing, solution.fit.targets)
    basis, station = motion.plane.basis(), solution.grid.station
    out = motion.in_plane / np.linalg.norm(motion.in_plane, axis=1)[:, None]
    along = np.column_stack([-out[:, 1], out[:, 0]])
    up = np.broadcast_to(motion.plane.normal, (len(out), 3))
    shifts = np.stack([out @ basis, along @ basis, up])
    felt = np.einsum("sja,jia->sji", shifts[:, station], unit)
    later: list[Bools] = [when.share >= share for share in KNOCKED_AT]
    return np.concatenate([felt * late for late in later])


def scale(solution: TracerSolution) -> Floats:
    """Return lengths that are too long by their own size: (1, m, n)."""
    return ranges(solution.fit.standing, solution.fit.targets)[0][None]


def refraction(solution: TracerSolution) -> Floats:
    """Return an index of the air that grows by one per metre of height: (1, m, n)."""
    fit = solution.fit
    distance, _ = ranges(fit.standing, fit.targets)
    height = 0.5 * (fit.standing[:, None, 2] + fit.targets[:, 2])
    return np.asarray(distance * (height - height.mean()))[None]
