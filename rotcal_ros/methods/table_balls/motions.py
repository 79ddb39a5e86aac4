"""What is stated of the table's motions: their sizes, and the orders in which they move.

The balls do not determine all motions at an angle; for those the statement stands. It is weighed
as if each angle moved by itself, so that it leads nothing astray; what it does to the uncertainty
follows from the orders. Of orders that nobody states, each alone and white motion are held to be
possible, and every output keeps the worst: one in a low order, as those of real axes are, is the
same witness at every angle, and passes for an axis that stands or leans elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from rotcal_ros.adjust.error_motion import WHITE, Correlated, Spectrum
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.methods.table_balls.settings import (
    FALLING,
    STATED,
    WHITE_ONLY,
    BallsSolverSettings,
)

KINDS: Final = {"radial": (0, 1), "axial": (2,), "tilt": (3, 4)}
"""Motions of one kind by their numbers among the six: EXC and EYC, EZC, EAC and EBC."""
LOWEST: Final = {"radial": 2, "axial": 1, "tilt": 2}
"""Lowest order that is no part of the definition of the axis, but for what EXC and EYC, or EAC and
EBC, have of the first order against the turn."""


def spectra(solver: BallsSolverSettings) -> dict[str, tuple[Spectrum, ...]]:
    """Return the spectra that are possible of each kind of motion."""
    sizes = {
        "radial": solver.radial_orders, "axial": solver.axial_orders, "tilt": solver.tilt_orders
    }  # fmt: skip
    if solver.error_motion_orders == WHITE_ONLY:
        return dict.fromkeys(KINDS, (WHITE,))
    if solver.error_motion_orders == FALLING:
        return {kind: (Spectrum.falling(LOWEST[kind]),) for kind in KINDS}
    if solver.error_motion_orders == STATED:
        return {kind: (Spectrum.of_sizes(sizes[kind]),) for kind in KINDS}
    return dict.fromkeys(KINDS, tuple(Spectrum.one_each()))


def ways(spectrum: Spectrum, angles: Floats, tilts: int) -> Iterator[Floats]:
    """Yield columns (t p, r) of a motion of size 1 at the ``angles`` (p,) of all ``tilts``.

    Of its own at every tilt and, in orders, the same at all: what a bearing does when it turns
    does not know how it lies.
    """
    once = spectrum.root(angles)
    yield np.asarray(np.kron(np.eye(tilts), once), dtype=np.float64)
    if tilts > 1 and spectrum.orders:
        yield np.tile(once, (tilts, 1))


def correlated(
    rows: Floats,
    sums: Floats,
    stated: Floats,
    angles: Floats,
    tilts: int,
    possible: dict[str, tuple[Spectrum, ...]],
) -> Correlated:
    """Return what the errors of statements have in common.

    ``rows`` (k, 6 t p): what each statement takes of the motions, per standard deviation; they
    are the first k of their model. ``sums`` (d, 6 t p): what is zero by definition; ``stated``
    (6,): sizes of the motions, m and rad.
    """
    basis = np.linalg.qr(sums.T)[0]
    rows = rows - (rows @ basis) @ basis.T
    of_motion = rows.reshape(len(rows), 6, tilts * len(angles)) * stated[:, None]
    parts = tuple(
        tuple(
            np.concatenate([of_motion[:, number] @ way for number in KINDS[kind]], axis=1)
            for spectrum in each
            for way in ways(spectrum, angles, tilts)
        )
        for kind, each in possible.items()
    )
    return Correlated(np.arange(len(rows)), parts)
