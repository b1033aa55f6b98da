"""`omniman goal` without a robot; test_running_platform.py has goals of a running one."""

import pytest

from omniman_ros.cli import motion
from omniman_ros.cli.main import main


@pytest.mark.processes
def test_without_a_planner_it_fails_and_names_the_node(own_domain, monkeypatch, capfd):
    monkeypatch.setattr(motion, "READY_TIMEOUT", 0.2)
    assert main(["goal", "1", "0"]) == 1
    assert "no mpc_planner" in capfd.readouterr().err


@pytest.mark.parametrize("arguments", [["goal"], ["goal", "1"], ["goal", "a", "b"]])
def test_a_goal_needs_two_numbers(arguments, capfd):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
