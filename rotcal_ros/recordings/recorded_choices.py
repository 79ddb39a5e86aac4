"""Why each step was measured: the choices in a bag, and the same policy asked again."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from threadpoolctl import threadpool_limits

from rotcal_ros import methods
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.methods.continuation import Continuation
from rotcal_ros.planning.choices import AS_LISTED, Choice, Standing, StepOutcome

ENDLESS: Final = 2**62


@dataclass(frozen=True)
class RecordedChoice:
    """One choice of a run; ``attempt`` is the first one that belongs to it."""

    run: int
    number: int
    attempt: int
    choice: Choice

    @classmethod
    def of(cls, message: Any) -> RecordedChoice:
        """Return what a rotcal_msgs/StepChoice says."""
        standing = Standing(message.left, message.uncertainty, message.goal)
        step = None if message.stop else message.step
        choice = Choice(step, message.reason, standing)
        return cls(message.run, message.number, message.attempt, choice)


def differences(
    calibration: methods.Calibration,
    choices: Sequence[RecordedChoice],
    observations: Iterable[Observation],
) -> tuple[str, ...]:
    """Return where the policy, given the recorded observations, chooses otherwise than it did.

    ``calibration`` has the settings of the planner. The policy as_listed makes no choices.
    """
    if calibration.configuration.planner.policy == AS_LISTED:
        return ()
    every = tuple(observations)
    found = []
    for run in sorted({recorded.run for recorded in choices}):
        mine = sorted((c for c in choices if c.run == run), key=lambda c: c.number)
        continuation = _begun(calibration, run, [o for o in every if o.run < run])
        with threadpool_limits(1, "blas"):  # as the planner
            text = _first_difference(
                calibration, continuation, mine, [o for o in every if o.run == run]
            )
        if text:
            found.append(text)
    return tuple(found)


def _begun(
    calibration: methods.Calibration, run: int, earlier: Sequence[Observation]
) -> Continuation:
    """Return what a run was begun with."""
    if run == 0:
        return calibration.from_the_start()
    return calibration.continued(run, earlier)


def _first_difference(
    calibration: methods.Calibration,
    continuation: Continuation,
    choices: Sequence[RecordedChoice],
    observations: Sequence[Observation],
) -> str:
    policy = calibration.policy(continuation)
    for place, recorded in enumerate(choices):
        again = policy.choose()
        if recorded.number != place or not again.same_as(recorded.choice):
            return (
                f"run {recorded.run}, choice {place}: the planner chose "
                f"{_in_words(recorded.choice)}, and from what was recorded the policy chooses "
                f"{_in_words(again)}"
            )
        if recorded.choice.step is not None:
            policy.note(_outcome(recorded, choices[place + 1 :], observations))
    return ""


def _outcome(
    recorded: RecordedChoice,
    later: Sequence[RecordedChoice],
    observations: Sequence[Observation],
) -> StepOutcome:
    """Return how the step of a choice went: the last accepted one of its attempts."""
    step = recorded.choice.step
    assert step is not None
    behind = min((c.attempt for c in later if c.choice.step == step), default=ENDLESS)
    accepted = [
        o
        for o in observations
        if o.step == step and o.accepted and recorded.attempt <= o.attempt < behind
    ]
    return StepOutcome(step, max(accepted, key=lambda o: o.attempt, default=None))


def _in_words(choice: Choice) -> str:
    step = "to stop" if choice.step is None else f"step {choice.step}"
    return f"{step} ({choice.reason}; {choice.standing.left} left)"
