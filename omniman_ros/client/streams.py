"""What a client publishes again and again: twists, and where obstacles are."""

from geometry_msgs.msg import Twist, TwistStamped
from rclpy.publisher import Publisher
from visualization_msgs.msg import MarkerArray

from omniman_ros.client import messages
from omniman_ros.client.shared_node import SharedNode
from omniman_ros.client.state import RobotError
from omniman_ros.client.telemetry import Telemetry
from omniman_ros.core.framing import CmdVelFraming
from omniman_ros.core.planar import Triple

CONTROLLER = "platform_controller"  #: Node that takes `cmd_vel`


class TwistStream:
    """Streams a twist on `cmd_vel`, of the type that the controller subscribes to.

    Attributes:
        target: Twist [m/s, m/s, rad/s]; None if nothing is to be streamed.
        is_streaming: Whether twists are published; some zeros follow the last target.
        publisher: None until a subscriber is known.
    """

    def __init__(self, shared: SharedNode, telemetry: Telemetry) -> None:
        self._shared, self._telemetry = shared, telemetry
        self._framing = CmdVelFraming()
        self._is_stamped = False
        self.target: Triple | None = None
        self.is_streaming = False
        self.publisher: Publisher | None = None

    @property
    def is_heard(self) -> bool:
        """Whether anybody takes twists."""
        return self.publisher is not None and self.publisher.get_subscription_count() > 0

    def tick(self) -> None:
        """Publish what is due."""
        if self.publisher is None:
            self._find_controller()
        twist = self._framing.next(self.target)
        self.is_streaming = twist is not None
        if twist is not None:
            self.publish(twist)

    def _find_controller(self) -> None:
        topic = self._shared.name("cmd_vel")
        listeners = self._shared.node.get_subscriptions_info_by_topic(topic)
        listeners.sort(key=lambda info: info.node_name != CONTROLLER)
        if listeners:
            self._is_stamped = listeners[0].topic_type.endswith("/TwistStamped")
            kind = TwistStamped if self._is_stamped else Twist
            self.publisher = self._shared.publisher(kind, "cmd_vel", 1)

    def publish(self, twist: Triple) -> None:
        """Publish a twist once."""
        if self.publisher is not None:
            stamp = self._telemetry.next_stamp() if self._is_stamped else None
            self.publisher.publish(messages.twist(twist, stamp))


class ObstacleStream:
    """Publishes where the obstacles of a client are. Who has begun to do so is expected to go on.

    Attributes:
        publisher: None before the first obstacle.
    """

    def __init__(self, shared: SharedNode, telemetry: Telemetry) -> None:
        self._shared, self._telemetry = shared, telemetry
        self._placed: dict[str, tuple[float, messages.RoundObstacle]] = {}
        self._removed: list[str] = []
        self.publisher: Publisher | None = None

    def place(self, obstacle: messages.RoundObstacle) -> None:
        """Show an obstacle from now on, in place of one of the same name."""
        self._placed[obstacle.name] = (self._shared.now(), obstacle)

    def remove(self, name: str) -> None:
        """Remove an obstacle that was placed; RobotError if there is none of that name."""
        if self._placed.pop(name, None) is None:
            raise RobotError(f"there is no obstacle '{name}'")
        self._removed.append(name)

    def clear(self) -> None:
        """Remove all obstacles."""
        self._removed += self._placed
        self._placed.clear()

    def tick(self) -> None:
        """Publish the obstacles, and what was removed."""
        if self.publisher is None:
            if not self._placed:
                return
            self.publisher = self._shared.publisher(MarkerArray, "obstacles", 50)
        now, stamp = self._shared.now(), self._telemetry.next_stamp()
        markers = [messages.removal(name) for name in self._removed]
        markers += [obstacle.marker(now - at, stamp) for at, obstacle in self._placed.values()]
        self.publisher.publish(MarkerArray(markers=markers))
        self._removed.clear()
