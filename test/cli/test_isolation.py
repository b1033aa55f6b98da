import socket

import pytest

from omniman_ros.cli import isolation
from omniman_ros.cli.isolation import SELDOM_USED, USUAL, free_domain, is_free, isolate

pytestmark = pytest.mark.processes


def test_a_domain_is_chosen_and_kept_to_this_machine():
    environment = {}
    domain = isolate(environment)
    assert environment == {
        "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"
    }  # fmt: skip
    assert domain in SELDOM_USED


def test_what_the_user_has_set_stays():
    environment = {"ROS_DOMAIN_ID": "7", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    assert isolate(dict(environment)) == 7
    assert isolate(environment) == 7
    assert environment == {"ROS_DOMAIN_ID": "7", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}


def test_a_domain_in_use_is_not_free():
    domain = free_domain()
    assert is_free(domain)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        participant.bind(("", 7400 + 250 * domain + 10))
        assert not is_free(domain)


def test_the_usual_domains_serve_when_the_others_are_taken(monkeypatch):
    monkeypatch.setattr(isolation, "USUAL", range(41, 44))
    monkeypatch.setattr(isolation, "is_free", lambda domain: domain == 42)
    assert free_domain() == 42
    monkeypatch.setattr(isolation, "is_free", lambda domain: False)
    assert free_domain() in (*SELDOM_USED, *USUAL)


def test_every_domain_has_ports_that_exist_and_that_linux_does_not_give_out():
    for domain in (*SELDOM_USED, *USUAL):
        first = 7400 + 250 * domain
        last = first + 11 + 2 * 50  # of the 50th participant
        assert last < 32768 or (first > 60999 and last < 65536)
