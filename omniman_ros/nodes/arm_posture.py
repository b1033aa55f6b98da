"""Topic from which a node knows the arm's posture."""

from collections.abc import Callable, Sequence

import numpy as np
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from omniman_ros.conversions.joints import joint_arrays, require_array
from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.nodes.omniman_node import MAX_LEAD, OmnimanNode
from omniman_ros.nodes.serialized import deserialized

PERIOD = 0.04
"""Period at which the posture is taken [s]; the fastest joint moves by 0.13 rad in it."""
MAX_AGE = 0.5
"""Age from which a joint state is stale [s]."""
RESOLUTION = 1e-3
"""Largest change of all angles up to which a posture counts as the same [rad]."""


class ArmPostureInput:
    """Takes the arm's posture from `arm/joint_states`, at most every 40 ms.

    While the arm is silent, its last posture holds: its mass does not vanish.

    Args:
        node: Node that owns the subscription.
        names: Names of the six joints, from the base on.
        on_posture: Called with the joint angles (6,) [rad] when they have changed.
    """

    def __init__(
        self, node: OmnimanNode, names: Sequence[str], on_posture: Callable[[Array], None]
    ) -> None:
        self._node = node
        self._names = names
        self._on_posture = on_posture
        self._posture: Array | None = None
        self._time = 0.0
        self._unread: bytes | None = None
        self._read = node.guarded("arm/joint_states", self._on_states)
        # The arm reports more often than its mass is needed: only the last report is read.
        qos = QoSProfile(depth=1)
        node.create_subscription(JointState, "arm/joint_states", self._keep, qos, raw=True)
        node.every(PERIOD, self._take)

    @property
    def state(self) -> str:
        """Whether the posture is known, in a few words for the diagnostics."""
        if self._posture is None:
            return "not received: as configured"
        age = self._node.now() - self._time
        return "received" if age <= MAX_AGE else f"silent for {age:.0f} s: the last one holds"

    def repeat(self) -> None:
        """Report the present posture again, if it is known, as the arm's mass has changed."""
        if self._posture is not None:
            self._on_posture(self._posture)

    def _keep(self, data: bytes) -> None:
        self._unread = data

    def _take(self) -> None:
        data, self._unread = self._unread, None
        if data is not None:
            self._read(data)

    def _on_states(self, data: bytes) -> None:
        message = deserialized(data, JointState)
        position, _, _ = joint_arrays(message, self._names)
        posture = require_array(position, plausible.ANGLE, "position")
        time, now = self._node.instant(message.header.stamp), self._node.now()
        if now - time > MAX_AGE:
            raise InputError(f"stale, {now - time:.3f} s old")
        # A known posture from the future was received before simulated time jumped back.
        if self._posture is not None and time < self._time <= now + MAX_LEAD:
            raise InputError(f"out of order, {self._time - time:.4f} s before the last message")
        self._time = time
        known = self._posture
        if known is None or float(np.abs(posture - known).max()) > RESOLUTION:
            self._posture = posture
            self._on_posture(posture)
