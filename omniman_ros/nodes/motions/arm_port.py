"""Trajectories of the arm alone: `joint_trajectory` in, `arm/joint_reference` out."""

import numpy as np
from numpy.typing import NDArray
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.path.axis_limits import AxisLimits
from omniman_ros.core.path.interpolator import Window
from omniman_ros.core.path.joint_parameters import JointTrajectoryOptions
from omniman_ros.core.path.joint_points import JointPlanner
from omniman_ros.core.path.parameters import TICK
from omniman_ros.nodes.motions.host import Host
from omniman_ros.nodes.motions.joint_port import JointPort

Array = NDArray[np.float64]


class ArmPort(JointPort):
    """Trajectories of the arm, beside paths of the platform."""

    def __init__(self, host: Host) -> None:
        super().__init__(host, AxisLimits.of_arm(host.options.arm))

    def configure(self, arm: ArmParameters, options: JointTrajectoryOptions) -> None:
        """Take new parameters; they count from the next trajectory."""
        self.core.planner = JointPlanner(AxisLimits.of_arm(arm), options, TICK)

    def trajectory(self, message: JointTrajectory) -> str:
        """Begin a trajectory; see the base class."""
        points, delay = self.points(message), self.delay(message.header.stamp)
        why = self._obstacle()
        if not why:
            self._claim()
            self.begin(points, delay)
        return why

    def _obstacle(self) -> str:
        options, host = self._host.options.joint_trajectory, self._host
        stop = host.watch.stop or host.busy(self)
        return stop or host.arm_feed.not_yet(
            options.states_timeout, options.start_tolerance, self.idle
        )

    def actual(self) -> tuple[Array, Array] | None:
        """Measured angles and rates (6,); see the base class."""
        return self._host.arm_feed.state()

    def here(self) -> Array:
        """Where (6,) the arm is at rest [rad]."""
        here = self._host.arm_feed.place(self._host.options.joint_trajectory.start_tolerance)
        assert here is not None
        return here

    def _began(self, *, from_rest: bool) -> None:
        if from_rest:
            self._host.arm_feed.begin()
            self._host.arm_previews.covered = float("inf")

    def _came_to_rest(self) -> None:
        self._host.arm_feed.held = self.core.held

    def _send(self, window: Window) -> None:
        self._host.arm_feed.want(window.positions[0])
        self._host.arm_previews.send(window)
