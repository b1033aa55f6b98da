"""`omniman tool` with real nodes, and without any."""

import os
import re
import signal

import pytest

from omniman_ros.cli import tool
from omniman_ros.cli.main import main

from .support import PATIENT, Running, command, environment

ARM = ("-p", "joint_trajectory.states_timeout:=1.0", "-p", "scaling_timeout:=2.0")
WITHOUT = ("platform_controller", "simulated_drive", "path_interpolator", "arm_streamer",
           "simulated_ur")  # fmt: skip


def test_without_an_interpolator_it_says_so(own_domain, monkeypatch, capfd):
    monkeypatch.setattr(tool, "DISCOVERY", 0.2)
    assert main(["tool", "1", "0", "0.5"]) == 1
    assert "no path_interpolator" in capfd.readouterr().err


@pytest.mark.parametrize("wrong", [["tool"], ["tool", "1", "2"], ["tool", "a", "b", "c"]])
def test_a_place_needs_numbers(wrong, capfd):
    with pytest.raises(SystemExit) as ended:
        main(wrong)
    assert ended.value.code == 2


def test_a_straight_path_keeps_the_tool_turned_as_it_is():
    path = tool.straight((1.0, 2.0, 3.0), (4.0, 5.0, 6.0))
    assert path.header.frame_id == "odom" and len(path.poses) == 2
    end = path.poses[1].pose
    assert [end.position.x, end.position.y, end.position.z] == [4.0, 5.0, 6.0]
    turn = end.orientation
    assert [turn.x, turn.y, turn.z, turn.w] == [0.0] * 4


@pytest.mark.processes
def test_the_tool_is_led_refused_and_called_back():
    env = environment()
    with Running(command("up", *PATIENT, *ARM, "--only", *WITHOUT), env) as up:
        up.wait_for("Ctrl-C stops")
        with Running(command("tool", "1.2", "0.2", "0.05", "--relative"), env) as there:
            assert there.finish() == 0, there.output
            assert re.search("there after", there.output)
        with Running(command("tool", "0", "0", "3", "--relative"), env) as high:
            assert high.finish() == 1
            assert "reach" in high.output, high.output
        with Running(command("tool", "5", "0", "0", "--relative"), env) as far:
            up.wait_for("5.00 m of the tool")
            far.process.send_signal(signal.SIGINT)
            assert far.finish() == 130
        up.wait_for("trajectory: cancelled")
        os.kill(up.process.pid, signal.SIGINT)
        assert up.finish() == 0, up.output
