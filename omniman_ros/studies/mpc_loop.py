"""Planner, controller and slipping plant in one loop, in simulated time, among obstacles."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arbiter import Source
from omniman_ros.core.platform_parameters import PlatformParameters
from omniman_ros.core.preview import Preview
from omniman_ros.drive.parameters import SimulationParameters
from omniman_ros.planning.cycle import Measured, PlannerState, Report
from omniman_ros.planning.ellipses import Ellipses
from omniman_ros.planning.goals import Goal
from omniman_ros.planning.obstacles import Observation, ObstacleSet
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.planning.planner import Planner
from omniman_ros.studies.closed_loop import LATENCY, PERIOD, ClosedLoop

Array = NDArray[np.float64]

CYCLE = 0.05
"""Period of the planner [s]."""
OBSERVED = 0.05
"""Period of the observations of obstacles [s]."""
WARM_UP = 12
"""Ticks before the first goal: a planner holds its first motion, at the origin, for 50 ms."""


@dataclass(frozen=True)
class MovingObstacle:
    """An obstacle as it truly is.

    Attributes:
        semi_axes: [m].
        place: Its centre (2,) in odom [m] at a time [s].
        angle: Of its x axis [rad].
    """

    semi_axes: tuple[float, float]
    place: Callable[[float], Array]
    angle: float = 0.0


@dataclass
class Trace:
    """What happened, one row a planner cycle.

    Attributes:
        times: [s].
        poses: True poses (3,) of the robot.
        references: Poses (3,) that were asked for.
        plans: Poses (k, 3) planned.
        obstacles: True places (M, 2).
        reports: Of the planner.
        energy: Electric energy taken until then [J].
        states: Of the planner.
        plan_times: Of the poses planned, (k,) each [s].
        known: Obstacles as they were known.
        spent: What planning took, on the timer of the loop [s]; 0 where nothing was planned.
    """

    times: list[float] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)
    references: list[Array] = field(default_factory=list)
    plans: list[Array] = field(default_factory=list)
    obstacles: list[Array] = field(default_factory=list)
    reports: list[Report] = field(default_factory=list)
    energy: list[float] = field(default_factory=list)
    states: list[PlannerState] = field(default_factory=list)
    plan_times: list[Array] = field(default_factory=list)
    known: list[Ellipses] = field(default_factory=list)
    spent: list[float] = field(default_factory=list)


@dataclass
class Course:
    """What the robot did, one row a tick of the controller, as it truly was.

    Attributes:
        times: [s].
        poses: (3,) each [m, m, rad].
        odometry: Poses (3,) as the robot has them.
        twists: (3,) in base_link, from the encoders.
        energy: Electric energy taken until then [J].
    """

    times: list[float] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)
    odometry: list[Array] = field(default_factory=list)
    twists: list[Array] = field(default_factory=list)
    energy: list[float] = field(default_factory=list)

    def add(self, loop: ClosedLoop) -> None:
        """Take down the last tick of a loop."""
        odometry = loop.controller.odometry
        self.times.append(loop.now - PERIOD)
        self.poses.append(loop.truth.copy())
        self.odometry.append(np.array(odometry.pose))
        self.twists.append(np.array(odometry.twist))
        self.energy.append(float(loop.drives.electrical()[:, 2].sum()))


class MpcLoop:
    """The robot on its way to goals, a cycle of the planner at a time.

    Args:
        planner: Parameters of the planner.
        platform: Parameters of the controller, of the same robot.
        simulation: Parameters of the drives.
        start: (3,) pose at the start.
        obstacles: What is there.
        voltages: Whether the planner's voltages are applied, or its reference followed.
        solve_time: How long an answer takes; a multiple of the tick of 5 ms [s].
        noise: Standard deviation of the observed places of obstacles [m].
        seed: Of the noise.
        timer: CPU time [s], or whatever planning is to be measured by; None: it is not.
    """

    def __init__(
        self,
        planner: PlannerParameters,
        platform: PlatformParameters,
        simulation: SimulationParameters,
        start: Sequence[float] = (0.0, 0.0, 0.0),
        obstacles: Sequence[MovingObstacle] = (),
        voltages: bool = False,
        solve_time: float = 0.01,
        noise: float = 0.0,
        seed: int = 0,
        timer: Callable[[], float] | None = None,
    ) -> None:
        self.loop = ClosedLoop(platform, simulation)
        x, y, theta = map(float, start)
        self.loop.drives.set_pose((x, y, theta))
        self.loop.controller.set_pose((x, y, theta))
        for _ in range(WARM_UP):
            self.loop.step()
        self.planner = Planner(planner, anchored=not voltages)
        self.seen = ObstacleSet(planner.obstacles)
        self.obstacles = list(obstacles)
        self.trace, self.course = Trace(), Course()
        self._timer = timer or (lambda: 0.0)
        self._spent = 0.0
        self._voltages, self._noise = voltages, noise
        self._solving = round(solve_time / PERIOD)
        self._random = np.random.default_rng(seed)
        self._observed = -np.inf
        self._previewed = False

    @property
    def now(self) -> float:
        """Time [s]."""
        return self.loop.now

    def measured(self) -> Measured:
        """The robot as odometry has it."""
        odometry = self.loop.controller.odometry
        return Measured(self.loop.now - PERIOD, np.array(odometry.pose), np.array(odometry.twist))

    def drive(self, goal: Goal) -> None:
        """Go for a goal."""
        self._observe()
        self.planner.drive(goal, self.measured(), self.seen.ellipses(self.now))

    def run(self, seconds: float, until: Callable[[], bool] | None = None) -> None:
        """Drive for so long, or until the goal is reached."""
        end = self.now + seconds
        while self.now < end - 1e-9:
            self.cycle()
            if self.planner.state is PlannerState.ARRIVED and until is None:
                return
            if until is not None and until():
                return

    def cycle(self) -> None:
        """One cycle of the planner."""
        self._observe()
        now, planner = self.now, self.planner
        ticks = round(CYCLE / PERIOD)
        self._spent = 0.0
        if planner.active:
            begun = self._timer()
            proposal = planner.propose(now, self.measured(), self.seen.ellipses(now))
            self._spent = self._timer() - begun
            for _ in range(self._solving):
                self._step()
            begun = self._timer()
            planner.take(proposal, self.now, self.measured(), self.seen.ellipses(self.now))
            self._spent += self._timer() - begun
            planner.look(self.now, self.seen.ellipses(self.now))
            ticks -= self._solving
            self._publish()
        self._record()
        for _ in range(ticks):
            self._step()

    def _step(self) -> None:
        if self._voltages and self.loop.tick % 2 == 0:
            self._apply()
        self.loop.step()
        self.course.add(self.loop)

    def _publish(self) -> None:
        """Hand the motion to the controller as a preview."""
        motion, now = self.planner.motion, self.now
        braking = motion.currents_at(now)
        if self._voltages and np.isfinite(braking).all():
            return
        if motion.end <= now + 1e-3:
            return
        sent = self.planner.preview
        part = sent.between(now, max(sent.end, now + 1e-3))
        preview = Preview(part.times, part.poses, part.velocities)
        self.loop.controller.hear_preview(Source.MPC, preview, now)

    def _apply(self) -> None:
        """Hand the voltages of now to the controller."""
        volts = self.planner.voltages(self.now + 0.5 * 2 * PERIOD)
        if volts is not None:
            self.loop.controller.hear_voltages(volts, self.now + LATENCY)

    def _observe(self) -> None:
        if self.now - self._observed < OBSERVED - 1e-9 or not self.obstacles:
            return
        self._observed = self.now
        self.seen.heard(self.now)
        for k, obstacle in enumerate(self.obstacles):
            x, y = obstacle.place(self.now) + self._noise * self._random.standard_normal(2)
            seen = Observation(
                key=("obstacle", k), time=self.now, x=float(x), y=float(y), angle=obstacle.angle,
                semi_axes=obstacle.semi_axes, lifetime=0.0,
            )  # fmt: skip
            self.seen.add(seen, self.now)

    def _record(self) -> None:
        trace, now = self.trace, self.now
        trace.times.append(now)
        trace.poses.append(self.loop.truth.copy())
        trace.references.append(self.planner.motion.sample(now)[0])
        trace.plans.append(self.planner.motion.poses.copy())
        trace.obstacles.append(np.array([o.place(now) for o in self.obstacles]).reshape(-1, 2))
        trace.reports.append(self.planner.report)
        trace.energy.append(float(self.loop.drives.electrical()[:, 2].sum()))
        trace.states.append(self.planner.state)
        trace.plan_times.append(self.planner.motion.times.copy())
        trace.known.append(self.seen.ellipses(now))
        trace.spent.append(self._spent)
