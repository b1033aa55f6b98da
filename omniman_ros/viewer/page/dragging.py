"""Dragging over the floor: conversion of a browser's pointer into the dragged object's position.

viser reports a point in space under the pointer, and the position of the camera: the dragged
object moves on the level plane through the point where it was grabbed.
"""

import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import viser

from omniman_ros.viewer.events import Event
from omniman_ros.viewer.optimistic_updates import Key, OptimisticUpdates
from omniman_ros.viewer.page.inputs import Post
from omniman_ros.viewer.page.viser_compat import camera_position

Pair = tuple[float, float]  #: x, y on the floor or in a level plane [m]
Pointer = Hashable  #: Identifier of a drag: the browser and the scene node that it has grabbed
#: Maps the index of the grabbed instance to the object and its position; None refuses the drag
Grab = Callable[[int | None], tuple[Key, Pair] | None]
#: Handles a dragged object: its key, its new position, and whether it was released there
Move = Callable[[Key, Pair, bool], None]
Handle = viser.MeshHandle | viser.BatchedMeshHandle  #: Scene node that can be dragged

MAX_DISTANCE = 60.0  #: Distance beyond which a ray counts as pointing at the horizon [m]


def on_plane(eye: Sequence[float], through: Sequence[float], height: float) -> Pair | None:
    """Return the intersection of the ray from the camera through a point with a level plane [m].

    It is (x, y), or None if they do not meet within `MAX_DISTANCE`.
    """
    down = through[2] - eye[2]
    if abs(down) < 1e-9:
        return None
    along = (height - eye[2]) / down
    if not along > 0.0:
        return None
    dx, dy = along * (through[0] - eye[0]), along * (through[1] - eye[1])
    if not math.hypot(dx, dy) <= MAX_DISTANCE:
        return None
    return eye[0] + dx, eye[1] + dy


@dataclass(frozen=True)
class Drag:
    """One drag under way."""

    key: Key  #: Identifier of the dragged object
    height: float  #: Height of the point where it was grabbed [m]
    offset: Pair  #: Offset (x, y) from that point to the object's position [m]
    position: Pair  #: Latest position (x, y) on the floor [m]


class DragTracker:
    """All drags under way.

    Points are in the world of the cameras, positions are on the floor; `floor` is the position of
    the floor's origin in the world at that time [m].
    """

    def __init__(self) -> None:
        self._drags: dict[Pointer, Drag] = {}

    def start(
        self, pointer: Pointer, key: Key, position: Pair, point: Sequence[float], floor: Pair
    ) -> None:
        """Start a drag of an object at a position (x, y), grabbed at a point (x, y, z) [m]."""
        offset = position[0] - (point[0] - floor[0]), position[1] - (point[1] - floor[1])
        self._drags[pointer] = Drag(key, point[2], offset, position)

    def update(
        self, pointer: Pointer, eye: Sequence[float], point: Sequence[float], floor: Pair
    ) -> Drag | None:
        """Move the dragged object to the pointer; while that is at the horizon, the object stays.

        Returns:
            The drag with the new position, or None if this pointer drags nothing.
        """
        drag = self._drags.get(pointer)
        hit = None if drag is None else on_plane(eye, point, drag.height)
        if drag is None or hit is None:
            return drag
        (dx, dy), (x, y) = drag.offset, floor
        drag = replace(drag, position=(hit[0] - x + dx, hit[1] - y + dy))
        self._drags[pointer] = drag
        return drag

    def end(self, pointer: Pointer) -> None:
        """End the drag of a pointer, if there is one."""
        self._drags.pop(pointer, None)


class FloorDragging:
    """Lets objects of the scene be dragged over the floor, by all browsers.

    All callbacks run in the server's thread, in the order in which the browsers sent the events.

    Args:
        floor: Returns the position of the floor's origin in the world of the cameras [m].
    """

    def __init__(self, server: viser.ViserServer, floor: Callable[[], Pair], post: Post) -> None:
        self._server = server
        self._floor = floor
        self._tracker = DragTracker()
        self.post = post
        self.updates = (
            OptimisticUpdates()
        )  #: Values of dragged objects until the node confirms them

    def enable(self, handle: Handle, grab: Grab, move: Move) -> None:
        """Let a scene node be dragged with the left mouse button."""

        async def on_drag(event: viser.SceneNodeDragEvent[Any]) -> None:
            self._on_drag(event, grab, move)

        handle.on_drag("left")(on_drag)

    def report(self, key: Key, value: Any, event: Event, *, done: bool) -> None:
        """Display the new value of a dragged object at once, and post the event."""
        self.updates.put(key, value, done)
        self.post(event)

    def _on_drag(self, event: viser.SceneNodeDragEvent[Any], grab: Grab, move: Move) -> None:
        pointer = (event.client_id, event.target.name)
        if event.phase == "start":
            grabbed = grab(event.instance_index)
            if grabbed is not None:
                self._tracker.start(pointer, *grabbed, event.start_position, self._floor())
            return
        # Without a camera there is no ray: the object stays where it is.
        eye = camera_position(event.client) or event.end_position
        drag = self._tracker.update(pointer, eye, event.end_position, self._floor())
        done = event.phase == "end"
        if done:
            self._tracker.end(pointer)
            if event.client_id not in self._server.get_clients():
                # viser ends the drags of a lost browser, but its user has released nothing.
                return
        if drag is not None:
            move(drag.key, drag.position, done)
