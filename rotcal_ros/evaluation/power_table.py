"""What could be wrong with a method, and would its verdict say so: found by measuring.

Every effect that a method lists is added to a simulated measurement of a plan, until the verdict
turns with the wanted probability. The rule: what does more than TOLERABLE standard uncertainties
before that is named in the verdict line.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.catalogue import Calibration
from rotcal_ros.catalogue.disturbance import Disturbance
from rotcal_ros.errors import ConfigurationError, RotcalError
from rotcal_ros.evaluation.power import Trial, search, share_of
from rotcal_ros.protection import ALL_EFFECTS, EFFECTS, TOLERABLE, Effect
from rotcal_ros.results import Result

NOT_STATED = "not stated"


@dataclass(frozen=True)
class PowerRow:
    """One effect on one method.

    ``size`` is in ``unit``. The verdict turns there with the wanted probability; where it never
    does, ``reached`` is False and ``size`` the largest that was tried. Where the uncertainty
    holds an allowance, ``allowed`` is True and ``size`` is that. ``error`` is what an unnoticed
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

    @property
    def misleads(self) -> bool:
        """Whether the effect may spoil a result whose verdict does not tell."""
        return not self.named and not self.error <= TOLERABLE


class Bench:
    """Measures one plan again and again; the undisturbed solutions are kept."""

    def __init__(self, calibration: Calibration, runs: int) -> None:
        self.calibration, self.runs = calibration.of_distances, runs
        self._plain: dict[int, Result] = {}

    def plain(self, number: int) -> Result:
        """Return the undisturbed result of trial ``number``."""
        if number not in self._plain:
            measured = self.calibration.measured({}, number)
            self._plain[number] = self.calibration.solve(measured.observations)
        return self._plain[number]

    def false_alarms(self) -> int:
        """Return how many undisturbed results are not ok."""
        return sum(self.plain(number).verdict != "ok" for number in range(self.runs))

    def trial(self, effect: Effect, size: float, number: int) -> Trial:
        """Return trial ``number`` with an effect of ``size`` (SI); no result counts as noticed."""
        measured = self.calibration.measured({effect: size}, number)
        try:
            result = self.calibration.solve(measured.observations)
        except RotcalError:
            return Trial(True, None)
        plain = self.plain(number)
        if not np.array_equal(result.angles, plain.angles):
            return Trial(result.verdict != "ok", None)
        truth = self.calibration.method.gauge(
            np.array(self.calibration.plan.distinct_angles), measured.truth
        )
        error = _error(result, plain, truth)
        scatters = {d.effect for d in self.listed() if d.scatters}
        return Trial(
            result.verdict != "ok", _pooled(error) if effect in scatters else _worst(error)
        )

    def listed(self) -> tuple[Disturbance, ...]:
        """Return what may disturb the method; empty when it does not say."""
        disturbances = self.calibration.method.disturbances
        return () if disturbances is None else disturbances.listed

    def row(self, disturbance: Disturbance) -> PowerRow:
        """Return what the effect of a disturbance does before the verdict turns."""
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
            error = share_of(attempt, allowed, self.runs).error
            return PowerRow(
                *facts, allowed, False, True, np.inf if error is None else error, named
            )
        found = search(attempt, disturbance.start, disturbance.largest, self.runs)
        return PowerRow(*facts, found.size, found.reached, False, found.error, named)


def power_rows(
    bench: Bench, report: Callable[[PowerRow], None] = lambda row: None
) -> list[PowerRow]:
    """Return a row for each effect; ``report`` is called with every one as it is found.

    Raises ConfigurationError for a method that does not list what may disturb it.
    """
    method = bench.calibration.method
    listed = (
        {} if method.disturbances is None else {d.effect: d for d in method.disturbances.listed}
    )
    if missing := [effect for effect in EFFECTS if effect not in listed]:
        raise ConfigurationError(
            f"the method {method.name} does not say how these look: {', '.join(missing)}"
        )
    rows = []
    for effect in (effect for effect in ALL_EFFECTS if effect in listed):
        rows.append(bench.row(listed[effect]))
        report(rows[-1])
    return rows


def _error(result: Result, plain: Result, truth: Mapping[str, Floats]) -> dict[str, Floats]:
    """Return what the effect has caused of each component, in its stated std where it has one."""
    parts = {}
    for name in result.components:
        std = result.std[name]
        caused = result.deviations[name] - plain.deviations[name]
        if len(truth.get(name, ())) == len(caused):
            caused = caused - truth[name]
        parts[name] = caused[std > 0.0] / std[std > 0.0]
    return parts


def _worst(error: Mapping[str, Floats]) -> Floats:
    """Return the errors of a pattern, angle by angle."""
    return np.concatenate(list(error.values()))


def _pooled(error: Mapping[str, Floats]) -> Floats:
    """Return the errors of what scatters: rms over the angles, which are all alike."""
    return np.array([np.sqrt(np.mean(np.square(part))) for part in error.values()])
