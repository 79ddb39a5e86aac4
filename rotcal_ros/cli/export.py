"""``rotcal export``: from a bag or a result to the files of a controller."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from rotcal_ros.cli.completion import formats
from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.cli.input_options import setup_options
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.report.terminal.console import say, tell

if TYPE_CHECKING:
    from rotcal_ros.compensation.agreement import Accepted, MachineIdentity
    from rotcal_ros.compensation.export import ExportFiles
    from rotcal_ros.compensation.table import CompensationTable
    from rotcal_ros.foundation.results import Result
    from rotcal_ros.recordings.result_sources import ResultSource

VOLUMETRIC: Final = "volumetric"
"""Not a controller: all deviations that were measured, as CSV and JSON."""
DEFAULT_AXIS: Final = "C"


@click.command(epilog="Controllers and their settings: docs/compensation.md.")
@click.argument("source", type=path_type, metavar="BAG|TABLE|RESULT")
@setup_options
@click.option(
    "--to",
    "controller",
    required=True,
    shell_complete=formats,
    help="Controller, or 'volumetric'.",
)
@click.option("-o", "--out", "--output", "out", type=path_type, required=True, help="Folder.")
@click.option(
    "--spacing", type=float, metavar="DEG", help="Distance between rows; default: chosen."
)
@click.option("--axis", help=f"Letter of the axis; default: the bag's, {DEFAULT_AXIS} else.")
@click.option("--serial", metavar="NUMBER", help="Serial number of the item it is for.")
@click.option("--reference", type=float, metavar="DEG", help="Angle with correction zero.")
@click.option("--reverse", type=path_type, metavar="BAG|TABLE|RESULT", help="The other direction.")
@click.option("--harmonics", type=int, metavar="N", help="Fit N harmonics, not a spline.")
@click.option(
    "--revolutions", metavar="FIRST:LAST", help="Travel, for controllers that do not wrap."
)
@click.option("--machine-ini", type=path_type, metavar="FILE", help="LinuxCNC's; see below.")
@click.option(
    "--set",
    "options",
    multiple=True,
    metavar="[GROUP.]NAME=VALUE",
    help="Setting of the controller; with its GROUP one of the configuration.",
)
@click.option("--name", help="File name without extension; default: axis_controller.")
@click.option(
    "--replace", is_flag=True, help="Replace: no table was in force during the measurement."
)
@click.option("--add-to", type=path_type, metavar="FOLDER", help="Files of the table in force.")
@click.option(
    "--accept",
    multiple=True,
    metavar="axis|serial|age",
    help="Contradiction to accept: another axis, another item, or an old measurement.",
)
@click.option("--max-age", type=float, metavar="DAYS", help="Largest age of the measurement.")
@click.option(
    "--accept-unverified",
    is_flag=True,
    help="Write files although something about the controller is not verified.",
)
@json_option
def command(
    source: Path,
    setup: Path | None,
    targets: Path | None,
    controller: str,
    out: Path,
    spacing: float | None,
    axis: str | None,
    serial: str | None,
    reference: float | None,
    reverse: Path | None,
    harmonics: int | None,
    revolutions: str | None,
    machine_ini: Path | None,
    options: tuple[str, ...],
    name: str | None,
    replace: bool,
    add_to: Path | None,
    accept: tuple[str, ...],
    max_age: float | None,
    accept_unverified: bool,
    as_json: bool,
) -> int:
    """Write the table of BAG (a folder, .mcap, .db3), TABLE or RESULT (.json) for a controller.

    The files are read back and applied by the controller's own rule before they are written, all
    or none, and nothing is ever overwritten. Only the verdict ok may be fed. What was measured
    with a table in force is what that table leaves: it is added to that table with --add-to. Where
    it is not known which table was in force, --replace or --add-to must say it. Axis and serial
    number have to be those of the machine, and the measurement younger than --max-age (default: 30
    days): a contradiction is refused, unless --accept allows it.

    --machine-ini is read for what it says about the joint, and a copy of it that uses the table is
    written beside the table. The same as --set machine_ini=FILE.
    """
    from rotcal_ros.compensation.agreement import (
        LARGEST_AGE_DAYS,
        Accepted,
        MachineIdentity,
        words_of,
    )
    from rotcal_ros.compensation.earlier_export import to_be_in_force
    from rotcal_ros.compensation.export import prepare_export
    from rotcal_ros.compensation.writing import write_files
    from rotcal_ros.foundation.components import check_axis

    changes = tuple(option for option in options if _of_configuration(option))
    own = tuple(option for option in options if option not in changes)
    forward = _read(source, setup, targets, changes)
    asked = _Asked(
        machine=MachineIdentity(check_axis(axis) if axis else "", serial or ""),
        accepted=Accepted(words_of(accept), LARGEST_AGE_DAYS if max_age is None else max_age),
        measured_axis=_axis_of(forward) or axis or DEFAULT_AXIS,
        now=datetime.now(timezone.utc),
    )
    if controller == VOLUMETRIC:
        _refuse_unused({
            "--spacing": spacing, "--reference": reference, "--reverse": reverse,
            "--harmonics": harmonics, "--revolutions": revolutions,
            "--machine-ini": machine_ini, "--set": own, "--replace": replace,
            "--add-to": add_to, "--accept-unverified": accept_unverified,
        })  # fmt: skip
        _show(_write_volumetric(forward.result, asked, name, out), as_json)
        return 0
    backward = None if reverse is None else _read(reverse, setup, targets, changes)
    table = _table(forward, backward, asked.measured_axis, harmonics, spacing)
    export = prepare_export(
        to_be_in_force(
            table,
            controller,
            asked.machines,
            asked.accepted,
            asked.now_ns,
            replaces=replace,
            add_to=add_to,
        ),
        controller,
        now=asked.now,
        spacing=_radians(spacing),
        reference_angle=_radians(reference),
        settings=_settings(own, revolutions, machine_ini),
        stem=name,
        accept_unverified=accept_unverified,
        sources={**forward.sha256, **(backward.sha256 if backward else {})},
    )
    _show_export(export, write_files(export.with_machine_files(), out), as_json)
    return 0


@dataclass(frozen=True)
class _Asked:
    """The ``machine`` of the export, what is ``accepted``, and what was measured."""

    machine: MachineIdentity
    accepted: Accepted
    measured_axis: str
    now: datetime

    @property
    def now_ns(self) -> int:
        return int(self.now.timestamp()) * 1_000_000_000

    @property
    def machines(self) -> dict[str, MachineIdentity]:
        return {"the export (--axis, --serial)": self.machine}


def _refuse_unused(options: dict[str, Any]) -> None:
    """Raise ConfigurationError for options that a volumetric table would ignore."""
    unsaid = (None, (), False)
    if given := [n for n, value in options.items() if not any(value is no for no in unsaid)]:
        raise ConfigurationError(
            f"{', '.join(given)}: not for a volumetric table, which holds the deviations as they "
            "were measured; leave it out"
        )


def _write_volumetric(
    result: Result, asked: _Asked, name: str | None, out: Path
) -> tuple[Path, ...]:
    """Write all deviations of ``result``; contradictions are refused, or printed if accepted."""
    from rotcal_ros.compensation.agreement import MachineIdentity, require
    from rotcal_ros.compensation.volumetric import volumetric_files
    from rotcal_ros.compensation.writing import write_files
    from rotcal_ros.foundation.in_force import in_words

    measured = MachineIdentity(asked.measured_axis, result.circumstances.identity.serial)
    begun_ns = result.circumstances.begun_ns or 0
    for note in require(measured, begun_ns, asked.machines, asked.accepted, asked.now_ns):
        say(f"warning: {note}")
    say(in_words(result.measured_on))
    letter = asked.machine.axis or asked.measured_axis
    return write_files(
        volumetric_files(result, name or f"{letter}_{VOLUMETRIC}".lower(), letter), out
    )


def _settings(
    options: tuple[str, ...], revolutions: str | None, machine_ini: Path | None
) -> dict[str, Any]:
    """Return the settings of the controller that the command line states."""
    from rotcal_ros.compensation.controllers import parse_options, parse_revolutions

    settings = parse_options(options)
    if revolutions is not None:
        settings |= parse_revolutions(revolutions)
    if machine_ini is not None:
        settings["machine_ini"] = str(machine_ini)
    return settings


def _radians(degrees: float | None) -> float | None:
    return None if degrees is None else degrees * DEGREE


def _of_configuration(option: str) -> bool:
    """Return whether ``option`` names its group, as settings of a configuration do."""
    from rotcal_ros.methods.configuration import GROUPS

    return option.partition("=")[0].partition(".")[0] in GROUPS


def _read(
    path: Path, setup: Path | None, targets: Path | None, changes: tuple[str, ...]
) -> ResultSource:
    """Read a result, a bag or a table."""
    from rotcal_ros.recordings.inputs import Input
    from rotcal_ros.recordings.result_sources import read_source

    return read_source(path, Input(path, setup, targets, changes))


def _table(
    forward: ResultSource,
    backward: ResultSource | None,
    axis: str,
    harmonics: int | None,
    spacing: float | None,
) -> CompensationTable:
    """Return the correction table at the measured angles, or on rows of a harmonic fit."""
    from rotcal_ros.compensation.table import table_from_result

    if backward is not None and _axis_of(backward) not in ("", axis):
        raise ConfigurationError(
            f"the forward run is of axis {axis}, the reverse run of axis {_axis_of(backward)}"
        )
    return table_from_result(
        forward.result,
        reverse=None if backward is None else backward.result,
        axis=axis,
        harmonics=harmonics,
        # A fit knows its curve between the measured angles; a spline is sampled at export.
        spacing=None if harmonics is None else _radians(spacing),
    )


def _axis_of(source: ResultSource) -> str:
    """Return the axis that was measured, as session, bag or result say; empty: not known."""
    return source.axis or source.result.circumstances.axis


def _show(paths: Iterable[Path], as_json: bool, **facts: Any) -> None:
    """Print the paths of the files that were written, as JSON with further ``facts``."""
    files = [str(path.absolute()) for path in paths]
    if as_json:
        print_json({"files": files, **facts})
    else:
        tell(*files)


def _show_export(export: ExportFiles, paths: Iterable[Path], as_json: bool) -> None:
    """Print what was written, with its provenance, and what the reader must know of it."""
    from rotcal_ros.compensation.export import standing
    from rotcal_ros.compensation.writing import PROVENANCE

    side = next(text for file, text in export.files.items() if file.endswith(PROVENANCE))
    _show(paths, as_json, provenance=json.loads(side))
    if not as_json:
        say(standing(export.table))
        say(export.residual.in_words())
        for warning in export.warnings:
            say(f"warning: {warning}")
