"""A whole run of the simulated cell without ROS, also with something wrong in it.

What may spoil a calibration acts on whole observations (:mod:`.disturbance`): the difference that
it makes at a step is added to all that the instrument reads there.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from math import isfinite
from typing import NamedTuple

import numpy as np

from rotcal_ros.capture.capture import Observations, Record
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.observations import (
    Observation,
    PointKind,
    ProbeSample,
    TracerSample,
)
from rotcal_ros.methods.calibration import Calibration
from rotcal_ros.methods.disturbance import DisturbedMeasurement
from rotcal_ros.methods.simulation.table import true_deviations
from rotcal_ros.planning.plan import Step

_LONGEST_S = 3600.0
"""After one hour at a step something is missing."""
_BY_A_TRACKER = (PointKind.DIRECT, PointKind.MIRRORED, PointKind.NEST)


class Event(NamedTuple):
    """An order, or what an instrument sent, at ``time_ns`` while a step was measured.

    ``observed`` is what the record completes.
    """

    time_ns: int
    step: int
    what: Record
    observed: Observations = ()


def simulated_run(
    calibration: Calibration, start_ns: int = 0, *, attempts: int = 1, slice_s: float = 0.2
) -> Iterator[Event]:
    """Yield all orders and records of a run from ``start_ns`` on; its time passes in slices.

    A step whose observations are rejected is ordered again, up to ``attempts`` times in all; so is
    a whole turn.
    Raises ConfigurationError for a cell that cannot be simulated alone.
    """
    configuration = calibration.configuration
    cell = calibration.method.simulated_cell(configuration.simulation, start_ns)
    capture = calibration.capture()

    known: dict[tuple[int, int], Observation] = {}

    def order(step: Step, number: int) -> Iterator[Event]:
        command = step.command(number)
        cell.order_table(command)
        cell.order_probe(command)
        yield Event(cell.now_ns, step.index, command)

    def attempt(step: Step, number: int) -> Iterator[Event]:
        for _ in range(round(_LONGEST_S / slice_s)):
            if (step.index, number) in known:
                return
            out = cell.advance(slice_s)
            events = [
                Event(record.stamp_ns, step.index, record, capture.feed(record))
                for record in (*out.temperature, *out.air, *out.table, *out.tracer, *out.probe)
            ]
            known.update({(o.step, o.attempt): o for each in events for o in each.observed})
            yield from events
        raise ConfigurationError(
            f"{configuration.source}: the simulated cell does not finish step {step.index} "
            "within an hour; an external table or silent instruments cannot be simulated "
            "alone: set simulation.table.external to false"
        )

    plan, index = calibration.plan, 0
    while index < len(plan.steps):
        left = plan.passed_from(index)
        for number in range(attempts):
            yield from order(plan.steps[left[0]], number)
            for step in left:
                yield from attempt(plan.steps[step], number)
                if not isfinite(known[step, number].table_angle_measured):
                    break
            accepted = {key[0] for key, o in known.items() if o.accepted}
            if all(step in accepted for step in left):
                break
        index = left.stop


def disturb_events(
    events: Iterable[Event], calibration: Calibration, measured: DisturbedMeasurement
) -> Iterator[Event]:
    """Yield the events of a run whose steps read what was ``measured``, without observations.

    To the readings is added by how much ``measured`` differs from what an instrument without error
    sees at a perfect table; the simulated cell has added the deviations of its own table.
    """
    nominal = [np.array(o.mean) for o in calibration.nominal_observations()]
    shifts = [np.array(o.mean) - n for o, n in zip(measured.observations, nominal, strict=True)]
    for event in events:
        record, shift = event.what, shifts[event.step]
        if isinstance(record, TracerSample):
            record = replace(record, length=record.length + float(shift[0]))
        elif isinstance(record, ProbeSample) and record.kind is not PointKind.REFLECTOR:
            place = np.array(record.position)
            if record.kind in _BY_A_TRACKER:
                shift = _along_beam(place) @ _along_beam(nominal[event.step]).T @ shift
            x, y, z = (place + shift).tolist()
            record = replace(record, position=(x, y, z))
        yield Event(event.time_ns, event.step, record)


def _along_beam(seen: Floats) -> Floats:
    """Return the axes (3, 3), as columns: along the beam to a point, level across it, and up.

    A tracker stands upright, but is turned about its vertical in any way.
    """
    along = seen / np.linalg.norm(seen)
    level = np.cross([0.0, 0.0, 1.0], along)
    level /= np.linalg.norm(level)
    return np.column_stack([along, level, np.cross(along, level)])


def visible_truth(
    calibration: Calibration, measured: DisturbedMeasurement | None = None
) -> dict[str, Floats]:
    """Return the true deviations (n,) of the simulated table, as far as the method can see them.

    m or rad, at the distinct angles of the plan; those of ``measured`` come on top.
    """
    angles = np.array(calibration.plan.distinct_angles)
    true = dict(true_deviations(calibration.configuration.simulation.table, angles))
    for name, added in ({} if measured is None else measured.truth).items():
        true[name] = true[name] + added
    return calibration.method.gauge(angles, true)
