"""Platform and arm along a path of the tool, in the physics world, in simulated time.

The platform controller, the drives, the streamer's setpoint generator and the arm's servo run as
they do on the robot. Measured poses and previews arrive with a latency, obstacles are observed
with noise, and a plan counts once it is there. What drives the robot is an argument.
"""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from omniman_ros.core.arbiter import Source
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build
from omniman_ros.core.preview import Preview
from omniman_ros.lab.studies.avoidance_scenes import AvoidanceScene
from omniman_ros.lab.studies.closed_loop import LATENCY, PERIOD, ClosedLoop, StudyError
from omniman_ros.lab.studies.tool_path import (
    ODOM_LATENCY,
    ODOM_PERIOD,
    PREVIEW_LATENCY,
    STEP,
    StreamedArm,
)
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.motion.axes import JOINT_COLUMNS, PLATFORM_COLUMNS
from omniman_ros.motion.path.pace import Window
from omniman_ros.planning.whole_body.controller import PERIOD as CYCLE
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.processes.arm_options import WORLD_SERVO_LAG
from omniman_ros.simulation.arm_link.direct_link import DirectLink
from omniman_ros.simulation.ur.arm import UrArmParameters
from omniman_ros.simulation.ur.world_arm import WorldArm
from omniman_ros.simulation.world import scene as things
from omniman_ros.surroundings.obstacles import Observation, ObstacleParameters, ObstacleSet
from omniman_ros.ur.parameters import UrParameters

BEGIN = 1.0  #: Time for which the robot sees a scene before it begins [s]
ANSWER = 0.02  #: Time after which the result of a cycle is there [s]
OBSERVED = 0.1  #: Period of the observations [s]
NOISE = 0.01  #: Standard deviation of an observed position, along each axis [m]
#: Shortest time between two previews of the arm from cycle to cycle [s]
CORRECTED = 0.018
#: Time for which the arm may refuse previews before the motion is given up [s]
REFUSED = 0.2
REST_TIME = 1.0  #: Time for which a robot is watched that has stopped early [s]


class BodyDriver(Protocol):
    """What moves platform and arm; times are those of the scene [s]."""

    @property
    def is_completed(self) -> bool:
        """Whether the tool rests at the end of its path."""

    def cycle(self, now: float, axes: Array, around: ObstacleSnapshot) -> None:
        """Choose the motion, every 50 ms, from measured axes (9,) and what was observed."""

    def correct(self, time: float, pose: Array) -> None:
        """Take a measured pose (3,) of the platform."""

    def window(self, now: float) -> Window | None:
        """Return the motion of all axes (k, 9) from now on; None if nothing moves."""

    def tool(self, now: float) -> Array:
        """Return the position (3,) in odom at which the tool is to be now [m]."""


@dataclass
class BodyRecord:
    """What truly happened, and what was measured; times are those of the scene [s]."""

    #: Times, measured (3,) and true poses (3,) of the platform, each tick of its controller
    platform: list[Array] = field(default_factory=list)
    #: Times, true angles (6,) of the arm, and where the tool is to be (3,), each of its cycles
    arm: list[Array] = field(default_factory=list)
    #: Times and names of what touched the robot in the physics world
    contacts: list[tuple[float, str]] = field(default_factory=list)
    stop: str = ""  #: Why the robot stopped early, if it did
    completed_at: float | None = None  #: Time at which the tool rested at the end of its path


class BodyLoop:
    """Drives a robot among the things of a scene.

    Persons are in the ground truth of the scene alone, as those of the engine would give way.

    Args:
        robot: Parameters of the robot, full names to values.
        posture: Angles (6,) at which the arm begins [rad].
        seed: Seed of the noise and of the latencies.
    """

    def __init__(
        self,
        robot: Mapping[str, Any],
        wheels: str,
        scene: AvoidanceScene,
        posture: Array,
        seed: int,
    ) -> None:
        self._scene, angles = scene, tuple(posture.tolist())
        world = WorldChoice.of(robot, wheels, _standing(scene), angles)
        self._platform = ClosedLoop.of_robot(robot, world)
        assert self._platform.world is not None and self._platform.world.arm is not None
        self._world = self._platform.world
        link = DirectLink(self._platform.world.arm)
        body = WorldArm(UrArmParameters(initial=angles), link, is_lockstep=True)
        body.measure(0.0)
        ur = replace(UrParameters(), servo_lag=WORLD_SERVO_LAG)
        self._joints = body
        self._arm = StreamedArm(body, build(ArmParameters, robot), ur)
        self._observed = ObstacleSet(build(ObstacleParameters, {}))
        self._random = np.random.default_rng(seed)
        self._poses: deque[tuple[float, float, Array]] = deque()
        self._previews: deque[tuple[float, Window, bool]] = deque()
        self._sent = self._told = self._accepted = -np.inf
        self.record = BodyRecord()

    def run(self, driver: BodyDriver, limit: float) -> BodyRecord:
        """Drive until the path is completed, or a time is over [s].

        A robot that stops early is watched until it rests.
        """
        record, arm_due, cycle_due, busy_until = self.record, self._arm.period, BEGIN, 0.0
        end = BEGIN + limit
        for k in range(round(end / STEP)):
            clock = k * STEP
            now = clock - BEGIN
            if clock >= self._platform.now:
                self._drive(now)
            self._observe(now)
            if clock >= cycle_due - 0.5 * STEP:
                cycle_due += CYCLE
                self._attempt(driver.cycle, now, self.measured(), self._around(now))
                busy_until = clock + ANSWER
                self._sent = -np.inf
            if clock >= busy_until:
                self._attempt(self._correct, driver, now)
            while self._previews and self._previews[0][0] <= clock:
                self._attempt(self._follow, *self._previews.popleft()[1:], clock)
            if clock >= arm_due:
                self._platform.drives.advance(arm_due)  # the joints are in its world
                self._move_arm(arm_due)
                row = [arm_due - BEGIN, *self._joints.q, *driver.tool(arm_due - BEGIN)]
                record.arm.append(np.array(row))
                arm_due += self._arm.period
            if driver.is_completed:
                record.completed_at = now
                break
            if record.stop:
                end = min(end, clock + REST_TIME)
            if clock >= end:
                break
        return record

    def _move_arm(self, clock: float) -> None:
        """Run one cycle of the arm; it stays where it is once its guard refuses a setpoint."""
        try:
            self._arm.cycle(clock)
        except InputError as error:
            self.record.stop = self.record.stop or f"the arm: {error}"

    def _attempt(self, step: Callable[..., None], *arguments: object) -> None:
        """Take a step of what drives the robot, unless it has stopped; note why it stops."""
        if self.record.stop:
            return
        try:
            step(*arguments)
            self._platform.check("the platform")
        except (StudyError, InputError) as error:
            self.record.stop = str(error)

    def measured(self) -> Array:
        """Return the axes (9,) as odometry and the arm's encoders have them."""
        return np.concatenate([self._platform.controller.odometry.pose, self._joints.q])

    def _drive(self, now: float) -> None:
        """Run one tick of the platform, whose pose is measured every other one."""
        loop = self._platform
        measured = loop.now
        loop.drives.advance(measured)
        loop.step()
        pose = np.array(loop.controller.odometry.pose)
        time = measured - BEGIN
        self.record.platform.append(np.array([time, *pose, *loop.truth]))
        names = {contact.element for contact in self._world.contacts}
        self.record.contacts += [(time, name) for name in sorted(names)]
        if round(measured / PERIOD) % round(ODOM_PERIOD / PERIOD) == 0:
            arrival = measured + LATENCY + self._random.uniform(*ODOM_LATENCY)
            if self._poses:
                arrival = max(arrival, self._poses[-1][0])  # in the order of sending
            self._poses.append((arrival, time, pose))

    def _observe(self, now: float) -> None:
        """Observe, with noise, what is in sight once the period of observations has passed."""
        if now < self._told + OBSERVED - 1e-9:
            return
        self._told = now
        robot, places = self._platform.truth[:2], self._scene.places_at(max(now, 0.0))
        for k in self._scene.in_sight(robot, places).tolist():
            x, y = (places[k] + NOISE * self._random.standard_normal(2)).tolist()
            thing = self._scene.things[k]
            a, b = thing.semi_axes
            seen = Observation(
                ("thing", k), now, x, y, 0.0, (a, b), heights=thing.heights, lifetime=0.0
            )
            self._observed.add(seen, now)

    def _around(self, now: float) -> ObstacleSnapshot:
        names = [f"{space} {number}" for space, number in self._observed.keys]
        return ObstacleSnapshot.of_ellipses(now, self._observed.ellipses(now), names)

    def _correct(self, driver: BodyDriver, now: float) -> None:
        """Take the measured poses that have arrived, and send what follows from them.

        The first preview after a cycle is that of platform and arm, the others are of the arm.
        """
        has_arrived, is_first = False, np.isinf(self._sent)
        while self._poses and self._poses[0][0] <= now + BEGIN:
            _, time, pose = self._poses.popleft()
            driver.correct(time, pose)
            has_arrived = True
        if not is_first and not (has_arrived and now >= self._sent + CORRECTED - 0.5 * STEP):
            return
        window = driver.window(now)
        if window is None:
            return
        self._sent = now
        arrival = now + BEGIN + self._random.uniform(*PREVIEW_LATENCY)
        if self._previews:
            arrival = max(arrival, self._previews[-1][0])
        self._previews.append((arrival, window, is_first))

    def _follow(self, window: Window, is_first: bool, clock: float) -> None:
        """Pass a preview that has arrived to the arm, and to the platform as well."""
        times = window.times + BEGIN
        arm = window.columns(JOINT_COLUMNS)
        try:
            self._arm.preview(times, arm.positions, arm.velocities, arm.accelerations, clock)
            self._accepted = clock
        except InputError as error:  # the last one is followed
            if clock - self._accepted > REFUSED:
                raise StudyError(f"arm/joint_reference is refused: {error}") from error
        if is_first:
            base = window.columns(PLATFORM_COLUMNS)
            parts = base.positions, base.velocities, base.accelerations
            self._platform.send(Source.BODY, Preview(times, *parts))


def _standing(scene: AvoidanceScene) -> things.Scene:
    """Return what stands in a scene as a scene of the physics world.

    A table top is a cylinder from the floor to its top, which for the platform is the same.
    """
    posts = [
        things.Post(
            name=f"thing {k}",
            x=float(scene.places[k, 0]),
            y=float(scene.places[k, 1]),
            radius=thing.semi_axes[0],
            height=thing.heights[1],
        )
        for k, thing in enumerate(scene.things)
        if not np.any(scene.velocities[k])
    ]
    return things.Scene(posts=tuple(posts))
