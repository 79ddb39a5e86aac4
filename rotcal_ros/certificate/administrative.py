"""First part of a certificate: who calibrated what for whom, with which software."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import date, datetime, timezone
from typing import Any, Final

from rotcal_ros import __version__
from rotcal_ros.certificate.elements import (
    DCC,
    LANGUAGE,
    contact,
    identification,
    leaf,
    present,
    text,
)
from rotcal_ros.circumstances import SIMULATED, Circumstances
from rotcal_ros.identity import Identity
from rotcal_ros.results import Result

NOT_MEASURED: Final = f"{SIMULATED}: a simulation, no item was measured."
_SECOND_NS: Final = 1_000_000_000


def administrative_data(result: Result, issued: date) -> Any:
    """Return the element ``administrativeData``."""
    circumstances = result.circumstances
    identity = circumstances.identity
    return DCC.administrativeData(
        DCC.dccSoftware(software()),
        _core_data(circumstances, issued),
        DCC.items(_item(circumstances)),
        DCC.calibrationLaboratory(
            contact(
                "contact",
                identity.laboratory,
                identity.laboratory_address,
                identity.laboratory_email,
                identity.laboratory_country,
            )
        ),
        DCC.respPersons(
            DCC.respPerson(contact("person", identity.operator), leaf("mainSigner", "true"))
        ),
        contact("customer", identity.customer, identity.customer_address),
        DCC.statements(*(DCC.statement(*parts) for parts in _statements(result))),
    )


def marked(name: str, circumstances: Circumstances) -> str:
    """Return a name that says where a simulation was measured instead."""
    return f"{SIMULATED}: {name}" if circumstances.simulated else name


def software() -> Any:
    """Return this software as an element."""
    return DCC.software(
        text("name", "rotcal_ros"), leaf("release", __version__), leaf("type", "application")
    )


def day(stamp_ns: int) -> str:
    """Return the date (UTC) of a stamp."""
    return datetime.fromtimestamp(stamp_ns // _SECOND_NS, timezone.utc).date().isoformat()


def _core_data(circumstances: Circumstances, issued: date) -> Any:
    identity = circumstances.identity
    begun, ended = circumstances.begun_ns, circumstances.ended_ns
    assert begun is not None
    number = f"{SIMULATED}-" * circumstances.simulated + identity.certificate_number
    ordered = None
    if identity.customer_number:
        known = identification("customer", identity.customer_number, "customer's number")
        ordered = DCC.identifications(known)
    return DCC.coreData(
        *present(
            leaf("countryCodeISO3166_1", identity.laboratory_country),
            leaf("usedLangCodeISO639_1", LANGUAGE),
            leaf("mandatoryLangCodeISO639_1", LANGUAGE),
            leaf("uniqueIdentifier", number),
            ordered,
            leaf("receiptDate", identity.received) if identity.received else None,
            leaf("beginPerformanceDate", day(begun)),
            leaf("endPerformanceDate", day(begun if ended is None else ended)),
            leaf("performanceLocation", "other"),
            leaf("issueDate", issued.isoformat()),
        )
    )


def _item(circumstances: Circumstances) -> Any:
    identity: Identity = circumstances.identity
    axis = f"Rotary axis {circumstances.axis}." if circumstances.axis else "Rotary axis."
    paragraphs = [axis, NOT_MEASURED] if circumstances.simulated else [axis]
    return DCC.item(
        *present(
            text("name", marked(identity.item, circumstances)),
            text("description", *paragraphs),
            contact("manufacturer", identity.maker) if identity.maker else None,
            leaf("model", identity.model) if identity.model else None,
            DCC.identifications(identification("manufacturer", identity.serial, "serial number")),
        )
    )


def _statements(result: Result) -> Iterator[list[Any]]:
    """Yield name and declaration of what a reader has to know."""
    circumstances = result.circumstances
    if circumstances.simulated:
        yield _statement(SIMULATED, NOT_MEASURED)
    yield _statement("Place of calibration", circumstances.identity.place)
    yield _statement(
        "Uncertainty",
        "The expanded uncertainties are standard uncertainties times the coverage factor k = 2, "
        "which for a normal distribution is a coverage of about 95 %. The covariance matrices are "
        "those of the standard uncertainties (JCGM 100).",
    )
    yield _statement(
        "Traceability",
        "The results are traced through the instruments named with the results and the "
        "certificates of their calibrations.",
    )
    yield _statement("Verdict of the evaluation", f"{result.verdict_line}.")
    if result.warnings:
        yield _statement("Remarks", *result.warnings)


def _statement(name: str, *paragraphs: str) -> list[Any]:
    return [text("name", name), text("declaration", *paragraphs)]
