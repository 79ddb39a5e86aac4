"""One solution of what several instruments observed of one table.

The deviations at all angles are unknowns that every instrument shares. An instrument brings its
observations, with unknowns, noise, effects and groups of its own, even where these say nothing
without the others. Where they are not at hand its result stands for them: values with all their
covariance, free of the zeros that it leaves open. That is exact for a linear method; what it left
out stays left out.

The zeros of every instrument are unknown: an offset of each component and what turns with the
table. Two measurements of one angle that contradict each other are found by closures: what
chi-squared falls by if every instrument had a curve of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, product
from typing import Any, Final

import numpy as np
from scipy.linalg import block_diag, null_space
from threadpoolctl import threadpool_limits

from rotcal_ros.adjust.designs import dense
from rotcal_ros.adjust.effects import EffectTest, effect_test
from rotcal_ros.adjust.engine import Adjusted, adjust, predicted
from rotcal_ros.adjust.fit import Fit
from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.model import CurveModel, Disturbing, Model, Unit, linear
from rotcal_ros.adjust.seen import seen_by
from rotcal_ros.adjust.stacking import places_of, reparametrised, stacked, whitened
from rotcal_ros.evaluation.combination import (
    Combination,
    CombinationInput,
    owners_of,
    result_of,
    wanted_groups,
    weaker,
)
from rotcal_ros.evaluation.common_angles import same_angles
from rotcal_ros.evaluation.compare import SURE
from rotcal_ros.evaluation.component_groups import (
    FLOOR,
    GROUPS,
    ComponentGroup,
    Curves,
    GroupLayout,
    Joined,
    Pooled,
    SeenCurves,
    laid_out,
    links_of,
    part_of,
    unknown,
)
from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.foundation.components import unit_of
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.results import Rejection, Result

WORDS: Final = Words("readings", "dirt, heat, a draught or a loose mount", "there", "there")
ORDERS: Final = (1, 2, 3)
"""What an instrument, its mount or an artefact errs by, it errs by mostly so often in a turn."""
LARGEST: Final = 1000.0
"""Difference of two instruments, in um or arcsec, that nobody would overlook."""
CURVES: Final = "deviations"
"""The block of unknowns that all instruments share."""
NONE: Final = 1e-9
"""Share of a direction that is rounding."""
DETERMINED: Final = 1e-7
"""Share of what observations feel of a direction from which on they separate it from others."""


@dataclass(frozen=True, eq=False)
class JointInput:
    """One measurement of the table: the result that it gives alone, and its observations.

    ``model`` is None where the result stands for them.
    """

    name: str
    result: Result
    model: CurveModel | None = None

    @cached_property
    def alone(self) -> CombinationInput:
        """It as an input of a combination; raises DataError for a result that cannot be one."""
        return CombinationInput.of(self.name, self.result)


@dataclass(frozen=True, eq=False)
class _Shared:
    """A ``layout`` of each group of components, its unknowns one after the other.

    ``inputs``: the curves of each instrument alone, by its name. ``left``: what all of them
    together leave open of a group, beside what no method knows.
    """

    inputs: Sequence[CombinationInput]
    layouts: Sequence[GroupLayout]
    parts: Sequence[Mapping[str, SeenCurves]]
    left: Sequence[Floats]

    @classmethod
    def of(cls, instruments: Sequence[JointInput]) -> _Shared:
        """Return what the instruments share; DataError where nothing joins them."""
        inputs = [each.alone for each in instruments]
        _require_own_observations(inputs)
        layouts, every = [], []
        for group in wanted_groups(inputs):
            curves = owners_of(group, inputs)
            layout = laid_out(group, curves)
            if layout.between:
                raise DataError(
                    f"{', '.join(group)} of {', '.join(layout.between)}: fewer than two angles in "
                    "common with the others: nothing joins their zeros; measure at common angles "
                    "(rotcal combine reads between angles, and says so)"
                )
            layouts.append(layout)
            every.append({name: part_of(name, curves, layout) for name in curves})
        nothing = [np.zeros((len(layout.common), 0)) for layout in layouts]
        return cls(inputs, layouts, every, nothing)

    def leaving(self, directions: Floats) -> _Shared:
        """Return the same without ``directions`` (s, k) of the unknowns, which are open."""
        parts = (np.linalg.svd(directions[place], full_matrices=False) for place in self.places)
        return replace(self, left=[ways[:, size > DETERMINED] for ways, size, _ in parts])

    @cached_property
    def places(self) -> list[slice]:
        """Which of the unknowns (s,) are those of each group."""
        return places_of(len(layout.common) for layout in self.layouts)

    @cached_property
    def columns(self) -> dict[str, slice]:
        """Which of the unknowns (s,) are those of each component."""
        return {
            c: slice(place.start + own.start, place.start + own.stop)
            for layout, place in zip(self.layouts, self.places, strict=True)
            for c, own in layout.columns.items()
        }

    @cached_property
    def basis(self) -> Floats:
        """Orthonormal columns (s, q) of all that can be known of the deviations.

        They are the unknowns: what no method knows, and what all leave open, is left out.
        """
        known = zip(self.layouts, self.left, strict=True)
        each = [null_space(np.hstack([o.common, left]).T) for o, left in known]
        return np.asarray(block_diag(*each), dtype=np.float64)

    def curves_of(self, name: str) -> Curves:
        """Return the curves of an instrument alone."""
        return next(m.curves for m in self.inputs if m.name == name)

    def joined(self, component: str) -> Joined:
        """Return the angles of a component."""
        return next(o.joined[component] for o in self.layouts if component in o.joined)

    def meets(self, component: str, angles: Floats) -> Bools:
        """Return which (m, n) of the angles of a component each of ``angles`` (m,) rad is."""
        joined = self.joined(component)
        return same_angles(angles, joined.angles, joined.period)


def _require_own_observations(inputs: Sequence[CombinationInput]) -> None:
    """Raise DataError for inputs that rest on the same observations."""
    for first, second in combinations(inputs, 2):
        here, _ = first.raw_data.shared_with(second.raw_data)
        if len(here):
            raise DataError(
                f"{first.name} and {second.name} share {len(here)} observations: solve one of "
                "them with the others (rotcal combine weighs results of the same data)"
            )


def _by_observations(shared: _Shared, curve_model: CurveModel) -> Model:
    """Return the observations of an instrument over the shared unknowns and its own.

    Its outputs C x are the shared curve, from a zero of its own: x = C+ (curve + zero) + what the
    outputs do not feel.
    """
    model, angles = curve_model.model, curve_model.angles
    meets = {c: shared.meets(c, angles) for c in curve_model.curves if c in shared.columns}
    there = {c: found.any(axis=1) for c, found in meets.items()}
    rows = np.concatenate([curve_model.curves[c][there[c]] for c in meets])
    seen = np.concatenate([meets[c][there[c]] @ shared.basis[shared.columns[c]] for c in meets])
    groups = [{c: angles[there[c]] for c in meets if c in group} for group in GROUPS]
    zeros = block_diag(*(unknown(group) for group in groups if group))
    inverse = np.linalg.pinv(rows, rcond=NONE)
    beyond = np.eye(len(rows)) - rows @ inverse
    beyond[np.abs(beyond) < NONE] = 0.0  # the rounding of nothing has an inverse, too
    # The zero that brings the shared curve to where the outputs count from.
    fixed = np.linalg.pinv(beyond @ zeros, rcond=NONE) @ beyond
    curve = seen - zeros @ (fixed @ seen)
    if np.abs(beyond @ curve).max() > NONE:
        raise DataError("the outputs of a model cannot be any curve: its result has to do")
    own = np.hstack([inverse @ zeros @ null_space(beyond @ zeros, rcond=NONE), null_space(rows)])
    to = np.hstack([inverse @ curve, own @ _observable(model, own)])
    blocks = {CURVES: curve.shape[1], "own unknown": to.shape[1] - curve.shape[1]}
    return whitened(reparametrised(model, to, blocks))


def _observable(model: Model, own: Floats) -> Floats:
    """Return columns (q, r): what observations determine of the unknowns ``own`` (p, q)."""
    felt = dense(model.equations(model.first)[1]) @ own / model.std[:, None]
    scale = np.linalg.norm(felt, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    _, size, ways = np.linalg.svd(felt / scale, full_matrices=False)
    seen = size > NONE * size.max(initial=0.0)
    return np.asarray((ways[seen].T / size[seen]) / scale[:, None])


def _narrowed(model: Model, to: Floats) -> Model:
    """Return the model of fewer shared unknowns, which ``to`` (s, t) takes to the present ones."""
    own = model.size[1] - len(to)
    blocks = {CURVES: to.shape[1], "own unknown": own}
    return reparametrised(model, block_diag(to, np.eye(own)), blocks)


def _by_result(shared: _Shared, name: str) -> Model:
    """Return the result of an instrument as observations of the shared unknowns, not judged.

    In the space of what it knows, along the axes of its covariance.
    """
    parts = [
        (group[name], place)
        for group, place in zip(shared.parts, shared.places, strict=True)
        if name in group
    ]
    values = np.concatenate([own.part.values for own, _ in parts])
    design = np.concatenate([own.part.design @ shared.basis[place] for own, place in parts])
    covariance = _whole_covariance([own for own, _ in parts], shared.curves_of(name))
    # Lengths and angles are compared in their own mean uncertainties.
    scale = np.concatenate([
        np.full(len(rows), np.sqrt(shared.curves_of(name)[c].covariance.diagonal().mean()))
        for own, _ in parts
        for c, rows in own.rows.items()
    ])  # fmt: skip
    open_ = block_diag(*(own.part.free for own, _ in parts)) / scale[:, None]
    known = null_space(open_.T).T
    size, axes = np.linalg.eigh(known @ (covariance / np.outer(scale, scale)) @ known.T)
    white = (axes / np.sqrt(np.maximum(size, FLOOR * size.mean()))).T @ known / scale
    return Model(
        blocks={CURVES: design.shape[1]},
        observed=white @ values,
        std=np.ones(len(white)),
        equations=linear(white @ design),
        outputs=np.zeros((0, design.shape[1])),
        words=WORDS,
        components=("the result",),
        judged=np.zeros(len(white), dtype=np.bool_),
        row_names=[f"value {k}" for k in range(len(white))],
    )


def _whole_covariance(parts: Sequence[SeenCurves], curves: Curves) -> Floats:
    """Return the covariance (m, m) of all values of a result.

    Between components by the influences of its observations; where they are not known, as in a
    combination.
    """
    rows = {c: taken for own in parts for c, taken in own.rows.items()}
    influences = [curves[c].raw_data.influence for c in rows]
    felt = [
        matrix[taken]
        for found, taken in zip(influences, rows.values(), strict=True)
        if found is not None
        for matrix in found.deviations.values()
    ]
    if len(felt) < len(rows):
        return np.asarray(block_diag(*(own.part.covariance for own in parts)))
    rest = [
        curves[c].covariance[np.ix_(taken, taken)] - own @ own.T
        for (c, taken), own in zip(rows.items(), felt, strict=True)
    ]
    together = np.concatenate(felt)
    return np.asarray(together @ together.T + block_diag(*rest))


def _determined(white: Floats, shared: int) -> Floats:
    """Return orthonormal rows (r, shared): what observations determine of the first unknowns.

    ``white`` (n, p): their derivatives, in their noise.
    """
    curve, own = white[:, :shared], white[:, shared:]
    axes, size, _ = np.linalg.svd(own, full_matrices=False)
    axes = axes[:, size > NONE * size.max(initial=0.0)]
    _, size, ways = np.linalg.svd(curve - axes @ (axes.T @ curve), full_matrices=False)
    return np.asarray(ways[size > DETERMINED * np.linalg.norm(curve)])


@dataclass(frozen=True, eq=False)
class _Views:
    """The models of all instruments, over the shared unknowns, and all of them as one."""

    shared: _Shared
    models: Mapping[str, Model]
    results: frozenset[str]
    """Names of the instruments whose results stand for them."""

    @classmethod
    def of(cls, instruments: Sequence[JointInput]) -> _Views:
        shared = _Shared.of(instruments)
        models = {
            each.name: _by_result(shared, each.name)
            if each.model is None
            else _by_observations(shared, each.model)
            for each in instruments
        }
        results = frozenset(each.name for each in instruments if each.model is None)
        wide = shared.basis
        white = [dense(model.equations(model.first)[1]) for model in models.values()]
        known = np.concatenate([_determined(each, wide.shape[1]) for each in white])
        if (open_ := null_space(known, rcond=DETERMINED)).size:
            shared = shared.leaving(wide @ open_)
            to = wide.T @ shared.basis
            models = {name: _narrowed(model, to) for name, model in models.items()}
        return cls(shared, models, results)

    def alone(self, name: str, fit: Fit) -> Model:
        """Return what one instrument observed, linear about the ``fit`` of all.

        Its outputs are what it determines of the deviations.
        """
        model, rows, unknowns = self.models[name], self.rows[name], self.whole.size[1]
        design, width = fit.design[rows, :unknowns], self.shared.basis.shape[1]
        known = _determined(design, width)
        outputs = self.shared.basis @ known.T @ known
        outputs[np.abs(outputs) < NONE] = 0.0  # rounding is no part of a deviation
        return replace(
            model,
            blocks=self.whole.blocks,
            observed=fit.residual[rows] + design @ fit.x[:unknowns],
            equations=linear(design),
            outputs=np.pad(outputs, ((0, 0), (0, unknowns - width))),
            also={},
            start=None,
        )

    @cached_property
    def of_results(self) -> Bools:
        """Which observations (n,) are those of results."""
        each = [np.full(m.size[0], name in self.results) for name, m in self.models.items()]
        return np.concatenate(each)

    @cached_property
    def whole(self) -> Model:
        """What all observed, with what the instruments may differ in."""
        basis = self.shared.basis
        model = stacked(self.models, {CURVES: basis.shape[1]}, basis, WORDS)
        design = dense(model.equations(model.first)[1])
        return replace(model, effects=[*model.effects, *self._differences(design)])

    @cached_property
    def rows(self) -> dict[str, slice]:
        """Which observations are those of each instrument."""
        places = places_of(m.size[0] for m in self.models.values())
        return dict(zip(self.models, places, strict=True))

    def own_curve(self, design: Floats, name: str, curves: Floats) -> Floats:
        """Return what is observed (n, k) if an instrument alone sees other ``curves`` (s, k).

        ``design`` (n, p): the derivatives of all observations.
        """
        basis, rows = self.shared.basis, self.rows[name]
        found = np.zeros((len(design), curves.shape[1]))
        found[rows] = design[rows, : basis.shape[1]] @ (basis.T @ curves)
        return found

    def _differences(self, design: Floats) -> Iterator[Disturbing]:
        """Yield what one instrument may see otherwise than the others, by orders of a curve."""
        names = [(m.name, c) for m in self.shared.inputs for c in m.curves]
        several = [(name, c) for name, c in names if sum(c == other for _, other in names) > 1]
        for (name, c), order in product(several, ORDERS):
            turned = order * self.shared.joined(c).angles
            curves = np.zeros((len(self.shared.basis), 2))
            curves[self.shared.columns[c]] = np.column_stack([np.cos(turned), np.sin(turned)])
            factor, label = unit_of(c)
            yield Disturbing(
                "gauge",
                f"order {order} of {c} (cosine, sine) is another for {name} than for the others",
                self.own_curve(design, name, curves),
                LARGEST * factor,
                Unit(label.replace("µ", "u"), factor),
            )


def solve_together(instruments: Sequence[JointInput]) -> Combination:
    """Return the solution of all that the ``instruments`` observed, and how they agree by group.

    Components count from their means, and the pairs have no part that turns with the table. If
    instruments contradict each other (closures, 1 % over all groups of components) the
    uncertainties are enlarged (Birge) and the verdict is suspect. Raises DataError for inputs that
    cannot be joined, ObservabilityError where they leave deviations open that none says it does.
    """
    with threadpool_limits(1, "blas"):  # as where one instrument is solved
        return _solved(instruments)


def _solved(instruments: Sequence[JointInput]) -> Combination:
    views = _Views.of(instruments)
    found = adjust(views.whole)
    # Closures are judged by the noise of each alone: in that of all together they would hide.
    factors = [
        np.ones(1)
        if each.model is None
        else adjust(views.alone(each.name, found.fit)).diagnosis.noise.factors
        for each in instruments
    ]
    alone = found.diagnosis.fitted(np.concatenate(factors), found.fit.x)
    tested = sum(len(parts) > 1 for parts in views.shared.parts)
    level = SURE / max(tested, 1)
    groups = [_group(views, found, alone, k, level) for k in range(len(views.shared.parts))]
    return Combination(_result(views, found, groups, instruments), tuple(groups))


def _group(views: _Views, found: Adjusted, alone: Fit, k: int, level: float) -> ComponentGroup:
    """Return the components of group ``k`` with their closures, tested at ``level``.

    ``alone`` is the solution with the noise that each instrument has alone; it is the result where
    they contradict each other.
    """
    shared, names, members = views.shared, list(views.models), list(views.shared.parts[k])
    layout, place = shared.layouts[k], shared.places[k]

    def closed(closing: Sequence[str]) -> EffectTest:
        curves = np.eye(len(shared.basis))[:, place]
        columns = [views.own_curve(alone.design, name, curves) for name in closing]
        return effect_test(seen_by(alone, np.hstack(columns)))

    squares, rank, chance = 0.0, 0, 1.0
    if len(members) > 1:
        test = closed(members[1:])
        squares, rank, chance = test.squares, test.rank, test.probability
    consistent = chance >= level
    fit = found.fit if consistent else alone
    response = fit.response[place]
    stated = _covariance(views, found)[place, place]
    covariance = stated if consistent else response @ response.T
    parts = np.array([(response[:, views.rows[name]] ** 2).sum(axis=1) for name in names])
    variances = np.maximum(parts.sum(axis=0), np.finfo(np.float64).tiny)
    group = ComponentGroup(
        inputs=tuple(names),
        members=tuple((name,) for name in names),
        joined=layout.joined,
        columns=layout.columns,
        pooled=Pooled(fit.value[place], covariance, parts / variances, squares, rank),
        chi2=squares,
        dof=rank,
        p_value=chance,
        consistent=consistent,
        chi2_of_noise=squares,
        open=shared.left[k],
    )
    if not consistent:
        by_name = {name: closed([name]).squares for name in members}
        farthest = max(by_name, key=by_name.__getitem__) if len(members) > 2 else ""
        factor = float(np.sqrt(squares / rank))
        group = replace(group, enlargement="birge", factor=factor, farthest=farthest)
    curves = {name: shared.curves_of(name) for name in members}
    return replace(
        group,
        links=tuple(links_of(group, curves, [own.part for own in shared.parts[k].values()])),
    )


def _covariance(views: _Views, found: Adjusted) -> Floats:
    """Return the covariance (s, s) of the deviations.

    A result that agrees with the others better than it says keeps what it says: its scatter there
    says nothing of what it alone knows.
    """
    model, response = found.model, found.fit.response[: len(found.model.outputs)]
    smaller = np.minimum(found.diagnosis.noise.factors, 1.0)[model.of_component]
    more = np.where(views.of_results, 1.0 / smaller**2 - 1.0, 0.0)
    return np.asarray(found.covariance + (response * more) @ response.T)


def _result(
    views: _Views,
    found: Adjusted,
    groups: Sequence[ComponentGroup],
    instruments: Sequence[JointInput],
) -> Result:
    """Return the result of all groups, with what the engine found and doubts."""
    result = result_of(groups, views.shared.inputs)
    own = {p.effect: p for p in found.protections() if p.effect == "gauge" and result.protections}
    details: dict[str, Any] = {**result.details, **found.details()}
    joint = replace(
        result,
        sigma0=found.sigma0,
        dof=found.fit.dof,
        n_observations=sum(each.result.n_observations for each in instruments),
        rejected=tuple(Rejection(row, why) for row, why in sorted(found.why.items())),
        warnings=(*found.doubts, *result.warnings),
        details=details,
        protections=tuple(
            weaker(p, own[p.effect]) if p.effect in own else p for p in result.protections
        ),
    )
    if found.verdict == "failed":
        return replace(joint, verdict="failed", zeros=replace(joint.zeros, within="failed"))
    return joint if found.verdict == "ok" else joint.doubted()


@dataclass(frozen=True, eq=False)
class JointPlan:
    """What a solution together would state: the largest std of each component, m or rad.

    Of the components ``open`` the zeros differ between parts, in which the std holds.
    """

    std: Mapping[str, float]
    open: tuple[str, ...]


def predicted_together(instruments: Sequence[JointInput]) -> JointPlan:
    """Return what ``instruments`` would give together; what they observed does not matter.

    Raises as :func:`solve_together`.
    """
    with threadpool_limits(1, "blas"):
        views = _Views.of(instruments)
        shared, std = views.shared, predicted(views.whole).std
    open_ = [
        c
        for layout, left in zip(shared.layouts, shared.left, strict=True)
        for c, own in layout.columns.items()
        if np.abs(left[own]).max(initial=0.0) > NONE
    ]
    largest = {c: float(std[own].max()) for c, own in shared.columns.items()}
    return JointPlan(largest, tuple(open_))
