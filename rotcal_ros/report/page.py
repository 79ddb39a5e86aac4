"""The HTML report of a result: one self-contained page with all that it rests on.

It is made from a recording, a plain table, or a result that comes without its data. Number and
fingerprint identify the pages of one report. Page one is in ``first_page``; here are the sections
after it: budget, goal, harmonics, reliability, traceability, protections.
"""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from importlib.metadata import version
from itertools import cycle
from pathlib import Path
from typing import Any, Final

import numpy as np

from rotcal_ros import __version__
from rotcal_ros.bags import names
from rotcal_ros.evaluation.budget import WHOLE, contributions
from rotcal_ros.evaluation.harmonics import HarmonicContent, harmonic_content
from rotcal_ros.evaluation.marks import marks, why_withheld
from rotcal_ros.evaluation.reliability import Reliability, reliability
from rotcal_ros.foundation.components import COVERAGE_FACTOR, SHOWN_IN, unit_of
from rotcal_ros.foundation.curves.measured import measured_curve
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.gum_numbers import (
    last_digit_place,
    uncertainty,
    value_to_place,
    value_with_uncertainty,
)
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.in_force import UNKNOWN
from rotcal_ros.foundation.language import join_texts, phrase
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.protection import TOLERABLE
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE
from rotcal_ros.methods import find_method, method_names
from rotcal_ros.methods.figures import Figure, curves, style
from rotcal_ros.methods.figures.residuals import residual_figures
from rotcal_ros.methods.goal import GoalStanding
from rotcal_ros.methods.measurements import PlannedMeasurements
from rotcal_ros.methods.method import Measurements
from rotcal_ros.methods.result_tables import ResultTable, deviations_table, steps_table
from rotcal_ros.planning.plan import PlanFigures
from rotcal_ros.recordings.replay import Recording
from rotcal_ros.recordings.result_sources import ResultSource
from rotcal_ros.report import first_page, iso230, verification
from rotcal_ros.report.first_page import NOT_STATED, degrees
from rotcal_ros.report.printing import write_page
from rotcal_ros.report.template import render
from rotcal_ros.report.verification import table_in_force_section

TITLE: Final = phrase("Calibration report of a rotary table")
PLAN_ID: Final = phrase("plan and configuration")
NO_ADJUSTMENT: Final = phrase(
    "No adjustment or repair between measurements is part of this report."
)


@dataclass(frozen=True)
class ReportInput:
    """What a report is made of.

    ``inputs`` pairs the name of every input with its SHA-256, ``versions`` names the software,
    ``truth`` is the injected deviation of a simulation in the form of truth.json, ``extra`` holds
    further sections as (title, HTML) pairs, ``goal`` how a goal was reached, ``issued`` the date
    of issue, ``go_on`` the command line that goes on with a session that was interrupted.
    """

    result: Result
    method_title: str
    title: str = TITLE
    observations: Sequence[Observation] = ()
    configuration_text: str = ""
    inputs: Sequence[tuple[str, str]] = ()
    versions: Mapping[str, str] = field(default_factory=dict)
    truth: Mapping[str, Any] | None = None
    extra: Sequence[tuple[str, str]] = ()
    goal: GoalStanding | None = None
    issued: str = ""
    go_on: str = ""


def render_report(report: ReportInput) -> str:
    """Return the report as one HTML page without any reference to other files."""
    result = report.result
    identity = result.circumstances.identity
    doubt = why_withheld(result, report.truth)
    attempts = [
        [o.step, o.attempt, phrase(o.reason)] for o in report.observations if not o.accepted
    ]
    adjusted = any(title == verification.TITLE for title, _ in report.extra)
    return render(
        "report",
        report=report,
        result=result,
        number=certificate_number(result),
        fingerprint=fingerprint(result),
        marks=marks(result, report.truth),
        withheld=doubt,
        item=first_page.item_facts(result, identity),
        work=first_page.calibration_facts(result, identity, report.method_title, report.issued),
        plan=first_page.plan_facts(result, len(attempts)),
        ranges=first_page.component_ranges(result, doubt),
        sentences=first_page.result_sentences(result, doubt),
        statement_of_u=first_page.uncertainty_statement(result, doubt),
        conformity=first_page.conformity_statements(result, doubt),
        warnings=list(map(phrase, result.warnings)),
        curve=curves.deviations(result, report.truth, valid=not doubt),
        zero=join_texts(_zero(result), " "),
        values=first_page.value_blocks(result, doubt),
        traceability=traceability_statement(result),
        only_this_item=first_page.ONLY_THIS_ITEM,
        adjustment=phrase("See “{0}”.", verification.TITLE) if adjusted else NO_ADJUSTMENT,
        goal=goal_section(report.goal),
        sections=_sections(report, doubt),
        rejected=[[r.index, phrase(r.why)] for r in result.rejected],
        attempts=attempts,
        details=_details(result),
    )


def _sections(report: ReportInput, doubt: str | None) -> list[tuple[str, str]]:
    """Return title and HTML of the sections that follow page one."""
    result = report.result
    figures = [
        replace(figure, title=phrase(figure.title), caption=phrase(figure.caption))
        for figure in _figures(report)
        if figure.svg
    ]
    drawn = {place: _drawings(figures, place) for place in ("set-up", "residuals", "results")}
    found = [
        (BUDGET, budget_section(result, doubt)),
        (TRUST, protections_section(result)),
        (TRACEABILITY, traceability_section(result)),
        (phrase("Set-up"), drawn["set-up"]),
        *report.extra,
        (phrase("ISO 230-2: positioning of the axis"), iso230.iso230_section(result)),
        (phrase("Harmonic content"), harmonics_section(result)),
        (phrase("Further figures"), drawn["results"]),
        (phrase("Residuals"), drawn["residuals"]),
        (RELIABILITY, reliability_section(result)),
        (TABLES, method_tables(result, stated=not doubt)),
    ]
    return [(title, html) for title, html in found if html]


def method_tables(result: Result, *, stated: bool) -> str | None:
    """Return the method's tables as HTML, folded, if there are any."""
    found = [*steps_table(result, stated=stated), *_tables_of_the_method(result)]
    if not found:
        return None
    titled = [replace(table, title=phrase(table.title)) for table in found]
    return render("tables", tables=titled, most=MOST_ROWS)


def _tables_of_the_method(result: Result) -> Sequence[ResultTable]:
    """Return the method's tables; none of a result whose details were cut or edited."""
    if result.method not in method_names():
        return ()
    try:
        return find_method(result.method).tables(result)
    except (LookupError, TypeError, ValueError):
        return ()


def write_tables(result: Result, folder: Path) -> list[Path]:
    """Write all tables of a result as CSV into ``folder``, and return where they are."""
    stated = not why_withheld(result)
    found = [deviations_table(result, stated=stated), *steps_table(result, stated=stated)]
    files = {folder / f"{t.name}.csv": t for t in (*found, *_tables_of_the_method(result))}
    folder.mkdir(parents=True, exist_ok=True)
    for path, table in files.items():
        write_atomically(path, table.to_csv())
    return list(files)


def _drawings(figures: Sequence[Figure], place: str) -> str | None:
    """Return the HTML of the ``figures`` of a section, if there are any."""
    there = [figure for figure in figures if figure.place == place]
    return render("drawings", figures=there) if there else None


def _figures(report: ReportInput) -> list[Figure]:
    """Return the figures that all methods show besides the curve, and those of the method."""
    result = report.result
    installed = result.method in method_names()
    own = find_method(result.method).figures(result, report.truth) if installed else ()
    return [
        Figure(
            phrase("Adjacent deviations"),
            phrase(
                "Deviation of each step between neighbouring angles (k = 2). These are not the "
                "positioning deviations: a controller needs the cumulative curve of page one."
            ),
            curves.adjacent(result),
        ),
        *(own if installed else residual_figures(result)),
        Figure(
            phrase("Temperature"),
            phrase("Temperature at each observation."),
            curves.temperature(report.observations),
        ),
    ]


def _zero(result: Result) -> Sequence[str]:
    """Return what the curves count from, in words."""
    if result.method in method_names():
        return [phrase(text) for text in find_method(result.method).zero(result)]
    if result.zeros.counts_from == UNKNOWN:
        return ()
    return (phrase("Every deviation counts from: {0}.", phrase(result.zeros.counts_from)),)


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


def fingerprint(result: Result) -> str:
    """Return the SHA-256 of the text of result.json."""
    return hashlib.sha256(result.to_json().encode()).hexdigest()


def certificate_number(result: Result) -> str:
    """Return the number of the certificate, or one that follows from the fingerprint."""
    stated = result.circumstances.identity.certificate_number
    return stated or f"RC-{fingerprint(result)[:DIGITS].upper()}"


def report_recording(
    recording: Recording,
    page: Path,
    truth: Mapping[str, Any] | None = None,
    extra: Sequence[tuple[str, str]] = (),
    in_force: Path | None = None,
    go_on: str = "",
) -> Result:
    """Solve a recording, write the page about it, and return the result.

    ``truth`` is the content of the truth.json of a simulation, ``extra`` holds further sections
    as (title, HTML), ``in_force`` is the folder with the files of the table on which it was
    measured, ``go_on`` the command line that goes on with an interrupted session.
    """
    configuration = recording.calibration.configuration
    result = recording.solve()
    report = ReportInput(
        result,
        recording.calibration.method.title,
        observations=recording.observations,
        configuration_text=configuration.text,
        inputs=[*recording.sha256.items(), (PLAN_ID, configuration.plan_id)],
        versions=_versions(recording.attachments),
        truth=truth,
        extra=extra or table_in_force_section(result, in_force),  # that of verify says it itself
        goal=recording.goal_standing(result),
        issued=_today(),
        go_on=go_on,
    )
    write_page(page, render_report(report))
    return result


def report_measurement(
    measured: Recording | Measurements,
    page: Path,
    truth: Mapping[str, Any] | None = None,
    in_force: Path | None = None,
    go_on: str = "",
) -> Result:
    """Solve a bag or a plain table, write the page about it, and return the result."""
    if isinstance(measured, Recording):
        return report_recording(measured, page, truth, in_force=in_force, go_on=go_on)
    configuration, result = measured.configuration, measured.solve()
    report = ReportInput(
        result,
        configuration.method.title,
        observations=measured.observations if isinstance(measured, PlannedMeasurements) else (),
        configuration_text=configuration.text,
        inputs=[*measured.sha256.items(), (PLAN_ID, configuration.plan_id)],
        versions=_versions({}),
        truth=truth,
        extra=table_in_force_section(result, in_force),
        issued=_today(),
    )
    write_page(page, render_report(report))
    return result


def report_result(
    source: ResultSource,
    page: Path,
    truth: Mapping[str, Any] | None = None,
    in_force: Path | None = None,
) -> Result:
    """Write the page about a result without its bag, and return the result."""
    result = source.result
    installed = result.method in method_names()
    report = ReportInput(
        result,
        find_method(result.method).title if installed else result.method,
        inputs=list(source.sha256.items()),
        versions=_versions({}),
        truth=truth,
        extra=table_in_force_section(result, in_force),
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
    versions: dict[str, str] = {phrase("recorded with"): recorded} if recorded else {}
    return versions | {phrase("solved with"): running}


BUDGET = phrase("Uncertainty budget")


def budget_section(result: Result, withheld: str | None) -> str:
    """Return the budget as HTML, below the reason for which no U is stated, if there is one."""
    return render(
        "budget",
        figure=draw_budget(result),
        tables=_tables(result),
        withheld=withheld,
        refraction=phrase(result.circumstances.refraction or NOT_STATED),
        dof=result.dof,
        sigma0=f"{result.sigma0:.2f}",
    )


@style.house_style
def draw_budget(result: Result) -> str:
    """Draw the standard uncertainty of every source, and their sum, over the table angle."""
    names = result.components
    panels = style.grid(-(-len(names) // 2), min(2, len(names)), height=2.3)
    for ax, name in zip(panels, names, strict=False):
        unit, label = unit_of(name)
        parts = contributions(result, name)
        angles = result.angles / DEGREE
        if len(parts) > 1:
            for part, colour in zip(parts, cycle(style.COLOURS), strict=False):
                ax.plot(angles, part.std / unit, "o-", color=colour, ms=3, lw=1, label=part.source)
        ax.plot(angles, result.std[name] / unit, "-", color=style.INK, lw=1.6, label="combined")
        ax.set_ylim(bottom=0.0)
        ax.set_ylabel(f"u({name}) / {label}")
        style.angle_axis(ax, angles)
    for ax in panels[len(names) :]:
        ax.set_axis_off()
    return style.svg(panels[0])


def _tables(result: Result) -> list[dict[str, Any]]:
    """Return a table for each component that is split, or one for all where none is."""
    if any(len(contributions(result, name)) > 1 for name in result.components):
        return [_table(result, name) for name in result.components]
    rows = []
    for name in result.components:
        unit, label = unit_of(name)
        worst = int(np.argmax(result.std[name]))
        whole = float(result.std[name][worst]) / unit
        place = f"{degrees(float(result.angles[worst]))}°"
        texts = [uncertainty(whole), uncertainty(COVERAGE_FACTOR * whole)]
        rows.append([name, place, *(f"{text} {label}" for text in texts)])
    caption = phrase("{0}: the method does not separate the sources", phrase(WHOLE))
    head = [phrase("Deviation"), phrase("where U is largest"), "u", f"U (k = {COVERAGE_FACTOR:g})"]
    return [{"caption": caption, "head": head, "rows": rows}]


def _table(result: Result, name: str) -> dict[str, Any]:
    """Return the sources at the angle with the largest uncertainty as text."""
    unit, label = unit_of(name)
    std = result.std[name] / unit
    worst = int(np.argmax(std))
    whole = float(std[worst])
    # Half of the digits of U = 2 u: a source is shown to the place of the sum.
    place = last_digit_place(whole) if whole else 0
    rows = []
    for part in contributions(result, name):
        size = float(part.std[worst]) / unit
        share = 100.0 * (size / whole) ** 2 if whole else 0.0
        rows.append([phrase(part.source), value_to_place(size, place), f"{share:.0f} %"])
    expanded = uncertainty(COVERAGE_FACTOR * whole)
    rows.append([phrase("Combined standard uncertainty"), value_to_place(whole, place), "100 %"])
    stated = phrase("Expanded uncertainty U (k = {0})", f"{COVERAGE_FACTOR:g}")
    rows.append([stated, expanded, ""])
    return {
        "caption": phrase(
            "{0} at {1}°, where its U is largest", name, degrees(float(result.angles[worst]))
        ),
        "head": [phrase("Source"), f"u / {label}", phrase("Share of u²")],
        "rows": rows,
    }


def goal_section(standing: GoalStanding | None) -> str | None:
    """Return how the goal was reached as HTML, if there was one."""
    if standing is None:
        return None
    own, papers = standing.compared.own, standing.compared.papers
    return render(
        "goal",
        goal=f"{standing.goal / ARCSEC:.3f}",
        reached=f"{standing.reached / ARCSEC:.3f}",
        measured=standing.measured,
        candidates=standing.candidates,
        reason=phrase(standing.reason),
        noise=f"{standing.compared.length_std / MICROMETRE:.3g}",
        rows=_plan_rows(own, papers),
    )


def _plan_rows(own: PlanFigures, papers: PlanFigures) -> list[list[str]]:
    """Return what both plans take and reach, one row for each figure."""
    plans = (own, papers)
    rows = [
        [phrase("Lengths"), *(str(plan.lengths) for plan in plans)],
        [
            phrase("Predicted rms of U(ECC) / arcsec"),
            *(f"{plan.uncertainty / ARCSEC:.3f}" for plan in plans),
        ],
        [
            phrase("Time at the pace of planner.step_s and turn_s"),
            *(f"{plan.seconds:.0f} s" for plan in plans),
        ],
    ]
    if own.cell_seconds is not None:
        clocks = [plan.cell_seconds for plan in plans]
        cells = ["" if clock is None else f"{clock:.0f} s" for clock in clocks]
        rows.append([phrase("Time by the simulated cell’s clock"), *cells])
    return rows


@style.house_style
def draw_amplitudes(found: Mapping[str, HarmonicContent]) -> str:
    """Draw the amplitudes over the order; pale where the order does not differ from zero."""
    panels = style.grid(-(-len(found) // 2), min(2, len(found)), height=2.5)
    for ax, (name, content) in zip(panels, found.items(), strict=False):
        unit, label = unit_of(name)
        whiskers = COVERAGE_FACTOR * content.amplitude_std / unit
        heights = content.amplitude / unit
        for sure, alpha in ((content.significant, 0.85), (~content.significant, 0.25)):
            ax.bar(
                content.orders[sure], heights[sure], 0.7, yerr=whiskers[sure], alpha=alpha,
                color=style.BLUE, ecolor=style.INK, capsize=2,
            )  # fmt: skip
        ax.set_ylim(bottom=0.0)
        ax.set_xlabel("order per turn")
        ax.set_ylabel(phrase("{0} amplitude / {1}", name, label))
        style.whole_numbers(ax.xaxis)
    for ax in panels[len(found) :]:
        ax.set_axis_off()
    return style.svg(panels[0])


def harmonics_section(result: Result) -> str | None:
    """Return the harmonic content as HTML; None when no curve covers a full turn."""
    found = {}
    for name in result.components:
        # An arc, or a curve that does not close: the report shows that elsewhere.
        with suppress(DataError):
            found[name] = harmonic_content(measured_curve(result, name))
    if not found:
        return None
    tables = [_harmonics_table(name, content) for name, content in found.items()]
    return render("harmonics", figure=draw_amplitudes(found), tables=tables)


def _harmonics_table(name: str, content: HarmonicContent) -> dict[str, Any]:
    """Return order, amplitude and phase of every order as text."""
    unit, label = unit_of(name)
    amplitude, spread = content.amplitude / unit, COVERAGE_FACTOR * content.amplitude_std / unit
    phase = np.mod(content.phase, 2.0 * np.pi) / DEGREE
    turn = COVERAGE_FACTOR * content.phase_std / DEGREE
    rows = [
        (
            str(order),
            value_with_uncertainty(float(amplitude[k]), float(spread[k])).lstrip("+"),
            value_with_uncertainty(float(phase[k]), float(turn[k])).lstrip("+")
            if content.significant[k]
            else "–",
        )
        for k, order in enumerate(content.orders)
    ]
    rest = f"{content.residual_rms / unit:.4f} {label}"
    return {"name": name, "unit": label, "rows": rows, "rest": rest}


RELIABILITY: Final = phrase("What a single observation could hide")
TABLES: Final = phrase("Tables")
MOST_ROWS: Final = 200
"""Most rows of a table on a page; the files hold all."""
_WORST: Final = 8


def reliability_section(result: Result) -> str | None:
    """Return the worst observations by their reliability as HTML; None without residuals."""
    if result.residuals is None or not np.any(result.residuals.used):
        return None
    found = reliability(result.residuals)
    return render(
        "reliability",
        count=len(found.row),
        unchecked=int(found.unchecked.sum()),
        redundancy=f"{found.redundancy.mean():.2f}",
        power=f"{100.0 * found.power:g}",
        alpha=f"{100.0 * found.alpha:g}",
        rows=_observation_rows(found),
        head=_head(found),
    )


def _head(found: Reliability) -> list[str]:
    error = [phrase("Error / {0}", SHOWN_IN[found.unit][1])] if found.std is not None else []
    columns = [phrase("Error / its std"), phrase("Effect, at most / std")]
    return [phrase("Table position"), phrase("Target"), phrase("Redundancy"), *error, *columns]


def _observation_rows(found: Reliability) -> list[list[str]]:
    """Return position, target, redundancy, minimal detectable error and bound of its effect."""
    errors, rows = found.detectable_error(), []
    for k in found.worst(_WORST).tolist():
        numbers = [found.detectable[k], found.effect[k]]
        if errors is not None:
            numbers.insert(0, errors[k] / SHOWN_IN[found.unit][0])
        row = [str(found.table_position[k]), str(found.target[k]), f"{found.redundancy[k]:.3f}"]
        rows.append([*row, *(f"{v:.2f}" if np.isfinite(v) else phrase("any") for v in numbers)])
    return rows


TRACEABILITY: Final = phrase("Traceability")
_INSTRUMENTS: Final = (
    phrase("Instrument"),
    phrase("Maker and model"),
    phrase("Serial number"),
    phrase("Calibrated"),
    phrase("Certificate"),
)


def traceability_statement(result: Result) -> str:
    """Return in one sentence how far the numbers are traceable, claiming nothing unstated."""
    if result.simulated:
        return phrase("None: a simulation was measured, no instrument.")
    known = result.circumstances.identity.instruments.known
    certified = [name for name, instrument in known.items() if instrument.certificate]
    if not certified:
        return phrase("{0}: no certificate of an instrument is named.", NOT_STATED)
    names = join_texts([phrase(_spoken(name)) for name in certified], ", ")
    return phrase("Through the calibration certificates of: {0}.", names)


def traceability_section(result: Result) -> str:
    """Return instruments and statement as HTML."""
    return render(
        "traceability",
        statement=traceability_statement(result),
        head=_INSTRUMENTS,
        rows=_instrument_rows(result.circumstances.identity),
    )


def _instrument_rows(identity: Identity) -> list[list[str]]:
    rows = []
    for name, instrument in identity.instruments.known.items():
        model = " ".join(text for text in (instrument.maker, instrument.model) if text)
        texts = [model, instrument.serial, instrument.calibrated, instrument.certificate]
        rows.append([phrase(_spoken(name).capitalize()), *(text or NOT_STATED for text in texts)])
    return rows


def _spoken(name: str) -> str:
    return name.replace("_", " ")


TRUST = phrase("What could be wrong, and would it show?")


def protections_section(result: Result) -> str:
    """Return the table of protections as HTML, one row per effect."""
    return render(
        "trust",
        rows=[
            {
                "effect": phrase(p.effect),
                "treatment": phrase(p.treatment),
                "why": phrase(p.why),
                "error": "" if p.error is None else f"{p.error:.1f}",
                "bare": p.effect in result.unprotected,
            }
            for p in result.protections
        ],
        tolerable=f"{TOLERABLE:g}",
    )
