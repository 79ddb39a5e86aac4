import socket

from rotcal_ros.sessions.domains import DOMAINS, free_domain


def test_every_call_gives_another_domain():
    found = {free_domain() for _ in range(10)}
    assert len(found) == 10
    assert found <= set(range(1, DOMAINS + 1))


def test_a_domain_in_use_is_passed_over():
    taken = free_domain()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        participant.bind(("127.0.0.1", 7410 + 250 * taken))
        assert taken not in {free_domain() for _ in range(DOMAINS)}
