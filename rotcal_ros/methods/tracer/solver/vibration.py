"""Lines in what a table that turns leaves of its lengths: a vibration, or what comes by angle.

What the model does not hold is smooth noise, however it is correlated, and lies between the
orders as it lies at them. So the power of an order, summed over the turns of one speed, is
compared with the median of its neighbours: the ratio follows F if there is no line. Orders below
FIRST are not looked at: targets and zeros take them up.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.adjust.distributions import f_sf
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.methods.tracer.solver.carried_lengths import CarriedLengths
from rotcal_ros.methods.tracer.solver.turning import TurningRuns

FIRST: Final = 3
"""The lowest order that may be a line."""
AROUND: Final = 8
"""How many orders on each side show how large the noise is."""
SIGNIFICANCE: Final = 0.01
"""Chance of a line where there is none, of all orders and speeds together."""
LEAKS: Final = 2
"""So near to a larger line, in orders, another is part of it."""
EVEN: Final = 0.01
"""By how much of their mean the steps between the angles may differ."""
MOST: Final = 5
"""Lines that are named, the largest ones."""
_MEDIAN_WORTH: Final = 0.64
"""Share of independent values that a mean would need to be as good as the median of them all."""

_Spectra = dict[int, NDArray[np.complex128]]
"""Of each run, turn by order."""


@dataclass(frozen=True)
class Line:
    """A line at an ``order`` (per turn) of the lengths read at a ``speed``, rad/s.

    ``amplitude`` (m): root mean square over the turns; ``frequency``, Hz. ``likeness``: 1 where
    both directions show it at the same angles, near 0 where it comes at its own time, None where
    one direction alone was measured.
    """

    speed: float
    order: float
    frequency: float
    amplitude: float
    likeness: float | None


def vibration_lines(
    lengths: CarriedLengths, series: Ints, residual: Floats, redundancy: Floats
) -> tuple[Line, ...]:
    """Return the largest lines in residuals (k,), m, that are nan where none counts.

    ``series`` (k,): which lengths are of one target, of those that were measured as often before.
    """
    runs, spectra, spacing = TurningRuns.of(lengths), _Spectra(), dict[int, float]()
    whole = np.full((int(series.max()) + 1, len(lengths.angles)), np.nan)
    whole[series, lengths.position] = residual
    share = float(redundancy.mean())
    for run in range(len(runs.speed)):
        mine = np.flatnonzero(runs.number == run)
        mine = mine[np.argsort(lengths.angles[mine])]
        steps = np.diff(lengths.angles[mine])
        if len(mine) < 2 * (FIRST + AROUND) or np.ptp(steps) > EVEN * steps.mean():
            continue
        each = whole[:, mine]
        each = each[np.isfinite(each).sum(axis=1) > len(mine) // 2]
        if not len(each):
            continue
        spectra[run] = 2.0 / len(mine) * np.fft.rfft(np.nan_to_num(each), axis=1)[:, :-1]
        spacing[run] = 2.0 * np.pi / (len(mine) * float(steps.mean()))
    tests = sum(spectrum.shape[1] - FIRST for spectrum in spectra.values())
    found = list[Line]()
    for run, spectrum in spectra.items():
        power = (np.abs(spectrum) ** 2).sum(axis=0)
        for order in _standing_out(power, 2.0 * share * len(spectrum), SIGNIFICANCE / tests):
            turns = order * spacing[run]
            found.append(
                Line(
                    float(runs.speed[run]),
                    turns,
                    turns * abs(float(runs.speed[run])) / (2.0 * np.pi),
                    float(np.sqrt(power[order] / len(spectrum))),
                    _likeness(spectra, runs, run, order),
                )
            )
    return tuple(sorted(found, key=lambda line: -line.amplitude)[:MOST])


def _standing_out(power: Floats, dof: float, significance: float) -> Iterator[int]:
    """Yield the orders whose ``power`` (h,), of ``dof`` degrees of freedom, is no noise's."""
    usual = (1.0 - 2.0 / (9.0 * dof)) ** 3  # Wilson and Hilferty: median of chi squared by dof
    taken = list[int]()
    for order in np.argsort(-power).tolist():
        if order < FIRST or any(abs(order - other) <= LEAKS for other in taken):
            continue
        near = np.arange(max(order - AROUND, FIRST), min(order + AROUND + 1, len(power)))
        near = near[near != order]
        level = float(np.median(power[near])) / usual
        if f_sf(float(power[order]) / level, dof, _MEDIAN_WORTH * len(near) * dof) < significance:
            taken.append(order)
            yield order


def _likeness(spectra: _Spectra, runs: TurningRuns, run: int, order: int) -> float | None:
    """Return the correlation of an order with that of the same speed the other way."""
    for other in np.flatnonzero(runs.speed == -runs.speed[run]).tolist():
        if other in spectra and spectra[other].shape == spectra[run].shape:
            a, b = spectra[run][:, order], spectra[other][:, order]
            return float(np.vdot(b, a).real / (np.linalg.norm(a) * np.linalg.norm(b)))
    return None
