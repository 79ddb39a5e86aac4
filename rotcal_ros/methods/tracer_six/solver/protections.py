"""What protects six curves against each effect that could spoil them, and how well."""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import chi2_isf
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import HALF_OF_95_PERCENT
from rotcal_ros.foundation.protection import POWER, Effect, Protection, ordered
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.methods.tracer.solver import gathering
from rotcal_ros.methods.tracer.solver.error_response import Worst
from rotcal_ros.methods.tracer_six.solver import error_response
from rotcal_ros.methods.tracer_six.solver.solution import SixSolution
from rotcal_ros.methods.tracer_six.solver.timing import timing

LARGEST_MOVE: Final = 1e-4
"""Drift or knock (m, or rad times the largest reach) that nobody would overlook."""
LARGEST_RATIO: Final = 1e-3
"""Error of the scale, or of the air's index per metre of height, that nobody would overlook."""
HARMLESS: Final = 0.1
"""Error, in standard uncertainties, of what cannot be told from nothing."""


def protections(solution: SixSolution) -> tuple[Protection, ...]:
    """Return a statement about every effect, in the fixed order."""
    when = timing(solution.problem, solution.grid)
    drift = error_response.worst(solution, error_response.drifts(solution, when), LARGEST_MOVE)
    knock = error_response.worst(solution, error_response.knocks(solution, when), LARGEST_MOVE)
    scale = error_response.worst(solution, error_response.scale(solution), LARGEST_RATIO)
    air = error_response.worst(solution, error_response.refraction(solution), LARGEST_RATIO)
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
            _noise(solution),
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
    share = (np.abs(moved) / np.maximum(std, error_response.NOTHING)).max(axis=(1, 2))
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
    """Return the statement about a tracer that moves along its circle between the angles.

    By the same at every place, that is a table that turned further.
    """
    radius = _radius(solution)
    why = (
        "a tracer that mount or cable shift along its circle between the angles, by the same at "
        "every place, leaves no trace in any length: 1 um of it is "
        f"{MICROMETRE / radius / ARCSEC:.2f} arcsec of ECC; what differs from place to place is "
        "scatter"
    )
    within = returned(solution)
    bound = "no angle was measured again, which would bound what of it does not come back with it"
    if within is not None:
        bound = (
            "what of it does not come back with the angle is less than "
            f"{within / MICROMETRE:.2g} um, {within / radius / ARCSEC:.2g} arcsec (95 %, angles "
            "that were measured again)"
        )
    return Protection("tangential motion", "not protected", f"{why}; {bound}")


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
    if worst.error <= HARMLESS:
        return Protection(effect, "harmless", f"{what}, by less than a tenth of their uncertainty")
    if not worst.seen:
        return Protection(effect, "not protected", f"{what}, and no test shows it")
    return Protection(
        effect, "tested", f"{what}; the verdict turns from that size on", worst.error
    )


def _noise(solution: SixSolution) -> Protection:
    """Return the statement about noise larger than stated, by the test of chi-squared."""
    dof = max(solution.fit.dof, 1)
    significance = solution.problem.settings.test_significance
    ratio = float(chi2_isf(significance, dof) / chi2_isf(POWER, dof))
    return Protection(
        "axis noise",
        "tested",
        "the noise of lengths and of the targets' x, y and z is tested apart, and estimated where "
        "the statement does not hold",
        float(np.sqrt(max(ratio - 1.0, 0.0))),
    )


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
    significance = solution.problem.settings.test_significance
    ratio = float(chi2_isf(significance, contrasts) / chi2_isf(POWER, contrasts))
    return Protection(
        "repeatability",
        "tested",
        f"stated as {scatter.in_words()} between runs; {contrasts} contrasts between the places "
        "show more of it; left unset, it is estimated",
        float(np.sqrt(max(ratio - 1.0, 0.0))),
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
