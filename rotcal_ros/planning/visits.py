"""Repeated runs after ISO 230-2: to which target angle the table goes, when, from which side."""

from __future__ import annotations

from dataclasses import dataclass

from rotcal_ros.foundation.observations import Approach


@dataclass(frozen=True, slots=True)
class Visit:
    """One arrival of the table at target angle number ``target`` in ``run``, from one side."""

    target: int
    run: int
    approach: Approach


def visits(targets: int, runs: int, bidirectional: bool) -> tuple[Visit, ...]:
    """Return all arrivals: up through ``targets`` angles, and down again if ``bidirectional``.

    Every run is complete before the next begins.
    """
    ways = [(range(targets), Approach.POSITIVE)]
    if bidirectional:
        ways.append((range(targets)[::-1], Approach.NEGATIVE))
    return tuple(
        Visit(target, run, approach)
        for run in range(runs)
        for order, approach in ways
        for target in order
    )
