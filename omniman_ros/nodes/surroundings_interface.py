"""Topics with what is around the robot: obstacles, and a map of what stands."""

import numpy as np
from rclpy.qos import QoSProfile
from visualization_msgs.msg import MarkerArray

from omniman_ros.collision.solids import UprightSolids
from omniman_ros.collision.surroundings import Surroundings
from omniman_ros.core.rigid import PlanarPose
from omniman_ros.nodes import obstacle_interface
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.map_interface import MapInterface
from omniman_ros.nodes.obstacle_interface import marker_headers
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.surroundings_parameters import SurroundingsParameters
from omniman_ros.planning.obstacles.framed_obstacles import FramedObstacles
from omniman_ros.planning.obstacles.grid_map import GridMap
from omniman_ros.planning.obstacles.obstacles import Key
from omniman_ros.planning.obstacles.surroundings import ellipse_surroundings, grid_solids
from omniman_ros.planning.whole_body.surroundings import Hindrances


class SurroundingsInterface:
    """Subscribes to `obstacles`, `map` and `map_updates`.

    Args:
        node: Node that receives the messages.
        frames: Transforms of the node.
        parameters: Parameters.
    """

    def __init__(
        self, node: OmnimanNode, frames: FrameTransforms, parameters: SurroundingsParameters
    ) -> None:
        self._node, self._frames = node, frames
        self._obstacles = FramedObstacles(parameters.obstacles)
        self._standing = UprightSolids.join([])
        self._standing_names: tuple[str, ...] = ()
        self._map = MapInterface(node, frames, parameters.map_reading.rule, self._use_map)
        handler = frames.deferred("obstacles", marker_headers, self._on_obstacles)
        node.create_subscription(
            MarkerArray, "obstacles", node.guarded("obstacles", handler), QoSProfile(depth=50)
        )

    def configure(self, parameters: SurroundingsParameters) -> None:
        """Use other parameters."""
        self._obstacles.configure(parameters.obstacles)
        self._map.configure(parameters.map_reading.rule)

    def __len__(self) -> int:
        """Return the number of obstacles."""
        return len(self._obstacles)

    def update_map(self, robot: PlanarPose) -> None:
        """Move the map if its frame has moved against odom, near the robot's pose there."""
        self._map.update(robot)

    def silence_reason(self) -> str:
        """Return why the source of obstacles cannot be trusted now, or an empty string."""
        return self._obstacles.silence_reason(self._node.now())

    def dismiss_silent_source(self) -> None:
        """Stop waiting for a silent source of obstacles that no longer exists.

        Only a new task justifies this: somebody has sent it without the source.
        """
        if self.silence_reason() and not self._node.count_publishers("obstacles"):
            self._obstacles.dismiss_source()
            if not self.silence_reason():
                text = "the source of obstacles is gone: the last known obstacles are used"
                self._node.warn("source gone", text)

    def hindrances(self) -> Hindrances:
        """Return what is around the robot now, in odom; rates are by the second.

        Obstacles are named by namespace and number of their markers, parts of the map by where
        their middles are.
        """
        now = self._node.now()
        ellipses = self._obstacles.ellipses(now, lambda frame: self._frames.anchor(frame).planar())
        found = ellipse_surroundings(ellipses)
        moves = found.is_moving
        standing = found.solids.select(np.flatnonzero(~moves))
        names = [_name(key) for key in self._obstacles.keys]
        still = tuple(name for name, moved in zip(names, moves, strict=True) if not moved)
        walking = tuple(name for name, moved in zip(names, moves, strict=True) if moved)
        return Hindrances(
            now,
            UprightSolids.join([standing, self._standing]),
            Surroundings(found.solids.select(np.flatnonzero(moves)), found.velocity[:, moves]),
            ellipses.growth[moves],
            (*still, *self._standing_names, *walking),
        )

    def _use_map(self, grid: GridMap) -> None:
        self._standing = grid_solids(grid)
        self._standing_names = tuple(
            f"the map at ({x:.2f}, {y:.2f}) m" for x, y in self._standing.centre.T.tolist()
        )

    def _on_obstacles(self, message: MarkerArray) -> str:
        faults = obstacle_interface.update_obstacles(
            self._node, message, self._obstacles, self._frames.placement
        )
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        return faults[0] + more if faults else ""


def _name(key: Key) -> str:
    """Return what a user calls an obstacle, by namespace and number of its marker."""
    namespace, number = key
    return f"obstacle {namespace}/{number}" if namespace else f"obstacle {number}"
