"""``rc.write_certificate``: a certificate of a recording, a table or a result, in a file."""

from __future__ import annotations

from datetime import datetime, timezone
from os import PathLike
from pathlib import Path

from rotcal_history.certificate.document import make_certificate, signed
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.untrusted import read_bytes
from rotcal_ros.methods import find_method, method_names
from rotcal_ros.methods.method import Measurements
from rotcal_ros.recordings.replay import Recording

Name = str | PathLike[str]


def write_certificate(
    source: Recording | Measurements | Result,
    path: Name,
    *,
    key: Name | None = None,
    x509: Name | None = None,
) -> Path:
    """Write the digital calibration certificate of a recording, a table or a result, as XML.

    A recording or a table is solved; its group ``identity`` says what was calibrated, where and by
    whom. ``key`` and ``x509`` (PEM) sign it. Returns the path. Raises BagError for a file that
    exists, ConfigurationError that lists what is missing, DataError for a verdict that is not ok.

    >>> import rotcal_ros as rc
    >>> result = rc.read_result("examples/data/result_tracer.json")
    >>> rc.write_certificate(result, "certificate.xml")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    rotcal_ros.foundation.errors.ConfigurationError: a calibration certificate needs more than ...
    """
    path = Path(path)
    if (key is None) != (x509 is None):
        raise ConfigurationError("a signature needs both, key and X.509 certificate")
    require_new(path)
    result = source if isinstance(source, Result) else source.solve()
    title = find_method(result.method).title if result.method in method_names() else result.method
    data = make_certificate(result, title, datetime.now(timezone.utc).date())
    if key is not None and x509 is not None:
        data = signed(data, read_bytes(Path(key)), read_bytes(Path(x509)))
    write_atomically(path, data.decode())
    return path


def require_new(path: Path) -> None:
    """Raise BagError for a file that exists."""
    if path.exists():
        raise BagError(f"{path} exists and is not overwritten: name another file")
