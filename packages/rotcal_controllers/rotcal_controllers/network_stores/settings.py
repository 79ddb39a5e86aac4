"""The settings of controllers that are fed through a network, and where their secrets are."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import setting
from rotcal_ros.foundation.untrusted import cause_of, read_text

OTHERS: Final = 0o077
"""Rights of group and others on a file."""


@dataclass(frozen=True)
class OpcUaSettings:
    """An OPC UA server that shows the controller's files; always encrypted (Basic256Sha256)."""

    endpoint: str = setting("", doc="address of the server, opc.tcp://HOST:PORT")
    directory: str = setting(
        "", doc="node that holds the files: a node id, or a browse path below Objects"
    )
    user: str = setting(
        "", doc="name of the user; empty: identified by user_certificate, or anonymous"
    )
    password_from: str = setting("", doc="where the password is: file:PATH or env:NAME")
    certificate: str = setting("", doc="file (PEM or DER) with the certificate of the bridge")
    private_key: str = setting("", doc="file (PEM or DER) with the private key of the bridge")
    user_certificate: str = setting(
        "", doc="file (PEM or DER) with the certificate of the user, instead of a password"
    )
    user_key: str = setting("", doc="file (PEM or DER) with the private key of the user")
    server_certificate: str = setting(
        "", doc="file (PEM or DER) with the certificate that the server must have"
    )

    def check(self) -> None:
        """Raise ConfigurationError unless all is there that a connection needs."""
        needed = ("endpoint", "directory", "certificate", "private_key", "server_certificate")
        by_password = ("password_from",) if self.user else ()
        by_certificate = ("user_key",) if self.user_certificate else ()
        _require(self, "opcua", needed + by_password + by_certificate)
        if self.user and self.user_certificate:
            raise ConfigurationError(
                "opcua.user and opcua.user_certificate: give only one of them"
            )
        if not re.fullmatch(r"opc\.tcp://[^@/\s]+(/[^@\s]*)?", self.endpoint):
            raise ConfigurationError(
                "opcua.endpoint: expected opc.tcp://HOST:PORT, without user or password"
            )
        if self.password_from:
            _check_source(self.password_from, "opcua.password_from")


@dataclass(frozen=True)
class AdsSettings:
    """A TwinCAT runtime that takes the table as an array over ADS; nothing is encrypted."""

    net_id: str = setting("", doc="AMS net id of the runtime, such as 5.12.34.56.1.1")
    host: str = setting("", doc="host name or IP address of the runtime")
    port: int = setting(851, doc="AMS port of the PLC runtime", minimum=1, maximum=65_535)
    table: str = setting(
        "GVL.rotcal_table", doc="variable of the table: ARRAY [0..capacity-1, 0..4] OF LREAL"
    )
    count: str = setting(
        "GVL.rotcal_count", doc="variable of its length: UDINT, rows in force or 0"
    )
    capacity: int = setting(400, doc="rows that the array can hold", minimum=2, maximum=100_000)

    def check(self) -> None:
        """Raise ConfigurationError unless all is there that a connection needs."""
        _require(self, "ads", ("net_id", "host", "table", "count"))
        if not re.fullmatch(r"\d{1,3}(\.\d{1,3}){5}", self.net_id):
            raise ConfigurationError("ads.net_id: expected six numbers, such as 5.12.34.56.1.1")


def read_secret(source: str, where: str) -> str:
    """Return the secret that ``source``, file:PATH or env:NAME, leads to.

    Raises ConfigurationError when it is not there, or in a file that others may read.
    """
    kind, name = _check_source(source, where)
    if kind == "env":
        if name not in os.environ:
            raise ConfigurationError(
                f"{where}: the environment has no variable {name}; set it for this process"
            )
        return os.environ[name]
    path = Path(name).expanduser()
    try:
        if path.stat().st_mode & OTHERS:
            raise ConfigurationError(f"{where}: others may read {path}: run chmod 600 {path}")
        return read_text(path).rstrip("\r\n")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{where}: cannot read {path}: {cause_of(error)}") from error


def _check_source(source: str, where: str) -> tuple[str, str]:
    kind, _, name = source.partition(":")
    if kind not in ("file", "env") or not name:
        # The text is not repeated: it may be the secret itself, and this goes into logs.
        raise ConfigurationError(
            f"{where}: expected file:PATH or env:NAME; the secret itself does not belong in a "
            "configuration, which is copied into every bag"
        )
    return kind, name


def _require(settings: OpcUaSettings | AdsSettings, group: str, names: tuple[str, ...]) -> None:
    missing = [f"{group}.{name}" for name in names if not getattr(settings, name)]
    if missing:
        raise ConfigurationError(f"transport {group} needs {', '.join(missing)}")
