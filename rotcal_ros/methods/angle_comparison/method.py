"""The comparison of two circles, as nodes, replay and report see it: plan, result, figures.

What may be numbered or signed otherwise than stated, and whether the readings would show it.

A reference that stood one face farther than was written down, two settings that were exchanged, a
certificate that is read backwards: each is a model of its own, a *rival*. Where it explains the
readings as well as what is stated, and moves the result, they cannot tell which of the two is
true. Two settings alone never can: each order of the table then has as many unknowns as readings.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial, reduce
from itertools import combinations
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust.distributions import chi2_sf
from rotcal_ros.adjust.engine import Adjusted, predicted
from rotcal_ros.adjust.fit import Fit, fit_model, require_determined
from rotcal_ros.adjust.model import Model, block_rows
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import ConfigurationError, ObservabilityError, RotcalError
from rotcal_ros.foundation.language import Phrase, join_texts, noted, phrase
from rotcal_ros.foundation.observations import Observation, PointKind
from rotcal_ros.foundation.protection import TOLERABLE, Effect, Protection
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE, TURN
from rotcal_ros.methods.angle_comparison.model import (
    REFERENCE,
    Circles,
    known_reference,
    lost_orders,
    model_of,
    readings_of,
)
from rotcal_ros.methods.angle_comparison.settings import (
    SIGNS,
    ComparisonPlanSettings,
    ComparisonSimulationSettings,
    ComparisonSolverSettings,
)
from rotcal_ros.methods.arrivals import bidirectional_arrivals
from rotcal_ros.methods.by_model import TRUE_SIZE, ByModel, Statement
from rotcal_ros.methods.configuration import Configuration, changed
from rotcal_ros.methods.disturbance import harmless, of_readings, repeatability
from rotcal_ros.methods.figures import Figure, style
from rotcal_ros.methods.figures.residuals import residual_figures
from rotcal_ros.methods.measurements import planned_table
from rotcal_ros.planning.plan import Plan, numbered_steps, pauses_at_stations
from rotcal_ros.planning.readings import Readings

COUNT: Final = noted("readings count {0}")
STOOD_AT: Final = noted("setting {0} stood at {1:g} deg, not at {2:g}")

READ: Final = 8000
"""Readings that are solved again for rivals, one after the other."""
LEAST, MOST = 4, 40
"""Rivals that are tried of very many readings, and of few."""
ALL_FIT_IF: Final = noted("all readings fit if {0}: correct what is stated")
REFERENCE_IN_RESULT: Final = noted(
    "the errors of the reference are in the result: there is one shift and no certificate; add "
    "shifts, or solver.reference_errors_arcsec"
)

NAME: Final = "angle_comparison"
NOWHERE: Final = (0.0, 0.0, 0.0)
"""The instrument stays where it is."""
ARRIVALS: Final = 1.4
"""What arrivals that scatter do before they are found, per what noise does: by simulation of the
demonstration, as research/power_table.py does."""
MOST_NAMED: Final = 4
"""Statements that would fit better, to be told."""
CANDIDATES: Final = 36
"""Shifts of one more setting that are compared."""
FARTHEST_RAD: Final = 0.02
"""No instrument for small angles reads more than a degree."""


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


def plan(configuration: Configuration) -> Plan:
    """Return the plan: ``station`` is the setting of the reference, ``target`` its mark.

    Raises ConfigurationError for settings that contradict each other, PlanError for angles that
    do not ascend. Whether the shifts separate the two circles :func:`model` shows.
    """
    settings: ComparisonPlanSettings = configuration.plan
    circles = Circles.of(settings)
    source, marks = configuration.source, len(circles.marks)
    if not settings.shifts_deg:
        raise ConfigurationError(f"{source}: plan.shifts_deg: state at least one shift, such as 0")
    stated = configuration.solver.reference_errors_arcsec
    if stated and len(stated) != marks:
        raise ConfigurationError(
            f"{source}: solver.reference_errors_arcsec: {len(stated)} values, but with these "
            f"table angles and shifts the reference shows {marks} angles: state one for each"
        )
    rows = (
        (position, mark, setting)
        for setting, shown in enumerate(circles.shown.tolist())
        for position, mark in enumerate(shown)
    )
    targets = (NOWHERE,) * marks
    steps = numbered_steps(
        rows, circles.angles, targets, PointKind.READING,
        approaches=circles.approaches, n_points=settings.readings,
    )  # fmt: skip
    instructions = [
        f"setting {number} of {len(settings.shifts_deg)}: shift the reference so that it shows "
        f"its zero with the table at {shift:g} deg"
        for number, shift in enumerate(settings.shifts_deg)
    ]
    pauses = pauses_at_stations(steps, "reference", instructions) if settings.by_hand else ()
    return Plan(NAME, circles.angles, targets, steps, pauses)


def model(configuration: Configuration, read: Readings) -> Model:
    """Return what was read, for the engine; ObservabilityError for an order that is lost."""
    settings: ComparisonPlanSettings = configuration.plan
    circles, solver = Circles.of(settings), configuration.solver
    lost = lost_orders(circles, np.array(settings.shifts_deg) * DEGREE)
    if lost and len(settings.shifts_deg) > 1 and not known_reference(solver, circles):
        orders = ", ".join(map(str, lost[:12])) + (" and more" if len(lost) > 12 else "")
        raise ObservabilityError(
            f"nothing separates order {orders} of the table from that of the reference: add a "
            f"shift by one step of the table angles, {360.0 / len(circles.marks):g} deg"
        )
    return model_of(settings, solver, read)


def states(
    configuration: Configuration, read: Readings, found: Adjusted, _stated: Configuration
) -> Statement:
    """Return what is doubted, and what is done about effects that no reading can show."""
    rival, doubts = rivalry(configuration.plan, configuration.solver, read, found), []
    if REFERENCE not in found.further:
        doubts.append(phrase(REFERENCE_IN_RESULT))
    if rival.better:
        others = reduce(partial(phrase, "{0}, or if {1}"), rival.better[:MOST_NAMED])
        doubts.append(phrase(ALL_FIT_IF, others))
    stated = {p.effect: p for p in (*_unread(), _arrivals(found), _gauge(configuration, found))}
    for protection in rival.protections():
        if protection.treatment == "not protected" or protection.effect != "gauge":
            stated[protection.effect] = protection
    details = {"reference_angles": Circles.of(configuration.plan).marks}
    return Statement(doubts, tuple(stated.values()), details)


def _gauge(configuration: Configuration, found: Adjusted) -> Protection:
    if REFERENCE not in found.further:
        return Protection(
            "gauge", "not protected", phrase("the reference's errors are in the result")
        )
    if not configuration.solver.reference_errors_arcsec:
        return Protection("gauge", "estimated", phrase("the shifts separate the two circles"))
    bare = replace(configuration.solver, reference_errors_arcsec=())
    try:
        read = readings_of(configuration.plan)
        require_determined(model_of(configuration.plan, bare, read))
        checked = len(configuration.plan.shifts_deg) > 1
    except ObservabilityError:
        checked = False
    if checked:
        return Protection(
            "gauge", "bounded", phrase("the shifts check the certificate of the reference")
        )
    return Protection(
        "gauge", "not protected", phrase("nothing checks the certificate of the reference")
    )


def _unread() -> Iterator[Protection]:
    yield Protection("error motion", "harmless", phrase("an instrument for angles sees no shift"))
    yield Protection("refraction", "harmless", phrase("a steady bend is the same at all angles"))
    yield Protection(
        "tilt", "harmless", phrase("tilts of the table turn about axes that are not read")
    )
    yield Protection(
        "slip",
        "not protected",
        phrase(
            "a reference that gives way by the same whenever the table comes to an angle "
            "looks like the table"
        ),
    )
    yield Protection(
        "sign of readings",
        "not protected",
        phrase(
            "readings that count the other way round fit as well, and turn the sign of the result"
        ),
    )


def _arrivals(found: Adjusted) -> Protection:
    settings = found.model.groupings[0].number
    if len(np.unique(settings[settings >= 0])) == 1:
        return Protection("repeatability", "not protected", phrase("each angle is reached once"))
    noise = next(p.error for p in found.protections() if p.effect == "axis noise")
    error = None if noise is None else ARRIVALS * noise
    return Protection(
        "repeatability", "tested", phrase("every setting comes to every angle"), error
    )


def check(
    configuration: Configuration, planned: Plan, observations: Sequence[Observation]
) -> tuple[str, ...]:
    """Return in words that the newest setting is not aligned, by its first reading."""
    newest = max((o.station for o in observations), default=0)
    limit, begin = configuration.plan.alignment_arcsec, planned.table_angles[0] / DEGREE
    return tuple(
        f"setting {newest} reads {o.mean[0] / ARCSEC:.4g} arcsec at {begin:g} deg, more than "
        f"{limit:g}: align it again"
        for o in observations
        if (o.station, o.table_position) == (newest, 0) and abs(o.mean[0]) > limit * ARCSEC
    )


def drawn(configuration: Configuration, model: Model, random: np.random.Generator) -> Floats:
    """Return unknowns (p,) of a reference as certified, or as wrong as a table."""
    if "reference mark" not in model.blocks or not model.blocks["reference mark"]:
        return np.zeros(model.size[1])
    marks, solver = model.blocks["reference mark"], configuration.solver
    errors = TRUE_SIZE * ARCSEC * random.standard_normal(marks)
    if known_reference(solver, Circles.of(configuration.plan)):
        errors = np.array(solver.reference_errors_arcsec) * ARCSEC
        errors = errors + solver.reference_std_arcsec * ARCSEC * random.standard_normal(marks)
    return np.asarray(block_rows(model.blocks, "reference mark").T @ errors)


def one_more(configuration: Configuration) -> tuple[str, Configuration] | None:
    """Return the plan with the setting added that makes U smallest, and which it is."""
    plan, solver = configuration.plan, configuration.solver
    marks = len(Circles.of(plan).marks)
    steps = np.unique(np.linspace(1, marks - 1, min(marks - 1, CANDIDATES)).astype(int))
    found: list[tuple[float, float]] = []
    for shift in plan.shifts_deg[0] + 360.0 / marks * steps:
        more = replace(plan, shifts_deg=(*plan.shifts_deg, float(shift)))
        with suppress(ObservabilityError):
            expected = predicted(model_of(more, solver, readings_of(more)))
            found.append((round(float(expected.std.max()) / ARCSEC, 9), float(shift)))
    if not found:
        return None
    shifts = (*plan.shifts_deg, min(found)[1])
    return (
        f"one more setting, plan.shifts_deg [{', '.join(f'{s:g}' for s in shifts)}]",
        changed(configuration, [f"plan.shifts_deg={list(shifts)}"]),
    )


def figures(result: Result, _truth: Mapping[str, Any] | None) -> Sequence[Figure]:
    """Return the figures that only this method can fill."""
    return [
        Figure(
            "Errors of the reference",
            "Actual less nominal angle of the reference, k = 2; the mean is zero.",
            _reference(result.details),
        ),
        *residual_figures(result, ARCSEC, "arcsec"),
    ]


@style.house_style
def _reference(details: Mapping[str, Any]) -> str:
    if REFERENCE not in details["also"]:
        return ""
    found, angles = details["also"][REFERENCE], np.asarray(details["reference_angles"])
    error = np.asarray(found["value"]) / ARCSEC
    band = COVERAGE_FACTOR * np.asarray(found["std"]) / ARCSEC
    (ax,) = style.grid()
    ax.errorbar(angles / DEGREE, error, yerr=band, color=style.BLUE, fmt="o-", ms=3, capsize=2)
    ax.set_xlabel("angle of the reference / °")
    ax.set_ylabel("error of the reference / arcsec")
    return style.svg(ax)


METHOD: Final = ByModel(
    NAME,
    model,
    states,
    arrivals=lambda configuration: bidirectional_arrivals(configuration.plan),
    sign=lambda configuration: SIGNS[configuration.solver.readings_count],
    drawn=drawn,
).method(
    title="Two circles: polygon, indexing table or encoder beside the table",
    page="angle_comparison",
    plan_settings=ComparisonPlanSettings,
    solver_settings=ComparisonSolverSettings,
    simulation_settings=ComparisonSimulationSettings,
    simulated_instrument=plugins.lazy_load(
        "rotcal_ros.methods.angle_comparison.simulation:SimulatedComparison"
    ),
    plan=plan,
    check=check,
    table=planned_table(
        {"position": "table_position", "setting": "station"}, {"reading_rad": FARTHEST_RAD}
    ),
    figures=figures,
    set_by_hand=True,
    one_more=one_more,
    disturbances=(
        *of_readings(0.05, 20.0),
        repeatability(0.02, 10.0),
        *harmless("error motion", "refraction", "tilt", "gauge"),
    ),
)
