"""Which observations are spoilt by clocks that differ: what the live capture said of it counts.

Its estimate hangs on when messages came to it, which no recorder knows; its verdicts are in the
bag.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rotcal_ros.capture.stamp_offsets import OffsetLimits, is_of_clocks, rejected_for
from rotcal_ros.catalogue.configuration import Configuration
from rotcal_ros.observations import Observation


def judged_as_live(
    observations: Iterable[Observation], estimates: Sequence[str], recorded: Iterable[Observation]
) -> tuple[Observation, ...]:
    """Return the observations, rejected where the clocks of their streams differ.

    That is what was ``recorded`` of the same attempt; where nothing was (foreign bags, nodes that
    were killed) it is the estimate from the bag at each observation, empty: they are alike.
    """
    live = {_attempt(o): o.reason for o in recorded if o.accepted or is_of_clocks(o.reason)}
    return tuple(
        rejected_for(live.get(_attempt(observation), own), observation)
        for observation, own in zip(observations, estimates, strict=True)
    )


def same_limit(configuration: Configuration, recorded: Iterable[Configuration]) -> bool:
    """Return whether the clocks may differ as much as when it was ``recorded``."""
    allowed = OffsetLimits.of(configuration.capture)
    return all(OffsetLimits.of(known.capture) == allowed for known in recorded)


def _attempt(observation: Observation) -> tuple[int, int, int]:
    return observation.run, observation.step, observation.attempt
