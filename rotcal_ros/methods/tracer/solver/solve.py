"""The tracer method from problem to result."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust.closures import Closure, closures
from rotcal_ros.adjust.distributions import chi2_sf, noise_growth
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.compact import Covariances, difference_variance, variances_of
from rotcal_ros.foundation.components import HALF_OF_95_PERCENT
from rotcal_ros.foundation.language import Phrase, noted, phrase
from rotcal_ros.foundation.protection import POWER, Protection
from rotcal_ros.foundation.raw_data import RawData
from rotcal_ros.foundation.results import (
    ErrorMotion,
    Placement,
    Result,
    Zeros,
)
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.methods.tracer.solver.carried_lengths import LATER_RUN
from rotcal_ros.methods.tracer.solver.circle import TableMotion, algorithm_error, printed_scatter
from rotcal_ros.methods.tracer.solver.observability import (
    Numbering,
    rotation_about_z_between,
    weakest_direction,
)
from rotcal_ros.methods.tracer.solver.posed import (
    ALONG_AXIS,
    ERROR_MOTION,
    STATED_CIRCLE,
)
from rotcal_ros.methods.tracer.solver.problem import FREE_TARGET_MINIMUM, TracerProblem
from rotcal_ros.methods.tracer.solver.reporting import (
    expand_to_all_rows,
    segment_details,
    tangential_protection,
    target_corrections,
)
from rotcal_ros.methods.tracer.solver.solution import TracerSolution, adjust

CIRCLE_SHOWS: Final = noted(
    "{0:.2g} m from {1} residuals of the circle, which show its radial part; the tangential part "
    "is taken to be as large"
)
LIKE_THE_TABLE: Final = noted(
    ", or a machine whose origin drifts in step with each turn of the table,"
)
AS_FRINGES: Final = noted("as much as {0:+d} fringe(s), a counter that slipped")
LEAVE_THE_CIRCLE: Final = noted(
    "the stations leave their circle by {0:.3g} m (rms): the table's radial error motion is "
    "larger than the stated {1:.2g} m; {2:.2g} m, from {3} residuals of the circle, is used in "
    "its place"
)
JOINED: Final = noted(
    "run {0} was joined by {1} steps measured again: its lengths were {2:+.3g} m off (standard "
    "deviation {3:.2g} m); the steps agree within {4:.2g} m, {5:.2f} times what is expected"
)
TARGETS_LEFT_OUT: Final = noted(
    "target(s) {0} of the free network were left out: fewer than {1} lengths reach them"
)
NO_DEVIATION: Final = noted("no deviation for station(s) {0}: too few usable lengths")
IN_ONE_PLANE: Final = noted(
    "all targets lie in one plane, so the tracer could stand on either side of it: the lower "
    "side was taken; give start_stations to choose the other"
)

METHOD = "tracer_multistation"
MOST_FRINGES: Final = 3
"""Fringes that a counter slips at once; what is more is a beam that was broken."""
AGREES: Final = 2.58
"""Standard deviations by which the size of a slip may miss a whole number of fringes; 99 %."""


def solve(problem: TracerProblem) -> Result:
    """Return the angular positioning deviations ECC of the table at the commanded angles.

    ``deviations["ECC"]`` (radians, actual - commanded) are *cumulative*, counted from the first
    angle with usable lengths, where deviation and standard deviation are zero;
    ``adjacent_deviations`` are those of the steps between neighbouring angles (the paper's
    Table 3). Standard deviations are for a normal distribution. Angles whose station has too few
    lengths are absent from the result.
    Method: Laser tracer multi-station paper, Eq. 1-36. The order of the rows of ``problem`` does
    not change a bit of the result.

    Raises ObservabilityError when the geometry cannot determine the angle (it names the weak
    direction or both sides of Eq. 2), DataError for contradictory or implausible data.
    """
    return result_of(adjust(problem))


def result_of(solution: TracerSolution) -> Result:
    """Return what is known of a solved problem in the form that all methods share."""
    found, motion, angles = solution.found, solution.motion, solution.table_angles
    problem, lengths, absent = solution.problem, solution.posed.lengths, solution.posed.absent
    spread = solution.spread
    closing: tuple[Closure, ...] = ()
    if not problem.repeated_runs:
        closing = closures(angles, solution.deviations, spread, solution.positions)
    doubts, numbering = tuple(_doubts(solution)), _numbering(solution)
    plain = found.result(
        METHOD,
        angles,
        {"ECC": slice(None)},
        (lengths.position, lengths.target),
        doubts=doubts,
        protections=(*_protections(solution), numbering.protection()),
        details=_details(solution, closing),
        joint=True,
        further=False,
    )
    warnings = (*found.doubts, *doubts, *_remarks(solution))
    verdict, warnings = numbering.judged(plain.verdict, warnings)
    assert plain.residuals is not None
    residuals = replace(plain.residuals, residual=_residuals(solution))
    if problem.run is not None:
        plain = replace(plain, raw_data=RawData())
    steps = np.arange(len(angles) - 1)
    every = expand_to_all_rows(
        replace(plain, residuals=residuals), problem, lengths, absent.repeated | absent.unfit
    )
    return replace(
        every,
        std={"ECC": solution.std},
        covariance=Covariances({"ECC": spread}),
        verdict=verdict,
        warnings=warnings,
        adjacent_deviations=np.diff(solution.deviations),
        adjacent_std=np.sqrt(difference_variance(spread, steps, steps + 1)),
        zeros=Zeros("first angle"),
        budget=_budget(solution),
        placement=Placement.upwards(
            motion.centre, motion.plane.normal, solution.positions, solution.stations
        ),
        error_motion=solution.error_motion,
    )


def _numbering(solution: TracerSolution) -> Numbering:
    """Return how the stations stand to the start values that a plan or a person has stated."""
    stated, stations = solution.problem.start_stations, solution.stations
    bearing = (
        None if stated is None else rotation_about_z_between(stations, stated[solution.positions])
    )
    return Numbering.of("plan.tracer_m", solution.table_angles, solution.motion.radius, bearing)


def _residuals(solution: TracerSolution) -> Floats:
    """Return the residuals (k,) of the lengths, m, of the stations that a result has."""
    fit, lengths, state = solution.found.fit, solution.posed.lengths, solution.printed
    k = len(lengths.row)
    if state is None:
        return fit.residual[:k]
    apart = state[lengths.position, :3] - solution.grid.targets[lengths.target]
    computed = np.linalg.norm(apart, axis=1) - state[lengths.position, 3]
    return np.asarray(fit.model.observed[:k] - computed)


def _budget(solution: TracerSolution) -> dict[str, Floats]:
    """Return standard uncertainties (m,) of ECC by source; they add in squares.

    What is not known of the size of a source is shared out among them.
    """
    found, model, m = solution.found, solution.found.model, len(solution.std)
    sources = {"the lengths": "lengths", ERROR_MOTION: "error_motion"}
    sources |= dict.fromkeys((STATED_CIRCLE, ALONG_AXIS), "circle")
    budget = dict[str, Floats]()
    for name, each in zip(model.components, found.fit.variance_by_component[:m].T, strict=True):
        source = sources.get(name, "targets")
        budget[source] = budget.get(source, 0.0) + found.scale**2 * each
    if "circle" in budget:  # at the end is what a stated circle does not bind
        along = found.fit.response_of(np.arange(model.size[0] - m, model.size[0]))[:m]
        budget["error_motion"] = found.scale**2 * (along**2).sum(axis=1)
        budget["circle"] = budget["circle"] - budget["error_motion"]
    gathered = found.diagnosis.gathering.covariance()
    beside = np.zeros(m) if gathered is None else variances_of(gathered)[:m]
    possible = [(moved[:m] ** 2).sum(axis=1) for moved in found.diagnosis.possible()]
    beside = np.sum([beside, *possible], axis=0)
    whole = sum(budget.values(), np.zeros(m))
    larger = np.where(whole > 0.0, (found.std**2 - beside) / np.where(whole > 0.0, whole, 1.0), 0)
    budget = {source: each * larger for source, each in budget.items()}
    if solution.slips is not None:
        budget["slips"] = solution.slips.variances
    if beside.any():
        budget["gathered"] = beside
    return {name: np.sqrt(np.maximum(each, 0.0)) for name, each in budget.items()}


def _doubts(solution: TracerSolution) -> Iterator[Phrase]:
    """Yield what the method doubts beside the engine."""
    for effect in solution.found.found_effects:
        if effect.effect.effect == "slip":
            yield _cause(float(effect.sizes[0]), float(effect.std[0]), solution.problem.slip)
    motion = solution.error_motion
    if solution.contradicted is not None:
        rms = float(np.sqrt(np.mean(solution.motion.radial**2)))
        yield phrase(LEAVE_THE_CIRCLE, rms, motion.stated, motion.used, motion.dof)
    missing = solution.problem.missing(solution.positions)
    if missing:
        names = ", ".join(str(j) for j in missing)
        yield phrase(NO_DEVIATION, names)


def _cause(size: float, std: float, fringe: float) -> Phrase:
    """Return what may have made a zero jump by ``size`` +- ``std``, m."""
    number = round(size / fringe) if fringe else 0
    if 0 < abs(number) <= MOST_FRINGES and abs(size - number * fringe) <= AGREES * std:
        cause = phrase(AS_FRINGES, number)
    else:
        cause = phrase("a beam that was broken, or a tracer that was knocked")
    return phrase(
        "the zero of the lengths jumps by {0:+.3g} m (standard deviation {1:.2g} m), "
        "although no break was reported: {2}; it was split there", size, std, cause
    )  # fmt: skip


def _remarks(solution: TracerSolution) -> Iterator[Phrase]:
    """Yield what is to be known, and no reason to doubt."""
    spare = sorted({int(solution.problem.target[row]) for row in solution.posed.absent.spare})
    if spare:
        names = ", ".join(str(i) for i in spare)
        yield phrase(TARGETS_LEFT_OUT, names, FREE_TARGET_MINIMUM)
    if solution.posed.ambiguous:
        yield phrase(IN_ONE_PLANE)
    for run, offset, std, steps, apart, sigma0, _ in map(dict.values, _joins(solution)):
        yield phrase(JOINED, run, steps, offset, std, apart, sigma0)
    if solution.reported is not None and solution.reported.warning:
        yield solution.reported.warning
    yield from solution.turns.remarks(solution.problem.lag, solution.motion.radius)


def _joins(solution: TracerSolution) -> list[dict[str, Any]]:
    """Return how the later runs were joined.

    The zero of a ``run`` against the first: ``offset``, m, with the standard deviation ``std``.
    ``disagreement``: the largest residual of its ``steps`` measured again, m; ``sigma0`` and
    ``probability``: test that nothing but the zero has changed.
    """
    problem, lengths, fit = solution.problem, solution.lengths, solution.found.fit
    if problem.run is None or LATER_RUN not in lengths.blocks:
        return []
    begin, found, used = lengths.first[LATER_RUN], [], fit.used[: len(lengths.row)]
    for k, run in enumerate(np.unique(problem.run)[1:].tolist()):
        unit = np.eye(1, len(fit.x), begin + k).T
        variance = float(fit.kernel.times(unit)[begin + k, 0])
        again = (lengths.later == k) & (problem.earlier[lengths.row] > 0)
        rows = np.flatnonzero(again & used)
        values, ways = np.linalg.eigh(np.eye(len(rows)) - fit.kernel.hat_block(rows))
        seen = values > 1e-6
        squares = float(((ways.T @ fit.white[rows])[seen] ** 2 / values[seen]).sum())
        dof = int(seen.sum())
        found.append(
            {
                "run": run,
                "offset": -float(fit.x[begin + k]),
                "std": solution.found.scale * float(np.sqrt(variance)),
                "steps": len(rows),
                "disagreement": float(np.abs(fit.residual[rows]).max(initial=0.0)),
                "sigma0": float(np.sqrt(squares / dof)) if dof else 0.0,
                "probability": chi2_sf(squares, dof) if dof else 1.0,
            }
        )
    return found


def _details(solution: TracerSolution, closing: tuple[Closure, ...]) -> dict[str, Any]:
    """Return the method's own part of the result.

    ``station_ids`` (m,), which are table positions, and ``target_ids`` (n,) are the problem's
    indices of ``stations`` (m, 3) and ``targets`` (n, 3), all other arrays follow them.
    ``distances``: range at reading zero. ``radial``, ``axial``: distances of the stations from
    circle and plane. ``algorithm_error``: Eq. 36 at the commanded steps, ``scatter``: Eq. 34.
    ``returned``: positions at the same angle, and by less than what (m, 95 %) their stations lie
    apart along the circle.
    """
    problem, found, fit = solution.problem, solution.found, solution.found.fit
    lengths, grid = solution.posed.lengths, solution.grid
    k, m = len(lengths.row), len(solution.positions)
    blocks = solution.station_blocks
    weak, std, direction = weakest_direction(blocks)
    redundancy = np.bincount(lengths.position, fit.redundancy[:k], m)
    squares = np.bincount(lengths.position, fit.white[:k] ** 2, m)
    return {
        "variant": problem.variant,
        "datum": problem.datum if problem.variant == "joint" else "targets",
        "station_ids": solution.positions,
        "stations": solution.stations,
        "station_std": np.sqrt(np.diagonal(blocks, axis1=1, axis2=2)),
        "station_covariance": blocks,
        "distances": solution.distances[
            (grid.station if grid.zero is None else grid.zero)[grid.first_strip]
        ],
        "target_ids": grid.target_ids,
        "targets": solution.targets,
        **({} if solution.printed is not None else target_corrections(found, solution.lengths)),
        "unknowns": found.model.size[1],
        "rank": fit.kernel.rank,
        "weakest": {"station": int(solution.positions[weak]), "direction": direction, "std": std},
        **circle_details(solution.motion, solution.stations, solution.table_angles),
        "coverage_factor": HALF_OF_95_PERCENT,
        "redundancy_per_station": redundancy,
        "sigma0_per_station": np.sqrt(squares / np.maximum(redundancy, 1e-9)),
        **found.details(further=False),
        **_zeros(solution),
        "closure": [asdict(closure) for closure in closing],
        "returned": _returned(solution),
        **({} if solution.reported is None else {"reported_places": asdict(solution.reported)}),
        **({} if problem.run is None else {"joins": _joins(solution)}),
        **solution.turns.details(),
    }


def circle_details(motion: TableMotion, stations: Floats, angles: Floats) -> dict[str, Any]:
    """Return what ``stations`` (m, 3), m, at table ``angles`` (m,), rad, show of their circle."""
    return {
        "plane": {"normal": motion.plane.normal, "offset": motion.plane.offset},
        "circle": {"centre": motion.centre, "radius": motion.radius},
        "radial": motion.radial,
        "axial": motion.plane.distances(stations),
        "tilt": motion.tilt,
        "algorithm_error": algorithm_error(np.diff(angles), motion.tilt),
        "scatter": printed_scatter(motion.adjacent),
    }


def _zeros(solution: TracerSolution) -> dict[str, Any]:
    """Return the zeros of segments, their walk per length that was used, m, and slips."""
    if solution.problem.segment is None:
        return {}
    slips = solution.slips
    return {
        "segments": segment_details(solution.found, solution.lengths, solution.grid),
        "zero_walk_std": solution.supposed.walk,
        "slips": None if slips is None else {"size": slips.size, "found": slips.found},
    }


def _returned(solution: TracerSolution) -> list[dict[str, Any]]:
    """Return how nearly the tracer came back to its circle after whole turns of the table.

    Table positions ``first`` and ``last`` stand at the same angle; along the circle their stations
    lie apart by less than ``within`` (m), with 95 %.
    """
    spread = solution.spread
    # without the error motion: that is searched for
    budget = 2.0 * (solution.error_motion.used / solution.motion.radius) ** 2
    found = []
    for c in closures(solution.table_angles, solution.deviations, spread, solution.positions):
        std = float(np.sqrt(max(c.std**2 - budget, 0.0)))
        within = solution.motion.radius * (abs(c.error) + HALF_OF_95_PERCENT * std)
        found.append({"first": c.first, "last": c.last, "within": within})
    return found


def _protections(solution: TracerSolution) -> Iterator[Protection]:
    """Yield the statements that the engine cannot make."""
    motion, arrivals = solution.error_motion, _arrivals(solution)
    yield _error_motion(solution)
    yield from solution.turns.protections()
    hidden = None if motion.estimated else _hidden_motion(solution)
    yield Protection(
        "tilt", "estimated" if motion.estimated else "tested",
        phrase("the table's tilts shift the tracer by its height, as part of the error motion"),
        hidden,
    )  # fmt: skip
    yield Protection(
        "gauge",
        "harmless",
        phrase(
            "no gauge is carried: the angle is counted on the circle of the stations, in its own "
            "plane, whatever its radius and lean"
        ),
    )
    yield _repeatability(solution, arrivals)
    if solution.slips is not None:
        yield solution.slips.protection()
    nearest = max(_returned(solution), key=lambda each: each["within"], default=None)
    drift = phrase(LIKE_THE_TABLE)
    yield tangential_protection(
        solution.motion.radius,
        alike=drift if arrivals > 1 else "",
        beside=phrase(
            "the uncertainty holds {0:.2g} um (k = 1), which is believed and not measured",
            motion.used / MICROMETRE,
        ),
        within=None if nearest is None else nearest["within"],
        shown=""
        if nearest is None
        else phrase("positions {0} and {1}, at the same angle", nearest["first"], nearest["last"]),
        untested=phrase("the angle"),
    )


def _error_motion(solution: TracerSolution) -> Protection:
    motion: ErrorMotion = solution.error_motion
    if motion.estimated:
        return Protection(
            "error motion",
            "estimated",
            phrase(CIRCLE_SHOWS, motion.used, motion.dof),
        )
    return Protection(
        "error motion",
        "tested",
        phrase(
            "stated as {0:.2g} m; the circle of the stations shows the radial part of "
            "more; left unset, it would be estimated",
            motion.stated,
        ),
        _hidden_motion(solution),
    )


def _hidden_motion(solution: TracerSolution) -> float:
    """Return the error of an unstated error motion that the circle just shows with POWER.

    A radial shift that is observed to be zero with redundancy r scatters by its standard
    deviation over the root of r.
    """
    found, m = solution.found, len(solution.std)
    name = STATED_CIRCLE if solution.problem.circle_std else ERROR_MOTION
    rows = found.model.of_component == found.model.components.index(name)
    checked = float(found.fit.redundancy[rows].sum())
    if m <= 3 or checked < 1e-3:
        return float("inf")
    growth = noise_growth(found.diagnosis.limits.significance, POWER, m - 3)
    variance = float((found.fit.std[rows] ** 2).mean()) * (m - 3) / checked
    shift = np.sqrt((growth - 1.0) * variance * 2.0) / solution.motion.radius
    return float(shift / solution.std[solution.std > 0.0].min())


def _repeatability(solution: TracerSolution, arrivals: int) -> Protection:
    if solution.problem.repeated_runs:
        why = phrase("every position is reached in several runs")
        return Protection("repeatability", "estimated", why)
    if arrivals < 2:
        return Protection(
            "repeatability",
            "not protected",
            phrase(
                "each position is reached once: the table's scatter between arrivals is "
                "in the curve, not in the uncertainty"
            ),
        )
    noise = next(p.error for p in solution.found.protections() if p.effect == "axis noise")
    return Protection(
        "repeatability",
        "tested",
        phrase(
            "the table arrives {0} times or more at each position: what it does not "
            "repeat joins the scatter of the lengths",
            arrivals,
        ),
        noise,
    )


def _arrivals(solution: TracerSolution) -> int:
    """Return how often the table visited the position that it visited least."""
    problem = solution.problem
    at: Ints = problem.position[np.argsort(problem.measuring_order, kind="stable")]
    come = np.append(True, np.diff(at) != 0)
    arrivals = np.bincount(at[come], minlength=len(problem.table_angles))
    return int(arrivals[solution.positions].min())
