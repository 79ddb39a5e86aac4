"""What a problem would give without data: the covariance of a plan, and what its order hides."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rotcal_ros.adjust.closures import ClosureTest
from rotcal_ros.adjust.effects import (
    LargestUndetected,
    ObservableFamily,
    largest_undetected,
    largest_undetected_of_family,
)
from rotcal_ros.adjust.fit import Fit, fit_model, require_determined
from rotcal_ros.adjust.observable import observe_effect
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.protection import POWER, Effect
from rotcal_ros.methods.tracer.solver.observability import check_counts, limits_of
from rotcal_ros.methods.tracer.solver.posed import AssumedParameters, PosedProblem, effects_of
from rotcal_ros.methods.tracer.solver.problem import TracerProblem, arrange_grid
from rotcal_ros.methods.tracer.solver.solution import ecc_of_stations, unseen_slips


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a ``posed`` problem would give: ``covariance`` (m, m) of ECC in rad^2.

    ``redundancy`` (k,) by row of the problem; NaN for lengths that have no place on its grid.
    """

    posed: PosedProblem
    fit: Fit
    covariance: Floats

    @property
    def redundancy(self) -> Floats:
        """Share (k,) of each length that the others check."""
        row = self.posed.lengths.row
        found = np.full(len(self.posed.problem.position), np.nan)
        found[row] = self.fit.redundancy[: len(row)]
        return found

    def undetected_by_order(self, order: Ints) -> dict[Effect, LargestUndetected]:
        """Return what of drift and knock stays unseen where rows (k,) are measured in ``order``.

        ``order``: when each row of the problem is measured.
        """
        lengths = self.posed.lengths
        timed = replace(lengths, order=order[lengths.row])
        limits = limits_of(self.posed.problem.settings)
        each, std = limits.of_each_effect(self.fit.model), np.sqrt(self.covariance.diagonal())
        closed = [ClosureTest(self.fit, known) for known in self.fit.model.closures]
        found = dict[Effect, LargestUndetected]()
        unbroken = self.posed.problem.segment is not None
        for effect in effects_of(timed, unbroken=unbroken):
            if effect.effect not in ("drift", "knock"):
                continue
            known = effect.beside(self.fit.model.size[0] - len(lengths.row))
            seen = observe_effect(self.fit, known)
            for relation in closed:
                seen = relation.beside(known, seen)
            if isinstance(seen, ObservableFamily):
                worst = largest_undetected_of_family(
                    seen, std, known.largest, significance=each, power=POWER
                )
            else:
                worst = largest_undetected(
                    seen, std, known.largest, significance=each, power=POWER
                )
            if effect.effect not in found or worst.error > found[effect.effect].error:
                found[effect.effect] = worst
        return found


def predicted(problem: TracerProblem, stations: Floats | None = None) -> Prediction:
    """Return what ``problem`` would give with its tracer at ``stations`` (one per table angle, m).

    None: where its lengths say that it stands; else these do not matter, and exact ones take their
    place. Noise is as stated, and nothing is
    rejected. The table's error motion is taken as stated, None as none.

    Raises ObservabilityError when the lengths are too few or leave a direction open.
    """
    if stations is None:
        stations = PosedProblem.of(problem).every_station()
    apart = stations[problem.position] - problem.targets[problem.target]
    exact = replace(problem, length=np.sqrt((apart**2).sum(axis=1)), variant="joint")
    if problem.error_motion_std is None and problem.circle_std is None:
        exact = replace(exact, error_motion_std=0.0)
    grid, absent = arrange_grid(exact)
    check_counts(grid)
    standing = stations[grid.position_ids][grid.station]
    state = np.column_stack([standing, np.zeros(len(standing))])
    posed = PosedProblem.at(exact, grid, absent, state)
    model = posed.model(AssumedParameters(walk=problem.zero_walk_std or 0.0))
    require_determined(model)
    computed = model.equations(model.first)[0]
    every = np.ones(len(computed), dtype=np.bool_)
    correlated = [each.planned() for each in model.correlated]
    exact_model = replace(model, observed=computed, correlated=correlated)
    fit = fit_model(exact_model, every, model.std, model.first)
    if problem.variant == "station":
        covariance = ecc_of_stations(posed, fit, state)
    else:
        covariance = fit.covariance(slice(len(model.outputs)))
    slips = unseen_slips(problem, fit, np.sqrt(covariance.diagonal()))
    if slips is not None:
        covariance = covariance + slips.root @ slips.root.T
    return Prediction(posed, fit, covariance)
