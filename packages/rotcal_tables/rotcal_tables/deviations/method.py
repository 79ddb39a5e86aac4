"""Deviations that are known already, as a method: the mean of the runs, their scatter, reversal.

A reading is a deviation, actual - commanded, with its own standard uncertainty or that of the
set-up. What is stated is the same in all runs at an angle, as the calibration of an instrument
is; the scatter of the runs about the mean of their side (ISO 230-2, with n - 1, pooled over all
angles) comes on top of it. Few degrees of freedom widen it by Student's t, so that k = 2 covers
95 % (JCGM 100, G.6.4).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import t_isf, t_sf
from rotcal_ros.capture.attempt import CaptureRules
from rotcal_ros.capture.decisions import decide_by_points, mean_point
from rotcal_ros.evaluation.combination import UNCHECKED
from rotcal_ros.evaluation.reference import UNCERTAINTIES, require_known_factor
from rotcal_ros.foundation.arrays import Floats, Ints, std_of
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.curves.measured import measured_curve
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.language import Phrase, noted, phrase
from rotcal_ros.foundation.observations import Observation, PointKind
from rotcal_ros.foundation.protection import EFFECTS, Protection
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.table_columns import ANGLE, UNITS
from rotcal_ros.foundation.table_reading import Reading
from rotcal_ros.foundation.tables import Row, Table, table_hashes
from rotcal_ros.foundation.units import ARCSEC, DEGREE, TURN
from rotcal_ros.methods.added_errors import with_steps
from rotcal_ros.methods.arrivals import Arrivals, arrivals_of, mean_of_runs
from rotcal_ros.methods.calibration import prepare
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.measurements import PlannedMeasurements, RowStepFinder, read_at
from rotcal_ros.methods.method import Method, TableReader
from rotcal_ros.planning.plan import Plan, numbered_steps
from rotcal_ros.planning.readings import Readings
from rotcal_ros.planning.table_angles import planned_arrivals, table_angles
from rotcal_tables.deviations.settings import (
    DeviationPlanSettings,
    DeviationSimulationSettings,
    DeviationSolverSettings,
)
from rotcal_tables.deviations.simulation import SimulatedIndexer
from rotcal_tables.sheets.deviations import ACTUAL_MINUS_COMMANDED, ask_sign
from rotcal_tables.sheets.words import ACTUAL, REVERSED

NAME: Final = "deviations"
DEVIATION: Final = "deviation_rad"
COLUMNS: Final = {"position": "table_position"}
LARGEST_RAD: Final = 10.0 * DEGREE
"""No table is farther off; more are degrees that were read as something else."""
COVERAGE: Final = 0.9545
"""Of k = 2, of a normal distribution."""
STRANGE: Final = 1e-3
"""Risk that sound runs are held to have a value that does not belong to them."""


def plan(configuration: Configuration) -> Plan:
    """Return the plan: one reading at each arrival; raises PlanError for angles that descend."""
    settings: DeviationPlanSettings = configuration.plan
    angles = table_angles(settings)
    every = planned_arrivals(len(angles), settings.runs, settings.bidirectional)
    stops = tuple(angles[visit.target] for visit in every)
    steps = numbered_steps(
        ((position, 0, 0) for position in range(len(every))), stops, ((0.0, 0.0, 0.0),),
        PointKind.READING, approaches=[visit.approach for visit in every],
        n_points=settings.readings,
    )  # fmt: skip
    return Plan(NAME, stops, ((0.0, 0.0, 0.0),), steps)


def solve(configuration: Configuration, plan: Plan, observations: Sequence[Observation]) -> Result:
    """Return the mean curve of all runs, and those of both sides, with their uncertainty.

    Raises DataError where neither the table nor the set-up states an uncertainty, and no runs
    show one.
    """
    settings: DeviationPlanSettings = configuration.plan
    read = Readings.of(observations)
    position, values = read.position, read.value
    arrivals = arrivals_of(
        table_angles(settings), settings.runs, bidirectional=settings.bidirectional
    ).take(position)
    scatter, dof = _scatter(values, arrivals)
    stated = read.points[:, 1] if read.points.shape[1] > 1 else np.zeros(len(values))
    stated = np.where(stated > 0.0, stated, configuration.solver.u_arcsec * ARCSEC)
    count = configuration.sheet.counts_per_turn
    if not scatter and not np.all(stated > 0.0):
        known = "what was measured twice is the same" if dof else "none was measured twice"
        raise DataError(
            f"{configuration.source}: nothing states how sure these deviations are, and {known}: "
            "add a column of standard uncertainties, or state one for all with "
            "--reference-u ARCSEC (k = 1), solver.u_arcsec"
        )
    # a whole count hides up to half a count, the same in all runs
    stated = np.hypot(stated, TURN / abs(count) / np.sqrt(12.0) if count else 0.0)
    wide = scatter * (t_isf((1.0 - COVERAGE) / 2.0, dof) / COVERAGE_FACTOR if dof else 0.0)
    same = arrivals.target[:, None] == arrivals.target
    covariance = np.outer(stated, stated) * same + wide**2 * np.eye(len(values))
    doubts = _strangers(values, arrivals, dof)
    protections = _protections(dof, 0 if np.ptp(plan.table_angles) >= TURN else count)
    result = Result(
        method=NAME,
        angles=np.array(plan.table_angles)[position],
        deviations={"ECC": values},
        std={"ECC": std_of(covariance)},
        covariance={"ECC": covariance},
        sigma0=1.0,
        dof=dof,
        n_observations=len(values),
        verdict="suspect" if doubts else "ok",
        warnings=(*doubts, *([] if dof else [UNCHECKED])),
        protections=tuple(protections),
    )
    if settings.runs > 1 or settings.bidirectional:
        result = mean_of_runs(result, arrivals, from_first=False)
        assert result.runs is not None
        result = replace(result, runs=replace(result.runs, repeatability_std=scatter))
    return with_steps(_closing(result, count) if len(result.angles) > 1 else result)


def _closing(result: Result, count: int) -> Result:
    """Return the result, suspect where deviations differ at one place of the table.

    ``count``: the counts that are stated for a turn, 0 for none.
    """
    try:
        measured_curve(result)
    except DataError as error:
        angles, values = result.angles, result.deviations["ECC"]
        last = int(np.argmax(angles))
        first = int(np.argmin(np.abs(angles[last] - TURN - angles)))
        shown = count * (1.0 + (values[last] - values[first]) / TURN)
        counts = [phrase("or a turn has {0} counts", round(shown))] if count else []
        return replace(
            result,
            warnings=(
                phrase("the table contradicts itself: {0}", error),
                *counts,
                *result.warnings,
            ),
        ).as_suspect()
    return result


def _scatter(values: Floats, arrivals: Arrivals) -> tuple[float, int]:
    """Return the pooled standard deviation (rad) of an arrival, and its degrees of freedom."""
    group = _sides(arrivals)
    count = np.bincount(group)
    mean = np.bincount(group, values) / np.maximum(count, 1)
    dof = int((count[count > 0] - 1).sum())
    return float(np.sqrt(np.sum((values - mean[group]) ** 2) / max(dof, 1))), dof


def _sides(arrivals: Arrivals) -> Ints:
    return np.asarray(2 * arrivals.target + arrivals.upward, dtype=np.int64)


def _strangers(values: Floats, arrivals: Arrivals, dof: int) -> list[Phrase]:
    """Return in words the value that stands out of the runs most, if chance hardly explains it.

    Its residual over the scatter of all others has Student's distribution (Bonferroni).
    """
    group = _sides(arrivals)
    count = np.bincount(group)[group]
    if dof < 3 or count.max() < 3:
        return []
    residual = values - (np.bincount(group, values) / np.maximum(np.bincount(group), 1))[group]
    squares = np.where(count > 2, residual**2 * count / np.maximum(count - 1, 1), 0.0)
    worst = int(np.argmax(squares))
    rest = float(np.sum(residual**2) - squares[worst]) / (dof - 1)
    size = np.sqrt(squares[worst] / max(rest, 1e-30))
    if 2.0 * len(values) * t_sf(size, dof - 1) > STRANGE:
        return []
    return [
        phrase(
            "run {0} {1} at {2:g} degrees is {3:.3g} arcsec off the mean of its runs, {4:.1f} "
            "times what the others scatter: correct or leave out that value",
            int(arrivals.run[worst]) + 1,
            phrase("up") if arrivals.upward[worst] else phrase("down"),
            arrivals.targets[arrivals.target[worst]] / DEGREE,
            residual[worst] / ARCSEC,
            size,
        )
    ]


def _protections(dof: int, count: int) -> Iterator[Protection]:
    """Yield them; ``count`` is stated for a turn, at whose end no deviation came again; or 0."""
    scale = phrase(
        "{0} counts are stated for a turn: one more is {1:.4g} arcsec at its end, and no angle "
        "was measured a turn later",
        abs(count), TURN / ARCSEC / abs(count or 1),
    )  # fmt: skip
    known = ("axis noise", "repeatability") if dof else ()
    for effect in EFFECTS:
        if effect in known:
            yield Protection(effect, "estimated", phrase("the scatter of the runs is in U"))
        else:
            why = phrase("nothing in a table of deviations shows it")
            yield Protection(
                effect, "not protected", scale if count and effect == "scale" else why
            )
    if not dof:
        yield Protection("single readings", "not protected", UNCHECKED)
    yield Protection(
        "sign of readings",
        "not protected",
        phrase("deviations of the other sign would look as good: verify with a second table"),
    )


def read(
    configuration: Configuration, table: Table, _targets: Table | None
) -> PlannedMeasurements:
    """Return the deviations of a table as readings, each with its standard uncertainty or 0."""
    calibration = prepare(configuration)
    find, observations = RowStepFinder(calibration.plan, COLUMNS), list[Observation]()
    for row in table.rows():
        seen = row.radians(DEVIATION, LARGEST_RAD), _std(row), 0.0
        observations.append(read_at(row, find(row).observed(seen)))
    return PlannedMeasurements(calibration, tuple(observations), table_hashes(table))


def _std(row: Row) -> float:
    for name, factor in UNCERTAINTIES.items():
        if name in row.cells:
            std = row.number(name) * factor
            if std <= 0.0:
                raise DataError(
                    f"{row.place}: the uncertainty is {row.cells[name]} rad, expected more than "
                    "0: correct the row"
                )
            return std
    return 0.0


def require_sign(reading: Reading) -> None:
    """Raise a question where the table leaves open the sign, or the factor of its uncertainties.

    Both angles show the sign, and so does a person's word.
    """
    if reading.table.header[-1] in UNCERTAINTIES:
        require_known_factor(reading)
    stated = reading.stated.values or reading.stated.named().keys() & {
        "deviation",
        REVERSED,
        ACTUAL,
    }
    ours = {f"deviation_{unit}" for unit in UNITS[ANGLE]}.intersection(reading.form_head)
    if not (stated or ours or ACTUAL in reading.uses or ACTUAL_MINUS_COMMANDED in reading.remarks):
        row = max(reading.table.rows(), key=lambda row: abs(row.number(DEVIATION)))
        raise ask_sign(row.place, row.number(DEVIATION))


def _zero(_result: Result) -> tuple[str, ...]:
    return (phrase("ECC counts from the zero of the table that states it."),)


METHOD: Final = Method(
    NAME,
    title=noted("Deviations that are known already: of an interferometer, a list, a certificate"),
    page="deviations",
    plan_settings=DeviationPlanSettings,
    solver_settings=DeviationSolverSettings,
    plan=plan,
    capture=CaptureRules({PointKind.READING: decide_by_points(mean_point)}),
    solve=solve,
    simulation_settings=DeviationSimulationSettings,
    simulated_instrument=SimulatedIndexer,
    nominal=lambda _configuration, _plan: lambda _step: (0.0, 0.0, 0.0),
    gauge=lambda _angles, deviations: dict(deviations),
    zero=_zero,
    table=TableReader(
        tuple(
            chain(
                (("position", DEVIATION, u) for u in UNCERTAINTIES),
                [("position", DEVIATION)],
            )
        ),
        read,
        COLUMNS,
        runs="runs",
        require=require_sign,
        needs_setup=False,
    ),
)
