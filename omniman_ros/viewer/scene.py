"""The robot in space: what of the picture stands on the floor."""

import time
from collections.abc import Callable

import numpy as np
import viser

from omniman_ros.core.body.model import Mount
from omniman_ros.core.robot import Robot
from omniman_ros.viewer.buttons import Post
from omniman_ros.viewer.floor_scene import FloorScene
from omniman_ros.viewer.grasp import Grasp
from omniman_ros.viewer.robot_scene import RobotScene
from omniman_ros.viewer.state import Picture
from omniman_ros.viewer.things import Things

ROOT = "/world"
"""All stands on this frame: to follow the robot it is the world that moves, so that every browser
keeps its own view."""


class Scene:
    """Floor, lines, robot, ghost, and what can be dragged.

    Args:
        server: The page's.
        robot: What it looks like.
        mount: Where its arm stands; None for a robot without one.
        post: Where events go.
        clock: A steady one [s].
    """

    def __init__(
        self, server: viser.ViserServer, robot: Robot, mount: Mount | None, post: Post,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        api = server.scene
        self._clock = clock
        self._floor_at = (0.0, 0.0)
        api.configure_default_lights(enabled=True, cast_shadow=False)
        self._world = api.add_frame(ROOT, show_axes=False)
        self._floor = FloorScene(api, ROOT)
        self._robot = RobotScene(api, ROOT, robot, mount)
        self._things = Things(api, ROOT, robot, Grasp(server, lambda: self._floor_at), post)
        size = max(robot.body.length, robot.body.width)
        server.initial_camera.position = (-4.3 * size, 2.5 * size, 3.7 * size)
        server.initial_camera.look_at = (1.2 * size, -0.4 * size, 0.0)
        # Narrower than viser's own, which makes all that is near the edges lean.
        server.initial_camera.fov = 0.8

    def draw(self, picture: Picture, follow: bool) -> None:
        """Show what moves; if asked to, keep the robot in sight."""
        if follow and picture.odom is not None:
            floor = (-picture.odom[0], -picture.odom[1])
            if floor != self._floor_at:
                self._floor_at = floor
                self._world.position = np.array([*floor, 0.0])
        self._robot.draw(picture)
        self._floor.draw_motion(picture)
        self._things.draw(picture, self._clock())

    def draw_lines(self, picture: Picture) -> None:
        """Show what lies on the floor; less often, as a long line is sent as a whole."""
        self._floor.draw(picture)
