"""Controls of the page's obstacles: add, select, let move, resize, delete."""

import math

import viser

from omniman_ros.viewer.events import (
    ButtonPressed,
    ObstacleDeleted,
    ObstacleResized,
    ObstacleSelected,
)
from omniman_ros.viewer.page.floor_clicks import FloorClicks
from omniman_ros.viewer.page.inputs import NumberInput, Post, add_button, draw_pair
from omniman_ros.viewer.page.motion_controls import MotionControls
from omniman_ros.viewer.page.viser_compat import row_css, style_html
from omniman_ros.viewer.placed_obstacles import (
    MAX_SEMI_AXIS,
    MIN_SEMI_AXIS,
    ObstacleArrays,
    PlacedObstacle,
)
from omniman_ros.viewer.status_text import hint
from omniman_ros.viewer.view_state import ViewState


class ObstaclePanel:
    """Buttons for all obstacles, and the motion and size of the selected one."""

    def __init__(self, gui: viser.GuiApi, clicks: FloorClicks, post: Post) -> None:
        self._post = post
        self._drawn = ObstacleArrays.empty()
        self._selected: int | None = None
        add = add_button(gui, "Add", lambda: post(ButtonPressed("add")), "orange", viser.Icon.PLUS)
        self._next = add_button(gui, "Next", self._select_next, icon=viser.Icon.CHEVRON_RIGHT)
        self._delete = add_button(gui, "Delete", self._delete_selected, icon=viser.Icon.TRASH)
        self._hint = gui.add_html("")
        self._motion = MotionControls(gui, clicks, post)
        self._axes = [
            NumberInput(
                gui,
                f"{name} (m)",
                MIN_SEMI_AXIS,
                MAX_SEMI_AXIS,
                0.05,
                f"Semi-axis along its {axis}.",
            )
            for name, axis in (("length / 2", "x"), ("width / 2", "y"))
        ]
        self._heading = NumberInput(gui, "heading (°)", -180.0, 180.0, 5.0)
        self._all = add_button(
            gui, "Delete all", lambda: post(ObstacleDeleted(None)), icon=viser.Icon.TRASH_X
        )
        gui.add_html(style_html(row_css((add, self._next, self._delete))))

    def _select_next(self) -> None:
        numbers = self._drawn.numbers.tolist()
        if numbers:
            later = [
                number
                for number in numbers
                if number > (-1 if self._selected is None else self._selected)
            ]
            self._post(ObstacleSelected((later or numbers)[0]))

    def _delete_selected(self) -> None:
        if self._selected is not None:
            self._post(ObstacleDeleted(self._selected))

    def draw(self, state: ViewState, now: float) -> None:
        """Display the selected obstacle, at a time on the clock of `state` [s]."""
        obstacles = self._drawn = state.obstacles
        numbers = obstacles.numbers.tolist()
        selected = state.selected_obstacle if state.selected_obstacle in numbers else None
        if selected != self._selected:
            self._selected = selected
            for number in (*self._axes, self._heading):
                number.reset()
        self._next.disabled = self._all.disabled = not numbers
        self._delete.disabled = selected is None
        for number in (*self._axes, self._heading):
            number.handle.disabled = selected is None
        if selected is None:
            self._motion.draw(None, now)
            self._hint.content = hint(
                "Click an obstacle to choose it, drag it to move it."
                if numbers
                else "No obstacle yet: add one, it appears ahead of the robot."
            )
            return
        index = numbers.index(selected)
        self._hint.content = hint(f"Obstacle {index + 1} of {len(numbers)}")
        self._motion.draw(obstacles.placed[index], now)
        self._draw_shape(obstacles.placed[index], now)

    def _draw_shape(self, obstacle: PlacedObstacle, now: float) -> None:
        semi_axes = draw_pair(self._axes, obstacle.semi_axes, now)
        degrees = math.degrees(math.remainder(obstacle.angle, math.tau))
        new_degrees = self._heading.draw(round(degrees, 1), now)
        angle = obstacle.angle if new_degrees is None else math.radians(new_degrees)
        if (semi_axes, angle) != (obstacle.semi_axes, obstacle.angle):
            self._post(ObstacleResized(obstacle.number, semi_axes, angle))
