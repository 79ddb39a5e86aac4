"""A ROS domain that nobody on this machine uses, so that two cells never hear each other."""

from __future__ import annotations

import itertools
import os
import socket
from typing import Final

DOMAINS: Final = 100
"""Domains 1 to 100 use ports below the range that the kernel gives to outgoing connections."""
_FIRST_PORT: Final = 7410
_PORTS_PER_DOMAIN: Final = 250

_turn = itertools.count(os.getpid())


def free_domain() -> int:
    """Return a domain (1 to 100) whose first participant's port is free; a new one every call.

    The port is 7410 + 250 domain (DDSI-RTPS 2.3, 9.6.1). When all are taken, the next is
    returned all the same: sharing a domain beats not starting.
    """
    for _ in range(DOMAINS):
        domain = 1 + next(_turn) % DOMAINS
        if _is_free(domain):
            break
    return domain


def _is_free(domain: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("127.0.0.1", _FIRST_PORT + _PORTS_PER_DOMAIN * domain))
        except OSError:
            return False
    return True
