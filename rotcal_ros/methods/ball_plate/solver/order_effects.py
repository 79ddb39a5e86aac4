"""Drift and knocks in the order of measurement: whether they would be seen, and are there.

A drift of the CMM's origin and a knock, a motion of the plate on the table from some moment on,
displace the centres by known patterns, and the estimate is linear. So the error per unit is exact,
and what the residuals keep of the pattern tells the size at which a test finds it with a
probability of POWER: :func:`order_effects` needs no measured values. :func:`find_drift` and
:func:`find_motion` look for the same patterns in the residuals of a fit. :func:`find_knock`
looks between any two rows, by itself, and has the last word on a plate that jumped; the test of a
motion finds what is too small for it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import f_isf, f_noncentrality, f_sf
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
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
CANDIDATES: Final = 3
"""Moments of a knock whose motion is fitted with all that table and CMM take of it."""


@dataclass(frozen=True, eq=False)
class DisplacementPatterns:
    """Some patterns of displacement, m columns: amounts in metres, rotations times radius.

    ``felt`` are the errors of the deviations of each part per unit of its patterns, (3, N, .), m
    and rad. The amount a changes w'w of the fit by a' ``information`` a, and that of the
    difference between the first table position and its repetition at the end by a' ``closing`` a
    (zero without); (m, m). ``total`` is the mean information that perfect knowledge of all else
    would leave.
    """

    felt: tuple[Floats, Floats]
    information: Floats
    closing: Floats
    total: float

    @classmethod
    def of(
        cls, response: Floats, information: Floats, closing: Floats, total: float
    ) -> DisplacementPatterns:
        """Return those with the errors ``response`` (6, N, m) of the six deviations per unit."""
        m = response.shape[2]
        first, second = (response[part][:, :, _of_part(part, m)] for part in PARTS)
        return cls((first, second), information, closing, total)

    @property
    def response(self) -> Floats:
        """Errors of the six deviations per unit (6, N, m), m and rad."""
        m = len(self.information)
        response = np.zeros((6, self.felt[0].shape[1], m))
        for part, felt in zip(PARTS, self.felt, strict=True):
            for k, number in enumerate(_of_part(part, m)):
                response[part, :, number] = felt[:, :, k]
        return response

    @property
    def seen(self) -> float:
        """Information from which on a direction counts as seen, not as rounding."""
        return NOTHING * self.total


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

    def patterns(
        moved: tuple[Floats, Floats], closed: Floats, total: float
    ) -> DisplacementPatterns:
        """Return those of a fit, ``closed`` (k, 3, m) between first and last, ``total`` of all."""
        # a difference of two centres has twice the variance of one
        closing = 0.5 * np.einsum("nia,nib->ab", closed, closed)
        return DisplacementPatterns.of(*moved, closing, total / len(closing))

    drift, motion = drift_columns(problem.run_time, 1), plate_motion(problem)
    squares = np.einsum("ni,nia->n", problem.weights, motion**2)
    return OrderEffects(
        drift=patterns(
            linear.moved_by(drift),
            drift_columns(change, 1),
            float(np.einsum("ni,nia->", problem.weights, drift**2)),
        ),
        knocks=tuple(
            patterns(
                linear.moved_with_plate(place >= moment),
                motion[again[place[again] < moment]],
                float(squares[place >= moment].sum()),
            )
            for moment in moments
        ),
        moments=moments,
    )


def _of_part(part: list[int], m: int) -> list[int]:
    """Return which of m patterns, a drift or a motion, belong to a part."""
    return [number for number in part if number < m]


def needed(parameters: int, dof: int, tests: int = 1) -> float:
    """Return the noncentrality that an F test at SIGNIFICANCE / ``tests`` finds with POWER."""
    limit = float(f_isf(SIGNIFICANCE / tests, parameters, dof))
    return f_noncentrality(limit, parameters, dof, POWER)


def found_size(
    disturbance: DisplacementPatterns, amount: Floats, fit: float, closure: float
) -> float:
    """Return how many times ``amount`` (m,) must be there to be found, for unit noise.

    ``fit`` and ``closure`` are the noncentralities that the two tests need; infinite when both
    are blind.
    """
    seen = amount @ disturbance.information @ amount / fit
    again = amount @ disturbance.closing @ amount / closure
    best = max(float(seen), float(again))
    blind = disturbance.seen * float(amount @ amount) / max(fit, closure)
    return float(best**-0.5) if best > blind else float("inf")


def _worst_unseen(
    disturbance: DisplacementPatterns, std: Floats, fit: float, closure: float
) -> float:
    """Return the largest error, in ``std`` (6, N) for unit noise, of what is not yet found.

    Over all directions of the amounts, components and positions; of the bounds by either test
    and by both together the smallest holds.
    """
    fitted, closed = disturbance.information / fit, disturbance.closing / closure
    floor, worst = disturbance.seen / max(fit, closure), 0.0
    for part, felt in zip(PARTS, disturbance.felt, strict=True):
        gain = (felt / std[part][:, :, None]).reshape(-1, felt.shape[2])
        own = np.ix_(_of_part(part, len(fitted)), _of_part(part, len(fitted)))
        bounds = [
            factor * _largest(gain, information[own], floor)
            for factor, information in ((1.0, fitted), (1.0, closed), (2.0, fitted + closed))
        ]
        worst = max(worst, float(np.min(bounds, axis=0).max()))
    return float(np.sqrt(worst))


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


@dataclass(frozen=True)
class MotionTest:
    """The most likely motion of the plate: from ``row`` on, shift (3,) m, rotation (3,) rad."""

    row: int
    shift: Floats
    rotation: Floats
    p_value: float

    def turned(self, rotation: Floats) -> MotionTest:
        """Return the same in another frame, to which ``rotation`` (3, 3) takes vectors."""
        return replace(self, shift=rotation @ self.shift, rotation=rotation @ self.rotation)

    @property
    def significant(self) -> bool:
        """Whether the plate has moved."""
        return self.p_value < SIGNIFICANCE

    def sentence(self) -> str:
        """Say in words what seems to have moved when."""
        return (
            f"the plate seems to have moved on the table near row {self.row} by "
            f"{triple(self.shift / MICROMETRE, 3)} um and {triple(self.rotation / ARCSEC, 3)} "
            f"arcsec (p = {self.p_value:.2g}): look at its clamping, or measure again"
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
    seen = drift_seen(problem, columns, effects.drift.information)
    if seen < VISIBLE or solution.dof < SPARE:
        return None
    right = np.einsum("nia,ni->a", columns, problem.weights * solution.residuals)
    least = least_noise(problem, solution)
    amount, inverse, p_value, variance = _tested(effects.drift, right, solution, least)
    return DriftTest(amount, np.sqrt(variance * np.diag(inverse)), p_value, estimated=False)


def find_motion(
    problem: BallPlateProblem, solution: Solution, effects: OrderEffects
) -> MotionTest | None:
    """Look for a motion of the plate at each of the moments of ``effects``."""
    if solution.dof < SPARE:
        return None
    order, later = _pulled(problem, solution, plate_motion(problem))
    best: MotionTest | None = None
    least = least_noise(problem, solution)
    for moment, knock in zip(effects.moments, effects.knocks, strict=True):
        if moment >= len(order):
            continue  # after the last row nothing shows it
        amount, _, p_value, _ = _tested(knock, later[moment], solution, least)
        p_value = min(1.0, p_value * len(effects.knocks))  # Bonferroni: the best of so many
        if best is None or p_value < best.p_value:
            row = int(problem.rows[order[moment]])
            best = MotionTest(row, amount[:3], amount[3:] / problem.radius, p_value)
    return best


def _pulled(problem: BallPlateProblem, solution: Solution, motion: Floats) -> tuple[Ints, Floats]:
    """Return what the residuals say of a ``motion`` (n, 3, 6) of the plate.

    The rows in the order of measurement (n,), and the right-hand side (n, 6) of the motion of all
    rows from each one on.
    """
    order = np.argsort(problem.rows, kind="stable")
    pulled = np.einsum("nij,ni->nj", motion, problem.weights * solution.residuals)[order]
    return order, _from_the_end(pulled)


def _from_the_end(rows: Floats) -> Floats:
    """Return the sum of each of ``rows`` (n, ...) and all later ones, in their place."""
    np.cumsum(rows[::-1], axis=0, out=rows[::-1])
    return rows


def least_noise(problem: BallPlateProblem, solution: Solution) -> float:
    """Return the variance below which the rest is no noise; in units of ``std``, if given."""
    stated = 1.0 if problem.std is not None else problem.sigma or 0.0
    return max(least_variance(problem, solution.estimate), (SETTLED * stated) ** 2)


def _tested(
    pattern: DisplacementPatterns, right: Floats, solution: Solution, floor: float
) -> tuple[Floats, Floats, float, float]:
    """Return amount, unit covariance, p value of its F test, and the variance of the rest."""
    # only along the directions of which the fit leaves anything
    values, vectors = np.linalg.eigh(pattern.information)
    seen = values > pattern.seen
    rank = int(np.count_nonzero(seen))
    inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T
    amount: Floats = inverse @ right
    gain = float(right @ amount)
    dof = solution.dof - rank
    if not rank:
        return amount, inverse, 1.0, floor
    variance = max((solution.weighted_square_sum - gain) / dof, floor)
    return amount, inverse, f_sf(gain / rank / variance, rank, dof), variance


def _estimated(solution: Solution, drift: OriginDrift) -> DriftTest:
    """Test the linear part of an estimated drift."""
    linear = drift.unit_covariance[:3, :3]
    variance = solution.weighted_square_sum / solution.dof
    amount = drift.amount[0]
    value = float(amount @ np.linalg.solve(linear, amount)) / 3.0 / max(variance, 1e-300)
    std = np.sqrt(variance * np.diag(linear))
    return DriftTest(amount, std, f_sf(value, 3, solution.dof), estimated=True)


@dataclass(frozen=True)
class Knock:
    """The plate moved between the rows ``last`` and ``first`` (row numbers).

    ``shift`` (3,) metres and ``rotation`` (3,) radians are its motion on the table, in the
    table's frame at position 0, ``gain`` what it explains of w'w, ``scatter`` the variance it was
    tested against. Motions that the CMM's own errors can imitate are found as zero: they do no
    harm either.
    """

    last: int
    first: int
    ball_step: int
    position: int
    shift: Floats
    rotation: Floats
    gain: float
    scatter: float

    def in_whole(self, whole: BallPlateProblem, rotation: Floats) -> Knock:
        """Return the same in the numbers of ``whole``, in the frame that ``rotation`` leads to."""
        at = int(np.flatnonzero(whole.rows == self.first)[0])
        return replace(
            self,
            ball_step=int(whole.ball_step[at]),
            position=int(whole.position[at]),
            shift=rotation @ self.shift,
            rotation=rotation @ self.rotation,
        )

    def sentence(self) -> str:
        """Say in words what happened and when."""
        return (
            f"the plate moved on the table between rows {self.last} and {self.first} (before "
            f"ball step {self.ball_step} at table position {self.position}): all later centres "
            f"are displaced by about {triple(self.shift / MICROMETRE, 2)} um and turned by "
            f"{triple(self.rotation / ARCSEC, 2)} arcsec; fix the plate and measure again"
        )


def find_knock(
    problem: BallPlateProblem, linear: LinearFit, solution: Solution, sigma: float | None
) -> Knock | None:
    """Look along the rows in their order of measurement for a moment when the plate moved.

    The motion has six parameters from the moment on; the gain of w'w is tested against the
    remaining scatter, or the stated ``sigma`` (of unit weight) where that is larger. None when no
    moment stands out.
    """
    if solution.dof <= 12:  # six parameters, and too little left to test them by
        return None
    motion = plate_motion(problem)
    order, later = _pulled(problem, solution, motion)
    place = np.argsort(order)  # of each row in the order of measurement
    fitted = [
        (*_fit_motion(linear, place >= start, later[start]), start)
        for start in sorted(_candidates(later, motion, problem.weights, order))
    ]
    gain, amount, start = max(fitted, key=lambda each: each[0])
    rest = (solution.weighted_square_sum - gain) / (solution.dof - 6)
    scatter = max(rest, (sigma or 0.0) ** 2, least_variance(problem, solution.estimate))
    if gain / 6.0 < scatter * f_isf(FALSE_KNOCK / len(order), 6, solution.dof - 6):
        return None
    row = order[start]
    return Knock(
        last=int(problem.rows[order[start - 1]]),
        first=int(problem.rows[row]),
        ball_step=int(problem.ball_step[row]),
        position=int(problem.position[row]),
        shift=amount[:3],
        rotation=amount[3:] / problem.radius,
        gain=gain,
        scatter=scatter,
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


def _fit_motion(linear: LinearFit, there: Bools, right: Floats) -> tuple[float, Floats]:
    """Return gain of w'w and the motion (6,) of the plate in the rows ``there`` (n,)."""
    _, information = linear.moved_with_plate(there)
    # a motion that the CMM's own errors imitate leaves nothing: it counts as zero
    amount: Floats = np.linalg.pinv(information, rcond=1e-6, hermitian=True) @ right
    return float(right @ amount), amount
