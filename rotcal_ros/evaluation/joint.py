"""One solution of what several instruments observed of one table, or of their results.

The deviations at all angles are unknowns that every instrument shares. An instrument brings its
observations, with unknowns, noise, effects and groups of its own, even where these say nothing
without the others. Where they are not at hand its result stands for them: values with all their
covariance, free of the zeros that it leaves open. That is exact for a linear method; what it left
out stays left out. Of results alone that is a combination, by generalised least squares; those
that rest on the same observations vary together, see :mod:`.common_angles`.

The zeros of every instrument are unknown: an offset of each component and what turns with the
table. Two measurements of one angle that contradict each other are found by closures: what
chi-squared falls by if every instrument had a curve of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, product
from typing import Any, Final, TypeAlias

import numpy as np
from scipy.linalg import block_diag, null_space
from threadpoolctl import threadpool_limits

from rotcal_ros.adjust.designs import dense
from rotcal_ros.adjust.distributions import chi2_sf
from rotcal_ros.adjust.effects import EffectTest, effect_test
from rotcal_ros.adjust.engine import Adjusted, adjust, predicted
from rotcal_ros.adjust.fit import Fit, fit_model
from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.model import CurveModel, Disturbing, Model, Unit, linear
from rotcal_ros.adjust.observable import observe_columns
from rotcal_ros.adjust.roots import root_between
from rotcal_ros.adjust.stacking import reparametrise, slices_of, stack_models, whiten
from rotcal_ros.evaluation.combination import (
    Combination,
    CombinationInput,
    assemble_result,
    inputs_that_measured,
    wanted_groups,
    weaker_protection,
)
from rotcal_ros.evaluation.common_angles import (
    covariance_floor,
    influence_matrix,
    same_angles,
    shared_covariance,
    with_observation_noise_only,
)
from rotcal_ros.evaluation.compare import SURE, agrees_too_well
from rotcal_ros.evaluation.component_groups import (
    ENLARGEMENTS,
    GROUPS,
    SHARED,
    ComponentGroup,
    Curves,
    Enlargement,
    GroupLayout,
    JoinedAngles,
    ObservedCurves,
    curves_of_input,
    find_open_offsets,
    gauge_basis,
    lay_out_group,
    most_certain_inputs,
    orthonormal_basis,
)
from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.foundation.components import unit_of
from rotcal_ros.foundation.errors import ConfigurationError, DataError, ObservabilityError
from rotcal_ros.foundation.language import noted, phrase
from rotcal_ros.foundation.results import Rejection, Result

ORDER_DIFFERS: Final = noted(
    "order {0} of {1} (cosine, sine) is another for {2} than for the others"
)

Members: TypeAlias = "tuple[str, ...]"
"""Names of inputs that share observations."""
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
MOST: Final = 0.5
"""Share of a contradiction from which on it is that of one order."""
FLOOR: Final = 1e-12
"""Smallest variance of any direction, in mean variances; keeps exact results finite."""
ROUNDED: Final = 1e-6
"""Variance, in mean variances, by which influences that a file rounds may miss a covariance."""


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
    parts: Sequence[Mapping[str, ObservedCurves]]
    left: Sequence[Floats]

    @classmethod
    def of(cls, inputs: Sequence[CombinationInput], groups: Sequence[Sequence[str]]) -> _Shared:
        """Return what inputs share in ``groups`` of components; DataError where nothing does."""
        layouts, every = [], []
        for group in groups:
            curves = inputs_that_measured(group, inputs)
            layouts.append(layout := lay_out_group(group, curves))
            every.append({name: curves_of_input(name, curves, layout) for name in curves})
        nothing = [np.zeros((len(layout.common), 0)) for layout in layouts]
        return cls(inputs, layouts, every, nothing)

    def without_open(self, known: Sequence[Floats]) -> _Shared:
        """Return the same without what is open: combinations that no rows (r, s) determine."""
        rows = np.linalg.qr(np.concatenate(known), mode="r")
        if not (open_ := null_space(rows, rcond=DETERMINED)).size:
            return self
        directions = self.basis @ open_
        parts = (np.linalg.svd(directions[place], full_matrices=False) for place in self.places)
        return replace(self, left=[ways[:, size > DETERMINED] for ways, size, _ in parts])

    @cached_property
    def clusters(self) -> dict[str, frozenset[str]]:
        """By the name of an input the names of all that rest on the same observations."""
        found = {m.name: frozenset([m.name]) for m in self.inputs}
        for first, second in combinations(self.inputs, 2):
            if len(first.raw_data.common_observations(second.raw_data)[0]):
                both = found[first.name] | found[second.name]
                found |= dict.fromkeys(both, both)
        return found

    def known(self, curves: Mapping[str, Curves]) -> dict[Members, _Known]:
        """Return what results of ``curves`` know; those that share observations together."""
        clusters = dict.fromkeys(self.clusters.values())
        members = [tuple(n for n in curves if n in cluster) for cluster in clusters]
        return {names: _Known.of(self, names, curves) for names in members if names}

    def of_observations(self, curves: Mapping[str, Curves]) -> dict[str, Curves]:
        """Return curves; those that share nothing have the covariance of observations alone."""
        return {
            name: {c: with_observation_noise_only(curve) for c, curve in own.items()}
            if len(self.clusters[name]) == 1
            else own
            for name, own in curves.items()
        }

    @cached_property
    def places(self) -> list[slice]:
        """Which of the unknowns (s,) are those of each group."""
        return slices_of(len(layout.common) for layout in self.layouts)

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

    def joined(self, component: str) -> JoinedAngles:
        """Return the angles of a component."""
        return next(o.joined[component] for o in self.layouts if component in o.joined)

    def meets(self, component: str, angles: Floats) -> Bools:
        """Return which (m, n) of the angles of a component each of ``angles`` (m,) rad is."""
        joined = self.joined(component)
        return same_angles(angles, joined.angles, joined.period)


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
    zeros = block_diag(*(gauge_basis(group) for group in groups if group))
    inverse = np.linalg.pinv(rows, rcond=NONE)
    beyond = np.eye(len(rows)) - rows @ inverse
    bound = beyond @ zeros
    for part in (beyond, bound):
        part[np.abs(part) < NONE] = 0.0  # the rounding of nothing has an inverse, too
    # The zero that brings the shared curve to where the outputs count from.
    fixed = np.linalg.pinv(bound, rcond=NONE) @ beyond
    curve = seen - zeros @ (fixed @ seen)
    if np.abs(beyond @ curve).max() > NONE:
        raise DataError("the outputs of a model cannot be any curve: its result has to do")
    own = np.hstack([inverse @ zeros @ null_space(bound, rcond=NONE), null_space(rows)])
    to = np.hstack([inverse @ curve, own @ _observable(model, own)])
    blocks = {CURVES: curve.shape[1], "own unknown": to.shape[1] - curve.shape[1]}
    return whiten(reparametrise(model, to, blocks))


def _observable(model: Model, own: Floats) -> Floats:
    """Return columns (q, r): what observations determine of the unknowns ``own`` (p, q)."""
    felt = dense(model.equations(model.first)[1]) @ own / model.std[:, None]
    scale = np.linalg.norm(felt, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    _, size, ways = np.linalg.svd(felt / scale, full_matrices=False)
    seen = size > NONE * size.max(initial=0.0)
    return np.asarray((ways[seen].T / size[seen]) / scale[:, None])


@dataclass(frozen=True, eq=False)
class _Known:
    """What results of ``names`` that share observations know: combinations of their values.

    ``rows`` (k, m) of them are free of what it leaves open, and make lengths and angles numbers of
    one size; ``values`` (k,), ``design`` (k, s) and ``covariance`` (k, k) are those of the
    combinations.
    """

    names: Sequence[str]
    rows: Floats
    values: Floats
    design: Floats
    covariance: Floats

    @classmethod
    def of(cls, shared: _Shared, names: Sequence[str], curves: Mapping[str, Curves]) -> _Known:
        """Return what results know, by their ``names``, with the covariance of ``curves``."""
        found = [
            (name, group[name], slot, left[:, : left.shape[1] * (name in layout.between)])
            for name in names
            for group, slot, left, layout in zip(
                shared.parts, shared.places, shared.left, shared.layouts, strict=True
            )
            if name in group
        ]
        values = np.concatenate([own.values for _, own, _, _ in found])
        design = np.concatenate([own.design @ shared.basis[slot] for _, own, slot, _ in found])
        # A line between angles joins no zeros: it follows values with several zeros up and down.
        free = [
            orthonormal_basis(np.hstack([own.free, own.design @ left]))
            for _, own, _, left in found
        ]
        covariance = _covariance([(name, own) for name, own, _, _ in found], curves)
        # Lengths and angles are compared in their own mean uncertainties.
        scale = np.concatenate([
            np.full(len(rows), np.sqrt(curves[name][c].covariance.diagonal().mean()))
            for name, own, _, _ in found
            for c, rows in own.rows.items()
        ])  # fmt: skip
        rows = null_space((block_diag(*free) / scale[:, None]).T).T / scale
        return cls(names, rows, rows @ values, rows @ design, rows @ covariance @ rows.T)

    def model(self, more: float = 0.0) -> Model:
        """Return it as observations of the shared unknowns, not judged.

        Along the axes of the covariance; every value has ``more`` variance.
        """
        size, axes = np.linalg.eigh(self.covariance + more * self.rows @ self.rows.T)
        if size[0] < -ROUNDED * size.sum():
            raise DataError(
                f"{', '.join(self.names)}: the covariance of the deviations is not positive "
                "semi-definite: the result is damaged, solve again"
            )
        white = (axes / np.sqrt(np.maximum(size, FLOOR * size.mean()))).T
        return Model(
            blocks={CURVES: self.design.shape[1]},
            observed=white @ self.values,
            std=np.ones(len(white)),
            equations=linear(white @ self.design),
            outputs=np.zeros((0, self.design.shape[1])),
            words=WORDS,
            components=("the result",),
            judged=np.zeros(len(white), dtype=np.bool_),
            row_names=[f"value {k}" for k in range(len(white))],
        )


def _covariance(
    parts: Sequence[tuple[str, ObservedCurves]], curves: Mapping[str, Curves]
) -> Floats:
    """Return the covariance (m, m) of all values of results, by name, that share observations.

    Between components by the influences of the observations; where they are not known, as in a
    combination, errors are what the method left of independent ones.
    """
    each = [(n, c, rows, own.grow[c]) for n, own in parts for c, rows in own.rows.items()]
    stated = [curves[n][c].raw_data.influence for n, c, _, _ in each]
    known = [found for found in stated if found is not None]
    influences = [np.zeros((len(rows), 0)) for _, _, rows, _ in each]
    if len(known) == len(each):
        influences = [
            influence_matrix(i)[rows] for i, (_, _, rows, _) in zip(known, each, strict=True)
        ]
    rests = []
    for (n, c, rows, grow), mine in zip(each, influences, strict=True):
        own = curves[n][c].covariance[np.ix_(rows, rows)]
        rests.append(grow @ (own - mine @ mine.T) @ grow)
    total, slots = np.asarray(block_diag(*rests)), slices_of(len(own) for own in influences)
    for i, (n, c, rows, _) in enumerate(each):
        for j, (other, its, theirs, _) in enumerate(each[: i + 1]):
            if n == other:
                total[slots[i], slots[j]] += influences[i] @ influences[j].T
            else:
                pair = curves[n][c], curves[other][its]
                both = shared_covariance(*pair, (n, other), alike=c == its)
                if both is not None:
                    total[slots[i], slots[j]] = both[np.ix_(rows, theirs)]
            total[slots[j], slots[i]] = total[slots[i], slots[j]].T
    if len({n for n, _ in parts}) > 1:
        rounded = max(-np.linalg.eigvalsh(total)[0], 0.0)
        rounded = min(rounded, ROUNDED * float(np.mean(total.diagonal())))
        total += covariance_floor(total) + rounded * np.eye(len(total))
    return total


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
    """The models of all instruments, over the shared unknowns, and all of them as one.

    ``members``: the names of the inputs of each, several where they share observations.
    ``results``: names of the instruments whose results stand for them.
    """

    shared: _Shared
    models: Mapping[str, Model]
    members: Mapping[str, tuple[str, ...]]
    results: frozenset[str]

    @classmethod
    def of(cls, instruments: Sequence[JointInput]) -> _Views:
        inputs = [each.alone for each in instruments]
        for first, second in combinations(inputs, 2):
            here, _ = first.raw_data.common_observations(second.raw_data)
            if len(here):
                raise DataError(
                    f"{first.name} and {second.name} share {len(here)} observations: solve one of "
                    "them with the others (rotcal combine weighs results of the same data)"
                )
        shared = _Shared.of(inputs, wanted_groups(inputs))
        for layout in shared.layouts:
            if layout.between:
                raise DataError(
                    f"{', '.join(layout.joined)} of {', '.join(layout.between)}: fewer than two "
                    "angles in common with the others: nothing joins their zeros; measure at "
                    "common angles (rotcal combine reads between angles, and says so)"
                )

        def models() -> dict[str, Model]:
            return {
                each.name: _Known.of(shared, [each.name], {each.name: each.alone.curves}).model()
                if each.model is None
                else _by_observations(shared, each.model)
                for each in instruments
            }

        found, width = models(), shared.basis.shape[1]
        white = [dense(model.equations(model.first)[1]) for model in found.values()]
        shared = shared.without_open([_determined(each, width) for each in white])
        if shared.basis.shape[1] < width:
            found = models()
        results = frozenset(each.name for each in instruments if each.model is None)
        return cls(shared, found, {name: (name,) for name in found}, results)

    @classmethod
    def by_results(
        cls, shared: _Shared, known: Mapping[Members, _Known], more: float = 0.0
    ) -> _Views:
        """Return results by the names of their inputs; each value has ``more`` variance."""
        members = {SHARED.join(names): names for names in known}
        models = {name: known[of].model(more) for name, of in members.items()}
        return cls(shared, models, members, frozenset(members))

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
            further={},
            start=None,
        )

    @cached_property
    def together(self) -> Model:
        """What all observed."""
        basis = self.shared.basis
        return stack_models(self.models, {CURVES: basis.shape[1]}, basis, WORDS)

    @cached_property
    def whole(self) -> Model:
        """What all observed, with what the instruments may differ in."""
        design = dense(self.together.equations(self.together.first)[1])
        return replace(
            self.together,
            effects=[*self.together.effects, *self.differences(design, self.shared.columns)],
        )

    @cached_property
    def fit(self) -> Fit:
        """Least squares of what all observed, with the noise that is stated."""
        n, p = self.together.size
        return fit_model(self.together, np.ones(n, dtype=np.bool_), np.ones(n), np.zeros(p))

    @cached_property
    def rows(self) -> dict[str, slice]:
        """Which observations are those of each instrument."""
        places = slices_of(m.size[0] for m in self.models.values())
        return dict(zip(self.models, places, strict=True))

    def own_curve(self, design: Floats, name: str, curves: Floats) -> Floats:
        """Return what is observed (n, k) if an instrument alone sees other ``curves`` (s, k).

        ``design`` (n, p): the derivatives of all observations.
        """
        basis, rows = self.shared.basis, self.rows[name]
        found = np.zeros((len(design), curves.shape[1]))
        found[rows] = design[rows, : basis.shape[1]] @ (basis.T @ curves)
        return found

    def differences(self, design: Floats, components: Iterable[str]) -> Iterator[Disturbing]:
        """Yield what one instrument may see otherwise than the others, by orders of a curve."""
        seeing = {
            c: [
                name
                for name, of in self.members.items()
                if any(m.name in of and c in m.curves for m in self.shared.inputs)
            ]
            for c in components
        }
        several = [
            (name, c)
            for name in self.members
            for c, names in seeing.items()
            if len(names) > 1 and name in names
        ]
        for (name, c), order in product(several, ORDERS):
            turned = order * self.shared.joined(c).angles
            curves = np.zeros((len(self.shared.basis), 2))
            curves[self.shared.columns[c]] = np.column_stack([np.cos(turned), np.sin(turned)])
            factor, label = unit_of(c)
            yield Disturbing(
                "gauge",
                phrase(ORDER_DIFFERS, order, c, name),
                self.own_curve(design, name, curves),
                LARGEST * factor,
                Unit(label.replace("µ", "u"), factor),
            )

    def closed(self, fit: Fit, names: Sequence[str], place: slice) -> EffectTest:
        """Test whether some instruments see curves of their own of the unknowns at ``place``."""
        curves = np.eye(len(self.shared.basis))[:, place]
        columns = [self.own_curve(fit.design, name, curves) for name in names]
        return effect_test(observe_columns(fit, np.hstack(columns)))

    def group(
        self,
        k: int,
        fit: Fit,
        tested: tuple[float, int, float],
        level: float,
        spread: Floats | None = None,
    ) -> ComponentGroup:
        """Return group ``k`` of components as it is in ``fit``; ``spread``: its covariance.

        ``tested``: chi-squared of closures, degrees of freedom, and how often chance makes more.
        """
        place, layout = self.shared.places[k], self.shared.layouts[k]
        response = fit.response[place]
        parts = np.array([(response[:, rows] ** 2).sum(axis=1) for rows in self.rows.values()])
        chi2, dof, chance = tested
        return ComponentGroup(
            members=tuple(self.members.values()),
            joined=layout.joined,
            columns=layout.columns,
            value=fit.value[place],
            spread=response @ response.T if spread is None else spread,
            shares=parts / np.maximum(parts.sum(axis=0), np.finfo(np.float64).tiny),
            chi2=chi2,
            dof=dof,
            p_value=chance,
            consistent=chance >= level,
            chi2_of_noise=chi2,
            open=self.shared.left[k],
            interpolated=layout.between,
        )

    def contradicting(self, group: ComponentGroup, k: int, fit: Fit) -> ComponentGroup:
        """Return a group whose inputs contradict each other, with Birge's factor and who is off.

        By ``fit`` with the noise that each has alone.
        """
        place, farthest = self.shared.places[k], ""
        names = [
            n for n, of in self.members.items() if not self.shared.parts[k].keys().isdisjoint(of)
        ]
        if len(names) > 2:
            squares = {name: self.closed(fit, [name], place).squares for name in names}
            farthest = max(names, key=squares.__getitem__)
        tests = [
            (effect_test(observe_columns(fit, effect.whole(fit.computed))), effect.what)
            for effect in self.differences(fit.design, group.joined)
        ]
        differs = ""
        if tests:  # of one alone nothing is another
            best, what = max(tests, key=lambda test: test[0].squares)
            most = best.squares - best.rank > MOST * (group.chi2 - group.dof)
            differs = what if most and len(tests) * best.probability < SURE else ""
        factor = float(np.sqrt(group.chi2 / group.dof))
        return replace(
            group, enlargement="birge", factor=factor, farthest=farthest, differs=differs
        )

    def linked(self, group: ComponentGroup, k: int) -> ComponentGroup:
        """Return a group with the offsets that one input leaves open and others measured."""
        parts = self.shared.parts[k]
        curves = {name: self.shared.curves_of(name) for name in parts}
        return replace(group, links=tuple(find_open_offsets(group, curves, parts)))


def combine(inputs: Sequence[CombinationInput], enlarge: Enlargement = "birge") -> Combination:
    """Return the best estimate of all components that any of ``inputs`` measured.

    Each component counts from its own mean, and the pairs have no part that turns with the table.
    The angles are those of all inputs; a component that was measured at only some of them is
    interpolated at the others, with a warning. If the inputs contradict each other (chi-square, 1
    % over all groups of components) the uncertainties are enlarged as ``enlarge`` says and the
    verdict is suspect. An offset that one input leaves open, such as that between two groups of
    table positions, comes from the others; a sentence says from which, and what it adds to U. A
    component whose offset no input holds is left out if others are whole; if none is, all stay and
    the result keeps the open :class:`Zeros`. The order of the inputs does not matter. Raises
    DataError for inputs that cannot be joined.
    """
    if enlarge not in ENLARGEMENTS:
        raise ConfigurationError(
            f"enlargement {enlarge!r}: expected one of {', '.join(ENLARGEMENTS)}"
        )
    every = [_Shared.of(inputs, [group]) for group in wanted_groups(inputs)]
    level = SURE / max(1, sum(len(shared.parts[0]) > 1 for shared in every))
    groups = [_combined(shared, enlarge, level) for shared in every]
    return Combination(assemble_result(groups, inputs), tuple(groups))


def _combined(shared: _Shared, enlarge: Enlargement, level: float) -> ComponentGroup:
    """Return the one group of results: consistent if chance makes more than ``level``."""
    (layout,), (parts,) = shared.layouts, shared.parts
    curves = {name: shared.curves_of(name) for name in parts}
    if any(own.free.shape[1] > own.known for own in parts.values()):
        joining = [
            own.observable(shared.basis) for n, own in parts.items() if n not in layout.between
        ]
        shared = shared.without_open(joining)
    known, counting = shared.known(curves), most_certain_inputs(curves)
    surest, views = known, _Views.by_results(shared, known)
    best = views
    if len(counting) < len(curves):
        surest = shared.known({name: curves[name] for name in counting})
        best = _Views.by_results(shared, surest)
    try:
        chi2, dof = views.fit.chi2, views.fit.dof
    except ObservabilityError as error:
        raise DataError(
            f"{', '.join(layout.joined)} of {', '.join(parts)}: the inputs share too few angles "
            "to be joined: measure at two common angles or more"
        ) from error
    tested = chi2, dof, chi2_sf(chi2, dof) if dof else 1.0
    group = best.group(0, best.fit, tested, level)
    if agrees_too_well(chi2, dof):  # by less noise they agree less well
        noise = _Views.by_results(shared, shared.known(shared.of_observations(curves)))
        group = replace(group, chi2_of_noise=noise.fit.chi2)
    if not group.consistent:
        group = views.contradicting(group, 0, views.fit)
        if enlarge != "birge":
            group = replace(group, enlargement=enlarge, factor=1.0)
        if enlarge == "mandel-paule":
            variance = _common_variance(shared, views, known)
            best = _Views.by_results(shared, surest, variance)
            wide = best.group(0, best.fit, tested, level)
            group = replace(group, value=wide.value, spread=wide.spread, shares=wide.shares)
            group = replace(group, common_std=float(np.sqrt(variance)))
    return views.linked(replace(group, members=tuple(known)), 0)


def _common_variance(shared: _Shared, views: _Views, known: Mapping[Members, _Known]) -> float:
    """Return the variance that, added to every value, makes chi-square equal to dof.

    This is Mandel and Paule's between-laboratory component, here for every single value.
    """

    def missing(variance: float) -> float:
        fit = _Views.by_results(shared, known, variance).fit if variance else views.fit
        return fit.dof / fit.chi2 - 1.0  # nearly a straight line

    # where it would be if all values had one variance
    variance = float(np.mean([1.0 / np.mean((own.rows**2).sum(axis=1)) for own in known.values()]))
    high = variance * (views.fit.chi2 / views.fit.dof - 1.0)
    while missing(high) < 0.0:
        high *= 1.5
    return root_between(missing, 0.0, high, 1e-9 * high)


def solve_together(instruments: Sequence[JointInput]) -> Combination:
    """Return the solution of all that the ``instruments`` observed, and how they agree by group.

    Components count from their means, and the pairs have no part that turns with the table. If
    instruments contradict each other (closures, 1 % over all groups of components) the
    uncertainties are enlarged (Birge) and the verdict is suspect. Raises DataError for inputs that
    cannot be joined, ObservabilityError where they leave deviations open that none says it does.
    """
    with threadpool_limits(1, "blas"):  # as where one instrument is solved
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
        level = SURE / max(1, sum(len(parts) > 1 for parts in views.shared.parts))
        groups = [_group(views, found, alone, k, level) for k in range(len(views.shared.parts))]
        return Combination(_result(views, found, groups, instruments), tuple(groups))


def _group(views: _Views, found: Adjusted, alone: Fit, k: int, level: float) -> ComponentGroup:
    """Return the components of group ``k`` with their closures, tested at ``level``.

    ``alone`` is the solution with the noise that each instrument has alone; it is the result where
    they contradict each other.
    """
    place, (_, *closing) = views.shared.places[k], views.shared.parts[k]
    tested = (0.0, 0, 1.0)
    if closing:
        test = views.closed(alone, closing, place)
        tested = test.squares, test.rank, test.probability
    if tested[2] >= level:
        # A result that agrees with the others better than it says keeps what it says: its scatter
        # there says nothing of what it alone knows.
        of_results = np.concatenate(
            [np.full(m.size[0], name in views.results) for name, m in views.models.items()]
        )
        smaller = np.minimum(found.diagnosis.noise.factors, 1.0)[found.model.of_component]
        more = np.where(of_results, 1.0 / smaller**2 - 1.0, 0.0)
        response = found.fit.response[place]
        spread = found.covariance[place, place] + (response * more) @ response.T
        return views.linked(views.group(k, found.fit, tested, level, spread), k)
    group = views.group(k, alone, tested, level)
    return views.linked(views.contradicting(group, k, alone), k)


def _result(
    views: _Views,
    found: Adjusted,
    groups: Sequence[ComponentGroup],
    instruments: Sequence[JointInput],
) -> Result:
    """Return the result of all groups, with what the engine found and doubts."""
    result = assemble_result(groups, views.shared.inputs)
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
            weaker_protection(p, own[p.effect]) if p.effect in own else p
            for p in result.protections
        ),
    )
    if found.verdict == "failed":
        return replace(joint, verdict="failed", zeros=replace(joint.zeros, within="failed"))
    return joint if found.verdict == "ok" else joint.as_suspect()


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
