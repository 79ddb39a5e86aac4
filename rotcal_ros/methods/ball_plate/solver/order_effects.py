"""Drift and knocks in the order of measurement: whether they would be seen, and are there.

A drift of the CMM's origin and a knock, a motion of the plate on the table from some moment on,
displace the centres by known patterns, and the estimate is linear. So the error per unit is exact,
and what the residuals keep of the pattern gives the size at which a test finds it with a
probability of POWER: :func:`order_effects` needs no measured values. :func:`find_drift` and
:func:`find_motion` look for the same patterns in the residuals of a fit. :func:`find_knock`
looks between any two rows, by itself, and has the last word on a plate that jumped; the test of a
motion finds what is too small for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust.distributions import f_sf, noncentrality
from rotcal_ros.adjust.effects import Seen, effect_test
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.protection import POWER
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.methods.ball_plate.solver.estimate import (
    VISIBLE,
    drift_columns,
    drift_seen,
    factored_with_drift,
)
from rotcal_ros.methods.ball_plate.solver.model import (
    PARTS,
    LinearFit,
    OriginDrift,
    Solution,
    least_variance,
    plate_motion,
)
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, RowLayout, places_of

SIGNIFICANCE: Final = 0.01
"""Level of the tests for a drift, for a motion of the plate and of the closure."""
MOMENTS: Final = 40
"""Moments at which a knock is looked at, evenly over the run; a quarter where each costs more."""
MANY_CENTRES: Final = 3000
RANDOM_MOMENTS: Final = 0.95
"""A knock comes at a random moment: its error is that of all but the worst 5 % of them."""
HARMLESS: Final = 1e-12
"""Square of an error per unit, in standard deviations, below which it is rounding."""
NOTHING: Final = 1e-8
"""Part of the total information below which a direction counts as unseen."""
SPARE: Final = 8
"""Degrees of freedom below which nothing can be tested."""
SETTLED: Final = 0.01
"""Share of the stated noise that the iteration of the exact model may leave in the residuals."""
FALSE_KNOCK: Final = 1e-6
"""Probability that good data are said to contain a knock."""
IMITATED: Final = 1e-6
"""Part of a motion's information up to which the CMM's errors imitate it: it counts as zero."""
CANDIDATES: Final = 3
"""Moments of a knock whose motion is fitted with all that table and CMM take of it."""


@dataclass(frozen=True, eq=False)
class DisplacementPatterns:
    """Some patterns of displacement, m columns: amounts in metres, rotations times radius.

    ``seen`` by a fit, whose score is zero. The amount a changes the difference between the first
    table position and its repetition at the end by a' ``closing`` a; (m, m), zero without.
    """

    seen: Seen
    closing: Floats

    @property
    def response(self) -> Floats:
        """Errors of the six deviations per unit (6, N, m), m and rad."""
        return np.asarray(self.seen.moved[:].T.reshape(6, -1, len(self.closing)))

    @property
    def rounding(self) -> float:
        """Information up to which a direction counts as unseen."""
        return NOTHING * float(self.seen.whole[0])


@dataclass(frozen=True, eq=False)
class OrderEffects:
    """Drift (x, y, z over the run) and knocks (shift x, y, z, turn about x, y, z) of an order.

    ``moments`` are the places in the order of measurement from which on the plate has moved.
    """

    drift: DisplacementPatterns
    knocks: tuple[DisplacementPatterns, ...]
    moments: Ints


def order_effects(problem: BallPlateProblem, closing: BallPlateProblem | None) -> OrderEffects:
    """Return what drift and knocks do in the order of a problem and of its closing rows.

    With ``problem.drift`` a drift is estimated, and the knocks are those beside it. Layouts are
    remembered: the same one costs nothing the second time.
    """
    return _of_layout(RowLayout.of(problem), b"" if closing is None else closing.cell.tobytes())


@lru_cache(maxsize=4)
def _of_layout(layout: RowLayout, closing: bytes) -> OrderEffects:
    """Return the effects in a layout; ``closing`` are the cells measured again at the end."""
    problem = layout.problem
    linear, n = factored_with_drift(problem), len(problem.centres)
    quick = problem.complete and n <= MANY_CENTRES
    count = MOMENTS if quick else MOMENTS // 4
    moments = np.unique(np.ceil((np.arange(count) + 0.5) / count * n).astype(np.int64))
    place = np.argsort(np.argsort(problem.rows))  # of each row in the order of measurement
    cells = np.frombuffer(closing, dtype=np.int64)
    again = places_of(cells[np.isin(cells, problem.cell)], problem.cell)
    change = 0.5 - problem.run_time[again]  # of the run time, which is 0.5 at the end

    def patterns(seen: Seen, closed: Floats) -> DisplacementPatterns:
        """Return those of a fit; ``closed`` (k, 3, m) between first and last."""
        # a difference of two centres has twice the variance of one
        return DisplacementPatterns(_alike(seen), 0.5 * np.einsum("nia,nib->ab", closed, closed))

    drift, motion = drift_columns(problem.run_time, 1), plate_motion(problem)[again]
    return OrderEffects(
        drift=patterns(linear.seen(drift), drift_columns(change, 1)),
        knocks=tuple(
            patterns(linear.seen_of_plate(place >= moment), motion[place[again] < moment])
            for moment in moments
        ),
        moments=moments,
    )


def _alike(seen: Seen) -> Seen:
    """Return it with columns of one length: none counts more where a direction leaves nothing."""
    return replace(seen, whole=np.full_like(seen.whole, seen.whole.mean()))


def needed(parameters: int, dof: int, tests: int = 1) -> float:
    """Return the noncentrality that an F test at SIGNIFICANCE / ``tests`` finds with POWER."""
    return noncentrality(SIGNIFICANCE / tests, POWER, parameters, dof)


def found_size(
    disturbance: DisplacementPatterns, amount: Floats, fit: float, closure: float
) -> float:
    """Return how many times ``amount`` (m,) must be there to be found, for unit noise.

    ``fit`` and ``closure`` are the noncentralities that the two tests need; infinite when both
    are blind.
    """
    seen = amount @ disturbance.seen.information @ amount / fit
    again = amount @ disturbance.closing @ amount / closure
    best = max(float(seen), float(again))
    blind = disturbance.rounding * float(amount @ amount) / max(fit, closure)
    return float(best**-0.5) if best > blind else float("inf")


def _worst_unseen(
    disturbance: DisplacementPatterns, std: Floats, fit: float, closure: float
) -> float:
    """Return the largest error, in ``std`` (6, N) for unit noise, of what is not yet found.

    Over all directions of the amounts, components and positions; of the bounds by either test
    and by both together the smallest holds.
    """
    fitted, closed = disturbance.seen.information / fit, disturbance.closing / closure
    gain, floor = (
        (disturbance.seen.moved[:] / std.ravel()).T,
        disturbance.rounding / max(fit, closure),
    )
    bounds = [
        factor * _largest(gain, information, floor)
        for factor, information in ((1.0, fitted), (1.0, closed), (2.0, fitted + closed))
    ]
    return float(np.sqrt(np.min(bounds, axis=0).max()))


def _largest(gain: Floats, information: Floats, floor: float) -> Floats:
    """Return the largest (g a)^2 for a' information a = 1, for every row g of ``gain``."""
    values, vectors = np.linalg.eigh(information)
    along = (gain @ vectors) ** 2
    seen = values > floor
    unseen = along[:, ~seen].sum(axis=1) > HARMLESS
    inside: Floats = (along[:, seen] / values[seen]).sum(axis=1)
    return np.where(unseen, np.inf, inside)


def drift_error(effects: OrderEffects, std: Floats, dof: int) -> float:
    """Return the largest error of a linear drift that the tests leave unseen, in ``std``."""
    return _worst_unseen(effects.drift, std, needed(3, dof), needed(6, dof))


def knock_error(effects: OrderEffects, std: Floats, dof: int) -> float:
    """Return the error of a knock that the tests leave unseen, in ``std``.

    The largest of all directions, components and positions, for all but the worst moments.
    """
    fit, closure = needed(6, dof, len(effects.knocks)), needed(6, dof)
    errors = np.array([_worst_unseen(k, std, fit, closure) for k in effects.knocks])
    return float(errors[bad_moment(errors)])


def bad_moment(errors: Floats) -> int:
    """Return the moment whose error all but the worst moments do not exceed."""
    return int(np.argsort(errors)[int(np.ceil(RANDOM_MOMENTS * len(errors))) - 1])


@dataclass(frozen=True)
class DriftTest:
    """Linear drift of the CMM's origin: ``amount`` (3,), m over the run, with ``std``; p value.

    ``estimated``: part of the fit, and so no reason for doubt.
    """

    amount: Floats
    std: Floats
    p_value: float
    estimated: bool

    def turned(self, rotation: Floats) -> DriftTest:
        """Return the same in another frame, to which ``rotation`` (3, 3) takes vectors."""
        std = np.sqrt(rotation**2 @ self.std**2)
        return replace(self, amount=rotation @ self.amount, std=std)

    @property
    def significant(self) -> bool:
        """Whether there is a drift."""
        return self.p_value < SIGNIFICANCE

    def sentence(self) -> str:
        """Say in words how much drifts."""
        shown = ", ".join(
            f"{a / MICROMETRE:.3f} +- {2.0 * s / MICROMETRE:.3f}"
            for a, s in zip(self.amount, self.std, strict=True)
        )
        found = f"the origin of the CMM drifts by ({shown}) um over the run in x, y, z"
        if self.estimated:
            return f"{found}; it is estimated and taken off"
        return (
            f"{found} (p = {self.p_value:.2g}): solver.drift: linear takes it off, with its "
            "uncertainty"
        )


def triple(values: Floats, digits: int) -> str:
    """Write three numbers in brackets."""
    return "(" + ", ".join(f"{value:.{digits}f}" for value in values) + ")"


def find_drift(
    problem: BallPlateProblem, solution: Solution, effects: OrderEffects
) -> DriftTest | None:
    """Test the three linear drifts together; None where the residuals do not keep them."""
    if solution.drift is not None:
        return _estimated(solution, solution.drift)
    columns = drift_columns(problem.run_time, 1)
    kept = drift_seen(problem, columns, effects.drift.seen.information)
    if kept < VISIBLE or solution.dof < SPARE:
        return None
    score = np.einsum("nia,ni->a", columns, problem.weights * solution.residuals)
    seen, rest = replace(effects.drift.seen, score=score), solution.weighted_square_sum
    test = effect_test(seen, (rest, solution.dof), least_noise(problem, solution), NOTHING)
    std = np.sqrt(test.variance * np.diag(test.covariance))
    return DriftTest(test.size, std, test.probability, estimated=False)


def _from_the_end(rows: Floats) -> Floats:
    """Return the sum of each of ``rows`` (n, ...) and all later ones, in their place."""
    np.cumsum(rows[::-1], axis=0, out=rows[::-1])
    return rows


def least_noise(problem: BallPlateProblem, solution: Solution) -> float:
    """Return the variance below which the rest is no noise; in units of ``std``, if given."""
    stated = 1.0 if problem.std is not None else problem.sigma or 0.0
    return max(least_variance(problem, solution.estimate), (SETTLED * stated) ** 2)


def _estimated(solution: Solution, drift: OriginDrift) -> DriftTest:
    """Test the linear part of an estimated drift."""
    linear = drift.unit_covariance[:3, :3]
    variance = solution.weighted_square_sum / solution.dof
    amount = drift.amount[0]
    value = float(amount @ np.linalg.solve(linear, amount)) / 3.0 / max(variance, 1e-300)
    std = np.sqrt(variance * np.diag(linear))
    return DriftTest(amount, std, f_sf(value, 3, solution.dof), estimated=True)


@dataclass(frozen=True)
class PlateMotion:
    """The plate moved between the rows ``last`` and ``first``, or most likely so.

    ``shift`` (3,) metres and ``rotation`` (3,) radians are its motion on the table, in the
    table's frame at position 0, ``gain`` what it explains of w'w, ``scatter`` the variance it was
    tested against. Motions that the CMM's own errors can imitate are found as zero: they do no
    harm either. ``p_value``: how probably chance makes as much of one. ``knock``: it is beyond
    doubt, and explains more than a single centre.
    """

    last: int
    first: int
    ball_step: int
    position: int
    shift: Floats
    rotation: Floats
    gain: float
    scatter: float
    p_value: float
    knock: bool = False

    @property
    def significant(self) -> bool:
        """Whether the plate has moved."""
        return self.p_value < SIGNIFICANCE

    def in_whole(self, whole: BallPlateProblem, rotation: Floats) -> PlateMotion:
        """Return the same in the numbers of ``whole``, in the frame that ``rotation`` leads to."""
        at = int(np.flatnonzero(whole.rows == self.first)[0])
        return replace(
            self,
            ball_step=int(whole.ball_step[at]),
            position=int(whole.position[at]),
            shift=rotation @ self.shift,
            rotation=rotation @ self.rotation,
        )

    def details(self) -> dict[str, Any]:
        """Return it for the details of a result, SI."""
        moved = {"shift": self.shift, "rotation": self.rotation}
        if self.knock:
            return {"last_row": self.last, "first_row": self.first, **moved}
        return {"row": self.first, **moved, "p_value": self.p_value}

    def sentence(self) -> str:
        """Say in words what happened and when."""
        if self.knock:
            return (
                f"the plate moved on the table between rows {self.last} and {self.first} (before "
                f"ball step {self.ball_step} at table position {self.position}): all later "
                f"centres are displaced by about {triple(self.shift / MICROMETRE, 2)} um and "
                f"turned by {triple(self.rotation / ARCSEC, 2)} arcsec; fix the plate and measure "
                "again"
            )
        return (
            f"the plate seems to have moved on the table near row {self.first} by "
            f"{triple(self.shift / MICROMETRE, 3)} um and {triple(self.rotation / ARCSEC, 3)} "
            f"arcsec (p = {self.p_value:.2g}): look at its clamping, or measure again"
        )


def find_knock(
    problem: BallPlateProblem, linear: LinearFit, solution: Solution, sigma: float | None
) -> PlateMotion | None:
    """Look between any two rows for a moment when the plate moved; None when none stands out.

    From the remaining scatter, or the stated ``sigma`` (of unit weight) where that is larger.
    """
    if solution.dof <= 12:  # six parameters, and too little left to test them by
        return None
    order, later = _pulled(problem, solution)
    place = np.argsort(order)  # of each row in the order of measurement
    starts = sorted(_candidates(later, plate_motion(problem), problem.weights, order))
    tried = {start: _alike(linear.seen_of_plate(place >= start)) for start in starts}
    least = max((sigma or 0.0) ** 2, least_variance(problem, solution.estimate))
    found = _likeliest(problem, solution, tried, (least, IMITATED), len(order))
    return replace(found, knock=True) if found and found.p_value < FALSE_KNOCK else None


def find_motion(
    problem: BallPlateProblem, solution: Solution, effects: OrderEffects
) -> PlateMotion | None:
    """Return the most likely motion of the plate at one of the moments of ``effects``."""
    if solution.dof < SPARE:
        return None
    tried = dict(zip(effects.moments.tolist(), (k.seen for k in effects.knocks), strict=True))
    limits = least_noise(problem, solution), NOTHING
    return _likeliest(problem, solution, tried, limits, len(tried))


def _pulled(problem: BallPlateProblem, solution: Solution) -> tuple[Ints, Floats]:
    """Return what the residuals say of a motion of the plate.

    The rows in the order of measurement (n,), and the right-hand side (n, 6) of the motion of all
    rows from each one on.
    """
    order = np.argsort(problem.rows, kind="stable")
    weighted = problem.weights * solution.residuals
    return order, _from_the_end(np.einsum("nij,ni->nj", plate_motion(problem), weighted)[order])


def _likeliest(
    problem: BallPlateProblem,
    solution: Solution,
    tried: Mapping[int, Seen],
    limits: tuple[float, float],
    count: int,
) -> PlateMotion | None:
    """Return the likeliest of the motions that were ``tried``, by the row they begin with.

    ``limits``: variance and ``nothing`` as of :func:`~rotcal_ros.adjust.effects.effect_test`. Of
    ``count`` moments (Bonferroni); after the last row nothing shows one.
    """
    order, later = _pulled(problem, solution)
    rest = solution.weighted_square_sum, solution.dof
    tests = [
        (start, effect_test(replace(seen, score=later[start]), rest, *limits))
        for start, seen in tried.items()
        if start < len(order)
    ]
    if not tests:
        return None
    start, test = min(tests, key=lambda each: (each[1].probability, -each[1].squares))
    return PlateMotion(
        last=int(problem.rows[order[start - 1]]),
        first=int(problem.rows[order[start]]),
        ball_step=int(problem.ball_step[order[start]]),
        position=int(problem.position[order[start]]),
        shift=test.size[:3],
        rotation=test.size[3:] / problem.radius,
        gain=test.squares,
        scatter=test.variance,
        p_value=min(1.0, test.probability * count),
    )


def _candidates(later: Floats, motion: Floats, weight: Floats, order: Ints) -> list[int]:
    """Return the most likely moments by a bound on their gain, best first.

    ``later`` (n, 6) is in the ``order`` of measurement. The bound leaves out that table and CMM
    absorb part of the motion; it peaks where the gain does. Moments within 1 % of each other count
    as one.
    """
    bound = sum(_bound(later[:, own], motion[:, :, own], weight, order) for own in PARTS)
    chosen: list[int] = []
    for index in np.argsort(-bound, kind="stable"):
        start = int(index) + 1
        if all(abs(start - other) > 0.01 * len(later) for other in chosen):
            chosen.append(start)
        if len(chosen) == CANDIDATES:
            break
    return chosen


def _bound(later: Floats, motion: Floats, weight: Floats, order: Ints) -> Floats:
    """Return what motions (n, 3, m) from every row but the first on gain at most, (n - 1,)."""
    information = _from_the_end(np.einsum("nij,ni,nik->njk", motion, weight, motion)[order])
    total, information, later = information[0], information[1:], later[1:]
    # a motion of all rows together is seen by nothing and taken off, as an unknown of its own;
    # the small part of the total keeps the matrices regular at both ends of the run
    spread = np.linalg.pinv(total) @ information
    spread = information @ np.subtract(np.eye(len(total)), spread, out=spread)
    spread += 1e-9 * total
    amount = np.linalg.solve(spread, later[:, :, None])[:, :, 0]
    return np.asarray(np.einsum("nj,nj->n", later, amount))
