"""Before and after compensation: how much a correction table has removed, and what is left."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np

from rotcal_ros.compensation.held_table import CorrectionEffect
from rotcal_ros.evaluation.iso230 import Iso230
from rotcal_ros.foundation.arrays import Floats, std_of
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.gum_numbers import value
from rotcal_ros.foundation.language import Phrase, phrase
from rotcal_ros.foundation.protection import split_verdict_line
from rotcal_ros.foundation.results import Result, Verdict
from rotcal_ros.foundation.units import ARCSEC, DEGREE

SCHEMA: Final = 1
AGREEMENT: Final = 4.0
"""Standard uncertainties within which two measurements agree."""
ISO_FIGURES: Final = ("accuracy", "repeatability", "systematic", "reversal", "mean_range")


@dataclass(frozen=True, eq=False)
class Positioning:
    """One measured run: deviations and standard uncertainties (n,) rad at angles (n,) rad.

    It gives a range after ISO 230-2 (E of one direction, or of both if both were measured: then
    the angles go up and down again), but no repeatability.
    """

    angles: Floats
    deviation: Floats
    std: Floats

    @property
    def systematic(self) -> float:
        """E, the range of the deviations, rad."""
        return float(np.ptp(self.deviation))

    @property
    def rms(self) -> float:
        """Standard deviation of the deviations around their mean, rad."""
        return float(np.std(self.deviation))

    def to_dict(self) -> dict[str, Any]:
        """Return figures and numbers in degrees and arcseconds."""
        return {
            "systematic_E_arcsec": self.systematic / ARCSEC,
            "rms_arcsec": self.rms / ARCSEC,
            "largest_std_arcsec": float(np.max(self.std)) / ARCSEC,
            "angles_deg": (self.angles / DEGREE).tolist(),
            "deviation_arcsec": (self.deviation / ARCSEC).tolist(),
            "std_arcsec": (self.std / ARCSEC).tolist(),
        }


@dataclass(frozen=True, eq=False)
class Verification:
    """Two measurements of one axis, without and with its correction table.

    ``stated`` (rad) is what the table should leave over. ``iso`` holds ISO 230-2 evaluations of
    the axis itself under "before", "after" and "again", where its true angle is known.
    ``verdict_lines`` are those of the measurements, by the same names. ``again`` is a third one,
    after the findings of the second were added to the table. ``effect`` says how much is left of
    what the table corrects, ``simulated`` that no instrument measured. ``shared`` (rad, k = 1) is
    one and the same error in the first two. ``notes`` say what they cannot show.
    """

    before: Positioning
    after: Positioning
    stated: float
    iso: Mapping[str, Iso230] = field(default_factory=dict)
    verdict_lines: Mapping[str, str] = field(default_factory=dict)
    again: Positioning | None = None
    effect: CorrectionEffect | None = None
    simulated: bool = False
    shared: float = 0.0
    notes: tuple[Phrase, ...] = ()

    @property
    def fault(self) -> str | None:
        """The fault of the table at the control, in words, if it is certain."""
        return None if self.effect is None else self.effect.fault

    @property
    def ratio(self) -> float:
        """How many times smaller E is after the compensation."""
        return self.before.systematic / max(self.after.systematic, 1e-15)

    @property
    def figures(self) -> Phrase:
        """Return E before and after, in words, to the digits of their uncertainties."""
        found = (
            value(run.systematic / ARCSEC, COVERAGE_FACTOR * float(run.std.max()) / ARCSEC)
            for run in (self.before, self.after)
        )
        return phrase(
            "measured E {0} arcsec before, {1} after compensation, {2:.0f} times smaller",
            *(text.lstrip("+") for text in found),
            self.ratio,
        )

    @property
    def expected(self) -> float:
        """Largest deviation (rad) that may be left: both uncertainties and what was stated."""
        squares = float(np.max(self.before.std)) ** 2 + float(np.max(self.after.std)) ** 2
        return AGREEMENT * float(np.sqrt(squares - 2.0 * self.shared**2)) + self.stated

    @property
    def reserves(self) -> tuple[str, ...]:
        """Measurements that are not ok, and what none covers: they may share such an error."""
        lines = {when: split_verdict_line(line) for when, line in self.verdict_lines.items()}
        doubted = (
            phrase("measurement {0}: {1}", phrase(when), words)
            for when, (words, _) in lines.items()
            if not words.startswith("ok")
        )
        uncovered = {when: missing for when, (_, missing) in lines.items() if missing}
        alike = len({missing for _, missing in lines.values()}) == 1
        notes = dict.fromkeys(
            missing if alike else phrase("measurement {0}: {1}", phrase(when), missing)
            for when, missing in uncovered.items()
        )
        return *doubted, *notes, *self.notes

    @property
    def verdict(self) -> Verdict:
        """Ok if no more is left than was expected, and less than before.

        A table that does not act, or acts with the wrong sign, has failed.
        """
        rounds = [self.after] if self.again is None else [self.after, self.again]
        if self.fault or any(run.systematic >= self.before.systematic for run in rounds):
            return "failed"
        return "ok" if all(_left(run) <= self.expected for run in rounds) else "suspect"

    def to_dict(self) -> dict[str, Any]:
        """Return the machine-readable form (degrees and arcseconds)."""
        data: dict[str, Any] = {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "verdict_lines": dict(self.verdict_lines),
            "ratio": self.ratio,
            "stated_residual_arcsec": self.stated / ARCSEC,
            "expected_at_most_arcsec": self.expected / ARCSEC,
            "before": self.before.to_dict(),
            "after": self.after.to_dict(),
        }
        if self.shared:
            data["shared_std_arcsec"] = self.shared / ARCSEC
        if self.notes:
            data["notes"] = list(self.notes)
        if self.effect is not None:
            data["effect"] = {**asdict(self.effect), "words": self.fault or self.effect.describe()}
        if self.again is not None:
            data["again"] = self.again.to_dict()
        if self.iso:
            data["iso230_2_arcsec"] = {
                when: {name: getattr(figures, name) / ARCSEC for name in ISO_FIGURES}
                for when, figures in self.iso.items()
            }
        return data


def _left(run: Positioning) -> float:
    """Return the largest deviation (rad) from the mean of all."""
    return float(np.max(np.abs(run.deviation - np.mean(run.deviation))))


def positioning(result: Result) -> Positioning:
    """Return the ECC deviations of ``result``; DataError when there are none."""
    if "ECC" not in result.deviations:
        raise DataError(f"the {result.method} result holds no ECC: no positioning to verify")
    both = result.directions.get("ECC")
    if both is None:
        return Positioning(result.angles, result.deviations["ECC"], result.std["ECC"])
    up, down = np.split(std_of(both.covariance), 2)
    ways = ((both.angles, both.angles), (both.forward, both.reverse), (up, down))
    return Positioning(*(np.concatenate([rising, falling[::-1]]) for rising, falling in ways))
