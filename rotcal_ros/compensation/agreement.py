"""Checks whether a table belongs to the machine that it is meant for: axis, serial number, age.

``rotcal export`` and the bridge use the same function. A table that contradicts is refused; a
person may accept it nevertheless, by the word for that kind of contradiction.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from rotcal_ros.foundation.errors import ConfigurationError, DataError, Question
from rotcal_ros.foundation.units import NANOSECOND

if TYPE_CHECKING:
    from rotcal_ros.compensation.table import CompensationTable

AXIS: Final = "axis"
SERIAL: Final = "serial"
AGE: Final = "age"
CONFLICTS: Final = (AXIS, SERIAL, AGE)
"""The words that accept contradictions, one for each kind."""
UNVERIFIED: Final = "unverified"
"""Accepts what has not been confirmed of a controller; no contradiction."""
ACCEPT: Final = "accept"
"""The setting that a refusal asks for: its answers are such words, each with the reason."""
LARGEST_AGE_DAYS: Final = 30.0
"""Largest age of a measurement unless the settings say otherwise: tables are remounted, and they
wear."""
DAY_S: Final = 86_400.0


@dataclass(frozen=True)
class MachineIdentity:
    """The axis letter and the serial number of what a table is for; empty: not known."""

    axis: str = ""
    serial: str = ""


NO_MACHINE: Final = MachineIdentity()


@dataclass(frozen=True)
class AcceptedConflicts:
    """What a person accepts: words of CONFLICTS, and how old (days) a measurement may be."""

    words: tuple[str, ...] = ()
    largest_age_days: float = LARGEST_AGE_DAYS

    def __post_init__(self) -> None:
        if wrong := [word for word in self.words if word not in CONFLICTS]:
            raise ConfigurationError(
                f"accept {wrong[0]!r}: expected one of {', '.join(CONFLICTS)}, what it accepts"
            )
        if not self.largest_age_days > 0.0:
            raise ConfigurationError(
                f"largest age {self.largest_age_days:g} days: expected more than 0"
            )


def check_table_for_machines(
    table: CompensationTable,
    machines: Mapping[str, MachineIdentity],
    accepted: AcceptedConflicts,
    now_ns: int,
    made_ns: int = 0,
) -> CompensationTable:
    """Return ``table`` for ``machines`` that it belongs to, see :func:`require_same_machine`.

    ``made_ns`` is when the table was made, which counts if the time of measurement is not known.
    A contradiction that is accepted becomes a warning, and so does an unknown age; the axis
    becomes that of the machines.
    """
    measured = MachineIdentity(table.axis, table.serial)
    notes = require_same_machine(
        measured, table.measured_from_ns or made_ns, machines, accepted, now_ns
    )
    axis = next((m.axis for m in machines.values() if m.axis), table.axis)
    fresh = tuple(note for note in notes if note not in table.warnings)
    if not fresh and axis == table.axis:
        return table
    return replace(table, axis=axis, warnings=(*table.warnings, *fresh))


def require_same_machine(
    measured: MachineIdentity,
    made_ns: int,
    machines: Mapping[str, MachineIdentity],
    accepted: AcceptedConflicts,
    now_ns: int,
) -> tuple[str, ...]:
    """Return in words the accepted contradictions between ``measured`` and ``machines``.

    The keys of ``machines`` are names for people. The measurement was made at ``made_ns`` (since
    1970; 0: not known) and must not be older at ``now_ns`` than accepted. An unknown age and an
    unknown item are reported too: they must not count as young, and as the right one. Raises
    DataError with every contradiction that is not accepted, and its word.
    """
    found = _contradictions(measured, machines)
    limit = f"at most {accepted.largest_age_days:g} are accepted (--max-age, bridge.max_age_days)"
    age_days = (now_ns - made_ns) * NANOSECOND / DAY_S
    if made_ns and age_days > accepted.largest_age_days:
        found[AGE] = [f"the measurement is {age_days:.0f} days old, {limit}"]
    refused = [word for word in found if word not in accepted.words]
    if refused:
        words = " ".join(f"--accept {word}" for word in refused)
        raise DataError(
            f"{'; '.join(text for word in refused for text in found[word])}: the table does not "
            f"belong here. To use it nevertheless, say so: {words} "
            f"(bridge.accept: [{', '.join(refused)}]); nothing was written",
            question=Question(ACCEPT, tuple((word, "; ".join(found[word])) for word in refused)),
        )
    unknown = [] if made_ns else [f"it is not known how many days ago this was measured, {limit}"]
    if not measured.serial:
        unknown += [
            f"it is not known which item was measured: nothing shows that it is {machine.serial}, "
            f"as {name} says"
            for name, machine in machines.items()
            if machine.serial
        ]
    return tuple(unknown) + tuple(
        f"{text}: accepted by a person ({word})" for word, texts in found.items() for text in texts
    )


def require_verified(title: str, unverified: Iterable[str]) -> None:
    """Raise ConfigurationError if something about the controller ``title`` is not verified."""
    if words := "; ".join(unverified):
        raise ConfigurationError(
            f"{title}: not verified: {words}. Give --accept-unverified to write the file "
            "nevertheless, and test it with one small value first",
            question=Question(ACCEPT, ((UNVERIFIED, f"{title}: not verified: {words}"),)),
        )


def _contradictions(
    measured: MachineIdentity, machines: Mapping[str, MachineIdentity]
) -> dict[str, list[str]]:
    """Return where axis and serial number contradict, in words, by the word that accepts it."""
    found: dict[str, list[str]] = {}
    serial, its = (
        measured.serial,
        f"the item with the serial number {measured.serial} was measured",
    )
    for name, machine in machines.items():
        if measured.axis and machine.axis and machine.axis != measured.axis:
            found.setdefault(AXIS, []).append(
                f"axis {measured.axis} was measured and {name} has axis {machine.axis}"
            )
        if serial and machine.serial and machine.serial != serial:
            found.setdefault(SERIAL, []).append(f"{its} and {name} has {machine.serial}")
        if machine.serial and not serial:
            serial, its = machine.serial, f"{name} has the serial number {machine.serial}"
    return found


def split_words(texts: Iterable[str]) -> tuple[str, ...]:
    """Return the words of several options, each of which may hold more than one."""
    return tuple(word for text in texts for word in text.replace(",", " ").split())
