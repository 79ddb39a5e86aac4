"""The settings of the operator's page: group ``page`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass
from ipaddress import ip_address
from typing import Final

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import setting

LOOPBACK: Final = "127.0.0.1"


@dataclass(frozen=True)
class PageSettings:
    """Where the operator's page is served, and who may see it."""

    host: str = setting(
        LOOPBACK,
        doc="address of the interface that the page is served on; any but loopback needs a "
        "password_file",
    )
    port: int = setting(0, doc="port of the page; 0: any free one", minimum=0, maximum=65_535)
    password_file: str = setting(
        "",
        doc="file that holds the page's password, at least 16 characters, readable by its owner "
        "alone; empty: no password",
    )

    def __post_init__(self) -> None:
        """Refuse to serve other machines without a password."""
        if not (is_loopback(self.host) or self.password_file):
            raise ConfigurationError(
                f"host {self.host!r} is reachable from other machines: name a password_file, or "
                f"leave the page on {LOOPBACK}"
            )


def is_loopback(host: str) -> bool:
    """Return whether ``host`` is this machine alone; ConfigurationError if it is no address."""
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        raise ConfigurationError(
            f"host {host!r} is not an address: expected one such as {LOOPBACK}, ::1 or 0.0.0.0"
        ) from None
