"""The secret that permits changes of a controller, in a file that only the operator can read."""

from __future__ import annotations

import hmac
import os
import stat
from pathlib import Path
from typing import Final

from rotcal_ros.foundation.errors import ConfigurationError

SHORTEST: Final = 16
"""Least number of bytes; a random word of this length cannot be guessed."""


class Secret:
    """A secret that a request must contain; never part of a text, a parameter or a log."""

    def __init__(self, path: Path) -> None:
        """Read the file; ConfigurationError if others can read or write it too."""
        try:
            descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
            with os.fdopen(descriptor, "rb") as stream:
                status = os.fstat(descriptor)
                _check(path, status)
                self._secret = stream.read().strip()
        except OSError as error:
            raise ConfigurationError(
                f"the secret in {path} cannot be read: {error.strerror}; expected a file that is "
                "not a link"
            ) from error
        if len(self._secret) < SHORTEST:
            raise ConfigurationError(
                f"the secret in {path} has {len(self._secret)} bytes, expected at least {SHORTEST}"
                f": (umask 077; openssl rand -hex 32 > {path})"
            )

    def is_in(self, request: str) -> bool:
        """Return whether ``request`` is the secret, in a time that does not depend on it."""
        return hmac.compare_digest(request.strip().encode(errors="backslashreplace"), self._secret)


def _check(path: Path, status: os.stat_result) -> None:
    mode = stat.S_IMODE(status.st_mode)
    if not stat.S_ISREG(status.st_mode):
        raise ConfigurationError(f"the secret in {path} is not a plain file")
    if mode & 0o077 or status.st_uid not in (os.geteuid(), 0):
        raise ConfigurationError(
            f"the secret in {path} is open to others besides the operator (mode {mode:03o}, owner "
            f"{status.st_uid}): chmod 600 {path}, and choose a new secret"
        )
