"""A whole certificate: the parts in order, the result itself, and a signature on request."""

from __future__ import annotations

import gzip
from base64 import b64encode
from datetime import date
from hashlib import sha256
from typing import Any, Final

from lxml import etree

from rotcal_ros.certificate.administrative import administrative_data
from rotcal_ros.certificate.elements import DCC, DCC_NAMESPACE, leaf, text
from rotcal_ros.certificate.measurement import measurement_results
from rotcal_ros.certificate.required import require
from rotcal_ros.results import Result

SCHEMA: Final = "3.3.0"
LARGEST_TEXT: Final = 9_900_000
"""Characters in one text: parsers of XML refuse more than 10 million."""
_LOCATION: Final = "{http://www.w3.org/2001/XMLSchema-instance}schemaLocation"


def certificate(result: Result, method_title: str, issued: date) -> bytes:
    """Return the digital calibration certificate of a result as XML, UTF-8.

    Raises ConfigurationError that lists what the result does not tell, DataError where its
    verdict is not ok.
    """
    require(result)
    root = DCC.digitalCalibrationCertificate(
        administrative_data(result, issued),
        measurement_results(result, method_title),
        _result_file(result),
        schemaVersion=SCHEMA,
    )
    root.set(_LOCATION, f"{DCC_NAMESPACE} {DCC_NAMESPACE}/v{SCHEMA}/dcc.xsd")
    etree.indent(root)
    return as_bytes(root)


def as_bytes(root: Any) -> bytes:
    """Return a document as it is written."""
    data: bytes = etree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return data


def _result_file(result: Result) -> Any:
    """Return result.json, from which all of it can be computed again.

    A large one is compressed; of one that is too large even so only its SHA-256 is here.
    """
    name, mime, data = "result.json", "application/json", result.to_json().encode()
    digest = sha256(data).hexdigest()
    if _too_large(data):
        name, mime, data = f"{name}.gz", "application/gzip", gzip.compress(data, mtime=0)
    if _too_large(data):
        name, mime = "result.json.sha256", "text/plain"
        data = f"{digest}  result.json\n".encode()
    return DCC.document(
        text("name", "The result in the machine-readable form of rotcal_ros"),
        leaf("fileName", name),
        leaf("mimeType", mime),
        leaf("dataBase64", b64encode(data).decode()),
    )


def _too_large(data: bytes) -> bool:
    return 4 * len(data) > 3 * LARGEST_TEXT
