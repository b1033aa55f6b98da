"""Topics with what is around the robot: obstacles, and a map of what stands."""

from collections.abc import Callable

from omniman_ros.core.rigid import PlanarPose
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.map_interface import MapInterface
from omniman_ros.nodes.obstacle_interface import ObstacleInterface
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.source_watch import SourceWatch
from omniman_ros.nodes.surroundings_parameters import MapReading
from omniman_ros.surroundings.grid_map import GridMap
from omniman_ros.surroundings.obstacles import ObstacleParameters


class SurroundingsInterface:
    """Subscribes to `obstacles`, `map` and `map_updates`, and knows when it is blind.

    Args:
        use_map: Called with each map, where it is in odom.

    Attributes:
        obstacles: What is known of the obstacles.
    """

    def __init__(
        self,
        node: OmnimanNode,
        frames: FrameTransforms,
        obstacles: ObstacleParameters,
        reading: MapReading,
        use_map: Callable[[GridMap], None],
    ) -> None:
        self._watch = SourceWatch(node, frames)
        self.obstacles = ObstacleInterface(node, frames, obstacles, self._watch)
        self._map = MapInterface(node, frames, reading.rule, use_map, self._watch)

    def configure(self, obstacles: ObstacleParameters, reading: MapReading) -> None:
        """Use other parameters."""
        self.obstacles.configure(obstacles)
        self._map.configure(reading.rule)

    def update_map(self, robot: PlanarPose) -> None:
        """Move the map if its frame has moved against odom, near the robot's pose there."""
        self._map.update(robot)

    def blind_reason(self) -> str:
        """Return why it is not known what is around the robot, or an empty string."""
        return self._watch.blind_reason()
