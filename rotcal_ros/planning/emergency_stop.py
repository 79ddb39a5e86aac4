"""Who stops the cell now: a topic, diagnostics, or their silence; without ROS.

What is decided here is no safety function: it only keeps this suite from ordering motion.
"""

from __future__ import annotations

from rotcal_ros.planning.safety_settings import SafetySettings

_ERROR = 2
_WORDS = {2: "ERROR", 3: "STALE"}


class StopSources:
    """Keeps what the sources of a stop said last; times are monotonic, in seconds.

    ``topic`` is the absolute name of the emergency stop, empty: none. Silence counts from
    ``now_s`` on, the time of the start. Several that share the end of their name are sources of
    their own, from the first word of each on: none speaks for another.
    """

    def __init__(self, settings: SafetySettings, topic: str, now_s: float) -> None:
        self._limit_s = settings.silent_s
        self._heard_s = dict.fromkeys(
            [*([topic] if topic else []), *settings.stop_on_diagnostics], now_s
        )
        self._topic, self._names = topic, settings.stop_on_diagnostics
        self._stops: dict[str, str] = {}

    def hear(self, stopped: bool, now_s: float) -> None:
        """Take the word of the topic."""
        self._note(self._topic, f"{self._topic} is true" if stopped else "", now_s)

    def diagnose(self, name: str, level: int, words: str, now_s: float) -> None:
        """Take a status of /diagnostics; others than the configured ones are let be."""
        for known in self._names:
            if name == known or name.endswith((f"/{known}", f": {known}")):
                state = _WORDS.get(level, f"level {level}")
                detail = f" ({words})" if words else ""
                text = f"{name} is in {state} on /diagnostics{detail}"
                if name != known:
                    self._heard_s.pop(known, None)
                self._note(name, text if level >= _ERROR else "", now_s)

    def why(self, now_s: float) -> str:
        """Return why nothing may be ordered now, in words; empty: it may."""
        return "; ".join([*self._stops.values(), *self._silent(now_s)])

    def _note(self, source: str, stop: str, now_s: float) -> None:
        self._heard_s[source] = now_s
        self._stops.pop(source, None)
        if stop:
            self._stops[source] = stop

    def _silent(self, now_s: float) -> list[str]:
        if not self._limit_s:
            return []
        return [
            f"{source} has said nothing for {self._limit_s:g} s (safety.silent_s)"
            for source, heard_s in self._heard_s.items()
            if now_s - heard_s > self._limit_s and source not in self._stops
        ]
