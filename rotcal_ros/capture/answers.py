"""The machine's answers held against the orders: who does not echo them is told so at once."""

from __future__ import annotations

from typing import Final

from rotcal_ros.observations import Command, PointKind, ProbeSample

_REMEMBERED: Final = 64
Key = tuple[int, int]
"""Step and attempt."""


class Answers:
    """Orders and the probe points that follow; ``unanswered`` orders gave way to the next one.

    What it says depends on the order of arrival: it is for people, never for a decision.
    """

    def __init__(self) -> None:
        self.unanswered = 0
        self._ordered: Key | None = None
        self._answered: dict[Key, None] = {}
        self._wrong: Key | None = None

    def order(self, command: Command) -> None:
        """Take an order; the same one again is none."""
        key = (command.step, command.attempt)
        if key == self._ordered:
            return
        self.unanswered += self._is_open()
        self._ordered, self._wrong = key, None

    def hear(self, sample: ProbeSample) -> None:
        """Take a probe point; one that was sent unasked answers nothing."""
        if sample.kind == PointKind.UNKNOWN:
            return
        key = (sample.step, sample.attempt)
        if key != self._ordered:
            self._wrong = key
        self._answered[key] = None
        if len(self._answered) > _REMEMBERED:
            del self._answered[next(iter(self._answered))]

    def waited_for(self) -> str:
        """Say which order has no answer yet; empty: none is waited for."""
        if not self._is_open():
            return ""
        assert self._ordered is not None
        step, attempt = self._ordered
        text = f"step {step}, attempt {attempt}: no point on probe_point answers the order"
        if self._wrong is None:
            return f"{text}: an answer has its step, its attempt, and a kind"
        step, attempt = self._wrong
        return (
            f"{text}; the one that came names step {step}, attempt {attempt}: the machine must "
            "echo both of the order"
        )

    def complaint(self) -> str:
        """Say that the last order was answered as another; empty: it was not."""
        return self.waited_for() if self._wrong is not None else ""

    def _is_open(self) -> bool:
        return self._ordered is not None and self._ordered not in self._answered
