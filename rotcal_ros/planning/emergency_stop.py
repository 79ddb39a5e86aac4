"""Decides whether a topic, diagnostics, or their silence stop the cell; without ROS.

This is not a safety function: it only keeps rotcal from ordering motion.
"""

from __future__ import annotations

from rotcal_ros.planning.settings import SafetySettings

_ERROR = 2
_WORDS = {2: "ERROR", 3: "STALE"}


class StopSources:
    """The latest states of the sources of a stop; times are monotonic, in seconds.

    ``topic`` is the absolute name of the emergency stop, empty: none. Silence counts from
    ``now_s`` on, the time of the start. Statuses that share the end of their name are separate
    sources, each from its first message on.
    """

    def __init__(self, settings: SafetySettings, topic: str, now_s: float) -> None:
        self._limit_s = settings.silent_s
        self._heard_s = dict.fromkeys(
            [*([topic] if topic else []), *settings.stop_on_diagnostics], now_s
        )
        self._topic, self._names = topic, settings.stop_on_diagnostics
        self._stops: dict[str, str] = {}

    def receive(self, stopped: bool, now_s: float) -> None:
        """Take a message of the topic."""
        self._note(self._topic, f"{self._topic} is true" if stopped else None, now_s)

    def diagnose(self, name: str, level: int, words: str, now_s: float) -> None:
        """Note a status of /diagnostics; only the configured ones count."""
        for configured in self._names:
            if name == configured or name.endswith((f"/{configured}", f": {configured}")):
                state = _WORDS.get(level, f"level {level}")
                detail = f" ({words})" if words else ""
                text = f"{name} is in {state} on /diagnostics{detail}"
                if name != configured:
                    self._heard_s.pop(configured, None)
                self._note(name, text if level >= _ERROR else None, now_s)

    def reasons(self, now_s: float) -> list[str]:
        """Return the reasons, in words, for which nothing may be ordered now."""
        return [*self._stops.values(), *self._silent(now_s)]

    def _note(self, source: str, stop: str | None, now_s: float) -> None:
        self._heard_s[source] = now_s
        self._stops.pop(source, None)
        if stop is not None:
            self._stops[source] = stop

    def _silent(self, now_s: float) -> list[str]:
        if not self._limit_s:
            return []
        return [
            f"{source} has said nothing for {self._limit_s:g} s (safety.silent_s)"
            for source, heard_s in self._heard_s.items()
            if now_s - heard_s > self._limit_s and source not in self._stops
        ]
