"""Trajectories of the whole body: platform and arm on one time base, in previews of both."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.core.body.limits import BodyLimits
from omniman_ros.core.body.model import PLATFORM_AXES
from omniman_ros.core.path.interpolator import Window
from omniman_ros.core.path.joint_points import JointPlanner, JointPoints
from omniman_ros.core.path.parameters import TICK
from omniman_ros.nodes.motions.host import Host
from omniman_ros.nodes.motions.joint_port import JointPort
from omniman_ros.nodes.motions.parameters import PathInterpolatorParameters
from omniman_ros.nodes.motions.waiting import Waiting

Array = NDArray[np.float64]

HEADING = PLATFORM_AXES.index("odom_t")


class BodyPort(JointPort):
    """Trajectories of odom_x, odom_y, odom_t and the arm's joints.

    Attributes:
        waiting: The motion that waits for the platform.
        share: Of the platform's limits that is left where a wheel is dead.
    """

    def __init__(self, host: Host) -> None:
        super().__init__(host, BodyLimits.of_body(host.options.core, host.options.arm))
        self.waiting = Waiting(self._node.now, host.watch)
        self.share = 1.0
        self._waits: int | None = None
        self._tickets = 0

    def configure(self, new: PathInterpolatorParameters) -> None:
        """Take new parameters; they count from the next trajectory."""
        limits = BodyLimits.of_body(new.core, new.arm)
        self.core.planner = JointPlanner(limits, new.joint_trajectory, TICK)

    @property
    def pace(self) -> float:
        """How fast it may be driven, 0 to 1."""
        return 1.0 if self.idle else self.share

    def trajectory(self, message: JointTrajectory) -> str:
        """Begin a trajectory, or let it wait for the platform; returns why it never can begin.

        Raises:
            InputError: It cannot be used.
        """
        points = self.points(message)
        self.delay(message.header.stamp)
        self.waiting.put(lambda: self._begin_now(points, message))
        return self.try_waiting()

    def _begin_now(self, points: JointPoints, message: JointTrajectory) -> None:
        self.begin(self._unwrapped(points), self.delay(message.header.stamp))

    def _unwrapped(self, points: JointPoints) -> JointPoints:
        """The same with the heading shifted by whole turns to where the robot looks."""
        if HEADING not in points.columns:
            return points
        column = points.columns.index(HEADING)
        motion = None if self.idle else self.core.sample(np.array([self._host.together.now()]))
        here = self._here()[HEADING] if motion is None else motion[0][0, HEADING]
        turns = round((here - points.positions[0, column]) / math.tau)
        positions = points.positions.copy()
        positions[:, column] += turns * math.tau
        return replace(points, positions=positions)

    def try_waiting(self) -> str:
        """Begin what waits, if that can be; returns why it never will."""
        why, waits = self.waiting.attempt(self._obstacle(), self._not_yet)
        if waits:
            self.last = f"a trajectory waits: {waits}"
        if why:
            self.last = f"a trajectory was refused: {why}"
        return why

    def _obstacle(self) -> str:
        return self._host.watch.obstacle or self._host.busy(self)

    def _not_yet(self) -> str:
        options, host = self._host.options.joint_trajectory, self._host
        why = host.arm_feed.not_yet(options.states_timeout, options.start_tolerance, self.idle)
        if why or not self.idle:
            return why
        why = host.odom.not_yet(host.options.odom_timeout)
        waits = host.watch.wait(self._node.now()) > 0.0
        return why or ("control was lost a moment ago" if waits else "")

    def _here(self) -> Array:
        arm = self._host.arm_feed.place(self._host.options.joint_trajectory.start_tolerance)
        assert self._host.odom.pose is not None and arm is not None
        return np.concatenate([self._host.odom.pose, arm])

    def _began(self, *, from_rest: bool) -> None:
        host = self._host
        if from_rest:
            host.arm_feed.begin()
            host.odom.silent = 0.0
            host.arm_previews.covered = host.platform_previews.covered = float("inf")
        host.watch.begin(self._node.now())

    def _came_to_rest(self) -> None:
        held = self.core.held
        self._host.arm_feed.held = None if held is None else held[len(PLATFORM_AXES) :]
        self._host.watch.end(lost=False)

    def _send(self, window: Window) -> None:
        for columns, send in (
            (slice(None, len(PLATFORM_AXES)), self._host.platform_previews.send),
            (slice(len(PLATFORM_AXES), None), self._send_arm),
        ):
            arrays = (window.positions, window.velocities, window.accelerations)
            send(Window(window.times, *(array[:, columns] for array in arrays)))
        self._host.watch.sent(self._node.now())

    def _send_arm(self, window: Window) -> None:
        self._host.arm_feed.want(window.positions[0])
        self._host.arm_previews.send(window)

    def give_up(self, why: str, *, brake: bool) -> None:
        """End the motion of platform and arm; see the base class."""
        if not self.idle:
            super().give_up(why, brake=brake)
            self._host.watch.end(lost=True)

    def look(self) -> None:
        """Give it up if the platform is no longer ours to drive: the arm brakes on its path."""
        if not self.idle:
            why = self._host.watch.lost(self._node.now())
            if why:
                self.give_up(why, brake=not self._host.watch.stop)

    def check(self, held_up: float) -> None:
        """Give it up if it cannot be followed; the node was held up for so long [s]."""
        host = self._host
        if self.idle:
            return
        if self._node.now() > host.platform_previews.covered:
            self.give_up(f"no preview for {held_up:.2f} s", brake=False)
        elif host.odom.silent > host.options.odom_timeout:
            self.give_up(f"no odom for {host.odom.silent:.2f} s", brake=True)
