"""Markers that can be dragged: start, goal, obstacles, and the obstacles' velocity arrows."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from omniman_ros.core.arrays import Array
from omniman_ros.core.platform import Body, Platform
from omniman_ros.surroundings.ellipses import Ellipses
from omniman_ros.viewer import style
from omniman_ros.viewer.events import (
    GoalDragged,
    ObstacleDragged,
    ObstacleSelected,
    ObstacleVelocitySet,
    StartDragged,
)
from omniman_ros.viewer.floor_shapes import OBSTACLE_HEIGHT, arrow_head, marker, obstacle
from omniman_ros.viewer.meshes import Mesh
from omniman_ros.viewer.optimistic_updates import Key
from omniman_ros.viewer.page.dragging import FloorDragging, Pair
from omniman_ros.viewer.page.floor_scene import SceneLine
from omniman_ros.viewer.page.robot_scene import FloorFrame, add_mesh
from omniman_ros.viewer.placed_obstacles import MAX_VELOCITY, ObstacleArrays
from omniman_ros.viewer.style import Colour
from omniman_ros.viewer.view_state import Pose, ViewState

OPAQUE = 1.0  #: Opacity of a marker
PALE = 0.3  #: Opacity of the goal's marker while there is no goal
OBSTACLE_OPACITY = 0.8  #: Opacity of an obstacle
PLATE_OPACITY = 0.25  #: Ratio of the opacity of a marker's plate to that of its other parts
GOAL_LIFT = 0.02  #: Height of the goal above the start [m], to grab it where both coincide
GOAL_GAP = 1.0  #: Distance between the robot and a goal that waits to be dragged [m]
ARROW_HEIGHT = OBSTACLE_HEIGHT + 0.02  #: Height of the velocity arrows above the floor [m]
ARROW_LENGTH = 0.2  #: Length of the head of a velocity arrow [m]
ARROW_THICKNESS = 0.03  #: Thickness of the head of a velocity arrow [m]
REST_SPEED = 0.04  #: Speed below which a dragged velocity counts as zero [m/s]


class DraggableMarkers:
    """Start, goal and obstacles of the page, and the obstacles of other sources."""

    def __init__(
        self, api: viser.SceneApi, root: str, robot: Platform, dragging: FloorDragging
    ) -> None:
        self._updates = dragging.updates
        self._start = _PoseMarker(
            api, f"{root}/start", robot.body, style.START, dragging, StartDragged
        )
        self._goal = _PoseMarker(
            api, f"{root}/goal", robot.body, style.GOAL, dragging, GoalDragged
        )
        self._goal_distance = robot.body.length + GOAL_GAP
        self._obstacles = _ObstacleMarkers(api, f"{root}/obstacles", dragging)
        self._drawn_others = Ellipses.none()
        self._others = MeshBatch(
            api, f"{root}/other_obstacles", obstacle(), style.OTHER_OBSTACLE, OBSTACLE_OPACITY
        )

    def draw(self, state: ViewState, now: float) -> None:
        """Draw all markers at a time of any steady clock [s]."""
        updates = self._updates.values(now)
        self._start.draw(state.start, updates)
        goal = state.goal
        if goal is None and state.odom is not None:
            x, y, heading = state.odom
            goal = (
                x + self._goal_distance * math.cos(heading),
                y + self._goal_distance * math.sin(heading),
                heading,
            )
        self._goal.draw(goal, updates, pale=state.goal is None)
        self._obstacles.draw(state.obstacles, state.selected_obstacle, updates)
        if state.other_obstacles is not self._drawn_others:
            others = self._drawn_others = state.other_obstacles
            self._others.draw(
                _at_height(others.centers),
                _rotations(others.angles),
                _scales(others.semi_axes),
                None,
            )


class MeshBatch:
    """Instances of one mesh, in any number.

    viser lets their number change, but not to zero: the last ones are then hidden instead.
    """

    def __init__(
        self, api: viser.SceneApi, name: str, mesh: Mesh, colour: Colour, opacity: float
    ) -> None:
        self.handle = api.add_batched_meshes_simple(
            name,
            mesh.vertices,
            mesh.triangles,
            np.array([[1.0, 0.0, 0.0, 0.0]]),
            np.zeros((1, 3)),
            batched_scales=np.ones((1, 3)),
            batched_colors=np.array([colour], dtype=np.uint8),
            opacity=opacity if opacity < 1.0 else None,
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
            visible=False,
        )
        self._colour = np.array([colour], dtype=np.uint8)
        self._sent: dict[str, NDArray[Any]] = {}

    def draw(
        self, positions: Array, rotations: Array, scales: Array, colours: NDArray[np.uint8] | None
    ) -> None:
        """Draw N instances at positions (N, 3) [m] with quaternions, scales and colours of N rows.

        Without colours, they have that of the batch.
        """
        if len(positions):
            if colours is None:
                colours = np.repeat(self._colour, len(positions), axis=0)
            for name, values in (
                ("batched_positions", positions),
                ("batched_wxyzs", rotations),
                ("batched_scales", scales),
                ("batched_colors", colours),
            ):
                # viser would compare as well, but five times as slowly.
                if not np.array_equal(self._sent.get(name, ()), values):
                    self._sent[name] = values
                    setattr(self.handle, name, values)
        self.handle.visible = bool(len(positions))


class _PoseMarker:
    """A pose on the floor: dragging its plate moves it, dragging its knob rotates it."""

    def __init__(
        self,
        api: viser.SceneApi,
        name: str,
        body: Body,
        colour: Colour,
        dragging: FloorDragging,
        event: type[StartDragged] | type[GoalDragged],
    ) -> None:
        height = GOAL_LIFT if event is GoalDragged else 0.0
        self._event, shape = event, marker(body)
        self._name, self._dragging, self._knob_distance = name, dragging, shape.tip
        self._pose: Pose | None = None
        self._frame = FloorFrame(api, name)
        self._opacity = OPAQUE
        self._parts = {
            part: add_mesh(api, f"{name}/{part}", mesh.moved(0.0, 0.0, height), colour, OPAQUE)
            for part, mesh in (("border", shape.border), ("arrow", shape.arrow))
        }
        self._plate = add_mesh(
            api, f"{name}/plate", shape.plate.moved(0.0, 0.0, height), colour, PLATE_OPACITY
        )
        knob = add_mesh(
            api, f"{name}/knob", shape.knob.moved(0.0, 0.0, height), colour, OPAQUE, flat=False
        )
        self._parts["knob"] = knob
        for handle in (self._plate, self._parts["border"], self._parts["arrow"]):
            dragging.enable(handle, self._grab_plate, self._move)
        dragging.enable(knob, self._grab_knob, self._rotate)

    def draw(self, pose: Pose | None, updates: Mapping[Key, Any], pale: bool = False) -> None:
        pose = self._pose = updates.get(self._name, pose)
        self._frame.place(pose)
        opacity = PALE if pale and self._name not in updates else OPAQUE
        if opacity == self._opacity:
            return
        self._opacity = opacity
        for part in self._parts.values():
            part.opacity = opacity
        self._plate.opacity = PLATE_OPACITY * opacity

    def _grab_plate(self, _: int | None) -> tuple[Key, Pair] | None:
        pose = self._pose
        return None if pose is None else (self._name, pose[:2])

    def _grab_knob(self, _: int | None) -> tuple[Key, Pair] | None:
        if self._pose is None:
            return None
        x, y, heading = self._pose
        distance = self._knob_distance
        return self._name, (x + distance * math.cos(heading), y + distance * math.sin(heading))

    def _move(self, _: Key, position: Pair, done: bool) -> None:
        if self._pose is not None:
            self._report((*position, self._pose[2]), done)

    def _rotate(self, _: Key, position: Pair, done: bool) -> None:
        if self._pose is not None:
            x, y, _heading = self._pose
            self._report((x, y, math.atan2(position[1] - y, position[0] - x)), done)

    def _report(self, pose: Pose, done: bool) -> None:
        # The pose is stored at once, for a drag that continues before the next frame.
        self._pose = pose
        self._dragging.report(self._name, pose, self._event(pose, done), done=done)


class _ObstacleMarkers:
    """Obstacles of the page: dragging one moves it, dragging its arrow sets its velocity."""

    def __init__(self, api: viser.SceneApi, name: str, dragging: FloorDragging) -> None:
        self._dragging = dragging
        # Numbers, centres and velocities as drawn; replaced as a whole, because the drags read
        # them in another thread.
        empty = ObstacleArrays.empty()
        self._drawn = empty.numbers, empty.centers, empty.velocities
        self._bodies = MeshBatch(api, name, obstacle(), style.PLACED_OBSTACLE, OBSTACLE_OPACITY)
        head = arrow_head(ARROW_LENGTH, ARROW_THICKNESS)
        self._arrows = MeshBatch(api, f"{name}_arrows", head, style.VELOCITY_ARROW, OPAQUE)
        self._shafts = SceneLine(api, f"{name}_shafts", style.VELOCITY_SHAFT, 3.0, 0)
        dragging.enable(self._bodies.handle, self._grab_body, self._move)
        dragging.enable(self._arrows.handle, self._grab_arrow, self._set_velocity)

        @self._bodies.handle.on_click
        async def _(event: viser.SceneNodePointerEvent[viser.BatchedMeshHandle]) -> None:
            index, numbers = event.instance_index, self._drawn[0]
            if index is not None and 0 <= index < len(numbers):
                dragging.post(ObstacleSelected(int(numbers[index])))

    def draw(
        self, obstacles: ObstacleArrays, selected: int | None, updates: Mapping[Key, Any]
    ) -> None:
        centers = _updated(obstacles, obstacles.centers, "obstacle", updates)
        velocities = obstacles.resumed_velocities
        if velocities is None:
            velocities = obstacles.velocities
        velocities = _updated(obstacles, velocities, "arrow", updates)
        self._drawn = obstacles.numbers, centers, velocities
        colours = np.empty((len(centers), 3), dtype=np.uint8)
        colours[:] = style.PLACED_OBSTACLE
        if selected is not None:
            colours[obstacles.numbers == selected] = style.SELECTED_OBSTACLE
        self._bodies.draw(
            _at_height(centers),
            _rotations(obstacles.angles),
            _scales(obstacles.semi_axes),
            colours,
        )
        tips = _at_height(centers + velocities, ARROW_HEIGHT)
        moving = np.hypot(*velocities.T) > REST_SPEED
        headings = np.arctan2(velocities[:, 1], velocities[:, 0])
        headings = np.where(moving, headings, obstacles.angles)
        self._arrows.draw(tips, _rotations(headings), np.ones((len(tips), 3)), None)
        ends = np.stack([_at_height(centers, ARROW_HEIGHT), tips], axis=1)
        self._shafts.draw(ends[moving])

    def _grab_body(self, index: int | None) -> tuple[Key, Pair] | None:
        numbers, centers, _ = self._drawn
        if index is None or not 0 <= index < len(numbers):
            return None
        return ("obstacle", int(numbers[index])), _pair(centers[index])

    def _grab_arrow(self, index: int | None) -> tuple[Key, Pair] | None:
        numbers, centers, velocities = self._drawn
        if index is None or not 0 <= index < len(numbers):
            return None
        return ("arrow", int(numbers[index])), _pair(centers[index] + velocities[index])

    def _move(self, key: Key, position: Pair, done: bool) -> None:
        event = ObstacleDragged(_number(key), position, done)
        self._dragging.report(key, position, event, done=done)

    def _set_velocity(self, key: Key, tip: Pair, done: bool) -> None:
        numbers, centers, _ = self._drawn
        found = np.flatnonzero(numbers == _number(key))
        if not len(found):
            return  # deleted meanwhile
        velocity = np.clip(np.array(tip) - centers[found[0]], -MAX_VELOCITY, MAX_VELOCITY)
        if np.hypot(*velocity) < REST_SPEED:
            velocity = np.zeros(2)
        event = ObstacleVelocitySet(_number(key), _pair(velocity))
        self._dragging.report(key, _pair(velocity), event, done=done)


def _updated(
    obstacles: ObstacleArrays, values: Array, kind: str, updates: Mapping[Key, Any]
) -> Array:
    """Return values (M, 2) of the obstacles, with those replaced that are being dragged."""
    dragged = {
        key[1]: value
        for key, value in updates.items()
        if isinstance(key, tuple) and key[0] == kind
    }
    if not dragged:
        return values
    values = values.copy()
    for number, value in dragged.items():
        values[obstacles.numbers == number] = value
    return values


def _number(key: Key) -> int:
    assert isinstance(key, tuple)
    return int(key[1])


def _pair(point: Array) -> Pair:
    return float(point[0]), float(point[1])


def _at_height(points: Array, height: float = 0.0) -> Array:
    return np.column_stack([points, np.full(len(points), height)])


def _scales(semi_axes: Array) -> Array:
    return np.column_stack([semi_axes, np.ones(len(semi_axes))])


def _rotations(angles: Array) -> Array:
    zeros = np.zeros(len(angles))
    return np.stack([np.cos(0.5 * angles), zeros, zeros, np.sin(0.5 * angles)], axis=1)
