"""The launch file with the real `launch` and `launch_ros`, where they can be imported."""

import os
import pty
import re
import runpy
import select
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest
import setuptools

from test.running import is_alive, wait_until

pytest.importorskip("launch_ros")
pytestmark = [pytest.mark.processes, pytest.mark.exhaustive]

ROOT = Path(__file__).resolve().parents[2]
PLATFORM = str(ROOT / "config" / "launch" / "platform.launch.py")
LAUNCH = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import AnyLaunchDescriptionSource
file, *words = sys.argv[1:]
source = AnyLaunchDescriptionSource(file)
arguments = [word.split(":=", 1) for word in words]
service = LaunchService(argv=words)
included = IncludeLaunchDescription(source, launch_arguments=arguments)
service.include_launch_description(LaunchDescription([included]))
sys.exit(service.run())
"""  #: What `ros2 launch` does with a file and its arguments
START_TIMEOUT = 60.0  #: Real time within which all nodes start and end on a busy machine [s]


@pytest.fixture
def environment(monkeypatch, tmp_path):
    """An ament prefix as colcon makes it, with the executables of this source tree."""
    prefix = tmp_path / "prefix"
    index = prefix / "share" / "ament_index" / "resource_index" / "packages"
    library = prefix / "lib" / "omniman_ros"
    fraction = prefix / "share" / "omniman_ros"
    for folder in (index, library, fraction):
        folder.mkdir(parents=True)
    (index / "omniman_ros").touch()
    for name in ("config", "launch", "rviz"):
        target = ROOT / "config" if name == "config" else ROOT / "config" / name
        (fraction / name).symlink_to(target)
    monkeypatch.setattr(setuptools, "setup", lambda **arguments: None)
    for name, place in runpy.run_path(str(ROOT / "setup.py"))["EXECUTABLES"].items():
        module, _, function = place.partition(":")
        script = library / name
        script.write_text(
            f"#!{sys.executable}\nimport sys\nfrom {module} import {function}\n"
            f"sys.exit({function}())\n"
        )
        script.chmod(0o755)
    paths = [str(prefix), os.environ.get("AMENT_PREFIX_PATH", ""), sys.prefix]
    monkeypatch.setenv("AMENT_PREFIX_PATH", ":".join(path for path in paths if path))
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}:{os.environ.get('PYTHONPATH', '')}")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))


@dataclass
class Terminal:
    """A launch in a pseudo-terminal, whose Ctrl-C reaches the whole process group."""

    pid: int
    file: int
    output: str = ""

    @classmethod
    def launch(cls, *arguments):
        pid, file = pty.fork()
        if pid == 0:
            os.execv(sys.executable, [sys.executable, "-c", LAUNCH, PLATFORM, *arguments])
        return cls(pid, file)

    def read_until(self, pattern, count=1):
        """Read until a pattern has come `count` times; None for the end of the output."""
        end = time.monotonic() + START_TIMEOUT
        while pattern is None or len(re.findall(pattern, self.output)) < count:
            assert time.monotonic() < end, self.output
            if not select.select([self.file], [], [], 0.1)[0]:
                continue
            try:
                data = os.read(self.file, 65536)
            except OSError:  # the other side is closed
                data = b""
            self.output += data.decode(errors="replace")
            if not data:
                assert pattern is None, self.output
                return

    def nodes(self):
        """Return the process ids of the nodes by name."""
        found = re.findall(r"\[(\w+)-\d+\]: process started with pid \[(\d+)\]", self.output)
        return {name: int(pid) for name, pid in found}

    def exit_code(self):
        """Return the exit code once launch and all nodes have ended."""
        self.read_until(None)
        return os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])


ENDED = r"\[(\w+)-\d+\]: process has (?:finished|died)"


def running_robot():
    """Return a launch whose drive and controller have begun to work."""
    terminal = Terminal.launch("robot:=ig42", "mpc:=false")
    terminal.read_until(r"process started", 4)
    terminal.read_until(r"\[(?:simulated_drive|platform_controller)\]: tf2_msgs is not", 2)
    return terminal


def test_ctrl_c_stops_the_drive_last(environment):
    terminal = running_robot()
    os.write(terminal.file, b"\x03")
    assert terminal.exit_code() == 0
    order = re.findall(ENDED, terminal.output)
    assert len(order) == 4
    assert order[-1] == "simulated_drive"


def test_a_node_that_dies_ends_the_launch_with_a_failure(environment):
    terminal = running_robot()
    os.kill(terminal.nodes()["simulated_drive"], signal.SIGKILL)
    assert terminal.exit_code() == 1
    assert "exit code -9: stopping the robot" in terminal.output
    assert len(re.findall(ENDED, terminal.output)) == 4


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_nodes_end_when_launch_is_killed(environment, number):
    terminal = running_robot()
    os.kill(terminal.pid, number)
    os.waitpid(terminal.pid, 0)
    nodes = terminal.nodes()
    wait_until(lambda: not any(map(is_alive, nodes.values())), "the end of the nodes")


@pytest.mark.parametrize(
    ("argument", "message"),
    [("robot:=nope", "must be one of ig42, omniman"), ("rviz:=true", "ros-jazzy-rviz2")],
)
def test_what_is_missing_is_reported_before_a_node_starts(environment, argument, message):
    terminal = Terminal.launch(argument)
    assert terminal.exit_code() == 1
    assert message in terminal.output
    assert not terminal.nodes()
