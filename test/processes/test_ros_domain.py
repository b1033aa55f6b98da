import os
import socket
import subprocess
import sys
import tempfile

import pytest

from omniman_ros.processes import ros_domain
from omniman_ros.processes.ros_domain import (
    HIGH_DOMAINS,
    LOW_DOMAINS,
    RESERVATION,
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
    assert domain in (*HIGH_DOMAINS, *LOW_DOMAINS)


def test_isolation_keeps_what_the_user_has_set():
    environment = {"ROS_DOMAIN_ID": "7", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    assert isolate_ros_domain(dict(environment)) == 7
    assert isolate_ros_domain(environment) == 7
    assert environment == {"ROS_DOMAIN_ID": "7", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}


def test_a_domain_in_use_is_not_free():
    domain = free_domain()
    assert is_free(domain)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        participant.bind(("", 7400 + 250 * domain + 14))  # the third: the first two have ended
        assert not is_free(domain)


CHOOSE = "from omniman_ros.processes.ros_domain import free_domain; print(free_domain())"


def test_processes_that_choose_at_the_same_time_get_different_domains(monkeypatch, tmp_path):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    command = [sys.executable, "-c", CHOOSE]
    processes = [subprocess.Popen(command, stdout=subprocess.PIPE) for _ in range(8)]
    domains = [int(process.communicate()[0]) for process in processes]
    assert len(set(domains)) == len(domains)


def test_a_domain_that_was_chosen_is_chosen_again_when_its_processes_had_time(
    monkeypatch, tmp_path
):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(ros_domain, "HIGH_DOMAINS", range(215, 216))
    monkeypatch.setattr(ros_domain, "is_free", lambda domain: True)
    assert free_domain() == 215 != free_domain()
    (reservation,) = tmp_path.glob("*/215")
    long_ago = reservation.stat().st_mtime - RESERVATION - 1.0
    os.utime(reservation, (long_ago, long_ago))
    assert free_domain() == 215


def test_a_domain_is_found_where_nothing_can_be_reserved(monkeypatch, tmp_path):
    (tmp_path / f"omniman_ros_domains_{os.getuid()}").write_text("a file")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(ros_domain, "is_free", lambda domain: domain == 220)
    assert free_domain() == 220


def test_low_domains_are_used_when_all_high_ones_are_taken(monkeypatch, tmp_path):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(ros_domain, "LOW_DOMAINS", range(21, 24))
    monkeypatch.setattr(ros_domain, "is_free", lambda domain: domain == 22)
    assert free_domain() == 22
    monkeypatch.setattr(ros_domain, "is_free", lambda domain: False)
    assert free_domain() in (*HIGH_DOMAINS, *LOW_DOMAINS)


def test_every_domain_has_valid_ports_that_linux_does_not_assign_by_itself():
    for domain in (*HIGH_DOMAINS, *LOW_DOMAINS):
        first = 7400 + 250 * domain
        last = first + 11 + 2 * 50  # of the 50th participant
        assert last < 32768 or (first > 60999 and last < 65536)
