"""The lengths of a laser tracer as an experiment: what any choice of steps would give.

What is planned is linear about the nominal place of the tracer (:class:`Information`). What was
observed enters by what the solver states of it (:class:`StatedResult`): its noise, which lengths
it does not believe, drifts, and the U that ends a measurement.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, sqrt
from typing import TypeAlias

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats, Ints, rms_about_mean
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.foundation.language import Phrase, join_texts, noted, phrase
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods.tracer.policy.information import Information, Lengths, Scene, noisy_problem
from rotcal_ros.methods.tracer.settings import TracerSolverSettings
from rotcal_ros.methods.tracer.solver.prediction import predicted
from rotcal_ros.methods.tracer.solver.problem import TracerProblem, station_minimum
from rotcal_ros.planning.plan import Plan
from rotcal_ros.planning.readings import time_ranks


@dataclass(frozen=True, slots=True)
class StatedResult:
    """A result as the solver states it now.

    ``uncertainty``: U of ECC less its mean, k = 2, rms over the angles, rad; infinite without a
    result. ``length_std``: noise of the lengths, rms, m; None without a result. ``error_motion``
    (m): the most likely one of the table, where the solver estimates it. ``suspects``: what was
    left out, and why. ``drifts``: whether a drift was found. ``doubt``: why the verdict
    is not ok, or why there is no result; empty: it is ok.
    """

    uncertainty: float
    length_std: float | None = None
    error_motion: float = 0.0
    suspects: tuple[tuple[Observation, str], ...] = ()
    drifts: bool = False
    doubt: str = ""

    @classmethod
    def of(cls, result: Result, observations: Sequence[Observation]) -> StatedResult:
        """Return what a ``result`` of ``observations`` states, which are its rows."""
        motion, rows = result.error_motion, result.residuals
        assert rows is not None
        assert rows.std is not None
        found = {each["effect"] for each in result.details["effects_found"]}
        return cls(
            COVERAGE_FACTOR * rms_about_mean(result.covariance["ECC"]),
            float(np.sqrt((rows.std[rows.used] ** 2).mean())),
            motion.likely if motion is not None and motion.used != motion.stated else 0.0,
            tuple((observations[each.index], each.why) for each in result.rejected),
            "drift" in found,
            "" if result.verdict == "ok" else next(iter(result.warnings), result.verdict),
        )


Solver: TypeAlias = Callable[[Sequence[Observation]], StatedResult]
"""Solves all accepted observations as the calibration will."""


@dataclass(frozen=True, slots=True)
class Allowance:
    """How what is stated follows from what lengths are planned to give.

    stated^2 = floor^2 + (growth * planned)^2: ``floor`` (rad) is the part of an estimated error
    motion, which no length lowers; ``growth`` is what the solver makes of the rest by estimating
    noise and error motion, allowing for slips, leaving lengths out.
    """

    floor: float = 0.0
    growth: float = 1.0

    @classmethod
    def of(cls, stated: float, planned: float, floor: float) -> Allowance:
        """Return the allowance that makes ``stated`` of ``planned``, both in rad."""
        if not 0.0 < planned < inf:
            return cls(floor)
        return cls(floor, sqrt(max(stated**2 - floor**2, 0.0)) / planned)

    def stated(self, planned: float) -> float:
        """Return what is stated where so much is ``planned``, rad."""
        return sqrt(self.floor**2 + (self.growth * planned) ** 2)

    def planned(self, stated: float) -> float:
        """Return what has to be planned for so much to be ``stated``, rad; 0: nothing helps."""
        return sqrt(max(stated**2 - self.floor**2, 0.0)) / self.growth


class MeasuredLengths:
    """Accepted observations of single steps, as the solver will take them.

    With a zero per station the last observation of a step counts, with a zero ``per_segment`` the
    last one of each run: a run begins a segment, and so does a beam that was broken.
    """

    def __init__(self, per_segment: bool, observations: Iterable[Observation] = ()) -> None:
        self.per_segment = per_segment
        self._kept: dict[tuple[int, int], Observation] = {}
        self._latest: tuple[int, int] | None = None
        for observation in observations:
            self.add(observation)

    def add(self, observation: Observation) -> None:
        """Take an observation in place of what it repeats."""
        self._kept[self._key(observation)] = observation
        self._latest = self._beam(observation)
        self._forget()

    def drop(self, observation: Observation) -> None:
        """Forget an observation."""
        del self._kept[self._key(observation)]
        self._forget()

    def _forget(self) -> None:
        """Have what follows from the observations worked out anew: they have changed."""
        for name in ("observations", "beams"):
            self.__dict__.pop(name, None)

    @cached_property
    def observations(self) -> tuple[Observation, ...]:
        """All that count, in an order that does not depend on when they came."""
        return tuple(self._kept[key] for key in sorted(self._kept))

    def time_order(self) -> Ints:
        """Return the rank (k,) in time of each of the ``observations``."""
        return time_ranks(self.observations)

    @property
    def steps(self) -> set[int]:
        """The steps that were measured."""
        return {step for _, step in self._kept}

    def __contains__(self, step: int) -> bool:
        return step in self.steps

    def last_of(self, step: int) -> Observation | None:
        """Return the last observation of a step, None without any."""
        own = [key for key in self._kept if key[1] == step]
        return self._kept[max(own)] if own else None

    @cached_property
    def beams(self) -> tuple[tuple[int, int], ...]:
        """Run and segment of every unbroken beam, the one that is read now among them."""
        every = {self._beam(o) for o in self._kept.values()} | {self._latest or (0, 0)}
        return tuple(sorted(every))

    def segments(self) -> Ints:
        """Return the place among ``beams`` of the one that each observation (k,) was read from."""
        number = {beam: place for place, beam in enumerate(self.beams)}
        return np.array([number[self._beam(o)] for o in self.observations], dtype=np.int64)

    @property
    def current_segment(self) -> int:
        """The place among ``beams`` of the one that further lengths will be read from."""
        return self.beams.index(self._latest or (0, 0))

    def share_zero(self, a: Observation, b: Observation) -> bool:
        """Return whether both count from the same zero, being of one step."""
        return not self.per_segment or self._beam(a) == self._beam(b)

    def _key(self, observation: Observation) -> tuple[int, int]:
        return (observation.run if self.per_segment else 0, observation.step)

    @staticmethod
    def _beam(observation: Observation) -> tuple[int, int]:
        return observation.run, observation.segment


@dataclass(frozen=True, slots=True)
class Costs:
    """Seconds that a step takes, and that a turn of the table takes."""

    step_s: float
    turn_s: float

    @property
    def longest_step_s(self) -> float:
        """A step for which the table has to turn."""
        return self.step_s + self.turn_s


class LengthExperiment:
    """The steps of ``plan`` as lengths in ``scene``.

    Each station has a zero of its own, or ``per_segment`` each unbroken beam: what is not measured
    yet is taken to be read from the beam of now. ``solved`` says what the result of observations
    states, ``solver`` how the lengths will be judged.
    """

    def __init__(
        self,
        plan: Plan,
        scene: Scene,
        costs: Costs,
        solved: Solver,
        *,
        per_segment: bool = False,
        solver: TracerSolverSettings | None = None,
    ) -> None:
        self.solved, self.solver = solved, solver or TracerSolverSettings()
        self.plan, self.scene, self.costs, self.per_segment = plan, scene, costs, per_segment
        self.minimum = 1 + station_minimum(not per_segment, on_circle=False)  # one checks them
        self.position = np.array([step.table_position for step in plan.steps], dtype=np.int64)
        self.target = np.array([step.target for step in plan.steps], dtype=np.int64)
        self.sweeps: dict[float, tuple[int, ...]] = {}
        """First sweeps that were planned, by the uncertainty (rad) that they reach."""
        self._scenes: dict[float, Scene] = {}

    @cached_property
    def directions(self) -> Floats:
        """Unit vectors (k, 3) of the beams, from target to station, machine's frame."""
        return self.scene.beams(self.position, self.target)[0]

    @property
    def nothing(self) -> MeasuredLengths:
        """What is measured before the first step."""
        return MeasuredLengths(self.per_segment)

    def information(
        self, measured: MeasuredLengths, noise: float, further: Collection[int] | Ints = ()
    ) -> Information:
        """Return what the ``measured`` lengths determine, and those of ``further`` steps."""
        zeros = len(measured.beams) if self.per_segment else self.stations
        return Information(self._noisier(noise), self._known(measured, further), zeros)

    def _known(self, measured: MeasuredLengths, further: Collection[int] | Ints = ()) -> Lengths:
        rows = np.array([o.step for o in measured.observations], dtype=np.int64)
        zero = measured.segments() if self.per_segment else self.position[rows]
        lengths = Lengths.of(self.position[rows], self.target[rows], zero)
        return lengths + self.lengths(further, measured)

    def lengths(self, steps: Collection[int] | Ints, measured: MeasuredLengths) -> Lengths:
        """Return the lengths of ``steps`` as they would be read now."""
        rows = np.fromiter(steps, dtype=np.int64, count=len(steps))
        zero = measured.current_segment if self.per_segment else self.position[rows]
        return Lengths.of(self.position[rows], self.target[rows], zero)

    def planned(
        self,
        measured: MeasuredLengths,
        noise: float,
        further: Collection[int] | Ints = (),
    ) -> float:
        """Return U (k = 2, rms over the angles, rad) of these steps by the joint model.

        Without slips of a fringe. Infinite while the solver could not solve them.
        """
        known = self.information(measured, noise, further)
        if self.stations_lacking_lengths(known.lengths).any():
            return np.inf
        return COVERAGE_FACTOR * known.rms_std

    def uncertainty(
        self, measured: MeasuredLengths, noise: float, further: Sequence[int] = ()
    ) -> float:
        """Return :meth:`planned` as the solver will state it, ``further`` steps in their order.

        With its variant, and slips that would stay unseen of zeros per segment.
        """
        joint = self.solver.variant == "joint" and not self.per_segment
        if joint or not self.solvable(measured, further):
            return self.planned(measured, noise, further)
        problem = self.posed(measured, noise, further)
        try:
            covariance = predicted(problem, self.scene.stations).covariance
        except ObservabilityError:
            return np.inf  # enough lengths, in directions too much alike
        return COVERAGE_FACTOR * rms_about_mean(covariance)

    def posed(
        self, measured: MeasuredLengths, noise: float, further: Sequence[int] | Ints = ()
    ) -> TracerProblem:
        """Return the problem that the solver will have to solve, with made-up readings."""
        lengths = self._known(measured, further)
        order = np.concatenate(
            [measured.time_order(), len(lengths) - len(further) + np.arange(len(further))]
        )
        problem = noisy_problem(
            self._noisier(noise), lengths, one_zero=self.per_segment, seed=0,
            slip=self.solver.slip_m, limits=self.solver,
        )  # fmt: skip
        return replace(problem, order=order, variant=self.solver.variant)

    def error_motion_uncertainty(self, error_motion: float) -> float:
        """Return the expanded uncertainty (rad, rms) that an error motion (m, k = 1) makes."""
        angles = replace(self.scene, error_motion_std=error_motion).error_motion_angles
        return COVERAGE_FACTOR * float(np.sqrt(np.trace(angles) / len(angles)))

    def solvable(self, measured: MeasuredLengths, further: Collection[int] = ()) -> bool:
        """Whether every station has enough lengths, those of ``further`` steps included."""
        return not self.stations_lacking_lengths(self._known(measured, further)).any()

    def noise(self, measured: MeasuredLengths, length_std: float | None) -> float:
        """Return a noise of the ``measured`` lengths (rms, m) in units of the planned one."""
        at = np.array([(o.table_position, o.target) for o in measured.observations])
        planned = self.scene.beams(*at.T)[1].mean()
        return 1.0 if length_std is None else length_std / float(np.sqrt(planned))

    def describe_lacking(self, measured: MeasuredLengths) -> Phrase:
        """Return which stations have too few lengths; empty when all have enough."""
        found = self._telling(self._known(measured))
        needed = noted("table position {0} has {1} lengths of {2} needed")
        few = np.flatnonzero(found < self.minimum)
        return join_texts([phrase(needed, at, found[at], self.minimum) for at in few], ", ")

    @property
    def stations(self) -> int:
        """How many there are, one for each table position."""
        return len(self.plan.table_angles)

    def _telling(self, lengths: Lengths) -> Ints:
        """Return how many ``lengths`` of each station are not alone with their zero."""
        shared = np.bincount(lengths.segment)[lengths.segment] > 1
        position = lengths.position[shared | (not self.per_segment)]
        return np.bincount(position, minlength=self.stations)

    def stations_lacking_lengths(self, lengths: Lengths) -> Bools:
        """Return which stations (m,) have fewer ``lengths`` than it takes."""
        return np.asarray(self._telling(lengths) < self.minimum)

    def _noisier(self, factor: float) -> Scene:
        """Return the scene with ``factor`` times the noise; the last few are kept."""
        found = self._scenes.get(factor)
        if found is None:
            if len(self._scenes) > 8:
                self._scenes.clear()
            found = self._scenes[factor] = replace(
                self.scene,
                length_std=factor * self.scene.length_std,
                length_std_relative=factor * self.scene.length_std_relative,
            )
            for name in ("_carriage", "_known"):
                found.__dict__[name] = getattr(self.scene, name)  # the noise has no part in them
        return found
