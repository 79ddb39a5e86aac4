"""``rotcal report --dcc``: the digital calibration certificate of a recording or a result."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path

import click

from rotcal_ros.cli.console import VERDICT_EXIT_CODES
from rotcal_ros.extensions.certificate.document import certificate, signed
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.session_folder import SessionFolder
from rotcal_ros.foundation.untrusted import read_bytes
from rotcal_ros.methods import find_method, method_names
from rotcal_ros.recordings.inputs import Input
from rotcal_ros.recordings.result_sources import read_source
from rotcal_ros.report.terminal.console import say


def write_certificate(
    given: Input, output: Path | None, key: Path | None, x509: Path | None
) -> int:
    """Write the certificate, signed with a key and its X.509 certificate if given.

    Nothing is overwritten. Raises ConfigurationError that lists what it needs.
    """
    if (key is None) != (x509 is None):
        raise click.UsageError("a signature needs both: --sign KEY --certificate X509")
    session = SessionFolder(given.path)
    folder = given.path if session.bag.is_dir() else given.path.parent
    output = output or folder / "certificate.xml"
    if output.exists():
        raise BagError(f"{output} exists and is not overwritten; name another file with -o")
    result = read_source(given.path, given).result
    title = find_method(result.method).title if result.method in method_names() else result.method
    data = certificate(result, title, datetime.now(timezone.utc).date())
    if key is not None and x509 is not None:
        data = signed(data, read_bytes(key), read_bytes(x509))
    write_atomically(output, data.decode())
    say(f"certificate: {output.absolute()}")
    return VERDICT_EXIT_CODES[result.verdict]
