"""The HTML report of a result: one self-contained page with all that it rests on.

It is made from a recording, a plain table, or a result without its data. Number and
fingerprint identify the pages of one report.
"""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from rotcal_ros import __version__
from rotcal_ros.bags import names
from rotcal_ros.evaluation.marks import marks, withheld
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.in_force import UNKNOWN
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods import find_method, method_names
from rotcal_ros.methods.figures import Figure, curves
from rotcal_ros.methods.figures.residuals import residual_figures
from rotcal_ros.methods.goal import GoalStanding
from rotcal_ros.methods.measurements import PlannedMeasurements
from rotcal_ros.methods.method import Measurements
from rotcal_ros.recordings.replay import Recording
from rotcal_ros.recordings.result_sources import ResultSource
from rotcal_ros.report import facts, first_page, iso230, sections, verification
from rotcal_ros.report.printing import write_page
from rotcal_ros.report.template import render
from rotcal_ros.report.verification import acting_section

TITLE: Final = "Calibration report of a rotary table"
NO_ADJUSTMENT: Final = "No adjustment or repair between measurements is part of this report."


@dataclass(frozen=True)
class ReportInput:
    """What a report is made of.

    ``inputs`` pairs the name of every input with its SHA-256, ``versions`` names the software,
    ``truth`` is the injected deviation of a simulation in the form of truth.json, ``extra`` holds
    further sections as (title, HTML) pairs, ``goal`` how a goal was reached, ``issued`` the date
    of issue.
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
        marks=marks(result, report.truth),
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
        sections=_sections(report, doubt),
        rejected=[[r.index, r.why] for r in result.rejected],
        attempts=attempts,
        details=_details(result),
    )


def _sections(report: ReportInput, doubt: str | None) -> list[tuple[str, str]]:
    """Return title and HTML of the sections that follow page one."""
    result = report.result
    figures = [figure for figure in _figures(report) if figure.svg]
    drawn = {place: _drawings(figures, place) for place in ("set-up", "residuals", "results")}
    found = [
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
    return [(title, html) for title, html in found if html]


def _drawings(figures: Sequence[Figure], place: str) -> str | None:
    """Return the HTML of the ``figures`` of a section, if there are any."""
    there = [figure for figure in figures if figure.place == place]
    return render("drawings", figures=there) if there else None


def _figures(report: ReportInput) -> list[Figure]:
    """Return the figures that all methods show besides the curve, and those of the method."""
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
    """Return the figures of a method that is not installed here."""
    return residual_figures(result)


def _zero(result: Result) -> Sequence[str]:
    """Return what the curves count from, in words."""
    if result.method in method_names():
        return find_method(result.method).zero(result)
    counts_from = result.zeros.counts_from
    return () if counts_from == UNKNOWN else (f"Every deviation counts from: {counts_from}.",)


def _details(result: Result) -> list[tuple[str, str]]:
    details = [(name, _short(value)) for name, value in result.all_details.items()]
    return [(name.replace("_", " "), text) for name, text in details if text]


def _short(value: Any) -> str | None:
    """Return a detail as text; None for long arrays."""
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
    return None


DIGITS: Final = 10
SHOWN: Final = 16


def fingerprint(result: Result) -> str:
    """Return the SHA-256 of the text of result.json."""
    return hashlib.sha256(result.to_json().encode()).hexdigest()


def number(result: Result) -> str:
    """Return the number of the certificate, or one that follows from the fingerprint."""
    stated = result.circumstances.identity.certificate_number
    return stated or f"RC-{fingerprint(result)[:DIGITS].upper()}"


def write_recorded(
    recording: Recording,
    page: Path,
    truth: Mapping[str, Any] | None = None,
    extra: Sequence[tuple[str, str]] = (),
    in_force: Path | None = None,
) -> Result:
    """Solve a recording, write the page about it, and return the result.

    ``truth`` is the content of the truth.json of a simulation, ``extra`` holds further sections
    as (title, HTML), ``in_force`` is the folder with the files of the table on which it was
    measured.
    """
    configuration = recording.calibration.configuration
    result = recording.solve()
    report = ReportInput(
        result=result,
        title=TITLE,
        method_title=recording.calibration.method.title,
        observations=recording.observations,
        configuration_text=configuration.text,
        inputs=[*recording.sha256.items(), ("plan and configuration", configuration.plan_id)],
        versions=_versions(recording.attachments),
        truth=truth,
        extra=extra or acting_section(result, in_force),  # that of verify says it itself
        goal=recording.goal_standing(result),
        issued=_today(),
    )
    write_page(page, render_report(report))
    return result


def write_measured(
    measured: Recording | Measurements,
    page: Path,
    truth: Mapping[str, Any] | None = None,
    in_force: Path | None = None,
) -> Result:
    """Solve a bag or a plain table, write the page about it, and return the result."""
    if isinstance(measured, Recording):
        return write_recorded(measured, page, truth, in_force=in_force)
    configuration, result = measured.configuration, measured.solve()
    report = ReportInput(
        result=result,
        title=TITLE,
        method_title=configuration.method.title,
        observations=measured.observations if isinstance(measured, PlannedMeasurements) else (),
        configuration_text=configuration.text,
        inputs=[*measured.sha256.items(), ("plan and configuration", configuration.plan_id)],
        versions=_versions({}),
        truth=truth,
        extra=acting_section(result, in_force),
        issued=_today(),
    )
    write_page(page, render_report(report))
    return result


def write_result(
    source: ResultSource,
    page: Path,
    truth: Mapping[str, Any] | None = None,
    in_force: Path | None = None,
) -> Result:
    """Write the page about a result without its bag, and return the result."""
    result = source.result
    installed = result.method in method_names()
    report = ReportInput(
        result=result,
        title=TITLE,
        method_title=find_method(result.method).title if installed else result.method,
        inputs=list(source.sha256.items()),
        versions=_versions({}),
        truth=truth,
        extra=acting_section(result, in_force),
        issued=_today(),
    )
    try:
        text = render_report(report)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise DataError(
            f"the details of the result are not what {result.method} writes, or truth.json "
            f"belongs to another table ({error}): use result.json as it was written, or report "
            "its bag"
        ) from error
    write_page(page, text)
    return result


def _today() -> str:
    return f"{datetime.now(timezone.utc):%Y-%m-%d}"


def _versions(attachments: Mapping[str, bytes]) -> dict[str, str]:
    """Return the versions that the recorder noted, if any, and those of this process."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "mcap"))
    running = f"rotcal_ros {__version__}, {packages}, Python {platform.python_version()}"
    try:
        noted = json.loads(attachments.get(names.VERSIONS, b"{}"))
        recorded = ", ".join(f"{name} {text}" for name, text in noted.items())
    except (ValueError, AttributeError):
        recorded = "the bag's note of versions is damaged"
    return ({"recorded with": recorded} if recorded else {}) | {"solved with": running}
