"""The balls on the table, as nodes, replay and report see them: plan, result, figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from rotcal_ros.adjust import alternatives
from rotcal_ros.adjust.effects import LargestUndetected
from rotcal_ros.adjust.engine import LIMITS, Adjusted
from rotcal_ros.adjust.model import Model
from rotcal_ros.capture.attempt import CaptureRules
from rotcal_ros.capture.decisions import decide_by_points, decide_length, mean_point
from rotcal_ros.capture.passage import FittedCurve, decide_passage
from rotcal_ros.capture.touched_ball import reported_centre, touched_centre
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COMPONENTS, COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.curves import gauge
from rotcal_ros.foundation.errors import ConfigurationError, DataError, PlanError
from rotcal_ros.foundation.language import Phrase, phrase
from rotcal_ros.foundation.observations import Approach, Observation, PointKind, Turn
from rotcal_ros.foundation.protection import TOLERABLE, Effect, Protection
from rotcal_ros.foundation.results import AxisLine, Result
from rotcal_ros.foundation.tables import Table, table_hashes
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE, MILLIMETRE, TURN
from rotcal_ros.geometry.rotations import wrap_angle
from rotcal_ros.methods.ball_plate.settings import CENTRE, SURFACE
from rotcal_ros.methods.by_model import ByModel, RestatedConfiguration, Statement
from rotcal_ros.methods.calibration import prepare
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.disturbance import (
    Disturbance,
    error_motion,
    harmless,
    of_readings,
    repeatability,
    solver_statement,
    tilt,
)
from rotcal_ros.methods.figures import Figure, style
from rotcal_ros.methods.figures.curves import polar
from rotcal_ros.methods.figures.residuals import residual_figures
from rotcal_ros.methods.measurements import PlannedMeasurements, planned_table
from rotcal_ros.methods.method import Measurements, See, TableReader
from rotcal_ros.methods.result_tables import ResultTable
from rotcal_ros.methods.table_balls import set_up
from rotcal_ros.methods.table_balls.model import (
    AXIS,
    MOTIONS,
    BallsOnTable,
    components_of,
    model_of,
    untold_of,
)
from rotcal_ros.methods.table_balls.motions import (
    EXCEEDED,
    MOTION_KINDS,
    stated_motions_of,
    undetected_motions,
)
from rotcal_ros.methods.table_balls.settings import (
    BAR,
    DISPLACEMENT,
    FARTHEST_M,
    STATED,
    BallsPlanSettings,
    BallsSimulationSettings,
    BallsSolverSettings,
    below_the_table,
    sense_of,
)
from rotcal_ros.methods.table_balls.trajectory import table_of_ranges, trajectories, way_figures
from rotcal_ros.methods.turning import require_turns
from rotcal_ros.planning.plan import OperatorMove, Pause, Plan, Step
from rotcal_ros.planning.readings import Readings
from rotcal_ros.planning.table_angles import table_angles

NAME: Final = "table_balls"
KINDS: Final = {
    SURFACE: PointKind.SURFACE,
    CENTRE: PointKind.CENTRE,
    DISPLACEMENT: PointKind.READING,
    BAR: PointKind.REFLECTOR,
}
LARGEST_DISPLACEMENT_M: Final = 0.01
NEAR_AXIS_M: Final = 5e-3
"""A ball nearer to the axis shows nothing of its turns."""
MISPLACED_M: Final = 0.02
"""A ball that is farther from its planned place is another one, or turns the other way."""
AXIS_SHOWN: Final = (*((MICROMETRE, "um"),) * 2, *((ARCSEC, "arcsec"),) * 2)
"""Units in which people read :data:`AXIS`."""
MILLISECOND: Final = 1e-3
STATED_BY: Final = {
    "radial": "error_motion_std_m", "axial": "error_motion_std_m", "tilt": "tilt_std_arcsec"
}  # fmt: skip
"""Which setting of the solver states each kind of motion."""
OF_AXES: Final[Mapping[str, Effect]] = {"scale": "scale", "squareness": "gauge"}
"""Blocks of what may be wrong with the linear axes, and the effect that it is."""
LIKE_MOTIONS: Final[Mapping[Effect, str]] = {
    "straightness": "what the linear axes err along their ways",
    "play": "what linear axes or probe lose where they turn round",
}
"""Effects that no balls show."""
AXES: Final = ("axis", "tilting_axis")
"""Tables of where they stand."""
ARRIVALS: Final = 1.0
"""What arrivals that scatter do before they are found, per what noise does: by simulation, as
research/power_table.py does."""


def balls_of(configuration: Configuration, read: Readings | None = None) -> BallsOnTable:
    """Return which balls are seen where; see :meth:`~.model.BallsOnTable.of`."""
    return BallsOnTable.of(configuration.plan, configuration.solver, read)


def plan(configuration: Configuration) -> Plan:
    """Return the plan: every run goes through all angles, at each to all balls, there and back.

    A step's ``station`` is its run; with a tilting axis its tilt, to which a person brings it. A
    ball bar is brought from set-up to set-up instead, which ``target`` counts, ball by ball. A
    table that turns passes all angles once for each ball.
    Raises ConfigurationError for a ball without place and for tilts that do not fit the chain,
    PlanError for angles that do not ascend.
    """
    settings: BallsPlanSettings = configuration.plan
    _check_chain(settings, configuration.source)
    _check_turning(settings, configuration.source)
    _check_orders(configuration.solver, configuration.source)
    balls = balls_of(configuration)
    if not len(balls.places):
        raise ConfigurationError(f"{configuration.source}: plan.balls_m: state at least one ball")
    if settings.measure == BAR and not len(balls.bars):
        raise ConfigurationError(f"{configuration.source}: plan.bars_m: state at least one set-up")
    sent, kind = balls.sent, KINDS[settings.measure]
    steps: list[Step] = []
    for number, target, (run, position, angle, turn) in _order(settings, balls):
        x, y, z = sent[number, position, target].tolist()
        back = turn is not None and turn.speed < 0.0
        steps.append(
            Step(
                index=len(steps),
                table_position=position,
                table_angle=angle,
                approach=Approach.NEGATIVE if back else Approach.POSITIVE,
                kind=kind,
                target=target,
                position=(x, y, z),
                station=run if balls.tilting is None else number,
                n_points=settings.points_per_ball if kind == PointKind.SURFACE else 1,
                ball_diameter=settings.ball_diameter_m,
                turn=turn,
                passing=0.0 if turn is None else settings.passing_deg * DEGREE,
            )
        )
    targets = tuple((x, y, z) for x, y, z in (balls.aims + balls.origin).tolist())
    pauses = tuple(_pauses(balls, steps))
    return Plan(NAME, table_angles(settings), targets, tuple(steps), pauses)


class Stop(NamedTuple):
    """Run, number and commanded angle (rad) of a table position, and the turn that passes it."""

    run: int
    position: int
    angle: float
    turn: Turn | None = None


def _order(settings: BallsPlanSettings, balls: BallsOnTable) -> Iterator[tuple[int, int, Stop]]:
    stops, targets = list(_stops(settings)), range(len(balls.aims))
    if settings.turning_deg_s:
        yield from ((0, target, stop) for target, stop in _passed(settings, targets))
        return
    for number in range(balls.tilts):
        if len(balls.bars):
            yield from ((number, target, stop) for target in targets for stop in stops)
            continue
        for stop in stops:
            yield from ((number, target, stop) for target in targets[:: -1 if stop[1] % 2 else 1])


def _pauses(balls: BallsOnTable, steps: Sequence[Step]) -> Iterator[Pause]:
    """Yield a pause wherever a person turns the tilting axis, or brings the bar to a set-up."""
    before, bars, tilting = (-1, -1), len(balls.bars), balls.tilting
    for step in steps:
        here, work, move = (
            (step.station, step.target),
            list[str](),
            OperatorMove("ball bar", step.target),
        )
        if tilting is not None and here[0] != before[0]:
            work.append(
                phrase("turn {0} to {1:g} deg", tilting.letter, tilting.degrees[step.station])
            )
            move = OperatorMove(tilting.letter, step.station)
        if bars and (work or here[1] != before[1]):
            ball, number = divmod(step.target, bars)
            work.append(f"bring the ball bar to ball {ball}, set-up {number} of plan.bars_m")
        if work:
            yield Pause(step.index, step.index, "; ".join(work), move=move)
        before = here


def _check_orders(solver: BallsSolverSettings, source: str) -> None:
    if solver.error_motion_orders != STATED:
        return
    for name in ("radial_orders", "axial_orders", "tilt_orders"):
        if not any(getattr(solver, name)):
            raise ConfigurationError(
                f"{source}: solver.{name}: no order has a size above 0: give one, such as "
                "[0.0, 1.0] for the second, or leave solver.error_motion_orders out"
            )


def _check_turning(settings: BallsPlanSettings, source: str) -> None:
    speeds = settings.turning_deg_s
    if not speeds:
        return
    if settings.measure != DISPLACEMENT or settings.closing or below_the_table(settings.chain):
        raise ConfigurationError(
            f"{source}: plan.turning_deg_s: a table that turns on takes plan.measure: "
            "displacement, plan.closing: false, and a chain of C alone"
        )
    if len(speeds) != settings.runs or not all(speeds):
        raise ConfigurationError(
            f"{source}: plan.turning_deg_s: {len(speeds)} speeds, expected {settings.runs} other "
            "than 0, one for each of plan.runs"
        )
    if settings.run_up_deg <= settings.passing_deg:
        raise ConfigurationError(
            f"{source}: plan.run_up_deg: {settings.run_up_deg:g} leaves the table no way to "
            f"get up to its speed before plan.passing_deg, {settings.passing_deg:g}"
        )


def _check_chain(settings: BallsPlanSettings, source: str) -> None:
    tilts, (lowest, highest) = settings.tilts_deg, settings.tilt_limits_deg
    letter = below_the_table(settings.chain)
    if not letter:
        if tilts:
            raise ConfigurationError(
                f"{source}: plan.tilts_deg: no axis of the chain {settings.chain} tilts the "
                "table: state plan.chain, such as AC"
            )
        return
    if len(set(tilts)) < 2:
        raise ConfigurationError(
            f"{source}: plan.tilts_deg: {len(set(tilts))} tilts do not determine where "
            f"{letter} stands, expected two or more, as far apart as can be"
        )
    if beyond := [tilt for tilt in tilts if not lowest <= tilt <= highest]:
        raise ConfigurationError(
            f"{source}: plan.tilts_deg: {beyond[0]:g} deg is beyond plan.tilt_limits_deg, "
            f"{lowest:g} to {highest:g}"
        )


def _stops(settings: BallsPlanSettings) -> Iterator[Stop]:
    angles, on = np.array(table_angles(settings)), _turns_on(settings)
    for run in range(settings.runs):
        for position, angle in enumerate(angles.tolist()):
            yield Stop(run, position, angle + run * on)
    if settings.closing:
        yield Stop(settings.runs - 1, 0, float(angles[0]) + settings.runs * on)


def _turns_on(settings: BallsPlanSettings) -> float:
    """Return by how much (rad) the angles of the next run are ahead, in its sense."""
    angles = np.array(table_angles(settings))
    step = float(np.diff(angles).max(initial=0.0))
    whole = angles[-1] + step - angles[0] > TURN * (1.0 - 1e-9)
    return TURN if whole and settings.turns_on else 0.0


def _passed(settings: BallsPlanSettings, targets: Sequence[int]) -> Iterator[tuple[int, Stop]]:
    """Yield ball and stop of every angle that a table passes, in each run once for each ball."""
    angles, run_up, on = table_angles(settings), settings.run_up_deg * DEGREE, _turns_on(settings)
    whole, before = 0.0, 0.0
    for run, speed in enumerate(np.array(settings.turning_deg_s) * DEGREE):
        sense = float(np.sign(speed))
        for target in targets:
            whole += on * sense * (before == sense)
            ends = [whole + angles[0] - run_up, whole + angles[-1] + run_up][:: int(sense)]
            turn, before = Turn(ends[0], ends[1], float(speed)), sense
            for position in range(len(angles))[:: int(sense)]:
                yield target, Stop(run, position, angles[position] + whole, turn)


def check_plan(configuration: Configuration, planned: Plan) -> None:
    """Raise PlanError for a plan whose balls determine neither axis nor ECC, with the reason."""
    balls = balls_of(configuration)
    if configuration.plan.turning_deg_s:
        require_turns(configuration, planned)
    radius = np.hypot(*balls.places.T[:2])
    if radius.max() < NEAR_AXIS_M:
        raise PlanError(
            f"all balls stand within {radius.max() / MILLIMETRE:.3g} mm of the axis and show "
            "nothing of its turns: put at least one aside, or correct plan.axis_m"
        )
    if "ECC" not in balls.shown:
        raise PlanError(
            "no set-up of the ball bar determines ECC: add a tangential one to plan.bars_m, such "
            "as [0.0, 0.1, 0.0]"
        )
    BY_MODEL.check_plan(configuration, planned)


def nominal(configuration: Configuration, _plan: Plan) -> See:
    """Return what is measured at a step where nothing is wrong, m."""
    lengths = np.linalg.norm(balls_of(configuration).arms, axis=1).tolist()

    def see(step: Step) -> tuple[float, ...]:
        if step.kind == PointKind.REFLECTOR:
            return (lengths[step.target],)
        return (0.0, 0.0, 0.0) if step.kind == PointKind.READING else step.position

    return see


def model(configuration: Configuration, read: Readings, *, whole: bool = False) -> Model:
    """Return what is read for the engine; DataError where a ball is not where it is planned.

    A displacement counts from where the nest was sent, which is where the ball is planned.
    ``whole`` as of :func:`~.model.model_of`.
    """
    balls = balls_of(configuration, read)
    if configuration.plan.measure == DISPLACEMENT:
        sent = balls.sent[balls.tilt, balls.position, balls.target]
        read = replace(read, points=read.points + sent)
    found = model_of(configuration.plan, configuration.solver, read, whole=whole)
    if len(balls.bars):
        _check_lengths(balls, read)
        return found
    assert found.start is not None
    places = found.start[balls.first["ball"] : balls.first["EXC"]].reshape(-1, 3)
    places = places + np.append(found.start[:2], 0.0)
    seen = np.isin(np.arange(len(places)), read.target)
    away = np.where(seen, np.linalg.norm(places - balls.places, axis=1), 0.0)
    if away.max() > MISPLACED_M:
        ball = int(away.argmax())
        x, y, z = (places[ball] + balls.origin).tolist()
        raise DataError(
            f"ball {ball} seems to stand at ({x:.4f}, {y:.4f}, {z:.4f}) m at table angle 0, "
            f"{away.max() / MILLIMETRE:.3g} mm from its place in plan.balls_m: correct that or "
            "plan.axis_m, or the table turns the other way (plan.chain), or z points into it"
        )
    return found


def _check_lengths(balls: BallsOnTable, read: Readings) -> None:
    wanted = np.linalg.norm(balls.arms, axis=1)[balls.target]
    worst = int(np.abs(read.value - wanted).argmax())
    if abs(read.value[worst] - wanted[worst]) > MISPLACED_M:
        raise DataError(
            f"bar {balls.target[worst]} at position {balls.position[worst]} is "
            f"{read.value[worst]:.6g} m long, expected {wanted[worst]:.6g} m: lengths are those "
            "between the centres of both balls, in the order of plan.bars_m at each ball"
        )


def states(
    configuration: Configuration, read: Readings, found: Adjusted, given: Configuration
) -> Statement:
    """Return what is done about effects that the engine does not know, and the axis."""
    balls, ways = balls_of(configuration), trajectories(balls_of(configuration, read), found)
    details: dict[str, Any] = {"untold": [name for name in COMPONENTS if name not in balls.shown]}
    if balls.tilting is not None:
        details["tilts"] = np.array(balls.tilting.degrees) * DEGREE
    every = set_up.compare_setups(given, read, found.why, partial(model, whole=True))
    protections = (
        *_protections(configuration, balls, found),
        *alternatives.alternative_protections(every),
    )
    doubts = tuple(alternatives.alternative_doubts(every))
    axes = _axes(balls, found, configuration.plan.chain)
    return Statement(doubts, protections, details | {"trajectories": ways}, axes)


def restated(
    configuration: Configuration, _read: Readings, found: Adjusted
) -> RestatedConfiguration | None:
    """Return larger statements of motions where the balls show more; None where they fit."""
    solver = configuration.solver
    beyond = [
        each
        for together in stated_motions_of(found.model)
        for each in together.contradictions(found.fit)
        if each.factor > 1.0 and each.probability < LIMITS.significance / len(MOTION_KINDS)
    ]
    if not beyond:
        return None
    factor = max(each.factor for each in beyond)  # of both, which balls tell apart by their sizes
    values = {name: getattr(solver, name) * factor for name in STATED_BY.values()}
    return RestatedConfiguration(
        replace(configuration, solver=replace(solver, **values)),
        tuple(
            phrase(
                "the balls show {0} motions {1:.2g} times as large as solver.{2} states (p = "
                "{3:.1g}): the uncertainty is enlarged as if they were stated; state them, "
                "or look for play, squareness and scale of the linear axes",
                phrase(each.kind),
                each.factor,
                STATED_BY[each.kind],
                each.probability,
            )
            for each in beyond
        ),
    )


def _protections(
    configuration: Configuration, balls: BallsOnTable, found: Adjusted
) -> Iterator[Protection]:
    worst = undetected_motions(balls, found)
    of_effects: tuple[tuple[Effect, tuple[str, ...], tuple[str, ...]], ...] = (
        ("error motion", COMPONENTS[:3], ("radial", "axial")),
        ("tilt", COMPONENTS[3:5], ("tilt",)),
    )
    for effect, every, kinds in of_effects:
        if untold := [name for name in every if name not in balls.shown]:
            names = ", ".join(untold)
            why = phrase(
                "the balls do not determine {0}: the uncertainty holds what is stated", names
            )
            yield _stated_only(effect, why, [worst[kind] for kind in kinds])
        else:
            yield Protection(effect, "estimated", phrase("the balls determine it at every angle"))
    yield Protection("refraction", "harmless", phrase("no light measures"))
    for name, effect in OF_AXES.items():
        size, left = LINEAR[name](configuration), found.further[name][1].max()
        why = phrase(
            "the uncertainty holds the {0} of the linear axes: stated are {1:.3g} um/m, the "
            "balls leave {2:.3g} um/m of the worst", phrase(name), size / MICROMETRE,
            left / MICROMETRE
        )  # fmt: skip
        beside = [worst["bar"]] if effect == "gauge" and "bar" in worst else []
        yield _stated_only(effect, why, [worst[name], *beside])
    if tip := configuration.solver.tip_std_m:
        why = phrase(
            "the uncertainty of the axis holds {0:.3g} um of the probe's tip", tip / MICROMETRE
        )
        yield _stated_only("probe tip", why, [worst["tip"]])
    else:
        yield Protection(
            "probe tip",
            "not protected",
            phrase("an offset of the probe's tip is in the place of the axis"),
        )
    for effect, what in LIKE_MOTIONS.items():
        why = phrase(
            "{0} is the same in every run, and read as motions of the balls", phrase(what)
        )
        yield Protection(effect, "not protected", why)
    if configuration.plan.measure in (DISPLACEMENT, BAR):
        # no effect for the engine: one of 100 % would explain all that is stated to be zero
        why = phrase(
            "an instrument that shows 2 % too little makes all that it finds 2 % too small"
        )
        yield Protection("gain", "not protected", why)
    if "lag" in balls.known:
        yield _lag(configuration, found)
    if configuration.plan.runs == 1:
        yield Protection("repeatability", "not protected", phrase("each angle is reached once"))
        return
    noise = next(p.error for p in found.protections() if p.effect == "axis noise")
    error = None if noise is None else ARRIVALS * noise
    yield Protection("repeatability", "tested", phrase("every run comes to every angle"), error)


def _stated_only(effect: Effect, why: Phrase, every: Sequence[LargestUndetected]) -> Protection:
    """Return what is done about an effect that is stated: not enough where that may be exceeded.

    ``every``: what may stay unseen of all that is stated of it.
    """
    worst = max(every, key=lambda each: each.error)
    if worst.error <= TOLERABLE:
        return Protection(effect, "bounded", why, worst.error)
    why = phrase(
        "{0}; up to {1:g} times as large, it moves the result by {2:.2g} standard uncertainties "
        "before the verdict changes", why, EXCEEDED, worst.error
    )  # fmt: skip
    return Protection(effect, worst.treatment, why, worst.error)


def _lag(configuration: Configuration, found: Adjusted) -> Protection:
    left = found.further["lag"][1][0]
    if np.isclose(left, configuration.solver.lag_std_s, rtol=0.01):
        return Protection(
            "lag", "harmless", phrase("at one speed a lag only moves the balls: nothing shows it")
        )
    return Protection(
        "lag",
        "estimated",
        phrase(
            "runs of several speeds determine it to {0:.3g} ms: play of the table looks the same",
            left / MILLISECOND,
        ),
    )


def _axes(balls: BallsOnTable, found: Adjusted, chain: str) -> tuple[AxisLine, ...]:
    """Return where the table's axis stands, and the one that tilts it: the last of the outputs."""
    lines: list[tuple[tuple[str, ...], Floats]] = [(AXIS, balls.origin)]
    if balls.tilting is not None:
        lines.append((balls.tilting.line, balls.tilting.point))
    first, axes = len(found.value) - len(AXIS) * len(lines), []
    for names, origin in lines:
        at = slice(first, first + len(names))
        covariance = found.covariance[at, at]
        sense = round(sense_of(chain, names[0][-1]))
        axes.append(AxisLine(names, found.value[at], found.std[at], covariance, origin, sense))
        first = at.stop
    return tuple(axes)


def tables(result: Result) -> list[ResultTable]:
    """Return the axes, motions that are no deviations, and what is found of the linear axes."""
    details = result.details
    found, factor = list[ResultTable](), np.array([si for si, _ in AXIS_SHOWN])
    for name, axis in zip(AXES, result.axes, strict=False):
        x, y, z = axis.origin / MILLIMETRE
        titles = (
            phrase(
                "Axis average line, from ({0:.3f}, {1:.3f}) mm at the height z = {2:.3f} mm",
                x,
                y,
                z,
            ),
            phrase(
                "Axis average line of the tilting axis, from ({0:.3f}, {1:.3f}, {2:.3f}) mm",
                x,
                y,
                z,
            ),
        )
        columns = {"value": axis.value / factor, "U_value": COVERAGE_FACTOR * axis.std / factor}
        unit, title = [unit for _, unit in AXIS_SHOWN], titles[AXES.index(name)]
        found.append(ResultTable.of(name, title, quantity=axis.names, unit=unit, **columns))
    found.append(table_of_ranges(details))
    for name, rows in details["also"].items():
        si, suffix = MICROMETRE, "um" if "motion" in name else "um_per_m"
        if name == "lag":
            si, suffix = MILLISECOND, "ms"
        if name[:3].isupper():
            si, suffix = (MICROMETRE, "um") if set(name[:2]) & set("XYZ") else (ARCSEC, "arcsec")
        columns = {
            f"value_{suffix}": np.asarray(rows["value"]) / si,
            f"U_value_{suffix}": COVERAGE_FACTOR * np.asarray(rows["std"]) / si,
        }
        number = range(len(rows["value"]))
        found.append(
            ResultTable.of(name.replace(" ", "_"), name.capitalize(), number=number, **columns)
        )
    return found


def figures(result: Result, _truth: Mapping[str, Any] | None) -> list[Figure]:
    """Return the figures that only this method can fill."""
    return [
        *(
            Figure(
                "Axis average line",
                "Where the axis stands and which way it leans, from its nominal place; U (k = 2).",
                _axis(axis),
                "set-up",
            )
            for axis in result.axes
        ),
        *way_figures(result.details["trajectories"]),
        Figure(
            "Polar plots",
            "Motions over the table angle, from a circle of arbitrary radius; the band is U "
            "(k = 2).",
            _polar(result),
        ),
        *residual_figures(result),
    ]


@style.house_style
def _axis(axis: AxisLine) -> str:
    panels = style.grid(1, 2)
    for number, (ax, (si, unit)) in enumerate(zip(panels, AXIS_SHOWN[::2], strict=True)):
        pair = slice(2 * number, 2 * number + 2)
        (x, y), (u, v) = axis.value[pair] / si, COVERAGE_FACTOR * axis.std[pair] / si
        ax.errorbar([x], [y], xerr=[u], yerr=[v], fmt="o", color=style.BLUE, capsize=3)
        ax.plot([0.0], [0.0], "+", color=style.GREY)
        first, second = axis.names[pair]
        ax.set_xlabel(f"{first} / {unit}")
        ax.set_ylabel(f"{second} / {unit}")
    return style.svg(panels[0])


def _polar(result: Result) -> str:
    """Draw the motions of the balls or, where they determine those of the table, these."""
    count, also = len(result.angles), result.details["also"]
    motions = [
        (f"{name} of ball {ball}", value, std)
        for name in MOTIONS
        if name in also
        for ball, (value, std) in enumerate(
            zip(*(np.reshape(also[name][of], (-1, count)) for of in ("value", "std")), strict=True)
        )
    ]
    if motions:
        return polar(result.angles, [(*motion, *unit_of("EXC")) for motion in motions])
    every = result.components
    return polar(
        result.angles, [(n, result.deviations[n], result.std[n], *unit_of(n)) for n in every]
    )


LINEAR: Final = {name: solver_statement(f"{name}_std_um_per_m", MICROMETRE) for name in OF_AXES}
"""What is stated of the linear axes."""
KNOWN: Final = {
    "position": "table_position", "ball": "target", "bar": "target", "tilt": "station"
}  # fmt: skip
READ: Final = {
    CENTRE: ("ball", dict.fromkeys(("x_m", "y_m", "z_m"), FARTHEST_M)),
    DISPLACEMENT: ("ball", dict.fromkeys(("dx_m", "dy_m", "dz_m"), LARGEST_DISPLACEMENT_M)),
    BAR: ("bar", {"length_m": FARTHEST_M}),
}
"""By what is measured: the column of its number, and those of its values with the largest."""
READERS: Final = {
    (measure, tilt): planned_table({n: KNOWN[n] for n in ("position", number, *tilt)}, values)
    for tilt in (("tilt",) * tilted for tilted in range(2))
    for measure, (number, values) in READ.items()
}


PASSING: Final = ("run", "ball", "passing_rad", "dx_m", "dy_m", "dz_m")
"""Columns of displacements of a table that turns; ``passing_rad`` is its angle."""
MOST_TURNS_RAD: Final = 1e4


def read_passing(configuration: Configuration, table: Table) -> PlannedMeasurements:
    """Return displacements at the table angles, of a table that turned.

    Each is that of the straight line through the readings on both sides of the angle. Raises
    DataError for an angle that is not passed.
    """
    if not configuration.plan.turning_deg_s:
        raise DataError(
            f"{table.path} was read while the table turned: state plan.turning_deg_s, the speed "
            "of each run, in the set-up"
        )
    calibration = prepare(configuration)
    rows = np.array([
        [row.index("run"), row.index("ball"), row.radians("passing_rad", MOST_TURNS_RAD),
         *(row.metres(name, LARGEST_DISPLACEMENT_M) for name in PASSING[3:])]
        for row in table.rows()
    ]).reshape(-1, len(PASSING))  # fmt: skip
    seen, observations = rows[:, :2], list[Observation]()
    for step in calibration.plan.steps:
        away = wrap_angle(rows[:, 2] - step.table_angle)
        near = np.abs(away) < configuration.plan.passing_deg * DEGREE
        near &= (seen == (step.station, step.target)).all(axis=1)
        if not (away[near].min(initial=0.0) < 0.0 < away[near].max(initial=0.0)):
            raise DataError(
                f"{table.path}: run {step.station} has no readings of ball {step.target} on both "
                f"sides of {step.table_angle / DEGREE:g} deg within plan.passing_deg, "
                f"{configuration.plan.passing_deg:g} deg"
            )
        x, y, z = (FittedCurve.through(away[near], column).value for column in rows[near, 3:].T)
        observations.append(step.observed((x, y, z)))
    return PlannedMeasurements(calibration, tuple(observations), table_hashes(table))


def read_rows(configuration: Configuration, table: Table, targets: Table | None) -> Measurements:
    """Return centres, displacements or lengths of a table, as its columns say."""
    tilted = "tilt" in table.header
    if tilted != bool(below_the_table(configuration.plan.chain)):
        has, needs = ("a", "states an axis for it") if tilted else ("no", "has none, as C")
        raise DataError(
            f"{table.path} has {has} column of tilts, expected a plan.chain that {needs}: "
            f"plan.chain is {configuration.plan.chain}"
        )
    if set(PASSING) <= set(table.header):
        return read_passing(configuration, table)
    measure = next(each for each, (_, values) in READ.items() if set(values) <= set(table.header))
    configuration = replace(configuration, plan=replace(configuration.plan, measure=measure))
    return READERS[measure, ("tilt",) * tilted].read(configuration, table, targets)


AT_REST: Final = decide_by_points(mean_point)
BY_MODEL: Final = ByModel(
    NAME,
    model,
    states,
    components=lambda configuration: components_of(balls_of(configuration)),
    untold=lambda configuration: untold_of(balls_of(configuration)),
    nominal=nominal,
    coordinates=lambda configuration: balls_of(configuration).coordinates,
    further=lambda configuration: (
        len(AXIS) * (2 if below_the_table(configuration.plan.chain) else 1)
    ),
    counts_from="mean",
    wrong=OF_AXES,
    restated=restated,
)
METHOD: Final = BY_MODEL.method(
    title="Balls on the table, touched by the machine",
    page="table_balls",
    plan_settings=BallsPlanSettings,
    solver_settings=BallsSolverSettings,
    simulation_settings=BallsSimulationSettings,
    simulated_instrument=plugins.lazy_load(
        "rotcal_ros.methods.table_balls.simulation:TouchedBalls"
    ),
    plan=plan,
    check_plan=check_plan,
    capture=CaptureRules(
        {
            PointKind.SURFACE: decide_by_points(touched_centre),
            PointKind.CENTRE: decide_by_points(reported_centre),
            # at an angle where the table rests, or which it passes
            PointKind.READING: lambda attempt, *more: (
                AT_REST if attempt.step.turn is None else decide_passage
            )(attempt, *more),
            PointKind.REFLECTOR: decide_length,
        }
    ),
    gauge=gauge.without_axis_and_artefact,
    zero=gauge.describe,
    table=TableReader(
        (*(header for reader in READERS.values() for header in reader.headers), PASSING),
        read_rows,
        KNOWN,
        runs="runs",
    ),
    tables=tables,
    figures=figures,
    disturbances=(
        *(d for d in of_readings(1.0, 200.0, "um", MICROMETRE) if d.effect != "scale"),
        *(
            Disturbance(OF_AXES[name], what, "um/m", MICROMETRE, 1.0, 1e3, True, LINEAR[name])
            for name, what in (
                ("scale", "x, y and z read more by so much each"),
                ("squareness", "each pair of linear axes is out of square by so much"),
            )
        ),
        error_motion(0.5, 100.0, solver_statement("error_motion_std_m")),
        tilt(0.5, 100.0, solver_statement("tilt_std_arcsec", ARCSEC)),
        repeatability(0.5, 100.0),
        *harmless("refraction"),
    ),
)
