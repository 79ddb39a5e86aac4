"""Repeated runs: one curve for each run and direction, their mean, and that of each direction.

The stations of a result are then arrivals of the table. What belongs to an angle is the mean of
its arrivals; how they scatter is the table's own repeatability.

:func:`arrivals_of` lists the arrivals of a plan, :func:`mean_of_runs` makes the mean curves of a
result, :func:`mean_of_arrivals` those of a model, :class:`RepeatedTrials` those of simulated
measurements.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse import csr_array, vstack

from rotcal_ros.adjust.model import CurveModel, block_rows
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.compact import (
    CompactCovariance,
    Covariances,
    Spread,
    kept,
    mapped,
    variances_of,
)
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.results import Directions, RepeatedRuns, Result
from rotcal_ros.methods.added_errors import as_small, from_zero, with_steps
from rotcal_ros.methods.method import Trials
from rotcal_ros.planning.table_angles import planned_arrivals, table_angles


@dataclass(frozen=True, eq=False)
class Arrivals:
    """To which of ``targets`` (k,) rad each station of a result belongs, and when it was.

    ``target``, ``run`` (m,) count from 0, ``upward`` (m,) is the side of the approach.
    """

    targets: Floats
    target: Ints
    run: Ints
    upward: Bools

    def take(self, stations: Ints) -> Arrivals:
        """Return the arrivals of some stations."""
        return replace(
            self,
            target=self.target[stations],
            run=self.run[stations],
            upward=self.upward[stations],
        )

    @property
    def measured(self) -> Ints:
        """The targets (k',) that have any arrival."""
        return np.unique(self.target)

    def averaging(self) -> Floats | csr_array:
        """Return (k', m): the mean of all arrivals at each measured target.

        Both directions weigh the same at a target that has both.
        """
        below, above = self.by_direction()
        sides = sum((np.diff(side.indptr) > 0).astype(np.float64) for side in (below, above))
        return as_small(csr_array((below + above) / sides[:, None]))

    def by_direction(self) -> tuple[csr_array, csr_array]:
        """Return (k', m) for the mean of the arrivals from below, and for that from above.

        A row is zero where a target has none of them.
        """
        row, found = np.searchsorted(self.measured, self.target), list[csr_array]()
        for mine in (np.flatnonzero(self.upward), np.flatnonzero(~self.upward)):
            share = 1.0 / np.bincount(row[mine], minlength=len(self.measured))[row[mine]]
            places = (share, (row[mine], mine))
            found.append(csr_array(places, shape=(len(self.measured), len(row))))
        return found[0], found[1]


def arrivals_of(angles: Sequence[float], runs: int, *, bidirectional: bool) -> Arrivals:
    """Return all :func:`planned_arrivals` at table positions with ``angles`` (rad)."""
    every = planned_arrivals(len(angles), runs, bidirectional)
    return Arrivals(
        targets=np.array(angles),
        target=np.array([visit.target for visit in every]),
        run=np.array([visit.run for visit in every]),
        upward=np.array([visit.approach is Approach.POSITIVE for visit in every]),
    )


def arrivals_of_turns(angles: Sequence[float], speeds: Sequence[float]) -> Arrivals:
    """Return the arrivals of a table that passes all ``angles`` (rad) at each of the ``speeds``.

    Of any unit; below zero it turns back.
    """
    upward = np.array(speeds) > 0.0
    run = np.where(upward, np.cumsum(upward), np.cumsum(~upward)) - 1
    count = len(angles)
    return Arrivals(
        targets=np.array(angles),
        target=np.tile(np.arange(count), len(upward)),
        run=np.repeat(run, count),
        upward=np.repeat(upward, count),
    )


def bidirectional_arrivals(plan: Any) -> Arrivals | None:
    """Return the arrivals of the settings of a plan that measures both directions; else None."""
    if not plan.bidirectional:
        return None
    return arrivals_of(table_angles(plan), runs=1, bidirectional=True)


def mean_of_runs(result: Result, arrivals: Arrivals, *, from_first: bool = True) -> Result:
    """Return ``result`` of all arrivals as the mean curves at the targets, with its ``runs``.

    To the covariance of the measurement comes the scatter of the arrivals that the measurement
    does not explain. Deviations count from the first target, or, without ``from_first``, from
    where the method counts them. Where targets were reached from both sides the result has both
    ``directions``. Raises DataError when arrivals and result do not fit.
    """
    ecc = result.deviations["ECC"]
    if len(arrivals.target) != len(ecc):
        raise DataError(f"{len(ecc)} stations in the result, {len(arrivals.target)} arrivals")
    tied, scatter = mean_curve(arrivals, from_first=from_first), scatter_of(result, arrivals)
    spread = {
        name: _with_scatter(kept(result.covariance)[name], scatter[name])
        for name in result.deviations
    }
    total = {name: mapped(matrix, tied) for name, matrix in spread.items()}
    sides = []
    for name, side in (("forward", arrivals.upward), ("reverse", ~arrivals.upward)):
        table = np.full((len(arrivals.targets), int(arrivals.run.max()) + 1), np.nan)
        table[arrivals.target[side], arrivals.run[side]] = ecc[side]
        sides.append((name, side, table))
    mean = replace(
        result,
        angles=arrivals.targets[arrivals.measured],
        deviations={name: tied @ values for name, values in result.deviations.items()},
        std={name: np.sqrt(variances_of(matrix)) for name, matrix in total.items()},
        covariance=Covariances(total),
        budget=_shared_out(result, variances_of(total["ECC"]), arrivals),
        details={**result.details, "station_deviations": ecc},
        runs=RepeatedRuns(
            targets=arrivals.targets,
            **{n: table if side.any() else None for n, side, table in sides},
            repeatability_std=scatter["ECC"],
        ),
        directions=_directions(result.deviations, spread, arrivals, from_first),
        zeros=result.zeros.mapped(tied),
        raw_data=result.raw_data.transformed(tied),
    )
    return with_steps(mean) if from_first else mean


def _with_scatter(covariance: Spread, std: float) -> Spread:
    """Return that of values which scatter by ``std`` besides, each by itself."""
    if not isinstance(covariance, CompactCovariance):
        return covariance + std**2 * np.eye(len(covariance))
    return covariance.plus(CompactCovariance.alone(np.full(len(covariance), std)))


def mean_of_arrivals(
    found: CurveModel, arrivals: Arrivals, scatter: Mapping[str, float] | None = None
) -> CurveModel:
    """Return a model of all arrivals as one of their mean curves at the targets.

    ``scatter``: standard deviation of one arrival about the mean of its side, by component, m or
    rad; nothing, or none: the mean is that of the arrivals that were measured. How much arrivals
    scatter is a component of the noise.
    """
    known = {c: std for c, std in (scatter or {}).items() if std}
    side = np.unique(2 * arrivals.target + arrivals.upward, return_inverse=True)[1]
    count, size = int(side.max()) + 1, found.model.size[1]
    means = {f"mean of {c}": count for c in known}
    to = np.eye(size, size + sum(means.values()))
    model = found.model
    if means:
        from rotcal_ros.adjust.stacking import reparametrise

        model = reparametrise(model, to, {**model.blocks, **means})
    every = {c: rows @ to for c, rows in found.curves.items()}
    curves = {c: arrivals.averaging() @ rows for c, rows in every.items()}
    for c, std in known.items():
        mean = block_rows(model.blocks, f"mean of {c}")
        left = every[c] - mean[side]
        model = model.with_prior(phrase("the arrivals of {0}", c), left, np.zeros(len(side)), std)
        curves[c] = arrivals.averaging() @ mean[side]
    return CurveModel(model, arrivals.targets[arrivals.measured], curves, found.mixed)


def _shared_out(result: Result, variance: Floats, arrivals: Arrivals) -> dict[str, Floats]:
    """Return the standard uncertainties of the mean ECC (k',) by source, as arrivals have shares.

    ``variance`` (k',) of it, rad^2.
    """
    whole = np.sum([std**2 for std in result.budget.values()], axis=0)
    return {
        name: np.sqrt(np.maximum(variance * (arrivals.averaging() @ share), 0.0))
        for name, std in result.budget.items()
        for share in [std**2 / np.where(whole > 0.0, whole, 1.0)]
    }


@dataclass(frozen=True, eq=False)
class RepeatedTrials:
    """Trials of all arrivals, with their repeatability (c,), m and rad, as c mean curves."""

    arrivals: Trials
    mean: Floats | csr_array
    repeatability_std: Floats

    @classmethod
    def of(
        cls, prepared: Trials, result: Result, arrivals: Arrivals, *, from_first: bool = True
    ) -> RepeatedTrials:
        """Return the trials ``prepared`` for the ``result`` of all ``arrivals`` as mean curves.

        ``from_first`` as in :func:`mean_of_runs`.
        """
        scatter = np.array([*scatter_of(result, arrivals).values()])
        return cls(prepared, mean_curve(arrivals, from_first=from_first), scatter)

    def __call__(self, rng: np.random.Generator, count: int) -> Floats:
        """Return the mean deviations (count, c k), component by component, in m and rad."""
        values = self.arrivals(rng, count).reshape(count, len(self.repeatability_std), -1)
        scatter = self.repeatability_std[:, None]
        values = values + scatter * rng.standard_normal(values.shape)
        return np.asarray((values @ self.mean.T).reshape(count, -1), dtype=np.float64)


def _directions(
    deviations: Mapping[str, Floats],
    spread: Mapping[str, Spread],
    arrivals: Arrivals,
    from_first: bool,
) -> dict[str, Directions]:
    """Return curves from both sides, counted as the mean is, where two or more targets have both.

    ``deviations`` (m,) and their covariances ``spread`` are those of all arrivals.
    """
    sides = arrivals.by_direction()
    both = np.flatnonzero((np.diff(sides[0].indptr) > 0) & (np.diff(sides[1].indptr) > 0))
    if len(both) < 2:
        return {}
    stacked = csr_array(vstack([side[both] for side in sides], format="csr"))
    stacked = as_small(stacked)
    if from_first:
        stacked = from_zero(stacked, arrivals.averaging()[:1])
    angles = arrivals.targets[arrivals.measured][both]
    found = {}
    for name, values in deviations.items():
        forward, reverse = np.split(stacked @ values, 2)
        found[name] = Directions(angles, forward, reverse, mapped(spread[name], stacked))
    return found


def mean_curve(arrivals: Arrivals, *, from_first: bool = True) -> Floats | csr_array:
    """Return (k', m): from all arrivals to the mean curve, counted from its first value if so."""
    average = arrivals.averaging()
    return from_zero(average, average[:1]) if from_first else average


def scatter_of(result: Result, arrivals: Arrivals) -> dict[str, float]:
    """Return the :func:`repeatability_std` of each component of the result of all arrivals."""
    return {
        name: repeatability_std(result.deviations[name], kept(result.covariance)[name], arrivals)
        for name in result.components
    }


def repeatability_std(ecc: Floats, covariance: Spread, arrivals: Arrivals) -> float:
    """Return the standard deviation of one arrival beyond the noise of the measurement, rad.

    Pooled over all targets and directions; zero when the noise explains the whole scatter.
    """
    squares, noise, dof = 0.0, 0.0, 0
    group = 2 * arrivals.target + arrivals.upward
    values, count = np.unique(group, return_counts=True)
    for value in values[count > 1]:
        at = np.flatnonzero(group == value)
        centring = np.eye(len(at)) - 1.0 / len(at)
        squares += float(np.sum((centring @ ecc[at]) ** 2))
        noise += float(np.trace(centring @ _among(covariance, at)))
        dof += len(at) - 1
    return float(np.sqrt(max(squares - noise, 0.0) / dof)) if dof else 0.0


def _among(covariance: Spread, at: Ints) -> Floats:
    """Return the covariance (k, k) between the values ``at`` (k,)."""
    if isinstance(covariance, CompactCovariance):
        return covariance.part(at).dense()
    return covariance[np.ix_(at, at)]
