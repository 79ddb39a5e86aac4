"""What a method measures, said so that the engine can do the rest.

A method without algebra of its own hands a :class:`Model` to :func:`~.engine.adjust`: unknowns,
observations, and the effects that could spoil them. All is in one unit (radian or metre) and in
the order of the observations; nothing is whitened.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from scipy.linalg import lapack
from scipy.sparse import csr_array

from rotcal_ros.adjust.arrow import (
    Arrow,
    Design,
    FewEach,
    adjoint,
    beside,
    dense,
    normal,
    times,
    weighted,
)
from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.groups import CHECKED
from rotcal_ros.adjust.subsets import runs
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import DataError, ObservabilityError
from rotcal_ros.foundation.protection import Effect
from rotcal_ros.foundation.units import ARCSEC

OPEN: Final = 1e-9
"""Singular values below this share of the largest are directions that nothing tells."""
FIRM: Final = 1e-6
"""Reciprocal condition number from which on a design needs no singular values."""
FREE: Final = 1e-7
"""Share of its length that an output may feel of a direction that nothing tells."""
NAMED: Final = 0.3
"""Share of the largest part of an open direction from which an unknown is named."""
MAX_ITERATIONS: Final = 50
CONVERGED: Final = 1e-14
"""Squared step, in standard deviations and per chi-squared, that does not matter."""
NEARLY: Final = 1e-6
"""Squared step from which on the solution is so near that no step has to be shortened."""
HALVINGS: Final = 20
MOST_MOMENTS: Final = 1000
"""Moments at which a move is looked for in each of several ways."""
SAME: Final = 0.01
"""Difference of the outputs, in their uncertainty, that makes it no matter which cause it was."""

Equations = Callable[[Floats], tuple[Floats, Design]]
"""Takes the unknowns (p,) to the computed observations (n,) and their derivatives (n, p).

As scipy's ``csr_array`` of those entries that can be other than zero, the same at all unknowns,
they are solved block by block where they fall into blocks (:mod:`.arrow`).
"""


ANGULAR: Final = ("arcsec", "arcmin", "deg", "rad", "mrad", "urad", "µrad", "nrad", "gon", "mgon")
"""Names of units of angles."""


class Unit(NamedTuple):
    """The unit in which people read the observations, and its SI value."""

    name: str = "arcsec"
    si: float = ARCSEC

    @property
    def angular(self) -> bool:
        """Whether it is one of angles; else it counts as one of lengths."""
        return self.name in ANGULAR

    def shown(self, value: float) -> str:
        """Return an SI ``value`` for people."""
        return f"{value / self.si:.3g} {self.name}"


SECONDS: Final = Unit()


class Grouping(NamedTuple):
    """Observations that may be spoiled together: of one station, position, target or run.

    ``number`` (n,): which one each belongs to, -1 for none. ``along`` (n,): a time or place along
    which neighbours are spoiled together; None: only the whole group is judged.
    """

    kind: str
    number: Ints
    along: Floats | None = None

    def with_others(self, count: int) -> Grouping:
        """Return the same beside further observations that belong to none."""
        along = None if self.along is None else np.append(self.along, np.zeros(count))
        return self._replace(number=np.append(self.number, np.full(count, -1)), along=along)


@dataclass(frozen=True, eq=False)
class Disturbing:
    """An effect that could spoil the observations: ``columns`` (n, k) of errors per unit of size.

    Of all observations, zero for those that it does not touch, as a certificate's values. Or what
    makes such columns from the computed observations (n,), as a wrong scale does: the observed
    ones hold the very noise that they would explain. ``what`` happens, for people.
    ``largest``: a size that nobody would overlook, in SI; people are shown sizes in ``unit``. A
    ``family`` has columns of which at most one is there, in the order of time; other columns are
    there together.
    """

    effect: Effect
    what: str
    columns: Floats | Callable[[Floats], Floats]
    largest: float
    unit: Unit = SECONDS
    family: bool = False

    def at(self, computed: Floats) -> Floats:
        """Return the columns (n, k) where the observations are ``computed`` (n,)."""
        return self.columns(computed) if callable(self.columns) else self.columns

    def mapped(
        self, to: Callable[[Floats], Floats], back: Callable[[Floats], Floats]
    ) -> Disturbing:
        """Return the effect on observations that were changed.

        ``to`` changes columns (n, k) as observations were, ``back`` takes computed ones (n',) to
        what they were before.
        """
        if callable(self.columns):
            return replace(self, columns=lambda computed: to(self.at(back(computed))))
        return replace(self, columns=to(self.columns))


def linear(design: Floats | csr_array) -> Equations:
    """Return the equations of observations that are ``design`` (n, p) times the unknowns."""
    return lambda x: (design @ x, design)


def indicators(*blocks: tuple[Ints, int]) -> Floats:
    """Return the design (n, p) of observations that are sums of one unknown of each block.

    ``blocks``: number (n,) of the unknown, -1 for none, and how many the block has.
    """
    return np.concatenate(
        [(number[:, None] == np.arange(count)).astype(np.float64) for number, count in blocks],
        axis=1,
    )


def drifts(run: Ints, when: Floats) -> Floats:
    """Return a linear drift by one unit in each ``run`` (n,), -1 for none: (n, runs)."""
    found = []
    for number in np.unique(run[run >= 0]):
        mine = run == number
        if span := float(np.ptp(when[mine])):
            found.append(np.where(mine, (when - when[mine].mean()) / span, 0.0))
    return np.column_stack([np.zeros((len(run), 0)), *found])


def knocks(run: Ints, when: Floats) -> Floats:
    """Return shifts by one unit from each moment within a ``run`` (n,) on, in time: (n, k)."""
    found = [
        (run == number) & (when >= moment)
        for number in np.unique(run[run >= 0])
        for moment in np.unique(when[run == number])[1:]
    ]
    return np.column_stack([np.zeros((len(run), 0)), *found])


def steps(run: Ints, when: Floats, felt: Floats) -> Floats:
    """Return what a move by one unit does from each moment within a ``run`` (n,) on: (n, k m).

    ``felt`` (n, k): what each reading feels of k ways to move, one after the other. Of very many
    moments some, evenly.
    """
    every = knocks(run, when)
    some = every[:, :: max(1, every.shape[1] // MOST_MOMENTS)]
    return np.column_stack([some * each[:, None] for each in felt.T])


def effect_texts(instrument: str, moved: str = "") -> tuple[str, str, str, str]:
    """Return what :func:`instrument_effects` are called, in their order."""
    return (
        f"{instrument} drifts",
        f"{instrument} drifts in one run,",
        f"{moved or instrument} moved",
        f"the scale of {instrument} is wrong",
    )


def instrument_effects(
    instrument: str,
    run: Ints,
    when: Floats,
    largest: float,
    *,
    moved: str = "",
    unit: Unit = SECONDS,
    scale: float = 0.1,
) -> tuple[Disturbing, ...]:
    """Return what may happen to any instrument: it drifts, something moves, its scale is wrong.

    It drifts in all runs or in one of them. ``run`` (n,): readings from one zero, -1 for none;
    ``when`` (n,): the order or the time. ``largest``: a drift or a shift that nobody would
    overlook, ``scale`` the same of its scale, 0.1 for one that may be off by 10 %; ``moved``: what
    may be moved.
    """
    drifting, shifted = drifts(run, when), knocks(run, when)
    drift, alone, moves, wrong = effect_texts(instrument, moved)
    found = [Disturbing("drift", drift, drifting, largest, unit)]
    if drifting.shape[1] > 1:
        found.append(Disturbing("drift", alone, drifting, largest, unit, family=True))
    return (
        *found,
        Disturbing("knock", moves, shifted, largest, unit, family=True),
        Disturbing("scale", wrong, _scaled, scale, Unit("%", 0.01)),
    )


def _scaled(computed: Floats) -> Floats:
    """Return by how much readings are off whose scale is too large by 1: (n, 1)."""
    return computed[:, None]


def from_first(blocks: Mapping[str, int], name: str) -> Floats:
    """Return outputs (k, p): the k unknowns of a block, counted from the first of them."""
    outputs = block_rows(blocks, name)
    return np.asarray(outputs - outputs[0], dtype=np.float64)


def from_mean(blocks: Mapping[str, int], name: str) -> Floats:
    """Return outputs (k, p): the k unknowns of a block, counted from their mean."""
    outputs = block_rows(blocks, name)
    return np.asarray(outputs - outputs.mean(axis=0), dtype=np.float64)


def block_rows(blocks: Mapping[str, int], name: str) -> Floats:
    """Return rows (k, p) that take the unknowns of a block out of all, as they are."""
    if name not in blocks:
        raise DataError(f"the model has no block {name!r}: its blocks are {', '.join(blocks)}")
    before = sum(list(blocks.values())[: list(blocks).index(name)])
    return np.eye(blocks[name], sum(blocks.values()), before)


@dataclass(frozen=True, eq=False)
class Model:
    """Observed (n,) = computed(x) + noise, and what could be wrong with it.

    ``blocks``: names of the unknowns in the order of x (p,), and how many of each. ``observed``,
    ``std`` (n,): what was read, and its stated standard deviation. ``outputs`` (o, p): C, the
    result is C x; what nothing tells, such as a zero that all readings share, outputs must not
    feel. ``also`` (k, p) by name: what else is told with its uncertainty, but counts in no test.
    ``component`` (n,): which of the ``components`` of noise each observation belongs to.
    ``judged`` (n,): those that may be left out. ``row_names``: what people call the observations;
    else they are called by their groups. What is known beforehand joins by :meth:`knowing`.
    """

    blocks: Mapping[str, int]
    observed: Floats
    std: Floats
    equations: Equations
    outputs: Floats
    words: Words
    unit: Unit = SECONDS
    start: Floats | None = None
    also: Mapping[str, Floats] = field(default_factory=dict)
    components: Sequence[str] = ("the observations",)
    component: Ints | None = None
    judged: Bools | None = None
    groupings: Sequence[Grouping] = ()
    effects: Sequence[Disturbing] = ()
    row_names: Sequence[str] = ()

    def __post_init__(self) -> None:
        """Refuse what does not fit together; raises DataError."""
        n, p = len(self.observed), sum(self.blocks.values())
        if not n:
            raise DataError("nothing was observed: there is nothing to solve")
        if not p:
            raise DataError("the model has no unknowns")
        for name, values, wanted in (
            ("observed", self.observed, (n,)),
            ("std", self.std, (n,)),
            ("start", self.first, (p,)),
            ("outputs", self.outputs, (len(self.outputs), p)),
            *((name, rows, (len(rows), p)) for name, rows in self.also.items()),
            ("component", self.of_component, (n,)),
            ("judged", self.may_go, (n,)),
            *((f"numbers of {g.kind}", g.number, (n,)) for g in self.groupings),
            *(
                (f"places of {g.kind}", g.along, (n,))
                for g in self.groupings
                if g.along is not None
            ),
            *((f"columns of {e.effect}", e.at(self.observed), None) for e in self.effects),
        ):
            found = np.shape(values)
            if found != wanted and not (wanted is None and len(found) == 2 and found[0] == n):
                raise DataError(
                    f"{name} of the model: shape {found}, expected {wanted or (n, 'k')}"
                )
            if not np.isfinite(values).all():
                raise DataError(f"{name} of the model: expected finite numbers")
        if not (self.std > 0.0).all():
            raise DataError("std of the model: expected positive numbers")
        if not np.isin(self.of_component, np.arange(len(self.components))).all():
            raise DataError(f"component of the model: expected 0 to {len(self.components) - 1}")

    @property
    def size(self) -> tuple[int, int]:
        """Numbers n of observations and p of unknowns."""
        return len(self.observed), sum(self.blocks.values())

    @cached_property
    def of_component(self) -> Ints:
        """Component (n,) of each observation."""
        if self.component is None:
            return np.zeros(len(self.observed), dtype=np.int64)
        return self.component

    @cached_property
    def may_go(self) -> Bools:
        """Whether each observation (n,) may be left out."""
        return np.ones(len(self.observed), dtype=np.bool_) if self.judged is None else self.judged

    @property
    def first(self) -> Floats:
        """Where the iteration starts (p,)."""
        return np.zeros(self.size[1]) if self.start is None else self.start

    @cached_property
    def every_output(self) -> Floats:
        """``outputs`` and, below them, all of ``also`` (o + a, p)."""
        return np.concatenate([self.outputs, *self.also.values()])

    @cached_property
    def held(self) -> Ints:
        """Unknowns (k,) that may stand still: the others tell what they do, as a zero of all does.

        Those that pivoted Cholesky finds last at the start values. Who leaves them out must check
        that nothing is lost: it takes what is weak for open, too.
        """
        _, jacobian = self.equations(self.first)
        squares = normal(weighted(jacobian, 1.0 / self.std))
        length = np.sqrt(np.where(squares.diagonal() > 0.0, squares.diagonal(), 1.0))
        _, pivots, rank, _ = lapack.dpstrf(squares / length / length[:, None], tol=FIRM**2)
        return np.sort(pivots[rank:] - 1) if rank else np.zeros(0, dtype=np.int64)

    @cached_property
    def names(self) -> Sequence[str]:
        """What people call each observation: its groups, and which one of several it is."""
        if self.row_names or not self.groupings:
            return self.row_names or [f"observation {k}" for k in range(len(self.observed))]
        groups = zip(*(g.number.tolist() for g in self.groupings), strict=True)
        kinds = [g.kind for g in self.groupings]
        plain = [
            ", ".join(f"{kind} {k}" for kind, k in zip(kinds, numbers, strict=True) if k >= 0)
            for numbers in groups
        ]
        whole, seen, found = Counter(plain), Counter[str](), []
        for name in plain:
            seen[name] += 1
            found.append(f"{name} ({seen[name]} of {whole[name]})" if whole[name] > 1 else name)
        return found

    def at(self, unknowns: Floats) -> Model:
        """Return the model of exact observations, were these the ``unknowns`` (p,)."""
        return replace(self, observed=self.equations(unknowns)[0], start=unknowns)

    def knowing(self, what: str, rows: Floats, values: Floats, std: float) -> Model:
        """Return the model with what is known beforehand, as from a certificate.

        ``rows`` (k, p) times the unknowns are ``values`` (k,), each with ``std``: observations
        that belong to no group, that no effect spoils and that are never left out, with noise of
        their own. ``what`` they are, for people.
        """
        n, k = len(self.observed), len(values)

        def equations(x: Floats) -> tuple[Floats, Design]:
            computed, design = self.equations(x)
            return np.append(computed, rows @ x), beside(design, rows)

        def below(columns: Floats) -> Floats:
            return np.pad(columns, ((0, k), (0, 0)))

        return replace(
            self,
            observed=np.append(self.observed, values),
            std=np.append(self.std, np.full(k, std)),
            equations=equations,
            components=(*self.components, what),
            component=np.append(self.of_component, np.full(k, len(self.components))),
            judged=np.append(self.may_go, np.zeros(k, dtype=np.bool_)),
            groupings=[g.with_others(k) for g in self.groupings],
            effects=[e.mapped(below, lambda computed: computed[:n]) for e in self.effects],
            row_names=[*self.names, *(f"value {i} of {what}" for i in range(k))],
        )

    def sharing(self, errors: Floats) -> Model:
        """Return the model of observations that have errors in common, made independent.

        ``errors`` (n, r): what r independent ones do, each of its standard deviation, beside the
        noise of each observation. The symmetric root of the covariance takes them off: of all
        roots it changes an observation least, and its own error stays nearly its own.
        """
        ways, size, _ = np.linalg.svd(errors / self.std[:, None], full_matrices=False)
        root = np.sqrt(1.0 + size**2)

        def changed(values: Floats, by: Floats) -> Floats:
            """Multiply ``values`` (n,) or (n, k) by so much along each of the ways."""
            white = (values.T / self.std).T
            white = white + (ways * (by - 1.0)) @ (ways.T @ white)
            return np.asarray((white.T * self.std).T)

        def freed(values: Floats) -> Floats:
            return changed(values, 1.0 / root)

        def equations(x: Floats) -> tuple[Floats, Design]:
            computed, design = self.equations(x)
            return freed(computed), freed(dense(design))

        return replace(
            self,
            observed=freed(self.observed),
            equations=equations,
            effects=[
                e.mapped(freed, lambda computed: changed(computed, root)) for e in self.effects
            ],
        )

    def name_of(self, unknown: int) -> str:
        """Return the name of an unknown for people: its block, its number there."""
        for name, count in self.blocks.items():
            if unknown < count:
                return f"{name} {unknown}" if count > 1 else name
            unknown -= count
        raise DataError(f"the model has no unknown {unknown}")


@dataclass(frozen=True, eq=False)
class CurveModel:
    """A model, and what of its unknowns are deviations: rows (m, p) of each of the ``curves``.

    At the commanded ``angles`` (m,) rad; also those that the model has, but does not tell: the
    ``mixed`` ones, which other instruments may.
    """

    model: Model
    angles: Floats
    curves: Mapping[str, Floats]
    mixed: Collection[str] = ()


@dataclass(frozen=True, eq=False)
class Fit:
    """A model at its least-squares solution, by the whole design: the dense reference.

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
    def _factors(self) -> tuple[Floats, Floats]:
        return _factored(self.model, self.design * (self.used / self.std)[:, None])

    @property
    def basis(self) -> Floats:
        """Orthonormal columns (n, rank) that span the whitened design of what is used."""
        return self._factors[0]

    @property
    def root(self) -> Floats:
        """A root (p + q, rank) of the cofactors: times its transposed it is those of x."""
        return self._factors[1]

    @cached_property
    def gain(self) -> Floats:
        """What whitened errors do to x (p + q, n)."""
        return np.asarray(self.root @ self.basis.T)

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
        """Observations in use minus unknowns that they tell."""
        return int(self.used.sum()) - int(self.basis.shape[1])

    @cached_property
    def redundancy(self) -> Floats:
        """Share (n,) of each observation that the others check; zero where not used."""
        return np.where(self.used, 1.0 - (self.basis**2).sum(axis=1), 0.0)

    @cached_property
    def test_value(self) -> Floats:
        """Residuals (n,) in their own standard deviation; 0 where nothing checks one.

        Of what is not used, against what the others predict.
        """
        variance, left = self.redundancy.copy(), ~self.used
        rows = self.design[left] / self.std[left, None]
        variance[left] = 1.0 + ((rows @ self.root) ** 2).sum(axis=1)
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
        return np.asarray(self.outputs @ self.x)

    @cached_property
    def response(self) -> Floats:
        """B (o + a, n): what whitened errors do to the outputs."""
        return np.asarray((self.outputs @ self.root) @ self.basis.T)

    @cached_property
    def output_std(self) -> Floats:
        """Standard deviations (o + a,) of the outputs; infinite for those that count nowhere."""
        return self.counting(np.linalg.norm(self.outputs @ self.root, axis=1))

    def felt(self, change: Floats) -> bool:
        """Whether a ``change`` (o + a,) of the outputs is no trifle for those that count."""
        return bool((np.abs(change) > SAME * self.output_std).any())

    def counting(self, std: Floats) -> Floats:
        """Return ``std`` (o + a,), infinite for those that count in no test."""
        return np.where(np.arange(len(std)) < len(self.model.outputs), std, np.inf)

    def left_of(self, white: Floats) -> Floats:
        """Return what whitened errors (n, k) leave in the residuals, R times them."""
        mine = white * self.used[:, None]
        return np.asarray(mine - self.basis @ (self.basis.T @ mine))


def require_determined(model: Model) -> None:
    """Refuse a model whose outputs feel what no observation tells.

    Raises ObservabilityError with the unknowns.
    """
    computed, design = model.equations(model.first)
    jacobian = dense(design)
    if not (np.isfinite(computed).all() and np.isfinite(jacobian).all()):
        raise DataError(
            "the equations give no finite numbers at the start values: give others in Model.first"
        )
    _factored(model, jacobian / model.std[:, None])


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
    blocks = weighted(jacobian, weight)
    arrow = Arrow.of(blocks.few) if isinstance(blocks, FewEach) else None
    for _ in range(MAX_ITERATIONS):
        residual = model.observed - computed
        white = residual * weight
        step, left = _step(model, weighted(jacobian, weight), white, arrow)
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
    return computed + extra @ x[p:], np.concatenate([dense(jacobian), extra], axis=1)


def _step(
    model: Model, design: Floats | FewEach, white: Floats, arrow: Arrow | None
) -> tuple[Floats, float]:
    """Return the step (p + q,) that ``white`` (n,) asks for, and the square that it takes off.

    Block by block, or by the normal equations, which are quick, where these are firm.
    """
    step = None
    if isinstance(design, FewEach) and arrow is not None:
        step = arrow.solved(design, white)
    if step is not None:
        felt = times(design, step)
        return step, float(felt @ felt)
    squares = normal(design)
    scale = np.sqrt(np.where(squares.diagonal() > 0.0, squares.diagonal(), 1.0))
    squares /= scale * scale[:, None]
    moving = _moving(model, len(scale))
    squares = squares[moving][:, moving]
    root, failed = lapack.dpotrf(squares)
    firm = not failed and lapack.dpocon(root, np.abs(squares).sum(axis=0).max())[0] >= FIRM**2
    if not firm or not _told_by_others(model, design, root, scale):
        basis, cofactors = _factored(model, dense(design))
        along = basis.T @ white
        return cofactors @ along, float(along @ along)
    along = lapack.dtrtrs(root, (adjoint(design, white) / scale)[moving], trans=1)[0]
    step = np.zeros(len(scale))
    step[moving] = lapack.dtrtrs(root, along)[0]
    return step / scale, float(along @ along)


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


def _factored(model: Model, white: Floats) -> tuple[Floats, Floats]:
    """Return the basis (n, rank) of a whitened design, and a root (p, rank) of the cofactors.

    Of columns that were brought to length one: by QR, or by SVD where that is not firm. What is
    open is told by small singular values, whatever the units of the unknowns.
    """
    scale = np.linalg.norm(white, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    unit, moving = white / scale, _moving(model, len(scale))
    if len(unit) >= len(scale) - len(model.held) and np.isfinite(unit).all():
        basis, upper = np.linalg.qr(unit[:, moving])
        if lapack.dtrcon(upper)[0] > FIRM and _is_open(model, scale, unit, basis, upper):
            root = np.zeros((len(scale), len(upper)))
            root[moving] = lapack.dtrtri(upper)[0]
            return basis, root / scale[:, None]
    try:
        u, s, vt = np.linalg.svd(unit, full_matrices=False)
    except np.linalg.LinAlgError as error:  # the unknowns have run away
        raise _unsettled() from error
    determined = s > OPEN * s[0]
    if not determined.all() or len(s) < len(scale):
        full = vt if len(vt) == len(scale) else np.linalg.svd(unit)[2]
        _require_unfelt(model, scale, full[int(determined.sum()) :], white != 0.0)
    return u[:, determined], vt[determined].T / s[determined] / scale[:, None]


def _is_open(model: Model, scale: Floats, unit: Floats, basis: Floats, upper: Floats) -> bool:
    """Whether the unknowns that stand still are told by nothing, and felt by no output.

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
    lengths = np.linalg.norm(directions, axis=0)
    return bool((felt <= FREE * np.linalg.norm(outputs, axis=1, keepdims=True) * lengths).all())


def _require_unfelt(model: Model, scale: Floats, open_: Floats, telling: Bools) -> None:
    """Raise ObservabilityError where an output feels one of the ``open_`` directions (k, p + q).

    Both in unknowns times ``scale`` (p + q,); ``telling`` (n, p + q): which observations tell of
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
        raise ObservabilityError(
            f"no observation tells of {names}: measure them, or leave them out"
        )
    wanted = (outputs != 0.0).any(axis=0)[: len(share)]
    named = wanted & (share > NAMED * share[wanted].max())
    if len(lost) == 1:  # one part has moved against the other
        along = lost[0, : len(share)]
        named &= along * along[np.argmax(share * wanted)] > 0.0
        if (others := np.flatnonzero(wanted & ~named)).size:
            part, rest = (_in_words(model, k, telling) for k in (np.flatnonzero(named), others))
            raise ObservabilityError(
                f"the observations cannot tell {part} from {rest}: measure what joins them"
            )
    names = _in_words(model, np.flatnonzero(named), telling)
    raise ObservabilityError(
        f"the observations cannot tell apart {names}: measure what joins them to the others"
    )


def _in_words(model: Model, unknowns: Ints, telling: Bools) -> str:
    """Return the names of unknowns, and in brackets the groups of observations that tell of them.

    Kinds of groups of which all, or very many, tell of them say nothing.
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


def members_of(grouping: Grouping, judged: Bools) -> dict[int, Ints]:
    """Return the judged observations of each group, by its number."""
    return {
        int(number): np.flatnonzero((grouping.number == number) & judged)
        for number in np.unique(grouping.number[grouping.number >= 0])
    }


def gathered_of(grouping: Grouping, members: Ints) -> Bools:
    """Return which members (e,) of a group lie together, (q, e); none where nothing says so."""
    if grouping.along is None:
        return np.zeros((0, len(members)), dtype=np.bool_)
    return runs(grouping.along[members])
