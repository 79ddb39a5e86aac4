"""A domain whose ports are taken is passed over."""

import socket

import pytest

from rotcal_ros.cli import domain
from rotcal_ros.cli.domain import free_domain
from rotcal_ros.errors import ConfigurationError


def test_a_domain_with_a_participant_is_passed_over():
    first = free_domain(40)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        # The well-known port of the second participant of the domain (DDSI-RTPS 9.6.2.3).
        participant.bind(("127.0.0.1", 7400 + 250 * first + 10 + 2 * 1))
        assert free_domain(first - 1) != first


def test_none_is_free(monkeypatch):
    monkeypatch.setattr(domain, "_is_free", lambda _: False)
    with pytest.raises(ConfigurationError, match="all ROS domains from 1 to 100"):
        free_domain()


def test_every_start_leads_into_the_range(monkeypatch):
    monkeypatch.setattr(domain, "_is_free", lambda _: True)
    assert {free_domain(start) for start in range(250)} == set(range(1, 101))
