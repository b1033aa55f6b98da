"""Clicks on the floor, as positions in `odom`."""

from collections.abc import Callable

import viser

from omniman_ros.viewer.page.dragging import Pair, on_plane


class FloorClicks:
    """Reports where the floor is clicked in any browser, while there is a listener.

    A drag on the floor, which turns the camera, is no click.

    Args:
        floor: Returns the position of the floor's origin in the world of the cameras [m].
    """

    def __init__(self, api: viser.SceneApi, floor: Callable[[], Pair]) -> None:
        self._api = api
        self._floor = floor
        self._listener: Callable[[Pair], None] | None = None

    @property
    def active(self) -> bool:
        """Whether there is a listener."""
        return self._listener is not None

    def listen(self, listener: Callable[[Pair], None] | None) -> None:
        """Set the function that is called with each clicked position (x, y) [m]; None for none."""
        if self._listener is None and listener is not None:
            # viser declares plain functions only, but awaits coroutines as elsewhere.
            self._api.on_click()(self._on_click)  # type: ignore[arg-type]
        elif self._listener is not None and listener is None:
            self._api.remove_click_callback(self._on_click)
        self._listener = listener

    async def _on_click(self, event: viser.SceneClickEvent) -> None:
        eye = event.ray_origin
        through = [a + b for a, b in zip(eye, event.ray_direction, strict=True)]
        hit = on_plane(eye, through, 0.0)
        listener = self._listener
        if hit is not None and listener is not None:
            x, y = self._floor()
            listener((hit[0] - x, hit[1] - y))
