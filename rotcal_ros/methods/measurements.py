"""Measurements from plain tables: from a machine's or a tracker's own program."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError, UndecidedError
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.observations import Approach, Observation
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.settings import declarations
from rotcal_ros.foundation.table_columns import AS_IT_STANDS, SheetSettings, TableColumn
from rotcal_ros.foundation.table_forms import FILE, read_any, remembered
from rotcal_ros.foundation.table_questions import Announce, asking_at_once
from rotcal_ros.foundation.table_reading import Known, Reading
from rotcal_ros.foundation.tables import (
    Header,
    Row,
    Table,
    has_own_form,
    is_table,
    is_workbook,
    parquet_as_table,
    read_own_form,
    table_hashes,
)
from rotcal_ros.foundation.units import NANOSECOND
from rotcal_ros.methods.calibration import Calibration, prepare
from rotcal_ros.methods.configuration import (
    Configuration,
    parse_configuration,
    raw_groups,
    replaced,
)
from rotcal_ros.methods.method import Measurements, TableReader, Trials, usable_methods
from rotcal_ros.planning.plan import Plan, Step
from rotcal_ros.planning.table_angles import ANGLE_SETTINGS

if TYPE_CHECKING:
    from rotcal_ros.adjust.model import CurveModel

TARGETS_FILE: Final = "targets"
"""Stem of the file of targets beside a table of lengths."""
TIME: Final = "time_s"
"""A last column that states when a row was read, from any moment on."""
LATEST_S: Final = 9e9
"""Nanoseconds beyond are no numbers of 64 bits."""


@dataclass(frozen=True)
class PlannedMeasurements:
    """Observations of a plan, as of a table; ``sha256`` maps file names to hashes."""

    calibration: Calibration
    observations: tuple[Observation, ...]
    sha256: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        return measured_in_words(self, f"{len(self.observations)} observations")

    @property
    def configuration(self) -> Configuration:
        """What it is solved with."""
        return self.calibration.configuration

    def solve(self) -> Result:
        """Return the result."""
        return self.calibration.solve(self.observations)

    def model_of_curves(self) -> CurveModel | None:
        """Return the observations as a model, see :class:`~.calibration.Calibration`."""
        return self.calibration.model_of_curves(self.observations)

    def trials(self) -> Trials:
        """Prepare Monte Carlo trials about the observations."""
        return self.calibration.trials(self.observations)


def measured_in_words(measured: Measurements, what: str) -> str:
    """Return in one line, for a person at a prompt, what a method was given."""
    files = ", ".join(measured.sha256) or "no file"
    return f"{what} of {measured.configuration.method.name} ({files}): solve() gives the result"


def read_measurements(
    source: Path | Table,
    configuration: Configuration,
    targets: Path | Table | None = None,
    announce: Announce = str,
) -> Measurements:
    """Read a table, of any form, as the method of the configuration understands it.

    ``targets`` are target positions, for methods that have targets; without them they are taken
    from the file ``targets`` beside the table, or from a sheet of its workbook. ``announce`` is
    given how the table was understood. Raises BagError when a file cannot be read or has other
    columns, ConfigurationError for a set-up without plan, DataError when the content cannot be
    what it should be or can be read in two ways.
    """
    source = parquet_as_table(source)

    def read(sheet: SheetSettings, announced: Announce) -> Measurements:
        return _read(source, replace(configuration, sheet=sheet), targets, announced)

    return asking_at_once(read, configuration.sheet, announce)


def _read(
    source: Path | Table,
    configuration: Configuration,
    targets: Path | Table | None,
    announce: Announce,
) -> Measurements:
    path, method = source.path if isinstance(source, Table) else source, configuration.method
    if method.table is None:
        raise BagError(f"{path}: the method {method.name} reads no plain tables: give a bag")
    _require_own_method(source, configuration)
    reader, settings = method.table, configuration.sheet
    if not isinstance(source, Table):
        settings = remembered(source, settings)
    aim, aimed_by = _targets(source, targets, reader.targets, settings)

    def known() -> Mapping[str, Known]:
        found = _known_of_plan(configuration, reader.columns)
        if aim is not None:
            numbers = tuple(range(len(aim.table.lines)))
            found["target"] = Known(numbers, aim.labels, source=aim)
        if states_angles(configuration) and settings.angles != "table":
            return found
        found.pop("position", None)
        return found

    # a table of any other form is never held to be one of a table that turned
    own = read_own_form(source, reader.with_angles)
    reading = Reading(own) if own else read_any(source, reader.headers, settings, known)
    where = phrase("table angles of the plan in {0}", configuration.source)
    if reading.angles_deg:
        where = phrase("table angles of the table")
        text = replaced(configuration, "plan", _plan_of(reading, configuration))
        configuration = parse_configuration(text, configuration.source)
        if reading.runs > 1 or reading.both_directions:  # only now there are positions for them
            settings = replace(settings, angles="")
            reading = read_any(source, reader.headers, settings, known)
    elif own:
        where = phrase("table angles of the table")
    else:
        _require_angles(configuration, path)
    answers = () if settings == configuration.sheet else (phrase("answers of {0}", FILE),)
    announce(replace(reading, sources=(where, *aimed_by, *answers)))
    aims = own is not None or "target" in reading.table.header
    aimed_at = aim.table if aim is not None and aims else None
    if targets is not None and aimed_at is None:
        raise DataError(f"{path} has no column of targets: leave out the table of targets")
    reader.require(reading)
    return reader.read(configuration, reading.table, aimed_at)


def _require_angles(configuration: Configuration, path: Path) -> None:
    if not states_angles(configuration):
        raise ConfigurationError(
            f"{configuration.source} has no group 'plan' with table angles: it has to say which "
            f"the positions in {path} stand for: add plan.table_positions, plan.table_step_deg "
            "and plan.table_start_deg, or a column of table angles to the table"
        )


def states_angles(configuration: Configuration) -> bool:
    """Return whether a set-up states table angles; a plan that cannot list them always does."""
    known = {declared.name for declared in declarations(type(configuration.plan))}
    given = {f"plan.{name}" for name in ANGLE_SETTINGS} & configuration.given
    return bool(given) or ("plan" in configuration.given and "table_angles_deg" not in known)


def _plan_of(reading: Reading, configuration: Configuration) -> dict[str, Any]:
    """Return the settings of the plan with the table angles of a table."""
    method = configuration.method
    _, groups = raw_groups(configuration.text, configuration.source)
    given = (groups.get("plan") or {}).items()
    plan = {name: value for name, value in given if name not in ANGLE_SETTINGS}
    plan["table_angles_deg"] = list(reading.angles_deg)
    if reading.runs == 1 and not reading.both_directions:
        return plan
    reader = method.table
    if reader is None or (reading.runs > 1 and not reader.runs):
        raise DataError(
            f"{reading.table.path}: the table comes to its angles in {reading.runs} runs, which "
            f"the method {method.name} does not distinguish: keep one, and solve each for itself"
        )
    plan |= {"bidirectional": True} if reading.both_directions else {}
    plan |= {reader.runs: reading.runs} if reading.runs > 1 else {}
    return {**plan, **reader.again}


def _require_own_method(source: Path | Table, configuration: Configuration) -> None:
    method = configuration.method
    others = [
        other.name
        for other in usable_methods()
        if other.table is not None
        and has_own_form(source, (*other.table.headers, *other.table.with_angles))
    ]
    if others and method.name not in others:
        path = source.path if isinstance(source, Table) else source
        raise BagError(
            f"{path} is a table of the method {others[0]}, but {configuration.source} sets up "
            f"{method.name}: give the set-up that belongs to it"
        )


def _targets(
    source: Path | Table, given: Path | Table | None, header: Header, settings: SheetSettings
) -> tuple[Reading | None, tuple[str, ...]]:
    """Return the table of targets, and in words where it is: given, beside the table, or in it.

    DataError where there are two, and they differ.
    """
    if not header:
        return None, ()
    wanted = {TableColumn.of(name).name for name in header}
    columns = tuple(f"{n}={text}" for n, text in settings.named().items() if n in wanted)
    own = replace(settings, name="", columns=columns)  # those are of the measurements
    if given is not None:
        name = given.path if isinstance(given, Table) else given
        return read_targets(given, header, own), (phrase("targets of {0}", str(name)),)
    if isinstance(source, Table):
        if source.in_memory:
            return None, ()
        source = source.path
    found = {
        path: read_targets(path, header, own)
        for path in sorted(filter(is_table, source.parent.glob(f"{TARGETS_FILE}.*")))
    }
    if is_workbook(source) and (inside := _targets_inside(source, header, own)):
        found[source] = inside
    if not found:
        return None, ()
    (first, aim), *others = found.items()
    for path, other in others:
        if _places(other) != _places(aim):
            raise DataError(
                f"{source}: targets stand in {first} and in {_place_of(other, path)}, and they "
                f"differ: say which count: --targets {first} or --targets {path}"
            )
    return aim, (phrase("targets of {0}", _place_of(aim, first)),)


def _targets_inside(book: Path, header: Header, settings: SheetSettings) -> Reading | None:
    """Return the targets that a workbook has, None without any; ask where it has several."""
    try:
        return read_targets(book, header, settings)
    except UndecidedError as error:
        if error.question is None or error.question.setting == "sheet.columns":
            return None
        if error.question.setting != "sheet.name":
            raise
        raise DataError(
            f"{error.found}: which targets count? Keep one sheet of them, or save it as CSV and "
            "name that file by --targets"
        ) from error
    except (BagError, DataError):
        return None


def _places(reading: Reading) -> set[tuple[str, ...]]:
    """Return targets with their places to a nanometre."""
    rows = [cells for _, cells in reading.table.lines]
    return {(number, *(f"{float(v) * 1e9:.0f}" for v in place)) for number, *place in rows}


def _place_of(reading: Reading, path: Path) -> str:
    return f"{path}, {reading.form}" if is_workbook(path) else str(path)


def read_targets(
    source: Path | Table, header: Header, settings: SheetSettings = AS_IT_STANDS
) -> Reading:
    """Return a table of targets, whose labels it alone knows."""
    return read_any(source, (header,), settings, lambda: {"target": Known(listed=True)})


def _known_of_plan(configuration: Configuration, columns: Mapping[str, str]) -> dict[str, Known]:
    """Return the numbers that ``columns`` may have, by the field of a step that each holds."""
    plan = prepare(configuration).plan
    down = (step for step in plan.steps if step.approach is Approach.NEGATIVE)
    downward = frozenset(step.table_position for step in down)
    return {
        name: Known(
            tuple(sorted({getattr(step, field) for step in plan.steps})),
            angles=plan.table_angles if field == "table_position" else (),
            downward=downward,
            order=tuple(step.table_position for step in plan.steps),
        )
        for name, field in columns.items()
    }


def planned_table(
    columns: Mapping[str, str],
    values: Mapping[str, float],
    further: Mapping[str, float] | None = None,
) -> TableReader:
    """Return what reads tables with a row for each step of a plan, and what was read there.

    ``columns`` of numbers from 0, each with the field of a :class:`~.planning.plan.Step` that it
    tells; columns of up to three ``values``, in metres or radians as their names say (``_m``,
    ``_rad``), else plain numbers, with the largest that can be. ``further`` values may be left
    out: they are 0 then. A last column ``time_s`` may tell when each row was read; without it
    that was in the order of the plan.
    """
    header, largest = (*columns, *values), {**values, **(further or {})}

    def read(
        configuration: Configuration, table: Table, _targets: Table | None
    ) -> PlannedMeasurements:
        calibration = prepare(configuration)
        find, observations = RowStepFinder(calibration.plan, columns), list[Observation]()
        for row in table.rows():
            seen = [
                _value(row, name, most) if name in row.cells else 0.0
                for name, most in largest.items()
            ]
            step, missing = find(row), (0.0,) * (3 - len(seen))
            observations.append(read_at(row, step.observed((*seen, *missing))))
        return PlannedMeasurements(calibration, tuple(observations), table_hashes(table))

    more = ((), tuple(further)) if further else ((),)
    headers = ((*header, *names, *time) for names in more for time in ((), (TIME,)))
    return TableReader(tuple(headers), read, columns)


def read_at(row: Row, observation: Observation) -> Observation:
    """Return the observation with the time that its row states, if it states one."""
    if TIME not in row.cells:
        return observation
    seconds = row.number(TIME)
    if abs(seconds) > LATEST_S:
        raise DataError(f"{row.place}: {TIME} is {seconds:g} s; are these milliseconds?")
    return replace(observation, window_end_ns=round(seconds / NANOSECOND))


def _value(row: Row, name: str, largest: float) -> float:
    if name.endswith("_rad"):
        return row.radians(name, largest)
    if name.endswith("_m"):
        return row.metres(name, largest)
    if abs(value := row.number(name)) > largest:
        raise DataError(f"{row.place}: {name} is {value:g}, expected {largest:g} at most")
    return value


class RowStepFinder:
    """Finds the step of the plan that a row measures, and refuses it twice.

    What the plan measures again, as a plan that closes does, may stand in the table again.
    ``columns`` of the table, each with the field of a step that it holds: ``table_position``,
    ``target`` or ``station``. A field that no column holds counts as the same everywhere.
    """

    def __init__(self, plan: Plan, columns: Mapping[str, str]) -> None:
        self._columns, self._steps = columns, dict[tuple[int, ...], list[Step]]()
        for step in plan.steps:
            key = tuple(getattr(step, field) for field in columns.values())
            self._steps.setdefault(key, []).append(step)
        self._seen: dict[tuple[int, ...], list[str]] = {}

    def __call__(self, row: Row) -> Step:
        """Return the step that a row measures; DataError, with its place, where there is none."""
        key = tuple(row.index(name) for name in self._columns)
        steps, names = self._steps.get(key), [name.replace("_", " ") for name in self._columns]
        what = ", ".join(f"{name} {number}" for name, number in zip(names, key, strict=True))
        if steps is None:
            known = zip(names, zip(*self._steps, strict=True), strict=True)
            plurals = ((f"{name}es" if name[-1] == "x" else f"{name}s", n) for name, n in known)
            *most, last = [f"{names} {_in_words(numbers)}" for names, numbers in plurals]
            raise DataError(
                f"{row.place}: {what} is not in the plan, which has {', '.join(most)} and {last}; "
                "does the set-up belong to this table?"
            )
        seen = self._seen.setdefault(key, [])
        if len(seen) == len(steps):
            raise DataError(
                f"{row.place}: {what} was measured already ({', '.join(seen)}), and the plan "
                f"measures it {'once' if len(steps) == 1 else f'{len(steps)} times'}: keep that "
                "many rows, or plan what was measured again: plan.bidirectional=true for both "
                "directions, plan.runs or plan.arrivals (where the method has them) for more "
                "runs, an angle more for a turn that closes"
            )
        seen.append(row.place)
        return steps[len(seen) - 1]


def _in_words(numbers: Iterable[int]) -> str:
    """Return which numbers there are; the balls of a plate have gaps."""
    known = sorted(set(numbers))
    if known == list(range(len(known))):
        return f"0 to {known[-1]}"
    return ", ".join(map(str, known))
