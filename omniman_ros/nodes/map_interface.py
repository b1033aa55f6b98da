"""The map of fixed obstacles, which stays in its own frame."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray

from omniman_ros.conversions.geometry import yaw_from_quaternion
from omniman_ros.conversions.headers import is_stamped, time_seconds
from omniman_ros.core import se2
from omniman_ros.core.errors import InputError
from omniman_ros.core.rigid import PlanarPose
from omniman_ros.nodes import map_messages
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.planning.obstacles.grid_map import GridMap

MOST_SHIFT = 0.005
"""Distance by which a map may be wrong where the robot is, before it is moved [m]."""
MOST_TURN = 0.002
"""Angle by which a map may be wrong before it is moved [rad]: 1 cm at a distance of 5 m."""

Rule = tuple[int, bool]
"""Occupancy from which on a cell counts as occupied, 1 to 100 [%], and whether cells of unknown
occupancy are free."""


@dataclass(frozen=True)
class _Cells:
    """The last map as it was sent, with all updates since.

    Attributes:
        values: (rows, columns) occupancy of the cells [%], -1 where it is unknown.
        resolution: Edge of a cell [m].
        origin: Pose of the corner of the first cell in `frame` [m, m, rad].
        frame: Frame in which the map stays.
        name: Frame that the messages give, without a leading slash.
        time: Stamp of the last message [s]; minus infinity without one.
    """

    values: NDArray[np.int8]
    resolution: float
    origin: PlanarPose
    frame: str
    name: str
    time: float

    def grid(self, rule: Rule) -> GridMap:
        """Return the map in its own frame.

        Raises:
            InputError: A cell or the map is refused; see `GridMap`.
        """
        height, width = self.values.shape
        origin = np.array(self.origin)
        cells = self.values.ravel()
        return GridMap.of_occupancy(cells, width, height, self.resolution, origin, *rule)

    def updated(self, message: Any) -> "_Cells":
        """Return the map with the cells of an update.

        Raises:
            InputError: The update is of another frame, older than what it changes, of another size
                than it says, or not inside of the map.
        """
        name, time = message.header.frame_id.lstrip("/"), _time(message.header)
        if name != self.name:
            raise InputError(f"its frame is {name!r}, that of the map {self.name!r}")
        if time < self.time:
            raise InputError(f"stale, {self.time - time:.3f} s before the map it would change")
        x, y, width, height = message.x, message.y, message.width, message.height
        if width * height != len(message.data) or not len(message.data):
            raise InputError(f"there are {len(message.data)} cells, expected {width} x {height}")
        rows, columns = self.values.shape
        if x < 0 or y < 0 or x + width > columns or y + height > rows:
            raise InputError(
                f"{width} x {height} cells from ({x}, {y}) on are not inside of a map of "
                f"{columns} x {rows}"
            )
        values = self.values.copy()
        cells = np.asarray(message.data, dtype=np.int8).reshape(height, width)
        values[y : y + height, x : x + width] = cells
        return _Cells(values, self.resolution, self.origin, self.frame, self.name, time)


def _time(header: Any) -> float:
    """Return the stamp of a header [s]; minus infinity without one."""
    return time_seconds(header.stamp) if is_stamped(header.stamp) else -math.inf


class MapInterface:
    """Keeps the last map of `map` and `map_updates`, and says where it is in odom on any change.

    Args:
        node: Node that receives the messages.
        frames: Transforms of the node.
        rule: How its cells are read.
        use: Called with the map in odom.
    """

    def __init__(
        self,
        node: OmnimanNode,
        frames: FrameTransforms,
        rule: Rule,
        use: Callable[[GridMap], None],
    ) -> None:
        self._node, self._frames, self._use = node, frames, use
        self._cells: _Cells | None = None
        self._grid: GridMap | None = None
        self._rule = rule
        self._anchor: PlanarPose = (0.0, 0.0, 0.0)
        updates = map_messages.OccupancyGridUpdate
        if updates is None:
            node.get_logger().info("map_msgs is not installed: map_updates are not received")
        for kind, topic, handler, qos in (
            (OccupancyGrid, map_messages.TOPIC, self._on_map, LATCHED),
            (updates, map_messages.UPDATES_TOPIC, self._on_update, map_messages.UPDATES),
        ):
            if kind is not None:
                waiting = frames.deferred(topic, lambda message: [message.header], handler)
                node.create_subscription(kind, topic, node.guarded(topic, waiting), qos)

    def configure(self, rule: Rule) -> None:
        """Read the cells of the last map by another rule.

        A latched map may be sent only once, so the one that is kept has to follow its parameters.

        Args:
            rule: How its cells are read.
        """
        if rule == self._rule:
            return
        self._rule = rule
        if self._cells is not None:
            self._keep(self._cells, self._anchor)

    def update(self, robot: PlanarPose) -> None:
        """Move the map if its frame has moved against odom.

        Args:
            robot: Pose of the robot in odom, near which the map has to be right [m, m, rad].
        """
        if self._cells is None:
            return
        anchor = self._frames.anchor(self._cells.frame).planar()
        if anchor == self._anchor:
            return
        x, y, theta = se2.displacement(self._anchor, anchor, robot)
        if math.hypot(x, y) > MOST_SHIFT or abs(theta) > MOST_TURN:
            self._place(anchor)

    def _on_map(self, message: OccupancyGrid) -> None:
        placement, info = self._frames.placement(message.header), message.info
        position, theta = info.origin.position, yaw_from_quaternion(info.origin.orientation)
        values = np.asarray(message.data, dtype=np.int8)
        if not values.size or values.size != info.width * info.height:
            raise InputError(
                f"map: there are {values.size} cells, expected {info.width} x {info.height}"
            )
        cells = _Cells(
            values.reshape(info.height, info.width),
            info.resolution,
            se2.compose(placement.transform.planar(), (position.x, position.y, theta)),
            placement.frame,
            message.header.frame_id.lstrip("/"),
            _time(message.header),
        )
        before = self._grid
        self._keep(cells, self._frames.anchor(placement.frame).planar())
        assert self._grid is not None
        if before is None or before.size != self._grid.size:
            length, width = self._grid.size
            self._node.get_logger().info(f"map received: {length:.1f} x {width:.1f} m")

    def _on_update(self, message: Any) -> str | None:
        if self._cells is None:
            return "there is no map yet that it could change"
        self._keep(self._cells.updated(message), self._anchor)
        return None

    def _keep(self, cells: _Cells, anchor: PlanarPose) -> None:
        """Keep and use a map, unless it is refused."""
        self._grid, self._cells = cells.grid(self._rule), cells
        self._place(anchor)

    def _place(self, anchor: PlanarPose) -> None:
        assert self._grid is not None and self._cells is not None
        self._anchor = anchor
        self._use(self._grid if not self._cells.frame else self._grid.displaced(anchor))
