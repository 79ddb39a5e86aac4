"""What is known of a table that turned beside its deviations: lag, noise in time, vibration."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust.engine import Adjusted
from rotcal_ros.foundation.arrays import Ints
from rotcal_ros.foundation.language import Phrase, noted, phrase
from rotcal_ros.foundation.protection import Protection
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE
from rotcal_ros.methods.tracer.solver.carried_lengths import LAG, CarriedLengths
from rotcal_ros.methods.tracer.solver.turning import (
    TimeCorrelatedLengths,
    TurningRuns,
    series_of,
)
from rotcal_ros.methods.tracer.solver.vibration import Line, vibration_lines

VIBRATES: Final = noted(
    "the lengths hold a line at order {0:.4g} ({1:.3g} Hz) of {2:.2g} um at {3:g} deg/s, which no "
    "noise explains: were it as large along the tracer's circle, ECC would hold {4:.2g} arcsec of "
    "it"
)


@dataclass(frozen=True, eq=False)
class TurningReport:
    """What is known of the turns of solved ``lengths``; nothing of a table that stood.

    ``again`` (k,): how often the pair of each was measured before. ``noise`` in time, if any.
    """

    lengths: CarriedLengths
    again: Ints
    found: Adjusted
    noise: TimeCorrelatedLengths | None

    @cached_property
    def lines(self) -> tuple[Line, ...]:
        """The lines in what the lengths leave over, the largest ones."""
        lengths, k = self.lengths, len(self.lengths.row)
        if lengths.speed is None:
            return ()
        # weighed by noise in time, both directions leave the same differently
        fit = self.found.fit if self.noise is None else self.noise.first
        left = np.where(fit.used[:k], fit.residual[:k], np.nan)
        return vibration_lines(lengths, series_of(lengths, self.again), left, fit.redundancy[:k])

    def remarks(self, lag: float | None, radius: float) -> Iterator[Phrase]:
        """Yield what is left open, how the noise hangs together in time, and the largest line.

        ``lag`` (s) as stated; ``radius`` (m) of the tracer's circle.
        """
        if self.lengths.speed is None:
            return
        speeds = TurningRuns.of(self.lengths).speed
        if lag is None and len(speeds) == 2 and speeds.prod() < 0.0:
            yield phrase(
                "the mean reversal is zero by definition: at one speed and back nothing tells it "
                "from the lag of the table's feedback; turn at a second speed, or state "
                "solver.lag_s"
            )
        if self.noise is not None:
            shares = {each.independent: None for each in self.noise.noise}
            words = ", ".join(f"{100.0 * share:.0f} %" for share in shares)
            yield phrase(
                "the noise of the lengths is correlated from angle to angle: for what changes "
                "slowly with it they count as {0} of their number", words
            )  # fmt: skip
        for line in self.lines[:1]:
            yield phrase(
                VIBRATES, line.order, line.frequency, line.amplitude / MICROMETRE,
                line.speed / DEGREE, line.amplitude / radius / ARCSEC
            )  # fmt: skip

    def protections(self) -> Iterator[Protection]:
        """Yield what is done about a lag of the feedback."""
        if self.lengths.speed is not None:
            why = phrase(
                "a late feedback turns all angles of a speed alike: how late it is, or the mean "
                "reversal beside it, is found with the deviations"
            )
            yield Protection("lag", "estimated", why)

    def details(self) -> dict[str, Any]:
        """Return speeds (r,) rad/s, noise in time, the lag (s), and the lines.

        ``autoregression``: coefficients of each run, on the lengths of the angles before;
        ``independent``: the share of them that counts for slow changes.
        """
        fit = self.found.fit
        if self.lengths.speed is None:
            return {}
        at = self.lengths.first[LAG]
        variance = float(fit.kernel.times(np.eye(1, len(fit.x), at).T)[at, 0])
        each = [] if self.noise is None else self.noise.noise
        return {
            "turning": {
                "speeds": TurningRuns.of(self.lengths).speed,
                "lag": float(fit.x[at]),
                "lag_std": self.found.scale * float(np.sqrt(variance)),
                "autoregression": [run.ahead[-1] for run in each],
                "independent": [run.independent for run in each],
                "lines": [asdict(line) for line in self.lines],
            }
        }
