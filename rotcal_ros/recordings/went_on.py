"""What a run knew of the runs before it, where the nodes themselves went on.

They went on from the observations that were recorded. The streams tell more where a node died
between a reading and its observation: that step was measured again, and counts once.
"""

from __future__ import annotations

from collections.abc import Iterable

from rotcal_ros.bags import names
from rotcal_ros.bags.scan import Scan
from rotcal_ros.observations import Observation


def known_then(
    captured: Iterable[Observation], recorded: Iterable[Observation], scans: Iterable[Scan]
) -> tuple[Observation, ...]:
    """Return the observations without those that no later run of the nodes has known."""
    notes = (scan.metadata.get(names.RUN, {}) for scan in scans)
    runs = (note.get("number", "") for note in notes if note.get("earlier") == names.RECORDED)
    last = max((int(run) for run in runs if run.isascii() and run.isdecimal()), default=0)
    known = {(o.run, o.step, o.attempt) for o in recorded}
    return tuple(o for o in captured if o.run >= last or (o.run, o.step, o.attempt) in known)
