"""Which compensation table a controller held during a measurement: a hash, none, or unknown."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.language import Phrase, phrase

UNKNOWN: Final = "unknown"
NONE: Final = "none"


def check_in_force(state: str) -> str:
    """Return ``state``; ConfigurationError unless it is a SHA-256, "none" or "unknown"."""
    if _is_state(state):
        return state
    raise ConfigurationError(
        f"table in force {state!r}: expected the SHA-256 of the controller's files (64 digits, "
        f"contents_sha256 of the side file), '{NONE}' or '{UNKNOWN}'"
    )


def _is_state(state: str) -> bool:
    return state in (UNKNOWN, NONE) or re.fullmatch(r"[0-9a-f]{64}", state) is not None


def states_of_axis(announcements: Iterable[tuple[str, str]], axis: str) -> tuple[str, ...]:
    """Return the states among ``announcements`` (axis, state) that are about ``axis``.

    An announcement without an axis is about the only axis of its cell.
    """
    return tuple(state for about, state in announcements if about in ("", axis))


def agreed_state(states: Iterable[str]) -> str:
    """Return what all ``states`` agree on, else "unknown".

    A hash and "unknown" give the hash: adding to it later requires this same table at the
    controller. "none" and "unknown" give "unknown": it cannot be verified later that there was no
    table. Text of a foreign cell that is not a state at all gives "unknown".
    """
    stated = set(states) - {""}
    definite = stated - {UNKNOWN}
    if len(definite) != 1 or not all(map(_is_state, definite)) or stated == {NONE, UNKNOWN}:
        return UNKNOWN
    return definite.pop()


def describe_contradiction(states: Iterable[str]) -> Phrase | None:
    """Return in words how ``states`` contradict each other, if they do."""
    stated = set(states) - {""}
    if stated == {NONE, UNKNOWN}:
        return phrase(
            "'{0}' was stated as the table in force, and '{1}' was announced too: which table "
            "was in force is {2}", NONE, UNKNOWN, UNKNOWN
        )  # fmt: skip
    definite = sorted(stated - {UNKNOWN})
    if wrong := [state for state in definite if not _is_state(state)]:
        return phrase(
            "the cell announced {0!r}, which is not a table in force (a SHA-256, '{1}' or '{2}'): "
            "which one was is {2}", wrong[0], NONE, UNKNOWN
        )  # fmt: skip
    if len(definite) < 2:
        return None
    return phrase(
        "more than one table was in force ({0}): which is {1}",
        ", ".join(s[:12] for s in definite), UNKNOWN
    )  # fmt: skip


def is_table_hash(state: str) -> bool:
    """Return whether ``state`` names a table."""
    return state not in (UNKNOWN, NONE, "")


def describe(state: str) -> str:
    """Return what was in force during a measurement, for people."""
    if is_table_hash(state):
        return phrase("measured with table {0} in force: the deviations are what it leaves "
                      "uncorrected", state[:12])  # fmt: skip
    if state == NONE:
        return phrase("measured with no table in force: these are the full deviations")
    return phrase(
        "not known which table was in force: the whole deviation, or what a table leaves"
    )
