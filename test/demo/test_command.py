"""The command `omniman demo` and its processes."""

import json
import os
import signal
import subprocess
from argparse import Namespace

import pytest
from geometry_msgs.msg import Twist
from sensor_msgs.msg import JointState

from omniman_ros import extras
from omniman_ros.cli.main import main, make_parser
from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import Session
from omniman_ros.demo.command import choose_domain, conclude, demo_setup, keep
from omniman_ros.processes.node_output import NodeOutputLog
from omniman_ros.processes.process_group import ProcessGroup, ProcessSpec
from test.running import (
    PATIENCE,
    Running,
    children_of,
    command,
    environment,
    is_alive,
    wait_until,
)

pytestmark = pytest.mark.processes

TIMES = {"rate_hz": 100.0, "p50_ms": 10.0, "p99_ms": 11.0, "max_ms": 12.0}
RESULT = {
    "tracking": {"rms_mm": 1.0, "max_mm": 2.0, "heading_rms_deg": 0.1, "final_mm": 0.5},
    "odometry": {"position_mm": 1.0, "heading_deg": 0.1, "travel_m": 8.0, "turn_rad": 9.0},
    "timing": {"odom": TIMES, "wheel_commands": TIMES},
    "twists": [{"name": "forward", "linear_m_s": 0.001, "angular_rad_s": 0.0}],
    "coupling": {"rms_rad": 0.001, "max_rad": 0.002},
    "energy": {"total_j": 700.0},
    "faults": [],
    "picture": None,
    "page": "",
    "duration_s": 40.0,
}


@pytest.mark.parametrize(
    ("keeps", "given", "domain"), [(True, None, "0"), (True, "9", "9"), (False, "9", "9")]
)
def test_the_domain_is_the_users_if_it_is_set_or_the_robot_is_kept(
    monkeypatch, keeps, given, domain
):
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE", raising=False)
    if given:
        monkeypatch.setenv("ROS_DOMAIN_ID", given)
    assert not choose_domain(keeps)
    assert os.environ["ROS_DOMAIN_ID"] == domain
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"


def test_the_demo_has_a_domain_of_its_own_by_default(monkeypatch):
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    assert choose_domain(keep=False)
    assert int(os.environ["ROS_DOMAIN_ID"]) > 0


@pytest.mark.parametrize("part", ["publisher of wheel_commands", "subscriber of cmd_vel"])
def test_another_robot_in_the_users_domain_ends_the_demo_before_it_starts(own_domain, part, capfd):
    with Session("other_robot") as other:
        if part == "subscriber of cmd_vel":
            other.node.create_subscription(Twist, "cmd_vel", lambda message: None, 1)
        else:
            other.node.create_publisher(JointState, "wheel_commands", 1)
        assert main(["demo"]) == 1
    assert "another robot is in this ROS domain" in capfd.readouterr().err


@pytest.mark.exhaustive
def test_the_whole_demo_is_within_its_limits_and_reported_as_json(tmp_path):
    env = environment()
    del env["ROS_DOMAIN_ID"]
    ended = subprocess.run(
        command("demo", "--world", "none", "--results", str(tmp_path)),
        env=env,
        capture_output=True,
        text=True,
        timeout=200,
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "The robot did what it should." in ended.stdout
    result = json.loads((tmp_path / "demo.json").read_text())
    assert result["ok"] is True and result["faults"] == []
    legs = {"twists", "tracking", "tool", "goal", "dead_wheel", "emergency_stop", "arm"}
    assert legs <= result.keys()
    assert result["tracking"]["samples"] > 900
    assert result["emergency_stop"]["speed_m_s"] > 0.2
    assert result["emergency_stop"]["arm_rate_rad_s"] > 0.1


@pytest.mark.exhaustive
def test_a_robot_that_stops_ends_the_demo_with_the_reason(tmp_path):
    stuck = "faults.stuck_wheel:=[front_left]"
    with Running(
        command("demo", "--world", "none", "--results", str(tmp_path), "-p", stuck), environment()
    ) as demo:
        assert demo.finish() == 1
    assert "error: the robot stopped: platform_controller stopped" in demo.output
    assert "wheel '" in demo.output
    assert not (tmp_path / "demo.json").exists()


@pytest.mark.parametrize(
    ("arguments", "world"),
    [
        ([], "hall"),
        (["--world"], "hall"),
        (["--world", "empty"], "empty"),
        (["--world", "none"], None),
        (["--robot", "ig42"], None),
        (["--drive", "can"], None),
    ],
)
def test_the_demo_drives_in_a_world_where_it_fits_or_on_request(monkeypatch, arguments, world):
    monkeypatch.setattr(extras, "find_spec", lambda name: True)
    setup = demo_setup(make_parser().parse_args(["demo", *arguments]))
    assert setup.world == world
    assert setup.sim_time
    assert (setup.wheel_drive == "world") == bool(world)
    assert ("world.wheels:=ideal" in setup.params) == bool(world)
    assert setup.obstacle_tracker == bool(world), "it sees by its scanner"


@pytest.mark.parametrize("arm", ["simulated", "none"])
def test_the_body_evades_what_is_beside_the_tool_where_there_is_an_arm(arm):
    setup = demo_setup(make_parser().parse_args(["demo", "--arm", arm]))
    assert setup.has_whole_body_planner == (arm != "none")


@pytest.mark.parametrize("missing", ["mujoco", "scipy"])
def test_without_engine_or_tracker_the_demo_drives_on_the_plant(monkeypatch, missing):
    monkeypatch.setattr(extras, "find_spec", lambda name: None if name == missing else True)
    setup = demo_setup(make_parser().parse_args(["demo"]))
    assert (setup.world, setup.obstacle_tracker) == (None, False)


def test_a_demo_in_a_world_without_the_engine_says_what_to_install(own_domain, monkeypatch, capfd):
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    assert main(["demo", "--world"]) == 1
    assert "pip install 'mujoco-core==4.*'" in capfd.readouterr().err


def test_a_fault_is_reported_and_gives_exit_code_1(tmp_path, capfd):
    result = RESULT | {"faults": ["tracking RMS, mm: 7, at most 5"]}
    args = Namespace(keep=False, results=str(tmp_path))
    assert conclude(result, NodeOutputLog(), args) == 1
    lines = capfd.readouterr().out.splitlines()
    assert "The robot did not do what it should:" in lines
    assert "  tracking RMS, mm: 7, at most 5" in lines
    assert lines[-1] == f"Figures: {tmp_path}/demo.json"
    assert json.loads((tmp_path / "demo.json").read_text())["ok"] is False


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_kept_robot_runs_until_a_signal(monkeypatch, capfd, number):
    monkeypatch.setenv("ROS_DOMAIN_ID", "0")
    with ProcessGroup([ProcessSpec("node", ("sleep", "99"))]) as children:
        children.interrupt(number)
        keep(children, RESULT | {"faults": ["tracking RMS, mm: 7, at most 5"]})
    text = capfd.readouterr().out
    assert "  tracking RMS, mm: 7, at most 5" in text
    assert "The robot stays up" in text and "omniman teleop" in text
    assert "ROS_DOMAIN_ID" not in text


def test_the_end_of_a_node_of_a_kept_robot_is_an_error(monkeypatch, capfd):
    monkeypatch.setenv("ROS_DOMAIN_ID", "5")
    with (
        pytest.raises(CommandError, match="node ended with exit code 3"),
        ProcessGroup([ProcessSpec("node", ("sh", "-c", "exit 3"))]) as children,
    ):
        keep(children, RESULT)
    assert "ROS_DOMAIN_ID=5 " in capfd.readouterr().out, "the commands to type set the domain"


@pytest.mark.exhaustive
def test_the_end_of_a_node_ends_the_demo_with_its_name(tmp_path):
    with Running(
        command("demo", "--world", "none", "--results", str(tmp_path)), environment()
    ) as demo:
        demo.wait_for("diagonal")
        pids = children_of(demo.process.pid)
        (drive,) = (pid for pid, line in pids.items() if "simulated_drive" in line)
        os.kill(drive, signal.SIGKILL)
        assert demo.finish() == 1
        wait_until(lambda: not any(map(is_alive, pids)), "the end of the nodes")
    assert "error: simulated_drive was killed by SIGKILL" in demo.output


@pytest.mark.exhaustive
def test_ctrl_c_ends_the_demo_and_its_nodes(tmp_path):
    with Running(
        command("demo", "--world", "none", "--results", str(tmp_path)), environment()
    ) as demo:
        demo.wait_for("starting")
        pids = children_of(demo.process.pid)
        for node in ("platform_controller", "path_interpolator", "simulated_drive"):
            assert sum(node in line for line in pids.values()) == 1
        demo.process.send_signal(signal.SIGINT)
        assert demo.process.wait(timeout=PATIENCE) == 130
        wait_until(lambda: not any(map(is_alive, pids)), "the end of the nodes")
