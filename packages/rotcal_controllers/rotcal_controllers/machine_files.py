"""What a machine's own files say of its axis: texts of settings, read as they are printed.

Sources of the forms: SINUMERIK, rows of an archive in a public program's data (``N32700
$MA_ENC_COMP_ENABLE[0,AX4]``) and 6FC5397-1BP40-3BA1; FANUC, a punched parameter file in a public
program's tests (``N01851Q1A1P4A2P0``, bits ``N01815Q1A1P00000010``); TwinCAT, the example of
TF5200, page 309173003.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, nan
from pathlib import Path
from typing import Final

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.untrusted import read_bytes, read_errors_as

_MACHINE_DATUM: Final = re.compile(
    r'^[ \t]*(?:N\d+[ \t]+)?\$(\w+)[ \t]*(?:\[([^\]\n]*)\])?[ \t]*=[ \t]*"?([^"\s;]+)',
    re.MULTILINE,
)
_BLOCK: Final = re.compile(r"^\s*N0*(\d{1,5})(?:Q\d+)?((?:[A-Z]\d+)?P\S*)\s*$", re.MULTILINE)
_VALUE: Final = re.compile(r"(?:A(\d+))?P([-+]?\d+(?:\.\d*)?)")


def machine_text(path: str) -> str:
    """Return the text of a machine's file; ConfigurationError when it cannot be read."""
    with read_errors_as(Path(path), ConfigurationError, "the machine's file "):
        return read_bytes(Path(path)).decode("latin-1")


def parse_finite(path: str, name: str, text: str) -> float:
    """Return the number that ``text`` is; ConfigurationError for any other text."""
    try:
        number = float(text)
    except ValueError:
        number = nan
    if not isfinite(number):
        raise ConfigurationError(f"{path}: {name} is {text!r:.40}, expected a number")
    return number


def backlash_note(name: str, now: float | None, measured: float | None, unit: str) -> str:
    """Return what is to be known of a backlash that acts beside the table; empty if nothing.

    ``now`` is the value in the machine's file, None if it is not there; ``measured`` what a person
    says that it was during the measurement. Raises ConfigurationError where they differ.
    """
    if now is None:
        return f"{name} is not in the machine's file: leave it as it was during the measurement"
    if measured is not None and abs(now - measured) > 1e-9:
        raise ConfigurationError(
            f"{name} is {now:g} {unit} in the machine's file and was {measured:g} during the "
            "measurement: nothing of it is in the table, so set it back, or measure again"
        )
    return "" if not now else (
        f"{name} = {now:g} {unit} acts beside the table, and has to be what it was during the "
        "measurement: nothing of it is in the table"
    )  # fmt: skip


@dataclass(frozen=True)
class MachineData:
    """Machine and setting data of a SINUMERIK archive: ``values`` by name and index."""

    path: str
    values: Mapping[tuple[str, str], str]

    @classmethod
    def read(cls, path: str) -> MachineData:
        """Read an archive or initial.ini; ConfigurationError for a file without machine data."""
        found = {
            (name, index.replace(" ", "")): value
            for name, index, value in _MACHINE_DATUM.findall(machine_text(path))
        }
        if not found:
            raise ConfigurationError(
                f"{path}: no machine data, as N32450 $MA_BACKLASH[0,AX4]=0: give an archive in "
                "text form"
            )
        return cls(path, found)

    def axis(self, name: str) -> str:
        """Return AX1 .. of the machine axis ``name``; ConfigurationError if there is none."""
        tab = {
            value: f"AX{int(index) + 1}"
            for (datum, index), value in self.values.items()
            if datum == "MN_AXCONF_MACHAX_NAME_TAB" and index.isdecimal()
        }
        axes = {index.rpartition(",")[2] for datum, index in self.values if datum[:2] == "MA"}
        found = tab.get(name, name)
        if found not in axes:
            known = ", ".join(sorted({*tab, *axes}))
            raise ConfigurationError(
                f"{self.path}: no machine axis {name}: set axis_name to one of {known}"
            )
        return found

    def number(self, name: str, index: str) -> float | None:
        """Return a number; None where the file does not state it."""
        text = self.values.get((name, index))
        return None if text is None else parse_finite(self.path, f"${name}[{index}]", text)


@dataclass(frozen=True)
class PunchedParameters:
    """Parameters of a FANUC file: ``values`` as texts by number and axis, 0 for those of none."""

    path: str
    values: Mapping[tuple[int, int], str]

    @classmethod
    def read(cls, path: str) -> PunchedParameters:
        """Read a punched parameter file; ConfigurationError for a file without parameters."""
        text = machine_text(path).replace(";", "\n")
        found = {
            (int(number), int(axis or 0)): value
            for number, rest in _BLOCK.findall(text)
            for axis, value in _VALUE.findall(rest)
        }
        if not found:
            raise ConfigurationError(
                f"{path}: no parameters, as N01851Q1A1P0A2P0: punch them to a file again"
            )
        return cls(path, found)

    def number(self, parameter: int, axis: int) -> float | None:
        """Return the value for an axis; None where the file does not state it."""
        text = self.values.get((parameter, axis))
        return None if text is None else parse_finite(self.path, f"N{parameter:05d}A{axis}", text)

    def bit(self, parameter: int, axis: int, bit: int) -> bool | None:
        """Return a bit, counted from the right; None where eight of them do not stand there."""
        text = self.values.get((parameter, axis), "")
        return text[-1 - bit] == "1" if re.fullmatch(r"[01]{8}", text) else None
