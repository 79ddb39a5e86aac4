"""The report of a recording: result, observations, fingerprints and versions in one place."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rotcal_ros import __version__
from rotcal_ros.bags import names
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods import find_method, method_names
from rotcal_ros.methods.measurements import PlannedMeasurements
from rotcal_ros.methods.method import Measurements
from rotcal_ros.recordings.replay import Recording
from rotcal_ros.recordings.result_sources import ResultSource
from rotcal_ros.report.page import TITLE, ReportInput, render_report
from rotcal_ros.report.printing import write_page
from rotcal_ros.report.verification import acting_section


def write_recorded(
    recording: Recording,
    page: Path,
    truth: Mapping[str, Any] | None = None,
    extra: Sequence[tuple[str, str]] = (),
    in_force: Path | None = None,
) -> Result:
    """Solve a recording, write the page about it, and return the result.

    ``truth`` is the content of the truth.json of a simulation, ``extra`` holds further sections
    as (title, HTML), ``in_force`` is the folder with the files of the table on which it was
    measured.
    """
    configuration = recording.calibration.configuration
    result = recording.solve()
    report = ReportInput(
        result=result,
        title=TITLE,
        method_title=recording.calibration.method.title,
        observations=recording.observations,
        configuration_text=configuration.text,
        inputs=[*recording.sha256.items(), ("plan and configuration", configuration.plan_id)],
        versions=_versions(recording.attachments),
        truth=truth,
        extra=extra or acting_section(result, in_force),  # that of verify says it itself
        goal=recording.goal_standing(result),
        issued=_today(),
    )
    write_page(page, render_report(report))
    return result


def write_measured(
    measured: Recording | Measurements,
    page: Path,
    truth: Mapping[str, Any] | None = None,
    in_force: Path | None = None,
) -> Result:
    """Solve a bag or a plain table, write the page about it, and return the result."""
    if isinstance(measured, Recording):
        return write_recorded(measured, page, truth, in_force=in_force)
    configuration, result = measured.configuration, measured.solve()
    report = ReportInput(
        result=result,
        title=TITLE,
        method_title=configuration.method.title,
        observations=measured.observations if isinstance(measured, PlannedMeasurements) else (),
        configuration_text=configuration.text,
        inputs=[*measured.sha256.items(), ("plan and configuration", configuration.plan_id)],
        versions=_versions({}),
        truth=truth,
        extra=acting_section(result, in_force),
        issued=_today(),
    )
    write_page(page, render_report(report))
    return result


def write_result(
    source: ResultSource,
    page: Path,
    truth: Mapping[str, Any] | None = None,
    in_force: Path | None = None,
) -> Result:
    """Write the page about a result that comes without its bag, and return the result."""
    result = source.result
    installed = result.method in method_names()
    report = ReportInput(
        result=result,
        title=TITLE,
        method_title=find_method(result.method).title if installed else result.method,
        inputs=list(source.sha256.items()),
        versions=_versions({}),
        truth=truth,
        extra=acting_section(result, in_force),
        issued=_today(),
    )
    try:
        text = render_report(report)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise DataError(
            f"the details of the result are not what {result.method} writes, or truth.json is not "
            f"of this table ({error}): take result.json as it was written, or report its bag"
        ) from error
    write_page(page, text)
    return result


def _today() -> str:
    return f"{datetime.now(timezone.utc):%Y-%m-%d}"


def _versions(attachments: Mapping[str, bytes]) -> dict[str, str]:
    """Return the versions that the recorder noted, if it did, and those that are running."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "mcap"))
    own = f"rotcal_ros {__version__}, {packages}, Python {platform.python_version()}"
    try:
        noted = json.loads(attachments.get(names.VERSIONS, b"{}"))
        recorded = ", ".join(f"{name} {text}" for name, text in noted.items())
    except (ValueError, AttributeError):
        recorded = "the bag's note of versions is damaged"
    return ({"recorded with": recorded} if recorded else {}) | {"solved with": own}
