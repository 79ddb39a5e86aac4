"""A goal, what became of it, and the paper's plan beside it: a section of the report."""

from __future__ import annotations

from rotcal_ros.catalogue.goal import GoalStanding
from rotcal_ros.planning.plan_figures import PlanFigures
from rotcal_ros.report.template import render
from rotcal_ros.units import ARCSEC, MICROMETRE


def section(standing: GoalStanding | None) -> str:
    """Return the section as HTML; empty without a goal."""
    if standing is None:
        return ""
    own, papers = standing.compared.own, standing.compared.papers
    return render(
        "goal",
        goal=f"{standing.goal / ARCSEC:.3f}",
        reached=f"{standing.reached / ARCSEC:.3f}",
        measured=standing.measured,
        candidates=standing.candidates,
        reason=standing.reason,
        noise=f"{standing.compared.length_std / MICROMETRE:.3g}",
        rows=_rows(own, papers),
    )


def _rows(own: PlanFigures, papers: PlanFigures) -> list[list[str]]:
    """Return what both plans take and reach, one row for each figure."""
    plans = (own, papers)
    rows = [
        ["Lengths", *(str(plan.lengths) for plan in plans)],
        [
            "Predicted rms of U(ECC) / arcsec",
            *(f"{plan.uncertainty / ARCSEC:.3f}" for plan in plans),
        ],
        [
            "Time at the pace of planner.step_s and turn_s",
            *(f"{plan.seconds:.0f} s" for plan in plans),
        ],
    ]
    if own.cell_seconds is not None:
        clocks = [plan.cell_seconds for plan in plans]
        cells = ["" if clock is None else f"{clock:.0f} s" for clock in clocks]
        rows.append(["Time by the simulated cell's clock", *cells])
    return rows
