"""The comparison of two circles, as nodes, replay and report see it: plan, result, figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust.engine import Adjusted
from rotcal_ros.adjust.model import Model
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import ConfigurationError, ObservabilityError
from rotcal_ros.foundation.observations import Observation, PointKind
from rotcal_ros.foundation.protection import Protection
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods.angle_comparison.model import (
    REFERENCE,
    Circles,
    known_reference,
    lost_orders,
    model_of,
)
from rotcal_ros.methods.angle_comparison.settings import (
    SIGNS,
    ComparisonPlanSettings,
    ComparisonSimulationSettings,
    ComparisonSolverSettings,
)
from rotcal_ros.methods.angle_comparison.simulation import SimulatedComparison
from rotcal_ros.methods.arrivals import Arrivals, arrivals_of
from rotcal_ros.methods.by_model import ByModel, Statement
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.disturbance import harmless, of_readings, repeatability
from rotcal_ros.methods.figures import Figure, style
from rotcal_ros.methods.figures.residuals import residual_figures
from rotcal_ros.methods.measurements import planned_table
from rotcal_ros.planning.plan import Plan, numbered_steps, pauses_at_stations
from rotcal_ros.planning.readings import Readings
from rotcal_ros.planning.table_angles import table_angles

NAME: Final = "angle_comparison"
NOWHERE: Final = (0.0, 0.0, 0.0)
"""The instrument stays where it is."""
ARRIVALS: Final = 1.4
"""What arrivals that scatter do before they are found, per what noise does: by simulation of the
demonstration, as scripts/power_table.py does."""
FARTHEST_RAD: Final = 0.02
"""No instrument for small angles reads more than a degree."""


def plan(configuration: Configuration) -> Plan:
    """Return the plan: ``station`` is the setting of the reference, ``target`` its mark.

    Raises ConfigurationError for settings that contradict each other, PlanError for angles that
    do not ascend. Whether the shifts separate the two circles :func:`model` shows.
    """
    settings: ComparisonPlanSettings = configuration.plan
    circles = Circles.of(settings)
    _check(configuration, circles)
    rows = (
        (position, mark, setting)
        for setting, marks in enumerate(circles.shown.tolist())
        for position, mark in enumerate(marks)
    )
    targets = (NOWHERE,) * len(circles.marks)
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


def _check(configuration: Configuration, circles: Circles) -> None:
    plan, source = configuration.plan, configuration.source
    stated, marks = configuration.solver.reference_errors_arcsec, len(circles.marks)
    if not plan.shifts_deg:
        raise ConfigurationError(f"{source}: plan.shifts_deg: state at least one shift, such as 0")
    if stated and len(stated) != marks:
        raise ConfigurationError(
            f"{source}: solver.reference_errors_arcsec: {len(stated)} values, but with these "
            f"table angles and shifts the reference shows {marks} angles: state one for each"
        )


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


def states(configuration: Configuration, _read: Readings, found: Adjusted) -> Statement:
    """Return what is doubted, and what is done about effects that no reading can show."""
    gauge, doubts = Protection("gauge", "estimated", "the shifts separate the two circles"), []
    if REFERENCE not in found.also:
        gauge = Protection("gauge", "not protected", "the reference's errors are in the result")
        doubts.append(
            "the errors of the reference are in the result: there is one shift and no "
            "certificate; add shifts, or solver.reference_errors_arcsec"
        )
    elif configuration.solver.reference_errors_arcsec:
        gauge = Protection("gauge", "bounded", "the reference's errors have a certificate")
    return Statement(doubts, (*_unread(), _arrivals(found), gauge), _details(configuration))


def _details(configuration: Configuration) -> dict[str, Any]:
    """Return the angles that the reference shows, rad, beside their errors."""
    return {"reference_angles": Circles.of(configuration.plan).marks}


def _unread() -> Iterator[Protection]:
    yield Protection("error motion", "harmless", "an instrument for angles sees no shift")
    yield Protection("refraction", "harmless", "a steady bend is the same at all angles")
    yield Protection("tilt", "harmless", "tilts of the table turn about axes that are not read")
    yield Protection(
        "sign of readings",
        "not protected",
        "readings that count the other way round fit as well, and turn the sign of the result",
    )


def _arrivals(found: Adjusted) -> Protection:
    settings = found.model.groupings[0].number
    if len(np.unique(settings[settings >= 0])) == 1:
        return Protection("repeatability", "not protected", "the table comes once to an angle")
    noise = next(p.error for p in found.protections() if p.effect == "axis noise")
    error = None if noise is None else ARRIVALS * noise
    return Protection("repeatability", "tested", "every setting comes to every angle", error)


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


def arrivals(configuration: Configuration) -> Arrivals | None:
    """Return the arrivals of a plan that measures both directions."""
    plan: ComparisonPlanSettings = configuration.plan
    if not plan.bidirectional:
        return None
    return arrivals_of(table_angles(plan), runs=1, bidirectional=True)


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


@style.styled
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
    arrivals=arrivals,
    sign=lambda configuration: SIGNS[configuration.solver.readings_count],
).method(
    title="Two circles: polygon, indexing table or encoder beside the table",
    page="angle_comparison",
    plan_settings=ComparisonPlanSettings,
    solver_settings=ComparisonSolverSettings,
    simulation_settings=ComparisonSimulationSettings,
    simulated_instrument=SimulatedComparison,
    plan=plan,
    check=check,
    table=planned_table(
        {"position": "table_position", "setting": "station"}, {"reading_rad": FARTHEST_RAD}
    ),
    figures=figures,
    disturbances=(
        *of_readings(0.05, 20.0),
        repeatability(0.02, 10.0),
        *harmless("error motion", "refraction", "tilt", "gauge"),
    ),
)
