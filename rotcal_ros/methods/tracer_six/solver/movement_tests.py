"""What moved between two runs, or between the beginning of a run and its end.

A table that does not repeat deforms the triangle of the places, and so does a machine that stands
elsewhere in the next run; a machine that drifts in all runs alike deforms nothing, and shows only
where an angle is measured again in the same run. Neither may pass for scatter. Both are directions
of the contrasts y of :mod:`.scatter`,

    u = Q y,  the rows of Q spanning  D R,

with the root R of A = R R' and displacements D of the stations: of each later run against the
first one; of later arrivals against the first one at the same place and angle, along the machine's
axes and along the table's; and of a place's stations after a moment along the table's, of all
moments the one that explains most. u ~ N(0, 1 + s_t^2 Q K_t Q' + s_r^2 Q K_r Q') is tested by
chi-squared, with the scatter that the contrasts across all of these directions tell, over its
whole posterior.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from scipy.special import chdtrc

from rotcal_ros.adjust.distributions import chi2_isf, noncentrality
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import HALF_OF_95_PERCENT
from rotcal_ros.foundation.protection import POWER
from rotcal_ros.methods.tracer_six.solver.layout import StationLayout
from rotcal_ros.methods.tracer_six.solver.network import LengthNetwork, relax
from rotcal_ros.methods.tracer_six.solver.patterns import pattern_gradient
from rotcal_ros.methods.tracer_six.solver.posterior import full_covariance, pulled
from rotcal_ros.methods.tracer_six.solver.scatter import (
    ScatterContrasts,
    contrasts,
    estimate,
    stated,
)

Kind = Literal["between runs", "within runs", "slip"]
RANGE: Final = 1e-3
"""Share of the largest singular value from which a direction is told: heights of runs are not."""
LIKELY: Final = 1e-4
"""Share of the largest weight from which a scatter counts."""
REACH: Final = 1e4
"""Mean chi-squared up to which, and beginning with its inverse, a size is looked for."""
BISECTIONS: Final = 16


@dataclass(frozen=True, eq=False)
class Likely:
    """The scatter that contrasts tell: squares ``variances`` (k, 2) with ``weights`` (k,)."""

    variances: Floats
    weights: Floats

    def inverse(self, spread: Floats) -> Floats:
        """Return the inverse covariances (k, r, r) of contrasts with ``spread`` (2, r, r)."""
        noise = np.eye(spread.shape[1]) + np.tensordot(self.variances, spread, 1)
        return np.asarray(np.linalg.inv(noise), dtype=np.float64)

    def tail(self, square: Floats, dof: int) -> Floats:
        """Return how probably chance exceeds ``square`` (..., k), chi-squared of each scatter."""
        return np.asarray(chdtrc(dof, square) @ self.weights, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class MoveTest:
    """The test of one kind of move: ``probability`` of its chi-squared by chance.

    ``places`` (p,), indices of the layout, stand ``moved`` (p, 3) beside where they were, m,
    along the machine's axes, of a slip along the table's. ``directions`` (c, r, q): Q, of each
    moment that was tried.
    """

    kind: Kind
    probability: float
    places: Ints
    moved: Floats
    directions: Floats


@dataclass(frozen=True, eq=False)
class Moves:
    """The tests of a ``network`` without scatter, and the ``contrasts`` that they are of."""

    network: LengthNetwork
    contrasts: ScatterContrasts
    scatter: Likely
    tests: tuple[MoveTest, ...]

    def test(self, kind: Kind) -> MoveTest | None:
        """Return the test of a kind of move, None where the measurement has none."""
        return next((test for test in self.tests if test.kind == kind), None)

    def returned(self) -> float | None:
        """Return within how many m the tracer came back along its circle, 95 %; None: untested.

        At angles measured again in the same run, whatever it is that all places have in common.
        """
        first, later = _pairs(self.network.layout)
        if not len(later):
            return None
        along = tangents(self.network)
        moved = np.zeros_like(along)
        for stations, sign in ((later, 0.5), (first, -0.5)):
            moved[stations] += sign * along[stations]
        shown = moved.ravel() @ self.contrasts.root
        size = float(shown @ shown)
        spread = np.eye(len(shown)) + np.tensordot(
            self.scatter.weights @ self.scatter.variances, self.contrasts.spread, 1
        )
        std = float(np.sqrt(shown @ spread @ shown)) / size
        return abs(float(shown @ self.contrasts.value)) / size + HALF_OF_95_PERCENT * std

    def found_at(self, patterns: Floats, significance: float) -> Floats:
        """Return the sizes (k,) of ``patterns`` (k, V, n), m, that a test finds with POWER."""
        here, root = pattern_gradient(self.network, patterns), self.contrasts.root
        taken = here.slope @ full_covariance(self.network) @ pulled(self.network).T
        left = here.force.reshape(len(patterns), -1) - taken
        moved = left @ (root / (root**2).sum(axis=0))
        sizes = np.full(len(patterns), np.inf)
        for test in self.tests:
            shown = moved @ test.directions.swapaxes(1, 2)  # (c, k, r)
            best = np.argmax((shown**2).sum(axis=2), axis=0)
            for at in np.unique(best).tolist():
                own = test.directions[at]
                here_sizes = self._found(own, shown[at, best == at], significance, len(shown))
                sizes[best == at] = np.minimum(sizes[best == at], here_sizes)
        return sizes

    def _found(self, own: Floats, u: Floats, significance: float, tried: int) -> Floats:
        """Return the sizes (k,) of moves ``u`` (k, r) along ``own`` (r, q) that are found."""
        inverse = self.scatter.inverse(own @ self.contrasts.spread @ own.T)
        square = np.einsum("pi,kij,pj->pk", u, inverse, u)
        dof, alone = len(own), significance / tried
        mean = np.maximum(square @ self.scatter.weights, 1e-300)
        low, high = np.full(len(u), 1.0 / REACH), np.full(len(u), REACH)
        for _ in range(BISECTIONS):
            size = np.sqrt(low * high)
            unseen = self.scatter.tail((size / mean)[:, None] * square, dof) > alone
            low, high = np.where(unseen, size, low), np.where(unseen, high, size)
        margin = noncentrality(alone, POWER, dof) / chi2_isf(alone, dof)
        return np.asarray(np.sqrt(margin * high / mean), dtype=np.float64)


def moves(
    network: LengthNetwork,
    when: Floats,
    known: tuple[float | None, float | None],
    significance: float,
) -> Moves:
    """Return the tests of all moves that ``network`` can show; ``known`` is the stated scatter.

    ``when`` (V,): share of its run that had gone when each station was measured.
    """
    layout = network.layout
    if network.scatter is not None:
        network = relax(network.grid, layout, None, network.state)
    found = contrasts(network, network.state.arms(layout))
    slips, runs = _slips(layout, network.state.rotation, when)
    slip = _best(found, slips)
    asked: tuple[tuple[Kind, Floats, Ints, int], ...] = (
        ("between runs", *_between(layout), 0),
        ("within runs", *_within(layout, network.state.rotation), 0),
        ("slip", slips, runs, slip),
    )
    candidates = [
        (kind, shifts.reshape(len(shifts), -1, len(found.root)) @ found.root, places, best)
        for kind, shifts, places, best in asked
        if len(shifts)
    ]
    scatter = _other_scatter(
        found,
        np.concatenate([shifts[best] for _, shifts, _, best in candidates]),
        known,
        significance,
    )
    return Moves(
        network,
        found,
        scatter,
        tuple(_test(found, scatter, *candidate) for candidate in candidates),
    )


def tangents(network: LengthNetwork) -> Floats:
    """Return the directions (V, 3) along which a turn of the table moves each station."""
    arms = network.state.arms(network.layout)
    across = np.column_stack([-arms[:, 1], arms[:, 0], np.zeros(len(arms))])
    return np.asarray(across / np.linalg.norm(across, axis=1, keepdims=True), dtype=np.float64)


def _best(found: ScatterContrasts, shifts: Floats) -> int:
    """Return which of the displacements (c, d, V, 3) explains most of the contrasts."""
    shown = shifts.reshape(len(shifts), -1, len(found.root)) @ found.root
    explained = [float(((_basis(moment)[0] @ found.value) ** 2).sum()) for moment in shown]
    return int(np.argmax(explained)) if explained else 0


def _basis(shifts: Floats) -> tuple[Floats, Floats]:
    """Return orthonormal rows that span ``shifts`` (d, q), and others that complete them."""
    _, size, basis = np.linalg.svd(shifts)
    rank = int(np.count_nonzero(size > RANGE * max(size[0], np.finfo(np.float64).tiny)))
    return basis[:rank], basis[rank:]


def _other_scatter(
    found: ScatterContrasts,
    shifts: Floats,
    known: tuple[float | None, float | None],
    significance: float,
) -> Likely:
    """Return the scatter that the contrasts across ``shifts`` (d, q) tell."""
    _, other = _basis(shifts)
    if len(other):
        spread = other @ found.spread @ other.T
        others = replace(found, value=other @ found.value, spread=spread)
        scatter = estimate(others, *known, significance)
    else:
        scatter = stated(known[0] or 0.0, known[1] or 0.0)
    likely = scatter.weights > LIKELY * scatter.weights.max()
    weights = scatter.weights[likely]
    return Likely(scatter.variances[likely], weights / weights.sum())


def _test(
    found: ScatterContrasts, scatter: Likely, kind: Kind, shifts: Floats, places: Ints, best: int
) -> MoveTest:
    """Return the test of ``shifts`` (c, d, q), of which ``best`` explains most."""
    bases = [_basis(moment)[0] for moment in shifts]
    rank = min(len(basis) for basis in bases)
    directions = np.stack([basis[:rank] for basis in bases])
    own = directions[best]
    value = own @ found.value
    inverse = scatter.inverse(own @ found.spread @ own.T)
    tail = scatter.tail(np.einsum("i,kij,j->k", value, inverse, value), rank)
    places = places[best : best + 1] if kind == "slip" else places
    # the first three displacements of a place are along the machine's axes
    along = shifts[best, : 3 * len(places)]
    moved = -np.linalg.lstsq(along.T, found.value, rcond=RANGE)[0].reshape(-1, 3)
    return MoveTest(kind, min(1.0, float(tail) * len(shifts)), places, moved, directions)


def _between(layout: StationLayout) -> tuple[Floats, Ints]:
    """Return displacements (1, 3 p, V, 3) of each run but the first along the machine's axes."""
    places = np.arange(1, len(layout.places))
    mine = (layout.place == places[:, None]).astype(np.float64)
    found = np.einsum("pv,ab->pavb", mine, np.eye(3))
    return found.reshape(1, -1, len(layout.place), 3), places


def _within(layout: StationLayout, rotation: Floats) -> tuple[Floats, Ints]:
    """Return displacements (1, 6 p, V, 3) of later arrivals against first ones, and places (p,).

    None where there are none. Along the machine's axes (3 p of them), then along the table's.
    """
    first, later = _pairs(layout)
    places = np.unique(layout.place[later])
    frames = np.stack([np.broadcast_to(np.eye(3), rotation.shape), rotation])
    found = np.zeros((2, len(places), 3, len(layout.position), 3))
    for number, place in enumerate(places.tolist()):
        mine = layout.place[later] == place
        for stations, sign in ((later[mine], 0.5), (first[mine], -0.5)):
            turned = frames[:, layout.position[stations]]  # (2, r, 3, 3)
            for frame in range(2):
                found[frame, number][:, stations] += sign * turned[frame].transpose(2, 0, 1)
    return found.reshape(1, -1, len(layout.position), 3)[: len(places)], places


def _slips(layout: StationLayout, rotation: Floats, when: Floats) -> tuple[Floats, Ints]:
    """Return displacements (c, 3, V, 3) of a place (c,) after a moment, along the table."""
    moved = rotation[layout.position].transpose(2, 0, 1)  # (3, V, 3)
    found, places = [], []
    for place in range(len(layout.places)):
        mine = layout.place == place
        for begins in np.unique(when[mine])[1:].tolist():
            found.append(moved * (mine & (when >= begins))[:, None])
            places.append(place)
    return np.array(found).reshape(-1, 3, len(when), 3), np.array(places, dtype=np.int64)


def _pairs(layout: StationLayout) -> tuple[Ints, Ints]:
    """Return first and later stations (r,) of a place at an angle; arrivals stand in order."""
    seen: dict[tuple[int, int], int] = {}
    keys = zip(layout.place.tolist(), layout.position.tolist(), strict=True)
    first = np.array([seen.setdefault(key, station) for station, key in enumerate(keys)])
    later = np.flatnonzero(first != np.arange(len(first)))
    return first[later], later
