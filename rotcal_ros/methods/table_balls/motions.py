"""What is stated of the table's motions: their sizes, and the orders in which they move.

The balls do not determine all motions at an angle; for those the statement stands. It is weighed
as if each angle moved by itself, so that it leads nothing astray; what it does to the uncertainty
follows from the orders. Of orders that nobody states, each alone and white motion are held to be
possible, and every output keeps the worst: one in a low order, as those of real axes are, is the
same witness at every angle, and passes for an axis that stands or leans elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from rotcal_ros.adjust.distributions import chi2_sf, noise_growth
from rotcal_ros.adjust.engine import LIMITS
from rotcal_ros.adjust.error_motion import WHITE, Correlated, Spectrum
from rotcal_ros.adjust.fit import Fit
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.protection import POWER
from rotcal_ros.methods.table_balls.settings import (
    FALLING,
    STATED,
    WHITE_ONLY,
    BallsSolverSettings,
)

MOTION_KINDS: Final = {"radial": (0, 1), "axial": (2,), "tilt": (3, 4)}
"""Motions of one kind by their numbers among the six: EXC and EYC, EZC, EAC and EBC."""
LOWEST: Final = {"radial": 2, "axial": 1, "tilt": 2}
"""Lowest order that is no part of the definition of the axis, but for what EXC and EYC, or EAC and
EBC, have of the first order against the turn."""


FACTORS: Final = np.geomspace(0.05, 1000.0, 80)
"""Sizes of motions, per stated, that are tried."""
SILENT: Final = 1e-9
"""Share of the largest variance of what is shown below which another is none."""
RANGES: Final = tuple((low, high) for low in (1, 2) for high in (3, 4, 6, 10))
"""Lowest and highest orders of motions that have several alike."""


def spectra(solver: BallsSolverSettings) -> dict[str, tuple[Spectrum, ...]]:
    """Return the spectra that are possible of each kind of motion."""
    sizes = {
        "radial": solver.radial_orders, "axial": solver.axial_orders, "tilt": solver.tilt_orders
    }  # fmt: skip
    if solver.error_motion_orders == WHITE_ONLY:
        return dict.fromkeys(MOTION_KINDS, (WHITE,))
    if solver.error_motion_orders == FALLING:
        return {kind: (Spectrum.falling(LOWEST[kind]),) for kind in MOTION_KINDS}
    if solver.error_motion_orders == STATED:
        return {kind: (Spectrum.of_sizes(sizes[kind]),) for kind in MOTION_KINDS}
    alike = [
        Spectrum.of_sizes([0.0, *[1.0] * (h - 1)] if a == 2 else [1.0] * h) for a, h in RANGES
    ]
    every = (*Spectrum.one_each(), *alike, Spectrum.falling(1), Spectrum.falling(2))
    return dict.fromkeys(MOTION_KINDS, every)


def ways(spectrum: Spectrum, angles: Floats, tilts: int) -> Iterator[Floats]:
    """Yield columns (t p, r) of a motion of size 1 at the ``angles`` (p,) of all ``tilts``.

    Of its own at every tilt and, in orders, the same at all: what a bearing does when it turns
    does not know how it lies.
    """
    once = spectrum.root(angles)
    yield np.asarray(np.kron(np.eye(tilts), once), dtype=np.float64)
    if tilts > 1 and spectrum.orders:
        yield np.tile(once, (tilts, 1))


def drawn(
    sums: Floats,
    stated: Floats,
    angles: Floats,
    tilts: int,
    possible: Mapping[str, tuple[Spectrum, ...]],
) -> dict[str, tuple[Floats, ...]]:
    """Return columns (6 t p, r) of motions of each kind in each possible way, m and rad.

    ``sums`` (d, 6 t p): what is zero by definition; ``stated`` (6,): sizes of the motions.
    """
    basis, count = np.linalg.qr(sums.T)[0], tilts * len(angles)

    def placed(kind: str, way: Floats) -> Floats:
        found = np.zeros((6, count, len(MOTION_KINDS[kind]), way.shape[1]))
        for k, number in enumerate(MOTION_KINDS[kind]):
            found[number, :, k] = stated[number] * way
        flat = found.reshape(6 * count, -1)
        return np.asarray(flat - basis @ (basis.T @ flat))

    return {
        kind: tuple(
            placed(kind, way) for spectrum in each for way in ways(spectrum, angles, tilts)
        )
        for kind, each in possible.items()
    }


def correlated(rows: Floats, moves: Mapping[str, tuple[Floats, ...]]) -> Correlated:
    """Return what the errors of statements have in common, the first rows of their model.

    ``rows`` (k, 6 t p): what each statement takes of the motions, per standard deviation;
    ``moves``: what :func:`drawn` returns.
    """
    parts = tuple(tuple(rows @ way for way in each) for each in moves.values())
    return Correlated(np.arange(len(rows)), parts)


class Contradiction(NamedTuple):
    """Motions of a ``kind`` are ``factor`` times as large as stated, with this ``probability``.

    That is: how probably they are what is shown, were the statement true.
    """

    kind: str
    factor: float
    probability: float


def contradictions(
    fit: Fit, stated: Floats, moves: Mapping[str, tuple[Floats, ...]], first: int
) -> Iterator[Contradiction]:
    """Yield of each kind of motion how what is shown of it fits its statement.

    ``first``: where the motions are among the unknowns; ``stated`` (6,), ``moves`` as above. Each
    way to move is weighed by how well it fits at the size that suits it best; the rest of its
    directions, which noise rules, say nothing.
    """
    for kind, white, value, ways in _shown(fit, stated, moves, first):
        yield _contradiction(kind, white @ value, [white @ way for way in ways])


def found_from(
    fit: Fit, stated: Floats, moves: Mapping[str, tuple[Floats, ...]], first: int
) -> Iterator[Floats]:
    """Yield of each kind of motion how many times (w,) as large as stated each way is found.

    With a probability of POWER by :func:`contradictions`, whose arguments these are; infinite
    where no reading shows it.
    """
    each = LIMITS.significance / len(MOTION_KINDS)
    for _, white, _, ways in _shown(fit, stated, moves, first):
        rules = [int((np.linalg.svd(white @ way, compute_uv=False) > 1.0).sum()) for way in ways]
        yield np.array([np.sqrt(noise_growth(each, POWER, n)) if n else np.inf for n in rules])


def _shown(
    fit: Fit, stated: Floats, moves: Mapping[str, tuple[Floats, ...]], first: int
) -> Iterator[tuple[str, Floats, Floats, list[Floats]]]:
    """Yield each kind, what makes the noise in its motions white (k, m), these (m,), its ways."""
    (together,) = fit.model.correlated
    count = next(iter(moves.values()))[0].shape[0] // 6
    scale = np.repeat(stated, count)
    gain = fit.gain(slice(first, first + 6 * count)) / scale[:, None]
    value = fit.x[first : first + 6 * count] / scale
    noise = np.delete(gain, together.rows, axis=1)
    per_way = [
        np.concatenate([
            way / scale[:, None] - gain[:, together.rows] @ root
            for way, root in zip(both, roots, strict=True)
        ], axis=1)
        for both, roots in zip(zip(*moves.values(), strict=True),
                               zip(*together.parts, strict=True), strict=True)
    ]  # fmt: skip
    for kind, numbers in MOTION_KINDS.items():
        own = np.isin(np.repeat(np.arange(6), count), numbers)
        size, axes = np.linalg.eigh(noise[own] @ noise[own].T)
        kept = size > SILENT * max(size[-1], np.finfo(np.float64).tiny)
        white = (axes[:, kept] / np.sqrt(size[kept])).T
        yield kind, white, value[own], [way[own] for way in per_way]


def _contradiction(kind: str, value: Floats, ways: Sequence[Floats]) -> Contradiction:
    """Return how a ``value`` (m,) fits each of the ways (m, r), both with white noise of 1."""
    merit, chance, factor = np.zeros((3, len(ways)))
    for k, way in enumerate(ways):
        along, single, _ = np.linalg.svd(way, full_matrices=False)
        squares, grown = (along.T @ value) ** 2, single**2
        ruled = 1.0 + np.multiply.outer(FACTORS**2, grown)
        fits = -0.5 * (np.log(ruled) + squares / ruled - squares).sum(axis=1)
        merit[k], factor[k] = fits.max(), FACTORS[fits.argmax()]
        rules = grown > 1.0
        chance[k] = (
            chi2_sf(float((squares / (1.0 + grown))[rules].sum()), int(rules.sum()))
            if (rules.any())
            else 1.0
        )
    weight = np.exp(merit - merit.max())
    weight /= weight.sum()
    size_of = float(np.sqrt(weight @ factor**2))
    return Contradiction(kind, size_of, float(weight @ chance))
