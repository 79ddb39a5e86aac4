"""What a run knew of the runs before it, where the nodes themselves went on.

They went on from the observations that were recorded. The streams tell more where a node died
between a reading and its observation: that step was measured again, and counts once.
"""

from __future__ import annotations

from collections.abc import Iterable

from rotcal_ros.bags import names
from rotcal_ros.bags.run_number import run_number
from rotcal_ros.bags.scan import Scan
from rotcal_ros.observations import Observation


def known_then(
    captured: Iterable[Observation], recorded: Iterable[Observation], scans: Iterable[Scan]
) -> tuple[Observation, ...]:
    """Return the observations without those that no later run of the nodes has known."""
    went_on = (
        scan.metadata
        for scan in scans
        if scan.metadata.get(names.RUN, {}).get("earlier") == names.RECORDED
    )
    last = max(map(run_number, went_on), default=0)
    known = {(o.run, o.step, o.attempt) for o in recorded}
    return tuple(o for o in captured if o.run >= last or (o.run, o.step, o.attempt) in known)
