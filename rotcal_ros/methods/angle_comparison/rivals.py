"""What may be numbered or signed otherwise than stated, and whether the readings would show it.

A reference that stood one face farther than was written down, two settings that were exchanged, a
certificate that is read backwards: each is a model of its own, a *rival*. Where it explains the
readings as well as what is stated, and moves the result, they cannot tell which of the two is
true. Two settings alone never can: each order of the table then has as many unknowns as readings.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import chi2_sf
from rotcal_ros.adjust.engine import Adjusted
from rotcal_ros.adjust.fit import Fit, fit_model
from rotcal_ros.adjust.model import Model
from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.foundation.language import Phrase, join_texts, noted, phrase
from rotcal_ros.foundation.protection import TOLERABLE, Effect, Protection
from rotcal_ros.foundation.units import DEGREE, TURN
from rotcal_ros.methods.angle_comparison.model import (
    Circles,
    known_reference,
    lost_orders,
    model_of,
)
from rotcal_ros.methods.angle_comparison.settings import (
    SIGNS,
    ComparisonPlanSettings,
    ComparisonSolverSettings,
)
from rotcal_ros.planning.readings import Readings

COUNT: Final = noted("readings count {0}")
STOOD_AT: Final = noted("setting {0} stood at {1:g} deg, not at {2:g}")

READ: Final = 8000
"""Readings that are solved again for rivals, one after the other."""
LEAST, MOST = 4, 40
"""Rivals that are tried of very many readings, and of few."""


@dataclass(frozen=True)
class Rival:
    """What else may be true: ``what``, the ``effect`` that it is, and how it would be stated."""

    effect: Effect
    what: Phrase
    plan: ComparisonPlanSettings
    solver: ComparisonSolverSettings


def rivals_of(plan: ComparisonPlanSettings, solver: ComparisonSolverSettings) -> Iterator[Rival]:
    """Yield all rivals, those first that differ least from what is stated."""
    circles = Circles.of(plan)
    stated, certified = solver.reference_errors_arcsec, known_reference(solver, circles)
    if not certified and len(plan.shifts_deg) < 2:
        return  # the reference is taken for perfect: it has no numbers
    for counting in SIGNS.keys() - {solver.readings_count} if certified else ():
        counted = replace(solver, readings_count=counting)
        yield Rival("sign of readings", phrase(COUNT, phrase(counting)), plan, counted)
    for what, errors in (
        (phrase("the signs of the certificate are reversed"), tuple(-e for e in stated)),
        (
            phrase("the certificate lists its angles the other way round"),
            stated[:1] + stated[:0:-1],
        ),
    )[: 2 * certified]:
        yield Rival("gauge", what, plan, replace(solver, reference_errors_arcsec=errors))
    for what, shifts in _shifts_of(plan.shifts_deg, circles, certified):
        yield Rival("numbering", what, replace(plan, shifts_deg=shifts), solver)


def _shifts_of(
    stated: Sequence[float], circles: Circles, certified: bool
) -> Iterator[tuple[Phrase, tuple[float, ...]]]:
    """Yield other shifts, deg, by steps of the marks; of one setting all others are relative."""
    count = round(TURN / np.diff(circles.marks, append=circles.marks[0] + TURN).min())
    step = 360.0 / count
    low = 0.0 if min(stated) >= 0.0 else -180.0
    first = 0 if certified or len(stated) > 2 else 1

    def moved(by: int) -> Iterator[tuple[Phrase, tuple[float, ...]]]:
        for k in range(first, len(stated)):
            there = low + (stated[k] + by * step - low) % 360.0
            what = phrase(STOOD_AT, k, there, stated[k])
            yield what, (*stated[:k], there, *stated[k + 1 :])

    for by in (1, -1):
        yield from moved(by)
    yield phrase("the shifts count the other way round"), tuple(-shift for shift in stated)
    for k, other in combinations(range(len(stated)), 2):
        swapped = list(stated)
        swapped[k], swapped[other] = stated[other], stated[k]
        yield phrase("settings {0} and {1} are exchanged", k, other), tuple(swapped)
    for by in range(2, count // 2 + 1):
        yield from moved(by)
        yield from moved(-by)


@dataclass(frozen=True, eq=False)
class Rivalry:
    """What rivals make of readings that were solved as stated.

    ``open``: by effect, what explains them as well and moves the result; None: nothing does;
    empty: none could be solved.
    ``better``: what explains all of them where the statement does not.
    """

    open: dict[Effect, Phrase | None]
    better: Sequence[Phrase] = ()

    def protections(self) -> Iterator[Protection]:
        """Yield whether the readings show each of the effects."""
        for effect, what in self.open.items():
            if what is None:
                yield Protection(
                    effect, "tested", phrase("the readings contradict other statements")
                )
            elif what:
                why = phrase("the readings fit as well if {0}, which gives another result", what)
                yield Protection(effect, "not protected", why)
            else:
                yield Protection(
                    effect, "not protected", phrase("at these angles nothing else is solved")
                )


def rivalry(
    plan: ComparisonPlanSettings, solver: ComparisonSolverSettings, read: Readings, found: Adjusted
) -> Rivalry:
    """Return which rivals the readings cannot tell from what was stated.

    A rival is excluded where what is stated is as many times as probable as a test is rarely
    wrong.
    """
    limits, fit = found.diagnosis.limits, found.fit
    counts = found.std > 0.0
    tolerable = TOLERABLE * found.std[counts]
    count = min(max(READ // len(read.value), LEAST), MOST)
    needed = 2.0 * float(np.log(1.0 / limits.significance)) * found.scale**2
    open_: dict[Effect, Phrase | None] = {}
    certified = known_reference(solver, Circles.of(plan))
    better: list[Phrase] = []
    sound = found.verdict == "ok" or _chance(found.model) > limits.significance
    for _, rival in zip(range(count), rivals_of(plan, solver), strict=False):
        circles = Circles.of(rival.plan)
        if not certified and lost_orders(circles, np.array(rival.plan.shifts_deg) * DEGREE):
            continue  # others show what it would
        shown = circles.shown[read.station, read.position]
        model = model_of(rival.plan, rival.solver, replace(read, target=shown))
        if model.size[0] != found.model.size[0]:
            continue  # a certificate of other angles
        open_.setdefault(rival.effect, join_texts(()))
        if not sound and _chance(model) > limits.significance:
            better.append(rival.what)
        if open_[rival.effect] or (other := _solved(model, found)) is None:
            continue
        moved = np.abs(other.value[: len(counts)] - found.value)[counts]
        if other.chi2 - fit.chi2 < needed and (moved > tolerable).any():
            open_[rival.effect] = rival.what
        elif not open_[rival.effect]:
            open_[rival.effect] = None
    return Rivalry(open_, better)


def _solved(model: Model, found: Adjusted) -> Fit | None:
    """Return the solution of a rival ``model`` with what was believed; None where it has none."""
    extra = (e.columns for e in found.diagnosis.nuisance)
    columns = np.column_stack([np.zeros((model.size[0], 0)), *extra])
    try:
        fit = fit_model(model, found.fit.used, found.fit.std, model.first, columns)
        return fit if fit.kernel.rank else None
    except RotcalError:
        return None


def _chance(model: Model) -> float:
    try:
        fit = fit_model(model, np.ones(model.size[0], dtype=np.bool_), model.std, model.first)
        return chi2_sf(fit.chi2, fit.dof) if fit.dof else 1.0
    except RotcalError:
        return 0.0
