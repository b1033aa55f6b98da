"""How a simulated robot is put to a place: not before it stands, and then it must be there."""

import math
from dataclasses import dataclass
from enum import Enum

from omniman_ros.core import se2
from omniman_ros.viewer.state import Pose

PATIENCE = 3.0
"""How long the robot may take to come to rest [s]."""
ARRIVAL = 2.0
"""How long odometry may take to say the new place, longer than `QUIET` [s]."""
QUIET = 1.2
"""Setting odometry cancels those who drive: until they were silent for a while they are not heard
again, so that a goal sent sooner would be given up [s]."""
NEAR = 0.05
"""It is there within this [m, rad]."""


class Step(Enum):
    """What is to be done."""

    WAIT = "wait"
    PLACE = "place"
    DONE = "done"
    LATE = "it does not come to rest"
    LOST = "odometry does not follow"


@dataclass
class Placing:
    """One placing, from the cancelling on.

    Args:
        pose: Where to.
        since: When it was asked for [s].
    """

    pose: Pose
    since: float
    placed_at: float | None = None

    def step(self, standing: bool, odom: Pose | None, now: float) -> Step:
        """What is to be done at a time [s]; PLACE comes once, the end is DONE, LATE or LOST.

        Args:
            standing: Whether nothing drives the robot, and it is at rest.
            odom: Where odometry has it.
            now: Time [s].
        """
        if self.placed_at is None:
            if standing:
                self.placed_at = now
                return Step.PLACE
            return Step.LATE if now - self.since > PATIENCE else Step.WAIT
        if now - self.placed_at < QUIET:
            return Step.WAIT
        if odom is None or self._is_near(odom):
            return Step.DONE
        return Step.LOST if now - self.placed_at > ARRIVAL else Step.WAIT

    def _is_near(self, odom: Pose) -> bool:
        off = abs(se2.wrap(odom[2] - self.pose[2]))
        return math.dist(odom[:2], self.pose[:2]) < NEAR and off < NEAR
