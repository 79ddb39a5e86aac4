"""The board that all viewers look at, and courses of values that never grow without bound."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

from rotcal_ros.extensions.page.state import PageState, Points

COURSE_POINTS: Final = 240


class Board:
    """Holds the present state. One thread changes it, any number look at it.

    A viewer remembers the state it has seen, so that nothing is queued for a slow one.
    """

    def __init__(self) -> None:
        self.state = PageState()

    def show(self, **sections: Any) -> None:
        """Replace sections by new ones."""
        self.state = replace(self.state, **sections)


class Course:
    """The course of a value over any time, thinned to at most ``limit`` points."""

    def __init__(self, limit: int = COURSE_POINTS) -> None:
        self._limit = limit
        self._every = 1
        self._heard = 0
        self._points: list[tuple[float, float]] = []

    def add(self, x: float, y: float) -> None:
        """Take the next value."""
        if self._heard % self._every == 0:
            self._points.append((x, y))
        self._heard += 1
        if len(self._points) > self._limit:
            self._points = self._points[::2]
            self._every *= 2

    @property
    def points(self) -> Points:
        """What is kept, in order."""
        return tuple(self._points)
