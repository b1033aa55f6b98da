"""Measured joint states of the arm, and their comparison with its recent reference."""

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.stamps import MAX_LEAD
from omniman_ros.motion.path.joint_parameters import ArmFollowing
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.nodes.arm_states import ArmStates, ArmStatesReader
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.trajectory_interfaces.odom_feed import AT_REST

MAX_LAG = 0.2  #: Longest time by which the arm may lag behind its reference [s]


class ArmFeed:
    """Subscribes to `arm/joint_states`, and remembers the recent reference of the arm.

    Attributes:
        silence: Age of the states on arrival plus the node's own time since then [s].
        rest_position: (6,) joint angles at which the last motion came to rest [rad]; None if it
            was given up, or there was none.
    """

    def __init__(
        self,
        node: OmnimanNode,
        names: tuple[str, ...],
        is_moving: Callable[[], bool],
        on_states: Callable[[], None],
    ) -> None:
        self._node, self._names = node, names
        self._is_moving, self._on_states = is_moving, on_states
        self.position: Array | None = None  #: (6,) joint angles [rad]
        self.velocity: Array = np.zeros(len(names))  #: (6,) joint rates [rad/s]; or zeros
        self.silence, self.time = 0.0, float("-inf")
        self.rest_position: Array | None = None
        self._references: deque[tuple[float, Array]] = deque()
        self._reader = ArmStatesReader(node, names, self._on_message)

    def _on_message(self) -> None:
        if self._is_moving():
            self.measure()
            self._on_states()

    def measure(self) -> None:
        """Read the last message, unless that was done; raise InputError if it is unusable."""
        self._adopt(self._reader.read())

    def _adopt(self, states: ArmStates | None) -> None:
        """Use states that have just been read, if there are any."""
        if states is not None:
            self.position, self.velocity = states.position, states.velocity
            self.time = states.time
            self.silence = max(self.age, 0.0)

    def state(self) -> tuple[Array, Array] | None:
        """Return the last usable joint angles [rad] and rates [rad/s], (6,) each, if any."""
        self._adopt(self._reader.poll())
        return None if self.position is None else (self.position, self.velocity)

    @property
    def age(self) -> float:
        """Age of the last usable joint states [s]; infinite after time went back behind them."""
        age = self._node.now() - self.time
        return age if age >= -MAX_LEAD else math.inf

    def pass_time(self, elapsed: float) -> None:
        """Advance the silence by the node's own time [s].

        Time during which the node itself is held up must not be counted in full, because the arm
        is not silent then.
        """
        self.silence += elapsed

    def start_motion(self) -> None:
        """Note that a motion starts from rest."""
        self.silence = 0.0
        self._references.clear()

    def record_reference(self, position: Array) -> None:
        """Record the present reference (6,) of the arm [rad]."""
        now = self._node.now()
        self._references.append((now, position))
        while self._references[0][0] < now - MAX_LAG - 2.0 * TICK:
            self._references.popleft()

    def following_error(self, max_error: float) -> str:
        """Return which joint is over `max_error` [rad] from its reference of the last 0.2 s."""
        if self.position is None or not self._references:
            return ""
        recent = np.array([reference for _, reference in self._references])
        error = np.maximum(self.position - recent.max(axis=0), recent.min(axis=0) - self.position)
        k = int(error.argmax())
        if error[k] <= max_error:
            return ""
        return f"{self._names[k]} is {error[k]:.3f} rad from its reference"

    def start_position(self, tolerance: float) -> Array | None:
        """Return the joint angles (6,) at which a motion from rest starts [rad], or None.

        They are exactly those at which the last motion came to rest, within the tolerance [rad].
        """
        rest, measured = self.rest_position, self.position
        if rest is None or measured is None:
            return measured
        return rest if np.abs(rest - measured).max() <= tolerance else measured

    def blocking_reason(self, options: ArmFollowing, *, idle: bool) -> str:
        """Return why no motion of the arm can start, or an empty string.

        It is such a reason that the last message cannot be used.
        """
        try:
            self.measure()
        except InputError as error:
            return f"arm/joint_states: {error}"
        if self.position is None:
            return "no arm/joint_states"
        age = max(self.age, self.silence) if idle else self.silence
        if age > options.states_timeout:
            return f"arm/joint_states are {age:.2f} s old"
        if not idle or self.start_position(options.start_tolerance) is self.rest_position:
            return ""
        return "" if float(np.abs(self.velocity).max()) <= AT_REST else "the arm moves"

    def forget(self) -> None:
        """Forget all measurements, because time went back."""
        self._reader.forget()
        self.position, self.time = None, float("-inf")
