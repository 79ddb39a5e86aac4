"""Decides what may be shown of a result: its two marks, and whether its uncertainty counts.

*Measurement*: may the numbers be believed (ok, suspect, failed)? *Tolerance*: is the table as it
was agreed (within, beyond, undecided)? A good measurement of a bad table is ok and beyond. Page,
report and terminal show the marks of this module and no others.

A band that is drawn or a U that is printed is believed, whatever is written beside it. So neither
is shown as valid where the model behind it is contradicted: by the verdict, or by the deviations
that a simulation injected. The numbers stay in result.json.

Conformity is decided after JCGM 106:2012, with a guard band w = U on either side. Within: every
deviation lies inside the tolerance by more than U (guarded acceptance, 8.3.2). Beyond: one lies
outside by more than U (guarded rejection, 8.3.3). Otherwise undecided. The conformance probability
(7) is that of a normal distribution about the measured values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR, SHOWN_IN, TRANSLATIONS, unit_of
from rotcal_ros.foundation.gum_numbers import typeset_minus, uncertainty, value_with_uncertainty
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.language import join_texts, noted, phrase
from rotcal_ros.foundation.protection import coverage_note
from rotcal_ros.foundation.results import AxisLine, Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE, MILLIMETRE

Decision = Literal["within", "beyond", "undecided"]
DRAWS: Final = 20_000
"""Curves drawn for the probability of a whole curve; one of 0.5 is then known to 0.004."""
RULE: Final = phrase("JCGM 106:2012, guard band w = U (k = 2)")


_DECIDED: Final[Mapping[Decision, str]] = {
    "within": noted("{0} is within the tolerance {1}"),
    "beyond": noted("{0} is beyond the tolerance {1}, by more than U at {2}"),
    "undecided": noted("{0} is undecided against the tolerance {1}: U goes beyond it at {2}"),
}


@dataclass(frozen=True, slots=True)
class Conformity:
    """One component against its tolerance, SI.

    ``probability`` is that of the whole curve, all angles at once; ``worst`` is the index of the
    deciding angle, where |deviation| + U is largest. With ``open_zeros`` U is unbounded, nothing
    is decided, and the probability is NaN.
    """

    component: str
    tolerance: float
    decision: Decision
    probability: float
    worst: int
    open_zeros: str = ""

    def describe(self, result: Result) -> str:
        """Return the statement of conformity in one sentence."""
        unit, label = unit_of(self.component)
        limit = f"±{self.tolerance / unit:g} {label}"
        if self.open_zeros:
            return phrase("{0} is undecided against the tolerance {1}: {2}",
                          self.component, limit, phrase(self.open_zeros))  # fmt: skip
        place = f"{result.angles[self.worst] / DEGREE:g}°"
        decision = phrase(_DECIDED[self.decision], self.component, limit, place)
        return phrase("{0}; conformance probability {1}", decision, _percent(self.probability))


def decide_conformity(values: Floats, stds: Floats, tolerance: float) -> Decision:
    """Return the decision about ``values`` (n,) with ``stds`` (n,) against +-``tolerance``."""
    size, guard = np.abs(values), COVERAGE_FACTOR * stds
    if np.all(size <= tolerance - guard):
        return "within"
    return "beyond" if np.any(size > tolerance + guard) else "undecided"


def conformities(result: Result, identity: Identity) -> tuple[Conformity, ...]:
    """Return the conformity of each measured component for which ``identity`` has a tolerance."""
    found = []
    for name in result.components:
        tolerance = tolerance_of(name, identity)
        if tolerance:
            values, std = result.deviations[name], result.std[name]
            if words := result.zeros.describe([name]):
                worst = int(np.argmax(np.abs(values)))
                found.append(Conformity(name, tolerance, "undecided", np.nan, worst, words))
                continue
            worst = int(np.argmax(np.abs(values) + COVERAGE_FACTOR * std))
            probability = _whole_curve(
                values, result.covariance.get(name, np.diag(std**2)), tolerance
            )
            decision = decide_conformity(values, std, tolerance)
            found.append(Conformity(name, tolerance, decision, probability, worst))
    return tuple(found)


def tolerance_of(component: str, identity: Identity) -> float:
    """Return the tolerance of a component in SI; 0 where none is agreed."""
    if component in TRANSLATIONS:
        return identity.tolerance_um * MICROMETRE
    return identity.tolerance_arcsec * ARCSEC


def _whole_curve(values: Floats, covariance: Floats, tolerance: float) -> float:
    """Return the probability that all values (n,) conform at once; equal input, equal output."""
    eigenvalues, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
    drawn = np.random.default_rng(106).standard_normal((DRAWS, len(values))) @ root.T
    return float(np.mean(np.all(np.abs(values + drawn) <= tolerance, axis=1)))


def _percent(probability: float) -> str:
    """Return a probability in percent, not closer to 0 or 100 than the draws can resolve."""
    if probability > 0.999:
        return phrase("above 99.9 %")
    return phrase("below 0.1 %") if probability < 0.001 else f"{100.0 * probability:.1f} %"


WITHIN: Final = "within"
BEYOND: Final = "beyond"
UNDECIDED: Final = "undecided"
COLOURS: Final[Mapping[str, str]] = {
    "ok": "green",
    "suspect": "red",
    "failed": "red",
    WITHIN: "green",
    UNDECIDED: "yellow",
    BEYOND: "red",
}
"""The colour of every kind of mark; pages have shades of them in their style sheets."""


@dataclass(frozen=True, slots=True)
class Mark:
    """One answer: ``name`` is measurement or tolerance, ``kind`` one of COLOURS.

    ``words`` begin with the answer; ``remark`` is the line below it, what it does not cover.
    """

    name: str
    kind: str
    words: str
    remark: str = ""

    @property
    def colour(self) -> str:
        """The colour at a terminal."""
        return COLOURS[self.kind]

    @property
    def line(self) -> str:
        """The mark as one line."""
        return phrase("{0}: {1}", phrase(self.name), self.words)


def marks(result: Result, truth: Mapping[str, Any] | None = None) -> tuple[Mark, ...]:
    """Return the marks of a result; only one if no tolerance is agreed.

    ``truth`` is the content of the truth.json of a simulation.
    """
    about = Mark(
        "measurement", result.verdict, result.verdict_words, coverage_note(result.not_tested)
    )
    doubt = why_withheld(result, truth)
    against = tolerance_mark(result.deviations, result.std, result.circumstances.identity, doubt)
    return (about,) if against is None else (about, against)


def tolerance_mark(
    deviations: Mapping[str, Floats],
    std: Mapping[str, Floats],
    identity: Identity,
    doubt: str | None,
) -> Mark | None:
    """Return the mark of deviations (SI, by component) with their standard uncertainties.

    None if no tolerance is agreed for any of them. If one component is beyond, all are. If U may
    not be stated (``doubt``) nothing is decided.
    """
    agreed = {name: limit for name in deviations if (limit := tolerance_of(name, identity))}
    if not agreed:
        return None
    if doubt:
        words = phrase("undecided, because U is not stated ({0})", _all(agreed))
        return Mark("tolerance", UNDECIDED, words)
    found = {name: decide_conformity(deviations[name], std[name], agreed[name]) for name in agreed}
    kind = next((k for k in (BEYOND, UNDECIDED) if k in found.values()), WITHIN)
    named = {name: limit for name, limit in agreed.items() if found[name] == kind}
    return Mark("tolerance", kind, phrase("{0} {1}", phrase(kind), _all(named)))


def _all(agreed: Mapping[str, float]) -> str:
    """Return components with their tolerances: "±2 arcsec (EAC, ECC), ±3 µm (EZC)"."""
    by_limit: dict[str, list[str]] = {}
    for name, limit in agreed.items():
        unit, label = unit_of(name)
        by_limit.setdefault(f"±{limit / unit:g} {label}", []).append(name)
    return ", ".join(f"{limit} ({', '.join(names)})" for limit, names in by_limit.items())


SURELY_WRONG: Final = 2.0
"""Distance in U, four standard uncertainties: no honest curve is that far from the truth."""


def why_withheld(result: Result, truth: Mapping[str, Any] | None = None) -> str | None:
    """Return why no uncertainty of ``result`` may be stated; None if it may.

    ``truth`` is the content of the truth.json of a simulation.
    """
    if reason := why_verdict_withholds(result.verdict, result.warnings):
        return reason
    return None if truth is None else _contradicted(result, truth)


def why_verdict_withholds(verdict: str, warnings: Sequence[str]) -> str | None:
    """Return why a verdict forbids to state an uncertainty; None if it does not."""
    if verdict == "ok":
        return None
    why = join_texts([*map(phrase, warnings)] or [phrase("its reason is not recorded")])
    return phrase("the verdict is {0}: {1}", phrase(verdict), why)


def further_statements(result: Result, *, valid: bool) -> list[str]:
    """Return what is said beside the deviations, in a sentence each; with U where ``valid``."""
    return [
        *(_line(axis, valid=valid) for axis in result.axes),
        *reversal_statements(result, valid=valid),
    ]


def _line(axis: AxisLine, *, valid: bool) -> str:
    """Return where an axis average line is (ISO 230-1: XOC and so on)."""
    found = []
    for name, number, std in zip(axis.names, axis.value, axis.std, strict=True):
        unit, label = SHOWN_IN["rad" if name[0] in "ABC" else "m"]
        text = typeset_minus(value_with_uncertainty(number / unit, COVERAGE_FACTOR * std / unit))
        found.append(f"{name} {text if valid else text.split(' ')[0]} {label}")
    place = ", ".join(f"{x / MILLIMETRE:g}" for x in axis.origin)
    return phrase("Axis at ({0}) mm, from its nominal place: {1}.", place, ", ".join(found))


def reversal_statements(result: Result, *, valid: bool) -> list[str]:
    """Return mean and largest reversal of what was measured from both sides, in a sentence each.

    B_i of ISO 230-2; with U where it is ``valid``.
    """
    found = list[str]()
    for name, both in result.directions.items():
        unit, label = unit_of(name)
        share = np.repeat([1.0, -1.0], len(both.angles)) / len(both.angles)
        mean_std = max(float(share @ both.covariance @ share), 0.0) ** 0.5
        at = int(np.argmax(np.abs(both.reversal)))
        mean, largest = (
            typeset_minus(value_with_uncertainty(number / unit, COVERAGE_FACTOR * std / unit))
            for number, std in (
                (float(np.mean(both.reversal)), mean_std),
                (float(both.reversal[at]), float(both.reversal_std[at])),
            )
        )
        if not valid:
            mean, largest = mean.split(" ")[0], largest.split(" ")[0]
        found.append(phrase(
            "Reversal of {0} (↑ − ↓, ISO 230-2): mean {1} {2}; largest {3} {2}, at {4}°.",
            name, mean, label, largest, f"{both.angles[at] / DEGREE:.6g}",
        ))  # fmt: skip
    return found


def uncovered_effects(result: Result) -> tuple[str, ...]:
    """Return the effects that a stated uncertainty leaves out."""
    if not result.protections:
        return (
            phrase("what drift, knocks and the like may have done (not stated by the method)"),
        )
    return result.unprotected


def injected_at_angles(
    angles: Floats, truth: Mapping[str, Any], component: str
) -> tuple[Floats, Bools]:
    """Return the injected values (n,), SI, at ``angles`` (n,), and where they are known."""
    values = truth.get("deviations", {}).get(component)
    if values is None:
        return np.zeros(len(angles)), np.zeros(len(angles), dtype=np.bool_)
    injected_at = np.asarray(truth["angles_rad"], dtype=np.float64)
    apart = np.abs(angles[:, None] - injected_at)
    nearest = apart.argmin(axis=1)
    return np.asarray(values, dtype=np.float64)[nearest], apart.min(axis=1) < 1e-9


def _contradicted(result: Result, truth: Mapping[str, Any]) -> str | None:
    """Return in words where the injected deviations lie far outside the band, or None."""
    for name in result.components:
        injected, known = injected_at_angles(result.angles, truth, name)
        expanded = COVERAGE_FACTOR * result.std[name]
        error = np.abs(result.deviations[name] - injected)
        times = np.divide(error, expanded, out=np.zeros_like(error), where=known & (expanded > 0))
        worst = int(times.argmax())
        if times[worst] > SURELY_WRONG:
            unit, label = unit_of(name)
            stated = uncertainty(float(expanded[worst]) / unit)
            return phrase(
                "{0} at {1:g} degrees is {2:.2g} {3} off what the simulation injected, {4:.1f} "
                "times its U of {5} {6}: the model is incomplete", name,
                result.angles[worst] / DEGREE, error[worst] / unit, label, times[worst], stated,
                label
            )  # fmt: skip
    return None
