"""Obstacles of the page: add, choose, shape, send off, delete."""

import math

import numpy as np
import viser

from omniman_ros.viewer.buttons import NumberInput, Post, add_button, row
from omniman_ros.viewer.crowd import FASTEST, LARGEST, SMALLEST, Rows
from omniman_ros.viewer.events import (
    ObstacleChosen,
    ObstacleDeleted,
    ObstacleSent,
    ObstacleShaped,
    Pressed,
)
from omniman_ros.viewer.state import Picture
from omniman_ros.viewer.text import hint

Pair = tuple[float, float]


class ObstaclePanel:
    """Buttons for all obstacles, numbers for the one that is chosen.

    Args:
        gui: Where to.
        post: Where events go.
    """

    def __init__(self, gui: viser.GuiApi, post: Post) -> None:
        self._post = post
        self._rows = Rows.none()
        self._chosen: int | None = None
        self._velocities: dict[int, Pair] = {}
        add = add_button(gui, "Add", lambda: post(Pressed("add")), "orange", viser.Icon.PLUS)
        self._next = add_button(gui, "Next", self._choose, icon=viser.Icon.CHEVRON_RIGHT)
        self._delete = add_button(gui, "Delete", self._remove, icon=viser.Icon.TRASH)
        self._said = gui.add_html("")
        self._axes = [
            NumberInput(
                gui, f"{name} (m)", SMALLEST, LARGEST, 0.05, f"Semi-axis along its {axis}."
            )
            for name, axis in (("length / 2", "x"), ("width / 2", "y"))
        ]
        self._heading = NumberInput(gui, "heading (°)", -180.0, 180.0, 5.0)
        self._velocity = [
            NumberInput(gui, f"{axis} speed (m/s)", -FASTEST, FASTEST, 0.05) for axis in "xy"
        ]
        self._all = add_button(
            gui, "Delete all", lambda: post(ObstacleDeleted(None)), icon=viser.Icon.TRASH_X
        )
        gui.add_html(f"<style>{row((add, self._next, self._delete))}</style>")

    def _choose(self) -> None:
        numbers = self._rows.numbers.tolist()
        if numbers:
            later = [number for number in numbers if number > (-1 if self._chosen is None
                     else self._chosen)]  # fmt: skip
            self._post(ObstacleChosen((later or numbers)[0]))

    def _remove(self) -> None:
        if self._chosen is not None:
            self._post(ObstacleDeleted(self._chosen))

    def draw(self, picture: Picture, now: float) -> None:
        """Show the obstacle that is chosen, at a time [s]."""
        crowd = self._rows = picture.crowd
        numbers = crowd.numbers.tolist()
        if not picture.holding:
            # While they are held their velocities are zero, not what they will be.
            self._velocities = dict(
                zip(numbers, map(tuple, crowd.velocities.tolist()), strict=True)
            )
        chosen = picture.chosen if picture.chosen in numbers else None
        if chosen != self._chosen:
            self._chosen = chosen
            for number in (*self._axes, self._heading, *self._velocity):
                number.reopen()
        self._next.disabled = self._all.disabled = not numbers
        self._delete.disabled = chosen is None
        for number in (*self._axes, self._heading, *self._velocity):
            number.handle.disabled = chosen is None
        if chosen is None:
            self._said.content = hint(
                "Click an obstacle to choose it, drag it to move it."
                if numbers else "No obstacle yet: add one, it appears ahead of the robot."
            )  # fmt: skip
            return
        at = numbers.index(chosen)
        self._said.content = hint(f"Obstacle {at + 1} of {len(numbers)}")
        self._draw_shape(chosen, crowd.semi_axes[at].tolist(), float(crowd.angles[at]), now)
        velocity = self._velocities.get(chosen, (0.0, 0.0))
        asked = [
            number.draw(round(value, 3), now)
            for number, value in zip(self._velocity, velocity, strict=True)
        ]
        if any(value is not None for value in asked):
            x, y = (number.handle.value for number in self._velocity)
            if np.isfinite([x, y]).all():
                self._velocities[chosen] = x, y
                self._post(ObstacleSent(chosen, (x, y)))

    def _draw_shape(self, chosen: int, semi_axes: list[float], angle: float, now: float) -> None:
        degrees = math.degrees(math.remainder(angle, math.tau))
        asked = [
            number.draw(round(value, 3), now)
            for number, value in zip(self._axes, semi_axes, strict=True)
        ]
        turned = self._heading.draw(round(degrees, 1), now)
        if turned is None and asked == [None, None]:
            return
        a, b = (value if new is None else new for new, value in zip(asked, semi_axes, strict=True))
        turn = angle if turned is None else math.radians(turned)
        self._post(ObstacleShaped(chosen, (a, b), turn))
