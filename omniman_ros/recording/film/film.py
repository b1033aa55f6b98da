"""The frames of a film, one after the other, from what was recorded.

Importing this module raises ImportError where Pillow is not installed.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from omniman_ros.core import se2
from omniman_ros.core.arm_model import JOINTS
from omniman_ros.core.arrays import Array
from omniman_ros.core.planar import Triple
from omniman_ros.core.platform import Platform
from omniman_ros.motion.whole_body.model import Mount
from omniman_ros.recording.film.bodies import RobotBody, Triangles, ribbon, solid_body
from omniman_ros.recording.film.camera import Camera, fitted_camera
from omniman_ros.recording.film.film_log import FilmLog, Solid
from omniman_ros.recording.film.picture import (
    Caption,
    CaptionWriter,
    FloorLine,
    drawn_frame,
    floor_picture,
)
from omniman_ros.recording.film.shots import FAULT, STOP, TITLES, TOOL, Shot
from omniman_ros.viewer import style

AROUND = 0.8  #: Distance around the robot's positions that a camera shows [m]
HEIGHT = 1.5  #: Height above the robot's positions that a camera shows [m]
SCAN_AGE = 0.4  #: Age up to which a scan is drawn [s]
SCAN_RANGE = 8.0  #: Distance up to which points of a scan are drawn [m]
PLAN_AGE = 0.6  #: Age up to which a plan is drawn [s]
TRAIL = 12.0  #: Length of the trail behind the robot [s]
MAP_PERIOD = 2.0  #: Time for which a map is drawn until the next one is [s]
TOOL_PATH_WIDTH = 0.022  #: Width of a path of the tool [m]
#: Angles of the points of the outline of an obstacle [rad]
CIRCLE = np.linspace(0.0, 2.0 * np.pi, 33)
#: Distance of the outline of an obstacle that the robot knows from the obstacle [m]
OBSTACLE_MARGIN = 0.06


@dataclass(frozen=True)
class FilmFormat:
    """Format of a film."""

    size: tuple[int, int] = (800, 450)  #: Width and height [px]
    rate: float = 12.0  #: Frames per second


class Film:
    """Draws the frames of a film."""

    def __init__(
        self,
        log: FilmLog,
        shots: Sequence[Shot],
        robot: Platform,
        mount: Mount | None,
        form: FilmFormat,
    ) -> None:
        self._log, self._shots, self._format = log, shots, form
        self._body = RobotBody(robot, mount)
        self._wheel_count = robot.wheel_count
        self._captions = CaptionWriter(form.size)
        self._length = sum(shot.on_screen for shot in shots)
        self._floor: tuple[tuple[int, int], Any] | None = None

    @property
    def frame_count(self) -> int:
        """Number of frames."""
        return sum(len(shot.times(self._format.rate)) for shot in self._shots)

    def frames(self) -> Iterator[Any]:
        """Yield the frames as images of Pillow."""
        before = 0.0
        for number, shot in enumerate(self._shots):
            camera = self._camera(shot)
            for time in shot.times(self._format.rate):
                fraction = (before + (time - shot.start) / shot.speed) / self._length
                image = self._frame(number, camera, float(time))
                self._captions.write(image, self._caption(shot, float(time), fraction))
                yield image
            before += shot.on_screen

    def pose(self, time: float) -> Triple:
        """Return the robot's pose in `odom` at a ROS time [s]."""
        return _interpolated_pose(self._log.robot.odom, time)

    def joints(self, time: float) -> Array | None:
        """Return the joint angles (6,) at a ROS time [s]; None where none were recorded [rad]."""
        arm = self._log.robot.arm
        if len(arm) == 0 or arm.shape[1] != 1 + JOINTS:
            return None
        return _interpolated(arm, time)

    def _camera(self, shot: Shot) -> Camera:
        times = np.linspace(shot.start, shot.end, 40)
        places = [np.array(self.pose(float(time))[:2]) for time in times]
        shown = [place + AROUND * np.array([c, s]) for place in places for c, s in _DIRECTIONS]
        goal = self._goal(shot.end)
        if shot.kind == "mpc" and goal is not None:
            shown += [np.array(goal[:2]) + AROUND * np.array(each) for each in _DIRECTIONS]
        floor = np.array(shown)
        low = np.column_stack((floor, np.zeros(len(floor))))
        high = np.column_stack((np.array(places), np.full(len(places), HEIGHT)))
        points = np.concatenate((low, high))
        if shot.kind == TOOL:
            path = self._log.tool_paths.at(shot.end)
            points = points if path is None else np.concatenate((points, path))
        width, height = self._format.size
        margins = np.array([[0.05 * width, 0.05 * width], [0.10 * height, 0.06 * height]])
        return fitted_camera(points, self._format.size, margins)

    def _frame(self, number: int, camera: Camera, time: float) -> Any:
        log, shot = self._log, self._shots[number]
        pose = self.pose(time)
        wheels = np.zeros(self._wheel_count)
        if len(log.wheels) and log.wheels.shape[1] == 1 + self._wheel_count:
            wheels = _interpolated(log.wheels, time)
        others = [solid_body(solid) for solid in self._solids(time)]
        signs = []
        if shot.kind == "mpc" and (goal := self._goal(time)) is not None:
            signs.append(self._body.goal_marker.placed(*goal))
        tool_path = log.tool_paths.at(time)
        if shot.kind == TOOL and tool_path is not None and len(tool_path) > 1:
            signs.append(ribbon(tool_path, TOOL_PATH_WIDTH, style.TOOL_PATH))
        return drawn_frame(
            camera,
            self._floor_at(number, camera, time),
            self._lines(shot, time),
            self._dots(time, pose),
            self._body.at(pose, wheels, self.joints(time)),
            Triangles.join(others),
            Triangles.join(signs),
        )

    def _floor_at(self, number: int, camera: Camera, time: float) -> Any:
        key = (number, int(time / MAP_PERIOD))
        if self._floor is None or self._floor[0] != key:
            self._floor = key, floor_picture(camera, self._log.maps.at(time))
        return self._floor[1]

    def _lines(self, shot: Shot, time: float) -> list[FloorLine]:
        log, lines = self._log, []
        if shot.kind in ("path", FAULT) and (path := log.paths.at(time)) is not None:
            lines.append(FloorLine(path, style.PATH, 3.0))
        odom = log.robot.odom
        part = odom[(odom[:, 0] > time - TRAIL) & (odom[:, 0] <= time), 1:3]
        lines.append(FloorLine(part[:: max(1, len(part) // 200)], style.TRAIL, 1.5))
        plan = log.plans.at(time, PLAN_AGE)
        if plan is not None:
            lines.append(FloorLine(plan, style.PLAN, 3.0))
        for solid in log.obstacles.at(time, SCAN_AGE) or ():
            lines.append(FloorLine(_outline(solid), style.TRACK, 1.5))
        return lines

    def _dots(self, time: float, pose: Triple) -> Array:
        """Return the points (k, 3) of the newest scan in `odom` [m]."""
        index = self._log.scans.index(time)
        points = self._log.scans.at(time, SCAN_AGE)
        if points is None:
            return np.zeros((0, 3))
        near = points[np.hypot(*points.T) < SCAN_RANGE]
        seen_from = self.pose(self._log.scans.times[index])
        flat = near @ se2.rotation(seen_from[2])[:2, :2] + np.array(seen_from[:2])
        return np.column_stack((flat, np.full(len(flat), 0.2)))

    def _solids(self, time: float) -> list[Solid]:
        """Return the bodies around the robot, in `odom`.

        In a simulated world they are where the simulation has them, seen from the true robot; else
        they are the obstacles that the robot knows.
        """
        log = self._log
        index = log.world.index(time)
        if index < 0:
            return list(log.obstacles.at(time) or ())
        following = min(index + 1, len(log.world.values) - 1)
        before, after = log.world.values[index], log.world.values[following]
        start, end = log.world.times[index], log.world.times[following]
        fraction = (time - start) / (end - start) if end > start else 0.0
        if len(log.robot.truth):
            true_pose = _interpolated_pose(log.robot.truth, time)
            shift = se2.compose(self.pose(time), se2.inverse(true_pose))
        else:
            shift = (0.0, 0.0, 0.0)
        if len(before) != len(after):
            fraction = 0.0
        moved = zip(before, after if fraction else before, strict=True)
        return [_moved(first, second, fraction, shift) for first, second in moved]

    def _goal(self, time: float) -> Triple | None:
        goals = self._log.robot.goals
        known = goals[goals[:, 0] <= time]
        if not len(known):
            return None
        x, y, theta = known[-1, 1:4].tolist()
        return x, y, theta

    def _caption(self, shot: Shot, time: float, fraction: float) -> Caption:
        title, subtitle = TITLES[shot.kind]
        dead = self._log.dead_wheels.at(time) or ()
        alarm = ""
        if shot.kind == STOP and (reason := self._log.stop_reason(time)):
            alarm = f"stopped: {reason}"
        elif dead:
            alarm = f"no torque: {', '.join(dead)}"
        corner = f"{shot.speed:.1f}x" if shot.speed > 1.05 else ""
        return Caption(title, subtitle, corner, alarm, fraction)


_DIRECTIONS = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))  #: Directions around a position


def _outline(solid: Solid) -> Array:
    a, b = (0.5 * size + OBSTACLE_MARGIN for size in solid.size)
    x, y, angle = solid.place
    points = np.column_stack((a * np.cos(CIRCLE), b * np.sin(CIRCLE)))
    return np.asarray(points @ se2.rotation(angle)[:2, :2] + np.array([x, y]))


def _moved(first: Solid, second: Solid, fraction: float, shift: Triple) -> Solid:
    x, y = (a + fraction * (b - a) for a, b in zip(first.place[:2], second.place[:2], strict=True))
    place = se2.compose(shift, (x, y, first.place[2]))
    return Solid(first.is_round, place, first.size, first.heights)


def _interpolated(table: Array, time: float) -> Array:
    """Return the values (n,) of a table (k, 1 + n) at a time [s]."""
    return np.array([np.interp(time, table[:, 0], column) for column in table[:, 1:].T])


def _interpolated_pose(table: Array, time: float) -> Triple:
    """Return the pose of a table (k, 4 or more) of time, x, y, theta at a time [s]."""
    after = min(int(np.searchsorted(table[:, 0], time)), len(table) - 1)
    first, second = table[max(after - 1, 0)], table[after]
    gap = second[0] - first[0]
    fraction = min(max((time - first[0]) / gap, 0.0), 1.0) if gap > 0.0 else 0.0
    turn = float(np.arctan2(np.sin(second[3] - first[3]), np.cos(second[3] - first[3])))
    x, y = first[1:3] + fraction * (second[1:3] - first[1:3])
    return float(x), float(y), float(first[3] + fraction * turn)
