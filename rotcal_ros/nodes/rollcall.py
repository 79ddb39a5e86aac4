"""Who is there: nodes beat, and one that stops is named. Plain bookkeeping, without ROS."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class RollCall:
    """Names with the monotonic time (s) of their last beat.

    ``timeout_s`` is the silence after which a node counts as lost. A pause of the caller itself
    (a stalled machine) is not blamed on the others: it is granted to all.
    """

    timeout_s: float
    _seen: dict[str, float] = field(default_factory=dict)
    _checked: float | None = None

    def beat(self, name: str, now: float) -> None:
        """Note a beat of ``name``."""
        self._seen[name] = now

    def leave(self, name: str) -> None:
        """Forget ``name``: it left on purpose."""
        self._seen.pop(name, None)

    def known(self) -> set[str]:
        """Return the names that have beaten and not left, silent ones included."""
        return set(self._seen)

    def silent(self, now: float) -> dict[str, float]:
        """Return the lost names with their silence in seconds; call it regularly."""
        pause = 0.0 if self._checked is None else now - self._checked
        self._checked = now
        if pause > self.timeout_s / 2:
            self._seen = {name: seen + pause for name, seen in self._seen.items()}
        return {n: now - seen for n, seen in self._seen.items() if now - seen > self.timeout_s}
