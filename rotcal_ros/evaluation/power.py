"""From which size on the verdict notices an effect, and what it does unnoticed until then.

Every effect that a method lists is added to a simulated measurement of a plan, until the verdict
changes with the wanted probability. An effect that changes the result by more than TOLERABLE
standard uncertainties before that must be named in the verdict line.

A *trial* measures once, with an effect of a size, and records whether that was noticed and how
much it changed the result. The size that is noticed with a wanted probability is bracketed by
doubling, then by halving; between the last two sizes the probability is interpolated as a probit
of the logarithm.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from math import exp, isfinite, log
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust.distributions import normal_isf
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ConfigurationError, RotcalError
from rotcal_ros.foundation.protection import ALL_EFFECTS, EFFECTS, POWER, TOLERABLE, Effect
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods import Calibration
from rotcal_ros.methods.disturbance import Disturbance, DisturbedMeasurement

NOT_STATED: Final = "not stated"


@dataclass(frozen=True)
class PowerRow:
    """One effect on one method.

    ``size`` is in ``unit``. There the verdict changes with the wanted probability; if it never
    does, ``reached`` is False and ``size`` is the largest one tried. If the uncertainty holds an
    allowance, ``allowed`` is True and ``size`` is that allowance; ``beyond`` it is the larger one
    that is found, or the largest that was tried, with its error. ``error`` is what an unnoticed
    effect of that size does, in stated standard uncertainties; ``named`` says whether the verdict
    line names the effect.
    """

    effect: Effect
    what: str
    treatment: str
    unit: str
    size: float
    reached: bool
    allowed: bool
    error: float
    named: bool
    beyond: tuple[float, float] = (0.0, 0.0)

    @property
    def misleads(self) -> bool:
        """Whether the effect may spoil a result without a trace in the verdict."""
        return not self.named and not self.error <= TOLERABLE

    def to_dict(self, unit_si: float) -> dict[str, Any]:
        """Return the row for JSON, its size in SI by that of its unit."""
        return {
            "effect": self.effect,
            "what": self.what,
            "treatment": self.treatment,
            "size": self.size * unit_si,
            "noticed": self.reached,
            "allowed": self.allowed,
            "beyond": self.beyond[0] * unit_si if self.allowed else None,
            "error_std": self.error if isfinite(self.error) else None,
            "named": self.named,
            "misleads": self.misleads,
        }

    def cells(self) -> tuple[str, str, str, str, str]:
        """Return effect, treatment, size, error and whether it is named, for people."""
        size = f"{self.size:.3g} {self.unit}"
        if self.allowed:
            seen = "found from" if self.reached else "not found up to"
            larger, error = self.beyond
            size = f"allowed {size}, {seen} {larger:.3g} {self.unit} ({error:.2g} std)"
        elif not self.reached:
            size = f"not up to {size}"
        named = "yes" if self.named else "no"
        return self.effect, self.treatment, size, f"{self.error:.2g}", named


class PowerBench:
    """Measures one plan again and again; the undisturbed solutions are kept."""

    def __init__(self, calibration: Calibration, runs: int) -> None:
        self.calibration, self.runs = calibration.of_distances, runs
        self._plain: dict[int, tuple[Result, Mapping[str, Floats]]] = {}

    def plain(self, number: int) -> Result:
        """Return the undisturbed result of trial ``number``."""
        return self._undisturbed(number)[0]

    def _undisturbed(self, number: int) -> tuple[Result, Mapping[str, Floats]]:
        """Return the result of trial ``number``, and what the table really does there."""
        if number not in self._plain:
            measured = self.calibration.measured({}, number)
            result = self.calibration.solve(measured.observations)
            self._plain[number] = result, self._truth(measured)
        return self._plain[number]

    def _truth(self, measured: DisturbedMeasurement) -> Mapping[str, Floats]:
        angles = np.array(self.calibration.plan.distinct_angles)
        return self.calibration.method.gauge(angles, measured.truth)

    def false_alarms(self) -> int:
        """Return how many undisturbed results are not ok."""
        return sum(self.plain(number).verdict != "ok" for number in range(self.runs))

    def trial(self, effect: Effect, size: float, number: int) -> Trial:
        """Return trial ``number`` with an effect of ``size`` (SI).

        Without a result it counts as noticed.
        """
        measured = self.calibration.measured({effect: size}, number)
        try:
            result = self.calibration.solve(measured.observations)
        except RotcalError:
            return Trial(True, None)
        plain, before = self._undisturbed(number)
        if not np.array_equal(result.angles, plain.angles):
            return Trial(result.verdict != "ok", None)
        truth = self._truth(measured)
        error = _error(result, plain, {name: truth[name] - before[name] for name in truth})
        if effect in {d.effect for d in self.listed() if d.scatters}:  # all angles are alike
            error = {
                name: np.sqrt(np.mean(part**2, keepdims=True)) for name, part in error.items()
            }
        return Trial(result.verdict != "ok", np.concatenate(list(error.values())))

    def listed(self) -> tuple[Disturbance, ...]:
        """Return the disturbances that the method lists for the plan; empty if it lists none."""
        disturbances = self.calibration.method.disturbances
        if disturbances is None:
            return ()
        turns = any(step.turn is not None for step in self.calibration.plan.steps)
        return tuple(each for each in disturbances.listed if turns or not each.of_turns)

    def row(self, disturbance: Disturbance) -> PowerRow:
        """Return what a disturbance does before the verdict changes."""
        effect, unit = disturbance.effect, disturbance.unit_si
        stated = {p.effect: p.treatment for p in self.plain(0).protections}
        treatment = stated.get(effect, NOT_STATED)
        allowance = disturbance.stated
        allowed = 0.0
        if treatment == "bounded" and allowance is not None:
            allowed = allowance(self.calibration.configuration) / unit

        def attempt(size: float, number: int) -> Trial:
            return self.trial(effect, size * unit, number)

        named = effect in self.plain(0).unprotected
        facts = (effect, disturbance.what, treatment, disturbance.unit)
        if allowed > 0.0:
            error = detection_share(attempt, allowed, self.runs).error
            first = min(2.0 * allowed, disturbance.largest)
            beyond = search_detectable_size(attempt, first, disturbance.largest, self.runs)
            held = np.inf if error is None else error
            larger = beyond.size, beyond.error
            return PowerRow(*facts, allowed, beyond.reached, True, held, named, larger)
        found = search_detectable_size(attempt, disturbance.start, disturbance.largest, self.runs)
        return PowerRow(*facts, found.size, found.reached, False, found.error, named)


def power_rows(
    bench: PowerBench,
    report: Callable[[PowerRow], object] = lambda row: None,
    effects: Collection[str] = (),
) -> list[PowerRow]:
    """Return a row for each effect, or for some; ``report`` gets each as soon as it is found.

    Raises ConfigurationError for a method that does not list what may disturb it, or none of the
    wanted ``effects``.
    """
    listed, name = {d.effect: d for d in bench.listed()}, bench.calibration.method.name
    if missing := [effect for effect in EFFECTS if effect not in listed]:
        raise ConfigurationError(
            f"the method {name} does not say how these act: {', '.join(missing)}"
        )
    if unknown := set(effects) - set(listed):
        raise ConfigurationError(
            f"the method {name} has no effect {', '.join(sorted(unknown))}; it has "
            f"{', '.join(sorted(listed))}"
        )
    rows = []
    for effect in (effect for effect in ALL_EFFECTS if effect in listed):
        if not effects or effect in effects:
            rows.append(bench.row(listed[effect]))
            report(rows[-1])
    return rows


def _error(result: Result, plain: Result, moved: Mapping[str, Floats]) -> dict[str, Floats]:
    """Return the error of each component, in its stated std if it has one.

    ``moved``: by how much the effect moves the table itself, as a tilt does.
    """
    parts = {}
    for name in result.components:
        std = result.std[name]
        caused = result.deviations[name] - plain.deviations[name]
        if len(moved.get(name, ())) == len(caused):
            caused = caused - moved[name]
        parts[name] = caused[std > 0.0] / std[std > 0.0]
    return parts


FACTOR: Final = 2.0
"""Factor from one size to the next in the search for a bracket."""
HALVINGS: Final = 2
"""How often the bracket is halved (in the logarithm): then it is 19 % wide."""
GLANCE: Final = 20
"""After this many trials a size is given up if it is noticed far too seldom, or always."""
SELDOM: Final = 0.6
ENOUGH: Final = 3
"""Unnoticed trials needed to state an error."""


@dataclass(frozen=True)
class Trial:
    """One measurement with an effect: ``error`` (n,) is its part in the deviations, in their std.

    None if there is no result.
    """

    noticed: bool
    error: Floats | None


Try = Callable[[float, int], Trial]
"""``attempt(size, number)``: the trial of a size with the number's own noise."""


@dataclass(frozen=True)
class DetectionShare:
    """How many trials of a size were noticed; ``error`` is the largest rms error of the others.

    It is taken over the unnoticed trials, at the worst of all angles and components, in stated
    standard uncertainties; None with fewer than ENOUGH of them.
    """

    size: float
    trials: int
    noticed: int
    error: float | None

    @property
    def probability(self) -> float:
        """The share, shifted by half a trial at either end so that it has a probit."""
        return (self.noticed + 0.5) / (self.trials + 1.0)


@dataclass(frozen=True)
class DetectableSize:
    """The outcome of a search.

    ``size`` is noticed with the wanted probability; if no size up to the largest is, ``reached``
    is False and ``size`` is the largest. ``error`` is what an unnoticed effect of that size does,
    in stated standard uncertainties.
    """

    size: float
    reached: bool
    error: float


def search_detectable_size(
    attempt: Try, start: float, largest: float, runs: int, power: float = POWER
) -> DetectableSize:
    """Return from which size up to ``largest`` an effect is noticed with probability ``power``.

    ``runs`` trials decide about a size. The largest is tried first: an effect that is not noticed
    even there needs no search. The search begins at ``start`` and assumes that the probability
    grows with the size.
    """
    below: DetectionShare | None = None
    above: DetectionShare | None = None
    shares: list[DetectionShare] = []

    def look(size: float) -> None:
        nonlocal below, above
        share = detection_share(attempt, size, runs)
        shares.append(share)
        if share.noticed / share.trials >= power:
            above = share
        else:
            below = share

    look(largest)
    if above is None:
        return DetectableSize(largest, False, _error_at(largest, shares))
    below = above = None
    look(min(start, largest))
    while above is None and below is not None:
        look(min(FACTOR * below.size, largest))
    assert above is not None  # at the latest at the largest size
    while below is None and above.size > 1e-6 * start:
        look(above.size / FACTOR)
    if below is None:  # noticed even where there is next to nothing: a verdict that is never ok
        return DetectableSize(above.size, True, 0.0)
    for _ in range(HALVINGS):
        look(exp(0.5 * (log(below.size) + log(above.size))))
    size = _between(below, above, power)
    return DetectableSize(size, True, _error_at(size, shares))


def detection_share(attempt: Try, size: float, runs: int) -> DetectionShare:
    """Try a size ``runs`` times, or fewer if it is clearly noticed too seldom."""
    noticed, errors = 0, []
    number = 0
    while number < runs:
        trial = attempt(size, number)
        number += 1
        noticed += trial.noticed
        if not trial.noticed and trial.error is not None:
            errors.append(trial.error)
        if number == GLANCE and noticed < SELDOM * GLANCE:
            break
    error = None
    if len(errors) >= ENOUGH:
        error = float(np.sqrt(np.mean(np.square(errors), axis=0).max(initial=0.0)))
    return DetectionShare(size, number, noticed, error)


def _between(below: DetectionShare, above: DetectionShare, power: float) -> float:
    """Return the size of probability ``power`` between two that enclose it."""
    low, high = (-normal_isf(share.probability) for share in (below, above))
    wanted = -normal_isf(power)
    part = float(np.clip((wanted - low) / (high - low), 0.0, 1.0)) if high > low else 1.0
    return exp((1.0 - part) * log(below.size) + part * log(above.size))


def _error_at(size: float, shares: list[DetectionShare]) -> float:
    """Return the error of an unnoticed effect of ``size``, in proportion to the nearest known.

    It is inf if no size left enough trials unnoticed.
    """
    with_error = [share for share in shares if share.error is not None]
    if not with_error:
        return float("inf")
    nearest = min(with_error, key=lambda share: abs(log(share.size / size)))
    assert nearest.error is not None
    return nearest.error * size / nearest.size
