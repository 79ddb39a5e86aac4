"""What spoils a network of lengths, and in which words it is said: for one place and for several.

Each method works out what an effect does to its own result, and at which size its own tests find
it. Here is what does not depend on that: the sizes up to which an effect is looked for, the
largest error that stays unseen, effects of the air, and the statements that both methods make.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import chi2_isf
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.protection import POWER, Effect, Protection
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE

LARGEST_MOVE: Final = 1e-4
"""Drift or knock (m, or rad times the largest reach) that nobody would overlook."""
LARGEST_RATIO: Final = 1e-3
"""Error of the scale, or of the air's index per metre of height, that nobody would overlook."""
HARMLESS: Final = 0.1
"""Error, in standard uncertainties, of what cannot be told from nothing."""
KNOCKED_AT: Final = (0.25, 0.5, 0.75)
"""Shares of a run after which a knock is tried."""
NOTHING: Final = 1e-150
"""Keeps divisions by what a test does not feel finite; far below any square of a length."""
MOST_PATTERNS: Final = 4_000_000
"""Lengths of all patterns together, 32 MB, up to which each length's influence is told."""


@dataclass(frozen=True, slots=True)
class Worst:
    """The largest error that may stay unseen, in standard uncertainties; ``seen``: no larger."""

    error: float
    seen: bool

    @classmethod
    def of(cls, detectable: Floats, share: Floats, largest: float) -> Worst:
        """Return the worst of k patterns, none of which is larger than ``largest``.

        ``detectable`` (k,): size that a test finds; ``share`` (k,): error per unit of size, in
        standard uncertainties.
        """
        error = np.minimum(detectable, largest) * share
        k = int(np.argmax(error))
        return cls(float(error[k]), bool(detectable[k] <= largest))

    def stated(self, effect: Effect, harmless: str, unseen: str, seen: str) -> Protection:
        """Return the statement about ``effect``, in one of three wordings."""
        if self.error <= HARMLESS:
            return Protection(effect, "harmless", harmless)
        if not self.seen:
            return Protection(effect, "not protected", unseen)
        return Protection(effect, "tested", seen, self.error)


def share_gone(order: Ints) -> Floats:
    """Return which share (k,), 0 to 1, of the lengths had been taken when each was."""
    share = np.empty(len(order))
    share[np.argsort(order, kind="stable")] = np.linspace(0.0, 1.0, len(order))
    return share


def refracted(distance: Floats, stations: Floats, targets: Floats) -> Floats:
    """Return lengths (1, p, n) by an index of the air that grows by one per metre of height.

    ``distance`` (p, n) between ``stations`` (p, 3) and ``targets`` (n, 3). The index at the mean
    height of a beam is that along it, for it grows linearly.
    """
    height = 0.5 * (stations[:, None, 2] + targets[:, 2])
    return np.asarray(distance * (height - height.mean()))[None]


def found_growth(significance: float, dof: int) -> float:
    """Return how many times its variance noise has to be for chi-squared to show it with POWER."""
    return float(chi2_isf(significance, dof) / chi2_isf(POWER, dof))


def noise_protection(error: float) -> Protection:
    """Return the statement about components of the noise that are larger than stated."""
    return Protection(
        "axis noise",
        "tested",
        "the noise of lengths and of the targets' x, y and z is tested apart, and estimated where "
        "the statement does not hold",
        error,
    )


def tangential_protection(
    radius: float, *, alike: str, beside: str, within: float | None, shown: str, untested: str
) -> Protection:
    """Return the statement about a tracer that moves along its circle between the angles.

    All its lengths are those of a table that turned further: none can show it, and an angle that
    was measured again bounds only what does not come back with the angle. ``radius`` (m) of the
    circle; ``alike``: what else looks like it, ``beside``: what is said beside. ``within`` (m):
    how near the tracer came back, 95 %, as ``shown``; None: that is ``untested``.
    """
    why = (
        f"a tracer that mount or cable shift along its circle between the angles{alike} leaves no "
        f"trace in any length: 1 um of it is {MICROMETRE / radius / ARCSEC:.2f} arcsec{beside}"
    )
    bound = "no angle was measured again, which would bound what of it does not come back with "
    bound += untested
    if within is not None:
        bound = (
            f"what of it does not come back with the angle is less than {within / MICROMETRE:.2g} "
            f"um, {within / radius / ARCSEC:.2g} arcsec (95 %, {shown})"
        )
    return Protection("tangential motion", "not protected", f"{why}; {bound}")
