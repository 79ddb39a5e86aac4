"""A designed plan in the order it is measured in: time, drift and knock, and the solver's U."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.methods.tracer.design.design import ARCSEC, DesignSearch, TracerDesign, finite
from rotcal_ros.methods.tracer.design.optimum import Progress
from rotcal_ros.methods.tracer.design.promise import Promise, promised
from rotcal_ros.methods.tracer.design.scene import Lengths, Scene
from rotcal_ros.methods.tracer.design.sequence_choice import (
    MeasuringOrder,
    least_hidden,
    measuring_orders,
)
from rotcal_ros.methods.tracer.design.sequence_forecast import SequenceForecast, ranks
from rotcal_ros.methods.tracer.design.settings import SHARED, TracerDesignSettings
from rotcal_ros.methods.tracer.solver.prediction import predicted
from rotcal_ros.methods.tracer.solver.problem import TracerProblem
from rotcal_ros.methods.tracer.solver_settings import TracerLimits
from rotcal_ros.planning.sequence_time import HARDLY, Drive, TimeModel, stated_time

TRIES: Final = 6
"""Searches after the first, each with less allowed to the lengths."""
AIM: Final = 0.97
"""Share of the wanted variance that a search aims at."""
CLOSE: Final = 0.85
"""Share of the wanted variance from which fewer lengths are no longer looked for."""
LEAST_EXCESS: Final = 0.1


def time_model(settings: TracerDesignSettings) -> TimeModel:
    """Return the time model that the settings describe."""
    machine = HARDLY
    if settings.machine_speed_m_s is not None:
        machine = Drive(settings.machine_speed_m_s, settings.machine_acceleration_m_s2)
    return stated_time(settings.rotation_s, settings.length_s, machine)


@dataclass(frozen=True, eq=False)
class OrderedDesign:
    """A plan and the order it is measured in, the quickest that shows drifts and knocks.

    ``variances`` (m,), rad^2, of ECC less its mean, are those that the solver will state for it
    when it estimates nothing: with one zero they allow for fringes slipped unseen, which depend on
    the order. ``promise``: what simulated results state. ``quickest``: the quickest order of the
    same lengths, whatever it hides.
    """

    design: TracerDesign
    order: MeasuringOrder
    variances: Floats
    promise: Promise
    quickest: MeasuringOrder

    @property
    def lengths(self) -> Lengths:
        """The lengths in their order."""
        return self.design.lengths[self.order.order]

    @property
    def expanded(self) -> Floats:
        """U (m,) of ECC less its mean, k = 2, rad, nothing being estimated."""
        return np.asarray(COVERAGE_FACTOR * np.sqrt(self.variances), dtype=np.float64)

    def excess(self) -> tuple[float, float]:
        """Return likely over wanted variance, mean and largest, less the error motion's part.

        Of the plain minimum, whose lengths check nothing, what is stated when all is well: which
        of them are doubted scatters U by more than any goal allows.
        """
        settings, scene = self.design.settings, self.design.scene
        constant = COVERAGE_FACTOR**2 * np.diagonal(scene.error_motion_angles)
        rms, largest = self.promise.likely(settings.confidence)
        if not settings.checked:
            rms, largest = float(np.sqrt((self.expanded**2).mean())), float(self.expanded.max())
        most_rms, most = settings.goal
        left = float(constant.mean()), float(constant.max())
        return (
            (rms**2 - left[0]) / max(most_rms**2 - left[0], 1e-3 * most_rms**2),
            (largest**2 - left[1]) / max(most**2 - left[1], 1e-3 * most**2),
        )

    @property
    def kept(self) -> bool:
        """Whether results reach the goal with the wanted confidence; see :meth:`excess`."""
        settings = self.design.settings
        if not settings.checked:
            return max(self.excess()) <= 1.0
        return self.promise.kept(settings.confidence, *settings.goal)

    @property
    def wanted(self) -> tuple[float, float]:
        """By what the variances that the lengths make, mean and largest, are to be multiplied."""
        least = LEAST_EXCESS if self.kept else 1.0
        mean, largest = (AIM / max(value, least) for value in self.excess())
        return mean, largest

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON, SI but for names that tell a unit."""
        settings, forecast = self.design.settings, self.order.forecast
        hidden = self.quickest.forecast
        stated = dict(zip(("rms", "largest"), self.promise.median, strict=True))
        below = dict(zip(("rms", "largest"), self.promise.below(settings.confidence), strict=True))
        return {
            **self.design.to_dict(),
            **{f"expanded_{name}_arcsec": finite(u / ARCSEC) for name, u in stated.items()},
            **{f"promised_{name}_arcsec": finite(u / ARCSEC) for name, u in below.items()},
            "confidence": settings.confidence,
            "met": self.promise.met(*settings.goal),
            "suspected": self.promise.suspected,
            "runs": self.promise.runs,
            "error_motion_std_m": settings.error_motion,
            "time_s": self.order.seconds,
            **self.cost(),
            "order": self.order.name,
            "unseen_std": {} if forecast is None else forecast.to_dict(),
            "quickest_unseen_std": {} if hidden is None else hidden.to_dict(),
        }

    def cost(self) -> dict[str, float]:
        """Return what the time (s) is made of, and what the order's protection takes of it.

        ``lengths_s``: if the table never had to turn, ``turns_s``: what its turns add;
        ``quickest_s``: of the same lengths in the quickest order, which hides drifts and knocks.
        """
        alone = self.design.settings.length_s * (len(self.lengths) - 1)
        return {
            "lengths_s": min(alone, self.order.seconds),
            "turns_s": max(self.order.seconds - alone, 0.0),
            "quickest_s": self.quickest.seconds,
        }


def ordered_design(
    settings: TracerDesignSettings,
    *,
    targets: Floats | None = None,
    progress: Progress | None = None,
) -> OrderedDesign:
    """Return a plan with few lengths whose result reaches the goal of ``settings``, in its order.

    ``targets`` (n, 3), m: the only places of the reflector, else all of the volume. The search
    knows nothing of slips and of what the solver estimates: where that takes the plan beyond the
    goal, with the wanted confidence, it is continued with less.
    Raises PlanError when the goal is out of reach, or no plan was found that checks every length.
    """
    search = DesignSearch(settings, targets, progress)
    found = best = _in_order(search.first())
    for _ in range(0 if best.kept else TRIES):
        if not np.isfinite(found.excess()).all() or found.promise.hopeless(settings.confidence):
            break
        try:
            found = _in_order(search.continued(found.design, *found.wanted))
        except PlanError:
            break
        if found.kept and (not best.kept or len(found.lengths) < len(best.lengths)):
            best = found
        if found.kept and max(found.excess()) >= CLOSE:
            break
    if not best.kept:
        raise PlanError(_out_of_reach(settings, found))
    return best


def _out_of_reach(settings: TracerDesignSettings, found: OrderedDesign) -> str:
    """Return why no plan keeps the promise, and what would help."""
    promise = found.promise
    suspected = f"{100 * promise.suspected:.2g} % of its sound runs are not called ok"
    if promise.hopeless(settings.confidence):
        return (
            f"no plan was found that ends ok with a probability of {100 * settings.confidence:g} "
            f"%: of the last one, of {len(found.lengths)} lengths, {suspected}, and no further "
            "length changes that: ask for a lower confidence, and measure again where it happens"
        )
    rms, _ = promise.likely(settings.confidence)
    cures = ["ask for less"]
    if settings.error_motion is None:
        cures.append("state error_motion_std_m, which the solver would else estimate")
    if settings.zero == SHARED and settings.slip_m > 0.0:
        cures.append(
            f"plan a zero per station: a fringe of {settings.slip_m:g} m that may slip unseen is "
            "in U"
        )
    return (
        f"no plan was found whose result states U <= {settings.need_arcsec:g} arcsec with a "
        f"probability of {100 * settings.confidence:g} %; the last one, of {len(found.lengths)} "
        f"lengths, stays below {rms / ARCSEC:.3g} arcsec ({suspected}): {', or '.join(cures)}"
    )


def _in_order(design: TracerDesign) -> OrderedDesign:
    settings, scene, lengths = design.settings, design.scene, design.lengths
    position, target = lengths.position, lengths.target
    costs = time_model(settings).costs(scene.table_angles, scene.targets, position, target)
    problem = noisy_problem(
        scene, lengths, one_zero=settings.zero == SHARED, seed=settings.seed,
        slip=settings.slip_m, limits=settings.limits,
    )  # fmt: skip
    ways = measuring_orders(
        position, target, costs, SequenceForecast(problem), limit=settings.max_unseen,
        seed=settings.seed,
    )  # fmt: skip
    order = least_hidden(ways, settings.max_unseen)
    posed = replace(problem, targets=scene.targets, order=ranks(order.order))
    promise = promised(posed, scene, settings.goal, settings.confidence, seed=settings.seed)
    return OrderedDesign(design, order, _stated(posed, scene), promise, ways[0])


def _stated(problem: TracerProblem, scene: Scene) -> Floats:
    """Return the variances (m,) of the deviations less their mean that the solver states."""
    covariance = predicted(problem, scene.stations).angles.covariance
    turn = np.eye(len(covariance)) - 1.0 / len(covariance)
    return np.asarray(np.diagonal(turn @ covariance @ turn), dtype=np.float64)


def noisy_problem(
    scene: Scene,
    lengths: Lengths,
    *,
    one_zero: bool,
    seed: int,
    slip: float,
    limits: TracerLimits,
) -> TracerProblem:
    """Return ``lengths`` with the stated noise as the solver would have to solve them.

    ``one_zero``: all of one unbroken beam, else each station with a zero of its own. ``slip``: a
    fringe (m) that may slip unseen, ``limits`` of the solver.
    """
    rng, ours = np.random.default_rng(seed), scene.targets[lengths.target]
    distance = np.linalg.norm(scene.stations[lengths.position] - ours, axis=1)
    std = np.hypot(scene.length_std, scene.length_std_relative * distance)
    moved = scene.target_std * rng.standard_normal(scene.targets.shape)
    return TracerProblem(
        position=lengths.position,
        target=lengths.target,
        length=distance + std * rng.standard_normal(len(std)),
        length_std=std,
        targets=scene.targets + moved,
        target_std=scene.target_std,
        table_angles=scene.table_angles,
        error_motion_std=scene.error_motion_std,
        circle_std=scene.circle_std,
        again=_earlier(lengths),
        start_stations=scene.stations,
        segment=lengths.segment if one_zero else None,
        slip=slip,
        settings=limits,
    )


def _earlier(lengths: Lengths) -> Ints:
    """Return how often the pair of each length (k,) stands before it."""
    pair = np.column_stack([lengths.position, lengths.target])
    same = (pair[:, None] == pair).all(axis=2)
    return np.asarray(np.tril(same, -1).sum(axis=1), dtype=np.int64)
