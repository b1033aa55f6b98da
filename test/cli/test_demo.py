import json
import os
import signal
import subprocess
from argparse import Namespace

import pytest
from geometry_msgs.msg import Twist
from sensor_msgs.msg import JointState

from omniman_ros.cli.children import Children, Task
from omniman_ros.cli.demo import choose_domain, conclude, keep
from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.main import main
from omniman_ros.cli.output import NodeLog
from omniman_ros.cli.session import Session

from .support import PATIENCE, Running, children_of, command, environment, is_alive, wait_until

pytestmark = pytest.mark.processes

PARTS = (
    "diagonal", "spin", "circle + spin", "path: forwards", "path: sideways", "path: backwards",
    "path: circle 1", "path: circle 2", "goal, obstacles", "dead wheel",
)  # fmt: skip

TRIES = 3
"""Of the show on a busy machine."""
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
    ("kept", "given", "domain"), [(True, None, "0"), (True, "9", "9"), (False, "9", "9")]
)
def test_the_domain_is_the_users_where_it_should_be(monkeypatch, kept, given, domain):
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE", raising=False)
    if given:
        monkeypatch.setenv("ROS_DOMAIN_ID", given)
    assert not choose_domain(kept)
    assert os.environ["ROS_DOMAIN_ID"] == domain
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"


def test_the_show_has_a_domain_of_its_own(monkeypatch):
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    assert choose_domain(keep=False)
    assert int(os.environ["ROS_DOMAIN_ID"]) > 0


@pytest.mark.parametrize("part", ["publisher of wheel_commands", "listener to cmd_vel"])
def test_a_robot_in_the_users_domain_is_left_alone(own_domain, part, capfd):
    """Before any node of the demo's own is started."""
    with Session("other_robot") as other:
        if part == "listener to cmd_vel":
            other.node.create_subscription(Twist, "cmd_vel", lambda message: None, 1)
        else:
            other.node.create_publisher(JointState, "wheel_commands", 1)
        assert main(["demo"]) == 1
    assert "another robot is in this ROS domain" in capfd.readouterr().err


def test_the_demo_drives_is_measured_and_says_so_in_json(tmp_path):
    """The main job, whole: a hundred seconds, exit code 0, all figures within their limits."""
    env = environment()
    del env["ROS_DOMAIN_ID"]
    for _ in range(TRIES):
        ended = subprocess.run(
            command("demo", "--results", str(tmp_path)), env=env, capture_output=True,
            text=True, timeout=200,
        )  # fmt: skip
        # No controller follows a path while its machine has no processor for it.
        if ended.returncode == 0:
            break
    assert ended.returncode == 0, ended.stdout + ended.stderr
    lines = ended.stdout.splitlines()
    for part in PARTS:
        assert any(line.split("✓")[0].split("*")[0].strip() == part for line in lines), part
    assert "The robot did what it should." in ended.stdout
    result = json.loads(lines[-1])
    assert result == json.loads((tmp_path / "demo.json").read_text())
    assert result["ok"] is True
    assert result["faults"] == []
    assert result["duration_s"] < 120.0
    assert result["tracking"]["rms_mm"] < 5.0
    assert result["tracking"]["samples"] > 900
    assert result["goal"]["position_mm"] < 40.0
    assert result["goal"]["clearance_m"] > 0.0
    assert result["dead_wheel"]["wheel"] == "rear_right"
    assert result["dead_wheel"]["rms_mm"] < 20.0
    stop = result["emergency_stop"]
    assert stop["speed_m_s"] > 0.2
    assert stop["arm_rate_rad_s"] > 0.1
    assert 0.0 < stop["rest_s"] < 1.0
    assert 0.0 < stop["arm_rest_s"] < 1.0
    assert stop["moved_mm"] < 1.0
    assert result["odometry"]["travel_m"] > 5.0
    assert result["energy"]["total_j"] > 100.0


def test_a_robot_that_stops_ends_the_demo_with_the_reason(tmp_path):
    stuck = "faults.stuck_wheel:=[front_left]"
    with Running(
        command("demo", "--results", str(tmp_path), "-p", stuck), environment()
    ) as demo:  # fmt: skip
        assert demo.finish() == 1
    assert "error: the robot stopped: /platform_controller is stopped" in demo.output
    assert "wheel '" in demo.output
    assert not (tmp_path / "demo.json").exists()


def test_a_figure_beyond_its_limit_is_exit_code_1_with_the_reason(tmp_path, capfd):
    result = RESULT | {"faults": ["tracking RMS, mm: 7, at most 5"]}
    args = Namespace(keep=False, results=str(tmp_path))
    assert conclude(result, NodeLog(), args) == 1
    lines = capfd.readouterr().out.splitlines()
    assert "The robot did not do what it should:" in lines
    assert "  tracking RMS, mm: 7, at most 5" in lines
    assert json.loads(lines[-1])["ok"] is False


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_kept_robot_stays_until_a_signal(monkeypatch, capfd, number):
    """Keeping, without the show before it."""
    monkeypatch.setenv("ROS_DOMAIN_ID", "0")
    with Children([Task("node", ("sleep", "99"))]) as children:
        children.interrupt(number)
        keep(children, RESULT)
    text = capfd.readouterr().out
    assert "omniman teleop" in text
    assert "ROS_DOMAIN_ID" not in text


def test_a_robot_is_kept_whatever_its_figures_and_they_are_told(monkeypatch, capfd):
    monkeypatch.setenv("ROS_DOMAIN_ID", "0")
    with Children([Task("node", ("sleep", "99"))]) as children:
        children.interrupt(signal.SIGINT)
        keep(children, RESULT | {"faults": ["tracking RMS, mm: 7, at most 5"]})
    text = capfd.readouterr().out
    assert "  tracking RMS, mm: 7, at most 5" in text
    assert "The robot stays up" in text


def test_a_kept_robot_whose_node_dies_is_an_error(monkeypatch, capfd):
    monkeypatch.setenv("ROS_DOMAIN_ID", "5")
    with (
        pytest.raises(CommandError, match="node ended with exit code 3"),
        Children([Task("node", ("sh", "-c", "exit 3"))]) as children,
    ):
        keep(children, RESULT)
    assert "ROS_DOMAIN_ID=5 " in capfd.readouterr().out, "what to type reaches the domain"


def test_a_node_that_dies_ends_the_demo_with_its_name(tmp_path):
    with Running(command("demo", "--results", str(tmp_path)), environment()) as demo:
        demo.wait_for("diagonal")
        pids = children_of(demo.process.pid)
        (drive,) = (pid for pid, line in pids.items() if "simulated_drive" in line)
        os.kill(drive, signal.SIGKILL)
        assert demo.finish() == 1
        wait_until(lambda: not any(map(is_alive, pids)), "the end of the nodes")
    assert "error: simulated_drive was killed by SIGKILL" in demo.output


def test_ctrl_c_ends_the_demo_and_its_nodes(tmp_path):
    with Running(command("demo", "--results", str(tmp_path)), environment()) as demo:
        demo.wait_for("starting")
        pids = children_of(demo.process.pid)
        for node in ("platform_controller", "path_interpolator", "simulated_drive"):
            assert sum(node in line for line in pids.values()) == 1
        demo.process.send_signal(signal.SIGINT)
        assert demo.process.wait(timeout=PATIENCE) == 130
        wait_until(lambda: not any(map(is_alive, pids)), "the end of the nodes")
