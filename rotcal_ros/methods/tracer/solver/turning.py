"""Lengths of a table that turns: the lag of its feedback, its motion, noise correlated in time.

A turn passes all angles at one speed while the tracer reads one target, from one zero. Each run,
all turns at one speed, places the table at every angle by itself:

* **Lag.** A table that turns at w is ahead of its feedback by w times the lag. One speed and its
  reverse leave open which part of a constant reversal that is: unless it is stated, the mean
  reversal is called zero. Two speeds in one direction show the same table, so they tell it.
* **Error motion.** Hundreds of angles see its low orders well. They are unknowns, common to all
  runs, that scatter by a size which may be unknown; what is beside them is another at every angle,
  and as large along the circle as across it.
* **Noise in time.** Readings follow each other so quickly that drifting air spoils neighbours
  alike. What an angle's redundant lengths leave over is correlated as their noise is, for all of
  them see the table move alike. An autoregression describes it, after Yule and Walker and of an
  order that BIC chooses: e_i = sum phi_k e_{i-k} + w_i. Lengths less what it foretells, W y, are
  independent.

What W does to places P of the table, of which beams change their directions slowly, is U (W P): so
q = W P are unknowns in their place, which lengths feel as before, and P = W^-1 q. All is linear
about the solution of lengths that are held to be independent. The same place of all targets is
spoiled by W alike; where a length is missing, W goes on with what the solution says in its place.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from scipy.linalg import solve_banded, solve_toeplitz
from scipy.sparse import block_diag, csr_array, hstack, identity, kron

from rotcal_ros.adjust.bordered import SparseDesign
from rotcal_ros.adjust.diagnosis import Diagnosis, Limits
from rotcal_ros.adjust.engine import Adjusted
from rotcal_ros.adjust.engine import adjust as adjusted
from rotcal_ros.adjust.error_motion import WHITE, Spectrum
from rotcal_ros.adjust.fit import Fit
from rotcal_ros.adjust.model import Model, linear
from rotcal_ros.adjust.outputs import Outputs
from rotcal_ros.adjust.robust_start import NORMAL_QUARTILE
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.methods.tracer.solver.carried_lengths import LAG, CarriedLengths

MOTION: Final = "motion"
"""The block of the error motion's low orders: cosines and sines of x and y, order by order."""
LOW_ORDERS: Final = "the error motion's orders"
MOST_COEFFICIENTS: Final = 8
"""Readings before, from which the noise of the next may be foretold."""
LEAST_SHARE: Final = 0.1
"""Share of the scatter of places that is always held to be a motion of the axis."""
FORGOTTEN: Final = 1e-4
"""Share of a reading's noise that is no matter to a later one."""
SAME: Final = 1e-9
"""By how much (rad) runs that show one table may differ in their mean."""
AT_ONCE: Final = 256
"""Places of which it is asked at once what they do to later ones."""
GROSS: Final = 4.0
"""Residuals, in their scatter, beyond which one is no noise."""


@dataclass(frozen=True, eq=False)
class TurningRuns:
    """Which run each position of a table that turns is passed in, and when.

    ``number`` (m,): of the run; ``place`` (m,): how many positions of it were passed before;
    ``speed`` (r,): of each run, rad/s.
    """

    number: Ints
    place: Ints
    speed: Floats

    @classmethod
    def of(cls, lengths: CarriedLengths) -> TurningRuns:
        """Return the runs of ``lengths``, by the speed at which each position was passed."""
        assert lengths.speed is not None
        at = np.zeros(len(lengths.angles))
        at[lengths.position] = lengths.speed
        speed, number = np.unique(at, return_inverse=True)
        along = lengths.angles * np.sign(speed)[number]
        in_time = np.lexsort((along, number))
        place = np.empty(len(at), dtype=np.int64)
        place[in_time] = np.arange(len(at))
        first = np.searchsorted(number[in_time], np.arange(len(speed)))
        return cls(number, place - first[number], speed)

    def before(self, position: Ints, count: int) -> Ints:
        """Return the positions (k, count) that were passed before those given, -1 for none."""
        whole = np.full((len(self.speed), int(self.place.max()) + 1 + count), -1)
        whole[self.number, self.place + count] = np.arange(len(self.number))
        steps = count - 1 - np.arange(count)
        return np.asarray(whole[self.number[position, None], self.place[position, None] + steps])


@dataclass(frozen=True, eq=False)
class NoiseInTime:
    """The noise of a run as an autoregression, of variance 1.

    ``ahead`` (order + 1, order) and ``left`` (order + 1,): how the first reading, the second and
    so on follow from those before, and the standard deviation of what is new; the last ones hold
    for all others.
    """

    ahead: Floats
    left: Floats

    @classmethod
    def of(cls, correlations: Floats, count: float) -> NoiseInTime:
        """Return what ``correlations`` (p + 1,) of ``count`` readings support, from lag 0 on."""
        most = len(correlations) - 1
        every = [np.zeros(0)]
        every += [
            solve_toeplitz(correlations[:k], correlations[1 : k + 1]) for k in range(1, most + 1)
        ]
        left = np.array([1.0 - c @ correlations[1 : len(c) + 1] for c in every])
        stable = np.minimum.accumulate(np.where(left > 0.0, left, np.inf))
        order = int(np.argmin(count * np.log(stable) + np.log(count) * np.arange(most + 1)))
        ahead = np.zeros((order + 1, order))
        for k in range(order + 1):
            ahead[k, :k] = every[k]
        return cls(ahead, np.sqrt(left[: order + 1]))

    @property
    def order(self) -> int:
        """How many readings before count."""
        return len(self.ahead) - 1

    @property
    def independent(self) -> float:
        """The share of readings that would say as much of a slow effect were they independent."""
        return float(((1.0 - self.ahead[-1].sum()) / self.left[-1]) ** 2)


@dataclass(frozen=True, eq=False)
class TimeCorrelatedLengths:
    """A table's ``lengths`` beside the ``noise`` (r) of its ``runs``, about a ``first`` fit.

    That takes lengths to be independent.

    ``series`` (k,): which lengths are of one target, of those that were measured as often before.
    """

    lengths: CarriedLengths
    series: Ints
    runs: TurningRuns
    noise: tuple[NoiseInTime, ...]
    first: Fit

    @property
    def x(self) -> Floats:
        """The unknowns of the first fit."""
        return self.first.x

    @classmethod
    def of(cls, lengths: CarriedLengths, again: Ints, fit: Fit) -> TimeCorrelatedLengths:
        """Return what the residuals of a ``fit`` of independent lengths show.

        ``again`` (k,): how often the pair of each was measured before.
        """
        runs, k = TurningRuns.of(lengths), len(lengths.row)
        number = series_of(lengths, again)
        series = np.full((int(number.max()) + 1, len(lengths.angles)), np.nan)
        white = np.where(fit.used[:k], fit.white[:k], np.nan)
        usual = float(np.nanmedian(np.abs(white)) / NORMAL_QUARTILE)
        white[np.abs(white) > GROSS * usual] = np.nan
        series[number, lengths.position] = white
        checked = np.bincount(lengths.position, fit.redundancy[:k], len(lengths.angles))
        found: dict[float, NoiseInTime] = {}
        for speed in np.unique(np.abs(runs.speed)).tolist():
            here = [
                np.flatnonzero(runs.number == r)
                for r in np.flatnonzero(np.abs(runs.speed) == speed)
            ]
            each = [series[:, mine[np.argsort(runs.place[mine])]] for mine in here]
            products = np.array([_product(each, lag) for lag in range(MOST_COEFFICIENTS + 1)])
            count = float(sum(checked[mine].sum() for mine in here))
            found[speed] = NoiseInTime.of(products / products[0], count)
        return cls(
            lengths,
            number,
            runs,
            tuple(found[speed] for speed in np.abs(runs.speed).tolist()),
            fit,
        )

    @property
    def independent(self) -> bool:
        """Whether all readings are."""
        return not any(noise.order for noise in self.noise)

    def _foretold(self, position: Ints) -> tuple[Ints, Floats, Floats]:
        """Return the positions (k, p) before those given, what they foretell, and what is left."""
        order = max(noise.order for noise in self.noise)
        ahead, left = np.zeros((len(position), order)), np.ones(len(position))
        for number, noise in enumerate(self.noise):
            mine = self.runs.number[position] == number
            step = np.minimum(self.runs.place[position[mine]], noise.order)
            ahead[mine, : noise.order], left[mine] = noise.ahead[step], noise.left[step]
        return self.runs.before(position, order), ahead, left

    @cached_property
    def at_places(self) -> csr_array:
        """W (m, m) of what belongs to a position."""
        position = np.arange(len(self.lengths.angles))
        before, ahead, left = self._foretold(position)
        return _news(position, before, ahead, left)

    @cached_property
    def _of_lengths(self) -> tuple[csr_array, csr_array, Floats]:
        """W (k, k) of lengths, of what changes slowly with them; and how noise grows by gaps."""
        lengths, k = self.lengths, np.arange(len(self.lengths.row))
        row = np.full((int(self.series.max()) + 1, len(lengths.angles) + 1), -1)
        row[self.series, lengths.position] = k
        before, ahead, left = self._foretold(lengths.position)
        there = row[self.series[:, None], before]
        gone = np.where((there < 0) & (before >= 0), ahead, 0.0)
        own = _news(k, there, ahead, left)
        slow = own - csr_array((gone.sum(axis=1) / left, (k, k)), shape=own.shape)
        return own, slow, np.sqrt(1.0 + (gone**2).sum(axis=1))

    @cached_property
    def places(self) -> csr_array:
        """What takes the unknowns of the model to those of the lengths, (p, p)."""
        m, every = len(self.lengths.angles), list[csr_array]()
        for number, noise in enumerate(self.noise):
            mine = np.flatnonzero(self.runs.number == number)
            mine = mine[np.argsort(self.runs.place[mine])]
            news, count = self.at_places[mine][:, mine], len(mine)
            bands, back = np.zeros((noise.order + 1, count)), []
            for k in range(noise.order + 1):
                bands[k, : count - k] = news.diagonal(-k)
            for begin in range(0, count, AT_ONCE):
                unit = np.eye(count, min(AT_ONCE, count - begin), -begin)
                some = solve_banded((noise.order, 0), bands, unit)
                some[np.abs(some) < FORGOTTEN] = 0.0
                back.append(csr_array(some))
            pick = csr_array((np.ones(count), mine, np.arange(count + 1)), shape=(count, m))
            every.append(pick.T @ hstack(back, format="csr") @ pick)
        whole = csr_array(sum(every[1:], every[0]))
        rest = identity(self.lengths.size - self._own)
        parts = [*(_kron(whole, ways) for ways in self._ways), rest]
        return csr_array(block_diag(parts, format="csr"))

    @property
    def _ways(self) -> tuple[int, int]:
        """In how many ways a position shifts, and turns."""
        return 3, len(self.lengths.turning)

    @property
    def _own(self) -> int:
        """How many unknowns belong to positions; they come first."""
        return sum(self._ways) * len(self.lengths.angles)

    def model(self, model: Model) -> Model:
        """Return a ``model`` of independent lengths as one of these, about its solution."""
        computed, design = model.linearised(self.x)
        assert isinstance(design, SparseDesign)
        k, own, to = len(self.lengths.row), self._own, self.places
        news, slowly, grown = self._of_rows(design.few[:, :own], model.of_component)
        few = hstack([design.few[:, :own], slowly @ design.few[:, own:]], format="csr")
        whole = SparseDesign(csr_array(few), design.known @ to)
        x = self.x.copy()
        forward = [_kron(self.at_places, ways) for ways in self._ways]
        x[:own] = block_diag(forward, format="csr") @ x[:own]
        n = few.shape[0]
        left = model.observed - computed
        left[:n] = news @ left[:n]
        rows = model.outputs
        assert isinstance(rows, Outputs)

        def mixed(columns: Floats) -> Floats:
            return np.concatenate([slowly @ columns[:n], columns[n:]])

        return replace(
            model,
            observed=left + whole.times(x),
            std=np.append(model.std[:k] * grown, model.std[k:]),
            equations=linear(whole),
            outputs=Outputs(csr_array(rows.few @ to), rows.common @ to, rows.share),
            effects=[e.mapped(mixed, lambda of: of, apart=False) for e in model.effects],
            definitions=None if model.definitions is None else model.definitions @ to,
            start=x,
        )

    def _of_rows(self, local: csr_array, component: Ints) -> tuple[csr_array, csr_array, Floats]:
        """Return W (n, n) of rows, of what changes slowly with them, and how gaps add to noise.

        Those below the lengths are of positions if they feel the ``local`` unknowns; else they
        stand by themselves.
        """
        k, m, n = len(self.lengths.row), len(self.lengths.angles), local.shape[0]
        own, slow, grown = self._of_lengths
        parts = []
        for rows in np.split(np.arange(k, n), np.flatnonzero(np.diff(component[k:n])) + 1):
            whole = local[rows].nnz and len(rows) % m == 0
            parts.append(_kron(self.at_places, len(rows) // m) if whole else identity(len(rows)))
        news, slowly = (csr_array(block_diag([w, *parts], format="csr")) for w in (own, slow))
        return news, slowly, grown


def series_of(lengths: CarriedLengths, again: Ints) -> Ints:
    """Return which lengths (k,) are of one target, of those that were measured as often before.

    ``again`` (k,): how often the pair of each was measured before.
    """
    kinds = np.column_stack([again, lengths.place, lengths.target])
    return np.unique(kinds, axis=0, return_inverse=True)[1].ravel()


def _product(series: list[Floats], lag: int) -> float:
    """Return the sum of products of each series (n, m) with itself ``lag`` places later."""
    return float(sum(np.nansum(each[:, : each.shape[1] - lag] * each[:, lag:]) for each in series))


def _kron(each: csr_array, ways: int) -> csr_array:
    """Return what does the same as ``each`` (m, m) to each of several ways of a position."""
    return csr_array(kron(each, identity(ways), format="csr"))


def _news(own: Ints, before: Ints, ahead: Floats, left: Floats) -> csr_array:
    """Return W of rows ``own`` (k,): each less what those ``before`` it (k, p) foretell."""
    there = before >= 0
    row = np.broadcast_to(np.arange(len(own))[:, None], before.shape)[there]
    value = np.concatenate([1.0 / left, -(ahead / left[:, None])[there]])
    entries = (
        value,
        (np.concatenate([np.arange(len(own)), row]), np.concatenate([own, before[there]])),
    )
    return csr_array(entries, shape=(len(own), len(own)))


def in_time(
    first: Diagnosis, lengths: CarriedLengths, again: Ints, limits: Limits
) -> tuple[Adjusted, TimeCorrelatedLengths | None]:
    """Return the solution with the noise in time that a ``first`` one shows; None: there is none.

    That takes readings to be independent. ``again`` as of :meth:`TimeCorrelatedLengths.of`.
    """
    found = TimeCorrelatedLengths.of(lengths, again, first.fit)
    if found.independent:
        return adjusted(replace(first.model, start=first.fit.x), limits), None
    return adjusted(found.model(first.model), limits), found


def with_unknown_motion(
    model: Model, lengths: CarriedLengths, spectra: Mapping[Spectrum, float], free: float
) -> Model:
    """Return the model whose MOTION scatters by a size that is not known.

    ``spectra``: which orders it may have, with what probability; ``free``: a size (m) that nobody
    would overlook.
    """
    orders, ways = np.repeat(low_orders(spectra), 4), []
    for spectrum, share in spectra.items():
        if spectrum != WHITE:
            size = np.zeros(len(orders))
            for order, part in zip(spectrum.orders, spectrum.shares, strict=True):
                size[orders == order] = np.sqrt(part)
            ways.append((share, np.diag(size)[:, size > 0.0]))
    return model.scattering(LOW_ORDERS, lengths.rows_of(MOTION), None, free, ways)


def with_stated_motion(
    model: Model, lengths: CarriedLengths, spectra: Mapping[Spectrum, float], size: float
) -> Model:
    """Return the model whose MOTION has the standard deviation ``size``, m.

    Each order has the variance that it has in the mean of the ``spectra``.
    """
    rows, orders = lengths.rows_of(MOTION), low_orders(spectra)
    variance, total = np.zeros(len(orders)), 0.0
    for spectrum, share in spectra.items():
        if spectrum != WHITE:
            at = np.searchsorted(orders, spectrum.orders)
            variance[at] += share * np.array(spectrum.shares) / sum(spectrum.shares)
            total += share
    std = size * np.sqrt(np.repeat(variance / total, 4))
    return model.with_prior(LOW_ORDERS, rows, np.zeros(len(std)), std)


def scatter_beside_low_orders(runs: TurningRuns, angles: Floats, radial: Floats) -> float:
    """Return how much places scatter across their circle beside low orders, m, in all runs alike.

    ``radial`` (m,): what is left of them at the ``angles`` (m,). One run alone holds its noise. A
    tenth of that is always left, which does no harm.
    """
    which = np.unique(angles, return_inverse=True)[1]
    count, total = np.bincount(which), np.bincount(which, radial)
    pairs = float((count * (count - 1)).sum())
    if not pairs:
        return float(radial.std())
    products = float((total**2 - np.bincount(which, radial**2)).sum())
    return float(np.sqrt(max(products / pairs, (LEAST_SHARE * radial.std()) ** 2)))


def low_orders(spectra: Mapping[Spectrum, float]) -> Ints:
    """Return the orders that a motion of these ``spectra`` may have."""
    return np.unique([order for spectrum in spectra for order in spectrum.orders])


def motion_design(lengths: CarriedLengths, spectra: Mapping[Spectrum, float]) -> csr_array:
    """Return by how much the MOTION moves the axis along x and y at each position, (2 m, p)."""
    phase = np.outer(lengths.angles, low_orders(spectra))
    waves = np.stack([np.cos(phase), np.sin(phase)], axis=2).reshape(len(phase), -1)
    return csr_array(csr_array(np.kron(waves, np.eye(2))) @ lengths.rows_of(MOTION))


def tie_runs_of_table(
    model: Model, lengths: CarriedLengths, lag: float | None, lag_std: float
) -> Model:
    """Return the model whose runs show one table: its mean reversal, or ``lag``, as it is known.

    Runs of one direction have the same mean. One speed and its reverse are held to have so, too,
    unless the lag is stated: nothing else tells them apart.
    """
    runs, begin = TurningRuns.of(lengths), lengths.first["turn"]
    each = len(lengths.turning)  # of which the last is about the axis
    mean = np.zeros((len(runs.speed), lengths.size))
    for number in range(len(runs.speed)):
        mine = np.flatnonzero(runs.number == number)
        mean[number, begin + each * mine + each - 1] = 1.0 / len(mine)
    sides = [np.flatnonzero(runs.speed * sense > 0.0) for sense in (1.0, -1.0)]
    same = np.concatenate([mean[side[1:]] - mean[side[:1]] for side in sides])
    if lag is not None:
        model = model.with_prior("the stated lag", lengths.rows_of(LAG), np.array([lag]), lag_std)
    elif not len(same):
        same = mean[1:] - mean[:1]
    if not len(same):
        return model
    return model.with_prior("runs of one table", same, np.zeros(len(same)), SAME)
