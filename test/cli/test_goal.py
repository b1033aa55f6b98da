"""`omniman goal` with real nodes, and without any."""

import os
import signal

import pytest

from omniman_ros.cli import goal
from omniman_ros.cli.main import main

from .support import PATIENT, Running, command, environment

pytestmark = pytest.mark.processes

NODES = ("platform_controller", "simulated_drive", "mpc_planner")
QUICK = ("-p", "horizon.steps:=10", "-p", "safety.deadline:=0.05")


def test_without_a_planner_it_says_so(own_domain, monkeypatch, capfd):
    monkeypatch.setattr(goal, "DISCOVERY", 0.2)
    assert main(["goal", "1", "0"]) == 1
    assert "no mpc_planner" in capfd.readouterr().err


def test_a_robot_is_sent_refused_and_called_back():
    env = environment()
    with Running(command("up", *PATIENT, *QUICK, "--only", *NODES), env) as up:
        up.wait_for("Ctrl-C stops")
        with Running(command("goal", "0.4", "0", "10", "--relative"), env) as there:
            assert there.finish() == 0, there.output
            assert "reached" in there.output
        up.wait_for("goal reached")
        with Running(command("goal", "1e9", "0"), env) as refused:
            assert refused.finish() == 1
            assert "refused" in refused.output
        with Running(command("goal", "30", "0"), env) as far:
            up.wait_for("goal taken")
            far.process.send_signal(signal.SIGINT)
            assert far.finish() == 130
        with Running(command("goal", "0.8", "0.1"), env) as after:
            assert after.finish() == 0, after.output
        os.kill(up.process.pid, signal.SIGINT)
        assert up.finish() == 0


@pytest.mark.parametrize("wrong", [["goal"], ["goal", "1"], ["goal", "a", "b"]])
def test_a_goal_needs_numbers(wrong, capfd):
    with pytest.raises(SystemExit) as ended:
        main(wrong)
    assert ended.value.code == 2
