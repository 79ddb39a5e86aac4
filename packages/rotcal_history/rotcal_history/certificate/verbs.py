"""``rotcal report --dcc``: the digital calibration certificate of a recording or a result."""

from __future__ import annotations

from pathlib import Path

import click

from rotcal_history.certificate.writing import require_new
from rotcal_history.certificate.writing import write_certificate as write_file
from rotcal_ros.cli.console import VERDICT_EXIT_CODES
from rotcal_ros.foundation.session_folder import SessionFolder
from rotcal_ros.recordings.inputs import MeasurementInput
from rotcal_ros.recordings.result_sources import read_source
from rotcal_ros.report.terminal.console import say


def write_certificate(
    given: MeasurementInput, output: Path | None, key: Path | None, x509: Path | None
) -> int:
    """Write the certificate, signed with a key and its X.509 certificate if given.

    Nothing is overwritten. Raises ConfigurationError that lists what it needs.
    """
    if (key is None) != (x509 is None):
        raise click.UsageError("a signature needs both: --sign KEY --certificate X509")
    session = SessionFolder(given.path)
    folder = given.path if session.bag.is_dir() else given.path.parent
    output = output or folder / "certificate.xml"
    require_new(output)
    result = read_source(given.path, given).result
    write_file(result, output, key=key, x509=x509)
    say(f"certificate: {output.absolute()}")
    return VERDICT_EXIT_CODES[result.verdict]
