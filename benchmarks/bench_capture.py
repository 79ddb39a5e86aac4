"""Throughput of the capture in samples per second: one by one as live, in blocks as in replay.

``rows()`` yields one measurement each. The samples come from the simulated cell at the default
rates (tracer 1 kHz, table 100 Hz); both ways must give the same observations.
"""

import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby

import numpy as np

from rotcal_ros.capture import Capture, CaptureSettings, Record
from rotcal_ros.foundation.observations import Observation, TracerSample
from rotcal_ros.methods import find_method
from rotcal_ros.methods.tracer.method import METHOD
from rotcal_ros.methods.tracer.plan import tracer_plan
from rotcal_ros.methods.tracer.settings import TracerPlanSettings, TracerSimulationSettings
from rotcal_ros.planning.plan import Plan

RULES = find_method("tracer_multistation").capture
SETTINGS = CaptureSettings()
REPEATS = 5


@dataclass(frozen=True)
class Row:
    """Best of several runs; ``ratio`` is the throughput over that of single samples."""

    name: str
    samples: int
    observations: int
    samples_per_s: float
    ratio: float


def recorded() -> tuple[Plan, list[Record]]:
    """Return a plan of 48 steps and all records of measuring it once, in order of arrival."""
    plan = tracer_plan(TracerPlanSettings(table_positions=6, box_points=(2, 2, 2)))
    cell, capture, records = (
        METHOD.simulated_cell(TracerSimulationSettings()),
        Capture(plan, SETTINGS, RULES),
        [],
    )
    for step in plan.steps:
        cell.order_table(step.command(0))
        cell.order_probe(step.command(0))
        found = 0
        while not found:
            out = cell.advance(0.02)
            batch = [*out.probe, *out.table, *out.temperature, *out.tracer]
            found = sum(len(capture.feed(record)) for record in batch)
            records += batch
    return plan, records


def single(plan: Plan, records: Sequence[Record]) -> list[Observation]:
    """Feed record by record."""
    capture = Capture(plan, SETTINGS, RULES)
    return [observation for record in records for observation in capture.feed(record)]


def blocks(plan: Plan, parts: Sequence[tuple[np.ndarray, ...] | Record]) -> list[Observation]:
    """Feed runs of tracer readings as arrays, all else record by record."""
    capture, found = Capture(plan, SETTINGS, RULES), []
    for part in parts:
        found += capture.feed_tracer(*part) if isinstance(part, tuple) else capture.feed(part)
    return found


def in_blocks(records: Sequence[Record]) -> list[tuple[np.ndarray, ...] | Record]:
    """Return the records, each run of tracer readings as (stamp, sequence, length, status)."""
    parts: list[tuple[np.ndarray, ...] | Record] = []
    for tracer, run in groupby(records, key=lambda record: isinstance(record, TracerSample)):
        if tracer:
            columns = zip(
                *((s.stamp_ns, s.sequence, s.length, s.status) for s in run), strict=True
            )
            parts.append(tuple(np.array(column) for column in columns))
        else:
            parts += run
    return parts


def best_time(function: Callable[[], list[Observation]]) -> tuple[float, list[Observation]]:
    """Return the shortest time in seconds and the answer."""
    times = []
    for _ in range(REPEATS):
        begin = time.process_time()
        answer = function()
        times.append(time.process_time() - begin)
    return min(times), answer


def rows() -> Iterator[Row]:
    """Measure both ways."""
    plan, records = recorded()
    parts = in_blocks(records)
    slow, expected = best_time(lambda: single(plan, records))
    fast, answer = best_time(lambda: blocks(plan, parts))
    assert answer == expected
    count = len(records)
    yield Row("capture, sample by sample", count, len(expected), count / slow, 1.0)
    yield Row("capture, tracer in blocks", count, len(answer), count / fast, slow / fast)


if __name__ == "__main__":
    for row in rows():
        print(json.dumps(asdict(row)))
