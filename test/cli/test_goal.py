"""`omniman goal` without a robot; test_running_platform.py has goals of a running one."""

import pytest

from omniman_ros.cli import motion
from omniman_ros.cli.main import main


@pytest.mark.processes
@pytest.mark.parametrize(
    ("option", "node"),
    [((), "no mpc_planner"), (("--joints", "0", "-90"), "no whole_body_planner")],
)
def test_without_a_planner_it_fails_and_names_the_node(
    option, node, own_domain, monkeypatch, capfd
):
    monkeypatch.setattr(motion, "READY_TIMEOUT", 0.2)
    assert main(["goal", "1", "0", *option]) == 1
    assert node in capfd.readouterr().err


@pytest.mark.parametrize("arguments", [["goal"], ["goal", "1"], ["goal", "a", "b"]])
def test_a_goal_needs_two_numbers(arguments, capfd):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
