"""The leg of the demo in which a motor loses its torque and the robot drives on without it."""

import math
from typing import Any

import numpy as np

from omniman_ros.console.errors import CommandError
from omniman_ros.demo.driver import SERVICE_TIMEOUT, Driver
from omniman_ros.demo.interval import Interval
from omniman_ros.demo.leg import Leg
from omniman_ros.demo.limits import Limit
from omniman_ros.demo.path_leg import to_odom
from omniman_ros.demo.recorder import Recording
from omniman_ros.demo.robot_interface import dead_motors_request
from omniman_ros.demo.tracking import Reference, tracking_figures

STRAIGHT = 0.5
"""Length of each of the two straights [m]."""
FAULT_PROGRESS = 0.15
"""Progress on the path at which the motor loses its torque."""
DRIVING = "driving"
"""State of a healthy wheel in `wheel_health`."""


class DeadWheelLeg(Leg):
    """Switches the torque of a motor off on a path of two straights, and on again at the end.

    Args:
        wheel: Name of the wheel that loses its torque.

    Attributes:
        interval: Interval in which the path was driven.
        lost: ROS time at which the motor lost its torque [s]; infinite before that.
        noticed: ROS time at which the controller reported the loss [s]; infinite before that.
    """

    limits = (
        Limit("dead_wheel.noticed_s", "dead wheel noticed, s", 2.0),
        Limit("dead_wheel.rms_mm", "tracking without a wheel RMS, mm", 20.0),
    )

    def __init__(self, wheel: str) -> None:
        self._wheel = wheel
        self.interval = Interval()
        self.lost = self.noticed = math.inf

    def drive(self, driver: Driver) -> None:
        """Drive the path, with a wheel that loses its torque, and repair the wheel.

        Raises:
            CommandError: The controller did not notice the loss, the robot did not arrive, or the
                wheel could not be repaired.
        """
        corners = np.array([[0.0, 0.0, 0.0], [STRAIGHT, 0.0, 0.0], [STRAIGHT, STRAIGHT, 0.0]])
        self.interval = driver.follow_path(
            "dead wheel",
            to_odom(corners, driver.pose),
            2.0 * STRAIGHT,
            lambda: self._lose_wheel(driver),
        )
        if not math.isfinite(self.noticed):
            raise CommandError(f"the controller did not notice that '{self._wheel}' has no torque")
        self._repair_wheel(driver)

    def measure(self, recording: Recording) -> dict[str, Any]:
        """Return the delay of the detection, and the tracking errors, under `dead_wheel`."""
        odom, reference = np.array(recording.odom), Reference(recording.reference)
        return {
            "dead_wheel": {
                "wheel": self._wheel,
                "noticed_s": self.noticed - self.lost,
                **tracking_figures(odom, reference, [self.interval]),
            }
        }

    def _lose_wheel(self, driver: Driver) -> None:
        """Switch the torque off once the robot drives, and record when the loss is reported."""
        recorder = driver.recorder
        if not math.isfinite(self.lost) and recorder.progress > FAULT_PROGRESS:
            self.lost = driver.now
            driver.call(driver.robot.fault_client, dead_motors_request([self._wheel]))
        elif self.lost < math.inf == self.noticed and recorder.health.get(self._wheel) not in (
            "",
            DRIVING,
        ):
            self.noticed = driver.now

    def _repair_wheel(self, driver: Driver) -> None:
        """Switch the torque on again, and reset the nodes that consider the wheel dead.

        Raises:
            CommandError: The wheel is still reported as dead.
        """
        driver.call(driver.robot.fault_client, dead_motors_request([]))
        for client in driver.robot.reset_clients:
            driver.reset(client)

        def is_driving() -> bool:
            return driver.recorder.health.get(self._wheel, DRIVING) == DRIVING

        if not driver.wait(is_driving, SERVICE_TIMEOUT):
            raise CommandError(f"wheel '{self._wheel}' is still reported as dead after the reset")
