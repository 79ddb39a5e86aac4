"""Why a bag yields no observation, in one sentence that says what can be done about it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from rotcal_ros.bags import names
from rotcal_ros.capture.rejections import Commonest
from rotcal_ros.foundation.observations import Observation

_TOPICS: Final = {
    "tracer": names.TRACER_LENGTH,
    "table": names.JOINT_STATES,
    "probe": names.PROBE_POINT,
    "temperature": names.TEMPERATURE,
    "command": f"{names.TABLE_ANGLE} or {names.PROBE_TARGET}",
}
"""What delivers each stream of the capture."""
_MAX_NAMED: Final = 8
_FEW: Final = 0.1
"""Share of steps without an accepted observation that is not worth a warning."""


def why_nothing(
    observations: Sequence[Observation],
    counts: Mapping[str, Mapping[str, int]],
    unreadable: Mapping[str, str],
    broken: Mapping[str, int],
    topics: Iterable[str],
) -> str:
    """Return why none of ``observations`` was accepted.

    ``counts`` is what the capture counted per stream, empty when the recorded observations were
    taken; ``unreadable`` names topics without a usable definition and ``broken`` those whose
    messages could not be decoded; ``topics`` are all of the bag.
    """
    reasons = list(unreadable.values())
    reasons += [f"{topic}: {count} messages cannot be decoded" for topic, count in broken.items()]
    silent = [
        _TOPICS[stream]
        for stream, counted in counts.items()
        if not counted.get("received") and stream in _TOPICS
    ]
    if observations:
        reasons.insert(0, _rejections(observations))
    elif not counts:
        reasons.append(f"it holds none on a topic {names.OBSERVATION}; solve its streams instead")
    elif silent:
        reasons.append(f"nothing was read on {', '.join(silent)}; {_present(topics)}")
    elif counts.get("command", {}).get("unanswered"):
        reasons.append(unanswered(counts["command"]))
    else:
        reasons.append("its streams hold no complete step of the plan")
    return "; ".join(reasons)


def _rejections(observations: Sequence[Observation]) -> str:
    """Return how many were rejected, and the commonest reason."""
    found = Commonest.of(o.reason for o in observations)
    assert found is not None
    return f"all {found.total} were rejected, {found.in_words()}"


def doubtful(
    observations: Sequence[Observation], counts: Mapping[str, Mapping[str, int]]
) -> tuple[str, ...]:
    """Return what a reader should know of attempts that failed, though not all did.

    And how many messages contradict others: it is not known which of them are true.
    """
    texts = []
    rejected = [o.reason for o in observations if not o.accepted]
    found = Commonest.of(rejected)
    if found and 2 * found.total > len(observations):
        texts.append(
            f"{found.total} of {len(observations)} attempts were rejected, {found.in_words()}"
        )
    elif without := _without(observations):
        texts.append(without)
    texts += [
        f"{n} messages on {_TOPICS[stream]} contradict others of the same time or order: two "
        "publishers, or stamps that are too coarse; the first one counts"
        for stream in ("tracer", "table", "probe")
        if (n := counts.get(stream, {}).get("contradicting", 0))
    ]
    commands = counts.get("command", {})
    if 2 * commands.get("unanswered", 0) > commands.get("received", 0):
        texts.append(unanswered(commands))
    return tuple(texts)


def _without(observations: Sequence[Observation]) -> str:
    """Return how many steps were tried in vain, and why; empty: few, such as a blocked beam."""
    done = {o.step for o in observations if o.accepted}
    vain = [o for o in observations if o.step not in done]
    found, steps = Commonest.of(o.reason for o in vain), len({o.step for o in vain})
    if found is None or steps <= _FEW * (len(done) + steps):
        return ""
    return f"{steps} of {len(done) + steps} steps were tried in vain, {found.in_words()}"


def unanswered(commands: Mapping[str, int]) -> str:
    """Say that the machine did not echo its orders."""
    return (
        f"{commands['unanswered']} of {commands['received']} orders have no answer: a point on "
        f"{names.PROBE_POINT} must echo step and attempt of its order"
    )


def _present(topics: Iterable[str]) -> str:
    found = sorted(topics)
    if not found:
        return "it has no topics at all"
    more = f" and {len(found) - _MAX_NAMED} more" if len(found) > _MAX_NAMED else ""
    return (
        f"its topics are {', '.join(found[:_MAX_NAMED])}{more} (see --namespace, and the group "
        "topics of the set-up for other names)"
    )
