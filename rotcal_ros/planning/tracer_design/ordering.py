"""A designed plan in the order it is measured in: time, drift and knock, and the solver's U."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.components import COVERAGE_FACTOR
from rotcal_ros.errors import PlanError
from rotcal_ros.methods.tracer.prediction import predicted
from rotcal_ros.methods.tracer.problem import TracerProblem
from rotcal_ros.methods.tracer.settings import TracerLimits
from rotcal_ros.planning.sequence_choice import MeasuringOrder, least_hidden, measuring_orders
from rotcal_ros.planning.sequence_forecast import OrderForecast, ranks
from rotcal_ros.planning.sequence_time import HARDLY, Drive, TimeModel, stated_time
from rotcal_ros.planning.tracer_design.design import ARCSEC, DesignSearch, TracerDesign
from rotcal_ros.planning.tracer_design.optimum import Progress
from rotcal_ros.planning.tracer_design.penalty import Demands
from rotcal_ros.planning.tracer_design.scene import Lengths, Scene
from rotcal_ros.planning.tracer_design.settings import SHARED, TracerDesignSettings

TRIES: Final = 4
"""Searches after the first, each with less allowed to the lengths."""
MARGIN: Final = 0.1
"""By how much more than slips have just added is left to them, growing with every search."""


def time_model(settings: TracerDesignSettings) -> TimeModel:
    """Return the time model that the settings describe."""
    machine = HARDLY
    if settings.machine_speed_m_s is not None:
        machine = Drive(settings.machine_speed_m_s, settings.machine_acceleration_m_s2)
    return stated_time(settings.rotation_s, settings.length_s, machine)


@dataclass(frozen=True, eq=False)
class OrderedDesign:
    """A plan and the order it is measured in, the quickest that shows drifts and knocks.

    ``variances`` (m,), rad^2, of ECC less its mean, are those that the solver will state for it:
    with one zero they allow for fringes slipped unseen, which depend on the order.
    """

    design: TracerDesign
    order: MeasuringOrder
    variances: Floats

    @property
    def lengths(self) -> Lengths:
        """The lengths in their order."""
        return self.design.lengths[self.order.order]

    @property
    def expanded(self) -> Floats:
        """U (m,) of ECC less its mean, k = 2, rad."""
        return np.asarray(COVERAGE_FACTOR * np.sqrt(self.variances), dtype=np.float64)

    def reaches(self, demands: Demands) -> bool:
        """Whether the variances are as small as demanded."""
        small = self.variances.mean() <= demands.mean and self.variances.max() <= demands.largest
        return bool(small)

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON, SI but for names that tell a unit."""
        expanded, forecast = self.expanded / ARCSEC, self.order.forecast
        return {
            **self.design.to_dict(),
            "expanded_rms_arcsec": float(np.sqrt((expanded**2).mean())),
            "expanded_largest_arcsec": float(expanded.max()),
            "time_s": self.order.seconds,
            "order": self.order.name,
            "unseen_std": {} if forecast is None else forecast.to_dict(),
        }


def ordered_design(
    settings: TracerDesignSettings,
    *,
    targets: Floats | None = None,
    progress: Progress | None = None,
) -> OrderedDesign:
    """Return a plan with few lengths whose result reaches the goal of ``settings``, in its order.

    ``targets`` (n, 3), m: the only places of the reflector, else all of the volume. The search
    knows nothing of slips: where they take the plan beyond the goal it is continued with less.
    Raises PlanError when the goal is out of reach, or no plan was found that checks every length.
    """
    search = DesignSearch(settings, targets, progress)
    found = _in_order(search.first())
    for number in range(1, TRIES + 1):
        if found.reaches(search.demands):
            return found
        added = (1.0 + MARGIN * number) * (found.variances - found.design.known.variances())
        found = _in_order(search.stricter(float(added.mean()), float(added.max())))
    if found.reaches(search.demands):
        return found
    raise PlanError(
        f"with a fringe of {settings.slip_m:g} m that may slip unseen no plan was found that "
        "reaches the goal: ask for less, or plan a zero per station"
    )


def _in_order(design: TracerDesign) -> OrderedDesign:
    settings, scene, lengths = design.settings, design.scene, design.lengths
    position, target = lengths.position, lengths.target
    costs = time_model(settings).costs(scene.table_angles, scene.targets, position, target)
    problem = noisy_problem(
        scene, lengths, one_zero=settings.zero == SHARED, seed=settings.seed,
        slip=settings.slip_m, limits=settings.limits,
    )  # fmt: skip
    order = least_hidden(
        measuring_orders(
            position, target, costs, OrderForecast(problem), limit=settings.max_unseen,
            seed=settings.seed,
        ),
        settings.max_unseen,
    )  # fmt: skip
    return OrderedDesign(design, order, _stated(problem, scene, order.order))


def _stated(problem: TracerProblem, scene: Scene, order: Ints) -> Floats:
    """Return the variances (m,) that the solver states in an ``order`` (k,), less their mean."""
    exact = replace(problem, targets=scene.targets, order=ranks(order))
    covariance = predicted(exact, scene.stations).angles.covariance
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
