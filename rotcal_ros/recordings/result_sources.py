"""Reads what the evaluating verbs take: results of any method, bags, reference tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Final

from rotcal_ros.bags.reader import Progress
from rotcal_ros.evaluation.combination import CombinationInput
from rotcal_ros.evaluation.iso230 import (
    HEADER,
    BidirectionalRuns,
    read_any_runs,
    read_runs,
    require_runs,
)
from rotcal_ros.evaluation.joint import JointInput
from rotcal_ros.evaluation.reference import (
    COLUMNS,
    read_deviations,
    read_reference,
    subtract_polygon,
)
from rotcal_ros.evaluation.ways import EVALUATIONS, way_name
from rotcal_ros.foundation.curves.measured import MeasuredCurve, measured_curve
from rotcal_ros.foundation.errors import (
    BagError,
    ConfigurationError,
    DataError,
    GeometryError,
    ObservabilityError,
)
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.session_folder import SessionFolder
from rotcal_ros.foundation.table_columns import AS_IT_STANDS, SheetSettings
from rotcal_ros.foundation.table_reading import Reading
from rotcal_ros.foundation.tables import is_table, read_own_form
from rotcal_ros.foundation.untrusted import cause_of, load_json, read_bytes
from rotcal_ros.methods.configuration import read_configuration
from rotcal_ros.methods.measurements import PlannedMeasurements
from rotcal_ros.methods.method import Measurements
from rotcal_ros.recordings.inputs import MeasurementInput
from rotcal_ros.recordings.replay import Recording


@dataclass(frozen=True)
class ResultSource:
    """A result and where it comes from.

    ``sha256`` maps file names to hashes. ``axis`` is the letter of the measured axis, None if only
    the result is known.
    """

    result: Result
    sha256: Mapping[str, str]
    axis: str | None = None


def read_source(path: Path, given: MeasurementInput | None = None) -> ResultSource:
    """Return the result in a JSON file, the solution of a bag or table, or a session's result.

    ``given`` is the path with the set-up, targets and changes for solving a bag or a table. The
    folder of an unfinished session has no result: its bag is solved. Raises BagError when it
    cannot be read, DataError when the file holds no result.
    """
    given = given or MeasurementInput(path)
    session = SessionFolder(path)
    if session.result.is_file() and given.is_bare_path:
        # The result of a file does not know its axis, its session does.
        known = session.configuration.is_file()
        axis = read_configuration(session.configuration).cell.axis if known else None
        return replace(read_source(session.result), axis=axis)
    if session.bag.is_dir():
        return read_source(session.bag, replace(given, path=session.bag))
    if path.suffix != ".json":
        return solve_measurement(given.read())
    if not given.is_bare_path:
        raise ConfigurationError(
            f"{path} is already a result: set-up, targets and changes belong to a bag or a table"
        )
    found = _results(path)
    if len(found) > 1:
        raise DataError(
            f"{path} holds {len(found)} evaluations of the same data ({', '.join(found)}): "
            "`rotcal compare` reads all of them; other verbs take one result"
        )
    (source,) = found.values()
    return source


def _results(path: Path) -> dict[str, ResultSource]:
    """Return the result in a JSON file, or all evaluations by name; raises as read_source."""
    try:
        data = read_bytes(path)
        content = load_json(data)
        hashed = {path.name: sha256(data).hexdigest()}
        if isinstance(content, dict) and "deviations" in content and "schema" not in content:
            raise DataError(
                "these are deviations of no result, as the truth of a simulation: `rotcal compare "
                f"--truth {path.parent}` scores the results beside it"
            )
        ways = content.get(EVALUATIONS) if isinstance(content, dict) else None
        if not isinstance(ways, list) or not ways:
            return {"": ResultSource(Result.from_dict(content), hashed)}
        return {
            way_name(way.get("changes", ())): ResultSource(
                Result.from_dict(way.get("result")), hashed
            )
            for way in ways
        }
    except OSError as error:
        raise BagError(f"cannot read {path}: {cause_of(error)}") from error
    except (AttributeError, TypeError) as error:
        raise DataError(f"{path}: damaged evaluations: {error}; solve again") from error
    except ValueError as error:
        raise BagError(
            f"{path} is not JSON: {error}: give a result.json, a bag, a session or a table"
        ) from error
    except DataError as error:
        raise DataError(f"{path}: {error}") from error


def solve_measurement(measured: Recording | Measurements) -> ResultSource:
    """Return the solution of a bag or a table."""
    axis = measured.configuration.cell.axis
    return ResultSource(measured.solve(), measured.sha256, axis)


def joint_input(name: str, measured: Recording | Measurements) -> JointInput:
    """Return a bag or a table, ready to be solved together with others.

    Also one that cannot be solved alone: the others may determine what it lacks, or what happened
    to it. Where its data contradict each other the result says so, and is suspect at best.
    """
    try:
        return JointInput(name, measured.solve(), measured.model_of_curves())
    except DataError as refused:
        if not isinstance(measured, Recording | PlannedMeasurements):
            raise
        model = measured.model_of_curves()
        if model is None:
            raise
        untold = measured.calibration.without_solution(measured.observations, model)
        if isinstance(measured, Recording):
            untold = measured.with_warnings(untold)
        if not isinstance(refused, ObservabilityError | GeometryError):
            untold = replace(
                untold, warnings=(phrase("alone: {0}", refused), *untold.warnings)
            ).as_suspect()
        return JointInput(name, untold, model)


def read_instrument(given: MeasurementInput, progress: Progress | None = None) -> JointInput:
    """Return a bag, a table, or a result in a JSON file, ready to be solved with others.

    A result stands for its observations, with all their covariance. Raises as :func:`read_source`.
    """
    if given.path.suffix == ".json":
        return JointInput(str(given.path), read_source(given.path, given).result)
    return joint_input(str(given.path), given.read(progress))


def read_repeated_runs(
    path: Path, sheet: SheetSettings = AS_IT_STANDS, announce: Callable[[Reading], object] = str
) -> BidirectionalRuns:
    """Return the repeated runs in a table, a result or a bag; DataError without any.

    ``sheet`` says what a table leaves open, ``announce`` is given how it was understood.
    """
    if not is_table(path):
        return require_runs(read_source(path).result, str(path))
    own = read_own_form(path, (HEADER,))
    if own is None:
        return read_any_runs(path, sheet, announce)
    announce(Reading(own))
    return read_runs(own)


@dataclass(frozen=True)
class References:
    """How reference tables are read.

    ``std`` (rad) is the standard uncertainty of those that state none, ``polygon`` holds the face
    errors that are subtracted from them. ``sheet`` says what a table leaves open, ``announce`` is
    given how one of another form than ours was understood. ``own`` says it of each of several
    tables.
    """

    std: float | None = None
    polygon: MeasuredCurve | None = None
    sheet: SheetSettings = AS_IT_STANDS
    announce: Callable[[Reading], object] = str
    own: Mapping[Path, SheetSettings] = field(default_factory=dict)

    def read(self, path: Path) -> MeasuredCurve:
        """Return the curve in a table without the polygon; raises as :func:`read_reference`."""
        curve = self.faces(path)
        return curve if self.polygon is None else subtract_polygon(curve, self.polygon)

    def faces(self, path: Path) -> MeasuredCurve:
        """Return the curve in a table as it stands there."""
        own = read_own_form(path, (COLUMNS, COLUMNS[:2]))
        if own is not None:
            return read_reference(own, self.std)
        return read_deviations(path, self.std, self.own.get(path, self.sheet), self.announce)


AS_STATED: Final = References()
"""Reference tables that state everything themselves."""


def read_measured(path: Path, references: References = AS_STATED) -> CombinationInput:
    """Return a result, a bag, a session or a reference table, ready to be combined."""
    if is_table(path):
        return CombinationInput.of(str(path), references.read(path))
    return CombinationInput.of(str(path), read_source(path).result)


def read_curves(
    path: Path, component: str, references: References = AS_STATED
) -> dict[str, MeasuredCurve]:
    """Return the curve as :func:`read_curve` does, or those of all evaluations, by name."""
    if path.suffix == ".json" and path.is_file():
        return {
            f"{path}: {name}" if name else str(path): measured_curve(source.result, component)
            for name, source in _results(path).items()
        }
    return {str(path): read_curve(path, component, references)}


def read_curve(path: Path, component: str, references: References = AS_STATED) -> MeasuredCurve:
    """Return one deviation curve of a result, a bag, or a reference table."""
    if not is_table(path):
        return measured_curve(read_source(path).result, component)
    if component != "ECC":
        raise DataError(
            f"{path}: a reference table holds ECC only, {component} was asked for: "
            "leave out the component"
        )
    return references.read(path)
