"""What is wrong with observations: a robust start, the noise, and explanations one by one.

:func:`diagnose_causes` goes on until nothing significant is left unexplained. In each round a
:class:`~.look.SolutionView` at the solution asks for explanations. The most probable goes first:
observations are left out, an effect becomes an unknown. What explains nearly as much is
remembered, and the difference it makes joins the covariance.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from rotcal_ros.adjust.diagnosis import ContestedExplanation, Diagnosis, Explanation, Limits, Noise
from rotcal_ros.adjust.fit import Fit
from rotcal_ros.adjust.groups import CHECKED
from rotcal_ros.adjust.judgement import ALIKE
from rotcal_ros.adjust.look import SolutionView
from rotcal_ros.adjust.model import Model
from rotcal_ros.adjust.noise import (
    LEAST_FACTOR,
    LEAST_REDUNDANCY,
    NEARLY_SETTLED,
    PRIOR,
    SETTLED,
    UNKNOWN,
    EstimatedFactors,
    NoiseEvidence,
    estimate_factors,
    robust_squares,
)
from rotcal_ros.adjust.robust_start import robust_start
from rotcal_ros.adjust.scattering import FLOOR
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import DataError, ObservabilityError, RotcalError
from rotcal_ros.foundation.language import join_texts, phrase

TIED: Final = 1e-6
"""Difference of two supports, or improbabilities, that is rounding: the first asked goes first."""
SCATTER_ROUNDS: Final = 3
"""Times that a scatter is estimated, and all is judged by it."""
MANY: Final = 0.25
"""Part of a group from which on those that are left do not tell surely which ones are off."""
FEW_EFFECTS: Final = 3
"""Effects that are taken up, one after the other, instead of larger noise."""
GENEROUSLY: Final = 3.0
"""Times what few effects explain each that they may explain together."""


def diagnose_causes(model: Model, limits: Limits) -> Diagnosis:
    """Return what is believed when nothing significant is left unexplained.

    Gross errors wait outside from the start, and come back where they agree after all, or where
    something explains them together.
    """
    start, gross = robust_start(model, limits)
    whole = Diagnosis(model, limits, Noise(np.ones(len(model.components))), start)
    if not model.scatterings:
        return _beside_gross(whole, gross)
    explained = _beside_gross(whole, gross) if len(gross) else None
    return _with_scatter(whole, explained)


def start_diagnosis(model: Model, limits: Limits) -> Diagnosis:
    """Return where the adjustment starts: gross errors wait outside, nothing else is judged."""
    start, gross = robust_start(model, limits)
    return _outside(Diagnosis(model, limits, Noise(np.ones(len(model.components))), start), gross)


def _with_scatter(whole: Diagnosis, explained: Diagnosis | None) -> Diagnosis:
    """Return what is believed once what scatters is weighed by the size that is likely.

    Before, it was weighed by a size that nobody would overlook, or as stated; what was
    ``explained`` so stays.
    """
    diagnosis = (explained or whole).with_likely_scatter
    for judged in range(SCATTER_ROUNDS):
        fit, model = diagnosis.fit, diagnosis.model
        sizes = [fit.sizes[each].median_size for each in model.scatterings]
        if not judged:
            sizes = _least_sizes(diagnosis, sizes)
        if explained and diagnosis.weighs(sizes):
            break
        again = replace(diagnosis, model=model.scattered(sizes), start=fit.x)
        diagnosis = explained = _explained(again)
    return diagnosis


def _least_sizes(diagnosis: Diagnosis, sizes: Sequence[float]) -> list[float]:
    """Return sizes of what scatters beside effects that scatter would hardly pass for.

    These are asked for as if nothing scattered: else it would take up what they do.
    """
    fit, model, found = diagnosis.fit, diagnosis.model, list(sizes)
    least = [FLOOR * fit.sizes[each].noticed for each in model.scatterings]
    if np.allclose(sizes, least) or not model.effects:
        return found
    calm = replace(diagnosis, model=model.scattered(least))
    limit = diagnosis.limits.of_each_effect(model)
    look = SolutionView(calm, calm.fitted(np.ones(len(model.components)), fit.x))
    for best, *others in look.effects:
        assert best.effect is not None
        errors = np.where(fit.used[:, None], best.columns / fit.std[:, None], 0.0)
        among = best.effect.at(fit.computed).shape[1] // best.effect.width if others else 1
        for k, each in enumerate(model.scatterings):
            if each.stated is not None:
                continue  # it is weighed as stated, and what contradicts that is not an effect yet
            chance, beside = each.beside(fit, errors)
            # an effect that reaches all contrasts leaves none that tell of the size
            if beside.contrasts and chance * among < limit:
                found[k] = min(found[k], beside.median_size)
    return found


def _beside_gross(whole: Diagnosis, gross: Ints) -> Diagnosis:
    """Return what is believed where ``gross`` observations (k,) wait outside."""
    if not len(gross):
        return _explained(whole)
    try:
        apart = _come_back(_explained(_outside(whole, gross)), gross)
    except ObservabilityError:
        return _explained(whole)  # so many that unknowns are open without them
    try:
        together = _explained(whole)
    except RotcalError:
        return apart  # gross errors in all directions let nothing settle
    if not _same(apart, together) and apart.bic < together.bic - TIED:
        return _contested_by(apart, together)
    return _contested_by(together, apart)  # it says what else may be wrong


def _same(first: Diagnosis, second: Diagnosis) -> bool:
    """Whether two diagnoses leave out the same observations and hold the same effects."""
    held, others = ([e.what for e in each.nuisance] for each in (first, second))
    return first.why.keys() == second.why.keys() and held == others


def _contested_by(best: Diagnosis, other: Diagnosis) -> Diagnosis:
    """Return the ``best`` of two diagnoses, and that the ``other`` is possible where it is."""
    apart, change = other.bic - best.bic, other.fit.value - best.fit.value
    if apart >= 2.0 * np.log(ALIKE) or not best.fit.influenced(change):
        return best
    none, nothing = np.zeros((len(best.used), 0)), np.zeros(0, dtype=np.int64)
    chosen = Explanation(best.describe(), join_texts(()), none, nothing, 0.0, 0.0, 0.0 * change)
    rival = chosen._replace(what=other.describe(), support=-0.5 * apart, change=change)
    return replace(best, contests=(*best.contests, ContestedExplanation(chosen, (rival,))))


def _outside(diagnosis: Diagnosis, gross: Ints) -> Diagnosis:
    name = diagnosis.model.name_of_row
    why = {row: phrase("{0}: far off all others", name(row)) for row in gross.tolist()}
    return replace(diagnosis, why=why, price=_price(diagnosis.model, gross))


def _price(model: Model, rows: Ints) -> float:
    """Return the price of ``rows`` that explain themselves, by elements among all."""
    elements = len(np.unique(model.of_element[rows]))
    among = 2 * elements * np.log(max(model.rejectable_elements, 1))
    return float(len(rows) * np.log(len(model.observed)) + among)


def _come_back(diagnosis: Diagnosis, gross: Ints) -> Diagnosis:
    """Return the diagnosis with those of the ``gross`` observations that agree after all."""
    model, fit = diagnosis.model, diagnosis.fit
    squares, rank = fit.element_test
    agrees = squares <= diagnosis.limits.of_squares(model, rank)
    back = gross[agrees[model.of_element[gross]]].tolist()
    if not back:
        return diagnosis
    why = {row: text for row, text in diagnosis.why.items() if row not in back}
    price = diagnosis.price - _price(model, np.array(back))
    return _explained(replace(diagnosis, why=why, price=price))


def _explained(diagnosis: Diagnosis) -> Diagnosis:
    """Return what explains the residuals; effects may do so far better than larger noise.

    Far, for noise that is stated too small is no rare thing.
    """
    found = _explained_beside_noise(diagnosis)
    if found.noise.factors.max() <= 1.0 or diagnosis.model.unstated:
        return found
    other = _by_effects(diagnosis)
    if other is None:
        return found
    # what the unknowns take up says nothing of the noise: its restricted likelihood
    used = found.used
    taken_up = 1.0 - found.fit.redundancy[used]
    spread = 2.0 * taken_up @ np.log(found.noise.factors[found.model.of_component[used]])
    if other.bic < found.bic - spread - 2.0 * np.log(ALIKE):
        return other
    return found


def _by_effects(diagnosis: Diagnosis) -> Diagnosis | None:
    """Return how few effects explain what else had to be noise; None if they do not."""
    ones = np.ones(len(diagnosis.model.components))
    for left in range(FEW_EFFECTS, 0, -1):
        fit = diagnosis.fitted(ones, diagnosis.start)
        look = SolutionView(replace(diagnosis, noise=Noise(ones), start=fit.x), fit)
        most = sum(sorted(look.squares)[-left:])
        if _excess(fit) > GENEROUSLY * most:
            return None
        best = _first(look.significant_effects(), look.before)
        if best is None:
            return None
        diagnosis = look.before.holding(best, look.rivals(best))
        if not _as_stated(diagnosis, diagnosis.fitted(ones, fit.x), bent=True):
            continue
        try:
            after = _explained_beside_noise(diagnosis)
        except DataError:
            return None  # it does not settle: no explanation
        if after.noise.estimated is None:
            return after
    return None


def _excess(fit: Fit) -> float:
    """Return by how much squared residuals exceed what noise as stated would make of them."""
    expected = float(fit.redundancy.sum())
    squares = float(robust_squares(fit.white**2, fit.redundancy, CHECKED).sum())
    return squares - expected - 3.0 * float(np.sqrt(2.0 * expected))


def _explained_beside_noise(diagnosis: Diagnosis) -> Diagnosis:
    bent = True
    while True:
        noise, fit, bent = _noise_and_fit(diagnosis, bent)
        # what was judged before is judged anew: large groups are not kept twice
        gathering = replace(diagnosis.gathering, judgement=None)
        diagnosis = replace(diagnosis, noise=noise, start=fit.x, gathering=gathering)
        look = SolutionView(diagnosis, fit)
        diagnosis = look.diagnosis
        best = _first(look.significant(), diagnosis)
        if best is not None:
            diagnosis = diagnosis.holding(best, look.rivals(best))
        elif (together := _together(diagnosis.solved(fit))) is not None:
            diagnosis = together
        elif not bent:
            return diagnosis.solved(fit)
        elif noise.estimated is None and _as_stated(diagnosis, fit, bent=False):
            return diagnosis.solved(fit)  # whole squares show the same
        else:
            bent = False


def _together(diagnosis: Diagnosis) -> Diagnosis | None:
    """Return that what was left out of one group, one by one, is off together; None: it is not.

    Which of them go first, noise decides: where they are many it is asked again, with all of them,
    who is to blame.
    """
    model, alone = diagnosis.model, ~diagnosis.used
    for case in diagnosis.gathering.blamed:
        alone[model.rows_of(case.group.members[case.subset])] = False
    for grouping in (g for g in model.groupings if g.gathers):
        for number in np.unique(grouping.number[alone & (grouping.number >= 0)]).tolist():
            back = np.flatnonzero(alone & (grouping.number == number))
            whole = model.of_element[(grouping.number == number) & model.rejectable]
            gone, every = (len(np.unique(each)) for each in (model.of_element[back], whole))
            if not max(2, MANY * every) <= gone <= 0.5 * every:
                continue
            why = {row: text for row, text in diagnosis.why.items() if row not in back}
            price = diagnosis.price - _price(model, back)
            before = replace(diagnosis, why=why, price=price)
            found = SolutionView(before, before.fit).together(grouping.name_of(number))
            if found is None or not _bearable(before, found):
                continue
            other = before.holding(found)
            if other.bic <= diagnosis.bic:
                return other
    return None


def _first(found: Iterable[Explanation], diagnosis: Diagnosis) -> Explanation | None:
    """Return the most probable explanation that a ``diagnosis`` can hold; None: there is none."""
    ordered = sorted(found, key=lambda e: -round(e.support / TIED))
    return next((e for e in ordered if _bearable(diagnosis, e)), None)


def _bearable(diagnosis: Diagnosis, found: Explanation) -> bool:
    """Whether what is left with an explanation still determines the unknowns, and settles."""
    after = diagnosis.holding(found)
    try:
        after.fitted(diagnosis.noise.factors, diagnosis.start)
    except (DataError, ObservabilityError):
        return False
    return bool(after.used.any())


def _noise_and_fit(diagnosis: Diagnosis, bent: bool) -> tuple[Noise, Fit, bool]:
    """Return the noise, the fit with it, and whether large residuals are still bent for it."""
    stated = diagnosis.fitted(np.ones(len(diagnosis.model.components)), diagnosis.start)
    noise, fit = _settled_noise(diagnosis, stated, bent)
    if not bent or noise.estimated is None:
        return noise, fit, bent
    x = fit.x
    del fit  # two solutions are enough to keep
    whole, fit = _settled_noise(replace(diagnosis, noise=noise), stated, bent=False)
    if _alike(noise, whole):  # nothing bends it
        return whole, fit, False
    return noise, diagnosis.fitted(noise.factors, x), bent


def _settled_noise(diagnosis: Diagnosis, stated: Fit, bent: bool) -> tuple[Noise, Fit]:
    """Return the noise as in the fit ``stated``, or estimated where that is contradicted; its fit.

    ``bent``: large residuals count no more than some, while outliers are about. A component that
    scatters less than any instrument is exact, made-up data: its statement stays. Where nothing
    is stated, it has the least noise that the model admits.
    """
    model, ones = diagnosis.model, np.ones(len(diagnosis.model.components))
    least = model.least_factors if model.unstated else ones
    if _as_stated(diagnosis, stated, bent):
        return Noise(ones), stated
    evidence = _evidence(stated, bent)
    checked = (evidence.redundancy > LEAST_REDUNDANCY) & evidence.present
    read = np.isin(np.arange(len(ones)), model.of_component[model.rejectable])
    held, fit, factors = np.zeros(len(ones), dtype=np.bool_), stated, diagnosis.noise.factors
    if diagnosis.noise.estimated is not None:  # what was exact is so still
        held = evidence.present & np.isnan(diagnosis.noise.estimated.log_std)
    while True:
        start = np.where(held, least, factors)
        found, fit = _estimated_noise(diagnosis, fit, start, bent, held)
        lowest = least if model.unstated else LEAST_FACTOR
        exact = ~held & (found.factors < lowest * (1.0 + 1e-9))
        if not exact.any():
            return Noise(found.factors, found), fit
        held, factors = held | exact, found.factors
        if held[checked & read].all():  # what is stated beside made-up data stays, too
            return Noise(least), diagnosis.fitted(least, stated.x) if model.unstated else stated


def _alike(bent: Noise, whole: Noise) -> bool:
    """Whether two estimates of the noise agree as well as they are known."""
    if bent.estimated is None or whole.estimated is None:
        return False
    apart = np.abs(np.log(whole.factors / bent.factors))
    return not (apart > bent.estimated.log_std).any()  # NaN, absent, does not matter


def _as_stated(diagnosis: Diagnosis, fit: Fit, bent: bool) -> bool:
    """Whether a fit with the noise as stated contradicts no component of it."""
    if diagnosis.model.unstated:
        return False
    chance = _evidence(fit, bent).probabilities()
    return bool(chance.min() >= diagnosis.limits.significance / len(chance))


def _estimated_noise(
    diagnosis: Diagnosis, near: Fit, start: Floats, bent: bool, held: Bools
) -> tuple[EstimatedFactors, Fit]:
    """Return the factors of the components but those that are ``held`` (c,), from a ``start``.

    Other weights hardly move the solution: its derivatives are those of one ``near``, but at the
    end.
    """
    model = diagnosis.model
    lowest = model.least_factors if model.unstated else np.full(len(held), LEAST_FACTOR)

    x = near.x

    def at(factors: Floats) -> NoiseEvidence:
        nonlocal x  # of the solution itself no more is kept
        fit = near.weighed_by(model.std * factors[model.of_component])
        x, evidence = fit.x, _evidence(fit, bent)
        return replace(evidence, present=evidence.present & ~held)

    prior = np.eye(len(held)) / (UNKNOWN if model.unstated else PRIOR) ** 2
    settled = NEARLY_SETTLED if bent else SETTLED
    found = estimate_factors(at, start, prior, settled, lowest)
    return found, diagnosis.fitted(found.factors, x)


def _evidence(fit: Fit, bent: bool) -> NoiseEvidence:
    """Return what the residuals say of each component of the noise."""
    model, squares, redundancy = fit.model, fit.white**2, fit.redundancy
    if bent:
        squares = robust_squares(squares, redundancy, CHECKED)
    part, information = fit.redundancy_between
    present = part.any(axis=1) & ~model.of_scatter
    mine = (part * np.sqrt(squares) * np.sign(fit.white)).T
    average = mine.T @ fit.residuals_of(mine)
    return NoiseEvidence(present, part @ squares, part @ redundancy, information, average)
