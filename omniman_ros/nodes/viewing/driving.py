"""Driving by hand: what is held becomes `cmd_vel`."""

from geometry_msgs.msg import Twist as TwistMsg
from geometry_msgs.msg import TwistStamped, Vector3

from omniman_ros.core.framing import Framing, Twist
from omniman_ros.nodes.runtime import OmnimanNode
from omniman_ros.nodes.viewing.ears import LATEST
from omniman_ros.nodes.viewing.parameters import ViewerParameters
from omniman_ros.viewer.hold import DEAD_MAN, HoldToDrive


class Driving:
    """Output `cmd_vel`.

    Args:
        node: Whose.
        parameters: Of the node.

    Attributes:
        hold: What is held.
        silent: Whether nothing was sent in the last period.
    """

    def __init__(self, node: OmnimanNode, parameters: ViewerParameters) -> None:
        self._node = node
        self._stamped, self._frame = parameters.cmd_vel_stamped, parameters.base_frame
        self._publisher = node.create_publisher(
            TwistStamped if self._stamped else TwistMsg, "cmd_vel", LATEST
        )
        self.hold = HoldToDrive()
        self._framing = Framing()
        self.silent = True
        self._driven_at = node.now()

    def drive(self, speeds: tuple[float, float], now: float) -> None:
        """Send what is held, at most at these speeds [m/s, rad/s]; call it once a period."""
        if now - self._driven_at > DEAD_MAN:
            # What was held while this node could not listen may be long released.
            self.hold.release()
        self._driven_at = now
        twist = self._framing.next(self.hold.twist(now, *speeds))
        self.silent = twist is None
        if twist is not None:
            self._publisher.publish(self._message(twist))

    def _message(self, twist: Twist) -> TwistMsg | TwistStamped:
        x, y, turn = twist
        message = TwistMsg(linear=Vector3(x=x, y=y), angular=Vector3(z=turn))
        if not self._stamped:
            return message
        stamped = TwistStamped(twist=message)
        stamped.header.stamp = self._node.stamp()
        stamped.header.frame_id = self._frame
        return stamped
