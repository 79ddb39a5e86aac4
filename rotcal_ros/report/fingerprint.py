"""The number and the fingerprint by which the pages of one report are known."""

from __future__ import annotations

import hashlib
from typing import Final

from rotcal_ros.results import Result

DIGITS: Final = 10
SHOWN: Final = 16


def fingerprint(result: Result) -> str:
    """Return the SHA-256 of the result as result.json holds it."""
    return hashlib.sha256(result.to_json().encode()).hexdigest()


def number(result: Result) -> str:
    """Return the number of the certificate, or one that follows from the fingerprint."""
    stated = result.circumstances.identity.certificate_number
    return stated or f"RC-{fingerprint(result)[:DIGITS].upper()}"
