"""What a method measures, said so that the engine can do the rest.

A method without algebra of its own hands a :class:`Model` to :func:`~.engine.adjust`: unknowns,
observations, and the effects that could spoil them. All is in one unit (radian or metre) and in
the order of the observations; nothing is whitened.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Final, NamedTuple

import numpy as np
from scipy.linalg import lapack
from scipy.sparse import block_diag, csr_array, hstack

from rotcal_ros.adjust.bordered import Groups, SparseDesign, index_within_group
from rotcal_ros.adjust.designs import Derivatives, dense, make_design
from rotcal_ros.adjust.error_motion import Correlated
from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.kernels import FIRM, Design
from rotcal_ros.adjust.outputs import Outputs
from rotcal_ros.adjust.scattering import Scattering
from rotcal_ros.adjust.subsets import contiguous_runs, distinct_of_each, neighbourhoods_of_each
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.language import Phrase, join_texts, phrase
from rotcal_ros.foundation.protection import Effect
from rotcal_ros.foundation.units import ARCSEC, TURN

MOST_MOMENTS: Final = 1000
"""Moments at which a move is looked for in each of several ways."""

Equations = Callable[[Floats], tuple[Floats, Derivatives]]
"""Takes the unknowns (p,) to the computed observations (n,) and their derivatives (n, p).

As scipy's ``csr_array`` of those entries that can be other than zero, the same at all unknowns,
they are solved block by block where they fall into blocks (:mod:`.bordered`).
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

    def shown(self, value: float) -> Phrase:
        """Return an SI ``value`` for people."""
        return phrase("{0:.3g} {1}", value / self.si, self.name)


SECONDS: Final = Unit()


class Grouping(NamedTuple):
    """Observations that may be spoiled together: of one station, position, target or run.

    ``number`` (n,): which one each belongs to, -1 for none. ``along`` (n,): a time or place along
    which neighbours are spoiled together. ``near`` (n, k): places with neighbours all round, unit
    vectors for directions. ``closed``: ``along`` is a bearing, of which the last is followed by
    the first. Of neither: only the whole group is judged. ``frame`` (n, c, c): takes the c rows of
    each one's element, of one noise, to the axes along which those of a group are off alike; None:
    that are the rows.
    """

    kind: str
    number: Ints
    along: Floats | None = None
    near: Floats | None = None
    frame: Floats | None = None
    closed: bool = False

    @property
    def gathers(self) -> bool:
        """Whether it says which observations lie together."""
        return self.along is not None or self.near is not None

    def name_of(self, number: int) -> Phrase:
        """Return what people call one of the groups."""
        return self.names_of([number])[0]

    def names_of(self, numbers: Sequence[int]) -> list[Phrase]:
        """Return the same of several."""
        kind = phrase(self.kind)
        return [phrase("{0} {1}", kind, number) for number in numbers]

    def at(self, rows: Ints) -> Grouping:
        """Return the same of some ``rows`` (k,) alone."""
        known = (self.along, self.near, self.frame)
        along, near, frame = (None if each is None else each[rows] for each in known)
        return self._replace(number=self.number[rows], along=along, near=near, frame=frame)

    def with_others(self, below: int, above: int = 0) -> Grouping:
        """Return the same beside further observations, below and above, that belong to none."""
        rows = (above, below)
        return self._replace(
            number=np.pad(self.number, rows, constant_values=-1),
            along=None if self.along is None else np.pad(self.along, rows),
            near=None if self.near is None else np.pad(self.near, (rows, (0, 0))),
            frame=None if self.frame is None else np.pad(self.frame, (rows, (0, 0), (0, 0))),
        )


@dataclass(frozen=True, eq=False)
class Steps:
    """Moves from each moment within a run on, in time: columns (n, k w), w of each moment.

    They are written out when they are asked for: of many observations they are very many.
    ``run`` (n,): -1 for none; ``when`` (n,): the order or the time. ``ways`` (n, w): what each
    observation feels of w ways to move by one unit; None: of one way, by which all shift alike.
    ``stride``: only each so many-th moment: one between two is seen nearly as well. ``centred``:
    moves count from their mean in the run.
    """

    run: Ints
    when: Floats
    ways: Floats | None = None
    stride: int = 1
    centred: bool = False

    @property
    def influence(self) -> Floats:
        """What each observation feels of each way to move, (n, w)."""
        return np.ones((len(self.run), 1)) if self.ways is None else self.ways

    @property
    def width(self) -> int:
        """The number w of columns of a moment."""
        return 1 if self.ways is None else int(self.ways.shape[1])

    @cached_property
    def runs(self) -> list[tuple[Ints, Ints]]:
        """Of each run its rows (e,) in time, and with which of them its columns (m,) begin."""
        found = []
        for number in np.unique(self.run[self.run >= 0]):
            mine = np.flatnonzero(self.run == number)
            rows = mine[np.argsort(self.when[mine], kind="stable")]
            found.append((rows, np.unique(self.when[rows], return_index=True)[1][1:]))
        ends = np.cumsum([0, *(len(first) for _, first in found)])
        return [
            (rows, first[-end % self.stride :: self.stride])
            for (rows, first), end in zip(found, ends.tolist(), strict=False)
        ]

    def thinned(self, most: int) -> Steps:
        """Return the same of some moments, evenly, where they are far more than ``most``."""
        moments = self.shape[1] // self.width
        return replace(self, stride=self.stride * max(1, moments // most))

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers n of observations and k of columns."""
        return len(self.run), self.width * sum(len(first) for _, first in self.runs)

    def with_others(self, below: int, above: int = 0) -> Steps:
        """Return the same beside observations, below and above, that belong to no run."""
        rows = (above, below)
        ways = None if self.ways is None else np.pad(self.ways, (rows, (0, 0)))
        run = np.pad(self.run, rows, constant_values=-1)
        return replace(self, run=run, when=np.pad(self.when, rows), ways=ways)

    def whole(self, which: slice | Ints = slice(None)) -> Floats:
        """Return some columns (n, m), written out."""
        at, begin = np.arange(self.shape[1])[which], 0
        found = np.zeros((len(self.run), len(at)))
        for rows, first in self.runs:
            mine = np.flatnonzero((at >= begin) & (at < begin + self.width * len(first)))
            moment, way = np.divmod(at[mine] - begin, self.width)
            later = (np.arange(len(rows))[:, None] >= first[moment]).astype(np.float64)
            if self.centred:
                later -= later.mean(axis=0)
            found[rows[:, None], mine] = later * self.influence[rows][:, way]
            begin += self.width * len(first)
        return found


@dataclass(frozen=True, eq=False)
class Disturbing:
    """An effect that could spoil the observations: ``columns`` (n, k) of errors per unit of size.

    Of all observations, zero for those that it does not touch, as a certificate's values. Or what
    makes such columns from the computed observations (n,), as a wrong scale does: the observed
    ones hold the very noise that they would explain. ``what`` happens, for people.
    ``largest``: a size that nobody would overlook, in SI; people are shown sizes in ``unit``. A
    ``family`` has members of which at most one is there, in the order of time, each of so many
    columns as its :attr:`width`; other columns are there together. What ``stays`` does so from
    its moment on until the run ends, as :class:`Steps` do. Where its moment is random, what may
    stay unseen is told of this ``usual`` share of them, not of the worst. Where not every moment
    is a member, each ``stands_for`` so many of them: it is as improbable as any moment.
    """

    effect: Effect
    what: str
    columns: Floats | Steps | Callable[[Floats], Floats]
    largest: float
    unit: Unit = SECONDS
    family: bool = False
    of_each: int = 1
    stays: bool = False
    usual: float = 1.0
    stands_for: float = 1.0

    @property
    def width(self) -> int:
        """How many columns each member of a family has; of :class:`Steps` they say it."""
        return self.columns.width if isinstance(self.columns, Steps) else self.of_each

    def at(self, computed: Floats) -> Floats | Steps:
        """Return the columns (n, k) where the observations are ``computed`` (n,)."""
        return self.columns(computed) if callable(self.columns) else self.columns

    def whole(self, computed: Floats) -> Floats:
        """Return the same, written out; of very many moments some, evenly."""
        found = self.at(computed)
        return found.thinned(MOST_MOMENTS).whole() if isinstance(found, Steps) else found

    def mapped(
        self, to: Callable[[Floats], Floats], back: Callable[[Floats], Floats], *, apart: bool
    ) -> Disturbing:
        """Return the effect on observations that were changed.

        ``to`` changes columns (n, k) as observations were, ``back`` takes computed ones (n',) to
        what they were before. ``apart``: each element was changed by itself.
        """
        if isinstance(self.columns, Steps) and apart:
            return replace(self, columns=replace(self.columns, ways=to(self.columns.influence)))
        if callable(self.columns):
            return replace(self, columns=lambda computed: to(self.whole(back(computed))))
        stays = self.stays or isinstance(self.columns, Steps)
        whole = to(self.whole(np.zeros(0)))
        return replace(self, columns=whole, of_each=self.width, stays=stays)

    def beside(self, below: int, above: int = 0) -> Disturbing:
        """Return the effect beside further observations, below and above, which it spares."""
        if isinstance(self.columns, Steps):
            return replace(self, columns=self.columns.with_others(below, above))

        def spread(columns: Floats) -> Floats:
            return np.pad(columns, ((above, below), (0, 0)))

        def own(computed: Floats) -> Floats:
            return computed[above : len(computed) - below]

        return self.mapped(spread, own, apart=False)


class UnseenEventPrior(NamedTuple):
    """What may have happened unseen, once, by ``size``, plus or minus: a member of a family.

    With this ``probability`` beforehand, as of a fringe that a counter slips.
    """

    effect: Disturbing
    size: float
    probability: float


class KnownRelation(NamedTuple):
    """What outputs are known to keep, though each is free: ``rows`` (k, o) of them are zero.

    But for a scatter of ``std``: as steps round a circle add up to nothing, or a table comes to
    an angle again. ``what`` people are told, as in "*the deviation at 0 deg differs when it is
    measured again*, by 5 ± 1 arcsec", in the ``unit`` of the outputs; None: of the model.
    """

    what: str
    rows: Floats
    std: float = 0.0
    unit: Unit | None = None


def linear(design: Derivatives) -> Equations:
    """Return the equations of observations that are ``design`` (n, p) times the unknowns."""
    form = make_design(design)
    return lambda x: (form.times(x), design)


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


def recurring(run: Ints, when: Floats) -> Floats:
    """Return drifts by one unit that come back with each ``run`` (n,), -1 for none: (n, 3).

    From its first reading to its last: a straight line, one sine and one cosine, whose sums are
    near to a warm-up, too. Runs that all go the same way leave them open, for they are what a
    deviation at each place is; there and back leave open what is the same from both ends.
    """
    each = [run == number for number in np.unique(run[run >= 0])]
    spans = [float(np.ptp(when[mine])) for mine in each if np.ptp(when[mine])]
    gone, span = np.zeros(len(run)), float(np.median(spans)) if spans else 1.0
    for mine in each:
        gone[mine] = (when[mine] - when[mine].min()) / span
    turned = TURN * gone
    shapes = np.column_stack([gone - 0.5, 0.5 * np.sin(turned), 0.5 * np.cos(turned)])
    return np.asarray(np.where((run >= 0)[:, None], shapes, 0.0))


def knocks(run: Ints, when: Floats) -> Floats:
    """Return shifts by one unit from each moment within a ``run`` (n,) on, in time: (n, k)."""
    return Steps(run, when).whole()


def effect_texts(
    instrument: str, moved: str = ""
) -> tuple[Phrase, Phrase, Phrase, Phrase, Phrase]:
    """Return what :func:`instrument_effects` are called, in their order."""
    return (
        phrase("{0} drifts", phrase(instrument)),
        phrase("{0} drifts in one run,", phrase(instrument)),
        phrase("{0} drifts in each run alike", phrase(instrument)),
        phrase("{0} moved", phrase(moved or instrument)),
        phrase("the scale of {0} is wrong", phrase(instrument)),
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

    It drifts in all runs, in one of them, or in each alike. ``run`` (n,): readings from one zero,
    -1 for none; ``when`` (n,): the order or the time. ``largest``: a drift or a shift that nobody
    would overlook, ``scale`` the same of its scale, 0.1 for one that may be off by 10 %;
    ``moved``: what may be moved.
    """
    drifting, shifted = drifts(run, when), Steps(run, when)
    drift, alone, alike, moves, wrong = effect_texts(instrument, moved)
    found = [Disturbing("drift", drift, drifting, largest, unit)]
    if drifting.shape[1] > 1:
        found.append(Disturbing("drift", alone, drifting, largest, unit, family=True))
    swings = recurring(run, when)[:, 1:]  # a straight line in each run is among the drifts
    return (
        *found,
        Disturbing("recurring drift", alike, swings, largest, unit),
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
    result is C x; what nothing determines, such as a zero that all readings share, outputs must
    not feel. ``further`` (k, p) by name: what else is reported with its uncertainty, but counts in
    no test. ``component`` (n,): which of the ``components`` of noise each observation belongs to.
    ``judged`` (n,): those that may be left out. ``row_names``: what people call the observations,
    or what makes the name of one; else they are called by their groups. What is known beforehand
    joins by :meth:`with_prior`.
    Rows that are ``correlated`` are weighed as if they were not; the uncertainty of outputs knows.
    ``element`` (n,): rows of one number stand or fall together, as the coordinates of a centre,
    and share their name; -1: alone. ``mixed`` (n, n): what takes rows back to what was read.
    ``definitions`` G (g, p): G x = 0 fixes what no observation determines, and nothing else.
    ``expected``: what may have happened unseen. ``closures``: relations that outputs should keep.
    ``shared``: blocks that rows of many groups feel, where derivatives come as ``csr_array``.
    ``unstated``: the noise is not known, and ``std`` a guess; no standard deviation is held to be
    below ``least``, as what the equations neglect.
    """

    blocks: Mapping[str, int]
    observed: Floats
    std: Floats
    equations: Equations
    outputs: Floats | Outputs
    words: Words
    unit: Unit = SECONDS
    start: Floats | None = None
    further: Mapping[str, Floats | Outputs] = field(default_factory=dict)
    components: Sequence[str] = ("the observations",)
    component: Ints | None = None
    judged: Bools | None = None
    groupings: Sequence[Grouping] = ()
    effects: Sequence[Disturbing] = ()
    row_names: Sequence[str] | Callable[[int], str] = ()
    correlated: Sequence[Correlated] = ()
    element: Ints | None = None
    mixed: csr_array | None = None
    definitions: Floats | None = None
    expected: Sequence[UnseenEventPrior] = ()
    closures: Sequence[KnownRelation] = ()
    shared: Sequence[str] = ()
    unstated: bool = False
    least: float = 0.0

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
            *((name, rows, (len(rows), p)) for name, rows in self.further.items()),
            ("component", self.of_component, (n,)),
            ("judged", self.rejectable, (n,)),
            *((("element", self.element, (n,)),) if self.element is not None else ()),
            *(
                (("definitions", self.definitions, (np.size(self.definitions) // p, p)),)
                if self.definitions is not None
                else ()
            ),
            *((f"numbers of {g.kind}", g.number, (n,)) for g in self.groupings),
            *(
                (f"places of {g.kind}", g.along, (n,))
                for g in self.groupings
                if g.along is not None
            ),
            *(
                (f"places near each other of {g.kind}", g.near, (n, np.size(g.near) // n))
                for g in self.groupings
                if g.near is not None
            ),
            *((f"columns of {e.effect}", e.at(self.observed), None) for e in self.effects),
        ):
            found = np.shape(values)
            if found != wanted and not (wanted is None and len(found) == 2 and found[0] == n):
                raise DataError(
                    f"{name} of the model: shape {found}, expected {wanted or (n, 'k')}"
                )
            if not (isinstance(values, Steps | Outputs) or np.isfinite(values).all()):
                raise DataError(f"{name} of the model: expected finite numbers")
        if not (self.std > 0.0).all():
            raise DataError("std of the model: expected positive numbers")
        if not np.isin(self.of_component, np.arange(len(self.components))).all():
            raise DataError(f"component of the model: expected 0 to {len(self.components) - 1}")
        self._check_elements()

    def _check_elements(self) -> None:
        if self.element is None:
            return
        first = self.elements[self.of_element, 0]
        sizes = (self.elements >= 0).sum(axis=1)[self.of_element]
        for what, each in (
            ("judged", self.rejectable),
            *((g.kind, g.number) for g in self.groupings),
        ):
            if (each != each[first]).any():
                raise DataError(f"{what} of the model: expected the same for all of an element")
        for g in self.groupings:
            mine = self.rejectable & (g.number >= 0)
            number, size = g.number[mine], sizes[mine]
            mixed = number[np.bincount(number, size)[number] != np.bincount(number)[number] * size]
            if len(mixed):
                raise DataError(
                    f"elements of {g.kind} {mixed.min()}: expected as many rows in each"
                )

    @cached_property
    def of_element(self) -> Ints:
        """Which of the elements (n,) each observation belongs to."""
        n = len(self.observed)
        if self.element is None:
            return np.arange(n)
        alone = self.element.max(initial=-1) + 1 + np.arange(n)
        number = np.where(self.element < 0, alone, self.element)
        _, first, which = np.unique(number, return_index=True, return_inverse=True)
        return np.asarray(np.argsort(np.argsort(first))[which])

    @cached_property
    def elements(self) -> Ints:
        """Rows (m, c) of each element, -1 where one has fewer."""
        number = self.of_element
        at = index_within_group(number)
        found = np.full((int(number.max()) + 1, int(at.max()) + 1), -1)
        found[number, at] = np.arange(len(number))
        return found

    @cached_property
    def rejectable_elements(self) -> int:
        """How many elements may be left out."""
        return int(self.rejectable[self.elements[:, 0]].sum())

    def rows_of(self, elements: Ints) -> Ints:
        """Return the rows of some ``elements`` (k,)."""
        rows = self.elements[elements].ravel()
        return np.asarray(rows[rows >= 0])

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
    def least_factors(self) -> Floats:
        """Factors (c,) of unstated noise that make the smallest of each component ``least``."""
        number = self.of_component
        guess = [self.std[number == k].min(initial=np.inf) for k in range(len(self.components))]
        floor = np.maximum(self.least, np.finfo(np.float64).eps * np.abs(self.observed).max())
        return np.asarray(np.minimum(floor / np.array(guess), 1.0))

    @cached_property
    def rejectable(self) -> Bools:
        """Whether each observation (n,) may be left out."""
        return np.ones(len(self.observed), dtype=np.bool_) if self.judged is None else self.judged

    @property
    def first(self) -> Floats:
        """Where the iteration starts (p,)."""
        return np.zeros(self.size[1]) if self.start is None else self.start

    @cached_property
    def every_output(self) -> Floats:
        """``outputs`` and, below them, all of ``also`` (o + a, p)."""
        return np.concatenate([self.outputs, *self.further.values()])

    @cached_property
    def counting_outputs(self) -> Outputs:
        """``outputs`` alone by what they have in common."""
        return self.output_rows.part(slice(len(self.outputs)))

    @cached_property
    def output_rows(self) -> Outputs:
        """The same by what they have in common."""
        return Outputs.of([self.outputs, *self.further.values()])

    @cached_property
    def fixed(self) -> Ints:
        """Unknowns (k,) that may stand still: the others do what they do, as a zero of all does.

        Those that pivoted Cholesky finds last at the start values. Who leaves them out must check
        that nothing is lost: it takes what is weak for open, too.
        """
        squares = self.linearised(self.first)[1].weighted(1.0 / self.std).normal()
        length = np.sqrt(np.where(squares.diagonal() > 0.0, squares.diagonal(), 1.0))
        _, pivots, rank, _ = lapack.dpstrf(squares / length / length[:, None], tol=FIRM**2)
        return np.sort(pivots[rank:] - 1) if rank else np.zeros(0, dtype=np.int64)

    @cached_property
    def name_of_row(self) -> Callable[[int], str]:
        """What makes the name of an observation: its groups, and which one of several it is.

        Names are made one by one, for those of very many observations cost seconds.
        """
        if callable(self.row_names):
            return self.row_names
        if self.row_names:
            return self.row_names.__getitem__
        if not self.groupings:
            return partial(phrase, "observation {0}")
        groupings, of_element = self.groupings, self.of_element
        groups = np.array([g.number[self.elements[:, 0]] for g in groupings])
        alike = np.unique(groups, axis=1, return_inverse=True)[1]
        seen, whole = (index_within_group(alike) + 1).tolist(), np.bincount(alike)[alike].tolist()

        def name(row: int) -> Phrase:
            k = int(of_element[row])
            each = zip(groupings, groups[:, k].tolist(), strict=True)
            plain = join_texts([g.name_of(number) for g, number in each if number >= 0], ", ")
            return phrase("{0} ({1} of {2})", plain, seen[k], whole[k]) if whole[k] > 1 else plain

        return name

    @property
    def names(self) -> list[str]:
        """What people call each observation."""
        return [self.name_of_row(row) for row in range(len(self.observed))]

    def linearised(self, x: Floats) -> tuple[Floats, Design]:
        """Return the computed observations (n,) and their design at ``x`` (p,)."""
        computed, found = self.equations(x)
        return computed, make_design(found, self._groups)

    @cached_property
    def _groups(self) -> Groups | None:
        """Into which groups the unknowns fall, which is asked once."""
        design = make_design(self.equations(self.first)[1])
        if not isinstance(design, SparseDesign):
            return None
        block = np.repeat(list(self.blocks), list(self.blocks.values()))
        return Groups.of(design.few, np.flatnonzero(np.isin(block, self.shared)))

    def at(self, unknowns: Floats) -> Model:
        """Return the model of exact observations, were these the ``unknowns`` (p,)."""
        return replace(self, observed=self.equations(unknowns)[0], start=unknowns)

    def with_prior(
        self, what: str, rows: Floats | csr_array, values: Floats, std: Floats | float
    ) -> Model:
        """Return the model with what is known beforehand, as from a certificate.

        ``rows`` (k, p) times the unknowns are ``values`` (k,), each with ``std``: observations
        that belong to no group, that no effect spoils and that are never left out, with noise of
        their own: one for each ``what`` they are, for people. As ``csr_array`` they fall into
        blocks with those before.
        """
        k, every = len(values), tuple(dict.fromkeys([*self.components, what]))
        # of this model no more is kept
        n, read, name_before, before = len(self.observed), self.equations, self.name_of_row, 0
        if what in self.components:
            before = int((self.of_component == every.index(what)).sum())

        def name(row: int) -> str:
            known = before + row - n
            return name_before(row) if row < n else phrase("value {0} of {1}", known, phrase(what))

        def equations(x: Floats) -> tuple[Floats, Derivatives]:
            computed, design = read(x)
            return np.append(computed, rows @ x), make_design(design).beside(rows)

        return replace(
            self,
            observed=np.append(self.observed, values),
            std=np.append(self.std, np.broadcast_to(std, k)),
            equations=equations,
            components=every,
            component=np.append(self.of_component, np.full(k, every.index(what))),
            judged=np.append(self.rejectable, np.zeros(k, dtype=np.bool_)),
            groupings=[g.with_others(k) for g in self.groupings],
            effects=[effect.beside(k) for effect in self.effects],
            expected=[e._replace(effect=e.effect.beside(k)) for e in self.expected],
            row_names=name,
            element=None if self.element is None else np.append(self.element, np.full(k, -1)),
            mixed=self.mixed
            if self.mixed is None
            else csr_array(block_diag([self.mixed, np.eye(k)])),
        )

    def scattering(
        self,
        what: str,
        rows: Floats | csr_array,
        size: float | None,
        largest: float,
        ways: Sequence[tuple[float, Floats]] = (),
        influence: float = 1.0,
    ) -> Model:
        """Return the model with what scatters by a ``size``; None: that is estimated.

        ``rows`` (k, p) times the unknowns are zero but for the scatter. ``ways``: probabilities
        and roots (k, r) of its covariance per unit of size; none: of each row by itself. Sizes
        are given as what a row scatters by the first of them, in the mean of squares.
        ``largest``: one that nobody would overlook. ``influence``: how many times as much outputs
        feel it, in their noise, as a mean contrast does.
        """
        n, likely = len(self.observed), np.array([share for share, _ in ways] or [1.0])
        k, unit = rows.shape[0], 1.0
        if ways:
            unit = float(np.sqrt((ways[0][1] ** 2).sum() / k))
        stated = None if size is None else size * unit
        known = self.with_prior(what, rows, np.zeros(k), stated or largest)
        parts = (tuple(root / unit for _, root in ways),)
        each = np.arange(n, n + k)
        scatter = Scattering(each, parts, what, likely / likely.sum(), stated, influence=influence)
        return replace(known, correlated=(*self.correlated, scatter))

    @property
    def scatterings(self) -> list[Scattering]:
        """What scatters by a size that is estimated, or may have to be."""
        return [each for each in self.correlated if isinstance(each, Scattering)]

    @cached_property
    def of_scatter(self) -> Bools:
        """Which components (c,) are a scatter: how large it is is no matter of the noise."""
        number = [self.of_component[each.rows[0]] for each in self.scatterings]
        return np.isin(np.arange(len(self.components)), number)

    def scattered(self, sizes: Sequence[float]) -> Model:
        """Return the model in which what scatters is weighed by such ``sizes``."""
        std = self.std.copy()
        for each, size in zip(self.scatterings, sizes, strict=True):
            std[each.rows] = size
        return replace(self, std=std)

    def with_unknowns(self, name: str, columns: Floats) -> Model:
        """Return the model in which ``columns`` (n, r) of errors have unknown sizes."""
        more, p = columns.shape[1], self.size[1]

        def wider(rows: Floats | Outputs) -> Floats:
            return np.pad(np.asarray(rows), ((0, 0), (0, more)))

        def equations(x: Floats) -> tuple[Floats, Derivatives]:
            computed, design = self.equations(x[:p])
            if isinstance(design, csr_array):
                design = csr_array(hstack([design, csr_array(columns)], format="csr"))
            else:
                design = np.hstack([dense(design), columns])
            return computed + columns @ x[p:], design

        return replace(
            self,
            blocks={**self.blocks, name: more},
            equations=equations,
            outputs=wider(self.outputs),
            further={key: wider(rows) for key, rows in self.further.items()},
            start=np.append(self.first, np.zeros(more)),
            definitions=None if self.definitions is None else wider(self.definitions),
        )

    def with_common_errors(self, errors: Floats) -> Model:
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

        def equations(x: Floats) -> tuple[Floats, Derivatives]:
            computed, design = self.equations(x)
            return changed(computed, 1.0 / root), changed(dense(design), 1.0 / root)

        return self.changed(
            equations, lambda of: changed(of, 1.0 / root), lambda of: changed(of, root), False
        )

    def with_blocks(self, covariance: Floats) -> Model:
        """Return the model of elements of c rows whose noise is correlated, made independent.

        ``covariance`` (m, c, c) of each element's. As in :meth:`with_common_errors` by the
        symmetric root, of the correlations: rows keep their ``std``, which are the roots of its
        diagonal.
        """
        std = np.sqrt(covariance.diagonal(axis1=1, axis2=2))  # (m, c)
        size, ways = np.linalg.eigh(covariance / std[:, :, None] / std[:, None])
        scale = std[:, :, None] / std[:, None]
        there, rows = self.elements >= 0, self.elements[self.elements >= 0]
        order = np.argsort(rows)

        def blocks(power: float) -> csr_array:
            each = scale * ((ways * size[:, None] ** power) @ ways.swapaxes(1, 2))
            whole = block_diag([b[np.ix_(t, t)] for b, t in zip(each, there, strict=True)])
            return csr_array(csr_array(whole)[order][:, order])

        to, back = blocks(-0.5), blocks(0.5)

        def equations(x: Floats) -> tuple[Floats, Derivatives]:
            computed, design = self.equations(x)
            return to @ computed, to @ (design if isinstance(design, csr_array) else dense(design))

        alone = replace(self, std=std[there][order], mixed=back)
        return alone.changed(equations, lambda of: np.asarray(to @ of), back.__matmul__, True)

    def changed(
        self,
        equations: Equations,
        to: Callable[[Floats], Floats],
        back: Callable[[Floats], Floats],
        apart: bool,
    ) -> Model:
        """Return the model of combinations ``to`` of its observations, which ``back`` takes back.

        Both take (n,) and (n, k). ``apart``: each observation is changed by itself.
        """
        effects = [e.mapped(to, back, apart=apart) for e in self.effects]
        expected = [
            e._replace(effect=e.effect.mapped(to, back, apart=apart)) for e in self.expected
        ]
        return replace(
            self,
            observed=to(self.observed),
            equations=equations,
            effects=effects,
            expected=expected,
        )

    def name_of(self, unknown: int) -> Phrase:
        """Return the name of an unknown for people: its block, its number there."""
        for name, count in self.blocks.items():
            if unknown < count:
                return phrase("{0} {1}", phrase(name), unknown) if count > 1 else phrase(name)
            unknown -= count
        raise DataError(f"the model has no unknown {unknown}")


@dataclass(frozen=True, eq=False)
class CurveModel:
    """A model, and what of its unknowns are deviations: rows (m, p) of each of the ``curves``.

    At the commanded ``angles`` (m,) rad; also those that the model has, but does not determine:
    the ``mixed`` ones, which other instruments may.
    """

    model: Model
    angles: Floats
    curves: Mapping[str, Floats]
    mixed: Collection[str] = ()


def members_by_group(grouping: Grouping, judged: Bools) -> dict[int, Ints]:
    """Return the judged observations of each group, by its number."""
    number = grouping.number
    order = np.argsort(number, kind="stable")
    order = order[judged[order]]
    every = np.unique(number[number >= 0])
    if not len(every):
        return {}
    ends = np.searchsorted(number[order], every, side="right")
    begin = int((number[order] < 0).sum())
    return dict(zip(every.tolist(), np.split(order[begin:], ends[:-1] - begin), strict=True))


def gathered_subsets(grouping: Grouping, members: Ints) -> list[Bools]:
    """Return which members (q, e) of groups (g, e) lie together; none where nothing says so."""
    found = [np.zeros((len(members), 0, members.shape[1]), dtype=np.bool_)]
    if grouping.along is not None:
        found.append(contiguous_runs(grouping.along[members], grouping.closed))
    if grouping.near is not None:
        found.append(neighbourhoods_of_each(grouping.near[members]))
    return distinct_of_each(np.concatenate(found, axis=1))
