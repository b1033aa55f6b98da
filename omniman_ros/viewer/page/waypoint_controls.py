"""Controls of the way points of the selected obstacle."""

from dataclasses import replace
from typing import Any

import viser

from omniman_ros.viewer.events import ObstaclePathSet, WaypointAdded
from omniman_ros.viewer.obstacle_paths import MAX_SPEED, MIN_SPEED, AtEnd, Pair, WaypointPath
from omniman_ros.viewer.page.floor_clicks import FloorClicks
from omniman_ros.viewer.page.inputs import NumberInput, Post, add_button, draw_pair
from omniman_ros.viewer.page.viser_compat import row_css, style_html
from omniman_ros.viewer.status_text import hint

MAX_COORDINATE = 1000.0  #: Largest coordinate of a way point that can be entered [m]
NEW_POINT_DISTANCE = 1.0  #: Distance along x from the last way point to an added one [m]

#: Control that can be hidden
Handle = viser.GuiInputHandle[Any] | viser.GuiButtonHandle | viser.GuiHtmlHandle


class WaypointControls:
    """Speed, behaviour at the end, and the way points, which clicks on the floor can add.

    Clicks on the floor count from when a path of a single point is displayed, or from the button,
    until the button is pressed again or another obstacle is selected.
    """

    def __init__(self, gui: viser.GuiApi, clicks: FloorClicks, post: Post) -> None:
        self._gui = gui
        self._clicks = clicks
        self._post = post
        self._number: int | None = None
        self._path = WaypointPath(((0.0, 0.0),))
        self._selected = 0
        self._drawn_point: tuple[int | None, int] = (None, 0)
        self._speed = NumberInput(gui, "speed (m/s)", MIN_SPEED, MAX_SPEED, 0.05)
        self._ends = {at_end: self._end_button(at_end) for at_end in AtEnd}
        self._pick = add_button(gui, "Click floor", self._toggle_picking, icon=viser.Icon.POINTER)
        self._add = add_button(gui, "Add point", self._add_point, icon=viser.Icon.PLUS)
        self._next = add_button(
            gui, "Next point", self._select_next, icon=viser.Icon.CHEVRON_RIGHT
        )
        self._delete = add_button(gui, "Delete point", self._delete_point, icon=viser.Icon.TRASH)
        self._hint = gui.add_html("")
        self._coordinates = [
            NumberInput(gui, f"point {axis} (m)", -MAX_COORDINATE, MAX_COORDINATE, 0.1)
            for axis in "xy"
        ]
        buttons = (self._pick, self._add, self._next, self._delete)
        gui.add_html(style_html(row_css(self._ends.values()), row_css(buttons, 2)))
        self._numbers = (self._speed, *self._coordinates)
        self._handles: tuple[Handle, ...] = (
            *(number.handle for number in self._numbers),
            *self._ends.values(),
            *buttons,
            self._hint,
        )

    def _end_button(self, at_end: AtEnd) -> viser.GuiButtonHandle:
        return add_button(
            self._gui,
            at_end.value.capitalize(),
            lambda: self._set(replace(self._path, at_end=at_end)),
        )

    def _set(self, path: WaypointPath) -> None:
        if self._number is not None:
            self._path = path
            self._post(ObstaclePathSet(self._number, path))

    def _toggle_picking(self) -> None:
        if self._number is not None:
            self._clicks.listen(None if self._clicks.active else self._append)

    def _append(self, position: Pair) -> None:
        if self._number is not None:
            self._post(WaypointAdded(self._number, position))

    def _add_point(self) -> None:
        x, y = self._path.points[-1]
        self._append((x + NEW_POINT_DISTANCE, y))

    def _select_next(self) -> None:
        self._selected = (self._selected + 1) % len(self._path.points)

    def _delete_point(self) -> None:
        points = self._path.points
        if len(points) > 1 and self._selected < len(points):
            kept = points[: self._selected] + points[self._selected + 1 :]
            self._set(replace(self._path, points=kept))

    def draw(self, number: int | None, path: WaypointPath | None, now: float) -> None:
        """Display the way points of an obstacle, at a time of any steady clock [s].

        Args:
            path: Its path, or None if it does not follow way points: all controls are hidden.
        """
        shown = number if path is not None else None
        for handle in self._handles:
            handle.visible = shown is not None
        if shown != self._number:
            self._number = shown
            self._path = WaypointPath(((0.0, 0.0),))
            is_new = path is not None and len(path.points) == 1
            self._clicks.listen(self._append if is_new else None)
            self._speed.reset()
        if path is None:
            return
        if len(path.points) > len(self._path.points):
            self._selected = len(path.points) - 1
        self._selected = min(self._selected, len(path.points) - 1)
        if (shown, self._selected) != self._drawn_point:
            self._drawn_point = shown, self._selected
            for coordinate in self._coordinates:
                coordinate.reset()
        self._path = path
        self._draw_buttons(path)
        speed = self._speed.draw(round(path.speed, 3), now)
        point = draw_pair(self._coordinates, path.points[self._selected], now)
        entered = path.with_point(self._selected, point)
        if speed is not None:
            entered = replace(entered, speed=speed)
        if entered != path:
            self._set(entered)

    def _draw_buttons(self, path: WaypointPath) -> None:
        for at_end, button in self._ends.items():
            button.color = "blue" if at_end is path.at_end else "gray"
        is_picking = self._clicks.active
        self._pick.label = "Done" if is_picking else "Click floor"
        self._pick.color = "orange" if is_picking else "gray"
        self._next.disabled = self._delete.disabled = len(path.points) == 1
        advice = "; click the floor to add more" if is_picking else ""
        self._hint.content = hint(f"Point {self._selected + 1} of {len(path.points)}{advice}")
