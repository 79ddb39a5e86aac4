"""``rotcal export``: turns a bag or a result into the files of a controller."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from rotcal_ros.cli.console import json_option, path_type, print_json
from rotcal_ros.cli.options import installed, setup_options
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.report.terminal.console import say, tell, understood

if TYPE_CHECKING:
    from rotcal_ros.compensation.agreement import Accepted, MachineIdentity
    from rotcal_ros.compensation.export import ExportFiles
    from rotcal_ros.compensation.table import CompensationTable
    from rotcal_ros.recordings.result_sources import ResultSource

VOLUMETRIC: Final = "volumetric"
"""No controller, but all measured deviations as CSV and JSON."""
DEFAULT_AXIS: Final = "C"


@click.command(epilog="Controllers and their settings: docs/controllers.md.")
@click.argument("source", type=path_type, metavar="BAG|TABLE|RESULT")
@setup_options
@click.option(
    "--to",
    "controller",
    required=True,
    shell_complete=installed(plugins.CONTROLLERS, VOLUMETRIC),
    help="Controller, or 'volumetric'.",
)
@click.option("-o", "--out", "--output", "out", type=path_type, required=True, help="Folder.")
@click.option(
    "--spacing",
    type=float,
    metavar="DEG",
    help="Distance between rows; default: chosen automatically.",
)
@click.option("--axis", help=f"Letter of the axis; default: the bag's, else {DEFAULT_AXIS}.")
@click.option("--serial", metavar="NUMBER", help="Serial number of the item that gets the table.")
@click.option("--reference", type=float, metavar="DEG", help="Angle where the correction is zero.")
@click.option(
    "--reverse",
    type=path_type,
    metavar="BAG|TABLE|RESULT",
    help="Measurement in the other direction.",
)
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
def command(as_json: bool, **options: Any) -> int:
    """Write the table of BAG (a folder, .mcap, .db3), TABLE or RESULT (.json) for a controller.

    Before the files are written, they are read back and applied by the controller's own rule. All
    are written or none, and nothing is overwritten. Only a result with the verdict ok may be fed.
    A measurement with a table in force shows what that table leaves: --add-to adds this to that
    table. If it is not known which table was in force, --replace or --add-to must say so. Axis and
    serial number must be those of the machine, and the measurement must be younger than --max-age
    (default: 30 days): a contradiction is refused unless --accept allows it.

    The settings of the joint come from --machine-ini; a copy of that file, which uses the table,
    is written beside the table. The option is the same as --set machine_ini=FILE.
    """
    asked = ExportRequest(**options)
    forward = asked.read(asked.source)
    if asked.controller == VOLUMETRIC:
        _show(_write_volumetric(forward, asked), as_json)
    else:
        export, paths = write_export(forward, asked)
        _show_export(export, paths, as_json)
    return 0


@dataclass(frozen=True)
class ExportRequest:
    """The options of the command line; ``now`` is the time of the call."""

    source: Path
    controller: str
    out: Path
    setup: Path | None = None
    targets: Path | None = None
    spacing: float | None = None
    axis: str | None = None
    serial: str | None = None
    reference: float | None = None
    reverse: Path | None = None
    harmonics: int | None = None
    revolutions: str | None = None
    machine_ini: Path | None = None
    settings: tuple[str, ...] = ()
    name: str | None = None
    replace: bool = False
    add_to: Path | None = None
    accept: tuple[str, ...] = ()
    max_age: float | None = None
    accept_unverified: bool = False
    now: datetime = field(default_factory=lambda: datetime.now(timezone.utc))

    @property
    def now_ns(self) -> int:
        """The time of the call in ns since 1970."""
        return int(self.now.timestamp()) * 1_000_000_000

    def machines(self) -> dict[str, MachineIdentity]:
        """Return what is known of the machine that the files are for, by source."""
        from rotcal_ros.compensation.agreement import MachineIdentity
        from rotcal_ros.foundation.components import check_axis

        axis = check_axis(self.axis) if self.axis else ""
        return {"the export (--axis, --serial)": MachineIdentity(axis, self.serial or "")}

    def accepted(self) -> Accepted:
        """Return the contradictions that are accepted."""
        from rotcal_ros.compensation.agreement import LARGEST_AGE_DAYS, Accepted, words_of

        largest_age = LARGEST_AGE_DAYS if self.max_age is None else self.max_age
        return Accepted(words_of(self.accept), largest_age)

    def measured_axis(self, forward: ResultSource) -> str:
        """Return the letter of the axis that was measured."""
        return _recorded_axis(forward) or self.axis or DEFAULT_AXIS

    def read(self, path: Path) -> ResultSource:
        """Read a result, a bag or a table with the set-up that is given."""
        from rotcal_ros.recordings.inputs import Input
        from rotcal_ros.recordings.result_sources import read_source

        changes = tuple(filter(_is_of_configuration, self.settings))
        return read_source(
            path, Input(path, self.setup, self.targets, changes, announce=understood)
        )

    def controller_options(self) -> tuple[str, ...]:
        """Return the ``--set`` options of the controller."""
        return tuple(s for s in self.settings if not _is_of_configuration(s))

    def controller_settings(self) -> dict[str, Any]:
        """Return the settings of the controller."""
        from rotcal_ros.compensation.controllers import parse_options, parse_revolutions

        settings = parse_options(self.controller_options())
        if self.revolutions is not None:
            settings |= parse_revolutions(self.revolutions)
        if self.machine_ini is not None:
            settings["machine_ini"] = str(self.machine_ini)
        return settings

    def refuse_what_only_controllers_take(self) -> None:
        """Raise ConfigurationError for options that a volumetric table does not use."""
        only_controllers = {
            "--spacing": self.spacing, "--reference": self.reference, "--reverse": self.reverse,
            "--harmonics": self.harmonics, "--revolutions": self.revolutions,
            "--machine-ini": self.machine_ini, "--set": self.controller_options() or None,
            "--replace": self.replace or None, "--add-to": self.add_to,
            "--accept-unverified": self.accept_unverified or None,
        }  # fmt: skip
        if given := [name for name, value in only_controllers.items() if value is not None]:
            raise ConfigurationError(
                f"{', '.join(given)}: no use for a volumetric table, which holds the deviations "
                "as measured; leave it out"
            )


def write_export(
    forward: ResultSource, asked: ExportRequest
) -> tuple[ExportFiles, tuple[Path, ...]]:
    """Write the files for a controller, after reading them back and simulating it."""
    from rotcal_ros.compensation.earlier_export import to_be_in_force
    from rotcal_ros.compensation.export import prepare_export
    from rotcal_ros.compensation.writing import write_files

    machines, accepted = asked.machines(), asked.accepted()
    backward = None if asked.reverse is None else asked.read(asked.reverse)
    export = prepare_export(
        to_be_in_force(
            _table(forward, backward, asked),
            asked.controller,
            machines,
            accepted,
            asked.now_ns,
            measured_ns=forward.result.circumstances.from_ns,
            replaces=asked.replace,
            add_to=asked.add_to,
        ),
        asked.controller,
        now=asked.now,
        spacing=_radians(asked.spacing),
        reference_angle=_radians(asked.reference),
        settings=asked.controller_settings(),
        stem=asked.name,
        accept_unverified=asked.accept_unverified,
        sources={**forward.sha256, **(backward.sha256 if backward else {})},
    )
    return export, write_files(export.with_machine_files(), asked.out)


def _table(
    forward: ResultSource, backward: ResultSource | None, asked: ExportRequest
) -> CompensationTable:
    """Return the correction table at the measured angles, or on rows of a harmonic fit."""
    from rotcal_ros.compensation.table import require_one_axis, table_from_result

    axis = asked.measured_axis(forward)
    require_one_axis(axis, "" if backward is None else _recorded_axis(backward) or "")
    return table_from_result(
        forward.result,
        reverse=None if backward is None else backward.result,
        axis=axis,
        harmonics=asked.harmonics,
        # A fit knows its curve between the measured angles; a spline is sampled at export.
        spacing=None if asked.harmonics is None else _radians(asked.spacing),
    )


def _write_volumetric(forward: ResultSource, asked: ExportRequest) -> tuple[Path, ...]:
    """Write all deviations; contradictions are refused, or printed if accepted."""
    from rotcal_ros.compensation.agreement import MachineIdentity, require
    from rotcal_ros.compensation.volumetric import volumetric_files
    from rotcal_ros.compensation.writing import write_files
    from rotcal_ros.foundation.in_force import in_words

    machines, accepted = asked.machines(), asked.accepted()
    asked.refuse_what_only_controllers_take()
    axis, result = asked.measured_axis(forward), forward.result
    measured = MachineIdentity(axis, result.circumstances.identity.serial)
    begun_ns = result.circumstances.from_ns
    for note in require(measured, begun_ns, machines, accepted, asked.now_ns):
        say(f"warning: {note}")
    say(in_words(result.measured_on))
    letter = next(machine.axis for machine in machines.values()) or axis
    name = asked.name or f"{letter}_{VOLUMETRIC}".lower()
    return write_files(volumetric_files(result, name, letter), asked.out)


def _radians(degrees: float | None) -> float | None:
    return None if degrees is None else degrees * DEGREE


def _is_of_configuration(setting: str) -> bool:
    """Return whether a ``--set`` names its group, as settings of a configuration do."""
    from rotcal_ros.methods.configuration import GROUPS

    return setting.partition("=")[0].partition(".")[0] in GROUPS


def _recorded_axis(source: ResultSource) -> str | None:
    """Return the axis that was measured, by session, bag or result; None: they do not say."""
    return source.axis or source.result.circumstances.axis or None


def _show(paths: Iterable[Path], as_json: bool, **facts: Any) -> None:
    """Print the paths of the files that were written, as JSON with further ``facts``."""
    files = [str(path.absolute()) for path in paths]
    if as_json:
        print_json({"files": files, **facts})
    else:
        tell(*files)


def _show_export(export: ExportFiles, paths: Iterable[Path], as_json: bool) -> None:
    """Print what was written, with its provenance and its warnings."""
    from rotcal_ros.compensation.writing import PROVENANCE

    side = next(text for file, text in export.files.items() if file.endswith(PROVENANCE))
    _show(paths, as_json, provenance=json.loads(side))
    if not as_json:
        for line in export.in_words():
            say(line)
