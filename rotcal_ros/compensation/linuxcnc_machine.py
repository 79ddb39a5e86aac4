"""What the ini file of a LinuxCNC says about a rotary axis, and whether it uses a table."""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Final

import numpy as np

from rotcal_ros.compensation.linuxcnc_ini import Ini
from rotcal_ros.foundation.errors import ConfigurationError

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

    ini: Ini
    number: int
    letter: str

    @classmethod
    def of_axis(cls, ini: Ini, letter: str, number: int) -> Joint:
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
        kind, unit = joint._text("TYPE") or "LINEAR", ini.value("TRAJ", "ANGULAR_UNITS")
        if kind != "ANGULAR":
            raise ConfigurationError(
                f"{ini.path}: [{joint.section}] TYPE = {kind}, a table of degrees needs ANGULAR"
            )
        if unit not in DEGREE_WORDS:
            raise ConfigurationError(
                f"{ini.path}: [TRAJ] ANGULAR_UNITS = {unit}, tables are written in degree"
            )
        return joint

    @property
    def section(self) -> str:
        """The name of its section."""
        return f"JOINT_{self.number}"

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

    def not_using(self, table: Path, file_type: int) -> list[str]:
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


def joints_with_tables(ini: Ini) -> list[Joint]:
    """Return the joints that load a table; ConfigurationError for more than there can be."""
    count = int(ini.number("KINS", "JOINTS", 1))
    if count > MOST_JOINTS:
        raise ConfigurationError(
            f"{ini.path}: [KINS] JOINTS = {count}, LinuxCNC has at most {MOST_JOINTS}"
        )
    letters = _coordinates(ini)
    joints = [Joint(ini, n, letters[n] if n < len(letters) else "") for n in range(count)]
    return [joint for joint in joints if joint.table_path is not None]


def agent_command(ini: str, axis: str, number: int) -> list[str]:
    """Return the command of the agent for one axis of the machine of the file ``ini``.

    ``number`` is the axis' joint if the kinematics do not state it. Raises ConfigurationError
    when the machine has no such axis.
    """
    if not ini:
        raise ConfigurationError("linuxcnc_driver: parameter ini_file is missing")
    joint = Joint.of_axis(Ini.read(Path(ini)), axis, number)
    return [*AGENT, "-ini", ini, "--axis", joint.letter, "--joint", str(joint.number)]


def _joints(ini: Ini, letter: str) -> list[int]:
    """Return the joints of an axis; empty: the kinematics do not say."""
    letters = _coordinates(ini)
    found = [number for number, name in enumerate(letters) if name == letter]
    if letters and not found:
        raise ConfigurationError(
            f"{ini.path}: the machine has the axes {letters} and none named {letter}"
        )
    return found


def _coordinates(ini: Ini) -> str:
    kinematics, *options = (ini.value("KINS", "KINEMATICS") or "").split() or [""]
    if kinematics != "trivkins":
        return ""
    match = re.search(r"coordinates=(\w+)", " ".join(options), re.IGNORECASE)
    return match[1].upper() if match else LETTERS
