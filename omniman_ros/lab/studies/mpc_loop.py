"""MPC planner, controller and slipping plant in a closed loop in simulated time."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core.arbiter import Source
from omniman_ros.core.arrays import Array
from omniman_ros.core.preview import Preview
from omniman_ros.lab.studies.closed_loop import LATENCY, PERIOD, ClosedLoop
from omniman_ros.lab.studies.worlds import WorldChoice, move_person
from omniman_ros.planning.cycle import CycleReport, MeasuredState, PlannerState
from omniman_ros.planning.goals import Goal
from omniman_ros.planning.obstacles.ellipses import Ellipses
from omniman_ros.planning.obstacles.obstacles import Observation, ObstacleSet
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.planning.planner import Planner
from omniman_ros.simulation.plant.parameters import SimulationParameters

PLANNER_PERIOD = 0.05  # period of the planner [s]
OBSERVATION_PERIOD = 0.05  # period of the observations of obstacles [s]
WARM_UP_TICKS = 12
"""Number of ticks before the first goal: the planner keeps its initial motion, at rest at the
origin, for 50 ms."""


@dataclass(frozen=True)
class MovingObstacle:
    """An obstacle as it truly moves.

    Attributes:
        place: Function from a time [s] to the position (2,) of its centre in odom [m].
    """

    semi_axes: tuple[float, float]  # semi-axes [m]
    place: Callable[[float], Array]
    angle: float = 0.0  # angle of its first semi-axis in odom [rad]

    @property
    def is_fixed(self) -> bool:
        """Whether it stands still in the first second."""
        return not np.ptp([self.place(0.0), self.place(1.0)], axis=0).any()


@dataclass
class Trace:
    """The record of a planner, with a row for each of its cycles.

    Attributes:
        poses: True poses (3,) of the robot in odom [m, m, rad].
        references: Reference poses (3,) in odom [m, m, rad].
        obstacles: True positions (M, 2) of the obstacles in odom [m].
        planning_times: Durations of planning on the timer of the loop [s]; 0 in cycles
            without planning.
    """

    times: list[float] = field(default_factory=list)  # times of the cycles [s]
    poses: list[Array] = field(default_factory=list)
    references: list[Array] = field(default_factory=list)
    plans: list[Array] = field(default_factory=list)  # planned poses (k, 3) in odom [m, m, rad]
    obstacles: list[Array] = field(default_factory=list)
    reports: list[CycleReport] = field(default_factory=list)
    energy: list[float] = field(default_factory=list)  # electric energy consumed so far [J]
    states: list[PlannerState] = field(default_factory=list)  # states of the planner
    plan_times: list[Array] = field(default_factory=list)  # times (k,) of the planned poses [s]
    known: list[Ellipses] = field(default_factory=list)  # obstacles as the planner knows them
    planning_times: list[float] = field(default_factory=list)
    cycle_times: list[float] = field(default_factory=list)  # the same, with the search for routes


@dataclass
class MotionRecord:
    """The record of a robot's motion, with a row for each tick of the controller.

    Attributes:
        twists: Twists (3,) in base_link, from the encoders [m/s, m/s, rad/s].
    """

    times: list[float] = field(default_factory=list)  # times of the ticks [s]
    poses: list[Array] = field(default_factory=list)  # true poses (3,) in odom [m, m, rad]
    odometry: list[Array] = field(default_factory=list)  # poses (3,) by odometry [m, m, rad]
    twists: list[Array] = field(default_factory=list)
    energy: list[float] = field(default_factory=list)  # electric energy consumed so far [J]

    def add(self, loop: ClosedLoop) -> None:
        """Record the latest tick of a loop."""
        odometry = loop.controller.odometry
        self.times.append(loop.now - PERIOD)
        self.poses.append(loop.truth.copy())
        self.odometry.append(np.array(odometry.pose))
        self.twists.append(np.array(odometry.twist))
        self.energy.append(float(loop.drives.electrical()[:, 2].sum()))


@dataclass(frozen=True)
class LoopOptions:
    """The conditions of a drive.

    Attributes:
        voltages: Whether the planner's motor voltages are applied, instead of its reference being
            followed.
        solve_time: Simulated duration of planning in a cycle, a multiple of the tick of 5 ms [s].
        timer: Function that returns a time [s], by which the duration of planning is measured;
            None if it is not measured.
        world: World in which the robot drives; None for the plant. Its persons are the moving
            obstacles, in their order.
        observe: Function that tells planner and set of obstacles what is seen, called in each
            cycle; None if the obstacles are observed themselves.
        on_tick: Function that is called after each tick of the controller, or None.
    """

    start: Sequence[float] = (0.0, 0.0, 0.0)  # (3,) pose at the start in odom [m, m, rad]
    obstacles: Sequence[MovingObstacle] = ()  # obstacles as they truly move
    voltages: bool = False
    solve_time: float = 0.01
    noise: float = 0.0  # standard deviation of the observed positions of obstacles [m]
    seed: int = 0  # seed of the noise
    timer: Callable[[], float] | None = None
    world: WorldChoice | None = None
    observe: Callable[["MpcLoop"], None] | None = None
    on_tick: Callable[["MpcLoop"], None] | None = None


class MpcLoop:
    """Drives a robot to goals, one cycle of the planner at a time."""

    def __init__(
        self,
        planner: PlannerParameters,
        platform: PlatformParameters,
        simulation: SimulationParameters,
        options: LoopOptions | None = None,
    ) -> None:
        options = options or LoopOptions()
        self.loop = ClosedLoop(platform, simulation, world=options.world)
        x, y, theta = map(float, options.start)
        self.loop.drives.set_pose((x, y, theta))
        self.loop.controller.set_pose((x, y, theta))
        for _ in range(WARM_UP_TICKS):
            self.loop.step()
        self.planner = Planner(planner, anchored=not options.voltages)
        self.observed = ObstacleSet(planner.obstacles)
        self.obstacles = list(options.obstacles)
        self.touched: list[str] = []
        persons = options.world.scene.persons if options.world else ()
        moving = [obstacle for obstacle in self.obstacles if not obstacle.is_fixed]
        self._persons = list(zip(persons, moving, strict=True)) if options.world else []
        self.trace, self.motion_record = Trace(), MotionRecord()
        self._timer = options.timer or (lambda: 0.0)
        self._planning_time = self._cycle_time = 0.0
        self._observe_by, self._on_tick = options.observe, options.on_tick
        self._voltages, self._noise = options.voltages, options.noise
        self._solve_ticks = round(options.solve_time / PERIOD)
        self._random = np.random.default_rng(options.seed)
        self._last_observation = -np.inf

    @property
    def now(self) -> float:
        """Present time of the simulation [s]."""
        return self.loop.now

    def measured(self) -> MeasuredState:
        """Return the robot's pose and twist by odometry at the latest tick."""
        odometry = self.loop.controller.odometry
        return MeasuredState(
            self.loop.now - PERIOD, np.array(odometry.pose), np.array(odometry.twist)
        )

    def drive(self, goal: Goal) -> None:
        """Send a goal to the planner; nothing moves before `run` or `cycle`."""
        self._observe()
        self.planner.drive(goal, self.measured(), self.observed.ellipses(self.now))

    def run(self, seconds: float, until: Callable[[], bool] | None = None) -> None:
        """Run cycles for a time, or until a condition holds."""
        end = self.now + seconds
        while self.now < end - 1e-9:
            self.cycle()
            if self.planner.state is PlannerState.ARRIVED and until is None:
                return
            if until is not None and until():
                return

    def cycle(self) -> None:
        """Run one cycle of the planner, and the ticks of the controller until the next cycle."""
        self._observe()
        now, planner = self.now, self.planner
        ticks = round(PLANNER_PERIOD / PERIOD)
        self._planning_time = self._cycle_time = 0.0
        if planner.active:
            begin = self._timer()
            proposal = planner.propose(now, self.measured(), self.observed.ellipses(now))
            self._planning_time = self._timer() - begin
            for _ in range(self._solve_ticks):
                self._step()
            begin = self._timer()
            planner.take(proposal, self.now, self.measured(), self.observed.ellipses(self.now))
            self._planning_time += self._timer() - begin
            begin = self._timer()
            planner.update_route(self.now, self.observed.ellipses(self.now))
            self._cycle_time = self._planning_time + self._timer() - begin
            ticks -= self._solve_ticks
            self._publish()
        self._record()
        for _ in range(ticks):
            self._step()

    def _step(self) -> None:
        """Run one tick of controller and plant, and record it."""
        if self._voltages and self.loop.tick % 2 == 0:
            self._apply()
        self._move_persons()
        self.loop.step()
        self.motion_record.add(self.loop)
        if self._on_tick is not None:
            self._on_tick(self)
        if self.loop.world is not None:
            things = [contact.thing for contact in self.loop.world.contacts]
            self.touched += sorted(set(things) - set(self.touched))

    def _move_persons(self) -> None:
        """Move the persons of the world with the obstacles that they are, up to the next tick."""
        world, begin = self.loop.world, self.now - PERIOD
        if world is None:
            return
        for person, obstacle in self._persons:
            place = obstacle.place(begin)
            move_person(world, person, place, (obstacle.place(self.now) - place) / PERIOD)

    def _publish(self) -> None:
        """Pass the planner's motion to the controller as a preview, unless voltages drive it."""
        motion, now = self.planner.motion, self.now
        currents = motion.currents_at(now)
        if self._voltages and np.isfinite(currents).all():
            return
        if motion.end <= now + 1e-3:
            return
        sent = self.planner.preview
        part = sent.between(now, max(sent.end, now + 1e-3))
        preview = Preview(part.times, part.poses, part.velocities)
        self.loop.controller.set_preview(Source.MPC, preview, now)

    def _apply(self) -> None:
        """Pass the planner's motor voltages for the next two ticks to the controller."""
        volts = self.planner.voltages(self.now + 0.5 * 2 * PERIOD)
        if volts is not None:
            self.loop.controller.set_voltages(volts, self.now + LATENCY)

    def _observe(self) -> None:
        """Observe all obstacles with noise once the period of observations has passed."""
        if self._observe_by is not None:
            self._observe_by(self)
            return
        if self.now - self._last_observation < OBSERVATION_PERIOD - 1e-9 or not self.obstacles:
            return
        self._last_observation = self.now
        for k, obstacle in enumerate(self.obstacles):
            x, y = obstacle.place(self.now) + self._noise * self._random.standard_normal(2)
            observation = Observation(
                key=("obstacle", k),
                time=self.now,
                x=float(x),
                y=float(y),
                angle=obstacle.angle,
                semi_axes=obstacle.semi_axes,
                lifetime=0.0,
            )
            self.observed.add(observation, self.now)

    def _record(self) -> None:
        """Add a row for the present cycle to the trace."""
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
        trace.known.append(self.observed.ellipses(now))
        trace.planning_times.append(self._planning_time)
        trace.cycle_times.append(self._cycle_time)
