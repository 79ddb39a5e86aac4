"""A model at its least-squares solution, and what that makes of errors in the observations."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from scipy.linalg import block_diag, lapack

from rotcal_ros.adjust.effects import ObservableEffect, ObservableFamily
from rotcal_ros.adjust.groups import CHECKED
from rotcal_ros.adjust.kernels import (
    FIRM,
    OPEN,
    ConstrainedKernel,
    DenseKernel,
    Design,
    Kernel,
    fix_open_directions,
)
from rotcal_ros.adjust.model import Disturbing, Model
from rotcal_ros.adjust.outputs import FEW_ROWS, Outputs
from rotcal_ros.adjust.scattering import (
    PosteriorSizes,
    Scattering,
    enlargement_factors,
    join_scatters,
)
from rotcal_ros.adjust.sensitivity import Sensitivity
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.compact import CompactCovariance
from rotcal_ros.foundation.errors import DataError, ObservabilityError
from rotcal_ros.foundation.language import phrase

FREE: Final = 1e-7
"""Share of its length that an output may feel of a direction that nothing determines."""
NAMED: Final = 0.3
"""Share of the largest part of an open direction from which an unknown is named."""
MAX_ITERATIONS: Final = 50
CONVERGED: Final = 1e-14
"""Squared step, in standard deviations and per chi-squared, that does not matter."""
NEARLY: Final = 1e-6
"""The same from which on the solution is so near that no step has to be shortened."""
FROZEN, SHRINKS, STRAIGHT = 0.01, 0.01, 1e-8
"""Squared step, in standard deviations, from which on derivatives stay as they were, as long as
the next one is so much smaller; and how much smaller it is where they hardly change at all."""
HALVINGS: Final = 20
"""Times that steps are shortened in all before damped ones are taken, which do not creep."""
MOST_DAMPED: Final = 200
"""Damped steps on the way to a minimum: many, for long bent valleys."""
LEAST_DAMPING, STIFF = 1e-12, 1e12
"""Damping that is none, and from which on nothing moves, as shares of the squares."""
BEND: Final = 0.1
"""Share of a step by which it is asked how equations bend along it."""
FLAT: Final = 1e-6
"""Fall of chi-squared, per chi-squared, that is no more matter; and damping that is hardly any."""
FEW: Final = 2_000_000
"""Numbers in what all errors do to all outputs up to which it is worked out at once (16 MB)."""
SAME: Final = 0.01
"""Difference of the outputs, in their uncertainty, that makes it no matter which cause it was."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A model at its least-squares solution.

    ``x`` (p + q,): the unknowns, then the sizes of q effects that were found. ``residual`` (n,):
    observed - computed, also of observations that are not ``used``. ``weighed`` (n,): with which
    standard deviations. ``by_form``: the kernel of the form of what is used, if that has one.
    """

    model: Model
    x: Floats
    residual: Floats
    std: Floats
    used: Bools
    jacobian: Design
    by_form: Kernel | None = None

    @cached_property
    def design(self) -> Floats:
        """The derivatives (n, p + q) of the computed observations."""
        return self.jacobian.dense()

    @cached_property
    def _white_design(self) -> Design:
        return self.jacobian.weighted(self.used / self.std)

    @cached_property
    def kernel(self) -> Kernel:
        """That of x (p + q,), from the whitened design of what is used."""
        if self.by_form is not None:
            return self.by_form
        design = self._white_design
        if design.prefers_normal_equations and (found := _by_form(self.model, design)) is not None:
            return found
        _require_told(self.model, design)
        return _whole(self.model, design)

    def weighed_by(self, std: Floats) -> Fit:
        """Return the solution weighed by other ``std`` (n,), by the derivatives of this one."""
        weight = self.used / std
        design = self.jacobian.weighted(weight)
        steps = _Steps(self.model, design, _by_form(self.model, design))
        step, _ = steps(self.residual * weight, self.x)
        residual = self.residual - self.jacobian.times(step)
        return Fit(
            self.model, self.x + step, residual, std, self.used, self.jacobian, steps.by_form
        )

    def gain(self, unknowns: slice) -> Floats:
        """Return what whitened errors do to some ``unknowns``, (k, n)."""
        begin, end, _ = unknowns.indices(len(self.x))
        return np.asarray(self.kernel.adjusted(np.eye(len(self.x), end - begin, -begin)).T)

    @property
    def computed(self) -> Floats:
        """What the unknowns make of the observations (n,)."""
        return self.model.observed - self.residual

    @cached_property
    def white(self) -> Floats:
        """Whitened residuals (n,), zero where not used."""
        return np.where(self.used, self.residual / self.std, 0.0)

    @cached_property
    def seen(self) -> dict[Disturbing, ObservableEffect | ObservableFamily]:
        """What it makes of effects that were asked for: they are again and again."""
        return {}

    @property
    def chi2(self) -> float:
        """The sum of squares of what is used."""
        return float(self.white @ self.white)

    @cached_property
    def dof(self) -> int:
        """Observations in use minus unknowns that they determine."""
        return int(self.used.sum()) - self.kernel.rank

    @cached_property
    def redundancy(self) -> Floats:
        """Share (n,) of each observation that the others check; zero where not used."""
        return np.where(self.used, 1.0 - self.kernel.leverage, 0.0)

    @cached_property
    def redundancy_between(self) -> tuple[Bools, Floats]:
        """What is in use of each component of the noise (c, n), and squared sums of R by pairs.

        R is a projection: those (c, c) of its blocks follow from those of its complement.
        """
        every = np.arange(len(self.model.components))
        part = (self.model.of_component == every[:, None]) & self.used
        own = np.diag(part @ (2.0 * self.redundancy - 1.0))
        return part, self.kernel.shared(part) + own

    @cached_property
    def test_value(self) -> Floats:
        """Residuals (n,) in their own standard deviation; 0 where nothing checks one.

        Of what is not used, against what the others predict.
        """
        variance, left = self.redundancy.copy(), np.flatnonzero(~self.used)
        rows = self.jacobian.rows(left) / self.std[left, None]
        variance[left] = 1.0 + self.kernel.variances(rows)
        checked = variance > CHECKED
        root = np.sqrt(np.where(checked, variance, 1.0))
        return np.where(checked, self.residual / self.std / root, 0.0)

    @cached_property
    def element_test(self) -> tuple[Floats, Ints]:
        """T (m,) = r'R^+r of the rows r of each element, and their degrees of freedom.

        Of what is not used, against what the others predict.
        """
        first = self.model.elements[:, 0]
        squares = self.test_value[first] ** 2
        rank = (squares > 0.0).astype(np.int64)
        sizes = (self.model.elements >= 0).sum(axis=1)
        for count in np.unique(sizes[sizes > 1]).tolist():
            which = np.flatnonzero(sizes == count)
            rows = self.model.elements[which, :count]
            cofactor, kind = self.cofactors(rows)
            values, vectors = (each[kind] for each in np.linalg.eigh(cofactor))
            missed = (self.residual / self.std)[rows]
            along, checked = (missed[:, None] @ vectors)[:, 0], values > CHECKED
            each = np.where(checked, along**2 / np.where(checked, values, 1.0), 0.0)
            squares[which], rank[which] = each.sum(axis=1), checked.sum(axis=1)
        return squares, rank

    def cofactors(self, rows: Ints) -> tuple[Floats, Ints]:
        """Return R (k, c, c) of each kind of elements, and of which kind (m,) each is.

        Of those not used, that of what others predict.
        """
        among, kind = self.kernel.hat_blocks(rows)
        found, left = np.eye(rows.shape[1]) - among, np.flatnonzero(~self.used[rows[:, 0]])
        if len(left):
            flat = rows[left].ravel()
            design = self.jacobian.rows(flat) / self.std[flat, None]
            gain = self.kernel.times(design.T).T.reshape(*rows[left].shape, -1)
            spread = design.reshape(gain.shape) @ gain.swapaxes(1, 2)
            kind[left] = len(found) + np.arange(len(left))
            found = np.concatenate([found, np.eye(rows.shape[1]) + spread])
        return found, kind

    @property
    def value(self) -> Floats:
        """All outputs (o + a,)."""
        x = self.x
        if self.model.definitions is not None and isinstance(self.kernel, ConstrainedKernel):
            x = self.kernel.defined(x)  # the quickest steps do not know them
        return self.model.output_rows.times(x)

    @property
    def response(self) -> Floats:
        """B (o + a, n): what whitened errors do to the outputs; correlated ones as independent."""
        return self.response_of(np.arange(len(self.std)))

    def response_of(self, rows: Ints, outputs: Outputs | None = None) -> Floats:
        """Return the same of some ``rows`` (k,), (o + a, k), or of the first ``outputs`` alone."""
        found = self.alone(rows) if outputs is None else self.kernel.response(outputs, rows)
        for number, each in enumerate(self.model.correlated):
            mine, at = np.nonzero(rows[:, None] == each.rows)
            if len(mine):
                found[:, mine] = self._spread[number][1][: len(found), at]
        return found

    @cached_property
    def _influence(self) -> Floats | None:
        """What whitened errors do to the outputs (o + a, n), each as it is; None: too many."""
        outputs, n = self.model.output_rows, len(self.std)
        if len(outputs) * n > FEW:
            return None
        return self.kernel.response(outputs, np.arange(n))

    @cached_property
    def _spread(self) -> list[tuple[Floats, Floats]]:
        """What correlated errors do (o + a, k) each as it is, and what independent ones would."""
        every = [(each, self.alone(each.rows)) for each in self.model.correlated]
        return [(alone, each.spread_of(self, alone)) for each, alone in every]

    def correlated_rows(self) -> list[tuple[Ints, Floats]]:
        """Return rows (k,) with errors in common, and what independent ones do (o + a, k)."""
        every = zip(self.model.correlated, self._spread, strict=True)
        return [(each.rows, spread) for each, (_, spread) in every]

    @cached_property
    def sizes(self) -> dict[Scattering, PosteriorSizes]:
        """What is believed of each scatter of the model."""
        return {each: each.sizes(self) for each in self.model.scatterings}

    @cached_property
    def enlargement(self) -> Floats:
        """Factors (o + a,) on standard deviations for scatter whose size is hardly known."""
        every, fixed = list[tuple[Floats, Floats]](), self.variance.copy()
        for each, (alone, spread) in zip(self.model.correlated, self._spread, strict=True):
            if isinstance(each, Scattering):
                sizes = self.sizes[each]
                fixed -= (spread**2).sum(axis=1)
                std = float(self.std[each.rows[0]])
                every.append((each.variances(sizes, alone, std), sizes.weight))
        if all(len(weight) == 1 for _, weight in every):
            return np.ones(len(fixed))
        variances, weight = join_scatters(every, np.random.default_rng(0))
        return enlargement_factors(np.maximum(fixed, 0.0), self.variance, variances, weight)

    def response_to(self, asked: Floats) -> Floats:
        """Return what whitened errors do to combinations ``asked`` (k, o) of the outputs, (k, n).

        Correlated ones as independent.
        """
        at = np.flatnonzero(asked.any(axis=0))
        outputs = self.model.output_rows.some(at)
        rows = np.zeros((len(asked), len(self.x)))
        rows[:, : outputs.shape[1]] = asked[:, at] @ outputs
        influence = self.kernel.adjusted(rows.T).T
        for mine, spread in self.correlated_rows():
            influence[:, mine] = asked @ spread[: asked.shape[1]]
        return np.asarray(influence)

    def alone(self, rows: Ints) -> Floats:
        """Return what whitened errors of some ``rows`` (k,) do to the outputs (o + a, k).

        Each as it is, whatever they have in common.
        """
        every = self._influence
        if every is not None:
            return every[:, rows]
        return self.kernel.response(self.model.output_rows, rows)

    def sensitivity(self, rows: Ints) -> Sensitivity:
        """Return the same in parts that are few."""
        if self._influence is not None:
            return Sensitivity.whole(self._influence[:, rows])
        return self.kernel.sensitivity(self.model.output_rows, rows)

    def moved(self, white: Floats) -> Floats:
        """Return what whitened errors (n, k) of what is not correlated do to the outputs."""
        return self.model.output_rows.times(self.kernel.solve(white))

    def moved_by(self, gain: Floats, _white: Floats) -> Floats:
        """Return the same where the kernel's solution ``gain`` (p + q, k) is known already."""
        return self.model.output_rows.times(gain)

    def covariance(self, part: slice) -> Floats:
        """Return the covariance (k, k) of a ``part`` of the outputs, by the noise alone: B B'."""
        whole = self._plain_covariance(part)
        for alone, spread in self._spread:
            whole += spread[part] @ spread[part].T - alone[part] @ alone[part].T
        for begin in range(0, len(whole), FEW_ROWS):
            rows, rest = slice(begin, begin + FEW_ROWS), slice(begin, None)
            mean = whole[rows, rest] + whole[rest, rows].T
            mean *= 0.5
            whole[rows, rest], whole[rest, rows] = mean, mean.T
        return whole

    def _plain_covariance(self, part: slice) -> Floats:
        return self.kernel.covariance_of(self.model.output_rows.part(part))

    def compact(self, part: slice) -> CompactCovariance | None:
        """Return the covariance in the form of few numbers; None where it has none."""
        rows = self.model.output_rows.part(part)
        parts = self.kernel.parts_of(rows)
        if parts is None:
            return None
        near, low, core = parts
        for alone, spread in self._spread:
            sign = np.repeat([1.0, -1.0], [spread.shape[1], alone.shape[1]])
            low, core = (
                np.hstack([low, spread[part], alone[part]]),
                block_diag(core, np.diag(sign)),
            )
        return CompactCovariance.of(near, low, core).scaled(np.where(rows.idle, 0.0, 1.0))

    @cached_property
    def _plain_variance(self) -> Floats:
        rows = self.model.output_rows
        return np.where(rows.idle, 0.0, np.maximum(self.kernel.variances_of(rows), 0.0))

    @cached_property
    def variance(self) -> Floats:
        """Variances (o + a,) of the outputs, by the noise alone."""
        found = self._plain_variance
        for alone, spread in self._spread:
            found = found + (spread**2).sum(axis=1) - (alone**2).sum(axis=1)
        return np.maximum(found, 0.0)

    @property
    def noise_std(self) -> Floats:
        """Standard deviations (o + a,) of all outputs, by the noise alone."""
        return np.sqrt(self.variance)

    def output_products(self, first: Ints, second: Ints, weight: Floats) -> Floats:
        """Return sums (o + a, c) of what a unit of one row does to each output times another's.

        Of the pairs ``first`` and ``second`` (k,) with the ``weight`` (c, k), each as it is.
        """
        if self._influence is None:
            return self.kernel.output_products(self.model.output_rows, first, second, weight)
        return np.asarray((self._influence[:, first] * self._influence[:, second]) @ weight.T)

    def variance_from(self, part: Bools) -> Floats:
        """Return the variances (o + a, c) of the outputs by the noise of each ``part`` (c, n)."""
        if len(part) == 1:
            return self.variance[:, None]
        share, every = part.astype(np.float64), np.arange(len(self.std))
        found = self.output_products(every, every, share)
        for each, (alone, spread) in zip(self.model.correlated, self._spread, strict=True):
            found += (spread**2 - alone**2) @ share[:, each.rows].T
        return np.maximum(found, 0.0)

    @cached_property
    def variance_by_component(self) -> Floats:
        """Variances (o + a, c) of the outputs by the noise of each component of it."""
        every = np.arange(len(self.model.components))
        return self.variance_from(self.model.of_component == every[:, None])

    @cached_property
    def output_std(self) -> Floats:
        """Standard deviations (o + a,) of the outputs; infinite for those that count nowhere.

        Those that nothing correlates.
        """
        design = self._white_design
        known = self.by_form is not None or self.model.definitions is not None
        variance = None if known else design.variances(self.model.output_rows)
        if variance is None and design.prefers_normal_equations:
            _require_told(self.model, design)
        return self.counting(np.sqrt(self._plain_variance if variance is None else variance))

    def is_much_less_precise(self, other: Fit, factor: float) -> bool:
        """Whether an output is less sure than by ``factor`` times of another fit.

        Raises ObservabilityError where one is not determined at all.
        """
        outputs = self.model.output_rows.part(slice(len(self.model.outputs)))
        if self._white_design.is_nearly_as_precise(other._white_design, outputs, factor):
            return False
        return bool((self.output_std > factor * other.output_std).any())

    def without(self, rows: Ints) -> tuple[float, int] | None:
        """Return chi-squared and the unknowns that are determined without some ``rows`` (k,).

        None where the form of the rest has no kernel.
        """
        weight = self.used / self.std
        weight[rows] = 0.0
        design = self.jacobian.weighted(weight).without_unused_columns()
        found = design.kernel()
        if found is None:
            return None
        white = self.residual * weight
        left = white - design.times(found.solve(white))
        return float(left @ left), found.rank

    def influenced(self, change: Floats) -> bool:
        """Whether a ``change`` (o + a,) of the outputs is no trifle for those that count."""
        return bool((np.abs(change) > SAME * self.output_std).any())

    def counting(self, std: Floats) -> Floats:
        """Return ``std`` (o + a,), infinite for those that count in no test."""
        return np.where(np.arange(len(std)) < len(self.model.outputs), std, np.inf)

    def residuals_of(self, white: Floats) -> Floats:
        """Return what whitened errors (n, k) leave in the residuals, R times them."""
        mine = white * self.used[:, None]
        return np.asarray(mine - self.kernel.projected(mine))


def require_determined(model: Model) -> None:
    """Refuse a model whose outputs feel what no observation determines.

    Raises ObservabilityError with the unknowns.
    """
    computed, design = model.linearised(model.first)
    if not (np.isfinite(computed).all() and design.finite):
        raise DataError(
            "the equations give no finite numbers at the start values: give others in Model.first"
        )
    white = design.weighted(1.0 / model.std)
    if _by_form(model, white) is None:
        _whole(model, white)


def _by_form(model: Model, design: Design) -> Kernel | None:
    """Return the kernel of the form of a whitened design; None where it has none that is firm.

    Or none of circles whose outputs feel what is open. Raises ObservabilityError where others do.
    """
    form = design.kernel()
    found = None if form is None else _defined(model, form)
    if found is None or not found.directions.shape[1]:
        return found
    if design.divided:
        _require_unfelt(model, found)
        return found
    return None if _feels(model, found) else found


def _defined(model: Model, kernel: Kernel) -> Kernel:
    """Return the kernel of outputs that keep what is defined."""
    if model.definitions is None or not kernel.directions.shape[1]:
        return kernel
    return ConstrainedKernel.of(kernel, model.definitions)


def fit_model(
    model: Model,
    used: Bools,
    std: Floats,
    start: Floats,
    extra: Floats | None = None,
    settled: float = CONVERGED,
) -> Fit:
    """Return the least-squares solution with the observations ``used`` (n,), weighed by ``std``.

    ``start`` (p,) or longer; ``extra`` (n, q): columns that are unknowns, too. Gauss-Newton; where
    its steps creep, damped ones lead on. The steps may be rough, what they end at is where the
    gradient vanishes, to a step whose square, in standard deviations and per chi-squared, is
    ``settled``. Raises ObservabilityError where an output feels what nothing tells, DataError
    where the iteration does not settle.
    """
    n, p = model.size
    extra = np.zeros((n, 0)) if extra is None else extra
    x, weight = np.zeros(p + extra.shape[1]), used / std
    x[: min(len(start), len(x))] = start[: len(x)]
    x, found = _stepped(model, x, (used, std), extra, settled)
    if found is not None:
        return found
    damped = _damped(model, x, weight, extra)
    if damped is None:
        raise _unsettled()
    found = _stepped(model, damped, (used, std), extra, settled)[1]  # digits, where it is steep
    if found is not None:
        return found
    computed, jacobian = _computed(model, damped, extra)
    form = _Steps.of(model, jacobian.weighted(weight)).by_form
    return Fit(model, damped, model.observed - computed, std, used, jacobian, form)


def _stepped(
    model: Model, x: Floats, weighed: tuple[Bools, Floats], extra: Floats, settled: float
) -> tuple[Floats, Fit | None]:
    """Return where Gauss-Newton leads from ``x`` (p + q,), and the solution if it settles there.

    With halved steps where the sum of squares would grow, not very often. ``weighed``: ``used``
    and ``std`` (n,) of the observations.
    """
    used, std = weighed
    weight, before = used / std, np.inf
    computed, jacobian = _computed(model, x, extra)
    steps, solved = _Steps.of(model, jacobian.weighted(weight)), jacobian
    if steps.defines:  # what is defined is no step of the iteration
        x = steps.defined(x)
        computed, jacobian = _computed(model, x, extra)
        solved = jacobian
    slow, halved = False, 0
    for _ in range(MAX_ITERATIONS):
        residual = model.observed - computed
        white = residual * weight
        step, left = steps(white, x)
        if jacobian is not solved and left > STRAIGHT * before and (slow or before > FROZEN):
            steps, solved = _Steps.of(model, jacobian.weighted(weight)), jacobian
            step, left = steps(white, x)
        square = float(white @ white)
        # what no longer shrinks is the rounding of the observations
        near = left < NEARLY * max(square, 1.0)
        if left <= settled * max(square, 1.0) or (near and 0.25 * before < left):
            x = x + step  # no more matter, but digits
            left_over = model.observed - _computed(model, x, extra)[0]
            return x, Fit(model, x, left_over, std, used, jacobian, steps.by_form)
        slow, before = left > SHRINKS * before, left
        while True:
            computed, jacobian = _computed(model, x + step, extra)
            after = (model.observed - computed) * weight
            finite = np.isfinite(after).all() and jacobian.finite
            if finite and (near or float(after @ after) <= square):
                break
            if halved == HALVINGS:
                return x, None  # these steps creep
            step, halved = 0.5 * step, halved + 1
        x = x + step
    return x, None


def _damped(model: Model, x: Floats, weight: Floats, extra: Floats) -> Floats | None:
    """Return the unknowns (p + q,) where damped steps from ``x`` end; None where they do not.

    After Levenberg and Marquardt, for long bent valleys, which steps follow (Transtrum and Sethna,
    arXiv:1201.5885): whole ones leave them, and shortened ones creep. Where a valley is flat, any
    place of it will do.
    """
    computed, jacobian = _computed(model, x, extra)
    white = (model.observed - computed) * weight
    square, damping = float(white @ white), 1e-3
    for _ in range(MOST_DAMPED):
        design = jacobian.weighted(weight)
        if design.large or not (np.isfinite(square) and jacobian.finite):
            return None
        squares, pull = design.normal(), design.transpose_times(white)
        along = np.where(squares.diagonal() > 0.0, squares.diagonal(), 1.0)
        firm = squares + damping * np.diag(along)
        step: Floats = np.asarray(np.linalg.solve(firm, pull), dtype=np.float64)
        near = (model.observed - _computed(model, x + BEND * step, extra)[0]) * weight
        bend: Floats = np.asarray(2.0 / BEND * ((white - near) / BEND - design.times(step)))
        bent = np.linalg.solve(firm, design.transpose_times(-0.5 * bend))
        if np.isfinite(bent).all() and bent @ (along * bent) <= step @ (along * step):
            step = step + bent
        computed, ahead = _computed(model, x + step, extra)
        after = (model.observed - computed) * weight
        if not (ahead.finite and float(after @ after) <= square):
            if float(pull @ step) <= FLAT * max(square, 1.0):
                return x  # what is left to gain drowns in rounding
            damping *= 10.0
            if damping > STIFF:
                return None
            continue
        gained = square - float(after @ after)
        x, white, square, jacobian = x + step, after, float(after @ after), ahead
        damping = max(0.1 * damping, LEAST_DAMPING)
        if gained <= FLAT * max(square, 1.0) and damping <= FLAT:
            return x
    return None


def _unsettled() -> DataError:
    return DataError(
        "the adjustment does not settle: the start values are too far off, or observations "
        "contradict each other; check units, signs and order of the data"
    )


def _computed(model: Model, x: Floats, extra: Floats) -> tuple[Floats, Design]:
    """Return computed observations (n,) and the design (n, p + q), effects included."""
    p = model.size[1]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        computed, jacobian = model.linearised(x[:p])  # outside its domain a step is shortened
    if not extra.shape[1]:
        return computed, jacobian
    return computed + extra @ x[p:], jacobian.with_extra(extra)


@dataclass(frozen=True, eq=False)
class _Steps:
    """What leads to the solution of a whitened ``design``, with the kernel of its form or without.

    Without, by what else its form has; or by the normal equations, which are quick, where these
    are firm.
    """

    model: Model
    design: Design
    by_form: Kernel | None

    @classmethod
    def of(cls, model: Model, design: Design) -> _Steps:
        return cls(
            model, design, None if design.prefers_normal_equations else _by_form(model, design)
        )

    def __call__(self, white: Floats, x: Floats) -> tuple[Floats, float]:
        """Return the step (p + q,) from ``x`` that ``white`` (n,) asks for, as it is defined.

        And the square it takes off.
        """
        step = self.by_form.solve(white) if self.by_form else self.design.roughly(white)
        if step is None:
            return self._by_normal_equations(white, x)
        change = self.design.times(step)
        if self.defines:
            step = self.defined(x + step) - x
        return step, float(change @ change)

    @property
    def defines(self) -> bool:
        """Whether definitions fix what is open of this design, where that is known beforehand."""
        return self._fixing is not None

    @cached_property
    def _fixing(self) -> tuple[Floats, Floats] | None:
        """Definitions (g, p + q), and what takes what they are off to the unknowns, (p + q, g)."""
        if isinstance(self.by_form, ConstrainedKernel):
            return self.by_form.rows, self.by_form.fixing
        if self.model.definitions is None or (open_ := self.design.open_directions) is None:
            return None
        rows = np.pad(self.model.definitions, ((0, 0), (0, len(open_) - self.model.size[1])))
        return rows, fix_open_directions(rows, open_, _scale(self.design))[0]

    def defined(self, x: Floats) -> Floats:
        """Return unknowns ``x`` (p + q,) as they are defined."""
        if self._fixing is None:
            return x
        rows, fixing = self._fixing
        return np.asarray(x - fixing @ (rows @ x))

    def _by_normal_equations(self, white: Floats, x: Floats) -> tuple[Floats, float]:
        if self._factor is None:
            step = self._whole.solve(white)
            change = self.design.times(step)
            if isinstance(self._whole, ConstrainedKernel):
                step = self._whole.defined(x + step) - x
            return step, float(change @ change)
        (root, scale, open_), moving = self._factor, _moving(self.model, len(x))
        along = lapack.dtrtrs(root, (self.design.transpose_times(white) / scale)[moving], trans=1)[
            0
        ]
        step = np.zeros(len(scale))
        step[moving] = lapack.dtrtrs(root, along)[0]
        step /= scale
        if self.model.definitions is not None and open_.shape[1]:
            rows = np.pad(self.model.definitions, ((0, 0), (0, len(scale) - self.model.size[1])))
            step -= fix_open_directions(rows, open_, scale)[0] @ (rows @ (x + step))
        return step, float(along @ along)

    @cached_property
    def _whole(self) -> Kernel:
        return _whole(self.model, self.design)

    @cached_property
    def _factor(self) -> tuple[Floats, Floats, Floats] | None:
        """The root of the normal equations, their scale, and what is open; None: not firm."""
        model, design = self.model, self.design
        _require_told(model, design)
        squares = design.normal()
        scale = np.sqrt(np.where(squares.diagonal() > 0.0, squares.diagonal(), 1.0))
        squares /= scale * scale[:, None]
        moving = _moving(model, len(scale))
        squares = squares[moving][:, moving]
        root, failed = lapack.dpotrf(squares)
        firm = not failed and lapack.dpocon(root, np.abs(squares).sum(axis=0).max())[0] >= FIRM**2
        open_ = _open(model, design, root, scale) if firm else None
        return None if open_ is None else (root, scale, open_)


def _require_told(model: Model, design: Design) -> None:
    """Raise ObservabilityError for unknowns of circles that no observation feels, weighted.

    And for too many unknowns for a whole matrix, where nothing else solves them.
    """
    if design.divided:
        return
    counted = model.output_rows.influenced
    unseen = np.flatnonzero(counted & (design.lengths[: len(counted)] == 0.0))
    if unseen.size:
        raise _untold(_in_words(model, unseen, np.zeros((model.size[0], len(counted)), np.bool_)))
    if design.large:
        raise ObservabilityError(
            "the observations cannot separate the places of the circles: measure what joins them"
        )


def _untold(names: str) -> ObservabilityError:
    return ObservabilityError(
        f"no observation determines {names}: measure them, or leave them out"
    )


def _moving(model: Model, unknowns: int) -> Ints | slice:
    """Return the unknowns that do not stand still, of so many with effects that were taken up."""
    if not len(model.fixed):
        return slice(None)
    return np.delete(np.arange(unknowns), model.fixed)


def _open(model: Model, design: Design, root: Floats, scale: Floats) -> Floats | None:
    """Return the open directions (p + q, k); None: unknowns that stand still may be felt.

    Their columns should be combinations of those of unknowns that move. ``root``: the upper
    Cholesky factor of the normal matrix of these, times ``scale`` (p + q,). What it leaves is
    taken once more, since it squares what is badly conditioned.
    """
    held = model.fixed
    open_ = np.zeros((len(scale), len(held)))
    if not len(held):
        return open_
    open_[held, np.arange(len(held))] = 1.0 / scale[held]
    left, moving = design.times(open_), _moving(model, len(scale))
    for _ in range(2):
        part = np.zeros_like(open_)
        part[moving] = lapack.dpotrs(
            root, (design.transpose_times(left) / scale[:, None])[moving]
        )[0]
        left = left - design.times(part / scale[:, None])
        open_ -= part / scale[:, None]
    return open_ if (np.linalg.norm(left, axis=0) <= OPEN).all() else None


def _whole(model: Model, design: Design) -> Kernel:
    """Return the kernel of a whitened design by the whole of it.

    Raises ObservabilityError where outputs feel what is open.
    """
    try:
        found = _defined(model, DenseKernel.of(design, model.fixed))
    except np.linalg.LinAlgError as error:  # the unknowns have run away
        raise _unsettled() from error
    _require_unfelt(model, found)
    return found


def _scale(design: Design) -> Floats:
    """Return the length (p + q,) of each column, 1 where that is none."""
    lengths = design.lengths
    return np.where(lengths > 0.0, lengths, 1.0)


def _feels(model: Model, kernel: Kernel) -> bool:
    """Whether an output feels a direction that nothing determines, by more than rounding."""
    outputs, open_, scale = model.output_rows, kernel.directions, _scale(kernel.design)
    influence, lengths = (
        np.abs(outputs.times(open_)),
        np.linalg.norm(open_ * scale[:, None], axis=0),
    )
    return bool((influence > FREE * outputs.lengths(scale)[:, None] * lengths).any())


def _require_unfelt(model: Model, kernel: Kernel) -> None:
    """Raise ObservabilityError where an output feels a direction that nothing determines.

    What is open else, such as a zero that all readings share, is no matter.
    """
    if not kernel.directions.shape[1] or not _feels(model, kernel):
        return
    scale, telling = _scale(kernel.design), kernel.design.dense() != 0.0
    open_ = np.linalg.qr(kernel.directions * scale[:, None])[0].T
    every = model.every_output
    outputs = np.pad(every, ((0, 0), (0, len(scale) - every.shape[1]))) / scale
    influence = outputs @ open_.T
    size, ways = np.linalg.svd(influence, full_matrices=False)[1:]
    lost = ways[size > FREE * size[0]] @ open_  # what outputs feel of it
    share = np.linalg.norm(lost, axis=0)[: model.size[1]]
    unseen = (telling[:, : len(share)].sum(axis=0) == 0) & (share > FREE)
    if unseen.any():
        names = _in_words(model, np.flatnonzero(unseen), telling)
        raise _untold(names)
    wanted = (outputs != 0.0).any(axis=0)[: len(share)]
    named = wanted & (share > NAMED * share[wanted].max())
    if len(lost) == 1:  # one part has moved against the other
        along = lost[0, : len(share)]
        named &= along * along[np.argmax(share * wanted)] > 0.0
        if (others := np.flatnonzero(wanted & ~named)).size:
            part, rest = (_in_words(model, k, telling) for k in (np.flatnonzero(named), others))
            raise ObservabilityError(
                f"the observations cannot separate {part} from {rest}: measure what joins them"
            )
    names = _in_words(model, np.flatnonzero(named), telling)
    raise ObservabilityError(
        f"the observations cannot separate {names}: measure what joins them to the others"
    )


def _in_words(model: Model, unknowns: Ints, telling: Bools) -> str:
    """Return the names of unknowns, in brackets the groups of observations that depend on them.

    Kinds of groups of which all, or very many, depend on them say nothing.
    """
    most = 8
    names = [model.name_of(k) for k in unknowns[:most].tolist()]
    names += [phrase("{0} others", len(unknowns) - most)] if len(unknowns) > most else []
    rows, groups = telling[:, unknowns].any(axis=1), list[str]()
    for grouping in model.groupings:
        every, here = (set(n[n >= 0].tolist()) for n in (grouping.number, grouping.number[rows]))
        if 0 < len(here) < min(len(every), most) and grouping.kind not in model.blocks:
            groups += [f"{grouping.kind} {k}" for k in sorted(here)]
    return ", ".join(names) + (f" ({', '.join(groups)})" if groups else "")
