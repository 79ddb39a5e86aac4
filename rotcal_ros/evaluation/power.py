"""From which size on an effect turns the verdict, and what it does to a result up to there.

A *trial* measures once, with an effect of a size, and tells whether that was noticed and what it
did. The size that is noticed with a wanted probability is bracketed by doubling and halved from
there; between the last two sizes the probability is interpolated as a probit of the logarithm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import exp, log
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import normal_isf
from rotcal_ros.arrays import Floats
from rotcal_ros.protection import POWER

FACTOR: Final = 2.0
"""From one size to the next while the search is for a bracket."""
HALVINGS: Final = 2
"""How often the bracket is halved (in the logarithm); then it is 19 % wide."""
GLANCE: Final = 20
"""Trials after which a size is given up that is noticed far too seldom, or always."""
SELDOM: Final = 0.6
ENOUGH: Final = 3
"""Unnoticed trials from which an error can be told."""


@dataclass(frozen=True)
class Trial:
    """One measurement with an effect: ``error`` (n,) is its part in the deviations, in their std.

    None where there is no result.
    """

    noticed: bool
    error: Floats | None


Try = Callable[[float, int], Trial]
"""``attempt(size, number)``: the trial of a size with the number's own noise."""


@dataclass(frozen=True)
class Share:
    """How many trials of a size were noticed; ``error`` is the largest rms error of the others.

    Over the trials of which nobody noticed anything, at the worst of all angles and components,
    in stated standard uncertainties; None with fewer than ENOUGH of them.
    """

    size: float
    trials: int
    noticed: int
    error: float | None

    @property
    def probability(self) -> float:
        """The share, with half a trial in doubt on either side so that it has a probit."""
        return (self.noticed + 0.5) / (self.trials + 1.0)


@dataclass(frozen=True)
class Found:
    """The outcome of a search.

    ``size`` is noticed with the wanted probability; where none up to the largest was,
    ``reached`` is False and ``size`` that one. ``error`` is what an unnoticed effect of that size
    does, in stated standard uncertainties.
    """

    size: float
    reached: bool
    error: float
    shares: tuple[Share, ...]


def search(attempt: Try, start: float, largest: float, runs: int, power: float = POWER) -> Found:
    """Return from which size up to ``largest`` an effect is noticed with probability ``power``.

    ``runs`` trials decide about a size. The largest is tried first: an effect that is not even
    noticed there needs no search, which else begins at ``start``. The probability is taken to
    grow with the size.
    """
    below: Share | None = None
    above: Share | None = None
    shares: list[Share] = []

    def look(size: float) -> None:
        nonlocal below, above
        share = share_of(attempt, size, runs)
        shares.append(share)
        if share.noticed / share.trials >= power:
            above = share
        else:
            below = share

    look(largest)
    if above is None:
        return Found(largest, False, _error_at(largest, shares), tuple(shares))
    below = above = None
    look(min(start, largest))
    while above is None and below is not None:
        look(min(FACTOR * below.size, largest))
    assert above is not None  # at the latest at the largest size
    while below is None and above.size > 1e-6 * start:
        look(above.size / FACTOR)
    if below is None:  # noticed even where there is next to nothing: a verdict that is never ok
        return Found(above.size, True, 0.0, tuple(shares))
    for _ in range(HALVINGS):
        look(exp(0.5 * (log(below.size) + log(above.size))))
    size = _between(below, above, power)
    return Found(size, True, _error_at(size, shares), tuple(shares))


def share_of(attempt: Try, size: float, runs: int) -> Share:
    """Try a size ``runs`` times, fewer where it is clear that it is noticed too seldom."""
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
    return Share(size, number, noticed, _largest_rms(errors))


def _largest_rms(errors: list[Floats]) -> float | None:
    if len(errors) < ENOUGH:
        return None
    square: Floats = np.mean(np.square(np.array(errors)), axis=0)
    return float(np.sqrt(square.max(initial=0.0)))


def _between(below: Share, above: Share, power: float) -> float:
    """Return the size of probability ``power`` between two that enclose it."""
    low, high = (-normal_isf(share.probability) for share in (below, above))
    wanted = -normal_isf(power)
    part = float(np.clip((wanted - low) / (high - low), 0.0, 1.0)) if high > low else 1.0
    return exp((1.0 - part) * log(below.size) + part * log(above.size))


def _error_at(size: float, shares: list[Share]) -> float:
    """Return the error of an unnoticed effect of ``size``: in proportion to the nearest known.

    inf where no size left enough trials unnoticed.
    """
    known = [share for share in shares if share.error is not None]
    if not known:
        return float("inf")
    nearest = min(known, key=lambda share: abs(log(share.size / size)))
    assert nearest.error is not None
    return nearest.error * size / nearest.size
