"""How differently the table arrives at the same angle: scatter from run to run.

A run sees one place only, so what moves the table between runs deforms the triangle of the places.
What the rigid network leaves of the stations, the *contrasts*, are as many as stations have
coordinates beyond poses and places. With the network solved without scatter, b = U' W f holds
them: b ~ N(0, A + A G A), A = U' W U - U' W J C J' W U, where G is the covariance of the scatter,
block by block

    S = s_t^2 + s_r^2 [a]x [a]x',      a: the station seen from the point of the axis at z = 0.

In the range of A this is y ~ N(0, 1 + s_t^2 K_t + s_r^2 K_r). This likelihood, free of mean and of
nuisance, is the restricted likelihood of all lengths. Three dozen contrasts do not say much about
two variances, so their whole posterior is used: none at all, and every size x of scatter, times
every share of turns in it. Arrivals of one run at one angle are contrasts in all three directions.

The prior was set by simulation, for 12 angles, 24 targets and places at 0, 120 and 240 degrees at
r = 150 mm: there 95 % intervals hold 93 to 97.5 %, for every size of scatter that was tried. With
more angles they hold less (docs/tracer_six.md). x^4 / (1 + x^6) vanishes at zero, so that "none"
and "some" stay apart and contrasts that show nothing cost little. Turns alone weigh most, for they
move the curves as much as shifts do and leave half the trace: at z = 0, tilts move no distance
between places.

Stations are weighed as if an estimated scatter were the same in all directions: which share of it
turns have is hardly known, and weights that rely on it promise more than they keep. With the
weights fixed, the variance of a curve is linear in s_t^2 and s_r^2; its standard deviation is the
one with which +-1.96 of it hold 95 % of what is predicted, Student's t in spirit.

The same contrasts show what *moved*: a machine that stands elsewhere in the next run deforms the
triangle of the places as a table does that does not repeat; a machine that drifts in all runs
alike deforms nothing, and shows only where an angle is measured again in the same run. Neither may
pass for scatter. Both are directions of the contrasts y,

    u = Q y,  the rows of Q spanning  D R,

with the root R of A = R R' and displacements D of the stations: of each later run against the
first one; of later arrivals against the first one at the same place and angle, along the machine's
axes and along the table's; and of a place's stations after a moment along the table's, of all
moments the one that explains most. u ~ N(0, 1 + s_t^2 Q K_t Q' + s_r^2 Q K_r Q') is tested by
chi-squared, with the scatter that the contrasts across all of these directions show, over its
whole posterior.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from scipy.special import chdtrc, erfc

from rotcal_ros.adjust.distributions import chi2_isf, chi2_sf, noncentrality
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import HALF_OF_95_PERCENT
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.foundation.protection import POWER
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.geometry.rotations import cross_matrix
from rotcal_ros.methods.tracer_six.solver.network import (
    LengthNetwork,
    full_covariance,
    pattern_gradient,
    pulled,
    relax,
)
from rotcal_ros.methods.tracer_six.solver.problem import StationLayout

OUTSIDE: Final = 0.05
"""Probability that the interval misses what is predicted."""
ABSENT: Final = 0.2
"""Prior probability of no scatter."""
LEVELS: Final = np.concatenate([np.arange(0.1, 2.0, 0.1), 2.0 * 1.08 ** np.arange(111)])
"""Sizes of scatter x, 1 of which doubles the variance of a contrast on average."""
DENSITY: Final = LEVELS**4 / (1.0 + LEVELS**6) * np.gradient(LEVELS)
"""Prior of the sizes, not normalised."""
MIXTURES: Final = np.radians([0.0, 22.5, 45.0, 67.5, 90.0])
"""Direction of (s_t, s_r radius): from shifts alone to turns alone."""
MIXTURE_PRIOR: Final = np.array([2.0, 1.0, 1.0, 2.0, 14.0]) / 20.0
"""How likely each direction is beforehand; see above for the weight of turns."""
SEEN: Final = 1e-3
"""Share of the clearest trace in the contrasts below which a mixture leaves none."""
RANGE: Final = 1e-6
"""Share of the largest eigenvalue of A from which a direction is a contrast."""
Kind = Literal["between runs", "within runs", "slip"]
SHOWN: Final = 1e-3
"""Share of the largest singular value that makes a direction seen: heights of runs are not."""
LIKELY: Final = 1e-4
"""Share of the largest weight from which a scatter counts."""
REACH: Final = 1e4
"""Mean chi-squared up to which, and beginning with its inverse, a size is searched for."""
BISECTIONS: Final = 16
"""Bisections of the logarithm of the size, over eight decades: to 0.03 %."""


@dataclass(frozen=True, eq=False)
class Scatter:
    """``translation`` (m) and ``rotation`` (rad) of the scatter that the covariance holds.

    ``estimated`` says whether from the ``n_contrasts``; ``probability``: how probably chance
    makes the contrasts as large as they are with the stated scatter, None where none is stated.
    ``variances`` (k, 2) with ``weights`` (k,) are the posterior of both squares.
    """

    translation: float
    rotation: float
    estimated: bool
    n_contrasts: int
    probability: float | None
    variances: Floats
    weights: Floats

    def in_words(self) -> str:
        """Return both for people."""
        shift, turn = self.translation / MICROMETRE, self.rotation / ARCSEC
        return f"{shift:.2g} um and {turn:.2g} arcsec"

    def weighing(self, arms: Floats) -> tuple[float, float]:
        """Return the squares (m^2, rad^2) of the scatter that weighs stations at ``arms``.

        As stated; of an estimated one a shift whose mean square is the same.
        """
        if not self.estimated:
            return self.translation**2, self.rotation**2
        lever = 2.0 / 3.0 * float((arms * arms).sum(axis=1).mean())
        return self.translation**2 + self.rotation**2 * lever, 0.0

    def roots(self, arms: Floats) -> Floats | None:
        """Return roots (V, 3, 3) of the covariances at ``arms`` (V, 3), None for no scatter."""
        shift, turn = self.weighing(arms)
        if shift == 0.0 and turn == 0.0:
            return None
        return roots_of(shift, turn, arms)

    def likely(self) -> Scatter:
        """Return it without squares that hardly count."""
        counts = self.weights > LIKELY * self.weights.max()
        weights = self.weights[counts]
        return replace(self, variances=self.variances[counts], weights=weights / weights.sum())

    def inverse(self, spread: Floats) -> Floats:
        """Return the inverse covariances (k, r, r) of contrasts with ``spread`` (2, r, r)."""
        noise = np.eye(spread.shape[1]) + np.tensordot(self.variances, spread, 1)
        return np.asarray(np.linalg.inv(noise), dtype=np.float64)

    def tail(self, square: Floats, dof: int) -> Floats:
        """Return how probably chance exceeds ``square`` (..., k), chi-squared of each scatter."""
        return np.asarray(chdtrc(dof, square) @ self.weights, dtype=np.float64)


def roots_of(shift: float, turn: float, arms: Floats) -> Floats:
    """Return roots (V, 3, 3) of the covariances of squared shifts (m^2) and turns (rad^2).

    At ``arms`` (V, 3); turns alone leave the direction of the arm at rest, which has no Cholesky.
    """
    values, vectors = np.linalg.eigh(shift * np.eye(3) + turn * turned(arms))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None], dtype=np.float64)


def turned(arms: Floats) -> Floats:
    """Return the covariances (V, 3, 3) at ``arms`` (V, 3) of a turn about every axis, m^2."""
    across = cross_matrix(arms)
    return np.asarray(across @ across.swapaxes(1, 2), dtype=np.float64)


def stated(translation: float, rotation: float) -> Scatter:
    """Return a scatter as it is stated, in m and rad."""
    alone = np.array([[translation**2, rotation**2]])
    return Scatter(translation, rotation, False, 0, None, alone, np.ones(1))


@dataclass(frozen=True, eq=False)
class ScatterContrasts:
    """``value`` (q,), which noise makes N(0, 1), ``spread`` (2, q, q): K_t, K_r; ``radius`` m.

    ``root`` (3 V, q), 1/m: its transpose times the shifts of the stations is what these add.
    """

    value: Floats
    spread: Floats
    radius: float
    root: Floats


def contrasts(network: LengthNetwork, arms: Floats) -> ScatterContrasts:
    """Return the contrasts of a ``network`` solved without scatter; ``arms`` (V, 3) in m."""
    v = len(arms)
    each = np.arange(v)
    spent = pulled(network)
    # A: the weight of each station less what poses and kept unknowns take up
    matrix = -spent @ full_covariance(network) @ spent.T
    matrix.reshape(v, 3, v, 3)[each, :, each] += network.normal
    values, vectors = np.linalg.eigh(matrix)
    kept = values > RANGE * values[-1]
    force = network.pull @ network.slopes.error[:, :, None]
    root = vectors[:, kept] * np.sqrt(values[kept])
    by_station = root.reshape(v, 3, -1)
    moved = turned(arms) @ by_station
    value = (vectors[:, kept].T @ force.ravel()) / np.sqrt(values[kept])
    spread = np.stack([root.T @ root, root.T @ moved.reshape(3 * v, -1)])
    apart = network.state.places - network.state.places.mean(axis=0)
    radius = float(np.sqrt((apart**2).sum() / len(apart)))
    return ScatterContrasts(value, spread, radius, root)


def estimate(
    found: ScatterContrasts, translation: float | None, rotation: float | None, significance: float
) -> Scatter:
    """Return the scatter that ``found`` gives, rms of the posterior; what is stated stands.

    Both stated: they stand unless the contrasts contradict them with ``significance``; then both
    are estimated. Raises ObservabilityError where nothing shows it.
    """
    q = len(found.value)
    probability = None
    if translation is not None and rotation is not None:
        known = np.eye(q) + translation**2 * found.spread[0] + rotation**2 * found.spread[1]
        if q:
            square = float(found.value @ np.linalg.solve(known, found.value))
            probability = chi2_sf(square, q)
        if probability is None or probability >= significance:
            kept = stated(translation, rotation)
            return replace(kept, n_contrasts=q, probability=probability)
        translation = rotation = None
    variances, weights = _posterior(found, translation, rotation)
    mean = weights @ variances
    return Scatter(
        float(np.sqrt(mean[0])), float(np.sqrt(mean[1])), True, q, probability, variances, weights
    )


def _posterior(
    found: ScatterContrasts, translation: float | None, rotation: float | None
) -> tuple[Floats, Floats]:
    """Return squares of both scatters (k, 2), the first without any, and their weights (k,)."""
    base = np.array([(translation or 0.0) ** 2, (rotation or 0.0) ** 2])
    noise = np.eye(len(found.value)) + np.tensordot(base, found.spread, 1)
    root = np.linalg.inv(np.linalg.cholesky(noise))
    value, spread = root @ found.value, root @ found.spread @ root.T
    directions, priors = _directions(found, spread, translation, rotation)
    variances, logs = [base[None]], [np.log([ABSENT]) - 0.5 * (value @ value)]
    size = np.log((1.0 - ABSENT) * DENSITY / DENSITY.sum())
    for direction, prior in zip(directions, priors, strict=True):
        values, vectors = np.linalg.eigh(np.tensordot(direction, spread, 1))
        level = LEVELS**2 / values.mean()
        total = 1.0 + level[:, None] * np.maximum(values, 0.0)
        square = (vectors.T @ value) ** 2
        likelihood = -0.5 * (np.log(total) + square / total).sum(axis=1)
        logs.append(likelihood + size + np.log(prior))
        variances.append(base + level[:, None] * direction)
    weights = np.concatenate(logs)
    weights = np.exp(weights - weights.max())
    return np.concatenate(variances), weights / weights.sum()


def _directions(
    found: ScatterContrasts, spread: Floats, translation: float | None, rotation: float | None
) -> tuple[Floats, Floats]:
    """Return what grows with the size in both squares (k, 2), and how likely each is (k,).

    ``spread`` (2, q, q) as in the contrasts. Mixtures that leave no trace there are left out.
    """
    size = np.array([1.0, found.radius**-2])
    if translation is not None:
        directions, priors = np.array([[0.0, 1.0]]), np.ones(1)
    elif rotation is not None:
        directions, priors = np.array([[1.0, 0.0]]), np.ones(1)
    else:
        shares = np.column_stack([np.cos(MIXTURES), np.sin(MIXTURES)])
        directions, priors = shares**2, MIXTURE_PRIOR
    directions = directions * size
    trace = np.trace(spread, axis1=1, axis2=2)
    seen = directions @ trace > SEEN * (size * trace).max()
    if not seen.any():
        raise ObservabilityError(
            "no distance between the places shows how the table scatters from run to run: state "
            "scatter_translation_std and scatter_rotation_std, or measure from three places"
        )
    return directions[seen], priors[seen] / priors[seen].sum()


def enlargement(
    scatter: Scatter, used: tuple[float, float], variance: Floats, slope: Floats
) -> Floats:
    """Return factors (c,) on standard deviations whose 1.96 fold then holds 95 %.

    ``variance`` (c,) is that with the squares ``used`` (m^2, rad^2), ``slope`` (2, c) what a unit
    of each square adds to it.
    """
    if not scatter.estimated:
        return np.ones_like(variance)
    # what is as unlikely does not change 5 % outside
    likely = scatter.weights > 1e-7
    spread = variance + (scatter.variances[likely] - np.array(used)) @ slope
    spread = np.maximum(spread / variance, 1e-12)
    weights = scatter.weights[likely] / scatter.weights[likely].sum()
    factor = np.ones_like(variance)
    # Newton's method for the factor at which 5 % lie outside; steps are kept short enough that
    # no factor turns negative
    for _ in range(12):
        reach = HALF_OF_95_PERCENT * factor / np.sqrt(2.0 * spread)
        outside = weights @ erfc(reach) - OUTSIDE
        slope_of = weights @ (np.exp(-(reach**2)) * reach) * (-2.0 / np.sqrt(np.pi)) / factor
        step = np.clip(outside / slope_of, -0.3 * factor, 0.3 * factor)
        factor = factor - step
        if np.abs(step).max() < 1e-6:
            break
    return np.asarray(factor, dtype=np.float64)


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
    scatter: Scatter
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
        along = _tangents(self.network)
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


def _tangents(network: LengthNetwork) -> Floats:
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
    rank = int(np.count_nonzero(size > SHOWN * max(size[0], np.finfo(np.float64).tiny)))
    return basis[:rank], basis[rank:]


def _other_scatter(
    found: ScatterContrasts,
    shifts: Floats,
    known: tuple[float | None, float | None],
    significance: float,
) -> Scatter:
    """Return the scatter that the contrasts across ``shifts`` (d, q) show."""
    _, other = _basis(shifts)
    if len(other):
        spread = other @ found.spread @ other.T
        others = replace(found, value=other @ found.value, spread=spread)
        scatter = estimate(others, *known, significance)
    else:
        scatter = stated(known[0] or 0.0, known[1] or 0.0)
    return scatter.likely()


def _test(
    found: ScatterContrasts, scatter: Scatter, kind: Kind, shifts: Floats, places: Ints, best: int
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
    moved = -np.linalg.lstsq(along.T, found.value, rcond=SHOWN)[0].reshape(-1, 3)
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
