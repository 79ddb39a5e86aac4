"""Disturbances that gather in one place: at a table position, a ball, a CMM position.

What lasts for a while is a run of rows at a position of the table or the CMM, one of which rests
in every order of measurement.

The engine in :mod:`rotcal_ros.adjust` judges; here are the groups of a plate's centres and what
the model says of them. Residual cofactors of all groups and the map to the six deviations follow
from the layout alone and are remembered. Only groups that show anything at all are judged.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import chi2_isf
from rotcal_ros.adjust.felt import Felt
from rotcal_ros.adjust.groups import CHECKED, Group
from rotcal_ros.adjust.judgement import Belief, Blame, Judgement, blame, judge
from rotcal_ros.adjust.reliability import Hidden, hidden
from rotcal_ros.adjust.subsets import distinct, runs
from rotcal_ros.arrays import Bools, Floats, Ints
from rotcal_ros.methods.ball_plate import general, model
from rotcal_ros.methods.ball_plate.drift import drift_columns
from rotcal_ros.methods.ball_plate.model import Solution
from rotcal_ros.methods.ball_plate.order_effects import Layout, layout_of
from rotcal_ros.methods.ball_plate.problem import BallPlateProblem
from rotcal_ros.protection import POWER
from rotcal_ros.units import MICROMETRE

EVEN: Final = 2.0
"""ln of the Bayes factor from which on a result is suspect; below, U covers what is probable. One
of 100 sound plates reached it."""
SIGNIFICANCE: Final = 0.01
"""Probability below which chance may cost good centres of one place."""
BELIEF: Final = Belief(disturbed=0.8)
"""Disturbances are held to be likely: what can be neither proved nor excluded widens U."""
MOST_UNKNOWNS: Final = 1200
"""Unknowns up to which groups are judged: the work grows with their third power."""
RUNS: Final = (2, 3, 4, 5, 6, 8, 12)
"""How many neighbours are tried together, along a ball's turn or in time."""
SHOWS: Final = 14.0
"""Chi-squared of a common shift from which on a group is judged: less cannot be probable."""
SUSPICIOUS: Final = 0.01
"""Probability of a group's residuals below which it is judged."""
MANY: Final = 8
"""Groups of a kind from which on their typical scatter is known."""
SHARED: Final = 1.25
"""Ratio of the typical group's squares to chance from which on all groups of a kind scatter."""
LARGEST: Final = 1e-3
"""Displacement, m, that the screening finds anyway."""


@dataclass(frozen=True, eq=False)
class Place:
    """The rows (e,) of one group, its residual cofactor with pseudo-inverse (3 e, 3 e) and rank.

    ``gathered`` (q, e) are its subsets, ``inverse`` (q, 3, 3) the covariances of their shifts.
    """

    kind: str
    name: str
    rows: Ints
    cofactor: Floats
    whole: Floats
    rank: int
    gathered: Bools
    inverse: Floats

    def group(self, whitened: Floats, unit: Floats, response: Floats | None) -> Group:
        """Return the engine's group; ``response`` (6 M, n, 3), None for none."""
        none = np.zeros((1, 3 * len(self.rows)))
        return Group(
            kind=self.kind,
            name=self.name,
            members=self.rows,
            residual=whitened[self.rows],
            cofactor=self.cofactor,
            felt=Felt.whole(
                none if response is None else response[:, self.rows].reshape(len(response), -1)
            ),
            unit=unit[self.rows],
            gathered=self.gathered,
        )


@dataclass(frozen=True, eq=False)
class View:
    """All groups of a layout, and the errors (6 M, n, 3) of the deviations per unit of a row."""

    places: tuple[Place, ...]
    response: Floats


@dataclass(frozen=True, eq=False)
class Gathered:
    """What is believed after a fit of ``positions`` (M,); ``blame`` is None where all is kept.

    ``covariance`` (6 M, 6 M), m and rad, is what probable but unproved disturbances add, or what
    the choice adds which of several explanations is taken. ``contested``: some centre alone would
    be rejected there, which explains it no better.
    """

    positions: Ints
    judgement: Judgement
    blame: Blame | None
    contested: bool = False

    @property
    def covariance(self) -> Floats:
        """What it adds to the covariance (6 M, 6 M)."""
        if self.blame is not None:
            return self.blame.covariance
        return self.judgement.covariance()

    @property
    def doubtful(self) -> bool:
        """Whether the residuals speak for a disturbance beyond what chance makes of sound ones."""
        return self.contested or self.judgement.log_bayes > EVEN

    @property
    def rows(self) -> Ints:
        """The rows to leave out, as the problem has them."""
        if self.blame is None:
            return np.empty(0, dtype=np.int64)
        return np.asarray(self.blame.group.members[self.blame.subset])

    @property
    def suspected(self) -> Ints:
        """The rows of the place where something gathers most probably, as the problem has them."""
        return self.judgement.groups[self.judgement.worst].members

    def sentence(self) -> str:
        """Say in words what gathers where."""
        if self.blame is None:
            group = self.judgement.groups[self.judgement.worst]
            return (
                f"something may be wrong with several of the {group.size} centres of "
                f"{group.name}: the uncertainty covers it; measure them again"
            )
        size = self.blame.size / MICROMETRE
        group = self.blame.group
        text = (
            f"{int(self.blame.subset.sum())} of the {group.size} centres of {group.name} are "
            f"displaced together by about ({size[0]:.2f}, {size[1]:.2f}, {size[2]:.2f}) um and "
            "are left out"
        )
        if self.blame.ambiguous:
            text += "; other ones explain it nearly as well, the uncertainty covers both"
        return f"{text}: look for dirt, a touched plate or warm air there, and measure it again"


def judged(problem: BallPlateProblem, solution: Solution, sigma: float | None) -> Gathered | None:
    """Return what gathers in one place of a fitted problem; None where nothing shows.

    ``sigma``: the stated noise of unit weight, m (or 1), None where it is not known; the noise in
    the residuals counts, axis by axis, where it is larger or nothing was stated. Problems of more
    than MOST_UNKNOWNS unknowns are not judged.
    """
    if not can_judge(problem):
        return None
    view = view_of(problem)
    whitened, unit, rest, scale = _whitened(problem, solution, sigma)
    shown = _showing([p for p in view.places if len(p.rows) >= 4], whitened)
    if not shown:
        return None
    among = len(view.places)
    without = judge(
        [p.group(whitened, unit, None) for p in shown],
        belief=BELIEF,
        rest=rest,
        searched=SUSPICIOUS,
        among=among,
    )
    if not without.possible:
        return None
    likely = [p for p, b in zip(shown, without.by_group, strict=True) if b > 1e-3]
    response = view.response * scale
    groups = [p.group(whitened, unit, response) for p in likely]
    found = judge(groups, belief=BELIEF, rest=rest, searched=SUSPICIOUS, among=among)
    proved = without.proved(SIGNIFICANCE)
    to_blame = blame(found.groups[found.worst], BELIEF) if proved else None
    return Gathered(problem.table_positions, found, to_blame)


def can_judge(problem: BallPlateProblem) -> bool:
    """Tell whether a problem is small enough to be judged place by place."""
    return model.offsets(problem).total <= MOST_UNKNOWNS


def unseen(
    problem: BallPlateProblem, sigma: tuple[Floats, Floats], significance: float = SIGNIFICANCE
) -> Hidden | None:
    """Return the worst at a table position, for its deviations, that no test sees; None: unknown.

    ``sigma``: noise (3,) of the axes in units of ``std``, and standard deviations (6, M).
    """
    if not can_judge(problem):
        return None
    view = view_of(problem)
    scale, std = sigma
    own = np.ones_like(problem.centres) if problem.std is None else problem.std
    nothing, unit = np.zeros_like(problem.centres), 1.0 / (own * scale)
    response = view.response.reshape(6, -1, *problem.centres.shape) * scale / std[:, :, None, None]
    groups = [
        place.group(nothing, unit, response[:, k])
        for k, place in enumerate(p for p in view.places if p.kind == "table position")
    ]
    return hidden(groups, np.ones(6), significance, POWER, LARGEST)


def _whitened(
    problem: BallPlateProblem, solution: Solution, sigma: float | None
) -> tuple[Floats, Floats, tuple[float, float] | None, Floats]:
    """Return whitened residuals, units (n, 3), the yardstick of the rest, and the noise (3,).

    x and y share one noise, z has its own.
    """
    own = np.ones_like(problem.centres) if problem.std is None else problem.std
    residuals = solution.residuals / own
    free = _freedom(problem)
    squares = np.sum(residuals**2, axis=0)
    squares = np.array([squares[0] + squares[1], squares[2]])
    found = np.sqrt(squares / np.maximum(free, 1.0))
    found = np.maximum(found, 0.05 * found.max())
    stated = max(sigma or 0.0, float(np.sqrt(model.least_variance(problem, solution.estimate))))
    beyond = stated**2 * chi2_isf(0.01, free) / np.maximum(free, 1.0)
    known = found**2 <= beyond
    used = np.where(known, stated, found)
    scale = used[[0, 0, 1]]
    whitened = residuals / scale
    rest = None if known.all() else (float(np.sum(whitened**2)), float(free.sum()))
    return whitened, 1.0 / (own * scale), rest, scale


def _freedom(problem: BallPlateProblem) -> Floats:
    """Return the degrees of freedom of the plane and of z, (2,), for the nominal design."""
    balls, cmm = len(problem.balls), len(problem.cmm_positions)
    turned, n = len(problem.table_positions), len(problem.centres)
    drift = problem.drift
    axial = n - balls - cmm - 3 * turned - 3 + 9 - drift
    total = model.degrees_of_freedom(problem) - 3 * drift
    return np.array([total - axial, axial], dtype=np.float64)


def _showing(places: list[Place], whitened: Floats) -> list[Place]:
    """Return the places of which a group or a subset stands out, kind by kind."""
    found: list[Place] = []
    for kind in dict.fromkeys(p.kind for p in places):
        mine = [p for p in places if p.kind == kind]
        flat = [whitened[p.rows].ravel() for p in mine]
        squares = np.array([r @ p.whole @ r for p, r in zip(mine, flat, strict=True)])
        rank = np.array([p.rank for p in mine])
        if len(mine) > MANY and np.median(squares / chi2_isf(0.5, rank)) > SHARED:
            continue
        limit = chi2_isf(SUSPICIOUS, rank)
        for place, value, most in zip(mine, squares, limit, strict=True):
            if value > most or _largest(place, whitened) > SHOWS:
                found.append(place)
    return found


def _largest(place: Place, whitened: Floats) -> float:
    """Return the largest chi-squared of a common shift of a gathered subset."""
    if not len(place.gathered):
        return 0.0
    right = place.gathered @ whitened[place.rows]
    return float(np.einsum("qa,qab,qb->q", right, place.inverse, right).max())


def view_of(problem: BallPlateProblem) -> View:
    """Return the groups of a problem; those of a layout are remembered."""
    std = problem.std
    if std is not None and not np.ptp(std, axis=0).any() and std[0, 0] == std[0, 1]:
        std = None  # the plane and z do not meet: whitened, all is as without
    view = _of_layout(layout_of(replace(problem, std=std, sigma=None), None))
    if std is problem.std:
        return view
    own = np.ones(3) if problem.std is None else problem.std[0]
    return View(view.places, view.response * own)


@lru_cache(maxsize=4)
def _of_layout(layout: Layout) -> View:
    problem = layout.problem()
    view = general.linear_view(problem)
    n = len(problem.centres)
    design, std = view.design.toarray(), view.std
    half = design @ view.covariance
    response = view.table @ design.T
    border = drift_columns(problem.run_time, problem.drift).reshape(3 * n, -1) / std[:, None]
    left = border - half @ (design.T @ border)
    inverse = np.linalg.inv(border.T @ left) if problem.drift else np.zeros((0, 0))
    response = response - (response @ border) @ inverse @ left.T

    def cofactor(rows: Ints) -> Floats:
        at = (3 * rows[:, None] + np.arange(3)).ravel()
        kept = np.eye(len(at)) - half[at] @ design[at].T - left[at] @ inverse @ left[at].T
        shape = (len(rows), 3, len(rows), 3)
        return np.asarray(0.5 * (kept + kept.T)).reshape(shape)

    places = tuple(
        _placed(problem, cofactor(rows), kind, name, rows) for kind, name, rows in _groups(problem)
    )
    return View(places, response.reshape(len(response), n, 3))


def _placed(
    problem: BallPlateProblem, cofactor: Floats, kind: str, name: str, rows: Ints
) -> Place:
    gathered = _subsets(problem, kind, rows)
    part = gathered.astype(np.float64)
    both = np.tensordot(part, cofactor, 1)
    square = np.einsum("qaeb,qe->qab", both, part)
    inverse = np.linalg.pinv(square, rcond=1e-6, hermitian=True) if len(part) else square
    flat = cofactor.reshape(3 * len(rows), -1)
    values = np.linalg.eigvalsh(flat)
    whole = np.asarray(np.linalg.pinv(flat, rcond=CHECKED, hermitian=True), dtype=np.float64)
    rank = int(np.count_nonzero(values > CHECKED))
    return Place(kind, name, rows, cofactor, whole, max(rank, 1), gathered, inverse)


def _groups(problem: BallPlateProblem) -> list[tuple[str, str, Ints]]:
    """Return kind, name and rows of all groups."""
    found = []
    for kind, column in (
        ("table position", problem.position),
        ("ball", problem.ball_step),
        ("CMM position", problem.cmm_index),
    ):
        word = "ball step" if kind == "ball" else kind
        found += [(kind, f"{word} {k}", np.flatnonzero(column == k)) for k in np.unique(column)]
    return found


def _subsets(problem: BallPlateProblem, kind: str, rows: Ints) -> Bools:
    """Return what may be wrong together: neighbours on the plate, in the turn, in time."""
    along = problem.position[rows] if kind == "ball" else problem.ball_step[rows]
    found = runs(along.astype(np.float64), closed=True)
    if kind != "ball":
        found = distinct(found, runs(problem.rows[rows].astype(np.float64)))
    return _short(found)


def _short(subsets: Bools) -> Bools:
    return np.asarray(subsets[np.isin(subsets.sum(axis=1), RUNS)])
