"""What the viewer hears of the planner and of what is around: topics into a `Picture`."""

from collections.abc import Callable

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Path
from visualization_msgs.msg import MarkerArray

from omniman_ros import conversions
from omniman_ros.core.parameters import build
from omniman_ros.nodes import obstacle_port
from omniman_ros.nodes.runtime import OmnimanNode
from omniman_ros.nodes.viewing.ears import Ears
from omniman_ros.nodes.viewing.robot_senses import path_points
from omniman_ros.planning.obstacles import Observation, ObstacleParameters, ObstacleSet
from omniman_ros.viewer.lines import outlines, thinned
from omniman_ros.viewer.state import SILENCE, Picture

SHOWN = 100
"""So many obstacles are drawn at most; of more, every second, third, ..."""
PREDICTED = 200
"""The same for where they are expected."""
LARGEST = 1e6
"""Of a number that is plotted: what is larger no plot can scale."""
DRIVING = ("driving", "blocked")
"""States of the planner with a goal to drive to."""


class PlannerSenses:
    """Plan, route, obstacles, and what the planner says of itself.

    Args:
        node: Who hears.
        ears: Its subscriptions.
        picture: What is told.
        frames: Which are taken for odom.
        ours: Whether an obstacle of a namespace is one that this page has placed.
    """

    def __init__(
        self, node: OmnimanNode, ears: Ears, picture: Picture, frames: tuple[str, ...],
        ours: Callable[[str], bool],
    ) -> None:  # fmt: skip
        self._node = node
        self._picture = picture
        self._frames = frames
        self._ours = ours
        self._obstacles = ObstacleSet(build(ObstacleParameters, {}))
        self._routed = -np.inf
        ears.hear(MarkerArray, "obstacles", self._on_obstacles, 50)
        ears.hear(DiagnosticStatus, "mpc/status", self._on_status)
        # The planner makes these only for those who listen.
        ears.hear_watched(Path, "mpc/plan", self._on_plan)
        ears.hear_watched(Path, "mpc/route", self._on_route)
        ears.hear_watched(MarkerArray, "mpc/predicted_obstacles", self._on_predicted)

    @property
    def driving(self) -> bool:
        """Whether the planner says that it drives to a goal."""
        picture = self._picture
        fresh = picture.is_fresh("planner", self._node.now())
        return fresh and picture.planner.get("state") in DRIVING

    @property
    def paused(self) -> bool:
        """Whether the planner says that it holds on the way to a goal."""
        picture = self._picture
        fresh = picture.is_fresh("planner", self._node.now())
        return fresh and picture.planner.get("state") == "paused"

    def sample(self, now: float) -> None:
        """Forget a route that is not repeated."""
        if len(self._picture.route.points) and now - self._routed >= SILENCE:
            self._picture.route.set(np.empty((0, 2)))

    def show(self, now: float) -> None:
        """Put obstacles where they are now, at constant velocity since they were observed."""
        around = self._obstacles.ellipses(now)
        self._picture.seen = around.select(np.array(list(thinned(len(around), SHOWN)), dtype=int))

    def _on_obstacles(self, message: MarkerArray) -> str:
        others = [marker for marker in message.markers if not self._ours(marker.ns)]
        if message.markers and not others:
            return ""
        complaints = obstacle_port.hear(
            self._node, MarkerArray(markers=others), self._obstacles, self._frames
        )
        return complaints[0] if complaints else ""

    def _on_plan(self, message: Path) -> None:
        self._picture.hear_plan(path_points(message, self._frames)[:, :2], self._node.now())

    def _on_route(self, message: Path) -> None:
        self._picture.route.set(path_points(message, self._frames)[:, :2])
        self._routed = self._node.now()

    def _on_predicted(self, message: MarkerArray) -> str:
        changes, complaints = conversions.marker_changes(
            message, self._frames, lambda stamp: 0.0, Observation
        )
        found = [change for change in changes if isinstance(change, Observation)]
        shown = [found[i] for i in thinned(len(found), PREDICTED)]
        around = outlines(
            np.array([(one.x, one.y) for one in shown]).reshape(-1, 2),
            np.array([one.semi_axes for one in shown]).reshape(-1, 2),
            np.array([one.angle for one in shown], dtype=float),
        )
        self._picture.hear_predicted(around, self._node.now())
        return complaints[0] if complaints else ""

    def _on_status(self, message: DiagnosticStatus) -> None:
        now = self._node.now()
        said = {item.key: item.value for item in message.values}
        self._picture.hear_planner(said | {"message": message.message}, now)
        if said.get("state") in DRIVING:
            solving = np.array([_number(said, "solve_ms"), 1e3 * _number(said, "slack_m")])
            self._picture.hear("solving", solving, now)


def _number(said: dict[str, str], key: str) -> float:
    """A number of a status, NaN where there is none that can be plotted."""
    try:
        value = float(said.get(key, ""))
    except ValueError:
        return np.nan
    return value if abs(value) <= LARGEST else np.nan
