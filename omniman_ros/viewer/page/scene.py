"""3D scene of the viewer's page."""

import time
from collections.abc import Callable

import numpy as np
import viser

from omniman_ros.core.platform import Platform
from omniman_ros.motion.whole_body.model import Mount
from omniman_ros.viewer.page.draggable_markers import DraggableMarkers
from omniman_ros.viewer.page.dragging import FloorDragging
from omniman_ros.viewer.page.floor_clicks import FloorClicks
from omniman_ros.viewer.page.floor_scene import FloorScene
from omniman_ros.viewer.page.inputs import Post
from omniman_ros.viewer.page.path_markers import PathMarkers
from omniman_ros.viewer.page.perceived_scene import PerceivedScene
from omniman_ros.viewer.page.robot_scene import RobotScene
from omniman_ros.viewer.page.tool_handle import ToolHandle
from omniman_ros.viewer.view_state import ViewState

#: Name of the frame of `odom`, the parent of all objects in the scene.
#:
#: To follow the robot, this frame is moved rather than the camera, so that every browser keeps its
#: own view.
ROOT = "/world"


class PageScene:
    """Draws the floor, the lines, the robot, its ghost and the draggable markers."""

    def __init__(
        self,
        server: viser.ViserServer,
        robot: Platform,
        mount: Mount | None,
        post: Post,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        api = server.scene
        self._clock = clock
        self._floor_origin = (0.0, 0.0)
        api.configure_default_lights(enabled=True, cast_shadow=False)
        self._world = api.add_frame(ROOT, show_axes=False)
        self._floor = FloorScene(api, ROOT)
        self._perceived = PerceivedScene(api, ROOT)
        self._robot = RobotScene(api, ROOT, robot, mount)
        self.clicks = FloorClicks(api, lambda: self._floor_origin)  #: Clicks on the floor
        dragging = FloorDragging(server, lambda: self._floor_origin, post)
        self._paths = PathMarkers(api, ROOT, dragging)
        self._markers = DraggableMarkers(api, ROOT, robot, dragging)
        self._tool = ToolHandle(api, ROOT, post, clock)
        size = max(robot.body.length, robot.body.width)
        server.initial_camera.position = (-4.3 * size, 2.5 * size, 3.7 * size)
        server.initial_camera.look_at = (1.2 * size, -0.4 * size, 0.0)
        # A field of view [rad] below viser's default, with which objects near the edges appear to
        # lean.
        server.initial_camera.fov = 0.8

    def draw(self, state: ViewState, follow: bool) -> None:
        """Draw the moving objects; `follow` keeps the robot in the middle of the scene."""
        if follow and state.odom is not None:
            origin = (-state.odom[0], -state.odom[1])
            if origin != self._floor_origin:
                self._floor_origin = origin
                self._world.position = np.array([*origin, 0.0])
        self._robot.draw(state)
        self._floor.draw_motion(state)
        self._paths.draw(state.obstacles)
        self._markers.draw(state, self._clock())
        self._tool.draw(state.tool_goal)

    def draw_perceived(self, state: ViewState, layers: frozenset[str]) -> None:
        """Draw what the robot perceives; call this less often, as most of it changes always."""
        self._perceived.draw(state.perceived, layers)

    def draw_lines(self, state: ViewState) -> None:
        """Draw the lines on the floor; call this less often, as a changed line is sent whole."""
        self._floor.draw(state)
