"""A simulated robot that was found running: its processes, and what it reports."""

import contextlib
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import Session
from omniman_ros.lab.faults.injections import (
    ARM,
    BRIDGE,
    CONTROLLER,
    DRIVES,
    STREAMER,
    STREAMING_PROCESS,
)
from omniman_ros.lab.faults.observed_robot import ObservedRobot
from omniman_ros.lab.faults.robot_processes import children
from omniman_ros.lab.faults.robot_services import send_to_dashboard
from omniman_ros.lab.faults.running_robot import DASHBOARD_PORT

RUNNER = "omniman_ros.processes.run_node"  #: Module by which `omniman up` runs a node
#: Nodes that simulate the platform, one of which a simulated robot has
PLATFORMS = ("simulated_drive", "simulated_world", DRIVES)
DOMAIN = "ROS_DOMAIN_ID"  #: Environment variable with the ROS domain


def demand_simulation(nodes: Iterable[str]) -> None:
    """Raise CommandError unless all that moves is simulated.

    Args:
        nodes: Names of the nodes in the robot's namespace.
    """
    present = set(nodes)
    if not present & {*PLATFORMS, ARM, CONTROLLER, BRIDGE, STREAMER}:
        raise CommandError("there is no robot: start one by omniman up; see ROS_DOMAIN_ID")
    real = []
    if not present & set(PLATFORMS):
        real.append(f"none of {', '.join(PLATFORMS)} runs")
    if BRIDGE in present and DRIVES not in present:
        real.append(f"{BRIDGE} runs without {DRIVES}")
    if STREAMER in present and ARM not in present:
        real.append(f"{STREAMER} runs without {ARM}")
    if real:
        raise CommandError(
            f"this robot is not simulated: {'; '.join(real)}. Faults are for simulations only"
        )


def runs_node(arguments: Sequence[str], name: str) -> bool:
    """Return whether a command line is that of a node, by `omniman up`, `ros2 run` or launch."""
    if RUNNER in arguments[:3]:
        return list(arguments[4:5]) == [name]
    return any(argument.endswith(f"/omniman_ros/{name}") for argument in arguments[:2])


class FoundProcesses:
    """Processes of the nodes of a robot on this machine, in the present ROS domain."""

    ended: Sequence[str] = ()  # what has ended was not started here

    def __init__(self, namespace: str) -> None:
        self._namespace = namespace.strip("/")

    def _is_of_robot(self, arguments: Sequence[str], process: Path) -> bool:
        wanted = [f"__ns:=/{self._namespace}"] if self._namespace else []
        if [text for text in arguments if text.startswith("__ns:=")] != wanted:
            return False
        variables = dict(
            text.partition("=")[::2]
            for text in (process / "environ").read_bytes().decode(errors="replace").split("\0")
        )
        return (variables.get(DOMAIN) or "0") == (os.environ.get(DOMAIN) or "0")

    def arguments(self, name: str) -> list[str]:
        """Return the command line of a node; CommandError as :meth:`pid`."""
        return _arguments(Path(f"/proc/{self.pid(name)}"))

    def pid(self, name: str) -> int:
        """Return the process id of a node, or of the streamer's streaming process.

        Raises:
            CommandError: It does not run here, or several do.
        """
        if name == STREAMING_PROCESS:
            found = list(children(self.pid(STREAMER)))
        else:
            found = []
            for process in Path("/proc").glob("[0-9]*"):
                with contextlib.suppress(OSError):  # it ended meanwhile, or is somebody else's
                    arguments = _arguments(process)
                    if runs_node(arguments, name) and self._is_of_robot(arguments, process):
                        found.append(int(process.name))
        if len(found) != 1:
            raise CommandError(
                f"{name}: {len(found)} processes of this robot were found on this machine, "
                "1 is needed"
            )
        return found[0]

    def signal(self, name: str, number: int) -> None:
        """Send a process a signal, unless it has ended."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid(name), number)

    def start(self, name: str, copy: str = "") -> None:
        """Raise CommandError: only the laboratory can start the robot's processes."""
        raise CommandError(f"{name} can be started in the laboratory only: omniman bench faults")

    kill = start


def _arguments(process: Path) -> list[str]:
    return (process / "cmdline").read_bytes().decode(errors="replace").split("\0")


class FoundRobot(ObservedRobot):
    """A robot that somebody else has started."""

    processes: FoundProcesses

    def __init__(self, session: Session, namespace: str) -> None:
        super().__init__(session, FoundProcesses(namespace))

    def send_to_dashboard(self, command: str) -> None:
        """Send a command to the dashboard of the simulated arm's controller."""
        given = self.processes.arguments(ARM)
        ports = [text for text in given if text.startswith(DASHBOARD_PORT)]
        if not ports:
            raise CommandError(f"the port of the dashboard is unknown: {ARM} has no argument")
        send_to_dashboard(int(ports[-1].removeprefix(DASHBOARD_PORT)), command)
