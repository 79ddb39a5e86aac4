"""What a plan would give, and what its verdict could not exclude, before it is measured."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from rotcal_ros.foundation.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.protection import Effect
from rotcal_ros.methods.calibration import Calibration, prepare

SEED: Final = 1
"""Seed of the measurement that is drawn; what is said does not depend on it."""


@dataclass(frozen=True)
class Prospect:
    """Largest standard uncertainty of each component (m, rad), and what nothing would test.

    ``change``: what is added to the plan; empty: nothing.
    """

    change: str
    std: Mapping[str, float]
    untested: tuple[Effect, ...]

    @classmethod
    def of(cls, calibration: Calibration, change: str = "") -> Prospect:
        """Return that of a plan, by one measurement of it with its stated noise."""
        alone = calibration.of_distances
        result = alone.solve(alone.measured({}, SEED).observations)
        std = {name: float(result.std[name].max()) for name in result.components}
        return cls(change, std, result.unprotected)

    def in_words(self, before: Prospect) -> str:
        """Return it for people; of more than the plan, what is better than ``before``."""
        expanded = ", ".join(
            f"U({name}) {COVERAGE_FACTOR * std / unit_of(name)[0]:.2g} {unit_of(name)[1]}"
            for name, std in self.std.items()
        )
        if not self.change:
            return f"{expanded}; not tested for: {', '.join(self.untested) or 'nothing'}"
        more = [effect for effect in before.untested if effect not in self.untested]
        return f"with {self.change}: {expanded}; then tested for: {', '.join(more) or 'no more'}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON."""
        return {"change": self.change, "std": dict(self.std), "not_tested_for": self.untested}


def prospects(calibration: Calibration) -> Iterator[Prospect]:
    """Yield that of the plan, and that with what would help most, where the method knows it."""
    if calibration.method.disturbances is None:
        return
    yield Prospect.of(calibration)
    find = calibration.method.one_more
    if find is not None and (better := find(calibration.configuration)) is not None:
        change, configuration = better
        yield Prospect.of(prepare(configuration), change)
