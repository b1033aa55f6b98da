"""Topics with what is around the robot: obstacles, and a map of what stands."""

from omniman_ros.collision.obstacle_shapes import grid_obstacles
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.core.rigid import PlanarPose
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.map_interface import MapInterface
from omniman_ros.nodes.obstacle_interface import ObstacleInterface
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.source_watch import SourceWatch
from omniman_ros.nodes.surroundings_parameters import SurroundingsParameters
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.surroundings.grid_map import GridMap
from omniman_ros.surroundings.obstacles import Key


class SurroundingsInterface:
    """Subscribes to `obstacles`, `map` and `map_updates`."""

    def __init__(
        self, node: OmnimanNode, frames: FrameTransforms, parameters: SurroundingsParameters
    ) -> None:
        self._node = node
        self._watch = SourceWatch(node, frames)
        self._obstacles = ObstacleInterface(node, frames, parameters.obstacles, self._watch)
        self._standing = UprightObstacles.join([])
        self._standing_names: tuple[str, ...] = ()
        self._map = MapInterface(
            node, frames, parameters.map_reading.rule, self._use_map, self._watch
        )

    def configure(self, parameters: SurroundingsParameters) -> None:
        """Use other parameters."""
        self._obstacles.configure(parameters.obstacles)
        self._map.configure(parameters.map_reading.rule)

    def __len__(self) -> int:
        return len(self._obstacles)

    def update_map(self, robot: PlanarPose) -> None:
        """Move the map if its frame has moved against odom, near the robot's pose there."""
        self._map.update(robot)

    def silence_reason(self) -> str:
        """Return why it is not known what is around the robot, or an empty string."""
        return self._watch.blind_reason()

    def dismiss_silent_source(self) -> None:
        """Stop waiting for a silent source of obstacles that no longer exists: see there."""
        self._obstacles.dismiss_silent_source()

    def obstacle_snapshot(self) -> ObstacleSnapshot:
        """Return what is around the robot now, in odom; rates are by the second.

        Obstacles are named by namespace and number of their markers, parts of the map by where
        their middles are.
        """
        return ObstacleSnapshot.of_ellipses(
            self._node.now(),
            self._obstacles.ellipses(),
            [_name(key) for key in self._obstacles.keys],
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
