"""A tool that is held at a place, as a path without length."""

import numpy as np

from omniman_ros.core.arrays import Array


class HeldTool:
    """A pose (4, 4) of `tool0` in odom, whatever the parameter of a path; see `ToolCurve`."""

    end = 0.0

    def __init__(self, pose: Array) -> None:
        self._pose: Array = pose.copy()

    def pose(self, u: Array) -> Array:
        """Return poses (m, 4, 4) of the tool at u (m,): all the same."""
        return np.broadcast_to(self._pose, (len(u), 4, 4)).copy()

    def motion(self, u: Array) -> tuple[Array, Array, Array]:
        """Return poses (m, 4, 4), and twists and their derivatives (m, 6), which are zero."""
        return self.pose(u), np.zeros((len(u), 6)), np.zeros((len(u), 6))

    def length(self) -> float:
        """Return the length of the path, zero [m]."""
        return 0.0
