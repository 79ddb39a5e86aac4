"""A measuring plan: the steps that the planner commands and the capture expects; its figures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.language import NOTHING
from rotcal_ros.foundation.observations import (
    Approach,
    Command,
    Observation,
    PointKind,
    Turn,
    place_in_words,
)

Point = tuple[float, float, float]

MACHINE_FRAME: Final = "machine"
"""Frame that stands still, at the foot of the table axis, with +z along it."""
TABLE_FRAME: Final = "table"
"""Frame that turns with the table; at angle 0 it is the machine frame."""


@dataclass(frozen=True, slots=True)
class Step:
    """One step: turn the table, place the probe, observe once.

    ``table_angle`` (rad) is approached from the side ``approach``; ``position`` (m) is the
    nominal place of target number ``target``. ``n_points`` is the number of probe points that make
    the observation (1 for a carried reflector); ``ball_diameter`` (m) is that of the touched ball,
    0 if there is none. With a ``turn`` the table passes the angle; the readings up to ``passing``
    (rad) on both sides of it make the observation. One order begins a turn; the steps that it
    passes later are captured without.
    """

    index: int
    table_position: int
    table_angle: float
    approach: Approach
    kind: PointKind
    target: int
    position: Point
    station: int = 0
    n_points: int = 1
    ball_diameter: float = 0.0
    turn: Turn | None = None
    passing: float = 0.0

    def describe(self, attempt: int = 0) -> str:
        """Return the place of this step, for people."""
        return place_in_words(self.table_position, self.target, attempt)

    def follows(self, before: Step) -> bool:
        """Return whether the turn in which the table passes ``before`` passes this one next."""
        if self.turn is None or before.index != self.index - 1:
            return False
        ours, theirs = ((s.turn, s.station, s.target) for s in (self, before))
        return ours == theirs

    def command(self, attempt: int) -> Command:
        """Return the order for one attempt at this step; one of a turn begins it."""
        return Command(
            step=self.index,
            attempt=attempt,
            table_angle=self.table_angle,
            approach=self.approach,
            kind=self.kind,
            target=self.target,
            position=self.position,
            station=self.station,
            turn=self.turn,
        )

    def observed(self, mean: tuple[float, ...], kind: PointKind | None = None) -> Observation:
        """Return the accepted observation of a value ``mean`` (m) without a known scatter."""
        zeros = (0.0,) * len(mean)
        return Observation(
            step=self.index,
            attempt=0,
            table_position=self.table_position,
            table_angle=self.table_angle,
            target=self.target,
            station=self.station,
            kind=self.kind if kind is None else kind,
            mean=mean,
            std=zeros,
            scatter=zeros,
            probe_position=self.position,
            n_samples=1,
            n_used=1,
            accepted=True,
            reason=NOTHING,
            table_angle_measured=self.table_angle,
            temperature_c=None,
            window_start_ns=0,
            window_end_ns=0,
        )


def numbered_steps(
    rows: Iterable[tuple[int, int, int]],
    angles: Sequence[float],
    targets: Sequence[Point],
    kind: PointKind,
    *,
    approaches: Sequence[Approach] = (),
    n_points: int = 1,
) -> tuple[Step, ...]:
    """Return a step for each of ``rows``, which are table position, target and station.

    ``approaches`` are those of the table positions; none: all from below.
    """
    return tuple(
        Step(
            index=index,
            table_position=position,
            table_angle=angles[position],
            approach=approaches[position] if approaches else Approach.POSITIVE,
            kind=kind,
            target=target,
            position=targets[target],
            station=station,
            n_points=n_points,
        )
        for index, (position, target, station) in enumerate(rows)
    )


@dataclass(frozen=True, slots=True)
class OperatorMove:
    """What a pause is for: ``what`` is brought to ``station``, at ``position`` (m) in ``frame``.

    Without a position the plan knows no place: the instruction says what has to be turned, and
    how.
    """

    what: str
    station: int
    position: Point | None = None
    frame: str = MACHINE_FRAME


@dataclass(frozen=True, slots=True)
class Pause:
    """A person's work before step ``first``, described in ``instruction``, ``move`` as data.

    The steps ``first`` to ``last`` show whether it was done well: they are measured and judged by
    the method before the rest follows. ``last`` = ``first`` - 1: no step shows it. With
    ``again_from`` there is nothing to do at first: only if the steps show a fault is the person
    asked, and everything from that step on measured again.
    """

    first: int
    last: int
    instruction: str
    again_from: int | None = None
    move: OperatorMove | None = None


def pauses_at_stations(
    steps: Sequence[Step], what: str, instructions: Sequence[str]
) -> tuple[Pause, ...]:
    """Return a pause before the first step of each station, which shows whether it is done well.

    ``what`` is moved there, as its instruction says.
    """
    first: dict[int, int] = {}
    for step in steps:
        first.setdefault(step.station, step.index)
    return tuple(
        Pause(index, index, instructions[station], move=OperatorMove(what, station))
        for station, index in first.items()
    )


@dataclass(frozen=True)
class Plan:
    """All steps of one calibration, with the table angles (rad) and targets (m) they refer to.

    ``pauses`` are in the order of their steps; most methods have none.
    """

    method: str
    table_angles: tuple[float, ...]
    targets: tuple[Point, ...]
    steps: tuple[Step, ...]
    pauses: tuple[Pause, ...] = ()

    def __post_init__(self) -> None:
        """Refuse a plan whose steps do not fit its tables."""
        if not self.steps:
            raise PlanError(
                f"the plan of method {self.method} has no steps: give table positions and targets"
            )
        for number, step in enumerate(self.steps):
            if step.index != number:
                raise PlanError(f"step {number} of the plan carries the index {step.index}")
            if not 0 <= step.table_position < len(self.table_angles):
                raise PlanError(
                    f"step {number}: table position {step.table_position} outside 0.."
                    f"{len(self.table_angles) - 1}"
                )

    @property
    def distinct_angles(self) -> tuple[float, ...]:
        """The table angles (rad), each once, in the order of the plan."""
        return tuple(dict.fromkeys(self.table_angles))

    @cached_property
    def counting(self) -> frozenset[int]:
        """The steps that make the result: where the table turns, those that it passes."""
        turning = frozenset(step.index for step in self.steps if step.turn is not None)
        return turning or frozenset(range(len(self.steps)))

    def passed_from(self, index: int) -> range:
        """Return the steps that one order measures: step ``index``, and all its turn passes."""
        end = index + 1
        while end < len(self.steps) and self.steps[end].follows(self.steps[end - 1]):
            end += 1
        return range(index, end)

    def pause_before(self, index: int) -> Pause | None:
        """Return the pause before step ``index``, if there is one."""
        return next((pause for pause in self.pauses if pause.first == index), None)

    def step(self, index: int) -> Step:
        """Return step ``index``; raises PlanError if the plan has no such step."""
        if not 0 <= index < len(self.steps):
            raise PlanError(
                f"step {index} is not in the plan: it has the steps 0 to {len(self.steps) - 1}"
            )
        return self.steps[index]


@dataclass(frozen=True)
class PlanFigures:
    """Figures of a plan: its ``lengths``, their uncertainty and their time.

    ``uncertainty``: predicted U (k = 2) of ECC about its mean, rms over the angles, rad.
    ``seconds``: from the end of the first length to that of the last, as the policy estimates;
    ``cell_seconds``: the same by the clock of the simulated cell, None without one.
    """

    lengths: int
    uncertainty: float
    seconds: float
    cell_seconds: float | None


@dataclass(frozen=True)
class PlanComparison:
    """What was measured (``own``) and the paper's plan, both with ``length_std`` (m) planned."""

    own: PlanFigures
    papers: PlanFigures
    length_std: float
