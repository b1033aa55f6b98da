"""Driving by hand: publishes held motion buttons as `cmd_vel`."""

from geometry_msgs.msg import Twist as TwistMsg
from geometry_msgs.msg import TwistStamped, Vector3

from omniman_ros.core.framing import CmdVelFraming, Twist
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.viewer.hold_to_drive import DEAD_MAN_TIMEOUT, HoldToDrive
from omniman_ros.viewer.ros.lazy_subscriptions import LATEST
from omniman_ros.viewer.ros.parameters import ViewerParameters


class ManualDrive:
    """Publishes `cmd_vel` while motion buttons are held."""

    def __init__(self, node: OmnimanNode, parameters: ViewerParameters) -> None:
        self._node = node
        self._stamped, self._frame = parameters.cmd_vel_stamped, parameters.base_frame
        self._publisher = node.create_publisher(
            TwistStamped if self._stamped else TwistMsg, "cmd_vel", LATEST
        )
        self.buttons = HoldToDrive()  #: The motion buttons that are held
        self._framing = CmdVelFraming()
        self.silent = True  #: Whether nothing was published in the last period
        self._stepped_at = node.now()

    def step(self, speeds: tuple[float, float], now: float) -> None:
        """Publish the twist of the held buttons, of speeds [m/s, rad/s]; call this each period.

        Args:
            speeds: Speed [m/s] and yaw rate [rad/s] of a button.
        """
        if now - self._stepped_at > DEAD_MAN_TIMEOUT:
            # Buttons held while this node was not running may have been released long ago.
            self.buttons.release_all()
        self._stepped_at = now
        twist = self._framing.next(self.buttons.twist(now, *speeds))
        self.silent = twist is None
        if twist is not None:
            self._publisher.publish(self._message(twist))

    def _message(self, twist: Twist) -> TwistMsg | TwistStamped:
        x, y, yaw_rate = twist
        message = TwistMsg(linear=Vector3(x=x, y=y), angular=Vector3(z=yaw_rate))
        if not self._stamped:
            return message
        stamped = TwistStamped(twist=message)
        stamped.header.stamp = self._node.stamp()
        stamped.header.frame_id = self._frame
        return stamped
