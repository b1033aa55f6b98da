"""What leads the tool along its path in `BodyLoop`: the whole body, and what it is beside."""

import time
from typing import Protocol

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.lab.studies.body_loop import ANSWER
from omniman_ros.lab.studies.reactive_body import ReactiveBody
from omniman_ros.motion.path.interpolator import PathState
from omniman_ros.motion.path.pace import LimitUsage, Pace, Window
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.whole_body.correction import LedTool, PlatformCorrection, ToolStream
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.tool_planner import ToolPlanner
from omniman_ros.planning.whole_body.avoidance_motion import AvoidanceMotion
from omniman_ros.planning.whole_body.controller import PERIOD, CycleOutcome
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.planning.whole_body.obstruction import Cause
from omniman_ros.planning.whole_body.parameters import BodySetup
from omniman_ros.planning.whole_body.platform_path import NoPathError
from omniman_ros.planning.whole_body.progress_watch import ProgressWatch
from omniman_ros.planning.whole_body.task import WholeBodyTask
from omniman_ros.simulation.world.distances import ConfigurationDistances, Prism

HORIZON = 0.4  #: Duration of previews [s]
SPACING = 2  #: Ticks between two points of a preview
AHEAD = np.arange(0.0, 1.0 + 1e-9, 0.1)  #: Times at which a robot that waits looks ahead [s]
AHEAD_GAP = 0.05  #: Gap below which it waits [m]
UNSEEN = 1e3  #: Coordinate of what has not been seen [m]


def _preview_times(now: float, horizon: float) -> Array:
    first = np.floor(now / TICK + 1e-6)
    times: Array = TICK * (first + np.arange(0, int(horizon / TICK) + 1, SPACING))
    return times


class PacedMotion(LedTool, Protocol):
    """A motion of nine axes as a function of the motion time."""

    def planned(self, times: Array) -> tuple[Array, Array, Array]:
        """Return x, x', x'' (k, 9) at motion times (k,) [s]."""

    def demand(self, times: Array) -> LimitUsage | None:
        """Return the use of the limits at motion times (k,) [s]."""


class LedBody:
    """Previews of a motion at a pace, with the arm corrected for the platform's error."""

    def __init__(self, setup: BodySetup, motion: PacedMotion, now: float) -> None:
        self.motion = motion
        model = WholeBodyModel(setup.description.mount)
        speeds = tuple(setup.limits.velocity[3:].tolist())
        self._tool = ToolStream(model, motion, PlatformCorrection(setup.path), speeds)
        self.pace = Pace(self._demand, TICK)
        self.pace.reset(now, 1.0)

    def _demand(self, times: Array) -> LimitUsage:
        return self.motion.demand(times) or LimitUsage.none(len(times))

    def limit(self, target: float, now: float) -> None:
        """Aim for a pace, or for less where the platform is off its path."""
        self.pace.refresh(now)
        self.pace.aim(min(target, self._tool.max_pace), now, at_once=target == 0.0)

    def correct(self, time: float, pose: Array) -> None:
        """Take a measured pose (3,) of the platform at a time [s]."""
        reference = self.motion.planned(np.array([self.pace.motion(time)]))[0][0, :3]
        self._tool.correction.update(time, pose, reference)

    def window(self, now: float, horizon: float) -> Window:
        """Return the motion (k, 9) from now on."""
        times = _preview_times(now, horizon)
        window, _ = self._tool.corrected(times, self.pace, self.motion.planned, lambda t: t)
        return window

    def tool(self, now: float) -> Array:
        """Return the position (3,) at which the tool is to be [m]."""
        place: Array = self.motion.tool(np.array([self.pace.motion(now)]))[0, :3, 3]
        return place


class AvoidingBody:
    """The whole body avoids what is around it, as `whole_body_planner` does.

    Searches for a way take no time here; the node makes them in the background. Like it, a cycle
    raises NoPathError where the path is impossible.

    Attributes:
        cycle_times: CPU times of the cycles [s].
        preview_times: The same of all previews from cycle to cycle [s].
        search_times: The same of the searches for a way [s].
    """

    def __init__(self, setup: BodySetup, poses: Array) -> None:
        self._setup, self._poses = setup, poses
        self._motion = AvoidanceMotion(setup.limits)
        self._led: LedBody | None = None
        self._watch = ProgressWatch(0.0)
        self._horizon = HORIZON
        self._rest: Array = np.zeros(3)
        self.cycle_times: list[float] = []
        self.preview_times: list[float] = []
        self.search_times: list[float] = []

    @property
    def is_completed(self) -> bool:
        """Whether the tool rests at the end of its path."""
        return self._led is not None and self._motion.state is PathState.IDLE

    def cycle(self, now: float, axes: Array, around: ObstacleSnapshot) -> None:
        """Choose the motion; see `BodyDriver`."""
        led, motion = self._led or self._begin(now, axes, around), self._motion
        begin = time.process_time()
        motion_time, rate = led.pace.motion(now), led.pace.rate(now)
        outcome = motion.cycle(motion_time, rate, around, ANSWER, HORIZON)
        self._horizon = max(HORIZON, min(motion.time_to_rest(motion_time, rate), 2.0))
        self.cycle_times.append(time.process_time() - begin)
        self.preview_times.append(0.0)
        led.limit(1.0, now)
        motion.update(motion_time)
        if outcome is None:
            self._watch.excuse(now)
        else:
            self._search_if_blocked(now, motion_time, outcome, around)

    def _begin(self, now: float, axes: Array, around: ObstacleSnapshot) -> LedBody:
        begin = time.process_time()
        self._rest = WholeBodyModel(self._setup.description.mount).forward(axes)[:3, 3]
        try:
            task = WholeBodyTask(self._setup, self._poses, axes, now, around)
        finally:
            self.search_times.append(time.process_time() - begin)
        self._motion.follow(task)
        self._led, self._watch = LedBody(self._setup, self._motion, now), ProgressWatch(now)
        return self._led

    def _search_if_blocked(
        self, now: float, motion_time: float, outcome: CycleOutcome, around: ObstacleSnapshot
    ) -> None:
        place, found = self._motion.path_parameter(motion_time), outcome.obstruction
        self._watch.note(now, place, is_held=False, is_excused=False)
        stands = found is not None and found.cause is Cause.STANDING
        if not self._watch.is_search_due(now, is_obstructed=stands):
            return
        begin = time.process_time()
        try:
            self._motion.task.search(motion_time, around)
            self._watch.no_path = None
            if self._motion.take_detour(motion_time):
                self._watch = ProgressWatch(now)
        except NoPathError as error:
            self._watch.no_path = error
        self.search_times.append(time.process_time() - begin)

    def correct(self, time: float, pose: Array) -> None:
        """Take a measured pose of the platform; see `BodyDriver`."""
        if self._led is not None and self._motion.state is not PathState.IDLE:
            self._led.correct(time, pose)

    def window(self, now: float) -> Window | None:
        """Return the motion from now on; see `BodyDriver`."""
        if self._led is None or self._motion.state is PathState.IDLE:
            return None
        begin = time.process_time()
        window = self._led.window(now, self._horizon)
        self.preview_times[-1] += time.process_time() - begin
        return window

    def tool(self, now: float) -> Array:
        """Return where the tool is to be; see `BodyDriver`."""
        if self._led is not None and self._motion.state is not PathState.IDLE:
            self._rest = self._led.tool(now)
        return self._rest


class FixedMotion:
    """A motion of `ToolPlanner` that begins at a time [s]."""

    def __init__(self, setup: BodySetup, poses: Array, axes: Array, begin: float) -> None:
        model = WholeBodyModel(setup.description.mount)
        self._plan = ToolPlanner(model, setup.limits, setup.path).plan(poses, axes)
        self._begin, self._groups = begin, setup.limits.groups(1.0, 0.0)
        self.branch = self._plan.branch
        self.end = begin + self._plan.curve.duration

    def planned(self, times: Array) -> tuple[Array, Array, Array]:
        """Return x, x', x'' (k, 9) at motion times (k,) [s]."""
        return self._plan.curve.sample(times - self._begin)

    def tool(self, times: Array) -> Array:
        """Return poses (m, 4, 4) of `tool0` at motion times (m,) [s]."""
        return self._plan.tool(times - self._begin)

    def demand(self, times: Array) -> LimitUsage:
        """Return the use of the limits at motion times (k,) [s]."""
        _, v, a = self.planned(times)
        return LimitUsage.of(self._groups, v, a)


class FixedPosture:
    """The arm's configuration stays as far as it can, as `path_interpolator` leads the tool.

    Args:
        things: What is in the scene, before which the robot stops on its path and waits; none if
            it drives on.
    """

    def __init__(self, setup: BodySetup, poses: Array, things: tuple[Prism, ...] = ()) -> None:
        self._setup, self._poses = setup, poses
        self._gaps = ConfigurationDistances(setup.description, things) if things else None
        self._count = len(things)
        self._led: LedBody | None = None
        self._motion: FixedMotion | None = None
        self._now = 0.0
        self._rest: Array = np.zeros(3)

    @property
    def is_completed(self) -> bool:
        """Whether the tool rests at the end of its path."""
        led, motion = self._led, self._motion
        return led is not None and motion is not None and led.pace.motion(self._now) >= motion.end

    def cycle(self, now: float, axes: Array, around: ObstacleSnapshot) -> None:
        """Go on, or wait while contact is ahead; see `BodyDriver`."""
        self._now = now
        if self._led is None:
            self._rest = WholeBodyModel(self._setup.description.mount).forward(axes)[:3, 3]
            self._motion = FixedMotion(self._setup, self._poses, axes, now)
            self._led = LedBody(self._setup, self._motion, now)
        self._led.limit(0.0 if self._is_blocked(now, around) else 1.0, now)

    def _is_blocked(self, now: float, around: ObstacleSnapshot) -> bool:
        """Return whether the robot would be near something that it has seen."""
        if self._gaps is None:
            return False
        assert self._led is not None and self._motion is not None
        times = np.minimum(self._led.pace.motion(now) + AHEAD, self._motion.end)
        moves = self._motion.planned(times)[0]
        count = len(around.standing) + len(around.moving)
        seen = around.placed(AHEAD, np.tile(np.arange(count), (len(AHEAD), 1))).centre  # (2, k, M)
        numbers = [int(label.rpartition(" ")[2]) for label in around.labels()]
        for k, axes in enumerate(moves):
            places = np.full((self._count, 2), UNSEEN)
            places[numbers] = seen[:, k].T
            self._gaps.place(axes[:3], axes[3:], places)
            if self._gaps.distances(1.0).min() <= AHEAD_GAP:
                return True
        return False

    def correct(self, time: float, pose: Array) -> None:
        """Take a measured pose of the platform; see `BodyDriver`."""
        if self._led is not None:
            self._led.correct(time, pose)

    def window(self, now: float) -> Window | None:
        """Return the motion from now on; see `BodyDriver`."""
        return None if self._led is None else self._led.window(now, HORIZON)

    def tool(self, now: float) -> Array:
        """Return where the tool is to be; see `BodyDriver`."""
        return self._rest if self._led is None else self._led.tool(now)


class ReactiveDriver:
    """A reactive controller, whose rates become the platform's and the arm's motion.

    The rates of a cycle are reached from those before within a period. It begins two periods after
    the cycle, as the arm's setpoints are sent ahead by its servo's lag.
    """

    def __init__(self, setup: BodySetup, poses: Array) -> None:
        self._setup, self._poses = setup, poses
        self._body: ReactiveBody | None = None
        self._times: list[float] = []
        self._positions: list[Array] = []
        self._rates: list[Array] = []
        self._rest: Array = np.zeros(3)

    @property
    def is_completed(self) -> bool:
        """Whether the tool rests at the end of its path."""
        return self._body is not None and self._body.is_completed

    def cycle(self, now: float, axes: Array, around: ObstacleSnapshot) -> None:
        """Choose the rates; see `BodyDriver`."""
        if self._body is None:
            self._body = ReactiveBody(self._setup, self._poses, axes)
            self._times, self._positions = [now, now + 2.0 * PERIOD], [axes, axes]
            self._rates = [np.zeros(len(axes))] * 2
        rates = self._body.cycle(axes, now, around)
        mean = 0.5 * (self._rates[-1] + rates)
        self._times.append(self._times[-1] + PERIOD)
        self._positions.append(self._positions[-1] + PERIOD * mean)
        self._rates.append(rates)

    def correct(self, time: float, pose: Array) -> None:
        """Do nothing: the next cycle measures the pose."""

    def window(self, now: float) -> Window | None:
        """Return the motion from now on; see `BodyDriver`."""
        if self._body is None:
            return None
        times = _preview_times(now, HORIZON)
        knots, rates = np.array(self._times), np.array(self._rates)
        index = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(knots) - 1)
        change = np.vstack([np.diff(rates, axis=0), np.zeros(rates.shape[1])]) / PERIOD
        elapsed, acceleration = (times - knots[index])[:, None], change[index]
        rate = rates[index] + elapsed * acceleration
        position = np.array(self._positions)[index] + 0.5 * elapsed * (rates[index] + rate)
        return Window(times, position, rate, acceleration)

    def tool(self, now: float) -> Array:
        """Return where the tool is to be; see `BodyDriver`."""
        if self._body is not None:
            self._rest = self._body.path.pose(np.array([self._body.place]))[0, :3, 3]
        return self._rest
