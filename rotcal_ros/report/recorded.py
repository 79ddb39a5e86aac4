"""The report of a recording: result, observations, fingerprints and versions in one place."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rotcal_ros import __version__
from rotcal_ros.bags import names
from rotcal_ros.recordings.replay import Recording
from rotcal_ros.report.page import ReportInput, write_report
from rotcal_ros.results import Result


def write_recorded(
    recording: Recording,
    page: Path,
    truth: Path | None = None,
    extra: Sequence[tuple[str, str]] = (),
) -> Result:
    """Solve a recording, write the page about it, and return the result.

    ``truth`` is the truth.json of a simulation, ``extra`` holds further sections as (title, HTML).
    """
    result = recording.solve()
    injected = None if truth is None else json.loads(truth.read_text(encoding="utf-8"))
    write_report(replace(report_of(recording, result, injected), extra=extra), page)
    return result


def report_of(
    recording: Recording, result: Result, truth: Mapping[str, Any] | None = None
) -> ReportInput:
    """Return what the page shows of a recording and the result that was solved from it."""
    configuration = recording.calibration.configuration
    return ReportInput(
        result=result,
        title="Calibration of a rotary table",
        method_title=recording.calibration.method.title,
        observations=recording.observations,
        configuration_text=configuration.text,
        inputs=[*recording.sha256.items(), ("plan and configuration", configuration.plan_id)],
        versions={**_recorded_versions(recording.attachments), **_own_versions()},
        truth=truth,
        notes=recording.warnings(),
    )


def _own_versions() -> dict[str, str]:
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "mcap"))
    return {
        "solved with": f"rotcal_ros {__version__}, {packages}, Python {platform.python_version()}"
    }


def _recorded_versions(attachments: Mapping[str, bytes]) -> dict[str, str]:
    """Return the versions that the recorder noted; none where the bag holds none."""
    try:
        noted = json.loads(attachments.get(names.VERSIONS, b"{}"))
    except ValueError:
        return {"recorded with": "the bag's note of versions is damaged"}
    if not isinstance(noted, dict) or not noted:
        return {}
    return {"recorded with": ", ".join(f"{name} {text}" for name, text in noted.items())}
