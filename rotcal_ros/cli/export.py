"""``rotcal export``: turns a bag or a result into the files of a controller."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.cli.options import complete_plugins, reference_option, setup_options
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.report.terminal.console import print_reading, say, tell

if TYPE_CHECKING:
    from rotcal_ros.compensation.request import ExportRequest
    from rotcal_ros.recordings.result_sources import ResultSource

VOLUMETRIC: Final = "volumetric"
"""No controller, but all measured deviations as CSV and JSON."""
AXIS: Final = "axis"


@click.command(epilog="Controllers and their settings: docs/controllers.md.")
@click.argument("source", type=path_type, metavar="BAG|TABLE|RESULT")
@setup_options
@click.option(
    "--to",
    "controller",
    required=True,
    shell_complete=complete_plugins(plugins.CONTROLLERS, VOLUMETRIC),
    help="Controller, or 'volumetric'.",
)
@click.option(
    "--what",
    type=click.Choice(["table", AXIS, VOLUMETRIC]),
    default="table",
    help="Compensation table, where the axes are, or all six deviations.",
)
@click.option("-o", "--out", "--output", "out", type=path_type, required=True, help="Folder.")
@click.option(
    "--spacing",
    type=float,
    metavar="DEG",
    help="Distance between rows; default: chosen automatically.",
)
@click.option("--axis", help="Letter of the axis; default: the bag's, else C.")
@click.option("--serial", metavar="NUMBER", help="Serial number of the item that gets the table.")
@click.option("--reference", type=float, metavar="DEG", help="Angle where the correction is zero.")
@click.option(
    "--reverse",
    type=path_type,
    metavar="BAG|TABLE|RESULT",
    help="Measurement in the other direction.",
)
@reference_option
@click.option("--harmonics", type=int, metavar="N", help="Fit N harmonics instead of a spline.")
@click.option(
    "--revolutions", metavar="FIRST:LAST", help="Travel, for controllers that do not wrap."
)
@click.option(
    "--machine-ini", type=path_type, metavar="FILE", help="Ini file of LinuxCNC; see below."
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="[GROUP.]NAME=VALUE",
    help="Setting of the controller, or GROUP.NAME of the configuration.",
)
@click.option("--name", help="File name without extension; default: such as c_linuxcnc.")
@click.option(
    "--replace", is_flag=True, help="State that no table was in force during the measurement."
)
@click.option("--add-to", type=path_type, metavar="FOLDER", help="Files of the table in force.")
@click.option(
    "--accept",
    multiple=True,
    metavar="axis|serial|age",
    help="Accept a contradiction: another axis, another item, or an old measurement.",
)
@click.option("--max-age", type=float, metavar="DAYS", help="Largest age of the measurement.")
@click.option(
    "--accept-unverified",
    is_flag=True,
    help="Write files even if something about the controller is not verified.",
)
@json_option
def command(
    as_json: bool,
    source: Path,
    setup: Path | None,
    targets: Path | None,
    reverse: Path | None,
    settings: tuple[str, ...],
    reference_std: float | None,
    what: str,
    **options: Any,
) -> int:
    """Write the table of BAG (a folder, .mcap, .db3), TABLE or RESULT (.json) for a controller.

    Before the files are written, they are read back and applied by the controller's own rule. All
    are written or none, and nothing is overwritten. Only a result with the verdict ok may be fed.
    A measurement with a table in force shows what that table leaves: --add-to adds this to that
    table. If it is not known which table was in force, --replace or --add-to must say so. Axis and
    serial number must be those of the machine, and the measurement must be younger than --max-age
    (default: 30 days): a contradiction is refused unless --accept allows it.

    A table of deviations, actual - commanded, needs no set-up: one or both directions, repeated
    runs, with its uncertainty in a column, by --reference-u, or from the repeats. Whether the
    numbers are deviations or corrections is asked, where the table does not show it.

    The settings of the joint come from --machine-ini; a copy of that file, which uses the table,
    is written beside the table. The option is the same as --set machine_ini=FILE.

    --what axis writes where the axes are instead, as the parameters of the controller's
    kinematics, from a result of table_balls. --what volumetric writes all deviations, EXC to ECC,
    in the controller's own form; --to volumetric in a neutral one.
    """
    from rotcal_ros.compensation.axis_location import prepare_location
    from rotcal_ros.compensation.request import ExportRequest, write_export
    from rotcal_ros.compensation.volumetric import prepare_volumetric
    from rotcal_ros.recordings.inputs import MeasurementInput
    from rotcal_ros.recordings.result_sources import read_source

    changes = tuple(filter(_is_of_configuration, settings))
    if setup is None:
        changes += _of_a_table_alone(source, options["axis"], reference_std)
    own = tuple(s for s in settings if not _is_of_configuration(s))
    asked = ExportRequest(settings=own, **options)

    def read(path: Path) -> ResultSource:
        return read_source(
            path, MeasurementInput(path, setup, targets, changes, announce=print_reading)
        )

    forward = read(source)
    if what == AXIS or (what == VOLUMETRIC and asked.controller != VOLUMETRIC):
        _refuse(_of_tables(asked, reverse), f"--what {what}, which writes no table")
        _write_prepared(prepare_volumetric if what == VOLUMETRIC else prepare_location,
                        forward, asked, as_json)  # fmt: skip
    elif asked.controller == VOLUMETRIC:
        unused = _of_tables(asked, reverse) | _of_controllers(asked)
        _refuse(unused, "a volumetric table, which holds the deviations as measured")
        _show(_write_volumetric(forward, asked), as_json)
    else:
        backward = None if reverse is None else read(reverse)
        export, paths = write_export(forward, asked, backward)
        _show_written(export.files, paths, as_json, export.describe())
    return 0


def _of_a_table_alone(
    source: Path, axis: str | None, reference_std: float | None
) -> tuple[str, ...]:
    """Return what the options say of a table of deviations, which has no set-up."""
    from rotcal_ros.foundation.tables import is_table

    stated = () if reference_std is None else (f"solver.u_arcsec={reference_std / ARCSEC!r}",)
    if not is_table(source):
        _refuse({"--reference-u": reference_std}, "what is no table of deviations")
        return ()
    return (*stated, *([f"cell.axis={axis}"] if axis else []))


def _of_tables(asked: ExportRequest, reverse: Path | None) -> dict[str, Any]:
    """Return the options that only a table of a controller uses."""
    return {
        "--spacing": asked.spacing, "--reference": asked.reference, "--reverse": reverse,
        "--harmonics": asked.harmonics, "--revolutions": asked.revolutions,
        "--replace": asked.replace or None, "--add-to": asked.add_to,
    }  # fmt: skip


def _of_controllers(asked: ExportRequest) -> dict[str, Any]:
    """Return the options that only files of a controller use."""
    return {
        "--machine-ini": asked.machine_ini, "--set": asked.settings or None,
        "--accept-unverified": asked.accept_unverified or None,
    }  # fmt: skip


def _refuse(options: dict[str, Any], what: str) -> None:
    """Raise ConfigurationError for ``options`` by name that were given and are of no use."""
    if given := ", ".join(name for name, value in options.items() if value is not None):
        raise ConfigurationError(f"{given}: no use for {what}; leave it out")


def _letter(forward: ResultSource, asked: ExportRequest) -> str:
    """Return the axis to write for; contradictions are refused, or printed if accepted."""
    from rotcal_ros.compensation.agreement import MachineIdentity, require_same_machine

    machines, axis = asked.machines(), asked.measured_axis(forward)
    known = forward.result.circumstances
    measured = MachineIdentity(axis, known.identity.serial)
    for note in require_same_machine(
        measured, known.from_ns, machines, asked.accepted(), asked.now_ns
    ):
        say(f"warning: {note}")
    return next(machine.axis for machine in machines.values()) or axis


def _write_volumetric(forward: ResultSource, asked: ExportRequest) -> tuple[Path, ...]:
    """Write all deviations."""
    from rotcal_ros.compensation.volumetric import volumetric_files
    from rotcal_ros.compensation.writing import write_files
    from rotcal_ros.foundation.in_force import describe

    letter, result = _letter(forward, asked), forward.result
    say(describe(result.measured_on))
    name = asked.name or f"{letter}_{VOLUMETRIC}".lower()
    return write_files(volumetric_files(result, name, letter), asked.out)


def _write_prepared(
    prepare: Callable[..., tuple[dict[str, str], tuple[str, ...]]],
    forward: ResultSource,
    asked: ExportRequest,
    as_json: bool,
) -> None:
    """Write where the axes are, or all deviations, and say what the controller cannot hold."""
    from rotcal_ros.compensation.controllers import make_controller
    from rotcal_ros.compensation.writing import write_files

    files, words = prepare(
        forward.result,
        asked.controller,
        make_controller(asked.controller, asked.controller_settings()),
        now=asked.now,
        axis=_letter(forward, asked),
        stem=asked.name,
        accept_unverified=asked.accept_unverified,
        sources=forward.sha256,
    )
    _show_written(files, write_files(files, asked.out), as_json, words)


def _is_of_configuration(setting: str) -> bool:
    """Return whether a ``--set`` is of the configuration: it names its group, or the method."""
    from rotcal_ros.methods.configuration import GROUPS

    return setting.partition("=")[0].partition(".")[0] in {"method", *GROUPS}


def _show(paths: Iterable[Path], as_json: bool, **facts: Any) -> None:
    """Print the paths of the files that were written, as JSON with further ``facts``."""
    files = [str(path.absolute()) for path in paths]
    if as_json:
        print_json({"files": files, **facts})
    else:
        tell(*files)


def _show_written(
    files: Mapping[str, str], paths: Iterable[Path], as_json: bool, words: Iterable[str]
) -> None:
    """Print what was written, with its provenance and what to know of it, in ``words``."""
    from rotcal_ros.compensation.writing import PROVENANCE

    side = next(text for file, text in files.items() if file.endswith(PROVENANCE))
    _show(paths, as_json, provenance=json.loads(side))
    if not as_json:
        for line in words:
            say(line)
