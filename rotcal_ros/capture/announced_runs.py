"""Whose plans a bag holds: those of runs that the cell's planner named, or a stranger's.

Any node may publish on the topic of the plan. While it runs a plan, the planner names the run in
its beat; a plan that no beat names is a stranger's, and says nothing about the measurement.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from rotcal_ros.bags import names
from rotcal_ros.bags.decode import Decoder
from rotcal_ros.bags.reader import read_blocks
from rotcal_ros.bags.settings import DEFAULT_LIMITS, ReadingLimits
from rotcal_ros.capture.publishers import RUN
from rotcal_ros.foundation.errors import BagError

PLANNER: Final = "planner"


def foreign_plans(
    files: tuple[Path, ...],
    planned: Collection[tuple[str, str]],
    attached: Collection[str] = (),
    limits: ReadingLimits = DEFAULT_LIMITS,
) -> frozenset[str]:
    """Return which of the plans in a bag belong to no run of its planner.

    ``planned`` are the plans: the run that each announces, and the text of its configuration;
    ``attached`` are the texts that the recorder was given. They count where no beat names any of
    the runs; where none of them is planned either, it is not known whose the plans are: none is
    returned.
    """
    runs = frozenset(run for run, _ in planned)
    if len(runs) < 2:
        return frozenset()
    named = runs.intersection(_named_by_the_planner(files, runs, limits))
    ours = named or {run for run, text in planned if text in attached}
    return runs - ours if ours else frozenset()


def _named_by_the_planner(
    files: tuple[Path, ...], runs: Collection[str], limits: ReadingLimits
) -> Iterator[str]:
    """Yield the runs that beats of the planner name, of either form that beats have had."""
    wanted = [run.encode() for run in runs]
    for scan, block in read_blocks(files, None, limits):
        if block is None:
            continue
        for number in block.counts():
            channel = scan.channels[number]
            if channel.topic.rpartition("/")[2] != names.HEARTBEAT:
                continue
            try:
                decoder = Decoder(channel)
            except BagError:
                continue
            for row in np.flatnonzero(block.headers["channel"] == number).tolist():
                payload = block.payload(row)
                if any(run in payload for run in wanted):  # decoding takes 50 times as long
                    yield from _run_of(decoder.message(payload))


def _run_of(beat: Any) -> Iterator[str]:
    if PLANNER in (getattr(beat, "node", ""), getattr(beat, "name", "")):
        yield from (entry.value for entry in getattr(beat, "values", ()) if entry.key == RUN)
