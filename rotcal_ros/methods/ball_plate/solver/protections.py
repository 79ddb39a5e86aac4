"""What is done about each effect that could spoil a ball plate measurement, from the facts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from rotcal_ros.adjust.reliability import Hidden
from rotcal_ros.foundation.protection import TOLERABLE, Protection, ordered
from rotcal_ros.foundation.units import MICROMETRE


@dataclass(frozen=True)
class PlateEvidence:
    """What a result's protections follow from.

    ``drift_error`` and ``knock_error`` are the largest errors, in stated standard uncertainties,
    that the tests leave unseen with the probability of POWER; ``drift_degree`` is 0 where no drift
    is estimated; ``drift_allowance`` is stated, m over the run. ``n_repeated`` counts the stops of
    the table beyond the first at each position; ``own_arrivals``: nearly every centre has a stop
    of its own; ``repeatability``: their scatter is estimated.
    ``scale_error`` is the error, in standard uncertainties, of the largest radius error that
    passes the check; ``n_groups`` the groups with a zero of their own,
    ``group_allowance`` how far these are apart at most, m, 0 where that is not stated.
    """

    drift_error: float
    knock_error: float
    drift_degree: int
    drift_allowance: float
    n_repeated: int
    own_arrivals: bool
    repeatability: bool
    scale_error: float
    n_groups: int
    hidden: Hidden | None
    group_allowance: float


def protections(facts: PlateEvidence) -> tuple[Protection, ...]:
    """Return all protections, of centres that do not tell which way is up."""
    return ordered(
        [
            _drift(facts),
            _knock(facts),
            Protection(
                "axis noise", "estimated", "each axis has its own, also where one was stated"
            ),
            Protection("error motion", "estimated", "all six deviations are results"),
            _repeatability(facts),
            Protection("refraction", "harmless", "no light is used"),
            _scale(facts),
            Protection(
                "tilt", "estimated", "the pose of the axis and the place of each ball are unknowns"
            ),
            _gauge(facts),
            _one_place(facts.hidden),
            Protection(
                "numbering",
                "not protected",
                "which table angle belongs to position 0 is taken from the table: positions that "
                "are all numbered off by one fit as well, on a plate whose ball steps are off by "
                "as many the other way",
            ),
            Protection(
                "sign of z",
                "not protected",
                "that z points away from the table is taken from the frame: a z column of the "
                "other sign fits every centre as well and turns the signs of EZC, EAC and EBC; "
                "touch points on the upper half of the balls would tell",
            ),
        ]
    )


_DEGREES: Final = {1: "linear", 2: "quadratic"}


def _drift(facts: PlateEvidence) -> Protection:
    if facts.drift_degree:
        shape = _DEGREES[facts.drift_degree]
        return Protection("drift", "estimated", f"a {shape} drift of each axis is an unknown")
    if facts.drift_error <= TOLERABLE:
        why = "the order of measurement shows a linear drift of the CMM's origin"
        return Protection("drift", "tested", why, facts.drift_error)
    if facts.drift_allowance > 0.0:
        why = f"the budget holds {facts.drift_allowance / MICROMETRE:g} um over the run"
        return Protection("drift", "bounded", why)
    return Protection(
        "drift",
        "not protected",
        "the order of measurement hides a drift of the CMM's origin in the table's deviations: "
        "measure in the order interleaved, or state solver.drift_allowance_m",
        _finite(facts.drift_error),
    )


def _knock(facts: PlateEvidence) -> Protection:
    if facts.knock_error <= TOLERABLE:
        why = "a motion of the plate on the table contradicts earlier centres of the same balls"
        return Protection("knock", "tested", why, facts.knock_error)
    return Protection(
        "knock",
        "not protected",
        "a small motion of the plate between two stops may pass for deviations of the table: "
        "measure in the order interleaved, with more balls",
        _finite(facts.knock_error),
    )


def _repeatability(facts: PlateEvidence) -> Protection:
    if facts.repeatability:
        why = f"from {facts.n_repeated} repeated stops of the table"
        return Protection("repeatability", "estimated", why)
    if facts.own_arrivals:
        why = "every centre has a stop of its own, so it is part of the residuals"
        return Protection("repeatability", "estimated", why)
    return Protection(
        "repeatability",
        "not protected",
        "not included: the table came to each position once, or too seldom to tell",
    )


def _scale(facts: PlateEvidence) -> Protection:
    why = "a wrong radius of the ball circle shows in all centres; it scales the rotations"
    return Protection("scale", "tested", why, facts.scale_error)


def _gauge(facts: PlateEvidence) -> Protection:
    if facts.n_groups > 1 and facts.group_allowance > 0.0:
        why = f"the budget holds {facts.group_allowance / MICROMETRE:g} um between the groups"
        return Protection("gauge", "bounded", why)
    if facts.n_groups > 1:
        why = f"{facts.n_groups} groups of table positions have each a zero of their own"
        return Protection("gauge", "not protected", why)
    return Protection(
        "gauge",
        "harmless",
        "mean values, and what a shifted or tilted plate causes, are no part of the curves",
    )


def _one_place(hidden: Hidden | None) -> Protection:
    if hidden is None:
        return Protection(
            "one place",
            "not protected",
            "too many positions to judge what gathers at one of them: single centres are tested",
        )
    size = hidden.size / MICROMETRE
    why = (
        "what displaces several balls at one position together is looked for, and widens U where "
        f"it can be neither proved nor excluded; of {hidden.count} neighbours it is found from "
        f"{size:.2g} um on"
    )
    return Protection("one place", "tested", why, hidden.error)


def _finite(error: float) -> float | None:
    """Return the error, None where nothing bounds it."""
    return error if error < float("inf") else None
