"""Traceability: the instruments with their serial numbers and calibrations."""

from __future__ import annotations

from typing import Final

from rotcal_ros.identity import Identity
from rotcal_ros.report.facts import NOT_STATED
from rotcal_ros.report.template import render
from rotcal_ros.results import Result

TITLE: Final = "Traceability"
HEAD: Final = ("Instrument", "Maker and model", "Serial number", "Calibrated", "Certificate")


def statement(result: Result) -> str:
    """Return in one sentence how far the numbers are traceable, claiming nothing unstated."""
    if result.simulated:
        return "None: a simulation was measured, no instrument."
    known = result.circumstances.identity.instruments.known
    certified = [name for name, instrument in known.items() if instrument.certificate]
    if not certified:
        return f"{NOT_STATED}: no certificate of an instrument is named."
    return f"Through the calibration certificates of: {', '.join(map(_spoken, certified))}."


def section(result: Result) -> str:
    """Return instruments and statement as HTML."""
    return render(
        "traceability",
        statement=statement(result),
        head=HEAD,
        rows=_rows(result.circumstances.identity),
    )


def _rows(identity: Identity) -> list[list[str]]:
    rows = []
    for name, instrument in identity.instruments.known.items():
        model = " ".join(text for text in (instrument.maker, instrument.model) if text)
        texts = [model, instrument.serial, instrument.calibrated, instrument.certificate]
        rows.append([_spoken(name).capitalize(), *(text or NOT_STATED for text in texts)])
    return rows


def _spoken(name: str) -> str:
    return name.replace("_", " ")
