"""Drawing: one look for all figures, and the figures that all methods share."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Figure:
    """One figure of a page; an empty ``svg`` means that there is nothing to show."""

    title: str
    caption: str
    svg: str
