"""Where to put the balls, and what a required uncertainty needs of plate, positions and machine.

:func:`plan_plate` finds the layout with the smallest predicted uncertainty. Layouts are judged by
their mean variances when all CMM positions are measured, in closed form, many at once. With
P(q) = sum over the balls of exp(-2 pi i q j / N) the normal matrices of a harmonic (see
:mod:`~rotcal_ros.methods.ball_plate.solver.separability`) are 3 x 3 with entries made of P at
q - 1, q, q + 1 and of P(1), P(2): their inverse is written out, so a layout costs one short
transform and a few hundred operations.

:func:`required_effort` looks for the fewest centres of a given plate and machine.
:func:`plate_trade` measures all positions and says how large the plate or how quiet the machine
has to be. By cyclic symmetry no choice of n centres, whichever balls at whichever positions, beats
the share n of the plate that has a ball at every step: a variance of V_full N^2 / n, the
:func:`variance_bound`. A good plate of a few balls comes within some per cent of that, so there is
little to plan but the number of centres.

N table positions, L layouts, R balls.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import chain, combinations, islice
from math import comb
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Complexes, Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS, COVERAGE_FACTOR, ROTATIONS, unit_of
from rotcal_ros.foundation.errors import ObservabilityError, PlanError
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.methods.ball_plate.measuring_order import spread_out
from rotcal_ros.methods.ball_plate.solver.layout import PlateLayout
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.solver.separability import couplings, harmonic_multiplicity

EXHAUSTIVE_LIMIT = 4_000_000
"""Layouts up to which all are looked at; beyond it exchange search takes over."""
BATCH: Final = 16384
"""Layouts that are made at once."""
CHUNK: Final = 256
"""Layouts that are judged at once: the work fits into the processor's cache."""
SINGULAR: Final = 1e-7
"""Relative determinant below which a layout counts as not separable."""
WEIGHTS = (1.0, 1.0, 1.0, 1.0)
"""Weights of the mean variances of ECC, plane translations, tilts and EZC."""
MOST_BALLS = 24
"""Balls up to which plates are tried where no number is given."""
_INDEX = {"ECC": 0, "EXC": 1, "EYC": 1, "EAC": 2, "EBC": 2, "EZC": 3}

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class BallLayout:
    """A layout of balls and what it promises when all CMM positions are measured.

    ``variances`` (4,) are the mean variances for unit noise as of
    :func:`mean_variances`, ``score`` their weighted sum, ``bound`` what no layout
    of so many balls can beat (proven), ``evaluated`` the number of layouts looked at.
    ``optimal`` says that all layouts were covered, so that none is better.
    """

    grid: int
    steps: tuple[int, ...]
    variances: tuple[float, float, float, float]
    score: float
    bound: float
    evaluated: int
    optimal: bool

    @property
    def gap(self) -> float:
        """How far the score lies above the proven bound, as part of the bound."""
        return self.score / self.bound - 1.0

    def predicted_std(self, sigma: float, radius: float) -> dict[str, float]:
        """Return the rms standard deviation of the six components, metres and radians.

        ``sigma`` is the standard deviation of a ball centre and ``radius`` that of the ball
        circle, both in metres.
        """
        scale = {name: 1.0 / radius if name in ROTATIONS else 1.0 for name in COMPONENTS}
        std = np.sqrt(self.variances)
        return {name: sigma * scale[name] * float(std[_INDEX[name]]) for name in COMPONENTS}


def plan_plate(
    grid: int,
    balls: int,
    *,
    min_gap: int = 1,
    subset_of: Sequence[int] | None = None,
    weights: tuple[float, ...] = WEIGHTS,
    seed: int = 0,
    starts: int = 40,
    exact: bool = True,
    progress: Progress | None = None,
) -> BallLayout:
    """Find the ball steps on a grid of table positions that give the smallest uncertainty.

    ``min_gap`` grid steps lie between neighbours, ``subset_of`` are the steps of an existing
    plate, ``weights`` those of the mean variances of ECC, EXC and EYC, EAC and EBC, EZC (rotations
    times radius). ``steps`` is the layout, ``predicted_std(sigma, radius)`` (m) its standard
    deviations (m, rad), ``optimal`` says that none is better. Raises PlanError when no layout
    separates table, plate and machine.

    Layouts that differ by a rotation or a reflection are equal, so only one of them is looked at;
    up to ``EXHAUSTIVE_LIMIT`` all are. Beyond it, or without ``exact``, an exchange search runs
    from ``starts`` random layouts (``seed``). ``progress(done, total)`` is called now and then.

    >>> import rotcal_ros as rc
    >>> layout = rc.plan_plate(12, 6)
    >>> layout.steps, layout.optimal
    ((0, 1, 3, 5, 8, 9), True)
    """
    weight = _checked(grid, balls, min_gap, subset_of, weights)
    places = np.arange(grid) if subset_of is None else np.unique(np.array(subset_of) % grid)
    if subset_of is None:
        batches, count = _necklaces(grid, balls, min_gap), count_layouts(grid, balls, min_gap)
    else:
        count = comb(len(places), balls)
        batches = (
            layouts[np.diff(layouts, append=layouts[:, :1] + grid).min(axis=1) >= min_gap]
            for layouts in _choices(places.tolist(), balls)
        )
    if exact and count <= EXHAUSTIVE_LIMIT:
        found = _exhaustive(grid, batches, weight, count, progress)
    else:
        found = _exchange(grid, balls, places, min_gap, weight, seed, starts, progress)
    if found is None:
        raise PlanError(
            f"no layout of {balls} balls on {grid} steps with gaps of at least {min_gap} "
            "separates table, plate and CMM; use more balls"
        )
    return found


def count_layouts(grid: int, n_balls: int, min_gap: int = 1) -> int:
    """Return how many layouts the exhaustive search enumerates (reflections counted twice)."""
    return sum(
        comb(grid - n_balls * gap + n_balls - 2, n_balls - 2)
        for gap in range(min_gap, grid // n_balls + 1)
    )


def _checked(
    grid: int,
    n_balls: int,
    min_gap: int,
    subset_of: Sequence[int] | None,
    weights: tuple[float, ...],
) -> Floats:
    weight = np.array(weights, dtype=np.float64)
    if weight.shape != (4,) or not (weight >= 0.0).all() or not weight.any():
        raise PlanError(
            f"give four weights of at least 0 (ECC, xy, tilt, z), one above 0, not {weights}"
        )
    if n_balls < 4:
        raise PlanError(f"{n_balls} balls cannot separate table, plate and CMM: give at least 4")
    if min_gap < 1 or n_balls * min_gap > grid:
        raise PlanError(
            f"{n_balls} balls {min_gap} steps apart do not fit on {grid} steps: give fewer balls, "
            "a smaller gap or a finer grid"
        )
    if subset_of is not None and len(set(subset_of)) < n_balls:
        raise PlanError(f"the plate has only {len(set(subset_of))} of {n_balls} wanted balls")
    return weight


def _necklaces(grid: int, n_balls: int, min_gap: int) -> Iterator[Ints]:
    """Yield batches of layouts, the smallest gap first, one of each mirrored pair.

    A few layouts whose smallest gap occurs twice come more than once; none is left out.
    """
    for gap in range(min_gap, grid // n_balls + 1):
        free = grid - n_balls * gap  # to be shared out among the other gaps
        # ways to share out: n_balls - 2 bars among so many places, the gaps lie between the bars
        bars = free + n_balls - 2
        for chosen in _choices(range(bars), n_balls - 2):
            others = np.diff(chosen, axis=1, prepend=-1, append=bars) - 1 + gap
            others = others[others[:, 0] <= others[:, -1]]
            start = np.zeros((len(others), 1), dtype=np.int64)
            yield np.hstack([start, start + gap, gap + np.cumsum(others[:, :-1], axis=1)])


def _choices(values: Iterable[int], count: int) -> Iterator[Ints]:
    """Yield all combinations of ``count`` values in batches (L, count)."""
    every = combinations(values, count)
    while True:
        flat = np.fromiter(chain.from_iterable(islice(every, BATCH)), dtype=np.int64)
        if not len(flat):
            return
        yield flat.reshape(-1, count)


def _exhaustive(
    grid: int, batches: Iterator[Ints], weights: Floats, count: int, progress: Progress | None
) -> BallLayout | None:
    """Look at all layouts."""
    best, seen = None, 0
    for layouts in batches:
        seen += len(layouts)
        if len(layouts):
            found = _best_of(grid, layouts, weights)
            if found[0] < (np.inf if best is None else best[0]):
                best = found
        if progress is not None:
            progress(min(seen, count), count)
    return None if best is None else _layout(grid, *best[1:], weights, seen, True)


def _exchange(
    grid: int,
    n_balls: int,
    places: Ints,
    min_gap: int,
    weights: Floats,
    seed: int,
    starts: int,
    progress: Progress | None,
) -> BallLayout | None:
    """Move one ball at a time to where it helps most, from several random layouts."""
    rng = np.random.default_rng(seed)
    best: BallLayout | None = None
    evaluated = 0
    for start in range(starts):
        layout = _random_layout(rng, grid, n_balls, places, min_gap)
        score, variances = np.inf, np.full(4, np.inf)
        while True:
            neighbours = _neighbours(grid, layout, places, min_gap)
            evaluated += len(neighbours)
            found = _best_of(grid, neighbours, weights)
            if not found[0] < score:
                break
            score, layout, variances = found
        if np.isfinite(score) and (best is None or score < best.score):
            best = _layout(grid, layout, variances, weights, evaluated, False)
        if progress is not None:
            progress(start + 1, starts)
    return None if best is None else replace(best, evaluated=evaluated)


def _random_layout(
    rng: np.random.Generator, grid: int, n_balls: int, places: Ints, min_gap: int
) -> Ints:
    """Draw places one by one among those that keep the gaps; start again when stuck."""
    for _ in range(1000):
        chosen: list[int] = []
        free = places
        while len(chosen) < n_balls and len(free):
            chosen.append(int(rng.choice(free)))
            free = free[_steps_between(grid, free, chosen[-1]) >= min_gap]
        if len(chosen) == n_balls:
            return np.sort(np.array(chosen))
    raise PlanError(
        f"no random layout of {n_balls} balls keeps gaps of {min_gap} steps: give fewer balls or "
        "a smaller gap"
    )


def _neighbours(grid: int, layout: Ints, places: Ints, min_gap: int) -> Ints:
    """Return the layout itself and all that differ in one ball, (L, R)."""
    found = [layout[None]]
    for ball in range(len(layout)):
        others = np.delete(layout, ball)
        away = _steps_between(grid, places[:, None], others).min(axis=1)
        free = places[(away >= min_gap) & (places != layout[ball])]
        moved = np.hstack([np.tile(others, (len(free), 1)), free[:, None]])
        found.append(np.sort(moved, axis=1))
    return np.vstack(found)


def _steps_between(grid: int, step: Ints, other: Ints | int) -> Ints:
    """Return how many grid steps lie between two on the circle, the shorter way."""
    steps: Ints = np.abs((step - other + grid // 2) % grid - grid // 2)
    return steps


def _best_of(grid: int, layouts: Ints, weights: Floats) -> tuple[float, Ints, Floats]:
    """Return score, layout and variances (4,) of the best of ``layouts`` (L, R)."""
    variances = mean_variances(grid, layouts)
    # layouts that do not separate count as infinite, whatever the weights
    scores = np.where(np.isfinite(variances), variances, 0.0) @ weights
    scores[~np.isfinite(variances).all(axis=1)] = np.inf
    first = int(np.argmin(scores))
    return float(scores[first]), layouts[first], variances[first]


def _layout(
    grid: int, steps: Ints, variances: Floats, weights: Floats, evaluated: int, optimal: bool
) -> BallLayout:
    first, second, third, fourth = variances.tolist()
    return BallLayout(
        grid=grid,
        steps=tuple(np.sort(steps).tolist()),
        variances=(first, second, third, fourth),
        score=float(variances @ weights),
        bound=float(proven_bound(grid, len(steps)) @ weights),
        evaluated=evaluated,
        optimal=optimal,
    )


def mean_variances(grid: int, layouts: Ints) -> Floats:
    """Return the mean variances (L, 4) of layouts (L, R) for unit noise; inf if not separable.

    Mean over the table positions and, for pairs, over x and y: ECC; EXC, EYC; EAC, EBC; EZC.
    Multiply by sigma^2, and divide those of rotations by the squared radius.
    """
    layouts = np.atleast_2d(layouts)
    variances = np.empty((len(layouts), 4))
    for start in range(0, len(layouts), CHUNK):
        part = layouts[start : start + CHUNK]
        variances[start : start + CHUNK] = _variances(_spectrum(grid, part), grid, part.shape[1])
    return variances


def _spectrum(grid: int, layouts: Ints) -> Complexes:
    """Return P(q) of layouts (L, R) for q = 0 .. N//2 + 1, (L, N//2 + 2)."""
    present = np.zeros((len(layouts), grid))
    present[np.arange(len(layouts))[:, None], layouts] = 1.0
    half = np.fft.rfft(present)
    beyond = half[:, grid - grid // 2 - 1].conj()  # P(N//2 + 1), by symmetry
    extended: Complexes = np.concatenate([half, beyond[:, None]], axis=1)
    return extended


def proven_bound(grid: int, n_balls: int) -> Floats:
    """Return what no layout of so many balls can beat, (4,), ordered as :func:`mean_variances`.

    The sum of |P(q)|^2 over all q is N R (Parseval) and the diagonal terms are convex in it, so
    spreading it evenly is best (Jensen); the couplings between unknowns only add variance.
    """
    power = grid * n_balls - n_balls**2
    each = (grid - 1) / grid / (n_balls - power / (grid - 1) / n_balls)
    # The pair meets P(-1) but not P(1), which have the same size: some more power there is best.
    others = grid - 3
    first = ((np.sqrt(2.0) - 1.0) * n_balls**2 + power / others) / (np.sqrt(2.0) + 2.0 / others)
    first = min(first, 0.5 * power)
    rest = (power - 2.0 * first) / others
    pair = 1.0 / (n_balls - first / n_balls) + others / (n_balls - rest / n_balls)
    return np.array([each, pair / grid, 2.0 * pair / grid, each])


def _variances(sums: Complexes, grid: int, n_balls: int) -> Floats:
    """Evaluate the inverses (L, 4) from P (L, N//2 + 2)."""
    diagonal, up, down, across = couplings(sums, n_balls)
    lower, middle, upper = diagonal[:, :-2], diagonal[:, 1:-1], diagonal[:, 2:]
    up_power, down_power = _power(up), _power(down)
    cross_power = _power(across)
    # singular layouts may divide by zero here: they are found by _singular
    with np.errstate(divide="ignore", invalid="ignore"):
        # PLANE, whose unknowns d+ and d- meet only in rho c_z: by elimination
        up_share, down_share = 0.5 * up_power / upper, 0.5 * down_power / lower
        turn = 1.0 / (middle - up_share - down_share)
        plane_up, plane_down = (1.0 + up_share * turn) / upper, (1.0 + down_share * turn) / lower
        # AXIS, all coupled: by the adjugate over the determinant
        determinant = (
            middle * (upper * lower - cross_power)
            - upper * down_power
            - lower * up_power
            + 2.0 * (across.conj() * up * down).real
        )
        tilt_up = 2.0 * (lower * middle - down_power) / determinant
        tilt_down = 2.0 * (upper * middle - up_power) / determinant
        height = (upper * lower - cross_power) / determinant
    bad = _singular(upper, lower, middle, turn, determinant, n_balls)
    plane_down[:, 0] = tilt_down[:, 0] = 0.0  # fixed by a constraint at q = 1
    twice = harmonic_multiplicity(grid) / grid
    result = np.stack(
        [
            turn @ twice,
            0.5 * (plane_up + plane_down) @ twice,
            0.5 * (tilt_up + tilt_down) @ twice,
            height @ twice,
        ],
        axis=1,
    )
    result[bad] = np.inf
    return result


def _power(values: Complexes) -> Floats:
    power: Floats = values.real**2 + values.imag**2
    return power


def _singular(
    upper: Floats, lower: Floats, middle: Floats, turn: Floats, determinant: Floats, n_balls: int
) -> Bools:
    """Layouts (L,) with a harmonic whose systems are singular to rounding."""
    small = SINGULAR * n_balls
    smallest = np.minimum(np.minimum(upper, lower), middle).min(axis=1) < small
    plane = ~((turn > 0.0) & (turn * small < 1.0)).all(axis=1)
    axis = ~(determinant > SINGULAR * n_balls**3).all(axis=1)
    bad: Bools = smallest | plane | axis
    return bad


@dataclass(frozen=True)
class Effort:
    """One way to reach the required uncertainty.

    ``layout`` are the balls, ``positions`` (S,) the CMM positions to measure them at;
    ``expanded`` is the worst predicted expanded uncertainty (k = 2) of the wanted component
    over the table positions, metres or radians; ``centres`` the number of balls to be probed.
    """

    layout: BallLayout
    positions: tuple[int, ...]
    expanded: float

    @property
    def centres(self) -> int:
        """Number of ball centres to measure."""
        return len(self.layout.steps) * len(self.positions)


def required_effort(
    grid: int,
    component: str,
    limit: float,
    *,
    sigma: float,
    radius: float,
    min_gap: int = 1,
    most_balls: int | None = None,
    seed: int = 0,
) -> tuple[Effort, ...]:
    """Find, for every number of balls, the fewest CMM positions for U(component) <= limit.

    ``sigma`` is the standard deviation of a ball centre, ``radius`` that of the ball circle, in
    metres; ``limit`` in metres or radians, with k = 2. The ways are returned in the order
    of the number of centres to be measured, the least work first. Positions are spread over the
    circle. Raises PlanError when the component is unknown or no way reaches the limit.
    """
    if component not in COMPONENTS:
        raise PlanError(f"unknown component {component!r}: one of {', '.join(COMPONENTS)}")
    if not limit > 0.0:
        raise PlanError(f"the required uncertainty must be positive, not {limit}")
    ways = []
    most = most_balls or MOST_BALLS
    for n_balls in range(5, min(most, grid // min_gap) + 1):
        try:
            layout = plan_plate(grid, n_balls, min_gap=min_gap, seed=seed, starts=6, exact=False)
        except PlanError:
            continue
        scale = COVERAGE_FACTOR * sigma
        if (way := _fewest_positions(layout, component, radius, limit / scale)) is not None:
            ways.append(Effort(layout, way[0], scale * way[1]))
    if not ways:
        unit, label = unit_of(component)
        raise PlanError(
            f"no layout of up to {most} balls on {grid} steps reaches "
            f"U({component}) <= {limit / unit:g} {label} with {sigma / MICROMETRE:g} um per "
            "centre: repeat the measurement n times (U falls with the square root of n), or use "
            "a larger ball circle"
        )
    return tuple(sorted(ways, key=lambda way: (way.centres, way.expanded)))


def unit_std(
    grid: int, balls: Ints | list[int], positions: Ints | list[int], radius: float
) -> dict[str, Floats]:
    """Return the standard deviations (N,) of the six components for unit noise of a centre.

    For any choice of balls and CMM positions; ObservabilityError when it separates nothing.
    """
    ball, cmm = (axis.ravel() for axis in np.meshgrid(balls, positions))
    problem = BallPlateProblem.nominal(grid, radius, (cmm - ball) % grid, ball)
    return PlateLayout(problem).unit_std()


def _fewest_positions(
    layout: BallLayout, component: str, radius: float, limit: float
) -> tuple[tuple[int, ...], float] | None:
    """Bisect the number of CMM positions; None when all are not enough.

    The sets are nested, so that more positions never raise the uncertainty.
    """
    grid = layout.grid
    spread = spread_out(grid)

    @cache
    def worst(count: int) -> float:
        try:
            std = unit_std(grid, np.array(layout.steps), spread[:count], radius)[component]
        except ObservabilityError:
            return np.inf
        return float(std.max())

    if worst(grid) > limit:
        return None
    enough = bisect_left(range(grid), True, lo=4, key=lambda count: worst(count) <= limit)
    return tuple(np.sort(spread[:enough]).tolist()), worst(enough)


@dataclass(frozen=True)
class PlateTrade:
    """What a plate of ``balls`` at the steps ``ball_steps`` gives, all positions measured.

    ``centres`` are measured in ``seconds``; ``expanded``: U (k = 2) of ECC, rad. ``radius`` and
    ``sigma`` (m) are what the required uncertainty takes, the other one as given. ``saving``:
    share of the centres that the best of all plans could save.
    """

    balls: int
    ball_steps: tuple[int, ...]
    centres: int
    seconds: float
    expanded: float
    radius: float
    sigma: float
    saving: float


def plate_trade(
    grid: int,
    balls: Sequence[int],
    limit: float,
    *,
    radius: float,
    sigma: float,
    centre_s: float,
    seed: int = 0,
) -> tuple[PlateTrade, ...]:
    """Return the trade for U(ECC) <= ``limit`` (rad) on ``grid`` table positions.

    ``radius`` (m) of the ball circle, ``sigma`` (m, k = 1) of a centre coordinate, ``centre_s``
    (s) for one centre with all that it takes. Raises PlanError for plates that separate nothing.
    """
    rows = []
    for count in balls:
        layout = plan_plate(grid, count, weights=(1.0, 0.0, 0.0, 0.0), seed=seed, starts=6)
        unit = float(mean_variances(grid, np.array(layout.steps))[0, _INDEX["ECC"]])
        turn = COVERAGE_FACTOR * np.sqrt(unit)  # times sigma / radius
        rows.append(
            PlateTrade(
                balls=count,
                ball_steps=tuple(layout.steps),
                centres=grid * count,
                seconds=grid * count * centre_s,
                expanded=float(turn * sigma / radius),
                radius=float(turn * sigma / limit),
                sigma=float(limit * radius / turn),
                saving=1.0 - variance_bound(grid, grid * count) / unit,
            )
        )
    return tuple(rows)


def variance_bound(grid: int, centres: int) -> float:
    """Return the mean variance of ECC for unit noise and radius that no plan can beat."""
    full = float(mean_variances(grid, np.arange(grid))[0, _INDEX["ECC"]])
    return full * grid**2 / centres
