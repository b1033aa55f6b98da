import socket

import pytest

from omniman_ros.processes import ros_domain
from omniman_ros.processes.ros_domain import (
    HIGH_DOMAINS,
    LOW_DOMAINS,
    free_domain,
    is_free,
    isolate_ros_domain,
)

pytestmark = pytest.mark.processes


def test_isolation_chooses_a_domain_and_restricts_discovery_to_this_machine():
    environment = {}
    domain = isolate_ros_domain(environment)
    assert environment == {
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    assert domain in HIGH_DOMAINS


def test_isolation_keeps_what_the_user_has_set():
    environment = {"ROS_DOMAIN_ID": "7", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    assert isolate_ros_domain(dict(environment)) == 7
    assert isolate_ros_domain(environment) == 7
    assert environment == {"ROS_DOMAIN_ID": "7", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}


def test_a_domain_in_use_is_not_free():
    domain = free_domain()
    assert is_free(domain)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        participant.bind(("", 7400 + 250 * domain + 10))
        assert not is_free(domain)


def test_low_domains_are_used_when_all_high_ones_are_taken(monkeypatch):
    monkeypatch.setattr(ros_domain, "LOW_DOMAINS", range(41, 44))
    monkeypatch.setattr(ros_domain, "is_free", lambda domain: domain == 42)
    assert free_domain() == 42
    monkeypatch.setattr(ros_domain, "is_free", lambda domain: False)
    assert free_domain() in (*HIGH_DOMAINS, *LOW_DOMAINS)


def test_every_domain_has_valid_ports_that_linux_does_not_assign_by_itself():
    for domain in (*HIGH_DOMAINS, *LOW_DOMAINS):
        first = 7400 + 250 * domain
        last = first + 11 + 2 * 50  # of the 50th participant
        assert last < 32768 or (first > 60999 and last < 65536)
