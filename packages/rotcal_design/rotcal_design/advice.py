"""Which method fits what somebody owns: each one's plan, predicted before anything is measured.

What is listed here is which methods an instrument serves, and with how much effort they are tried.
U, minutes and what stays untested come from the plan of the very set-up that the command writes:
its own measurement with the stated noise, solved as it will be.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any, Final

from rotcal_design.ball_plate.ball_layout import plan_plate
from rotcal_design.trades import USUAL_BALLS, USUAL_MIRROR
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import ConfigurationError, RotcalError
from rotcal_ros.methods.calibration import prepare_whole
from rotcal_ros.methods.configuration import parse_configuration
from rotcal_ros.methods.dry_run import DryRun, Prospect
from rotcal_ros.methods.method import find_method, method_names
from rotcal_ros.methods.new_setup import (
    Known,
    full_turn_settings,
    given_value,
    known_settings,
    setup_text,
    values_of_tables,
)

Changes = tuple[str, ...]
"""Settings as group.name=value."""
OF_THE_MACHINE: Final = ("solver.sigma_centre_m", "solver.target_std_m")
"""What says how well a machine measures or places a point."""


def _usual(text: str, name: str) -> str:
    return f"plan.{name}={list(getattr(parse_configuration(text).plan, name))}"


def _balls(_positions: int) -> Iterator[Changes]:
    """Yield one ball, and three that are not in a line, in one to four runs."""
    three = _usual(USUAL_BALLS, "balls_m")
    for runs in (1, 2, 4):
        yield (f"plan.runs={runs}",)
        yield three, f"plan.runs={runs}"


def _plates(positions: int) -> Iterator[Changes]:
    for balls in (4, 6, 8):
        if balls <= positions:
            steps = plan_plate(positions, balls, starts=4).steps
            yield (f"plan.plate.ball_steps={list(steps)}",)


def _boxes(_positions: int) -> Iterator[Changes]:
    yield from ((f"plan.box_points={list(n)}",) for n in ((2, 2, 2), (3, 3, 2), (4, 4, 3)))


def _reflectors(_positions: int) -> Iterator[Changes]:
    nests = _usual(USUAL_MIRROR, "nests_m")
    yield from ((nests, f"plan.reflectors={n}") for n in (1, 2, 4))


def _shifts(positions: int) -> Iterator[Changes]:
    step = 360.0 / positions
    yield from ((f"plan.shifts_deg={[k * step for k in ks]}",) for ks in ((0,), (0, 1, 5)))


def _as_usual(_positions: int) -> Iterator[Changes]:
    yield ()


@dataclass(frozen=True)
class MeasuringRoute:
    """A ``method``, the ``settings`` that make it one of an instrument, and its efforts.

    ``efforts`` yields further settings for a number of table angles, the quickest first.
    """

    method: str
    efforts: Callable[[int], Iterable[Changes]] = _as_usual
    settings: Changes = ()


PLATE: Final = ("plan.plate.circle_radius_m=0.185", "plan.plate.ball_diameter_m=0.025")
"""A plate that is usual, until somebody states another."""
OWNED: Final[Mapping[str, tuple[str, tuple[MeasuringRoute, ...]]]] = {
    "tracer": (
        "laser tracer, and a machine that carries its reflector",
        (MeasuringRoute("tracer_multistation", _boxes), MeasuringRoute("tracer_six")),
    ),
    "tracker": (
        "laser tracker and a mirror on the table",
        (MeasuringRoute("plane_mirror", _reflectors),),
    ),
    "cmm": (
        "measuring machine, with a plate of balls or balls on the table",
        (MeasuringRoute("ball_plate", _plates, PLATE), MeasuringRoute("table_balls", _balls)),
    ),
    "probe": (
        "touch probe of the machine tool, and a ball or three",
        (MeasuringRoute("table_balls", _balls),),
    ),
    "ball-bar": ("ball bar", (MeasuringRoute("table_balls", _balls, ("plan.measure=bar",)),)),
    "r-test": ("R-test", (MeasuringRoute("table_balls", _balls, ("plan.measure=displacement",)),)),
    "polygon": ("polygon and autocollimator", (MeasuringRoute("angle_comparison", _shifts),)),
    "interferometer": (
        "laser interferometer with rotary indexer",
        (MeasuringRoute("deviations"), MeasuringRoute("angle_comparison", _shifts)),
    ),
}
"""Name -> what it is in words, and the ways that it serves."""


@dataclass(frozen=True)
class Goal:
    """What is wanted: ``need``: U (k = 2, m or rad) by component, 0: any; ``seconds`` at most."""

    need: Mapping[str, float]
    positions: int
    seconds: float = float("inf")

    def shortfall(self, expanded: Mapping[str, float], seconds: float) -> float:
        """Return by which factor the worst of U and time misses: at most 1 meets the goal."""
        ratios = [seconds / self.seconds]
        for component, need in self.need.items():
            if component not in expanded:
                return float("inf")
            ratios.append(expanded[component] / need if need else 0.0)
        return max(ratios)


@dataclass(frozen=True)
class Advice:
    """One way, at the effort that suits the goal best.

    ``expanded``: largest U (k = 2, m or rad) by component, empty where it could not be predicted:
    then ``refused`` says why. ``rests_on``: the settings that it rests on, with their values.
    ``pauses``: how often a person has to do something, whose time is not in ``seconds``.
    """

    instrument: str
    method: str
    title: str
    meets: bool
    shortfall: float
    expanded: Mapping[str, float]
    seconds: float
    pauses: int
    untested: tuple[str, ...]
    rests_on: Mapping[str, Any]
    command: str
    refused: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON, SI."""
        return asdict(self) | {
            "shortfall": self.shortfall if self.shortfall < float("inf") else None
        }


def advise(
    owned: Sequence[str],
    goal: Goal,
    *,
    machine_std: float | None = None,
    changes: Changes = (),
) -> tuple[Advice, ...]:
    """Return the ways that ``owned`` instruments serve, those first that meet the ``goal``.

    ``machine_std`` (m, k = 1) is how well the machine measures or places a point, ``changes`` are
    settings of those methods that have them. Raises ConfigurationError for one that none has.
    """
    ways = [(name, way) for name in owned for way in OWNED[name][1]]
    _require_of_any(changes, [way.method for _, way in ways])
    found = [_best(name, way, goal, machine_std, changes) for name, way in ways]
    return tuple(sorted(found, key=lambda each: (not each.meets, each.shortfall, each.seconds)))


def _require_of_any(changes: Changes, methods: Iterable[str]) -> None:
    every = {name for m in {*methods} & {*method_names()} for name in known_settings(m)}
    for change in changes:
        if change.partition("=")[0] not in every:
            raise ConfigurationError(f"--set {change}: no method of these instruments has it")


def _best(
    instrument: str, way: MeasuringRoute, goal: Goal, machine_std: float | None, changes: Changes
) -> Advice:
    """Return the quickest effort that meets the goal, else the one that misses it least."""
    if way.method not in method_names():
        return _refused(instrument, way, "its package is not installed")
    known = known_settings(way.method)
    of_machine = tuple(
        f"{name}={machine_std!r}" for name in OF_THE_MACHINE if machine_std and name in known
    )
    own = tuple(change for change in changes if change.partition("=")[0] in known)
    tried, refused = list[Advice](), list[str]()
    for effort in way.efforts(goal.positions):
        stated = (*way.settings, *effort, *of_machine, *own)
        try:
            tried.append(_predicted(instrument, way, goal, known, stated))
        except RotcalError as error:
            refused.append(str(error))
            continue
        if tried[-1].meets:
            return tried[-1]
    if tried:
        return min(tried, key=lambda each: each.shortfall)
    return _refused(instrument, way, refused[0])


def _predicted(
    instrument: str, way: MeasuringRoute, goal: Goal, known: Known, stated: Changes
) -> Advice:
    """Return what a set-up with the settings ``stated`` would give; raises what refuses it."""
    given = dict(given_value(way.method, known, change) for change in stated)
    values = {**values_of_tables(way.method), **full_turn_settings(known, goal.positions), **given}
    rests = {
        name: values.get(name, known[name].default)
        for name in known
        if name in OF_THE_MACHINE or (known[name].info.first and name.startswith("solver."))
    }
    if OF_THE_MACHINE[0] in rests and not rests[OF_THE_MACHINE[0]]:
        raise ConfigurationError(
            "nothing states how well the machine measures a ball: --machine-um, by repeating one"
        )
    text = setup_text(way.method, known, values)
    calibration = prepare_whole(parse_configuration(text, way.method))
    seconds, _ = DryRun(calibration, calibration.plan.table_angles[0]).time_estimate()
    prospect = Prospect.of(calibration)
    expanded = {name: COVERAGE_FACTOR * std for name, std in prospect.std.items()}
    shortfall = goal.shortfall(expanded, seconds)
    return Advice(
        instrument=instrument,
        method=way.method,
        title=find_method(way.method).title,
        meets=shortfall <= 1.0,
        shortfall=shortfall,
        expanded=expanded,
        seconds=seconds,
        pauses=len(calibration.plan.pauses),
        untested=prospect.untested,
        rests_on=rests,
        command=_command(way.method, goal.positions, stated),
    )


def _command(method: str, positions: int, stated: Changes) -> str:
    """Return what begins it: the set-up, or the solution of a table that needs none."""
    words = [word for change in stated for word in ("--set", change)]
    table = find_method(method).table
    if table is not None and not table.needs_setup:
        return shlex.join(["rotcal", "solve", f"{method}.csv", *words])
    new = ["rotcal", "new", "--method", method, "--positions", str(positions), *words]
    return shlex.join([*new, "-y", "-o", f"{method}.yaml"])


def _refused(instrument: str, way: MeasuringRoute, why: str) -> Advice:
    title = way.method
    with suppress(RotcalError):
        title = find_method(way.method).title
    worst = float("inf")
    return Advice(instrument, way.method, title, False, worst, {}, 0.0, 0, (), {}, "", refused=why)
