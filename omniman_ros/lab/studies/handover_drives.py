"""Leader and followers of the study of handing over a load, in simulated time.

The leader drives along a path and knows nothing of the follower. A follower with the station
keeper gets the leader's odometry, with a latency; one with the planner was told the leader's
motion beforehand, as a goal that moves. All poses are in one odom, at whose poses the odometries
of both robots begin.
"""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core import se2
from omniman_ros.core.arbiter import Source
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.core.planar import Triple
from omniman_ros.core.preview import Preview
from omniman_ros.core.robot import Robot
from omniman_ros.lab.studies.closed_loop import LATENCY, PERIOD, ClosedLoop, StudyError
from omniman_ros.lab.studies.handover import (
    HANDOVER_WHEELS,
    KEPT_TIME,
    SIDE_GAP,
    SPEED,
    Case,
    Run,
    station_error,
)
from omniman_ros.lab.studies.mpc_loop import LoopOptions, MotionRecord, MpcLoop
from omniman_ros.lab.studies.scene_geometry import Box
from omniman_ros.lab.studies.tool_courses import COURSES
from omniman_ros.lab.studies.tool_path import ODOM_LATENCY, ODOM_PERIOD, PREVIEW_LATENCY
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.motion.path.interpolator import PathInterpolator
from omniman_ros.motion.path.parameters import PathParameters
from omniman_ros.motion.path.window import Window
from omniman_ros.motion.station.keeper import StationKeeper, StationState
from omniman_ros.motion.station.leader import Leader
from omniman_ros.motion.station.parameters import StationParameters
from omniman_ros.planning.goals import PoseGoal, TrajectoryGoal
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.simulation.plant.parameters import MismatchParameters, SimulationParameters

LENGTH = 7.0  # length of the leader's path [m]
PATH_SPACING = 0.05  # distance between poses of the leader's path [m]
DEPARTURE = 0.5  # time at which the leader departs [s]
REQUEST = 1.5  # time at which the follower is sent to the station [s]
REST_TIME = 1.0  # time for which the leader is recorded at the end of its path [s]
LEADER_START: Triple = (0.0, 0.0, 0.0)  # pose of the leader at the start [m, m, rad]
FOLLOWER_START: Triple = (-1.0, -3.0, 1.2)  # pose of the follower at the start [m, m, rad]
SETTLING_TIME = 1.0
"""Time from the follower's report that it keeps the station to the judged time [s]."""
PARTING = 1.2  # distance by which the follower moves away from the station sideways to part [m]
PARTING_TIME = 4.0
"""Time from the beginning of the parting until the station keeper is released [s]."""
PREVIEW_PERIOD = 0.04  # period of the previews of paths and stations [s]
PREVIEW_HORIZON = 0.4  # duration that these previews cover [s]
GOAL_SPACING = 0.1  # time between points of the planner's goal [s]


@dataclass(frozen=True)
class LedDrive:
    """The drive of a leader.

    Attributes:
        sample: Function from times (k,) [s] to x, x', x'' (k, 3) of the reference in odom.
    """

    record: MotionRecord  # record of its motion
    sample: Callable[[Array], tuple[Array, Array, Array]]


@dataclass(frozen=True)
class SimulatedRobot:
    """One of the two robots.

    Attributes:
        wheels: Kind of wheels in a physics world of the robot's own; None for the plant.
    """

    values: Mapping[str, Any]  # parameters of the robot, full names to values
    mismatch: Mapping[str, Any]  # errors of its wheels, names to factors by wheel
    start: Triple  # pose at the start [m, m, rad]
    wheels: str | None = None

    @property
    def simulation(self) -> SimulationParameters:
        """Parameters of the drives."""
        simulation = build(SimulationParameters, self.values)
        return replace(simulation, mismatch=build(MismatchParameters, self.mismatch))

    @property
    def world(self) -> WorldChoice | None:
        """World in which the robot drives; None for the plant."""
        return None if self.wheels is None else WorldChoice.of(self.values, self.wheels)

    def closed_loop(self) -> ClosedLoop:
        """Return controller and drives, at the start."""
        parameters = build(PlatformParameters, self.values)
        loop = ClosedLoop(parameters, self.simulation, torques=False, world=self.world)
        loop.drives.set_pose(self.start)
        loop.controller.set_pose(self.start)
        return loop


def drive(robot: Mapping[str, Any], world: str | None, case: Case) -> Run:
    """Drive leader and follower of a case."""
    wheels = HANDOVER_WHEELS[case.wheels]
    values = {**robot, **wheels.changes}
    body = build(Robot, values).body
    offset: Triple = (0.0, -(body.width + SIDE_GAP), 0.0)
    leader = drive_leader(
        SimulatedRobot(values, wheels.mismatch, LEADER_START, world),
        COURSES[case.course](*_distances())[:, [0, 1, 3]],
    )
    reverse = {name: list(factors)[::-1] for name, factors in wheels.mismatch.items()}
    behind = SimulatedRobot(values, reverse, FOLLOWER_START, world)
    if case.follower == "mpc_planner":
        follower, kept_since = plan_beside(behind, leader, offset)
    else:
        keeping = StationDrive(behind, leader.record, offset, case.seed)
        follower, kept_since = keeping.run()
    if kept_since is None:
        raise StudyError(f"{case.follower}, {case.course}: the station was not reached")
    box = Box(body.length, body.width)
    return Run.of(case, offset, box, leader.record, follower, kept_since + SETTLING_TIME)


def _distances() -> tuple[Array, float]:
    return np.linspace(0.0, LENGTH, round(LENGTH / PATH_SPACING) + 1), LENGTH


def _step(loop: ClosedLoop, record: MotionRecord) -> None:
    """Run one tick of a robot, and record it."""
    loop.step()
    record.add(loop)
    stopped = loop.controller.cancelled or loop.controller.latch.status.reason
    if stopped or loop.drives.stop_reason:
        raise StudyError(stopped or loop.drives.stop_reason)


def _preview(loop: ClosedLoop, source: Source, window: Window) -> None:
    """Pass a preview to a controller."""
    preview = Preview(window.times, window.positions, window.velocities, window.accelerations)
    refusal = loop.controller.set_preview(source, preview, loop.now)
    if refusal:
        raise StudyError(f"{source.value}/reference was refused: {refusal}")


def drive_leader(robot: SimulatedRobot, poses: Array) -> LedDrive:
    """Drive the leader along its path, from rest to rest.

    Args:
        poses: (k, 3) poses of the path [m, m, rad].
    """
    speeds = {"path.linear_velocity": SPEED, "path.angular_velocity": 10.0}
    path = PathInterpolator(build(PathParameters, {**robot.values, **speeds}))
    loop = robot.closed_loop()
    record = MotionRecord()
    while loop.now < DEPARTURE:
        _step(loop, record)
    proposal = path.propose(poses, loop.controller.odometry.pose, loop.now)
    path.take(proposal, loop.now)
    while loop.now < proposal.trajectory.end + REST_TIME:
        if loop.tick % round(PREVIEW_PERIOD / PERIOD) == 0:
            window = path.window(loop.now, PREVIEW_HORIZON)
            assert window is not None
            _preview(loop, Source.PATH, window)
        _step(loop, record)
    return LedDrive(record, proposal.trajectory.sample)


class StationDrive:
    """Drive of a follower with the station keeper, beside a leader whose drive is known."""

    def __init__(
        self, robot: SimulatedRobot, leader: MotionRecord, offset: Triple, seed: int
    ) -> None:
        self._leader, self._offset = leader, offset
        self._loop = robot.closed_loop()
        self._keeper = StationKeeper(build(StationParameters, robot.values))
        self._random = np.random.default_rng(seed)
        self._arriving: deque[tuple[float, Callable[[], None]]] = deque()
        self._measured = 0.0, robot.start
        self._kept_since: float | None = None
        self._requests = deque([(REQUEST, self._approach)])
        self._record = MotionRecord()

    def run(self) -> tuple[MotionRecord, float | None]:
        """Return the record since the request, and the time at which the station was kept [s]."""
        loop = self._loop
        while loop.now <= self._leader.times[-1]:
            now = loop.now
            if now < REQUEST:
                self._record = MotionRecord()
            _step(loop, self._record)
            if loop.tick % round(ODOM_PERIOD / PERIOD) == 0:
                self._send_odometry(now)
            while self._arriving and self._arriving[0][0] <= loop.now:
                self._arriving.popleft()[1]()
            while self._requests and self._requests[0][0] <= loop.now:
                self._requests.popleft()[1]()
            if loop.tick % round(PREVIEW_PERIOD / PERIOD) == 0:
                self._send_preview()
        return self._record, self._kept_since

    def _approach(self) -> None:
        self._keeper.keep(self._offset, self._measured[1], self._loop.now)

    def _part(self) -> None:
        x, y, theta = self._offset
        self._keeper.keep((x, y - PARTING, theta), self._measured[1], self._loop.now)

    def _send_odometry(self, measured: float) -> None:
        """Send the odometry of both robots, measured at a time [s], to the station keeper."""
        row = round((measured - self._leader.times[0]) / PERIOD)
        if row < 0:
            return
        pose, twist = self._leader.odometry[row], self._leader.twists[row]
        x, y, theta = pose.tolist()
        own = self._loop.controller.odometry.pose

        def receive() -> None:
            self._keeper.update_leader(measured, (x, y, theta), twist)
            self._measured = measured, own

        self._deliver(receive, LATENCY + self._random.uniform(*ODOM_LATENCY))

    def _deliver(self, receive: Callable[[], None], latency: float) -> None:
        """Call a receiver after a latency [s]; messages arrive in the order of sending."""
        arrival = self._loop.now + latency
        if self._arriving:
            arrival = max(arrival, self._arriving[-1][0])
        self._arriving.append((arrival, receive))

    def _send_preview(self) -> None:
        """Send the next preview; plan the parting when the station is kept for the first time."""
        keeper, now = self._keeper, self._loop.now
        time, pose = self._measured
        keeper.update(pose, time, now)
        if self._kept_since is None and keeper.state is StationState.KEEPING:
            self._kept_since = now
            parting = now + SETTLING_TIME + KEPT_TIME
            self._requests += [(parting, self._part), (parting + PARTING_TIME, keeper.release)]
        window = keeper.window(now, PREVIEW_HORIZON)
        if window is not None:
            latency = self._random.uniform(*PREVIEW_LATENCY)
            self._deliver(lambda: _preview(self._loop, Source.STATION, window), latency)


def plan_beside(
    robot: SimulatedRobot, leader: LedDrive, offset: Triple
) -> tuple[MotionRecord, float | None]:
    """Drive a follower with the planner, whose goal moves with the station.

    Returns:
        The record from the request on, and the time at which the station was kept [s].
    """
    loop = MpcLoop(
        build(PlannerParameters, robot.values),
        build(PlatformParameters, robot.values),
        robot.simulation,
        LoopOptions(start=robot.start, world=robot.world),
    )
    options = build(StationParameters, robot.values).station
    end = leader.record.times[-1]
    loop.run(REQUEST - loop.now, lambda: False)
    loop.motion_record = MotionRecord()
    goal = _moving_goal(leader, offset, np.arange(REQUEST, end, GOAL_SPACING))
    loop.drive(TrajectoryGoal(goal))

    def is_kept() -> bool:
        measured = loop.measured()
        station = goal.sample(measured.time).pose.tolist()
        x, y, angle = station_error(station, (0.0, 0.0, 0.0), measured.pose.tolist())
        near = np.hypot(x, y) <= options.position_tolerance
        return bool(near and abs(angle) <= options.heading_tolerance)

    loop.run(end - loop.now, is_kept)
    kept_since = loop.now if is_kept() else None
    loop.run(SETTLING_TIME + KEPT_TIME, lambda: False)
    x, y, theta = goal.sample(loop.now).pose.tolist()
    away = se2.compose((x, y, theta), (0.0, -PARTING, 0.0))
    loop.drive(PoseGoal(np.array(away)))
    loop.run(end - loop.now, lambda: False)
    return loop.motion_record, kept_since


def _moving_goal(leader: LedDrive, offset: Triple, times: Array) -> Preview:
    """Return the motion of the station beside the leader's reference, at times (k,) [s]."""
    poses, velocities = [], []
    for time, x, v in zip(times.tolist(), *leader.sample(times)[:2], strict=True):
        at, twist = (x[0], x[1], x[2]), se2.to_robot(float(x[2]), v)
        pose, velocity = Leader(time, at, twist).station(offset, time)
        poses.append(pose)
        velocities.append(velocity)
    return Preview(times, np.array(poses), np.array(velocities))
