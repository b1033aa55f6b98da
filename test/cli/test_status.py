"""`omniman status` without a robot; test_running_platform.py tells of a running one."""

import pytest

from omniman_ros.cli import status
from omniman_ros.cli.main import main


@pytest.mark.processes
def test_without_a_robot_it_fails_and_names_domain_and_namespace(own_domain, monkeypatch, capfd):
    monkeypatch.setattr(status, "SEARCH_TIMEOUT", 0.2)
    assert main(["status", "--namespace", "a"]) == 1
    assert f"no robot answers in ROS domain {own_domain}, namespace '/a'" in capfd.readouterr().err
