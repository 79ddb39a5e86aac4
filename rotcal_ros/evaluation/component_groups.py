"""Combines groups of components, judges their consistency, and acts if it is lacking.

What an input cannot know is free: its offset in every component, and in the pairs EXC, EYC and
EAC, EBC the part that turns with the table, as a shifted or tilted plate would. Curves are
combined at the angles at which any of them was measured.

Model of input k: values_k = design_k @ curve + free_k @ unknowns_k + noise_k with a full
covariance, solved by generalised least squares. What all inputs leave open together is taken from
the estimate, which is therefore the one of smallest norm, and so is its covariance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations, product
from typing import Final, Literal, NamedTuple, get_args

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import brentq

from rotcal_ros.adjust.distributions import chi2_sf
from rotcal_ros.evaluation.common_angles import (
    floor,
    of_observations_alone,
    same_angles,
    shared_covariance,
)
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.curves.interpolation import SAME_ANGLE, interpolation_matrix
from rotcal_ros.foundation.curves.measured import MeasuredCurve, covers_circle
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.units import DEGREE, TURN

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


@dataclass(frozen=True, slots=True)
class Link:
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

    def in_words(self) -> str:
        """Return where the offset comes from and what it costs, in one sentence."""
        unit, label = unit_of(self.component)
        alone = "" if self.checked else " alone: nothing checks that, its stated uncertainty rules"
        return (
            f"{self.component} of {self.input}: the offset between {self.name}, "
            f"{self.offset / unit:+.3g} {label}, comes from {', '.join(self.others)}{alone}; it "
            f"adds up to {COVERAGE_FACTOR * self.share / unit:.2g} {label} to U"
        )

    @property
    def checked(self) -> bool:
        """Whether more than one input determines it."""
        return len(self.others) > 1


@dataclass(frozen=True, eq=False)
class ComponentGroup:
    """Components that were combined together, with the outcome.

    ``joined`` holds the angles of each component, ``columns`` its place among the unknowns.
    ``inputs`` are names; the ``members`` that share observations are joined by " + ". ``chi2``,
    ``dof`` and ``p_value`` belong to the stated uncertainties, ``chi2_of_noise`` to the part of
    the observations alone, if known. ``factor`` multiplies the standard uncertainties (Birge),
    ``common_std`` was added to those of all values (Mandel and Paule), rad or m. ``farthest`` is
    the input that fits worst. The estimate is known up to any multiple of the columns of ``open``
    (unknowns, q), besides what no method knows; ``links`` are offsets that one input leaves open
    and others measured.
    """

    inputs: tuple[str, ...]
    members: tuple[tuple[str, ...], ...]
    joined: Mapping[str, Joined]
    columns: Mapping[str, slice]
    pooled: Pooled
    chi2: float
    dof: int
    p_value: float
    consistent: bool
    chi2_of_noise: float
    enlargement: Enlargement = "none"
    factor: float = 1.0
    common_std: float = 0.0
    farthest: str = ""

    interpolated: tuple[str, ...] = ()
    open: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    links: tuple[Link, ...] = ()

    @property
    def name(self) -> str:
        """The components in words."""
        return ", ".join(self.joined)

    @property
    def weights(self) -> dict[str, float]:
        """Mean share of each input in the variance of the estimates, by its name; sum 1."""
        parts = self.pooled.variance_parts.mean(axis=1)
        return dict(zip(self.inputs, parts.tolist(), strict=True))

    def open_of(self, component: str) -> Floats:
        """Return the open directions (n, q) of one component; q = 0 if none touches it."""
        columns = self.open[self.columns[component]]
        return columns[:, np.max(np.abs(columns), axis=0, initial=0.0) > OPEN]

    def values(self, component: str) -> Floats:
        """Return the estimate (n,) of one component, m or rad."""
        return self.pooled.values[self.columns[component]]

    def covariance(self, component: str) -> Floats:
        """Return the covariance (n, n) of one component, enlarged if necessary."""
        own = self.columns[component]
        return self.factor**2 * self.pooled.covariance[own, own]

    def in_words(self) -> str:
        """Return in words that the inputs contradict each other, and what was done about it."""
        unit, label = unit_of(next(iter(self.joined)))
        done = {
            "birge": f"uncertainties enlarged by the factor {self.factor:.3g} (Birge)",
            "mandel-paule": f"{self.common_std / unit:.3g} {label} added to the standard "
            "uncertainty of every value (Mandel-Paule)",
            "none": "uncertainties not enlarged",
        }
        off = f"; {self.farthest} is farthest off" if self.farthest else ""
        return (
            f"{self.name}: the inputs contradict each other (chi-square {self.chi2:.4g} with "
            f"{self.dof} degrees of freedom, p = {self.p_value:.2g}{off}): "
            f"{done[self.enlargement]}"
        )


def combine_group(
    components: Sequence[str], inputs: Mapping[str, Curves], enlarge: Enlargement, level: float
) -> ComponentGroup:
    """Combine ``components`` of all ``inputs`` (by name), each of which has at least one.

    They are consistent if chance gives a larger chi-square more often than ``level``; if not,
    the uncertainties are enlarged. Raises DataError for inputs that cannot be joined.
    """
    layout = laid_out(components, inputs)
    joined, columns, between, common = layout

    def weighed_with(curves: Mapping[str, Curves]) -> _Weighed:
        seen = {name: part_of(name, {**inputs, **curves}, layout) for name in curves}
        far = [name in between for name in curves]
        parts, left = _with_open([own.part for own in seen.values()], common, far)
        return _Weighed(parts, left, *_clustered(seen, parts, curves))

    parts, left, members, weighed = weighed_with(inputs)
    gauge = np.hstack([common, left])
    try:
        pooled = pool(weighed, gauge)
        bare = weighed_with(_of_observations_alone(inputs, members))
        chi2_of_noise = pool(bare.weighed, gauge).chi2
    except DataError as error:
        raise DataError(f"{', '.join(components)} of {', '.join(inputs)}: {error}") from error
    p_value = chi2_sf(pooled.chi2, pooled.dof) if pooled.dof else 1.0
    group = ComponentGroup(
        inputs=tuple(" + ".join(names) for names in members),
        members=members,
        joined=joined,
        columns=columns,
        pooled=pooled,
        chi2=pooled.chi2,
        dof=pooled.dof,
        p_value=p_value,
        consistent=p_value >= level,
        chi2_of_noise=chi2_of_noise,
        interpolated=between,
        open=left,
    )
    counting = weighed_with({name: inputs[name] for name in _telling(inputs)})

    def counted(extra: float = 0.0) -> ComponentGroup:
        wider = pool(widened(counting.weighed, extra**2), gauge)
        return _told_by(group, wider, counting.members)

    if len(counting.parts) < len(inputs):
        group = counted()
    if not group.consistent:
        group = _enlarged(group, weighed, gauge, enlarge, counted)
    return replace(group, links=tuple(links_of(group, inputs, parts)))


def _telling(inputs: Mapping[str, Curves]) -> list[str]:
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
    ours, _ = mine.shared_with(theirs)
    if not len(ours) or len(ours) < min(len(mine.hashes), len(theirs.hashes)):
        return False
    if any(
        not same_angles(other[c].angles, surer[c].angles, surer[c].period).any(axis=1).all()
        or set(surer[c].free_names) - set(other[c].free_names)
        for c in both
    ):
        return False
    first, second = (sum(_scatter(curves[c]) for c in both) for curves in (surer, other))
    return first <= second


def _scatter(curve: MeasuredCurve) -> float:
    """Return the mean variance of a curve about its mean."""
    matrix = curve.covariance
    return float(np.mean(matrix.diagonal()) - np.mean(matrix))


def _told_by(
    group: ComponentGroup, pooled: Pooled, members: Sequence[Sequence[str]]
) -> ComponentGroup:
    """Return a group with the estimate of some of its inputs; how all agree stays as it is."""
    parts = np.zeros((len(group.members), len(pooled.values)))
    for names, own in zip(members, pooled.variance_parts, strict=True):
        parts[next(k for k, every in enumerate(group.members) if names[0] in every)] += own
    return replace(
        group,
        pooled=replace(pooled, variance_parts=parts, chi2=group.pooled.chi2, dof=group.pooled.dof),
    )


class GroupLayout(NamedTuple):
    """What the inputs of a group measured where.

    ``joined``: the angles of each component; ``columns``: its place among the n unknowns;
    ``between``: inputs that are read between their angles; ``common`` (n, g): what no method
    knows.
    """

    joined: dict[str, Joined]
    columns: dict[str, slice]
    between: tuple[str, ...]
    common: Floats


def laid_out(components: Sequence[str], inputs: Mapping[str, Curves]) -> GroupLayout:
    """Return the unknowns of ``components``; DataError for angles that cannot be joined."""
    joined = {c: join_angles([inputs[name][c] for name in _with(c, inputs)]) for c in components}
    columns, start = {}, 0
    for c in components:
        columns[c] = slice(start, start + len(joined[c].angles))
        start = columns[c].stop
    between = tuple(
        name
        for c in components
        for name, far in zip(_with(c, inputs), joined[c].interpolated, strict=True)
        if far
    )
    return GroupLayout(
        joined, columns, between, unknown({c: joined[c].angles for c in components})
    )


class _Weighed(NamedTuple):
    """The parts of all inputs, what they leave open, and how they are weighted, by members."""

    parts: list[ComponentInput]
    left: Floats
    members: tuple[tuple[str, ...], ...]
    weighed: list[ComponentInput]


def _of_observations_alone(
    inputs: Mapping[str, Curves], members: Sequence[Sequence[str]]
) -> dict[str, Curves]:
    """Return the inputs; those that share nothing have the covariance of their observations."""
    single = {names[0] for names in members if len(names) == 1}
    return {
        name: {c: of_observations_alone(own) for c, own in curves.items()}
        if name in single
        else curves
        for name, curves in inputs.items()
    }


def _with_open(
    parts: Sequence[ComponentInput], common: Floats, between: Sequence[bool]
) -> tuple[list[ComponentInput], Floats]:
    """Return the parts, and an orthonormal basis (m, q) of what they leave open together.

    ``common`` (m, g) is not part of it. Values read ``between`` the angles of a curve join no
    zeros: a line through values with several zeros follows them up and down.
    """
    if all(part.free.shape[1] == part.known for part in parts):
        return list(parts), np.zeros((len(common), 0))
    seen = [
        part.design - part.free @ (part.free.T @ part.design)
        for part, far in zip(parts, between, strict=True)
        if not far
    ]
    _, s, vt = np.linalg.svd(np.concatenate([*seen, np.zeros_like(common @ common.T)]))
    null = vt[s <= 1e-9 * max(s[0], 1.0)].T
    left = _orthonormal(null - common @ (common.T @ null))
    return [
        replace(part, free=_orthonormal(np.hstack([part.free, part.design @ left])))
        if far
        else part
        for part, far in zip(parts, between, strict=True)
    ], left


def links_of(
    group: ComponentGroup, inputs: Mapping[str, Curves], parts: Sequence[ComponentInput]
) -> Iterator[Link]:
    """Yield offsets of single components that the group knows and one input leaves open."""
    for (name, curves), part in zip(inputs.items(), parts, strict=True):
        start = 0
        own = [c for c in group.joined if c in curves]
        for c in own:
            rows = group.joined[c].rows[_with(c, inputs).index(name)]
            place, start = slice(start, start + len(rows)), start + len(rows)
            others = tuple(n for n in inputs if n != name and c in inputs[n])
            if group.open_of(c).shape[1] or not others:
                continue
            for column, word in zip(curves[c].free_columns.T, curves[c].free_names, strict=True):
                if word and np.ptp(column[rows]):
                    which = _which(word, column[rows], curves[c], rows)
                    way = part.design[place].T @ column[rows]
                    seen = dict(zip(inputs, parts, strict=True))
                    which_ones = tuple(n for n in others if seen[n].determines(way)) or others
                    yield _link(group, part, place, column[rows], (c, name, which, which_ones))


def _which(word: str, column: Floats, curve: MeasuredCurve, rows: Ints) -> str:
    """Return the name of an offset; if several have it, with the first angle that it moves."""
    if curve.free_names.count(word) < 2:
        return word
    first = curve.angles[rows][column > 0.5 * column.max()][0] / DEGREE
    return f"{word}, that with {first:.6g} deg against the others"


def _link(
    group: ComponentGroup,
    part: ComponentInput,
    place: slice,
    column: Floats,
    words: tuple[str, str, str, tuple[str, ...]],
) -> Link:
    """Return one link: the offset along ``column`` (k,) of the rows at ``place`` of a part."""
    centred = column - column.mean()
    contrast = np.zeros(len(part.values))
    contrast[place] = centred / (centred @ centred)
    seen = contrast @ part.design
    variance = float(seen @ group.pooled.covariance @ seen)
    std = group.factor * max(variance, 0.0) ** 0.5
    return Link(
        *words,
        offset=float(contrast @ part.values - seen @ group.pooled.values),
        std=std,
        share=std * float(np.max(np.abs(centred))),
    )


def _enlarged(
    group: ComponentGroup,
    parts: Sequence[ComponentInput],
    gauge: Floats,
    enlarge: Enlargement,
    counted: Callable[[float], ComponentGroup],
) -> ComponentGroup:
    """Return a group with larger uncertainties, because its inputs contradict each other.

    ``counted``: the group where every value has so much more of a standard uncertainty.
    """
    if len(parts) > 2:
        group = replace(group, farthest=group.inputs[farthest(parts, gauge)])
    if enlarge == "birge":
        factor = float(np.sqrt(group.chi2 / group.dof))
        return replace(group, enlargement=enlarge, factor=factor)
    if enlarge == "mandel-paule":
        extra = common_std(parts, gauge)
        wider = counted(extra).pooled
        return replace(group, enlargement=enlarge, common_std=extra, pooled=wider)
    return group


def _with(component: str, inputs: Mapping[str, Curves]) -> list[str]:
    """Return the names of the inputs that measured a component."""
    return [name for name, curves in inputs.items() if component in curves]


@dataclass(frozen=True, eq=False)
class SeenCurves:
    """One input as a ``part``, and how its curves went into it, by component.

    ``rows``: the values of the curve; ``grow``: the matrix they are multiplied by; ``place``:
    their first index.
    """

    part: ComponentInput
    rows: Mapping[str, Ints]
    grow: Mapping[str, Floats]
    place: Mapping[str, int]


def part_of(name: str, inputs: Mapping[str, Curves], layout: GroupLayout) -> SeenCurves:
    """Return what one input says about the unknowns of a group."""
    joined, columns, _, _ = layout
    own = {c: inputs[name][c] for c in joined if c in inputs[name]}
    width = max(column.stop for column in columns.values())
    angles: dict[str, Floats] = {}
    values: dict[str, Floats] = {}
    rows, place, designs = {}, {}, []
    for c, curve in own.items():
        number = _with(c, inputs).index(name)
        rows[c], place[c] = joined[c].rows[number], sum(len(v) for v in values.values())
        design = np.zeros((len(rows[c]), width))
        design[:, columns[c]] = joined[c].designs[number]
        designs.append(design)
        angles[c], values[c] = curve.angles[rows[c]], curve.deviation[rows[c]]
    # Columns of the same number are one direction in both of a pair.
    open_zeros = np.concatenate([curve.free_columns[rows[c]] for c, curve in own.items()])
    grow = _turning(angles, values)
    covariances = {
        c: grow[c] @ curve.covariance[np.ix_(rows[c], rows[c])] @ grow[c]
        for c, curve in own.items()
    }
    part = ComponentInput(
        values=np.concatenate(list(values.values())),
        covariance=block_diag(*covariances.values()),
        design=np.concatenate(designs),
        free=_orthonormal(np.hstack([(common := unknown(angles)), open_zeros])),
        known=common.shape[1],
    )
    return SeenCurves(part, rows, grow, place)


def _clustered(
    seen: Mapping[str, SeenCurves], parts: Sequence[ComponentInput], inputs: Mapping[str, Curves]
) -> tuple[tuple[tuple[str, ...], ...], list[ComponentInput]]:
    """Return the names of each part; inputs that share observations are one part together.

    ``parts`` are those of the inputs, in their order, as weighted.
    """
    names = list(inputs)
    mine = {n: replace(seen[n], part=part) for n, part in zip(names, parts, strict=True)}
    clusters: list[list[str]] = []
    shared: dict[tuple[str, str], dict[str, Floats]] = {}
    for k, name in enumerate(names):
        for other in names[:k]:
            if found := _shared(name, other, inputs):
                shared[name, other] = found
        linked = [c for c in clusters if any((name, other) in shared for other in c)]
        clusters = [c for c in clusters if c not in linked]
        clusters.append([*(other for c in linked for other in c), name])
    return (
        tuple(map(tuple, clusters)),
        [_together([mine[name] for name in c], c, shared) for c in clusters],
    )


def _shared(first: str, second: str, inputs: Mapping[str, Curves]) -> dict[str, Floats]:
    """Return by component the covariance of two inputs; empty if they share nothing."""
    ours, theirs = inputs[first], inputs[second]
    found = {
        c: shared_covariance(ours[c], theirs[c], (first, second)) for c in ours if c in theirs
    }
    return {c: matrix for c, matrix in found.items() if matrix is not None}


def _together(
    seen: Sequence[SeenCurves],
    names: Sequence[str],
    shared: Mapping[tuple[str, str], Mapping[str, Floats]],
) -> ComponentInput:
    """Return the parts of one cluster as one, with the covariance of its members."""
    if len(seen) == 1:
        return seen[0].part
    ends = np.cumsum([0, *(len(own.part.values) for own in seen)])
    covariance = block_diag(*(own.part.covariance for own in seen))
    for (i, first), (j, second) in product(enumerate(names), repeat=2):
        for c, matrix in shared.get((first, second), {}).items():
            if c not in seen[i].rows or c not in seen[j].rows:
                continue
            mine, other = seen[i], seen[j]
            block = mine.grow[c] @ matrix[np.ix_(mine.rows[c], other.rows[c])] @ other.grow[c].T
            at, to = ends[i] + mine.place[c], ends[j] + other.place[c]
            covariance[at : at + len(block), to : to + block.shape[1]] = block
            covariance[to : to + block.shape[1], at : at + len(block)] = block.T
    mean = float(np.mean(covariance.diagonal()))
    rounded = np.clip(-np.linalg.eigvalsh(covariance)[0], 0.0, ROUNDED * mean)
    return ComponentInput(
        values=np.concatenate([own.part.values for own in seen]),
        covariance=covariance + floor(covariance) + rounded * np.eye(len(covariance)),
        design=np.concatenate([own.part.design for own in seen]),
        free=block_diag(*(own.part.free for own in seen)),
    )


def unknown(angles: Mapping[str, Floats]) -> Floats:
    """Return an orthonormal basis (m, q) of what no method knows, at ``angles`` by component.

    An offset of every component and, for a pair or one of it, a plate that is shifted or tilted:
    a cos t - b sin t in the first, a sin t + b cos t in the second component.
    """
    columns = [_stacked(angles, lambda t, c, own=own: np.full(len(t), c == own)) for own in angles]
    seconds = [second for _, second in PAIRS]
    if any(c in pair for pair in PAIRS for c in angles):
        columns.append(_stacked(angles, lambda t, c: np.sin(t) if c in seconds else np.cos(t)))
        columns.append(_stacked(angles, lambda t, c: np.cos(t) if c in seconds else -np.sin(t)))
    return _orthonormal(np.column_stack(columns))


def _orthonormal(columns: Floats) -> Floats:
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


WEAK: Final = 1e-9
"""Directions with a singular value below this share of the largest are not determined."""
ROUNDED: Final = 1e-6
"""Variance, in mean variances, by which influences that a file rounds may miss a covariance."""
FLOOR: Final = 1e-12
"""Smallest variance of any direction, in mean variances; keeps exact combinations finite."""


@dataclass(frozen=True, eq=False)
class ComponentInput:
    """One input: ``values`` (m,) with ``covariance`` (m, m), in rad or m.

    ``design`` (m, n) selects or interpolates the curve at the n unknowns, ``free`` (m, q) holds
    what the input cannot know, such as its offset. Its first ``known`` columns are what no input
    of this kind knows; the others this input leaves open.
    """

    values: Floats
    covariance: Floats
    design: Floats
    free: Floats
    known: int = 0

    def determines(self, way: Floats) -> bool:
        """Whether its values show how far the curve goes one ``way`` (n,)."""
        seen = self.design @ way
        left = seen - self.free @ (self.free.T @ seen)
        return bool(np.linalg.norm(left) > WEAK * np.linalg.norm(way))


@dataclass(frozen=True, eq=False)
class Pooled:
    """The estimate (n,) with ``covariance`` (n, n), both without the unknown offsets.

    ``variance_parts`` (k, n) are the parts of each variance that come from each input; they sum to
    one. ``chi2`` has ``dof`` degrees of freedom.
    """

    values: Floats
    covariance: Floats
    variance_parts: Floats
    chi2: float
    dof: int


def pool(parts: Sequence[ComponentInput], gauge: Floats) -> Pooled:
    """Return the best estimate of all ``parts``; ``gauge`` (n, g) is what none of them knows.

    Every part is whitened by the root of its covariance and freed from its own unknowns by an
    orthogonal projection; the rest is solved by singular values. Raises DataError when more than
    the gauge stays undetermined.
    """
    white = [_whitened(part) for part in parts]
    design = np.concatenate([w.design for w in white])
    values = np.concatenate([w.values for w in white])
    u, s, vt = np.linalg.svd(design, full_matrices=False)
    rank = int(np.sum(s > WEAK * s[0]))
    if rank != design.shape[1] - gauge.shape[1]:
        raise DataError(
            "the inputs share too few angles to be joined: measure at two common angles or more"
        )
    u, root = u[:, :rank], vt[:rank].T / s[:rank]
    estimate = root @ (u.T @ values)
    covariance = root @ root.T
    rest = values - design @ estimate
    ends = np.cumsum([len(w.values) for w in white])
    variances = np.maximum(np.diag(covariance), np.finfo(np.float64).tiny)
    gains = np.split(u @ root.T, ends[:-1])
    return Pooled(
        values=estimate,
        covariance=covariance,
        variance_parts=np.array([np.sum(gain**2, axis=0) for gain in gains]) / variances,
        chi2=float(rest @ rest),
        dof=sum(len(p.values) - p.free.shape[1] for p in parts) - rank,
    )


def common_std(parts: Sequence[ComponentInput], gauge: Floats) -> float:
    """Return the standard deviation that, added to every value, makes chi-square equal to dof.

    This is Mandel and Paule's between-laboratory component, here for every single value. Zero when
    chi-square is not above its expectation.
    """

    def excess(variance: float) -> float:
        pooled = pool(widened(parts, variance), gauge)
        return pooled.chi2 - pooled.dof

    if excess(0.0) <= 0.0:
        return 0.0
    high = max(float(np.mean(np.diag(part.covariance))) for part in parts)
    while excess(high) > 0.0:
        high *= 4.0
    return float(np.sqrt(brentq(excess, 0.0, high, xtol=1e-6 * high, rtol=1e-9)))


def widened(parts: Sequence[ComponentInput], variance: float) -> list[ComponentInput]:
    """Return the parts with an independent ``variance`` added to every value."""
    return [
        replace(part, covariance=part.covariance + variance * np.eye(len(part.values)))
        for part in parts
    ]


def farthest(parts: Sequence[ComponentInput], gauge: Floats) -> int:
    """Return the part whose omission lowers chi-square most."""
    without = []
    for k, part in enumerate(parts):
        # Not left out but made worthless: angles that it alone measured stay determined.
        loose = replace(part, covariance=1e6 * part.covariance)
        without.append(pool([*parts[:k], loose, *parts[k + 1 :]], gauge).chi2)
    return int(np.argmin(without))


def _whitened(part: ComponentInput) -> ComponentInput:
    """Return the part with unit covariance, and orthogonal to its own unknowns.

    A large variance along the unknowns changes nothing else, but makes singular covariances
    regular: those of curves that are exactly zero at their first angle or in their mean.
    """
    m = len(part.values)
    scale = float(np.trace(part.covariance)) / m
    regular = part.covariance / scale + part.free @ part.free.T + FLOOR * np.eye(m)
    try:
        root = np.linalg.cholesky(regular) * np.sqrt(scale)
    except np.linalg.LinAlgError as error:
        raise DataError(
            "the covariance of the deviations is not positive semi-definite: the result is "
            "damaged, solve again"
        ) from error
    columns = np.column_stack([part.design, part.values])
    white = np.linalg.solve(root, columns)
    q, _ = np.linalg.qr(np.linalg.solve(root, part.free))
    white -= q @ (q.T @ white)
    return ComponentInput(white[:, -1], np.eye(m), white[:, :-1], q)


SAME: Final = 1e3 * SAME_ANGLE
"""rad; angles of two curves that are closer than this count as common, as in a comparison."""
LINKING: Final = 2
"""Least common angles that join two curves; with a single one a shift would not show."""


@dataclass(frozen=True, eq=False)
class Joined:
    """The angles (n,) rad of a combined curve, ascending, and how each input sees the curve.

    ``designs`` holds for every input the matrix (m_k, n) and ``rows`` which of its values (m_k,)
    are used. ``interpolated`` (k,) marks inputs with too few angles in common.
    """

    angles: Floats
    period: float
    designs: tuple[Floats, ...]
    rows: tuple[Ints, ...]
    interpolated: tuple[bool, ...]


def join_angles(curves: Sequence[MeasuredCurve]) -> Joined:
    """Return the union of the angles of all curves that are joined by common ones.

    Curves that share fewer than two angles with the rest are compared with it by interpolation,
    as :func:`~rotcal_ros.evaluation.compare.compare` does, and add no angles of their own. The
    order of the curves does not matter.
    """
    turn = any(curve.period for curve in curves)
    at = [np.mod(curve.angles, TURN) if turn else curve.angles for curve in curves]
    nodes, places = _merged(at, turn)
    linked = _linked([set(place.tolist()) for place in places])
    # Of groups of equal size the one that begins first: the order of the inputs says nothing.
    main = min(linked, key=lambda group: (-len(group), sorted(group)))
    chosen = np.array(sorted(main))
    angles = nodes[chosen]
    period = TURN if turn or covers_circle(angles) else 0.0
    designs, rows, interpolated = [], [], []
    for place, own in zip(places, at, strict=True):
        member = main.issuperset(place.tolist())
        row = np.arange(len(own)) if member or period else _within(angles, own)
        if member:
            design = (place[:, None] == chosen).astype(np.float64)
        else:
            design = interpolation_matrix(angles, own[row], period)
        designs.append(design)
        rows.append(row)
        interpolated.append(not member)
    return Joined(angles, period, tuple(designs), tuple(rows), tuple(interpolated))


def union(angles: Sequence[Floats], turn: bool) -> Floats:
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


def _within(angles: Floats, own: Floats) -> Ints:
    """Return the rows of ``own`` inside of the arc of ``angles``; DataError for less than two."""
    inside = np.flatnonzero((own >= angles[0] - SAME_ANGLE) & (own <= angles[-1] + SAME_ANGLE))
    if len(inside) < LINKING:
        raise DataError(
            f"the curves share {len(inside)} angles: the others cover only "
            f"{angles[0] / DEGREE:.6g} .. {angles[-1] / DEGREE:.6g} deg; give results of "
            "the same arc"
        )
    return inside
