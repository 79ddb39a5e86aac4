"""Files for a controller, as they are asked for on the command line and on a page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Final, Protocol

from rotcal_ros.compensation.agreement import (
    LARGEST_AGE_DAYS,
    AcceptedConflicts,
    MachineIdentity,
    split_words,
)
from rotcal_ros.compensation.controllers import parse_options, parse_revolutions
from rotcal_ros.compensation.earlier_export import combine_with_earlier_export
from rotcal_ros.compensation.export import ExportFiles, prepare_export
from rotcal_ros.compensation.table import CompensationTable, require_one_axis, table_from_result
from rotcal_ros.compensation.writing import write_files
from rotcal_ros.foundation.components import check_axis
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import DEGREE

DEFAULT_AXIS: Final = "C"


class MeasuredAxisResult(Protocol):
    """A result, the ``axis`` that was measured as far as its source knows, and its files."""

    @property
    def result(self) -> Result:
        """What was found."""

    @property
    def sha256(self) -> Mapping[str, str]:
        """Hashes of the files by their names."""

    @property
    def axis(self) -> str | None:
        """The letter of the axis; None if only the result is known."""


@dataclass(frozen=True)
class ExportRequest:
    """What files are asked for, in degrees and days; ``now`` is the time of the call.

    ``controller``: its name. ``out``: the folder. ``settings``: of the controller, as NAME=VALUE.
    """

    controller: str
    out: Path
    spacing: float | None = None
    axis: str | None = None
    serial: str | None = None
    reference: float | None = None
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
        axis = check_axis(self.axis) if self.axis else ""
        return {"the export (--axis, --serial)": MachineIdentity(axis, self.serial or "")}

    def accepted(self) -> AcceptedConflicts:
        """Return the contradictions that are accepted."""
        largest_age = LARGEST_AGE_DAYS if self.max_age is None else self.max_age
        return AcceptedConflicts(split_words(self.accept), largest_age)

    def measured_axis(self, forward: MeasuredAxisResult) -> str:
        """Return the letter of the axis that was measured."""
        return _recorded_axis(forward) or self.axis or DEFAULT_AXIS

    def controller_settings(self) -> dict[str, Any]:
        """Return the settings of the controller."""
        settings = parse_options(self.settings)
        if self.revolutions is not None:
            settings |= parse_revolutions(self.revolutions)
        if self.machine_ini is not None:
            settings["machine_ini"] = str(self.machine_ini)
        return settings


def write_export(
    forward: MeasuredAxisResult, asked: ExportRequest, backward: MeasuredAxisResult | None = None
) -> tuple[ExportFiles, tuple[Path, ...]]:
    """Write the files for a controller, after reading them back and simulating it.

    ``backward`` is what was measured in the other direction. Raises ConfigurationError for what
    acts beside the table and has to be stated.
    """
    machines, accepted = asked.machines(), asked.accepted()
    export = prepare_export(
        combine_with_earlier_export(
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
    export.controller.require_stated(export.table)
    return export, write_files(export.with_machine_files(), asked.out)


def _table(
    forward: MeasuredAxisResult, backward: MeasuredAxisResult | None, asked: ExportRequest
) -> CompensationTable:
    """Return the correction table at the measured angles, or on rows of a harmonic fit."""
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


def _radians(degrees: float | None) -> float | None:
    return None if degrees is None else degrees * DEGREE


def _recorded_axis(source: MeasuredAxisResult) -> str | None:
    """Return the axis that was measured, by session, bag or result; None: they do not say."""
    return source.axis or source.result.circumstances.axis or None
