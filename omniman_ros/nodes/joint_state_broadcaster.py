"""Node `joint_state_broadcaster`: wheels and arm together on `joint_states`, and the URDF.

What robot_state_publisher, RViz and MoveIt expect of a robot.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from numpy.typing import NDArray
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from omniman_ros import conversions
from omniman_ros.core import plausible
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import FUTURE, OmnimanNode, run
from omniman_ros.nodes.stopping import LATCHED

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class JointStateBroadcasterParameters:
    """Parameters of the node: what the URDF is made from, its rate, and what is too old."""

    description: DescriptionParameters = inline()
    rate: float = parameter(
        50.0, "Largest rate of joint_states.", unit="Hz", low=1, high=500, read_only=True
    )
    timeout: float = parameter(
        0.5, "Age at which wheels or arm are left out of joint_states.", unit="s", low=0.02,
        high=60,
    )  # fmt: skip
    publish_description: bool = parameter(
        True, "Whether the URDF is on robot_description; not where robot_state_publisher has it.",
        read_only=True,
    )  # fmt: skip


@dataclass(frozen=True)
class Part:
    """Joints as they were at a time.

    Attributes:
        time: On the node's clock [s].
        stamp: The same in ROS time.
        position, velocity, effort: (n,) each; velocity and effort can be absent.
    """

    time: float
    stamp: Time
    position: Array
    velocity: Array | None
    effort: Array | None

    @property
    def order(self) -> tuple[int, int]:
        """What the stamps of parts are compared by."""
        return self.stamp.sec, self.stamp.nanosec


class JointStateBroadcasterNode(OmnimanNode):
    """Message plumbing: two topics in, the joints of both that are known now out."""

    def __init__(self, **options: object) -> None:
        super().__init__("joint_state_broadcaster", **options)
        self.settings = ParameterSet(self, JointStateBroadcasterParameters)
        p = self.settings.value
        self._parts: dict[str, Part] = {}
        self._waiting: dict[str, Callable[[], None]] = {}
        self._told: Time | None = None
        self._names = {
            "wheel_states": p.description.robot.wheels.names,
            "arm/joint_states": p.description.arm.joints,
        }
        self._joint_states = self.create_publisher(JointState, "joint_states", 10)
        self._description = None
        if p.publish_description:
            self._description = self.create_publisher(String, "robot_description", LATCHED)
        self._urdf = ""
        self._describe(p)
        self.settings.on_change(self._describe)
        for topic in self._names:
            self._listen(topic)
        self.every(1.0 / p.rate, self.tick)

    def _describe(self, p: JointStateBroadcasterParameters) -> None:
        text = p.description.urdf
        if self._description is not None and text != self._urdf:
            self._description.publish(String(data=text))
        self._urdf = text

    # ---- inputs -------------------------------------------------------------------------------

    def _listen(self, topic: str) -> None:
        handler = self.guarded(topic, lambda data: self._on_states(topic, data))

        def keep(data: bytes) -> None:
            """Only the last one a tick is read: they come faster than they are asked for."""
            self._waiting[topic] = lambda: handler(data)

        self.create_subscription(JointState, topic, keep, QoSProfile(depth=1), raw=True)

    def _on_states(self, topic: str, data: bytes) -> None:
        message = deserialize_message(data, JointState)
        position, velocity, effort = conversions.joint_arrays(message, self._names[topic])
        position = conversions.present(position, plausible.WHEEL_ANGLE, "position")
        for array, bound, label in (
            (velocity, plausible.WHEEL_SPEED, "velocity"), (effort, plausible.EFFORT, "effort"),
        ):  # fmt: skip
            if array is not None:
                plausible.demand(array, bound, label)
        time, stamp = self.instant(message.header.stamp), message.header.stamp
        if stamp.sec == 0 and stamp.nanosec == 0:
            stamp = self.stamp(time)
        part = Part(time, stamp, position, velocity, effort)
        known = self._parts.get(topic)
        # A time ahead is one from before simulated time went back.
        if known is not None and part.order < known.order and known.time <= self.now() + FUTURE:
            raise InputError(f"out of order, {known.time - time:.4f} s back")
        self._parts[topic] = part

    # ---- output -------------------------------------------------------------------------------

    def tick(self) -> None:
        """Publish the joints that are known now, unless all of that was published before."""
        while self._waiting:
            self._waiting.popitem()[1]()
        living = self._living()
        if not living:
            return
        parts = [self._parts[topic] for topic in living]
        newest = max(parts, key=lambda part: part.order)
        # tf2 complains of a stamp that it has had.
        if newest.stamp == self._told:
            return
        self._told = newest.stamp
        message = JointState(name=[name for topic in living for name in self._names[topic]])
        message.header.stamp = newest.stamp
        message.position = _together([part.position for part in parts])
        message.velocity = _together([part.velocity for part in parts])
        message.effort = _together([part.effort for part in parts])
        self._joint_states.publish(message)

    def _living(self) -> list[str]:
        """Topics whose last message is not too old."""
        now, timeout = self.now(), self.settings.value.timeout
        return [
            topic
            for topic in self._names
            if topic in self._parts and -FUTURE <= now - self._parts[topic].time <= timeout
        ]

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Level, message and values for the diagnostics."""
        living = self._living()
        silent = [topic for topic in self._parts if topic not in living]
        values = [(topic, "heard" if topic in living else "silent") for topic in self._names]
        if not self._parts:
            return DiagnosticStatus.WARN, "waiting for wheel_states or arm/joint_states", values
        if silent:
            return DiagnosticStatus.WARN, f"no {' and no '.join(silent)} any more", values
        return DiagnosticStatus.OK, "running", values


def _together(parts: Sequence[Array | None]) -> list[float]:
    """One list of all, or none where a part has none: a JointState has no gaps."""
    known = [part for part in parts if part is not None]
    return [value for part in known for value in part.tolist()] if len(known) == len(parts) else []


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run omniman_ros joint_state_broadcaster`."""
    return run(JointStateBroadcasterNode, args)
