"""Groups of components of one table: what the results of several measurements say of them.

What an input cannot know is free: its offset in every component, and in the pairs EXC, EYC and
EAC, EBC the part that turns with the table, as a shifted or tilted plate would. Curves are
combined at the angles at which any of them was measured.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Final, Literal, NamedTuple, get_args

import numpy as np

from rotcal_ros.evaluation.common_angles import same_angles
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.curves.interpolation import SAME_ANGLE, interpolation_matrix
from rotcal_ros.foundation.curves.measured import MeasuredCurve, covers_circle
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.language import Phrase, join_texts, noted, phrase
from rotcal_ros.foundation.units import DEGREE, TURN

FROM_ALONE: Final = noted("{0} alone: nothing checks that, its stated uncertainty rules")
FARTHEST: Final = noted("{0} is farthest off")
CONTRADICT: Final = noted(
    "{0}: the inputs contradict each other (chi-square {1:.4g} with {2} degrees of freedom, "
    "{3}): {4}"
)

Curves = Mapping[str, MeasuredCurve]
"""Curves of one input by component."""
Enlargement = Literal["birge", "mandel-paule", "none"]
ENLARGEMENTS: Final[tuple[Enlargement, ...]] = get_args(Enlargement)
PAIRS: Final = (("EXC", "EYC"), ("EAC", "EBC"))
"""Components in which a shifted or tilted plate turns together."""
GROUPS: Final = (PAIRS[0], ("EZC",), PAIRS[1], ("ECC",))
_IN_PHASE: Final = 1e-9
"""If the turning part is below this share of the curve, the method has removed it."""
OPEN: Final = 1e-9
"""A direction with a smaller part in a component does not touch that component."""
SHARED: Final = " + "
"""Between the names of inputs that share observations."""


@dataclass(frozen=True, slots=True)
class OpenOffset:
    """An offset of one component (m or rad) that ``input`` leaves open and ``others`` measured.

    ``name`` as in :class:`FreeDirection`; ``offset`` is how far the values of the input are off,
    with standard uncertainty ``std``; ``share`` is the most that it adds to the uncertainty of any
    value. ``others`` are those that determine it: what only one does, nothing checks.
    """

    component: str
    input: str
    name: str
    others: tuple[str, ...]
    offset: float
    std: float
    share: float

    def describe(self) -> Phrase:
        """Return where the offset comes from and what it costs, in one sentence."""
        unit, label = unit_of(self.component)
        others = phrase("{0}", ", ".join(self.others))
        if not self.checked:
            others = phrase(FROM_ALONE, *self.others)
        return phrase(
            "{0} of {1}: the offset between {2}, {3:+.3g} {4}, comes from {5}; it adds up to "
            "{6:.2g} {4} to U",
            self.component, self.input, phrase(self.name), self.offset / unit, label, others,
            COVERAGE_FACTOR * self.share / unit,
        )  # fmt: skip

    @property
    def checked(self) -> bool:
        """Whether more than one input determines it."""
        return len(self.others) > 1


@dataclass(frozen=True, eq=False)
class ComponentGroup:
    """Components that were combined together, with the outcome.

    ``joined`` holds the angles of each component, ``columns`` its place among the unknowns, of
    which ``value`` (n,) and ``spread`` (n, n) are the estimate and its covariance, before it is
    enlarged. ``members`` are names of inputs, of those that share observations together;
    ``shares`` (k, n) are the parts of each variance that come from them. ``chi2``, ``dof`` and
    ``p_value`` belong to the stated uncertainties, ``chi2_of_noise`` to the part of the
    observations alone, if known. ``factor`` multiplies the standard uncertainties (Birge),
    ``common_std`` was added to those of all values (Mandel and Paule), rad or m. ``farthest`` is
    the input that fits worst, ``differs`` what explains most of it. The estimate is known up to
    any multiple of the columns of ``open`` (n, q), besides what no method knows; ``links`` are
    offsets that one input leaves open and others measured.
    """

    members: tuple[tuple[str, ...], ...]
    joined: Mapping[str, JoinedAngles]
    columns: Mapping[str, slice]
    value: Floats
    spread: Floats
    shares: Floats
    chi2: float
    dof: int
    p_value: float
    consistent: bool
    chi2_of_noise: float
    open: Floats
    enlargement: Enlargement = "none"
    factor: float = 1.0
    common_std: float = 0.0
    farthest: str = ""
    differs: str = ""
    interpolated: tuple[str, ...] = ()
    links: tuple[OpenOffset, ...] = ()

    @property
    def name(self) -> str:
        """The components in words."""
        return ", ".join(self.joined)

    @property
    def weights(self) -> dict[str, float]:
        """Mean share of each input in the variance of the estimates, by its name; sum 1."""
        names = map(SHARED.join, self.members)
        return dict(zip(names, self.shares.mean(axis=1).tolist(), strict=True))

    def open_of(self, component: str) -> Floats:
        """Return the open directions (n, q) of one component; q = 0 if none touches it."""
        columns = self.open[self.columns[component]]
        return columns[:, np.max(np.abs(columns), axis=0, initial=0.0) > OPEN]

    def covariance(self, component: str) -> Floats:
        """Return the covariance (n, n) of one component, enlarged if necessary."""
        own = self.columns[component]
        return self.factor**2 * self.spread[own, own]

    def describe(self) -> Phrase:
        """Return in words that the inputs contradict each other, and what was done about it."""
        unit, label = unit_of(next(iter(self.joined)))
        done = {
            "birge": phrase("uncertainties enlarged by the factor {0:.3g} (Birge)", self.factor),
            "mandel-paule": phrase(
                "{0:.3g} {1} added to the standard uncertainty of every value (Mandel-Paule)",
                self.common_std / unit, label
            ),
            "none": phrase("uncertainties not enlarged"),
        }  # fmt: skip
        found = [phrase("p = {0:.2g}", self.p_value)]
        found += [phrase(FARTHEST, self.farthest)] if self.farthest else []
        found += [phrase(self.differs)] if self.differs else []
        return phrase(
            CONTRADICT, self.name, self.chi2, self.dof, join_texts(found), done[self.enlargement]
        )


def most_certain_inputs(inputs: Mapping[str, Curves]) -> list[str]:
    """Return the inputs that count: of evaluations of the same data the one that is surest.

    The same noise tells each of them how large it is, a little otherwise: as if they had more than
    one of it, they would gain. An evaluation stands for another that has no angle, no component
    and no joined zero beyond its own.
    """
    names = list(inputs)
    for first, second in permutations(inputs, 2):
        if first in names and second in names and _stands_for(inputs[first], inputs[second]):
            names.remove(second)
    return names


def _stands_for(surer: Curves, other: Curves) -> bool:
    """Whether ``surer`` evaluates what the ``other`` does, or part of it, more surely."""
    both = surer.keys() & other.keys()
    if both != other.keys():
        return False
    here = next(iter(both))
    mine, theirs = surer[here].raw_data, other[here].raw_data
    ours, _ = mine.common_observations(theirs)
    if not len(ours) or len(ours) < min(len(mine.hashes), len(theirs.hashes)):
        return False
    if any(
        not same_angles(other[c].angles, surer[c].angles, surer[c].period).any(axis=1).all()
        or set(surer[c].free_names) - set(other[c].free_names)
        for c in both
    ):
        return False
    # by the mean variances of the curves about their means
    first, second = (
        sum(np.mean(m.diagonal()) - np.mean(m) for m in (curves[c].covariance for c in both))
        for curves in (surer, other)
    )
    return bool(first <= second)


class GroupLayout(NamedTuple):
    """What the inputs of a group measured where.

    ``joined``: the angles of each component; ``columns``: its place among the n unknowns;
    ``between``: inputs that are read between their angles; ``common`` (n, g): what no method
    knows.
    """

    joined: dict[str, JoinedAngles]
    columns: dict[str, slice]
    between: tuple[str, ...]
    common: Floats


def lay_out_group(components: Sequence[str], inputs: Mapping[str, Curves]) -> GroupLayout:
    """Return the unknowns of ``components``; DataError for angles that cannot be joined."""
    joined = {
        c: join_angles({name: curves[c] for name, curves in inputs.items() if c in curves})
        for c in components
    }
    columns, start = {}, 0
    for c, own in joined.items():
        columns[c] = slice(start, start := start + len(own.angles))
    between = tuple(name for own in joined.values() for name in own.between)
    common = gauge_basis({c: own.angles for c, own in joined.items()})
    return GroupLayout(joined, columns, between, common)


def find_open_offsets(
    group: ComponentGroup, inputs: Mapping[str, Curves], parts: Mapping[str, ObservedCurves]
) -> Iterator[OpenOffset]:
    """Yield offsets of single components that the group knows and one input leaves open."""
    for (name, curves), part in zip(inputs.items(), parts.values(), strict=True):
        end = 0
        for c, rows in part.rows.items():
            place, end = slice(end, end + len(rows)), end + len(rows)
            others = tuple(n for n in inputs if n != name and c in inputs[n])
            if group.open_of(c).shape[1] or not others:
                continue
            for way, word in zip(curves[c].free_columns.T, curves[c].free_names, strict=True):
                if not word or not np.ptp(way[rows]):
                    continue
                centred = way[rows] - way[rows].mean()
                contrast = np.zeros(len(part.values))
                contrast[place] = centred / (centred @ centred)
                seen = contrast @ part.design
                std = group.factor * max(float(seen @ group.spread @ seen), 0.0) ** 0.5
                along = part.design[place].T @ way[rows]
                shown = {n: np.linalg.norm(parts[n].observable(along)) for n in others}
                telling = (n for n in others if shown[n] > OPEN * np.linalg.norm(along))
                if curves[c].free_names.count(word) > 1:  # with the first angle that it moves
                    first = curves[c].angles[rows][way[rows] > 0.5 * way[rows].max()][0] / DEGREE
                    word = phrase(
                        "{0}, that with {1:.6g} deg against the others", phrase(word), first
                    )
                yield OpenOffset(
                    component=c,
                    input=name,
                    name=word,
                    others=tuple(telling) or others,
                    offset=float(contrast @ part.values - seen @ group.value),
                    std=std,
                    share=std * float(np.max(np.abs(centred))),
                )


@dataclass(frozen=True, eq=False)
class ObservedCurves:
    """What one input says of the n unknowns of a group: ``values`` (m,), in rad or m.

    ``design`` (m, n) selects or interpolates the curve at the unknowns, ``free`` (m, q) holds what
    the input cannot know, such as its offset: its first ``known`` columns are what no input of
    this kind knows, the others this one leaves open. ``rows`` are the values of each curve that
    went into it; ``grow`` the matrix that undoes what the method took off their errors.
    """

    values: Floats
    design: Floats
    free: Floats
    known: int
    rows: Mapping[str, Ints]
    grow: Mapping[str, Floats]

    def observable(self, ways: Floats) -> Floats:
        """Return what its values show (m, k) of ``ways`` (n, k) in which curves may go."""
        seen = self.design @ ways
        return np.asarray(seen - self.free @ (self.free.T @ seen))


def curves_of_input(
    name: str, inputs: Mapping[str, Curves], layout: GroupLayout
) -> ObservedCurves:
    """Return what one input says about the unknowns of a group."""
    joined, columns, _, common = layout
    own = {c: inputs[name][c] for c in joined if c in inputs[name]}
    rows = {c: joined[c].rows[name] for c in own}
    designs = []
    for c in own:
        designs.append(np.zeros((len(rows[c]), len(common))))
        designs[-1][:, columns[c]] = joined[c].designs[name]
    angles = {c: curve.angles[rows[c]] for c, curve in own.items()}
    values = {c: curve.deviation[rows[c]] for c, curve in own.items()}
    # Columns of the same number are one direction in both of a pair.
    open_zeros = np.concatenate([curve.free_columns[rows[c]] for c, curve in own.items()])
    known = gauge_basis(angles)
    return ObservedCurves(
        values=np.concatenate(list(values.values())),
        design=np.concatenate(designs),
        free=orthonormal_basis(np.hstack([known, open_zeros])),
        known=known.shape[1],
        rows=rows,
        grow=_turning(angles, values),
    )


def gauge_basis(angles: Mapping[str, Floats]) -> Floats:
    """Return an orthonormal basis (m, q) of what no method knows, at ``angles`` by component.

    An offset of every component and, for a pair or one of it, a plate that is shifted or tilted:
    a cos t - b sin t in the first, a sin t + b cos t in the second component.
    """
    columns = [_stacked(angles, lambda t, c, own=own: np.full(len(t), c == own)) for own in angles]
    seconds = [second for _, second in PAIRS]
    if any(c in pair for pair in PAIRS for c in angles):
        columns.append(_stacked(angles, lambda t, c: np.sin(t) if c in seconds else np.cos(t)))
        columns.append(_stacked(angles, lambda t, c: np.cos(t) if c in seconds else -np.sin(t)))
    return orthonormal_basis(np.column_stack(columns))


def orthonormal_basis(columns: Floats) -> Floats:
    """Return an orthonormal basis (m, q) of the span of ``columns`` (m, k) of about unit size."""
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(u[:, s > 1e-9 * max(np.max(s, initial=0.0), 1.0)], dtype=np.float64)


def _stacked(angles: Mapping[str, Floats], of: Callable[..., Floats]) -> Floats:
    return np.concatenate([of(t, c) for c, t in angles.items()]).astype(np.float64)


def _turning(angles: Mapping[str, Floats], values: Mapping[str, Floats]) -> dict[str, Floats]:
    """Return by component the factor on errors that undoes the removal of a turning part.

    A result holds no covariance between components. If a method has removed the part of a pair
    that turns with the table, the first harmonics of each component alone show only the remaining
    half of their variance: the part that turns the other way has kept all of it. Doubling restores
    that; the part that turns with the table is free and not affected.
    """
    alone = {c: np.eye(len(own)) for c, own in values.items()}
    if len(values) < 2:
        return alone
    first, second = angles.values()
    x, y = values.values()
    if len(first) != len(second) or np.max(np.abs(first - second)) > _IN_PHASE:
        return alone
    pair = x - x.mean() + 1j * (y - y.mean())
    if abs(np.mean(pair * np.exp(-1j * first))) > _IN_PHASE * np.max(np.abs(pair)):
        return alone
    basis = np.column_stack([np.ones_like(first), np.cos(first), np.sin(first)])
    # The first column is the constant, which stays as it is.
    harmonic = np.linalg.qr(basis)[0][:, 1:]
    grow = np.eye(len(first)) + (np.sqrt(2.0) - 1.0) * harmonic @ harmonic.T
    return dict.fromkeys(values, grow)


SAME: Final = 1e3 * SAME_ANGLE
"""rad; angles of two curves that are closer than this count as common, as in a comparison."""
LINKING: Final = 2
"""Least common angles that join two curves; with a single one a shift would not show."""


@dataclass(frozen=True, eq=False)
class JoinedAngles:
    """The angles (n,) rad of a combined curve, ascending, and how each input sees the curve.

    ``designs`` holds for every input the matrix (m, n) and ``rows`` which of its values (m,) are
    used. Inputs with too few angles in common are read ``between`` them.
    """

    angles: Floats
    period: float
    designs: Mapping[str, Floats]
    rows: Mapping[str, Ints]
    between: tuple[str, ...]


def join_angles(curves: Mapping[str, MeasuredCurve]) -> JoinedAngles:
    """Return the union of the angles of all curves that are joined by common ones.

    Curves that share fewer than two angles with the rest are compared with it by interpolation,
    as :func:`~rotcal_ros.evaluation.compare.compare` does, and add no angles of their own. The
    order of the curves does not matter.
    """
    turn = any(curve.period for curve in curves.values())
    at = [np.mod(curve.angles, TURN) if turn else curve.angles for curve in curves.values()]
    nodes, places = _merged(at, turn)
    linked = _linked([set(place.tolist()) for place in places])
    # Of groups of equal size the one that begins first: the order of the inputs says nothing.
    main = min(linked, key=lambda group: (-len(group), sorted(group)))
    chosen = np.array(sorted(main))
    angles = nodes[chosen]
    period = TURN if turn or covers_circle(angles) else 0.0
    designs, rows, between = {}, {}, list[str]()
    for name, place, own in zip(curves, places, at, strict=True):
        if main.issuperset(place.tolist()):
            rows[name] = np.arange(len(own))
            designs[name] = (place[:, None] == chosen).astype(np.float64)
            continue
        between.append(name)
        ahead, behind = own - angles[0] + SAME_ANGLE, angles[-1] - own + SAME_ANGLE
        rows[name] = np.flatnonzero((np.minimum(ahead, behind) >= 0.0) | (period > 0.0))
        if len(rows[name]) < LINKING and not period:
            raise DataError(
                f"the curves share {len(rows[name])} angles: the others cover only "
                f"{angles[0] / DEGREE:.6g} .. {angles[-1] / DEGREE:.6g} deg; give results of "
                "the same arc"
            )
        designs[name] = interpolation_matrix(angles, own[rows[name]], period)
    return JoinedAngles(angles, period, designs, rows, tuple(between))


def union_of_angles(angles: Sequence[Floats], turn: bool) -> Floats:
    """Return all ``angles`` once, ascending, wrapped into one turn when they go round."""
    return _merged([np.mod(a, TURN) if turn else a for a in angles], turn)[0]


def _merged(at: Sequence[Floats], turn: bool) -> tuple[Floats, list[Ints]]:
    """Return the distinct angles, and for every curve which of them are its own."""
    every = np.concatenate(at)
    if turn:
        every = np.where(TURN - every < SAME, every - TURN, every)
    order = np.argsort(every, kind="stable")
    new = np.append(True, np.diff(every[order]) > SAME)
    index = np.empty(len(every), dtype=np.int64)
    index[order] = np.cumsum(new) - 1
    nodes = every[order][new]
    nodes[np.abs(nodes) < SAME] = 0.0
    return nodes, np.split(index, np.cumsum([len(a) for a in at])[:-1])


def _linked(groups: list[set[int]]) -> list[set[int]]:
    """Merge groups that share enough angles until none do; return their unions."""
    for i, first in enumerate(groups):
        for second in groups[i + 1 :]:
            if len(first & second) >= LINKING:
                rest = [g for g in groups if g is not first and g is not second]
                return _linked([*rest, first | second])
    return groups
