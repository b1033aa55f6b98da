"""`omniman stop` and `omniman reset` without a robot; test_running_platform.py stops one."""

import pytest

from omniman_ros.cli.main import main
from omniman_ros.client.robot import Robot


@pytest.mark.processes
@pytest.mark.parametrize("action", ["stop", "reset"])
def test_the_command_fails_and_names_the_domain_if_no_node_is_found(
    action, own_domain, monkeypatch, capfd
):
    monkeypatch.setattr(Robot.stop, "__defaults__", (0.1, *Robot.stop.__defaults__[1:]))
    monkeypatch.setattr(Robot.reset, "__defaults__", (0.1, *Robot.reset.__defaults__[1:]))
    assert main([action]) == 1
    assert "ROS_DOMAIN_ID" in capfd.readouterr().err
