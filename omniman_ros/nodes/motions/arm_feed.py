"""What the node hears of where the arm is."""

from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from omniman_ros import conversions
from omniman_ros.core import plausible
from omniman_ros.core.errors import InputError
from omniman_ros.core.path.parameters import TICK
from omniman_ros.nodes.runtime import OmnimanNode

Array = NDArray[np.float64]

AT_REST = 0.02
"""Joint speed below which a motion may begin [rad/s]."""
LAG = 0.2
"""The arm may be where it was to be so long ago [s]."""


class ArmFeed:
    """Input `arm/joint_states`, and where the arm was to be.

    Args:
        node: Where the topic is.
        names: Of the joints.
        looked_at: Whether the arm moves for this node, so that each message counts.
        compare: Called after each message that counts.

    Attributes:
        position: (6,) [rad], or None.
        velocity: (6,) [rad/s]; zeros where it is not said.
        time: When it was measured, on this node's clock [s].
        silent: Age that it had, and time that has passed since on this node's clock [s].
        held: (6,) where the last motion ended that was driven to a rest [rad], or None.
    """

    def __init__(
        self, node: OmnimanNode, names: tuple[str, ...], looked_at: Callable[[], bool],
        compare: Callable[[], None],
    ) -> None:  # fmt: skip
        self._node, self._names = node, names
        self._looked_at, self._compare = looked_at, compare
        self.position: Array | None = None
        self.velocity: Array = np.zeros(len(names))
        self.silent, self.time = 0.0, float("-inf")
        self.held: Array | None = None
        self._heard = float("-inf")
        self._states: bytes | None = None
        self._wanted: deque[tuple[float, Array]] = deque()
        # Bytes: at rest, states are needed only now and then.
        on_states = node.guarded("arm/joint_states", self._on_states)
        node.create_subscription(JointState, "arm/joint_states", on_states, 1, raw=True)

    def _on_states(self, data: bytes) -> None:
        self._states, self._heard = data, self._node.now()
        if self._looked_at():
            self.measure()
            self._compare()

    def measure(self) -> None:
        """Unpack what was heard last.

        Raises:
            InputError: It cannot be used.
        """
        data, self._states = self._states, None
        if data is None:
            return
        message = deserialize_message(data, JointState)
        position, velocity, _ = conversions.joint_arrays(message, self._names)
        self.position = conversions.present(position, plausible.ANGLE, "position")
        if velocity is None:
            self.velocity = np.zeros(len(self._names))
        else:
            plausible.demand(velocity, plausible.SPEED, "velocity")
            self.velocity = velocity
        self.silent = max(self._node.age(message.header.stamp), 0.0)
        self.time = min(self._node.now() - self.silent, self._heard)

    def state(self) -> tuple[Array, Array] | None:
        """Last measured angles [rad] and rates [rad/s] (6,), if there are any that can be used."""
        try:
            self.measure()
        except InputError as error:
            self._node.warn("arm/joint_states", f"arm/joint_states ignored: {error}")
        return None if self.position is None else (self.position, self.velocity)

    @property
    def age(self) -> float:
        """Of the states that are known [s]; what could not be used is none."""
        return self._node.now() - self.time

    def pass_time(self, elapsed: float) -> None:
        """Let time pass [s]: while the node is held up, it is not the arm that is silent."""
        self.silent += elapsed

    def begin(self) -> None:
        """A motion begins from rest."""
        self.silent = 0.0
        self._wanted.clear()

    def want(self, position: Array) -> None:
        """Hear where the arm is led now (6,) [rad]."""
        now = self._node.now()
        self._wanted.append((now, position))
        while self._wanted[0][0] < now - LAG - 2.0 * TICK:
            self._wanted.popleft()

    def off(self, bound: float) -> str:
        """Which joint is not where it was to be, and how far; or an empty string.

        Args:
            bound: As far as this is no matter [rad].
        """
        if self.position is None or not self._wanted:
            return ""
        places = np.array([place for _, place in self._wanted])
        off = np.maximum(self.position - places.max(axis=0), places.min(axis=0) - self.position)
        k = int(off.argmax())
        return f"{self._names[k]} is {off[k]:.3f} rad from its reference" if off[k] > bound else ""

    def place(self, tolerance: float) -> Array | None:
        """Where (6,) a motion from rest begins [rad]: where the last one ended, if it is there.

        Args:
            tolerance: How far the arm may be from there [rad].
        """
        held, here = self.held, self.position
        near = held is not None and here is not None and np.abs(held - here).max() <= tolerance
        return held if near else here

    def not_yet(self, timeout: float, tolerance: float, idle: bool) -> str:
        """Why no motion of the arm can begin, or an empty string.

        What was heard last and cannot be used is such a reason: this is asked outside of callbacks
        of messages, too.

        Args:
            timeout: Age at which it is unknown where the arm is [s].
            tolerance: How far the arm may be from where its last motion ended [rad].
            idle: Whether it moves for nobody here.
        """
        try:
            self.measure()
        except InputError as error:
            return f"arm/joint_states: {error}"
        if self.position is None:
            return "no arm/joint_states"
        age = self.age if idle else self.silent
        age = max(age, self.silent)
        if age > timeout:
            return f"arm/joint_states are {age:.2f} s old"
        rests = self.place(tolerance) is self.held or float(np.abs(self.velocity).max()) <= AT_REST
        return "" if rests or not idle else "the arm moves"

    def forget_place(self) -> None:
        """As if nothing had been heard."""
        self.position = self._states = None
        self.time = self._heard = float("-inf")
