"""Topics that show plans to people; nothing is computed for a topic without subscribers."""

from typing import TYPE_CHECKING

import numpy as np
from nav_msgs.msg import Path
from visualization_msgs.msg import MarkerArray

from omniman_ros.conversions.obstacles import ellipse_markers
from omniman_ros.conversions.poses import path_message
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.planning.obstacles.ellipses import Ellipses

if TYPE_CHECKING:
    from omniman_ros.planning.planner import Planner

PREDICTION_TIMES = (0.5, 1.0, 1.5)  #: Times ahead at which predicted obstacles are shown [s]


class PlanPublisher:
    """Publishes `mpc/plan`, `mpc/route` and `mpc/predicted_obstacles`."""

    def __init__(self, node: OmnimanNode, frame: str, planner: "Planner") -> None:
        self._node, self._frame, self._planner = node, frame, planner
        self._plan = node.create_publisher(Path, "mpc/plan", 10)
        self._route = node.create_publisher(Path, "mpc/route", 10)
        self._predicted = node.create_publisher(MarkerArray, "mpc/predicted_obstacles", 10)

    def publish(self, now: float, obstacles: Ellipses) -> None:
        """Publish the plan, the route and the predicted obstacles from the time `now` [s] on."""
        stamp, motion = self._node.stamp(now), self._planner.motion
        if self._plan.get_subscription_count():
            part = motion.between(now, max(motion.end, now + 0.01))
            plan = path_message(part.poses, self._frame)
            plan.header.stamp = stamp
            self._plan.publish(plan)
        route_planner = self._planner.route_planner
        route = None if route_planner is None else route_planner.route
        if route is not None and self._route.get_subscription_count():
            message = path_message(route.poses, self._frame)
            message.header.stamp = stamp
            self._route.publish(message)
        if self._predicted.get_subscription_count():
            times = now + np.array(PREDICTION_TIMES)
            self._predicted.publish(ellipse_markers(obstacles, times, self._frame, stamp))
