"""The trend of one figure over time as a small drawing: thousands of them in seconds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Final

from rotcal_ros.report.template import render

WIDTH, HEIGHT = 860, 180
_LEFT, _RIGHT, _TOP, _BOTTOM = 70, 12, 12, 28
MOST_POINTS: Final = 600
"""Points beyond this are drawn as the largest of their neighbours."""


@dataclass(frozen=True)
class Point:
    """A value with its U at a time; ``far`` says that it stands out."""

    time_ns: int
    value: float
    u: float
    far: bool = False


def drawn(points: Sequence[Point], label: str) -> str:
    """Return the drawing as an ``<svg>`` element; values in the unit that ``label`` names."""
    thinned = _thinned(sorted(points, key=lambda point: point.time_ns))
    begin, end = thinned[0].time_ns, thinned[-1].time_ns
    top = max(point.value + point.u for point in thinned) or 1.0

    def x(time_ns: float) -> float:
        share = (time_ns - begin) / (end - begin) if end > begin else 0.5
        return _LEFT + share * (WIDTH - _LEFT - _RIGHT)

    def y(value: float) -> float:
        return HEIGHT - _BOTTOM - value / top * (HEIGHT - _TOP - _BOTTOM)

    times = dict.fromkeys([begin, (begin + end) // 2, end])
    marks = [
        (round(x(p.time_ns), 1), round(y(p.value), 1), round(y(p.value + p.u), 1),
         round(y(max(0.0, p.value - p.u)), 1), p.far)
        for p in thinned
    ]  # fmt: skip
    return render(
        "trend",
        width=WIDTH,
        height=HEIGHT,
        left=_LEFT,
        right=WIDTH - _RIGHT,
        label=label,
        marks=marks,
        ticks=[(round(y(share * top), 1), f"{share * top:.3g}") for share in (0.0, 0.5, 1.0)],
        dates=[(round(x(t), 1), _date(t)) for t in times],
        thinned=len(thinned) < len(points),
    )


def _thinned(points: Sequence[Point]) -> Sequence[Point]:
    """Return at most MOST_POINTS, of each group of neighbours the largest."""
    size = -(-len(points) // MOST_POINTS)
    if size == 1:
        return points
    groups = (points[i : i + size] for i in range(0, len(points), size))
    return [max(group, key=lambda point: (point.far, point.value)) for group in groups]


def _date(time_ns: int) -> str:
    return f"{datetime.fromtimestamp(time_ns // 10**9, timezone.utc):%Y-%m-%d}"
