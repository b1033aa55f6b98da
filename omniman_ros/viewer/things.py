"""What can be dragged: start, goal, obstacles and the arrows of their velocities."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from omniman_ros.core.robot import Body, Robot
from omniman_ros.planning.ellipses import Ellipses
from omniman_ros.viewer.buttons import Post
from omniman_ros.viewer.crowd import FASTEST, Rows
from omniman_ros.viewer.dragging import Ahead, Pair, Thing
from omniman_ros.viewer.events import (
    GoalDragged,
    ObstacleChosen,
    ObstacleDragged,
    ObstacleSent,
    StartDragged,
)
from omniman_ros.viewer.floor_scene import Colour, LineOf
from omniman_ros.viewer.floor_shapes import HEIGHT, dart, marker, obstacle
from omniman_ros.viewer.grasp import Grasp
from omniman_ros.viewer.meshes import Array, Mesh
from omniman_ros.viewer.robot_scene import Stand, solid
from omniman_ros.viewer.state import Picture, Pose

SHAFT: Colour = (105, 50, 24)
START: Colour = (201, 24, 24)
GOAL: Colour = (16, 74, 204)
# Of batches: viser shows these lighter than such numbers are anywhere else.
PLACED: Colour = (200, 52, 8)
CHOSEN: Colour = (255, 150, 0)
SEEN: Colour = (58, 32, 18)
ARROW: Colour = (44, 12, 4)

SOLID, PALE = 1.0, 0.3
"""Opacity of a marker, and of the goal while there is none."""
BODY = 0.8
"""Opacity of an obstacle."""
PLATE = 0.25
"""Opacity of a marker's plate over that of the rest."""
GAP = 1.0
"""Between the robot and a goal that waits to be dragged [m]."""
ARROWS = HEIGHT + 0.02
"""Height of the arrows [m]."""
DART, THICK = 0.2, 0.03
"""Size of an arrow's head [m]."""
REST = 0.04
"""An obstacle that is sent off slower than this is to stand [m/s]."""


class Things:
    """All that can be dragged, and obstacles of others.

    Args:
        api: Where to.
        root: The frame that all stands on.
        robot: Whose start and goal.
        grasp: Who listens to the hands.
        post: Where events go.
    """

    def __init__(
        self, api: viser.SceneApi, root: str, robot: Robot, grasp: Grasp, post: Post
    ) -> None:
        self._ahead = Ahead()
        # The goal is above the start where both lie at one place, so that it can be grabbed.
        self._start = _Marker(
            api, f"{root}/start", robot.body, START, grasp, self._ahead,
            lambda pose, done: post(StartDragged(pose, done)), 0.0,
        )  # fmt: skip
        self._goal = _Marker(
            api, f"{root}/goal", robot.body, GOAL, grasp, self._ahead,
            lambda pose, done: post(GoalDragged(pose, done)), 0.02,
        )  # fmt: skip
        self._before = robot.body.length + GAP
        self._crowd = _Crowd(api, f"{root}/crowd", grasp, self._ahead, post)
        self._known = Ellipses.none()
        self._seen = Batch(api, f"{root}/seen", obstacle(), SEEN, BODY)

    def draw(self, picture: Picture, now: float) -> None:
        """Show them at a time of any steady clock [s]."""
        ahead = self._ahead.values(now)
        self._start.draw(picture.start, ahead)
        goal = picture.goal
        if goal is None and picture.odom is not None:
            x, y, heading = picture.odom
            goal = (
                x + self._before * math.cos(heading), y + self._before * math.sin(heading), heading
            )  # fmt: skip
        self._goal.draw(goal, ahead, pale=picture.goal is None)
        self._crowd.draw(picture.crowd, picture.chosen, ahead)
        if picture.seen is self._known:
            return
        seen = self._known = picture.seen
        self._seen.show(
            _on_floor(seen.centers), _turns(seen.angles), _upright(seen.semi_axes), None
        )


class Batch:
    """Instances of one mesh in any number.

    viser takes another number in place; of none, the last ones stay, hidden.
    """

    def __init__(
        self, api: viser.SceneApi, name: str, mesh: Mesh, colour: Colour, opacity: float
    ) -> None:
        self.handle = api.add_batched_meshes_simple(
            name, mesh.vertices, mesh.triangles, np.array([[1.0, 0.0, 0.0, 0.0]]),
            np.zeros((1, 3)), batched_scales=np.ones((1, 3)),
            batched_colors=np.array([colour], dtype=np.uint8),
            opacity=opacity if opacity < 1.0 else None, lod="off", cast_shadow=False,
            receive_shadow=False, visible=False,
        )  # fmt: skip
        self._colour = np.array([colour], dtype=np.uint8)
        self._sent: dict[str, NDArray[Any]] = {}

    def show(
        self, positions: Array, rotations: Array, scales: Array, colours: NDArray[np.uint8] | None
    ) -> None:
        """Show instances at (N, 3) [m], turned by (N, 4), of sizes (N, 3), of colours (N, 3)."""
        if len(positions):
            if colours is None:
                colours = np.repeat(self._colour, len(positions), axis=0)
            for name, values in (
                ("batched_positions", positions),
                ("batched_wxyzs", rotations),
                ("batched_scales", scales),
                ("batched_colors", colours),
            ):
                # viser would find out as well, but takes five times as long.
                if not np.array_equal(self._sent.get(name, ()), values):
                    self._sent[name] = values
                    setattr(self.handle, name, values)
        self.handle.visible = bool(len(positions))


class _Marker:
    """A pose on the floor: its plate is dragged to move it, the knob to turn it."""

    def __init__(
        self, api: viser.SceneApi, name: str, body: Body, colour: Colour, grasp: Grasp,
        ahead: Ahead, say: Callable[[Pose, bool], None], height: float,
    ) -> None:  # fmt: skip
        shape = marker(body)
        self._name, self._ahead, self._say, self._tip = name, ahead, say, shape.tip
        self._pose: Pose | None = None
        self._stand = Stand(api, name)
        self._opacity = SOLID
        self._parts = {
            part: solid(api, f"{name}/{part}", mesh.moved(0.0, 0.0, height), colour, SOLID)
            for part, mesh in (("border", shape.border), ("arrow", shape.arrow))
        }
        self._plate = solid(
            api, f"{name}/plate", shape.plate.moved(0.0, 0.0, height), colour, PLATE
        )
        knob = solid(
            api, f"{name}/knob", shape.knob.moved(0.0, 0.0, height), colour, SOLID, flat=False
        )
        self._parts["knob"] = knob
        for handle in (self._plate, self._parts["border"], self._parts["arrow"]):
            grasp.listen(handle, self._middle, self._move)
        grasp.listen(knob, self._end, self._turn)

    def draw(self, pose: Pose | None, ahead: Mapping[Thing, Any], pale: bool = False) -> None:
        """Show it at a pose, or where it is dragged."""
        pose = self._pose = ahead.get(self._name, pose)
        self._stand.put(pose)
        opacity = PALE if pale and self._name not in ahead else SOLID
        if opacity == self._opacity:
            return
        self._opacity = opacity
        for part in self._parts.values():
            part.opacity = opacity
        self._plate.opacity = PLATE * opacity

    def _middle(self, _: int | None) -> tuple[Thing, Pair] | None:
        pose = self._pose
        return None if pose is None else (self._name, pose[:2])

    def _end(self, _: int | None) -> tuple[Thing, Pair] | None:
        pose = self._pose
        if pose is None:
            return None
        x, y, heading = pose
        tip = x + self._tip * math.cos(heading), y + self._tip * math.sin(heading)
        return self._name, tip

    def _move(self, _: Thing, to: Pair, done: bool) -> None:
        if self._pose is not None:
            self._put((*to, self._pose[2]), done)

    def _turn(self, _: Thing, to: Pair, done: bool) -> None:
        if self._pose is not None:
            x, y, _heading = self._pose
            self._put((x, y, math.atan2(to[1] - y, to[0] - x)), done)

    def _put(self, pose: Pose, done: bool) -> None:
        # Known at once to whoever drags on before the next frame.
        self._pose = pose
        self._ahead.put(self._name, pose, done)
        self._say(pose, done)


class _Crowd:
    """Obstacles of the page: dragged to move them, their arrows to send them off."""

    def __init__(
        self, api: viser.SceneApi, name: str, grasp: Grasp, ahead: Ahead, post: Post
    ) -> None:
        self._ahead, self._post = ahead, post
        # Numbers, centres and courses as they are drawn; replaced as a whole, as the hands read
        # it in another thread.
        none = Rows.none()
        self._shown = none.numbers, none.centers, none.velocities
        self._bodies = Batch(api, name, obstacle(), PLACED, BODY)
        self._arrows = Batch(api, f"{name}_arrows", dart(DART, THICK), ARROW, 1.0)
        self._shafts = LineOf(api, f"{name}_shafts", SHAFT, 3.0, 0)
        grasp.listen(self._bodies.handle, self._middle, self._move)
        grasp.listen(self._arrows.handle, self._tip, self._send)

        @self._bodies.handle.on_click
        async def _(event: viser.SceneNodePointerEvent[viser.BatchedMeshHandle]) -> None:
            index, numbers = event.instance_index, self._shown[0]
            if index is not None and 0 <= index < len(numbers):
                post(ObstacleChosen(int(numbers[index])))

    def draw(self, rows: Rows, chosen: int | None, ahead: Mapping[Thing, Any]) -> None:
        """Show them, or where they are dragged."""
        centers = _led(rows, rows.centers, "obstacle", ahead)
        courses = rows.velocities if rows.courses is None else rows.courses
        courses = _led(rows, courses, "arrow", ahead)
        self._shown = rows.numbers, centers, courses
        colours = np.empty((len(centers), 3), dtype=np.uint8)
        colours[:] = PLACED
        if chosen is not None:
            colours[rows.numbers == chosen] = CHOSEN
        self._bodies.show(
            _on_floor(centers), _turns(rows.angles), _upright(rows.semi_axes), colours
        )
        tips = centers + courses
        moving = np.hypot(*courses.T) > REST
        headings = np.where(moving, np.arctan2(courses[:, 1], courses[:, 0]), rows.angles)
        self._arrows.show(_on_floor(tips, ARROWS), _turns(headings), np.ones((len(tips), 3)), None)
        ends = np.stack([_on_floor(centers, ARROWS), _on_floor(tips, ARROWS)], axis=1)
        self._shafts.draw(ends[moving])

    def _middle(self, index: int | None) -> tuple[Thing, Pair] | None:
        numbers, centers, _ = self._shown
        if index is None or not 0 <= index < len(numbers):
            return None
        return ("obstacle", int(numbers[index])), _pair(centers[index])

    def _tip(self, index: int | None) -> tuple[Thing, Pair] | None:
        numbers, centers, courses = self._shown
        if index is None or not 0 <= index < len(numbers):
            return None
        return ("arrow", int(numbers[index])), _pair(centers[index] + courses[index])

    def _move(self, thing: Thing, to: Pair, done: bool) -> None:
        self._ahead.put(thing, to, done)
        self._post(ObstacleDragged(_number(thing), to, done))

    def _send(self, thing: Thing, to: Pair, done: bool) -> None:
        numbers, centers, _ = self._shown
        found = np.flatnonzero(numbers == _number(thing))
        if not len(found):
            return  # deleted meanwhile
        velocity = np.clip(np.array(to) - centers[found[0]], -FASTEST, FASTEST)
        if np.hypot(*velocity) < REST:
            velocity = np.zeros(2)
        self._ahead.put(thing, _pair(velocity), done)
        self._post(ObstacleSent(_number(thing), _pair(velocity)))


def _led(rows: Rows, values: Array, what: str, ahead: Mapping[Thing, Any]) -> Array:
    """Values (M, 2) with those of the obstacles that are dragged in their places."""
    led = {
        thing[1]: at
        for thing, at in ahead.items()
        if isinstance(thing, tuple) and thing[0] == what
    }
    if not led:
        return values
    values = values.copy()
    for number, value in led.items():
        values[rows.numbers == number] = value
    return values


def _number(thing: Thing) -> int:
    assert isinstance(thing, tuple)
    return int(thing[1])


def _pair(point: Array) -> Pair:
    return float(point[0]), float(point[1])


def _on_floor(points: Array, height: float = 0.0) -> Array:
    return np.column_stack([points, np.full(len(points), height)])


def _upright(semi_axes: Array) -> Array:
    return np.column_stack([semi_axes, np.ones(len(semi_axes))])


def _turns(angles: Array) -> Array:
    nothing = np.zeros(len(angles))
    return np.stack([np.cos(0.5 * angles), nothing, nothing, np.sin(0.5 * angles)], axis=1)
