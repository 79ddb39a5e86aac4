"""The HTML report: one self-contained page, a pure function of a result and its inputs.

The number and the fingerprint by which the pages of one report are known.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from rotcal_ros.evaluation.marks import marks
from rotcal_ros.evaluation.withheld import withheld
from rotcal_ros.figures import Figure, curves
from rotcal_ros.figures.residuals import residual_figures
from rotcal_ros.foundation.in_force import UNKNOWN
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods import find_method, method_names
from rotcal_ros.methods.goal import GoalStanding
from rotcal_ros.report import facts, first_page, iso230, sections, verification
from rotcal_ros.report.template import render

TITLE: Final = "Calibration report of a rotary table"
NO_ADJUSTMENT: Final = "No adjustment or repair between measurements is part of this report."


@dataclass(frozen=True)
class ReportInput:
    """What a report is made of.

    ``inputs`` pairs the name of every input with its SHA-256, ``versions`` names the software,
    ``truth`` is the injected deviation of a simulation in the form of truth.json, ``extra``
    holds further sections as (title, HTML) pairs, ``goal`` how the goal was reached, where there
    was one, ``issued`` the date of issue.
    """

    result: Result
    title: str
    method_title: str
    observations: Sequence[Observation] = ()
    configuration_text: str = ""
    inputs: Sequence[tuple[str, str]] = ()
    versions: Mapping[str, str] = field(default_factory=dict)
    truth: Mapping[str, Any] | None = None
    extra: Sequence[tuple[str, str]] = ()
    goal: GoalStanding | None = None
    issued: str = ""


def render_report(report: ReportInput) -> str:
    """Return the report as one HTML page without any reference to other files."""
    result = report.result
    identity = result.circumstances.identity
    doubt = withheld(result, report.truth)
    attempts = [[o.step, o.attempt, o.reason] for o in report.observations if not o.accepted]
    adjusted = any(title == verification.TITLE for title, _ in report.extra)
    return render(
        "report",
        report=report,
        result=result,
        number=number(result),
        fingerprint=fingerprint(result),
        marks=marks(result, doubt),
        withheld=doubt,
        item=facts.about_the_item(result, identity),
        work=facts.about_the_work(result, identity, report.method_title, report.issued),
        plan=facts.about_the_plan(result, len(attempts)),
        ranges=first_page.ranges(result, doubt),
        sentences=first_page.sentences(result, doubt),
        statement_of_u=first_page.statement_of_u(result, doubt),
        conformity=first_page.statements_of_conformity(result, doubt),
        curve=curves.deviations(result, report.truth, valid=not doubt),
        zero=_zero(result),
        values=first_page.value_blocks(result, doubt),
        traceability=sections.traceability_statement(result),
        only_this_item=facts.ONLY_THIS_ITEM,
        adjustment=f"See “{verification.TITLE}”." if adjusted else NO_ADJUSTMENT,
        goal=sections.goal_standing(report.goal),
        sections=[section for section in _sections(report, doubt) if section[1]],
        rejected=[[r.index, r.why] for r in result.rejected],
        attempts=attempts,
        details=_details(result),
    )


def _sections(report: ReportInput, doubt: str) -> list[tuple[str, str]]:
    """Return title and HTML of what follows page one; empty HTML where there is nothing."""
    result = report.result
    figures = [figure for figure in _figures(report) if figure.svg]
    drawn = {place: _drawings(figures, place) for place in ("set-up", "residuals", "results")}
    return [
        (sections.BUDGET, sections.budget(result, doubt)),
        (sections.TRUST, sections.protections(result)),
        (sections.TRACEABILITY, sections.traceability(result)),
        ("Set-up", drawn["set-up"]),
        *report.extra,
        ("ISO 230-2: positioning of the axis", iso230.section(result)),
        ("Harmonic content", sections.harmonics(result)),
        ("Further figures", drawn["results"]),
        ("Residuals", drawn["residuals"]),
        (sections.RELIABILITY, sections.reliability_of_observations(result)),
    ]


def _drawings(figures: Sequence[Figure], place: str) -> str:
    """Return the HTML of those ``figures`` that stand in a section."""
    there = [figure for figure in figures if figure.place == place]
    return render("drawings", figures=there) if there else ""


def _figures(report: ReportInput) -> list[Figure]:
    """Return what all methods show beside the curve, and what the method alone can show."""
    result = report.result
    installed = result.method in method_names()
    draw = find_method(result.method).figures if installed else _residuals_alone
    return [
        Figure(
            "Adjacent deviations",
            "Deviation of each step between neighbouring angles (k = 2). These are not the "
            "positioning deviations: a controller needs the cumulative curve of page one.",
            curves.adjacent(result),
        ),
        *draw(result, report.truth),
        Figure(
            "Temperature",
            "Temperature at each observation.",
            curves.temperature(report.observations),
        ),
    ]


def _residuals_alone(result: Result, _truth: Mapping[str, Any] | None) -> Sequence[Figure]:
    """Return what is drawn of a method that is not installed here."""
    return residual_figures(result)


def _zero(result: Result) -> Sequence[str]:
    """Return what the curves count from, in words."""
    if result.method in method_names():
        return find_method(result.method).zero(result)
    known = result.zeros.counts_from
    return () if known == UNKNOWN else (f"Every deviation counts from: {known}.",)


def _details(result: Result) -> list[tuple[str, str]]:
    details = [(name, _short(value)) for name, value in result.all_details.items()]
    return [(name.replace("_", " "), text) for name, text in details if text]


def _short(value: Any) -> str:
    """Return a detail as text; empty for long arrays."""
    if isinstance(value, Mapping):
        parts = [(key, _short(item)) for key, item in value.items()]
        return "; ".join(f"{key.replace('_', ' ')} {text}" for key, text in parts if text)
    if isinstance(value, bool | str):
        return str(value)
    if isinstance(value, int | float):
        return f"{value:.6g}"
    items = list(value) if hasattr(value, "__iter__") else []
    if 0 < len(items) <= 4 and all(isinstance(item, int | float) for item in items):
        return "(" + ", ".join(f"{item:.6g}" for item in items) + ")"
    return ""


DIGITS: Final = 10
SHOWN: Final = 16


def fingerprint(result: Result) -> str:
    """Return the SHA-256 of the result as result.json holds it."""
    return hashlib.sha256(result.to_json().encode()).hexdigest()


def number(result: Result) -> str:
    """Return the number of the certificate, or one that follows from the fingerprint."""
    stated = result.circumstances.identity.certificate_number
    return stated or f"RC-{fingerprint(result)[:DIGITS].upper()}"
