"""ok, suspect or failed: the rules, and the sentences that say why.

suspect
    a component of the noise is larger than stated (the estimate is used), or chi-squared of the
    lengths is too large all the same (the covariance is then enlarged by it); the distances
    between the places contradict the stated scatter (the estimate is used); more than
    ``max_rejected_share`` of the lengths were rejected; a closure is larger than its uncertainty
    allows; something gathers (:mod:`rotcal_ros.methods.tracer.gathering`); the zero of a place
    jumps where no beam broke; the machine or the tracer has moved
    between the runs or within one (:mod:`.moves`); a position of the plan is missing.
failed
    the noise is beyond the limits of :mod:`rotcal_ros.methods.tracer.verdict`, or more than a
    fifth of the lengths were rejected.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import normal_isf
from rotcal_ros.components import ROTATIONS
from rotcal_ros.methods.tracer.adjustment import MINIMAL_REDUNDANCY
from rotcal_ros.methods.tracer.gathering import doubts as doubt_gathering
from rotcal_ros.methods.tracer.jumps import Jump
from rotcal_ros.methods.tracer.verdict import (
    FAILED_FACTORS,
    FAILED_SHARE,
    doubt_jump,
    doubt_noise,
    doubt_rejected,
    times_stated,
)
from rotcal_ros.methods.tracer_six.layout import renamed
from rotcal_ros.methods.tracer_six.moves import Kind
from rotcal_ros.methods.tracer_six.solution import SixSolution
from rotcal_ros.results import Verdict
from rotcal_ros.units import MICROMETRE

MOVED: Final[dict[Kind, str]] = {
    "between runs": "the machine stands elsewhere in one run than in another: it drifted, or was "
    "knocked",
    "slip": "the tracer slipped on the table",
    "within runs": "angles measured again in the same run contradict the first time: the machine "
    "drifted, or the tracer slipped on the table",
}


def judge(solution: SixSolution) -> tuple[Verdict, tuple[str, ...]]:
    """Return the verdict and its warnings by the rules in this module's docstring."""
    doubts = [*_doubt_noise(solution), *_doubt_gathering(solution), *_doubt_motion(solution)]
    verdict: Verdict = "suspect" if doubts else "ok"
    factors = solution.scale * solution.noise.factors
    share = solution.n_rejected / solution.n_lengths
    if (factors > FAILED_FACTORS).any() or share > FAILED_SHARE:
        verdict = "failed"
    return verdict, (*doubts, *_remarks(solution))


def _doubt_noise(solution: SixSolution) -> list[str]:
    settings = solution.problem.settings
    doubts = doubt_noise(solution.noise, settings)
    if solution.scale > 1.0:
        doubts.append(
            f"the residuals are {solution.scale:.2f} times what their standard deviations allow "
            "(chi-squared test): the uncertainty is enlarged by that factor; look for drift or a "
            "tracer that slips on the table"
        )
    return doubts + doubt_rejected(solution.n_rejected, solution.n_lengths, settings)


def _doubt_gathering(solution: SixSolution) -> list[str]:
    layout = solution.layout
    names = {int(s): layout.station_name(j) for j, s in enumerate(layout.grid.position_ids)}
    found = doubt_gathering(solution.gathering, solution.problem.settings)
    return [renamed(text, names) for text in found]


def _doubt_motion(solution: SixSolution) -> list[str]:
    doubts = []
    scatter = solution.scatter
    if scatter.estimated and scatter.probability is not None:
        doubts.append(
            "the distances between the places change more than the stated scatter of the table "
            f"allows (p = {scatter.probability:.2g}): {scatter.in_words()}, as "
            f"{scatter.n_contrasts} contrasts tell, are used; look for a tracer that slips, or "
            "state a larger scatter"
        )
    limit = normal_isf(0.5 * solution.problem.settings.test_significance)
    for name, found in solution.closures.items():
        unit = "rad" if name in ROTATIONS else "m"
        doubts += [
            f"{name} at positions {c.first} and {c.last}, whole turns apart, differs by "
            f"{c.error:.3g} {unit}, expected 0 with a standard deviation of {c.std:.3g} {unit}: "
            "something moved or drifted during the runs"
            for c in found
            if abs(c.error) > limit * c.std
        ]
    doubts += [
        doubt_jump(f"place {_place_of(solution, jump)}", jump, solution.problem.slip)
        for jump in solution.jumps
    ]
    doubts += _doubt_moves(solution)
    if solution.missing:
        names = ", ".join(map(str, solution.missing))
        doubts.append(
            f"no deviations for position(s) {names}: fewer than three places have enough lengths"
        )
    return doubts


def _place_of(solution: SixSolution, jump: Jump) -> int:
    return int(solution.problem.place[jump.row])


def _doubt_moves(solution: SixSolution) -> list[str]:
    """Return which moves between the runs, or within them, are no chance."""
    doubts = []
    for test in solution.moves.tests:
        if test.probability >= solution.problem.settings.test_significance:
            continue
        worst = int(np.argmax(np.linalg.norm(test.moved, axis=1)))
        place = solution.layout.place_ids[test.places[worst]]
        x, y, z = (test.moved[worst] / MICROMETRE).tolist()
        doubts.append(
            f"{MOVED[test.kind]} (p = {test.probability:.2g}), most at place {place}: about "
            f"({x:.3g}, {y:.3g}, {z:.3g}) um along x, y, z"
        )
    return doubts


def _remarks(solution: SixSolution) -> list[str]:
    noise, settings = solution.noise, solution.problem.settings
    remarks = [
        f"{times_stated(noise, k)}, and so the estimate is used"
        for k in np.flatnonzero(noise.contradicted(settings.noise_significance)).tolist()
        if noise.factors[k] < 1.0 or not noise.contradicted(settings.test_significance)[k]
    ]
    bare = solution.grid.used & (solution.fit.redundancy <= MINIMAL_REDUNDANCY)
    if unchecked := int(bare.sum()):
        remarks.append(
            f"{unchecked} lengths are checked by no other: an error in them stays unseen"
        )
    return remarks
