"""Topic from which a node knows the arm's posture."""

from collections.abc import Callable, Sequence

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.nodes.arm_states import ArmStatesReader
from omniman_ros.nodes.omniman_node import OmnimanNode

#: Period at which the posture is taken [s]; the fastest joint moves by 0.13 rad in it
PERIOD = 0.04
MAX_AGE = 0.5  #: Age from which a joint state is stale [s]
RESOLUTION = 1e-3  #: Largest change of all angles up to which a posture counts as the same [rad]


class ArmConfigurationInput:
    """Takes the arm's posture from `arm/joint_states`, at most every 40 ms.

    While the arm is silent, its last posture holds: its mass does not vanish.

    Args:
        on_configuration: Called with the joint angles (6,) [rad] when they have changed.
    """

    def __init__(
        self, node: OmnimanNode, names: Sequence[str], on_configuration: Callable[[Array], None]
    ) -> None:
        self._node, self._on_arm_configuration = node, on_configuration
        self._states = ArmStatesReader(node, names, max_age=MAX_AGE)
        self._posture: Array | None = None
        self._time = 0.0
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
            self._on_arm_configuration(self._posture)

    def _take(self) -> None:
        states = self._states.poll()
        if states is None:
            return
        self._time = states.time
        known, posture = self._posture, states.position
        if known is None or float(np.abs(posture - known).max()) > RESOLUTION:
            self._posture = posture
            self._on_arm_configuration(posture)
