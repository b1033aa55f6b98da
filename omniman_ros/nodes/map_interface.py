"""The map of fixed obstacles, which stays in its own frame."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from builtin_interfaces.msg import Time
from nav_msgs.msg import OccupancyGrid
from std_msgs.msg import Header

from omniman_ros.conversions.maps import map_from_message, map_update_from_message
from omniman_ros.core import se2
from omniman_ros.core.errors import InputError
from omniman_ros.core.rigid import PlanarPose
from omniman_ros.core.source_monitor import SourceMonitor, SourceTerms
from omniman_ros.core.stamps import comparable
from omniman_ros.core.transform_tree import ODOM, Placement, TransformError
from omniman_ros.nodes import map_messages
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.source_watch import SourceWatch
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.surroundings.grid_map import GridMap
from omniman_ros.surroundings.occupancy import OccupancyMap

#: Distance by which a map may be wrong where the robot is, before it is moved [m]
MOST_SHIFT = 0.005
#: Angle by which a map may be wrong before it is moved [rad]: 1 cm at a distance of 5 m
MAX_ROTATION_ERROR = 0.002
#: Period at which a map is placed again whose transform was missing [s]: it comes only once
MAP_TRANSFORM_PERIOD = 0.5
#: What is expected of the source of the map: it may send once, as it is latched
TERMS = SourceTerms(patience=2.0)

#: Occupancy from which on a cell counts as occupied, 1 to 100 [%], and whether cells of unknown
#: occupancy are free.
Rule = tuple[int, bool]


class MapInterface:
    """Keeps the last map of `map` and `map_updates`, and says where it is in odom."""

    def __init__(
        self,
        node: OmnimanNode,
        frames: FrameTransforms,
        rule: Rule,
        use: Callable[[GridMap], None],
        watch: SourceWatch,
    ) -> None:
        self._node, self._frames, self._use = node, frames, use
        self._source = SourceMonitor(map_messages.TOPIC, TERMS)
        self._unplaced: OccupancyGrid | None = None
        self._map: OccupancyMap | None = None
        self._grid: GridMap | None = None
        self._rule = rule
        self._placement = Placement(ODOM)
        self._anchor: PlanarPose = (0.0, 0.0, 0.0)
        watch.subscribe(OccupancyGrid, self._source, _headers, self._on_map, LATCHED)
        node.every(MAP_TRANSFORM_PERIOD, self._place_late)
        updates, topic = map_messages.OccupancyGridUpdate, map_messages.UPDATES_TOPIC
        if updates is None:
            node.get_logger().info("map_msgs is not installed: map_updates are not received")
            return
        waiting = frames.deferred(topic, _headers, self._on_update)
        node.create_subscription(
            updates, topic, node.guarded(topic, waiting), map_messages.UPDATES
        )

    def configure(self, rule: Rule) -> None:
        """Read the cells of the last map, which may be sent only once, by another rule."""
        if rule == self._rule:
            return
        self._rule = rule
        if self._map is not None:
            self._keep(self._map, self._placement)

    def update(self, robot: PlanarPose) -> None:
        """Move the map if its frame has moved against odom near the robot.

        Args:
            robot: Pose of the robot in odom, near which the map has to be right [m, m, rad].
        """
        if self._grid is None:
            return
        anchor = self._frames.anchor(self._placement.frame).planar()
        if anchor == self._anchor:
            return
        x, y, theta = se2.displacement(self._anchor, anchor, robot)
        if math.hypot(x, y) > MOST_SHIFT or abs(theta) > MAX_ROTATION_ERROR:
            self._place(self._grid, anchor)

    def _on_map(self, message: OccupancyGrid) -> None:
        self._unplaced = None
        try:
            self._node.demand_not_ahead(message.header.stamp)
        except InputError as error:
            # A latched map outlives a simulation that begins anew: without it, walls are missing.
            self._node.warn("map: stamp", f"map used without its stamp: {error}")
            message.header.stamp = Time()
        try:
            placement = self._frames.placement(message.header)
        except TransformError:
            self._unplaced = message
            raise
        before = self._grid
        grid = self._keep(map_from_message(message), placement)
        if before is None or before.size != grid.size:
            length, width = grid.size
            self._node.get_logger().info(f"map received: {length:.1f} x {width:.1f} m")

    def _place_late(self) -> None:
        """Use the last map if its transform was missing, and has come."""
        if self._unplaced is None:
            return
        message = self._unplaced
        try:
            self._frames.into_odom(message.header)
            self._on_map(message)
        except TransformError:
            return
        except InputError as error:
            self._source.refuse(str(error))
            self._node.warn("map", f"map ignored: {error}")
        else:
            self._source.use(self._node.now())

    def _on_update(self, message: Any) -> str | None:
        update = map_update_from_message(message)
        if self._map is None:
            return self._lost("there is no map yet that it could change")
        kept = replace(self._map, time=comparable(self._map.time, 1e-9 * self._node.ros_time()))
        try:
            self._node.demand_not_ahead(message.header.stamp)
            changed = kept.updated(update)
        except InputError as error:
            if not update.is_before(kept):  # else the map has newer cells
                self._lost(str(error))
            raise
        self._keep(changed, self._placement)
        return None

    def _lost(self, reason: str) -> str:
        """Note and return why an update cannot be used; the next whole map has what it told."""
        self._source.refuse(f"a part of it is not known: map_updates: {reason}")
        return reason

    def _keep(self, received: OccupancyMap, placement: Placement) -> GridMap:
        """Keep, use and return a map, unless it is refused."""
        grid = GridMap.of_occupancy(received, *self._rule)
        grid = grid.displaced(placement.transform.planar())
        anchor = self._frames.anchor(placement.frame).planar()
        self._grid, self._map, self._placement = grid, received, placement
        self._place(grid, anchor)
        return grid

    def _place(self, grid: GridMap, anchor: PlanarPose) -> None:
        self._anchor = anchor
        self._use(grid.displaced(anchor) if self._placement.frame else grid)


def _headers(message: Any) -> list[Header]:
    return [message.header]
