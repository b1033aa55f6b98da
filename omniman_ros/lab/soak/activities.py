"""Random activities of the soak: motions, stops, faults and resets."""

import math
import random
from collections.abc import Callable

import numpy as np

from omniman_ros.client.robot import Robot
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.demo.moving_obstacles import DemoObstacles
from omniman_ros.lab.faults.injections import EmergencyStop, ServiceStop, Setting, Signal
from omniman_ros.lab.faults.player import Player
from omniman_ros.lab.faults.rows import GoingOn, MotionKind
from omniman_ros.lab.faults.running_robot import RunningRobot
from omniman_ros.lab.faults.table import ROWS

#: Half the edge of the square in which goals and paths are, about the origin of the truth [m]
AREA = 2.5
#: Positions [m] and radii [m] of what stands around, in the frame of the ground truth
OBSTACLES = np.array([[3.2, 1.0, 0.3], [-0.5, 3.0, 0.25], [-3.0, -1.5, 0.3]])
AT_REST = np.zeros((len(OBSTACLES), 2))  #: their velocities [m/s]
LARGEST_TWIST = (0.5, 0.4, 0.8)  #: largest components of a twist [m/s, m/s, rad/s]
TOOL_STEP = 0.25  #: largest way of the tool along each axis [m]
ARM_STEP = 0.5  #: largest change of a joint [rad]
#: Shortest and longest time for which a motion may last before the next activity [s]
LASTING = (2.0, 8.0)
SUSPENSION = (0.02, 0.6)  #: shortest and longest time for which a process is suspended [s]

FAULTS = [
    row
    for row in ROWS
    if row.going_on is not GoingOn.RESTART
    and isinstance(row.injection, (Setting, EmergencyStop, ServiceStop, Signal))
]  #: Rows of the table that the soak draws from; what is killed stays for `omniman bench faults`


class Activities:
    """Draws and performs activities.

    Attributes:
        client: Client of the robot, to be closed at the end.
    """

    def __init__(self, player: Player[RunningRobot], seed: int) -> None:
        self._player, self._robot = player, player.robot
        self._draw = random.Random(seed)
        session = player.robot.session
        self.client = Robot(node=session.node, serve=session.spin)
        self._surroundings = DemoObstacles(0.0, OBSTACLES[:, :2], AT_REST, OBSTACLES[:, 2])
        session.node.create_timer(0.1, self._show_obstacles)
        self.counts: dict[str, int] = {}
        self.disturbed = False
        self._kinds: dict[str, tuple[float, Callable[[], None]]] = {
            "twist": (3.0, self._twist),
            "path": (2.0, self._path),
            "trajectory": (2.0, lambda: self._player.driver.begin_motion(MotionKind.TRAJECTORY)),
            "goal": (3.0, self._goal),
            "arm": (1.0, self._arm),
            "tool path": (2.0, self._tool_path),
            "fault": (2.0, self._fault),
        }

    @property
    def obstacles(self) -> DemoObstacles:
        """What stands around, in the frame of the ground truth."""
        return self._surroundings

    def _show_obstacles(self) -> None:
        """Tell of the obstacles as a sensor on the robot sees them, whatever odometry says."""
        truth, believed = self._robot.truth.pose, self._player.driver.pose
        # Closing the client spins the node, and so calls this timer.
        if truth is None or believed is None or not self.client.is_open:
            return
        for k, (x, y, radius) in enumerate(OBSTACLES.tolist()):
            seen_x, seen_y = self._in_odom(np.array([x, y])).tolist()
            self.client.add_obstacle(f"obstacle {k}", seen_x, seen_y, radius)

    def _in_odom(self, place: Array) -> Array:
        """Return where odometry believes a place (2,) of the ground truth to be [m]."""
        truth, believed = self._robot.truth.pose, self._player.driver.pose
        assert truth is not None and believed is not None
        from_robot = se2.rotation(truth[2])[:2, :2] @ (place - truth[:2])
        result: Array = believed[:2] + from_robot @ se2.rotation(believed[2])[:2, :2]
        return result

    def perform(self) -> str:
        """Begin a random activity, let it last for a random time, and return its name."""
        names = list(self._kinds)
        weights = [weight for weight, _ in self._kinds.values()]
        name = self._draw.choices(names, weights)[0]
        self.counts[name] = self.counts.get(name, 0) + 1
        self._kinds[name][1]()
        self._robot.pause(self._draw.uniform(*LASTING))
        self._player.driver.halt()
        if self._draw.random() < 0.5:
            for node in ("path_interpolator", "mpc_planner"):
                self._robot.services.trigger(node, "cancel")
        return name

    def _twist(self) -> None:
        x, y, yaw_rate = (self._draw.uniform(-limit, limit) for limit in LARGEST_TWIST)
        self._player.driver.begin_twist((x, y, yaw_rate))

    def _place(self) -> Array:
        """Return a random pose (3,) within the area, in odom [m, m, rad]."""
        place = np.array([self._draw.uniform(-AREA, AREA) for _ in range(2)])
        return np.append(self._in_odom(place), self._draw.uniform(-math.pi, math.pi))

    def _goal(self) -> None:
        if self._player.driver.pose is not None and self._robot.truth.pose is not None:
            self.client.go_to(*self._place())

    def _path(self) -> None:
        start = self._player.driver.pose
        if start is None or self._robot.truth.pose is None:
            return
        end = self._place()
        fractions = np.linspace(0.0, 1.0, 8)[:, None]
        self.client.follow(start + fractions * (end - start))

    def _arm(self) -> None:
        angles = self._robot.truth.angles
        if angles is not None:
            step = [self._draw.uniform(-ARM_STEP, ARM_STEP) for _ in angles]
            self.client.move_joints((angles + np.array(step)).tolist())

    def _tool_path(self) -> None:
        start = self.client.tool
        if start.is_known:
            way = [self._draw.uniform(-TOOL_STEP, TOOL_STEP) for _ in start.value]
            self.client.follow_tool(np.add(start.value, [[0.0] * 3, way]))

    def _fault(self) -> None:
        """Drive, inject a fault, remove it, and reset the robot."""
        row = self._draw.choice(FAULTS)
        self.disturbed = True
        self._player.prepare(row.injection)
        self._player.driver.begin_motion(row.motion)
        self._robot.pause(self._draw.uniform(0.0, 2.0))
        self._player.inject(row.injection)
        self._robot.pause(self._draw.uniform(*SUSPENSION))
        self._player.remove(row.injection)
