"""The six-deviations method from problem to result: the model, and what only it can say.

Noise, outliers, moves, slips, scatter of arrivals, closures and verdict are the engine's
(docs/engine.md). Here are the set-up's own doubts: places that are numbered off, a z that points
into the table, positions without a result.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust.engine import Adjusted, Trials
from rotcal_ros.adjust.engine import adjust as adjusted
from rotcal_ros.adjust.fit import fitted
from rotcal_ros.adjust.model import CurveModel
from rotcal_ros.adjust.observable import observable_by
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS, HALF_OF_95_PERCENT, unit_of
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.foundation.language import Phrase, noted, phrase
from rotcal_ros.foundation.protection import Protection
from rotcal_ros.foundation.results import Placement, Result, Verdict
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.geometry.rotations import rotation_about_z, rotation_from_vector
from rotcal_ros.methods.tracer.solver.carried_lengths import CarriedLengths
from rotcal_ros.methods.tracer.solver.observability import (
    Numbering,
    limits_of,
    or_prior,
    told_of_a_turned_sign,
)
from rotcal_ros.methods.tracer.solver.reported import Reported, along_beams, nearest, weighed
from rotcal_ros.methods.tracer.solver.reporting import (
    corrections,
    of_all_rows,
    segments_of,
    tangential_protection,
)
from rotcal_ros.methods.tracer_six.solver.model import lengths_of, model_of
from rotcal_ros.methods.tracer_six.solver.poses import Curves, find_start, table_curves
from rotcal_ros.methods.tracer_six.solver.problem import SixProblem, StationLayout, lay_out

UPSIDE_DOWN: Final = noted(
    "beams go down by {0:.0f} degrees, through the table, and none goes up as steeply: the z "
    "axis of targets and places seems to point into the table, and then EZC, EAC and EBC have "
    "the wrong sign"
)
NO_DEVIATIONS: Final = noted(
    "no deviations for position(s) {0}: fewer than three places have enough lengths"
)

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

    ``absent``: why rows have no place in it. ``reported``: what was made of reported places.
    """

    problem: SixProblem
    layout: StationLayout
    lengths: CarriedLengths
    found: Adjusted
    absent: dict[int, Phrase]
    reported: Reported | None = None

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
    def positions(self) -> Ints:
        """The table positions (m,) that have a result."""
        return self.layout.position_ids

    def deviations(self) -> Floats:
        """Return the six curves (6, m), m and rad."""
        return np.concatenate([self.curves.translation.T, self.curves.rotation.T])

    @property
    def trials(self) -> Trials:
        """Draws the curves of measurements like the given one, (count, 6 m)."""
        return replace(self.found.trials, value=self.deviations().ravel())


def adjust(problem: SixProblem) -> SixSolution:
    """Return the solution of ``problem``; raises what :func:`solve` raises."""
    return told_of_a_turned_sign(
        problem,
        _adjusted,
        lambda s: bool((s.found.scale * s.found.diagnosis.noise.factors < FITTING).all()),
    )


def _adjusted(problem: SixProblem) -> SixSolution:
    layout, absent = lay_out(problem)
    lengths = lengths_of(problem, layout, find_start(problem, layout))
    along = along_beams(lengths, problem.moved)

    def solved(weight: float, left: float = 0.0) -> SixSolution:
        moved = lengths
        if along is not None:
            observed, std = lengths.observed - weight * along, np.hypot(lengths.std, left)
            moved = replace(lengths, observed=observed, std=std)
        try:
            found = adjusted(model_of(problem, layout, moved), limits_of(problem.settings))
        except ObservabilityError as error:
            advice = f"{CURE}{or_prior(free=layout.grid.free)}"
            raise ObservabilityError(f"{error}: {advice}") from None
        return SixSolution(problem, layout, moved, found, absent)

    weight = 1.0
    if along is not None:
        weight = nearest(model_of(problem, layout, lengths), along)
    solution, reported = weighed(solved(weight), weight, lengths, along, solved)
    solution = replace(solution, reported=reported)
    _check_curves(solution, problem.settings.max_station_std)
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
    layout, lengths, problem = solution.layout, solution.lengths, solution.problem
    m, reported = len(layout.angles), solution.reported
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
    if reported is not None and reported.warning:
        warnings = (*warnings, reported.warning)

    def named(text: Phrase) -> Phrase:
        """Return a text of the engine with the stations called by their names."""
        match text.template, text.parts:
            case "{0} {1}", ("station", int(number)):
                return problem.station_name(number)
        parts = (named(part) if isinstance(part, Phrase) else part for part in text.parts)
        return phrase(text.template, *parts)

    every = of_all_rows(plain, problem, lengths, solution.absent)
    return replace(
        every,
        deviations=dict(zip(COMPONENTS, solution.deviations(), strict=True)),
        rejected=tuple(replace(r, why=named(r.why)) for r in every.rejected),
        verdict=verdict,
        warnings=tuple(map(named, warnings)),
        protections=tuple(replace(p, why=named(p.why)) for p in plain.protections),
        placement=Placement.upwards(solution.curves.origin, solution.curves.axes[:, 2]),
    )


def _numbering(solution: SixSolution) -> Numbering:
    """Return how the places found stand round the axis to those that the plan states."""
    found = solution.places[:, :2] @ (1.0, 1j)
    stated = solution.problem.places[solution.layout.place_ids, :2] @ (1.0, 1j)
    return Numbering.of(
        phrase("the plan (places, azimuth_deg)"),
        solution.layout.angles,
        float(np.abs(found).mean()),
        float(np.angle(np.vdot(stated, found))),
        solution.problem.place_tolerance,
    )


def _doubts(solution: SixSolution) -> list[Phrase]:
    missing = solution.problem.missing(solution.positions)
    names = ", ".join(map(str, missing))
    few = phrase(NO_DEVIATIONS, names)
    return [few] if missing else []


def _protections(solution: SixSolution) -> Iterator[Protection]:
    """Yield what is said of effects that no length shows, or that are measured."""
    problem = solution.problem
    yield Protection("error motion", "estimated", phrase("EXC, EYC and EZC are measured"))
    std = problem.tilt_std
    if std is None:
        yield Protection("tilt", "estimated", phrase("EAC and EBC are measured"))
    else:
        held = phrase(
            "EAC and EBC are held to a stated {0:.2g} arcsec, which the budget holds", std / ARCSEC
        )
        yield Protection("tilt", "bounded", held)
    yield Protection(
        "gauge",
        "harmless",
        phrase(
            "the curves are referred to the axis itself: what a lean or shift of the machine "
            "or of the table's own frame does is taken off"
        ),
    )
    stated = (problem.scatter_translation_std, problem.scatter_rotation_std)
    for sizes in solution.found.fit.sizes.values():
        if not sizes.contrasts:
            why = phrase("no distance between places shows it: the stated value is used")
            yield Protection("repeatability", "not protected", why)
        elif None in stated:
            yield Protection(
                "repeatability",
                "estimated",
                phrase("between runs, from {0} contrasts between the places", sizes.contrasts),
            )
        else:
            yield Protection(
                "repeatability",
                "tested",
                phrase(
                    "stated; {0} contrasts between the places show more of it", sizes.contrasts
                ),
            )
    radius = float(np.hypot(*solution.places[:, :2].T).mean())
    yield tangential_protection(
        radius,
        alike=phrase(", by the same at every place,"),
        of=phrase(" of ECC"),
        beside=phrase("what differs from place to place is scatter"),
        within=_returned(solution, radius),
        shown=phrase("angles that were measured again"),
        untested=phrase("it"),
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
        arm = lengths.stands(lengths.start)[1] @ lengths.axes.T
        along = np.cross([0.0, 0.0, 1.0], arm) / np.hypot(arm[:, 0], arm[:, 1])[:, None]
        felt = -(lengths.toward * along).sum(axis=1) * side[lengths.station]
        felt = np.pad(felt, (0, len(fit.std)))
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
    found, lengths, places = solution.found, solution.lengths, solution.layout.place_ids
    reported = solution.reported
    return {
        "datum": problem.datum,
        "zero": problem.zero,
        "position_ids": solution.positions,
        "place_ids": places,
        "places": solution.places,
        "zeros": lengths.zeros + solution.part("zero"),
        "segments": [] if problem.segment is None else segments_of(found, lengths, grid, places),
        "target_ids": grid.target_ids,
        "targets": solution.targets,
        **corrections(found, lengths),
        "axis": {"origin": curves.origin, "direction": curves.axes[:, 2]},
        "coverage_factor": HALF_OF_95_PERCENT,
        "covariance_scale": found.scale,
        **({} if reported is None else {"reported_places": asdict(reported)}),
    }


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
        self, verdict: Verdict, warnings: tuple[Phrase, ...]
    ) -> tuple[Verdict, tuple[Phrase, ...]]:
        """Return ``verdict`` and ``warnings``; a frame that stands on its head is not ok."""
        if self.lowest > -STEEP or self.highest > STEEP:
            return verdict, warnings
        warning = phrase(UPSIDE_DOWN, -self.lowest / DEGREE)
        return "suspect" if verdict == "ok" else verdict, (*warnings, warning)

    def protection(self) -> Protection:
        """Return whether targets and places that are both mirrored in z would be found."""
        unseen = phrase(
            "targets and places whose z axis points into the table fit every length as well and "
            "turn the signs of EZC, EAC and EBC"
        )
        if self.highest > STEEP and self.lowest > -STEEP:
            return Protection(
                "sign of z",
                "tested",
                phrase(
                    "{0}, but beams that go up by {1:.0f} degrees would go down as "
                    "steeply, through the table",
                    unseen,
                    self.highest / DEGREE,
                ),
            )
        return Protection(
            "sign of z",
            "not protected",
            phrase(
                "{0}; no beam goes up by {1:.0f} degrees or more alone, which would show "
                "it, for none goes down so steeply, through the table",
                unseen,
                STEEP / DEGREE,
            ),
        )


def curve_model(solution: SixSolution) -> CurveModel:
    """Return the model of a solution, to be solved with other instruments."""
    lengths, model = solution.lengths, solution.found.model
    every = np.eye(6 * len(solution.layout.angles), model.size[1]).reshape(2, -1, 3, model.size[1])
    curves = {name: every[k // 3, :, k % 3] for k, name in enumerate(COMPONENTS)}
    return CurveModel(replace(model, outputs=every[0, :0, 0]), lengths.angles, curves)
