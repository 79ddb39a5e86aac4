"""A ROS domain that nobody on this machine uses."""

from __future__ import annotations

import os
import socket
from typing import Final

from rotcal_ros.errors import ConfigurationError

DOMAINS: Final = range(1, 101)
"""Their ports lie below the range that the kernel gives to outgoing connections."""
_FIRST_PORT: Final = 7410
_PORTS_PER_DOMAIN: Final = 250
_PORTS_PER_PARTICIPANT: Final = 2
_PARTICIPANTS: Final = 8
"""Participants that are looked for: the first of a domain take the first ports that are free."""


def free_domain(start: int | None = None) -> int:
    """Return a domain without participants, the first from ``start`` on (default: process id).

    Two calibrations in one domain would hear each other's instruments. Raises
    ConfigurationError when all are in use.
    """
    start = os.getpid() if start is None else start
    for step in range(len(DOMAINS)):
        domain = DOMAINS[(start + step) % len(DOMAINS)]
        if _is_free(domain):
            return domain
    raise ConfigurationError(
        f"all ROS domains from {DOMAINS[0]} to {DOMAINS[-1]} are in use on this machine; end what "
        "runs there, or choose one with ROS_DOMAIN_ID"
    )


def _is_free(domain: int) -> bool:
    """Return whether the discovery ports of a domain's first participants can be bound."""
    first = _FIRST_PORT + _PORTS_PER_DOMAIN * domain
    for number in range(_PARTICIPANTS):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", first + _PORTS_PER_PARTICIPANT * number))
            except OSError:
                return False
    return True
