"""Controls of how the selected obstacle moves: straight on, with one turn, or along way points."""

from dataclasses import replace

import viser

from omniman_ros.planning.cases import TwoVelocityPath
from omniman_ros.viewer.events import ObstacleMotionSet, ObstaclePathSet
from omniman_ros.viewer.obstacle_paths import PathKind, WaypointPath, motion
from omniman_ros.viewer.page.floor_clicks import FloorClicks
from omniman_ros.viewer.page.inputs import NumberInput, Post, add_button, draw_pair
from omniman_ros.viewer.page.viser_compat import row_css, style_html
from omniman_ros.viewer.page.waypoint_controls import WaypointControls
from omniman_ros.viewer.placed_obstacles import MAX_VELOCITY, PlacedObstacle

MAX_REVOLUTION_TIME = 600.0  #: Latest time of a turn that can be entered [s]
STANDING = TwoVelocityPath((0.0, 0.0))  #: Path that is displayed while no obstacle is selected


class MotionControls:
    """Buttons for the kind of motion, and the numbers that belong to it."""

    def __init__(self, gui: viser.GuiApi, clicks: FloorClicks, post: Post) -> None:
        self._gui = gui
        self._post = post
        self._number: int | None = None
        self._kinds = {kind: self._kind_button(kind) for kind in PathKind}
        gui.add_html(style_html(row_css(self._kinds.values())))
        self._velocity = self._velocity_inputs("{} speed (m/s)")
        self._turn_time = NumberInput(
            gui,
            "turn after (s)",
            0.0,
            MAX_REVOLUTION_TIME,
            0.5,
            "Counts from a change of the motion, a drag or Restart; stands still in a pause.",
        )
        self._then = self._velocity_inputs("then {} speed (m/s)")
        self._numbers = (*self._velocity, self._turn_time, *self._then)
        self._waypoints = WaypointControls(gui, clicks, post)

    def _velocity_inputs(self, label: str) -> list[NumberInput]:
        return [
            NumberInput(self._gui, label.format(axis), -MAX_VELOCITY, MAX_VELOCITY, 0.05)
            for axis in "xy"
        ]

    def _kind_button(self, kind: PathKind) -> viser.GuiButtonHandle:
        return add_button(self._gui, kind.value.capitalize(), lambda: self._choose(kind))

    def _choose(self, kind: PathKind) -> None:
        if self._number is not None:
            self._post(ObstacleMotionSet(self._number, kind))

    def draw(self, obstacle: PlacedObstacle | None, now: float) -> None:
        """Display the motion of the selected obstacle, at a time of any steady clock [s]."""
        number = None if obstacle is None else obstacle.number
        if number != self._number:
            self._number = number
            for entry in self._numbers:
                entry.reset()
        home = STANDING if obstacle is None else obstacle.home
        kind = motion(home)
        for each, button in self._kinds.items():
            button.disabled = number is None
            button.color = "blue" if number is not None and each is kind else "gray"
        for entry in self._velocity:
            entry.handle.disabled = number is None
            entry.handle.visible = kind is not PathKind.WAYPOINTS
        for entry in (self._turn_time, *self._then):
            entry.handle.visible = kind is PathKind.ONE_TURN
        if isinstance(home, WaypointPath):
            self._waypoints.draw(number, home, now)
            return
        self._waypoints.draw(None, None, now)
        path = self._entered(home, now)
        if number is not None and path != home:
            self._post(ObstaclePathSet(number, path))

    def _entered(self, path: TwoVelocityPath, now: float) -> TwoVelocityPath:
        """Display the numbers of a path, and return the path with the newly entered ones."""
        path = replace(path, velocity=draw_pair(self._velocity, path.velocity, now))
        if motion(path) is PathKind.STRAIGHT:
            return path
        time = self._turn_time.draw(round(path.time, 3), now)
        return replace(
            path,
            time=path.time if time is None else time,
            then=draw_pair(self._then, path.then, now),
        )
