"""What was calibrated, where, by whom, and with which instruments: group ``identity``.

All of it is text that only people and certificates read; only the tolerances are used in a
computation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from datetime import date, datetime
from typing import Any, Final

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import expert, group, load, setting, to_mapping

_OF_THE_ITEM: Final = ("item", "maker", "model", "serial")


@dataclass(frozen=True)
class InstrumentIdentity:
    """One instrument that was used; unknown texts are empty."""

    maker: str = setting("", doc="manufacturer")
    model: str = setting("", doc="type or model")
    serial: str = setting("", doc="serial number, in quotes")
    calibrated: str = setting("", doc="date of its last calibration, as 2026-03-31")
    certificate: str = setting("", doc="number of the certificate of that calibration")

    def __post_init__(self) -> None:
        """Refuse what is not a date."""
        _check_date("calibrated", self.calibrated)

    @property
    def known(self) -> bool:
        """Whether anything about it is stated."""
        return self != InstrumentIdentity()


@dataclass(frozen=True)
class Instruments:
    """The instruments of a cell, by what they do in it."""

    tracer: InstrumentIdentity = group(InstrumentIdentity)
    tracker: InstrumentIdentity = group(InstrumentIdentity)
    machine: InstrumentIdentity = group(InstrumentIdentity)
    ball_plate: InstrumentIdentity = group(InstrumentIdentity)
    mirror: InstrumentIdentity = group(InstrumentIdentity)
    ball_bar: InstrumentIdentity = group(InstrumentIdentity)
    angle_standard: InstrumentIdentity = group(InstrumentIdentity)  # polygon, indexer, encoder
    autocollimator: InstrumentIdentity = group(InstrumentIdentity)
    interferometer: InstrumentIdentity = group(InstrumentIdentity)
    electronic_level: InstrumentIdentity = group(InstrumentIdentity)
    thermometer: InstrumentIdentity = group(InstrumentIdentity)
    barometer: InstrumentIdentity = group(InstrumentIdentity)
    hygrometer: InstrumentIdentity = group(InstrumentIdentity)

    @property
    def known(self) -> Mapping[str, InstrumentIdentity]:
        """Those about which anything is stated, by name."""
        named = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: instrument for name, instrument in named.items() if instrument.known}


@dataclass(frozen=True)
class Identity:
    """The calibrated item, the place, the people; unknown texts are empty.

    The axis is that of the group ``cell``. ``tolerance_arcsec`` is the largest deviation, either
    way, that a rotation (ECC, EAC, EBC) may have, ``tolerance_um`` that of a displacement.
    """

    item: str = setting("", doc="what is calibrated, e.g. rotary table", first=True)
    maker: str = setting("", doc="its manufacturer")
    model: str = setting("", doc="its type or model")
    serial: str = setting("", doc="its serial number, in quotes")
    place: str = setting("", doc="where it was calibrated")
    operator: str = setting("", doc="who measured")
    laboratory: str = setting("", doc="who is responsible for the calibration")
    laboratory_address: str = expert("", doc="address of the laboratory")
    laboratory_email: str = expert("", doc="email address of the laboratory")
    laboratory_country: str = expert("", doc="country of the laboratory, two letters of ISO 3166")
    customer: str = setting("", doc="for whom it was calibrated")
    customer_address: str = expert("", doc="address of the customer")
    customer_number: str = setting("", doc="number of the order, or of the item at the customer's")
    certificate_number: str = expert("", doc="number of the certificate, in quotes")
    received: str = expert("", doc="date on which the item was received, as 2026-03-31")
    measured: str = setting(
        "",
        doc="day or local time of the measurement, where the data state no date: 2026-03-31 or "
        "2026-03-31T10:00",
    )
    tolerance_arcsec: float = setting(
        0.0, doc="arcsec, largest rotation that the item may show, either way; 0: none agreed",
        minimum=0.0,
    )  # fmt: skip
    tolerance_um: float = setting(
        0.0, doc="um, largest displacement that the item may show, either way; 0: none agreed",
        minimum=0.0,
    )  # fmt: skip
    instruments: Instruments = group(Instruments)

    def __post_init__(self) -> None:
        """Refuse what is not a date or a country."""
        _check_date("received", self.received)
        if self.measured and self.measured != _time_of_day(self.measured):
            _check_date("measured", self.measured, " or 2026-03-31T10:00")
        country = self.laboratory_country
        if country and not (len(country) == 2 and country.isascii() and country.isupper()):
            raise ConfigurationError(
                f"laboratory_country: {country!r}: expected two capital letters of ISO 3166, as DE"
            )

    @property
    def title(self) -> str:
        """The item in one line, as far as stated."""
        words = [self.item, self.maker, self.model, f"no. {self.serial}" if self.serial else ""]
        return " ".join(word for word in words if word)

    @classmethod
    def joined(cls, parts: Sequence[Identity]) -> Identity:
        """Return the identity that all ``parts``, or their items alone, agree on."""
        if parts and all(part == parts[0] for part in parts):
            return parts[0]
        stated = {name: {getattr(part, name) for part in parts} - {""} for name in _OF_THE_ITEM}
        return cls(**{name: texts.pop() for name, texts in stated.items() if len(texts) == 1})

    def to_dict(self) -> dict[str, Any]:
        """Return what is known, without the empty texts, in plain types."""
        return _without_nothing(to_mapping(self))

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Identity:
        """Rebuild it from :meth:`to_dict`; raises ConfigurationError for wrong data."""
        return load(cls, data, "identity")


def _time_of_day(text: str) -> str | None:
    """Return a day with a time as isoformat writes it, to the minute; None for other texts."""
    with suppress(ValueError):
        return datetime.fromisoformat(text).isoformat(timespec="minutes")
    return None


def _check_date(name: str, text: str, more: str = "") -> None:
    try:
        # fromisoformat takes 20260331 and 2026-W14-2 too, but the xs:date of a certificate must
        # be 2026-03-31: so the text must be what isoformat writes.
        whole = not text or date.fromisoformat(text).isoformat() == text
    except ValueError:
        whole = False
    if not whole:
        raise ConfigurationError(
            f"{name}: {text!r} is not a date: expected one like 2026-03-31{more}"
        )


def _without_nothing(values: Mapping[str, Any]) -> dict[str, Any]:
    plain = {k: _without_nothing(v) if isinstance(v, Mapping) else v for k, v in values.items()}
    return {name: value for name, value in plain.items() if value not in ("", 0.0, {})}
