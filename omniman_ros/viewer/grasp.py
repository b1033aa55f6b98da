"""Listens to browsers that drag things over the floor."""

from collections.abc import Callable
from typing import Any

import viser

from omniman_ros.viewer.dragging import Hands, Pair, Thing

Held = Callable[[int | None], tuple[Thing, Pair] | None]
"""From the index of what was grabbed in a batch to the thing and its place, None for nothing."""
Moved = Callable[[Thing, Pair, bool], None]
"""Takes a thing's new place, and whether it was let go there."""
Handle = viser.MeshHandle | viser.BatchedMeshHandle


class Grasp:
    """The hands of all browsers.

    All runs in the server's thread, in the order in which it came.

    Args:
        server: The page's.
        floor: Where the floor's origin is in the world of the cameras [m].
    """

    def __init__(self, server: viser.ViserServer, floor: Callable[[], Pair]) -> None:
        self._server = server
        self._floor = floor
        self._hands = Hands()

    def listen(self, handle: Handle, held: Held, moved: Moved) -> None:
        """Let something be dragged with the left button."""

        async def on_drag(event: viser.SceneNodeDragEvent[Any]) -> None:
            self._on_drag(event, held, moved)

        handle.on_drag("left")(on_drag)

    def _on_drag(self, event: viser.SceneNodeDragEvent[Any], held: Held, moved: Moved) -> None:
        hand = (event.client_id, event.target.name)
        if event.phase == "start":
            grabbed = held(event.instance_index)
            if grabbed is not None:
                self._hands.grab(hand, *grabbed, event.start_position, self._floor())
            return
        grip = self._hands.lead(hand, _eye(event), event.end_position, self._floor())
        done = event.phase == "end"
        if done:
            self._hands.let_go(hand)
            if event.client_id not in self._server.get_clients():
                # viser ends a drag when its browser is lost: nobody let go there.
                return
        if grip is not None:
            moved(grip.thing, grip.place, done)


def _eye(event: viser.SceneNodeDragEvent[Any]) -> tuple[float, float, float]:
    try:
        x, y, z = event.client.camera.position.tolist()
    except AssertionError:  # viser's word for a camera that it has not heard of yet
        return event.end_position  # no ray: what is held stays where it is
    return x, y, z
