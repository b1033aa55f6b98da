"""`omniman fault`: what it lists, what it refuses, and which processes it finds."""

import signal
import subprocess
import sys

import pytest
from std_msgs.msg import Bool, String

from omniman_ros.cli.main import main
from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import Session
from omniman_ros.lab.faults import command, page
from omniman_ros.lab.faults.command import demand_needed, inject, listed, row_of
from omniman_ros.lab.faults.found_robot import (
    FoundProcesses,
    FoundRobot,
    demand_simulation,
    runs_node,
)
from omniman_ros.lab.faults.table import ROWS
from omniman_ros.nodes.stop_interface import LATCHED

SIMULATED = ("platform_controller", "simulated_drive", "arm_streamer", "simulated_ur")
ON_CAN = ("platform_controller", "can_bridge", "simulated_can_drives")


def test_short_names_are_single_words_unique_listed_and_on_the_page():
    names = [row.short_name for row in ROWS]
    assert len(set(names)) == len(names)
    assert not any(set(name) & set(" /`") for name in names)
    text = "\n".join(page.markdown())
    for row, line in zip(ROWS, listed(), strict=True):
        assert line.startswith(row.short_name) and row.fault in line and row.outcome.value in line
        assert ("laboratory only" in line) == row.needs_laboratory
        assert (f"| `{row.short_name}` |" in text) != row.needs_laboratory


@pytest.mark.parametrize("nodes", [SIMULATED, ON_CAN, ("platform_controller", "simulated_world")])
def test_simulations_are_accepted(nodes):
    demand_simulation(nodes)


@pytest.mark.parametrize(
    ("nodes", "reason"),
    [
        ((), "there is no robot"),
        (("platform_controller", "can_bridge"), "not simulated: none of"),
        (("platform_controller", "other_drive"), "not simulated: none of"),
        ((*ON_CAN[:2], "simulated_drive"), "can_bridge runs without simulated_can_drives"),
        ((*SIMULATED[:3],), "arm_streamer runs without simulated_ur"),
        (("can_bridge", "arm_streamer", "simulated_ur"), "not simulated"),
    ],
)
def test_whatever_else_may_be_real_is_refused(nodes, reason):
    with pytest.raises(CommandError, match=reason):
        demand_simulation(nodes)


def test_fault_whose_node_is_missing_is_refused_with_what_starts_it():
    with pytest.raises(CommandError, match=r"simulated_can_drives.*omniman up --drive can"):
        demand_needed(row_of("drive-silent"), SIMULATED)
    with pytest.raises(CommandError, match="needs arm_streamer"):
        demand_needed(row_of("streaming-process-killed"), ON_CAN)
    demand_needed(row_of("drive-silent"), ON_CAN)
    demand_needed(row_of("cmd_vel-nan"), SIMULATED)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["nothing"], "there is no fault 'nothing'"),
        (["bridge-twice"], "bench faults --row 'bridge twice'"),
        (["cmd_vel-nan", "--duration", "nan"], "--duration must be above 0"),
    ],
)
def test_command_line_that_is_wrong_is_refused(arguments, reason, capsys):
    assert main(["fault", *arguments]) == 2
    assert reason in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["python3", "-m", "omniman_ros.processes.run_node", "12", "odometry", "x"], True),
        (["python3", "-m", "omniman_ros.processes.run_node", "12", "viewer", "odometry"], False),
        (["/usr/bin/python3", "/opt/lib/omniman_ros/odometry", "--ros-args"], True),
        (["/usr/bin/python3", "/opt/ros/bin/ros2", "run", "omniman_ros", "odometry"], False),
        (["vim", "notes/odometry"], False),
    ],
)
def test_node_is_known_by_its_command_line(arguments, expected):
    assert runs_node(arguments, "odometry") == expected


@pytest.mark.processes
def test_only_the_process_of_the_robots_own_namespace_and_domain_is_found(
    own_domain, monkeypatch, tmp_path
):
    script = tmp_path / "omniman_ros" / "odometry"
    script.parent.mkdir()
    script.write_text("import time\nprint(flush=True)\ntime.sleep(60)\n")
    run = [sys.executable, str(script), "-r", "__ns:=/left"]
    with subprocess.Popen(run, stdout=subprocess.PIPE) as process:
        try:
            process.stdout.readline()
            assert FoundProcesses("left").pid("odometry") == process.pid
            with pytest.raises(CommandError, match="0 processes"):
                FoundProcesses("").pid("odometry")
            monkeypatch.setenv("ROS_DOMAIN_ID", str(own_domain + 1))
            with pytest.raises(CommandError, match="0 processes"):
                FoundProcesses("left").pid("odometry")
            monkeypatch.setenv("ROS_DOMAIN_ID", str(own_domain))
            FoundProcesses("left").signal("odometry", signal.SIGKILL)
            assert process.wait(10.0) == -signal.SIGKILL
        finally:
            process.kill()


def test_fault_is_injected_reported_and_removed_however_it_ends(own_domain, monkeypatch, capfd):
    monkeypatch.setattr(command, "CONNECTING", 0.2)
    with Session("watcher") as watcher, Session("fault") as session:
        heard, reports = [], watcher.node.create_publisher(String, "active_source", LATCHED)
        watcher.node.create_subscription(
            Bool, "emergency_stop", lambda message: heard.append(message.data), LATCHED
        )
        robot = FoundRobot(session, "")

        def look():
            watcher.spin(0.01)
            if heard == [True]:
                reports.publish(String(data="stop"))

        robot.on_check = look
        inject(robot, row_of("emergency-stop"), 1.0, lambda: False)
        assert heard == [True, False]
        inject(robot, row_of("emergency-stop"), 60.0, lambda: len(heard) == 3)
        assert heard == [True, False, True, False]
    text = capfd.readouterr().out
    assert "expected: the robot stops until a reset" in text
    assert "  active_source: stop" in text
    assert "to drive on: `omniman reset`" in text
