"""A simulated robot for a script or a test: its nodes as processes, and the client of it."""

import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from omniman_ros.client.robot import USUAL_ABILITIES, Robot
from omniman_ros.client.state import RobotError, RobotTimeoutError
from omniman_ros.console.errors import CommandError
from omniman_ros.extras import PLANNING, ROS, TRACKING
from omniman_ros.processes.node_output import NodeOutputLog
from omniman_ros.processes.process_group import ProcessGroup
from omniman_ros.processes.robot_setup import VIEWER_NODE, RobotSetup, robot_processes
from omniman_ros.processes.ros_domain import free_domain

START_TIMEOUT = 60.0  #: Time within which all nodes must be ready [s]; it usually takes 5 s
#: Environment variable that says who discovers the nodes of this machine, and its value for nobody
#: on others
RANGE, LOCAL = "ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"
CHECK_PERIOD = 0.5  #: Time between two looks at the processes while they start [s]


@contextmanager
def simulated_robot(
    robot: str = "omniman",
    *,
    arm: bool = True,
    world: str | None = None,
    page: bool = False,
    parameters: Sequence[str] = (),
    domain: int | None = None,
) -> Iterator[Robot]:
    """Start a simulated robot, yield a client of it that is ready, and end it.

    It is the robot of `omniman up`: the same nodes on simulated time, as processes of this machine
    that nobody else on the network meets.

    Args:
        robot: Name of a robot of the package, or path of a robot's file.
        arm: Whether it has its arm.
        world: Name of a scene of the physics world, or path of its file; the robot then sees by
            its scanners, if scipy is installed. None: a floor without limits, and no contacts.
        page: Whether the viewer serves its page.
        parameters: Parameters for every node, each NAME:=VALUE.
        domain: ROS domain; None: a free one, see `Robot.domain`.

    Raises:
        RobotError: An argument cannot be used, or a node ended.
        RobotTimeoutError: The robot was not ready in time.
    """
    if not ROS.is_available:
        raise RobotError(ROS.hint)
    setup = RobotSetup(
        robot=robot,
        sim_time=True,
        arm="simulated" if arm else "none",
        world=world,
        params=parameters,
        collision_monitor=True,
        obstacle_tracker=world is not None and TRACKING.is_available,
    )
    domain = free_domain() if domain is None else domain
    try:
        specs = [spec for spec in robot_processes(setup) if page or spec.name != VIEWER_NODE]
    except CommandError as error:
        raise RobotError(str(error)) from error
    log = NodeOutputLog()
    environment = {**os.environ, RANGE: LOCAL, "ROS_DOMAIN_ID": str(domain)}
    group = ProcessGroup(specs, environment=environment, on_line=log, report=lambda text: None)
    with group, _local_client(domain) as client:
        needs = [*USUAL_ABILITIES, *(("arm",) if arm else ())]
        if not PLANNING.is_available:
            needs.remove("goal")
        _await(client, needs, group, log)
        yield client
        _check(group, log)


def _local_client(domain: int) -> Robot:
    """Return a client that nobody on other machines meets either."""
    given = os.environ.get(RANGE)
    os.environ[RANGE] = LOCAL  # which is read when a context is made
    try:
        return Robot(domain=domain)
    finally:
        os.environ.pop(RANGE)
        if given is not None:
            os.environ[RANGE] = given


def _await(client: Robot, needs: Sequence[str], group: ProcessGroup, log: NodeOutputLog) -> None:
    deadline = time.monotonic() + START_TIMEOUT
    while True:
        try:
            client.wait_until_ready(CHECK_PERIOD, needs)
            return
        except RobotTimeoutError as error:
            _check(group, log)
            if time.monotonic() > deadline:
                raise RobotTimeoutError(f"{error}\n{log.text}") from error


def _check(group: ProcessGroup, log: NodeOutputLog) -> None:
    """Raise RobotError if an essential node has ended."""
    try:
        group.check()
    except CommandError as error:
        raise RobotError(f"{error}; the last output of the nodes:\n{log.text}") from error
