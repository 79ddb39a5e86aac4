"""What a method measures, said so that the engine can do the rest.

A method without algebra of its own hands a :class:`Model` to :func:`~.engine.adjust`: unknowns,
observations, and the effects that could spoil them. All is in one unit (radian or metre) and in
the order of the observations; nothing is whitened.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.groups import CHECKED
from rotcal_ros.adjust.subsets import runs
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import DataError, ObservabilityError
from rotcal_ros.foundation.protection import Effect
from rotcal_ros.foundation.units import ARCSEC

OPEN: Final = 1e-9
"""Singular values below this share of the largest are directions that nothing tells."""
FREE: Final = 1e-7
"""Share of its length that an observation or an output may feel of a free direction."""
NAMED: Final = 0.3
"""Share of the largest part of an open direction from which an unknown is named."""
MAX_ITERATIONS: Final = 50
CONVERGED: Final = 1e-14
"""Squared step, in standard deviations and per chi-squared, that does not matter."""
NEARLY: Final = 1e-6
"""Squared step from which on the solution is so near that no step has to be shortened."""
HALVINGS: Final = 20

Equations = Callable[[Floats], tuple[Floats, Floats]]
"""Takes the unknowns (p,) to the computed observations (n,) and their derivatives (n, p)."""


class Unit(NamedTuple):
    """The unit in which people read the observations, and its SI value."""

    name: str = "arcsec"
    si: float = ARCSEC

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


def linear(design: Floats) -> Equations:
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


@dataclass(frozen=True, eq=False)
class Model:
    """Observed (n,) = computed(x) + noise, and what could be wrong with it.

    ``blocks``: names of the unknowns in the order of x (p,), and how many of each. ``observed``,
    ``std`` (n,): what was read, and its stated standard deviation. ``outputs`` (o, p): C, the
    result is C x. ``free`` (p, g): directions that no observation tells, such as one zero of all;
    outputs must not feel them. ``component`` (n,): which of the ``components`` of noise each
    observation belongs to. ``judged`` (n,): those that may be left out; a certificate may not.
    ``row_name`` calls an observation by its number, for people.
    """

    blocks: Mapping[str, int]
    observed: Floats
    std: Floats
    equations: Equations
    outputs: Floats
    words: Words
    unit: Unit = SECONDS
    start: Floats | None = None
    free: Floats | None = None
    components: Sequence[str] = ("the observations",)
    component: Ints | None = None
    judged: Bools | None = None
    groupings: Sequence[Grouping] = ()
    effects: Sequence[Disturbing] = ()
    row_name: Callable[[int], str] = field(default=lambda row: f"observation {row}")

    def __post_init__(self) -> None:
        """Refuse what does not fit together; raises DataError."""
        n, p = len(self.observed), sum(self.blocks.values())
        if not n:
            raise DataError("nothing was observed: there is nothing to solve")
        if not p:
            raise DataError("the model has no unknowns")
        free = (p, 0) if self.free is None else (p, np.shape(self.free)[-1])
        for name, values, wanted in (
            ("observed", self.observed, (n,)),
            ("std", self.std, (n,)),
            ("start", self.first, (p,)),
            ("outputs", self.outputs, (len(self.outputs), p)),
            ("free", np.zeros((p, 0)) if self.free is None else self.free, free),
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

    def name_of(self, unknown: int) -> str:
        """Return the name of an unknown for people: its block, its number there."""
        for name, count in self.blocks.items():
            if unknown < count:
                return f"{name} {unknown}" if count > 1 else name
            unknown -= count
        raise DataError(f"the model has no unknown {unknown}")


@dataclass(frozen=True, eq=False)
class Fit:
    """A model at its least-squares solution, by the whole design: the dense reference.

    ``x`` (p + q,): the unknowns, then the sizes of q effects that were found. ``residual`` (n,):
    observed - computed, also of observations that are not ``used``. ``std`` (n,): as weighed.
    ``basis`` (n, rank): orthonormal columns that span the whitened design of what is used.
    ``gain`` (p + q, n): what whitened errors do to x.
    """

    model: Model
    x: Floats
    residual: Floats
    std: Floats
    used: Bools
    design: Floats
    basis: Floats
    gain: Floats

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
        rows = self.design / self.std[:, None]
        predicted = 1.0 + ((rows @ self.gain) ** 2).sum(axis=1)
        variance = np.where(self.used, self.redundancy, predicted)
        checked = variance > CHECKED
        root = np.sqrt(np.where(checked, variance, 1.0))
        return np.where(checked, self.residual / self.std / root, 0.0)

    @cached_property
    def outputs(self) -> Floats:
        """C (o, p + q): the outputs do not count the effects that were taken up."""
        extra = len(self.x) - self.model.size[1]
        return np.pad(self.model.outputs, ((0, 0), (0, extra)))

    @property
    def value(self) -> Floats:
        """The outputs (o,)."""
        return np.asarray(self.outputs @ self.x)

    @cached_property
    def response(self) -> Floats:
        """B (o, n): what whitened errors do to the outputs."""
        return np.asarray(self.outputs @ self.gain)

    def covariance_of(self, rows: Floats) -> Floats:
        """Return the covariance of ``rows`` (k, p) times the unknowns."""
        own = np.pad(rows, ((0, 0), (0, len(self.x) - rows.shape[1]))) @ self.gain
        return np.asarray(own @ own.T)

    def left_of(self, white: Floats) -> Floats:
        """Return what whitened errors (n, k) leave in the residuals, R times them."""
        mine = white * self.used[:, None]
        return np.asarray(mine - self.basis @ (self.basis.T @ mine))


def require_determined(model: Model) -> None:
    """Refuse a model that leaves more open than it says, or whose outputs feel what is open.

    Raises ObservabilityError with the unknowns; DataError for a free direction that observations
    determine, or that an output feels.
    """
    computed, jacobian = model.equations(model.first)
    if not (np.isfinite(computed).all() and np.isfinite(jacobian).all()):
        raise DataError("the equations give no finite numbers at the start values")
    white = jacobian / model.std[:, None]
    _solved(model, white)
    if model.free is None:
        return
    length = np.maximum(np.linalg.norm(white, axis=0), np.finfo(np.float64).tiny)
    if np.linalg.matrix_rank(model.free * length[:, None]) < model.free.shape[1]:
        raise DataError("the free directions of the model depend on each other, or are zero")
    for k, direction in enumerate(model.free.T):
        felt = np.abs(white @ direction).max() / np.linalg.norm(length * direction)
        if felt > FREE:
            raise DataError(f"free direction {k} of the model is determined by the observations")
        moved = np.abs(model.outputs @ direction)
        if (moved > FREE * np.abs(model.outputs) @ np.abs(direction)).any():
            raise DataError(
                f"an output of the model feels free direction {k}, which nothing tells"
            )


def fitted(
    model: Model, used: Bools, std: Floats, start: Floats, extra: Floats | None = None
) -> Fit:
    """Return the least-squares solution with the observations ``used`` (n,), weighed by ``std``.

    ``start`` (p,) or longer; ``extra`` (n, q): columns that are unknowns, too. Gauss-Newton with
    halved steps where the sum of squares would grow. Raises ObservabilityError where more than
    the free directions is open, DataError where the iteration does not settle.
    """
    n, p = model.size
    extra = np.zeros((n, 0)) if extra is None else extra
    x = np.zeros(p + extra.shape[1])
    x[: min(len(start), len(x))] = start[: len(x)]
    weight, before = used / std, np.inf
    computed, jacobian = _computed(model, x, extra)
    for _ in range(MAX_ITERATIONS):
        basis, gain = _solved(model, jacobian * weight[:, None])
        residual = model.observed - computed
        white = residual * weight
        left, square = float(np.sum((basis.T @ white) ** 2)), float(white @ white)
        # what no longer shrinks is the rounding of the observations
        if left <= CONVERGED * max(square, 1.0) or 0.25 * before < left < NEARLY:
            return Fit(model, x, residual, std, used, jacobian, basis, gain)
        step, before = gain @ white, left
        for _halved in range(HALVINGS):
            computed, jacobian = _computed(model, x + step, extra)
            after = (model.observed - computed) * weight
            finite = np.isfinite(after).all() and np.isfinite(jacobian).all()
            if finite and (left < NEARLY or float(after @ after) <= square):
                break
            step = 0.5 * step
        else:
            break  # no step makes it better
        x = x + step
    raise DataError(
        "the adjustment does not settle: the start values are too far off, or observations "
        "contradict each other"
    )


def _computed(model: Model, x: Floats, extra: Floats) -> tuple[Floats, Floats]:
    """Return computed observations (n,) and the design (n, p + q), effects included."""
    p = model.size[1]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        computed, jacobian = model.equations(x[:p])  # outside its domain a step is shortened
    return computed + extra @ x[p:], np.concatenate([jacobian, extra], axis=1)


def _solved(model: Model, white: Floats) -> tuple[Floats, Floats]:
    """Return the basis (n, rank) of a whitened design, and its pseudo-inverse (p, n).

    By SVD of columns that were brought to length one: what is open is told by small singular
    values, whatever the units of the unknowns.
    """
    scale = np.linalg.norm(white, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    u, s, vt = np.linalg.svd(white / scale, full_matrices=False)
    determined = s > OPEN * s[0]
    rank, free = int(determined.sum()), 0 if model.free is None else model.free.shape[1]
    if rank < white.shape[1] - free:
        raise ObservabilityError(_what_is_open(model, white / scale, scale, rank))
    gain = (vt[determined].T / s[determined]) @ u[:, determined].T / scale[:, None]
    return u[:, determined], gain


def _what_is_open(model: Model, scaled: Floats, scale: Floats, rank: int) -> str:
    """Return in words which unknowns the observations leave open, beside the free directions."""
    p = model.size[1]
    unseen = np.flatnonzero(np.linalg.norm(scaled[:, :p], axis=0) == 0.0)
    null = np.linalg.svd(np.linalg.qr(scaled, mode="r"))[2][rank:, :p].T
    if model.free is not None:
        known = np.linalg.qr(model.free * scale[:p, None])[0]
        null = null - known @ (known.T @ null)
    share = np.linalg.norm(null, axis=1)
    named = unseen if len(unseen) else np.flatnonzero(share > NAMED * share.max())
    names = ", ".join(model.name_of(int(k)) for k in named[:8])
    more = f" and {len(named) - 8} others" if len(named) > 8 else ""
    why = "no observation tells of" if len(unseen) else "the observations cannot tell apart"
    return f"{why} {names}{more}: measure what joins them to the others"


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
