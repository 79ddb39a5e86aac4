"""What a certificate has to say, and which settings say it."""

from __future__ import annotations

from typing import Final

from rotcal_ros.errors import ConfigurationError, DataError
from rotcal_ros.results import Result

REQUIRED: Final = {
    "item": "what was calibrated",
    "serial": "the serial number that the item is known by",
    "place": "where it was calibrated",
    "operator": "the person who is responsible",
    "laboratory": "who is responsible for the calibration",
    "laboratory_address": "where the laboratory is",
    "laboratory_country": "in which country, two letters of ISO 3166",
    "customer": "for whom it was calibrated",
    "customer_address": "where the customer is",
    "certificate_number": "the unique number of the certificate",
}
"""Settings of the group ``identity`` that no certificate can do without, and why."""


def require(result: Result) -> None:
    """Refuse what cannot be certified.

    Raises ConfigurationError that lists everything that is missing, by the names of the settings,
    and DataError for a result that is not ok: a certificate vouches for its uncertainties.
    """
    missing = missing_settings(result)
    if missing:
        lines = "\n".join(f"  {name}: {why}" for name, why in missing.items())
        raise ConfigurationError(
            "a calibration certificate needs more than this result tells, see below: give it in "
            "the configuration, or with --setup or --set for a bag (the "
            "group identity changes no number)",
            lines,
        )
    if result.verdict != "ok":
        raise DataError(
            f"the verdict is {result.verdict}: no certificate is written about uncertainties that "
            "the data contradict; the report says why"
        )


def missing_settings(result: Result) -> dict[str, str]:
    """Return the settings that are missing for a certificate, with what they are for."""
    circumstances = result.circumstances
    identity = circumstances.identity
    missing = {
        f"identity.{name}": why for name, why in REQUIRED.items() if not getattr(identity, name)
    }
    traced = [i for i in identity.instruments.known.values() if i.serial and i.calibrated]
    if not traced:
        missing["identity.instruments.*"] = (
            "serial and date of calibration (calibrated) of one instrument or more: traceability"
        )
    if circumstances.begun_ns is None:
        missing["time"] = "when it was measured: the result of a table does not know, a bag does"
    return missing
