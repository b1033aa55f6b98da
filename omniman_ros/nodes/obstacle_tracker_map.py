"""The rolling map of an obstacle tracker on its topics: whole, or what has changed."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray
from rclpy.publisher import Publisher

from omniman_ros.conversions.maps import map_message, map_update_message
from omniman_ros.core.arrays import Array
from omniman_ros.core.occupancy import changed_cells
from omniman_ros.nodes import map_messages
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.stop_interface import LATCHED

if TYPE_CHECKING:
    from omniman_ros.perception.obstacle_tracker import ObstacleTracker

#: Longest time between two whole maps, after which a reader that has missed an update is right
#: again [s].
WHOLE_PERIOD = 5.0


class MapPublisher:
    """Publishes `map` and `map_updates`.

    A whole map is sent where the map has moved, for a new reader, and every `WHOLE_PERIOD`; in
    between, if all readers of `map` read `map_updates` too, the rectangle of what has changed.
    """

    def __init__(
        self, node: OmnimanNode, core: "ObstacleTracker", frame: str, rate: float
    ) -> None:
        self._node, self._core, self._frame = node, core, frame
        self._maps = node.create_publisher(OccupancyGrid, map_messages.TOPIC, LATCHED)
        self._updates: Publisher | None = None
        if map_messages.OccupancyGridUpdate is None:
            node.get_logger().info("map_msgs is not installed: map is always sent whole")
        else:
            self._updates = node.create_publisher(
                map_messages.OccupancyGridUpdate, map_messages.UPDATES_TOPIC, map_messages.UPDATES
            )
        self._sent: tuple[NDArray[np.int8], Array] | None = None
        self._time = self._whole = -math.inf
        self._readers = 0
        node.every(1.0 / rate, self._publish)

    def _publish(self) -> None:
        """Publish the map if a scan has come since the last time."""
        core = self._core
        if core.time == self._time or not np.isfinite(core.time):
            return
        cells, origin = core.occupancy(), core.map.origin
        stamp = self._node.stamp(core.time)
        if self._is_whole(core.time, origin):
            self._whole = core.time
            self._maps.publish(map_message(cells, core.map.resolution, origin, self._frame, stamp))
        else:
            assert self._sent is not None and self._updates is not None
            changed = changed_cells(self._sent[0], cells)
            if changed is not None:
                kind: Any = map_messages.OccupancyGridUpdate
                self._updates.publish(map_update_message(kind, cells, changed, self._frame, stamp))
        self._time, self._sent = core.time, (cells, origin)

    def _is_whole(self, time: float, origin: Array) -> bool:
        before, self._readers = self._readers, self._maps.get_subscription_count()
        if self._updates is None or self._sent is None:
            return True
        return (
            self._readers > min(before, self._updates.get_subscription_count())
            or not self._whole <= time < self._whole + WHOLE_PERIOD
            or not np.array_equal(origin, self._sent[1])
        )
