"""What is around the robot, each part with what a user calls it."""

from omniman_ros.collision.obstacle_shapes import grid_obstacles
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.surroundings_interface import SurroundingsInterface
from omniman_ros.nodes.surroundings_parameters import SurroundingsParameters
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.surroundings.grid_map import GridMap
from omniman_ros.surroundings.obstacles import Key


class NamedSurroundings(SurroundingsInterface):
    """Takes snapshots of obstacles and map."""

    def __init__(
        self, node: OmnimanNode, frames: FrameTransforms, parameters: SurroundingsParameters
    ) -> None:
        self._node = node
        self._standing = UprightObstacles.join([])
        self._standing_names: tuple[str, ...] = ()
        super().__init__(node, frames, parameters.obstacles, parameters.map_reading, self._use_map)

    def snapshot(self) -> ObstacleSnapshot:
        """Return what is around the robot now, in odom; rates are by the second.

        Obstacles are named by namespace and number of their markers, parts of the map by where
        their middles are.
        """
        return ObstacleSnapshot.of_ellipses(
            self._node.now(),
            self.obstacles.ellipses(),
            [_name(key) for key in self.obstacles.keys],
            self._standing,
            self._standing_names,
        )

    def _use_map(self, grid: GridMap) -> None:
        self._standing = grid_obstacles(grid)
        self._standing_names = tuple(
            f"the map at ({x:.2f}, {y:.2f}) m" for x, y in self._standing.centre.T.tolist()
        )


def _name(key: Key) -> str:
    """Return what a user calls an obstacle, by namespace and number of its marker."""
    namespace, number = key
    return f"obstacle {namespace}/{number}" if namespace else f"obstacle {number}"
