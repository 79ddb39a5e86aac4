"""What the page shows, as frozen sections; a viewer is sent those that have changed.

Numbers are in the units that people read, named by their suffix; times are seconds since 1970.
None means not known. All viewers look at one board; courses of values never grow without bound.
The large line says what happens now, or what a person has to do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from math import isfinite
from typing import TYPE_CHECKING, Any, Final, Literal

from rotcal_ros.foundation.language import Phrase, noted, phrase
from rotcal_ros.foundation.node_state import RELEASED, STOPS, UNHEARD, NodeState, State, Why

if TYPE_CHECKING:
    from rotcal_ros.evaluation.marks import Mark

Points = tuple[tuple[float, float], ...]
Point = tuple[float, float, float]
Kind = Literal[
    "waiting", "ready", "measuring", "person", "confirm", "emergency", "stopping", "done",
    "stopped", "failed",
]  # fmt: skip
"""What the cell does, or what a person has to do (``person``, ``confirm``, ``emergency``)."""


@dataclass(frozen=True, slots=True)
class Cell:
    """What is calibrated. ``simulated`` is None until it is known."""

    namespace: str = ""
    method: str = ""
    axis: str = ""
    simulated: bool | None = None
    item: str = ""
    serial: str = ""
    plan_id: str = ""


@dataclass(frozen=True, slots=True)
class CurrentActivity:
    """What happens now, large; ``resume`` and ``stop`` are what a person may do.

    ``instruction`` is the work whose end ``resume`` reports, ``command`` the command line that
    goes on with a session that has no result.
    """

    kind: Kind = "waiting"
    headline: str = phrase("Waiting for the planner")
    detail: str = ""
    resume: bool = False
    stop: bool = False
    instruction: str = ""
    command: str = ""


@dataclass(frozen=True, slots=True)
class StepProgress:
    """How far the measurement has come; ``end_s`` is the expected end."""

    step: int
    total: int
    accepted: int
    rejected: int
    left: int
    end_s: float | None


@dataclass(frozen=True, slots=True)
class Curve:
    """A deviation with its expanded uncertainty (k = 2), both in ``unit``.

    ``expanded`` is empty if it is withheld.
    """

    name: str
    unit: str
    values: tuple[float | None, ...]
    expanded: tuple[float | None, ...]


@dataclass(frozen=True, slots=True)
class PageMark:
    """One answer about a result: ``line`` in words, ``kind`` names its colour.

    ``remark`` is the line below it: what the answer does not cover.
    """

    name: str
    kind: str
    line: str
    remark: str = ""

    @classmethod
    def of(cls, mark: Mark) -> PageMark:
        """Return the mark of a result as the page has it."""
        return cls(mark.name, mark.kind, mark.line, mark.remark)


@dataclass(frozen=True, slots=True)
class Deviations:
    """What is known of the table so far; there are ``marks`` once it is ``final``.

    ``withheld`` says why no uncertainty may be stated; empty if it may.
    """

    angles_deg: tuple[float | None, ...]
    curves: tuple[Curve, ...]
    observations: int
    final: bool
    marks: tuple[PageMark, ...]
    warnings: tuple[str, ...]
    withheld: str = ""


@dataclass(frozen=True, slots=True)
class ShownUncertainty:
    """The uncertainty of ECC and how it stands to the goal, if any.

    ``largest_arcsec`` is U, the largest expanded uncertainty (k = 2) of the curve, as everywhere;
    ``course`` holds it over the accepted steps. ``goal_arcsec`` is for another figure, the root
    mean square of U about the mean: ``rms_arcsec``, from the policy. ``withheld`` says why
    none of it may be stated; empty if it may.
    """

    largest_arcsec: float | None = None
    rms_arcsec: float | None = None
    goal_arcsec: float | None = None
    course: Points = ()
    withheld: str = ""


@dataclass(frozen=True, slots=True)
class PlanView:
    """The cell from above, m, machine frame: targets, and where the instrument stands in turn."""

    angles_deg: tuple[float, ...]
    targets: Points
    stands: Points


@dataclass(frozen=True, slots=True)
class OrderedStep:
    """The step that was ordered last; ``stand`` is None if there is no beam."""

    place: str
    table_angle_deg: float
    target: tuple[float, float]
    stand: tuple[float, float] | None
    visited_deg: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class OperatorTask:
    """What a person brings where: ``what`` to place ``number`` of ``count``, both from 1.

    ``station`` is its number in the data. ``at`` is where it shall stand, m, x y z: on the table
    at angle 0 if it ``rides`` there, else in the machine frame; None where the plan does not say.
    ``again``: it was done before, and not well.
    """

    what: str
    number: int
    count: int
    station: int
    at: Point | None = None
    rides: bool = False
    again: bool = False


@dataclass(frozen=True, slots=True)
class LiveReading:
    """The live reading of the instrument, with its unit."""

    label: str
    now: str
    trouble: str


@dataclass(frozen=True, slots=True)
class Temperature:
    """One sensor since the page began: latest, range, drift, and the course in degC."""

    sensor: str
    now_c: float
    low_c: float
    high_c: float
    drift_k_per_h: float | None
    course: Points


@dataclass(frozen=True, slots=True)
class RejectedAttempt:
    """An attempt that was not accepted."""

    time_s: float
    place: str
    reason: str


@dataclass(frozen=True, slots=True)
class ShownNode:
    """A node of the cell; ``level`` is 0 well, 1 warning, 2 error, 3 silent."""

    name: str
    words: str
    level: int


@dataclass(frozen=True, slots=True)
class TopicState:
    """An instrument's topic."""

    topic: str
    rate_hz: float
    silent_s: float | None


@dataclass(frozen=True, slots=True)
class RecorderState:
    """The bag: ``lost`` messages known to be lost, free space beside it."""

    file: str
    messages: int
    lost: int
    losses: tuple[str, ...]
    free_gb: float | None


@dataclass(frozen=True, slots=True)
class LogLine:
    """A warning or an error of a node."""

    time_s: float
    error: bool
    node: str
    text: str


@dataclass(frozen=True, slots=True)
class ShownOffer:
    """A compensation table that waits at the bridge; ``why_not`` says why it cannot be applied.

    ``in_force``, ``residual`` and ``bridge`` are what the bridge says in words of the table that
    it replaces or adds to, of what will be left, and of itself.
    ``before_arcsec``, ``after_arcsec``: correction of the controller now and with this table,
    for increasing angle; ``*_reverse_*`` the same for decreasing angle. ``simulated``: no
    instrument measured the table.
    """

    confirmation: str
    table_hash: str
    verdict: str
    in_force: str
    residual: str
    bridge: str
    why_not: str
    applied: bool
    angles_deg: tuple[float, ...] = ()
    before_arcsec: tuple[float, ...] = ()
    after_arcsec: tuple[float, ...] = ()
    expanded_arcsec: tuple[float, ...] = ()
    before_reverse_arcsec: tuple[float, ...] = ()
    after_reverse_arcsec: tuple[float, ...] = ()
    expanded_reverse_arcsec: tuple[float, ...] = ()
    simulated: bool = False


@dataclass(frozen=True, slots=True)
class PageState:
    """All that the page shows; ``ended`` says that the cell has been switched off in order.

    ``task`` is what a pause is for, ``table_deg`` where the table stands. ``length_course`` holds
    the lengths of the last minute, mm.
    """

    cell: Cell = Cell()
    now: CurrentActivity = CurrentActivity()
    steps: StepProgress | None = None
    deviations: Deviations | None = None
    standing: ShownUncertainty = ShownUncertainty()
    view: PlanView | None = None
    pointing: OrderedStep | None = None
    task: OperatorTask | None = None
    table_deg: float | None = None
    lengths: LiveReading | None = None
    length_course: Points = ()
    temperatures: tuple[Temperature, ...] = ()
    rejections: tuple[RejectedAttempt, ...] = ()
    nodes: tuple[ShownNode, ...] = ()
    streams: tuple[TopicState, ...] = ()
    recording: RecorderState | None = None
    log: tuple[LogLine, ...] = ()
    offer: ShownOffer | None = None
    ended: bool = False


NAMES: Final = tuple(field.name for field in fields(PageState))


def state_changes(seen: PageState | None, state: PageState) -> Mapping[str, Any]:
    """Return what has to be sent to a viewer who has ``seen`` a state; all of it for None."""
    return {
        name: json_value(getattr(state, name))
        for name in NAMES
        if seen is None or getattr(seen, name) != getattr(state, name)
    }


def json_value(value: Any) -> Any:
    """Return what JSON can hold: of a phrase its parts; NaN and infinity become None."""
    if isinstance(value, Phrase):
        return [value.template, *map(json_value, value.shown)]
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: json_value(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, tuple):
        return [json_value(item) for item in value]
    return None if isinstance(value, float) and not isfinite(value) else value


COURSE_POINTS: Final = 240


class StateBoard:
    """Holds the present state. One thread changes it, any number look at it.

    A viewer remembers the state it has seen, so that nothing is queued for a slow one.
    """

    def __init__(self) -> None:
        self.state = PageState()

    def show(self, **sections: Any) -> None:
        """Replace sections by new ones."""
        self.state = replace(self.state, **sections)


class ValueHistory:
    """The course of a value over any time, thinned to at most ``limit`` points."""

    def __init__(self, limit: int = COURSE_POINTS) -> None:
        self._limit = limit
        self._every = 1
        self._heard = 0
        self._points: list[tuple[float, float]] = []

    def add(self, x: float, y: float) -> None:
        """Take the next value."""
        if self._heard % self._every == 0:
            self._points.append((x, y))
        self._heard += 1
        if len(self._points) > self._limit:
            self._points = self._points[::2]
            self._every *= 2

    @property
    def points(self) -> Points:
        """What is kept, in order."""
        return tuple(self._points)


_HEADLINES: Final = {
    **dict.fromkeys(
        (Why.PREFLIGHT, Why.PREFLIGHT_NODES, Why.PREFLIGHT_CLOCKS, Why.PREFLIGHT_TOPICS),
        phrase("Checking the cell"),
    ),
    Why.OPENING_BAG: phrase("Starting the recording"),
    Why.SOLVING: phrase("Computing the deviations"),
    Why.CLOSING_BAG: phrase("Closing the recording"),
}


PRESS: Final = phrase("Press Continue when it is done.")
_STOPS: Final = {
    Why.STOPPED: (
        noted("Emergency stop: {0}."),
        noted("No motion is commanded, and the current step will be repeated. Recording "
              "continues and the bag is safe. Release the stop, then press Continue."),
    ),
    Why.RELEASED: (
        noted("Emergency stop released, cause: {0}."),
        noted("Nothing moves until you press Continue: make sure that the cell is clear to move."),
    ),
    Why.RELEASED_AND_WORK: (
        noted("Emergency stop released, cause: {0}."),
        noted("Nothing moves until you press Continue: make sure that the cell is clear to move "
              "({1})."),
    ),
}  # fmt: skip
"""Headline and detail of a stop, to be filled with the arguments of its reason."""


@dataclass(frozen=True, slots=True)
class PlannerStatus:
    """What was heard of the planner and its goal.

    ``planner`` is its state, UNKNOWN if it is not there; ``silent``: it was there and fell silent.
    ``calibrating``: a goal runs; ``doing`` and ``activity`` say what it does, as a code and in
    words, ``instruction`` what it waits for, ``task`` the same as data. ``ended``: the last goal
    has ended, with a verdict or an error, and may go on with ``command``.
    """

    planner: NodeState = UNHEARD
    silent: bool = False
    calibrating: bool = False
    doing: Why = Why.UNKNOWN
    activity: str = ""
    instruction: str = ""
    task: OperatorTask | None = None
    stopping: bool = False
    ended: bool = False
    canceled: bool = False
    verdict: str = ""
    error: str = ""
    command: str = ""


def current_activity(heard: PlannerStatus, offer: ShownOffer | None = None) -> CurrentActivity:
    """Return the large line; ``offer`` is a table that waits for a person."""
    if heard.silent:
        detail = _sentence(heard.error) or phrase("Nothing moves.")
        return CurrentActivity("failed", phrase("The planner no longer answers"), detail)
    here = heard.planner.state is not State.UNKNOWN
    if here and heard.calibrating:
        return _calibrating(heard)
    if offer is not None and not (offer.why_not or offer.applied):
        return CurrentActivity("confirm", phrase("A table waits for your confirmation"),
                   phrase("See below what it changes."))  # fmt: skip
    return _after_the_end(heard) or (_ready(heard.planner) if here else CurrentActivity())


def _ready(planner: NodeState) -> CurrentActivity:
    words = phrase("The planner is {0}: no calibration runs.", planner.describe())
    return CurrentActivity("ready", phrase("Ready"), words)


def _calibrating(heard: PlannerStatus) -> CurrentActivity:
    if heard.stopping:
        return CurrentActivity("stopping", phrase("Stopping"), phrase("The bag is being closed."))
    if heard.instruction:
        headline, detail = _asked(heard)
        stopped = heard.doing in STOPS
        return CurrentActivity("emergency" if stopped else "person", headline, detail,
                   resume=not stopped or heard.doing in RELEASED, stop=True,
                   instruction=heard.instruction)  # fmt: skip
    if heard.doing in _HEADLINES:
        return CurrentActivity("measuring", _HEADLINES[heard.doing], stop=True)
    headline = phrase("Measuring") if heard.activity else phrase("Starting")
    return CurrentActivity("measuring", headline, _sentence(heard.activity), stop=True)


def _asked(heard: PlannerStatus) -> tuple[str, str]:
    """Return what a person has to do: its headline, and more about it."""
    task = heard.task
    if task is not None and heard.doing is Why.WORK:
        place = (phrase(task.what), task.number, task.count)
        if task.again:
            return phrase("Not in place yet: {0} at place {1} of {2}", *place), heard.instruction
        put = phrase("Fix the {0} at place {1} of {2} on the table", *place)
        return (put if task.rides else phrase("Put the {0} at place {1} of {2}", *place), PRESS)
    for reason in heard.planner.reasons:
        if reason.code in _STOPS and reason.code is heard.doing:
            headline, detail = _STOPS[reason.code]
            return phrase(headline, *reason.arguments), phrase(detail, *reason.arguments)
    what, _, more = heard.instruction.partition("; ")
    if heard.doing in STOPS:
        return _sentence(what), _sentence(more)
    return _sentence(what), phrase("{0} {1}", _sentence(more), PRESS) if more else PRESS


def _after_the_end(heard: PlannerStatus) -> CurrentActivity | None:
    if not heard.ended:
        return None
    if heard.canceled:
        return CurrentActivity(
            "stopped", phrase("Stopped"), _sentence(heard.error), command=heard.command
        )
    if heard.error:
        headline = phrase("The calibration ended without a result")
        return CurrentActivity("failed", headline, _sentence(heard.error), command=heard.command)
    return CurrentActivity("done", phrase("Finished, measurement {0}", phrase(heard.verdict)),
               phrase("The result and its bag are on disk."))  # fmt: skip


def _sentence(words: str) -> str:
    """Return words as a sentence; a phrase is one already where it is shown as one."""
    words = words if isinstance(words, Phrase) else words.strip()
    if isinstance(words, Phrase) or not words:
        return words
    return words[0].upper() + words[1:] + ("" if words[-1] in ".!?" else ".")
