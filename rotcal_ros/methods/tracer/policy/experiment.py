"""The lengths of a laser tracer as an experiment: what any choice of steps would give.

Everything is linear about the nominal place of the tracer (:class:`Information`); what was
observed enters only the estimate of the noise and the tests, and what the result of the lengths so
far would state (:class:`Stated`): the U that ends a measurement.

The noise is that of the first sweep alone, by restricted maximum likelihood
(:class:`LengthContrasts`), which keeps the errors of the targets apart; its information gives the
degrees of freedom. Stein (Ann. Math. Statist. 16 (1945) 243): a number of further lengths that
depends on this estimate alone leaves the final mean independent of it, so that Student's t with
these degrees of freedom holds for the final interval, however many lengths follow. An estimate
renewed on the way would stop where it happens to be small: intervals that promise too much.

What lengths determine, whatever stations and zeros are, follows from a linear model:

y = A x + T p + e: stations, zeros and offsets x are unknown, the errors p of the targets have the
machine's covariance (T holds it: p ~ N(0, 1)), the lengths' noise e ~ N(0, s^2). With
V = s^2 + T T' everything that is asked for follows from W = V^-1 - V^-1 A (A' V^-1 A)^-1 A' V^-1.
Let P = 1 - A (A'A)^-1 A' and T' P T = E L E' (eigenvalues L), B = P T E. Then

    W = (P - B D B') / s^2,        D = 1 / (s^2 + L)

so that one decomposition in the size of the targets serves every s.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, sqrt
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from scipy.linalg import eigh, qr
from scipy.special import ndtr, ndtri, stdtrit

from rotcal_ros.foundation.arrays import Bools, Floats, Ints, rms_about_mean
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.methods.tracer.policy.information import Information, Lengths, Scene, noisy_problem
from rotcal_ros.methods.tracer.settings import TracerSolverSettings
from rotcal_ros.methods.tracer.solver.prediction import predicted
from rotcal_ros.methods.tracer.solver.problem import TracerProblem, station_minimum
from rotcal_ros.planning.plan import Plan
from rotcal_ros.planning.readings import time_order

LEAST_SHARE: Final = 0.05
"""The noise is not estimated smaller than this share of the planned: that would be made up."""
MAX_ITERATIONS: Final = 100
"""Scoring steps after which the last variance stands."""
SETTLED: Final = 1e-10
"""Last step, as a share of the variance."""
CHECKED: Final = 1e-6
"""Redundancy from which a length is checked by others."""
DOUBTFUL: Final = 3
ALIKE: Final = 0.9
"""Up to three lengths whose test values are so nearly the largest are looked at one by one: where
few lengths check each other, an error shows in several."""


class Moments(NamedTuple):
    """tr W, tr W^2 and y' W^2 y at one noise."""

    trace: float
    square: float
    seen: float


class LengthContrasts:
    """k lengths; everything in units of their planned standard deviations.

    ``design`` (k, p): A above; ``targets`` (k, q): T; ``length`` (k,): y, observed less computed;
    ``time`` (k,): when each was taken, in any unit.
    """

    def __init__(self, design: Floats, targets: Floats, length: Floats, time: Floats) -> None:
        self._design, self._given = design, (targets, length, time)
        k, p = design.shape
        sizes = np.linalg.norm(design, axis=0)
        explained = qr(design / sizes, mode="economic", check_finite=False)[0]

        def unexplained(values: Floats) -> Floats:
            return np.asarray(values - explained @ (explained.T @ values), dtype=np.float64)

        through = unexplained(targets)
        spread, axes = eigh(through.T @ through, check_finite=False)
        self.count = k - p
        """How many contrasts there are; without any nothing is known of the noise."""
        self._plain = self.count - len(spread)
        """Contrasts that no target has part in; below zero, as many eigenvalues are zero."""
        self._spread = np.maximum(spread, 0.0)
        self._length, self._slope = unexplained(length), unexplained(time - time.mean())
        self._free = 1.0 - (explained**2).sum(axis=1)
        self._by_target = through @ axes
        self._measured, self._drifted = (
            self._by_target.T @ self._length,
            self._by_target.T @ self._slope,
        )

    def __len__(self) -> int:
        return len(self._length)

    def moments(self, variance: float) -> Moments:
        """Return what the likelihood is made of."""
        known = 1.0 / (variance + self._spread)
        trace = self._plain / variance + known.sum()
        square = self._plain / variance**2 + (known**2).sum()
        left = (
            self._length @ self._length
            - (self._measured**2 * known * (2.0 - self._spread * known)).sum()
        )
        return Moments(float(trace), float(square), float(left / variance**2))

    def without(self, row: int) -> LengthContrasts:
        """Return the lengths but the one in ``row``, which becomes one more unknown."""
        alone = np.eye(len(self), 1, -row)
        return LengthContrasts(np.hstack([self._design, alone]), *self._given)

    def checked(self, variance: float) -> Floats:
        """Return the diagonal of W (k,): how much the others check each length."""
        known = 1.0 / (variance + self._spread)
        return np.asarray((self._free - self._by_target**2 @ known) / variance, dtype=np.float64)

    def pull(self, variance: float) -> Floats:
        """Return W y (k,)."""
        known = 1.0 / (variance + self._spread)
        left = self._length - self._by_target @ (known * self._measured)
        return np.asarray(left / variance, dtype=np.float64)

    def drift(self, variance: float) -> float:
        """Return the change of all lengths in proportion to time, in standard deviations."""
        known = 1.0 / (variance + self._spread)
        weight = self._slope @ self._slope - (known * self._drifted**2).sum()
        value = self._slope @ self._length - (known * self._drifted * self._measured).sum()
        return float(value / np.sqrt(variance * weight)) if weight > 0.0 else 0.0


def likeliest(lengths: LengthContrasts) -> float:
    """Return the variance s^2 of the noise of greatest restricted likelihood.

    Fisher scoring from 1: y' W^2 y = tr W there (Patterson and Thompson, Biometrika 58 (1971)
    545).
    """
    variance = 1.0
    for _ in range(MAX_ITERATIONS):
        now = lengths.moments(variance)
        better = max(variance + (now.seen - now.trace) / now.square, LEAST_SHARE**2)
        if abs(better - variance) <= SETTLED * variance:
            return better
        variance = better
    return variance


def degrees_of_freedom(lengths: LengthContrasts, variance: float) -> float:
    """Return s^4 tr W^2: the number of contrasts where the targets play no part."""
    return variance**2 * lengths.moments(variance).square


@dataclass(frozen=True, eq=False)
class LengthNoise:
    """Factor on the planned standard deviation of the lengths, its degrees of freedom, and tests.

    ``test_value`` (k,): normalised residual of each length in standard deviations, 0 where no
    other length checks it; ``drift_value``: the same for a change of all lengths in proportion to
    time.
    """

    factor: float
    dof: float
    test_value: Floats
    drift_value: float


def student_factor(dof: float) -> float:
    """Return the t that holds as often with ``dof`` degrees of freedom as k = 2 with infinite."""
    return float(stdtrit(dof, ndtr(COVERAGE_FACTOR)))


def estimated_noise(lengths: LengthContrasts) -> LengthNoise:
    """Return the noise of the lengths; without a contrast 1 with zero degrees of freedom."""
    if lengths.count <= 0:
        return LengthNoise(1.0, 0.0, np.zeros(len(lengths)), 0.0)
    variance = likeliest(lengths)
    return _judged(lengths, variance, degrees_of_freedom(lengths, variance))


def judged_lengths(lengths: LengthContrasts, factor: float) -> LengthNoise:
    """Return the tests of :func:`estimated_noise` with a ``factor`` that is known; zero dof."""
    return _judged(lengths, factor**2, 0.0)


def _judged(lengths: LengthContrasts, variance: float, dof: float) -> LengthNoise:
    checked = lengths.checked(variance)
    seen = checked * variance > CHECKED
    test = np.where(seen, lengths.pull(variance) / np.sqrt(np.where(seen, checked, 1.0)), 0.0)
    return LengthNoise(float(np.sqrt(variance)), dof, test, lengths.drift(variance))


def suspect_length(
    lengths: LengthContrasts, noise: LengthNoise, significance: float
) -> tuple[int, float] | None:
    """Return which of the lengths is the most suspect, and its test value; None: none is.

    The test is against the noise that the others show; ``significance``: probability of suspecting
    any when all are good.
    """
    tail = 1.0 - 0.5 * significance / len(noise.test_value)
    size = np.abs(noise.test_value)
    worst = int(np.argmax(size))
    if noise.dof <= 1.0:
        value = float(noise.test_value[worst])
        return (worst, value) if abs(value) > ndtri(tail) else None
    values = {}
    for k in np.argsort(-size)[:DOUBTFUL].tolist():
        if size[k] == 0.0 or size[k] < ALIKE * size[worst]:
            break
        others = lengths.without(k)
        variance = likeliest(others)
        limit = float(stdtrit(max(degrees_of_freedom(others, variance), 1.0), tail))
        value = float(lengths.pull(variance)[k] / np.sqrt(lengths.checked(variance)[k]))
        if abs(value) > limit:
            values[k] = value
    return max(values.items(), key=lambda item: abs(item[1]), default=None)


PLACING_STEPS: Final = 8
"""Gauss-Newton steps that place the stations from nominal places, a few centimetres off."""
RIDGE: Final = 1e-12
"""Share of the diagonal that keeps a station in place where its lengths leave a direction open."""


@dataclass(frozen=True, slots=True)
class Stated:
    """A result as the solver states it now.

    ``uncertainty``: U of ECC less its mean, k = 2, rms over the angles, rad; infinite without a
    result. ``error_motion`` (m): the most likely one of the table, where the solver estimates it.
    ``doubt``: why the verdict is not ok, or why there is no result; empty: it is ok.
    """

    uncertainty: float
    error_motion: float = 0.0
    doubt: str = ""


Solver: TypeAlias = Callable[[Sequence[Observation]], Stated]
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
        return time_order(self.observations)

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

    def only(self, steps: Collection[int]) -> MeasuredLengths:
        """Return what was measured of ``steps``."""
        return MeasuredLengths(self.per_segment, (o for o in self.observations if o.step in steps))

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
    def segment_now(self) -> int:
        """The place among ``beams`` of the one that further lengths will be read from."""
        return self.beams.index(self._latest or (0, 0))

    def of_one_zero(self, a: Observation, b: Observation) -> bool:
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
    def dearest_s(self) -> float:
        """A step for which the table has to turn."""
        return self.step_s + self.turn_s


class LengthExperiment:
    """The steps of ``plan`` as lengths in ``scene``.

    Each station has a zero of its own, or ``per_segment`` each unbroken beam: what is not measured
    yet is taken to be read from the beam of now. ``solver`` says how the lengths will be judged,
    ``solved`` what the result of observations states; None: what is planned is believed.
    """

    def __init__(
        self,
        plan: Plan,
        scene: Scene,
        costs: Costs,
        *,
        per_segment: bool = False,
        solver: TracerSolverSettings | None = None,
        solved: Solver | None = None,
    ) -> None:
        self.solved = solved
        self.solver = solver or TracerSolverSettings()
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
        zero = measured.segment_now if self.per_segment else self.position[rows]
        return Lengths.of(self.position[rows], self.target[rows], zero)

    def planned(
        self,
        measured: MeasuredLengths,
        noise: float,
        coverage_factor: float,
        further: Collection[int] | Ints = (),
    ) -> float:
        """Return the expanded uncertainty (rad, rms over the angles) that these steps give.

        To first order and without slips of a fringe. Infinite while the solver could not solve
        them.
        """
        known = self.information(measured, noise, further)
        if self.lacking(known.lengths).any():
            return np.inf
        return coverage_factor * known.rms_std

    def uncertainty(
        self,
        measured: MeasuredLengths,
        noise: float,
        coverage_factor: float,
        further: Sequence[int] = (),
    ) -> float:
        """Return :meth:`planned` as the solver will state it, ``further`` steps in their order.

        With a zero per segment it allows for slips that these lengths would not show.
        """
        if not self.per_segment or not self.solvable(measured, further):
            return self.planned(measured, noise, coverage_factor, further)
        problem = self.posed(measured, noise, further)
        try:
            covariance = predicted(problem, self.scene.stations).covariance
        except ObservabilityError:
            return np.inf  # enough lengths, in directions too much alike
        return coverage_factor * rms_about_mean(covariance)

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
        return replace(problem, order=order)

    def felt(self, error_motion: float) -> float:
        """Return the expanded uncertainty (rad, rms) that an error motion (m, k = 1) makes."""
        angles = replace(self.scene, error_motion_std=error_motion).error_motion_angles
        return COVERAGE_FACTOR * float(np.sqrt(np.trace(angles) / len(angles)))

    def share_of_noise(self, measured: MeasuredLengths, noise: float) -> float:
        """Return d ln(variance) / d ln(noise^2): how much of the mean variance the noise makes."""
        # a central difference over +-5 % of the noise
        low, high = (
            self.information(measured, noise * f).variances().mean() for f in (0.95, 1.05)
        )
        return float(np.log(high / low) / (2.0 * np.log(1.05 / 0.95)))

    def solvable(self, measured: MeasuredLengths, further: Collection[int] = ()) -> bool:
        """Whether every station has enough lengths, those of ``further`` steps included."""
        return not self.lacking(self._known(measured, further)).any()

    def lacking_in_words(self, measured: MeasuredLengths) -> str:
        """Return which stations have too few lengths; empty when all have enough."""
        found = self._telling(self._known(measured))
        return ", ".join(
            f"table position {position} has {found[position]} lengths of {self.minimum} needed"
            for position in np.flatnonzero(found < self.minimum)
        )

    @property
    def stations(self) -> int:
        """How many there are, one for each table position."""
        return len(self.plan.table_angles)

    def _telling(self, lengths: Lengths) -> Ints:
        """Return how many ``lengths`` of each station are not alone with their zero."""
        shared = np.bincount(lengths.segment)[lengths.segment] > 1
        position = lengths.position[shared | (not self.per_segment)]
        return np.bincount(position, minlength=self.stations)

    def lacking(self, lengths: Lengths) -> Bools:
        """Return which stations (m,) have fewer ``lengths`` than it takes."""
        return np.asarray(self._telling(lengths) < self.minimum)

    def noise(
        self, measured: MeasuredLengths, significance: float, factor: float | None = None
    ) -> tuple[LengthNoise, tuple[Observation, float] | None]:
        """Return the noise of the ``measured`` lengths, and the most suspect one.

        That comes with its test value; None: no length is suspect. With a ``factor``
        that is known already only the tests are new. Stations with too few lengths take no part.
        """
        lacking = self.lacking(self._known(measured))
        every = measured.observations
        kept = np.array([not lacking[o.table_position] for o in every], dtype=np.bool_)
        observations = [o for o, takes_part in zip(every, kept, strict=True) if takes_part]
        if not observations:
            return LengthNoise(1.0, 0.0, np.zeros(0), 0.0), None
        zero = measured.segments()[kept] if self.per_segment else None
        residuals = contrasts(self.scene, observations, zero)
        found = estimated_noise(residuals) if factor is None else judged_lengths(residuals, factor)
        suspect = suspect_length(residuals, found, significance)
        return found, None if suspect is None else (observations[suspect[0]], suspect[1])

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


def contrasts(
    scene: Scene, observations: Sequence[Observation], zero: Ints | None
) -> LengthContrasts:
    """Return what the lengths (k,) of ``scene`` show about their noise.

    ``zero`` (k,): the unknown zero of each length; None: every station has its own, and a later
    run an offset to the first. Times in ns.
    """
    position = np.array([o.table_position for o in observations])
    target = np.array([o.target for o in observations])
    seen, own = np.unique(target, return_inverse=True)
    places = np.array([o.probe_position for o in observations])
    zeros = [_columns(position if zero is None else zero)]
    if zero is None:
        zeros.append(_columns(np.array([o.run for o in observations]))[:, 1:])
    length = np.array([o.mean[0] for o in observations])
    unit, design, y = _placed(scene.stations, position, places, length, np.hstack(zeros))
    errors = np.zeros((len(target), len(seen), 3))
    errors[np.arange(len(target)), own] = unit * scene.target_std[seen][own]
    std = np.sqrt(scene.beams(position, target)[1])
    time = np.array([o.window_end_ns for o in observations], dtype=np.float64)
    errors = errors.reshape(len(target), -1) / std[:, None]
    return LengthContrasts(design / std[:, None], errors, y / std, time - time[0])


def _columns(group: Ints) -> Floats:
    """Return a column of ones and zeros for each group, (k, groups)."""
    return np.asarray(group[:, None] == np.unique(group), dtype=np.float64)


def _placed(
    nominal: Floats, position: Ints, targets: Floats, length: Floats, zeros: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return unit vectors (k, 3), design (k, p) and lengths less computed ones (k,).

    Gauss-Newton on all stations and ``zeros`` (k, q) together, targets (k, 3) being known.
    """
    ids, own = np.unique(position, return_inverse=True)
    stations, offsets = nominal[ids].copy(), np.zeros(zeros.shape[1])
    each, moved = np.arange(len(own)), 3 * len(ids)
    for turn in range(PLACING_STEPS + 1):
        apart = stations[own] - targets
        distance = np.linalg.norm(apart, axis=1)
        unit = apart / distance[:, None]
        y = length - distance + zeros @ offsets
        by_station = np.zeros((len(own), len(ids), 3))
        by_station[each, own] = unit
        design = np.hstack([by_station.reshape(len(own), -1), -zeros])
        if turn == PLACING_STEPS:
            break
        normal = design.T @ design
        normal.flat[:: len(normal) + 1] *= 1.0 + RIDGE
        step = np.linalg.solve(normal, design.T @ y)
        stations += step[:moved].reshape(-1, 3)
        offsets += step[moved:]
    return unit, design, y
