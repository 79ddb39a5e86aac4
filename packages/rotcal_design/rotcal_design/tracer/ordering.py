"""A designed plan in the order it is measured in: time, drift and knock, and the U it will state.

To first order U follows from the geometry, but a result states it after the solver has looked at
what was measured: it may estimate the noise, leaves lengths out, and takes the error motion of the
table from the circle where none is stated, which scatters from run to run. So the plan is measured
many times over in simulation before it is in earnest: every run is solved by the solver itself,
and what it states is counted (:class:`SimulatedUncertainties`).

A verdict that is not ``ok`` states nothing. The tests behind it call a few sound runs suspect,
whatever is planned: no length lowers their share, which is counted apart. A run that is called so
misses the goal like one whose U is too large: what is promised is that a run ends well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from rotcal_design.settings import SHARED, TracerDesignSettings
from rotcal_design.tracer.search import DesignSearch, TracerDesign
from rotcal_ros.adjust.distributions import binomial_quantile
from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import PlanError, RotcalError
from rotcal_ros.foundation.results import json_value
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.tracer.policy.exchange import Progress
from rotcal_ros.methods.tracer.policy.information import Lengths, Scene, noisy_problem
from rotcal_ros.methods.tracer.policy.sequence import (
    MeasuringOrder,
    SequenceForecast,
    least_hidden,
    measuring_orders,
    ranks,
)
from rotcal_ros.methods.tracer.solver.circle import table_motion
from rotcal_ros.methods.tracer.solver.prediction import predicted
from rotcal_ros.methods.tracer.solver.problem import TracerProblem
from rotcal_ros.methods.tracer.solver.solution import adjust
from rotcal_ros.planning.sequence_time import HARDLY, Drive, TimeModel, constant_time_model

LOOKS: Final = (400, 1000, 2500)
"""Runs after which is asked whether the promise is kept. Tests that call 3 % of sound runs suspect
leave 2 % of the 5 % to U: 400 runs rarely show that much."""
FEWEST: Final = 100
"""Runs that show how far a plan is from its goal."""
ASSURANCE: Final = 0.95
"""How sure it is that the probability is what is promised, so few runs being simulated."""
TRIES: Final = 6
"""Searches after the first, each with less allowed to the lengths."""
AIM: Final = 0.97
"""Share of the wanted variance that a search aims at."""
CLOSE: Final = 0.85
"""Share of the wanted variance from which fewer lengths are no longer searched for."""
LEAST_EXCESS: Final = 0.1
"""A plan that needs still less of its wanted variance is taken to need so much: the next search
may use ten times its variance at most."""


def allowed_misses(runs: int, confidence: float) -> int:
    """Return how many of so many ``runs`` may miss a goal that is met with ``confidence``.

    More often missed it would be so few times with a probability of (1 - ASSURANCE) / looks, by
    the binomial law: together the LOOKS are wrong with 1 - ASSURANCE at most. -1: they are too few
    to decide.
    """
    return binomial_quantile((1.0 - ASSURANCE) / len(LOOKS), runs, 1.0 - confidence) - 1


@dataclass(frozen=True, eq=False)
class SimulatedUncertainties:
    """U (k = 2, rad) of ECC less its mean that simulated results state.

    ``rms`` (r,) over the angles, ``largest`` (r,) at the worst one, of each run; infinite where
    the verdict was not ok.
    """

    rms: Floats
    largest: Floats

    @property
    def runs(self) -> int:
        """How many were simulated."""
        return len(self.rms)

    @property
    def suspected(self) -> float:
        """Share of sound runs whose verdict is not ok."""
        return float(np.isinf(self.rms).mean())

    @property
    def median(self) -> tuple[float, float]:
        """What half of the results stay below, rms and largest, rad."""
        return self._exceeded_by(self.runs // 2)

    def below(self, confidence: float) -> tuple[float, float]:
        """Return what a result stays below with the probability ``confidence``, rms and largest.

        The order statistics that are above these quantiles with ASSURANCE, without any
        distribution assumed (Wilks, Ann. Math. Statist. 12 (1941) 91).
        """
        return self._exceeded_by(allowed_misses(self.runs, confidence))

    def likely(self, confidence: float) -> tuple[float, float]:
        """Return what it stays below so often as would suffice after the last look.

        Of the results that are ok, where fewer are.
        """
        share = allowed_misses(LOOKS[-1], confidence) / LOOKS[-1]
        not_ok = int(np.isinf(self.rms).sum())
        return self._exceeded_by(max(int(share * self.runs), min(not_ok, self.runs - 1)))

    def _exceeded_by(self, number: int) -> tuple[float, float]:
        """Return what so many of the results exceed, rms and largest; infinite for -1."""
        if number < 0:
            return np.inf, np.inf
        rank = self.runs - 1 - number
        return float(np.sort(self.rms)[rank]), float(np.sort(self.largest)[rank])

    def met(self, rms: float, largest: float = np.inf) -> float:
        """Return the share of results that state no more than these, rad, and are ok."""
        return float(self._met(rms, largest).mean())

    def kept(self, confidence: float, rms: float, largest: float = np.inf) -> bool:
        """Return whether results are so with the probability ``confidence``."""
        missed = int((~self._met(rms, largest)).sum())
        return missed <= allowed_misses(self.runs, confidence)

    def hopeless(self, confidence: float) -> bool:
        """Return whether those that are not ok are more than may miss any goal."""
        return self.suspected > 1.0 - confidence

    def _met(self, rms: float, largest: float) -> Bools:
        within = (self.rms <= rms) & (self.largest <= largest)
        return np.asarray(within & np.isfinite(self.rms), dtype=np.bool_)


def simulate_uncertainties(
    problem: TracerProblem,
    scene: Scene,
    goal: tuple[float, float],
    confidence: float,
    *,
    looks: Sequence[int] = LOOKS,
    seed: int = 0,
) -> SimulatedUncertainties:
    """Return what results of ``problem`` in the ``scene`` will state; its lengths do not matter.

    Lengths and targets scatter as stated, and the stations about their circle by its stated
    deviation and by the stated error motion. Where none is stated the table has none. Ends at one
    of the ``looks``, numbers of runs, if the ``goal`` (rms and largest, rad) is seen there to be
    met with ``confidence``, or as soon as the last look can no longer show it.
    """
    found: list[tuple[float, float]] = []
    missed = 0
    for number in range(looks[-1]):
        found.append(_stated(_measured(problem, scene, np.random.default_rng([seed, number]))))
        missed += not (found[-1][0] <= goal[0] and found[-1][1] <= goal[1])
        runs = number + 1
        if runs in looks and missed <= allowed_misses(runs, confidence):
            break
        if runs >= FEWEST and missed > allowed_misses(looks[-1], confidence):
            break
    return SimulatedUncertainties(*np.array(found).T)


def variances_about_mean(covariance: Floats) -> Floats:
    """Return the variances (m,) of deviations less their mean, of ``covariance`` (m, m)."""
    turn = np.eye(len(covariance)) - 1.0 / len(covariance)
    return np.asarray(np.diagonal(turn @ covariance @ turn), dtype=np.float64)


def expanded_about_mean(covariance: Floats) -> Floats:
    """Return U (m,), k = 2, of deviations less their mean, from their ``covariance`` (m, m)."""
    variance = np.maximum(variances_about_mean(covariance), 0.0)
    return np.asarray(COVERAGE_FACTOR * np.sqrt(variance), dtype=np.float64)


def _measured(problem: TracerProblem, scene: Scene, rng: np.random.Generator) -> TracerProblem:
    """Return the ``problem`` as it is measured once more."""
    stations = scene.stations + _off_circle(scene, rng)
    apart = stations[problem.position] - scene.targets[problem.target]
    noise = problem.length_std * rng.standard_normal(len(apart))
    return replace(
        problem,
        length=np.linalg.norm(apart, axis=1) + noise,
        targets=scene.targets + scene.target_std * rng.standard_normal(scene.targets.shape),
    )


def _off_circle(scene: Scene, rng: np.random.Generator) -> Floats:
    """Return by how much (m, 3) the stations leave the places of a perfect table, m."""
    motion = table_motion(scene.stations, scene.table_angles)
    outward = motion.in_plane / np.linalg.norm(motion.in_plane, axis=1)[:, None]
    basis = motion.plane.basis()
    along = np.column_stack([-outward[:, 1], outward[:, 0]]) @ basis
    drawn = rng.standard_normal((3, len(outward), 1))
    turning = scene.error_motion_std or 0.0
    across = turning if scene.circle_std is None else scene.circle_std
    off = across * drawn[0] * (outward @ basis) + turning * drawn[1] * along
    return np.asarray(off + (scene.circle_std or 0.0) * drawn[2] * motion.plane.normal)


def _stated(problem: TracerProblem) -> tuple[float, float]:
    """Return U that the result of ``problem`` states, rms and largest, rad."""
    try:
        solution = adjust(problem)
    except RotcalError:
        return np.inf, np.inf
    if solution.found.verdict != "ok":
        return np.inf, np.inf
    found = expanded_about_mean(solution.covariance)
    return float(np.sqrt((found**2).mean())), float(found.max())


def time_model(settings: TracerDesignSettings) -> TimeModel:
    """Return the time model that the settings describe."""
    machine = HARDLY
    if settings.machine_speed_m_s is not None:
        machine = Drive(settings.machine_speed_m_s, settings.machine_acceleration_m_s2)
    return constant_time_model(settings.rotation_s, settings.length_s, machine)


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
    promise: SimulatedUncertainties
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
            # where error motion nearly takes up the goal, next to nothing is left to divide by
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
        """Factor on the variances that the lengths cause, mean and largest."""
        least = LEAST_EXCESS if self.kept else 1.0
        mean, largest = (AIM / max(value, least) for value in self.excess())
        return mean, largest

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON, SI but for names that carry a unit."""
        settings, forecast = self.design.settings, self.order.forecast
        hidden = self.quickest.forecast
        stated = dict(zip(("rms", "largest"), self.promise.median, strict=True))
        below = dict(zip(("rms", "largest"), self.promise.below(settings.confidence), strict=True))
        return {
            **self.design.to_dict(),
            **{f"expanded_{name}_arcsec": json_value(u / ARCSEC) for name, u in stated.items()},
            **{f"promised_{name}_arcsec": json_value(u / ARCSEC) for name, u in below.items()},
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
    promise = simulate_uncertainties(
        posed, scene, settings.goal, settings.confidence, seed=settings.seed
    )
    stated = variances_about_mean(predicted(posed, scene.stations).covariance)
    return OrderedDesign(design, order, stated, promise, ways[0])
