"""What is known of a plan without its readings, and two plans side by side."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PlanFigures:
    """``lengths`` of a plan, what they promise and what they take.

    ``uncertainty``: predicted U (k = 2) of ECC about its mean, rms over the angles, rad.
    ``seconds``: from the end of the first length to that of the last, as the policy reckons;
    ``cell_seconds``: the same by the clock of the simulated cell, None without one.
    """

    lengths: int
    uncertainty: float
    seconds: float
    cell_seconds: float | None


@dataclass(frozen=True)
class Compared:
    """What was measured (``own``) and the paper's plan, both with ``length_std`` (m) planned."""

    own: PlanFigures
    papers: PlanFigures
    length_std: float
