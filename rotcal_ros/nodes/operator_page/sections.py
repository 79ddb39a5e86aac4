"""Sections of the page, made from messages and from the beats of nodes."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

import numpy as np
from rotcal_msgs.msg import DeviationArray, Pause

from rotcal_ros.evaluation.marks import Mark, tolerance_mark, why_verdict_withholds
from rotcal_ros.foundation.components import COMPONENTS, COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.language import join_texts, noted, phrase
from rotcal_ros.foundation.protection import split_verdict_line
from rotcal_ros.foundation.session_folder import resume_command, unfinished
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.methods import Calibration
from rotcal_ros.nodes.runtime.health import Health
from rotcal_ros.page.state import (
    Cell,
    Curve,
    Deviations,
    OperatorTask,
    PageMark,
    PlanView,
    RecorderState,
    ShownNode,
)
from rotcal_ros.planning.plan import TABLE_FRAME, Point

SILENT: Final = 3
MOST_TARGETS: Final = 400
OF_THE_BAG: Final = ("file", "messages", "topics")


def cell_section(calibration: Calibration, namespace: str) -> Cell:
    """Return what is calibrated."""
    configuration = calibration.configuration
    return Cell(
        namespace=namespace,
        method=phrase(calibration.method.title),
        axis=configuration.cell.axis,
        simulated=configuration.simulated,
        item=configuration.identity.item,
        serial=configuration.identity.serial,
        plan_id=configuration.plan_id,
    )


def plan_view(calibration: Calibration) -> PlanView:
    """Return targets and positions of the instrument, seen from above."""
    plan = calibration.plan
    targets = dict.fromkeys(seen_from_above(step.position) for step in plan.steps)
    places = (calibration.instrument_place(step) for step in plan.steps)
    stands = dict.fromkeys(seen_from_above(place) for place in places if place is not None)
    every = max(1, math.ceil(len(targets) / MOST_TARGETS))
    return PlanView(
        angles_deg=tuple(
            dict.fromkeys(round(a / DEGREE, 3) % 360.0 for a in plan.distinct_angles)
        ),
        targets=tuple(targets)[::every],
        stands=tuple(stands),
    )


def operator_task(calibration: Calibration, pause: Pause) -> OperatorTask | None:
    """Return what a pause asks a person to move; None if it moves nothing, or is over."""
    if not pause.waiting or pause.kind != Pause.KIND_MOVE:
        return None
    plan = calibration.plan
    moves = [p.move for p in plan.pauses if p.move is not None and p.move.what == pause.what]
    stations = sorted({move.station for move in moves} | {pause.station})
    x, y, z = map(float, pause.position)
    return OperatorTask(
        what=pause.what,
        number=1 + stations.index(pause.station),
        count=len(stations),
        station=pause.station,
        at=None if math.isnan(x) else (x, y, z),
        rides=pause.header.frame_id == TABLE_FRAME,
        again=all(planned.instruction != pause.instruction for planned in plan.pauses),
    )


def seen_from_above(place: Point) -> tuple[float, float]:
    """Return a place seen from above."""
    return round(place[0], 4), round(place[1], 4)


def deviations_section(message: DeviationArray, identity: Identity) -> Deviations:
    """Return the curves of a solution, in units for people; without U if it is withheld."""
    why = why_verdict_withholds(message.verdict, message.warnings) if message.final else None
    curves = []
    for name in COMPONENTS:
        values = getattr(message, name.lower())
        std = getattr(message, f"{name.lower()}_std")
        if len(values):
            factor, unit = unit_of(name)
            expanded = [] if why else [COVERAGE_FACTOR * s / factor for s in std]
            curves.append(Curve(name, unit, _rounded(v / factor for v in values),
                                _rounded(expanded)))  # fmt: skip
    return Deviations(
        angles_deg=_rounded(a / DEGREE for a in message.angles),
        curves=tuple(curves),
        observations=message.n_observations,
        final=message.final,
        marks=_marks(message, identity, why) if message.final else (),
        warnings=tuple(message.warnings),
        withheld=why or "",
    )


def _marks(message: DeviationArray, identity: Identity, why: str | None) -> tuple[PageMark, ...]:
    """Return the marks of a final solution, as its report has them."""
    values, std = (
        {n: np.array(found) for n in COMPONENTS if len(found := getattr(message, n.lower() + end))}
        for end in ("", "_std")
    )
    words, remark = split_verdict_line(message.verdict_line or message.verdict)
    about = Mark("measurement", message.verdict, phrase(words), remark)
    against = tolerance_mark(values, std, identity, why)
    return tuple(PageMark.of(m) for m in (about, against) if m is not None)


def _rounded(values: Iterable[float]) -> tuple[float | None, ...]:
    return tuple(round(float(v), 5) if math.isfinite(v) else None for v in values)


def node_states(health: Health) -> tuple[ShownNode, ...]:
    """Return the nodes that are there, or were until they were lost."""
    found = []
    for name, beat in sorted(health.others.items()):
        level = SILENT if name in health.lost else beat.level
        words = phrase("silent") if level == SILENT else _words(health, name)
        if (seconds := health.slow.get(name)) is not None:
            words = phrase("slow: no heartbeat for {0} s; {1}", f"{seconds:.0f}", words)
            level = max(level, 1)
        found.append(ShownNode(name, words, level))
    return tuple(found)


def _words(health: Health, name: str) -> str:
    """Return the state of a node with what troubles it."""
    values = health.values(name)
    forms = {"lost_nodes": noted("without {0}"), "unfinished": "{0}"}
    trouble = [phrase(form, values[key]) for key, form in forms.items() if key in values]
    return join_texts([health.describe(name), *trouble])


def recorder_state(values: Mapping[str, str]) -> RecorderState | None:
    """Return the state of the bag, from the recorder's values; None before there is one."""
    if "file" not in values:
        return None
    losses = {k: int(n) for k, n in values.items() if k not in OF_THE_BAG and n.isdigit()}
    return RecorderState(
        file=values["file"],
        messages=int(values.get("messages", 0)),
        lost=sum(n for name, n in losses.items() if not name.startswith("silent")),
        losses=tuple(f"{name}: {n}" for name, n in losses.items()),
        free_gb=_free_gb(Path(values["file"]).parent),
    )


def resume_command_line(bag_folder: str) -> str:
    """Return the command line that goes on with a session on this machine; empty: there is none.

    ``bag_folder`` is empty where nothing was recorded.
    """
    session = Path(bag_folder).parent
    return resume_command(session) if bag_folder and unfinished(session) else ""


def _free_gb(folder: Path) -> float | None:
    """Return the free space beside a bag, None for one on another machine."""
    try:
        return round(shutil.disk_usage(folder).free / 1e9, 1)
    except OSError:
        return None
