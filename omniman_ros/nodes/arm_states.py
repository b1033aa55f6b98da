"""Joint states of the arm, as every node reads them."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from sensor_msgs.msg import JointState

from omniman_ros.conversions.joints import require_array
from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.stamps import MAX_LEAD
from omniman_ros.nodes.joint_state_reader import JointStateReader
from omniman_ros.nodes.omniman_node import OmnimanNode

TOPIC = "arm/joint_states"  #: Name of the topic
#: Time by which a measurement may seem to be older than the one before it [s]
TIME_TOLERANCE = 1e-6


@dataclass(frozen=True)
class ArmStates:
    """Measured joint states."""

    position: Array  #: (n,) joint angles [rad]
    velocity: Array  #: (n,) joint rates [rad/s]; zeros where the message has none
    #: Time of the measurement on the node's clock, at the latest that of its arrival [s]
    time: float


class ArmStatesReader:
    """Keeps the last message on `arm/joint_states`, and reads it when it is needed.

    The arm reports more often than most need to know: messages stay serialized until then.
    """

    def __init__(
        self,
        node: OmnimanNode,
        names: Sequence[str],
        on_message: Callable[[], None] = lambda: None,
        max_age: float = math.inf,
    ) -> None:
        self._node, self._max_age = node, max_age
        self._count, self._reader = len(names), JointStateReader(names)
        self._data: bytes | None = None
        self._received = -math.inf
        self.last: ArmStates | None = None

        def keep(data: bytes) -> None:
            self._data, self._received = data, node.now()
            on_message()

        handler = node.guarded(TOPIC, keep)
        node.create_subscription(JointState, TOPIC, handler, 1, raw=True)

    def forget(self) -> None:
        """Forget all that was received, because time went back."""
        self._data = self.last = None
        self._received = -math.inf

    def read(self) -> ArmStates | None:
        """Return the last states, unless they were read; raise InputError if they are no use."""
        data, self._data = self._data, None
        if data is None:
            return None
        stamp, position, velocity, _ = self._reader.read(data)
        angles = require_array(position, plausible.ANGLE, "position")
        if velocity is None:
            velocity = np.zeros(self._count)
        plausible.demand(velocity, plausible.SPEED, "velocity")
        time = min(self._node.instant(stamp), self._received)
        last, now = self.last, self._node.now()
        if now - time > self._max_age:
            raise InputError(f"stale, {now - time:.3f} s old")
        # States from the future were received before simulated time jumped back.
        if last is not None and time < last.time - TIME_TOLERANCE <= now + MAX_LEAD:
            raise InputError(f"out of order, {last.time - time:.4f} s before the last message")
        self.last = ArmStates(angles, velocity, time)
        return self.last

    def poll(self) -> ArmStates | None:
        """Return what :meth:`read` returns; what cannot be used is warned of instead."""
        try:
            return self.read()
        except InputError as error:
            self._node.warn(TOPIC, f"{TOPIC} ignored: {error}")
            return None
