"""Figures of the demo: how far the robot was from what it was told, by what it published.

`odom` stands for the rows (k, 7) of `DemoRecording.odom`, `truth` for the rows (k, 4) of
`DemoRecording.truth`.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.planar import Triple
from omniman_ros.demo.measures import Interval
from omniman_ros.demo.moving_obstacles import DemoObstacles
from omniman_ros.demo.perception import People, Perception
from omniman_ros.demo.recorder import DemoRecording, Row
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.motion.whole_body.model import WholeBodyModel, planar_transform
from omniman_ros.planning.obstacles.separation import box_gap
from omniman_ros.simulation.world.scene import Post

TWIST_SETTLING = 1.0  #: Time after which the robot is to drive the commanded twist [s]
SAME_TIME = 1e-3  #: Time difference below which two points of the reference are the same [s]
ARM_SETTLING = 1.0  #: Time after the start of a move from which on its errors are measured [s]
LAGS = np.arange(-0.1, 0.2, 0.002)  #: Candidates for the lag of the arm behind its reference [s]
REST_SPEED = 0.01  #: Speed below which platform and arm count as at rest [m/s, rad/s]
ARM_SPEED_STEP = 0.05  #: Time step of the difference quotient that gives the arm's speed [s]
GAP_STEP = 5  #: Number of messages of the arm's angles for each measurement of gaps
FAR = 3.0  #: Largest gap that is measured [m]
HEIGHT = 2.0  #: Height up to which posts and persons count: the robot is lower [m]


def rms(values: Array) -> float:
    """Return the root mean square of an array."""
    return float(np.sqrt(np.mean(np.square(values))))


def wrap_angle(angle: Array) -> Array:
    """Return angles wrapped to [-pi, pi] [rad]."""
    result: Array = np.remainder(angle + math.pi, math.tau) - math.pi
    return result


# ---- twists ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class TwistPhase:
    """A body twist for some time."""

    name: str
    duration: float  #: [s]
    #: From the time since the start [s] to x', y' [m/s], theta' [rad/s] in base_link
    twist: Callable[[float], Triple]
    start: float = math.nan  #: ROS time at which it was driven [s]


def twist_figures(odom: Array, driven: Sequence[TwistPhase]) -> list[dict[str, Any]]:
    """Return name, and error of the mean twist once it had settled [m/s, rad/s], of each phase.

    The errors are infinite without odometry.
    """
    figures = []
    for phase in driven:
        elapsed = odom[:, 0] - phase.start
        settled = (elapsed >= TWIST_SETTLING) & (elapsed <= phase.duration)
        x, y, turning = math.inf, 0.0, math.inf
        if settled.any():
            setpoints = np.array([phase.twist(t) for t in elapsed[settled].tolist()])
            x, y, turning = (odom[settled, 4:7] - setpoints).mean(axis=0).tolist()
        figures.append(
            {"name": phase.name, "linear_m_s": math.hypot(x, y), "angular_rad_s": abs(turning)}
        )
    return figures


# ---- paths of the platform ------------------------------------------------------------------


class Reference:
    """The reference that `path/reference` published, as a function of ROS time.

    Args:
        rows: Rows of `DemoRecording.reference`: time, x, y, theta, in any order; times may repeat.
    """

    def __init__(self, rows: Sequence[Row]) -> None:
        table = np.array(rows).reshape(-1, 4)
        table = table[np.argsort(table[:, 0], kind="stable")]
        is_new = np.concatenate([[True], np.diff(table[:, 0]) > SAME_TIME])[: len(table)]
        self.times = table[is_new, 0]  #: Times (k,) in increasing order [s]
        self._poses = np.column_stack([table[is_new, 1:3], np.unwrap(table[is_new, 3])])

    def during(self, times: Array, intervals: Sequence[Interval]) -> NDArray[np.bool_]:
        """Return which of the times (k,) lie in any interval and within the reference."""
        is_during = np.zeros(len(times), dtype=bool)
        if len(self.times):
            for interval in intervals:
                is_during |= interval.contains(times)
            is_during &= (times >= self.times[0]) & (times <= self.times[-1])
        return is_during

    def errors(self, odom: Array) -> tuple[Array, Array]:
        """Return distance [m] and angle [rad], (k,) each, of rows (k, 7) of `DemoRecording.odom`.

        The first and the last pose of the reference hold before and after it.
        """
        due = [np.interp(odom[:, 0], self.times, column) for column in self._poses.T]
        error = odom[:, 1:4] - np.column_stack(due)
        return np.hypot(error[:, 0], error[:, 1]), wrap_angle(error[:, 2])


def tracking_figures(
    odom: Array, reference: Reference, intervals: Sequence[Interval]
) -> dict[str, Any]:
    """Return the tracking errors in odom, each at the stamp of its odometry message.

    They are those of position and heading, in the intervals in which the path was driven and at
    its end; infinite if in any of them no reference was published, or no odometry.
    """
    during = reference.during(odom[:, 0], intervals)
    is_driven = all(interval.contains(reference.times).any() for interval in intervals)
    if not is_driven or not during.any():
        means, maxima = ("rms_mm", "heading_rms_deg"), ("max_mm", "heading_max_deg")
        return dict.fromkeys((*means, *maxima, "final_mm", "final_heading_deg"), math.inf)
    distance, angle = reference.errors(odom[during])
    ended = odom[:, 0] <= max(interval.end for interval in intervals)
    final_distance, final_angle = reference.errors(odom[ended][-1:])
    return {
        "rms_mm": 1e3 * rms(distance),
        "max_mm": 1e3 * float(distance.max()),
        "heading_rms_deg": math.degrees(rms(angle)),
        "heading_max_deg": math.degrees(float(np.abs(angle).max())),
        "final_mm": 1e3 * float(final_distance[0]),
        "final_heading_deg": math.degrees(abs(float(final_angle[0]))),
        "samples": int(during.sum()),
    }


def coupling_figures(rows: Sequence[Row], movements: Sequence[Interval]) -> dict[str, Any]:
    """Return the coupling error on a path, over all movements and for each of them [rad].

    It is counted from the start of the path, CCTA 2017 (24). The rows are those of
    `DemoRecording.coupling`; a robot without constraints has only the stamps.
    """
    table = np.array(rows)
    times, epsilon = table[:, 0], table[:, 1:]
    result: dict[str, Any] = {"rms_rad": 0.0, "max_rad": 0.0, "movements": {}}
    if not epsilon.size:
        return result
    start = min((movement.start for movement in movements), default=math.inf)
    before = np.flatnonzero(times <= start)
    epsilon = epsilon - epsilon[before[-1] if before.size else 0]
    on_path = np.zeros(len(table), dtype=bool)
    for movement in movements:
        during = movement.contains(times)
        on_path |= during
        if during.any():
            result["movements"][movement.name] = float(np.abs(epsilon[during]).max())
    if on_path.any():
        result["rms_rad"] = rms(epsilon[on_path])
        result["max_rad"] = float(np.abs(epsilon[on_path]).max())
    return result


# ---- arm and tool ---------------------------------------------------------------------------


@dataclass(frozen=True)
class ArmMove:
    """A move of the arm to joint angles."""

    goal: tuple[float, ...]  #: Joint angles at the end of the move [rad]
    start: float  #: ROS time at which the move was sent [s]
    end: float = math.nan  #: ROS time until which the move is measured [s]


def arm_figures(recording: DemoRecording, moves: Sequence[ArmMove]) -> dict[str, Any]:
    """Return the lag and the errors of the arm behind its reference, and where it came to rest.

    The servo of the arm's controller lags. The lag is the delay at which the measured angles fit
    the reference best; the error is the remaining difference. Each figure is that of the worst
    joint or, as RMS, of all joints.
    """
    measured = np.array(recording.arm)
    reference = np.array(recording.arm_reference).reshape(-1, measured.shape[1])
    reference = reference[np.argsort(reference[:, 0], kind="stable")]
    is_moving = np.zeros(len(measured), dtype=bool)
    final_errors = []
    for move in moves:
        is_moving |= (measured[:, 0] >= move.start + ARM_SETTLING) & (measured[:, 0] <= move.end)
        last = measured[measured[:, 0] <= move.end][-1, 1:]
        final_errors.append(float(np.abs(last - np.array(move.goal)).max()))
    rows = measured[is_moving]

    def error(lag: float) -> Array:
        times = rows[:, 0] - lag
        joints = [np.interp(times, reference[:, 0], joint) for joint in reference[:, 1:].T]
        result: Array = rows[:, 1:] - np.column_stack(joints)
        return result

    lag = float(LAGS[int(np.argmin([rms(error(delay)) for delay in LAGS]))])
    travel = np.abs(np.diff(rows[:, 1:], axis=0)).sum(axis=0)
    return {
        "moves": len(moves),
        "travel_rad": float(travel.max()),
        "final_mrad": 1e3 * max(final_errors),
        "lag_ms": 1e3 * lag,
        "rms_mrad": 1e3 * rms(error(lag)),
        "setpoints": interval_figures(np.cumsum(recording.arm_intervals).tolist()),
    }


@dataclass(frozen=True)
class DrivenTool:
    """A path of the tool that was driven past posts and persons, if there were any."""

    interval: Interval  #: In which the tool was moved
    posts: Sequence[Post]  #: In the frame of the ground truth
    people: People

    @property
    def has_obstacles(self) -> bool:
        """Whether there was a post or a person."""
        return bool(len(self.posts) + len(self.people.radii))


@dataclass(frozen=True)
class ToolTrack:
    """Positions (k, 3) of the tool on its path [m], one for each message of the arm's angles."""

    times: Array  #: ROS times (k,) [s]
    platform: Array  #: Poses (k, 3) of the platform in odom [m, m, rad]
    measured: Array  #: Tool in odom, from the arm's angles and odometry
    reference: Array  #: Tool on its path at these times, in odom
    errors: Array  #: Distances (k,) of the tool from its reference [m]
    true_errors: Array  #: The same by the ground truth, with odometry's drift since the start [m]
    truth: Array  #: True poses (k, 3) of the platform [m, m, rad]
    angles: Array  #: Measured joint angles (k, 6) [rad]


def tool_track(recording: DemoRecording, model: WholeBodyModel, interval: Interval) -> ToolTrack:
    """Return how the tool moved in an interval."""
    arm, odom = np.array(recording.arm), np.array(recording.odom)
    reference = np.array(recording.tool_reference)
    reference = reference[np.argsort(reference[:, 0], kind="stable")]
    first = max(interval.start, reference[0, 0], odom[0, 0])
    last = min(interval.end, reference[-1, 0], odom[-1, 0])
    rows = arm[(arm[:, 0] >= first) & (arm[:, 0] <= last)]
    times = rows[:, 0]
    platform, truth = _poses_at(odom, times), _poses_at(np.array(recording.truth), times)
    tool = model.forward(np.hstack([platform, rows[:, 1:]]))
    in_base_link = np.linalg.inv(planar_transform(platform)) @ tool
    to_odom = planar_transform(platform[:1]) @ np.linalg.inv(planar_transform(truth[:1]))
    true = to_odom @ planar_transform(truth) @ in_base_link
    due = np.column_stack([np.interp(times, reference[:, 0], axis) for axis in reference[:, 1:].T])
    errors, true_errors = (np.linalg.norm(poses[:, :3, 3] - due, axis=1) for poses in (tool, true))
    return ToolTrack(times, platform, tool[:, :3, 3], due, errors, true_errors, truth, rows[:, 1:])


def tool_figures(track: ToolTrack) -> dict[str, Any]:
    """Return the errors of the tool, and the lengths of the paths of tool and platform."""
    steps = np.linalg.norm(np.diff(track.reference, axis=0), axis=1)
    platform_steps = np.hypot(*np.diff(track.platform[:, :2], axis=0).T)
    return {
        "rms_mm": 1e3 * rms(track.errors),
        "max_mm": 1e3 * float(track.errors.max()),
        "true_rms_mm": 1e3 * rms(track.true_errors),
        "true_max_mm": 1e3 * float(track.true_errors.max()),
        "length_m": float(steps.sum()),
        "platform_m": float(platform_steps.sum()),
        "time_s": float(track.times[-1] - track.times[0]),
        "samples": len(track.times),
    }


def tool_clearance(
    track: ToolTrack, description: DescriptionParameters, driven: DrivenTool
) -> float:
    """Return the least gap of platform and arm to posts and persons by the ground truth [m].

    The physics engine measures it, every `GAP_STEP` messages of the arm; at most `FAR`.

    Raises:
        ImportError: The physics engine is not installed.
    """
    from omniman_ros.simulation.world.distances import ConfigurationDistances, Prism

    people, standing = driven.people, np.array([(post.x, post.y) for post in driven.posts])
    radii = [*(post.radius for post in driven.posts), *people.radii.tolist()]
    things = [Prism((radius, radius), 0.0, (0.0, HEIGHT)) for radius in radii]
    robot, least = ConfigurationDistances(description, things), FAR
    for k in range(0, len(track.times), GAP_STEP):
        places = np.vstack([standing.reshape(-1, 2), people.at(float(track.times[k]))])
        robot.place(track.truth[k], track.angles[k], places)
        least = min(least, float(robot.distances(least).min()))
    return least


def _poses_at(rows: Array, times: Array) -> Array:
    """Return the poses (k, 3) at times (k,) of rows that begin with stamp, x, y, theta."""
    columns = (rows[:, 1], rows[:, 2], np.unwrap(rows[:, 3]))
    return np.column_stack([np.interp(times, rows[:, 0], column) for column in columns])


# ---- goal -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class DrivenGoal:
    """A goal that was reached among obstacles."""

    goal: Array  #: Pose (3,) in odom [m, m, rad]
    obstacles: DemoObstacles | People  #: On the way
    interval: Interval  #: In which the robot drove to the goal
    perception: Perception | None = None  #: If it drove by its scanner


def obstacle_gaps(
    obstacles: DemoObstacles | People, rows: Array, half_size: Sequence[float]
) -> Array:
    """Return the gaps (K, M) of the robot's box at rows (K, 4) of stamp and pose [m].

    `half_size` are half length and half width of the box [m].
    """
    centers = np.array([obstacles.at(time) for time in rows[:, 0].tolist()])
    radii = obstacles.radii
    axes = np.broadcast_to(radii[:, None], centers.shape)
    box = Rectangles.centred(np.array(half_size))
    return box_gap(rows[:, 1:4], box, centers, axes, np.zeros(len(radii)))


def goal_figures(
    odom: Array, truth: Array, driven: DrivenGoal, half_size: Sequence[float]
) -> dict[str, Any]:
    """Return the error at the goal and the smallest clearance of the obstacles on the way, if any.

    Persons in a world are in the frame of the ground truth, obstacles that the robot is told of in
    odom. `half_size` are half length and half width of the robot's bounding box [m].
    """
    rows = odom[:, :4] if driven.perception is None else truth
    during = odom[driven.interval.contains(odom[:, 0])]
    near = rows[driven.interval.contains(rows[:, 0])]
    if not len(during) or not len(near):
        figures = dict.fromkeys(("position_mm", "heading_deg", "time_s"), math.inf)
        return figures | {"clearance_m": -math.inf}
    x, y, theta = during[-1, 1:4] - driven.goal
    figures = {
        "position_mm": 1e3 * math.hypot(x, y),
        "heading_deg": math.degrees(abs(se2.wrap(theta))),
        "time_s": driven.interval.end - driven.interval.start,
    }
    if len(driven.obstacles.radii):
        figures["clearance_m"] = float(obstacle_gaps(driven.obstacles, near, half_size).min())
    return figures


# ---- emergency stop -------------------------------------------------------------------------


@dataclass(frozen=True)
class DrivenStop:
    """An emergency stop, in ROS time."""

    pressed: float  #: [s]
    reset: float  #: Time at which the reset was answered [s]
    end: float  #: Time until which the robot was watched [s]


def stop_figures(recording: DemoRecording, driven: DrivenStop) -> dict[str, Any]:
    """Return speed, time to rest and distance of the stop, and the motion after the reset.

    All are derived from odometry and from the arm's measured angles. The figures of the arm are
    missing if there is none.
    """
    odom, arm = np.array(recording.odom), np.array(recording.arm)
    result: dict[str, Any] = {}
    speeds = np.hypot(odom[:, 4], odom[:, 5]) + np.abs(odom[:, 6])
    result["speed_m_s"], result["rest_s"] = _time_to_rest(odom[:, 0], speeds, driven)
    stopping = odom[(odom[:, 0] >= driven.pressed) & (odom[:, 0] <= driven.reset)]
    result["way_mm"] = 1e3 * float(np.hypot(*np.diff(stopping[:, 1:3], axis=0).T).sum())
    after = odom[(odom[:, 0] > driven.reset) & (odom[:, 0] <= driven.end)]
    moved = np.hypot(*(after[:, 1:3] - after[0, 1:3]).T).max() if len(after) else math.inf
    result["moved_mm"] = 1e3 * float(moved)
    if len(arm):
        before = np.column_stack(
            [np.interp(arm[:, 0] - ARM_SPEED_STEP, arm[:, 0], joint) for joint in arm[:, 1:].T]
        )
        rates = np.abs(arm[:, 1:] - before).max(axis=1) / ARM_SPEED_STEP
        result["arm_rate_rad_s"], result["arm_rest_s"] = _time_to_rest(arm[:, 0], rates, driven)
        after = arm[(arm[:, 0] > driven.reset) & (arm[:, 0] <= driven.end), 1:]
        moved = np.abs(after - after[0]).max() if len(after) else math.inf
        result["arm_moved_mrad"] = 1e3 * float(moved)
    return result


def _time_to_rest(times: Array, speeds: Array, driven: DrivenStop) -> tuple[float, float]:
    """Return the speed when the stop is pressed, and the time from then to rest [s].

    They are NaN and infinity if the robot did not come to rest before the reset. The arguments
    are ROS times (k,) [s], and the speeds (k,) at these times.
    """
    before, during = times < driven.pressed, (times >= driven.pressed) & (times <= driven.reset)
    stamps, braking = times[during], speeds[during]
    if not before.any() or not len(stamps) or braking[-1] > REST_SPEED:
        return math.nan, math.inf
    moving = np.flatnonzero(braking > REST_SPEED)
    rest = float(stamps[moving[-1]] - driven.pressed) if len(moving) else 0.0
    return float(speeds[before][-1]), rest


# ---- whole drive ----------------------------------------------------------------------------


def whole_drive_figures(recording: DemoRecording) -> dict[str, Any]:
    """Return odometry's drift, the energy of the motors, timing and, in a world, contacts."""
    energy = np.array(recording.energy)
    consumed = energy[-1] - energy[0]
    touched = recording.contacts
    contacts = {} if touched is None else {"contacts": {"count": len(touched), "with": touched}}
    return {
        **contacts,
        "odometry": drift_figures(np.array(recording.odom), np.array(recording.truth)),
        "energy": {"total_j": float(consumed.sum()), "wheels_j": consumed.tolist()},
        "timing": {
            "odom": interval_figures([row[0] for row in recording.odom]),
            "wheel_commands": interval_figures(recording.commands),
            "stall_ms": 1e3 * recording.stall,
        },
    }


def drift_figures(odom: Array, truth: Array) -> dict[str, Any]:
    """Return odometry's error at the end, relative to its start, and the true travel."""
    x, y, theta = _relative_motion(odom[:, 1:4]) - _relative_motion(truth[:, 1:4])
    steps = np.diff(truth[:, 1:4], axis=0)
    return {
        "position_mm": 1e3 * math.hypot(x, y),
        "heading_deg": math.degrees(abs(se2.wrap(theta))),
        "travel_m": float(np.hypot(steps[:, 0], steps[:, 1]).sum()),
        "turn_rad": float(np.abs(wrap_angle(steps[:, 2])).sum()),
    }


def interval_figures(times: Sequence[float]) -> dict[str, float]:
    """Return the mean rate of a topic, and its intervals, from the times of messages [s]."""
    intervals_ms = 1e3 * np.diff(np.array(times))
    return {
        "rate_hz": 1e3 / float(intervals_ms.mean()),
        "p50_ms": float(np.percentile(intervals_ms, 50)),
        "p99_ms": float(np.percentile(intervals_ms, 99)),
        "max_ms": float(intervals_ms.max()),
    }


def _relative_motion(poses: Array) -> Array:
    """Return the last of the poses (k, 3) in the frame of the first [m, m, rad]."""
    result: Array = se2.rotation(poses[0, 2]) @ (poses[-1] - poses[0])
    return result
