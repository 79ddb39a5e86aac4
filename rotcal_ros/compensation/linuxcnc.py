"""LinuxCNC: ``[JOINT_n] COMP_FILE``, read by usrmotLoadComp, applied by the motion controller.

Lines ``nominal forward reverse`` in degrees. Type 0 holds the measured actual angle, type 1 the
trim that is added to the motor command. The real program silently stops at the first line that is
not three numbers, takes 256 rows, and does not know that an axis is round: the rows are repeated
for every turn of the travel. Source: LinuxCNC 2.9, src/emc/motion (usrmotintf.cc, command.c,
control.c) and docs/src/config/ini-config.adoc.

The trim follows its table once in a servo period and has half of the joint's velocity and
acceleration. At rest it makes a small change at once and ramps to a far one; between the two lies
a dead band in which it stands still: from a quarter to half of MAX_ACCELERATION times the square
of the servo period (compute_screw_comp in control.c).

The place of rotary axes goes into pins of ``xyzac-trt-kins`` and ``xyzbc-trt-kins``. For a table
that turns about C on one that tilts about A (or B) a point w of the work stands, with both angles
counter-clockwise, at

    r + d + Rx(A) (Rz(C) (w - r) - d)

r are the pins x-, y-, z-rot-point, and d the pins y-offset and z-offset (x-offset and z-offset for
B), to which tool-offset adds. So C stands at x-rot-point, y-rot-point; A lies at y-rot-point +
y-offset, z-rot-point + z-offset. Source: trtfuncs.c of LinuxCNC 2.9, and runs of the program.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.compensation.axis_location import LENGTH_DECIMALS, rounded_lengths
from rotcal_ros.compensation.controller import (
    Comment,
    EveryTurnController,
    Facts,
    Lag,
    Located,
    OwnSetting,
    Rule,
)
from rotcal_ros.compensation.controller_files import (
    columns_deg,
    fixed,
    only_file,
    repeat_for_turns,
    require_at_most,
)
from rotcal_ros.compensation.linuxcnc_machine import (
    AGENT,
    ENCODING,
    SERVO_PERIOD_NS,
    IniFile,
    Joint,
    all_joints,
)
from rotcal_ros.compensation.table import DIRECTIONS, CompensationTable
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.results import AxisLine
from rotcal_ros.foundation.settings import setting
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE, MILLIMETRE, NANOSECOND, TURN
from rotcal_ros.foundation.untrusted import read_bytes

KINEMATICS: Final = ("xyzac-trt-kins", "xyzbc-trt-kins")
SOURCE: Final = "LinuxCNC 2.9 source (trtfuncs.c) and runs of the program"
UNITS: Final = {
    **dict.fromkeys(("mm", "metric"), MILLIMETRE),
    **dict.fromkeys(("in", "inch", "imperial"), 25.4 * MILLIMETRE),
}
"""Words of [TRAJ] LINEAR_UNITS."""
HEIGHT_M: Final = 0.1
MAX_ROWS: Final = 256
POINTS_PER_ROW: Final = 24
LINES: Final = ("COMP_FILE", "COMP_FILE_TYPE")
UNKNOWN_LIMITS: Final = (
    "MAX_ACCELERATION of the joint is not known: what stays in the dead band of LinuxCNC's trim "
    "is not in the stated residual (setting machine_ini, or max_acceleration_deg_s2)"
)
UNKNOWN_BACKLASH: Final = (
    "BACKLASH of the joint is not known: LinuxCNC ignores it once it has a table, and then what "
    "it corrected in the measurement is missing: state --set backlash_deg=DEG, 0 for none, or "
    "--set machine_ini=FILE"
)
DECIMALS: Final = 9


def kinematics_and_unit(ini: IniFile) -> tuple[str, float]:
    """Return kinematics and linear unit (m) of a machine; ConfigurationError for other ones."""
    name = ((ini.value("KINS", "KINEMATICS") or "").split() or [""])[0]
    if name not in KINEMATICS:
        raise ConfigurationError(
            f"{ini.path}: [KINS] KINEMATICS = {name or 'missing'} has no place for an axis, "
            f"expected {' or '.join(KINEMATICS)}; with other kinematics the work offset takes it"
        )
    unit = (ini.value("TRAJ", "LINEAR_UNITS") or "").lower()
    if unit not in UNITS:
        raise ConfigurationError(
            f"{ini.path}: [TRAJ] LINEAR_UNITS = {unit or 'missing'}, expected mm or inch"
        )
    return name, UNITS[unit]


def pins_in_hal(
    lines: Sequence[AxisLine], stem: str, head: Sequence[str], kinematics: str, unit_m: float
) -> Located:
    """Return the HAL lines that set the pins for ``lines``, in units of ``unit_m``.

    Raises ConfigurationError if the axis that tilts is not that of the kinematics.
    """
    table, *tilting = lines
    letter = kinematics[3].upper()
    across = "yx"["AB".index(letter)]
    if tilting and tilting[0].letter != letter:
        raise ConfigurationError(
            f"{kinematics} tilts about {letter}, and {tilting[0].letter} was measured: set "
            f"kinematics to {next(k for k in KINEMATICS if k != kinematics)}"
        )
    point = table.point
    values = {"x-rot-point": point[0], "y-rot-point": point[1]}
    if tilting:
        place = tilting[0].point
        offset = place["xyz".index(across)] - values[f"{across}-rot-point"]
        values |= {"z-rot-point": place[2], f"{across}-offset": offset, "z-offset": 0.0}
    written = dict(
        zip(values, rounded_lengths(list(values.values()), unit_m).tolist(), strict=True)
    )
    text = [*(f"# {line}" for line in head)]
    text += [f"setp {kinematics}.{pin} {fixed(x, LENGTH_DECIMALS)}" for pin, x in written.items()]
    notes = tuple(_left(table, tilting, letter, across))
    files = {f"{stem}.hal": "\n".join(text) + "\n"}
    return Located(files, {f"{kinematics}.{p}": x for p, x in written.items()}, SOURCE, notes)


def _left(table: AxisLine, tilting: Sequence[AxisLine], letter: str, across: str) -> Iterator[str]:
    """Yield in words what the pins cannot hold, of what is more than its uncertainty."""
    if not tilting:
        yield (
            f"{letter} was not measured: {across}-offset counts from {across}-rot-point; change "
            f"it by as much the other way, so that {letter} stays where it is"
        )
    for line in (table, *tilting):
        if line.sense < 0:
            yield (
                f"{line.letter} turns clockwise (plan.chain), and these kinematics turn the work "
                "counter-clockwise: reverse the sign of its joint, or of it in programs"
            )
        for name, angle, std in zip(line.names, line.value, line.std, strict=True):
            if name[0] not in "ABC" or abs(angle) < COVERAGE_FACTOR * std:
                continue
            if line is table and name[0] == letter:
                cure = f"the zero of {letter} can take it"
            else:
                cure = f"{HEIGHT_M / MILLIMETRE:g} mm away it makes "
                cure += f"{abs(angle) * HEIGHT_M / MICROMETRE:.2g} um"
            yield f"no pin holds {name} = {angle / ARCSEC:.3g} arcsec: {cure}"


@dataclass(frozen=True, eq=False)
class LoadedComp:
    """What LinuxCNC holds after loading: degrees, trims in single precision, and its messages."""

    nominal_deg: Floats
    forward_deg: NDArray[np.float32]
    reverse_deg: NDArray[np.float32]
    messages: tuple[str, ...]

    def correction(self, angle: Floats, approach: Approach) -> Floats:
        """Return the trim (rad) at the joint position ``angle`` (rad, not wrapped).

        Linear, with slopes in single precision; before the first and after the last row the trim
        of that row is held.
        """
        trims = self.forward_deg if approach is Approach.POSITIVE else self.reverse_deg
        at = np.asarray(angle, dtype=np.float64) / DEGREE
        if len(trims) == 0:
            return np.zeros_like(at)
        rise = np.diff(trims.astype(np.float64)) / np.diff(self.nominal_deg)
        slopes = np.append(rise.astype(np.float32), np.float32(0.0)).astype(np.float64)
        row = np.clip(np.searchsorted(self.nominal_deg, at, side="right") - 1, 0, None)
        beyond = np.maximum(at - self.nominal_deg[row], 0.0)
        return np.asarray((trims[row] + slopes[row] * beyond) * DEGREE, dtype=np.float64)


@dataclass(frozen=True)
class LinuxCnc(EveryTurnController):
    """LinuxCNC: the rows are written for every turn of the travel."""

    suffixes = (".comp", ".ini")
    comment = Comment(".ini", 0, "# {}")
    facts = Facts(
        title="LinuxCNC",
        sign="type 1: trim = -(actual - commanded), added to the motor; type 0: the actual angle",
        wrap="none: rows repeated for each turn, beyond them the end row is held",
        unit="degrees, 9 decimals; held in single precision",
        source="LinuxCNC 2.9 source (usrmotintf.cc, command.c, control.c) and runs of the program",
        verified_on="the real program",
    )
    position_resolution = 10.0**-DECIMALS * DEGREE
    own_settings = (
        OwnSetting(
            "[JOINT_n] BACKLASH",
            "is ignored once the joint has a table",
            "its halves are put into both columns: read from machine_ini, or stated by "
            "backlash_deg; the line may stay",
            "LinuxCNC 2.9, control.c",
        ),
        OwnSetting(
            "[JOINT_n] COMP_FILE_TYPE",
            "is 0 if it is missing, and a table of trims is then read as positions",
            "both ini lines are written; put them in together",
            "LinuxCNC 2.9, inijoint.cc",
        ),
    )

    file_type: int = setting(1, doc="0: actual angles, 1: trims", minimum=0, maximum=1)
    joint: int = setting(0, doc="number in [JOINT_n]", minimum=0, maximum=15)
    machine_ini: str = setting(
        "",
        doc="ini file of the machine; gives the joint, the limits below, and whether it is at "
        "work",
    )
    max_acceleration_deg_s2: float = setting(
        0.0, doc="deg/s^2, MAX_ACCELERATION of the joint; 0: not known", minimum=0.0
    )
    max_velocity_deg_s: float = setting(
        0.0, doc="deg/s, MAX_VELOCITY of the joint; 0: not known", minimum=0.0
    )
    servo_period_ns: int = setting(
        0, doc="ns, SERVO_PERIOD; 0: not known, 1000000 is taken", minimum=0
    )
    feed_deg_s: float = setting(
        0.0, doc="deg/s, fastest programmed feed; 0: MAX_VELOCITY", minimum=0.0
    )
    home_deg: float = setting(0.0, doc="deg, HOME of the joint, where the trim begins with 0")
    backlash_deg: float | None = setting(
        None,
        doc="deg, BACKLASH of the joint during a measurement without table; none: that of "
        "machine_ini",
    )
    kinematics: str = setting(
        KINEMATICS[0],
        doc="that get the place of the axes, in mm; machine_ini states both",
        choices=KINEMATICS,
    )

    def write(self, table: CompensationTable, stem: str) -> dict[str, str]:
        """Return the table and the two ini lines that must go with it.

        Raises ConfigurationError when the rows of all turns are more than LinuxCNC holds.
        """
        angles, up, down = (np.round(column, DECIMALS) for column in columns_deg(table))
        if table.closed:
            angles, up, down = self._every_turn(angles, up, down)
        elif self.turns != 1 or self.first_turn != 0:
            raise ConfigurationError(
                "linuxcnc: an arc cannot be repeated, set turns 1, first_turn 0"
            )
        require_at_most(len(angles), MAX_ROWS, "linuxcnc: rows", "choose a wider spacing")
        if self.machine_ini:
            beyond = self._joint(table.axis).travel_beyond(angles[0], angles[-1])
            if beyond is not None:
                raise ConfigurationError(beyond)
        if self.file_type == 0:
            up, down = angles - up, angles - down
        lines = [
            " ".join(fixed(x, DECIMALS) for x in row) for row in zip(angles, up, down, strict=True)
        ]
        values = zip(LINES, (f"{stem}.comp", self.file_type), strict=True)
        ini = [f"[JOINT_{self.joint}]", *(f"{key} = {value}" for key, value in values)]
        return {f"{stem}.comp": "\n".join(lines) + "\n", f"{stem}.ini": "\n".join(ini) + "\n"}

    def marked(self, files: Mapping[str, str], text: str) -> dict[str, str]:
        """Return the files with a comment after the numbers of a row, where LinuxCNC stops."""
        texts = self.commented(files, [text])
        return {
            name: file.replace("\n", f" # {text}\n", 1) if name.endswith(".comp") else file
            for name, file in texts.items()
        }

    def read(self, files: Mapping[str, str]) -> LoadedComp:
        """Read table and ini lines; BagError for all that LinuxCNC would silently ignore."""
        _, ini = only_file(files, ".ini")
        name, text = only_file(files, ".comp")
        kind = re.search(r"^\s*COMP_FILE_TYPE\s*=\s*([01])\s*$", ini, re.MULTILINE)
        if kind is None:
            raise BagError(
                "the ini lines hold no COMP_FILE_TYPE = 0 or 1: LinuxCNC would take the default 0 "
                "and read trims as positions"
            )
        loaded = load_as_linuxcnc(text, int(kind.group(1)))
        lines = text.count("\n") + (not text.endswith("\n"))
        if loaded.messages or len(loaded.nominal_deg) != lines or lines == 0:
            raise BagError(
                f"{name}: {lines} lines, of which LinuxCNC uses {len(loaded.nominal_deg)}; "
                f"expected all; {'; '.join(loaded.messages) or 'a line is not three numbers'}"
            )
        columns = (loaded.nominal_deg, loaded.forward_deg, loaded.reverse_deg)
        if not all(np.isfinite(column).all() for column in columns):
            raise BagError(f"{name}: a number is too large")
        return loaded

    def resolution(self, table: CompensationTable) -> float:
        """Return twice the rounding: nine decimals, and single precision of trim and slope."""
        largest = np.max(np.abs([table.correction_forward, table.correction_reverse]))
        return float(2.0 * 10.0**-DECIMALS * DEGREE + 8.0 * np.finfo(np.float32).eps * largest)

    def for_axis(self, axis: str) -> LinuxCnc:
        """Return the controller with open settings completed from the machine's ini file."""
        if not self.machine_ini:
            return self
        joint = self._joint(axis)
        return replace(
            self,
            joint=joint.number,
            max_acceleration_deg_s2=self.max_acceleration_deg_s2 or joint.acceleration,
            max_velocity_deg_s=self.max_velocity_deg_s or joint.velocity,
            servo_period_ns=self.servo_period_ns or joint.servo_period_ns,
            home_deg=self.home_deg or joint.home_deg,
            backlash_deg=joint.backlash_deg if self.backlash_deg is None else self.backlash_deg,
        )

    def without_table(self, approach: Approach) -> float:
        """Return half of BACKLASH, added from below and taken off from above."""
        half = 0.5 * (self.backlash_deg or 0.0) * DEGREE
        return half if approach is Approach.POSITIVE else -half

    def replaced(self, table: CompensationTable) -> str:
        """Say what became of BACKLASH, which LinuxCNC ignores once the joint has a table."""
        if self.backlash_deg is None:
            return "" if table.adds_to else UNKNOWN_BACKLASH
        if not self.backlash_deg:
            return self._joint(table.axis).misplaced_backlash if self.machine_ini else ""
        about = f"BACKLASH = {self.backlash_deg:g} deg, which LinuxCNC ignores with a table"
        if table.adds_to:
            return f"{about}, did not act in the measurement either: nothing of it is added"
        half = self.without_table(Approach.POSITIVE) / ARCSEC
        return (
            f"{about}, is in the table: {half:+.6g} arcsec in the forward column and {-half:+.6g} "
            "in the reverse one, because it acted in the measurement. If it was another one then, "
            "state it: backlash_deg, 0 for none"
        )

    def require_stated(self, table: CompensationTable) -> None:
        """Raise ConfigurationError where nothing states BACKLASH, and no table was in force."""
        if self.backlash_deg is None and not table.adds_to:
            raise ConfigurationError(UNKNOWN_BACKLASH)

    def locate(self, lines: Sequence[AxisLine], stem: str, head: Sequence[str]) -> Located:
        """Return HAL lines for the pins of the kinematics."""
        kinematics, unit_m = self.kinematics, MILLIMETRE
        if self.machine_ini:
            kinematics, unit_m = kinematics_and_unit(IniFile.read(Path(self.machine_ini)))
        return pins_in_hal(lines, stem, head, kinematics, unit_m)

    def lag(self, rule: Rule, table: CompensationTable) -> Lag:
        """Return what remains because of the lag of the trim."""
        if not self.max_acceleration_deg_s2:
            return Lag(notes=(UNKNOWN_LIMITS,))
        following = JointLimits(
            acceleration=self.max_acceleration_deg_s2 * DEGREE,
            velocity=(self.max_velocity_deg_s or np.inf) * DEGREE,
            period=(self.servo_period_ns or SERVO_PERIOD_NS) * NANOSECOND,
        )
        first, last = table.angles[0], TURN if table.closed else table.angles[-1]
        angles = np.linspace(first, last, POINTS_PER_ROW * len(table.angles) + 1)
        start = self.first_turn * TURN if table.closed else 0.0
        up, down = (rule.correction(start + angles, approach) for approach in DIRECTIONS)
        feed = (self.feed_deg_s or self.max_velocity_deg_s) * DEGREE
        return trim_lag(following, angles, up, down, feed, table.closed, self.home_deg * DEGREE)

    def not_in_use(self, axis: str, files: Mapping[str, str], folder: Path) -> tuple[str, ...]:
        """Return why the machine of ``machine_ini`` would not use the table as intended."""
        if not self.machine_ini:
            return ()
        name, _ = only_file(files, ".comp")
        rows, joint = self.read(files).nominal_deg, self._joint(axis)
        reasons = joint.why_not_using(folder / name, self.file_type)
        beyond = joint.travel_beyond(rows[0], rows[-1])
        return tuple(reasons) if beyond is None else (*reasons, beyond)

    def machine_files(self, axis: str, files: Mapping[str, str]) -> dict[str, str]:
        """Return a copy of ``machine_ini`` with the lines of ``files`` in the joint's section."""
        if not self.machine_ini:
            return {}
        joint = self._joint(axis)
        _, lines = only_file(files, ".ini")
        written = IniFile(joint.ini.path, lines)
        values = {key: written.value(joint.section, key) or "" for key in LINES}
        return {joint.ini.path.name: joint.ini.merged(joint.section, values)}

    def _joint(self, axis: str) -> Joint:
        return Joint.of_axis(IniFile.read(Path(self.machine_ini)), axis, self.joint)

    def _every_turn(self, *columns: Floats) -> tuple[Floats, Floats, Floats]:
        """Repeat angles, forward and reverse column (n,) of a closed turn for all turns."""
        rows = len(columns[0]) - 1
        fit = (MAX_ROWS - 1) // rows if rows < MAX_ROWS else 0
        require_at_most(
            rows * self.turns + 1,
            MAX_ROWS,
            f"linuxcnc: {rows} rows x {self.turns} turns + 1",
            f"choose a spacing of at least {360 * self.turns / (MAX_ROWS - 1):.3g} deg"
            + (f", or at most {fit} turns at this spacing" if fit else ""),
        )
        angles, up, down = repeat_for_turns(self.first_turn, self.turns, *columns)
        return angles, up, down

    @property
    def switch_on(self) -> str:
        """The two lines of the joint, and a restart."""
        return (
            f"COMP_FILE and COMP_FILE_TYPE = {self.file_type} in [JOINT_{self.joint}], then "
            "restart LinuxCNC; no trim acts before the first move"
        )

    @property
    def busy_command(self) -> tuple[str, ...]:
        """Ask the running program, by its own modules on the system's Python."""
        if not self.machine_ini:
            return ()
        return *AGENT, "-ini", self.machine_ini, "--busy"


def load_as_linuxcnc(text: str, file_type: int) -> LoadedComp:
    """Load a table as LinuxCNC does, including silent stops and skipped rows."""
    rows: list[tuple[float, float, float]] = []
    messages: list[str] = []
    for line in text.split("\n"):
        values = _three_numbers(line[:254])
        if values is None:
            break
        nominal, up, down = values
        if file_type == 0:
            # Type 0 holds the actual angles: LinuxCNC makes the trim from them.
            up, down = nominal - up, nominal - down
        if len(rows) >= MAX_ROWS:
            messages.append("too many compensation entries")
        elif rows and nominal <= rows[-1][0]:
            messages.append("compensation values must increase")
        else:
            rows.append((nominal, up, down))
    data = np.array(rows, dtype=np.float64).reshape(-1, 3)
    return LoadedComp(
        nominal_deg=data[:, 0],
        # LinuxCNC keeps trims in single precision, and positions in double.
        forward_deg=data[:, 1].astype(np.float32),
        reverse_deg=data[:, 2].astype(np.float32),
        messages=tuple(messages),
    )


def _three_numbers(line: str) -> tuple[float, float, float] | None:
    """Return what ``sscanf("%lf %lf %lf")`` finds: three leading numbers, blanks between."""
    number = r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
    match = re.match(number + r"(?=\s)" + number + r"(?=\s)" + number, line)
    if match is None:
        return None
    return float(match.group(1)), float(match.group(2)), float(match.group(3))


EDGE: Final = 0.01
"""Share by which the dead band is widened, for changes between the evaluated rows."""


@dataclass(frozen=True)
class JointLimits:
    """The limits of a joint: ``acceleration`` (rad/s^2), ``velocity`` (rad/s), ``period`` (s)."""

    acceleration: float
    velocity: float
    period: float

    @property
    def largest_step(self) -> float:
        """The largest change (rad) that a trim at rest makes within one period."""
        return 0.25 * self.acceleration * self.period**2

    @property
    def in_motion(self) -> float:
        """The change (rad) above which a trim at rest begins to move."""
        gain = min(0.5 * self.acceleration * self.period, 0.5 * self.velocity)
        return 0.5 * gain * self.period + gain**2 / self.acceleration

    def stands(self, change: Floats) -> NDArray[np.bool_]:
        """Return whether a trim at rest stays where it is for these wanted changes (rad)."""
        size = np.abs(change)
        above = size > self.largest_step * (1.0 - EDGE)
        return np.asarray(above & (size <= self.in_motion * (1.0 + EDGE)))

    def fastest_feed(self, steepest: float) -> float:
        """Return the feed (rad/s) up to which the trim follows a slope of ``steepest`` (1)."""
        return self.largest_step / (steepest * self.period) if steepest else np.inf

    def behind(self, steepest: float, feed: float) -> float:
        """Return a bound (rad) on how far the trim is behind in motion; inf: without a bound.

        The trim starts when it is ``in_motion`` behind and changes its speed with half of the
        acceleration; a table that turns back asks it for twice the change of speed.
        """
        if feed <= self.fastest_feed(steepest):
            return 0.0
        speed = steepest * feed
        if speed >= 0.5 * self.velocity:
            return float(np.inf)
        return self.in_motion + 2.0 * speed * self.period + 4.0 * speed**2 / self.acceleration

    def residual_after_reversal(self, forward: Floats, reverse: Floats, closed: bool) -> float:
        """Return the most (rad) that remains after a slow reversal at any row and a slow move.

        ``forward`` and ``reverse`` (n,) rad are the trims at close angles that ascend; with
        ``closed`` the last is beside the first.
        """
        rows = np.arange(len(forward))
        away = self._left(forward, reverse, rows, closed)
        return max(away, self._left(reverse[::-1], forward[::-1], rows, closed))

    def residual_after_homing(
        self, forward: Floats, reverse: Floats, home: int, closed: bool
    ) -> float:
        """Return the most (rad) that remains in slow moves from row ``home``, where the trim is 0.

        The other arguments are those of :meth:`residual_after_reversal`.
        """
        none, back = np.zeros_like(forward), len(forward) - 1 - home
        away = self._left(forward, none, np.array([home]), closed)
        return max(away, self._left(reverse[::-1], none, np.array([back]), closed))

    def _left(self, wanted: Floats, held: Floats, rows: Ints, closed: bool) -> float:
        """Return the same for moves over ascending rows from ``rows``, from the trim ``held``."""
        count, worst = len(wanted), 0.0
        start = rows[self.stands(wanted[rows] - held[rows])]
        for ahead in range(count):
            at = start + ahead
            start, at = (start, at % count) if closed else (start[at < count], at[at < count])
            change = wanted[at] - held[start]
            standing = self.stands(change)
            start = start[standing]
            if len(start) == 0:
                break
            worst = max(worst, float(np.max(np.abs(change[standing]))))
        return worst


def trim_lag(
    following: JointLimits,
    angles: Floats,
    forward: Floats,
    reverse: Floats,
    feed: float,
    closed: bool,
    home: float = 0.0,
) -> Lag:
    """Return what is left of the trims ``forward`` and ``reverse`` (n,) rad at close ``angles``.

    ``feed`` (rad/s) is the fastest feed towards a place that matters; 0: not known.
    ``home`` (rad) is the angle at which the axis is homed; there the trim begins with 0.
    """
    steepest = float(max(np.max(np.abs(np.gradient(t, angles))) for t in (forward, reverse)))
    standing = following.residual_after_reversal(forward, reverse, closed)
    row = int(np.argmin(np.abs(angles - (home % TURN if closed else home))))
    at_first = following.residual_after_homing(forward, reverse, row, closed)
    behind = following.behind(steepest, feed)
    notes = []
    if standing:
        notes.append(_standing_note(following, standing, forward - reverse))
    if at_first:
        notes.append(_homing_note(following, at_first, angles[row]))
    if behind:
        notes.append(_behind_note(following, steepest, feed, behind))
    bound = following.in_motion * (1.0 + EDGE) if notes else 0.0
    return Lag(bound, max(standing, at_first), tuple(notes))


def _standing_note(following: JointLimits, standing: float, reversal: Floats) -> str:
    low, high = np.array([following.largest_step, following.in_motion]) / ARCSEC
    sizes = np.abs(reversal) / ARCSEC
    return (
        f"a reversal asks LinuxCNC for changes of {np.min(sizes):.3g} to {np.max(sizes):.3g} "
        f"arcsec, and its trim stands still for those of {low:.3g} to {high:.3g} (1/4 to 1/2 of "
        f"MAX_ACCELERATION times the square of the servo period): up to {standing / ARCSEC:.3g} "
        "arcsec stay. Another MAX_ACCELERATION or servo period moves this band away"
    )


def _homing_note(following: JointLimits, standing: float, home: float) -> str:
    low, high = np.array([following.largest_step, following.in_motion]) / ARCSEC
    return (
        f"the trim is 0 when the axis has been homed, at {home / DEGREE:.6g} deg, and stands "
        f"still for changes of {low:.3g} to {high:.3g} arcsec: up to {standing / ARCSEC:.3g} "
        "arcsec stay until the axis reaches an angle where the table asks for less or more. "
        "Choose the home angle as the reference of the table"
    )


def _behind_note(following: JointLimits, steepest: float, feed: float, behind: float) -> str:
    how = "more and more" if np.isinf(behind) else f"up to {behind / ARCSEC:.3g} arcsec"
    return (
        f"the trim follows up to a feed of {following.fastest_feed(steepest) / DEGREE:.4g} deg/s, "
        f"and at {feed / DEGREE:.4g} deg/s it is {how} behind while the axis moves; what is in "
        "the dead band when it stops stays"
    )


LARGEST_TRIM_DEG = 1.0
"""No table compensates more than this; trims read as positions give angles of the whole travel."""


def find_loaded_tables(path: Path) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield every table that the machine of the ini file ``path`` loads, with its faults.

    A rotary joint without a table is among them if it has a BACKLASH, which a table would put out
    of force. Raises ConfigurationError when the ini file cannot be read or makes no sense.
    """
    for joint in all_joints(IniFile.read(path)):
        amount, table = joint.backlash_deg, joint.table_path
        faults = [joint.misplaced_backlash] if joint.misplaced_backlash else []
        size = f" deg ({amount * DEGREE / ARCSEC:.6g} arcsec)" if joint.is_angular else ""
        own = f"BACKLASH = {amount:g}{size}"
        if table is not None:
            about = f"[{joint.section}] {table.name}, type {joint.table_type}"
            about += f"; {own} is ignored with this table" if amount else ""
            yield about, (*faults, *_complaints(joint, table))
        elif joint.is_angular and (amount or faults):
            acts = [f"{own} acts only until it has one, whose columns have to hold it"]
            yield f"[{joint.section}] no table", (*faults, *(acts if amount else []))


def _complaints(joint: Joint, table: Path) -> Iterator[str]:
    if (count := joint.ini.count(joint.section)) > 1:
        yield f"{count} sections [{joint.section}]: LinuxCNC ignores all but the first"
    try:
        text = read_bytes(table).decode(ENCODING)
    except OSError as error:
        yield f"{table}: {error.strerror}: LinuxCNC does not start"
        return
    loaded = load_as_linuxcnc(text, joint.table_type)
    lines = len(text.splitlines())
    if loaded.messages or lines != len(loaded.nominal_deg) or lines == 0:
        yield f"of {lines} lines LinuxCNC uses {len(loaded.nominal_deg)}"
    if len(loaded.nominal_deg) == 0:
        return
    if joint.backlash_deg and np.array_equal(loaded.forward_deg, loaded.reverse_deg):
        yield (
            f"BACKLASH = {joint.backlash_deg:g} is ignored, and both columns are equal: nothing "
            "corrects the reversal"
        )
    largest = float(np.max(np.abs([loaded.forward_deg, loaded.reverse_deg])))
    if largest > LARGEST_TRIM_DEG:
        yield (
            f"read as type {joint.table_type} the largest trim is {largest:.4g} deg: "
            f"COMP_FILE_TYPE is {joint.table_type} but the table is of another type"
        )
    if beyond := joint.travel_beyond(float(loaded.nominal_deg[0]), float(loaded.nominal_deg[-1])):
        yield beyond
