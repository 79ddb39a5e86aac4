"""What protects a tracer result against each effect that could spoil it, and how well.

Drift, knock, scale and refraction are worked out for the measurement at hand, to first order about
its solution. Each is a *pattern*: errors (p, n) of the lengths per unit of its size. It moves the
deviations, and it shows in what the fit cannot take up, in the circle of the stations, and in
closures. The size at which one of these turns the verdict with a probability of POWER is the
*detectable* one.

What does not depend on how a method works this out comes first, for one place of the tracer and
for several: the sizes up to which an effect is searched for, the largest error that stays unseen,
effects of the air, and the statements that both methods make.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.adjust.effects import Unseen
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.protection import Effect, Protection
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE

LARGEST_MOVE: Final = 1e-4
"""Drift or knock (m, or rad times the largest reach) that could not be overlooked."""
LARGEST_RATIO: Final = 1e-3
"""Error of the scale, or of the air's index per metre of height, that could not be missed."""
KNOCKED_AT: Final = (0.25, 0.5, 0.75)
"""Shares of a run after which a knock is tried."""
NOTHING: Final = 1e-150
"""Keeps divisions by what a test does not feel finite; far below any square of a length."""
MOST_PATTERNS: Final = 4_000_000
"""Lengths of all patterns together, 32 MB, up to which each length's influence is stated."""


def stated(
    effect: Effect, worst: Unseen, *, harmless: str, not_protected: str, tested: str
) -> Protection:
    """Return the statement about ``effect`` in the wording of its treatment."""
    treatment = worst.treatment
    why = {"harmless": harmless, "not protected": not_protected, "tested": tested}[treatment]
    return Protection(effect, treatment, why, worst.error if treatment == "tested" else None)


def refracted(distance: Floats, stations: Floats, targets: Floats) -> Floats:
    """Return lengths (1, p, n) by an index of the air that grows by one per metre of height.

    ``distance`` (p, n) between ``stations`` (p, 3) and ``targets`` (n, 3). The index at the mean
    height of a beam is that along it, for it grows linearly.
    """
    height = 0.5 * (stations[:, None, 2] + targets[:, 2])
    return np.asarray(distance * (height - height.mean()))[None]


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
    radius: float,
    *,
    alike: str,
    of: str = "",
    beside: str = "",
    within: float | None,
    shown: str,
    untested: str,
) -> Protection:
    """Return the statement about a tracer that moves along its circle between the angles.

    All its lengths are those of a table that turned further: none can show it, and an angle that
    was measured again bounds only what does not come back with the angle. ``radius`` (m) of the
    circle; ``alike``: what else looks like it, ``of`` which deviation the angle is, ``beside``:
    what else is said. ``within`` (m): how near the tracer came back, 95 %, as ``shown``; None:
    that is ``untested``.
    """
    why = (
        f"a tracer that mount or cable shift along its circle between the angles{alike} leaves no "
        f"trace in any length: 1 um of it is {MICROMETRE / radius / ARCSEC:.2f} arcsec{of}"
    )
    bound = (
        "no angle was measured again, which would bound what of it does not come back with "
        f"{untested}"
    )
    if within is not None:
        bound = (
            f"what of it does not come back with the angle is less than {within / MICROMETRE:.2g} "
            f"um, {within / radius / ARCSEC:.2g} arcsec (95 %, {shown})"
        )
    why = "; ".join(filter(None, (why, beside, bound)))
    return Protection("tangential motion", "not protected", why)
