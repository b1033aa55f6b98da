"""The paths of the page's obstacles on the floor, whose way points can be dragged."""

import numpy as np
import viser

from omniman_ros.viewer import style
from omniman_ros.viewer.events import ObstaclePathSet
from omniman_ros.viewer.floor_shapes import disc
from omniman_ros.viewer.lines import Line
from omniman_ros.viewer.obstacle_paths import WaypointPath, drawn_course
from omniman_ros.viewer.optimistic_updates import Key
from omniman_ros.viewer.page.draggable_markers import OPAQUE, MeshBatch
from omniman_ros.viewer.page.dragging import FloorDragging, Pair
from omniman_ros.viewer.page.floor_scene import SceneLine
from omniman_ros.viewer.placed_obstacles import ObstacleArrays

WAYPOINT_RADIUS = 0.07  #: Radius of the disc at a way point [m]
WAYPOINT_HEIGHT = 0.03  #: Height of the disc at a way point [m]
LINE_BREAK = np.full((1, 2), np.nan)  #: Separates two paths of one line


class PathMarkers:
    """Lines along the paths that turn or follow way points, and a disc at each way point."""

    def __init__(self, api: viser.SceneApi, root: str, dragging: FloorDragging) -> None:
        self._dragging = dragging
        self._drawn = ObstacleArrays.empty().placed
        # Obstacle's number, index and path of each disc; replaced as a whole, because the drags
        # read them in another thread.
        self._points: list[tuple[int, int, WaypointPath]] = []
        self._line = Line()
        self._lines = SceneLine(api, f"{root}/obstacle_paths", style.OBSTACLE_PATH, 2.0, 2)
        shape = disc(WAYPOINT_RADIUS, WAYPOINT_HEIGHT).moved(0.0, 0.0, 0.5 * WAYPOINT_HEIGHT)
        self._discs = MeshBatch(api, f"{root}/waypoints", shape, style.WAYPOINT, OPAQUE)
        dragging.enable(self._discs.handle, self._grab, self._move)

    def draw(self, obstacles: ObstacleArrays) -> None:
        """Draw the paths of the obstacles."""
        if obstacles.placed == self._drawn:
            return
        self._drawn = obstacles.placed
        courses = [drawn_course(obstacle.path) for obstacle in obstacles.placed]
        pieces = [piece for course in courses for piece in (course, LINE_BREAK)]
        self._line.set(np.concatenate([LINE_BREAK, *pieces]))
        self._lines.show(self._line.points, self._line.version)
        self._points = [
            (obstacle.number, index, obstacle.home)
            for obstacle in obstacles.placed
            if isinstance(obstacle.home, WaypointPath)
            for index in range(len(obstacle.home.points))
        ]
        count = len(self._points)
        places = np.array([path.points[index] for _, index, path in self._points]).reshape(-1, 2)
        positions = np.column_stack([places, np.zeros(count)])
        upright = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
        self._discs.draw(positions, upright, np.ones((count, 3)), None)

    def _grab(self, instance: int | None) -> tuple[Key, Pair] | None:
        points = self._points
        if instance is None or not 0 <= instance < len(points):
            return None
        number, index, path = points[instance]
        return (number, index), path.points[index]

    def _move(self, key: Key, position: Pair, done: bool) -> None:
        for number, index, path in self._points:
            if (number, index) == key:
                self._dragging.post(ObstaclePathSet(number, path.with_point(index, position)))
