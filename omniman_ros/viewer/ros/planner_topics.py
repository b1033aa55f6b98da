"""Subscriptions to the planner and to obstacles, which update the `ViewState`."""

from collections.abc import Callable
from functools import partial

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Path
from visualization_msgs.msg import MarkerArray

from omniman_ros.conversions.headers import within
from omniman_ros.conversions.obstacles import marker_changes
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build
from omniman_ros.nodes import obstacle_interface
from omniman_ros.nodes.obstacle_interface import marker_headers
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.surroundings.ellipses import Ellipses
from omniman_ros.surroundings.framed_obstacles import FramedObstacles
from omniman_ros.surroundings.obstacles import Observation, ObstacleParameters
from omniman_ros.viewer.lines import outlines, thinned
from omniman_ros.viewer.ros.lazy_subscriptions import LazySubscriptions
from omniman_ros.viewer.ros.page_frames import PageFrames
from omniman_ros.viewer.ros.robot_topics import path_points
from omniman_ros.viewer.view_state import ViewState

MAX_OBSTACLES = 100  #: Largest number of obstacles drawn; more are thinned evenly
MAX_PREDICTED = 200  #: Largest number of predicted obstacles drawn; more are thinned evenly
MAX_PLOTTED = 1e6  #: Largest number that is plotted: no plot can scale a larger one


class PlannerTopics:
    """Receives plan, route, obstacles and the planner's status."""

    def __init__(
        self,
        node: OmnimanNode,
        subscriptions: LazySubscriptions,
        state: ViewState,
        odom_names: tuple[str, ...],
        frames: PageFrames,
        is_own: Callable[[str], bool],
    ) -> None:
        self._node = node
        self._state = state
        self._odom_names, self._frames = odom_names, frames
        self._is_own = is_own
        self._obstacles = FramedObstacles(build(ObstacleParameters, {}))
        on_obstacles = frames.transforms.deferred("obstacles", marker_headers, self._on_obstacles)
        subscriptions.subscribe(MarkerArray, "obstacles", on_obstacles, 50)
        subscriptions.subscribe(DiagnosticStatus, "mpc/status", self._on_status)
        # The planner computes these for its subscribers only.
        for name in ("plan", "route"):
            on_line = partial(self._on_line, name)
            subscriptions.subscribe_while_watched(Path, f"mpc/{name}", on_line)
        subscriptions.subscribe_while_watched(
            MarkerArray, "mpc/predicted_obstacles", self._on_predicted
        )

    def update_state(self, now: float) -> None:
        """Write other sources' obstacles into the state, extrapolated at constant velocity."""
        try:
            ellipses = self._obstacles.ellipses(now, self._frames.pose)
        except InputError:  # where they are is not known any more
            ellipses = Ellipses.none()
        indices = np.array(list(thinned(len(ellipses), MAX_OBSTACLES)), dtype=int)
        self._state.other_obstacles = ellipses.select(indices)

    def _on_obstacles(self, message: MarkerArray) -> str:
        others = [marker for marker in message.markers if not self._is_own(marker.ns)]
        if message.markers and not others:
            return ""
        faults = obstacle_interface.update_obstacles(
            self._node,
            MarkerArray(markers=others),
            self._obstacles,
            partial(self._frames.placement, "obstacles"),
        )
        return faults[0] if faults else ""

    def _on_line(self, name: str, message: Path) -> None:
        points = path_points(message, self._odom_names)[:, :2]
        self._state.update_line(name, points, self._node.now())

    def _on_predicted(self, message: MarkerArray) -> str:
        changes, faults = marker_changes(message, within(*self._odom_names), lambda stamp: 0.0)
        predicted = [change for change in changes if isinstance(change, Observation)]
        drawn = [predicted[i] for i in thinned(len(predicted), MAX_PREDICTED)]
        points = outlines(
            np.array([(obstacle.x, obstacle.y) for obstacle in drawn]).reshape(-1, 2),
            np.array([obstacle.semi_axes for obstacle in drawn]).reshape(-1, 2),
            np.array([obstacle.angle for obstacle in drawn], dtype=float),
        )
        self._state.update_line("predicted", points, self._node.now())
        return faults[0] if faults else ""

    def _on_status(self, message: DiagnosticStatus) -> None:
        now = self._node.now()
        values = {item.key: item.value for item in message.values}
        self._state.update_planner(values | {"message": message.message}, now)
        if self._state.planner_is_driving(now):
            signal = np.array([_number(values, "solve_ms"), 1e3 * _number(values, "slack_m")])
            self._state.update_signal("solving", signal, now)


def _number(values: dict[str, str], key: str) -> float:
    """Return a number of a status, NaN if it is missing or cannot be plotted."""
    try:
        value = float(values.get(key, ""))
    except ValueError:
        return np.nan
    return value if abs(value) <= MAX_PLOTTED else np.nan
