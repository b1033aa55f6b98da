"""Nodes that stream references for the platform, with a fake controller that follows them."""

from collections.abc import Callable
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

from omniman_ros.conversions.geometry import quaternion_from_yaw
from omniman_ros.conversions.headers import time_seconds
from omniman_ros.conversions.trajectories import preview_from_message
from omniman_ros.core import se2
from omniman_ros.core.preview import Preview, Setpoint
from omniman_ros.nodes.stop_interface import LATCHED
from test.nodes.harness import PERIOD, World
from test.nodes.rig import twist


class StreamWorld(World):
    """A node with its recorded stream and warnings.

    Attributes:
        maker, name, source: Class and name of the node, and the source that it is.
        arrivals: Times at which the references arrived [s].
    """

    maker: type
    name: str
    source: str

    def __init__(self, *others: Any, parameters: dict[str, Any] | None = None) -> None:
        super().__init__(self.maker, *others, parameters=parameters)
        self.node: Any = self.nodes[0]
        self.arrivals: list[float] = []
        self.references: list[bytes] = []  # deserialized on demand, which is slow
        self._previews: dict[int, Preview] = {}
        self.probe.create_subscription(
            MultiDOFJointTrajectory, f"{self.source}/reference", self._on_reference, 100, raw=True
        )
        self._await(lambda: self.subscription_count() > 0, "a publisher of references")
        self.warnings: list[str] = []
        warn = self.node.warn
        self.node.warn = lambda subject, text: (self.warnings.append(text), warn(subject, text))

    def subscription_count(self) -> int:
        """Return the number of subscriptions that the publisher of references knows."""
        raise NotImplementedError

    def _on_reference(self, data: bytes) -> None:
        self.references.append(data)
        self.arrivals.append(self.time)

    def call_service(self, name: str) -> Trigger.Response:
        return self.call(Trigger, f"{self.name}/{name}")

    def set(self, name: str, value: object, node: str = "") -> Any:
        given = value if isinstance(value, Parameter) else Parameter(name, value=value)
        request = SetParameters.Request(parameters=[given.to_parameter_msg()])
        return self.call(SetParameters, f"{node or self.name}/set_parameters", request).results[0]

    def assert_silent(self, seconds: float = 1.0) -> None:
        """Assert that nothing is streamed."""
        before = len(self.references)
        self.run(seconds)
        assert len(self.references) == before, "a reference was sent"

    def message(self, i: int) -> MultiDOFJointTrajectory:
        return deserialize_message(self.references[i], MultiDOFJointTrajectory)

    def preview(self, i: int) -> Preview:
        i %= len(self.references)
        if i not in self._previews:
            message = self.message(i)
            start = time_seconds(message.header.stamp)
            self._previews[i] = preview_from_message(message, start, ("odom",))
        return self._previews[i]


class FakeFollower(StreamWorld):
    """A fake controller beside the node, which follows the stream without delay.

    Attributes:
        follows_stream: Whether the controller follows the stream.
        odometry: Returns the message to publish on odom; None publishes nothing.
        busy_until: Time until which the controller reports no new source [s].
        setpoint: Setpoint that is being followed.
    """

    def follow(self, source: str) -> None:
        """Begin to follow, with a source that is active; without one, nothing is followed."""
        self.follows_stream, self.busy_until = bool(source), 0.0
        self.odometry: Callable[[], Odometry] | None = self.odom_message
        self.setpoint = Setpoint(np.zeros(3), np.zeros(3), np.zeros(3))
        self._odom = self.publisher(Odometry, "odom")
        self._source = self.publisher(String, "active_source", LATCHED)
        self._last_source, self._received_count = "", 0
        self._preview: Preview | None = None
        self.hooks.append(self._control)
        if source:
            self.publish_source(source)
        self.run(4 * PERIOD)

    def publish_source(self, source: str) -> None:
        """Publish the active source."""
        if source != self._last_source:
            self._last_source = source
            self._source.publish(String(data=source))

    def _control(self) -> None:
        new = len(self.references) > self._received_count
        self._received_count = len(self.references)
        if not self.follows_stream:
            self._preview = None
        elif new:
            self._preview = self.preview(-1)
        if self._preview is not None:
            self.setpoint = self._preview.sample(self.time + 1e-9)
            held = 0.0 if self._preview.end_speed > 1e-6 else 0.2
            if self.time > self.busy_until:
                ends = self._preview.end + held
                self.publish_source(self.source if self.time <= ends else "none")
        if self.odometry is not None:
            self._odom.publish(self.odometry())

    def odom_message(self) -> Odometry:
        """Return odometry at the present setpoint of the stream."""
        message = Odometry(child_frame_id="base_link")
        message.header.frame_id, message.header.stamp = "odom", self.stamp()
        x, y, theta = self.setpoint.pose.tolist()
        message.pose.pose.position.x, message.pose.pose.position.y = x, y
        message.pose.pose.orientation = quaternion_from_yaw(theta)
        message.twist.twist = twist(*se2.to_robot(theta, self.setpoint.velocity))
        return message
