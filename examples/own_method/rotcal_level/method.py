"""The levels, as nodes, replay and report see them: plan, result, what else is said of it."""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_level.model import model_of
from rotcal_level.settings import LevelPlanSettings, LevelSimulationSettings, LevelSolverSettings
from rotcal_level.simulation import SimulatedLevels
from rotcal_ros.adjust.engine import Adjusted
from rotcal_ros.adjust.model import Model
from rotcal_ros.foundation.curves import gauge
from rotcal_ros.foundation.errors import ConfigurationError, PlanError
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.protection import Protection
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods.by_model import ByModel, Statement
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.disturbance import harmless, of_readings, repeatability
from rotcal_ros.methods.figures.residuals import residual_figures
from rotcal_ros.methods.measurements import planned_table
from rotcal_ros.planning.plan import Plan, numbered_steps, pauses_at_stations
from rotcal_ros.planning.readings import Readings
from rotcal_ros.planning.table_angles import table_angles

NAME: Final = "level"
PARALLEL: Final = 1e-6
"""Sine of the angle between levels that read along one line."""
ARRIVALS: Final = 1.4
"""What arrivals that scatter do unseen, per what noise does: as `rotcal plan power` finds."""
FARTHEST_RAD: Final = 0.02
"""No level reads more than a degree."""


def plan(configuration: Configuration) -> Plan:
    """Return the plan: ``station`` is a setting of the levels, ``target`` a level in a setting.

    Raises ConfigurationError for settings that contradict each other, PlanError for levels or
    angles that do not determine EAC and EBC.
    """
    settings: LevelPlanSettings = configuration.plan
    angles, azimuths, levels = table_angles(settings), settings.azimuths_deg, settings.levels
    n, k, source = len(angles), len(azimuths), configuration.source
    if not k or k % levels:
        raise ConfigurationError(
            f"{source}: plan.azimuths_deg: {k} azimuths for {levels} levels: expected one for "
            "each level in each setting"
        )
    if n < 3:
        raise PlanError(
            f"{source}: {n} table angles tell nothing of EAC and EBC: measure at 3 or more"
        )
    if (np.abs(np.sin((np.array(azimuths) - azimuths[0]) * DEGREE)) < PARALLEL).all():
        raise PlanError(
            f"{source}: levels at azimuths {list(azimuths)} read along one line, and tell EAC and "
            "EBC in one combination only: add a second level at 90 deg to the first, or a setting "
            "with the level turned by 90 deg"
        )
    stops = [*range(n), *[0] * settings.closing]
    rows = (
        (position, setting * levels + level, setting)
        for setting in range(k // levels)
        for position in stops
        for level in range(levels)
    )
    targets, points = ((0.0, 0.0, 0.0),) * k, settings.readings
    steps = numbered_steps(rows, angles, targets, PointKind.READING, n_points=points)
    begin = f"with the table at {angles[0] / DEGREE:g} deg put the levels so that they point to"
    instructions = [
        f"setting {first // levels} of {k // levels}: {begin} "
        f"{', '.join(f'{a:g}' for a in azimuths[first : first + levels])} deg"
        for first in range(0, k, levels)
    ]
    return Plan(NAME, angles, targets, steps, pauses_at_stations(steps, "levels", instructions))


def model(configuration: Configuration, read: Readings) -> Model:
    """Return what was read, for the engine."""
    return model_of(configuration.plan, configuration.solver, read)


def states(
    configuration: Configuration, _read: Readings, found: Adjusted, _stated: Configuration
) -> Statement:
    """Return what is done about effects that no reading can show."""
    seen = "mean values, and what turns with the table, are no part of the curves"
    wrong = "readings that count the other way round fit as well, and turn the sign of the result"
    return Statement(protections=(
        Protection("error motion", "harmless", phrase("a level sees no shift")),
        Protection("refraction", "harmless", phrase("a level has no line of sight")),
        Protection("tilt", "estimated", phrase("it is what is measured")),
        Protection("gauge", "harmless", seen),
        Protection("sign of readings", "not protected", wrong),
        _arrivals(configuration, found),
    ))  # fmt: skip


def _arrivals(configuration: Configuration, found: Adjusted) -> Protection:
    settings: LevelPlanSettings = configuration.plan
    if settings.levels == len(settings.azimuths_deg):
        return Protection("repeatability", "not protected", phrase("each angle is reached once"))
    noise = next(p.error for p in found.protections() if p.effect == "axis noise")
    error = None if noise is None else ARRIVALS * noise
    return Protection(
        "repeatability", "tested", phrase("every setting comes to every angle"), error
    )


METHOD: Final = ByModel(
    NAME, model, states, lambda _configuration: ("EAC", "EBC"), counts_from="mean"
).method(
    title="Electronic levels on the table",
    page="level",
    plan_settings=LevelPlanSettings,
    solver_settings=LevelSolverSettings,
    simulation_settings=LevelSimulationSettings,
    simulated_instrument=SimulatedLevels,
    plan=plan,
    gauge=gauge.without_axis_and_artefact,
    zero=gauge.describe,
    table=planned_table(
        {"position": "table_position", "level": "target"}, {"reading_rad": FARTHEST_RAD}
    ),
    figures=lambda result, _truth: residual_figures(result, ARCSEC, "arcsec"),
    disturbances=(
        *of_readings(0.05, 20.0),
        repeatability(0.02, 10.0),
        *harmless("error motion", "refraction", "tilt", "gauge"),
    ),
)
