"""The six-deviations method from problem to result, and its verdict: ok, suspect or failed.

suspect
    a component of the noise is larger than stated (the estimate is used), or chi-squared of the
    lengths is too large all the same (the covariance is then enlarged by it); the distances
    between the places contradict the stated scatter (the estimate is used); more than
    ``max_rejected_share`` of the lengths were rejected; a closure is larger than its uncertainty
    allows; something gathers (:mod:`~..lengths.screening`); the zero of a
    place jumps where no beam broke; the machine or the tracer has moved between the runs or within
    one (:mod:`.scatter`); a position of the plan is missing; or the stated z seems to point into
    the table (:class:`Upward`).
failed
    the noise is beyond the limits of :mod:`~..lengths.verdict`, or more than
    a fifth of the lengths were rejected.

What protects the curves against each effect that could spoil them is said to first order about a
solution: a pattern of errors of the lengths moves the curves, and what the network cannot take up
of it is left in chi-squared. Closures and the tests of movement find some of what chi-squared does
not.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust import gathering
from rotcal_ros.adjust.distributions import noncentrality
from rotcal_ros.adjust.effects import Unseen
from rotcal_ros.adjust.reliability import hidden_noise
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COMPONENTS, HALF_OF_95_PERCENT, ROTATIONS
from rotcal_ros.foundation.protection import POWER, Effect, Protection, ordered
from rotcal_ros.foundation.raw_data import MOST_INFLUENCES, Influence, RawData
from rotcal_ros.foundation.results import Placement, Rejection, Result, Verdict, Zeros
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE
from rotcal_ros.geometry.rotations import cross_matrix
from rotcal_ros.methods.tracer.solver.observability import Numbering
from rotcal_ros.methods.tracer_six.lengths.adjustment import residual_table
from rotcal_ros.methods.tracer_six.lengths.network import less_rigid
from rotcal_ros.methods.tracer_six.lengths.protections import (
    KNOCKED_AT,
    LARGEST_MOVE,
    LARGEST_RATIO,
    MOST_PATTERNS,
    NOTHING,
    noise_protection,
    refracted,
    stated,
    tangential_protection,
)
from rotcal_ros.methods.tracer_six.lengths.reported import (
    Slope,
    WeighedSolution,
    excess_of,
    noticed,
    scatter_along,
    weigh,
)
from rotcal_ros.methods.tracer_six.lengths.screening import (
    WORDS,
    gathering_protection,
    rejection_limit,
)
from rotcal_ros.methods.tracer_six.lengths.verdict import doubt_jump, judged
from rotcal_ros.methods.tracer_six.lengths.zeros import largest_share, zeros_in_time
from rotcal_ros.methods.tracer_six.solver.problem import NetworkTiming, SixProblem, timing
from rotcal_ros.methods.tracer_six.solver.scatter import Kind
from rotcal_ros.methods.tracer_six.solver.solution import PLACE, SixSolution, adjust, respond

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

    Raises ObservabilityError where the places or the lengths cannot determine all six (it names
    the lost direction), DataError for contradictory or implausible data.
    """
    return result_of(adjust(problem))


def result_of(solution: SixSolution) -> Result:
    """Return what is known of a solved problem in the form that all methods share."""
    covariance = {name: solution.covariance_of(name) for name in COMPONENTS}
    numbering = _numbering(solution)
    upward = Upward.of(solution)
    verdict, warnings = upward.judged(*numbering.judged(*judge(solution)))
    problem, grid, fit = solution.problem, solution.grid, solution.fit
    curves = solution.table.curves
    residual = np.full(len(problem.length), np.nan)
    residual[grid.row[grid.row >= 0]] = fit.residual[grid.row >= 0]
    return Result(
        method=METHOD,
        angles=solution.layout.angles,
        deviations=solution.deviations(),
        std={name: np.sqrt(matrix.diagonal()) for name, matrix in covariance.items()},
        covariance=covariance,
        sigma0=solution.evidence.lengths.sigma0,
        dof=fit.dof,
        n_observations=len(problem.length),
        rejected=tuple(Rejection(row, why) for row, why in sorted(solution.rejected.items())),
        verdict=verdict,
        warnings=warnings,
        residuals=residual_table(problem, grid, fit, residual),
        details=_details(solution),
        protections=ordered((*protections(solution), numbering.protection(), upward.protection())),
        raw_data=RawData(influence=influence_of(solution)),
        zeros=Zeros("mean"),
        placement=Placement.upwards(curves.origin, curves.axes[:, 2]),
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
        **_corrections(solution),
        "axis": {"origin": curves.origin, "direction": curves.axes[:, 2]},
        "unknowns": solution.fit.unknowns,
        "rank": solution.fit.rank,
        "covariance_scale": solution.scale,
        "coverage_factor": HALF_OF_95_PERCENT,
        "scatter": _scatter(solution),
        "noise": solution.evidence.noise.details(),
        "slips": None if slips is None else {"size": slips.size, "found": slips.found},
        "length_test": asdict(solution.evidence.lengths),
        "gathering": gathering.details(solution.evidence.gathering, WORDS.elements),
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


def _corrections(solution: SixSolution) -> dict[str, Any]:
    """Return by what the targets were corrected; free ones less a shift and a turn of all."""
    posterior, grid = solution.fit.posterior, solution.grid
    moved = posterior.network.state.targets - grid.targets
    covariance = posterior.targets.reshape(moved.size, moved.size)
    if grid.free:
        moved, std = less_rigid(grid.targets, moved, covariance)
    else:
        std = np.sqrt(covariance.diagonal()).reshape(moved.shape)
    return {"target_corrections": moved, "target_corrections_std": solution.scale * std}


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
    """Return one entry per segment, in the order of time; none where no segments are given.

    ``segment``: its number in the problem; ``place_id``: where the tracer stood; ``zero``,
    ``std``: range at reading zero, m. Behind another segment of the same place also ``step``,
    ``step_std``: the zero less that of the segment before, as the rigid table and all targets
    show it, m; ``probability``: how likely it would be if the zero had stayed.
    """
    problem, layout, grid = solution.problem, solution.layout, solution.grid
    if problem.segment is None:
        return []
    used = grid.row >= 0
    when = np.where(used, timing(problem, grid).whole, np.inf)
    first = 3 * (len(grid.targets) + len(layout.places))
    zeros = slice(first, first + layout.n_zeros)
    covariance = solution.scale**2 * solution.fit.posterior.covariance[zeros, zeros]
    begun = [when[layout.zero == z].min() for z in range(layout.n_zeros)]
    entries = []
    for z in np.argsort(begun, kind="stable").tolist():
        station, target = np.argwhere(used & (layout.zero == z))[0]
        place = int(layout.place[station])
        entry = {
            "segment": int(problem.segment[grid.row[station, target]]),
            "place_id": int(layout.place_ids[place]),
            "lengths": int(grid.used[layout.zero == z].sum()),
        }
        entries.append((entry, place, z, z))
    return zeros_in_time(entries, solution.zeros, covariance)


@dataclass(frozen=True, slots=True)
class Upward:
    """The elevations (rad, above the tracer along +z) of the steepest beams both ways.

    Targets and places typed in a frame whose z points into the table fit every length as well, and
    EZC, EAC and EBC change their signs. No length shows that. But a tracer stands on the table: no
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
            "would show it, for none goes down so steeply, through the table",
        )


def judge(solution: SixSolution) -> tuple[Verdict, tuple[str, ...]]:
    """Return the verdict and its warnings by the rules in this module's docstring."""
    settings = solution.problem.settings
    verdict, warnings = judged(solution.evidence, settings, _doubt_motion(solution))
    return verdict, tuple(map(solution.layout.named, warnings))


def _doubt_motion(solution: SixSolution) -> list[str]:
    doubts = []
    scatter = solution.scatter
    if scatter.estimated and scatter.probability is not None:
        doubts.append(
            "the distances between the places change more than the stated scatter of the table "
            f"allows (p = {scatter.probability:.2g}): {scatter.in_words()}, as "
            f"{scatter.n_contrasts} contrasts show, are used; look for a tracer that slips, or "
            "state a larger scatter"
        )
    for name, found in solution.closures.items():
        unit = "rad" if name in ROTATIONS else "m"
        doubts += [
            f"{name} at positions {c.first} and {c.last}, whole turns apart, differs by "
            f"{c.error:.3g} {unit}, expected 0 with a standard deviation of {c.std:.3g} {unit}: "
            "something moved or drifted during the runs"
            for c in found
            if c.open(solution.problem.settings.test_significance)
        ]
    doubts += [
        doubt_jump(f"place {solution.problem.place[jump.row]}", jump, solution.problem.slip)
        for jump in solution.evidence.jumps
    ]
    doubts += _doubt_moves(solution)
    if solution.missing:
        names = ", ".join(map(str, solution.missing))
        doubts.append(
            f"no deviations for position(s) {names}: fewer than three places have enough lengths"
        )
    return doubts


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


def protections(solution: SixSolution) -> tuple[Protection, ...]:
    """Return a statement about every effect, in the fixed order."""
    when = timing(solution.problem, solution.grid)
    state = solution.network.state
    standing = state.stations(solution.layout)  # without scatter
    distance = np.linalg.norm(standing[:, None] - state.targets, axis=2)
    significance = solution.problem.settings.test_significance
    drift = _worst(solution, _drifts(solution, when), LARGEST_MOVE)
    knock = _worst(solution, _knocks(solution, when), LARGEST_MOVE)
    scale = _worst(solution, distance[None], LARGEST_RATIO)
    air = _worst(solution, refracted(distance, standing, state.targets), LARGEST_RATIO)
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
            noise_protection(hidden_noise(significance, max(solution.fit.dof, 1))),
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
            *gathering_protection(solution.evidence.gathering, _std(solution)),
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
    cure = "; several arrivals at each angle (plan.arrivals) show more"
    return (slips.protection(slips.shifts.moved, _std(solution), cure),)


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
        of=" of ECC",
        beside="what differs from place to place is scatter",
        within=returned(solution),
        shown="angles that were measured again",
        untested="it",
    )


def _moved(solution: SixSolution, effect: Effect, worst: Unseen, what: str) -> Protection:
    """Return the statement about ``what`` moves, which an angle measured again can show."""
    again = solution.moves.test("within runs")
    if again is None:
        shown = f"{what}; no run measured an angle again to show it (plan.closes)"
    else:
        shown = (
            f"{what}; {len(again.places)} of {len(solution.layout.places)} runs came back to an "
            "angle, and are tested for it"
        )
    return _felt(effect, worst, shown)


def _felt(effect: Effect, worst: Unseen, what: str) -> Protection:
    return stated(
        effect,
        worst,
        harmless=f"{what}, by less than a tenth of their uncertainty",
        not_protected=f"{what}, and no test shows it",
        tested=f"{what}; the verdict turns from that size on",
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
    return Protection(
        "repeatability",
        "tested",
        f"stated as {scatter.in_words()} between runs; {contrasts} contrasts between the places "
        "show more of it; left unset, it is estimated",
        hidden_noise(solution.problem.settings.test_significance, contrasts),
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


def _worst(solution: SixSolution, patterns: Floats, largest: float) -> Unseen:
    """Return the worst of ``patterns`` (k, V, n), m per unit, none of them beyond ``largest``."""
    moved, left = _respond(solution, patterns)
    std = np.sqrt(np.einsum("ajaj->aj", solution.covariance))
    share = largest_share(moved.reshape(len(moved), -1), std.ravel())
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
    return Unseen.worst(seen_at, share, largest)


def _respond(solution: SixSolution, patterns: Floats) -> tuple[Floats, Floats]:
    """Return moves of the curves (k, 6, m), and what is left in chi-squared (k,)."""
    felt, k = respond(solution.fit, solution.table.jacobian, patterns), len(patterns)
    ordered = felt.moved.reshape(k, 2, -1, 3).transpose(0, 1, 3, 2).reshape(k, 6, -1)
    return ordered, np.maximum(felt.total - felt.taken, 0.0)


def adjust_at_equal_places(problem: SixProblem, along: Floats) -> WeighedSolution[SixSolution]:
    """Solve a problem with each length as it would be at the mean place of its target.

    ``along`` (k,): how much longer the machine said that each length was, m; believed as far as
    the lengths follow it (:mod:`rotcal_ros.methods.tracer_six.lengths.reported`).
    """

    def moved(weight: float, left: float) -> SixSolution:
        length_std = np.hypot(problem.length_std, left)
        length = problem.length - weight * along
        return adjust(replace(problem, length=length, length_std=length_std))

    if not noticed(along, problem.length_std):
        return WeighedSolution(moved(1.0, 0.0), None)
    scatter = scatter_along(along, problem.target)
    return weigh(adjust(problem), moved, lambda solution: slope_along(solution, along), scatter)


def slope_along(solution: SixSolution, errors: Floats) -> Slope:
    """Return what the residuals of a solution say of ``errors`` (k,), m, row by row."""
    column = solution.grid.placed(errors)
    _, information = _respond(solution, column[None])
    significance = solution.problem.settings.test_significance
    return Slope.of(
        solution.fit,
        solution.grid.weights * column,
        float(information[0]),
        excess_of(solution.evidence.noise, significance),
    )


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
