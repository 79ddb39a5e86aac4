"""The HTML report: one self-contained page, a pure function of a result and its inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from rotcal_ros.catalogue import find_method, method_names
from rotcal_ros.catalogue.goal import GoalStanding
from rotcal_ros.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.figures import Figure, curves
from rotcal_ros.figures.residuals import residual_figures
from rotcal_ros.in_force import in_words
from rotcal_ros.observations import Observation
from rotcal_ros.report import goal, harmonics, reliability, trust
from rotcal_ros.report.iso230 import section as iso230_section
from rotcal_ros.report.template import render
from rotcal_ros.results import Result
from rotcal_ros.units import DEGREE


@dataclass(frozen=True)
class ReportInput:
    """What a report is made of.

    ``inputs`` pairs the name of every input with its SHA-256, ``versions`` names the software,
    ``truth`` is the injected deviation of a simulation in the form of truth.json, ``extra``
    holds further sections as (title, HTML) pairs, ``goal`` how the goal was reached, where there
    was one.
    """

    result: Result
    title: str
    method_title: str
    observations: Sequence[Observation] = ()
    configuration_text: str = ""
    inputs: Sequence[tuple[str, str]] = ()
    versions: Mapping[str, str] = field(default_factory=dict)
    truth: Mapping[str, Any] | None = None
    notes: Sequence[str] = ()
    extra: Sequence[tuple[str, str]] = ()
    goal: GoalStanding | None = None


def render_report(report: ReportInput) -> str:
    """Return the report as one HTML page without any reference to other files."""
    result = report.result
    evaluated = [
        (trust.TITLE, trust.section(result)),
        (reliability.TITLE, reliability.section(result)),
        ("Harmonic content", harmonics.section(result)),
        ("ISO 230-2: positioning of the axis", iso230_section(result)),
    ]
    details = [(name, _short(value)) for name, value in result.all_details.items()]
    return render(
        "report",
        report=report,
        result=result,
        figures=_figures(report),
        columns=[f"{name} / {unit_of(name)[1]}" for name in result.components],
        rows=_deviation_rows(result),
        summary=_summary(result),
        standing=trust.standing(result),
        goal=goal.section(report.goal),
        extra=[*(section for section in evaluated if section[1]), *report.extra],
        sections=[(name.replace("_", " "), text) for name, text in details if text],
        attempts=[o for o in report.observations if not o.accepted],
    )


def _figures(report: ReportInput) -> list[Figure]:
    """Return all figures that the result can fill."""
    result = report.result
    candidates = [
        Figure(
            "Deviations",
            "Deviation = actual − commanded, at every angle. The band is the expanded "
            "uncertainty (k = 2).",
            curves.deviations(result, report.truth),
        ),
        Figure(
            "Adjacent deviations",
            "Deviation of each step between neighbouring angles. These are not the positioning "
            "deviations: a controller needs the cumulative curve above.",
            curves.adjacent(result),
        ),
        *_own_figures(report),
        Figure(
            "Temperature",
            "Temperature at each observation.",
            curves.temperature(report.observations),
        ),
    ]
    return [candidate for candidate in candidates if candidate.svg]


def _own_figures(report: ReportInput) -> Sequence[Figure]:
    """Return what the method draws; of one that is not installed here the residuals."""
    if report.result.method not in method_names():
        return residual_figures(report.result)
    return find_method(report.result.method).figures(report.result, report.truth)


def _deviation_rows(result: Result) -> list[tuple[str, list[str]]]:
    """Return one row per angle: the angle and 'value ± expanded uncertainty' per component."""
    rows = []
    for i, angle in enumerate(result.angles):
        cells = []
        for name in result.components:
            factor, _ = unit_of(name)
            value = result.deviations[name][i] / factor
            band = COVERAGE_FACTOR * result.std[name][i] / factor
            cells.append(f"{value:+.3f} ± {band:.3f}")
        rows.append((f"{angle / DEGREE:.4f}", cells))
    return rows


def _summary(result: Result) -> list[tuple[str, str]]:
    summary = [
        ("Verdict", result.verdict_line),
        ("Table in force", in_words(result.measured_on)),
        ("Observations", f"{result.n_observations}, of these {len(result.rejected)} rejected"),
        ("Degrees of freedom", str(result.dof)),
        ("σ₀ (1 = the stated noise fits)", f"{result.sigma0:.3f}"),
    ]
    for name in result.components:
        factor, unit = unit_of(name)
        values = result.deviations[name] / factor
        band = COVERAGE_FACTOR * result.std[name].max() / factor
        span = f"{values.min():+.3f} to {values.max():+.3f} {unit}"
        summary.append((name, f"{span}, U ≤ {band:.3f} {unit} (k = 2)"))
    return summary


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
