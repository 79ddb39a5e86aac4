"""The six-deviations method from problem to result, and its verdict: ok, suspect or failed.

suspect
    a component of the noise is larger than stated (the estimate is used), or chi-squared of the
    lengths is too large all the same (the covariance is then enlarged by it); the distances
    between the places contradict the stated scatter (the estimate is used); more than
    ``max_rejected_share`` of the lengths were rejected; a closure is larger than its uncertainty
    allows; something gathers (:mod:`rotcal_ros.methods.tracer.solver.gathering`); the zero of a
    place jumps where no beam broke; the machine or the tracer has moved between the runs or within
    one (:mod:`.scatter`); a position of the plan is missing; or the stated z seems to point into
    the table (:class:`Upward`).
failed
    the noise is beyond the limits of :mod:`rotcal_ros.methods.tracer.solver.verdict`, or more than
    a fifth of the lengths were rejected.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust.distributions import normal_isf
from rotcal_ros.foundation.components import COMPONENTS, HALF_OF_95_PERCENT, ROTATIONS
from rotcal_ros.foundation.protection import Protection, ordered
from rotcal_ros.foundation.raw_data import RawData
from rotcal_ros.foundation.results import Rejection, Residuals, Result, Verdict, Zeros
from rotcal_ros.foundation.units import DEGREE, MICROMETRE
from rotcal_ros.methods.tracer.solver.adjustment import MINIMAL_REDUNDANCY
from rotcal_ros.methods.tracer.solver.gathering import details as gathering_details
from rotcal_ros.methods.tracer.solver.gathering import doubts as doubt_gathering
from rotcal_ros.methods.tracer.solver.observability import Numbering
from rotcal_ros.methods.tracer.solver.screening import rejection_limit
from rotcal_ros.methods.tracer.solver.verdict import (
    doubt_jump,
    doubt_noise,
    doubt_rejected,
    remark_noise,
    remark_unchecked,
    verdict_of,
)
from rotcal_ros.methods.tracer.solver.zeros import Jump, step_between
from rotcal_ros.methods.tracer_six.solver.layout import renamed
from rotcal_ros.methods.tracer_six.solver.problem import SixProblem, timing
from rotcal_ros.methods.tracer_six.solver.protections import influence_of, protections
from rotcal_ros.methods.tracer_six.solver.scatter import Kind
from rotcal_ros.methods.tracer_six.solver.solution import SixSolution, adjust

METHOD = "tracer_six"
STEEP: Final = 45.0 * DEGREE
"""No beam goes down so steeply: tracers look past their own foot by 35 degrees or so at most."""
MOVED: Final[dict[Kind, str]] = {
    "between runs": "the machine stands elsewhere in one run than in another: it drifted, or was "
    "knocked",
    "slip": "the tracer slipped on the table",
    "within runs": "angles measured again in the same run contradict the first time: the machine "
    "drifted, or the tracer slipped on the table",
}


def solve(problem: SixProblem) -> Result:
    """Return EXC, EYC, EZC (m), EAC, EBC, ECC (rad) of the table at the commanded angles.

    Actual - commanded, of the point of the axis at the machine's z = 0, in a frame along the axis
    with x towards the machine's x. Each curve has zero mean; EXC, EYC and EAC, EBC have no part
    that turns with the table, for that is how the axis itself is defined. Standard deviations
    come from the lengths, the targets' prior and the scatter of the table from run to run;
    positions whose places leave a direction open are absent. The order of the rows does not
    change a bit of the result.

    Raises ObservabilityError where the places or the lengths cannot tell all six (it names the
    lost direction), DataError for contradictory or implausible data.
    """
    return result_of(adjust(problem))


def result_of(solution: SixSolution) -> Result:
    """Return what is known of a solved problem in the form that all methods share."""
    covariance = {name: solution.covariance_of(name) for name in COMPONENTS}
    numbering = _numbering(solution)
    upward = Upward.of(solution)
    verdict, warnings = upward.judged(*numbering.judged(*judge(solution)))
    return Result(
        method=METHOD,
        angles=solution.layout.angles,
        deviations=solution.deviations(),
        std={name: np.sqrt(matrix.diagonal()) for name, matrix in covariance.items()},
        covariance=covariance,
        sigma0=solution.lengths.sigma0,
        dof=solution.fit.dof,
        n_observations=len(solution.problem.length),
        rejected=tuple(Rejection(row, why) for row, why in sorted(solution.rejected.items())),
        verdict=verdict,
        warnings=warnings,
        residuals=_residuals(solution),
        details=_details(solution),
        protections=ordered((*protections(solution), numbering.protection(), upward.protection())),
        raw_data=RawData(influence=influence_of(solution)),
        zeros=Zeros("mean"),
    )


def _numbering(solution: SixSolution) -> Numbering:
    """Return how the places found stand round the axis to those that the plan states."""
    found = solution.places[:, :2] @ (1.0, 1j)
    stated = solution.problem.places[solution.layout.place_ids, :2] @ (1.0, 1j)
    return Numbering.of(
        "the plan (places, azimuth_deg)",
        solution.layout.angles,
        float(np.abs(found).mean()),
        float(np.angle(np.vdot(stated, found))),
        solution.problem.place_tolerance,
    )


def _residuals(solution: SixSolution) -> Residuals:
    """Return one row per length; NaN where the position or target was dropped altogether."""
    problem, grid, fit = solution.problem, solution.grid, solution.fit
    k = len(problem.length)
    residual, std = np.full(k, np.nan), problem.length_std.copy()
    redundancy, test_value = np.zeros(k), np.zeros(k)
    used = np.zeros(k, dtype=np.bool_)
    there = grid.row >= 0
    row = grid.row[there]
    residual[row], std[row] = fit.residual[there], fit.std[there]
    used[row] = grid.used[there]
    checked = there & grid.used
    row = grid.row[checked]
    redundancy[row], test_value[row] = fit.redundancy[checked], fit.test_value[checked]
    return Residuals(
        table_position=problem.position,
        target=problem.target,
        residual=residual,
        redundancy=redundancy,
        test_value=test_value,
        used=used,
        std=std,
    )


def _details(solution: SixSolution) -> dict[str, Any]:
    """Return the method's own part of the result, SI.

    ``places`` (p, 3) in the frame that turns with the table, z along the axis; ``place_ids`` are
    the problem's; ``axis``: where the axis meets the machine's z = 0, and its direction.
    ``slips``: size of a fringe, m, and how probably one at any moment is found.
    """
    problem, network, curves = solution.problem, solution.network, solution.table.curves
    slips = solution.slips
    return {
        "datum": problem.datum,
        "zero": problem.zero,
        "position_ids": solution.positions,
        "place_ids": solution.layout.place_ids,
        "places": solution.places,
        "zeros": solution.zeros,
        "segments": segment_report(solution),
        "target_ids": solution.grid.target_ids,
        "targets": network.state.targets,
        "axis": {"origin": curves.origin, "direction": curves.axes[:, 2]},
        "unknowns": solution.fit.unknowns,
        "rank": solution.fit.rank,
        "covariance_scale": solution.scale,
        "coverage_factor": HALF_OF_95_PERCENT,
        "scatter": _scatter(solution),
        "noise": solution.noise.details(),
        "slips": None if slips is None else {"size": slips.size, "found": slips.found},
        "length_test": asdict(solution.lengths),
        "gathering": gathering_details(solution.gathering),
        "rejection_limit": rejection_limit(solution.grid, problem.settings.rejection_significance),
        "closure": {
            name: [asdict(closure) for closure in found]
            for name, found in solution.closures.items()
            if found
        },
        "moves": [
            {
                "kind": test.kind,
                "place_ids": solution.layout.place_ids[test.places].tolist(),
                "moved": test.moved.tolist(),
                "p_value": test.probability,
            }
            for test in solution.moves.tests
        ],
    }


def _scatter(solution: SixSolution) -> dict[str, Any]:
    scatter = solution.scatter
    return {
        "translation": scatter.translation,
        "rotation": scatter.rotation,
        "estimated": scatter.estimated,
        "n_contrasts": scatter.n_contrasts,
        "p_value": scatter.probability,
    }


def segment_report(solution: SixSolution) -> list[dict[str, Any]]:
    """Return one entry per segment, in the order of time; none where no segments are told.

    ``segment``: its number in the problem; ``place_id``: where the tracer stood; ``zero``,
    ``std``: range at reading zero, m. Behind another segment of the same place also ``step``,
    ``step_std``: the zero less that of the segment before, as the rigid table and all targets
    tell it, m; ``probability``: how likely it would be if the zero had stayed.
    """
    problem, layout, grid = solution.problem, solution.layout, solution.grid
    if problem.segment is None:
        return []
    used = grid.row >= 0
    when = np.where(used, timing(problem, grid).whole, np.inf)
    first = 3 * (len(grid.targets) + len(layout.places))
    zeros = slice(first, first + layout.n_zeros)
    covariance = solution.scale**2 * solution.fit.posterior.covariance[zeros, zeros]
    value = solution.zeros
    begun = [when[layout.zero == z].min() for z in range(layout.n_zeros)]
    found: list[dict[str, Any]] = []
    before: dict[int, int] = {}
    for z in np.argsort(begun, kind="stable").tolist():
        station, target = np.argwhere(used & (layout.zero == z))[0]
        place = int(layout.place[station])
        entry = {
            "segment": int(problem.segment[grid.row[station, target]]),
            "place_id": int(layout.place_ids[place]),
            "lengths": int(grid.used[layout.zero == z].sum()),
            "zero": float(value[z]),
            "std": float(np.sqrt(covariance[z, z])),
        }
        if place in before:
            entry |= step_between(value, covariance, before[place], z)
        found.append(entry)
        before[place] = z
    return found


@dataclass(frozen=True, slots=True)
class Upward:
    """The elevations (rad, above the tracer along +z) of the steepest beams both ways.

    Targets and places typed in a frame whose z points into the table fit every length as well, and
    EZC, EAC and EBC change their signs. No length tells that. But a tracer stands on the table: no
    beam goes through it.
    """

    lowest: float
    highest: float

    @classmethod
    def of(cls, solution: SixSolution) -> Upward:
        """Return that of all lengths that were used, in the stated frame."""
        state = solution.network.state
        beam = state.targets - state.stations(solution.layout)[:, None]
        rises = (beam[..., 2] / np.linalg.norm(beam, axis=2))[solution.grid.used]
        return cls(float(np.arcsin(rises.min())), float(np.arcsin(rises.max())))

    def judged(
        self, verdict: Verdict, warnings: tuple[str, ...]
    ) -> tuple[Verdict, tuple[str, ...]]:
        """Return ``verdict`` and ``warnings``; a frame that stands on its head is not ok."""
        if self.lowest > -STEEP or self.highest > STEEP:
            return verdict, warnings
        warning = (
            f"beams go down by {-self.lowest / DEGREE:.0f} degrees, through the table, and none "
            "goes up as steeply: the z axis of targets and places seems to point into the table, "
            "and then EZC, EAC and EBC have the wrong sign"
        )
        return "suspect" if verdict == "ok" else verdict, (*warnings, warning)

    def protection(self) -> Protection:
        """Return whether targets and places that are both mirrored in z would be found."""
        unseen = (
            "targets and places whose z axis points into the table fit every length as well and "
            "turn the signs of EZC, EAC and EBC"
        )
        if self.highest > STEEP and self.lowest > -STEEP:
            return Protection(
                "sign of z",
                "tested",
                f"{unseen}, but beams that go up by {self.highest / DEGREE:.0f} degrees would go "
                "down as steeply, through the table",
            )
        return Protection(
            "sign of z",
            "not protected",
            f"{unseen}; no beam goes up by {STEEP / DEGREE:.0f} degrees or more alone, which "
            "would tell, for none goes down so steeply, through the table",
        )


def judge(solution: SixSolution) -> tuple[Verdict, tuple[str, ...]]:
    """Return the verdict and its warnings by the rules in this module's docstring."""
    doubts = [*_doubt_noise(solution), *_doubt_gathering(solution), *_doubt_motion(solution)]
    factors = solution.scale * solution.noise.factors
    verdict = verdict_of(doubts, factors, solution.n_rejected / solution.n_lengths)
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
    bare = solution.grid.used & (solution.fit.redundancy <= MINIMAL_REDUNDANCY)
    remarks = remark_noise(solution.noise, solution.problem.settings)
    return remarks + remark_unchecked(int(bare.sum()))
