"""The ini file of a LinuxCNC: what it says about one rotary axis, and whether it uses a table.

It is read as LinuxCNC reads it, and completed in a copy. LinuxCNC takes the first section of a
name and the first line of a key in it, and silently ignores all later ones. A value goes to the
end of its line. Source: IniFile::Find of LinuxCNC 2.9 (src/libnml/inifile/inifile.cc);
``#INCLUDE`` is expanded by its start script.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files
from math import isfinite
from pathlib import Path
from typing import Final

import numpy as np

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.untrusted import read_bytes, read_errors_as

AGENT: Final = (
    "/usr/bin/python3",
    str(files("rotcal_ros") / "nodes" / "adapters" / "linuxcnc_agent.py"),
)
"""Talks to the running program, on the system's Python, which has the modules for it."""
LETTERS: Final = "XYZABCUVW"
"""The axes of trivkins without ``coordinates=``, joint by joint."""
SERVO_PERIOD_NS: Final = 1_000_000
"""Assumed if the ini file does not say; all examples of LinuxCNC have it."""
DEGREE_WORDS: Final = ("deg", "degree")
UNLIMITED_DEG: Final = 1e99
SAME_DEG: Final = 1e-6

MOST_JOINTS: Final = 16
"""EMCMOT_MAX_JOINTS of LinuxCNC."""


@dataclass(frozen=True)
class Joint:
    """Joint ``number`` of the machine of ``ini``, the axis ``letter``; degrees and seconds."""

    ini: IniFile
    number: int
    letter: str

    @classmethod
    def of_axis(cls, ini: IniFile, letter: str, number: int) -> Joint:
        """Return the joint of the axis: with trivkins the one in the ini file.

        Other kinematics do not say which joint is the table: then it is ``number``. Raises
        ConfigurationError when the machine has no such axis, joint or unit.
        """
        found = _joints(ini, letter)
        if found and number not in found:
            if number or len(found) > 1:
                raise ConfigurationError(
                    f"{ini.path}: axis {letter} is joint {' and '.join(map(str, found))}, not "
                    f"{number}: set the joint"
                )
            number = found[0]
        ini.require_once(f"JOINT_{number}")
        joint = cls(ini, number, letter)
        unit = ini.value("TRAJ", "ANGULAR_UNITS")
        if not joint.is_angular:
            raise ConfigurationError(
                f"{ini.path}: [{joint.section}] TYPE = {joint._text('TYPE') or 'LINEAR'}, a table "
                "of degrees needs ANGULAR: name the joint of the rotary axis"
            )
        if unit not in DEGREE_WORDS:
            raise ConfigurationError(
                f"{ini.path}: [TRAJ] ANGULAR_UNITS = {unit}, tables are written in degree: "
                "set it to degree"
            )
        return joint

    @property
    def section(self) -> str:
        """The name of its section."""
        return f"JOINT_{self.number}"

    @property
    def is_angular(self) -> bool:
        """Whether it turns; without a TYPE LinuxCNC takes LINEAR."""
        return self._text("TYPE") == "ANGULAR"

    @property
    def acceleration(self) -> float:
        """MAX_ACCELERATION, deg/s^2."""
        return self.ini.number(self.section, "MAX_ACCELERATION", 1.0)

    @property
    def velocity(self) -> float:
        """MAX_VELOCITY, deg/s."""
        return self.ini.number(self.section, "MAX_VELOCITY", 1.0)

    @property
    def home_deg(self) -> float:
        """HOME, where the joint stands after homing; without it LinuxCNC takes 0."""
        return self.ini.number(self.section, "HOME", 0.0)

    @property
    def servo_period_ns(self) -> int:
        """SERVO_PERIOD of the motion controller."""
        return int(self.ini.number("EMCMOT", "SERVO_PERIOD", SERVO_PERIOD_NS))

    @property
    def travel_deg(self) -> tuple[float, float]:
        """The soft limits: the narrower ones of joint and axis."""
        sections = (self.section, f"AXIS_{self.letter}")
        lower = [self.ini.number(s, "MIN_LIMIT", -UNLIMITED_DEG) for s in sections]
        upper = [self.ini.number(s, "MAX_LIMIT", UNLIMITED_DEG) for s in sections]
        return max(lower), min(upper)

    @property
    def backlash_deg(self) -> float:
        """BACKLASH, whose halves LinuxCNC adds and takes off until the joint loads a table."""
        return self.ini.number(self.section, "BACKLASH", 0.0)

    @property
    def misplaced_backlash(self) -> str:
        """That BACKLASH stands where LinuxCNC does not look for it; empty if it does not."""
        axis = f"AXIS_{self.letter}"
        value = self.ini.value(axis, "BACKLASH")
        return "" if value is None else (
            f"{self.ini.path}: [{axis}] BACKLASH = {value}: LinuxCNC reads it in [{self.section}] "
            "only, so it does not act"
        )  # fmt: skip

    @property
    def table_path(self) -> Path | None:
        """The table that it loads; None: none."""
        name = self._text("COMP_FILE")
        return None if not name else self.ini.path.parent / Path(name).expanduser()

    @property
    def table_type(self) -> int:
        """COMP_FILE_TYPE; without one LinuxCNC takes 0."""
        return int(self.ini.number(self.section, "COMP_FILE_TYPE", 0))

    def travel_beyond(self, first_deg: float, last_deg: float) -> str | None:
        """Return in words how the travel exceeds a table from first to last, if it does."""
        lower, upper = self.travel_deg
        if lower >= first_deg - SAME_DEG and upper <= last_deg + SAME_DEG:
            return None
        first, last = int(np.floor(lower / 360.0)), int(np.ceil(upper / 360.0))
        return (
            f"{self._where} may travel from {lower:.9g} to {upper:.9g} deg and the table holds "
            f"{first_deg:.9g} to {last_deg:.9g}; beyond, the end row is held: narrow MIN_LIMIT "
            "and MAX_LIMIT"
            + (
                f", or write a full turn for revolutions {first}:{last}"
                if last - first < 256
                else ""
            )
        )

    def why_not_using(self, table: Path, file_type: int) -> list[str]:
        """Return in words why this joint would not use ``table`` of that type."""
        if self.table_path is None:
            return [f"{self._where} names no table: COMP_FILE = {table.name} is missing"]
        if self.table_path.resolve() != table.resolve():
            return [f"{self._where} COMP_FILE = {self._text('COMP_FILE')} is not {table}"]
        if self.table_type != file_type:
            found = self._text("COMP_FILE_TYPE") or "missing, which means 0"
            return [f"{self._where} COMP_FILE_TYPE is {found}, the table is of type {file_type}"]
        return []

    @property
    def _where(self) -> str:
        return f"{self.ini.path}: [{self.section}]"

    def _text(self, key: str) -> str | None:
        return self.ini.value(self.section, key)


def all_joints(ini: IniFile) -> list[Joint]:
    """Return all joints; ConfigurationError for more than there can be."""
    count = int(ini.number("KINS", "JOINTS", 1))
    if count > MOST_JOINTS:
        raise ConfigurationError(
            f"{ini.path}: [KINS] JOINTS = {count}, LinuxCNC has at most {MOST_JOINTS}; correct it"
        )
    letters = _coordinates(ini)
    return [Joint(ini, n, letters[n] if n < len(letters) else "") for n in range(count)]


def agent_command(ini: str, axis: str, number: int) -> list[str]:
    """Return the command of the agent for one axis of the machine of the file ``ini``.

    ``number`` is the axis' joint if the kinematics do not state it. Raises ConfigurationError
    when the machine has no such axis.
    """
    if not ini:
        raise ConfigurationError(
            "linuxcnc_driver: parameter ini_file is missing: give the machine's ini file"
        )
    joint = Joint.of_axis(IniFile.read(Path(ini)), axis, number)
    return [*AGENT, "-ini", ini, "--axis", joint.letter, "--joint", str(joint.number)]


def _joints(ini: IniFile, letter: str) -> list[int]:
    """Return the joints of an axis; empty: the kinematics do not say."""
    letters = _coordinates(ini)
    found = [number for number, name in enumerate(letters) if name == letter]
    if letters and not found:
        raise ConfigurationError(
            f"{ini.path}: the machine has the axes {letters} and none named {letter}; name "
            "one of them"
        )
    return found


def _coordinates(ini: IniFile) -> str:
    kinematics, *options = (ini.value("KINS", "KINEMATICS") or "").split() or [""]
    if kinematics != "trivkins":
        return ""
    match = re.search(r"coordinates=(\w+)", " ".join(options), re.IGNORECASE)
    return match[1].upper() if match else LETTERS


ENCODING: Final = "latin-1"
"""An encoding for any byte, so that the copy differs only in the new lines."""
_SECTION: Final = re.compile(r"\s*\[([^\]]*)\]")
_PAIR: Final = re.compile(r"\s*([^\s=#;][^\s=]*)\s*=\s*(.*?)\s*")
_INCLUDE: Final = re.compile(r"#INCLUDE\s+(\S+)\s*")
_NUMBER: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?(?![\d.xX])")


@dataclass(frozen=True)
class IniFile:
    """The text of the ini file at ``path``; ConfigurationError when it cannot be read."""

    path: Path
    text: str

    @classmethod
    def read(cls, path: Path) -> IniFile:
        """Read the file; ConfigurationError when there is none."""
        with read_errors_as(path, ConfigurationError, "the machine's ini file "):
            return cls(path, read_bytes(path).decode(ENCODING))

    def value(self, section: str, key: str) -> str | None:
        """Return the value that LinuxCNC finds for ``key`` in ``section``; None: none."""
        inside = False
        for line in self._lines():
            if header := _SECTION.match(line):
                if inside:
                    return None
                inside = header[1] == section
            elif inside and (pair := _PAIR.fullmatch(line)) and pair[1] == key:
                return pair[2]
        return None

    def number(self, section: str, key: str, default: float) -> float:
        """Return a number; ``default`` where there is none; ConfigurationError for other text."""
        text = self.value(section, key)
        if text is None:
            return default
        match = _NUMBER.match(text)
        if match is None:
            raise ConfigurationError(
                f"{self.path}: [{section}] {key} = {text!r}, expected a number"
            )
        if not isfinite(number := float(match[0])):
            raise ConfigurationError(
                f"{self.path}: [{section}] {key} = {text!r:.60} is too large; correct it"
            )
        return number

    def count(self, section: str) -> int:
        """Return how many sections there are of that name."""
        headers = (_SECTION.match(line) for line in self._lines())
        return sum(header is not None and header[1] == section for header in headers)

    def merged(self, section: str, values: Mapping[str, str | int]) -> str:
        """Return the text with ``values`` in ``section``: old lines replaced, new ones at its end.

        All other lines stay as they are. Raises ConfigurationError unless this file itself holds
        the section exactly once.
        """
        self.require_once(section)
        lines = self.text.splitlines(keepends=True)
        headers = [i for i, line in enumerate(lines) if _SECTION.match(line)]
        start = [i for i in headers if (m := _SECTION.match(lines[i])) and m[1] == section]
        if not start:
            raise ConfigurationError(
                f"{self.path}: section [{section}] is in an included file: put the two lines "
                "there by hand"
            )
        end = next((i for i in headers if i > start[0]), len(lines))
        kept = [line for line in lines[start[0] : end] if not _holds(line, values)]
        last = max(i for i, line in enumerate(kept) if line.strip())
        newline = "\r\n" if lines[start[0]].endswith("\r\n") else "\n"
        if not kept[last].endswith("\n"):
            kept[last] += newline
        new = [f"{key} = {value}{newline}" for key, value in values.items()]
        return "".join(
            [*lines[: start[0]], *kept[: last + 1], *new, *kept[last + 1 :], *lines[end:]]
        )

    def require_once(self, section: str) -> None:
        """Raise ConfigurationError unless there is exactly one section of that name."""
        if (count := self.count(section)) != 1:
            raise ConfigurationError(
                f"{self.path} holds {count} sections [{section}], expected one"
                + (": LinuxCNC ignores all but the first" if count else "")
            )

    def _lines(self) -> Iterator[str]:
        """Yield all lines, with those of included files in their place.

        Includes are not nested.
        """
        for line in self.text.splitlines():
            if include := _INCLUDE.fullmatch(line):
                yield from IniFile.read(self.path.parent / include[1]).text.splitlines()
            else:
                yield line


def _holds(line: str, values: Mapping[str, str | int]) -> bool:
    pair = _PAIR.fullmatch(line.rstrip("\r\n"))
    return pair is not None and pair[1] in values
