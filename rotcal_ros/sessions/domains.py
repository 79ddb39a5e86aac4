"""Finds unused ROS domains on this machine, so that two cells never hear each other."""

from __future__ import annotations

import fcntl
import itertools
import os
import socket
import tempfile
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Final

DOMAINS: Final = 100
"""Domains 1 to 100 use ports below the range that the kernel gives to outgoing connections."""
DEFAULT_DOMAIN: Final = 0
"""The domain that ROS uses if none is set."""
_PORTS_PER_DOMAIN: Final = 250

_SOCKETS: Final = (Path("/proc/net/udp"), Path("/proc/net/udp6"))
_BASE_PORT: Final = 7400
_OFFSETS: Final = range(10, 50, 2)
"""Ports of the first twenty participants of a domain, counted from the domain's base port."""

_turn = itertools.count(os.getpid())
_held: dict[int, int] = {}
"""Domain -> descriptor of the lock that this process holds on it."""


def free_domain() -> int:
    """Return a domain (1 to 100) in which no participant is seen; a new one at every call.

    It stays reserved for this process until its end or `release_domains`: another process of this
    user gets another one even before the first participant is there. Participant i has the port
    7410 + 250 domain + 2 i (DDSI-RTPS 2.3, 9.6.1). When all are taken, the next is returned
    nevertheless: sharing a domain is better than not starting.
    """
    for _ in range(DOMAINS):
        domain = 1 + next(_turn) % DOMAINS
        if _is_free(domain) and _hold(domain):
            break
    return domain


def release_domains() -> None:
    """Release the domains of this process, after its participants have left."""
    while _held:
        os.close(_held.popitem()[1])


def _hold(domain: int) -> bool:
    """Take the lock of a domain; return False when another process has it."""
    file = Path(tempfile.gettempdir(), f"rotcal_domain_{os.getuid()}_{domain}.lock")
    try:
        # The folder belongs to all users: O_NOFOLLOW refuses a link put there by another one.
        held = os.open(file, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    except OSError:
        return True  # nowhere to lock: the free port has to be enough
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(held)
        return False
    _held[domain] = held
    return True


def _is_free(domain: int) -> bool:
    """Return whether no port of a domain is taken; the first participant may have left others."""
    if any(path.exists() for path in _SOCKETS):
        return domain not in domains_in_use()
    with ExitStack() as probes:
        for offset in _OFFSETS:
            probe = probes.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            try:
                probe.bind(("127.0.0.1", _BASE_PORT + _PORTS_PER_DOMAIN * domain + offset))
            except OSError:
                return False
    return True


def domains_in_use() -> tuple[int, ...]:
    """Return the domains that have visible participants on this machine.

    Empty where the system does not list its sockets (other systems than Linux).
    """
    places = (divmod(port - _BASE_PORT, _PORTS_PER_DOMAIN) for port in _udp_ports())
    return tuple(sorted({d for d, offset in places if 0 <= d <= DOMAINS and offset in _OFFSETS}))


def _udp_ports() -> set[int]:
    ports = set()
    for path in _SOCKETS:
        with suppress(OSError, ValueError, IndexError):
            for line in path.read_text().splitlines()[1:]:
                # Second column of /proc/net/udp: local ADDRESS:PORT, in hexadecimal.
                ports.add(int(line.split()[1].rpartition(":")[2], 16))
    return ports
