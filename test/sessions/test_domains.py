import os
import socket
import subprocess
import sys

import pytest

from rotcal_ros.sessions.domains import DOMAINS, free_domain, release_domains


@pytest.fixture(autouse=True)
def _release():
    yield
    release_domains()


def test_every_call_gives_another_domain():
    found = {free_domain() for _ in range(10)}
    assert len(found) == 10
    assert found <= set(range(1, DOMAINS + 1))


def test_a_domain_in_use_is_passed_over():
    taken = free_domain()
    release_domains()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        participant.bind(("127.0.0.1", 7410 + 250 * taken))
        for _ in range(DOMAINS):
            assert free_domain() != taken
            release_domains()


def test_what_one_process_got_no_other_gets_though_nobody_is_there_yet():
    """Two `rotcal run` of the same second: neither has a participant when the other chooses."""
    first = free_domain()
    other = f"""
import itertools
from rotcal_ros.sessions import domains
domains._turn = itertools.count({first - 1})  # would be its first choice
print(domains.free_domain())
"""
    asked = [sys.executable, "-c", other]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}

    def second():
        return int(subprocess.run(asked, env=environment, capture_output=True, check=True).stdout)

    assert second() != first
    release_domains()
    assert second() == first
