"""Fit, test, reject, fit again: until every centre fits or the plate is found to have moved.

Each round leaves out what is proved to be wrong together in one place (:mod:`.gathering`), else
single centres, the worst first, whose normalised residual is no chance among so many.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from rotcal_ros.adjust.distributions import f_isf
from rotcal_ros.adjust.gathering import Gathering
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import DataError, ObservabilityError
from rotcal_ros.foundation.results import Rejection
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.methods.ball_plate.solver import model
from rotcal_ros.methods.ball_plate.solver.estimate import solved
from rotcal_ros.methods.ball_plate.solver.gathering import Taken, gathered, left_out, suspected
from rotcal_ros.methods.ball_plate.solver.growth import Growth, find_growth
from rotcal_ros.methods.ball_plate.solver.model import LinearFit, Solution
from rotcal_ros.methods.ball_plate.solver.order_effects import PlateMotion, find_knock
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.solver.separability import (
    MIN_BALLS,
    balls_at_positions,
    require_balls,
    require_separable,
)

MOST = 0.1
"""Part of the centres that may be rejected before the data are called contradictory."""
FALSE_ALARM = 0.01
"""Probability that good data lose any centre at all."""
MOST_PLACES = 5
"""Places of which centres that are wrong together are left out; more are no single places."""
MISNAMED = 1e-4
"""Probability that one bad centre, where it looks like a jump, is called one."""
LEAK = 0.3
"""Part of the worst normalised residual below which a row may only follow a worse one."""
MOST_OPEN = 0.25
"""Part of the table positions that may be left out for lack of balls."""
DETERMINED = 1e-8
"""Residual cofactors below this part of the largest belong to coordinates without a check."""


@dataclass(frozen=True)
class CentreTest:
    """Test of every centre (n,): its removal would lower w'w by ``gain``.

    ``value`` is the normalised residual sqrt(gain / rank) / sigma, ``critical`` (n,) what it may
    reach in good data, ``redundancy`` in [0, 1] how much of an error stays in the residual.
    """

    gain: Floats
    value: Floats
    critical: Floats
    redundancy: Floats


@dataclass(frozen=True)
class Fitted:
    """The rows that were kept, their solution and tests, the rejected ones and why.

    Table positions that are not among those of ``problem`` were left out. ``grown``: the growth
    of the plate explains more than any knock or single centre. ``gathering``: what was found to be
    wrong together, and how each group fits; not judged after a knock or a growth.
    """

    problem: BallPlateProblem
    linear: LinearFit
    solution: Solution
    test: CentreTest
    rejected: tuple[Rejection, ...]
    knock: PlateMotion | None
    growth: Growth
    grown: bool = False
    gathering: Gathering = field(default_factory=Gathering)


def fit_and_reject(problem: BallPlateProblem, named: BallPlateProblem | None = None) -> Fitted:
    """Solve, and reject what is wrong together in one place, then single centres, worst first.

    A jump of the plate that explains more than the worst centre ends the rejection, and so does
    its growth: rows that moved are not wrong one by one. ``named``: the same rows as people
    number them; None: as in ``problem``. Raises ObservabilityError when too little is left,
    DataError when more than a tenth of the centres would have to go.
    """
    whole, rejected, poor = named or problem, list[Rejection](), list[Rejection]()
    gathering = Gathering()
    while True:
        problem, open_ = _without_poor_positions(problem, whole)
        poor += open_
        linear, solution = _solve(problem)
        if solution.dof < 1:
            raise DataError(
                f"{len(problem.centres)} centres leave no redundancy: nothing can be checked; "
                "measure more balls or CMM positions"
            )
        sigma = 1.0 if problem.std is not None else problem.sigma
        test = judge_centres(problem, solution, sigma)
        knock = find_knock(problem, linear, solution, sigma)
        if knock is not None and not _more_than_one_centre(knock, test, solution.dof):
            knock = None
        growth = find_growth(problem, linear, solution)
        others = max(float(test.gain.max()), 0.0 if knock is None else knock.gain)
        grown = growth.evident and growth.gain > others
        if grown:
            knock = None
        if grown or knock is not None:
            gathering, why = Gathering(blamed=gathering.blamed), dict[int, str]()
        else:
            taken = Taken(whole, np.array([r.index for r in rejected], dtype=np.int64))
            gathering = gathered(gathering, problem, solution, sigma, test.redundancy, taken)
            gathering, why = _next(gathering, problem, solution, test)
        if not why:
            found = (*rejected, *poor)
            return Fitted(problem, linear, solution, test, found, knock, growth, grown, gathering)
        rejected += [
            Rejection(int(problem.rows[r]), f"{_name(problem, whole, r)}: {text}")
            for r, text in why.items()
        ]
        _check_share(len(rejected), whole, rejected[0])
        problem = problem.take(np.setdiff1d(np.arange(len(problem.centres)), list(why)))


def _next(
    gathering: Gathering, problem: BallPlateProblem, solution: Solution, test: CentreTest
) -> tuple[Gathering, dict[int, str]]:
    """Return which rows to leave out next, with the reason, and what is known to gather then."""
    together = left_out(gathering) if len(gathering.blamed) < MOST_PLACES else None
    if together is not None:
        return together
    bad, kept = choose(problem, test), suspected(gathering)
    if np.isin(bad, kept).any():
        # The centre that fits worst is often a good one among several that are displaced.
        bad = np.setdiff1d(bad, kept)
        gathering = replace(gathering, contested=True)
    why = {int(r): _reason(solution.residuals[r], test, int(r)) for r in bad}
    return gathering, why


def _name(problem: BallPlateProblem, whole: BallPlateProblem, r: int) -> str:
    """Return what people call a row of ``problem``: its place among ``whole`` rows."""
    return whole.row_name(int(np.flatnonzero(whole.rows == problem.rows[r])[0]))


def _without_poor_positions(
    problem: BallPlateProblem, whole: BallPlateProblem
) -> tuple[BallPlateProblem, list[Rejection]]:
    """Leave out the table positions with fewer than three balls: their six errors are open.

    Their balls connect nothing, so the others lose nothing. Raises ObservabilityError that names
    them when they are too many.
    """
    count = balls_at_positions(problem)
    poor = np.flatnonzero(count < MIN_BALLS)
    if len(poor) > MOST_OPEN * problem.n_positions:
        require_balls(problem, everywhere=True)
    away = np.isin(problem.position, poor)
    rejected = [
        Rejection(
            int(problem.rows[r]),
            f"{_name(problem, whole, r)}: only {count[problem.position[r]]} balls are left at "
            "this table position, which leaves its six errors open: the angle is left out",
        )
        for r in np.flatnonzero(away).tolist()
    ]
    return (problem.take(~away) if rejected else problem), rejected


def _more_than_one_centre(knock: PlateMotion, test: CentreTest, dof: int) -> bool:
    """Return whether a jump (six parameters) explains more than the worst centre alone (three).

    One bad centre at the end of a series looks like a jump of its own row, and the jump takes some
    noise of a second row on top: the difference is tested by F with three parameters.
    """
    more = (knock.gain - float(test.gain.max())) / 3.0
    return more > knock.scatter * float(f_isf(MISNAMED, 3, dof - 6))


def _solve(problem: BallPlateProblem) -> tuple[LinearFit, Solution]:
    """Solve, or say in words which harmonics of which component cannot be separated."""
    try:
        return solved(problem)
    except ObservabilityError:
        require_separable(problem)  # names the harmonics, where it is the harmonics
        raise


def _reason(residual: Floats, test: CentreTest, r: int) -> str:
    """Say why a row is rejected; ``residual`` (3,), m."""
    size = float(np.linalg.norm(residual)) / MICROMETRE
    return (
        f"residual {size:.3g} um, normalised {test.value[r]:.1f} where {test.critical[r]:.1f} is "
        "the limit"
    )


def _check_share(count: int, problem: BallPlateProblem, worst: Rejection) -> None:
    if count > MOST * len(problem.centres):
        raise DataError(
            f"{count} of {len(problem.centres)} centres contradict the others, more than "
            f"{MOST:.0%} may not be rejected; the worst: {worst.why}; check the assignment and "
            "measure again"
        )


def judge_centres(
    problem: BallPlateProblem, solution: Solution, sigma: float | None
) -> CentreTest:
    """Test each centre against the scatter of all the others.

    Its own part is left out, so that a gross error cannot hide behind the scatter it causes.
    Where the stated ``sigma`` (of unit weight) is larger it takes the place of the scatter; a
    statement that is too small must not cost good centres (the chi-square test reports it).
    """
    own = problem.noise_unit**2
    cofactor, largest = solution.cofactor(), own.max(axis=1)[:, None]
    # along the axes of its cofactor; coordinates that nothing checks have no part in the test
    values, vectors = np.linalg.eigh(cofactor / largest[:, :, None])
    values = values * largest
    checked = values > DETERMINED * largest
    along = np.einsum("nij,ni->nj", vectors, solution.residuals)
    gain = np.sum(np.where(checked, along**2 / np.where(checked, values, 1.0), 0.0), axis=1)
    rank = np.maximum(checked.sum(axis=1), 1)
    others = np.maximum(solution.dof - rank, 1)
    ranks = np.arange(1, 4)  # every limit is one of three
    limits = f_isf(FALSE_ALARM / len(gain), ranks, np.maximum(solution.dof - ranks, 1))
    # the scatter of the others, or what was stated, or what exact data leave
    least = max((sigma or 0.0) ** 2, model.least_variance(problem, solution.estimate))
    variance = np.maximum((solution.weighted_square_sum - gain) / others, least)
    return CentreTest(
        gain=gain,
        value=np.sqrt(gain / rank / variance),
        critical=np.sqrt(limits)[rank - 1],
        redundancy=np.einsum("nii,ni->n", cofactor, 1.0 / own) / 3.0,
    )


def choose(problem: BallPlateProblem, test: CentreTest) -> Ints:
    """Return the rows to reject together: the worst, and others that share nothing with it.

    A gross error leaks into the residuals of the same ball, table and CMM position, and a little
    into all others; rows that share none of the three with a worse one, and are not much
    smaller than the worst, are guilty on their own account. The others wait for the next fit.
    """
    ratio = test.value / test.critical
    outside = np.argsort(-ratio, kind="stable")[: np.count_nonzero(ratio > 1.0)]
    chosen: list[int] = []
    for row in outside:
        if test.value[row] < LEAK * test.value[outside[0]]:
            continue
        shares = (
            problem.ball_step[row] == problem.ball_step[chosen],
            problem.position[row] == problem.position[chosen],
            problem.cmm_index[row] == problem.cmm_index[chosen],
        )
        if not np.any(shares):
            chosen.append(int(row))
    return np.array(chosen, dtype=np.int64)
