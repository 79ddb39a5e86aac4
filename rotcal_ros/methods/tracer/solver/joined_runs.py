"""Joining runs: after an interruption the zero of the lengths is another one.

A relative length is the distance less the zero of its run. Steps that were measured in both runs
show the difference of the zeros; their scatter tests whether anything else moved in between.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rotcal_ros.adjust.distributions import chi2_sf
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.raw_data import RawData
from rotcal_ros.foundation.results import Result, Verdict
from rotcal_ros.geometry.rotations import wrap_angle
from rotcal_ros.methods.tracer.solver.problem import TracerProblem
from rotcal_ros.methods.tracer.solver.protections import slope_along
from rotcal_ros.methods.tracer.solver.reported import (
    Reported,
    WeighedSolution,
    noticed,
    scatter_along,
    weigh,
    with_reported,
)
from rotcal_ros.methods.tracer.solver.solution import TracerSolution, adjust
from rotcal_ros.methods.tracer.solver.solve import result_of
from rotcal_ros.methods.tracer.solver.trials import TracerTrials, trials_about


@dataclass(frozen=True, eq=False)
class RepeatedLengths:
    """Lengths of run number ``run`` that were measured before, one row per pair, shape (k,).

    ``row``: row of the problem that holds the earlier length; ``length``, ``length_std``: what
    the later run read there (m); ``shift`` (k, 3): how much further along x, y, z the machine
    says the target stood then (m).
    """

    run: int
    row: Ints
    length: Floats
    length_std: Floats
    shift: Floats


@dataclass(frozen=True, eq=False)
class Join:
    """The zero of a run against the runs before it.

    ``offset``: length of the later run less that of the earlier ones at the same place (m), with
    the standard deviation ``std`` that its pairs give it; ``shares``: the part of the weight of
    the pairs by the earlier run that they lean on. ``disagreement`` (k,): what each pair leaves of
    its difference (m). ``sigma0`` and ``probability``: chi-squared test that nothing but the zero
    has changed.
    """

    run: int
    offset: float
    std: float
    shares: Mapping[int, float]
    disagreement: Floats
    sigma0: float
    probability: float


def join_of(run: int, difference: Floats, std: Floats, earlier: Ints) -> Join:
    """Return the join that differences (k,) of lengths with standard deviations (k,) determine.

    ``earlier`` (k,) are the runs of the earlier lengths. The weighted mean; with one pair there
    is nothing left to test, and the probability is 1.
    """
    weights = std**-2
    offset = float((weights * difference).sum() / weights.sum())
    shares = {
        int(r): float(weights[earlier == r].sum() / weights.sum()) for r in np.unique(earlier)
    }
    left = difference - offset
    chi2, dof = float((weights * left**2).sum()), len(difference) - 1
    return Join(
        run=run,
        offset=offset,
        std=float(weights.sum() ** -0.5),
        shares=shares,
        disagreement=left,
        sigma0=float(np.sqrt(chi2 / dof)) if dof else 0.0,
        probability=chi2_sf(chi2, dof) if dof else 1.0,
    )


@dataclass(frozen=True, eq=False)
class Runs:
    """Lengths of several runs.

    ``run`` (k,): run of each row of ``problem``. ``shift`` (k, 3): where the machine says the
    target stood at this row less where ``problem.targets`` has it (m); a probe that came twice
    does not stand at the same place. ``pairs``: one per later run, in order. ``position_std``: by
    how much a coordinate differs from arrival to arrival without a word of the machine (m).
    """

    problem: TracerProblem
    run: Ints
    shift: Floats
    pairs: Sequence[RepeatedLengths]
    position_std: float = 0.0


@dataclass(frozen=True, eq=False)
class JoinedSolution:
    """Lengths of several runs, solved as those of a single one, and the joins between the runs."""

    solution: TracerSolution
    joins: Sequence[Join]
    trials: TracerTrials
    reported: Reported | None = None

    def result(self) -> Result:
        """Return the result; what it owes to the errors of the zeros joins the covariance.

        The joins are in the warnings; one that fails its test (``test_significance``) makes the
        verdict suspect.
        """
        significance = self.solution.problem.settings.test_significance
        moves = _moves(self.trials)
        result = with_reported(result_of(self.solution), self.reported)
        return _concluded(result, self.joins, moves, significance)


def adjust_at_equal_places(
    problem: TracerProblem, shift: Floats
) -> WeighedSolution[TracerSolution]:
    """Solve a problem with each length as it would be at the mean place of its target.

    ``shift`` (k, 3): how much further along x, y, z the machine said it was when it measured each
    length, m; believed as far as the lengths follow it (:mod:`.reported`). Where the machine comes
    to a target anew for every length these are its following errors. Shifts that no length would
    notice change nothing, to the last bit.
    """
    weighed = _adjusted(Runs(problem, np.zeros(len(shift), dtype=np.int64), shift, []))
    return WeighedSolution(weighed.solution[0], weighed.reported)


def adjust_joined(runs: Runs) -> JoinedSolution:
    """Solve lengths of several runs as those of a single one.

    Each later run is reduced to the zero of the first: offsets from the pairs, with the lengths
    first reduced to equal places of the targets along the beams of a first solution. The trials
    draw the zeros of later runs too.

    Raises DataError when a later run has no pair.
    """
    weighed = _adjusted(runs)
    solution, joins = weighed.solution
    trials = _with_zeros(trials_about(solution), runs.run, joins)
    return JoinedSolution(solution, joins, trials, weighed.reported)


_Joined = tuple[TracerSolution, list[Join]]


def _with_zeros(trials: TracerTrials, run: Ints, joins: Sequence[Join]) -> TracerTrials:
    """Return trials whose lengths move with the errors of the joins; ``run`` (k,): of each row.

    An error of one join reaches the zeros of later runs by the pairs with which they lean on it.
    """
    reach = np.zeros((len(joins), len(joins)))
    number = {join.run: k for k, join in enumerate(joins)}
    for k, join in enumerate(joins):
        reach[k, k] = join.std
        for earlier in join.shares.keys() & number.keys():
            reach[k] += join.shares[earlier] * reach[number[earlier]]
    of_place = np.where(trials.grid.used, run[trials.grid.row], -1)
    later = np.array([join.run for join in joins], dtype=np.int64)  # none: all steps were repeats
    masks = (of_place == later[:, None, None]).astype(np.float64)
    return replace(trials, zeros=np.tensordot(reach.T, masks, 1))


def _moves(trials: TracerTrials) -> Floats:
    """Return by how much the deviations (r, m) move with each of the trials' zeros, rad.

    The lengths in use stay the same: a move must not change what is rejected.
    """
    grid = trials.grid
    lengths = grid.length + np.concatenate([np.zeros((1, *grid.length.shape)), trials.zeros])
    places = np.broadcast_to(grid.targets, (len(lengths), *grid.targets.shape))
    found = trials.solve(lengths, places, np.zeros((len(lengths), len(trials.angles), 3)))
    return wrap_angle(found[1:] - found[0])


def _adjusted(runs: Runs) -> WeighedSolution[_Joined]:
    """Return the solution with all lengths on the zero of the first run, and the joins."""
    for later in runs.pairs:
        if not len(later.row):
            raise DataError(
                f"no step of the runs before was measured again in run {later.run}, so its "
                "zero of the lengths is not known; resume once more, or measure from the start"
            )
    none = np.zeros((len(runs.run), 3))  # where the stations and so the beams are is not known yet
    first, _ = _solved(replace(runs, shift=none), none, 1.0)
    beams, noise = _beams(runs.problem, first), first.noise.factors[0] * first.scale

    def moved(weight: float, left: float) -> _Joined:
        return _solved(_believed(runs, weight, left), beams, noise)

    unmoved = moved(0.0, 0.0) if runs.pairs else (first, [])
    shifts = [runs.shift, *(later.shift for later in runs.pairs)]
    if not noticed(np.concatenate(shifts), runs.problem.length_std):
        return WeighedSolution(moved(1.0, 0.0) if runs.pairs else unmoved, None)
    along = np.einsum("ka,ka->k", beams, runs.shift)
    scatter = scatter_along(along, runs.problem.target)
    return weigh(unmoved, moved, lambda solved: slope_along(solved[0], along), scatter)


def _believed(runs: Runs, weight: float, left: float) -> Runs:
    """Return ``runs`` with ``weight`` times the shifts; ``left`` (m) joins the lengths."""
    problem = runs.problem
    return replace(
        runs,
        problem=replace(problem, length_std=np.hypot(problem.length_std, left)),
        shift=weight * runs.shift,
        pairs=[
            replace(later, shift=weight * later.shift, length_std=np.hypot(later.length_std, left))
            for later in runs.pairs
        ],
    )


def _solved(runs: Runs, beams: Floats, noise: float) -> _Joined:
    """Return the solution of ``runs`` reduced along ``beams`` (k, 3), and the joins."""
    joins = _joins(runs, beams, noise)
    along = np.einsum("ka,ka->k", beams, runs.shift)
    return adjust(_reduced(runs.problem, runs.run, joins, along)), joins


def _joins(runs: Runs, beams: Floats, noise: float) -> list[Join]:
    """Return the joins, each against the lengths that the joins before have reduced.

    ``noise`` is how much larger the residuals say that the noise of the lengths is than stated:
    the scatter of the pairs is held against the larger one.
    """
    problem, run = runs.problem, runs.run
    joins: list[Join] = []
    for later in runs.pairs:
        reduced = _reduced(problem, run, joins, np.einsum("ka,ka->k", beams, runs.shift))
        along = np.einsum("ka,ka->k", beams[later.row], later.shift)
        difference = later.length - along - reduced.length[later.row]
        std = np.hypot(later.length_std, problem.length_std[later.row])
        std = np.maximum(noise * std, np.hypot(std, np.sqrt(2.0) * runs.position_std))
        joins.append(join_of(later.run, difference, std, run[later.row]))
    return joins


def _reduced(
    problem: TracerProblem, run: Ints, joins: Sequence[Join], along: Floats
) -> TracerProblem:
    """Return the problem with lengths less the offsets of their runs and less ``along`` (k,)."""
    length = problem.length - along
    for join in joins:
        length = length - join.offset * (run == join.run)
    return replace(problem, length=length)


def _beams(problem: TracerProblem, first: TracerSolution) -> Floats:
    """Return unit vectors (k, 3) from station to target; zero where a station was not solved."""
    place = dict(zip(first.positions.tolist(), first.fit.stations, strict=True))
    beams = np.zeros((len(problem.position), 3))
    for row, (position, target) in enumerate(zip(problem.position, problem.target, strict=True)):
        if int(position) in place:
            beam = problem.targets[target] - place[int(position)]
            beams[row] = beam / np.linalg.norm(beam)
    return beams


def _concluded(
    result: Result, joins: Sequence[Join], moves: Floats, significance: float
) -> Result:
    """Return the result with the joins in its covariance, verdict, warnings and details.

    ``moves`` (r, m): standard moves of the deviations ECC that are independent of each other.
    """
    covariance = {"ECC": result.covariance["ECC"] + moves.T @ moves}
    failed = [join for join in joins if join.probability < significance]
    verdict: Verdict = "suspect" if failed and result.verdict == "ok" else result.verdict
    adjacent = result.adjacent_std
    if adjacent is not None:
        adjacent = np.sqrt(adjacent**2 + (np.diff(moves, axis=1) ** 2).sum(axis=0))
    return replace(
        result,
        covariance=covariance,
        std={name: np.sqrt(np.diagonal(c)) for name, c in covariance.items()},
        adjacent_std=adjacent,
        verdict=verdict,
        warnings=(*result.warnings, *(_sentence(join, join in failed) for join in joins)),
        details={**result.details, "joins": [_plain(join) for join in joins]},
        raw_data=RawData(),  # what a length does by way of its join is not recorded
    )


def _sentence(join: Join, failed: bool) -> str:
    worst = float(np.abs(join.disagreement).max())
    moved = ": something moved during the interruption" if failed else ""
    return (
        f"run {join.run} was joined by {len(join.disagreement)} steps measured again: its lengths "
        f"were {join.offset:+.3g} m off (standard deviation {join.std:.2g} m); the steps agree "
        f"within {worst:.2g} m, {join.sigma0:.2f} times what is expected{moved}"
    )


def _plain(join: Join) -> dict[str, Any]:
    return {
        "run": join.run,
        "offset_m": join.offset,
        "offset_std_m": join.std,
        "disagreement_m": join.disagreement,
        "sigma0": join.sigma0,
        "probability": join.probability,
    }
