"""Sections of the report: budget, goal, harmonics, reliability, traceability, protections."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from itertools import cycle
from typing import Any, Final

import numpy as np

from rotcal_ros.evaluation.budget import WHOLE, contributions
from rotcal_ros.evaluation.harmonics import HarmonicContent, harmonic_content
from rotcal_ros.evaluation.reliability import Reliability, reliability
from rotcal_ros.foundation.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.curves.measured import measured_curve
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.gum_numbers import (
    place_of,
    uncertainty,
    value_to,
    value_with_uncertainty,
)
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.protection import TOLERABLE
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE
from rotcal_ros.methods.figures import style
from rotcal_ros.methods.goal import GoalStanding
from rotcal_ros.planning.plan import PlanFigures
from rotcal_ros.report.facts import NOT_STATED
from rotcal_ros.report.first_page import degrees
from rotcal_ros.report.template import render

BUDGET = "Uncertainty budget"


def budget(result: Result, withheld: str | None) -> str:
    """Return the budget as HTML, after the reason for which no U is stated, if there is one."""
    return render(
        "budget",
        figure=sources(result),
        tables=_tables(result),
        withheld=withheld,
        refraction=result.circumstances.refraction or NOT_STATED,
        dof=result.dof,
        sigma0=f"{result.sigma0:.2f}",
    )


@style.styled
def sources(result: Result) -> str:
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
    """Return a table for each component that is split, or one for all if none is."""
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
    caption = f"{WHOLE}: the method does not separate the sources"
    head = ["Deviation", "where U is largest", "u", f"U (k = {COVERAGE_FACTOR:g})"]
    return [{"caption": caption, "head": head, "rows": rows}]


def _table(result: Result, name: str) -> dict[str, Any]:
    """Return the sources at the angle with the largest uncertainty as text."""
    unit, label = unit_of(name)
    std = result.std[name] / unit
    worst = int(np.argmax(std))
    whole = float(std[worst])
    # Half of the digits of U = 2 u: a source is shown to the place of the sum.
    place = place_of(whole) if whole else 0
    rows = []
    for part in contributions(result, name):
        size = float(part.std[worst]) / unit
        share = 100.0 * (size / whole) ** 2 if whole else 0.0
        rows.append([part.source, value_to(size, place), f"{share:.0f} %"])
    expanded = COVERAGE_FACTOR * whole
    rows.append(["Combined standard uncertainty", value_to(whole, place), "100 %"])
    rows.append([f"Expanded uncertainty U (k = {COVERAGE_FACTOR:g})", uncertainty(expanded), ""])
    return {
        "caption": f"{name} at {degrees(float(result.angles[worst]))}°, where its U is largest",
        "head": ["Source", f"u / {label}", "Share of u²"],
        "rows": rows,
    }


def goal_standing(standing: GoalStanding | None) -> str | None:
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
        reason=standing.reason,
        noise=f"{standing.compared.length_std / MICROMETRE:.3g}",
        rows=_plan_rows(own, papers),
    )


def _plan_rows(own: PlanFigures, papers: PlanFigures) -> list[list[str]]:
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


@style.styled
def bars(found: Mapping[str, HarmonicContent]) -> str:
    """Draw the amplitudes over the order, pale if the order does not differ from zero."""
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
        ax.set_ylabel(f"{name} amplitude / {label}")
        style.whole_numbers(ax.xaxis)
    for ax in panels[len(found) :]:
        ax.set_axis_off()
    return style.svg(panels[0])


def harmonics(result: Result) -> str | None:
    """Return the harmonic content as HTML; None when no curve covers a full turn."""
    found = {}
    for name in result.components:
        # An arc, or a curve that does not close: the report shows that elsewhere.
        with suppress(DataError):
            found[name] = harmonic_content(measured_curve(result, name))
    if not found:
        return None
    tables = [_harmonics_table(name, content) for name, content in found.items()]
    return render("harmonics", figure=bars(found), tables=tables)


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
            _phase(float(phase[k]), float(turn[k])) if content.significant[k] else "–",
        )
        for k, order in enumerate(content.orders)
    ]
    rest = f"{content.residual_rms / unit:.4f} {label}"
    return {"name": name, "unit": label, "rows": rows, "rest": rest}


def _phase(degrees: float, expanded: float) -> str:
    return value_with_uncertainty(degrees, expanded).lstrip("+")


RELIABILITY: Final = "What a single observation could hide"
_WORST: Final = 8


def reliability_of_observations(result: Result) -> str | None:
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
    metres = ["Error / µm"] if found.std is not None else []
    columns = ["Error / its std", "Effect, at most / std"]
    return ["Table position", "Target", "Redundancy", *metres, *columns]


def _observation_rows(found: Reliability) -> list[list[str]]:
    """Return position, target, redundancy, minimal detectable error and bound of its effect."""
    metres, rows = found.detectable_m(), []
    for k in found.worst(_WORST).tolist():
        numbers = [found.detectable[k], found.effect[k]]
        if metres is not None:
            numbers.insert(0, metres[k] / MICROMETRE)
        row = [str(found.table_position[k]), str(found.target[k]), f"{found.redundancy[k]:.3f}"]
        rows.append([*row, *(f"{v:.2f}" if np.isfinite(v) else "any" for v in numbers)])
    return rows


TRACEABILITY: Final = "Traceability"
_INSTRUMENTS: Final = (
    "Instrument",
    "Maker and model",
    "Serial number",
    "Calibrated",
    "Certificate",
)


def traceability_statement(result: Result) -> str:
    """Return in one sentence how far the numbers are traceable, as far as stated."""
    if result.simulated:
        return "None: a simulation was measured, no instrument."
    known = result.circumstances.identity.instruments.known
    certified = [name for name, instrument in known.items() if instrument.certificate]
    if not certified:
        return f"{NOT_STATED}: no certificate of an instrument is named."
    return f"Through the calibration certificates of: {', '.join(map(_spoken, certified))}."


def traceability(result: Result) -> str:
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
        rows.append([_spoken(name).capitalize(), *(text or NOT_STATED for text in texts)])
    return rows


def _spoken(name: str) -> str:
    return name.replace("_", " ")


TRUST = "What could be wrong, and would it show?"


def protections(result: Result) -> str:
    """Return the table of protections as HTML, one row per effect."""
    return render(
        "trust",
        rows=[
            {
                "effect": p.effect,
                "treatment": p.treatment,
                "why": p.why,
                "error": "" if p.error is None else f"{p.error:.1f}",
                "bare": p.effect in result.unprotected,
            }
            for p in result.protections
        ],
        tolerable=f"{TOLERABLE:g}",
    )
