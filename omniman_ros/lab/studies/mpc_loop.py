"""MPC planner, controller and slipping plant in a closed loop in simulated time."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core.arbiter import Source
from omniman_ros.core.arrays import Array
from omniman_ros.core.planar import Triple
from omniman_ros.core.preview import Preview
from omniman_ros.lab.studies.closed_loop import LATENCY, PERIOD, ClosedLoop, MotionRecord
from omniman_ros.lab.studies.scene_geometry import MovingObstacle
from omniman_ros.lab.studies.worlds import WorldChoice, place_obstacles
from omniman_ros.planning.cycle import CycleReport, MeasuredState, PlannerState
from omniman_ros.planning.goals import Goal
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.planning.planner import Planner
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.surroundings.ellipses import Ellipses
from omniman_ros.surroundings.obstacles import Observation, ObstacleSet

PLANNER_PERIOD = 0.05  #: period of the planner [s]
OBSERVATION_PERIOD = 0.05  #: period of the observations of obstacles [s]
SOLVE_TICKS = 2  #: simulated duration of planning in a cycle that is not timed, in ticks
#: Number of ticks before the first goal: the planner keeps its initial motion, at rest at the
#: origin, for 50 ms.
WARM_UP_TICKS = 12


@dataclass(frozen=True)
class MpcSceneCycle:
    """The record of one cycle of the planner."""

    time: float  #: [s]
    pose: Array  #: true pose (3,) of the robot in odom [m, m, rad]
    reference: Array  #: reference pose (3,) in odom [m, m, rad]
    plan_times: Array  #: times (k,) of the planned poses [s]
    plan: Array  #: planned poses (k, 3) in odom [m, m, rad]
    known: Ellipses  #: obstacles as the planner knows them
    report: CycleReport
    state: PlannerState
    planning_time: float  #: duration of planning on the timer of the loop [s]; 0 without planning
    cycle_time: float  #: the same, with the search for routes [s]


@dataclass(frozen=True)
class LoopOptions:
    """The conditions of a drive."""

    start: Triple = (0.0, 0.0, 0.0)  #: pose at the start in odom [m, m, rad]
    obstacles: Sequence[MovingObstacle] = ()  #: obstacles as they truly move
    voltages: bool = False  #: whether the planner's motor voltages are applied, not its reference
    noise: float = 0.0  #: standard deviation of the observed positions of obstacles [m]
    seed: int = 0  #: seed of the noise
    timer: Callable[[], float] = lambda: 0.0  #: time by which planning is measured [s]
    world: WorldChoice | None = None  #: world in which the robot drives; None for the plant
    #: Function that tells planner and set of obstacles what is seen, called in each cycle; None if
    #: the obstacles are observed themselves.
    observe: Callable[["MpcLoop"], None] | None = None
    on_tick: Callable[["MpcLoop"], None] | None = None  #: called after each tick of the controller
    #: Whether planning lasts in the simulation what the timer measures: an answer counts once it
    #: is there, and a cycle begins at the first multiple of the period after the one before.
    timed: bool = False


class MpcLoop:
    """Drives a robot to goals, one cycle of the planner at a time."""

    def __init__(
        self,
        planner: PlannerParameters,
        platform: PlatformParameters,
        simulation: SimulationParameters,
        options: LoopOptions,
    ) -> None:
        self.options = options
        self.loop = ClosedLoop(platform, simulation, world=options.world)
        self.loop.set_pose(options.start)
        for _ in range(WARM_UP_TICKS):
            self.loop.step()
        self.planner = Planner(planner, anchored=not options.voltages)
        self.observed = ObstacleSet(planner.obstacles)
        self.touched: list[str] = []
        self.cycles: list[MpcSceneCycle] = []
        self.motion_record = MotionRecord()
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

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        """Run cycles for a time, or until a condition holds."""
        end = self.now + seconds
        while self.now < end - 1e-9:
            self.cycle()
            if until():
                return

    def cycle(self) -> None:
        """Run one cycle of the planner, and the ticks of the controller until the next cycle."""
        self._observe()
        now, planner, timer = self.now, self.planner, self.options.timer
        begin_tick, period = self.loop.tick, round(PLANNER_PERIOD / PERIOD)
        planning_time = cycle_time = 0.0
        if planner.active:
            begin = timer()
            proposal = planner.propose(now, self.measured(), self.observed.ellipses(now))
            planning_time = timer() - begin
            self._step_until(begin_tick + self._ticks(planning_time))
            begin = timer()
            planner.take(proposal, self.now, self.measured(), self.observed.ellipses(self.now))
            planning_time += timer() - begin
            self._step_until(begin_tick + self._ticks(planning_time))
            self._publish()
            begin = timer()
            planner.update_route(self.now, self.observed.ellipses(self.now))
            cycle_time = planning_time + timer() - begin
        self._record(planning_time, cycle_time)
        ticks = self._ticks(cycle_time)
        self._step_until(begin_tick + period * max(math.ceil(ticks / period), 1))

    def _ticks(self, duration: float) -> int:
        """Return the number of ticks after which what took a time [s] counts as done."""
        return math.ceil(duration / PERIOD) if self.options.timed else SOLVE_TICKS

    def _step_until(self, tick: int) -> None:
        """Run ticks of controller and plant until a number of them."""
        while self.loop.tick < tick:
            self._step()

    def _step(self) -> None:
        """Run one tick of controller and plant, and record it."""
        world = self.loop.world
        if self.options.voltages and self.loop.tick % 2 == 0:
            self._apply()
        if world is not None:
            place_obstacles(world, self.options.obstacles, self.now)
        self.loop.step()
        self.motion_record.add(self.loop)
        if self.options.on_tick is not None:
            self.options.on_tick(self)
        if world is not None:
            things = [contact.element for contact in world.contacts]
            self.touched += sorted(set(things) - set(self.touched))

    def _publish(self) -> None:
        """Pass the planner's motion to the controller as a preview, unless voltages drive it."""
        motion, now = self.planner.motion, self.now
        currents = motion.currents_at(now)
        if self.options.voltages and np.isfinite(currents).all():
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
        options = self.options
        if options.observe is not None:
            options.observe(self)
            return
        if self.now - self._last_observation < OBSERVATION_PERIOD - 1e-9 or not options.obstacles:
            return
        self._last_observation = self.now
        for k, obstacle in enumerate(options.obstacles):
            x, y = obstacle.place(self.now) + options.noise * self._random.standard_normal(2)
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

    def _record(self, planning_time: float, cycle_time: float) -> None:
        """Record the present cycle."""
        motion, now = self.planner.motion, self.now
        self.cycles.append(
            MpcSceneCycle(
                now,
                self.loop.truth.copy(),
                motion.sample(now)[0],
                motion.times.copy(),
                motion.poses.copy(),
                self.observed.ellipses(now),
                self.planner.report,
                self.planner.state,
                planning_time,
                cycle_time,
            )
        )
