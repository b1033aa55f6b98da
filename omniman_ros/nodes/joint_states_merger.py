"""Node `joint_states_merger`: wheels and arm together on `joint_states`, and the URDF.

These are the topics that robot_state_publisher, RViz and MoveIt expect of a robot.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from omniman_ros.conversions.headers import is_stamped
from omniman_ros.conversions.joints import joint_arrays, require_array
from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.stamps import MAX_LEAD
from omniman_ros.nodes.joint_states_merger_parameters import JointStatesMergerParameters
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.serialized import deserialized
from omniman_ros.nodes.stop_interface import LATCHED


@dataclass(frozen=True)
class JointSample:
    """States of the n joints of a topic at one time."""

    time: float  #: Time on the node's clock [s]
    stamp: Time  #: The same time in ROS time
    position: Array  #: (n,) [rad]
    velocity: Array | None  #: (n,) [rad/s], or None if absent
    effort: Array | None  #: (n,) [N m], or None if absent

    @property
    def order(self) -> tuple[int, int]:
        """Sort key of the stamp: seconds and nanoseconds."""
        return self.stamp.sec, self.stamp.nanosec


class JointStatesMergerNode(OmnimanNode):
    """Merges the joint states of wheels and arm, and publishes the URDF."""

    lookahead = math.inf

    def __init__(self, **options: object) -> None:
        super().__init__("joint_states_merger", **options)
        self.settings = ParameterSet(self, JointStatesMergerParameters)
        p = self.settings.value
        self._samples: dict[str, JointSample] = {}
        self._unread: dict[str, Callable[[], None]] = {}
        self._published_stamp: Time | None = None
        wheels, arm = p.description.robot.wheels, p.description.arm
        self._names = {"wheel_states": wheels.names, "arm/joint_states": arm.joints}
        self._joints = {"wheel_states": wheels.joints, "arm/joint_states": arm.joints}
        self._joint_states = self.create_publisher(JointState, "joint_states", 10)
        self._description = None
        if p.publish_description:
            self._description = self.create_publisher(String, "robot_description", LATCHED)
        self._urdf = ""
        self._publish_description(p)
        self.settings.on_change(self._publish_description)
        for topic in self._names:
            self._subscribe(topic)
        self.every(1.0 / p.rate, self.tick)

    def _publish_description(self, p: JointStatesMergerParameters) -> None:
        text = p.description.urdf
        if self._description is not None and text != self._urdf:
            self._description.publish(String(data=text))
        self._urdf = text

    def _subscribe(self, topic: str) -> None:
        handler = self.guarded(topic, lambda data: self._on_states(topic, data))

        def keep(data: bytes) -> None:
            """Keep the last message for the next tick, as messages come more often."""
            self._unread[topic] = lambda: handler(data)

        self.create_subscription(JointState, topic, keep, QoSProfile(depth=1), raw=True)

    def _on_states(self, topic: str, data: bytes) -> None:
        message = deserialized(data, JointState)
        position, velocity, effort = joint_arrays(message, self._names[topic])
        position = require_array(position, plausible.WHEEL_ANGLE, "position")
        for array, bound, label in (
            (velocity, plausible.WHEEL_SPEED, "velocity"),
            (effort, plausible.EFFORT, "effort"),
        ):
            if array is not None:
                plausible.demand(array, bound, label)
        time, stamp = self.instant(message.header.stamp), message.header.stamp
        if not is_stamped(stamp):
            stamp = self.stamp(time)
        sample = JointSample(time, stamp, position, velocity, effort)
        known = self._samples.get(topic)
        # A known sample from the future was received before simulated time jumped back.
        out_of_order = known is not None and sample.order < known.order
        if known is not None and out_of_order and known.time <= self.now() + MAX_LEAD:
            raise InputError(f"out of order, {known.time - time:.4f} s before the last message")
        self._samples[topic] = sample

    def tick(self) -> None:
        """Publish the joints that are known now, unless the same states were published before."""
        while self._unread:
            self._unread.popitem()[1]()
        fresh = self._fresh_topics()
        if not fresh:
            return
        samples = [self._samples[topic] for topic in fresh]
        newest = max(samples, key=lambda sample: sample.order)
        # A repeated stamp would make tf2 warn.
        if newest.stamp == self._published_stamp:
            return
        self._published_stamp = newest.stamp
        message = JointState(name=[name for topic in fresh for name in self._joints[topic]])
        message.header.stamp = newest.stamp
        message.position = _concatenated([sample.position for sample in samples])
        message.velocity = _concatenated([sample.velocity for sample in samples])
        message.effort = _concatenated([sample.effort for sample in samples])
        self._joint_states.publish(message)

    def _fresh_topics(self) -> list[str]:
        now, timeout = self.now(), self.settings.value.timeout
        return [
            topic
            for topic in self._names
            if topic in self._samples and -MAX_LEAD <= now - self._samples[topic].time <= timeout
        ]

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Return level, message and values of the diagnostics."""
        fresh = self._fresh_topics()
        silent = [topic for topic in self._samples if topic not in fresh]
        values: list[tuple[str, object]] = [
            (topic, "received" if topic in fresh else "silent") for topic in self._names
        ]
        if not self._samples:
            return DiagnosticStatus.WARN, "waiting for wheel_states or arm/joint_states", values
        if silent:
            return DiagnosticStatus.WARN, f"no {' and no '.join(silent)} any more", values
        return DiagnosticStatus.OK, "running", values


def _concatenated(parts: Sequence[Array | None]) -> list[float]:
    """Return the arrays as one list; empty if one is absent, as a JointState cannot have gaps."""
    known = [part for part in parts if part is not None]
    return [value for part in known for value in part.tolist()] if len(known) == len(parts) else []


def main(args: list[str] | None = None) -> int:
    """Run the node: entry point of `ros2 run omniman_ros joint_states_merger`."""
    return run(JointStatesMergerNode, args)
