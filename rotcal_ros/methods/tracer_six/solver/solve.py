"""The six-deviations method from problem to result: the model, and what only it can say.

Noise, outliers, moves, slips, scatter of arrivals, closures and verdict are the engine's
(docs/engine.md). Here are the set-up's own doubts: places that are numbered off, a z that points
into the table, positions without a result.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust.diagnosis import Limits
from rotcal_ros.adjust.distributions import chi2_sf
from rotcal_ros.adjust.engine import Adjusted
from rotcal_ros.adjust.engine import adjust as adjusted
from rotcal_ros.adjust.fit import fitted
from rotcal_ros.adjust.model import CurveModel
from rotcal_ros.adjust.observable import observable_by
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS, HALF_OF_95_PERCENT, unit_of
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.foundation.protection import Protection
from rotcal_ros.foundation.raw_data import RawData
from rotcal_ros.foundation.results import Placement, Rejection, Residuals, Result, Verdict
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.geometry.rotations import rotation_about_z, rotation_from_vector
from rotcal_ros.methods.tracer.solver.observability import (
    Numbering,
    or_prior,
    told_of_a_turned_sign,
)
from rotcal_ros.methods.tracer.solver.reported import (
    Slope,
    WeighedSolution,
    noticed,
    scatter_along,
    weigh,
)
from rotcal_ros.methods.tracer.solver.solve import tangential_protection
from rotcal_ros.methods.tracer_six.solver.curves import Curves, table_curves
from rotcal_ros.methods.tracer_six.solver.model import SixLengths, model_of
from rotcal_ros.methods.tracer_six.solver.problem import SixProblem, StationLayout, lay_out
from rotcal_ros.methods.tracer_six.solver.start import find_start

METHOD = "tracer_six"
STEEP: Final = 45.0 * DEGREE
"""No beam goes down so steeply: tracers look past their own foot by 35 degrees or so at most."""
FITTING: Final = 3.0
"""Times the stated noise up to which lengths of the opposite sign are said to fit."""
CURE: Final = (
    "measure more targets, spread low around the table, from places 120 degrees apart, or keep "
    "the beam unbroken (fewer zeros)"
)


@dataclass(frozen=True, eq=False)
class SixSolution:
    """A solved problem: the ``lengths`` in its ``layout``, and what the engine ``found``.

    ``absent``: why rows have no place in it.
    """

    problem: SixProblem
    layout: StationLayout
    lengths: SixLengths
    found: Adjusted
    absent: dict[int, str]

    def part(self, block: str) -> Floats:
        """Return the solved unknowns of a block; of poses and points (k, 3)."""
        return self.lengths.part(self.found.fit.x, block)

    @cached_property
    def curves(self) -> Curves:
        """The curves and frames of the solved poses."""
        lengths = self.lengths
        turned = rotation_from_vector(self.part("turn"))
        rotation = lengths.axes @ turned @ rotation_about_z(self.layout.angles)
        translation = lengths.origin + self.part("shift") @ lengths.axes.T
        return table_curves(rotation, translation, self.layout.angles)

    @property
    def places(self) -> Floats:
        """The places (p, 3), m, in the frame that turns with the table, z along the axis."""
        moved = self.lengths.places + self.part("place")
        return np.asarray((moved - self.curves.table_origin) @ self.curves.table_turn)

    @property
    def targets(self) -> Floats:
        """The targets (n, 3), m."""
        return np.asarray(self.lengths.targets + self.part("target"))

    @property
    def zeros(self) -> Floats:
        """The zeros (s,) of the counter as the lengths of the problem have them, m."""
        return np.asarray(self.lengths.zeros + self.part("zero") + self.layout.offset)

    @property
    def positions(self) -> Ints:
        """The table positions (m,) that have a result."""
        return self.layout.position_ids

    def deviations(self) -> Floats:
        """Return the six curves (6, m), m and rad."""
        return np.concatenate([self.curves.translation.T, self.curves.rotation.T])

    def covariance_among(self, block: str) -> Floats:
        """Return the covariance of a block's unknowns, or of the points that they move, m^2."""
        rows = self.lengths.picked(block).toarray()
        if block == "target" and self.lengths.target_ways is not None:
            rows = self.lengths.target_ways @ rows
        rows = np.pad(rows, ((0, 0), (0, len(self.found.fit.x) - rows.shape[1])))
        return np.asarray(self.found.scale**2 * rows @ self.found.fit.kernel.times(rows.T))

    @property
    def trials(self) -> SixTrials:
        """Draws measurements like the given one."""
        return SixTrials(self)


@dataclass(frozen=True, eq=False)
class SixTrials:
    """Draws the curves of measurements like that of a ``solution``, (count, 6 m)."""

    solution: SixSolution

    def __call__(self, rng: np.random.Generator, count: int) -> Floats:
        """Return EXC, EYC, EZC (m), EAC, EBC, ECC (rad) at all angles."""
        drawn = self.solution.found.trials(rng, count) - self.solution.found.value
        return np.asarray(self.solution.deviations().ravel() + drawn)


def adjust(problem: SixProblem) -> SixSolution:
    """Return the solution of ``problem``; raises what :func:`solve` raises."""
    return told_of_a_turned_sign(
        problem,
        _adjusted,
        lambda s: bool((s.found.scale * s.found.diagnosis.noise.factors < FITTING).all()),
    )


def _adjusted(problem: SixProblem) -> SixSolution:
    layout, absent = lay_out(problem)
    lengths = SixLengths.of(problem, layout, find_start(layout))
    settings = problem.settings
    limits = Limits(
        settings.rejection_significance, settings.noise_significance, settings.max_rejected_share
    )
    try:
        found = adjusted(model_of(problem, lengths), limits)
    except ObservabilityError as error:
        raise ObservabilityError(f"{error}: {CURE}{or_prior(free=layout.grid.free)}") from None
    solution = SixSolution(problem, layout, lengths, found, absent)
    _check_curves(solution, settings.max_station_std)
    return solution


def _check_curves(solution: SixSolution, limit: float) -> None:
    """Raise ObservabilityError where a curve is known worse than ``limit`` of the radius."""
    std, places = solution.found.fit.noise_std.reshape(6, -1), solution.lengths.places
    radius = float(np.linalg.norm(places - places.mean(axis=0), axis=1).max())
    share = std / np.repeat([radius, 1.0], 3)[:, None]
    component, position = np.unravel_index(np.argmax(share), share.shape)
    if share[component, position] > limit:
        factor, unit = unit_of(COMPONENTS[component])
        raise ObservabilityError(
            f"{COMPONENTS[component]} at position {position} is known to "
            f"{std[component, position] / factor:.2g} {unit} only (standard deviation): {CURE}"
        )


def solve(problem: SixProblem) -> Result:
    """Return EXC, EYC, EZC (m), EAC, EBC, ECC (rad) of the table at the commanded angles.

    Actual - commanded, of the point of the axis at the machine's z = 0, in a frame along the axis
    with x towards the machine's x. Each curve has zero mean; EXC, EYC and EAC, EBC have no part
    that turns with the table, for that is how the axis itself is defined. Standard deviations
    come from the lengths, the targets' prior and the scatter of the table from run to run;
    positions whose places leave a direction open are absent.

    Raises ObservabilityError where the places or the lengths cannot determine all six (it names
    the lost direction), DataError for contradictory or implausible data.
    """
    return result_of(adjust(problem))


def result_of(solution: SixSolution) -> Result:
    """Return what is known of a solved problem in the form that all methods share."""
    problem, layout, lengths = solution.problem, solution.layout, solution.lengths
    m, row = len(layout.angles), lengths.row
    numbering, upward = _numbering(solution), Upward.of(solution)
    plain = solution.found.result(
        METHOD,
        layout.angles,
        {name: slice(k * m, (k + 1) * m) for k, name in enumerate(COMPONENTS)},
        (lengths.position, lengths.target),
        counts_from="mean",
        doubts=_doubts(solution),
        protections=(*_protections(solution), numbering.protection(), upward.protection()),
        details=_details(solution),
        further=False,
    )
    verdict, warnings = upward.judged(*numbering.judged(plain.verdict, plain.warnings))
    gone = solution.absent | {int(row[r.index]): layout.named(r.why) for r in plain.rejected}
    influence = plain.raw_data.influence
    if influence is not None:
        influence = replace(influence, rows=row[influence.rows])
    return replace(
        plain,
        deviations=dict(zip(COMPONENTS, solution.deviations(), strict=True)),
        n_observations=len(problem.length),
        rejected=tuple(Rejection(k, why) for k, why in sorted(gone.items())),
        verdict=verdict,
        warnings=tuple(map(layout.named, warnings)),
        protections=tuple(replace(p, why=layout.named(p.why)) for p in plain.protections),
        residuals=_residuals(problem, row, plain.residuals),
        raw_data=RawData(influence=influence),
        placement=Placement.upwards(solution.curves.origin, solution.curves.axes[:, 2]),
    )


def _residuals(problem: SixProblem, row: Ints, found: Residuals | None) -> Residuals | None:
    """Return residuals of all lengths of a problem, of which those of ``row`` (k,) were solved."""
    if found is None:
        return None
    count = len(problem.length)

    def every(values: Floats, otherwise: Floats | float) -> Floats:
        column = np.full(count, otherwise, dtype=np.float64)
        column[row] = values
        return column

    used = np.zeros(count, dtype=np.bool_)
    used[row] = found.used
    return replace(
        found,
        table_position=problem.position,
        target=problem.target,
        residual=every(found.residual, np.nan),
        redundancy=every(found.redundancy, 0.0),
        test_value=every(found.test_value, 0.0),
        used=used,
        std=None if found.std is None else every(found.std, problem.length_std),
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


def _doubts(solution: SixSolution) -> list[str]:
    missing = solution.problem.missing(solution.positions)
    names = ", ".join(map(str, missing))
    few = f"no deviations for position(s) {names}: fewer than three places have enough lengths"
    return [few] if missing else []


def _protections(solution: SixSolution) -> Iterator[Protection]:
    """Yield what is said of effects that no length shows, or that are measured."""
    problem = solution.problem
    yield Protection("error motion", "estimated", "EXC, EYC and EZC are measured")
    std = problem.tilt_std
    if std is None:
        yield Protection("tilt", "estimated", "EAC and EBC are measured")
    else:
        held = (
            f"EAC and EBC are held to a stated {std / ARCSEC:.2g} arcsec, which the budget holds"
        )
        yield Protection("tilt", "bounded", held)
    yield Protection(
        "gauge",
        "harmless",
        "the curves are referred to the axis itself: what a lean or shift of the machine or of "
        "the table's own frame does is taken off",
    )
    stated = (problem.scatter_translation_std, problem.scatter_rotation_std)
    for sizes in solution.found.fit.sizes.values():
        if not sizes.contrasts:
            why = "no distance between places shows it: it is stated"
            yield Protection("repeatability", "not protected", why)
        elif None in stated:
            yield Protection(
                "repeatability",
                "estimated",
                f"between runs, from {sizes.contrasts} contrasts between the places",
            )
        else:
            yield Protection(
                "repeatability",
                "tested",
                f"stated; {sizes.contrasts} contrasts between the places show more of it",
            )
    radius = float(np.hypot(*solution.places[:, :2].T).mean())
    yield tangential_protection(
        radius,
        alike=", by the same at every place,",
        of=" of ECC",
        beside="what differs from place to place is scatter",
        within=_returned(solution, radius),
        shown="angles that were measured again",
        untested="it",
    )


def _returned(solution: SixSolution, radius: float) -> float | None:
    """Return within how many m the tracer came back along its circle, 95 %; None: untested.

    Seen by an angle that comes again, after a whole turn or in the same run, whichever says less.
    """
    closings = [c for c in solution.found.closed if c.relation.what.startswith("ECC ")]
    each = [(radius * c.error[0], radius * c.std[0]) for c in closings]
    layout, lengths, fit = solution.layout, solution.lengths, solution.found.fit
    stood = np.column_stack([layout.place, layout.position])
    _, first, which = np.unique(stood, axis=0, return_index=True, return_inverse=True)
    later = np.arange(len(stood)) != first[which]
    if later.any():
        side = np.where(later, 0.5, 0.0)
        side[first[which[later]]] = -0.5
        if solution.found.found_effects:  # a drift that was taken off may be just that
            fit = fitted(fit.model, fit.used, fit.std, fit.x)
        unit, arm = lengths.at_start
        along = np.cross([0.0, 0.0, 1.0], arm) / np.hypot(arm[:, 0], arm[:, 1])[:, None]
        felt = np.pad((unit * along).sum(axis=1) * side[lengths.station], (0, len(fit.std)))
        seen = observable_by(fit, felt[: len(fit.std), None])
        size = float(seen.score[0] / seen.information[0, 0])
        each.append((size, solution.found.scale / float(np.sqrt(seen.information[0, 0]))))
    return max((abs(e) + HALF_OF_95_PERCENT * u for e, u in each), default=None)


def _details(solution: SixSolution) -> dict[str, Any]:
    """Return the method's own part of the result, SI.

    ``places`` (p, 3) in the frame that turns with the table, z along the axis; ``place_ids`` are
    the problem's; ``axis``: where the axis meets the machine's z = 0, and its direction.
    """
    problem, curves, grid = solution.problem, solution.curves, solution.layout.grid
    moved, covariance = solution.part("target"), solution.covariance_among("target")
    std = np.sqrt(covariance.diagonal()).reshape(moved.shape)
    return {
        "datum": problem.datum,
        "zero": problem.zero,
        "position_ids": solution.positions,
        "place_ids": solution.layout.place_ids,
        "places": solution.places,
        "zeros": solution.zeros,
        "segments": segment_report(solution),
        "target_ids": grid.target_ids,
        "targets": solution.targets,
        "target_corrections": moved,
        "target_corrections_std": std,
        "axis": {"origin": curves.origin, "direction": curves.axes[:, 2]},
        "coverage_factor": HALF_OF_95_PERCENT,
        "covariance_scale": solution.found.scale,
    }


def segment_report(solution: SixSolution) -> list[dict[str, Any]]:
    """Return one entry per segment, in the order of time; none where no segments are given.

    ``segment``: its number in the problem; ``place_id``: where the tracer stood; ``zero``,
    ``std``: range at reading zero, m. Behind another segment of the same place also ``step``,
    ``step_std``: the zero less that of the segment before, as the rigid table and all targets
    show it, m; ``probability``: how likely it would be if the zero had stayed.
    """
    lengths, segment = solution.lengths, solution.problem.segment
    if segment is None:
        return []
    covariance, zero, used = solution.covariance_among("zero"), lengths.zero, _used(solution)
    begins = {z: int(lengths.order[zero == z].min()) for z in np.unique(zero).tolist()}
    found, before = [], dict[int, int]()
    for z in sorted(begins, key=begins.__getitem__):
        any_of_it = int(np.argmax(zero == z))
        place = int(lengths.place[any_of_it])
        entry = {
            "segment": int(segment[lengths.row[any_of_it]]),
            "place_id": int(solution.layout.place_ids[place]),
            "lengths": int(used[zero == z].sum()),
            "zero": float(solution.zeros[z]),
            "std": float(np.sqrt(covariance[z, z])),
        }
        if place in before:
            step = float(solution.zeros[z] - solution.zeros[before[place]])
            (a, b), (_, c) = covariance[np.ix_([before[place], z], [before[place], z])].tolist()
            variance = a + c - 2.0 * b
            chance = chi2_sf(step**2 / variance, 1.0)
            entry |= {"step": step, "step_std": float(np.sqrt(variance)), "probability": chance}
        found.append(entry)
        before[place] = z
    return found


def _used(solution: SixSolution) -> Bools:
    """Return which lengths (k,) are used."""
    return solution.found.fit.used[: len(solution.lengths.row)]


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
        lengths = solution.lengths
        beam = solution.targets[lengths.target] - lengths.stands(solution.found.fit.x)[0]
        rises = (beam[:, 2] / np.linalg.norm(beam, axis=1))[_used(solution)]
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
    return weigh(adjust(problem), moved, lambda solution: slope_along(solution, along), scatter)


def slope_along(solution: SixSolution, errors: Floats) -> Slope:
    """Return what the residuals of a solution say of ``errors`` (k,), m, row by row."""
    fit, row, noise = solution.found.fit, solution.lengths.row, solution.found.diagnosis.noise
    column = np.zeros(len(fit.std))
    column[: len(row)] = errors[row]
    white = np.where(fit.used, column / fit.std, 0.0)
    left = fit.left_of(white[:, None])[:, 0]
    factor, excess = float(noise.factors[0]), 0.0
    if factor > 1.0 and noise.estimated is not None:
        beyond = noise.estimated.contradicted(solution.problem.settings.test_significance)
        stated = float(np.median(solution.problem.length_std))
        excess = stated * float(np.sqrt(factor**2 - 1.0)) if beyond[0] else 0.0
    return Slope(float(white @ fit.white), float(left @ left), fit.chi2, fit.dof, excess)


def curve_model(solution: SixSolution) -> CurveModel:
    """Return the model of a solution, to be solved with other instruments."""
    lengths, model = solution.lengths, solution.found.model
    every = np.eye(6 * len(solution.layout.angles), model.size[1]).reshape(2, -1, 3, model.size[1])
    curves = {name: every[k // 3, :, k % 3] for k, name in enumerate(COMPONENTS)}
    return CurveModel(replace(model, outputs=every[0, :0, 0]), lengths.layout.angles, curves)
