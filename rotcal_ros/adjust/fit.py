"""A model at its least-squares solution, and what that makes of errors in the observations.

By the whole design, which is the reference; order by order where a design is of circles
(:mod:`.circles`). Steps go block by block where unknowns fall into blocks (:mod:`.arrow`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from scipy.linalg import lapack
from scipy.sparse import csr_array

from rotcal_ros.adjust.arrow import (
    OPEN,
    Arrow,
    Design,
    FewEach,
    Turned,
    adjoint,
    dense,
    normal,
    times,
    weighted,
)
from rotcal_ros.adjust.circles import (
    AT_ONCE,
    LARGE,
    Circular,
    Cofactors,
    Eliminated,
    Iterated,
)
from rotcal_ros.adjust.groups import CHECKED
from rotcal_ros.adjust.model import FIRM, Model
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import DataError, ObservabilityError

FREE: Final = 1e-7
"""Share of its length that an output may feel of a direction that nothing determines."""
NAMED: Final = 0.3
"""Share of the largest part of an open direction from which an unknown is named."""
MAX_ITERATIONS: Final = 50
CONVERGED: Final = 1e-14
"""Squared step, in standard deviations and per chi-squared, that does not matter."""
NEARLY: Final = 1e-6
"""Squared step from which on the solution is so near that no step has to be shortened."""
HALVINGS: Final = 20
SURELY: Final = 0.9
"""Share of a limit below which bounds that are found by iteration need not be known exactly."""
SAME: Final = 0.01
"""Difference of the outputs, in their uncertainty, that makes it no matter which cause it was."""


class Whole(NamedTuple):
    """The cofactors N^-1 of a whitened design J (n, p), by the whole of it: the reference.

    ``basis``: orthonormal columns (n, rank) that span J; ``root`` (p, rank) times its transposed
    is N^-1. Both are blocks and little else where J is an arrow.
    """

    basis: Floats | Turned
    root: Floats | Turned

    @property
    def rank(self) -> int:
        """How many unknowns are determined."""
        if isinstance(self.basis, Turned):
            return int(self.basis.below.shape[1])
        return int(self.basis.shape[1])

    def _rows(self, which: Ints) -> Floats:
        return self.basis.rows(which) if isinstance(self.basis, Turned) else self.basis[which]

    def among(self, rows: Ints) -> Floats:
        """Return J N^-1 J' between some ``rows`` (k,), (k, k)."""
        if isinstance(self.basis, Turned):
            return self.basis.among(rows)
        return np.asarray(self.basis[rows] @ self.basis[rows].T)

    def along(self, white: Floats | csr_array) -> Floats:
        """Return the parts (rank, k) of whitened errors (n, k) along the basis."""
        return adjoint(self.basis, white)

    def felt_by(self, rows: Floats) -> Floats:
        """Return what ``rows`` (k, p) make of a unit along the basis, (k, rank)."""
        return np.asarray(adjoint(self.root, rows.T).T)

    @property
    def leverage(self) -> Floats:
        """The diagonal (n,) of J N^-1 J'."""
        if isinstance(self.basis, Turned):
            return self.basis.squares
        return np.asarray((self.basis**2).sum(axis=1))

    def taken(self, white: Floats) -> Floats:
        """Return what the unknowns take up of whitened errors (n, k): J N^-1 J' times them."""
        return times(self.basis, self.along(white))

    def shared(self, part: Bools) -> Floats:
        """Return the sums of squares (c, c) of J N^-1 J' between parts (c, n) of all rows.

        What the largest has of the unit matrix B'B is what the others leave of it.
        """
        largest = int(part.sum(axis=1).argmax())
        squares = np.zeros((len(part), self.rank, self.rank))
        for k in np.delete(np.arange(len(part)), largest).tolist():
            mine = self._rows(np.flatnonzero(part[k]))
            squares[k] = mine.T @ mine
        squares[largest] = np.eye(self.rank) - squares.sum(axis=0)
        return np.asarray(np.einsum("kab,lab->kl", squares, squares))

    def squares(self, rows: Floats) -> Floats:
        """Return the variances (k,) of what ``rows`` (k, p) make of the unknowns."""
        return np.asarray((self.felt_by(rows) ** 2).sum(axis=1))


@dataclass(frozen=True, eq=False)
class Fit:
    """A model at its least-squares solution.

    ``x`` (p + q,): the unknowns, then the sizes of q effects that were found. ``residual`` (n,):
    observed - computed, also of observations that are not ``used``. ``weighed`` (n,): with which
    standard deviations.
    """

    model: Model
    x: Floats
    residual: Floats
    std: Floats
    used: Bools
    jacobian: Design

    @cached_property
    def design(self) -> Floats:
        """The derivatives (n, p + q) of the computed observations."""
        return dense(self.jacobian)

    @cached_property
    def by_order(self) -> Cofactors | None:
        """The cofactors of circles; None of others, or where too much is missing for that."""
        if not isinstance(self.jacobian, Circular):
            return None
        return _by_order(self.model, self.jacobian.weighted(self.used / self.std))

    @cached_property
    def cofactors(self) -> Whole | Cofactors:
        """Those of x (p + q, p + q), from the whitened design of what is used."""
        if self.by_order is not None:
            return self.by_order
        return _whole(self.model, weighted(self.jacobian, self.used / self.std))

    def gain(self, unknowns: slice) -> Floats:
        """Return what whitened errors do to some ``unknowns``, (k, n)."""
        found = self.cofactors
        if isinstance(found, Whole):
            each = np.eye(len(self.x))[unknowns]
            return np.asarray(times(found.basis, found.felt_by(each).T).T)
        count = unknowns.stop - unknowns.start
        each = np.eye(len(self.x), count, -unknowns.start)
        return np.asarray(found.design.times(found.times(each)).T)

    def _rows(self, which: Bools) -> Floats:
        """Return the derivatives (k, p + q) of some observations."""
        if isinstance(self.jacobian, Circular):
            return self.jacobian.rows(np.flatnonzero(which))
        if isinstance(self.jacobian, FewEach):
            return self.jacobian.rows(np.flatnonzero(which))
        return self.design[which]

    @property
    def computed(self) -> Floats:
        """What the unknowns make of the observations (n,)."""
        return self.model.observed - self.residual

    @cached_property
    def white(self) -> Floats:
        """Whitened residuals (n,), zero where not used."""
        return np.where(self.used, self.residual / self.std, 0.0)

    @property
    def chi2(self) -> float:
        """The sum of squares of what is used."""
        return float(self.white @ self.white)

    @property
    def dof(self) -> int:
        """Observations in use minus unknowns that they determine."""
        return int(self.used.sum()) - self.cofactors.rank

    @cached_property
    def redundancy(self) -> Floats:
        """Share (n,) of each observation that the others check; zero where not used."""
        return np.where(self.used, 1.0 - self.cofactors.leverage, 0.0)

    @cached_property
    def test_value(self) -> Floats:
        """Residuals (n,) in their own standard deviation; 0 where nothing checks one.

        Of what is not used, against what the others predict.
        """
        variance, left = self.redundancy.copy(), ~self.used
        rows = self._rows(left) / self.std[left, None]
        variance[left] = 1.0 + self.cofactors.squares(rows)
        checked = variance > CHECKED
        root = np.sqrt(np.where(checked, variance, 1.0))
        return np.where(checked, self.residual / self.std / root, 0.0)

    @cached_property
    def outputs(self) -> Floats:
        """C (o + a, p + q): the outputs do not count the effects that were taken up."""
        return _padded(self.model.every_output, len(self.x))

    @property
    def value(self) -> Floats:
        """All outputs (o + a,)."""
        if self.by_order is not None:
            return self.model.output_rows.times(self.x)
        return np.asarray(self.outputs @ self.x)

    @cached_property
    def response(self) -> Floats:
        """B (o + a, n): what whitened errors do to the outputs; correlated ones as independent."""
        if isinstance(self.cofactors, Whole):
            response: Floats = self._alone.copy()
            for each in self.model.correlated:
                response[:, each.rows] = each.spread(response[:, each.rows], each.possible(self))
            return response
        return self.response_of(np.arange(len(self.std)))

    def _response_where(self, asked: Bools) -> Floats:
        """Return B, of which only columns that are ``asked`` for (n,) count."""
        together = any(asked[each.rows].any() for each in self.model.correlated)
        return self.response if together else self._alone

    @cached_property
    def _alone(self) -> Floats:
        return self.alone(slice(None))

    def alone(self, rows: slice) -> Floats:
        """Return what whitened errors of some ``rows`` (k,) do to the outputs (o + a, k).

        Each as it is, whatever they have in common; of a design that is no circles.
        """
        found = self.cofactors
        assert isinstance(found, Whole)
        return np.asarray(times(found.basis, found.felt_by(self.outputs).T)[rows].T)

    def response_of(self, rows: Ints) -> Floats:
        """Return what whitened errors of some ``rows`` (k,) do to the outputs, (o + a, k)."""
        found = self.cofactors
        if isinstance(found, Whole):
            return self._response_where(np.isin(np.arange(len(self.std)), rows))[:, rows]
        parts = np.array_split(rows, len(rows) // AT_ONCE + 1)
        return np.hstack([self.model.output_rows.times(found.gained(part)) for part in parts])

    def moved(self, white: Floats) -> Floats:
        """Return what whitened errors (n, k) do to the outputs, (o + a, k): B times them."""
        found = self.cofactors
        if isinstance(found, Whole):
            return np.asarray(self._response_where(np.any(np.atleast_2d(white.T), 0)) @ white)
        return self.model.output_rows.times(found.times(found.design.adjoint(white)))

    def covariance(self, count: int) -> Floats:
        """Return the covariance (count, count) of the first outputs, by the noise alone: B B'."""
        found = self.cofactors
        if isinstance(found, Whole):
            return self._covariance[:count, :count]
        first, whole = self.model.output_rows.first(count), np.zeros((count, count))
        for here, rows in first.parts(len(self.x)):
            whole[:, here] = first.times(found.times(rows.T))
        whole += whole.T.copy()
        whole *= 0.5
        return whole

    @cached_property
    def _covariance(self) -> Floats:
        return np.asarray(self.response @ self.response.T)

    @cached_property
    def variance(self) -> Floats:
        """Variances (o + a,) of the outputs, by the noise alone."""
        found = self.cofactors
        if isinstance(found, Whole):
            return self._covariance.diagonal()
        parts = self.model.output_rows.parts(len(self.x))
        return np.concatenate([found.squares(rows) for _, rows in parts])

    @property
    def noise_std(self) -> Floats:
        """Standard deviations (o + a,) of all outputs, by the noise alone."""
        if self.by_order is not None:
            return np.sqrt(self.variance)
        return np.asarray(np.linalg.norm(self.response, axis=1))

    def variance_from(self, part: Bools) -> Floats:
        """Return the variances (o + a, c) of the outputs by the noise of each ``part`` (c, n)."""
        if isinstance(self.cofactors, Whole):
            return np.asarray((self.response**2) @ part.T.astype(np.float64))
        if len(part) == 1:
            return self.variance[:, None]
        found, every = np.zeros((len(self.model.output_rows), len(part))), np.arange(len(self.std))
        for rows in np.array_split(every, len(every) // AT_ONCE + 1):
            found += self.response_of(rows) ** 2 @ part[:, rows].T.astype(np.float64)
        return found

    @cached_property
    def output_std(self) -> Floats:
        """Standard deviations (o + a,) of the outputs; infinite for those that count nowhere."""
        if self.by_order is not None:
            return self.counting(np.sqrt(self.variance))
        if isinstance(self.jacobian, Circular):
            design = self.jacobian.weighted(self.used / self.std)
            plain = Eliminated.of(design)
            if plain is None:
                _require_told(self.model, design)
            else:
                parts = self.model.output_rows.parts(len(self.x))
                squares = np.concatenate([plain.squares(rows) for _, rows in parts])
                return self.counting(np.sqrt(squares))
        found = self.cofactors
        assert isinstance(found, Whole)
        return self.counting(np.linalg.norm(found.felt_by(self.outputs), axis=1))

    def far_worse_than(self, other: Fit, factor: float) -> bool:
        """Whether an output is less sure than by ``factor`` times of another fit.

        Raises ObservabilityError where one is not determined at all.
        """
        mine, others = self._iterated, other._iterated
        if mine is not None and others is not None:
            outputs = self.model.output_rows.first(len(self.model.outputs))
            bound = others.extremes[1] * mine.orders.variances(outputs)
            least = mine.extremes[0] * others.orders.variances(outputs)
            if (bound <= (SURELY * factor) ** 2 * least).all():
                return False
        return bool((self.output_std > factor * other.output_std).any())

    @cached_property
    def _iterated(self) -> Iterated | None:
        if not isinstance(self.jacobian, Circular):
            return None
        return Iterated.of(self.jacobian.weighted(self.used / self.std))

    def without(self, rows: Ints) -> tuple[float, int] | None:
        """Return chi-squared and the unknowns that are determined without some ``rows`` (k,).

        Of circles; None of others, or where those rows leave what is not firm.
        """
        if not isinstance(self.jacobian, Circular):
            return None
        weight = self.used / self.std
        weight[rows] = 0.0
        design = self.jacobian.weighted(weight)
        # an effect on those rows alone is no unknown of the others
        design = replace(design, extra=design.extra[:, design.extra.any(axis=0)])
        found = Cofactors.of(design, lost=True)
        if found is None:
            return None
        white = self.residual * weight
        left = white - design.times(found.solved(design, white))
        return float(left @ left), found.rank

    def felt(self, change: Floats) -> bool:
        """Whether a ``change`` (o + a,) of the outputs is no trifle for those that count."""
        return bool((np.abs(change) > SAME * self.output_std).any())

    def counting(self, std: Floats) -> Floats:
        """Return ``std`` (o + a,), infinite for those that count in no test."""
        return np.where(np.arange(len(std)) < len(self.model.outputs), std, np.inf)

    def left_of(self, white: Floats) -> Floats:
        """Return what whitened errors (n, k) leave in the residuals, R times them."""
        mine = white * self.used[:, None]
        return np.asarray(mine - self.cofactors.taken(mine))


def require_determined(model: Model) -> None:
    """Refuse a model whose outputs feel what no observation determines.

    Raises ObservabilityError with the unknowns.
    """
    computed, design = model.equations(model.first)
    if not _finite(computed, design):
        raise DataError(
            "the equations give no finite numbers at the start values: give others in Model.first"
        )
    if not isinstance(design, Circular):
        _whole(model, weighted(design, 1.0 / model.std))
    elif not _by_order(model, design.weighted(1.0 / model.std)):
        _factored(model, design.dense() / model.std[:, None])


def _by_order(model: Model, design: Circular) -> Cofactors | None:
    """Return the cofactors of a whitened design; None where they are not firm, or outputs felt it.

    Then the whole design shows which unknowns are at fault.
    """
    found = Cofactors.of(design)
    if found is None:
        return None
    directions = found.orders.directions
    felt = np.abs(model.output_rows.times(directions))
    return found if _are_small(felt, model.output_rows.lengths, directions) else None


def fitted(
    model: Model, used: Bools, std: Floats, start: Floats, extra: Floats | None = None
) -> Fit:
    """Return the least-squares solution with the observations ``used`` (n,), weighed by ``std``.

    ``start`` (p,) or longer; ``extra`` (n, q): columns that are unknowns, too. Gauss-Newton with
    halved steps where the sum of squares would grow; the steps may be rough, what they end at is
    where the gradient vanishes. Raises ObservabilityError where an output feels what nothing
    tells, DataError where the iteration does not settle.
    """
    n, p = model.size
    extra = np.zeros((n, 0)) if extra is None else extra
    x = np.zeros(p + extra.shape[1])
    x[: min(len(start), len(x))] = start[: len(x)]
    weight, before = used / std, np.inf
    computed, jacobian = _computed(model, x, extra)
    solver = _solver(model, weighted(jacobian, weight))
    for _ in range(MAX_ITERATIONS):
        residual = model.observed - computed
        white = residual * weight
        step, left = _step(model, weighted(jacobian, weight), white, solver)
        square = float(white @ white)
        # what no longer shrinks is the rounding of the observations
        if left <= CONVERGED * max(square, 1.0) or 0.25 * before < left < NEARLY:
            x = x + step  # no more matter, but digits
            return Fit(
                model, x, model.observed - _computed(model, x, extra)[0], std, used, jacobian
            )
        before = left
        for _halved in range(HALVINGS):
            computed, jacobian = _computed(model, x + step, extra)
            after = (model.observed - computed) * weight
            if _finite(after, jacobian) and (left < NEARLY or float(after @ after) <= square):
                break
            step = 0.5 * step
        else:
            break  # no step makes it better
        x = x + step
    raise _unsettled()


Solver: TypeAlias = "Arrow | Cofactors | Eliminated | Iterated"
"""What solves a design by its form."""


def _solver(model: Model, design: Floats | FewEach) -> Solver | None:
    """Return what solves a whitened ``design`` by its form; None where it has none."""
    if isinstance(design, Circular):
        return _by_order(model, design) or Iterated.of(design) or Eliminated.of(design)
    return Arrow.of(design.few) if isinstance(design, FewEach) else None


def _unsettled() -> DataError:
    return DataError(
        "the adjustment does not settle: the start values are too far off, or observations "
        "contradict each other; check units, signs and order of the data"
    )


def _finite(computed: Floats, design: Design) -> bool:
    entries = design.few if isinstance(design, FewEach) else design
    entries = entries if isinstance(entries, np.ndarray) else entries.data
    return bool(np.isfinite(computed).all() and np.isfinite(entries).all())


def _computed(model: Model, x: Floats, extra: Floats) -> tuple[Floats, Design]:
    """Return computed observations (n,) and the design (n, p + q), effects included."""
    p = model.size[1]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        computed, jacobian = model.equations(x[:p])  # outside its domain a step is shortened
    if not extra.shape[1]:
        return computed, jacobian
    if isinstance(jacobian, Circular):
        return computed + extra @ x[p:], jacobian.with_extra(extra)
    return computed + extra @ x[p:], np.concatenate([dense(jacobian), extra], axis=1)


def _step(
    model: Model,
    design: Floats | FewEach,
    white: Floats,
    solver: Solver | None,
) -> tuple[Floats, float]:
    """Return the step (p + q,) that ``white`` (n,) asks for, and the square that it takes off.

    Block by block, or by the normal equations, which are quick, where these are firm.
    """
    step = None
    if isinstance(design, FewEach) and solver is not None:
        step = solver.solved(design, white)
    if step is None and isinstance(solver, Iterated):
        plain = Eliminated.of(solver.design)
        step = None if plain is None else plain.solved(solver.design, white)
    if step is not None:
        felt = times(design, step)
        return step, float(felt @ felt)
    if isinstance(design, Circular):
        _require_told(model, design)
        design = design.dense()
    squares = normal(design)
    scale = np.sqrt(np.where(squares.diagonal() > 0.0, squares.diagonal(), 1.0))
    squares /= scale * scale[:, None]
    moving = _moving(model, len(scale))
    squares = squares[moving][:, moving]
    root, failed = lapack.dpotrf(squares)
    firm = not failed and lapack.dpocon(root, np.abs(squares).sum(axis=0).max())[0] >= FIRM**2
    if not firm or not _told_by_others(model, design, root, scale):
        whole = _whole(model, design)
        along = whole.along(white)
        return times(whole.root, along), float(along @ along)
    along = lapack.dtrtrs(root, (adjoint(design, white) / scale)[moving], trans=1)[0]
    step = np.zeros(len(scale))
    step[moving] = lapack.dtrtrs(root, along)[0]
    return step / scale, float(along @ along)


def _require_told(model: Model, design: Circular) -> None:
    """Raise ObservabilityError for unknowns of a weighted ``design`` that no observation feels."""
    felt = model.output_rows.felt
    telling = np.asarray(abs(design.few).sum(axis=0))
    unseen = np.flatnonzero(felt & (telling == 0.0))
    if unseen.size:
        raise _untold(_in_words(model, unseen, np.zeros((model.size[0], len(felt)), np.bool_)))
    if design.turns.size >= LARGE:  # no whole matrix of so many
        raise ObservabilityError(
            "the observations cannot separate the places of the circles: measure what joins them"
        )


def _untold(names: str) -> ObservabilityError:
    return ObservabilityError(
        f"no observation determines {names}: measure them, or leave them out"
    )


def _moving(model: Model, unknowns: int) -> Ints | slice:
    """Return the unknowns that do not stand still, of so many with effects that were taken up."""
    if not len(model.held):
        return slice(None)
    return np.delete(np.arange(unknowns), model.held)


def _told_by_others(model: Model, design: Floats | FewEach, root: Floats, scale: Floats) -> bool:
    """Whether columns of unknowns that stand still are combinations of those that move.

    ``root``: the upper Cholesky factor of the normal matrix of these, times ``scale`` (p + q,).
    What it leaves is taken once more, since it squares what is badly conditioned.
    """
    held = model.held
    if not len(held):
        return True
    unit = np.zeros((len(scale), len(held)))
    unit[held, np.arange(len(held))] = 1.0 / scale[held]
    left, moving = times(design, unit), _moving(model, len(scale))
    for _ in range(2):
        part = np.zeros_like(unit)
        part[moving] = lapack.dpotrs(root, (adjoint(design, left) / scale[:, None])[moving])[0]
        left = left - times(design, part / scale[:, None])
    return bool((np.linalg.norm(left, axis=0) <= OPEN).all())


def _whole(model: Model, design: Floats | FewEach) -> Whole:
    """Return the cofactors of a whitened design, block by block where it is a firm arrow."""
    if isinstance(design, FewEach) and not len(model.held):
        arrow = Arrow.of(design.few)
        found = None if arrow is None else arrow.factored(design)
        if found is not None:
            _require_unmoved(model, design, found[2])
            return Whole(*found[:2])
    return _factored(model, dense(design))


def _require_unmoved(model: Model, design: FewEach, open_: Floats) -> None:
    """Raise ObservabilityError where outputs feel directions ``open_`` (k, p) of a design."""
    if not len(open_):
        return
    white = design.dense()
    scale = np.linalg.norm(white, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    directions = np.linalg.qr((open_ * scale).T)[0]
    _require_unfelt(model, scale, directions.T, white != 0.0)


def _factored(model: Model, white: Floats) -> Whole:
    """Return the cofactors of a whitened design (n, p).

    Of columns that were brought to length one: by QR, or by SVD where that is not firm. What is
    open is shown by small singular values, whatever the units of the unknowns.
    """
    scale = np.linalg.norm(white, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    unit, moving = white / scale, _moving(model, len(scale))
    if len(unit) >= len(scale) - len(model.held) and np.isfinite(unit).all():
        basis, upper = np.linalg.qr(unit[:, moving])
        if lapack.dtrcon(upper)[0] > FIRM and _is_open(model, scale, unit, basis, upper):
            root = np.zeros((len(scale), len(upper)))
            root[moving] = lapack.dtrtri(upper)[0]
            return Whole(basis, root / scale[:, None])
    try:
        u, s, vt = np.linalg.svd(unit, full_matrices=False)
    except np.linalg.LinAlgError as error:  # the unknowns have run away
        raise _unsettled() from error
    determined = s > OPEN * s[0]
    if not determined.all() or len(s) < len(scale):
        full = vt if len(vt) == len(scale) else np.linalg.svd(unit)[2]
        _require_unfelt(model, scale, full[int(determined.sum()) :], white != 0.0)
    return Whole(u[:, determined], vt[determined].T / s[determined] / scale[:, None])


def _is_open(model: Model, scale: Floats, unit: Floats, basis: Floats, upper: Floats) -> bool:
    """Whether the unknowns that stand still are determined by nothing, and felt by no output.

    ``unit`` (n, p + q) of unknowns times ``scale`` (p + q,); ``basis`` and ``upper``: the QR
    decomposition of those that move.
    """
    held = unit[:, model.held]
    along = basis.T @ held
    if (np.linalg.norm(held - basis @ along, axis=0) > OPEN).any():
        return False
    directions = np.zeros((len(scale), len(model.held)))
    directions[_moving(model, len(scale))] = -lapack.dtrtrs(upper, along)[0]
    directions[model.held, np.arange(len(model.held))] = 1.0
    return _is_unfelt(_padded(model.every_output, len(scale)) / scale, directions)


def _is_unfelt(outputs: Floats, directions: Floats) -> bool:
    """Whether ``outputs`` (o, p + q) feel none of the ``directions`` (p + q, k)."""
    felt = np.abs(outputs @ directions)
    return _are_small(felt, np.linalg.norm(outputs, axis=1), directions)


def _are_small(felt: Floats, outputs: Floats, directions: Floats) -> bool:
    """Whether what outputs of these lengths (o,) have ``felt`` (o, k) is nothing but rounding."""
    lengths = np.linalg.norm(directions, axis=0)
    return bool((felt <= FREE * outputs[:, None] * lengths).all())


def _require_unfelt(model: Model, scale: Floats, open_: Floats, telling: Bools) -> None:
    """Raise ObservabilityError where an output feels one of the ``open_`` directions (k, p + q).

    Both in unknowns times ``scale`` (p + q,); ``telling`` (n, p + q): which observations depend on
    which. What is open else, such as a zero that all readings share, is no matter.
    """
    outputs = _padded(model.every_output, len(scale)) / scale
    if _is_unfelt(outputs, open_.T):
        return
    felt = outputs @ open_.T
    size, ways = np.linalg.svd(felt, full_matrices=False)[1:]
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
    names += [f"{len(unknowns) - most} others"] if len(unknowns) > most else []
    rows, groups = telling[:, unknowns].any(axis=1), list[str]()
    for grouping in model.groupings:
        every, here = (set(n[n >= 0].tolist()) for n in (grouping.number, grouping.number[rows]))
        if 0 < len(here) < min(len(every), most) and grouping.kind not in model.blocks:
            groups += [f"{grouping.kind} {k}" for k in sorted(here)]
    return ", ".join(names) + (f" ({', '.join(groups)})" if groups else "")


def _padded(rows: Floats, unknowns: int) -> Floats:
    """Return ``rows`` (k, p) of so many unknowns; they do not count the last ones."""
    more = unknowns - rows.shape[1]
    return np.pad(rows, ((0, 0), (0, more))) if more else rows
