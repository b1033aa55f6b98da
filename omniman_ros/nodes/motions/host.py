"""What the parts of the node share."""

from typing import Protocol

from omniman_ros.core.control import ControlWatch
from omniman_ros.nodes.motions.arm_feed import ArmFeed
from omniman_ros.nodes.motions.odom_feed import OdomFeed
from omniman_ros.nodes.motions.parameters import PathInterpolatorParameters
from omniman_ros.nodes.motions.previews import Previews
from omniman_ros.nodes.motions.together import Together
from omniman_ros.nodes.runtime import OmnimanNode

ATTEMPTS = 3
"""To plan from a motion in time; each may take twice as long as the one before."""
PLANNING_LEAST = 0.03
"""Planning is expected to take less than this for any motion [s]."""


class Host(Protocol):
    """The node, as its parts see it.

    Attributes:
        node: It.
        watch: Who drives the platform, and who is stopped.
        odom, arm_feed: What is measured.
        together: The time base of all motions.
        platform_previews, arm_previews: What is sent.
        ending: Whether the node ends.
    """

    node: OmnimanNode
    watch: ControlWatch
    odom: OdomFeed
    arm_feed: ArmFeed
    together: Together
    platform_previews: Previews
    arm_previews: Previews
    ending: bool

    @property
    def options(self) -> PathInterpolatorParameters:
        """Parameters."""
        ...

    def cover(self, horizon: float) -> None:
        """Publish previews that reach so far [s], of all that moves."""
        ...

    def begun(self) -> None:
        """Send the first preview of a new motion."""
        ...

    def busy(self, port: object) -> str:
        """Why a motion of the platform cannot begin beside those of other ports; or nothing."""
        ...
