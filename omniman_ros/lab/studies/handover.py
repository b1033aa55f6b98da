"""Two robots meet in motion, drive beside each other as for handing over a load, and part again.

MPC 2021, 5, names this as a use of goals that move. The leader drives along a path and knows
nothing of the follower, whose station keeper gets the leader's odometry, with a latency. All poses
are in one odom, at whose poses the odometries of both robots begin. A drive is judged by the true
poses of both.
"""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from omniman_ros.core import se2
from omniman_ros.core.arbiter import Source
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import build
from omniman_ros.core.planar import Triple
from omniman_ros.core.platform import Platform
from omniman_ros.core.preview import Preview
from omniman_ros.lab.studies.closed_loop import (
    LATENCY,
    PERIOD,
    ClosedLoop,
    MotionRecord,
    StudyError,
)
from omniman_ros.lab.studies.scene_geometry import RectangularOutline, wall_gap
from omniman_ros.lab.studies.tool_courses import COURSES
from omniman_ros.lab.studies.tool_path import (
    DEMO_MISMATCH,
    ODOM_LATENCY,
    ODOM_PERIOD,
    PREVIEW_LATENCY,
    WHEELS,
    WheelSettings,
)
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.motion.path.interpolator import PathInterpolator
from omniman_ros.motion.path.pace import Window
from omniman_ros.motion.path.parameters import PathParameters
from omniman_ros.motion.station.keeper import StationKeeper, StationState
from omniman_ros.motion.station.parameters import StationParameters
from omniman_ros.simulation.plant.parameters import MismatchParameters

SPEED = 0.3  #: speed of the leader along its path [m/s]
SIDE_GAP = 0.6  #: gap between the sides of the two robots at the station [m]
KEPT_TIME = 5.0  #: time for which the station is to be kept [s]
LENGTH = 7.0  #: length of the leader's path [m]
PATH_SPACING = 0.05  #: distance between poses of the leader's path [m]
DEPARTURE = 0.5  #: time at which the leader departs [s]
REQUEST = 1.5  #: time at which the follower is sent to the station [s]
REST_TIME = 1.0  #: time for which the leader is recorded at the end of its path [s]
LEADER_START: Triple = (0.0, 0.0, 0.0)  #: pose of the leader at the start [m, m, rad]
FOLLOWER_START: Triple = (-1.0, -3.0, 1.2)  #: pose of the follower at the start [m, m, rad]
SETTLING_TIME = 1.0  #: time from the report that the station is kept to the judged time [s]
PARTING = 1.2  #: distance by which the follower moves away from the station sideways to part [m]
PARTING_TIME = 4.0  #: time from the beginning of the parting until the keeper is released [s]
PREVIEW_PERIOD = 0.04  #: period of the previews of paths and stations [s]
PREVIEW_HORIZON = 0.4  #: duration that these previews cover [s]
UNCALIBRATED = "radii"  #: name of the wheels with radii that neither robot knows
HANDOVER_WHEELS = {
    "PI": WHEELS["PI"],
    "P": WHEELS["P"],
    UNCALIBRATED: WheelSettings(
        "wheels of the demo, radii off by up to 0.2 %",
        {},
        {**DEMO_MISMATCH, "radius": [1.002, 0.998, 1.001, 0.999]},
    ),
}  #: Wheels of the leader, by name; the follower has them in reverse order


@dataclass(frozen=True)
class HandoverCase:
    """One drive of the study."""

    course: str  #: shape of the leader's path, a key of `tool_courses.COURSES`
    wheels: str  #: wheels of the robots, a key of `HANDOVER_WHEELS`
    seed: int = 0  #: seed of the latencies

    @property
    def is_aim(self) -> bool:
        """Whether the station is to be kept: no odometry knows of radii that are off."""
        return self.wheels != UNCALIBRATED


@dataclass(frozen=True)
class HandoverRun:
    """A completed drive, with a row for each of K ticks of 5 ms."""

    case: HandoverCase  #: the case
    offset: Triple  #: pose of the station in base_link of the leader [m, m, rad]
    box: RectangularOutline  #: outline of each robot
    times: Array  #: (K,) times since the follower was sent to the station [s]
    leader: Array  #: (K, 3) true poses of the leader [m, m, rad]
    follower: Array  #: (K, 3) true poses of the follower [m, m, rad]
    energies: Array  #: (K, 2) electric energy that leader and follower have consumed [J]
    kept_from: float  #: time at which the judged time begins [s]

    @staticmethod
    def of(
        case: HandoverCase,
        offset: Triple,
        box: RectangularOutline,
        leader: MotionRecord,
        follower: MotionRecord,
        kept_from: float,
    ) -> "HandoverRun":
        """Return the run that two records contain; both end with the shorter one."""
        first = round((follower.times[0] - leader.times[0]) / PERIOD)
        count = min(len(leader.times) - first, len(follower.times))
        rows = slice(first, first + count)
        energies = np.column_stack([leader.energy[rows], follower.energy[:count]])
        return HandoverRun(
            case,
            offset,
            box,
            np.array(follower.times[:count]) - follower.times[0],
            np.array(leader.poses[rows]),
            np.array(follower.poses[:count]),
            energies - energies[0],
            kept_from - follower.times[0],
        )

    @property
    def kept(self) -> slice:
        """Rows of the judged time."""
        first = round(self.kept_from / PERIOD)
        return slice(first, first + round(KEPT_TIME / PERIOD) + 1)

    def errors(self) -> Array:
        """Return the true poses (K, 3) of the follower in the frame of the station [m, m, rad].

        The station is that beside the true leader.
        """
        pairs = zip(self.leader.tolist(), self.follower.tolist(), strict=True)
        return np.array([station_error(leader, self.offset, own) for leader, own in pairs])

    def gaps(self) -> Array:
        """Return the true gaps (K,) between the outlines of the robots [m]."""
        size = np.tile([self.box.length, self.box.width], (len(self.leader), 1))
        return wall_gap(self.follower, self.box, np.hstack([self.leader, size]))

    def speeds(self) -> Array:
        """Return the true speeds (K, 2) of leader and follower [m/s]."""
        rates = [
            np.gradient(poses[:, :2], PERIOD, axis=0) for poses in (self.leader, self.follower)
        ]
        return np.column_stack([np.hypot(rate[:, 0], rate[:, 1]) for rate in rates])


def station_error(leader: Triple, offset: Triple, follower: Triple) -> Triple:
    """Return the pose of a follower in the frame of its station [m, m, rad]."""
    station = se2.compose(leader, offset)
    difference = np.array([follower[0] - station[0], follower[1] - station[1], 0.0])
    x, y, _ = se2.to_robot(station[2], difference).tolist()
    return x, y, se2.wrap(follower[2] - station[2])


def drive(robot: Mapping[str, Any], world: str | None, case: HandoverCase) -> HandoverRun:
    """Drive leader and follower of a case, each on its plant or in a world of its own."""
    wheels = HANDOVER_WHEELS[case.wheels]
    values = {**robot, **wheels.changes}
    body = build(Platform, values).body
    offset: Triple = (0.0, -(body.width + SIDE_GAP), 0.0)
    distances = np.linspace(0.0, LENGTH, round(LENGTH / PATH_SPACING) + 1)
    path = COURSES[case.course](distances, LENGTH)[:, [0, 1, 3]]
    leader = drive_leader(_loop(values, world, wheels.mismatch, LEADER_START), values, path)
    reverse = {name: list(factors)[::-1] for name, factors in wheels.mismatch.items()}
    behind = _loop(values, world, reverse, FOLLOWER_START)
    follower, kept_since = StationDrive(behind, values, leader, offset, case.seed).run()
    if kept_since is None:
        raise StudyError(f"{case.course}: the station was not reached")
    box = RectangularOutline(body.length, body.width)
    return HandoverRun.of(case, offset, box, leader, follower, kept_since + SETTLING_TIME)


def _loop(
    values: Mapping[str, Any], world: str | None, mismatch: Mapping[str, Any], start: Triple
) -> ClosedLoop:
    """Return controller and drives of a robot, at its start."""
    choice = WorldChoice.of(values, world) if world else None
    loop = ClosedLoop.of_robot(values, choice, build(MismatchParameters, mismatch))
    loop.set_pose(start)
    return loop


def _step(loop: ClosedLoop, record: MotionRecord) -> None:
    """Run one tick of a robot, and record it."""
    loop.step()
    record.add(loop)
    loop.check("handover")


def _preview(window: Window) -> Preview:
    return Preview(window.times, window.positions, window.velocities, window.accelerations)


def drive_leader(loop: ClosedLoop, values: Mapping[str, Any], poses: Array) -> MotionRecord:
    """Drive the leader along its path of poses (k, 3) [m, m, rad], from rest to rest."""
    speeds = {"path.linear_velocity": SPEED, "path.angular_velocity": 10.0}
    path = PathInterpolator(build(PathParameters, {**values, **speeds}))
    record = MotionRecord()
    while loop.now < DEPARTURE:
        _step(loop, record)
    proposal = path.propose(poses, loop.controller.odometry.pose, loop.now)
    path.take(proposal, loop.now)
    while loop.now < proposal.trajectory.end + REST_TIME:
        if loop.tick % round(PREVIEW_PERIOD / PERIOD) == 0:
            window = path.window(loop.now, PREVIEW_HORIZON)
            assert window is not None
            loop.send(Source.PATH, _preview(window))
        _step(loop, record)
    return record


class StationDrive:
    """Drive of a follower with the station keeper, beside a leader whose drive is known."""

    def __init__(
        self,
        loop: ClosedLoop,
        values: Mapping[str, Any],
        leader: MotionRecord,
        offset: Triple,
        seed: int,
    ) -> None:
        self._loop, self._leader, self._offset = loop, leader, offset
        self._keeper = StationKeeper(build(StationParameters, values))
        self._random = np.random.default_rng(seed)
        self._arriving: deque[tuple[float, Callable[[], None]]] = deque()
        self._measured = 0.0, FOLLOWER_START
        self._kept_since: float | None = None
        self._requests = deque([(REQUEST, lambda: self._keep(self._offset))])
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
            for queue in (self._arriving, self._requests):
                while queue and queue[0][0] <= loop.now:
                    queue.popleft()[1]()
            if loop.tick % round(PREVIEW_PERIOD / PERIOD) == 0:
                self._send_preview()
        return self._record, self._kept_since

    def _keep(self, station: Triple) -> None:
        self._keeper.keep(station, self._measured[1], self._loop.now)

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
            x, y, theta = self._offset
            parting = now + SETTLING_TIME + KEPT_TIME
            self._requests.append((parting, lambda: self._keep((x, y - PARTING, theta))))
            self._requests.append((parting + PARTING_TIME, keeper.release))
        window = keeper.window(now, PREVIEW_HORIZON)
        if window is not None:
            latency = self._random.uniform(*PREVIEW_LATENCY)
            self._deliver(lambda: self._loop.send(Source.STATION, _preview(window)), latency)
