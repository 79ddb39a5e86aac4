"""Drawing: one look for all figures, and the figures that all methods share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Place = Literal["set-up", "residuals", "results"]


@dataclass(frozen=True, slots=True)
class Figure:
    """One figure of a page; an empty ``svg`` means that there is nothing to show.

    ``place`` says in which section of the report it stands.
    """

    title: str
    caption: str
    svg: str
    place: Place = "results"
