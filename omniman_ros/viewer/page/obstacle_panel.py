"""Controls of the page's obstacles: add, select, resize, set the velocity, delete."""

import math

import numpy as np
import viser

from omniman_ros.viewer.events import (
    ButtonPressed,
    ObstacleDeleted,
    ObstacleResized,
    ObstacleSelected,
    ObstacleVelocitySet,
)
from omniman_ros.viewer.page.inputs import NumberInput, Post, add_button
from omniman_ros.viewer.page.viser_compat import row_css, style_html
from omniman_ros.viewer.placed_obstacles import (
    MAX_SEMI_AXIS,
    MAX_VELOCITY,
    MIN_SEMI_AXIS,
    ObstacleArrays,
)
from omniman_ros.viewer.status_text import hint
from omniman_ros.viewer.view_state import ViewState

Pair = tuple[float, float]
"""Velocity (x, y) [m/s]."""


class ObstaclePanel:
    """Buttons for all obstacles, and number inputs for the selected one.

    Args:
        gui: GUI of the page.
        post: Accepts events; must not block.
    """

    def __init__(self, gui: viser.GuiApi, post: Post) -> None:
        self._post = post
        self._drawn = ObstacleArrays.empty()
        self._selected: int | None = None
        self._velocities: dict[int, Pair] = {}
        add = add_button(gui, "Add", lambda: post(ButtonPressed("add")), "orange", viser.Icon.PLUS)
        self._next = add_button(gui, "Next", self._select_next, icon=viser.Icon.CHEVRON_RIGHT)
        self._delete = add_button(gui, "Delete", self._delete_selected, icon=viser.Icon.TRASH)
        self._hint = gui.add_html("")
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
        self._velocity = [
            NumberInput(gui, f"{axis} speed (m/s)", -MAX_VELOCITY, MAX_VELOCITY, 0.05)
            for axis in "xy"
        ]
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
        if not state.obstacles_paused:
            # While the obstacles are paused, these velocities are zero, not those after the pause.
            self._velocities = dict(
                zip(numbers, map(tuple, obstacles.velocities.tolist()), strict=True)
            )
        selected = state.selected_obstacle if state.selected_obstacle in numbers else None
        if selected != self._selected:
            self._selected = selected
            for number in (*self._axes, self._heading, *self._velocity):
                number.reset()
        self._next.disabled = self._all.disabled = not numbers
        self._delete.disabled = selected is None
        for number in (*self._axes, self._heading, *self._velocity):
            number.handle.disabled = selected is None
        if selected is None:
            self._hint.content = hint(
                "Click an obstacle to choose it, drag it to move it."
                if numbers
                else "No obstacle yet: add one, it appears ahead of the robot."
            )
            return
        index = numbers.index(selected)
        self._hint.content = hint(f"Obstacle {index + 1} of {len(numbers)}")
        self._draw_shape(
            selected, obstacles.semi_axes[index].tolist(), float(obstacles.angles[index]), now
        )
        velocity = self._velocities.get(selected, (0.0, 0.0))
        requested = [
            number.draw(round(value, 3), now)
            for number, value in zip(self._velocity, velocity, strict=True)
        ]
        if any(value is not None for value in requested):
            x, y = (number.handle.value for number in self._velocity)
            if np.isfinite([x, y]).all():
                self._velocities[selected] = x, y
                self._post(ObstacleVelocitySet(selected, (x, y)))

    def _draw_shape(self, selected: int, semi_axes: list[float], angle: float, now: float) -> None:
        degrees = math.degrees(math.remainder(angle, math.tau))
        requested = [
            number.draw(round(value, 3), now)
            for number, value in zip(self._axes, semi_axes, strict=True)
        ]
        new_degrees = self._heading.draw(round(degrees, 1), now)
        if new_degrees is None and requested == [None, None]:
            return
        a, b = (
            value if new is None else new for new, value in zip(requested, semi_axes, strict=True)
        )
        heading = angle if new_degrees is None else math.radians(new_degrees)
        self._post(ObstacleResized(selected, (a, b), heading))
